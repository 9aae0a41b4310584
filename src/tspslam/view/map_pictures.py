"""Pictures of the topological map of a sequence: from its path, from above, its response, and what varies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .._atomic import make_folder, write_bytes
from ..topological_map import TopologicalMap
from ..types import FloatArray
from . import _map_page as page
from . import _style as style
from ._frame import Shown, is_colour, limits
from ._map import check_map, deviation, luminance, magnitude, rgb_of, tangents
from ._viewpoints import Outlook, from_above, from_path, is_overhead, normals

MAGNITUDE_MAP, DEVIATION_MAP = "inferno", "magma"
DIMMEST = 0.3  # brightness of the least magnitude: its hue can still be told
SIDE_LIGHT = 0.3  # share of a face's brightness that depends on how it stands
LIGHT = np.array([-0.45, -0.75, -0.48])  # as in the views of a frame: from above left, behind the viewer
BRIGHTEST = 95.0  # percentile of the deviations that is shown brightest: what moves is a small share
LEAST_PIXELS = 12  # of the buffer: a face that takes fewer is not counted as shown
Pair = tuple[Outlook, Outlook]  # from above, and from the path


def write_map_pictures(map_: TopologicalMap, folder: str | Path) -> list[Path]:
    """Write every picture of a map as PNG; one set of versions gives the same map the same bytes.

    Parameters
    ----------
    map_ : TopologicalMap
        What to show.
    folder : path
        Where to; made if it does not exist.

    Returns
    -------
    list of Path
        The files in reading order: ``map_path`` (luminance, and magnitude of the response, from the middle of the
        path), ``map_above``, ``map_response`` (its direction and magnitude), ``map_variance`` (over the views).

    Raises
    ------
    InputError
        If the parts of the map do not belong together.
    OutputError
        If a picture cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam import Cloud, Frame, Response, Rig, Surface, build_complex, sample_signals
    >>> from tspslam.mapping.build import map_of_frame
    >>> uv, faces, image = np.array([[1.0, 1], [8, 2], [3, 7]]), np.array([[0, 1, 2]], np.int32), np.eye(10)
    >>> rig, complex_ = Rig(10, 10, 5, 5, width=10, height=10), build_complex(faces, 3)
    >>> cloud = Cloud(np.insert(uv / 10, 2, 5.0, axis=1), uv, np.ones(3))
    >>> signals, response = sample_signals(image, uv, complex_), Response(np.ones(3, complex), 1, np.ones(3, bool))
    >>> frame = Frame(0, 0.0, "toy", rig, cloud, Surface(faces), complex_, signals, response, image=image)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.stem for path in write_map_pictures(map_of_frame(frame, rig, np.eye(4)), folder)]
    ['map_path', 'map_above', 'map_response', 'map_variance']
    """
    check_map(map_)
    views = from_above(map_), from_path(map_)
    pictures: dict[str, Callable[[TopologicalMap, Pair], Figure]] = {
        "map_path": path_picture,
        "map_above": above_picture,
        "map_response": response_picture,
        "map_variance": variance_picture,
    }
    make_folder(Path(folder))
    paths = []
    for name, draw in pictures.items():
        paths.append(Path(folder) / f"{name}.png")
        write_bytes(paths[-1], style.png(draw(map_, views)))
    return paths


def path_picture(map_: TopologicalMap, views: Pair) -> Figure:
    """Draw the surface from the middle of the path: luminance, and below it the magnitude of the response.

    Parameters
    ----------
    map_ : TopologicalMap
        What to show.
    views : (Outlook, Outlook)
        From above, and from the path.

    Returns
    -------
    Figure
    """
    outlook, strength = views[1], magnitude(map_)
    caption = (
        "From a little behind and above a keyframe in the middle of the path, along its view. Above: mean luminance of "
        "each face over all keyframes that see it, lightly shaded. Below: magnitude |r| of the harmonic response, "
        "large where luminance changes."
    )
    figure, (top, bottom) = page.double_page(map_, outlook, "The map from its path", caption)
    _show_luminance(figure, top, map_, outlook)
    norm = Normalize(*limits(strength.values[strength.ok]))
    page.show_faces(bottom, outlook, style.colours(strength.values, norm, MAGNITUDE_MAP), strength.ok)
    page.draw_legend(bottom, outlook, [], _pale(outlook, strength, "no response"))
    style.colour_bar(figure, bottom, norm, MAGNITUDE_MAP, "log₁₀ |r|", extend=_ends(strength, norm))
    return figure


def above_picture(map_: TopologicalMap, views: Pair) -> Figure:
    """Draw the surface from above in its luminance, with the camera's path, its keyframes and a scale.

    Parameters, returns: as `path_picture`.
    """
    outlook = views[0]
    caption = (
        f"One surface of {len(map_.surface.faces)} faces over {len(map_)} landmarks; grey: mean luminance over views."
    )
    figure, axes = page.map_page(map_, outlook, "The map from above", caption + _left_out(map_))
    _show_luminance(figure, axes, map_, outlook)
    return figure


def response_picture(map_: TopologicalMap, views: Pair) -> Figure:
    """Draw the response where it shows most: direction as hue, magnitude as brightness.

    Parameters, returns: as `path_picture`.
    """
    strength = magnitude(map_)
    outlook = _fuller(map_, views, strength)
    angle, length = tangents(map_, outlook)
    norm = Normalize(*limits(strength.values[strength.ok]))
    brightness = DIMMEST + (1 - DIMMEST) * np.clip(np.asarray(norm(strength.values)), 0, 1)
    rgb = page.direction_colours(angle, length, brightness)
    caption = (
        f"{_whence(outlook)}: the harmonic response of order {map_.response.order} at {int(map_.defined.sum())} of "
        f"{len(map_)} landmarks. Hue: the direction along the surface in which luminance grows, as it lies on this "
        "picture; grey: across it. Brightness: magnitude |r|, logarithmic."
    )
    figure, axes = page.map_page(map_, outlook, "Response of the map", caption + _left_out(map_, outlook))
    page.show_faces(axes, outlook, rgb, strength.ok)
    _explain(map_, axes, outlook, _pale(outlook, strength, "no response"))
    page.direction_wheel(figure, axes, norm, DIMMEST)
    return figure


def variance_picture(map_: TopologicalMap, views: Pair) -> Figure:
    """Draw how much the luminance of each face differs between the keyframes that see it.

    Parameters, returns: as `path_picture`.
    """
    shown = deviation(map_)
    outlook = _fuller(map_, views, shown)
    norm = Normalize(0.0, max(limits(shown.values[shown.ok], high=BRIGHTEST)[1], 1e-3))
    caption = (
        f"{_whence(outlook)}: standard deviation of the luminance of each face over the keyframes that see it, after "
        "their exposures are made equal. Bright: what shines, moves or is mismatched."
    )
    figure, axes = page.map_page(map_, outlook, "Difference between views", caption + _left_out(map_, outlook))
    page.show_faces(axes, outlook, style.colours(shown.values, norm, DEVIATION_MAP), shown.ok)
    _explain(map_, axes, outlook, _pale(outlook, shown, "seen by fewer than two keyframes"))
    style.colour_bar(figure, axes, norm, DEVIATION_MAP, "deviation of luminance", extend=_ends(shown, norm))
    return figure


def _show_luminance(figure: Figure, axes: Axes, map_: TopologicalMap, outlook: Outlook) -> None:
    """Faces in their luminance, with the path and all that explains them."""
    shown = luminance(map_)
    norm = Normalize(*limits(shown.values[shown.ok]))
    rgb = rgb_of(map_) if is_colour(map_.signals.face) else style.colours(shown.values, norm, "gray")
    page.show_faces(axes, outlook, rgb * _light(map_)[:, None], shown.ok)
    _explain(map_, axes, outlook, _pale(outlook, shown, "seen by no keyframe, or too slanted"), with_path=True)
    style.colour_bar(figure, axes, norm, "gray", "luminance", extend=_ends(shown, norm))


def _explain(map_: TopologicalMap, axes: Axes, outlook: Outlook, pale: str, *, with_path: bool = False) -> None:
    """Legend, and from above the path and a scale."""
    path = page.draw_path(axes, map_, outlook) if outlook.is_above or with_path else []
    taken = page.draw_legend(axes, outlook, path, pale)
    if outlook.is_above:
        page.draw_scale(axes, outlook, taken)


def _fuller(map_: TopologicalMap, views: Pair, shown: Shown) -> Outlook:
    """The picture that shows more faces with a value; of equal ones that from above."""
    return max(views, key=lambda view: int((view.pixels[shown.ok] >= LEAST_PIXELS).sum()))


def _light(map_: TopologicalMap) -> FloatArray:
    """Brightness of the faces, (F,) in [0.7, 1], by how they stand."""
    towards = np.abs(normals(map_) @ (LIGHT / np.linalg.norm(LIGHT)))
    return np.asarray(1 - SIDE_LIGHT + SIDE_LIGHT * towards)


def _pale(outlook: Outlook, shown: Shown, why: str) -> str:
    """Words for the pale tint, if the picture has any."""
    bare = (outlook.pixels > 0) & ~shown.ok
    return why if bare.any() else ""


def _left_out(map_: TopologicalMap, outlook: Outlook | None = None) -> str:
    count = 0 if outlook is not None and not outlook.is_above else int(is_overhead(map_).sum())
    return f" Left out: {count} faces that look down, such as a ceiling's." if count else ""


def _whence(outlook: Outlook) -> str:
    return "From above" if outlook.is_above else "From the middle of the path"


def _ends(shown: Shown, norm: Normalize) -> str:
    if not shown.ok.any():
        return "neither"
    return style.extends(shown.values[shown.ok], float(norm.vmin or 0), float(norm.vmax or 0))
