"""Quality: how far a distorted textured complex is from its original, by what stands on it and by its harmonics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import require, told
from ..errors import GeometryError, InputError
from ..topology.complex import Complex, Rows
from ..topology.diagnosis import orient_faces
from ..topology.harmonic import checked_bank, checked_order
from ..topology.laplacian import check_values
from ..types import BoolArray, FloatArray, IntArray, Signals, real_array
from . import _quality

Given = tuple[ArrayLike, Complex, Signals]

FLOOR = 0.01  # luminance below which differences hardly count: K1 of structural similarity (Wang 2004)
FLOOR_RESPONSE = 0.03  # luminance, of responses: K2, that of contrast, there
HALF_WAY = 0.5  # mean edges: a vertex so far off counts half; at half an edge it may as well be its neighbour
LEAST_SHARE = 0.1  # of the reference's elements with a signal: fewer that can be compared say nothing about the rest
NEAR = 3  # elements of the other surface at whose faces the nearest point is looked for
FARTHEST = 1e9  # m
LEVELS = ("luminance", "edge", "face")

_MODES = np.arange(4)  # orders of the features
_QUANTILES = (np.arange(16) + 0.5) / 16
_SHELLS = 64  # around the centroid: they see a texture that has moved (development: 16, 32, 64 tried)
_FLOOR_SHAPE = 0.1  # heights in edges, below which shape hardly counts
_FLOOR_LAYOUT = 0.05  # luminance over its mean
_BLOCKS = {
    **dict.fromkeys(LEVELS, FLOOR),
    **dict.fromkeys(("contrast", *(f"response {m}" for m in _MODES[1:])), FLOOR_RESPONSE),
    **dict.fromkeys((f"shape {m}" for m in _MODES), _FLOOR_SHAPE),
    "layout": _FLOOR_LAYOUT,
}
"""What features hold, in order, each with its floor: quantiles, then the means over the shells."""
FEATURES = len(_QUANTILES) * (len(_BLOCKS) - 1) + _SHELLS


class Quality(NamedTuple):
    """How far one complex is from another.

    Attributes
    ----------
    score : float
        Root mean square of the parts; 0 where the two are identical.
    parts : mapping of str to float
        Each 0 where nothing differs, about 1 where nothing agrees.
    """

    score: float
    parts: Mapping[str, float]


class _Side(NamedTuple):
    """A checked side: positions (n, 3), then of vertices, edges, faces together values (n + E + F, C) and marks."""

    complex_: Complex
    xyz: FloatArray
    values: FloatArray
    ok: BoolArray


class _Stars(NamedTuple):
    """What stands around each vertex: means (n, 3) of `_quality.filter_stars`, harmonics (n, M) of both."""

    plain: FloatArray
    texture: NDArray[np.complex128]
    shape: NDArray[np.complex128]


def compare_quality(reference: Given, distorted: Given, *, orders: Sequence[int] = (0, 1, 2, 3)) -> Quality:
    r"""Score of a distorted textured complex against its original: 0 is identical, about 1 has nothing in common.

    .. math:: \textrm{score}^2 = \operatorname{mean}_{\textrm{parts}} \operatorname{mean}_i
        \frac{|a_i - b_i|^2}{|a_i|^2 + |b_i|^2 + c^2}

    with a and b the signals of each level, then the harmonic responses of each order in the tangent planes of both
    surfaces: ``r_m = mean (s - s̄) e^{jmψ}`` over the star of a vertex, and the mean s̄ for m = 0.

    Parameters
    ----------
    reference, distorted : tuple of (xyz, complex_, signals)
        xyz (N, 3) float array, m, both in one frame: nothing is aligned here. Complex of triangles. Signals (n,) or
        (n, C), luminance in [0, 1]; the constants c, 0.01 and 0.03, are made for that. Vertices without a signal have
        no position either.
    orders : sequence of int
        Angular orders m of the responses.

    Returns
    -------
    Quality
        Parts "geometry": distance d of corresponding vertices in mean edges at the vertex of the reference, ``d² / (d²
        + ¼)``; "luminance", "edge", "face": signals of the three levels, where both have any; "response m";
        "missing": share of the reference's elements that have lost their signal. All as root mean squares.

    Raises
    ------
    InputError
        If a side is not as described, or under a tenth of the reference's elements with a signal can be compared.
    GeometryError
        If the reference or the distorted complex has no face with signals at its vertices.

    Notes
    -----
    With the same faces, elements of the same number correspond. Otherwise the distorted surface is sampled at the
    points nearest to the reference's vertices, edges and faces, linearly between what stands on its three levels, and
    "geometry" is the larger of both ways. The score is not symmetric: lengths are in the reference's edges. No person's
    ratings were used, here or in choosing any constant.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> uv = np.array([[0, 0], [8, 0], [0, 8], [8, 8.0]])
    >>> xyz, square = np.column_stack([uv, np.full(4, 9.0)]), build_complex([[0, 1, 2], [1, 2, 3]], 4)
    >>> image = np.eye(9)
    >>> sharp, dark = (sample_signals(image * k, uv, square) for k in (1.0, 0.8))
    >>> compare_quality((xyz, square, sharp), (xyz, square, sharp)).score
    0.0
    >>> 0 < compare_quality((xyz, square, sharp), (xyz, square, dark)).score < 0.2
    True
    """
    modes = _checked_orders(orders)
    a, b = _checked(reference, "reference"), _checked(distorted, "distorted")
    if a.values.shape[1] != b.values.shape[1]:
        raise InputError(
            f"distorted: signals have {b.values.shape[1]} channels, expected {a.values.shape[1]} as in the reference"
        )
    same = a.complex_.n == b.complex_.n and np.array_equal(a.complex_.faces, b.complex_.faces)
    same = same and np.array_equal(a.complex_.edges, b.complex_.edges)
    onto = b if same else _sampled_at(a, b)
    both = a.ok & onto.ok
    _check_share(int(both.sum()), int(a.ok.sum()))
    unit = _edge_at(a)
    parts = {"geometry": _root(_offset(a.xyz, onto.xyz, unit)[both[: a.complex_.n]])}
    if not same:
        parts["geometry"] = max(parts["geometry"], _back(a, b, unit))
    parts |= _signal_parts(a, onto, both) | _response_parts(a, onto, both, unit, modes)
    parts["missing"] = float(np.sqrt(1 - both.sum() / a.ok.sum()))
    return Quality(_root(np.square(list(parts.values()))), parts)


def quality_features(xyz: ArrayLike, complex_: Complex, signals: Signals) -> NDArray[np.float32]:
    """Numbers of a textured complex that travel in place of the original: what `compare_features` compares.

    Parameters
    ----------
    xyz : (N, 3) float array
        Vertices, m, in any frame: the numbers do not change with a rigid motion, nor with the unit of length.
    complex_ : Complex
        Of triangles.
    signals : Signals
        Luminance in [0, 1]; of several channels the mean counts.

    Returns
    -------
    (240,) float32
        16 quantiles of each of: vertex, edge and face signals, standard deviation in the star, magnitudes of the
        responses of orders 1 to 3, and of those of the heights over the tangent plane, in edges, of orders 0 to 3; then
        the faces' luminance over its mean, times area, in 64 shells around the centroid.

    Raises
    ------
    InputError, GeometryError
        As `compare_quality`.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> uv = np.array([[0, 0], [8, 0], [0, 8], [8, 8.0]])
    >>> xyz, square = np.column_stack([uv, np.full(4, 9.0)]), build_complex([[0, 1, 2], [1, 2, 3]], 4)
    >>> quality_features(xyz, square, sample_signals(np.eye(9), uv, square)).shape
    (240,)
    """
    side = _checked((xyz, complex_, signals), "quality_features")
    side = side._replace(values=side.values.mean(axis=1, keepdims=True))
    unit, value = _edge_at(side), side.values[:, 0]
    stars = _stars(side, _frames(side, side, side.ok)[0], unit, 0, side.ok, _MODES)
    used = stars.plain[:, 0] > 1
    several = [value[at][side.ok[at]] for at in _levels(complex_)]
    several += [np.sqrt(stars.plain[used, 2]), *np.abs(stars.texture[used, 1:].T), *np.abs(stars.shape[used].T)]
    quantiles = [np.quantile(each, _QUANTILES) if len(each) else np.zeros(len(_QUANTILES)) for each in several]
    return np.concatenate([*quantiles, _layout(side, value)]).astype(np.float32)


def compare_features(reference: ArrayLike, distorted: ArrayLike) -> Quality:
    """Score of a distorted complex by features alone: 0 is identical, about 1 has nothing in common.

    Parameters
    ----------
    reference, distorted : (240,) float array
        What `quality_features` gives for each.

    Returns
    -------
    Quality
        Parts "luminance", "edge", "face", "contrast", "response m", "shape m", "layout". Symmetric.

    Raises
    ------
    InputError
        If either is not 240 finite numbers.

    Examples
    --------
    >>> compare_features(np.ones(240), np.ones(240)).score
    0.0
    """
    one, other = _checked_features(reference, "reference"), _checked_features(distorted, "distorted")
    sizes = [_SHELLS if name == "layout" else len(_QUANTILES) for name in _BLOCKS]
    off = np.split(_relative(one, other, np.repeat(list(_BLOCKS.values()), sizes)), np.cumsum(sizes)[:-1])
    parts = {name: _root(squares) for name, squares in zip(_BLOCKS, off, strict=True)}
    return Quality(_root(np.square(list(parts.values()))), parts)


def _layout(side: _Side, value: FloatArray) -> FloatArray:
    """Luminance of the faces over its mean, in shells (64,) around the centroid: of equal area where it is a disc."""
    at = _levels(side.complex_)[2]
    corner, ok = side.xyz[side.complex_.faces], side.ok[at]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) * ok
    if not area.sum() > 0:
        return np.zeros(_SHELLS)
    area, middle = area / area.sum(), corner.mean(axis=1)
    squared = ((middle - area @ middle) ** 2).sum(axis=1)
    spread = float(area @ squared) or 1.0
    height = _SHELLS * area * (value[at] - area @ value[at])
    depth = np.minimum(squared / (2 * spread), 1) * (_SHELLS - 1)  # a face lies between two shells: nothing jumps
    low = np.minimum(depth.astype(np.int64), _SHELLS - 2)
    inner, outer = height * (1 + low - depth), height * (depth - low)
    return np.bincount(low, inner, _SHELLS) + np.bincount(low + 1, outer, _SHELLS)


def _checked_features(features: ArrayLike, what: str) -> FloatArray:
    values = np.asarray(real_array(features, f"{what}: features", f"({FEATURES},)"), np.float64)
    if values.shape != (FEATURES,) or not np.isfinite(values).all():
        raise InputError(f"{what}: features have shape {values.shape}, expected ({FEATURES},), all of them finite")
    return values


def _signal_parts(a: _Side, b: _Side, both: BoolArray) -> dict[str, float]:
    off = _relative(a.values, b.values, FLOOR).mean(axis=1)
    levels = [(name, off[at][both[at]]) for name, at in zip(LEVELS, _levels(a.complex_), strict=True)]
    return {name: _root(values) for name, values in levels if len(values)}


def _response_parts(
    a: _Side, b: _Side, both: BoolArray, unit: FloatArray, modes: NDArray[np.int64]
) -> dict[str, float]:
    """Differences of the responses at vertices that both have with a star."""
    frames = _frames(a, b, both)
    off, used = np.zeros((a.complex_.n, len(modes))), np.zeros(a.complex_.n, bool)
    channels = a.values.shape[1]
    for c in range(channels):
        one, other = (_stars(side, frame, unit, c, both, modes) for side, frame in zip((a, b), frames, strict=True))
        used = one.plain[:, 0] > 1
        floors = np.where(modes == 0, FLOOR, FLOOR_RESPONSE)
        off += _relative(one.texture, other.texture, floors) / channels
    return {f"response {m}": _root(off[used, k]) for k, m in enumerate(modes)}


def _stars(
    side: _Side, frame: FloatArray, unit: FloatArray, channel: int, ok: BoolArray, modes: NDArray[np.int64]
) -> _Stars:
    n = side.complex_.n
    found = _Stars(np.zeros((n, 3)), np.zeros((n, len(modes)), np.complex128), np.zeros((n, len(modes)), np.complex128))
    values = np.ascontiguousarray(side.values[:, channel])
    _quality.filter_stars(*side.complex_.stars, _places(side), frame, unit, values, ok, modes, *found)
    found.texture[:, modes == 0] = found.plain[:, 1:2]
    return found


def _frames(a: _Side, b: _Side, ok: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Axes t1, t2, n (n, 3, 3) at each vertex of both: those of the other are turned from ours the shortest way."""
    faces = _wound(a.complex_.faces[ok[: a.complex_.n][a.complex_.faces].all(axis=1)])
    normal, other = _normals(faces, a.xyz), _normals(faces, b.xyz)
    is_flat = (other == 0).all(axis=1)
    other[is_flat] = normal[is_flat]  # a star that has collapsed
    first = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first -= (first * normal).sum(axis=1, keepdims=True) * normal
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    cosine = (normal * other).sum(axis=1, keepdims=True)
    turned = first - (first * other).sum(axis=1, keepdims=True) / np.maximum(1 + cosine, 1e-9) * (normal + other)
    turned = np.where((normal == other).all(axis=1, keepdims=True), first, turned)  # to the last digit
    return _axes(first, normal), _axes(turned, other)


def _axes(first: FloatArray, normal: FloatArray) -> FloatArray:
    return np.ascontiguousarray(np.stack([first, np.cross(normal, first), normal], axis=1))


def _wound(faces: NDArray[np.int32]) -> IntArray:
    """Faces wound alike, which those of a complex are not; a one-sided surface as it stands."""
    try:
        return orient_faces(faces)
    except GeometryError:
        return faces


def _normals(faces: IntArray, xyz: FloatArray) -> FloatArray:
    """Unit normals (n, 3) of the vertices, means over their faces by area; 0 where there is none."""
    corner, rows = xyz[faces], faces.T.ravel()
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.stack([np.bincount(rows, np.tile(column, 3), len(xyz)) for column in across.T], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


def _sampled_at(a: _Side, b: _Side) -> _Side:
    """The surface of b, and what stands on it, at the points nearest to the elements of a."""
    place, nodes, weights = _nearest(_places(a)[a.ok], b)
    weights = weights * b.ok[nodes]
    total = weights.sum(axis=1)
    found = np.einsum("qk,qkc->qc", weights, b.values[nodes]) / np.where(total > 0, total, 1)[:, None]
    values, ok, xyz = np.zeros_like(a.values), np.zeros_like(a.ok), np.zeros_like(_places(a))
    values[a.ok], ok[a.ok], xyz[a.ok] = found, total > 1e-9, place
    return _Side(a.complex_, np.ascontiguousarray(xyz[: a.complex_.n]), values, ok)


def _nearest(queries: FloatArray, side: _Side) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Nearest points (Q, 3) of a surface, and the elements around each (Q, 3) with their weights (Q, 3)."""
    from scipy.spatial import cKDTree

    complex_, places = side.complex_, _places(side)
    first = complex_.n, complex_.n + len(complex_.edges)
    seen = side.ok[: complex_.n]
    is_solid = seen[complex_.faces].all(axis=1)
    number = np.flatnonzero(np.concatenate([seen, seen[complex_.edges].all(axis=1), is_solid]))
    count = min(NEAR, len(number))
    near = number[cKDTree(places[number]).query(queries, k=count)[1].reshape(len(queries), count)]
    place, nodes, weights = np.zeros((len(near), 3)), np.zeros((len(near), 3), np.int64), np.zeros((len(near), 3))
    around = (complex_.faces, complex_.face_edges, is_solid, *_faces_at(complex_))
    _quality.find_nearest(queries, near, places, first, *around, place, nodes, weights)
    return place, nodes, weights


def _faces_at(complex_: Complex) -> Rows:
    """The faces at each vertex, edge and face."""
    start, rows = complex_.face_rows
    count = len(complex_.faces)
    of_edges = np.bincount(complex_.face_edges.ravel(), minlength=len(complex_.edges))
    by_edge = np.argsort(complex_.face_edges, axis=None, kind="stable") // 3
    ends = start[-1] + np.cumsum(np.concatenate([of_edges, np.ones(count, np.int64)]))
    return Rows(
        np.append(start, ends).astype(np.int32), np.concatenate([rows, by_edge, np.arange(count)]).astype(np.int32)
    )


def _back(a: _Side, b: _Side, unit: FloatArray) -> float:
    """How far the vertices of b are from the surface of a, in the edges there."""
    xyz = b.xyz[b.ok[: b.complex_.n]]
    place, nodes, _ = _nearest(xyz, a)
    unit = np.append(unit, np.full(len(a.ok) - len(unit), unit.mean()))  # of an edge without a face
    return _root(_offset(place, xyz, unit[nodes[:, 0]]))


def _offset(xyz: FloatArray, other: FloatArray, unit: FloatArray) -> FloatArray:
    squared = (((xyz - other) / unit[:, None]) ** 2).sum(axis=1)
    return squared / (squared + HALF_WAY**2)


def _relative(a: Any, b: Any, floor: Any) -> FloatArray:
    return np.asarray(np.abs(a - b) ** 2 / (np.abs(a) ** 2 + np.abs(b) ** 2 + floor**2))


def _root(squares: FloatArray) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else 0.0


def _places(side: _Side) -> FloatArray:
    """Vertices, middles of edges, middles of faces (n + E + F, 3)."""
    xyz, complex_ = side.xyz, side.complex_
    return np.concatenate([xyz, xyz[complex_.edges].mean(axis=1), xyz[complex_.faces].mean(axis=1)])


def _levels(complex_: Complex) -> tuple[slice, slice, slice]:
    second, third = complex_.n, complex_.n + len(complex_.edges)
    return slice(0, second), slice(second, third), slice(third, None)


def _edge_at(side: _Side) -> FloatArray:
    """Mean length (n,) of the edges at each vertex; over all edges where it has none of any length."""
    n, ends = side.complex_.n, side.complex_.edges
    ends = ends[side.ok[:n][ends].all(axis=1)]
    length = np.linalg.norm(side.xyz[ends[:, 0]] - side.xyz[ends[:, 1]], axis=1)
    if not (length > 0).any():
        raise GeometryError("reference: no edge has a length, expected a face with signals at its corners")
    total, count = np.bincount(ends.ravel(), np.repeat(length, 2), n), np.bincount(ends.ravel(), minlength=n)
    return np.where(total > 0, total / np.maximum(count, 1), length.mean())


def _checked(given: Any, what: str) -> _Side:
    if not isinstance(given, tuple) or len(given) != 3:
        raise InputError(f"{what} is {told(given)}, expected a tuple (xyz, complex_, signals)")
    xyz, complex_, signals = given
    require(complex_, Complex, f"{what}: complex_")
    require(signals, Signals, f"{what}: signals")
    if not isinstance(complex_.faces, np.ndarray):
        raise InputError(f"{what}: the faces of its complex are polygons, expected triangles")
    values, ok = _checked_signals(complex_, signals, what)
    points = np.array(real_array(xyz, f"{what}: xyz", f"({complex_.n}, 3)"), np.float64)
    if points.shape != (complex_.n, 3):
        raise InputError(f"{what}: xyz has shape {points.shape}, expected ({complex_.n}, 3)")
    seen = ok[: complex_.n]
    bad = np.flatnonzero(seen & ~(np.abs(points) <= FARTHEST).all(axis=1))
    if len(bad):
        raise InputError(f"{what}: xyz is {points[bad[0]].tolist()} at vertex {bad[0]}, expected at most {FARTHEST:g}")
    points[~seen] = 0
    if not seen[complex_.faces].all(axis=1).any():
        raise GeometryError(f"{what}: no face has signals at its three vertices, expected one at least")
    return _Side(complex_, points, values, ok)


def _checked_signals(complex_: Complex, signals: Signals, what: str) -> tuple[FloatArray, BoolArray]:
    sizes = (complex_.n, len(complex_.edges), len(complex_.faces))
    columns, marks = [], []
    for level, size in zip(("vertex", "edge", "face"), sizes, strict=True):
        values, ok = np.asarray(getattr(signals, level), np.float64), np.asarray(getattr(signals, f"{level}_ok"))
        if values.shape != (size, *signals.vertex.shape[1:]) or ok.shape != (size,):
            raise InputError(f"{what}: signals.{level} has shape {values.shape}, expected ({size},) or ({size}, C)")
        columns.append(np.where(ok[:, None], values.reshape(size, -1 if size else values[:1].size or 1), 0))
        check_values(columns[-1], f"{what}: signals.{level}", level)
        marks.append(ok)
    return np.concatenate(columns), _with_corners(complex_, np.concatenate(marks))


def _with_corners(complex_: Complex, ok: BoolArray) -> BoolArray:
    """Only edges and faces whose vertices are marked too: the others have no place."""
    _, second, third = _levels(complex_)
    ok[second] &= ok[: complex_.n][complex_.edges].all(axis=1)
    ok[third] &= ok[: complex_.n][complex_.faces].all(axis=1)
    return ok


def _check_share(both: int, ours: int) -> None:
    if both < LEAST_SHARE * ours:
        raise InputError(
            f"distorted: {both} of the reference's {ours} elements with a signal have one here,"
            f" expected at least {LEAST_SHARE:.0%}"
        )


def _checked_orders(orders: Sequence[int]) -> NDArray[np.int64]:
    modes = [checked_order(order, "compare_quality") for order in checked_bank(orders, (1,), "compare_quality")[0]]
    if len(set(modes)) < len(modes):
        raise InputError(f"compare_quality: orders are {tuple(modes)}, expected each once")
    return np.array(modes, np.int64)
