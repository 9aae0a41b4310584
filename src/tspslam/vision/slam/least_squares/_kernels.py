"""Compiled loops of least squares on poses and points: equations, elimination of points, Cholesky's factors, cost.

A point X is seen by a camera at ``p = R X + t`` as (u, v, d): its pixel and its disparity. A step turns and moves the
camera: ``δp = ω × p + υ``. Observations are sorted by point; those of disparity NaN are bearings. Disparities may have
one offset in common: ``d = fx B / z - doffs + offset``; `lens` is (fx, fy, cx, cy, skew, fx B, doffs, offset).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel, reassociated_kernel

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]

_BEHIND = 1e-3  # m; nearer points, and those behind, are not seen
UNSEEN = 1e6  # cost of an observation whose point is not in front


@inlined
def residual(lens: Float64, R: Float64, t: Float64, X: Float64, seen: Float64, p: Float64, r: Float64) -> bool:
    """Fill `p` with the point in the camera's frame and `r` with seen less predicted (u, v, d); False if behind."""
    for i in range(3):
        p[i] = R[i, 0] * X[0] + R[i, 1] * X[1] + R[i, 2] * X[2] + t[i]
    if p[2] <= _BEHIND:
        return False
    near = 1 / p[2]
    r[0] = seen[0] - (lens[2] + (lens[0] * p[0] + lens[4] * p[1]) * near)
    r[1] = seen[1] - (lens[3] + lens[1] * p[1] * near)
    r[2] = 0.0 if np.isnan(seen[2]) else seen[2] - (lens[5] * near - lens[6] + lens[7])
    return True


@inlined
def square_of(r: Float64, information: Float64) -> float:
    """Squared length of a residual in standard deviations; `information` is that of a pixel and of a disparity."""
    return information[0] * (r[0] * r[0] + r[1] * r[1]) + information[1] * r[2] * r[2]


@inlined
def huber_of(r: Float64, information: Float64, width: float) -> tuple[float, float]:
    """Cost and weight of a residual: quadratic up to `width` standard deviations, linear beyond."""
    square = square_of(r, information)
    if square <= width * width:
        return square, 1.0
    length = np.sqrt(square)
    return 2 * width * length - width * width, width / length


@kernel
def cost(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, point: Int32, seen: Float64, information: Float64,
    width: float,
) -> float:  # fmt: skip
    """Sum of the Huber costs of all observations."""
    p, r = np.empty(3), np.empty(3)
    total = 0.0
    for o in range(pose.shape[0]):
        k = pose[o]
        if residual(lens, R[k], t[k], X[point[o]], seen[o], p, r):
            total += huber_of(r, information[o], width)[0]
        else:
            total += UNSEEN
    return total


@kernel
def squares(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, point: Int32, seen: Float64, information: Float64,
    found: Float64,
) -> None:  # fmt: skip
    """Squared length of each observation's residual in standard deviations; infinity where the point is behind."""
    p, r = np.empty(3), np.empty(3)
    for o in range(pose.shape[0]):
        k = pose[o]
        found[o] = np.inf
        if residual(lens, R[k], t[k], X[point[o]], seen[o], p, r):
            found[o] = square_of(r, information[o])


@inlined
def pose_jacobian(lens: Float64, p: Float64, has_disparity: bool, J: Float64) -> None:
    """Fill `J` (3, 6): derivatives of predicted (u, v, d) by the camera's (ω, υ)."""
    near = 1 / p[2]
    J[0, 3], J[0, 4] = lens[0] * near, lens[4] * near
    J[0, 5] = -(lens[0] * p[0] + lens[4] * p[1]) * near * near
    J[1, 3], J[1, 4], J[1, 5] = 0.0, lens[1] * near, -lens[1] * p[1] * near * near
    J[2, 3], J[2, 4], J[2, 5] = 0.0, 0.0, -lens[5] * near * near if has_disparity else 0.0
    for i in range(3):
        J[i, 0] = J[i, 5] * p[1] - J[i, 4] * p[2]
        J[i, 1] = J[i, 3] * p[2] - J[i, 5] * p[0]
        J[i, 2] = J[i, 4] * p[0] - J[i, 3] * p[1]


@inlined
def _jacobians(lens: Float64, R: Float64, p: Float64, has_disparity: bool, J: Float64, G: Float64) -> None:
    """Derivatives of predicted (u, v, d): `J` (3, 6) by the camera's (ω, υ), `G` (3, 3) by the point."""
    pose_jacobian(lens, p, has_disparity, J)
    for i in range(3):
        for j in range(3):
            G[i, j] = J[i, 3] * R[0, j] + J[i, 4] * R[1, j] + J[i, 5] * R[2, j]


@inlined
def _invert(A: Float64, B: Float64) -> bool:
    """Inverse of a symmetric positive (3, 3) matrix; False if it has none."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    if not det > 0:
        return False
    B[0, 0], B[0, 1], B[0, 2] = c00 / det, c01 / det, c02 / det
    B[1, 0], B[1, 1] = B[0, 1], (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) / det
    B[1, 2] = (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2]) / det
    B[2, 0], B[2, 1], B[2, 2] = B[0, 2], B[1, 2], (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]) / det
    return True


@kernel
def reduce(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, start: Int64, seen: Float64, information: Float64,
    width: float, damping: float, row: Int32, moving: bool, S: Float64, b: Float64, W: Float64, V: Float64, g: Float64,
    U: Float64,
) -> None:  # fmt: skip
    """Normal equations of the cameras that move, with the points eliminated (Schur complement).

    `row` numbers those cameras from 0, -1 for the others; `start` (M + 1,) bounds the observations of each point.
    Fills S (6K, 6K), of which the lower half counts, and b (6K,), with one row more where the offset of disparities is
    free; and for the way back W (O, 6, 3), V (M, 3, 3) inverse, g (M, 3) and U (M, 3), the offset's part. Points stay
    where they are unless `moving`. Diagonals grow by the factor 1 + damping.
    """
    p, r, J, G = np.empty(3), np.empty(3), np.empty((3, 6)), np.empty((3, 3))
    A = np.empty((3, 3))
    last = S.shape[0] - 1
    has_offset = S.shape[0] % 6 == 1
    S[:], b[:] = 0, 0
    for m in range(X.shape[0]):
        A[:] = 0
        g[m], U[m] = 0, 0
        for o in range(start[m], start[m + 1]):
            k = pose[o]
            W[o] = 0
            if not residual(lens, R[k], t[k], X[m], seen[o], p, r):
                continue
            has_disparity = not np.isnan(seen[o, 2])
            _jacobians(lens, R[k], p, has_disparity, J, G)
            weight = huber_of(r, information[o], width)[1]
            w = weight * information[o, 0], weight * information[o, 0], weight * information[o, 1]
            for i in range(3):
                for j in range(3):
                    A[i, j] += w[0] * G[0, i] * G[0, j] + w[1] * G[1, i] * G[1, j] + w[2] * G[2, i] * G[2, j]
                g[m, i] += w[0] * G[0, i] * r[0] + w[1] * G[1, i] * r[1] + w[2] * G[2, i] * r[2]
            if has_offset and has_disparity:
                S[last, last] += w[2]
                b[last] += w[2] * r[2]
                for i in range(3):
                    U[m, i] += w[2] * G[2, i]
            first = row[k] * 6
            if first < 0:
                continue
            for i in range(6):
                for j in range(6):
                    S[first + i, first + j] += (
                        w[0] * J[0, i] * J[0, j] + w[1] * J[1, i] * J[1, j] + w[2] * J[2, i] * J[2, j]
                    )
                for j in range(3):
                    W[o, i, j] = w[0] * J[0, i] * G[0, j] + w[1] * J[1, i] * G[1, j] + w[2] * J[2, i] * G[2, j]
                b[first + i] += w[0] * J[0, i] * r[0] + w[1] * J[1, i] * r[1] + w[2] * J[2, i] * r[2]
                if has_offset and has_disparity:
                    S[last, first + i] += w[2] * J[2, i]
        for i in range(3):
            A[i, i] = A[i, i] * (1 + damping) + 1e-9
        if not moving or not _invert(A, V[m]):
            V[m] = 0
    for i in range(S.shape[0]):
        S[i, i] = S[i, i] * (1 + damping) + 1e-9  # what nothing estimates stays
    if moving:
        _eliminate(pose, start, row, has_offset, S, b, W, V, g, U)


@kernel
def _eliminate(
    pose: Int32, start: Int64, row: Int32, has_offset: bool, S: Float64, b: Float64, W: Float64, V: Float64, g: Float64,
    U: Float64,
) -> None:  # fmt: skip
    """Take the points out of the equations: ``S - W V Wᵀ`` (its lower half), ``b - W V g``."""
    Y, last = np.empty((6, 3)), S.shape[0] - 1
    for m in range(V.shape[0]):
        if has_offset:
            for j in range(3):
                Y[0, j] = U[m, 0] * V[m, 0, j] + U[m, 1] * V[m, 1, j] + U[m, 2] * V[m, 2, j]
            b[last] -= Y[0, 0] * g[m, 0] + Y[0, 1] * g[m, 1] + Y[0, 2] * g[m, 2]
            S[last, last] -= Y[0, 0] * U[m, 0] + Y[0, 1] * U[m, 1] + Y[0, 2] * U[m, 2]
        for o in range(start[m], start[m + 1]):
            first = row[pose[o]] * 6
            if first < 0:
                continue
            for i in range(6):
                for j in range(3):
                    Y[i, j] = W[o, i, 0] * V[m, 0, j] + W[o, i, 1] * V[m, 1, j] + W[o, i, 2] * V[m, 2, j]
                b[first + i] -= Y[i, 0] * g[m, 0] + Y[i, 1] * g[m, 1] + Y[i, 2] * g[m, 2]
                if has_offset:
                    S[last, first + i] -= Y[i, 0] * U[m, 0] + Y[i, 1] * U[m, 1] + Y[i, 2] * U[m, 2]
            for other in range(start[m], start[m + 1]):
                second = row[pose[other]] * 6
                if second < 0 or second > first:
                    continue
                for i in range(6):
                    for j in range(6):
                        S[first + i, second + j] -= (
                            Y[i, 0] * W[other, j, 0] + Y[i, 1] * W[other, j, 1] + Y[i, 2] * W[other, j, 2]
                        )


@kernel
def points_step(
    pose: Int32, start: Int64, row: Int32, W: Float64, V: Float64, g: Float64, U: Float64, x: Float64, step: Float64
) -> None:
    """Steps of the points (M, 3) that go with the steps `x` of the cameras and of the offset."""
    rest = np.empty(3)
    has_offset = x.shape[0] % 6 == 1
    for m in range(step.shape[0]):
        rest[0], rest[1], rest[2] = g[m, 0], g[m, 1], g[m, 2]
        if has_offset:
            for j in range(3):
                rest[j] -= U[m, j] * x[-1]
        for o in range(start[m], start[m + 1]):
            first = row[pose[o]] * 6
            if first < 0:
                continue
            for j in range(3):
                for i in range(6):
                    rest[j] -= W[o, i, j] * x[first + i]
        for i in range(3):
            step[m, i] = V[m, i, 0] * rest[0] + V[m, i, 1] * rest[1] + V[m, i, 2] * rest[2]


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
        cost, weight = huber_of(r, information[m], width)
        total += cost
        pose_jacobian(lens, p, not np.isnan(seen[m, 2]), J)
        w_uv, w_d = weight * information[m, 0], weight * information[m, 1]
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
                value = value * (1 + damping) + 1e-9  # what nothing estimates stays
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
def _descend(
    lens: Float64, R: Float64, t: Float64, X: Float64, seen: Float64, information: Float64, width: float,
    search: tuple[float, float, float, float], most: int, S: Float64,
) -> bool:  # fmt: skip
    """Move a camera in at most so many steps of `minimise`; False if the equations of one have no solution.

    `search` is the first damping, the least, the largest, and the relative decrease of the cost that is enough. S
    (6, 6) receives the normal equations there.
    """
    damping, least, largest, enough = search
    b, x, b_new = np.empty(6), np.empty(6), np.empty(6)
    R_new, t_new, S_new = np.empty((3, 3)), np.empty(3), np.empty((6, 6))
    before = pose_equations(lens, R, t, X, seen, information, width, S, b)
    for _ in range(most):
        is_solvable, is_lower, cost = False, False, before
        while damping <= largest and not is_lower:
            if _solve(S, b, damping, x):
                _turned(R, t, x, R_new, t_new)
                cost = pose_equations(lens, R_new, t_new, X, seen, information, width, S_new, b_new)
                is_solvable, is_lower = True, cost <= before
            damping = max(damping / 10, least) if is_lower else damping * 10
        if not is_lower:
            return is_solvable
        for i in range(6):  # copies of whole arrays compile for seconds: they can raise a message of shapes
            b[i] = b_new[i]
            for j in range(6):
                S[i, j] = S_new[i, j]
        for i in range(3):
            t[i] = t_new[i]
            for j in range(3):
                R[i, j] = R_new[i, j]
        is_enough, before = before - cost <= enough * before, cost
        if is_enough:
            break
    return True


@kernel
def fit_camera(
    lens: Float64, R: Float64, t: Float64, X: Float64, seen: Float64, information: Float64, width: float,
    search: tuple[float, float, float, float], gates: Float64, fewest: int, steps: tuple[int, int], rows: Int64,
    S: Float64, distance: Float64,
) -> int:  # fmt: skip
    """Move a camera R, t to where it sees X (M, 3) best at `seen` (M, 3), with fewer and fewer outliers.

    For each of the gates it is moved, in at most ``steps[0]`` steps, and points whose residuals are longer, in standard
    deviations, are dropped: the others move up in X, `seen`, `information` and `rows` (M,). Then it is moved in at most
    ``steps[1]``. S (6, 6) receives the normal equations there, `distance` (M,) the length of each residual: infinity
    where the point is behind. Returns how many points are left, as soon as these are fewer than `fewest`; -1 if the
    equations of a step have no solution.
    """
    p, r, count = np.empty(3), np.empty(3), X.shape[0]
    for turn in range(gates.shape[0] + 1):
        is_last = turn == gates.shape[0]
        if count < fewest:
            return count
        given, most = (X[:count], seen[:count], information[:count]), steps[1] if is_last else steps[0]
        if not _descend(lens, R, t, *given, width, search, most, S):
            return -1
        left = 0
        for m in range(count):
            distance[m] = np.inf
            if residual(lens, R, t, X[m], seen[m], p, r):
                distance[m] = np.sqrt(square_of(r, information[m]))
            if not is_last and distance[m] <= gates[turn]:
                for i in range(3):
                    X[left, i], seen[left, i] = X[m, i], seen[m, i]
                information[left, 0], information[left, 1] = information[m, 0], information[m, 1]
                rows[left] = rows[m]
                left += 1
        count = count if is_last else left
    return count


@reassociated_kernel
def _dot(a: Float64, b: Float64) -> float:
    total = 0.0
    for k in range(a.shape[0]):
        total += a[k] * b[k]
    return total


@kernel
def solve_positive(S: Float64, b: Float64) -> bool:
    """Solve ``S x = b`` for a symmetric positive S, of which the lower half is read and overwritten by its factor.

    `b` (n,) receives x. False if S is not positive; both then hold nothing of use.
    """
    n = S.shape[0]
    begin = np.empty(n, np.int64)
    for i in range(n):
        begin[i] = i
        for j in range(i):
            if S[i, j] != 0:
                begin[i] = j
                break
        for j in range(begin[i], i + 1):
            first = max(begin[i], begin[j])
            value = S[i, j] - _dot(S[i, first:j], S[j, first:j])
            if j < i:
                S[i, j] = value / S[j, j]
            elif value > 0:
                S[i, i] = np.sqrt(value)
            else:
                return False
        b[i] = (b[i] - _dot(S[i, begin[i] : i], b[begin[i] : i])) / S[i, i]
    for i in range(n - 1, -1, -1):
        b[i] /= S[i, i]
        for j in range(begin[i], i):
            b[j] -= S[i, j] * b[i]
    return True
