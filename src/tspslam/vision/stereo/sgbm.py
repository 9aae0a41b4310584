"""Semi-global block matching as a matcher: dense disparities, sampled at keypoints or on a grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...types import Features, FloatArray, StereoPair
from ..images import prepare
from .dense import sample_map
from .descriptor_matcher import DescriptorMatcher, check_limits, median_and_spread, survey_disparities, widest_range
from .matches import Matches
from .patches import Patches, vertical_offsets

_FARTHEST = 2000.0  # px
_STEP = 16  # OpenCV's disparities come in sixteenths of a pixel, and their number in sixteens


@dataclass(frozen=True)
class SgbmMatcher:
    """Semi-global matching (Hirschmüller 2008), OpenCV's variant, sampled at the keypoints of the left image.

    Keypoints of the right image only help to find the range of disparities, where they have descriptors.

    Attributes
    ----------
    max_disparity, min_disparity : float or None
        Limits of ``u_left - u_right``, px; None takes them from the pair.
    block : int
        Side of the blocks, px, odd.
    uniqueness : int
        By how many per cent the best cost must be lower than any other.
    speckle : int
        Smaller islands of disparity are dropped, px.

    Raises
    ------
    InputError
        If a setting is out of its range.

    Examples
    --------
    >>> SgbmMatcher(block=7).block
    7
    """

    max_disparity: float | None = None
    min_disparity: float | None = None
    block: int = 5
    uniqueness: int = 10
    speckle: int = 100

    def __post_init__(self) -> None:
        check_limits(self.min_disparity, self.max_disparity)
        if not (1 <= self.block <= 15 and self.block % 2):  # larger ones overflow OpenCV's costs
            raise InputError(f"sgbm: block is {self.block}, expected an odd number from 1 to 15")
        if not (0 <= self.uniqueness <= 100 and 0 <= self.speckle <= 1_000_000):
            raise InputError(f"sgbm: uniqueness, speckle are {self.uniqueness}, {self.speckle}, expected 0 to 100, 1e6")

    def __call__(self, left: Features, right: Features, pair: StereoPair) -> Matches:
        """Match the keypoints of a pair; errors as `RowMatcher`."""
        low, high = self._range(left, right, pair)
        found = sample_map(self.disparity_map(pair, low, high), left.uv)
        rows = np.flatnonzero(np.isfinite(found))
        images = prepare(pair)
        planes = images.left_image.smooth, images.right_image.smooth
        median, spread = median_and_spread(vertical_offsets(*planes, left.uv[rows], found[rows], Patches()))
        return Matches(rows, np.full(len(rows), -1), found[rows], np.ones(len(rows)), median, spread)

    def disparity_map(self, pair: StereoPair, low: float, high: float) -> FloatArray:
        """Disparities of the left image by semi-global matching.

        OpenCV keeps disparities in 16 bits: limits are cut to ±2000 px. Of an image smaller than twice the
        block nothing is known.

        Parameters
        ----------
        pair : StereoPair
            A rectified pair.
        low, high : float
            Smallest and about the largest disparity, px.

        Returns
        -------
        (H, W) float64
            px; NaN where not known.
        """
        import cv2

        low, high = (float(np.clip(limit, -_FARTHEST, _FARTHEST)) for limit in (low, high))
        first = int(np.floor(low))
        if min(pair.left.shape[:2]) < 2 * self.block + 2 or pair.left.shape[1] <= max(abs(first), abs(high)) + _STEP:
            return np.full(pair.left.shape[:2], np.nan)
        count = max(_STEP, -(-int(np.ceil(high) - first + 1) // _STEP) * _STEP)
        area = self.block**2
        sgbm = cv2.StereoSGBM.create(
            minDisparity=first, numDisparities=count, blockSize=self.block, P1=8 * area, P2=32 * area, disp12MaxDiff=1,
            uniquenessRatio=self.uniqueness, speckleWindowSize=self.speckle, speckleRange=2,
        )  # fmt: skip
        images = prepare(pair)
        found = sgbm.compute(images.left_image.grey, images.right_image.grey) / _STEP
        return np.where(found >= first, found, np.nan)

    def _range(self, left: Features, right: Features, pair: StereoPair) -> tuple[float, float]:
        if left.descriptor.shape[1] == 0 or right.descriptor.shape[1] == 0:
            low, high = widest_range(pair, self.min_disparity, self.max_disparity)
            return max(low, -pair.rig.doffs), high
        survey = replace(DescriptorMatcher(), min_disparity=self.min_disparity, max_disparity=self.max_disparity)
        return survey_disparities(survey, left, right, pair)[0]
