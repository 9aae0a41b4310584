"""Compiled kernels of the construction: sides are spread over buckets of vertices, and sorted within the cache.

A bucket is ``1 << shift`` vertices in a row. What a pass appends to the buckets goes to few places in memory at a time,
and a bucket is small enough to be worked on in the cache, in whatever order the vertices come.
"""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

_SHORT = 32  # keys that are sorted by insertion
_MOST_ALIKE = 32  # sides in one place that are still compared in pairs


@kernel
def sort_faces(faces, n, shift, out, counts):  # type: ignore[no-untyped-def]
    """Write each face ascending into `out` and add its sides to the `counts` of the buckets of their smaller ends.

    Returns the first face that repeats a vertex or leaves 0..n-1, or -1.
    """
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        low, high = min(a, b, c), max(a, b, c)
        if low < 0 or high >= n or a == b or b == c or a == c:  # noqa: SIM109 - numba has no such tuple test
            return f
        middle = a + b + c - low - high
        out[f, 0], out[f, 1], out[f, 2] = low, middle, high
        counts[low >> shift] += 2
        counts[middle >> shift] += 1
    return -1


@kernel
def spread_faces(faces, shift, fill, sides):  # type: ignore[no-untyped-def]
    """Append each face's sides (smaller end, larger end, third vertex) to the buckets of their smaller ends.

    Only the first side of a face tells its third vertex; the others say -1.
    """
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        p = fill[i >> shift]
        fill[i >> shift] = p + 2
        sides[p, 0], sides[p, 1], sides[p, 2] = i, j, k
        sides[p + 1, 0], sides[p + 1, 1], sides[p + 1, 2] = i, k, -1
        p = fill[j >> shift]
        fill[j >> shift] = p + 1
        sides[p, 0], sides[p, 1], sides[p, 2] = j, k, -1


@kernel
def spread_edges(edges, shift, fill, sides):  # type: ignore[no-untyped-def]
    """Append edges that stand alone, as sides without a third vertex."""
    for e in range(edges.shape[0]):
        p = fill[edges[e, 0] >> shift]
        fill[edges[e, 0] >> shift] = p + 1
        sides[p, 0], sides[p, 1], sides[p, 2] = edges[e, 0], edges[e, 1], -1


@inlined
def _insert_sorted(keys, start, stop):  # type: ignore[no-untyped-def]
    for p in range(start + 1, stop):
        key = keys[p]
        q = p - 1
        while q >= start and keys[q] > key:
            keys[q + 1] = keys[q]
            q -= 1
        keys[q + 1] = key


@kernel
def _merge_sorted(keys, start, stop):  # type: ignore[no-untyped-def]
    """Sort many keys: short runs, then pairs of runs; NumPy's own sort is one that numba compiles for seconds."""
    for first in range(start, stop, _SHORT):
        _insert_sorted(keys, first, min(first + _SHORT, stop))
    held = np.empty(stop - start, np.int64)
    run = _SHORT
    while run < stop - start:
        for first in range(start, stop, 2 * run):
            p, middle, q, last = first, min(first + run, stop), min(first + run, stop), min(first + 2 * run, stop)
            for r in range(first, last):
                if p < middle and (q >= last or keys[p] <= keys[q]):
                    held[r - start] = keys[p]
                    p += 1
                else:
                    held[r - start] = keys[q]
                    q += 1
        for r in range(start, stop):  # as an assignment of slices, it would take seconds to compile
            keys[r] = held[r - start]
        run *= 2


@inlined
def _sort_bucket(first, stop, base, begin, sides, keys):  # type: ignore[no-untyped-def]
    """Sort a bucket's sides to `keys`: larger end, then place in the bucket. Those of vertex v go up to begin[v]."""
    begin[:] = 0
    for p in range(first, stop):
        begin[sides[p, 0] - base + 1] += 1
    for v in range(begin.shape[0] - 1):
        begin[v + 1] += begin[v]
    for p in range(first, stop):
        v = sides[p, 0] - base
        keys[begin[v]] = np.int64(sides[p, 1]) << 32 | p - first
        begin[v] += 1
    start = np.int64(0)  # a literal would be one more type to compile `_merge_sorted` for
    for v in range(begin.shape[0] - 1):
        if begin[v] - start <= _SHORT:
            _insert_sorted(keys, start, begin[v])
        else:
            _merge_sorted(keys, start, begin[v])
        start = begin[v]


@inlined
def _is_repeated(keys, first, q, sides):  # type: ignore[no-untyped-def]
    """Whether the side of key q and one before it in the same place, from `first` on, are of equal faces.

    Also so if there are too many to tell quickly.
    """
    third = sides[keys[q] & 0xFFFFFFFF, 2]
    if third < 0:
        return False
    for r in range(first, min(q, first + _MOST_ALIKE)):
        if sides[keys[r] & 0xFFFFFFFF, 2] == third:
            return True
    return q - first > _MOST_ALIKE


@kernel
def number_sides(buckets, n, starts, shift, sides, ranks, distinct):  # type: ignore[no-untyped-def]
    """Number the distinct sides of each bucket in lexicographic order; return whether a face may be repeated.

    `ranks` get each side's number in its bucket, `distinct` how many there are; their ends replace the first rows of
    the bucket's `sides`.
    """
    longest = 0
    for b in range(buckets[0], buckets[1]):
        longest = max(longest, starts[b + 1] - starts[b])
    keys, ends = np.empty(longest, np.int64), np.empty((1 << shift) + 1, np.int32)
    repeats = False
    for b in range(buckets[0], buckets[1]):
        bucket, base = sides[starts[b] : starts[b + 1]], b << shift
        begin = ends[: min(1 << shift, n - base) + 1]
        _sort_bucket(starts[b], starts[b + 1], base, begin, sides, keys)
        count, q = 0, 0
        for v in range(begin.shape[0] - 1):
            last, first = -1, q
            while q < begin[v]:
                larger = keys[q] >> 32
                if larger != last:
                    last, first = larger, q
                    bucket[count, 0], bucket[count, 1] = base + v, larger
                    count += 1
                elif not repeats:
                    repeats = _is_repeated(keys, first, q, bucket)
                ranks[starts[b] + (keys[q] & 0xFFFFFFFF)] = count - 1
                q += 1
        distinct[b] = count
    return repeats


@kernel
def take_edges(buckets, starts, sides, first, edges):  # type: ignore[no-untyped-def]
    """Write the distinct sides of the buckets one after another; those of bucket b are edges from ``first[b]`` on."""
    for b in range(buckets[0], buckets[1]):
        for k in range(first[b + 1] - first[b]):
            edges[first[b] + k, 0], edges[first[b] + k, 1] = sides[starts[b] + k, 0], sides[starts[b] + k, 1]


@kernel
def number_faces(faces, shift, fill, ranks, first, face_edges):  # type: ignore[no-untyped-def]
    """Write the edges of each face: its sides stand in the buckets where `spread_faces` appended them."""
    for f in range(faces.shape[0]):
        b = faces[f, 0] >> shift
        face_edges[f, 0], face_edges[f, 2] = first[b] + ranks[fill[b]], first[b] + ranks[fill[b] + 1]
        fill[b] += 2
        b = faces[f, 1] >> shift
        face_edges[f, 1] = first[b] + ranks[fill[b]]
        fill[b] += 1
