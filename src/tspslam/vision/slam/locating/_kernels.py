"""Compiled loops over the sights of a pose: how each depends on it, and what those in one part of the image sum to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@inlined
def _differentiate(lens: Float64, camera: Float64, across: Float64, J: Float64) -> None:
    """Fill derivatives of (u, v, disparity) by a point in the camera, (3, 3), and by the pose's (ω, υ), (3, 6)."""
    x, y, z = camera
    fx, fy, skew = lens[0], lens[1], lens[4]
    across[:] = 0
    across[0, 0], across[0, 1], across[0, 2] = fx / z, skew / z, -(fx * x + skew * y) / z**2
    across[1, 1], across[1, 2] = fy / z, -fy * y / z**2
    across[2, 2] = -lens[5] / z**2
    for k in range(3):
        after, last = (k + 1) % 3, (k + 2) % 3
        for i in range(3):  # the cross product of the point and the row
            J[i, k] = camera[after] * across[i, last] - camera[last] * across[i, after]
            J[i, 3 + k] = across[i, k]


@inlined
def _shift_with_depth(
    lens: Float64, T: Float64, T_keyframe: Float64, X: Float64, across: Float64, out: Float64
) -> None:
    """Fill how (u, v, disparity) change with the disparity that a keyframe measured, px per px."""
    away = 0.0
    for k in range(3):
        away += (X[k] - T_keyframe[k, 3]) * T_keyframe[k, 2]
    away = max(away, lens[5] / lens[0]) / lens[5]  # what lies behind that camera was seen by another
    out[:] = 0
    for j in range(3):
        turned = 0.0
        for k in range(3):
            turned += (X[k] - T_keyframe[k, 3]) * T[k, j]
        for i in range(3):
            out[i] += across[i, j] * turned * away


@kernel
def weigh_sights(
    lens: Float64, T: Float64, T_keyframe: Float64, points: Float64, seen: Float64, sigma: Float64, depth: Float64,
    huber: float, slope: Float64, residual: Float64, moved: Float64, scale: Float64,
) -> tuple[int, float, float]:  # fmt: skip
    """Fill what each sight says of the pose T, in standard deviations `sigma` (K, 3), weighed by a Huber cost.

    `slope` (K, 3, 6): derivatives of (u, v, disparity) by (ω, υ); `residual` (K, 3); `moved` (K, 6): Jᵀ W ∂r/∂d of each
    point, whose disparity `T_keyframe` measured to `depth` px; `scale` (K, 3): √weight, 0 where `seen` is NaN.

    Returned: values measured, what the depths let expect of the sum of their squares, and that sum.
    """
    across, J, shift, camera = np.empty((3, 3)), np.empty((3, 6)), np.empty(3), np.empty(3)
    count, expected, total = 0, 0.0, 0.0
    for m in range(points.shape[0]):
        X, square = points[m], 0.0
        for j in range(3):
            camera[j] = 0.0
            for k in range(3):
                camera[j] += (X[k] - T[k, 3]) * T[k, j]
        _differentiate(lens, camera, across, J)
        _shift_with_depth(lens, T, T_keyframe, X, across, shift)
        x, y, z = camera
        residual[m, 0] = seen[m, 0] - (lens[2] + (lens[0] * x + lens[4] * y) / z)
        residual[m, 1] = seen[m, 1] - (lens[3] + lens[1] * y / z)
        residual[m, 2] = seen[m, 2] - (lens[5] / z - lens[6])
        for i in range(3):
            is_measured = not np.isnan(seen[m, i])
            scale[m, i] = 1 / sigma[m, i] if is_measured else 0.0
            residual[m, i] = residual[m, i] * scale[m, i] if is_measured else 0.0
            count += is_measured
            square += residual[m, i] ** 2
            expected += (shift[i] * depth[m] * scale[m, i]) ** 2
        robust = min(1.0, huber / np.sqrt(max(square, 1e-12)))
        total += robust * square
        moved[m] = 0
        for i in range(3):
            scale[m, i] *= np.sqrt(robust)
            residual[m, i] *= np.sqrt(robust)
            for k in range(6):
                slope[m, i, k] = J[i, k] * scale[m, i]
                moved[m, k] += slope[m, i, k] * scale[m, i] * shift[i]
    return count, expected, total


@kernel
def sum_cells(cell: Int64, residual: Float64, slope: Float64, grid: Float64) -> None:
    """Add to `grid` (cells, 3, 9) residuals, their squares, how many are measured, and slopes of the points in each."""
    for m in range(cell.shape[0]):
        own = grid[cell[m]]
        for i in range(3):
            is_measured = False
            for k in range(6):
                own[i, 3 + k] += slope[m, i, k]
                is_measured = is_measured or slope[m, i, k] != 0
            own[i, 0] += residual[m, i]
            own[i, 1] += residual[m, i] ** 2
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
