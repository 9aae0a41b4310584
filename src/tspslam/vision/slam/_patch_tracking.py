"""Compiled loops of patch tracking: patches of one image found again in another, in two dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, kernel, reassociated_kernel
from .._sampling import LANES, prefetch_square, sample_cubic, window_moments

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Moments = tuple[np.float32, ...]

_MIN_VARIANCE = np.float32(1.0)  # grey levels squared; below it a window has no texture
_CONVERGED, _STEPS = 0.01, 12  # px; iterations
_PLACES = 512  # of a sample between two pixels
_WHOLE, _HIDDEN = float(1 << 32), 23  # parts of a pixel; their bits that are too small for a place
_MIN_SHAPE = 0.02  # smaller eigenvalue of the normal matrix over the larger one, about


@kernel
def aim(
    lens: Float64, size: Int64, xyz: Float64, landmark: Int64, T_reference: Float64, T_current: Float64,
    min_depth: float, max_zoom: float, warp: Float64, guess: Float64, in_view: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Fill `guess` (K, 2) with where a camera sees landmarks, `warp` (K, 2, 2) with what it does to their patches.

    `in_view` (K,) tells which lie within its image of `size` (width, height), at least `min_depth` before it, and at
    most `max_zoom` times nearer or farther than in the reference. Poses are ``T_world_camera``; `lens` begins with fx,
    fy, cx, cy, skew. Warps are for patches that face the reference (`patch_tracking.compute_warps`).
    """
    fx, fy, cx, cy, skew = lens[0], lens[1], lens[2], lens[3], lens[4]
    R = np.empty((3, 3))  # from the reference to the current camera
    R[:] = 0
    for i in range(3):
        for j in range(3):
            for k in range(3):
                R[i, j] += T_current[k, i] * T_reference[k, j]
    for m in range(landmark.shape[0]):
        X, x, y, z, before = xyz[landmark[m]], 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            away = X[k] - T_current[k, 3]
            x, y, z = x + away * T_current[k, 0], y + away * T_current[k, 1], z + away * T_current[k, 2]
            before += (X[k] - T_reference[k, 3]) * T_reference[k, 2]
        ratio, tilt_x, tilt_y = before / z, x / z, y / z
        u, v = cx + fx * tilt_x + skew * tilt_y, cy + fy * tilt_y
        guess[m, 0], guess[m, 1] = u, v
        is_alike = z > min_depth and ratio < max_zoom and ratio * max_zoom > 1
        in_view[m] = is_alike and 0 <= u <= size[0] - 1 and 0 <= v <= size[1] - 1
        # d(u, v) in the current image by d(u, v) in the reference
        uu, uv = ratio * (R[0, 0] - tilt_x * R[2, 0]), ratio * (R[0, 1] - tilt_x * R[2, 1]) * (fx / fy)
        vu, vv = ratio * (R[1, 0] - tilt_y * R[2, 0]) * (fy / fx), ratio * (R[1, 1] - tilt_y * R[2, 1])
        determinant = uu * vv - uv * vu
        warp[m, 0, 0], warp[m, 0, 1] = vv / determinant, -uv / determinant
        warp[m, 1, 0], warp[m, 1, 1] = -vu / determinant, uu / determinant


@inlined
def cubic_taps(f: float, taps: Float32) -> None:
    """Weights of four points (Catmull-Rom) for a sample at f in [0, 1) after the second."""
    taps[0] = ((-0.5 * f + 1.0) * f - 0.5) * f
    taps[1] = (1.5 * f - 2.5) * f * f + 1.0
    taps[2] = ((-1.5 * f + 2.0) * f + 0.5) * f
    taps[3] = (0.5 * f - 0.5) * f * f


def _table() -> Float32:
    """Taps for all places between two pixels, to 1/1024 px, four after four."""
    taps = np.empty((_PLACES, 4), np.float32)
    for k in range(_PLACES):
        cubic_taps.py_func(k / _PLACES, taps[k])
    return taps.ravel()


_TAPS = _table()


@reassociated_kernel
def _sample_warped(image: Float32, place: Float64, warp: Float64, out: Float32) -> bool:
    """Fill `out` with samples at ``place + warp · offset``; False if any lies outside.

    Places are whole numbers of 2⁻³² px: of these, the upper half is the pixel, and the next nine bits are its taps.
    """
    height, width = image.shape
    side, reach = out.shape[0], out.shape[0] // 2
    far_u = (abs(warp[0, 0]) + abs(warp[0, 1])) * reach + 2
    far_v = (abs(warp[1, 0]) + abs(warp[1, 1])) * reach + 2
    if not (far_u <= place[0] < width - far_u - 1 and far_v <= place[1] < height - far_v - 1):
        return False
    flat, half = image.ravel(), 1 << (_HIDDEN - 1)
    uu, uv = np.int64(warp[0, 0] * _WHOLE), np.int64(warp[0, 1] * _WHOLE)
    vu, vv = np.int64(warp[1, 0] * _WHOLE), np.int64(warp[1, 1] * _WHOLE)
    first_u = np.int64((place[0] - 1) * _WHOLE) - reach * (uu + uv) + half
    first_v = np.int64((place[1] - 1) * _WHOLE) - reach * (vu + vv) + half
    for a in range(side):
        u, v = first_u + a * uv, first_v + a * vv
        for b in range(side):
            across, down = ((u >> _HIDDEN) & (_PLACES - 1)) * 4, ((v >> _HIDDEN) & (_PLACES - 1)) * 4
            out[a, b] = sample_cubic(flat, (v >> 32) * width + (u >> 32), width, _TAPS, across, down)
            u += uu
            v += vu
    return True


@inlined
def _falls_off(radius: int, away: Float32) -> None:
    """Fill `away` with what divides the weights of pixels away from the centre: 1 + (distance / radius)²."""
    for a in range(2 * radius + 1):
        for b in range(2 * radius + 1):
            square = (a - radius) * (a - radius) + (b - radius) * (b - radius)
            away[a, b] = np.float32(1) + np.float32(square) / np.float32(radius * radius)


@reassociated_kernel
def _prepare(
    patch: Float32, contrast: float, away: Float32, weight: Float32, template: Float32, gu: Float32, gv: Float32
) -> Moments:
    """Weights, template and gradients of a patch with a margin of 1 px, grey levels less that of its centre.

    Returns the weights' sum; the weighted means t, u, v of template and gradients; their moments tt, tu, tv, uu, uv, vv
    about these.
    """
    side = template.shape[0]
    middle, slope = patch[side // 2 + 1, side // 2 + 1], np.float32(contrast)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    total, t, u, v, tt, tu, tv, uu, uv, vv = zero, zero, zero, zero, zero, zero, zero, zero, zero, zero
    for a in range(side):
        above, here, below = patch[a], patch[a + 1], patch[a + 2]
        for b in range(side):  # rows may be longer
            level = here[b + 1] - middle
            other = level * slope
            w = one / ((one + other * other) * away[a, b])
            along, down = half * (here[b + 2] - here[b]), half * (below[b + 1] - above[b + 1])
            weight[a, b], template[a, b], gu[a, b], gv[a, b] = w, level, along, down
            wt, wu, wv = w * level, w * along, w * down
            total, t, u, v = total + w, t + wt, u + wu, v + wv
            tt, tu, tv = tt + wt * level, tu + wt * along, tv + wt * down
            uu, uv, vv = uu + wu * along, uv + wu * down, vv + wv * down
    scale = one / total
    t, u, v = t * scale, u * scale, v * scale
    return (
        total, t, u, v, tt * scale - t * t, tu * scale - t * u, tv * scale - t * v, uu * scale - u * u,
        uv * scale - u * v, vv * scale - v * v,
    )  # fmt: skip


@kernel
def track_level(
    reference: Float32, current: Float32, place: Float64, warp: Float64, size: float, radius: int, contrast: float,
    reach: float, uv: Float64, score: Float64,
) -> None:  # fmt: skip
    """Find patches of the reference around `place` (N, 2) again near `uv` (N, 2), which is improved in place.

    Both are px of the full size, of which one at this level is `size`; `reach` is px of the level.
    Inverse compositional alignment (Baker and Matthews 2004) with gain and offset of brightness. `warp` (N, 2, 2)
    takes offsets in the current image to offsets in the reference. `score` (N,) receives the correlation, -1 where
    the iteration did not converge within `reach` px of its start; `uv` then stays.
    """
    side = 2 * radius + 1
    patch, away = np.empty((side + 2, side + 2), np.float32), np.empty((side, side), np.float32)
    blocks = -(-side // LANES)
    factors = np.empty((4, side, blocks * LANES), np.float32)
    factors[:] = 0
    weight, template, gu, gv, flat = factors[0], factors[1], factors[2], factors[3], factors.ravel()
    taps, images, here = np.empty(8, np.float32), (reference.ravel(), current.ravel()), np.empty(2)
    across, down = taps[:4], taps[4:]
    height, width = current.shape
    last = height * width - (side + 2) * width - blocks * LANES - 3  # beyond which pixels after the image are read
    _falls_off(radius, away)
    for i in range(place.shape[0]):
        score[i] = -1
        if i + 1 < place.shape[0]:
            coming = place[i + 1], uv[i + 1]
            for k in range(2):  # one call, as each copy takes time to compile
                prefetch_square(images[k], current.shape, coming[k][0] / size, coming[k][1] / size, radius + 3)
        here[0], here[1] = place[i, 0] / size, place[i, 1] / size
        if not _sample_warped(reference, here, warp[i], patch):
            continue
        prepared = _prepare(patch, contrast, away, weight, template, gu, gv)
        total, mean_t, mean_u, mean_v, variance, along0, down0, uu, cross, vv = prepared
        determinant = uu * vv - cross * cross
        if not (variance > _MIN_VARIANCE and determinant > _MIN_SHAPE * (uu + vv) * (uu + vv)):
            continue
        start_u, start_v, middle = uv[i, 0] / size, uv[i, 1] / size, patch[radius + 1, radius + 1]
        u, v = start_u, start_v
        for _ in range(_STEPS):
            left, top = u - radius, v - radius
            x, y = int(np.floor(left)), int(np.floor(top))
            first = (y - 1) * width + x - 1
            if x < 1 or y < 1 or x + side + 2 > width or y + side + 2 > height or first > last:
                break
            cubic_taps(left - x, across)
            cubic_taps(top - y, down)
            mean, square, shared, along, over = window_moments(
                images[1], first, width, taps, flat, side, blocks, middle
            )
            mean /= total
            spread, shared = square / total - mean * mean, shared / total - mean_t * mean
            if spread < _MIN_VARIANCE or shared <= 0:
                break
            gain = shared / spread
            a = gain * (along / total - mean_u * mean) - along0
            b = gain * (over / total - mean_v * mean) - down0
            du, dv = (vv * a - cross * b) / determinant, (uu * b - cross * a) / determinant
            u -= min(max(du, -2.0), 2.0)
            v -= min(max(dv, -2.0), 2.0)
            if abs(u - start_u) > reach or abs(v - start_v) > reach:
                break
            if abs(du) + abs(dv) < _CONVERGED:
                uv[i, 0], uv[i, 1], score[i] = u * size, v * size, shared / np.sqrt(variance * spread)
                break
