"""Binary descriptors compared by their Hamming distance; real ones made binary first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Descriptors = NDArray[np.uint64]


def binary_descriptors(descriptor: NDArray[np.uint8] | NDArray[np.float32]) -> Descriptors:
    """Descriptors as binary ones in 64-bit parts; of real ones the signs of 256 random projections (Charikar 2002).

    Parameters
    ----------
    descriptor : (N, D) uint8 or float32
        Binary or real ones; D may be 0.

    Returns
    -------
    (N, P) uint64

    Examples
    --------
    >>> binary_descriptors(np.zeros((3, 32), np.uint8)).shape, binary_descriptors(np.ones((3, 128), np.float32)).shape
    ((3, 4), (3, 4))
    """
    if descriptor.shape[1] == 0:
        return np.zeros(descriptor.shape, np.uint64)
    if descriptor.dtype == np.uint8:
        spare = -descriptor.shape[1] % 8
        return np.ascontiguousarray(np.pad(descriptor, ((0, 0), (0, spare)))).view(np.uint64)
    axes = np.random.default_rng(0).standard_normal((descriptor.shape[1], 256))
    axes -= axes.mean(axis=0)  # no descriptor's mean counts
    return np.packbits(descriptor.astype(np.float64) @ axes > 0, axis=1).view(np.uint64)


def match_descriptors(
    first: Descriptors, second: Descriptors, *, max_hamming: float, ratio: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Match descriptors that are each other's nearest, and clearly so.

    Parameters
    ----------
    first, second : (N, P), (M, P) uint64
        Binary descriptors.
    max_hamming : float
        Largest distance, bits in 256; longer descriptors in proportion.
    ratio : float
        The distance must be at most this times that of the second nearest.

    Returns
    -------
    i, j : (K,) int64
        Rows of `first` and of `second`.
    """
    if min(len(first), len(second)) < 2 or first.shape[1] == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    from ._hamming import nearest_both_ways

    nearest, bits, back = (np.empty(shape, np.int64) for shape in (len(first), (len(first), 2), len(second)))
    nearest_both_ways(np.ascontiguousarray(first), np.ascontiguousarray(second), nearest, bits, back)
    is_clear = bits[:, 0] <= np.minimum(ratio * bits[:, 1], max_hamming * first.shape[1] / 4)
    i = np.flatnonzero(is_clear & (back[nearest] == np.arange(len(first))))
    return i, nearest[i]
