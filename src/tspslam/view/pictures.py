"""Pictures of a frame: keypoints, mesh, signals and response over the left image, and the mesh in space."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import Colormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from .._atomic import make_folder, write_bytes
from ..frame import Frame
from ..types import BoolArray, FloatArray, one_channel
from . import _solid as solid
from . import _style as style
from ._frame import (
    Shown,
    check_frame,
    depth,
    image_of,
    is_colour,
    limits,
    log_magnitude,
    on_faces,
    phase,
    phase_on_faces,
    projected,
    texture,
    wide,
)

Counts = NDArray[np.int64]

DEPTH_CLASSES = (
    ("z < 8 m", "#2f6fed"),
    ("8 to 30 m", "#1fa35c"),
    ("30 to 60 m", "#f2c319"),
    ("z ≥ 60 m", "#e2343a"),
)  # the paper's Figure 4
DEPTH_BOUNDS = (8.0, 30.0, 60.0)
ONE_CLASS = 0.9  # share of the points above which the four classes say little and a continuous scale is added
STRONGEST = 0.1  # share of the vertices that carry an arrow
DEPTH_MAP, SIGNAL_MAP, MAGNITUDE_MAP = "viridis", "viridis", "inferno"


def write_pictures(frame: Frame, folder: str | Path) -> list[Path]:
    """Write every picture of a frame as PNG; one set of versions gives the same frame the same bytes.

    Parameters
    ----------
    frame : Frame
        What to show.
    folder : path
        Where to; made if it does not exist.

    Returns
    -------
    list of Path
        The files in reading order: ``keypoints``, ``keypoints_depth`` (only where nearly all points fall in one class
        of depth), ``mesh_depth``, ``signals``, ``magnitude``, ``phase``, ``view3d_signal``, ``view3d_magnitude``.

    Raises
    ------
    InputError
        If the parts of the frame do not belong together.
    OutputError
        If a picture cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam import Cloud, Frame, Rig, Surface, build_complex, sample_signals, tmahf
    >>> uv, rig = np.array([[2.0, 2], [17, 3], [3, 16], [16, 17], [9, 10]]), Rig(20, 20, 9, 9, width=20, height=20)
    >>> cloud = Cloud(np.insert(uv / 10, 2, 5.0, axis=1), uv, np.ones(5))
    >>> surface = Surface(np.array([[0, 1, 4], [1, 3, 4], [3, 2, 4], [2, 0, 4]], np.int32))
    >>> complex_, image = build_complex(surface.faces, 5), np.eye(20)
    >>> signals = sample_signals(image, uv, complex_)
    >>> response = tmahf(complex_, uv, signals, order=1)
    >>> frame = Frame(0, 0.0, "toy", rig, cloud, surface, complex_, signals, response, image=image)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.stem for path in write_pictures(frame, folder)][:3]
    ['keypoints', 'keypoints_depth', 'mesh_depth']
    """
    check_frame(frame)
    pictures: dict[str, Callable[[Frame], Figure]] = {
        "keypoints": keypoints_picture,
        "keypoints_depth": keypoint_depth_picture,
        "mesh_depth": mesh_depth_picture,
        "signals": signals_picture,
        "magnitude": magnitude_picture,
        "phase": phase_picture,
        "view3d_signal": signal_view,
        "view3d_magnitude": magnitude_view,
    }
    if not _nearly_one_class(frame):
        del pictures["keypoints_depth"]
    make_folder(Path(folder))
    paths = []
    for name, draw in pictures.items():
        paths.append(Path(folder) / f"{name}.png")
        write_bytes(paths[-1], style.png(draw(frame)))
    return paths


def _depth_classes(frame: Frame) -> Counts:
    """Count the points in each class of depth of the paper's Figure 4, then those without a depth or a place, (5,)."""
    ok = projected(frame)
    counts = np.bincount(_class_of(frame)[ok], minlength=4)
    return np.array([*counts, (~ok).sum()])


def _nearly_one_class(frame: Frame) -> bool:
    """Tell whether one class of depth holds nine tenths of the points or more."""
    counts = _depth_classes(frame)[:4]
    return bool(counts.sum() > 0 and counts.max() >= ONE_CLASS * counts.sum())


def _class_of(frame: Frame) -> Counts:
    return np.digitize(depth(frame).values, DEPTH_BOUNDS)


def keypoints_picture(frame: Frame) -> Figure:
    """Draw the keypoints on the left image in the paper's four classes of depth (Figure 4), with counts.

    Parameters
    ----------
    frame : Frame
        What to show.

    Returns
    -------
    Figure
    """
    counts = _depth_classes(frame)
    n = len(frame.cloud)
    caption = f"{_count(n, 'point')}; colour: class of depth z."
    caption += _missing(int(counts[4]), "point", "without a place in the image or a depth")
    figure, axes = style.image_page(
        image_of(frame), "Keypoints by class of depth", frame.name, caption, side=False, tone="plain"
    )
    uv, ok, which = frame.cloud.uv, projected(frame), _class_of(frame)
    for k, (_, colour) in enumerate(DEPTH_CLASSES):
        _dots(axes, uv[ok & (which == k)], colour, n)
    _legend(axes, counts)
    return figure


def _legend(axes: Axes, counts: Counts) -> None:
    digits = len(str(counts[:4].max()))
    handles = [
        Patch(facecolor=colour, edgecolor="none", label=f"{_padded(count, digits)}   {label}")
        for (label, colour), count in zip(DEPTH_CLASSES, counts[:4].tolist(), strict=True)
    ]
    legend = axes.legend(
        handles=handles, loc="lower left", prop={"family": style.FONT, "size": 9}, fancybox=False, framealpha=0.92,
        edgecolor=style.RULE, facecolor=style.PAPER, labelcolor=style.INK, handlelength=0.9, handleheight=0.9,
        borderaxespad=0.8,
    )  # fmt: skip
    legend.set_zorder(5)


def _padded(count: int, digits: int) -> str:
    return str(count).rjust(digits, "\N{FIGURE SPACE}")


def keypoint_depth_picture(frame: Frame) -> Figure:
    """Draw the keypoints on the left image, coloured by depth on a continuous scale.

    Parameters, returns: as `keypoints_picture`.
    """
    shown = depth(frame)
    caption = f"{_count(int(shown.ok.sum()), 'point')}; colour: depth z, from the 1st to the 99th percentile."
    figure, axes = style.image_page(image_of(frame), "Keypoints by depth", frame.name, caption, side=True, tone="light")
    norm = _depth_norm(shown)
    _dots(axes, frame.cloud.uv[shown.ok], style.colours(shown.values[shown.ok], norm, DEPTH_MAP), len(frame.cloud))
    _bar(figure, axes, shown, norm, DEPTH_MAP, "depth z [m]")
    return figure


def mesh_depth_picture(frame: Frame) -> Figure:
    """Draw the mesh over the image, each face in the mean depth of its vertices; edges without a face as lines.

    Parameters, returns: as `keypoints_picture`.
    """
    faces = frame.complex_.faces
    at_faces = on_faces(faces, depth(frame))
    drawable = at_faces.ok & projected(frame)[faces].all(axis=1)
    shown = Shown(at_faces.values, drawable)
    caption = (
        f"{_count(int(drawable.sum()), 'face')}, {_count(len(frame.complex_.edges), 'edge')}; "
        "colour: mean depth of a face's vertices."
    )
    caption += _missing(len(faces) - int(drawable.sum()), "face", "that the camera does not see whole")
    figure, axes = style.image_page(image_of(frame), "Mesh by depth", frame.name, caption, side=True, tone="light")
    norm = _depth_norm(shown)
    _edges(axes, frame, "#33404d", 0.3)
    _faces(
        axes,
        frame,
        drawable,
        style.colours(at_faces.values[drawable], norm, DEPTH_MAP),
        alpha=0.72,
        edge="#1b2430",
        width=0.25,
    )
    _bar(figure, axes, shown, norm, DEPTH_MAP, "mean depth of the face [m]")
    return figure


def signals_picture(frame: Frame) -> Figure:
    """Draw the edge and face signals at their barycentres (Figure 6): squares for edges, circles for faces.

    A signal with three channels is drawn in its colours; any other number of channels by their mean.

    Parameters, returns: as `keypoints_picture`.
    """
    signals = frame.signals
    edge, face = Shown(one_channel(signals.edge), signals.edge_ok), Shown(one_channel(signals.face), signals.face_ok)
    both = Shown(np.concatenate([edge.values, face.values]), np.concatenate([edge.ok, face.ok]))
    rgb = is_colour(signals.face)
    caption = (
        f"Squares: {_count(int(edge.ok.sum()), 'edge')}. Circles: {_count(int(face.ok.sum()), 'face')}. Each stands at "
        f"the barycentre of its pixels and shows their mean {'colour' if rgb else 'luminance'}."
    )
    caption += _missing(int((~both.ok).sum()), "element", "without a signal")
    figure, axes = style.image_page(
        image_of(frame), "Edge and face signals", frame.name, caption, side=not rgb, tone="light"
    )
    norm = _norm(both, 0, 100)
    levels = [(edge, signals.edge, signals.edge_uv, "s"), (face, signals.face, signals.face_uv, "o")]
    for shown, raw, uv, marker in levels:
        values = np.clip(raw, 0, 1) if rgb else style.colours(shown.values, norm, SIGNAL_MAP)
        _dots(axes, uv[shown.ok], values[shown.ok], 1.6 * len(both.ok), marker=marker)
    if not rgb:
        _bar(figure, axes, both, norm, SIGNAL_MAP, "luminance [0, 1]")
    return figure


def magnitude_picture(frame: Frame) -> Figure:
    """Draw ``log10 |r|`` at the vertices over the dimmed image (Figure 9, top); faces show their vertices' mean.

    Parameters, returns: as `keypoints_picture`.
    """
    shown, zeros = log_magnitude(frame)
    shown = Shown(shown.values, shown.ok & projected(frame))
    caption = f"Response of order {frame.response.order} at {_of(shown.ok)} vertices; faces: mean of their vertices."
    caption += _missing(zeros, "vertex", "where it is exactly 0") + _undefined(frame)
    figure, axes = style.image_page(image_of(frame), "Response magnitude", frame.name, caption, side=True, tone="dark")
    norm = _norm(shown)
    _filled(axes, frame, on_faces(frame.complex_.faces, shown), norm, MAGNITUDE_MAP)
    _dots(axes, frame.cloud.uv[shown.ok], style.colours(shown.values[shown.ok], norm, MAGNITUDE_MAP), len(shown.ok))
    _bar(figure, axes, shown, norm, MAGNITUDE_MAP, "log₁₀ |r|")
    return figure


def phase_picture(frame: Frame) -> Figure:
    """Draw ``arg r`` at the vertices over the dimmed image (Figure 9, bottom), arrows on the strongest tenth.

    An arrow points in the direction ψ = arg(r)/m, v down: for m = 1 from dark to bright; for m > 1 it is one of m
    equivalent directions; for m = 0 there is none.

    Parameters, returns: as `keypoints_picture`.
    """
    shown = phase(frame)
    shown = Shown(shown.values, shown.ok & projected(frame))
    order = frame.response.order
    caption = f"Response of order {order} at {_of(shown.ok)} vertices; faces: circular mean of their vertices."
    if order:
        meaning = "from dark to bright" if order == 1 else f"one of {order} equivalent directions"
        caption += f" Arrows: the strongest tenth, {meaning}."
    caption += _missing(log_magnitude(frame)[1], "vertex", "where it is exactly 0") + _undefined(frame)
    figure, axes = style.image_page(image_of(frame), "Response phase", frame.name, caption, side=True, tone="dark")
    norm, cmap = Normalize(-np.pi, np.pi), style.phase_map()
    _filled(axes, frame, phase_on_faces(frame.complex_.faces, shown), norm, cmap)
    _dots(axes, frame.cloud.uv[shown.ok], style.colours(shown.values[shown.ok], norm, cmap), len(shown.ok))
    if order:
        _arrows(axes, frame, shown)
    style.phase_wheel(figure, axes)
    return figure


def signal_view(frame: Frame) -> Figure:
    """Draw the mesh in space, each face in its mean luminance, or colour where the signal has three channels.

    Parameters, returns: as `keypoints_picture`.
    """
    signals = frame.signals
    what = "its mean colour" if is_colour(signals.face) else "its mean luminance"
    figure, _ = solid.solid_page(
        frame,
        "Mesh and face signal in space",
        _space_caption(frame, what, signals.face_ok),
        face_rgb=texture(signals.face),
        face_ok=signals.face_ok,
        vertex_rgb=texture(signals.vertex),
        side=False,
    )
    return figure


def magnitude_view(frame: Frame) -> Figure:
    """Draw the mesh in space, each face coloured by the mean ``log10 |r|`` of its vertices.

    Parameters, returns: as `keypoints_picture`.
    """
    shown, zeros = log_magnitude(frame)
    at_faces = on_faces(frame.complex_.faces, shown)
    norm = _norm(shown)
    caption = _space_caption(frame, "the mean log₁₀ |r| of its vertices", at_faces.ok)
    caption += _missing(zeros, "vertex", "where it is exactly 0") + _undefined(frame)
    figure, axes = solid.solid_page(
        frame,
        "Mesh and response magnitude in space",
        caption,
        face_rgb=style.colours(at_faces.values, norm, MAGNITUDE_MAP),
        face_ok=at_faces.ok,
        vertex_rgb=np.where(shown.ok[:, None], style.colours(shown.values, norm, MAGNITUDE_MAP), 0.8),
        side=True,
    )
    _bar(figure, axes, shown, norm, MAGNITUDE_MAP, "log₁₀ |r|")
    return figure


def _space_caption(frame: Frame, what: str, face_ok: BoolArray) -> str:
    points, faces = solid.in_space(frame)
    if not len(faces):
        return f"{_count(len(points), 'point')} from the side; no face to show."
    caption = f"{_count(len(faces), 'face')} from the side, lightly shaded, each in {what}."
    bare = int((~face_ok[faces]).sum())
    caption += f" Pale grey: {_count(bare, 'face')} without a value." if bare else ""
    return caption + _missing(len(face_ok) - len(faces), "face", "far off the rest or unseen")


def _norm(shown: Shown, low: float = 1.0, high: float = 99.0) -> Normalize:
    return Normalize(*limits(shown.values[shown.ok], low, high))


def _depth_norm(shown: Shown) -> Normalize:
    low, high = limits(shown.values[shown.ok])
    return LogNorm(low, high) if wide(low, high) else Normalize(low, high)


def _bar(figure: Figure, axes: Axes, shown: Shown, norm: Normalize, cmap: str, label: str) -> None:
    if not shown.ok.any():
        return
    extend = style.extends(shown.values[shown.ok], float(norm.vmin or 0), float(norm.vmax or 0))
    style.colour_bar(figure, axes, norm, cmap, label, extend=extend)


def _dots(axes: Axes, uv: FloatArray, colours: FloatArray | str, count: float, marker: str = "o") -> None:
    """Dots whose size suits `count` of them on a page."""
    size = float(np.clip(36000 / max(count, 1), 7, 46))
    width = 0.35 if size > 9 else 0.2
    axes.scatter(uv[:, 0], uv[:, 1], s=size, c=colours, marker=marker, edgecolors="#10151b", linewidths=width, zorder=3)


def _faces(
    axes: Axes, frame: Frame, which: BoolArray, colours: FloatArray, *, alpha: float, edge: str, width: float
) -> None:
    corners = frame.cloud.uv[frame.complex_.faces[which]]
    triangles = PolyCollection(
        list(corners), closed=True, facecolors=colours, edgecolors=edge, linewidths=width, alpha=alpha
    )
    triangles.set(zorder=2, joinstyle="round")
    axes.add_collection(triangles, autolim=False)


def _edges(axes: Axes, frame: Frame, colour: str, width: float) -> None:
    ends = frame.complex_.edges
    whole = projected(frame)[ends].all(axis=1)
    axes.add_collection(
        LineCollection(list(frame.cloud.uv[ends[whole]]), colors=colour, linewidths=width), autolim=False
    )


def _filled(axes: Axes, frame: Frame, at_faces: Shown, norm: Normalize, cmap: Colormap | str) -> None:
    which = at_faces.ok & projected(frame)[frame.complex_.faces].all(axis=1)
    colours = style.colours(at_faces.values[which], norm, cmap)
    _faces(axes, frame, which, colours, alpha=0.68, edge="#10151b", width=0.12)


def _arrows(axes: Axes, frame: Frame, shown: Shown) -> None:
    ok = np.flatnonzero(shown.ok)
    magnitude = log_magnitude(frame)[0].values[ok]
    strongest = ok[np.argsort(-magnitude, kind="stable")[: int(np.ceil(STRONGEST * len(ok)))]]
    psi = shown.values[strongest] / frame.response.order
    length = 0.022 * max(image_of(frame).shape[:2])
    du, dv = length * np.cos(psi), length * np.sin(psi)
    u, v = frame.cloud.uv[strongest].T
    axes.quiver(
        u, v, du, dv, angles="xy", scale_units="xy", scale=1, units="inches", width=0.018, headwidth=4, headlength=4.5,
        headaxislength=4, color="#ffffff", edgecolors="#10151b", linewidths=0.4, zorder=4,
    )  # fmt: skip


def _count(number: int, what: str) -> str:
    plural = "vertices" if what == "vertex" else f"{what}s"
    return f"{number} {what if number == 1 else plural}"


def _of(ok: BoolArray) -> str:
    return f"{int(ok.sum())} of {len(ok)}"


def _missing(number: int, what: str, why: str) -> str:
    return f" Left out: {_count(number, what)} {why}." if number else ""


def _undefined(frame: Frame) -> str:
    return _missing(int((~frame.response.defined).sum()), "vertex", "where it is not defined")
