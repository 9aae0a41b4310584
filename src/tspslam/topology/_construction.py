"""A complex from its faces, and what is around each vertex: sorted bucket by bucket, large ones by two threads.

Each pass goes over the input and appends to buckets of vertices, then works on one bucket at a time, which fits in the
cache: time grows little more than the input, in whatever order the vertices come. The order of what is appended does
not depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._threads import both
from ..types import BoolArray, IntArray
from . import _kernels, _stars
from ._locality import FEW
from ._memory import empty

Index = NDArray[np.int32]

_SHIFT = 11  # log2 of the vertices in a bucket: their 24 neighbours each, twice, fit in a core's cache
_MOST_BUCKETS = 10  # log2: a place in memory for each is near while they are filled


def sort_faces(triples: IntArray, n: int) -> tuple[Index, list[NDArray[np.int64]], int]:
    """Faces with ascending vertices, how many sides each part has in each bucket, and the first face that is bad or -1.

    Parameters
    ----------
    triples : (F, 3) int32 or int64
        Vertices in any order.
    n : int
        Number of vertices.

    Returns
    -------
    ascending : (F, 3) int32
    counts : list of (B,) int64
        One for each part of the faces.
    bad : int
    """
    shift, buckets = _grid(n)
    ascending, parts = empty(triples.shape, np.int32), _parts(len(triples))
    counts = [np.zeros(buckets, np.int64) for _ in parts]

    def sort(k: int) -> int:
        bad = _kernels.sort_faces(triples[parts[k]], n, shift, ascending[parts[k]], counts[k])
        return parts[k].start + bad if bad >= 0 else -1

    return ascending, counts, next((bad for bad in _at_once(sort, len(parts)) if bad >= 0), -1)


def number_edges(
    n: int, faces: Index, counts: list[NDArray[np.int64]], extra: Index
) -> tuple[Index, Index, bool]:  # fmt: skip
    """Edges in lexicographic order and those of each face, and whether faces may be repeated.

    Parameters
    ----------
    n : int
        Number of vertices.
    faces, counts
        As `sort_faces` gives them.
    extra : (M, 2) int32
        Edges that stand alone, i < j.

    Returns
    -------
    edges : (E, 2) int32
    face_edges : (F, 3) int32
    may_repeat : bool
    """
    shift, buckets = _grid(n)
    parts, alone = _parts(len(faces)), np.bincount(extra[:, 0] >> shift, minlength=buckets)
    starts, fills = _places([*counts, alone])
    sides, ranks = empty((int(starts[-1]), 3), np.int32), empty(int(starts[-1]), np.int32)
    _at_once(lambda k: _kernels.spread_faces(faces[parts[k]], shift, fills[k].copy(), sides), len(parts))
    _kernels.spread_edges(extra, shift, fills[-1].copy(), sides)
    ranges, distinct = _ranges(starts), np.zeros(buckets, np.int64)
    repeated = _at_once(
        lambda k: _kernels.number_sides(ranges[k], n, starts, shift, sides, ranks, distinct), len(ranges)
    )
    first = np.concatenate([[0], np.cumsum(distinct)])
    edges, face_edges = empty((int(first[-1]), 2), np.int32), empty(faces.shape, np.int32)
    _at_once(lambda k: _kernels.take_edges(ranges[k], starts, sides, first, edges), len(ranges))
    _at_once(
        lambda k: _kernels.number_faces(faces[parts[k]], shift, fills[k], ranks, first, face_edges[parts[k]]),
        len(parts),
    )
    return edges, face_edges, any(repeated)


def find_stars(
    n: int, edges: Index, has_face: BoolArray, faces: Index, face_edges: Index
) -> tuple[Index, Index, Index]:
    """CSR rows of the vertices, edges and faces around each vertex, as `_stars.fill_stars` orders them.

    Parameters
    ----------
    n : int
        Number of vertices.
    edges : (E, 2) int32
        In lexicographic order.
    has_face : (E,) bool
        Whether each has a face.
    faces, face_edges : (F, 3) int32
        Vertices and edges of the faces.

    Returns
    -------
    start : (n + 1,) int32
    rows : (start[n],) int32
        Edges counted from n on, faces from n + E on.
    levels : (n, 2) int32
        Where the edges of each row begin, and where its faces do.
    """
    shift, buckets = _grid(n)
    first = (0, n, n + len(edges))
    lower = np.searchsorted(edges[:, 0], np.arange(buckets + 1, dtype=np.int64) << shift)
    (above, lengths), corners = (
        _spread_edges(edges, has_face, shift, buckets),
        _spread_corners(faces, face_edges, shift, buckets),
    )
    begin = np.concatenate([[0], np.cumsum(lengths + 2 * np.diff(corners[0]))])
    start, rows, levels = empty(n + 1, np.int32), empty(int(begin[-1]), np.int32), empty((n, 2), np.int32)
    start[np.arange(buckets, dtype=np.int64) << shift], start[n] = begin[:-1], begin[-1]
    ranges, around = _ranges(begin), (*above, lower)
    _at_once(
        lambda k: _stars.fill_stars(ranges[k], shift, first, edges, has_face, around, corners, start, levels, rows),
        len(ranges),
    )
    return start, rows, levels


def _spread_edges(
    edges: Index, has_face: BoolArray, shift: int, buckets: int
) -> tuple[tuple[NDArray[np.int64], Index], NDArray[np.int64]]:
    """Edges by the bucket of their larger ends, and how long all rows of a bucket are without its corners."""
    parts = _parts(len(edges))
    counts, lengths = ([np.zeros(buckets, np.int64) for _ in parts] for _ in range(2))
    _at_once(
        lambda k: _stars.count_edges(edges[parts[k]], has_face[parts[k]], shift, counts[k], lengths[k]), len(parts)
    )
    starts, fills = _places(counts)
    out = empty((int(starts[-1]), 3), np.int32)
    _at_once(
        lambda k: _stars.spread_edges(
            parts[k].start, edges[parts[k]], has_face[parts[k]], shift, fills[k], out
        ),
        len(parts),
    )  # fmt: skip
    return (starts, out), sum(lengths[1:], lengths[0])


def _spread_corners(faces: Index, face_edges: Index, shift: int, buckets: int) -> tuple[NDArray[np.int64], Index]:
    """Corners of the faces by the bucket of their vertices."""
    parts = _parts(len(faces))
    counts = [np.zeros(buckets, np.int64) for _ in parts]
    _at_once(lambda k: _stars.count_corners(faces[parts[k]], shift, counts[k]), len(parts))
    starts, fills = _places(counts)
    out = empty((int(starts[-1]), 3), np.int32)
    _at_once(
        lambda k: _stars.spread_corners(
            parts[k].start, faces[parts[k]], face_edges[parts[k]], shift, fills[k], out
        ),
        len(parts),
    )  # fmt: skip
    return starts, out


def _grid(n: int) -> tuple[int, int]:
    """log2 of the vertices in a bucket, and the number of buckets, at least one."""
    shift = max(_SHIFT, n.bit_length() - _MOST_BUCKETS)
    return shift, max(-(-n >> shift), 1)


def _parts(count: int) -> list[slice]:
    """One part of rows if there are few, else two."""
    middle = count // 2
    return [slice(0, count)] if count <= FEW else [slice(0, middle), slice(middle, count)]


def _places(counts: list[NDArray[np.int64]]) -> tuple[NDArray[np.int64], list[NDArray[np.int64]]]:
    """Where each bucket starts (B + 1,), and where each part of the input begins to fill each bucket."""
    stops = np.cumsum(np.stack(counts, axis=1).ravel())
    places = np.concatenate([[0], stops]).astype(np.int64)
    begins = places[:-1].reshape(-1, len(counts))
    return np.append(begins[:, 0], places[-1]), [np.ascontiguousarray(column) for column in begins.T]


def _ranges(starts: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Buckets in one range, or in two of about the same length."""
    buckets = len(starts) - 1
    if starts[-1] <= FEW:
        return [(0, buckets)]
    middle = int(np.searchsorted(starts, starts[-1] // 2))
    return [(0, middle), (middle, buckets)]


def _at_once(function: Callable[[int], Any], count: int) -> list[Any]:
    """Results for 0 to count - 1, which is 1 or 2."""
    return [function(0)] if count == 1 else list(both(function, (0, 1)))
