"""Binary descriptors compared by their Hamming distance; real ones made binary first."""

from __future__ import annotations

from typing import Any

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


def nearest_descriptors(first: Descriptors, second: Descriptors, *, max_hamming: float) -> NDArray[np.int64]:
    """Find which rows of the second descriptors are the nearest to some of the first.

    Parameters
    ----------
    first, second : (N, P), (M, P) uint64
        Binary descriptors.
    max_hamming : float
        Largest distance, bits in 256; longer descriptors in proportion.

    Returns
    -------
    (K,) int64
        Rows of `second`, one for each row of `first` that has one near enough.
    """
    if not _are_comparable(first, second, 1):
        return np.empty(0, np.int64)
    found = _matcher().match(first.view(np.uint8), second.view(np.uint8))
    return np.array([one.trainIdx for one in found if one.distance <= _farthest(first, max_hamming)], np.int64)


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
    if not _are_comparable(first, second, 2):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    one, other, most = first.view(np.uint8), second.view(np.uint8), _farthest(first, max_hamming)
    back = {(match.trainIdx, match.queryIdx) for match in _matcher().match(other, one)}
    forth = [best for best, next_ in _matcher().knnMatch(one, other, k=2) if best.distance <= ratio * next_.distance]
    pairs = [(match.queryIdx, match.trainIdx) for match in forth if match.distance <= most]
    i, j = np.array([pair for pair in pairs if pair in back], np.int64).reshape(-1, 2).T
    return i, j


def _are_comparable(first: Descriptors, second: Descriptors, least: int) -> bool:
    return min(len(first), len(second)) >= least and first.shape[1] > 0


def _matcher() -> Any:
    import cv2

    return cv2.BFMatcher(cv2.NORM_HAMMING)


def _farthest(descriptors: Descriptors, max_hamming: float) -> float:
    return max_hamming * descriptors.shape[1] / 4
