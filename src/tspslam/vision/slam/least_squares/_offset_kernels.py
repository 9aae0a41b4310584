"""Compiled loop of what a path says of its cameras: equations of quantities of the calibration, points eliminated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel
from ._kernels import huber_of, pose_jacobian, residual

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
Bool = NDArray[np.bool_]


@inlined
def _by_point(J: Float64, R: Float64, G: Float64) -> None:
    """Fill `G` (3, 3): derivatives of (u, v, d) by the point are those by the camera's shift, turned."""
    for i in range(3):
        for j in range(3):
            G[i, j] = J[i, 3] * R[0, j] + J[i, 4] * R[1, j] + J[i, 5] * R[2, j]


@inlined
def _less_steps(r: Float64, own: int, H: Float64, J: Float64, delta: Float64, x: Float64, first: int) -> None:
    """Take from a residual what the steps of its keyframe's offset, of the quantities and of the camera explain."""
    if own >= 0:
        r[2] -= delta[own]
    shift = delta.shape[0] - H.shape[1]
    for i in range(3):
        for e in range(H.shape[1]):
            r[i] -= H[i, e] * delta[shift + e]
        if first >= 0:
            for j in range(6):
                r[i] -= J[i, j] * x[first + j]


@inlined
def _weighed(r: Float64, information: Float64, width: float, w: Float64) -> None:
    """Fill `w` with the weights of (u, v, d) at a residual."""
    weight = huber_of(r, information, width)[1]
    w[0] = w[1] = weight * information[0]
    w[2] = weight * information[1]


@inlined
def _touched(own: Int32, start: int, end: int, more: int, size: int, is_in: Bool, columns: Int64) -> int:
    """Fill in which columns a point has a part: those of the keyframes that see it, and the last `more`; how many."""
    count = 0
    for o in range(start, end):
        if own[o] >= 0 and not is_in[own[o]]:
            is_in[own[o]] = True
            columns[count] = own[o]
            count += 1
    for c in range(count):
        is_in[columns[c]] = False
    for c in range(size - more, size):
        columns[count] = c
        count += 1
    return count


@kernel
def offset_equations(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, start: Int64, seen: Float64, information: Float64,
    width: float, row: Int32, own: Int32, H: Float64, W: Float64, V: Float64, C: Float64, N: Float64, b: Float64,
) -> None:  # fmt: skip
    """Fill the equations of Q quantities: C (6K, Q), the part that cameras share, N (Q, Q), and the right side b (Q,).

    The first arguments, W and V are those of `_kernels.reduce`, which has filled the latter. The first quantities are
    offsets of disparities: `own` (O,) says which one an observation has, -1 for none. H (O, 3, E) are derivatives of
    (u, v, disparity) by the last E.
    """
    size, more = N.shape[0], H.shape[2]
    p, r, J, G = np.empty(3), np.empty(3), np.empty((3, 6)), np.empty((3, 3))
    U, Y, g, w = np.empty((3, size)), np.empty((3, size)), np.empty(3), np.empty(3)
    is_in, columns = np.zeros(size, np.bool_), np.empty(size, np.int64)
    C[:], N[:], b[:] = 0, 0, 0
    for m in range(X.shape[0]):
        count = _touched(own, start[m], start[m + 1], more, size, is_in, columns)
        g[:] = 0
        for a in range(count):
            U[:, columns[a]] = 0
        for o in range(start[m], start[m + 1]):
            k, first = pose[o], row[pose[o]] * 6
            if not residual(lens, R[k], t[k], X[m], seen[o], p, r):
                continue
            pose_jacobian(lens, p, not np.isnan(seen[o, 2]), J)
            _by_point(J, R[k], G)
            _weighed(r, information[o], width, w)
            for i in range(3):
                for j in range(3):
                    g[j] += G[i, j] * w[i] * r[i]
                for a in range(-1 if i == 2 and own[o] >= 0 else 0, more):
                    c = own[o] if a < 0 else size - more + a
                    part = w[i] * (1.0 if a < 0 else H[o, i, a])
                    b[c] += part * r[i]
                    for e in range(more):
                        N[c, size - more + e] += part * H[o, i, e]
                    if i == 2 and own[o] >= 0:
                        N[c, own[o]] += part
                    for j in range(3):
                        U[j, c] += part * G[i, j]
                    if first >= 0:
                        for j in range(6):
                            C[first + j, c] += part * J[i, j]
        for a in range(count):
            c = columns[a]
            for j in range(3):
                Y[j, c] = V[m, j, 0] * U[0, c] + V[m, j, 1] * U[1, c] + V[m, j, 2] * U[2, c]
            b[c] -= Y[0, c] * g[0] + Y[1, c] * g[1] + Y[2, c] * g[2]
            for other in range(count):
                e = columns[other]
                N[c, e] -= Y[0, c] * U[0, e] + Y[1, c] * U[1, e] + Y[2, c] * U[2, e]
        for o in range(start[m], start[m + 1]):
            first = row[pose[o]] * 6
            if first < 0:
                continue
            for i in range(6):
                for a in range(count):
                    c = columns[a]
                    C[first + i, c] -= W[o, i, 0] * Y[0, c] + W[o, i, 1] * Y[1, c] + W[o, i, 2] * Y[2, c]


@kernel
def offset_votes(
    lens: Float64, R: Float64, t: Float64, X: Float64, pose: Int32, start: Int64, seen: Float64, information: Float64,
    width: float, row: Int32, own: Int32, H: Float64, W: Float64, V: Float64, along: Float64, toward: Float64,
    delta: Float64, x: Float64, votes: Float64,
) -> None:  # fmt: skip
    """Fill how far each point pulls D steps, `votes` (M, D), after steps `delta` (Q,) and those of the cameras, `x`.

    The first arguments are those of `offset_equations`; `along` (Q, D) are the steps of the quantities, and `toward`
    (6K, D) those by which the cameras follow.
    """
    more, size = H.shape[2], along.shape[1]
    shift = along.shape[0] - more
    p, r, J, G = np.empty(3), np.empty(3), np.empty((3, 6)), np.empty((3, 3))
    U, g, w, rest = np.empty((3, size)), np.empty(3), np.empty(3), np.empty(3)
    votes[:] = 0
    for m in range(X.shape[0]):
        U[:], g[:] = 0, 0
        for o in range(start[m], start[m + 1]):
            k, first = pose[o], row[pose[o]] * 6
            if not residual(lens, R[k], t[k], X[m], seen[o], p, r):
                continue
            pose_jacobian(lens, p, not np.isnan(seen[o, 2]), J)
            _by_point(J, R[k], G)
            _weighed(r, information[o], width, w)
            _less_steps(r, own[o], H[o], J, delta, x, first)
            for i in range(3):
                for j in range(3):
                    g[j] += G[i, j] * w[i] * r[i]
                for a in range(-1 if i == 2 and own[o] >= 0 else 0, more):
                    c = own[o] if a < 0 else shift + a
                    part = w[i] * (1.0 if a < 0 else H[o, i, a])
                    for d in range(size):
                        votes[m, d] += part * r[i] * along[c, d]
                        for j in range(3):
                            U[j, d] += part * G[i, j] * along[c, d]
            if first >= 0:
                for j in range(6):
                    turn = w[0] * J[0, j] * r[0] + w[1] * J[1, j] * r[1] + w[2] * J[2, j] * r[2]
                    for d in range(size):
                        votes[m, d] -= turn * toward[first + j, d]
        for j in range(3):
            rest[j] = V[m, j, 0] * g[0] + V[m, j, 1] * g[1] + V[m, j, 2] * g[2]
        for d in range(size):
            votes[m, d] -= U[0, d] * rest[0] + U[1, d] * rest[1] + U[2, d] * rest[2]
        for o in range(start[m], start[m + 1]):
            first = row[pose[o]] * 6
            if first < 0:
                continue
            for j in range(6):
                turn = W[o, j, 0] * rest[0] + W[o, j, 1] * rest[1] + W[o, j, 2] * rest[2]
                for d in range(size):
                    votes[m, d] += turn * toward[first + j, d]
