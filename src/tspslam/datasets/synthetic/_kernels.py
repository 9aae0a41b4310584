"""Compiled loops of the renderer: painting a tile, casting rays at triangles, sampling texture.

A triangle is seen from the camera's place, corners ``v``. Its edge functions are ``e_k = v_{k+1} × v_{k+2}``, turned so
that the ray r meets the triangle where all ``e_k · r >= 0``; then its inverse depth is ``(Σ e_k · r) / det(v)``, which
also holds for triangles that reach behind the camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, kernel

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]

_NEAR = 1e-3  # m; what is nearer does not widen a triangle's box
_ROUNDING = 1e-9  # of a nearness, by far
_TAPS = 8  # samples along a stretched footprint, at most


@kernel
def paint(tile: Float32, leaves: Float64) -> None:
    """Paint leaves one over the other on a tile that wraps around.

    A leaf is (column, row, half length, half width, cosine, sine, grey, round); a round one is a disc of its length.
    """
    size = tile.shape[0]
    for leaf in leaves:
        reach = int(np.ceil(leaf[2] if leaf[7] > 0 else np.hypot(leaf[2], leaf[3])))
        x, y = int(leaf[0]), int(leaf[1])
        first = (x - reach) % size
        for dy in range(-reach, reach + 1):
            row, column, s_along, s_across = (y + dy) % size, first, dy * leaf[5], dy * leaf[4]
            for dx in range(-reach, reach + 1):
                if leaf[7] > 0:
                    inside = dx * dx + dy * dy <= leaf[2] * leaf[2]
                else:
                    inside = abs(dx * leaf[4] + s_along) <= leaf[2] and abs(s_across - dx * leaf[5]) <= leaf[3]
                if inside:
                    tile[row, column] = leaf[6]
                column = column + 1 if column + 1 < size else 0


@inlined
def _box(corners: Float64, lens: Float64, width: int, height: int) -> tuple[int, int, int, int]:
    """First and last column and row that a triangle may reach."""
    low_u, low_v, high_u, high_v = 1e9, 1e9, -1e9, -1e9
    for k in range(3):
        here, there = corners[k], corners[(k + 1) % 3]
        for end in range(2):
            x, y, z = here[0], here[1], here[2]
            if end == 1:  # where the side crosses the near plane
                if (here[2] > _NEAR) == (there[2] > _NEAR):
                    continue
                share = (_NEAR - here[2]) / (there[2] - here[2])
                x, y, z = x + share * (there[0] - x), y + share * (there[1] - y), _NEAR
            elif z <= _NEAR:
                continue
            u = min(max(lens[2] + (lens[0] * x + lens[4] * y) / z, -1e9), 1e9)
            v = min(max(lens[3] + lens[1] * y / z, -1e9), 1e9)
            low_u, high_u = min(low_u, u), max(high_u, u)
            low_v, high_v = min(low_v, v), max(high_v, v)
    first, last = max(int(np.floor(low_u)) - 1, 0), min(int(np.ceil(high_u)) + 1, width - 1)
    top, bottom = max(int(np.floor(low_v)) - 1, 0), min(int(np.ceil(high_v)) + 1, height - 1)
    return first, last, top, bottom


@inlined
def _span(e: Float64, lens: Float64, row: int, first: int, last: int) -> tuple[int, int]:
    """First and last column of a row between which a triangle's rays lie, or one more on each side."""
    low, high = float(first), float(last)
    bend = abs(lens[4] / lens[1])  # px of skew in half a row, and some
    for k in range(3):
        y = (row - lens[3]) / lens[1]
        most = e[k, 1] * y + e[k, 2] + abs(e[k, 1]) / lens[1]  # of any ray of the row, but for x
        if e[k, 0] == 0:
            if most < 0:
                return 0, -1
            continue
        column = lens[0] * (-most / e[k, 0]) + lens[4] * y + lens[2]
        if e[k, 0] > 0:
            low = max(low, column - bend - 1)
        else:
            high = min(high, column + bend + 1)
    if not low <= high:
        return 0, -1
    return int(np.floor(low)), int(np.ceil(high))


@kernel
def cast(
    corners: Float64, order: Int64, lens: Float64, slot: Int32, offsets: Float64, nearness: Float64, owner: Int32
) -> None:
    """Find the nearest triangle on each ray: its number in `owner` (M, K), 1 / z in `nearness` (M, K).

    A pixel with a slot has K rays, through ``(u, v) + offsets[k]``; pixels of slot -1 are passed over. Triangles are
    cast in an order, which is fastest from the nearest on; of equally near ones the first number counts.
    """
    height, width = slot.shape
    e = np.empty((3, 3))
    for t in order:
        v = corners[t]
        nearest = min(v[0, 2], v[1, 2], v[2, 2])
        most = (1 + _ROUNDING) / nearest if nearest > 0 else np.inf
        for k in range(3):
            a, b = v[(k + 1) % 3], v[(k + 2) % 3]
            e[k, 0] = a[1] * b[2] - a[2] * b[1]
            e[k, 1] = a[2] * b[0] - a[0] * b[2]
            e[k, 2] = a[0] * b[1] - a[1] * b[0]
        volume = v[0, 0] * e[0, 0] + v[0, 1] * e[0, 1] + v[0, 2] * e[0, 2]
        if volume == 0:
            continue
        if volume < 0:
            e[:] = -e
            volume = -volume
        first, last, top, bottom = _box(v, lens, width, height)
        for row in range(top, bottom + 1):
            begin, end = _span(e, lens, row, first, last)
            for column in range(begin, end + 1):
                m = slot[row, column]
                if m < 0:
                    continue
                for k in range(offsets.shape[0]):
                    if nearness[m, k] > most:
                        continue
                    y = (row + offsets[k, 1] - lens[3]) / lens[1]
                    x = (column + offsets[k, 0] - lens[2] - lens[4] * y) / lens[0]
                    e0 = e[0, 0] * x + (e[0, 1] * y + e[0, 2])
                    if e0 < 0:
                        continue
                    e1 = e[1, 0] * x + (e[1, 1] * y + e[1, 2])
                    e2 = e[2, 0] * x + (e[2, 1] * y + e[2, 2])
                    if e1 < 0 or e2 < 0:
                        continue
                    near = (e0 + e1 + e2) / volume
                    if near > nearness[m, k] or (near == nearness[m, k] and t < owner[m, k]):
                        nearness[m, k] = near
                        owner[m, k] = t


@inlined
def _bilinear(texels: Float32, begin: int, size: int, s: float, t: float) -> float:
    """Value of one level of a tile at texel coordinates, which wrap around; sizes are powers of two."""
    left, top = int(np.floor(s)), int(np.floor(t))
    fs, ft = s - left, t - top
    mask = size - 1
    x0, x1 = left & mask, (left + 1) & mask
    y0, y1 = begin + (top & mask) * size, begin + ((top + 1) & mask) * size
    above = texels[np.uint64(y0 + x0)] * (1 - fs) + texels[np.uint64(y0 + x1)] * fs
    below = texels[np.uint64(y1 + x0)] * (1 - fs) + texels[np.uint64(y1 + x1)] * fs
    return above * (1 - ft) + below * ft


@inlined
def _between(footprint: float, deepest: int) -> tuple[int, float]:
    """Finer of the two levels of a tile that fit a footprint in texels, and the share of the coarser."""
    level = min(max(np.log2(max(footprint, 1e-12)), 0.0), float(deepest))
    low = min(int(level), max(deepest - 1, 0))
    return low, level - low


@inlined
def _trilinear(texels: Float32, levels: Int64, tile: int, s: float, t: float, low: int, share: float) -> float:
    """Value of a tile at texel coordinates of its finest level, between two levels, see `_between`.

    `levels` are how many each tile has, and where each begins.
    """
    deepest = levels[tile, 0] - 1
    value = 0.0
    for k in range(2):
        weight = 1 - share if k == 0 else share
        if weight > 0:
            shrink = 1.0 / (1 << (low + k))
            s_there, t_there = (s + 0.5) * shrink - 0.5, (t + 0.5) * shrink - 0.5
            value += weight * _bilinear(texels, levels[tile, 1 + low + k], 1 << (deepest - low - k), s_there, t_there)
    return value


@inlined
def _slope(v: Float64, coordinates: Float64, gradient: Float64) -> None:
    """Rows S of both coordinates of a triangle's texture, and n, see `shade`."""
    gradient[:] = 0
    for c in range(3):
        a, b = v[(c + 1) % 3], v[(c + 2) % 3]
        for axis in range(3):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            e = a[i] * b[j] - a[j] * b[i]
            gradient[0, axis] += coordinates[c, 0] * e
            gradient[1, axis] += coordinates[c, 1] * e
            gradient[2, axis] += e


@kernel
def shade(
    pixels: Int64, offsets: Float64, width: int, owner: Int32, lens: Float64, corners: Float64, coordinates: Float64,
    paint_of: Int32, looks: Float64, texels: Float32, levels: Int64, values: Float64,
) -> None:  # fmt: skip
    """Luminance that each ray of `cast` meets, into `values`, where a triangle is met.

    A ray goes through ``(u, v) + offsets[k]`` of a pixel, number ``width v + u``. A coordinate of the texture is
    ``s = (S · r) / (n · r)``, with ``S = Σ s_k e_k`` and ``n = Σ e_k``, whose derivatives by the pixel give its
    footprint. `paint_of` (F, 2) is a triangle's tile and its look: (texels per metre, offsets, brightness, contrast,
    texels per metre and offsets of a second, coarser layer).
    """
    gradient, before = np.empty((3, 3)), -1
    for m in range(owner.shape[0]):
        row, column = pixels[m] // width, pixels[m] % width
        for k in range(owner.shape[1]):
            triangle = owner[m, k]
            if triangle < 0:
                continue
            if triangle != before:
                _slope(corners[triangle], coordinates[triangle], gradient)
                before = triangle
            y = (row + offsets[k, 1] - lens[3]) / lens[1]
            x = (column + offsets[k, 0] - lens[2] - lens[4] * y) / lens[0]
            depth = 1 / (gradient[2, 0] * x + gradient[2, 1] * y + gradient[2, 2])
            s = (gradient[0, 0] * x + gradient[0, 1] * y + gradient[0, 2]) * depth
            t = (gradient[1, 0] * x + gradient[1, 1] * y + gradient[1, 2]) * depth
            s_x, s_y = (gradient[0, 0] - s * gradient[2, 0]) * depth, (gradient[0, 1] - s * gradient[2, 1]) * depth
            t_x, t_y = (gradient[1, 0] - t * gradient[2, 0]) * depth, (gradient[1, 1] - t * gradient[2, 1]) * depth
            slant = lens[4] / (lens[0] * lens[1])
            su, tu, sv, tv = s_x / lens[0], t_x / lens[0], s_y / lens[1] - slant * s_x, t_y / lens[1] - slant * t_x
            across, down = np.hypot(su, tu), np.hypot(sv, tv)
            if across > down:
                long_s, long_t, long, short = su, tu, across, down
            else:
                long_s, long_t, long, short = sv, tv, down, across
            taps = min(max(int(np.ceil(long / max(short, 1e-12))), 1), _TAPS)
            tile, look = paint_of[triangle, 0], looks[paint_of[triangle, 1]]
            footprint, deepest = max(short, long / taps), levels[tile, 0] - 1
            is_layered = look[5] > 0
            fine, fine_share = _between(footprint * look[0], deepest)
            coarse, coarse_share = _between(footprint * look[5], deepest) if is_layered else (0, 0.0)
            total = 0.0
            for tap in range(taps):
                off = (tap + 0.5) / taps - 0.5
                s_tap, t_tap = s + off * long_s, t + off * long_t
                s_fine, t_fine = s_tap * look[0] + look[1], t_tap * look[0] + look[2]
                total += _trilinear(texels, levels, tile, s_fine, t_fine, fine, fine_share)
                if is_layered:
                    s_coarse, t_coarse = s_tap * look[5] + look[6], t_tap * look[5] + look[7]
                    total += _trilinear(texels, levels, tile, s_coarse, t_coarse, coarse, coarse_share)
            mean = total / (taps * (2 if is_layered else 1))
            values[m, k] = min(max(look[3] + look[4] * (mean - 0.5), 0.0), 1.0)
