"""Compiled loops of binary descriptors: how far apart two are, the nearest both ways at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, kernel

Words = NDArray[np.uint64]
Int64 = NDArray[np.int64]

_FAR = np.iinfo(np.int64).max  # bits: beyond all


@inlined
def hamming(a: Words, b: Words) -> np.int64:
    """Count the bits in which two rows of 64-bit words differ."""
    total = np.uint64(0)
    for k in range(a.shape[0]):
        x = a[k] ^ b[k]
        x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
        x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
        x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        total += (x * np.uint64(0x0101010101010101)) >> np.uint64(56)
    return np.int64(total)


@kernel
def nearest_both_ways(first: Words, second: Words, nearest: Int64, bits: Int64, back: Int64) -> None:
    """Find the nearest of the others, of equals the lower row; how many bits it and the next are away, (N, 2)."""
    least, away = np.empty(second.shape[0], np.int64), np.empty(second.shape[0], np.int64)
    least[:] = _FAR
    for i in range(first.shape[0]):
        for j in range(second.shape[0]):
            away[j] = hamming(first[i], second[j])
        best, best_bits, next_bits = -1, _FAR, _FAR
        for j in range(second.shape[0]):
            if away[j] < least[j]:
                least[j], back[j] = away[j], i
            if away[j] < next_bits:
                if away[j] < best_bits:
                    best, best_bits, next_bits = j, away[j], best_bits
                else:
                    next_bits = away[j]
        nearest[i], bits[i, 0], bits[i, 1] = best, best_bits, next_bits
