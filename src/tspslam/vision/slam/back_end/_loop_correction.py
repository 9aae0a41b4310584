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
) -> tuple[Int64, Int64]:
    """Pairs i < j of keyframes that follow each other, or see `least` landmarks in common: j of each, and their bounds.

    Keyframe i has the observations ``begin[i] <= o < begin[i + 1]``; its pairs are ``second[first[i] : first[i + 1]]``.
    """
    n = begin.shape[0] - 1
    first, shared = np.zeros(n + 1, np.int64), np.zeros(n, np.int64)
    second, size = np.empty(8 * n + 8, np.int64), 0
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
                second[size] = j
                size += 1
            shared[j] = 0
        first[i + 1] = size
    return first, second[:size]


@kernel
def add_information(
    lens: Float64, R: Float64, t: Float64, X: Float64, seen: Float64, weight: Float64, sum_: Float64
) -> None:
    """Add the information (6, 6) on a camera at R, t from one sight of X; `weight` has a pixel and a disparity."""
    p, r, J = np.empty(3), np.empty(3), np.empty((3, 6))
    if not residual(lens, R, t, X, seen, p, r):
        return
    pose_jacobian(lens, p, not np.isnan(seen[2]), J)
    for a in range(6):
        u, v, d = weight[0] * J[0, a], weight[0] * J[1, a], weight[1] * J[2, a]
        for b in range(6):
            sum_[a, b] += u * J[0, b] + v * J[1, b] + d * J[2, b]


@kernel
def pair_information(
    lens: Float64, R: Float64, t: Float64, X: Float64, landmark: Int64, frame: Int64, begin: Int64, seen: Float64,
    weight: Float64, start: Int64, sight: Int64, first: Int64, second: Int64, information: Float64,
) -> None:  # fmt: skip
    """Add, for each pair (i, j), what the landmarks in common tell of j's pose: (6, 6), in the frame of j."""
    n = begin.shape[0] - 1
    slot = np.full(n, -1)
    for i in range(n):
        for e in range(first[i], first[i + 1]):
            slot[second[e]] = e
        for o in range(begin[i], begin[i + 1]):
            m = landmark[o]
            for s in range(start[m], start[m + 1]):
                other = sight[s]
                j = frame[other]
                if slot[j] >= 0:
                    add_information(lens, R[j], t[j], X[m], seen[other], weight[other], information[slot[j]])
        for e in range(first[i], first[i + 1]):
            slot[second[e]] = -1
