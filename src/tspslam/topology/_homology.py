"""Compiled kernels of homology: a spanning tree of the vertices, one of the faces in what it leaves (cotree)."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel


@inlined
def root(parent, i):  # type: ignore[no-untyped-def]
    """Root of i in a forest of parents, which becomes flatter on the way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@kernel
def spanning_tree(n, edges):  # type: ignore[no-untyped-def]
    """Edges of a spanning forest (E,) bool, and one vertex of each component."""
    parent = np.arange(n)
    in_tree = np.zeros(edges.shape[0], np.bool_)
    for e in range(edges.shape[0]):
        a, b = root(parent, edges[e, 0]), root(parent, edges[e, 1])
        if a != b:
            parent[max(a, b)] = min(a, b)
            in_tree[e] = True
    return in_tree, np.flatnonzero(parent == np.arange(n))


@kernel
def sides_of_edges(start, rim, n_edges):  # type: ignore[no-untyped-def]
    """Number of faces at each edge, and its first two faces, -1 for none."""
    count, sides = np.zeros(n_edges, np.int32), np.full((n_edges, 2), -1, np.int64)
    for f in range(start.shape[0] - 1):
        for p in range(start[f], start[f + 1]):
            e = rim[p]
            if count[e] < 2:
                sides[e, count[e]] = f
            count[e] += 1
    return count, sides


@kernel
def cotree(in_tree, count, sides, n_faces):  # type: ignore[no-untyped-def]
    """Edges outside the tree, of one or two faces, that join the faces and the outside in a forest, (E,) bool."""
    parent = np.arange(n_faces + 1)
    in_cotree = np.zeros(in_tree.shape[0], np.bool_)
    for e in range(in_tree.shape[0]):
        if in_tree[e] or count[e] == 0 or count[e] > 2:
            continue
        a, b = root(parent, sides[e, 0]), root(parent, sides[e, 1] if count[e] == 2 else n_faces)
        if a != b:
            parent[max(a, b)] = min(a, b)
            in_cotree[e] = True
    return in_cotree


@kernel
def peel(start, rim, in_cotree, sides):  # type: ignore[no-untyped-def]
    """Take leaf after leaf from the cotree: faces in order, the position in `rim` of the edge that each decides.

    The faces that are left, one in each part of the cotree without the outside, come last; their position is -1.
    """
    n_faces = start.shape[0] - 1
    open_edges = np.zeros(n_faces, np.int32)
    for f in range(n_faces):
        for p in range(start[f], start[f + 1]):
            open_edges[f] += in_cotree[rim[p]]
    is_open, is_done = in_cotree.copy(), np.zeros(n_faces, np.bool_)
    order, position = np.empty(n_faces, np.int64), np.full(n_faces, -1)
    taken = 0
    for leaf in range(n_faces):
        f = leaf
        while f >= 0 and not is_done[f] and open_edges[f] == 1:
            for p in range(start[f], start[f + 1]):
                if is_open[rim[p]]:
                    order[taken], position[taken] = f, p
            e = rim[position[taken]]
            taken += 1
            is_open[e], is_done[f] = False, True
            f = sides[e, 0] + sides[e, 1] - f if sides[e, 1] >= 0 else -1
            if f >= 0:
                open_edges[f] -= 1
    for f in range(n_faces):
        if not is_done[f]:
            order[taken] = f
            taken += 1
    return order, position


@kernel
def sum_residual_faces(start, rim, sign, order, position):  # type: ignore[no-untyped-def]
    """Weight of every face in the residual face of its part of the cotree, and that face, or -1: the signed sum of
    the part's boundaries vanishes on its cotree edges."""  # noqa: D205, D209
    n_faces = start.shape[0] - 1
    weight, part = np.zeros(n_faces, np.int8), np.full(n_faces, -1)
    heir, heir_sign = np.full(n_faces, -1), np.zeros(n_faces, np.int8)
    waiting = np.full(rim.max() + 1 if rim.shape[0] else 0, -1)
    for k in range(n_faces):
        if position[k] >= 0:
            waiting[rim[position[k]]] = k
    for f in range(n_faces):
        for p in range(start[f], start[f + 1]):
            k = waiting[rim[p]]
            if k >= 0 and order[k] != f:
                heir[order[k]], heir_sign[order[k]] = f, -sign[p] * sign[position[k]]
    for k in range(n_faces - 1, -1, -1):
        f = order[k]
        if position[k] < 0:
            weight[f], part[f] = 1, f
        elif heir[f] >= 0:
            weight[f], part[f] = heir_sign[f] * weight[heir[f]], part[heir[f]]
    return weight, part


@kernel
def extend(start, rim, sign, order, position, cochain):  # type: ignore[no-untyped-def]
    """Give the cotree edges, in place, the values (E, G) that make the sum around each peeled face vanish."""
    for k in range(order.shape[0]):
        if position[k] < 0:
            continue
        decided, f = position[k], order[k]
        for p in range(start[f], start[f + 1]):
            if p != decided:
                for g in range(cochain.shape[1]):
                    cochain[rim[decided], g] -= sign[decided] * sign[p] * cochain[rim[p], g]
