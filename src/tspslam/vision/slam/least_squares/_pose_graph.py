"""Compiled loops of least squares on poses and relative poses: residuals, cost, equations.

An edge's residual is ``r = (log R, t)`` of ``inv(T_ij) inv(T_i) T_j``; a step turns and moves a pose in its own frame:
``R <- R exp(φ)``, ``t <- t + R ρ``. Both have the rotation first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel
from ._kernels import pose_equations

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

_SMALL = 1e-6  # rad; below, series serve


@inlined
def _log(R: Float64, r: Float64) -> None:
    """Fill the rotation vector of R, by its quaternion, of which the largest part is found first."""
    w, x, y, z = R[0, 0] + R[1, 1] + R[2, 2], R[0, 0], R[1, 1], R[2, 2]
    a, b, c = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    if w >= max(x, y, z):
        q, i, j, k = 1 + w, a, b, c
    elif x >= max(y, z):
        q, i, j, k = a, 1 + x - y - z, R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]
    elif y >= z:
        q, i, j, k = b, R[1, 0] + R[0, 1], 1 + y - x - z, R[2, 1] + R[1, 2]
    else:
        q, i, j, k = c, R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], 1 + z - x - y
    if q < 0:
        q, i, j, k = -q, -i, -j, -k
    length = np.sqrt(i * i + j * j + k * k)
    scale = 2 * np.arctan2(length, q) / length if length > _SMALL * q else 2 / q
    r[0], r[1], r[2] = scale * i, scale * j, scale * k


@inlined
def _edge(
    R_i: Float64, t_i: Float64, R_j: Float64, t_j: Float64, R_ij: Float64, t_ij: Float64, F: Float64, f: Float64,
    E: Float64, r: Float64,
) -> None:  # fmt: skip
    """Fill the relative pose `F`, `f` of two poses, the rotation `E` of what is left of it, and the residual."""
    for a in range(3):
        f[a] = 0.0
        for b in range(3):
            f[a] += R_i[b, a] * (t_j[b] - t_i[b])
            F[a, b] = R_i[0, a] * R_j[0, b] + R_i[1, a] * R_j[1, b] + R_i[2, a] * R_j[2, b]
    for a in range(3):
        r[3 + a] = 0.0
        for b in range(3):
            r[3 + a] += R_ij[b, a] * (f[b] - t_ij[b])
            E[a, b] = R_ij[0, a] * F[0, b] + R_ij[1, a] * F[1, b] + R_ij[2, a] * F[2, b]
    _log(E, r)


@inlined
def _square(r: Float64, information: Float64) -> float:
    total = 0.0
    for a in range(6):
        for b in range(6):
            total += r[a] * information[a, b] * r[b]
    return total


@inlined
def _inverse_right_jacobian(r: Float64, J: Float64) -> None:
    """Fill (3, 3) of a rotation vector: the change of ``log(exp(r) exp(φ))`` by φ at 0."""
    square = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    angle = np.sqrt(square)
    c = 1 / 12.0
    if angle > 1e-3:
        c = (1 - 0.5 * angle * np.cos(0.5 * angle) / np.sin(0.5 * angle)) / square
    for a in range(3):
        for b in range(3):
            J[a, b] = c * (r[a] * r[b] - (square if a == b else 0.0)) + (1.0 if a == b else 0.0)
    J[0, 1] -= 0.5 * r[2]
    J[1, 0] += 0.5 * r[2]
    J[0, 2] += 0.5 * r[1]
    J[2, 0] -= 0.5 * r[1]
    J[1, 2] -= 0.5 * r[0]
    J[2, 1] += 0.5 * r[0]


@inlined
def _edge_jacobians(F: Float64, f: Float64, E: Float64, R_ij: Float64, r: Float64, A: Float64, B: Float64) -> None:
    """Fill the derivatives of a residual by the steps of its two poses, (6, 6) each."""
    J = np.empty((3, 3))
    _inverse_right_jacobian(r, J)
    A[:], B[:] = 0, 0
    for a in range(3):
        for b in range(3):
            B[a, b], B[3 + a, 3 + b] = J[a, b], E[a, b]
            A[a, b] = -(J[a, 0] * F[b, 0] + J[a, 1] * F[b, 1] + J[a, 2] * F[b, 2])
            A[3 + a, 3 + b] = -R_ij[b, a]
        A[3 + a, 0] = R_ij[1, a] * f[2] - R_ij[2, a] * f[1]
        A[3 + a, 1] = R_ij[2, a] * f[0] - R_ij[0, a] * f[2]
        A[3 + a, 2] = R_ij[0, a] * f[1] - R_ij[1, a] * f[0]


@inlined
def _add_product(left: Float64, right: Float64, sum_: Float64) -> None:
    """Add ``left.T @ right`` of (6, 6) matrices."""
    for a in range(6):
        for k in range(6):
            for b in range(6):
                sum_[a, b] += left[k, a] * right[k, b]


@kernel
def graph_equations(
    R: Float64, t: Float64, i: Int64, j: Int64, R_ij: Float64, t_ij: Float64, information: Float64, width: float,
    column: Int64, diagonal: Int64, place: Int64, L: Float64, b: Float64, lengths: Float64,
) -> float:  # fmt: skip
    """Fill the normal equations: blocks of the lower half into L, laid out as the factor, and the right side b (n, 6).

    Fills the length of each residual in standard deviations too, and returns the sum of the Huber costs.

    `column` numbers the poses that move, -1 for the others; `diagonal` says where L has the diagonal block of a
    column, `place` that of an edge's two poses.
    """
    F, f, E, r = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty(6)
    A, B, WA, WB, w = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6)), np.empty(6)
    L[:], b[:], total = 0, 0, 0.0
    for e in range(i.shape[0]):
        first, second = column[i[e]], column[j[e]]
        _edge(R[i[e]], t[i[e]], R[j[e]], t[j[e]], R_ij[e], t_ij[e], F, f, E, r)
        length = np.sqrt(max(_square(r, information[e]), 0.0))
        lengths[e] = length
        weight = 1.0 if length <= width else width / length
        total += length * length if length <= width else 2 * width * length - width * width
        _edge_jacobians(F, f, E, R_ij[e], r, A, B)
        WA[:], WB[:], w[:] = 0, 0, 0
        for a in range(6):
            for k in range(6):
                value = weight * information[e, a, k]
                w[a] += value * r[k]
                for c in range(6):
                    WA[a, c] += value * A[k, c]
                    WB[a, c] += value * B[k, c]
        for a in range(6):
            for k in range(6):
                if first >= 0:
                    b[first, a] -= A[k, a] * w[k]
                if second >= 0:
                    b[second, a] -= B[k, a] * w[k]
        if first >= 0:
            _add_product(A, WA, L[diagonal[first]])
        if second >= 0:
            _add_product(B, WB, L[diagonal[second]])
        if first >= 0 and second >= 0:
            if first > second:
                _add_product(A, WB, L[place[e]])
            else:
                _add_product(B, WA, L[place[e]])
    return total


@kernel
def informations(
    lens: Float64, R: Float64, t: Float64, start: Int64, xyz: Float64, seen: Float64, weights: Float64, width: float,
    S: Float64,
) -> None:  # fmt: skip
    """Fill the normal equations S (K, 6, 6) of poses, each by rows ``start[k]`` to ``start[k + 1]`` of what is seen."""
    b = np.empty(6)
    for k in range(S.shape[0]):
        rows = slice(start[k], start[k + 1])
        pose_equations(lens, R[k], t[k], xyz[rows], seen[rows], weights[rows], width, S[k], b)
