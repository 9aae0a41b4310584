"""Left-right matches of descriptors along rows, and what they tell of the range of disparities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._settings import Checked, setting
from ..._threads import both
from ...errors import GeometryError, InputError
from ...types import Features, FloatArray, StereoPair
from .matches import Matches, find_supported

_WIDEST = 0.35  # of the image's width: disparities beyond it leave too little in common
_FEW = 20  # supported matches that a range of disparities needs
_POOR = 0.25  # matches per keypoint, below which it is asked whether the images are swapped


@dataclass(frozen=True)
class DescriptorMatcher(Checked, what="matcher"):
    """Plain matching of descriptors along rows with uniqueness: binary ones by Hamming, real ones by L2 distance.

    A match is the nearest descriptor in both directions, on the same row and octave within tolerance, and clearly
    nearer than the next one. The disparity is the difference of the two keypoints' columns.

    Parameters
    ----------
    max_disparity : float or None
        Largest ``u_left - u_right``, px; None allows 0.35 of the width.
    min_disparity : float or None
        Smallest one, px; None allows all with positive depth.
    row_tolerance : float
        Largest difference of rows, px per unit of the keypoint's scale.
    max_hamming : int
        Largest distance of binary descriptors, bits in 256; longer ones in proportion.
    max_l2 : float
        Largest distance of real descriptors, as a share of their length (norm).
    ratio : float
        The distance must be less than this times that of the second nearest; at most 1.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> from tspslam import datasets, reconstruct
    >>> cloud = reconstruct(datasets.motorcycle(), matcher=DescriptorMatcher(max_disparity=48))
    >>> bool(cloud.disparity.max() <= 48)
    True
    """

    max_disparity: float | None = setting(
        None, -1e5, 1e5, unit="px", source="the pair's own: its calibration's, else what it shows"
    )
    min_disparity: float | None = setting(
        None, -1e5, 1e5, unit="px", source="the pair's own: its calibration's, else where depth begins"
    )
    row_tolerance: float = setting(
        1.5, 0.0, 100.0, unit="px per unit of scale",
        source="by hand; Motorcycle, ORB's alone: 0.75, 1.5, 3 give 491, 605, 666 points, 78, 71, 68 % right to 1 px",
    )  # fmt: skip
    max_hamming: int = setting(
        64, 0, 256, unit="bits of 256",
        source="by hand; Motorcycle, ORB's alone: 32, 64, 100 give 281, 605, 823 points, 85, 71, 59 % right to 1 px",
    )  # fmt: skip
    max_l2: float = setting(
        0.7, 0.0, 2.0, unit="",
        source="by hand; Motorcycle, SIFT's: 0.35, 0.7, 1.4 give 618, 842, 992 points, 92, 88, 79 % right to 1 px",
    )  # fmt: skip
    ratio: float = setting(
        0.85, 0.0, 1.0, unit="",
        source="by hand (Lowe 2004: 0.8); Motorcycle, ORB alone: 0.7 to 0.95 give 587 to 610 points, 73 to 71 % right",
    )  # fmt: skip

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
            The images they come from; only the rig and the size are used.

        Returns
        -------
        Matches
            Sorted by left keypoint; `right_index` is never -1.

        Raises
        ------
        InputError
            If the descriptors differ in kind or length, or are neither uint8 nor float32.
        GeometryError
            If few match, and most disparities are behind the camera: the images look swapped.
        """
        if left.descriptor.shape[1:] == (0,):
            raise InputError(
                f"{pair.name}: keypoints have no descriptors, expected some, or a matcher of rows or blocks"
            )
        low, high = widest_range(pair, self.min_disparity, self.max_disparity)
        i, j = self.pairs(left, right, pair.left.shape[0], low, high)
        if len(i) < _POOR * len(left.uv):
            survey_disparities(self, left, right, pair)
        rows = right.uv[j, 1] - left.uv[i, 1]
        median, spread = median_and_spread(rows)
        return Matches(i, j, left.uv[i, 0] - right.uv[j, 0], _nearness(left, right, i, j), median, spread)

    def pairs(
        self, left: Features, right: Features, height: int, low: float, high: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Match features whose disparity ``u_left - u_right`` is within limits.

        Parameters
        ----------
        left, right : Features
            Of both images.
        height : int
            Of the images, px.
        low, high : float
            Smallest and largest disparity, px.

        Returns
        -------
        i, j : (M,) int64
            Rows of `left` and `right` that match.
        """
        _check_kinds(left, right)
        ways = ((left, right, low, high), (right, left, -high, -low))
        forth, back = both(lambda way: _nearest(*way, height, self.row_tolerance), ways)
        best, distance, second = forth[:, 0].astype(np.int64), *forth[:, 1:].T
        clear = (best >= 0) & (distance <= self._farthest(left)) & (distance < self.ratio * second)
        i = np.flatnonzero(clear)
        i = i[back[best[i], 0] == i]
        return i, best[i]

    def _farthest(self, features: Features) -> FloatArray | float:
        """Largest distance that each descriptor allows."""
        if features.descriptor.dtype == np.uint8:
            return self.max_hamming * features.descriptor.shape[1] / 32
        return self.max_l2 * np.linalg.norm(features.descriptor.astype(np.float64), axis=1)


def widest_range(pair: StereoPair, lowest: float | None, highest: float | None) -> tuple[float, float]:
    """Disparities that a pair may have: positive depth and at most 0.35 of the width, unless told otherwise.

    Parameters
    ----------
    pair : StereoPair
        A rectified pair; its own range, if it has one, is within that.
    lowest, highest : float or None
        Limits that were asked for, px, which go before the pair's own; None is as above.

    Returns
    -------
    low, high : float
        px.
    """
    first, last = pair.disparity_range or (-np.inf, np.inf)
    low = max(-pair.rig.doffs, first) if lowest is None else lowest
    if highest is not None and highest <= low:
        raise InputError(
            f"{pair.name}: max_disparity is {highest:g} px, expected more than {low:g}, where depth begins"
        )
    widest = low + _WIDEST * pair.left.shape[1]
    if highest is not None:
        return low, highest
    return low, last if low < last < np.inf else widest


def survey_disparities(
    matcher: DescriptorMatcher, left: Features, right: Features, pair: StereoPair
) -> tuple[tuple[float, float], NDArray[np.int64], NDArray[np.int64]]:
    """Find the range of disparities of a pair, and the matches in it.

    The range is that of the matches that their neighbours support, without half a per cent at each end as outliers,
    and with a tenth of the range and 4 px added. Where too few matches are found, it is `widest_range`.

    Parameters
    ----------
    matcher : DescriptorMatcher
        Matches the features.
    left, right : Features
        Of both images.
    pair : StereoPair
        Where they are from.

    Returns
    -------
    limits : (float, float)
        Smallest and largest disparity, px.
    i, j : (M,) int64
        Rows of `left` and `right` that match within them.

    Raises
    ------
    GeometryError
        If most disparities lie behind the camera: the images look swapped.
    """
    low, high = widest_range(pair, matcher.min_disparity, matcher.max_disparity)
    reach = max(high, _WIDEST * pair.left.shape[1])
    i, j = matcher.pairs(left, right, pair.left.shape[0], -reach, reach)
    every = left.uv[i, 0] - right.uv[j, 0]
    disparity = every[find_supported(left.uv[i], every, tolerance=2.0)]
    refuse_swapped(pair, disparity)
    disparity = disparity[(disparity >= low) & (disparity <= high)]
    if len(disparity) >= _FEW:
        first, last = np.quantile(disparity, (0.005, 0.995))
        margin = 4 + 0.1 * (last - first)
        low, high = max(low, first - margin), min(high, last + margin)
    inside = (every >= low) & (every <= high)
    return (low, high), i[inside], j[inside]


def refuse_swapped(pair: StereoPair, disparity: FloatArray) -> None:
    """Raise `GeometryError` if most disparities lie behind the camera.

    Parameters
    ----------
    pair : StereoPair
        Where they are from.
    disparity : (N,) float64
        px.
    """
    behind = np.count_nonzero(disparity + pair.rig.doffs < 0)
    if behind >= _FEW and 2 * behind > len(disparity):
        raise GeometryError(
            f"{pair.name}: {behind} of {len(disparity)} disparities are negative, expected positive ones; "
            "the left and right images look swapped"
        )


def median_and_spread(values: FloatArray) -> tuple[float, float]:
    """Median, and 1.4826 times the median absolute deviation; zeros for no values.

    Parameters
    ----------
    values : (N,) float64
        Finite.

    Returns
    -------
    median, spread : float
    """
    if len(values) == 0:
        return 0.0, 0.0
    median = float(np.median(values))
    return median, 1.4826 * float(np.median(np.abs(values - median)))


def check_order(lowest: float | None, highest: float | None) -> None:
    """Raise `InputError` unless limits of the disparity are in order.

    Parameters
    ----------
    lowest, highest : float or None
        px; None is no limit.
    """
    if lowest is not None and highest is not None and lowest > highest:
        raise InputError(f"matcher: min_disparity is {lowest}, expected at most max_disparity, {highest}")


def _nearest(points: Features, other: Features, low: float, high: float, height: int, tolerance: float) -> FloatArray:
    from ._descriptors import match_rows

    words, other_words = _comparable(points), _comparable(other)
    row = np.clip(np.rint(other.uv[:, 1]).astype(np.int64), 0, height - 1)
    order = np.argsort(row, kind="stable")
    row_start = np.searchsorted(row[order], np.arange(height + 1))
    found: FloatArray = match_rows(
        _places(points), words, _places(other)[order], other_words[order], row_start, np.array([low, high, tolerance])
    )
    some = found[:, 0] >= 0
    found[some, 0] = order[found[some, 0].astype(np.int64)]
    return found


def _places(features: Features) -> FloatArray:
    return np.column_stack([features.uv, features.scale.astype(np.float64)])


def _check_kinds(left: Features, right: Features) -> None:
    kinds = [(each.descriptor.dtype.name, each.descriptor.shape[1:]) for each in (left, right)]
    if kinds[0] != kinds[1]:
        said = [f"{name} of shape {shape}" for name, shape in kinds]
        raise InputError(f"descriptors are {said[0]} on the left and {said[1]} on the right, expected the same")
    if kinds[0][0] not in ("uint8", "float32") or len(kinds[0][1]) != 1:
        raise InputError(f"descriptors are {kinds[0][0]} of shape {kinds[0][1]}, expected rows of uint8 or float32")


def _nearness(left: Features, right: Features, i: NDArray[np.int64], j: NDArray[np.int64]) -> FloatArray:
    """1 for equal descriptors, 0 for the farthest possible."""
    one, other = _comparable(left)[i], _comparable(right)[j]
    if one.dtype == np.uint64:
        return 1 - np.bitwise_count(one ^ other).sum(axis=1) / max(8 * left.descriptor.shape[1], 1)
    length = np.linalg.norm(one, axis=1) + np.linalg.norm(other, axis=1)
    return 1 - np.linalg.norm(one - other, axis=1) / np.maximum(length, 1e-30)


def _comparable(features: Features) -> NDArray[Any]:
    """Binary descriptors as 64-bit words, padded with zeros; real ones as they are."""
    if features.descriptor.dtype == np.float32:
        return np.ascontiguousarray(features.descriptor)
    count, size = features.descriptor.shape
    padded = np.zeros((count, -(-size // 8) * 8), np.uint8)
    padded[:, :size] = features.descriptor
    return padded.view(np.uint64).reshape(count, -1)
