"""Semi-global block matching as a matcher: dense disparities, sampled at keypoints or on a grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._settings import Checked, copy_setting, setting
from ...errors import InputError
from ...types import Features, FloatArray, StereoPair
from ..images import prepare
from .dense import sample_map
from .descriptor_matcher import DescriptorMatcher, check_order, median_and_spread, survey_disparities, widest_range
from .matches import Matches
from .patches import Patches, measure_vertical_offsets

_FARTHEST = 2000.0  # px
_STEP = 16  # OpenCV's disparities come in sixteenths of a pixel, and their number in sixteens


@dataclass(frozen=True)
class SgbmMatcher(Checked, what="sgbm"):
    """Semi-global matching (Hirschmüller 2008), OpenCV's variant, sampled at the keypoints of the left image.

    Keypoints of the right image only help to find the range of disparities, where they have descriptors.

    Attributes
    ----------
    max_disparity : float or None
        Largest ``u_left - u_right``, px; None takes the limit from the pair.
    min_disparity : float or None
        Smallest one, px; None takes the limit from the pair.
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
    >>> from tspslam import Settings
    >>> Settings(matcher=SgbmMatcher(block=7)).matcher.block
    7
    """

    max_disparity: float | None = copy_setting(DescriptorMatcher, "max_disparity")
    min_disparity: float | None = copy_setting(DescriptorMatcher, "min_disparity")
    block: int = setting(  # larger ones overflow OpenCV's costs
        5, 1, 15, unit="px",
        source="OpenCV's manual (3 to 11); Motorcycle: 3, 5, 7, 9 leave 90.9, 90.3, 89.1, 88.4 % right to 1 px",
    )  # fmt: skip
    uniqueness: int = setting(10, 0, 100, unit="%", source="OpenCV's manual (5 to 15)")
    speckle: int = setting(100, 0, 1_000_000, unit="px", source="OpenCV's manual (50 to 200)")

    def __post_init__(self) -> None:
        super().__post_init__()
        check_order(self.min_disparity, self.max_disparity)
        if self.block % 2 == 0:
            raise InputError(f"sgbm: block is {self.block}, expected an odd number from 1 to 15")

    def __call__(self, left: Features, right: Features, pair: StereoPair) -> Matches:
        """Match the keypoints of a pair; errors as `RowMatcher`."""
        low, high = self._range(left, right, pair)
        found = sample_map(self.disparity_map(pair, low, high), left.uv)
        rows = np.flatnonzero(np.isfinite(found))
        images = prepare(pair)
        planes = images.left_image.smooth, images.right_image.smooth
        median, spread = median_and_spread(measure_vertical_offsets(*planes, left.uv[rows], found[rows], Patches()))
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
            px; NaN where not known, or no camera saw the pixel.
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
        is_known = found >= first if pair.valid is None else (found >= first) & pair.valid
        return np.where(is_known, found, np.nan)

    def _range(self, left: Features, right: Features, pair: StereoPair) -> tuple[float, float]:
        if left.descriptor.shape[1] == 0 or right.descriptor.shape[1] == 0:
            low, high = widest_range(pair, self.min_disparity, self.max_disparity)
            return max(low, -pair.rig.doffs), high
        survey = replace(DescriptorMatcher(), min_disparity=self.min_disparity, max_disparity=self.max_disparity)
        return survey_disparities(survey, left, right, pair)[0]
