"""Compiled kernels of the crust and of the diagnosis: poles, flood fill, loops."""

from __future__ import annotations

import numpy as np

from .._jit import kernel


@kernel
def farthest_centres(points, simplices, centres, against):  # type: ignore[no-untyped-def]
    """For each point, the tetrahedron around it with the farthest centre among those not on the side of `against`.

    Returns the tetrahedron (or -1) and the squared distance of each point; a centre that is not finite never wins.
    """
    best = np.zeros(points.shape[0])
    chosen = np.full(points.shape[0], -1, np.int64)
    for t in range(simplices.shape[0]):
        for corner in range(4):
            i = simplices[t, corner]
            if i >= points.shape[0]:
                continue
            squared, along = 0.0, 0.0
            for axis in range(3):
                step = centres[t, axis] - points[i, axis]
                squared += step * step
                along += step * against[i, axis]
            if along <= 0 and squared > best[i]:
                best[i], chosen[i] = squared, t
    return chosen, best


@kernel
def flood_outside(neighbours, is_wall):  # type: ignore[no-untyped-def]
    """Which tetrahedra are reached from beyond the hull (neighbour -1) through facets that are no walls."""
    outside = np.zeros(neighbours.shape[0], np.bool_)
    stack = np.empty(neighbours.shape[0], np.int32)
    top = 0
    for t in range(neighbours.shape[0]):
        for facet in range(4):
            if neighbours[t, facet] < 0 and not is_wall[t, facet] and not outside[t]:
                outside[t] = True
                stack[top] = t
                top += 1
    while top:
        top -= 1
        t = stack[top]
        for facet in range(4):
            u = neighbours[t, facet]
            if u >= 0 and not is_wall[t, facet] and not outside[u]:
                outside[u] = True
                stack[top] = u
                top += 1
    return outside


@kernel
def trace_loops(edges, start, incident):  # type: ignore[no-untyped-def]
    """Split edges, an even number at each vertex, into loops that visit a vertex once.

    `incident[start[v]:start[v + 1]]` are the edges at v, preferred ones first. Returns the vertices of all loops in a
    row and the stop of each loop. A walk that comes back to a vertex of its own path cuts a loop off there.
    """
    cursor = start[:-1].copy()
    is_used = np.zeros(edges.shape[0], np.bool_)
    place = np.full(start.shape[0] - 1, -1, np.int64)
    path = np.empty(edges.shape[0] + 1, np.int64)
    vertices = np.empty(edges.shape[0], np.int64)
    stops = np.empty(edges.shape[0], np.int64)
    written, loops = 0, 0
    for first in range(edges.shape[0]):
        v, top = edges[first, 0], 0
        while True:
            if place[v] >= 0:
                for q in range(place[v], top):
                    vertices[written] = path[q]
                    written += 1
                stops[loops] = written
                loops += 1
                for q in range(place[v] + 1, top):
                    place[path[q]] = -1
                top = place[v]
            place[v], path[top] = top, v
            top += 1
            while cursor[v] < start[v + 1] and is_used[incident[cursor[v]]]:
                cursor[v] += 1
            if cursor[v] == start[v + 1]:
                break
            e = incident[cursor[v]]
            is_used[e] = True
            v = edges[e, 0] + edges[e, 1] - v
        place[v] = -1
    return vertices, stops[:loops]
