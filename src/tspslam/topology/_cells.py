"""Compiled kernels of cell complexes: the cycle around merged faces, neighbourhoods over polygons."""

from __future__ import annotations

import numpy as np

from .._jit import kernel

NO_CYCLE, NO_DISC = -1, -2


@kernel
def trace_cycles(group, triangles, start, cycles, along, on_rim):  # type: ignore[no-untyped-def]
    """Cycles around groups of faces, from the smallest vertex towards its smaller neighbour.

    `group` holds the faces of each cell as CSR, `triangles` the faces, their edges and all edges; `start` (cells + 1,),
    `cycles`, the edges `along` them and, for each edge, whether it is `on_rim` are filled. Returns the first cell
    whose rim is no single cycle or which is no disc, and which of the two it is; (-1, 0) if there is none.
    """
    first, members = group
    faces, face_edges, edges = triangles
    in_cell, times = np.full(edges.shape[0], -1), np.zeros(edges.shape[0], np.int32)
    size = faces.max() + 1 if faces.shape[0] else 0
    seen, links = np.full(size, -1), np.zeros(size, np.int32)
    link, link_edge = np.zeros((size, 2), np.int32), np.zeros((size, 2), np.int32)
    start[0] = 0
    for c in range(first.shape[0] - 1):
        n_edges, n_vertices = 0, 0
        for p in range(first[c], first[c + 1]):
            for side in range(3):
                e, v = face_edges[members[p], side], faces[members[p], side]
                if in_cell[e] != c:
                    in_cell[e], times[e] = c, 0
                    n_edges += 1
                times[e] += 1
                if seen[v] != c:
                    seen[v], links[v] = c, 0
                    n_vertices += 1
        length, lowest = 0, -1
        for p in range(first[c], first[c + 1]):
            for side in range(3):
                e = face_edges[members[p], side]
                if times[e] != 1:
                    if times[e] > 2:
                        return c, NO_DISC
                    continue
                length += 1
                on_rim[e] = True
                for end in range(2):
                    v = edges[e, end]
                    if links[v] == 2:
                        return c, NO_CYCLE
                    link[v, links[v]], link_edge[v, links[v]] = edges[e, 1 - end], e
                    links[v] += 1
                    if lowest < 0 or v < lowest:
                        lowest = v
        if length == 0:
            return c, NO_CYCLE
        before, at = lowest, lowest
        for k in range(length):
            cycles[start[c] + k] = at
            second = link[at, 1] < link[at, 0] if k == 0 else link[at, 0] == before
            along[start[c] + k] = link_edge[at, int(second)]
            before, at = at, link[at, int(second)]
            if at == lowest and k + 1 < length:
                return c, NO_CYCLE
        if at != lowest:
            return c, NO_CYCLE
        if n_vertices - n_edges + first[c + 1] - first[c] != 1:
            return c, NO_DISC
        start[c + 1] = start[c] + length
    return -1, 0


@kernel
def bad_cycle(start, cycles, n):  # type: ignore[no-untyped-def]
    """The first cycle that is shorter than 3, repeats a vertex or leaves 0..n-1, or -1."""
    seen = np.full(n, -1)
    for c in range(start.shape[0] - 1):
        if start[c + 1] - start[c] < 3:
            return c
        for p in range(start[c], start[c + 1]):
            if not 0 <= cycles[p] < n or seen[cycles[p]] == c:
                return c
            seen[cycles[p]] = c
    return -1


@kernel
def turn_cycles(start, cycles):  # type: ignore[no-untyped-def]
    """Turn each cycle, in place, to start at its smallest vertex and go on to the smaller of its neighbours."""
    for c in range(start.shape[0] - 1):
        cycle = cycles[start[c] : start[c + 1]].copy()
        size, low = cycle.shape[0], np.argmin(cycle)
        step = 1 if cycle[(low + 1) % size] < cycle[low - 1] else -1
        for k in range(size):
            cycles[start[c] + k] = cycle[(low + step * k) % size]


@kernel
def cells_at_vertices(n, start, cycles):  # type: ignore[no-untyped-def]
    """CSR rows of the cells that contain each vertex, ascending."""
    first = np.zeros(n + 1, np.int32)
    for p in range(cycles.shape[0]):
        first[cycles[p] + 1] += 1
    for i in range(n):
        first[i + 1] += first[i]
    fill, rows = first[:-1].copy(), np.empty(cycles.shape[0], np.int32)
    for c in range(start.shape[0] - 1):
        for p in range(start[c], start[c + 1]):
            rows[fill[cycles[p]]] = c
            fill[cycles[p]] += 1
    return first, rows


@kernel
def edges_of_cells_at_vertices(cell_rows, boundary, n_edges):  # type: ignore[no-untyped-def]
    """CSR rows of all the edges of the cells at each vertex, each once."""
    first, cells = cell_rows
    start, rim = boundary
    n = first.shape[0] - 1
    out, seen = np.zeros(n + 1, np.int32), np.full(n_edges, -1)
    most = 0
    for p in range(cells.shape[0]):
        most += start[cells[p] + 1] - start[cells[p]]
    rows, count = np.empty(most, np.int32), 0
    for i in range(n):
        for p in range(first[i], first[i + 1]):
            for q in range(start[cells[p]], start[cells[p] + 1]):
                if seen[rim[q]] != i:
                    seen[rim[q]], rows[count] = i, rim[q]
                    count += 1
        out[i + 1] = count
    return out, rows[:count].copy()


@kernel
def grow_discs(faces, face_edges, count, sides, size, labels):  # type: ignore[no-untyped-def]
    """Label discs of up to `size` faces: each takes neighbours that bring one new vertex. Returns how many there are.

    `count` and `sides` are the faces at each edge. A face that shares one edge with a disc, and no more than that
    edge's vertices, leaves it a disc.
    """
    seen, queue = np.full(faces.max() + 1 if faces.shape[0] else 0, -1), np.empty(faces.shape[0], np.int64)
    labels[:] = -1
    cell = 0
    for f in range(faces.shape[0]):
        if labels[f] >= 0:
            continue
        labels[f], queue[0] = cell, f
        for side in range(3):
            seen[faces[f, side]] = cell
        head, stop = 0, 1
        while head < stop and stop < size:
            for side in range(3):
                e = face_edges[queue[head], side]
                g = sides[e, 0] + sides[e, 1] - queue[head] if count[e] == 2 else -1
                if g < 0 or labels[g] >= 0 or stop == size:
                    continue
                new = 0
                for corner in range(3):
                    new += seen[faces[g, corner]] != cell
                if new == 1:
                    labels[g], queue[stop] = cell, g
                    stop += 1
                    for corner in range(3):
                        seen[faces[g, corner]] = cell
            head += 1
        cell += 1
    return cell
