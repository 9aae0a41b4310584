"""Compiled loops of closing loops: which keyframes share landmarks, and how well these fix their relative poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import kernel
from ..least_squares._kernels import pose_jacobian, residual

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@kernel
def sights_of_landmarks(landmark: Int64, count: int) -> tuple[Int64, Int64]:
    """Observations by landmark, in order: those of m are ``sight[start[m] : start[m + 1]]``."""
    start = np.zeros(count + 1, np.int64)
    for m in landmark:
        start[m + 1] += 1
    start[:] = np.cumsum(start)
    end, sight = start[:-1].copy(), np.empty(landmark.shape[0], np.int64)
    for o in range(landmark.shape[0]):
        sight[end[landmark[o]]] = o
        end[landmark[o]] += 1
    return start, sight


@kernel
def shared_pairs(
    landmark: Int64, frame: Int64, begin: Int64, start: Int64, sight: Int64, least: int
) -> tuple[Int64, Int64, Int64]:
    """Pairs i < j of keyframes that follow each other, or see `least` landmarks in common.

    Keyframe i has the observations ``begin[i] <= o < begin[i + 1]``; its pairs are ``second[first[i] : first[i + 1]]``,
    with the numbers of landmarks in common beside.
    """
    n = begin.shape[0] - 1
    first, shared = np.zeros(n + 1, np.int64), np.zeros(n, np.int64)
    second, common, size = np.empty(8 * n + 8, np.int64), np.empty(8 * n + 8, np.int64), 0
    for i in range(n):
        last = i
        for o in range(begin[i], begin[i + 1]):
            m = landmark[o]
            for s in range(start[m], start[m + 1]):
                j = frame[sight[s]]
                if j > i:
                    shared[j] += 1
                    last = max(last, j)
        for j in range(i + 1, max(last, min(i + 1, n - 1)) + 1):
            if shared[j] >= least or j == i + 1:
                if size == second.shape[0]:
                    second = np.concatenate((second, np.empty(size, np.int64)))
                    common = np.concatenate((common, np.empty(size, np.int64)))
                second[size], common[size] = j, shared[j]
                size += 1
            shared[j] = 0
        first[i + 1] = size
    return first, second[:size], common[:size]


@kernel
def information_of(
    lens: Float64, R: Float64, t: Float64, X: Float64, landmark: Int64, begin: Int64, seen: Float64, weight: Float64,
    information: Float64,
) -> None:  # fmt: skip
    """Fill what its sights tell of the pose of each camera, (6, 6), in its own frame.

    `weight` (O, 2) is the information of a pixel and of a disparity.
    """
    p, r, J = np.empty(3), np.empty(3), np.empty((3, 6))
    for k in range(R.shape[0]):
        S = information[k]
        S[:] = 0
        for o in range(begin[k], begin[k + 1]):
            if not residual(lens, R[k], t[k], X[landmark[o]], seen[o], p, r):
                continue
            pose_jacobian(lens, p, not np.isnan(seen[o, 2]), J)
            for a in range(6):
                u, v, d = weight[o, 0] * J[0, a], weight[o, 0] * J[1, a], weight[o, 1] * J[2, a]
                for b in range(a + 1):
                    S[a, b] += u * J[0, b] + v * J[1, b] + d * J[2, b]
        for a in range(6):
            for b in range(a):
                S[b, a] = S[a, b]
