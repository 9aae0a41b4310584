"""Vector-valued signals: colour, variance, gradient and range of the texture, depth and normals of the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import require
from ..errors import InputError
from ..types import FloatArray, Signals, real_array
from .complex import Complex
from .mahf import normalised, tangent_axes
from .texture import luminance, sample_signals

Channel = Literal["luminance", "red", "green", "blue", "variance", "gradient_u", "gradient_v", "range"]
CHANNELS: tuple[Channel, ...] = (
    "luminance", "red", "green", "blue", "variance", "gradient_u", "gradient_v", "range"
)  # fmt: skip


def sample_vectors(
    image: NDArray[Any],
    uv: ArrayLike,
    complex_: Complex,
    channels: Sequence[Channel] = ("luminance", "variance", "gradient_u", "gradient_v"),
) -> Signals:
    """Sample several properties of an image on every level of a complex.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1]; colour is RGB.
    uv : (N, 2) float array
        Projections of the vertices, px; NaN where there is none.
    complex_ : Complex
        Of triangles.
    channels : sequence of str
        "luminance": mean, as `sample_signals`. "red", "green", "blue": means of a colour image. "variance": that of the
        luminance over the element's pixels, 0 for a single one. "gradient_u", "gradient_v": mean of its central
        differences, luminance/px. "range": its largest minus its smallest value, 0 for a single pixel.

    Returns
    -------
    Signals
        (n, C), unsigned, in the order of `channels`.

    Raises
    ------
    InputError
        As `sample_signals`; if a channel is not known or repeated, or colour is asked of a grey image.

    Notes
    -----
    All cost a face its height, except "range", which looks at each pixel and so costs its area.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> ramp = np.tile(np.linspace(0, 1, 11), (11, 1))
    >>> triangle = build_complex([[0, 1, 2]], 3)
    >>> signals = sample_vectors(ramp, [[0, 0], [10, 0], [0, 10]], triangle, ("gradient_u", "range"))
    >>> signals.face.round(9).tolist()
    [[0.1, 1.0]]
    """
    if isinstance(channels, str):
        raise InputError(f"channels are {channels!r}, expected a sequence of names, such as ({channels!r},)")
    for name in channels:
        if name not in CHANNELS:
            raise InputError(f"channel is {name!r}, expected one of {', '.join(CHANNELS)}")
    if not channels or len(set(channels)) < len(channels):
        raise InputError(f"channels are {tuple(channels)}, expected at least one, each once")
    plane = luminance(image)
    if image.ndim == 2 and {"red", "green", "blue"} & set(channels):
        raise InputError("image is grey, expected a colour image (H, W, 3) for red, green and blue")
    return stack_signals([_sample(name, image, plane, uv, complex_) for name in channels])


def geometry_signals(complex_: Complex, xyz: ArrayLike, signals: Signals) -> Signals:
    """Depth and normal as signals: four channels, depth in m, then the components of the unit normal.

    Parameters
    ----------
    complex_ : Complex
        Of triangles.
    xyz : (N, 3) float array
        Vertices in the camera's frame, m.
    signals : Signals
        Signals on the complex; theirs are the barycentres, and what is marked.

    Returns
    -------
    Signals
        (n, 4). Depth is the mean over an element's vertices. The normal of a face points away from the camera; that of
        a vertex or an edge is the area-weighted mean over its faces, or the line of sight without one. The normal is
        unsigned: it does not turn with the face's winding.

    Raises
    ------
    InputError
        If `xyz` or the signals do not fit, or a vertex with a signal is not finite.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> triangle = build_complex([[0, 1, 2]], 3)
    >>> signals = sample_signals(np.zeros((9, 9)), [[0, 0], [8, 0], [0, 8]], triangle)
    >>> geometry_signals(triangle, [[0, 0, 2], [1, 0, 2], [0, 1, 2.0]], signals).face.tolist()
    [[2.0, 0.0, 0.0, 1.0]]
    """
    require(complex_, Complex, "complex_")
    require(signals, Signals, "signals")
    points = np.array(real_array(xyz, "xyz", f"({complex_.n}, 3)"), np.float64)
    sizes = (len(signals.vertex), len(signals.edge), len(signals.face))
    if points.shape != (complex_.n, 3) or sizes != (complex_.n, len(complex_.edges), len(complex_.faces)):
        raise InputError(f"xyz has shape {points.shape}, signals {sizes} elements, expected those of the complex")
    bad = np.flatnonzero(signals.vertex_ok & ~np.isfinite(points).all(axis=1))
    if len(bad):
        raise InputError(f"xyz is not finite at vertex {bad[0]}, which has a signal; expected finite coordinates")
    points[~signals.vertex_ok] = 0
    normals = _normals(complex_, points)
    levels: dict[str, Any] = {}
    for level, rows in (("vertex", np.arange(complex_.n)[:, None]), ("edge", complex_.edges), ("face", complex_.faces)):
        values = np.column_stack([points[rows, 2].mean(axis=1), normals[level]])
        values[~getattr(signals, f"{level}_ok")] = 0
        levels[level] = values
    return replace(signals, **levels)


def stack_signals(several: Sequence[Signals]) -> Signals:
    """Signals of one complex side by side, as channels (n, C1 + C2 + ...).

    Parameters
    ----------
    several : sequence of Signals
        On the same elements; the first gives barycentres, pixel counts and marks.

    Returns
    -------
    Signals
        (n, C1 + C2 + ...) float64 on every level.

    Raises
    ------
    InputError
        If there is none, or their sizes or marks differ.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> one = sample_signals(np.zeros((9, 9)), [[0, 0], [8, 0], [0, 8]], build_complex([[0, 1, 2]], 3))
    >>> stack_signals([one, one, one]).edge.shape
    (3, 3)
    """
    if isinstance(several, Signals):
        raise InputError("signals are one Signals, expected a sequence of them")
    if not several:
        raise InputError("no signals to stack, expected at least one")
    for one in several:
        require(one, Signals, "one of the signals")
    levels = {}
    for level in ("vertex", "edge", "face"):
        marks = [getattr(one, f"{level}_ok") for one in several]
        if any(not np.array_equal(marks[0], ok) for ok in marks):
            raise InputError(f"signals differ in where {level} signals are, expected those of one complex and view")
        columns = [getattr(one, level).reshape(len(marks[0]), -1 if len(marks[0]) else 1) for one in several]
        levels[level] = np.concatenate(columns, axis=1)
    return replace(several[0], **levels)


def _sample(name: str, image: NDArray[Any], plane: FloatArray, uv: ArrayLike, complex_: Complex) -> Signals:
    if name == "variance":
        return _variance(plane, uv, complex_)
    if name == "range":
        return _range(plane, uv, complex_)
    if name in ("gradient_u", "gradient_v"):
        return sample_signals(_difference(plane, 1 if name == "gradient_u" else 0), uv, complex_, channels="all")
    if name == "luminance":
        return sample_signals(plane, uv, complex_)
    return sample_signals(np.ascontiguousarray(image[:, :, ("red", "green", "blue").index(name)]), uv, complex_)


def _difference(plane: FloatArray, axis: int) -> FloatArray:
    """Central differences, one-sided at the rim, per px."""
    return np.zeros_like(plane) if plane.shape[axis] < 2 else np.asarray(np.gradient(plane, axis=axis))


def _variance(plane: FloatArray, uv: ArrayLike, complex_: Complex) -> Signals:
    """Mean of squares minus square of means, about a middle value; at least 0."""
    centred = plane - 0.5
    mean, square = (sample_signals(values, uv, complex_, channels="all") for values in (centred, centred**2))
    edge, face = (np.maximum(getattr(square, x) - getattr(mean, x) ** 2, 0) for x in ("edge", "face"))
    edge[mean.edge_pixels < 2] = 0
    face[mean.face_pixels < 2] = 0
    return replace(mean, vertex=np.zeros(complex_.n), edge=edge, face=face)


def _range(plane: FloatArray, uv: ArrayLike, complex_: Complex) -> Signals:
    from . import _range as kernels

    signals, points = sample_signals(plane, uv, complex_), np.asarray(uv, np.float64)
    edge, face = np.zeros(len(complex_.edges)), np.zeros(len(complex_.faces))
    kernels.range_of_edges(plane, points, complex_.edges, signals.edge_pixels, edge)
    kernels.range_of_faces(plane, points, complex_.faces, signals.face_pixels, face)
    return replace(signals, vertex=np.zeros(complex_.n), edge=edge, face=face)


def _normals(complex_: Complex, xyz: FloatArray) -> dict[str, FloatArray]:
    """Unit normals of all levels, away from the camera; without a face, the line of sight."""
    faces = complex_.faces
    apart = xyz[faces].reshape(-1, 3), np.arange(faces.size, dtype=np.int32).reshape(-1, 3)
    one, other = xyz[faces[:, 1]] - xyz[faces[:, 0]], xyz[faces[:, 2]] - xyz[faces[:, 0]]
    area = np.linalg.norm(np.cross(one, other), axis=1, keepdims=True)
    vertex, face = _across(tangent_axes(xyz, faces)), _across(tangent_axes(*apart)[::3])
    sight = normalised(xyz[complex_.edges].mean(axis=1), np.array([0.0, 0.0, 1.0]))
    return {"vertex": vertex, "edge": normalised(abs(complex_.B2) @ (face * area), sight), "face": face}


def _across(axes: FloatArray) -> FloatArray:
    return np.cross(axes[:, :3], axes[:, 3:])
