"""ORB keypoints: our own corners, spread evenly, with OpenCV's descriptors."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._settings import Checked, setting
from ...types import Features
from .spread import check_plane, choose_evenly, no_features

_EDGE = 19  # px at each level that ORB needs around a keypoint
_PATCH = 31  # px, diameter of ORB's patch


@dataclass(frozen=True)
class OrbDetector(Checked, what="orb"):
    """ORB keypoints and descriptors (Rublee et al. 2011), spread evenly over the image.

    Corners are peaks of the FAST segment test on each octave, ranked by Harris response and oriented by the centroid
    of their neighbourhood. The image is cut into square cells, which take turns in giving their best remaining corner
    until `count` are found. Of corners close to each other, at whatever octave, the strongest stays.

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
    per_cell : float
        Keypoints a cell holds in the mean; smaller spreads more evenly.
    spacing : float
        Least distance of two keypoints, as a share of sqrt(H W / count), the distance in a regular grid.

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

    count: int = setting(
        2000, 1, 1_000_000, unit="keypoints",
        source="ORB-SLAM2's for KITTI images; Motorcycle, ORB: 1000, 2000, 4000 give 658, 1304, 2547 points",
    )  # fmt: skip
    scale_factor: float = setting(1.2, 1.01, 4.0, unit="", source="OpenCV's and ORB-SLAM2's")
    levels: int = setting(8, 1, 16, unit="octaves", source="OpenCV's and ORB-SLAM2's")
    fast_threshold: int = setting(
        7, 1, 254, unit="grey levels of 255",
        source="the lower of ORB-SLAM2's; Motorcycle: 4, 7, 14 give 1307, 1304, 1213 points",
    )  # fmt: skip
    per_cell: float = setting(
        6.0, 0.1, 1000.0, unit="keypoints", source="by hand; Motorcycle, ORB: 3, 6, 12 give 1273, 1304, 1290 points"
    )
    spacing: float = setting(
        0.5, 0.0, 1.0, unit="", source="by hand; Motorcycle, ORB: 0.25, 0.5, 0.75 give 1335, 1304, 1093 points"
    )

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
        check_plane("orb", grey)
        planes = self._pyramid(np.ascontiguousarray(grey))
        corners = self._choose(_all_corners(planes, self.fast_threshold), grey.shape, len(planes))
        if len(corners.xy) == 0:
            return no_features(32, np.uint8)
        return self._describe(planes, corners, _orientations(planes, corners))

    def _pyramid(self, grey: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        """Octaves that are larger than the margins, each resampled from the one before."""
        import cv2

        planes: list[NDArray[np.uint8]] = []
        level: Any = grey
        for octave in range(self.levels):
            height, width = (round(side / self.scale_factor**octave) for side in grey.shape)
            if min(height, width) < 2 * _EDGE + 6:
                break
            if octave:
                level = cv2.resize(level, (width, height), interpolation=cv2.INTER_LINEAR_EXACT)
            planes.append(level)
        return planes

    def _choose(self, corners: _Corners, shape: tuple[int, ...], levels: int) -> _Corners:
        """Spread choice of the corners, sorted by octave."""
        height, width = shape
        uv = self._full_size(corners, levels)
        np.minimum(uv, (width - 1, height - 1), out=uv)
        chosen = choose_evenly(
            uv, corners.strength, (height, width), self.count, per_cell=self.per_cell, spacing=self.spacing
        )
        return _Corners(corners.xy[chosen], corners.octave[chosen], corners.strength[chosen])

    def _describe(self, planes: list[NDArray[np.uint8]], corners: _Corners, angle: NDArray[np.float64]) -> Features:
        """ORB's descriptors, octave by octave: of the whole image OpenCV would make these anew."""
        import cv2

        orb = cv2.ORB.create(nlevels=1, edgeThreshold=_EDGE, patchSize=_PATCH)
        descriptor, degrees = np.empty((len(angle), 32), np.uint8), np.degrees(angle)
        for plane, rows in zip(planes, _octaves(corners, len(planes)), strict=True):
            u, v = corners.xy[rows].T.tolist()
            keypoints = list(map(cv2.KeyPoint, u, v, itertools.repeat(_PATCH), degrees[rows].tolist()))
            if keypoints:
                described, descriptor[rows] = orb.compute(plane, keypoints)
                assert len(described) == len(keypoints)  # the margins leave none at the border
        scale = self._scales(len(planes))[corners.octave]
        uv = self._full_size(corners, len(planes))
        return Features(uv, descriptor, corners.strength, scale.astype(np.float32), angle.astype(np.float32))

    def _full_size(self, corners: _Corners, levels: int) -> NDArray[np.float64]:
        """Places in the full image; a pixel's centre moves by (scale - 1) / 2."""
        uv = corners.xy.astype(np.float64)
        for scale, rows in zip(self._scales(levels), _octaves(corners, levels), strict=True):
            uv[rows] *= scale
            uv[rows] += (scale - 1) / 2
        return uv

    def _scales(self, levels: int) -> NDArray[np.float64]:
        scales: NDArray[np.float64] = self.scale_factor ** np.arange(levels, dtype=np.float64)
        return scales


@dataclass(frozen=True)
class _Corners:
    """Corners in level coordinates: xy (N, 2), octave (N,), strength (N,) float32."""

    xy: NDArray[np.int64]
    octave: NDArray[np.int64]
    strength: NDArray[np.float32]


def _all_corners(planes: list[NDArray[np.uint8]], threshold: int) -> _Corners:
    from ._corners import find_corners

    found = [find_corners(plane, threshold, _EDGE) for plane in planes]
    sizes = [len(strength) for _, strength in found]
    return _Corners(
        np.concatenate([np.zeros((0, 2), np.int64), *(xy for xy, _ in found)]),
        np.repeat(np.arange(len(planes)), sizes),
        np.concatenate([np.zeros(0, np.float32), *(strength for _, strength in found)]),
    )


def _orientations(planes: list[NDArray[np.uint8]], corners: _Corners) -> NDArray[np.float64]:
    from ._corners import orientations

    angle = np.empty(len(corners.xy))
    for plane, rows in zip(planes, _octaves(corners, len(planes)), strict=True):
        orientations(plane, corners.xy[rows], angle[rows])
    return angle


def _octaves(corners: _Corners, levels: int) -> list[slice]:
    """Rows of each octave's corners, which are sorted by octave."""
    ends = np.searchsorted(corners.octave, np.arange(levels + 1)).tolist()
    return [slice(*rows) for rows in itertools.pairwise(ends)]
