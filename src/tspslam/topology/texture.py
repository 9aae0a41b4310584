"""Texture signals: what the image shows at each vertex, along each edge and in each face, eqs (4)-(6)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import check_luminance, check_pixels, require
from ..errors import InputError
from ..types import REC601, UNIT_OF, BoolArray, FloatArray, Signals, real_array
from .complex import Complex

_ALL_SEEN = 1 - 1e-6  # of a mean of a mask: but for rounding, 1
_WIDEST_EXACT = 32767  # a row of 16-bit pixels of this length still sums within int32

Channels = Literal["luminance", "all"]


def luminance(image: NDArray[Any]) -> FloatArray:
    """Luminance of an image in [0, 1]; colour by the Rec. 601 weights, in float, before any rounding.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1]; colour is RGB.

    Returns
    -------
    (H, W) float64

    Raises
    ------
    InputError
        If the image has another shape or type, is empty, or holds values that are not finite.

    Examples
    --------
    >>> float(luminance(np.full((2, 2), 51, np.uint8))[0, 0])
    0.2
    """
    planes = _planes(image, "luminance")
    if len(planes) > 1:
        raise InputError(f"image: has {len(planes)} channels, expected a grey one or R, G, B")
    plane, unit = planes[0]
    return plane.astype(np.float64) * unit


def sample_signals(
    image: NDArray[Any], uv: ArrayLike, complex_: Complex, *, channels: Channels = "luminance",
    valid: BoolArray | None = None,
) -> Signals:  # fmt: skip
    """Sample an image on every level of a complex, eqs (4)-(6).

    A vertex takes the bilinear sample at its projection, an edge the mean over its integer Bresenham line, a face the
    mean over the pixel centres in its closed triangle. These signals are unsigned: they do not flip with orientation.

    Parameters
    ----------
    image : (H, W) or (H, W, C) uint8, uint16 or float array
        Floats in [0, 1]; three channels are RGB. Other fields of floats are sampled as they are: one
        plane with ``channels="all"``, such as a depth map, and two or more than three channels.
    uv : (N, 2) float array
        Projections of the vertices, px; NaN for a vertex that the camera does not see.
    complex_ : Complex
        Its vertices are the rows of `uv`.
    channels : {"luminance", "all"}
        What to sample of a colour image: its luminance, giving (n,) signals, or each channel, giving (n, C). An image
        with two, or with more than three channels is always sampled in each.
    valid : (H, W) bool array, optional
        Pixels that the camera saw; an element that rests on any other has no signal. All by default.

    Returns
    -------
    Signals
        Luminance in [0, 1]; elements without a signal are 0 and marked.

    Raises
    ------
    InputError
        If the image, `uv` or `valid` is not as described.

    Notes
    -----
    The cost of a face is its height, not its area: row prefix sums give each row with two look-ups.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> ramp = np.tile(np.arange(5, dtype=np.uint8) * 51, (5, 1))
    >>> triangle = build_complex([[0, 1, 2]], 3)
    >>> signals = sample_signals(ramp, [[0, 0], [4, 0], [0, 4]], triangle)
    >>> signals.vertex.round(9).tolist(), int(signals.face_pixels[0])
    ([0.0, 0.8, 0.0], 15)
    """
    require(complex_, Complex, "complex_")
    if not isinstance(complex_.faces, np.ndarray):
        raise InputError("complex: its faces are polygons, expected triangles; merge_signals gives the cells theirs")
    points = _checked_uv(uv, complex_.n)
    sampled = [_sample_plane(plane, unit, points, complex_) for plane, unit in _planes(image, channels)]
    if valid is not None:
        seen = _sample_plane(_checked_mask(valid, image), 1.0, points, complex_)
        sampled = [_drop_unseen(each, seen) for each in sampled]
    if len(sampled) == 1 and (image.ndim == 2 or channels == "luminance"):
        return sampled[0]
    return _stack(sampled)


def _sample_plane(plane: NDArray[Any], unit: float, uv: FloatArray, complex_: Complex) -> Signals:
    from . import _locality, _pixels
    from ._memory import empty

    edges, faces = complex_.edges.view(np.uint32), complex_.faces.view(np.uint32)  # unsigned: no wrap-around checks
    is_far, by_vertex, by_edge, by_face = _locality.visits(uv, edges[:, 0], faces[:, 0])
    _locality.keep_visit(vars(complex_), is_far, by_vertex)
    n_edges, n_faces = len(edges), len(faces)
    vertex, vertex_ok = empty(complex_.n), empty(complex_.n, bool)
    edge, edge_uv, edge_ok = empty(n_edges), empty((n_edges, 2)), empty(n_edges, bool)
    face, face_uv, face_ok = empty(n_faces), empty((n_faces, 2)), empty(n_faces, bool)
    edge_pixels, face_pixels = empty(n_edges, np.int32), empty(n_faces, np.int32)
    table = _prefix_table(plane)

    def vertices(part: slice) -> None:
        _pixels.sample_vertices(plane, unit, uv, by_vertex[part], is_far, vertex, vertex_ok)

    def sides(part: slice) -> None:
        given = plane, unit, uv, vertex_ok, edges, by_edge[part], is_far
        _pixels.sample_edges(*given, edge, edge_uv, edge_pixels, edge_ok)

    def triangles(part: slice) -> None:
        given = plane, table, unit, uv, vertex_ok, faces, by_face[part], is_far
        _pixels.sample_faces(*given, face, face_uv, face_pixels, face_ok)

    for level, count in ((vertices, complex_.n), (sides, n_edges), (triangles, n_faces)):
        _locality.in_parts(level, count)
    return Signals(vertex, edge, face, edge_uv, face_uv, edge_pixels, face_pixels, vertex_ok, edge_ok, face_ok)


def _checked_mask(valid: BoolArray, image: NDArray[Any]) -> NDArray[np.uint8]:
    mask = np.asarray(valid)
    if mask.dtype != np.bool_ or mask.shape != image.shape[:2]:
        raise InputError(f"valid: is {mask.dtype} of shape {mask.shape}, expected bool of shape {image.shape[:2]}")
    return np.ascontiguousarray(mask).view(np.uint8)


def _drop_unseen(signals: Signals, seen: Signals) -> Signals:
    """Signals without those of elements whose mean of a mask is not 1."""
    kept = {level: getattr(seen, level) > _ALL_SEEN for level in ("vertex", "edge", "face")}
    levels = {f"{level}_ok": getattr(signals, f"{level}_ok") & ok for level, ok in kept.items()}
    values = {name: getattr(signals, name) for name in vars(signals) if not name.endswith("_ok")}
    for name, value in values.items():
        ok = levels[f"{name.partition('_')[0]}_ok"]
        values[name] = np.where(ok.reshape(-1, *(1,) * (value.ndim - 1)), value, np.zeros((), value.dtype))
    return Signals(**values, **levels)


def _prefix_table(plane: NDArray[Any]) -> NDArray[Any]:
    from .._threads import in_halves
    from . import _pixels
    from ._locality import FEW
    from ._memory import empty

    height, width = plane.shape
    exact = plane.dtype.kind == "u" and width <= _WIDEST_EXACT
    table = empty((height, width + 1), np.int32 if exact else np.float64)
    table[:, 0] = 0
    least = FEW // max(width, 1) + 2  # rows of more pixels than are near
    in_halves(lambda part: _pixels.prefix_sums(plane[part], table[part]), height, least)
    return table


def _planes(image: NDArray[Any], channels: Channels) -> list[tuple[NDArray[Any], float]]:
    """The planes to sample, contiguous, each with the factor that makes it luminance."""
    check_pixels("image", image, "(H, W) or (H, W, C)")
    if channels not in ("luminance", "all"):
        raise InputError(f"channels is {channels!r}, expected 'luminance' or 'all'")
    _check_values(image, channels)
    unit = UNIT_OF.get(image.dtype, 1.0)
    if image.ndim == 2:
        return [(np.ascontiguousarray(image), unit)]
    count = image.shape[2]
    if count == 1 or (count == 3 and channels == "luminance"):
        return [(_weigh(image, (REC601 if count == 3 else np.ones(1)) * unit), 1.0)]
    return [(np.ascontiguousarray(image[:, :, c]), unit) for c in range(count)]


def _check_values(image: NDArray[Any], channels: Channels) -> None:
    """Floats of luminance or colour lie in [0, 1]; other fields, such as depths or a network's, are finite."""
    count = 1 if image.ndim == 2 else image.shape[2]
    if count == 3 or (count == 1 and channels == "luminance"):
        check_luminance("image", image)
    elif image.dtype.kind == "f" and not np.isfinite(image).all():
        raise InputError("image: holds NaN or infinite values, expected finite ones")


def _weigh(image: NDArray[Any], weights: FloatArray) -> FloatArray:
    from . import _pixels

    plane = np.empty(image.shape[:2])
    _pixels.weigh_channels(np.ascontiguousarray(image), weights, plane)
    return plane


def _checked_uv(uv: ArrayLike, n: int) -> FloatArray:
    points = np.ascontiguousarray(real_array(uv, "uv", f"({n}, 2)"), dtype=np.float64)
    if points.shape != (n, 2):
        raise InputError(f"uv: shape is {points.shape}, expected ({n}, 2): one projection for each vertex")
    return points


def _stack(sampled: list[Signals]) -> Signals:
    first = sampled[0]
    return Signals(
        np.stack([s.vertex for s in sampled], axis=1),
        np.stack([s.edge for s in sampled], axis=1),
        np.stack([s.face for s in sampled], axis=1),
        first.edge_uv, first.face_uv, first.edge_pixels, first.face_pixels,
        first.vertex_ok, first.edge_ok, first.face_ok,
    )  # fmt: skip
