"""What the errors of neighbouring points have in common: it does not average out as noise does."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....types import FloatArray

_FINEST = 16  # cells across the image: 77 px of KITTI's, where half of what neighbours share is left
_LEVELS = 4  # cells of 1/16 to 1/2 of the image: in the whole of it the fit leaves nothing in common


def shared_information(uv: FloatArray, width: int, residual: FloatArray, slope: FloatArray) -> FloatArray:
    """Find what is to be added to the normal matrix's noise because errors of neighbouring points are alike.

    A cell of each of four nested grids has an error of its own in each of the three measured values, beside the noise
    of each point: two points share what the cells share that hold both. With m_l the mean product of the residuals of
    two points that share a cell of level l, but none of a finer one, and level 4 coarser than all, of which m_4 = 0::

        τ_l² = max(m_l, ..., m_4) - max(m_l+1, ..., m_4),      S = Σ_l τ_l² Σ_cells (Σ_cell a) (Σ_cell a)ᵀ

    Patches at the edge of one thing, lenses that a calibration knows to half a pixel, and disparities of one surface
    err alike: on KITTI's recordings residuals within 40 px of each other correlate by 0.1 to 0.6, up to 160 px by 0.01
    to 0.4; on synthetic streets, beyond 10 px, by less than 0.03.

    Parameters
    ----------
    uv : (K, 2) float64
        Where points are seen, px.
    width : int
        Of the image, px.
    residual : (K, 3) float64
        Of u, v and disparity, standard deviations; 0 where not measured.
    slope : (K, 3, 6) float64
        Derivatives of these residuals by (ω, υ); 0 where not measured.

    Returns
    -------
    (6, 6) float64
        S; the covariance of the pose grows by C S C, with C the inverse of the normal equations.

    Examples
    --------
    >>> uv = np.array([[10.0, 10], [20, 10], [500, 10], [510, 10]])
    >>> slope = np.zeros((4, 3, 6))
    >>> slope[:, 0, 3] = 1
    >>> alike, apart = np.zeros((2, 4, 3))
    >>> alike[:, 0], apart[:, 0] = (1, 1, -1, -1), (1, -1, 1, -1)
    >>> [float(shared_information(uv, 640, each, slope)[3, 3]) for each in (alike, apart)]
    [8.0, 0.0]
    """
    from ._kernels import add_slopes, sum_products

    grids, shared = [_summed(uv, width, residual, slope)], []
    last, sums = np.zeros((3, 2)), np.empty((3, 2))
    for _ in range(_LEVELS):
        rows, columns = grids[-1].shape[:2]
        grids.append(np.empty((rows // 2, columns // 2, 3, 9)))
        sum_products(grids[-2], sums, grids[-1])
        products, pairs = (sums - last).T
        shared.append(np.divide(products, pairs, out=np.zeros(3), where=pairs > 0))
        last[:] = sums
    m = np.maximum.accumulate([np.zeros(3), *shared[::-1]])
    found = np.zeros((6, 6))
    for variance, grid in zip(np.diff(m, axis=0)[::-1], grids[:-1], strict=True):
        add_slopes(grid, variance, found)
    return found


def _summed(uv: FloatArray, width: int, residual: FloatArray, slope: FloatArray) -> FloatArray:
    """Sums of residuals, of their squares, of ones and of slopes over the finest cells: (rows, columns, 3, 9)."""
    from ._kernels import sum_cells

    cell: NDArray[np.int64] = np.maximum(uv * (_FINEST / width), 0).astype(np.int64)
    side = 1 << _LEVELS
    columns, rows = (-(-(int(most) + 1) // side) * side for most in cell.max(axis=0, initial=0))
    grid = np.zeros((rows * columns, 3, 9))
    sum_cells(cell[:, 1] * columns + cell[:, 0], residual, slope, grid)
    return grid.reshape(rows, columns, 3, 9)
