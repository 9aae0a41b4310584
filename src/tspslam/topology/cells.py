"""Cell complexes: polygons in the place of triangles, from faces that are merged or as they are given."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import Brief
from .._checks import refuse_path, require, with_part
from ..errors import InputError
from ..types import FloatArray, Signals
from .complex import Boundary, Complex, Index, Rows, checked_count, checked_pairs, largest


@dataclass(frozen=True, repr=False)
class Polygons(Brief):
    """Rows of different lengths: ``len(polygons)``, ``polygons[k]`` and iteration give single ones.

    Attributes
    ----------
    start : (F + 1,) int32
        Where each row begins in `items`.
    items : (L,) int32
        All rows, one after another.
    """

    start: Index
    items: Index

    def __len__(self) -> int:
        return len(self.start) - 1

    def __getitem__(self, k: int) -> Index:
        if not -len(self) <= k < len(self):
            raise IndexError(f"polygon {k} of {len(self)}")
        k %= len(self)
        return self.items[self.start[k] : self.start[k + 1]]

    def __iter__(self) -> Iterator[Index]:
        return (self[k] for k in range(len(self)))


@dataclass(frozen=True, repr=False)
class CellComplex(Complex):
    """A complex whose faces are polygons. Build it with `merge_cells` or `build_cells`.

    It has all that a `Complex` has, and goes where that goes: `tmahf`, `hodge_decompose`, `smooth_signals`, spectra.

    Attributes
    ----------
    n, edges
        As `Complex`. Vertices without an edge stay, so that positions and signals keep their rows.
    faces : Polygons
        Vertex cycles, from the smallest vertex towards its smaller neighbour.
    face_edges : Polygons
        The edges along each cycle; ``B2`` has +1 where the cycle runs from the smaller to the larger end, else -1.
    """

    faces: Polygons  # type: ignore[assignment]
    face_edges: Polygons  # type: ignore[assignment]

    @cached_property
    def boundary(self) -> Boundary:
        """The edges around each cell and their signs: the columns of ``B2``."""
        sign = np.where(self.faces.items < _following(self.faces.start, self.faces.items), 1, -1).astype(np.int8)
        return Boundary(self.face_edges.start, self.face_edges.items, sign)

    @cached_property
    def vertex_rows(self) -> Rows:
        """η_p as a CSR pattern."""
        from . import _stars

        return Rows(*_stars.vertex_neighbours(self.n, self.edges))

    @cached_property
    def face_rows(self) -> Rows:
        """η_f as a CSR pattern."""
        from . import _cells

        return Rows(*_cells.cells_at_vertices(self.n, self.faces.start, self.faces.items))

    @cached_property
    def edge_rows(self) -> Rows:
        """η_e as a CSR pattern."""
        from . import _cells

        return Rows(*_cells.edges_of_cells_at_vertices(self.face_rows, self.boundary[:2], len(self.edges)))

    @cached_property
    def around(self) -> tuple[Index, Index, Index]:
        """The two arrays of the stars, and where the edges and the faces of each begin, (n, 2)."""
        from . import _stars

        first = (0, self.n, self.n + len(self.edges))
        rows = tuple(self.vertex_rows), tuple(self.edge_rows), tuple(self.face_rows)  # of one type with those of others
        start, joined = _stars.join_rows(*rows, first)
        begins = start[:-1] + np.diff(self.vertex_rows.indptr), start[1:] - np.diff(self.face_rows.indptr)
        return start, joined, np.stack(begins, axis=1)

    def _level(self, level: int) -> Rows:
        start, rows = (self.vertex_rows, self.edge_rows, self.face_rows)[level]
        return Rows(start.copy(), rows.copy())


def build_cells(cells: Sequence[ArrayLike], n: int | None = None, edges: ArrayLike | None = None) -> CellComplex:
    """Build a cell complex from polygons and, if given, edges that stand without a face.

    Parameters
    ----------
    cells : sequence of (k,) integers
        Vertex cycles, k >= 3, in either direction and from any vertex.
    n : int, optional
        Number of vertices; without it one more than the largest that is named.
    edges : (M, 2) integers, optional
        Further edges.

    Returns
    -------
    CellComplex
        With B1 B2 = 0.

    Raises
    ------
    InputError
        If a cell is no cycle of distinct vertices in ``0..n-1``, or an edge is none.

    Examples
    --------
    >>> house = build_cells([[0, 1, 2, 3], [2, 3, 4]], 5)
    >>> len(house.edges), len(house.faces), house.euler
    (6, 2, 1)
    """
    from . import _cells

    refuse_path(cells, "cells", "rows of vertices", "tspslam.io.read_mesh(path)")
    if not isinstance(cells, Iterable):
        raise InputError(f"cells is {with_part(cells, 'faces')}, expected rows of vertices")
    rows = [_checked_cycle(k, cell) for k, cell in enumerate(cells)]
    start = np.concatenate([[0], np.cumsum([len(row) for row in rows], dtype=np.int64)]).astype(np.int32)
    items = np.concatenate([np.empty(0, np.int64), *rows])
    n = largest(items, edges) if n is None else checked_count(n)
    bad = _cells.bad_cycle(start, items, n)
    if bad >= 0:
        found = rows[bad].tolist()
        raise InputError(f"cells: cell {bad} is {found}, expected a cycle of 3 or more distinct vertices in 0..{n - 1}")
    cycles = items.astype(np.int32)
    _cells.turn_cycles(start, cycles)
    return _assemble(n, Polygons(start, cycles), checked_pairs(edges, n))


def grow_labels(complex_: Complex, size: int) -> NDArray[np.int64]:
    """Labels for `merge_cells`: discs of up to `size` neighbouring faces, grown one after another.

    Parameters
    ----------
    complex_ : Complex
        Triangles.
    size : int
        Faces of a cell at most, >= 1.

    Returns
    -------
    (F,) int64
        Labels from 0.

    Raises
    ------
    InputError
        If the complex has cells already, or the size is no positive integer.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> grow_labels(build_complex([[0, 1, 2], [0, 2, 3], [0, 3, 4]], 5), 2).tolist()
    [0, 0, 1]
    """
    from . import _cells, _homology

    if isinstance(complex_, CellComplex):
        raise InputError("cells: the complex has cells already, expected one of triangles")
    if isinstance(size, bool) or not isinstance(size, int | np.integer) or size < 1:
        raise InputError(f"cells: size is {size!r}, expected a positive integer")
    require(complex_, Complex, "complex_")
    start, rim, _ = complex_.boundary
    labels = np.empty(len(complex_.faces), np.int64)
    at_edges = _homology.sides_of_edges(start, rim, len(complex_.edges))
    _cells.grow_discs(complex_.faces, complex_.face_edges, *at_edges, size, labels)
    return labels


def merge_cells(complex_: Complex, labels: ArrayLike) -> CellComplex:
    """Join the faces of one label into one cell; edges inside a cell vanish, the others keep their order.

    Parameters
    ----------
    complex_ : Complex
        Triangles.
    labels : (F,) integers
        Cells come in ascending order of their labels.

    Returns
    -------
    CellComplex
        With B1 B2 = 0, as many vertices as before; those inside a cell stand alone.

    Raises
    ------
    InputError
        If the labels do not fit, or the faces of a label are no disc: their rim is not one cycle.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> square = build_complex([[0, 1, 2], [0, 2, 3]], 4)
    >>> merged = merge_cells(square, [7, 7])
    >>> merged.faces[0].tolist(), merged.edges.tolist()
    ([0, 1, 2, 3], [[0, 1], [0, 3], [1, 2], [2, 3]])
    """
    traced = _trace(complex_, labels)
    number = np.cumsum(traced.is_kept, dtype=np.int32) - 1
    cycles, along = Polygons(traced.start, traced.cycles), Polygons(traced.start, number[traced.along])
    return CellComplex(complex_.n, complex_.edges[traced.is_kept], cycles, along)


class _Traced(NamedTuple):
    """Cell of each face, how many cells, their cycles, the old edges along these, and which edges are left."""

    cell_of: NDArray[np.int64]
    cells: int
    start: Index
    cycles: Index
    along: Index
    is_kept: NDArray[np.bool_]


def _trace(complex_: Complex, labels: ArrayLike) -> _Traced:
    from . import _cells

    cell_of, names = _cells_of(complex_, labels)
    members = np.argsort(cell_of, kind="stable")
    first = np.searchsorted(cell_of[members], np.arange(len(names) + 1))
    start, cycles = np.zeros(len(names) + 1, np.int32), np.empty(3 * len(cell_of), np.int32)
    along, is_kept = np.empty_like(cycles), np.zeros(len(complex_.edges), bool)
    triangles = (complex_.faces, complex_.face_edges, complex_.edges)
    bad, fault = _cells.trace_cycles((first, members), triangles, start, cycles, along, is_kept)
    if bad >= 0:
        what = "whose rim is not one cycle" if fault == _cells.NO_CYCLE else "that are no disc"
        raise InputError(f"cells: label {names[bad]} joins {first[bad + 1] - first[bad]} faces {what}, expected a disc")
    stands_alone = np.ones(len(complex_.edges), bool)
    stands_alone[complex_.face_edges] = False
    size = start[-1]
    return _Traced(cell_of, len(names), start, cycles[:size].copy(), along[:size].copy(), is_kept | stands_alone)


def merge_signals(complex_: Complex, labels: ArrayLike, signals: Signals) -> Signals:
    """Signals of the cells that `merge_cells` makes: a cell's is the mean over the pixels of its faces.

    Parameters
    ----------
    complex_ : Complex
        Triangles.
    labels : (F,) integers
        As `merge_cells`.
    signals : Signals
        On the triangles.

    Returns
    -------
    Signals
        Vertices as before, edges that are left, cells. Means and barycentres are weighted by the pixels of each face
        (pixels on a shared side count on both); a cell of which no face holds a pixel takes the plain mean. A cell
        with a marked face is marked.

    Raises
    ------
    InputError
        As `merge_cells`, or if the signals are not on the complex.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> square = build_complex([[0, 1, 2], [0, 2, 3]], 4)
    >>> signals = sample_signals(np.full((9, 9), 0.25), [[0, 0], [8, 0], [8, 8], [0, 8]], square)
    >>> merge_signals(square, [0, 0], signals).face.tolist()
    [0.25]
    """
    if not isinstance(signals, Signals):
        raise InputError(f"cells: signals is {type(signals).__name__}, expected a Signals after the labels")
    cell_of, count, _, _, _, kept = _trace(complex_, labels)
    if len(signals.face) != len(cell_of) or len(signals.edge) != len(complex_.edges):
        raise InputError(f"cells: signals are on {len(signals.face)} faces, expected those of {len(cell_of)} faces")
    pixels = np.bincount(cell_of, signals.face_pixels, count).astype(np.int32)
    weight = np.where(pixels[cell_of] > 0, signals.face_pixels, 1).astype(np.float64)
    ok = np.bincount(cell_of, ~signals.face_ok, count) == 0
    face, face_uv = (_means(values, weight, cell_of, ok) for values in (signals.face, signals.face_uv))
    return replace(
        signals, edge=signals.edge[kept], edge_uv=signals.edge_uv[kept], edge_pixels=signals.edge_pixels[kept],
        edge_ok=signals.edge_ok[kept], face=face, face_uv=face_uv, face_pixels=np.where(ok, pixels, 0), face_ok=ok,
    )  # fmt: skip


def _means(values: FloatArray, weight: FloatArray, cell_of: NDArray[np.int64], ok: NDArray[np.bool_]) -> FloatArray:
    """Weighted mean of each cell, (cells,) or (cells, C); 0 where there is none."""
    total = np.bincount(cell_of, weight, len(ok))
    columns = values.reshape(len(values), -1 if values.size else 0)
    sums = [np.bincount(cell_of, weight * columns[:, c], len(ok)) for c in range(columns.shape[1])]
    means = np.where(ok, sums / np.where(ok, total, 1), 0).T if sums else np.zeros((len(ok), 0))
    return np.ascontiguousarray(means.reshape(len(ok), *values.shape[1:]))


def _cells_of(complex_: Complex, labels: ArrayLike) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Cell of each face, counted from 0 in the order of their labels, and the labels."""
    require(complex_, Complex, "complex_")
    values: NDArray[Any] = np.asarray(labels)
    if isinstance(complex_, CellComplex):
        raise InputError("cells: the complex has cells already, expected one of triangles")
    if values.shape != (len(complex_.faces),) or (values.size and values.dtype.kind not in "iu"):
        wanted = f"({len(complex_.faces)},) integers"
        raise InputError(f"cells: labels are {values.dtype} of shape {values.shape}, expected {wanted}")
    if values.size and values.min() >= 0 and values.max() < 4 * len(values):
        is_used = np.bincount(values) > 0
        return (np.cumsum(is_used) - 1)[values], np.flatnonzero(is_used)
    names, cell_of = np.unique(values, return_inverse=True)
    return cell_of.astype(np.int64), names


def _assemble(n: int, cycles: Polygons, extra: Index) -> CellComplex:
    """Number the edges of the cycles, and the extra ones, in lexicographic order."""
    after = _following(cycles.start, cycles.items)
    sides = np.stack([np.minimum(cycles.items, after), np.maximum(cycles.items, after)], axis=1)
    keys = np.unique(_keys(np.concatenate([sides, extra]), n))
    edges = np.stack(np.divmod(keys, max(n, 1)), axis=1).astype(np.int32)
    along = np.searchsorted(keys, _keys(sides, n)).astype(np.int32)
    return CellComplex(n, edges, cycles, Polygons(cycles.start, along))


def _following(start: Index, items: Index) -> Index:
    """The next vertex along each cycle."""
    after = np.roll(items, -1)
    after[start[1:] - 1] = items[start[:-1]]
    return after


def _keys(pairs: Index, n: int) -> NDArray[np.int64]:
    return pairs[:, 0].astype(np.int64) * n + pairs[:, 1]


def _checked_cycle(k: int, cell: ArrayLike) -> NDArray[np.int64]:
    values: NDArray[Any] = np.asarray(cell)
    if values.ndim != 1 or values.dtype.kind not in "iu":
        raise InputError(f"cells: cell {k} is {values.dtype} of shape {values.shape}, expected a row of integers")
    return values.astype(np.int64)
