"""Compiled kernels of T-MAHF banks: one gathering of the neighbourhood for all orders and scales."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel, reassociated_kernel
from ._harmonics import HARMONIC, MEAN, NEAREST_SQUARED, NONE, _append, _fit, _longest_row, _moments, _scratch


@kernel
def walk(i, rings, vertex_rows, face_rows, boundary, first, seen, queue, around, stops):  # type: ignore[no-untyped-def]
    """Elements around vertex i by topological distance: those up to d rings are ``around[:stops[d]]``."""
    v_start, v_rows = vertex_rows
    f_start, f_rows = face_rows
    e_start, e_rows = boundary
    seen[i], queue[0] = i, i
    begin, end, count = 0, 1, 0
    stops[0] = 0
    for d in range(1, rings + 1):
        stop = end
        for head in range(begin, end):
            at = queue[head]
            for p in range(v_start[at], v_start[at + 1]):
                j = v_rows[p]
                if seen[j] != i:
                    seen[j], queue[stop], around[count] = i, j, j
                    stop += 1
                    count += 1
            for p in range(f_start[at], f_start[at + 1]):
                f = f_rows[p]
                if seen[first[1] + f] == i:
                    continue
                seen[first[1] + f], around[count] = i, first[1] + f
                count += 1
                for q in range(e_start[f], e_start[f + 1]):
                    e = first[0] + e_rows[q]
                    if seen[e] != i:
                        seen[e], around[count] = i, e
                        count += 1
        begin, end = end, stop
        stops[d] = count


@inlined
def _to_units(count, x, y, p, q):  # type: ignore[no-untyped-def]
    """Make the offsets unit vectors, 0 without a direction, and copy them to (p, q)."""
    for k in range(count):
        squared = x[k] * x[k] + y[k] * y[k]
        inverse = 1.0 / np.sqrt(squared) if squared > NEAREST_SQUARED else 0.0
        x[k], y[k] = x[k] * inverse, y[k] * inverse
        p[k], q[k] = x[k], y[k]


@inlined
def _raise_power(times, count, x, y, p, q):  # type: ignore[no-untyped-def]
    """Multiply (p, q) by the unit vectors (x, y) so many times."""
    for _ in range(times):
        for k in range(count):
            p[k], q[k] = p[k] * x[k] - q[k] * y[k], p[k] * y[k] + q[k] * x[k]


@inlined
def _respond(centering, count, p, q, s, w):  # type: ignore[no-untyped-def]
    """Response (real, imaginary, defined) from unit vectors (p, q) at m times the angle; no direction: (0, 0)."""
    moments = _moments(False, count, p, q, s, w)
    if centering == HARMONIC:
        a, b, total, defined = _fit(moments)
        return 0.5 * total * a, 0.5 * total * b, defined
    _, _, total, s1, x1, y1, xs, ys, _, _, _ = moments
    defined = total > 0.0
    if centering == MEAN and defined:
        xs, ys = xs - s1 / total * x1, ys - s1 / total * y1
    return xs, ys, defined


@reassociated_kernel
def filter_bank(stars, vertex_rows, face_rows, boundary, elements, orders, rings, centering, z, defined):  # type: ignore[no-untyped-def]
    """T-MAHF of all orders and rings, scale by scale, to `z` and `defined` (N, K)."""
    start, rows = stars
    rows = rows.view(np.uint32)  # no wrap-around checks
    n, far = z.shape[0], rings.max()
    first = (n, elements.shape[0] - (boundary[0].shape[0] - 1))
    size = elements.shape[0] if far > 1 else _longest_row(start)
    x, y, s, w = _scratch(size)
    p, q = np.empty(size + 1), np.empty(size + 1)
    around, stops = np.empty(size + 1, np.uint32), np.zeros(far + 1, np.int64)
    seen, queue = np.full(elements.shape[0] if far > 1 else 0, -1, np.int32), np.empty(n if far > 1 else 0, np.int32)
    by_order = np.argsort(orders, kind="mergesort")
    for i in range(n):
        u, v, own = elements[i, 0], elements[i, 1], elements[i, 2]
        if elements[i, 3] == 0.0:
            continue
        if far > 1:
            walk(i, far, vertex_rows, face_rows, boundary, first, seen, queue, around, stops)
        else:
            stops[1] = start[i + 1] - start[i]
        near = around if far > 1 else rows[start[i] : start[i + 1]]
        shift = 0.0 if centering == NONE else own
        for k in range(stops[far]):
            _append(elements, near[k], 1.0, u, v, shift, k, x, y, s, w)
        _to_units(stops[far], x, y, p, q)
        power = 1
        for o in by_order:
            if orders[o] > 0:
                _raise_power(orders[o] - power, stops[far], x, y, p, q)
                power = orders[o]
            for r in range(rings.shape[0]):
                count, column = stops[rings[r]], r * orders.shape[0] + o
                if orders[o] == 0:
                    total = own
                    for k in range(count):
                        total += w[k] * (s[k] + shift)
                    z[i, column], defined[i, column] = total, True
                else:
                    a, b, defined[i, column] = _respond(centering, count, p, q, s, w)
                    z[i, column] = complex(a, b)
