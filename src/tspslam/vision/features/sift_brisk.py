"""SIFT and BRISK keypoints of OpenCV, spread evenly like ORB's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._settings import Checked, copy_setting, setting
from ...types import Features
from .orb import OrbDetector
from .spread import check_plane, choose_evenly, no_features

_SMALLEST = 16  # px a side: below it OpenCV has no room for an octave, and fails in its own words
_BRISK_SIZE = 12.0  # px, what OpenCV calls the size of a BRISK keypoint at full resolution


@dataclass(frozen=True)
class SiftDetector(Checked, what="sift"):
    """SIFT keypoints (Lowe 2004) with real descriptors (128), compared by L2; spread evenly over the image.

    Attributes
    ----------
    count : int
        Keypoints wanted; fewer are returned where there is less texture.
    layers : int
        Scales an octave.
    contrast_threshold : float
        Least contrast of an extremum; 0 keeps all.
    edge_threshold : float
        Largest ratio of principal curvatures.
    sigma : float
        Blur of the first scale, px.
    per_cell : float
        Keypoints a cell of the image holds in the mean; smaller spreads more evenly.
    spacing : float
        Least distance of two keypoints, as a share of sqrt(H W / count), the distance in a regular grid.

    Raises
    ------
    InputError
        If a setting is out of its range.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 256, (120, 160), np.uint8)
    >>> SiftDetector(count=20)(noise).descriptor.shape[1]
    128
    """

    count: int = copy_setting(OrbDetector, "count")
    layers: int = setting(3, 1, 10, unit="scales", source="Lowe 2004, and OpenCV's")
    contrast_threshold: float = setting(
        0.01, 0.0, 1.0, unit="luminance of 1",
        source="by hand, to have a choice; Motorcycle: 0.005, 0.01, 0.04 (OpenCV's) give 1323, 1293, 782 points",
    )  # fmt: skip
    edge_threshold: float = setting(10.0, 1.0, 1000.0, unit="", source="Lowe 2004, and OpenCV's")
    sigma: float = setting(1.6, 0.8, 10.0, unit="px", source="Lowe 2004, and OpenCV's")
    per_cell: float = copy_setting(OrbDetector, "per_cell")
    spacing: float = copy_setting(OrbDetector, "spacing")

    def __call__(self, grey: NDArray[np.uint8]) -> Features:
        """Detect keypoints in an (H, W) uint8 image."""
        import cv2

        check_plane("sift", grey)
        sift = cv2.SIFT_create(  # type: ignore[attr-defined]
            nfeatures=0, nOctaveLayers=self.layers, contrastThreshold=self.contrast_threshold,
            edgeThreshold=self.edge_threshold, sigma=self.sigma,
            enable_precise_upscale=True,  # without it, keypoints are a quarter of a pixel off
        )  # fmt: skip
        chosen = _choose(sift, grey, self)
        return _describe(sift, grey, chosen, 2 * self.sigma) or no_features(128, np.float32)


@dataclass(frozen=True)
class BriskDetector(Checked, what="brisk"):
    """BRISK keypoints (Leutenegger et al. 2011) with 512-bit descriptors; spread evenly over the image.

    Attributes
    ----------
    count : int
        Keypoints wanted; fewer are returned where there is less texture.
    threshold : int
        Contrast of a corner in the AGAST test, grey levels.
    octaves : int
        Octaves; 0 for a single scale.
    per_cell : float
        Keypoints a cell of the image holds in the mean; smaller spreads more evenly.
    spacing : float
        Least distance of two keypoints, as a share of sqrt(H W / count), the distance in a regular grid.

    Raises
    ------
    InputError
        If a setting is out of its range.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 256, (120, 160), np.uint8)
    >>> BriskDetector(count=50)(noise).descriptor.shape[1]
    64
    """

    count: int = copy_setting(OrbDetector, "count")
    threshold: int = setting(
        10, 1, 254, unit="grey levels of 255",
        source="by hand, to have a choice; Motorcycle: 5, 10, 30 (OpenCV's) give 1364, 1281, 850 points",
    )  # fmt: skip
    octaves: int = setting(3, 0, 8, unit="octaves", source="OpenCV's; Motorcycle: 0, 3, 4 give 1254, 1281, 1282 points")
    per_cell: float = copy_setting(OrbDetector, "per_cell")
    spacing: float = copy_setting(OrbDetector, "spacing")

    def __call__(self, grey: NDArray[np.uint8]) -> Features:
        """Detect keypoints in an (H, W) uint8 image."""
        import cv2

        check_plane("brisk", grey)
        fitting = max(0, int(np.log2(min(grey.shape))) - 1)  # octaves that leave a pixel
        brisk = cv2.BRISK_create(self.threshold, min(self.octaves, fitting))  # type: ignore[attr-defined]
        chosen = _choose(brisk, grey, self)
        return _describe(brisk, grey, chosen, _BRISK_SIZE) or no_features(64, np.uint8)


def _choose(extractor: Any, grey: NDArray[np.uint8], detector: SiftDetector | BriskDetector) -> list[Any]:
    """OpenCV's keypoints that spread evenly over the image."""
    found = extractor.detect(grey, None) if min(grey.shape) >= _SMALLEST else ()
    if not found:
        return []
    uv = np.clip([point.pt for point in found], 0, (grey.shape[1] - 1, grey.shape[0] - 1))
    strength = np.array([point.response for point in found], np.float32)
    rows = choose_evenly(uv, strength, grey.shape, detector.count, per_cell=detector.per_cell, spacing=detector.spacing)
    return [found[row] for row in rows]


def _describe(extractor: Any, grey: NDArray[np.uint8], chosen: list[Any], unit: float) -> Features | None:
    """Features of OpenCV's keypoints, but those too near the border for a descriptor; `unit` is the size of scale 1."""
    if not chosen:
        return None
    described, descriptor = extractor.compute(grey, chosen)
    if not described:
        return None
    columns = [(*point.pt, point.response, point.size / unit, np.radians(point.angle)) for point in described]
    u, v, score, scale, angle = np.array(columns, np.float64).T
    return Features(
        np.column_stack([u, v]), descriptor, score.astype(np.float32),
        np.maximum(scale, 1).astype(np.float32), angle.astype(np.float32),
    )  # fmt: skip
