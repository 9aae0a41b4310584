"""Sides of a comparison: checked, with the frames and stars of their vertices, and the nearest points of the other."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from .._checks import require, told
from ..errors import GeometryError, InputError
from ..topology.complex import Complex, Rows
from ..topology.diagnosis import orient_faces
from ..topology.laplacian import check_values, checked_mask
from ..types import BoolArray, FloatArray, IntArray, Signals, real_array
from . import _quality

NEAR = 3  # elements of the other surface at whose faces the nearest point is looked for
FARTHEST = 1e9  # m


class Side(NamedTuple):
    """A checked side: positions (n, 3), then of vertices, edges, faces together values (n + E + F, C) and marks."""

    complex_: Complex
    xyz: FloatArray
    values: FloatArray
    ok: BoolArray

    def __repr__(self) -> str:
        return brief(self)


class Stars(NamedTuple):
    """What stands around each vertex: means (n, 3) of `_quality.filter_stars`, harmonics (n, M) of both.

    `used` (n,): where there is a star and a plane to turn in.
    """

    plain: FloatArray
    texture: NDArray[np.complex128]
    shape: NDArray[np.complex128]
    used: BoolArray

    def __repr__(self) -> str:
        return brief(self)


def checked(given: Any, what: str) -> Side:
    """The side (xyz, complex_, signals) that was given, or what is wrong with it."""
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
    return Side(complex_, points, values, ok)


def _checked_signals(complex_: Complex, signals: Signals, what: str) -> tuple[FloatArray, BoolArray]:
    """Values (n + E + F, C), 0 where marked, and marks of all elements."""
    sizes, tail = (complex_.n, len(complex_.edges), len(complex_.faces)), np.shape(signals.vertex)[1:]
    columns, marks = [], []
    for level, size in zip(("vertex", "edge", "face"), sizes, strict=True):
        name = f"{what}: signals.{level}"
        values = real_array(getattr(signals, level), name, f"({size},) or ({size}, C)")
        if values.shape != (size, *tail) or len(tail) > 1 or 0 in tail:
            raise InputError(f"{name} has shape {values.shape}, expected ({size},) or ({size}, C)")
        marks.append(checked_mask(getattr(signals, f"{level}_ok"), size))
        columns.append(np.where(marks[-1][:, None], values.reshape(size, *(tail or (1,))), 0).astype(np.float64))
        check_values(columns[-1], name, level)
    return np.concatenate(columns), _with_corners(complex_, np.concatenate(marks))


def _with_corners(complex_: Complex, ok: BoolArray) -> BoolArray:
    """Only edges and faces whose vertices are marked too: the others have no place."""
    _, second, third = levels_of(complex_)
    ok[second] &= ok[: complex_.n][complex_.edges].all(axis=1)
    ok[third] &= ok[: complex_.n][complex_.faces].all(axis=1)
    return ok


def places_of(side: Side) -> FloatArray:
    """Vertices, middles of edges, middles of faces (n + E + F, 3)."""
    xyz, complex_ = side.xyz, side.complex_
    return np.concatenate([xyz, xyz[complex_.edges].mean(axis=1), xyz[complex_.faces].mean(axis=1)])


def levels_of(complex_: Complex) -> tuple[slice, slice, slice]:
    """Where vertices, edges and faces stand among all elements."""
    second, third = complex_.n, complex_.n + len(complex_.edges)
    return slice(0, second), slice(second, third), slice(third, None)


def areas_of(side: Side) -> FloatArray:
    """Area (F,) of the faces with a signal, of the others 0."""
    corner = side.xyz[side.complex_.faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return np.linalg.norm(across, axis=1) / 2 * side.ok[levels_of(side.complex_)[2]]


def edges_at(side: Side, what: str) -> FloatArray:
    """Mean length (n,) of the edges at each vertex; over all edges where it has none of any length."""
    n, ends = side.complex_.n, side.complex_.edges
    ends = ends[side.ok[:n][ends].all(axis=1)]
    length = np.linalg.norm(side.xyz[ends[:, 0]] - side.xyz[ends[:, 1]], axis=1)
    if not (length > 0).any():
        raise GeometryError(f"{what}: no edge has a length, expected vertices with signals at different places")
    total, count = np.bincount(ends.ravel(), np.repeat(length, 2), n), np.bincount(ends.ravel(), minlength=n)
    return np.where(total > 0, total / np.maximum(count, 1), length.mean())


def stars_of(
    side: Side, frame: FloatArray, unit: FloatArray, channel: int, ok: BoolArray, modes: NDArray[np.int64]
) -> Stars:
    """Means and harmonics of one channel around each vertex, in its frame; elements that are not `ok` left out."""
    n = side.complex_.n
    plain, texture, shape = np.zeros((n, 3)), *np.zeros((2, n, len(modes)), np.complex128)
    values = np.ascontiguousarray(side.values[:, channel])
    _quality.filter_stars(*side.complex_.stars, places_of(side), frame, unit, values, ok, modes, plain, texture, shape)
    texture[:, modes == 0] = plain[:, 1:2]
    return Stars(plain, texture, shape, (plain[:, 0] > 1) & frame[:, 2].any(axis=1))


def frames_of(a: Side, b: Side, ok: BoolArray) -> tuple[FloatArray, FloatArray]:
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


def sampled_at(a: Side, b: Side) -> Side:
    """The surface of b, and what stands on it, at the points nearest to the elements of a."""
    place, nodes, weights = nearest_on(places_of(a)[a.ok], b)
    weights = weights * b.ok[nodes]
    total = weights.sum(axis=1)
    found = np.einsum("qk,qkc->qc", weights, b.values[nodes]) / np.where(total > 0, total, 1)[:, None]
    values, ok, xyz = np.zeros_like(a.values), np.zeros_like(a.ok), np.zeros_like(places_of(a))
    values[a.ok], ok[a.ok], xyz[a.ok] = found, total > 1e-9, place
    return Side(a.complex_, np.ascontiguousarray(xyz[: a.complex_.n]), values, ok)


def nearest_on(queries: FloatArray, side: Side) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Nearest points (Q, 3) of a surface, and the elements around each (Q, 3) with their weights (Q, 3)."""
    from scipy.spatial import cKDTree

    complex_, places = side.complex_, places_of(side)
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
