"""Compiled loops over the sights of a pose: how each depends on it, and what those in one part of the image sum to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel
from ..least_squares._kernels import huber_of, pose_jacobian, residual, square_of

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@inlined
def _shift_with_depth(lens: Float64, R: Float64, T_keyframe: Float64, X: Float64, J: Float64, out: Float64) -> None:
    """Fill how (u, v, disparity) change with the disparity that a keyframe measured, px per px."""
    away = 0.0
    for k in range(3):
        away += (X[k] - T_keyframe[k, 3]) * T_keyframe[k, 2]
    away = max(away, lens[5] / lens[0]) / lens[5]  # what lies behind that camera was seen by another
    out[:] = 0
    for j in range(3):
        turned = 0.0
        for k in range(3):
            turned += (X[k] - T_keyframe[k, 3]) * R[j, k]
        for i in range(3):
            out[i] += J[i, 3 + j] * turned * away


@kernel
def weigh_sights(
    lens: Float64, T_camera_world: Float64, T_keyframe: Float64, points: Float64, seen: Float64, information: Float64,
    depth: Float64, huber: float, slope: Float64, residuals: Float64, moved: Float64, scale: Float64,
) -> tuple[int, float, float]:  # fmt: skip
    """Fill what each sight says of a pose, in standard deviations, weighed by a Huber cost; 0 behind the camera.

    `information` (K, 2): that of a pixel and of a disparity. `slope` (K, 3, 6): derivatives of (u, v, disparity) by
    (ω, υ); `residuals` (K, 3); `moved` (K, 6): Jᵀ W ∂r/∂d of each point, whose disparity `T_keyframe` measured to
    `depth` px; `scale` (K, 3): √weight, 0 where `seen` is NaN.

    Returned: values measured, what the depths let expect of the sum of their squares, and that sum.
    """
    p, r, J, shift = np.empty(3), np.empty(3), np.empty((3, 6)), np.empty(3)
    R, t = T_camera_world[:3, :3], T_camera_world[:3, 3]
    slope[:], residuals[:], moved[:], scale[:] = 0, 0, 0, 0
    count, expected, total = 0, 0.0, 0.0
    for m in range(points.shape[0]):
        if not residual(lens, R, t, points[m], seen[m], p, r):
            continue
        measured = 2 if np.isnan(seen[m, 2]) else 3
        pose_jacobian(lens, p, measured == 3, J)
        _shift_with_depth(lens, R, T_keyframe, points[m], J, shift)
        weight = huber_of(r, information[m], huber)[1]
        count, total = count + measured, total + weight * square_of(r, information[m])
        for i in range(measured):
            expected += (shift[i] * depth[m]) ** 2 * information[m, i // 2]
            scale[m, i] = np.sqrt(weight * information[m, i // 2])
            residuals[m, i] = r[i] * scale[m, i]
            for k in range(6):
                slope[m, i, k] = J[i, k] * scale[m, i]
                moved[m, k] += slope[m, i, k] * scale[m, i] * shift[i]
    return count, expected, total


@kernel
def sum_cells(cell: Int64, residuals: Float64, slope: Float64, grid: Float64) -> None:
    """Add to `grid` (cells, 3, 9) residuals, their squares, how many are measured, and slopes of the points in each."""
    for m in range(cell.shape[0]):
        own = grid[cell[m]]
        for i in range(3):
            is_measured = False
            for k in range(6):
                own[i, 3 + k] += slope[m, i, k]
                is_measured = is_measured or slope[m, i, k] != 0
            own[i, 0] += residuals[m, i]
            own[i, 1] += residuals[m, i] ** 2
            own[i, 2] += is_measured


@kernel
def sum_products(grid: Float64, sums: Float64, half: Float64) -> None:
    """Fill `sums` (3, 2) with the products of residuals in one cell, and their number; `half` with sums of four cells.

    `grid` (rows, columns, 3, 9) is of `sum_cells`; each pair of residuals counts twice.
    """
    sums[:], half[:] = 0, 0
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            own, wider = grid[row, column], half[row // 2, column // 2]
            for i in range(3):
                sums[i, 0] += own[i, 0] ** 2 - own[i, 1]
                sums[i, 1] += own[i, 2] * (own[i, 2] - 1)
                for k in range(9):
                    wider[i, k] += own[i, k]


@kernel
def add_slopes(grid: Float64, variance: Float64, found: Float64) -> None:
    """Add to `found` (6, 6) what errors of some variance, one of each value in each cell, do to a pose."""
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            for i in range(3):
                a = grid[row, column, i, 3:]
                for k in range(6):
                    scaled = variance[i] * a[k]
                    for j in range(6):
                        found[k, j] += scaled * a[j]
