"""What detectors share: grey levels, and the choice of keypoints that spreads them evenly."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...types import Features, FloatArray


def choose_evenly(
    uv: FloatArray,
    strength: NDArray[np.float32],
    shape: tuple[int, ...],
    count: int,
    *,
    per_cell: float = 6.0,
    spacing: float = 0.5,
) -> NDArray[np.int64]:
    """Choose keypoints that are strong and spread over the image.

    The image is cut into square cells, which take turns in giving their strongest remaining keypoint until `count`
    are chosen. Of keypoints close to each other the strongest stays.

    Parameters
    ----------
    uv : (N, 2) float64
        Positions, px, inside the image.
    strength : (N,) float32
        Detector response, not negative.
    shape : (H, W)
        Size of the image, px.
    count : int
        How many are wanted.
    per_cell : float
        How many a cell gives on average; smaller spreads more evenly.
    spacing : float
        Least distance of two, as a share of ``sqrt(H W / count)``, the distance in a regular grid.

    Returns
    -------
    (M,) int64
        Ascending rows of `uv`, M <= count.

    Examples
    --------
    >>> uv = np.array([[5.0, 5.0], [6.0, 5.0], [50.0, 50.0]])
    >>> choose_evenly(uv, np.array([1, 2, 0.1], np.float32), (60, 60), 2).tolist()
    [1, 2]
    """
    from ._corners import spread

    height, width = shape
    apart = math.sqrt(height * width / count)
    side = max(8.0, apart * math.sqrt(per_cell))
    order = _strongest_first(strength)
    return np.sort(spread(uv, order, side, int(spacing * apart), width, height, count))


def check_plane(what: str, grey: NDArray[Any]) -> None:
    """Raise `InputError` unless an image is a plane of uint8.

    Parameters
    ----------
    what : str
        How the error begins.
    grey : (H, W) uint8
        The image.
    """
    if grey.ndim != 2 or grey.dtype != np.uint8:
        raise InputError(f"{what}: image is {grey.dtype} of shape {grey.shape}, expected (H, W) uint8")


def no_features(size: int, dtype: type[np.uint8] | type[np.float32]) -> Features:
    """Features of an image in which nothing was found.

    Parameters
    ----------
    size : int
        Numbers of a descriptor.
    dtype : type
        Of the descriptors: `numpy.uint8` or `numpy.float32`.

    Returns
    -------
    Features
        No rows; descriptors are (0, size).
    """
    nothing = np.zeros(0, np.float32)
    descriptor: Any = np.zeros((0, size), dtype)
    return Features(np.zeros((0, 2)), descriptor, nothing, nothing, nothing)


def _strongest_first(strength: NDArray[np.float32]) -> NDArray[np.int64]:
    """Stable order by falling strength: bits of positive floats sort as integers."""
    from ._corners import order_by_key

    order: NDArray[np.int64] = order_by_key(np.uint32(0xFFFFFFFF) - strength.view(np.uint32))
    return order
