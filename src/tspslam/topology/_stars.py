"""Compiled kernels of the one-ring neighbourhoods: what meets a vertex is spread over buckets, then set in rows.

Buckets are those of `_kernels`. Below, rows of one level alone, and of polygons.
"""

from __future__ import annotations

import numpy as np

from .._jit import kernel


@kernel
def mark_edges(face_edges, has_face):  # type: ignore[no-untyped-def]
    """Mark the edges that have a face."""
    for f in range(face_edges.shape[0]):
        for side in range(3):
            has_face[face_edges[f, side]] = True


@kernel
def count_edges(edges, has_face, shift, counts, lengths):  # type: ignore[no-untyped-def]
    """Add edges to `counts` by the bucket of the larger end, and what they add to rows to `lengths` by bucket."""
    for e in range(edges.shape[0]):
        length = 2 if has_face[e] else 1
        counts[edges[e, 1] >> shift] += 1
        lengths[edges[e, 0] >> shift] += length
        lengths[edges[e, 1] >> shift] += length


@kernel
def count_corners(faces, shift, counts):  # type: ignore[no-untyped-def]
    """Add the corners of faces to `counts` by bucket."""
    for f in range(faces.shape[0]):
        for side in range(3):
            counts[faces[f, side] >> shift] += 1


@kernel
def spread_edges(number, edges, has_face, shift, fill, out):  # type: ignore[no-untyped-def]
    """Append (larger end, smaller end, edge) to the bucket of the larger end; ``~edge`` if it has no face.

    `number` is that of the first edge.
    """
    for e in range(edges.shape[0]):
        j = edges[e, 1]
        p = fill[j >> shift]
        fill[j >> shift] = p + 1
        out[p, 0], out[p, 1], out[p, 2] = j, edges[e, 0], number + e if has_face[e] else ~(number + e)


@kernel
def spread_corners(number, faces, face_edges, shift, fill, out):  # type: ignore[no-untyped-def]
    """Append (vertex, face, opposite edge) of each corner to the bucket of its vertex; `number`: the first face's."""
    for f in range(faces.shape[0]):
        for side in range(3):
            v = faces[f, side]
            p = fill[v >> shift]
            fill[v >> shift] = p + 1
            out[p, 0], out[p, 1], out[p, 2] = v, number + f, face_edges[f, (side + 1) % 3]


@kernel
def fill_stars(buckets, shift, first, edges, has_face, above, corners, start, levels, rows):  # type: ignore[no-untyped-def]
    """Rows of the vertices, edges and faces around each vertex of the buckets.

    A row holds the neighbours, ascending; the edges at the vertex that have a face, ascending; the opposite edge of
    each of its faces; these faces. An opposite edge determines its face, so each edge comes once without a search.

    `first` holds the numbers from which vertices, edges and faces count, `above` and `corners` what was spread: where
    each bucket starts, then the records; `start` is given at the first vertex of each bucket and filled for the others;
    `levels` (n, 2) get where the edges of each row begin, and where its faces.
    """
    edge_starts, ends, lower = above
    corner_starts, opposite = corners
    size, n = 1 << shift, start.shape[0] - 1
    place, counts = np.empty((size, 4), np.int64), np.empty((size, 3), np.int32)
    for b in range(buckets[0], buckets[1]):
        base, stop = b << shift, min((b + 1) << shift, n)
        counts[: stop - base] = 0
        for e in range(lower[b], lower[b + 1]):
            counts[edges[e, 0] - base, 0] += 1
            counts[edges[e, 0] - base, 1] += has_face[e]
        for p in range(edge_starts[b], edge_starts[b + 1]):
            counts[ends[p, 0] - base, 0] += 1
            counts[ends[p, 0] - base, 1] += ends[p, 2] >= 0
        for p in range(corner_starts[b], corner_starts[b + 1]):
            counts[opposite[p, 0] - base, 2] += 1
        at = np.int64(start[base])
        for v in range(stop - base):
            place[v, 0], place[v, 1] = at, at + counts[v, 0]
            place[v, 2] = place[v, 1] + counts[v, 1]
            place[v, 3] = place[v, 2] + counts[v, 2]
            levels[base + v, 0], levels[base + v, 1] = place[v, 1], place[v, 3]
            at = place[v, 3] + counts[v, 2]
            if base + v + 1 < stop:
                start[base + v + 1] = at
        for p in range(edge_starts[b], edge_starts[b + 1]):
            v, e = ends[p, 0] - base, ends[p, 2]
            rows[place[v, 0]] = first[0] + ends[p, 1]
            place[v, 0] += 1
            if e >= 0:
                rows[place[v, 1]] = first[1] + e
                place[v, 1] += 1
        for e in range(lower[b], lower[b + 1]):
            v = edges[e, 0] - base
            rows[place[v, 0]] = first[0] + edges[e, 1]
            place[v, 0] += 1
            if has_face[e]:
                rows[place[v, 1]] = first[1] + e
                place[v, 1] += 1
        for p in range(corner_starts[b], corner_starts[b + 1]):
            v = opposite[p, 0] - base
            rows[place[v, 2]], rows[place[v, 3]] = first[1] + opposite[p, 2], first[2] + opposite[p, 1]
            place[v, 2] += 1
            place[v, 3] += 1


@kernel
def take_level(start, levels, rows, level, first, out_start, out):  # type: ignore[no-untyped-def]
    """Copy one level of the neighbourhoods, 0 to 2, counted from `first`."""
    count, out_start[0] = 0, 0
    for i in range(levels.shape[0]):
        begin = start[i] if level == 0 else levels[i, level - 1]
        stop = start[i + 1] if level == 2 else levels[i, level]
        for p in range(begin, stop):
            out[count] = rows[p] - first
            count += 1
        out_start[i + 1] = count


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
