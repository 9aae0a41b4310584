"""Compiled loops of detection: corners, their strength and orientation, and an even choice of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from ..._jit import instructions, kernel, reassociated_kernel
from ._gradients import gradient_products

Levels = NDArray[np.uint8]
Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_HARRIS = np.float32(0.04)
_BLOCK = 3  # px, half width of the block that strength is summed over
_RADIUS = 15  # px, of the disc whose centroid gives the orientation


@instructions
def lesser(_context: Any, _a: Any, _b: Any) -> Any:
    """Smaller of two bytes, without a branch; many calls, and as inlined code each would take long to compile."""
    return _choice("<")


@instructions
def greater(_context: Any, _a: Any, _b: Any) -> Any:
    """Larger of two bytes, likewise."""
    return _choice(">")


def _choice(sign: str) -> Any:
    """Type and code of choosing the first of two bytes where it compares so to the second."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.select(builder.icmp_unsigned(sign, *arguments), *arguments)

    return types.uint8(types.uint8, types.uint8), generate


@kernel
def segment_scores(image: Levels, threshold: int, margin: int, score: Levels) -> None:
    """Segment test of FAST (Rosten and Drummond) on the circle of radius 3, at its eight even points.

    The score is the largest contrast at which four neighbouring points of the eight are all brighter or all darker
    than the centre; 0 where it does not exceed `threshold`. Bytes throughout: 32 pixels fit a vector register.
    """
    height, width = image.shape
    none = np.uint8(0)
    limit = np.uint8(threshold)
    first, last = margin, width - margin
    for y in range(margin, height - margin):
        # One slice a point: plain indices from 0 let the compiler use whole registers.
        n, ne, nw = image[y - 3, first:last], image[y - 2, first + 2 : last + 2], image[y - 2, first - 2 : last - 2]
        here, east, west = image[y, first:last], image[y, first + 3 : last + 3], image[y, first - 3 : last - 3]
        south, se, sw = image[y + 3, first:last], image[y + 2, first + 2 : last + 2], image[y + 2, first - 2 : last - 2]
        out = score[y, first:last]
        for x in range(last - first):
            c, a, b, d, e = here[x], n[x], ne[x], east[x], se[x]
            f, g, h, i = south[x], sw[x], west[x], nw[x]
            ab, bd, de, ef = lesser(a, b), lesser(b, d), lesser(d, e), lesser(e, f)
            fg, gh, hi, ia = lesser(f, g), lesser(g, h), lesser(h, i), lesser(i, a)
            one, two = greater(lesser(ab, de), lesser(bd, ef)), greater(lesser(de, fg), lesser(ef, gh))
            three, four = greater(lesser(fg, hi), lesser(gh, ia)), greater(lesser(hi, ab), lesser(ia, bd))
            high = greater(greater(one, two), greater(three, four))
            ab, bd, de, ef = greater(a, b), greater(b, d), greater(d, e), greater(e, f)
            fg, gh, hi, ia = greater(f, g), greater(g, h), greater(h, i), greater(i, a)
            one, two = lesser(greater(ab, de), greater(bd, ef)), lesser(greater(de, fg), greater(ef, gh))
            three, four = lesser(greater(fg, hi), greater(gh, ia)), lesser(greater(hi, ab), greater(ia, bd))
            low = lesser(lesser(one, two), lesser(three, four))
            contrast = greater(np.uint8(greater(high, c) - c), np.uint8(c - lesser(low, c)))
            out[x] = contrast if contrast > limit else none


@kernel
def peaks(score: Levels, y: int, peak: Levels) -> None:
    """Keep in `peak` the scores of row y that exceed those of their eight neighbours; of equal ones the last."""
    above, here, below = score[y - 1], score[y], score[y + 1]
    none, width = np.uint8(0), len(here)
    a, b, c = above[: width - 2], above[1 : width - 1], above[2:]
    d, e, f = here[: width - 2], here[1 : width - 1], here[2:]
    g, h, i = below[: width - 2], below[1 : width - 1], below[2:]
    out = peak[1 : width - 1]
    for x in range(width - 2):
        before, after = (
            greater(greater(a[x], b[x]), greater(c[x], d[x])),
            greater(greater(f[x], g[x]), greater(h[x], i[x])),
        )
        out[x] = e[x] if (e[x] >= before) & (e[x] > after) else none


@reassociated_kernel
def harris(flat: Levels, start: int, stride: int) -> np.float32:
    """Harris response over a block of 7 x 7 px whose first is at `start`, per pixel; central differences."""
    sums = gradient_products(flat, start, stride)
    xx, xy, yy = np.float32(sums[0]), np.float32(sums[1]), np.float32(sums[2])  # below 2²⁴: exact
    return (xx * yy - xy * xy - _HARRIS * (xx + yy) * (xx + yy)) / np.float32(2401)


@kernel
def find_corners(image: Levels, threshold: int, margin: int) -> tuple[Int64, Float32]:
    """Find the peaks of the segment test with positive Harris response: (N, 2) places (x, y), (N,) responses."""
    height, width = image.shape
    score, peak = np.empty((height, width), np.uint8), np.empty(width, np.uint8)
    score[:], peak[:] = 0, 0
    segment_scores(image, threshold, margin, score)
    flat, most = image.ravel(), (height * width) // 2  # no two peaks touch along a row
    xy, strength = np.empty((most, 2), np.int64), np.empty(most, np.float32)
    count = 0
    for y in range(margin, height - margin):
        peaks(score, y, peak)
        for x in range(margin, width - margin):
            if peak[x] > 0:
                response = harris(flat, (y - _BLOCK) * width + x - _BLOCK, width)
                if response > 0:
                    xy[count, 0], xy[count, 1], strength[count] = x, y, response
                    count += 1
    return xy[:count].copy(), strength[:count].copy()


@kernel
def order_by_key(key: NDArray[np.uint32]) -> Int64:
    """Rows in the order of their keys, of equal ones the first first: sorted by 11 bits of the key after the others."""
    order, after, begin = np.empty(len(key), np.int64), np.empty(len(key), np.int64), np.empty(2049, np.int64)
    for k in range(len(key)):
        order[k] = k
    for shift in (0, 11, 22):
        begin[:] = 0
        for k in range(len(key)):
            begin[((key[k] >> np.uint32(shift)) & np.uint32(2047)) + 1] += 1
        for digit in range(2048):
            begin[digit + 1] += begin[digit]
        for row in order:
            digit = (key[row] >> np.uint32(shift)) & np.uint32(2047)
            after[begin[digit]] = row
            begin[digit] += 1
        order, after = after, order
    return order


@kernel
def spread(uv: Float64, order: Int64, side: float, spacing: int, width: int, height: int, count: int) -> Int64:
    """Choose `count` points evenly: square cells take turns in giving the next of their points in `order`.

    A point within `spacing` px of an earlier one in `order` takes no part. Returns indices, best turn first.
    """
    columns, rows = int(width / side) + 1, int(height / side) + 1
    given, turn = np.empty(columns * rows, np.int64), np.empty(len(order), np.int64)
    taken = np.empty((height, width), np.bool_)
    given[:], turn[:], taken[:] = 0, -1, False
    for k in range(len(order)):
        u, v = uv[order[k], 0], uv[order[k], 1]
        x, y = int(u + 0.5), int(v + 0.5)
        if not taken[y, x]:
            for row in range(max(0, y - spacing), min(height, y + spacing + 1)):
                reach = int(np.sqrt(spacing * spacing - (row - y) * (row - y)))
                taken[row, max(0, x - reach) : x + reach + 1] = True
            cell = int(v / side) * columns + int(u / side)
            turn[k] = given[cell]
            given[cell] += 1
    turns = 0
    for cell in range(len(given)):
        turns = max(turns, given[cell])
    start = np.empty(turns + 2, np.int64)  # plain loops: NumPy's functions compile for a second
    start[:] = 0
    for k in range(len(order)):
        if turn[k] >= 0:
            start[turn[k] + 1] += 1
    for k in range(turns + 1):
        start[k + 1] += start[k]
    chosen = np.empty(start[turns + 1], np.int64)
    for k in range(len(order)):
        if turn[k] >= 0:
            chosen[start[turn[k]]] = order[k]
            start[turn[k]] += 1
    return chosen[:count]


@reassociated_kernel
def orientations(image: Levels, xy: Int64, angle: Float64) -> None:
    """Write the direction from each corner to the centroid of the grey levels around it, rad in [0, 2π)."""
    reach, ramp = np.empty(2 * _RADIUS + 1, np.int64), np.empty(2 * _RADIUS + 1, np.float32)
    for dy in range(-_RADIUS, _RADIUS + 1):
        reach[dy + _RADIUS] = int(np.sqrt((_RADIUS + 0.5) ** 2 - dy * dy))
        ramp[dy + _RADIUS] = dy
    for i in range(xy.shape[0]):
        x, y = xy[i, 0], xy[i, 1]
        along, down = np.float32(0), np.float32(0)
        for dy in range(-_RADIUS, _RADIUS + 1):
            r = reach[dy + _RADIUS]
            row, ramp_here = image[y + dy, x - r : x + r + 1], ramp[_RADIUS - r : _RADIUS + r + 1]
            total, moment = np.float32(0), np.float32(0)
            for k in range(2 * r + 1):
                value = np.float32(row[k])
                total += value
                moment += ramp_here[k] * value
            along += moment
            down += ramp[dy + _RADIUS] * total
        angle[i] = np.arctan2(np.float64(down), np.float64(along)) % (2 * np.pi)
