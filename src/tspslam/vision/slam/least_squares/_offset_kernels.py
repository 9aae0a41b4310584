"""Compiled loop of what a path says of its cameras: equations of offsets of disparities and of the focal length.

A disparity may be off by the offset of its group, and the focal length by a share of itself. Both are the columns ``H``
(3, G + 1) of an observation: 1 in the row of the disparity for its group, and the derivative of (u, v, d) by the
logarithm of the focal length last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import kernel
from ._kernels import huber_of, pose_jacobian, residual

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


@kernel
def offset_equations(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, start: Int64, seen: Float64, information: Float64,
    width: float, row: Int32, H: Float64, W: Float64, V: Float64, g: Float64, C: Float64, N: Float64, score: Float64,
    turn: Float64,
) -> None:  # fmt: skip
    """Fill the equations of the columns, with the points eliminated.

    Arguments are those of `_kernels.reduce`, which has filled W, V and g; observations are sorted by point. Fills
    C (6K, G + 1), the part that cameras and columns share, N (G + 1, G + 1), that of the columns alone, and of each
    point its share of the columns' right side, `score` (M, G + 1), and of the cameras', `turn` (M, 6K).
    """
    size = N.shape[0]
    p, r, J = np.empty(3), np.empty(3), np.empty((3, 6))
    U, Y = np.empty((3, size)), np.empty((3, size))
    C[:], N[:], score[:], turn[:] = 0, 0, 0, 0
    for m in range(X.shape[0]):
        U[:] = 0
        for o in range(start[m], start[m + 1]):
            k = pose[o]
            if not residual(lens, R[k], t[k], X[m], seen[o], p, r):
                continue
            has_disparity = not np.isnan(seen[o, 2])
            pose_jacobian(lens, p, has_disparity, J)
            weight = huber_of(r, information[o], width)[1]
            w = weight * information[o, 0], weight * information[o, 0], weight * information[o, 1]
            first = row[k] * 6
            for c in range(size):
                a, b, d = w[0] * H[o, 0, c], w[1] * H[o, 1, c], w[2] * H[o, 2, c]
                score[m, c] += a * r[0] + b * r[1] + d * r[2]
                for e in range(size):
                    N[c, e] += a * H[o, 0, e] + b * H[o, 1, e] + d * H[o, 2, e]
                for j in range(3):  # derivatives by the point are those by the camera's shift, turned
                    U[j, c] += (
                        a * (J[0, 3] * R[k, 0, j] + J[0, 4] * R[k, 1, j] + J[0, 5] * R[k, 2, j])
                        + b * (J[1, 3] * R[k, 0, j] + J[1, 4] * R[k, 1, j] + J[1, 5] * R[k, 2, j])
                        + d * (J[2, 3] * R[k, 0, j] + J[2, 4] * R[k, 1, j] + J[2, 5] * R[k, 2, j])
                    )
                if first >= 0:
                    for i in range(6):
                        C[first + i, c] += a * J[0, i] + b * J[1, i] + d * J[2, i]
            if first >= 0:
                for i in range(6):
                    turn[m, first + i] += w[0] * J[0, i] * r[0] + w[1] * J[1, i] * r[1] + w[2] * J[2, i] * r[2]
        for c in range(size):
            for j in range(3):
                Y[j, c] = V[m, j, 0] * U[0, c] + V[m, j, 1] * U[1, c] + V[m, j, 2] * U[2, c]
            score[m, c] -= Y[0, c] * g[m, 0] + Y[1, c] * g[m, 1] + Y[2, c] * g[m, 2]
            for e in range(size):
                N[c, e] -= Y[0, c] * U[0, e] + Y[1, c] * U[1, e] + Y[2, c] * U[2, e]
        for o in range(start[m], start[m + 1]):
            first = row[pose[o]] * 6
            if first < 0:
                continue
            for i in range(6):
                for j in range(3):
                    rest = V[m, j, 0] * g[m, 0] + V[m, j, 1] * g[m, 1] + V[m, j, 2] * g[m, 2]
                    turn[m, first + i] -= W[o, i, j] * rest
                for c in range(size):
                    C[first + i, c] -= W[o, i, 0] * Y[0, c] + W[o, i, 1] * Y[1, c] + W[o, i, 2] * Y[2, c]
