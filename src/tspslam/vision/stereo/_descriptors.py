"""Compiled loops of matching: the nearest descriptors along rows."""

from __future__ import annotations

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from ..._jit import inlined, kernel
from ..features._hamming import hamming

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Words = NDArray[np.uint64]

FAR = 1e12  # a distance of descriptors beyond all real ones


@inlined
def euclidean(a: Float32, b: Float32) -> float:
    """Distance of two real vectors."""
    total = 0.0
    for k in range(a.shape[0]):
        total += (a[k] - b[k]) * (a[k] - b[k])
    return np.sqrt(total)


def distance_of(a: Words | Float32, b: Words | Float32) -> float:
    """Distance of two descriptors: Hamming of 64-bit words, Euclidean of real ones. Compiled only."""
    raise NotImplementedError


@overload(distance_of, inline="always")
def _distance_of(a, b):  # type: ignore[no-untyped-def]
    if isinstance(a.dtype, types.Integer):
        return lambda a, b: float(hamming(a, b))
    return lambda a, b: euclidean(a, b)


@inlined
def candidates(point: Float64, other: Float64, begin: int, end: int, limits: Float64, chosen: Int64) -> int:
    """List the keypoints of a slice that agree with a point (u, v, scale) in row, scale and range of disparity.

    `limits` holds the range of u - u_other, px, and the largest difference of rows, px per unit of scale.
    """
    count = 0
    u, v, scale = point[0], point[1], point[2]
    first, last, smallest, largest = u - limits[1], u - limits[0], scale / 1.25, scale * 1.25
    for j in range(begin, end):
        alike = first <= other[j, 0] <= last and smallest <= other[j, 2] <= largest
        if alike and abs(v - other[j, 1]) <= limits[2] * max(scale, other[j, 2]):
            chosen[count] = j
            count += 1
    return count


@inlined
def best_of(
    words: Words | Float32, other: Float64, other_words: Words | Float32, chosen: Int64, distance: Float64, apart: float
) -> tuple[int, float, float]:
    """Nearest descriptor, its distance, and that of the nearest one that stands more than `apart` px from it."""
    best, nearest, second = -1, FAR, FAR
    for k in range(chosen.shape[0]):
        distance[k] = distance_of(words, other_words[chosen[k]])
        if distance[k] < nearest:
            best, nearest = chosen[k], distance[k]
    for k in range(chosen.shape[0]):
        if distance[k] < second and abs(other[chosen[k], 0] - other[best, 0]) > apart:
            second = distance[k]
    return best, nearest, second


@kernel
def match_rows(
    points: Float64,
    words: Words | Float32,
    other: Float64,
    other_words: Words | Float32,
    row_start: Int64,
    limits: Float64,
) -> Float64:
    """Match each keypoint along its row of the other image, whose keypoints are sorted by rounded row.

    Parameters
    ----------
    points, other : (N, 3), (M, 3) float64
        Keypoints (u, v, scale).
    words, other_words : (N, D), (M, D) uint64 or float32
        Binary descriptors as words, or real ones.
    row_start : (H + 1,) int64
        Where each row begins in `other`.
    limits : (3,) float64
        As in `candidates`.

    Returns
    -------
    (N, 3) float64
        Index in `other` or -1, distance of the descriptors, distance of the second nearest that stands elsewhere.
    """
    rows = row_start.shape[0] - 1
    found = np.empty((points.shape[0], 3), np.float64)
    chosen, distance = np.empty(other.shape[0], np.int64), np.empty(other.shape[0], np.float64)
    for i in range(points.shape[0]):
        scale = points[i, 2]
        reach = limits[2] * 1.25 * scale + 1
        first = min(max(0, int(np.floor(points[i, 1] - reach))), rows)
        last = max(min(rows, int(np.ceil(points[i, 1] + reach)) + 1), first)
        count = candidates(points[i], other, row_start[first], row_start[last], limits, chosen)
        # The same corner on a neighbouring octave is no rival: two pixels of its scale apart.
        best, nearest, second = best_of(words[i], other, other_words, chosen[:count], distance, 2 * scale)
        found[i, 0], found[i, 1], found[i, 2] = best, nearest, second
    return found
