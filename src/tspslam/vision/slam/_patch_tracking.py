"""Compiled loops of patch tracking: patches of one image found again in another, in two dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, kernel, reassociated_kernel

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

_MIN_VARIANCE = np.float32(1.0)  # grey levels squared; below it a window has no texture
_CONVERGED, _STEPS = 0.01, 12  # px; iterations
_PLACES = 512  # of a sample between two pixels
_MIN_SHAPE = 0.02  # smaller eigenvalue of the normal matrix over the larger one, about


@inlined
def cubic_taps(f: float, taps: Float32) -> None:
    """Weights of four points (Catmull-Rom) for a sample at f in [0, 1) after the second."""
    taps[0] = ((-0.5 * f + 1.0) * f - 0.5) * f
    taps[1] = (1.5 * f - 2.5) * f * f + 1.0
    taps[2] = ((-1.5 * f + 2.0) * f + 0.5) * f
    taps[3] = (0.5 * f - 0.5) * f * f


def _table() -> Float32:
    """Taps for all places between two pixels, to 1/1024 px."""
    taps = np.empty((_PLACES + 1, 4), np.float32)
    for k in range(_PLACES + 1):
        cubic_taps.py_func(k / _PLACES, taps[k])
    return taps


_TAPS = _table()
_ONE, _TWO, _THREE = np.uint64(1), np.uint64(2), np.uint64(3)  # plain steps of indices that are never negative


@reassociated_kernel
def _sample_warped(image: Float32, place: Float64, warp: Float64, out: Float32) -> bool:
    """Fill `out` with samples at ``place + warp · offset``; False if any lies outside."""
    height, width = image.shape
    side, reach = out.shape[0], out.shape[0] // 2
    far_u = (abs(warp[0, 0]) + abs(warp[0, 1])) * reach + 2
    far_v = (abs(warp[1, 0]) + abs(warp[1, 1])) * reach + 2
    if not (far_u <= place[0] < width - far_u - 1 and far_v <= place[1] < height - far_v - 1):
        return False
    for a in range(side):
        for b in range(side):
            u = place[0] + warp[0, 0] * (b - reach) + warp[0, 1] * (a - reach) - 1
            v = place[1] + warp[1, 0] * (b - reach) + warp[1, 1] * (a - reach) - 1
            x, y = np.uint64(u), np.uint64(v)
            across, down = _TAPS[np.uint64((u - x) * _PLACES + 0.5)], _TAPS[np.uint64((v - y) * _PLACES + 0.5)]
            value = np.float32(0)
            for k in range(4):
                row = y + np.uint64(k)
                value += down[k] * (
                    across[0] * image[row, x] + across[1] * image[row, x + _ONE]
                    + across[2] * image[row, x + _TWO] + across[3] * image[row, x + _THREE]
                )  # fmt: skip
            out[a, b] = value
    return True


@reassociated_kernel
def _sample_shifted(image: Float32, u: float, v: float, taps: Float32, rows: Float32, out: Float32) -> bool:
    """Fill `out` with the square window centred on (u, v); False if it leaves the image."""
    height, width = image.shape
    side = out.shape[0]
    left, top = u - side // 2, v - side // 2
    x, y = int(np.floor(left)), int(np.floor(top))
    if x < 1 or y < 1 or x + side + 2 > width or y + side + 2 > height:
        return False
    cubic_taps(left - x, taps)
    t0, t1, t2, t3 = taps[0], taps[1], taps[2], taps[3]
    for a in range(side + 3):
        line = image[y - 1 + a, x - 1 : x + side + 2]
        for k in range(side):
            rows[a, k] = t0 * line[k] + t1 * line[k + 1] + t2 * line[k + 2] + t3 * line[k + 3]
    cubic_taps(top - y, taps)
    t0, t1, t2, t3 = taps[0], taps[1], taps[2], taps[3]
    for a in range(side):
        for k in range(side):
            out[a, k] = t0 * rows[a, k] + t1 * rows[a + 1, k] + t2 * rows[a + 2, k] + t3 * rows[a + 3, k]
    return True


@reassociated_kernel
def _prepare(
    patch: Float32, contrast: float, weight: Float32, template: Float32, gu: Float32, gv: Float32, normal: Float64
) -> bool:
    """Weights, centred template and gradients of a patch with a margin of 1 px; False where it estimates no place.

    `normal` receives the moments uu, uv, vv of the gradients and the variance of the template.
    """
    side = template.shape[0]
    r = side // 2
    middle, slope, total = patch[r + 1, r + 1], np.float32(contrast), np.float32(0)
    for a in range(side):
        for b in range(side):
            other = (patch[a + 1, b + 1] - middle) * slope
            away = np.float32((a - r) * (a - r) + (b - r) * (b - r)) / np.float32(r * r)
            w = np.float32(1) / ((np.float32(1) + other * other) * (np.float32(1) + away))
            weight[a, b] = w
            total += w
    mt, mu, mv = np.float32(0), np.float32(0), np.float32(0)
    half = np.float32(0.5)
    for a in range(side):
        for b in range(side):
            w = weight[a, b] / total
            weight[a, b] = w
            template[a, b] = patch[a + 1, b + 1]
            gu[a, b] = half * (patch[a + 1, b + 2] - patch[a + 1, b])
            gv[a, b] = half * (patch[a + 2, b + 1] - patch[a, b + 1])
            mt += w * template[a, b]
            mu += w * gu[a, b]
            mv += w * gv[a, b]
    uu, uv, vv, tt = np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    for a in range(side):
        for b in range(side):
            w = weight[a, b]
            template[a, b] -= mt
            gu[a, b] -= mu
            gv[a, b] -= mv
            uu += w * gu[a, b] * gu[a, b]
            uv += w * gu[a, b] * gv[a, b]
            vv += w * gv[a, b] * gv[a, b]
            tt += w * template[a, b] * template[a, b]
    normal[0], normal[1], normal[2], normal[3] = uu, uv, vv, tt
    return bool(tt > _MIN_VARIANCE and uu * vv - uv * uv > _MIN_SHAPE * (uu + vv) * (uu + vv))


@reassociated_kernel
def _moments(
    window: Float32, weight: Float32, template: Float32, gu: Float32, gv: Float32
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    """Weighted mean and square of a window, and its products with the template and the gradients; all flat."""
    zero = np.float32(0)
    mean, square, shared, along, down = zero, zero, zero, zero, zero
    for k in range(window.shape[0]):
        w = weight[k] * window[k]
        mean += w
        square += w * window[k]
        shared += w * template[k]
        along += w * gu[k]
        down += w * gv[k]
    return mean, square, shared, along, down


@kernel
def track_level(
    reference: Float32, current: Float32, place: Float64, warp: Float64, radius: int, contrast: float, reach: float,
    uv: Float64, score: Float64,
) -> None:  # fmt: skip
    """Find patches of the reference around `place` (N, 2) again near `uv` (N, 2), which is improved in place.

    Inverse compositional alignment (Baker and Matthews 2004) with gain and offset of brightness. `warp` (N, 2, 2)
    takes offsets in the current image to offsets in the reference. `score` (N,) receives the correlation, -1 where
    the iteration did not converge within `reach` px of its start; `uv` then stays.
    """
    side = 2 * radius + 1
    patch, weight = np.empty((side + 2, side + 2), np.float32), np.empty((side, side), np.float32)
    template, gu, gv = np.empty_like(weight), np.empty_like(weight), np.empty_like(weight)
    window, rows = np.empty_like(weight), np.empty((side + 3, side), np.float32)
    flat = window.ravel(), weight.ravel(), template.ravel(), gu.ravel(), gv.ravel()
    taps, normal = np.empty(4, np.float32), np.empty(4)
    for i in range(place.shape[0]):
        score[i] = -1
        if not _sample_warped(reference, place[i], warp[i], patch):
            continue
        if not _prepare(patch, contrast, weight, template, gu, gv, normal):
            continue
        uu, cross, vv, variance = normal[0], normal[1], normal[2], normal[3]
        determinant = uu * vv - cross * cross
        _, _, _, along0, down0 = _moments(flat[2], flat[1], flat[2], flat[3], flat[4])
        u, v = uv[i, 0], uv[i, 1]
        for _ in range(_STEPS):
            if not _sample_shifted(current, u, v, taps, rows, window):
                break
            mean, square, shared, along, over = _moments(flat[0], flat[1], flat[2], flat[3], flat[4])
            spread = square - mean * mean
            if spread < _MIN_VARIANCE or shared <= 0:
                break
            gain = shared / spread
            a, b = gain * along - along0, gain * over - down0
            du, dv = (vv * a - cross * b) / determinant, (uu * b - cross * a) / determinant
            u -= min(max(du, -2.0), 2.0)
            v -= min(max(dv, -2.0), 2.0)
            if abs(u - uv[i, 0]) > reach or abs(v - uv[i, 1]) > reach:
                break
            if abs(du) + abs(dv) < _CONVERGED:
                uv[i, 0], uv[i, 1], score[i] = u, v, shared / np.sqrt(variance * spread)
                break
