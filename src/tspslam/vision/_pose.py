"""Compiled least squares on one camera's pose: normal equations, Levenberg's damping, Cholesky's factors.

Conventions are those of `_bundle`; the points stay where they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, kernel
from ._bundle import UNSEEN, huber_of, pose_jacobian, residual, square_of

Float64 = NDArray[np.float64]

_FIRST_DAMPING, _LEAST, _MOST = 1e-4, 1e-9, 1e8
_ENOUGH = 1e-6  # relative decrease of the cost below which the search ends


@kernel
def pose_equations(
    lens: Float64, R: Float64, t: Float64, X: Float64, seen: Float64, information: Float64, width: float, S: Float64,
    b: Float64,
) -> float:  # fmt: skip
    """Fill the normal equations S (6, 6), b (6,) of a camera that sees X (M, 3) at `seen` (M, 3); returns the cost."""
    p, r, J, total = np.empty(3), np.empty(3), np.empty((3, 6)), 0.0
    S[:], b[:] = 0, 0
    for m in range(X.shape[0]):
        if not residual(lens, R, t, X[m], seen[m], p, r):
            total += UNSEEN
            continue
        cost, weight = huber_of(r, information, width)
        total += cost
        pose_jacobian(lens, p, not np.isnan(seen[m, 2]), J)
        w_uv, w_d = weight * information[0], weight * information[1]
        for i in range(6):
            u, v, d = w_uv * J[0, i], w_uv * J[1, i], w_d * J[2, i]
            b[i] += u * r[0] + v * r[1] + d * r[2]
            for j in range(i + 1):
                S[i, j] += u * J[0, j] + v * J[1, j] + d * J[2, j]
    for i in range(6):
        for j in range(i):
            S[j, i] = S[i, j]
    return total


@inlined
def _solve(S: Float64, b: Float64, damping: float, x: Float64) -> bool:
    """Solve six equations whose diagonal grows by 1 + damping; False if they are not positive."""
    L = np.empty((6, 6))
    for i in range(6):
        for j in range(i + 1):
            value = S[i, j]
            if i == j:
                value = value * (1 + damping) + 1e-9  # what nothing fixes stays
            for k in range(j):
                value -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = value / L[j, j]
            elif value > 0:
                L[i, i] = np.sqrt(value)
            else:
                return False
    for i in range(6):
        x[i] = b[i]
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return True


@inlined
def _turned(R: Float64, t: Float64, x: Float64, R_new: Float64, t_new: Float64) -> None:
    """Fill the pose after a step (ω, υ): ``exp(ω) R``, ``exp(ω) t + υ``."""
    square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
    angle = np.sqrt(square)
    a = np.sin(angle) / angle if angle > 1e-4 else 1 - square / 6
    c = (1 - np.cos(angle)) / square if angle > 1e-4 else 0.5 - square / 24
    E = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            E[i, j] = c * (x[i] * x[j] - (square if i == j else 0.0)) + (1.0 if i == j else 0.0)
    E[2, 1] += a * x[0]
    E[1, 2] -= a * x[0]
    E[0, 2] += a * x[1]
    E[2, 0] -= a * x[1]
    E[1, 0] += a * x[2]
    E[0, 1] -= a * x[2]
    for i in range(3):
        t_new[i] = E[i, 0] * t[0] + E[i, 1] * t[1] + E[i, 2] * t[2] + x[3 + i]
        for j in range(3):
            R_new[i, j] = E[i, 0] * R[0, j] + E[i, 1] * R[1, j] + E[i, 2] * R[2, j]


@kernel
def improve_pose(
    lens: Float64, R: Float64, t: Float64, X: Float64, seen: Float64, information: Float64, width: float, steps: int,
    S: Float64, distance: Float64,
) -> bool:  # fmt: skip
    """Improve the pose R, t in place by at most so many steps; False if the equations have no solution.

    `information` holds that of a pixel and of a disparity, px⁻². S (6, 6) receives the information of (ω, υ),
    `distance` (M,) the length of each residual in standard deviations.
    """
    b, x, next_S, next_b = np.empty(6), np.empty(6), np.empty((6, 6)), np.empty(6)
    R_new, t_new = np.empty((3, 3)), np.empty(3)
    cost, damping = pose_equations(lens, R, t, X, seen, information, width, S, b), _FIRST_DAMPING
    solvable = True
    for _ in range(steps):
        taken = np.inf
        solvable = False
        while damping <= _MOST:
            if _solve(S, b, damping, x):
                solvable = True
                _turned(R, t, x, R_new, t_new)
                taken = pose_equations(lens, R_new, t_new, X, seen, information, width, next_S, next_b)
                if taken <= cost:
                    break
            damping *= 10
        if not taken <= cost:
            break
        R[:], t[:], S[:], b[:] = R_new, t_new, next_S, next_b
        damping = max(damping / 10, _LEAST)
        done, cost = cost - taken <= _ENOUGH * cost, taken
        if done:
            break
    p, r = x[:3], x[3:]
    for m in range(X.shape[0]):
        distance[m] = np.inf
        if residual(lens, R, t, X[m], seen[m], p, r):
            distance[m] = np.sqrt(square_of(r, information))
    return solvable
