"""Compiled kernels of quality: harmonics of the star of each vertex in its tangent plane, nearest surface points."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

FLAT = 1e-24  # share of the squared length of a star: an offset this short across the normal has no direction


@inlined
def _row(points, x, i):  # type: ignore[no-untyped-def]
    """From point i to point x, as three numbers: an array for each would cost more than all else."""
    return points[x, 0] - points[i, 0], points[x, 1] - points[i, 1], points[x, 2] - points[i, 2]


@kernel
def filter_stars(start, rows, places, axes, unit, values, ok, orders, plain, texture, shape):  # type: ignore[no-untyped-def]
    """Means over each vertex's star of what stands there, times ``e^{jmψ}``, ψ in its tangent plane.

    `places` (n + E + F, 3), `values` (n + E + F,); `axes` (n, 3, 3) holds t1, t2, n of each vertex. Gives `plain`
    (n, 3): how many, mean and variance of the values, the vertex's own among them; `texture` (n, M): ``mean (s - s̄)
    e^{jmψ}``; `shape` (n, M): ``mean h e^{jmψ}``, h the height over the tangent plane in units of `unit` (n,).
    """
    most = orders.max() if orders.shape[0] else 0
    for i in range(axes.shape[0]):
        if not ok[i]:
            continue
        count, total, squares = 1.0, 0.0, 0.0  # about the vertex's own value: no loss of digits
        for p in range(start[i], start[i + 1]):
            if ok[rows[p]]:
                off = values[rows[p]] - values[i]
                count, total, squares = count + 1.0, total + off, squares + off * off
        mean = total / count
        plain[i, 0], plain[i, 1], plain[i, 2] = count, values[i] + mean, max(squares / count - mean * mean, 0.0)
        if count == 1.0:
            continue
        for p in range(start[i], start[i + 1]):
            x = rows[p]
            if not ok[x]:
                continue
            d = _row(places, x, i)
            u = d[0] * axes[i, 0, 0] + d[1] * axes[i, 0, 1] + d[2] * axes[i, 0, 2]
            v = d[0] * axes[i, 1, 0] + d[1] * axes[i, 1, 1] + d[2] * axes[i, 1, 2]
            h = (d[0] * axes[i, 2, 0] + d[1] * axes[i, 2, 1] + d[2] * axes[i, 2, 2]) / (unit[i] * (count - 1.0))
            s = (values[x] - values[i] - mean) / (count - 1.0)
            far = u * u + v * v
            turn = complex(u, v) / np.sqrt(far) if far > FLAT * unit[i] * unit[i] else 0j
            power = 1.0 + 0j
            for m in range(most + 1):
                for o in range(orders.shape[0]):
                    if orders[o] == m:
                        texture[i, o] += s * power
                        shape[i, o] += h * power
                power *= turn


@inlined
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _on_side(off, side):  # type: ignore[no-untyped-def]
    """Share of a side's end in its point nearest to an offset from its beginning, and the squared distance."""
    length = _dot(side, side)
    t = min(max(_dot(off, side) / length, 0.0), 1.0) if length > 0.0 else 0.0
    gap = (off[0] - t * side[0], off[1] - t * side[1], off[2] - t * side[2])
    return t, _dot(gap, gap)


@inlined
def _on_triangle(q, b, c):  # type: ignore[no-untyped-def]
    """Shares of b and c in the point of a triangle nearest to q, its squared distance; all from the first corner."""
    bb, bc, cc, qb, qc = _dot(b, b), _dot(b, c), _dot(c, c), _dot(q, b), _dot(q, c)
    area = bb * cc - bc * bc
    if area > 1e-20 * bb * cc:
        v, w = (cc * qb - bc * qc) / area, (bb * qc - bc * qb) / area
        if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
            gap = (q[0] - v * b[0] - w * c[0], q[1] - v * b[1] - w * c[1], q[2] - v * b[2] - w * c[2])
            return v, w, _dot(gap, gap)
    t, first = _on_side(q, b)
    s, second = _on_side(q, c)
    r, third = _on_side((q[0] - b[0], q[1] - b[1], q[2] - b[2]), (c[0] - b[0], c[1] - b[1], c[2] - b[2]))
    if first <= second and first <= third:
        return t, 0.0, first
    if second <= third:
        return 0.0, s, second
    return 1.0 - r, r, third


@kernel
def find_nearest(queries, near, places, first, faces, face_edges, is_solid, start, rows, place, nodes, weights):  # type: ignore[no-untyped-def]
    """Nearest point of each query on the solid faces at the elements `near` (Q, k), or the first of these without one.

    Element x has faces ``rows[start[x]:start[x + 1]]`` and stands at ``places[x]``; edges are counted from ``first[0]``
    on, faces from ``first[1]``. Writes where the point is to `place` (Q, 3), and which elements stand around it with
    what weight (Q, 3): a corner, the middle of a side and that of the face: each face is six triangles, linear between
    what stands on it.
    """
    for q in range(queries.shape[0]):
        nodes[q, :], weights[q, 0], best, found, b, c = near[q, 0], 1.0, np.inf, -1, 0.0, 0.0
        for k in range(near.shape[1]):
            for p in range(start[near[q, k]], start[near[q, k] + 1]):
                if not is_solid[rows[p]]:
                    continue
                i, j, h = faces[rows[p], 0], faces[rows[p], 1], faces[rows[p], 2]
                off = (queries[q, 0] - places[i, 0], queries[q, 1] - places[i, 1], queries[q, 2] - places[i, 2])
                v, w, squared = _on_triangle(off, _row(places, j, i), _row(places, h, i))
                if squared < best:
                    best, found, b, c = squared, rows[p], v, w
        if found < 0:
            place[q] = places[near[q, 0]]
            continue
        i, j, h = faces[found, 0], faces[found, 1], faces[found, 2]
        for axis in range(3):
            place[q, axis] = (1.0 - b - c) * places[i, axis] + b * places[j, axis] + c * places[h, axis]
        _mark(
            (max(1.0 - b - c, 0.0), b, c),
            faces[found],
            face_edges[found],
            (first[0], first[1] + found),
            nodes[q],
            weights[q],
        )


@kernel
def _mark(share, corners, sides, first, nodes, weights):  # type: ignore[no-untyped-def]
    """The sixth of a face in which barycentric coordinates lie: corner, side, face, and their weights."""
    least = 0 if share[0] <= share[1] and share[0] <= share[2] else (1 if share[1] <= share[2] else 2)
    most, middle = (least + 1) % 3, (least + 2) % 3
    if share[most] < share[middle]:
        most, middle = middle, most
    nodes[0], nodes[1], nodes[2] = corners[most], first[0] + sides[(least + 1) % 3], first[1]
    weights[0], weights[1] = share[most] - share[middle], 2.0 * (share[middle] - share[least])
    weights[2] = 3.0 * share[least]
