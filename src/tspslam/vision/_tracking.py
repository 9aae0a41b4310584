"""Compiled search for landmarks among the keypoints near their predicted places."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, kernel

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]
Words = NDArray[np.uint64]

_CELL = 32.0  # px, of the grid that keypoints are sorted into
_SCALES = 1.7  # ratio of the scales of a landmark and its keypoint, at most
_FAR = 1 << 30


@inlined
def _hamming(a: Words, b: Words) -> np.int64:
    """Bits in which two descriptors differ."""
    total = np.int64(0)
    for k in range(a.shape[0]):
        v = a[k] ^ b[k]
        v = v - ((v >> np.uint64(1)) & np.uint64(0x5555555555555555))
        v = (v & np.uint64(0x3333333333333333)) + ((v >> np.uint64(2)) & np.uint64(0x3333333333333333))
        v = (v + (v >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        total += np.int64((v * np.uint64(0x0101010101010101)) >> np.uint64(56))
    return total


@kernel
def search_near(
    uv: Float64, words: Words, scale: Float64, places: Float64, wanted: Words, sizes: Float64, radius: float,
    best: Int64, distance: Int64, rival: Int64,
) -> None:  # fmt: skip
    """Nearest descriptor among the keypoints around each place: its row in `best` (-1: none), and two distances.

    Keypoints count that lie within `radius` times the landmark's scale in both directions, at a like scale.
    """
    columns, rows = int(uv[:, 0].max() / _CELL) + 2, int(uv[:, 1].max() / _CELL) + 2
    head, following = np.full((rows, columns), -1), np.empty(uv.shape[0], np.int64)
    for i in range(uv.shape[0]):
        row, column = int(uv[i, 1] / _CELL), int(uv[i, 0] / _CELL)
        following[i] = head[row, column]
        head[row, column] = i
    for p in range(places.shape[0]):
        best[p], distance[p], rival[p] = -1, _FAR, _FAR
        reach, u, v = radius * sizes[p], places[p, 0], places[p, 1]
        top, bottom = max(int((v - reach) / _CELL), 0), min(int((v + reach) / _CELL), rows - 1)
        left, right = max(int((u - reach) / _CELL), 0), min(int((u + reach) / _CELL), columns - 1)
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                i = head[row, column]
                while i >= 0:
                    ratio = scale[i] / sizes[p]
                    near = abs(uv[i, 0] - u) <= reach and abs(uv[i, 1] - v) <= reach
                    if near and ratio < _SCALES and ratio * _SCALES > 1:
                        bits = _hamming(words[i], wanted[p])
                        if bits < distance[p] or (bits == distance[p] and i < best[p]):
                            rival[p] = distance[p]
                            distance[p], best[p] = bits, i
                        elif bits < rival[p]:
                            rival[p] = bits
                    i = following[i]
