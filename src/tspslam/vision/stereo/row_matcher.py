"""Left-right matching: descriptors first, then a search of the row, then a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._settings import Checked, copy_setting, setting
from ..._threads import both, in_halves
from ...types import Features, FloatArray, StereoPair
from ..images import Plane, prepare
from .descriptor_matcher import DescriptorMatcher as DescriptorMatcher
from .descriptor_matcher import check_order, median_and_spread, survey_disparities
from .matches import Matches as Matches
from .matches import find_supported
from .patches import Patches, measure_vertical_offsets, refine, search, search_alone, shift_rows

Planes = tuple[Plane, Plane]
SearchNear = Callable[[Planes, FloatArray, FloatArray], FloatArray]
_LEVEL = 0.05  # px of vertical offset that do no harm
_NEAR = 3.0  # px that a guess of a disparity may be off
_PATCHES = Patches()
_BACK_PATCHES = Patches(radius=6, contrast=0.1)


def level_rows(planes: Planes, offset: float) -> Planes:
    """Level two planes: the right one is moved by its vertical offset, unless that does no harm.

    Parameters
    ----------
    planes : (left, right), each (H, W) float32
        Smoothed planes.
    offset : float
        Rows of the right image less those of the left, px.

    Returns
    -------
    (left, right), each (H, W) float32
        Planes whose rows agree.
    """
    return planes if abs(offset) < _LEVEL else (planes[0], shift_rows(planes[1], offset))


def search_near(matcher: object) -> SearchNear:
    """Return how disparities are searched near known ones: the matcher's own `near`, else a `RowMatcher`'s.

    The latter keeps to the matcher's limits, if it has any.

    Parameters
    ----------
    matcher : object
        Such as `RowMatcher`.

    Returns
    -------
    callable
        (planes, uv, guess) -> disparities, as `RowMatcher.near`.

    Examples
    --------
    >>> search_near(DescriptorMatcher(max_disparity=64)).__self__.max_disparity
    64.0
    """
    own: SearchNear | None = getattr(matcher, "near", None)
    high, low = (getattr(matcher, name, None) for name in ("max_disparity", "min_disparity"))
    return own or RowMatcher(max_disparity=high, min_disparity=low).near


@dataclass(frozen=True)
class RowMatcher(Checked, what="matcher"):
    """Matches along rows with sub-pixel disparities.

    1. The range of disparities is surveyed with descriptors, within the limits given.
    2. Descriptors are matched along rows (`DescriptorMatcher`).
    3. The vertical offset of the pair is measured on these, and taken out if it is over 0.05 px.
    4. Left keypoints without a partner search their row in the right image by correlation, with uniqueness and a
       search back. Windows lean on the pixels that look like their centre.
    5. Every match is aligned to a fraction of a pixel from left to right and from right to left; both must agree,
       and their mean is the disparity.
    6. A match that fewer than two of its neighbours support is dropped.

    Parameters
    ----------
    max_disparity : float or None
        Largest ``u_left - u_right``, px; None takes the limit from the pair.
    min_disparity : float or None
        Smallest one, px; None allows all with positive depth.
    row_tolerance : float
        Largest difference of rows of two keypoints, px per unit of the keypoint's scale.
    max_hamming : int
        Largest distance of two binary descriptors, bits in 256; longer ones in proportion.
    max_l2 : float
        Largest distance of two real descriptors, as a share of their length (norm).
    ratio : float
        A descriptor's distance must be less than this times that of the second nearest; at most 1.
    patches : Patches
        Size and weights of the patches compared from left to right.
    back_patches : Patches
        Those of the alignment from right to left; wider ones tell a match that only a depth edge holds.
    min_correlation : float
        Least correlation of an aligned match, below 1; a search may start from 0.1 less.
    uniqueness : float
        In the row search, ``1 - correlation`` must be less than this times that of the best rival.
    max_disagreement : float
        Largest difference of the disparities found from left to right and from right to left, px.
    max_gain : float
        Largest ratio of a patch's contrast gain to the median one, either way; at least 1.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> from tspslam import datasets, reconstruct
    >>> cloud = reconstruct(datasets.motorcycle(), matcher=RowMatcher(max_disparity=64))
    >>> bool(cloud.disparity.max() <= 64)
    True
    """

    max_disparity: float | None = copy_setting(DescriptorMatcher, "max_disparity")
    min_disparity: float | None = copy_setting(DescriptorMatcher, "min_disparity")
    row_tolerance: float = copy_setting(DescriptorMatcher, "row_tolerance")
    max_hamming: int = copy_setting(DescriptorMatcher, "max_hamming")
    max_l2: float = copy_setting(DescriptorMatcher, "max_l2")
    ratio: float = copy_setting(DescriptorMatcher, "ratio")
    patches: Patches = _PATCHES
    back_patches: Patches = setting(
        _BACK_PATCHES,
        source="by hand; Motorcycle: radius 4, 6, 8 give 1332, 1304, 1260 points, 95.9, 96.2, 96.6 % right to 1 px; "
        "contrast 0, 0.1, 0.15 give 1293, 1304, 1297",
    )  # fmt: skip
    min_correlation: float = setting(
        0.9, 0.0, 0.999, unit="",
        source="by hand; Motorcycle: 0.8, 0.9, 0.95 give 1425, 1304, 1139 points, 94.9, 96.2, 96.9 % right to 1 px",
    )  # fmt: skip
    uniqueness: float = setting(
        0.75, 0.0, 1.0, unit="",
        source="by hand; Motorcycle: 0.5, 0.75, 0.9 give 1290, 1304, 1309 points, 96.3, 96.2, 96.0 % right to 1 px",
    )  # fmt: skip
    max_disagreement: float = setting(
        0.6, 0.0, 10.0, unit="px",
        source="by hand; Motorcycle: 0.3, 0.6, 1.2 give 1237, 1304, 1325 points, 96.6, 96.2, 96.0 % right to 1 px",
    )  # fmt: skip
    max_gain: float = setting(
        2.0, 1.0, 10.0, unit="", source="by hand; Motorcycle: 1.4, 2, 4 give 1287, 1304, 1304 points"
    )

    def __post_init__(self) -> None:
        """Check the ranges."""
        super().__post_init__()
        check_order(self.min_disparity, self.max_disparity)

    def __call__(self, left: Features, right: Features, pair: StereoPair) -> Matches:
        """Match the keypoints of a pair.

        Parameters
        ----------
        left, right : Features
            Keypoints with descriptors of one kind.
        pair : StereoPair
            The images they come from.

        Returns
        -------
        Matches
            Sorted by left keypoint.

        Raises
        ------
        InputError
            If the descriptors differ in kind or length, or are neither uint8 nor float32.
        GeometryError
            If most disparities are behind the camera: the images look swapped.
        """
        (low, high), i, j = survey_disparities(self._descriptors(), left, right, pair)
        partner, guess = np.full(len(left.uv), -1), np.zeros(len(left.uv))
        partner[i], guess[i] = j, left.uv[i, 0] - right.uv[j, 0]
        images = prepare(pair)
        planes = both(lambda image: image.smooth, (images.left_image, images.right_image))
        planes, offset = self._level(planes, left.uv[i], guess[i])
        start = self._search(planes, left, partner, guess, (low, high))
        disparity, score = self._refine(planes, left.uv, start)
        kept = np.flatnonzero(np.isfinite(disparity) & (disparity >= low) & (disparity <= high))
        kept = kept[find_supported(left.uv[kept], disparity[kept], tolerance=1.0)]
        rest, spread = median_and_spread(
            measure_vertical_offsets(*planes, left.uv[kept], disparity[kept], self.patches)
        )
        return Matches(kept, partner[kept], disparity[kept], score[kept], offset + rest, spread)

    def _descriptors(self) -> DescriptorMatcher:
        limits = self.max_disparity, self.min_disparity
        return DescriptorMatcher(*limits, self.row_tolerance, self.max_hamming, self.max_l2, self.ratio)

    def _level(self, planes: Planes, uv: FloatArray, disparity: FloatArray) -> tuple[Planes, float]:
        """Planes whose rows agree, and by how much the right one was moved, px."""
        offset, _ = median_and_spread(measure_vertical_offsets(*planes, uv, disparity, self.patches))
        return level_rows(planes, offset), offset if abs(offset) >= _LEVEL else 0.0

    def _search(
        self,
        planes: Planes,
        left: Features,
        partner: NDArray[np.int64],
        guess: FloatArray,
        limits: tuple[float, float],
    ) -> FloatArray:
        """Disparity in whole px of each left keypoint, NaN where none is clear."""
        matched = partner >= 0
        about = 1.5 * left.scale + 1  # how far an octave's keypoints may be off
        ranges = np.where(matched, [guess - about, guess + about], np.reshape(limits, (2, 1)))
        disparity, score, rival = search(*planes, left.uv, ranges, self.patches)
        clear = (score >= self.min_correlation - 0.1) & (matched | (1 - score <= self.uniqueness * (1 - rival)))
        lone = np.flatnonzero(clear & ~matched)
        uv_right = left.uv[lone] - np.column_stack([disparity[lone], np.zeros(len(lone))])
        back = -search(planes[1], planes[0], uv_right, -ranges[::-1, lone], self.patches)[0]
        clear[lone] = np.abs(back - disparity[lone]) <= 1
        return np.where(clear, disparity, np.nan)

    def near(self, planes: Planes, uv: FloatArray, guess: FloatArray) -> FloatArray:
        """Disparities of points whose disparities are known to a few px.

        Parameters
        ----------
        planes : (left, right), each (H, W) float32
            Smoothed planes (`smooth_plane`) whose rows agree.
        uv : (N, 2) float64
            Points of the left image, px.
        guess : (N,) float64
            Their disparities, px.

        Returns
        -------
        (N,) float64
            px, measured in both directions; NaN where they do not agree or leave the matcher's limits.
        """
        aligned, ranges = np.full((len(uv), 4), np.nan), np.stack([guess - _NEAR, guess + _NEAR])

        def find(part: slice) -> None:
            start, score, _ = search_alone(*planes, uv[part], ranges[:, part], self.patches)
            rows = np.flatnonzero(score >= self.min_correlation - 0.1)
            aligned[part][rows] = self._align(planes, uv[part][rows], start[rows])

        in_halves(find, len(uv))
        found = self._agreed(aligned)[0]
        low = -np.inf if self.min_disparity is None else self.min_disparity
        high = np.inf if self.max_disparity is None else self.max_disparity
        return np.where((found >= low) & (found <= high), found, np.nan)

    def _refine(self, planes: Planes, uv: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Disparity to a fraction of a pixel, NaN where both directions do not agree, and correlation."""
        rows, aligned = np.flatnonzero(np.isfinite(start)), np.full((len(start), 4), np.nan)

        def align(part: slice) -> None:
            aligned[rows[part]] = self._align(planes, uv[rows[part]], start[rows[part]])

        in_halves(align, len(rows))
        return self._agreed(aligned)

    def _agreed(self, aligned: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean disparity, NaN where both directions do not agree, and correlation, of what `_align` gave."""
        disparity, score = np.full(len(aligned), np.nan), np.zeros(len(aligned))
        rows = np.flatnonzero(np.isfinite(aligned[:, 0]))
        forth, back, alike, gain = aligned[rows].T
        uneven = np.abs(np.log(gain / np.median(gain))) if len(rows) else gain
        with np.errstate(invalid="ignore"):
            agree = np.abs(forth + back) <= self.max_disagreement  # NaN does not
        good = agree & (alike >= self.min_correlation) & (uneven <= np.log(self.max_gain))
        disparity[rows[good]] = ((forth - back) / 2)[good]
        score[rows[good]] = alike[good]
        return disparity, score

    def _align(self, planes: Planes, uv: FloatArray, start: FloatArray) -> FloatArray:
        """Disparities from left to right, right to left (NaN where not found), correlations, gains: (N, 4)."""
        forth = refine(*planes, uv, start, self.patches)
        columns = np.column_stack([forth.disparity, np.full(len(uv), np.nan), forth.score, forth.gain])
        columns[~forth.good] = np.nan
        rows = np.flatnonzero(forth.good)
        shift = forth.disparity[rows]
        uv_right = uv[rows] - np.column_stack([shift, np.zeros(len(rows))])
        back = refine(planes[1], planes[0], uv_right, -shift, self.back_patches)
        columns[rows[back.good], 1] = back.disparity[back.good]
        return columns
