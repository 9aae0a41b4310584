"""The simplicial complex: edges, incidence matrices, Hodge Laplacians, unsigned neighbourhoods; eqs (14)-(16)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import Brief, brief
from .._checks import refuse_path, told, with_part
from ..errors import InputError
from ..types import IntArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Index = NDArray[np.int32]

LARGEST_PRODUCT = 1 << 32
"""Bytes of a matrix of pairs of edges that is still built."""


class Rows(NamedTuple):
    """A CSR pattern: row i holds ``indices[indptr[i]:indptr[i + 1]]``, each once (both int32)."""

    indptr: Index
    indices: Index

    def __repr__(self) -> str:
        return brief(self)


class Boundary(NamedTuple):
    """Boundaries of elements: that of element x is ``rim[start[x]:start[x + 1]]``, with orientation ``sign`` ±1."""

    start: Index
    rim: Index
    sign: NDArray[np.int8]

    def __repr__(self) -> str:
        return brief(self)


class Neighbours(NamedTuple):
    """The unsigned neighbourhoods of every vertex, as sparse (N, N), (N, E), (N, F) matrices of ones.

    ``vertex``: η_p, vertices that share an edge, without the vertex itself; ``edge``: η_e, all the edges of the
    faces that contain it, the opposite ones too; ``face``: η_f, those faces.
    """

    vertex: csr_array
    edge: csr_array
    face: csr_array

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, repr=False)
class Complex(Brief):
    """A simplicial complex of vertices, edges and triangles. Build it with `build_complex`.

    Attributes
    ----------
    n : int
        Number of vertices.
    edges : (E, 2) int32
        Vertex pairs i < j, in lexicographic order.
    faces : (F, 3) int32
        Vertex triples i < j < k, in the input's order.
    face_edges : (F, 3) int32
        The edges (i, j), (j, k), (i, k) of each face; ``B2`` has +1, +1, -1 there.

    Examples
    --------
    >>> disc = build_complex([[0, 1, 2], [0, 2, 3]], 4)
    >>> disc.edges.tolist()
    [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    >>> disc.euler
    1
    """

    n: int
    edges: Index
    faces: Index
    face_edges: Index

    @property
    def euler(self) -> int:
        """Euler characteristic N - E + F."""
        return self.n - len(self.edges) + len(self.faces)

    @cached_property
    def B1(self) -> csr_array:
        """Vertex-to-edge incidence matrix, (N, E) int8, with -1 at i and +1 at j of an edge i < j."""
        count = len(self.edges)
        start = np.arange(0, 2 * count + 1, 2, dtype=np.int32)
        return _incidence(Boundary(start, self.edges.ravel(), np.tile(np.array([-1, 1], np.int8), count)), self.n)

    @cached_property
    def boundary(self) -> Boundary:
        """The edges around each face and their signs: the columns of ``B2``."""
        count = len(self.face_edges)
        start = np.arange(0, 3 * count + 1, 3, dtype=np.int32)
        return Boundary(start, self.face_edges.ravel(), np.tile(np.array([1, 1, -1], np.int8), count))

    @cached_property
    def B2(self) -> csr_array:
        """Edge-to-face incidence matrix, (E, F) int8, with +1 on (i, j), +1 on (j, k), -1 on (i, k)."""
        return _incidence(self.boundary, len(self.edges))

    @cached_property
    def L0(self) -> csr_array:
        """Vertex Laplacian ``B1 B1ᵀ``, (N, N) float64, symmetric positive semidefinite."""
        B1 = self.B1.astype(np.float64)
        return B1 @ B1.T.tocsr()

    @cached_property
    def L1(self) -> csr_array:
        """Hodge Laplacian of oriented edge signals, ``B1ᵀ B1 + B2 B2ᵀ``, (E, E) float64.

        Raises
        ------
        InputError
            If so many edges meet in a vertex that it would take over 4 GiB.
        """
        check_product(self.edges, "L1")
        B1, B2 = self.B1.astype(np.float64), self.B2.astype(np.float64)
        return B1.T.tocsr() @ B1 + B2 @ B2.T.tocsr()

    @cached_property
    def L2(self) -> csr_array:
        """Laplacian of oriented face signals, ``B2ᵀ B2``, (F, F) float64."""
        B2 = self.B2.astype(np.float64)
        return B2.T.tocsr() @ B2

    @cached_property
    def vertex_rows(self) -> Rows:
        """η_p as a CSR pattern."""
        return self._level(0)

    @cached_property
    def face_rows(self) -> Rows:
        """η_f as a CSR pattern."""
        return self._level(2)

    @cached_property
    def edge_rows(self) -> Rows:
        """η_e as a CSR pattern."""
        return self._level(1)

    @cached_property
    def has_face(self) -> NDArray[np.bool_]:
        """Whether each edge has a face."""
        from . import _stars

        marked = np.zeros(len(self.edges), bool)
        _stars.mark_edges(self.face_edges, marked)
        return marked

    @cached_property
    def around(self) -> tuple[Index, Index, Index]:
        """The two arrays of the stars, and where the edges and the faces of each begin, (n, 2)."""
        from . import _construction

        return _construction.find_stars(self.n, self.edges, self.has_face, self.faces, self.face_edges)

    @property
    def stars(self) -> Rows:
        """η_p, η_e and η_f in one CSR pattern: edges are counted from n on, faces from n + E on."""
        return Rows(*self.around[:2])

    def _level(self, level: int) -> Rows:
        """The neighbours of one level, in arrays of their own."""
        from . import _stars
        from ._memory import empty

        start, rows, levels = self.around
        at_edges, at_faces = 2 * len(self.edges), self.face_edges.size
        size = (at_edges, len(rows) - at_edges - at_faces, at_faces)[level]
        first = (0, self.n, self.n + len(self.edges))[level]
        kept_start, kept = empty(self.n + 1, np.int32), empty(size, np.int32)
        _stars.take_level(start, levels, rows, level, first, kept_start, kept)
        return Rows(kept_start, kept)

    def neighbours(self) -> Neighbours:
        """Unsigned one-ring neighbourhoods of eqs (14)-(16).

        Returns
        -------
        Neighbours
            ``(vertex, edge, face)``, three sparse matrices of ones (int8).

        Examples
        --------
        >>> disc = build_complex([[0, 1, 2], [0, 2, 3]], 4)
        >>> disc.neighbours().edge.toarray()[1]
        array([1, 1, 0, 1, 0], dtype=int8)
        """
        from .._threads import both

        self.stars  # noqa: B018 - found before two threads ask for it
        sizes = (self.n, len(self.edges), len(self.faces))

        def patterns(levels: list[int]) -> list[csr_array]:
            return [_pattern(self._level(level), sizes[level]) for level in levels]

        edge, others = both(patterns, ([1], [0, 2]))  # of about the same length
        return Neighbours(others[0], edge[0], others[1])


def build_complex(faces: ArrayLike, n: int | None = None, edges: ArrayLike | None = None) -> Complex:
    """Build a simplicial complex from triangles and, if given, edges that stand without a face.

    Parameters
    ----------
    faces : (F, 3) integers
        Vertex triples in any order, counted from 0; repeated faces merge.
    n : int, optional
        Number of vertices; without it one more than the largest that a face or an edge names. Give it where there may
        be vertices without either.
    edges : (M, 2) integers, optional
        Further edges, in any order; those that a face has already merge with it.

    Returns
    -------
    Complex
        With B1 B2 = 0.

    Raises
    ------
    InputError
        If a face or an edge repeats a vertex or leaves ``0..n-1``, or the arrays have another shape or type.

    Examples
    --------
    The paper's Figure 2, counted from 0:

    >>> toy = build_complex([[0, 2, 3], [0, 1, 2], [1, 2, 4]], 5)
    >>> toy.n, len(toy.edges), len(toy.faces)
    (5, 7, 3)
    >>> abs(toy.B1 @ toy.B2).max()
    np.int8(0)
    """
    from . import _construction

    triples = _simplices(faces, 3, "face")
    n = largest(triples, edges) if n is None else checked_count(n)
    ascending, counts, bad = _construction.sort_faces(triples, n)
    _refuse(triples, bad, n, "face")
    extra = checked_pairs(edges, n)
    numbered, face_edges, may_repeat = _construction.number_edges(n, ascending, counts, extra)
    if may_repeat and len(distinct := first_of_equals(ascending)) < len(ascending):
        ascending, counts, _ = _construction.sort_faces(ascending[distinct], n)
        numbered, face_edges, _ = _construction.number_edges(n, ascending, counts, extra)
    complex_ = Complex(n, numbered, ascending, face_edges)
    if not len(extra):
        vars(complex_)["has_face"] = np.ones(len(complex_.edges), bool)
    return complex_


def checked_count(n: int) -> int:
    """Return a number of vertices as an int, or raise `InputError`.

    Parameters
    ----------
    n : int
        0 <= n < 2³¹.

    Returns
    -------
    int
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or not 0 <= n < 2**31:
        raise InputError(f"complex: n is {repr(n) if np.isscalar(n) else told(n)}, expected an integer, 0 <= n < 2**31")
    return int(n)


def largest(named: NDArray[Any], edges: ArrayLike | None) -> int:
    """Number of vertices up to the largest that faces or edges name.

    Parameters
    ----------
    named : (F, k) integers
        Vertices of the faces.
    edges : (M, 2) integers or None
        Further edges.

    Returns
    -------
    int
    """
    both = (named, _simplices([] if edges is None else edges, 2, "edge"))
    return checked_count(1 + max((int(each.max()) for each in both if each.size), default=-1))


def _simplices(values: ArrayLike, size: int, what: str) -> IntArray:
    refuse_path(values, f"complex: {what}s", f"(count, {size}) integers", "tspslam.io.read_mesh(path)")
    if hasattr(values, f"{what}s"):
        raise InputError(f"complex: {what}s is {with_part(values, f'{what}s')}, expected (count, {size}) integers")
    try:
        array: NDArray[Any] = np.asarray(values)
    except ValueError as error:
        raise InputError(f"complex: {what}s are rows of different lengths, expected (count, {size})") from error
    if array.shape in ((0,), (0, size)):
        return np.empty((0, size), np.int32)
    if array.ndim != 2 or array.shape[1] != size:
        hint = "; build_cells takes polygons" if what == "face" and array.ndim == 2 and 3 < array.shape[1] < 10 else ""
        raise InputError(f"complex: {what}s have shape {array.shape}, expected (count, {size}){hint}")
    if array.dtype.kind not in "iu":
        raise InputError(f"complex: {what}s are {array.dtype}, expected integers")
    if array.dtype == np.int32:
        return np.ascontiguousarray(array)
    if array.dtype == np.uint64:
        array = np.minimum(array, np.uint64(2**62))  # beyond any n, and no sign bit
    return np.ascontiguousarray(array.astype(np.int64))


def _refuse(simplices: IntArray, bad: int, n: int, what: str) -> None:
    if bad >= 0:
        row, hint = simplices[bad].tolist(), ""
        if simplices.min() == 1 and simplices.max() == n:
            hint = f": they look counted from 1, so give {what}s - 1"
        raise InputError(f"complex: {what} {bad} is {row}, expected distinct vertices in 0..{n - 1}{hint}")


def checked_pairs(edges: ArrayLike | None, n: int) -> Index:
    """Return edges as pairs i < j, or raise `InputError`.

    Parameters
    ----------
    edges : (M, 2) integers or None
        Vertex pairs in any order; None is no edge.
    n : int
        Number of vertices.

    Returns
    -------
    (M, 2) int32
    """
    pairs = _simplices([] if edges is None else edges, 2, "edge")
    low, high = pairs.min(axis=1), pairs.max(axis=1)
    bad = np.flatnonzero((low < 0) | (high >= n) | (low == high))
    _refuse(pairs, int(bad[0]) if len(bad) else -1, n, "edge")
    return np.stack([low, high], axis=1).astype(np.int32)


def check_product(edges: Index, what: str) -> None:
    """Refuse the matrix of all pairs of edges that meet in a vertex where it would take over 4 GiB.

    Parameters
    ----------
    edges : (E, 2) int32
        Vertex pairs.
    what : str
        What to call the matrix in the error.
    """
    pairs = int((np.bincount(edges.ravel()).astype(np.float64) ** 2).sum())
    if 12 * pairs > LARGEST_PRODUCT:
        most = int(np.bincount(edges.ravel()).argmax())
        size = f"{12 * pairs / 2**30:.0f} GiB, since so many edges meet in vertex {most}"
        raise InputError(f"complex: {what} takes {size}; expected at most 4")


def first_of_equals(table: NDArray[Any]) -> NDArray[np.int64]:
    """Rows of a table that equal no earlier row, ascending.

    Parameters
    ----------
    table : (N, k) integers
        The rows.

    Returns
    -------
    (K,) int64
    """
    order = np.lexsort(table.T[::-1])
    ordered = table[order]
    is_new = np.ones(len(table), bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return np.sort(order[is_new])  # the sort is stable: the first of a run is the earliest row


def _incidence(boundary: Boundary, rows: int) -> csr_array:
    """Sparse (rows, count) matrix of the boundaries."""
    from scipy.sparse import csc_array

    start, rim, sign = boundary
    return csc_array((sign, rim, start), shape=(rows, len(start) - 1)).tocsr()


def _pattern(rows: Rows, columns: int) -> csr_array:
    from scipy.sparse import csr_array

    from ._memory import empty

    ones = empty(len(rows.indices), np.int8)
    ones[:] = 1
    return csr_array((ones, rows.indices, rows.indptr), shape=(len(rows.indptr) - 1, columns))
