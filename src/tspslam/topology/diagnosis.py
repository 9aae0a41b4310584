"""What a triangle surface is: its normals, its edges, its holes, and whether it is a manifold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from .._checks import with_part
from ..errors import GeometryError, InputError
from ..types import BoolArray, FloatArray, IntArray
from .surface import pinched_vertices

LARGEST = 1e100
"""Coordinates beyond this many metres are refused: areas and volumes must not overflow."""


@dataclass(frozen=True, repr=False)
class SurfaceDiagnosis(Brief):
    """What `diagnose_surface` found.

    Attributes
    ----------
    face_normal : (F, 3) float64
        Unit normals by the right-hand rule; 0 for a face without area.
    face_area : (F,) float64
        m².
    vertex_normal : (N, 3) float64
        Unit sums of the faces' normals, weighted by area; 0 where `has_normal` is False.
    has_normal : (N,) bool
        False for vertices without a face, and where the normals of the faces cancel.
    n_edges : int
        Distinct sides of the faces.
    boundary_edges, nonmanifold_edges : int
        Edges of one face, and of more than two.
    misoriented_edges : int
        Edges that their two faces run along in the same direction.
    boundary_loops : tuple of (n,) int64
        Closed loops of vertices that visit none twice, each from its smallest vertex on; the surface lies on the left
        where it is oriented and has no `misoriented_edges`. The loops consist of the edges with an odd number of
        faces: the boundary edges, if the surface is edge-manifold.
    components : int
        Parts that share no vertex; vertices without a face do not count.
    euler : int
        ``V - E + F`` over the vertices that have a face.
    unused : (M,) int64
        Vertices without a face, ascending.
    pinched : (P,) int64
        Vertices whose faces fall into several fans, ascending; faces on one edge, however many, are in one fan.
    """

    face_normal: FloatArray
    face_area: FloatArray
    vertex_normal: FloatArray
    has_normal: BoolArray
    n_edges: int
    boundary_edges: int
    nonmanifold_edges: int
    misoriented_edges: int
    boundary_loops: tuple[NDArray[np.int64], ...]
    components: int
    euler: int
    unused: NDArray[np.int64]
    pinched: NDArray[np.int64]

    @property
    def is_edge_manifold(self) -> bool:
        """Whether no edge has more than two faces."""
        return self.nonmanifold_edges == 0

    @property
    def is_manifold(self) -> bool:
        """Whether the surface is a manifold, with or without boundary: edge-manifold, nowhere pinched."""
        return self.is_edge_manifold and len(self.pinched) == 0

    @property
    def is_closed(self) -> bool:
        """Whether there are faces and each edge has at least two."""
        return self.n_edges > 0 and self.boundary_edges == 0

    @property
    def is_oriented(self) -> bool:
        """Whether each edge of two faces is run along once in each direction."""
        return self.misoriented_edges == 0


def diagnose_surface(faces: IntArray, xyz: FloatArray) -> SurfaceDiagnosis:
    """Say what a triangle surface is: normals, areas, edges, holes, components, Euler characteristic.

    Parameters
    ----------
    faces : (F, 3) integers
        Vertex triples, wound either way; F may be 0.
    xyz : (N, 3) float64
        Positions, m.

    Returns
    -------
    SurfaceDiagnosis
        Its normals follow the winding of the faces; see `orient_faces`.

    Raises
    ------
    InputError
        If the arrays have other shapes, a position is not finite (or beyond 1e100 m), a face names a vertex that is
        not there or names one twice.

    Examples
    --------
    A square of two triangles has one hole: the outside.

    >>> xyz = np.array([[0., 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]])
    >>> square = diagnose_surface(np.array([[0, 1, 2], [0, 2, 3]]), xyz)
    >>> square.euler, square.face_area.tolist(), square.is_oriented
    (1, [2.0, 2.0], True)
    >>> [loop.tolist() for loop in square.boundary_loops]
    [[0, 1, 2, 3]]
    """
    xyz = checked_positions(xyz, "surface")
    faces = _checked_faces(faces, len(xyz))
    normal, area, summed, has_normal = _normals(faces, xyz)
    edges, count, balance = edges_of(faces)
    used = np.unique(faces)
    return SurfaceDiagnosis(
        face_normal=normal,
        face_area=area,
        vertex_normal=summed,
        has_normal=has_normal,
        n_edges=len(edges),
        boundary_edges=int(np.sum(count == 1)),
        nonmanifold_edges=int(np.sum(count > 2)),
        misoriented_edges=int(np.sum((count == 2) & (balance != 0))),
        boundary_loops=_loops(edges[count % 2 == 1], balance[count % 2 == 1]),
        components=_count_components(edges, used),
        euler=len(used) - len(edges) + len(faces),
        unused=np.setdiff1d(np.arange(len(xyz)), used, assume_unique=True),
        pinched=pinched_vertices(faces.astype(np.int32), len(xyz)),
    )


def orient_faces(faces: IntArray) -> IntArray:
    """Wind the faces alike: across an edge of two faces, each runs along it in the other direction.

    The first face of each part keeps its winding, the others follow it. Edges of more than two faces, and vertices
    alone, hand nothing on.

    Parameters
    ----------
    faces : (F, 3) integers
        Vertex triples.

    Returns
    -------
    (F, 3) integers
        The same triples in the same order and type; those that turned have their last two vertices swapped.

    Raises
    ------
    GeometryError
        If a part has no two sides, as a Möbius strip or a Klein bottle has none.
    InputError
        If `faces` has another shape, a negative vertex, or a face that names a vertex twice.

    Examples
    --------
    >>> orient_faces(np.array([[0, 1, 2], [1, 2, 3]])).tolist()
    [[0, 1, 2], [1, 3, 2]]
    """
    faces = _checked_faces(faces, None)
    as_given, turned = _label_sides(faces)
    if np.any(as_given == turned):
        first = int(np.argmax(as_given == turned))
        raise GeometryError(f"surface: the part with face {first} is one-sided, expected an orientable surface")
    _, leader, part = np.unique(np.minimum(as_given, turned), return_index=True, return_inverse=True)
    is_turned = as_given != as_given[leader][part]
    return np.where(is_turned[:, None], faces[:, [0, 2, 1]], faces)


def edges_of(faces: IntArray) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Distinct sides of triangles, with how many faces use them, and which way.

    Parameters
    ----------
    faces : (F, 3) integers
        Vertex triples, not negative.

    Returns
    -------
    edges : (E, 2) int64
        Pairs (i < j), in lexicographic order.
    count : (E,) int64
        Faces at each edge.
    balance : (E,) int64
        Faces that run from i to j less those that run from j to i.

    Examples
    --------
    >>> edges, count, balance = edges_of(np.array([[0, 1, 2], [1, 2, 3]]))
    >>> edges[count == 2].tolist(), balance[count == 2].tolist()
    ([[1, 2]], [2])
    """
    key, inverse, count, forward = _numbered_sides(faces)
    balance = 2 * np.bincount(inverse, weights=forward, minlength=len(key)).astype(np.int64) - count
    return np.stack(np.divmod(key, _base(faces)), axis=1), count, balance


def checked_positions(xyz: Any, what: str) -> FloatArray:
    """Return finite positions as float64, or raise `InputError`.

    Parameters
    ----------
    xyz : (N, 3) float array
        Positions, m, at most 1e100.
    what : str
        How the error begins.

    Returns
    -------
    (N, 3) float64
    """
    array = _array(xyz, f"{what}: xyz")
    if array.dtype.kind not in "fiu" or array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{what}: xyz is {array.dtype} of shape {array.shape}, expected numbers of shape (N, 3)")
    with np.errstate(over="ignore"):  # long doubles may not fit; infinite ones are refused below
        array = array.astype(np.float64, copy=False)
    good = (np.abs(array) <= LARGEST).all(axis=1)
    if not good.all():
        bad = int(np.argmin(good))
        raise InputError(f"{what}: point {bad} is {array[bad].tolist()}, expected finite metres, at most {LARGEST:g}")
    return array


def _array(values: Any, what: str) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError as error:
        raise InputError(f"{what} has rows of several lengths, expected 3 numbers a row") from error


def _checked_faces(faces: Any, n: int | None) -> IntArray:
    array = _array(faces, "surface: faces")
    if array.dtype.kind not in "iu" or array.ndim != 2 or array.shape[1] != 3:
        given = f"are {array.dtype} of shape {array.shape}" if array.ndim else f"is {with_part(faces, 'faces')}"
        raise InputError(f"surface: faces {given}, expected integers (F, 3)")
    high = 2**31 if n is None else n
    good = ((array >= 0) & (array < high)).all(axis=1) & (array != np.roll(array, 1, axis=1)).all(axis=1)
    if not good.all():
        bad = int(np.argmin(good))
        raise InputError(f"surface: face {bad} is {array[bad].tolist()}, expected three vertices from 0 to {high - 1}")
    return array


def _normals(faces: IntArray, xyz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Normals and areas of the faces, normals of the vertices and where they exist."""
    size = float(np.abs(xyz).max(initial=0.0)) or 1.0  # products of very large or small metres leave the float range
    corner = xyz[faces] / size
    double = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(double, axis=1)
    at, n = faces.ravel(), len(xyz)
    summed = np.stack([np.bincount(at, np.repeat(double[:, axis], 3), n) for axis in range(3)], axis=1)
    # what is left of vectors that cancel is rounding
    has_normal = np.linalg.norm(summed, axis=1) > 1e-12 * np.bincount(at, np.repeat(length, 3), n)
    return _unit(double, length > 0), length / 2 * size**2, _unit(summed, has_normal), has_normal


def _unit(vectors: NDArray[Any], where: BoolArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros(vectors.shape), where=where[:, None])


def _base(faces: IntArray) -> int:
    return int(faces.max(initial=0)) + 1


def _numbered_sides(faces: IntArray) -> tuple[Any, Any, Any, BoolArray]:
    """Keys of the distinct sides, each side's edge, faces per edge, and whether sides run upwards.

    The sides come face by face: (a, b), (b, c), (c, a).
    """
    tail = faces.ravel().astype(np.int64)
    head = np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    key = np.minimum(tail, head) * _base(faces) + np.maximum(tail, head)
    return *np.unique(key, return_inverse=True, return_counts=True), tail < head


def _label_sides(faces: IntArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Components of the double cover: a label for each face as it is, and one for it turned over.

    A face and its neighbour are linked as they are where they agree, the one with the other turned where they do not.
    A part of the surface is one-sided just if its two sheets hang together.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, inverse, count, forward = _numbered_sides(faces)
    by_edge = np.argsort(inverse, kind="stable")
    first = (np.cumsum(count) - count)[count == 2]
    one, other = by_edge[first], by_edge[first + 1]
    f, g, n = one // 3, other // 3, len(faces)
    disagree = np.where(forward[one] == forward[other], n, 0)
    row, column = np.concatenate([f, f + n]), np.concatenate([g + disagree, g + n - disagree])
    links = coo_array((np.ones(len(row), bool), (row, column)), shape=(2 * n, 2 * n))
    label = connected_components(links, directed=False)[1]
    return label[:n], label[n:]


def _count_components(edges: NDArray[np.int64], used: NDArray[Any]) -> int:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    row, column = np.searchsorted(used, edges).T
    links = coo_array((np.ones(len(row), bool), (row, column)), shape=(len(used), len(used)))
    return int(connected_components(links, directed=False)[0]) if len(used) else 0


def _loops(edges: NDArray[np.int64], balance: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Loops of edges that each vertex has an even number of, along the faces where these agree."""
    from ._crust import trace_loops

    along = np.where(balance[:, None] > 0, edges, edges[:, ::-1])
    names, local = np.unique(along, return_inverse=True)
    ends = local.reshape(-1, 2)
    both = np.concatenate([ends[:, 0], ends[:, 1]])  # edges that leave a vertex come before those that arrive
    order = np.argsort(both, kind="stable")
    start = np.searchsorted(both[order], np.arange(len(names) + 1))
    vertices, stops = trace_loops(ends, start, order % max(len(ends), 1))
    loops = np.split(names[vertices], stops[:-1]) if len(stops) else []
    return tuple(np.roll(loop, -int(np.argmin(loop))) for loop in loops)
