"""Compiled loops of matching: correlation along rows, sub-pixel alignment.

Images are float32 planes in grey levels (0 to 255). All patches carry the support weights of `support_weights`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, kernel, reassociated_kernel
from .._sampling import LANES, add_correlations, prefetch_square, row_moments

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Moments = tuple[np.float32, ...]

_MIN_VARIANCE = np.float32(1e-2)  # grey levels squared; below it a patch has no texture


@reassociated_kernel
def support_weights(image: Float32, x: int, y: int, radius: int, contrast: float, weight: Float32) -> None:
    """Fill `weight` with a patch's weights, which sum to 1: near its centre in place and in grey level counts more.

    w = 1 / ((1 + (difference · contrast)²)(1 + (distance / radius)²)), so that a patch at a depth edge leans on
    its centre's side.
    """
    centre = image[y, x]
    per_square = np.float32(1.0 / (radius * radius))
    slope = np.float32(contrast)
    total = np.float32(0)
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            difference = (image[y + dy, x + dx] - centre) * slope
            away = np.float32(dx * dx + dy * dy) * per_square
            w = np.float32(1) / ((np.float32(1) + difference * difference) * (np.float32(1) + away))
            weight[dy + radius, dx + radius] = w
            total += w
    scale = np.float32(1) / total
    for row in range(2 * radius + 1):
        for column in range(2 * radius + 1):
            weight[row, column] *= scale


@reassociated_kernel
def correlate(
    images: tuple[Float32, Float32], width: int, x: int, y: int, radius: int, begin: int, count: int, weight: Float32,
    scratch: Float32,
) -> Float32:  # fmt: skip
    """Weighted correlation of one patch with the patches of the other image centred at begin, begin + 1, ...

    Images are flat. Of `scratch`, three times ``count + LANES`` are used; the part of it with the coefficients is
    returned.
    """
    side, pitch, top = 2 * radius + 1, weight.shape[1], (y - radius) * width
    length = -(-count // LANES) * LANES
    first, second = top + x - radius, top + begin - radius
    early = max(0, second + (side - 1) * (width + 1) + length - len(images[1]))  # no pixel after the image is read
    mean, square, middle = np.float32(0), np.float32(0), images[0][y * width + x]
    for row in range(side):
        here = images[0][first + row * width : first + row * width + side]
        for column in range(side):
            value = here[column] - middle
            weighted = weight[row, column] * value
            mean += weighted
            square += weighted * value
    for at in range(0, length, LANES):
        add_correlations(
            images[0],
            first,
            images[1],
            second - early + at,
            width,
            weight.ravel(),
            side,
            pitch,
            scratch,
            at,
            length,
            middle,
        )
    shared, others, squares = scratch[:length], scratch[length : 2 * length], scratch[2 * length : 3 * length]
    variance = max(square - mean * mean, _MIN_VARIANCE)
    for k in range(length):
        other_variance = max(squares[k] - others[k] * others[k], _MIN_VARIANCE)
        shared[k] = (shared[k] - mean * others[k]) / np.sqrt(variance * other_variance)
    return shared[early : early + count]


@inlined
def peak_and_rival(scores: Float32) -> tuple[int, np.float32, np.float32]:
    """Place and value of the largest score, and the largest one more than two places away (-1 if none is)."""
    best = 0
    for k in range(1, scores.shape[0]):
        if scores[k] > scores[best]:
            best = k
    rival = np.float32(-1)
    for k in range(scores.shape[0]):
        if abs(k - best) > 2 and scores[k] > rival:
            rival = scores[k]
    return best, scores[best], rival


@kernel
def search_rows(
    image: Float32, other: Float32, xy: Int64, shift: Int64, radius: int, contrast: float, found: Float64
) -> None:
    """Search the other image's row for the patch around each pixel.

    Parameters
    ----------
    image, other : (H, W) float32
        Grey levels.
    xy : (N, 2) int64
        Centres of the patches, px.
    shift : (N, 2) int64
        First and last displacement x_other - x to try, px.
    radius : int
        Half width of each patch, px.
    contrast : float
        Of the support weights, per grey level.
    found : (N, 3) float64
        Receives the best displacement, its correlation and that of the best rival; correlation -1 where the patch or
        all of the range leaves the image.
    """
    height, width = image.shape
    widest = 2 * radius + 1
    weight = np.empty((widest, -(-widest // LANES) * LANES), np.float32)
    weight[:] = 0
    scratch, images = np.empty(3 * (width + LANES), np.float32), (image.ravel(), other.ravel())
    for i in range(xy.shape[0]):
        x, y, r = xy[i, 0], xy[i, 1], radius
        if i + 1 < xy.shape[0]:
            near = xy[i + 1, 0], xy[i + 1, 0] + shift[i + 1, 0]
            for k in range(2):  # one call, as each copy takes time to compile; so below
                prefetch_square(images[k], image.shape, near[k], xy[i + 1, 1], radius)
        begin = max(x + shift[i, 0], r)
        count = min(x + shift[i, 1], width - 1 - r) - begin + 1
        found[i, 0] = 0
        found[i, 1] = -1
        found[i, 2] = -1
        if count < 1 or x < r or x >= width - r or y < r or y >= height - r:
            continue
        if (widest - 1) * (width + 1) + count + LANES > height * width:  # hardly higher than the patch
            continue
        support_weights(image, x, y, r, contrast, weight)
        best, score, rival = peak_and_rival(correlate(images, width, x, y, r, begin, count, weight, scratch))
        found[i, 0] = begin + best - x
        found[i, 1] = score
        found[i, 2] = rival


@inlined
def lagrange_taps(f: float, taps: Float32) -> None:
    """Six-point Lagrange weights for a sample at f in [0, 1) after the third point."""
    a, b, c, d, e = f + 2, f + 1, f - 1, f - 2, f - 3
    taps[0] = -b * f * c * d * e / 120
    taps[1] = a * f * c * d * e / 24
    taps[2] = -a * b * c * d * e / 12
    taps[3] = a * b * f * d * e / 12
    taps[4] = -a * b * f * c * e / 24
    taps[5] = a * b * f * c * d / 120


@inlined
def solve_step(
    sums: Moments,
) -> tuple[float, float, float]:
    """Least squares l ≈ gain · (r + step · g) + offset: step, gain, correlation; gain 0 where there is no texture."""
    ml, mr, mg = np.float64(sums[0]), np.float64(sums[1]), np.float64(sums[2])
    ll, lr, lg = sums[3] - ml * ml, sums[4] - ml * mr, sums[5] - ml * mg
    rr, rg, gg = sums[6] - mr * mr, sums[7] - mr * mg, sums[8] - mg * mg
    determinant = rr * gg - rg * rg
    if ll < _MIN_VARIANCE or rr < _MIN_VARIANCE or determinant <= 1e-6 * rr * gg:
        return 0.0, 0.0, 0.0
    gain = (lr * gg - lg * rg) / determinant
    slope = (lg * rr - lr * rg) / determinant
    if gain < 0.1:
        return 0.0, 0.0, 0.0
    return slope / gain, gain, lr / np.sqrt(ll * rr)


@kernel
def align_one(
    images: tuple[Float32, Float32], shape: tuple[int, int], x: int, y: int, radius: int, start: float, taps: Float32,
    weight: Float32,
) -> tuple[float, float, float, bool]:  # fmt: skip
    """Iterate `solve_step` until it moves by less than 0.004 px: displacement, correlation, gain, success."""
    shift, score, gain = start, 0.0, 0.0
    (height, width), side, top = shape, 2 * radius + 1, (y - radius) * shape[1]
    blocks = len(weight) // (side * LANES)
    last = height * width - (side - 1) * width - blocks * LANES - 7  # beyond which pixels after the image are read
    first, middle = top + x - radius - 1, images[0][y * width + x]
    for _ in range(12):
        whole = np.floor(shift)
        column = x + int(whole)
        second = top + column - radius - 3
        if abs(shift - start) > 2.0 or column - radius < 3 or column + radius + 4 >= width:
            return shift, score, gain, False
        if max(first, second) > last:
            return shift, score, gain, False
        lagrange_taps(shift - whole, taps)
        sums = row_moments(images[0], first, images[1], second, width, taps, weight, side, blocks, middle)
        step, gain, score = solve_step(sums)
        if gain == 0.0:
            return shift, score, gain, False
        shift += min(max(step, -1.0), 1.0)
        if abs(step) < 0.004:
            return shift, score, gain, True
    return shift, score, gain, False


@kernel
def align_rows(
    image: Float32, other: Float32, xy: Int64, start: Float64, radius: int, contrast: float, found: Float64
) -> None:
    """Refine displacements along rows to a fraction of a pixel.

    `found` (N, 4) receives displacement x_other - x in px, correlation, gain, and 1 where the iteration converged
    within 2 px of its start (0 elsewhere). Other parameters as in `search_rows`.
    """
    height, width = image.shape
    side = 2 * radius + 1
    weight = np.empty((side, -(-side // LANES) * LANES), np.float32)
    weight[:] = 0
    taps, flat, images = np.empty(6, np.float32), weight.ravel(), (image.ravel(), other.ravel())
    for i in range(xy.shape[0]):
        x, y, r = xy[i, 0], xy[i, 1], radius
        if i + 1 < xy.shape[0]:
            near = np.float64(xy[i + 1, 0]), xy[i + 1, 0] + start[i + 1]
            for k in range(2):
                prefetch_square(images[k], image.shape, near[k], xy[i + 1, 1], radius + 1 + 2 * k)
        found[i, :] = 0
        if x <= r or x >= width - r - 1 or y < r or y >= height - r:
            continue
        support_weights(image, x, y, r, contrast, weight)
        shift, score, gain, ok = align_one(images, image.shape, x, y, r, start[i], taps, flat)
        found[i, 0], found[i, 1], found[i, 2], found[i, 3] = shift, score, gain, ok


@inlined
def sample_window(
    image: Float32, column: int, row: int, taps_u: Float32, taps_v: Float32, rows: Float32, out: Float32
) -> None:
    """Interpolate a square patch whose first sample lies after (column, row), by six points in each direction."""
    side = out.shape[0]
    for a in range(side + 5):
        line = image[row - 2 + a]
        for k in range(side):
            p = column + k
            value = np.float32(0)
            for t in range(6):
                value += taps_u[t] * line[p - 2 + t]
            rows[a, k] = value
    for a in range(side):
        for k in range(side):
            value = np.float32(0)
            for t in range(6):
                value += taps_v[t] * rows[a + t, k]
            out[a, k] = value


@inlined
def window_normal(left: Float32, patch: Float32, x: int, y: int, radius: int, weight: Float32, normal: Float64) -> None:
    """Centred normal equations of l ≈ gain · r + a · g_u + b · g_v + offset, as the 4x4 moments of (r, g_u, g_v, l)."""
    mean, values = np.empty(4), np.empty(4)
    mean[:], normal[:] = 0, 0
    for dy in range(2 * radius + 1):
        for dx in range(2 * radius + 1):
            p, q, a, b = x - radius + dx, y - radius + dy, dy + 1, dx + 1
            values[0] = patch[a, b]
            values[1] = 0.25 * (patch[a, b + 1] - patch[a, b - 1] + left[q, p + 1] - left[q, p - 1])
            values[2] = 0.25 * (patch[a + 1, b] - patch[a - 1, b] + left[q + 1, p] - left[q - 1, p])
            values[3] = left[q, p]
            for m in range(4):
                mean[m] += weight[dy, dx] * values[m]
                for n in range(4):
                    normal[m, n] += weight[dy, dx] * values[m] * values[n]
    for m in range(4):
        for n in range(4):
            normal[m, n] -= mean[m] * mean[n]


@inlined
def determinant3(n: Float64, a: int, b: int, c: int) -> float:
    """Return the determinant of three columns of a matrix's first three rows."""
    first = n[0, a] * (n[1, b] * n[2, c] - n[2, b] * n[1, c])
    second = n[0, b] * (n[1, a] * n[2, c] - n[2, a] * n[1, c])
    return first - second + n[0, c] * (n[1, a] * n[2, b] - n[2, a] * n[1, b])


@inlined
def plane_step(n: Float64) -> tuple[float, float, bool]:
    """Steps in u and v from the moments of `window_normal`; False where the patch does not fix both."""
    whole = determinant3(n, 0, 1, 2)
    if whole <= 1e-4 * n[0, 0] * n[1, 1] * n[2, 2] or n[3, 3] < _MIN_VARIANCE:
        return 0.0, 0.0, False
    gain = determinant3(n, 3, 1, 2) / whole
    if gain < 0.1:
        return 0.0, 0.0, False
    return determinant3(n, 0, 3, 2) / whole / gain, determinant3(n, 0, 1, 3) / whole / gain, True


@kernel
def align_plane(
    image: Float32, other: Float32, xy: Int64, start: Float64, radius: int, contrast: float, found: Float64
) -> None:
    """Refine displacements in both directions.

    `found` (N, 3), zeros at first, receives x_other - x and y_other - y in px, and 1 where the iteration converged.
    """
    height, width = image.shape
    side = 2 * radius + 1
    weight = np.empty((side, side), np.float32)
    patch, rows = np.empty((side + 2, side + 2), np.float32), np.empty((side + 7, side + 2), np.float32)
    taps_u, taps_v, normal = np.empty(6, np.float32), np.empty(6, np.float32), np.empty((4, 4))
    margin = radius + 1
    for i in range(xy.shape[0]):
        x, y = xy[i, 0], xy[i, 1]
        if x < margin or x >= width - margin or y < margin or y >= height - margin:
            continue
        support_weights(image, x, y, radius, contrast, weight)
        u, v = start[i], 0.0
        for _ in range(10):
            p, q = int(np.floor(u)), int(np.floor(v))
            column, row = x + p - margin, y + q - margin
            if abs(v) > 3 or abs(u - start[i]) > 2 or min(column, row) < 2:
                break
            if column + side + 6 > width or row + side + 6 > height:
                break
            lagrange_taps(u - p, taps_u)
            lagrange_taps(v - q, taps_v)
            sample_window(other, column, row, taps_u, taps_v, rows, patch)
            window_normal(image, patch, x, y, radius, weight, normal)
            du, dv, solved = plane_step(normal)
            if not solved:
                break
            u += min(max(du, -1.0), 1.0)
            v += min(max(dv, -1.0), 1.0)
            if abs(du) + abs(dv) < 0.005:
                found[i, 0], found[i, 1], found[i, 2] = u, v, 1.0
                break
