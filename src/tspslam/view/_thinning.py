"""A surface thinned for a page: vertices in one cell of a grid become one, so that what was connected stays so."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..types import BoolArray, FloatArray

MOST_FACES = 60_000  # a page of 2 MB, and 30 pictures a second with the graphics of a laptop
STEPS_AN_OCTAVE = 8  # the sides of cells that are tried: 9 % apart
OCTAVES = 20  # the smallest is a millionth of the whole
Rows = NDArray[np.int64]


class Kept(NamedTuple):
    """What is left of a complex: rows of the whole, ascending, and corners and ends numbered within `vertices`.

    Attributes
    ----------
    vertices : (n,) int64
        Rows.
    faces, edges : (f,) int64, (e,) int64
        Rows.
    corners, ends : (f, 3) int64, (e, 2) int64
        Into `vertices`.
    cell : float
        Side of the grid's cells, m; 0 where nothing was merged.
    """

    vertices: Rows
    faces: Rows
    corners: Rows
    edges: Rows
    ends: Rows
    cell: float

    def fits(self, most: int) -> bool:
        """Whether a page shows it well."""
        return len(self.faces) <= most and len(self.vertices) <= most and len(self.edges) <= 2 * most


def kept(xyz: FloatArray, faces: NDArray[Any], edges: NDArray[Any], keep: BoolArray, most: int = MOST_FACES) -> Kept:
    """Keep the elements all of whose vertices are kept; of more than `most` faces, merge vertices until these fit.

    All vertices in a cell become that one of them which is nearest to their mean: no vertex moves farther than a
    cell's diagonal, and all that stays is a part of the complex itself, with its own values. Of faces that fall
    together the largest stays, of edges the longest; faces and edges within a cell vanish. Vertices that were
    connected still are.
    """
    vertices, face_rows, edge_rows = (
        np.flatnonzero(x) for x in (keep, keep[faces].all(axis=1), keep[edges].all(axis=1))
    )
    number = np.cumsum(keep) - 1
    whole = Kept(vertices, face_rows, number[faces[face_rows]], edge_rows, number[edges[edge_rows]], 0.0)
    if whole.fits(most):
        return whole
    low, high = xyz[vertices].min(axis=0), xyz[vertices].max(axis=0)
    places, size = xyz[vertices] - low, max(float((high - low).max()), 1e-9) * (1 + 1e-9)
    coarse, fine = 0, STEPS_AN_OCTAVE * OCTAVES  # a single cell always fits
    while fine - coarse > 1:
        middle = (coarse + fine) // 2
        group, count = _cells(places, _side(size, middle))
        is_enough = (
            count <= most
            and len(np.unique(_keys(group[whole.corners], count)[1])) <= most
            and len(np.unique(_keys(group[whole.ends], count)[1])) <= 2 * most
        )
        coarse, fine = (middle, fine) if is_enough else (coarse, middle)
    return _merged(whole, places, _side(size, coarse))


def _side(size: float, step: int) -> float:
    return float(size * 2 ** (-step / STEPS_AN_OCTAVE))


def _merged(whole: Kept, places: FloatArray, cell: float) -> Kept:
    """Merge the vertices of each cell."""
    group, _ = _cells(places, cell)
    chosen = _middles(places, group)
    order = np.argsort(chosen)  # rows ascend
    rank = np.empty(len(chosen), np.int64)
    rank[order] = np.arange(len(chosen))
    group, chosen = rank[group], chosen[order]
    corners, ends = group[whole.corners], group[whole.ends]
    a, b, c = (places[whole.corners[:, k]] for k in range(3))
    faces = _distinct(corners, np.linalg.norm(np.cross(b - a, c - a), axis=1), len(chosen))
    long = np.linalg.norm(places[whole.ends[:, 0]] - places[whole.ends[:, 1]], axis=1)
    edges = _distinct(ends, long, len(chosen))
    return Kept(whole.vertices[chosen], whole.faces[faces], corners[faces], whole.edges[edges], ends[edges], cell)


def _cells(places: FloatArray, cell: float) -> tuple[Rows, int]:
    """Number the cells in which there are places; which each is in, (n,), and how many there are."""
    at = np.floor(places / cell).astype(np.int64)
    wide = at.max(axis=0) + 1
    found, group = np.unique((at[:, 0] * wide[1] + at[:, 1]) * wide[2] + at[:, 2], return_inverse=True)
    return group, len(found)


def _keys(corners: Rows, n: int) -> tuple[Rows, Rows]:
    """Rows of simplices whose corners differ, and a number for each that those with the same corners share."""
    ordered = np.sort(corners, axis=1)
    rows = np.flatnonzero((np.diff(ordered, axis=1) > 0).all(axis=1))
    key = np.zeros(len(rows), np.int64)
    for column in ordered[rows].T:
        key = key * n + column
    return rows, key


def _middles(places: FloatArray, group: Rows) -> Rows:
    """Choose the vertex of each group that is nearest to its mean, (groups,); of equal ones the first."""
    count = np.bincount(group)
    mean = np.stack([np.bincount(group, axis) for axis in places.T], axis=1) / count[:, None]
    distance = np.linalg.norm(places - mean[group], axis=1)
    order = np.lexsort((distance, group))
    return order[np.cumsum(count) - count]


def _distinct(corners: Rows, size: FloatArray, n: int) -> Rows:
    """Rows, ascending, of simplices whose corners differ, the largest of those with the same corners."""
    rows, key = _keys(corners, n)
    order = np.lexsort((rows, -size[rows]))
    return np.sort(rows[order][np.unique(key[order], return_index=True)[1]])
