"""Compiled kernels of segmentation: energies of regions, the tree of their merges, discs.

A region is a row of sums, so that two rows add up to their union's. Columns: 0 its number of points, 1 their weight,
2:5 Σ w x, 5:11 Σ w x xᵀ (xx xy xz yy yz zz), 11:17 Σ w C with C the covariances of the points; 17 the number of
normals, 18:21 their sum; then for each feature k, from 21 + 3k, its weight, Σ w s and Σ w s².
"""

from __future__ import annotations

import math

import numpy as np

from .._jit import inlined, kernel

GEOMETRY, NORMALS = 21, 17
_SINGULAR = 1e-4  # of the trace: what keeps noise along rays alone invertible
_ON_A_LINE = 1e-9  # width over length, squared, of points that lie on a line, and so in a plane
_STEPS, _ENOUGH = 30, 1e-9  # of Newton's: 3 where a region is flat, 30 for a double root to 1e-9
_BEND = 0.03  # mean of sin² between noisy normals of one flat region: 10 degrees


@inlined
def _least_root(c0, c1, c2, c3):  # type: ignore[no-untyped-def]
    """Least root of c0 - c1 λ + c2 λ² - c3 λ³, all of whose roots are positive: Newton from 0 climbs to it."""
    if c0 <= 0 or c1 * c3 < _ON_A_LINE * c2 * c2:
        return 0.0
    x = 0.0
    for _ in range(_STEPS):
        slope = c1 - x * (2 * c2 - 3 * c3 * x)
        if slope <= 0:
            break
        step = (c0 - x * (c1 - x * (c2 - c3 * x))) / slope
        x += step
        if step <= _ENOUGH * x:
            break
    return x


@kernel
def off_plane(s):  # type: ignore[no-untyped-def]
    """Mean square distance of points to their best plane over that which their covariances let expect.

    It is the least λ of det(S - λ C) = 0, with the scatter S of the points and the sum C of their covariances.
    """
    w = s[1]
    if w <= 0:
        return 0.0
    x, y, z = s[2] / w, s[3] / w, s[4] / w
    a, b, c = s[5] - w * x * x, s[6] - w * x * y, s[7] - w * x * z
    d, e, f = s[8] - w * y * y, s[9] - w * y * z, s[10] - w * z * z
    more = _SINGULAR * (s[11] + s[14] + s[16])
    g, h, i, j, k, m = s[11] + more, s[12], s[13], s[14] + more, s[15], s[16] + more
    sa, sb, sc, sd, se, sf = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    ca, cb, cc, cd, ce, cf = j * m - k * k, i * k - h * m, h * k - i * j, g * m - i * i, h * i - g * k, g * j - h * h
    first = sa * g + sd * j + sf * m + 2 * (sb * h + sc * i + se * k)
    second = ca * a + cd * d + cf * f + 2 * (cb * b + cc * c + ce * e)
    return _least_root(a * sa + b * sb + c * sc, first, second, g * ca + h * cb + i * cc)


@kernel
def energy(s, weight, floor):  # type: ignore[no-untyped-def]
    """What a region costs: how far it is from one plane, one normal, and one value of each feature."""
    total = s[0] * math.log(1 + off_plane(s)) if s[0] > 0 else 0.0
    if s[17] > 0:
        turned = 1 - (s[18] * s[18] + s[19] * s[19] + s[20] * s[20]) / (s[17] * s[17])
        total += s[17] * math.log(1 + max(turned, 0.0) / _BEND)
    for k in range(weight.shape[0]):
        n = s[GEOMETRY + 3 * k]
        if n > 0:
            mean = s[GEOMETRY + 3 * k + 1] / n
            total += weight[k] * n * math.log(1 + max(s[GEOMETRY + 3 * k + 2] / n - mean * mean, 0.0) / floor[k])
    return total


@kernel
def pairs_at_edges(face_edges, n_edges):  # type: ignore[no-untyped-def]
    """Faces that meet at an edge, (P, 2), and the edge (P,); k faces at one edge give k - 1 pairs."""
    last = np.full(n_edges, -1)
    pairs, edge = np.empty((3 * face_edges.shape[0], 2), np.int64), np.empty(3 * face_edges.shape[0], np.int64)
    count = 0
    for f in range(face_edges.shape[0]):
        for side in range(3):
            e = face_edges[f, side]
            if last[e] >= 0:
                pairs[count, 0], pairs[count, 1], edge[count] = last[e], f, e
                count += 1
            last[e] = f
    return pairs[:count], edge[:count]


@kernel
def add_corners(faces, xyz, covariance, share, sums):  # type: ignore[no-untyped-def]
    """Add the points of each face to its row of sums, each by its `share`: one over the faces that it has."""
    for f in range(faces.shape[0]):
        for corner in range(3):
            v = faces[f, corner]
            add_point(xyz[v], covariance[v], share[v], sums[f])


@kernel
def add_point(x, C, share, s):  # type: ignore[no-untyped-def]
    """Add one point to a row of sums; a point without a position, of share 0, changes nothing."""
    if share <= 0:
        return
    w = share / (C[0, 0] + C[1, 1] + C[2, 2])
    s[0] += share
    s[1] += w
    k = 0
    for i in range(3):
        s[2 + i] += w * x[i]
        for j in range(i, 3):
            s[5 + k] += w * x[i] * x[j]
            s[11 + k] += w * C[i, j]
            k += 1


@kernel
def ring_spread(edges, xyz, degree):  # type: ignore[no-untyped-def]
    """Standard deviation of each vertex and its neighbours off their best plane; -1 where they are fewer than 5."""
    sums, out, even = np.zeros((xyz.shape[0], GEOMETRY)), np.full(xyz.shape[0], -1.0), np.eye(3) / 3
    for i in range(xyz.shape[0]):
        add_point(np.zeros(3), even, 1.0, sums[i])
    for e in range(edges.shape[0]):
        for side in range(2):
            i, j = edges[e, side], edges[e, 1 - side]
            add_point(xyz[j] - xyz[i], even, 1.0, sums[i])
    for i in range(xyz.shape[0]):
        if degree[i] >= 4:
            out[i] = math.sqrt(off_plane(sums[i]) / 3 * (degree[i] + 1) / (degree[i] - 2))
    return out


@kernel
def merge_tree(sums, pairs, length, weight, floor):  # type: ignore[no-untyped-def]
    """All merges of neighbouring regions, down to one for each component: parent of each region and when it merges.

    In each round two regions merge which are each other's best: those whose union costs least more than both, for each
    edge between them. A merge is not earlier than those it builds on, so that later cuts join more, and only more.
    """
    n, columns = sums.shape
    rows, cost = np.zeros((2 * n, columns)), np.empty(pairs.shape[0])
    rows[:n] = sums
    own, parent, height = np.empty(2 * n), np.full(2 * n, -1), np.zeros(2 * n)
    for i in range(n):
        own[i] = energy(rows[i], weight, floor)
    a, b, shared = pairs[:, 0].copy(), pairs[:, 1].copy(), length.copy()
    is_new, best, count = np.ones(2 * n, np.bool_), np.full(2 * n, -1), n
    while a.shape[0] > 0:
        _price(a, b, shared, rows, own, is_new, weight, floor, cost)
        _choose(a, b, shared, cost, best, is_new)
        for k in range(a.shape[0]):
            if best[a[k]] == k and best[b[k]] == k:
                rows[count] = rows[a[k]] + rows[b[k]]
                own[count] = energy(rows[count], weight, floor)
                height[count] = max(cost[k], height[a[k]], height[b[k]])
                parent[a[k]] = parent[b[k]] = count
                is_new[count] = True
                count += 1
        a, b, shared, cost = _join(a, b, shared, cost, parent)
    return parent[:count], height[:count]


@kernel
def _price(a, b, shared, rows, own, is_new, weight, floor, cost):  # type: ignore[no-untyped-def]
    """Cost of merging each pair of which one is new."""
    both = np.empty(rows.shape[1])
    for k in range(a.shape[0]):
        if is_new[a[k]] or is_new[b[k]]:
            for c in range(both.shape[0]):
                both[c] = rows[a[k], c] + rows[b[k], c]
            cost[k] = (energy(both, weight, floor) - own[a[k]] - own[b[k]]) / shared[k]


@kernel
def _choose(a, b, shared, cost, best, is_new):  # type: ignore[no-untyped-def]
    """Each region's best pair: the cheapest; of equals the one that shares most, then the first. None is new now."""
    for k in range(a.shape[0]):
        best[a[k]] = best[b[k]] = -1
        is_new[a[k]] = is_new[b[k]] = False
    for k in range(a.shape[0]):
        for i in (a[k], b[k]):
            p = best[i]
            if p < 0 or cost[k] < cost[p] or (cost[k] == cost[p] and shared[k] > shared[p]):
                best[i] = k


@kernel
def _join(a, b, shared, cost, parent):  # type: ignore[no-untyped-def]
    """Pairs of the regions that are left, each once: those that stay as they are, then the new ones by number."""
    size, m = parent.shape[0], a.shape[0]
    first, second, length, price = np.empty(m, np.int64), np.empty(m, np.int64), np.empty(m), np.empty(m)
    keys, changed, n_changed, q = np.empty(m, np.int64), np.empty(m, np.int64), 0, 0
    for k in range(m):
        i = parent[a[k]] if parent[a[k]] >= 0 else a[k]
        j = parent[b[k]] if parent[b[k]] >= 0 else b[k]
        if i == a[k] and j == b[k]:
            first[q], second[q], length[q], price[q] = i, j, shared[k], cost[k]
            q += 1
        elif i != j:
            keys[n_changed], changed[n_changed] = min(i, j) * size + max(i, j), k
            n_changed += 1
    last = -1
    for p in np.argsort(keys[:n_changed], kind="mergesort"):
        if keys[p] == last:
            length[q - 1] += shared[changed[p]]
        else:
            last = keys[p]
            first[q], second[q], length[q] = last // size, last % size, shared[changed[p]]
            q += 1
    return first[:q].copy(), second[:q].copy(), length[:q].copy(), price[:q].copy()


@kernel
def cut_tree(parent, height, n, limit):  # type: ignore[no-untyped-def]
    """Region of each of n elements after all merges up to `limit`, numbered by its first element."""
    top, number = np.arange(parent.shape[0]), np.full(parent.shape[0], -1)
    labels, count = np.empty(n, np.int32), 0
    for i in range(parent.shape[0] - 1, -1, -1):
        if parent[i] >= 0 and height[parent[i]] <= limit:
            top[i] = top[parent[i]]
    for i in range(n):
        if number[top[i]] < 0:
            number[top[i]] = count
            count += 1
        labels[i] = number[top[i]]
    return labels


@kernel
def grow_discs(faces, face_edges, graph, n, n_edges, labels):  # type: ignore[no-untyped-def]
    """Cut regions into discs: labels, numbered by their first faces.

    A face joins a disc by one side whose opposite corner is new to it, or by two sides: then what they share with the
    disc is a path, and a disc it stays. No side is joined by a third face.
    """
    first, near = graph
    discs, at_vertex, at_edge = np.full(labels.shape[0], -1, np.int32), np.full(n, -1), np.full(n_edges, -1)
    full = np.full(n_edges, -1)
    queue, count = np.empty(4 * labels.shape[0] + 1, np.int64), 0
    for seed in range(labels.shape[0]):
        if discs[seed] >= 0:
            continue
        queue[0], head, stop = seed, 0, 1
        while head < stop:
            f = queue[head]
            head += 1
            sides, corners, is_free = 0, 0, True
            for k in range(3):
                is_free &= full[face_edges[f, k]] != count
                sides += at_edge[face_edges[f, k]] == count
                corners += at_vertex[faces[f, k]] == count
            if discs[f] >= 0 or not is_free or not (f == seed or (sides == 1 and corners == 2) or sides == 2):
                continue
            discs[f] = count
            for k in range(3):
                if at_edge[face_edges[f, k]] == count:
                    full[face_edges[f, k]] = count
                at_vertex[faces[f, k]] = at_edge[face_edges[f, k]] = count
            for p in range(first[f], first[f + 1]):
                if discs[near[p]] < 0 and labels[near[p]] == labels[f]:
                    queue[stop] = near[p]
                    stop += 1
        count += 1
    return discs
