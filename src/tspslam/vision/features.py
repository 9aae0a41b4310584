"""What detectors share: grey levels, and the choice of keypoints that spreads them evenly."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..types import Features, FloatArray

SPREAD_RANGES: dict[str, tuple[float, float]] = {
    "count": (1, 1_000_000),
    "per_cell": (0.1, 1000.0),
    "spacing": (0.0, 1.0),
}
"""Ranges of the settings that `choose_evenly` takes."""

_TO_GREY_LEVELS = {"u1": 1.0, "u2": 1 / 257, "f4": 255.0, "f8": 255.0}


def grey_levels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit luminance of any supported image: Rec. 601 weights in float, then rounded once.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array
        uint8, uint16, or float in [0, 1]; colour is RGB.

    Returns
    -------
    (H, W) uint8

    Raises
    ------
    InputError
        If the shape or dtype is another one.

    Examples
    --------
    >>> grey_levels(np.full((1, 1), 65535, np.uint16)).tolist()
    [[255]]
    >>> grey_levels(np.array([[[255, 0, 0]]], np.uint8)).tolist()
    [[76]]
    """
    if image.ndim == 2 and image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    return np.rint(luminance_levels(image)).astype(np.uint8)


def luminance_levels(image: NDArray[Any]) -> NDArray[np.float32]:
    """Luminance of any supported image in 8-bit grey levels, not rounded.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) array
        uint8, uint16, or float in [0, 1]; colour is RGB, weighed by Rec. 601.

    Returns
    -------
    (H, W) float32
        0 to 255.

    Raises
    ------
    InputError
        If the shape or dtype is another one.

    Examples
    --------
    >>> luminance_levels(np.full((1, 1), 0.5, np.float32)).tolist()
    [[127.5]]
    """
    to_grey = _TO_GREY_LEVELS.get(image.dtype.str[1:])
    if to_grey is None or image.size == 0 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InputError(
            f"image: {image.dtype} of shape {image.shape}, expected (H, W) or (H, W, 3) of uint8, uint16 or float"
        )
    plane: NDArray[np.float32] = image.astype(np.float32)
    if image.ndim == 3:
        import cv2

        plane = cv2.cvtColor(plane, cv2.COLOR_RGB2GRAY)  # Rec. 601
    if to_grey != 1.0:
        plane *= np.float32(to_grey)
    return np.clip(plane, 0, 255, out=plane)


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
        How many a cell gives in the mean; smaller spreads more evenly.
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


def check_ranges(what: str, detector: object, ranges: dict[str, tuple[float, float]]) -> None:
    """Raise InputError unless each attribute of `detector` lies in its range."""
    for name, (low, high) in ranges.items():
        value = getattr(detector, name)
        if not low <= value <= high:
            raise InputError(f"{what}: {name} is {value}, expected {low} to {high}")


def check_plane(what: str, grey: NDArray[Any]) -> None:
    """Raise InputError unless an image is a plane of uint8."""
    if grey.ndim != 2 or grey.dtype != np.uint8:
        raise InputError(f"{what}: image is {grey.dtype} of shape {grey.shape}, expected (H, W) uint8")


def no_features(size: int, dtype: type[np.uint8] | type[np.float32]) -> Features:
    """Features of an image in which nothing was found; descriptors are (0, size)."""
    nothing = np.zeros(0, np.float32)
    descriptor: Any = np.zeros((0, size), dtype)
    return Features(np.zeros((0, 2)), descriptor, nothing, nothing, nothing)


def _strongest_first(strength: NDArray[np.float32]) -> NDArray[np.int64]:
    """Stable order by falling strength; bits of positive floats sort as integers, with the row below them."""
    falling = np.uint64(0xFFFFFFFF) - strength.view(np.uint32).astype(np.uint64)
    keys = np.sort((falling << np.uint64(32)) | np.arange(len(strength), dtype=np.uint64))
    return (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)
