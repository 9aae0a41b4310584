"""Compiled loops that make triangles a manifold with a border."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel
from ..topology._stars import face_neighbours


@kernel
def limit_edges(faces, n):  # type: ignore[no-untyped-def]
    """Whether each face stays, taken in order, if a side may have one face in each direction: so they turn alike."""
    count = faces.shape[0]
    head = np.full(n, -1, np.int64)  # of the list of sides of each smaller vertex
    after, other, used = np.empty(3 * count, np.int64), np.empty(3 * count, np.int64), np.zeros(3 * count, np.int8)
    keep = np.zeros(count, np.bool_)
    sides, ways = np.empty(3, np.int64), np.empty(3, np.int8)
    size = 0
    for f in range(count):
        good = True
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            ways[k] = 1 if a < b else 2
            if a > b:
                a, b = b, a
            s = head[a]
            while s >= 0 and other[s] != b:
                s = after[s]
            if s < 0:
                s, size = size, size + 1
                other[s], after[s], head[a] = b, head[a], s
            sides[k] = s
            if used[s] & ways[k]:
                good = False
        if good:
            for k in range(3):
                used[sides[k]] |= ways[k]
        keep[f] = good
    return keep


@kernel
def largest_fans(faces, n):  # type: ignore[no-untyped-def]
    """Whether each face stays if, vertex after vertex, the largest fan does; of equal ones, that of the first face.

    What goes at a vertex may split the fan of an earlier one: call again until all stay.
    """
    count = faces.shape[0]
    start, around = face_neighbours(n, faces)
    keep = np.ones(count, np.bool_)
    here, label, sizes = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count, np.int64)
    for v in range(n):
        size = 0  # of the star of v, without what went at an earlier vertex: in a ring of corners not all go
        for r in range(start[v], start[v + 1]):
            if keep[around[r]]:
                here[size], label[size] = around[r], size
                size += 1
        changed = True
        while changed:
            changed = False
            for r in range(size):
                for q in range(r + 1, size):
                    if label[r] != label[q] and _meet(faces, here[r], here[q], v):
                        low = min(label[r], label[q])
                        label[r], label[q] = low, low
                        changed = True
        sizes[:size] = 0
        for r in range(size):
            sizes[label[r]] += 1
        best = 0
        for r in range(size):
            if sizes[r] > sizes[best]:
                best = r
        for r in range(size):
            if label[r] != best:
                keep[here[r]] = False
    return keep


@inlined
def _meet(faces, f, g, v):  # type: ignore[no-untyped-def]
    """Whether two faces at vertex v share another vertex."""
    found = False
    for i in range(3):
        for j in range(3):
            found = found or (faces[f, i] == faces[g, j] and faces[f, i] != v)
    return found
