"""Keypoints with descriptors, spread evenly over the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..types import Features

_TO_GREY_LEVELS = {"u1": 1.0, "u2": 1 / 257, "f4": 255.0, "f8": 255.0}
_EDGE = 19  # px at each level that ORB needs around a keypoint
_PATCH = 31  # px, diameter of ORB's patch


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


@dataclass(frozen=True)
class OrbDetector:
    """ORB keypoints and descriptors (Rublee et al. 2011), spread evenly over the image.

    ORB's corners are oversampled; the image is cut into square cells, and cells take turns in giving their best
    remaining corner until `count` are found. Of corners that fall on one pixel at several octaves, the best stays.

    Parameters
    ----------
    count : int
        Keypoints wanted; fewer are returned where there is less texture.
    scale_factor : float
        Ratio of neighbouring octaves, above 1.
    levels : int
        Octaves.
    fast_threshold : int
        Contrast of a corner, grey levels.
    oversampling : float
        Corners looked at per keypoint wanted.
    per_cell : float
        Keypoints a cell holds in the mean; smaller spreads more evenly.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 256, (120, 160), np.uint8)
    >>> features = OrbDetector(count=100)(noise)
    >>> features.uv.shape, features.descriptor.shape
    ((100, 2), (100, 32))
    """

    count: int = 2000
    scale_factor: float = 1.2
    levels: int = 8
    fast_threshold: int = 10
    oversampling: float = 1.5
    per_cell: float = 6.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        ranges = {
            "count": (1, 1_000_000),
            "scale_factor": (1.01, 4.0),
            "levels": (1, 16),
            "fast_threshold": (1, 254),
            "oversampling": (1.0, 100.0),
            "per_cell": (0.1, 1000.0),
        }
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(f"orb: {name} is {value}, expected {low} to {high}")

    def __call__(self, grey: NDArray[np.uint8]) -> Features:
        """Detect keypoints.

        Parameters
        ----------
        grey : (H, W) uint8
            Luminance.

        Returns
        -------
        Features
            At most `count`, sorted by octave; descriptors (N, 32) uint8. Empty where there is no texture.

        Raises
        ------
        InputError
            If the image is not a plane of uint8.
        """
        if grey.ndim != 2 or grey.dtype != np.uint8:
            raise InputError(f"orb: image is {grey.dtype} of shape {grey.shape}, expected (H, W) uint8")
        levels = self._usable_levels(grey.shape)
        if levels == 0:
            return _no_features()
        import cv2

        orb = cv2.ORB.create(
            nfeatures=math.ceil(self.count * self.oversampling),
            scaleFactor=self.scale_factor,
            nlevels=levels,
            edgeThreshold=_EDGE,
            patchSize=_PATCH,
            fastThreshold=self.fast_threshold,
        )
        candidates = orb.detect(np.ascontiguousarray(grey), None)
        kept = self._spread(candidates, grey.shape) if candidates else []
        if not kept:
            return _no_features()
        described, descriptor = orb.compute(grey, kept)
        return _pack(described, descriptor, self.scale_factor)

    def _usable_levels(self, shape: tuple[int, ...]) -> int:
        """Octaves whose image is still larger than the margins."""
        ratio = min(shape) / (2 * _EDGE + 6)
        return 0 if ratio < 1 else min(self.levels, 1 + int(math.log(ratio) / math.log(self.scale_factor)))

    def _spread(self, candidates: Sequence[Any], shape: tuple[int, ...]) -> list[Any]:
        import cv2

        uv = np.asarray(cv2.KeyPoint.convert(candidates), np.float32)
        score = np.array([c.response for c in candidates])
        octave = np.array([c.octave for c in candidates])
        best = _best_per_pixel(uv, score)
        side = max(8, math.sqrt(shape[0] * shape[1] * self.per_cell / self.count))
        cell = (uv[best, 1] // side) * math.ceil(shape[1] / side) + uv[best, 0] // side
        turn = _rank_in_group(cell, -score[best])
        chosen = best[np.lexsort((-score[best], turn))[: self.count]]
        return [candidates[k] for k in chosen[np.lexsort((chosen, octave[chosen]))]]


def _best_per_pixel(uv: NDArray[np.float32], score: NDArray[np.float64]) -> NDArray[np.int64]:
    pixel = np.rint(uv).astype(np.int64) @ np.array([1, 1 << 20])
    order = np.lexsort((-score, pixel))
    new = np.diff(pixel[order], prepend=-1) != 0
    return np.sort(order[new])


def _rank_in_group(group: NDArray[Any], key: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rank of each element by key within its group, from 0."""
    order = np.lexsort((key, group))
    place = np.arange(len(order))
    new = np.diff(group[order], prepend=-1) != 0
    rank = np.empty(len(order), np.int64)
    rank[order] = place - np.maximum.accumulate(np.where(new, place, 0))
    return rank


def _pack(keypoints: Sequence[Any], descriptor: NDArray[np.uint8], scale_factor: float) -> Features:
    import cv2

    scale = scale_factor ** np.array([k.octave for k in keypoints], np.float64)
    # ORB multiplies level coordinates by the scale; pixel centres then sit (scale - 1)/2 off.
    uv = np.asarray(cv2.KeyPoint.convert(keypoints), np.float64) + (scale[:, None] - 1) / 2
    return Features(
        uv=uv,
        descriptor=descriptor,
        score=np.array([k.response for k in keypoints], np.float32),
        scale=scale.astype(np.float32),
        angle=np.radians(np.array([k.angle for k in keypoints], np.float32)),
    )


def _no_features() -> Features:
    nothing = np.zeros(0, np.float32)
    return Features(np.zeros((0, 2)), np.zeros((0, 32), np.uint8), nothing, nothing, nothing)
