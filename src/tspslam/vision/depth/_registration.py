"""Compiled: a depth map's triangles drawn into another camera, the nearest one at each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import kernel

_HUGE = 1e6  # px
_ROUNDING = 1e-9  # of a triangle's area, so that pixels on an edge are drawn


@kernel
def draw_depth(
    u: NDArray[np.float64], v: NDArray[np.float64], near: NDArray[np.float64], steps: NDArray[np.float64],
    depth: NDArray[np.float64], inverse: NDArray[np.float64],
) -> None:  # fmt: skip
    """Draw two triangles for each square of four pixels of a depth map whose depths go together.

    `u`, `v` (h, w) are where its pixels come to lie, `near` (h, w) their 1 / z there, NaN where not known; `depth`
    (h, w) and `steps` (h, w) are the map's own depths and how far neighbours on one surface differ. Fills `inverse`
    (H, W), 1 / z of the nearest, which begins at 0.
    """
    h, w = depth.shape
    corners = np.array([[0, 0, 0, 1, 1, 0], [0, 1, 1, 1, 1, 0]])
    for row in range(h - 1):
        for column in range(w - 1):
            for k in range(2):
                r0, c0 = row + corners[k, 0], column + corners[k, 1]
                r1, c1 = row + corners[k, 2], column + corners[k, 3]
                r2, c2 = row + corners[k, 4], column + corners[k, 5]
                if np.isnan(near[r0, c0]) or np.isnan(near[r1, c1]) or np.isnan(near[r2, c2]):
                    continue
                z0, z1, z2 = depth[r0, c0], depth[r1, c1], depth[r2, c2]
                least = min(z0, z1, z2)
                if not max(z0, z1, z2) - least <= min(steps[r0, c0], steps[r1, c1], steps[r2, c2]):
                    continue
                _draw(
                    u[r0, c0], v[r0, c0], near[r0, c0], u[r1, c1], v[r1, c1], near[r1, c1],
                    u[r2, c2], v[r2, c2], near[r2, c2], inverse,
                )  # fmt: skip


@kernel
def _draw(
    u0: float, v0: float, w0: float, u1: float, v1: float, w1: float, u2: float, v2: float, w2: float,
    inverse: NDArray[np.float64],
) -> None:  # fmt: skip
    """Draw one triangle; 1 / z is linear in the image."""
    area = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    if area == 0 or not (max(abs(u0), abs(u1), abs(u2), abs(v0), abs(v1), abs(v2)) < _HUGE):
        return
    height, width = inverse.shape
    left, right = max(0, int(np.ceil(min(u0, u1, u2)))), min(width - 1, int(np.floor(max(u0, u1, u2))))
    top, bottom = max(0, int(np.ceil(min(v0, v1, v2)))), min(height - 1, int(np.floor(max(v0, v1, v2))))
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            b1 = ((column - u0) * (v2 - v0) - (u2 - u0) * (row - v0)) / area
            b2 = ((u1 - u0) * (row - v0) - (column - u0) * (v1 - v0)) / area
            b0 = 1.0 - b1 - b2
            if min(b0, b1, b2) >= -_ROUNDING:
                found = b0 * w0 + b1 * w1 + b2 * w2
                if found > inverse[row, column]:
                    inverse[row, column] = found
