"""Compiled kernels of the complex: incidences and one-ring neighbourhoods, each in one or two passes over the faces."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

_SHORT = 32  # entries that are sorted by insertion


@kernel
def sort_faces(faces, n, out):  # type: ignore[no-untyped-def]
    """Write each face ascending into `out`; return the first face that repeats or leaves 0..n-1, or -1."""
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        low, high = min(a, b, c), max(a, b, c)
        if low < 0 or high >= n or a == b or b == c or a == c:  # noqa: SIM109 - numba has no such tuple test
            return f
        out[f, 0], out[f, 1], out[f, 2] = low, a + b + c - low - high, high
    return -1


@inlined
def _insert_sorted(keys, slots, start, stop):  # type: ignore[no-untyped-def]
    for p in range(start + 1, stop):
        key, slot = keys[p], slots[p]
        q = p - 1
        while q >= start and keys[q] > key:
            keys[q + 1], slots[q + 1] = keys[q], slots[q]
            q -= 1
        keys[q + 1], slots[q + 1] = key, slot


@kernel
def _merge_sorted(keys, slots, start, stop):  # type: ignore[no-untyped-def]
    """Sort a large bucket, equal keys in their order: short runs, then pairs of runs.

    As NumPy's stable argsort does, which numba compiles for seconds.
    """
    for first in range(start, stop, _SHORT):
        _insert_sorted(keys, slots, first, min(first + _SHORT, stop))
    held_keys, held_slots = keys[start:stop].copy(), slots[start:stop].copy()
    run = _SHORT
    while run < stop - start:
        for first in range(start, stop, 2 * run):
            p, middle, q, last = first, min(first + run, stop), min(first + run, stop), min(first + 2 * run, stop)
            for r in range(first, last):
                if p < middle and (q >= last or keys[p] <= keys[q]):
                    held_keys[r - start], held_slots[r - start] = keys[p], slots[p]
                    p += 1
                else:
                    held_keys[r - start], held_slots[r - start] = keys[q], slots[q]
                    q += 1
        for r in range(start, stop):
            keys[r], slots[r] = held_keys[r - start], held_slots[r - start]
        run *= 2


@inlined
def _sort_bucket(keys, slots, start, stop):  # type: ignore[no-untyped-def]
    if stop - start <= _SHORT:
        _insert_sorted(keys, slots, start, stop)
    else:
        _merge_sorted(keys, slots, start, stop)


@kernel
def bucket_sides(faces, extra, n):  # type: ignore[no-untyped-def]
    """Sort all sides (and the extra edges) by smaller, then larger end.

    Returns the bucket starts (n + 1,), the larger ends, and each side's slot: 3·face + column, or -1.
    """
    start = np.zeros(n + 1, np.int32)
    for f in range(faces.shape[0]):
        start[faces[f, 0] + 1] += 2
        start[faces[f, 1] + 1] += 1
    for e in range(extra.shape[0]):
        start[extra[e, 0] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    ends = np.empty(start[n], np.int32)
    slots = np.empty(start[n], np.int32)
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        p = fill[i]
        ends[p], slots[p] = j, 3 * f
        ends[p + 1], slots[p + 1] = k, 3 * f + 2
        fill[i] = p + 2
        p = fill[j]
        ends[p], slots[p] = k, 3 * f + 1
        fill[j] = p + 1
    for e in range(extra.shape[0]):
        p = fill[extra[e, 0]]
        ends[p], slots[p] = extra[e, 1], -1
        fill[extra[e, 0]] = p + 1
    for i in range(n):
        _sort_bucket(ends, slots, start[i], start[i + 1])
    return start, ends, slots


@kernel
def number_edges(start, ends, slots, edges, face_edges):  # type: ignore[no-untyped-def]
    """Number the distinct sides in lexicographic order; fill `edges` and `face_edges`; return how many there are."""
    count = 0
    for i in range(start.shape[0] - 1):
        last = -1
        for p in range(start[i], start[i + 1]):
            if ends[p] != last:
                last = ends[p]
                edges[count, 0], edges[count, 1] = i, last
                count += 1
            if slots[p] >= 0:
                face_edges[slots[p] // 3, slots[p] % 3] = count - 1
    return count


@kernel
def may_repeat_faces(faces, start, ends, slots):  # type: ignore[no-untyped-def]
    """Whether two faces share their first side and their third vertex (or too many share a side to tell quickly)."""
    for i in range(start.shape[0] - 1):
        for p in range(start[i], start[i + 1]):
            if slots[p] < 0 or slots[p] % 3 != 0:
                continue
            q = p + 1
            while q < start[i + 1] and ends[q] == ends[p]:
                if slots[q] >= 0 and slots[q] % 3 == 0 and faces[slots[q] // 3, 2] == faces[slots[p] // 3, 2]:
                    return True
                if q - p > 32:
                    return True
                q += 1
    return False


@kernel
def vertex_neighbours(n, edges):  # type: ignore[no-untyped-def]
    """CSR rows of adjacent vertices, ascending."""
    start = np.zeros(n + 1, np.int32)
    for e in range(edges.shape[0]):
        start[edges[e, 0] + 1] += 1
        start[edges[e, 1] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    vertices = np.empty(2 * edges.shape[0], np.int32)
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        vertices[fill[i]] = j
        fill[i] += 1
        vertices[fill[j]] = i
        fill[j] += 1
    return start, vertices


@kernel
def face_neighbours(n, faces):  # type: ignore[no-untyped-def]
    """CSR rows of the faces that contain each vertex, ascending."""
    start = np.zeros(n + 1, np.int32)
    for f in range(faces.shape[0]):
        for side in range(3):
            start[faces[f, side] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    rows = np.empty(3 * faces.shape[0], np.int32)
    for f in range(faces.shape[0]):
        for side in range(3):
            i = faces[f, side]
            rows[fill[i]] = f
            fill[i] += 1
    return start, rows


@kernel
def edge_neighbours(n, edges, faces, face_edges):  # type: ignore[no-untyped-def]
    """CSR rows of all the edges of the faces that contain each vertex.

    First the edges at the vertex that have a face, ascending, then the opposite edge of each of its faces: an opposite
    edge determines its face, so each edge comes once without a search.
    """
    has_face = np.zeros(edges.shape[0], np.bool_)
    start = np.zeros(n + 1, np.int32)
    for f in range(faces.shape[0]):
        for side in range(3):
            has_face[face_edges[f, side]] = True
            start[faces[f, side] + 1] += 1
    for e in range(edges.shape[0]):
        if has_face[e]:
            start[edges[e, 0] + 1] += 1
            start[edges[e, 1] + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    rows = np.empty(start[n], np.int32)
    for e in range(edges.shape[0]):
        if has_face[e]:
            for side in range(2):
                i = edges[e, side]
                rows[fill[i]] = e
                fill[i] += 1
    for f in range(faces.shape[0]):
        for side in range(3):
            i = faces[f, side]
            rows[fill[i]] = face_edges[f, (side + 1) % 3]
            fill[i] += 1
    return start, rows


@kernel
def join_rows(vertices, edges, faces, first):  # type: ignore[no-untyped-def]
    """Concatenate three CSR patterns row by row, each level's indices counted from its own first."""
    start = np.empty(vertices[0].shape[0], np.int32)
    for i in range(start.shape[0]):
        start[i] = vertices[0][i] + edges[0][i] + faces[0][i]
    rows = np.empty(start[-1], np.int32)
    stop = 0
    for i in range(start.shape[0] - 1):
        for p in range(vertices[0][i], vertices[0][i + 1]):
            rows[stop] = first[0] + vertices[1][p]
            stop += 1
        for p in range(edges[0][i], edges[0][i + 1]):
            rows[stop] = first[1] + edges[1][p]
            stop += 1
        for p in range(faces[0][i], faces[0][i + 1]):
            rows[stop] = first[2] + faces[1][p]
            stop += 1
    return start, rows
