"""Compiled loop of what a path says of its cameras: equations of quantities of the calibration, points eliminated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel
from ._kernels import huber_of, pose_jacobian, residual

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


@inlined
def _by_point(J: Float64, R: Float64, G: Float64) -> None:
    """Fill `G` (3, 3): derivatives of (u, v, d) by the point are those by the camera's shift, turned."""
    for i in range(3):
        for j in range(3):
            G[i, j] = J[i, 3] * R[0, j] + J[i, 4] * R[1, j] + J[i, 5] * R[2, j]


@inlined
def _less_steps(r: Float64, H: Float64, J: Float64, delta: Float64, x: Float64, first: int) -> None:
    """Take from a residual what the steps of the quantities and of the camera explain."""
    for i in range(3):
        for c in range(delta.shape[0]):
            r[i] -= H[i, c] * delta[c]
        if first >= 0:
            for j in range(6):
                r[i] -= J[i, j] * x[first + j]


@kernel
def offset_equations(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, start: Int64, seen: Float64, information: Float64,
    width: float, row: Int32, H: Float64, W: Float64, V: Float64, delta: Float64, x: Float64, C: Float64, N: Float64,
    score: Float64, turn: Float64,
) -> None:  # fmt: skip
    """Fill the equations of Q quantities after their steps `delta` (Q,) and those of the cameras, `x` (6K,).

    The first arguments, W and V are those of `_kernels.reduce`, which has filled the latter; H (O, 3, Q) are
    derivatives of (u, v, disparity) by the quantities. Fills C (6K, Q), the part that cameras and quantities share,
    N (Q, Q), that of the quantities, and of each point its share of the quantities' right side, `score` (M, Q), and of
    the cameras', `turn` (M, 6K).
    """
    size = N.shape[0]
    p, r, J, G = np.empty(3), np.empty(3), np.empty((3, 6)), np.empty((3, 3))
    U, Y, g, w, rest = np.empty((3, size)), np.empty((3, size)), np.empty(3), np.empty(3), np.empty(3)
    C[:], N[:], score[:], turn[:] = 0, 0, 0, 0
    for m in range(X.shape[0]):
        U[:], g[:] = 0, 0
        for o in range(start[m], start[m + 1]):
            k, first = pose[o], row[pose[o]] * 6
            if not residual(lens, R[k], t[k], X[m], seen[o], p, r):
                continue
            pose_jacobian(lens, p, not np.isnan(seen[o, 2]), J)
            _by_point(J, R[k], G)
            weight = huber_of(r, information[o], width)[1]
            w[0] = w[1] = weight * information[o, 0]
            w[2] = weight * information[o, 1]
            _less_steps(r, H[o], J, delta, x, first)
            for i in range(3):
                for j in range(3):
                    g[j] += G[i, j] * w[i] * r[i]
                for c in range(size):
                    a = w[i] * H[o, i, c]
                    score[m, c] += a * r[i]
                    for e in range(size):
                        N[c, e] += a * H[o, i, e]
                    for j in range(3):
                        U[j, c] += a * G[i, j]
                    if first >= 0:
                        for j in range(6):
                            C[first + j, c] += a * J[i, j]
                if first >= 0:
                    for j in range(6):
                        turn[m, first + j] += w[i] * J[i, j] * r[i]
        for j in range(3):
            rest[j] = V[m, j, 0] * g[0] + V[m, j, 1] * g[1] + V[m, j, 2] * g[2]
            for c in range(size):
                Y[j, c] = V[m, j, 0] * U[0, c] + V[m, j, 1] * U[1, c] + V[m, j, 2] * U[2, c]
        for c in range(size):
            score[m, c] -= U[0, c] * rest[0] + U[1, c] * rest[1] + U[2, c] * rest[2]
            for e in range(size):
                N[c, e] -= Y[0, c] * U[0, e] + Y[1, c] * U[1, e] + Y[2, c] * U[2, e]
        for o in range(start[m], start[m + 1]):
            first = row[pose[o]] * 6
            if first < 0:
                continue
            for i in range(6):
                turn[m, first + i] -= W[o, i, 0] * rest[0] + W[o, i, 1] * rest[1] + W[o, i, 2] * rest[2]
                for c in range(size):
                    C[first + i, c] -= W[o, i, 0] * Y[0, c] + W[o, i, 1] * Y[1, c] + W[o, i, 2] * Y[2, c]
