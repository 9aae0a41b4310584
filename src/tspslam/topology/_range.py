"""Compiled kernels of the range of an image over edges and faces: each pixel is looked at."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel
from ._pixels import SUBPIXEL, _corner, _crossing, _floor_divide


@kernel
def range_of_edges(image, uv, edges, pixels, out):  # type: ignore[no-untyped-def]
    """Largest minus smallest pixel of each edge's Bresenham line, to `out`; `pixels` says how long it is."""
    for e in range(edges.shape[0]):
        if pixels[e] < 2:
            continue
        i, j = edges[e, 0], edges[e, 1]
        u0, v0 = int(uv[i, 0] + 0.5), int(uv[i, 1] + 0.5)
        u1, v1 = int(uv[j, 0] + 0.5), int(uv[j, 1] + 0.5)
        if v1 < v0 or (v1 == v0 and u1 < u0):
            u0, v0, u1, v1 = u1, v1, u0, v0
        du, dv, su = abs(u1 - u0), v1 - v0, 1 if u1 > u0 else -1
        long, short = max(du, dv), min(du, dv)
        u, v, decision = u0, v0, 2 * short - long
        least = most = image[v, u]
        for _ in range(long):
            aside = decision >= 0
            u += su if dv <= du or aside else 0
            v += 1 if dv > du or aside else 0
            decision += 2 * short - (2 * long if aside else 0)
            least, most = min(least, image[v, u]), max(most, image[v, u])
        out[e] = most - least


@inlined
def _range_rows(image, low, high, left, right, least, most):  # type: ignore[no-untyped-def]
    for row in range(low, high + 1):
        first = -_floor_divide(-(left[0] + row * left[1]), left[2], left[3])
        last = _floor_divide(right[0] + row * right[1], right[2], right[3])
        for u in range(first, last + 1):
            least, most = min(least, image[row, u]), max(most, image[row, u])
    return least, most


@inlined
def _scan_range(image, x0, y0, x1, y1, x2, y2):  # type: ignore[no-untyped-def]
    """Smallest and largest pixel whose centre is in the closed triangle."""
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    if y1 > y2:
        x1, y1, x2, y2 = x2, y2, x1, y1
    if y0 > y1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    top, bottom = -(-y0 // SUBPIXEL), y2 // SUBPIXEL
    least, most = np.inf, -np.inf
    if y0 == y2:
        low, high = min(x0, x1, x2), max(x0, x1, x2)
        for u in range(-(-low // SUBPIXEL), high // SUBPIXEL + 1):
            least, most = min(least, image[top, u]), max(most, image[top, u])
        return least, most
    long, upper, lower = _crossing(x0, y0, x2, y2), _crossing(x0, y0, x1, y1), _crossing(x1, y1, x2, y2)
    middle = y1 // SUBPIXEL if y1 > y0 else top - 1  # the last row that meets `upper`
    if (x1 - x0) * (y2 - y0) < (x2 - x0) * (y1 - y0):
        least, most = _range_rows(image, top, middle, upper, long, least, most)
        return _range_rows(image, middle + 1, bottom, lower, long, least, most)
    least, most = _range_rows(image, top, middle, long, upper, least, most)
    return _range_rows(image, middle + 1, bottom, long, lower, least, most)


@kernel
def range_of_faces(image, uv, faces, pixels, out):  # type: ignore[no-untyped-def]
    """Largest minus smallest pixel of each closed triangle, to `out`; `pixels` says how many it holds."""
    for f in range(faces.shape[0]):
        if pixels[f] < 2:
            continue
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        (x0, y0), (x1, y1), (x2, y2) = _corner(uv, i), _corner(uv, j), _corner(uv, k)
        least, most = _scan_range(image, x0, y0, x1, y1, x2, y2)
        out[f] = most - least
