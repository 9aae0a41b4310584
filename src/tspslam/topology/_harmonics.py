"""Compiled kernels of T-MAHF: gather the elements around a vertex, turn them into harmonics, sum or fit."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel, prefetch, reassociated_kernel

NONE, MEAN, HARMONIC, PLANE = 0, 1, 2, 3
BLOCK = 8  # vertices whose neighbours are brought near together
NEAREST_SQUARED = 1e-12  # px²: an element this close to the vertex has no direction
POOREST = 1e-3  # smallest eigenvalue of the design that still admits a fit


@kernel
def pack(first, uv, signal, ok, out):  # type: ignore[no-untyped-def]
    """Write (u, v, signal, 1) of each element from row `first` on; a marked element is (0, 0, 0, 0).

    Returns the first unmarked element that is not finite, or -1.
    """
    bad = -1
    for x in range(uv.shape[0]):
        u, v, value = uv[x, 0], uv[x, 1], signal[x]
        if not ok[x]:
            u, v, value = 0.0, 0.0, 0.0
        elif bad < 0 and not (abs(u + v + value) < np.inf):
            bad = x
        out[first + x, 0], out[first + x, 1], out[first + x, 2] = u, v, value
        out[first + x, 3] = 1.0 if ok[x] else 0.0
    return bad


@inlined
def _multiply_angle(order, count, x, y):  # type: ignore[no-untyped-def]
    """Turn offsets at angle ψ into unit vectors at mψ, by complex products: no trigonometric function anywhere."""
    for k in range(count):
        squared = x[k] * x[k] + y[k] * y[k]
        inverse = 1.0 / np.sqrt(squared) if squared > NEAREST_SQUARED else 0.0
        c, s = x[k] * inverse, y[k] * inverse
        real, imaginary = c, s
        for _ in range(order - 1):
            real, imaginary = real * c - imaginary * s, real * s + imaginary * c
        x[k], y[k] = real, imaginary


@inlined
def _moments(unit, count, x, y, s, w):  # type: ignore[no-untyped-def]
    """``Σ w, Σ w s`` over all, then ``Σ w, s, x, y, xs, ys, xx, xy, yy`` (times w) over elements with a direction.

    With `unit`, (x, y) are first made unit vectors; zero without a direction.
    """
    all_w, all_s, total, s1, x1, y1, xs, ys = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    xx, xy, yy = 0.0, 0.0, 0.0
    for k in range(count):
        squared = x[k] * x[k] + y[k] * y[k]
        far = squared > NEAREST_SQUARED
        scale = (1.0 / np.sqrt(squared) if unit else 1.0) if far else 0.0
        directed = w[k] if far else 0.0
        p, q = x[k] * scale, y[k] * scale
        wp, wq = directed * p, directed * q
        all_w += w[k]
        all_s += w[k] * s[k]
        total += directed
        s1 += directed * s[k]
        x1 += wp
        y1 += wq
        xs += wp * s[k]
        ys += wq * s[k]
        xx += wp * p
        xy += wp * q
        yy += wq * q
    return all_w, all_s, total, s1, x1, y1, xs, ys, xx, xy, yy


@inlined
def _sum_signals(count, s, w):  # type: ignore[no-untyped-def]
    """``Σ w s`` over all."""
    total = 0.0
    for k in range(count):
        total += w[k] * s[k]
    return total


@inlined
def _sum_units(count, x, y, s, w):  # type: ignore[no-untyped-def]
    """``Σ w, Σ w s`` over all, then ``Σ x, y, xs, ys`` (times w), with (x, y) made unit vectors as there."""
    total, s1, x1, y1, xs, ys = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        squared = x[k] * x[k] + y[k] * y[k]
        far = squared > NEAREST_SQUARED
        scale = 1.0 / np.sqrt(squared) if far else 0.0
        wp, wq = w[k] * (x[k] * scale), w[k] * (y[k] * scale)
        total += w[k]
        s1 += w[k] * s[k]
        x1 += wp
        y1 += wq
        xs += wp * s[k]
        ys += wq * s[k]
    return total, s1, x1, y1, xs, ys


@inlined
def _fit(moments):  # type: ignore[no-untyped-def]
    """Weighted least squares of ``s ≈ c + a x + b y``, of `_moments`: a, b, Σw, and whether the design admits it.

    With the columns scaled so that x² + y² has mean 1, the smallest eigenvalue of G = AᵀWA/Σw reaches `POOREST`
    exactly if G - POOREST·I has no negative pivot.
    """
    _, _, total, s1, x1, y1, xs, ys, xx, xy, yy = moments
    if not (total > 0.0 and xx + yy > 0.0):
        return 0.0, 0.0, total, False
    mean, trace = 1.0 / total, 1.0 / (xx + yy)
    scale = np.sqrt(total * trace)
    s1, x1, y1 = s1 * mean, x1 * mean * scale, y1 * mean * scale
    xx, xy, yy, xs, ys = xx * trace, xy * trace, yy * trace, xs * mean * scale, ys * mean * scale
    pivot = 1.0 / (1.0 - POOREST)
    second, third, cross = xx - POOREST - pivot * x1 * x1, yy - POOREST - pivot * y1 * y1, xy - pivot * x1 * y1
    if not (second > 0.0 and third * second >= cross * cross):
        return 0.0, 0.0, total, False
    xx, xy, yy, xs, ys = xx - x1 * x1, xy - x1 * y1, yy - y1 * y1, xs - x1 * s1, ys - y1 * s1
    solve = scale / (xx * yy - xy * xy)
    return (yy * xs - xy * ys) * solve, (xx * ys - xy * xs) * solve, total, True


@inlined
def _respond(order, centering, own, count, x, y, s, w):  # type: ignore[no-untyped-def]
    """Response (real, imaginary, defined) from gathered offsets (x, y), signals s, weights w; `own` is the vertex's."""
    if order == 0:
        return own + _sum_signals(count, s, w), 0.0, True
    on_circle = centering != PLANE
    if on_circle and order > 1:
        _multiply_angle(order, count, x, y)
    if centering >= HARMONIC:  # or PLANE; one call, as each copy of the loop takes time to compile
        a, b, total, defined = _fit(_moments(on_circle, count, x, y, s, w))
        scale = 0.5 * total if on_circle else 1.0
        return scale * a, scale * b, defined
    total, s1, x1, y1, real, imaginary = _sum_units(count, x, y, s, w)
    if centering == MEAN and total > 0.0:
        real, imaginary = real - s1 / total * x1, imaginary - s1 / total * y1
    return real, imaginary, total > 0.0


@inlined
def _scratch(size):  # type: ignore[no-untyped-def]
    return np.empty(size + 1), np.empty(size + 1), np.empty(size + 1), np.empty(size + 1)


@inlined
def _longest_row(start):  # type: ignore[no-untyped-def]
    longest = 0
    for i in range(start.shape[0] - 1):
        longest = max(longest, start[i + 1] - start[i])
    return longest


@inlined
def _append(elements, e, weight, u, v, shift, count, x, y, s, w):  # type: ignore[no-untyped-def]
    """Store one element's offset, centred signal and weight."""
    x[count] = elements[e, 0] - u
    y[count] = elements[e, 1] - v
    s[count] = elements[e, 2] - shift
    w[count] = elements[e, 3] * weight


@kernel
def fetch(visit, first, start, rows, elements, z):  # type: ignore[no-untyped-def]
    """Bring near what the coming blocks of vertices need: their rows, then the elements that these name."""
    last = min(first + BLOCK, visit.shape[0])
    for r in range(last, min(first + 2 * BLOCK, visit.shape[0])):
        prefetch(rows, start[visit[r]])
        prefetch(rows, start[visit[r]] + 16)
        prefetch(rows, start[visit[r] + 1] - 1)
        prefetch(z, visit[r])
    for r in range(first, last):
        for p in range(start[visit[r]], start[visit[r] + 1]):
            prefetch(elements, rows[p])


@reassociated_kernel
def filter_one_ring(visit, is_far, start, rows, elements, order, centering, z, defined):  # type: ignore[no-untyped-def]
    """T-MAHF over the one-ring, eq. (17); `rows` index the packed elements."""
    x, y, s, w = _scratch(_longest_row(start))
    for r in range(visit.shape[0]):
        if is_far and r % BLOCK == 0:
            fetch(visit, r + BLOCK, start, rows, elements, z)
        i = visit[r]
        u, v, own = elements[i, 0], elements[i, 1], elements[i, 2]
        z[i], defined[i] = 0.0, False
        if elements[i, 3] == 0.0:
            continue
        shift = 0.0 if centering == NONE else own
        count = np.int64(0)  # no literal, which would be a type of its own
        for p in range(start[i], start[i + 1]):
            _append(elements, rows[p], 1.0, u, v, shift, count, x, y, s, w)
            count += 1
        a, b, defined[i] = _respond(order, centering, own, count, x, y, s, w)
        z[i] = complex(a, b)


@reassociated_kernel
def filter_rings(vertex_rows, face_rows, boundary, elements, order, centering, g, z, defined):  # type: ignore[no-untyped-def]
    """T-MAHF with the weights ``g[d]`` of the topological distance, by one breadth-first walk from each vertex."""
    v_start, v_rows = vertex_rows
    f_start, f_rows = face_rows
    n, total = z.shape[0], elements.shape[0]
    e_start, e_rows = boundary
    first_face = total - (e_start.shape[0] - 1)
    seen = np.full(total, -1, np.int32)
    queue, hops = np.empty(n, np.int32), np.empty(n, np.int32)
    x, y, s, w = _scratch(total)
    for i in range(n):
        u, v, own = elements[i, 0], elements[i, 1], elements[i, 2]
        z[i], defined[i] = 0.0, False
        if elements[i, 3] == 0.0:
            continue
        shift = 0.0 if centering == NONE else own
        count, head, tail = np.int64(0), 0, 1
        queue[0], hops[0], seen[i] = i, 0, i
        while head < tail and hops[head] + 1 < g.shape[0]:
            at, d = queue[head], hops[head] + 1
            head += 1
            for p in range(v_start[at], v_start[at + 1]):
                j = v_rows[p]
                if seen[j] != i:
                    seen[j], queue[tail], hops[tail] = i, j, d
                    tail += 1
                    _append(elements, j, g[d], u, v, shift, count, x, y, s, w)
                    count += 1
            for p in range(f_start[at], f_start[at + 1]):
                f = f_rows[p]
                if seen[first_face + f] == i:
                    continue
                seen[first_face + f] = i
                _append(elements, first_face + f, g[d], u, v, shift, count, x, y, s, w)
                count += 1
                for q in range(e_start[f], e_start[f + 1]):
                    e = n + e_rows[q]
                    if seen[e] != i:
                        seen[e] = i
                        _append(elements, e, g[d], u, v, shift, count, x, y, s, w)
                        count += 1
        a, b, defined[i] = _respond(order, centering, own, count, x, y, s, w)
        z[i] = complex(a, b)
