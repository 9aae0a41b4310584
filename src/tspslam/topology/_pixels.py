"""Compiled kernels of the texture signals: bilinear samples, Bresenham lines, triangles by row prefix sums."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel, prefetch

BLOCK = 32  # elements whose data are brought near together
SUBPIXEL = 256  # corners of triangles are rounded to 1/256 px, so that "inside" is decided in integers


@kernel
def weigh_channels(image, weights, out):  # type: ignore[no-untyped-def]
    """``out[v, u] = Σ_c weights[c] · image[v, u, c]``, in float64."""
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            total = 0.0
            for c in range(weights.shape[0]):
                total += weights[c] * image[v, u, c]
            out[v, u] = total


@kernel
def prefix_sums(image, table):  # type: ignore[no-untyped-def]
    """``table[v, u + 1]`` = sum of ``image[v, :u + 1]``."""
    for v in range(image.shape[0]):
        total = table[v, 0]
        for u in range(image.shape[1]):
            total += image[v, u]
            table[v, u + 1] = total


@inlined
def _bilinear(image, u, v):  # type: ignore[no-untyped-def]
    height, width = image.shape
    u0 = min(int(u), max(width - 2, 0))
    v0 = min(int(v), max(height - 2, 0))
    u1, v1 = min(u0 + 1, width - 1), min(v0 + 1, height - 1)
    a, b = u - u0, v - v0
    top = (1.0 - a) * image[v0, u0] + a * image[v0, u1]
    bottom = (1.0 - a) * image[v1, u0] + a * image[v1, u1]
    return (1.0 - b) * top + b * bottom


@kernel
def sample_vertices(image, unit, uv, order, is_far, value, ok):  # type: ignore[no-untyped-def]
    """Bilinear samples at `uv`; a vertex outside the image (or NaN) has no signal."""
    height, width = image.shape
    for r in range(order.shape[0]):
        if is_far:
            ahead = order[min(r + BLOCK, order.shape[0] - 1)]
            prefetch(uv, ahead)
            prefetch(value, ahead)
            prefetch(ok, ahead)
        i = order[r]
        u, v = uv[i, 0], uv[i, 1]
        ok[i] = 0.0 <= u <= width - 1 and 0.0 <= v <= height - 1
        value[i] = _bilinear(image, u, v) * unit if ok[i] else 0.0


@inlined
def _trace(image, u0, v0, u1, v1):  # type: ignore[no-untyped-def]
    """Sum of the image, of u and of v over the integer Bresenham line from (u0, v0) to (u1, v1), both included."""
    du, dv = abs(u1 - u0), abs(v1 - v0)
    su = 1 if u1 > u0 else -1
    sv = 1 if v1 > v0 else -1
    total = 0.0
    sum_u, sum_v = 0, 0
    u, v = u0, v0
    if dv > du:
        decision = 2 * du - dv
        for _ in range(dv + 1):
            total += image[v, u]
            sum_u += u
            if decision >= 0:
                u += su
                decision -= 2 * dv
            decision += 2 * du
            v += sv
        sum_v = (v0 + v1) * (dv + 1) // 2
    else:
        decision = 2 * dv - du
        for _ in range(du + 1):
            total += image[v, u]
            sum_v += v
            if decision >= 0:
                v += sv
                decision -= 2 * du
            decision += 2 * dv
            u += su
        sum_u = (u0 + u1) * (du + 1) // 2
    return total, sum_u, sum_v


@kernel
def fetch(order, first, elements, uv, vertex_ok, value, places, pixels, ok):  # type: ignore[no-untyped-def]
    """Bring near what a coming block of elements needs: corners, where those are, where results go."""
    for r in range(first, min(first + BLOCK, order.shape[0])):
        e = order[r]
        prefetch(value, e)
        prefetch(places, e)
        prefetch(pixels, e)
        prefetch(ok, e)
        for side in range(elements.shape[1]):
            prefetch(uv, elements[e, side])
            prefetch(vertex_ok, elements[e, side])


@inlined
def _sample_edge_block(image, unit, uv, vertex_ok, edges, block, value, edge_uv, pixels, ok):  # type: ignore[no-untyped-def]
    """Means along lines of pixels; a one-pixel line: bilinear sample at the midpoint."""
    for e in block:
        i, j = edges[e, 0], edges[e, 1]
        ok[e] = vertex_ok[i] and vertex_ok[j]
        if not ok[e]:
            value[e], edge_uv[e, 0], edge_uv[e, 1], pixels[e] = 0.0, 0.0, 0.0, 0
            continue
        u0, v0 = int(uv[i, 0] + 0.5), int(uv[i, 1] + 0.5)
        u1, v1 = int(uv[j, 0] + 0.5), int(uv[j, 1] + 0.5)
        if u0 == u1 and v0 == v1:
            u, v = 0.5 * (uv[i, 0] + uv[j, 0]), 0.5 * (uv[i, 1] + uv[j, 1])
            value[e] = _bilinear(image, u, v) * unit
            edge_uv[e, 0], edge_uv[e, 1] = u, v
            pixels[e] = 1
            continue
        if v1 < v0 or (v1 == v0 and u1 < u0):
            u0, v0, u1, v1 = u1, v1, u0, v0
        total, sum_u, sum_v = _trace(image, u0, v0, u1, v1)
        count = max(abs(u1 - u0), v1 - v0) + 1
        value[e] = total * unit / count
        edge_uv[e, 0], edge_uv[e, 1] = sum_u / count, sum_v / count
        pixels[e] = count


@kernel
def sample_edges(image, unit, uv, vertex_ok, edges, order, is_far, value, edge_uv, pixels, ok):  # type: ignore[no-untyped-def]
    """Mean and barycentre of each edge's pixel line, in the order of visit."""
    for first in range(0, order.shape[0], BLOCK):
        if is_far:
            fetch(order, first + BLOCK, edges, uv, vertex_ok, value, edge_uv, pixels, ok)
        block = order[first : first + BLOCK]
        _sample_edge_block(image, unit, uv, vertex_ok, edges, block, value, edge_uv, pixels, ok)


@inlined
def _floor_divide(number, divisor, inverse):  # type: ignore[no-untyped-def]
    """``floor(number / divisor)`` for divisor > 0, exact: a floating estimate, put right by its remainder."""
    quotient = int(np.floor(number * inverse))
    rest = number - quotient * divisor
    if rest < 0:
        quotient -= 1
    elif rest >= divisor:
        quotient += 1
    return quotient


@inlined
def _crossing(x0, y0, x1, y1):  # type: ignore[no-untyped-def]
    """Line through two corners as ``u(row) = (start + row·step) / divisor`` px, all integers; y0 <= y1."""
    divisor = max(y1 - y0, 1)
    step = (x1 - x0) * SUBPIXEL
    start = x0 * divisor - (x1 - x0) * y0
    divisor *= SUBPIXEL
    return start, step, divisor, 1.0 / divisor


@inlined
def _sum_rows(table, low, high, left, right):  # type: ignore[no-untyped-def]
    """Sums over the pixels of rows low..high between two lines: of the image, 2u, v and 1."""
    total = 0.0
    sum_u, sum_v, count = 0, 0, 0
    for row in range(low, high + 1):
        first = -_floor_divide(-(left[0] + row * left[1]), left[2], left[3])
        last = _floor_divide(right[0] + row * right[1], right[2], right[3])
        if last >= first:
            total += table[row, last + 1] - table[row, first]
            length = last - first + 1
            sum_u += (first + last) * length
            sum_v += row * length
            count += length
    return total, sum_u, sum_v, count


@inlined
def _scan_flat(table, x0, x1, x2, y):  # type: ignore[no-untyped-def]
    """The triangle whose corners share one height: a piece of a row, or nothing."""
    low, high = min(x0, x1, x2), max(x0, x1, x2)
    row = y // SUBPIXEL
    first, last = -(-low // SUBPIXEL), high // SUBPIXEL
    if row * SUBPIXEL != y or last < first:
        return 0.0, 0, 0, 0
    length = last - first + 1
    return table[row, last + 1] - table[row, first] + 0.0, (first + last) * length, row * length, length


@inlined
def _scan(table, x0, y0, x1, y1, x2, y2):  # type: ignore[no-untyped-def]
    """Sums over the pixel centres in the closed triangle: of the image, 2u, v and 1."""
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y1 > y2:
        x1, y1, x2, y2 = x2, y2, x1, y1
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y0 == y2:
        return _scan_flat(table, x0, x1, x2, y0)
    long = _crossing(x0, y0, x2, y2)
    upper = _crossing(x0, y0, x1, y1)
    lower = _crossing(x1, y1, x2, y2)
    top, bottom = -(-y0 // SUBPIXEL), y2 // SUBPIXEL
    middle = y1 // SUBPIXEL if y1 > y0 else top - 1  # the last row that meets `upper`
    middle_on_left = (x1 - x0) * (y2 - y0) < (x2 - x0) * (y1 - y0)
    total, sum_u, sum_v, count = 0.0, 0, 0, 0
    low, high, short = top, middle, upper
    for _ in range(2):  # the rows of `upper`, then of `lower`: each copy of the loop takes time to compile
        left, right = (short, long) if middle_on_left else (long, short)
        part = _sum_rows(table, low, high, left, right)
        total, sum_u, sum_v, count = total + part[0], sum_u + part[1], sum_v + part[2], count + part[3]
        low, high, short = middle + 1, bottom, lower
    return total, sum_u, sum_v, count


@inlined
def _corner(uv, i):  # type: ignore[no-untyped-def]
    """Where vertex i is, in whole subpixels."""
    return int(np.floor(uv[i, 0] * SUBPIXEL + 0.5)), int(np.floor(uv[i, 1] * SUBPIXEL + 0.5))


@inlined
def _sample_face_block(image, table, unit, uv, vertex_ok, faces, block, value, face_uv, pixels, ok):  # type: ignore[no-untyped-def]
    """Means over closed triangles; no pixel centre inside: bilinear sample at the centroid."""
    for f in block:
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ok[f] = vertex_ok[i] and vertex_ok[j] and vertex_ok[k]
        if not ok[f]:
            value[f], face_uv[f, 0], face_uv[f, 1], pixels[f] = 0.0, 0.0, 0.0, 0
            continue
        (x0, y0), (x1, y1), (x2, y2) = _corner(uv, i), _corner(uv, j), _corner(uv, k)
        total, sum_2u, sum_v, count = _scan(table, x0, y0, x1, y1, x2, y2)
        pixels[f] = count
        if count > 0:
            value[f] = total * unit / count
            face_uv[f, 0], face_uv[f, 1] = 0.5 * sum_2u / count, sum_v / count
        else:
            u = (uv[i, 0] + uv[j, 0] + uv[k, 0]) / 3.0
            v = (uv[i, 1] + uv[j, 1] + uv[k, 1]) / 3.0
            value[f] = _bilinear(image, u, v) * unit
            face_uv[f, 0], face_uv[f, 1] = u, v


@kernel
def sample_faces(image, table, unit, uv, vertex_ok, faces, order, is_far, value, face_uv, pixels, ok):  # type: ignore[no-untyped-def]
    """Mean and barycentre of each closed triangle's pixels, in the order of visit."""
    for first in range(0, order.shape[0], BLOCK):
        if is_far:
            fetch(order, first + BLOCK, faces, uv, vertex_ok, value, face_uv, pixels, ok)
        block = order[first : first + BLOCK]
        _sample_face_block(image, table, unit, uv, vertex_ok, faces, block, value, face_uv, pixels, ok)
