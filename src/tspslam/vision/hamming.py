"""Left-right matches of binary descriptors along rows, and what they tell of the range of disparities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from ..types import Features, FloatArray, StereoPair
from ._parallel import both
from .consistency import supported
from .matches import Matches

_WIDEST = 0.35  # of the image's width: disparities beyond it leave too little in common
_FEW = 20  # supported matches that a range of disparities needs


@dataclass(frozen=True)
class HammingMatcher:
    """Plain matching of binary descriptors along rows, by Hamming distance with uniqueness.

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
        Largest distance, bits.
    ratio : float
        The distance must be less than this times that of the second nearest; at most 1.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> HammingMatcher(max_disparity=48).max_hamming
    64
    """

    max_disparity: float | None = None
    min_disparity: float | None = None
    row_tolerance: float = 1.5
    max_hamming: int = 64
    ratio: float = 0.85

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_range("row_tolerance", self.row_tolerance, 0, 100)
        check_range("max_hamming", self.max_hamming, 0, 100_000)
        check_range("ratio", self.ratio, 0, 1)
        check_limits(self.min_disparity, self.max_disparity)

    def __call__(self, left: Features, right: Features, pair: StereoPair) -> Matches:
        """Match the keypoints of a pair.

        Parameters
        ----------
        left, right : Features
            Keypoints with uint8 descriptors.
        pair : StereoPair
            The images they come from; only the rig and the size are used.

        Returns
        -------
        Matches
            Sorted by left keypoint; `right_index` is never -1.

        Raises
        ------
        InputError
            If the descriptors are not binary or differ in length.
        """
        low, high = widest_range(pair, self.min_disparity, self.max_disparity)
        i, j = self.pairs(left, right, pair.left.shape[0], low, high)
        rows = right.uv[j, 1] - left.uv[i, 1]
        median, spread = median_and_spread(rows)
        bits = np.bitwise_count(_as_words(left)[i] ^ _as_words(right)[j]).sum(axis=1)
        nearness = 1 - bits / max(8 * left.descriptor.shape[1], 1)
        return Matches(i, j, left.uv[i, 0] - right.uv[j, 0], nearness, median, spread)

    def pairs(
        self, left: Features, right: Features, height: int, low: float, high: float
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows of `left` and `right` that match with ``low <= u_left - u_right <= high``."""
        if left.descriptor.shape[1:] != right.descriptor.shape[1:]:
            sizes = f"{left.descriptor.shape[1:]} on the left and {right.descriptor.shape[1:]} on the right"
            raise InputError(f"descriptors have the shapes {sizes}, expected the same")
        ways = ((left, right, low, high), (right, left, -high, -low))
        forth, back = both(lambda way: _nearest(*way, height, self.row_tolerance), ways)
        best, distance, second = forth.T
        clear = (best >= 0) & (distance <= self.max_hamming) & (distance < self.ratio * second)
        i = np.flatnonzero(clear)
        i = i[back[best[i], 0] == i]
        return i, best[i]


def widest_range(pair: StereoPair, lowest: float | None, highest: float | None) -> tuple[float, float]:
    """Disparities that a pair may have: positive depth and at most 0.35 of the width, unless told otherwise."""
    low = -pair.rig.doffs if lowest is None else lowest
    if highest is not None and highest <= low:
        raise InputError(
            f"{pair.name}: max_disparity is {highest:g} px, expected more than {low:g}, where depth begins"
        )
    return low, low + _WIDEST * pair.left.shape[1] if highest is None else highest


def survey_disparities(
    matcher: HammingMatcher, left: Features, right: Features, pair: StereoPair
) -> tuple[tuple[float, float], NDArray[np.int64], NDArray[np.int64]]:
    """Range of disparities of a pair, px, and the matching rows of `left` and `right` in it.

    The range is that of the matches that their neighbours support, without half a per cent at each end as outliers,
    and with a tenth of the range and 4 px added. Where too few matches are found, it is `widest_range`.

    Raises
    ------
    GeometryError
        If most disparities lie behind the camera: the images look swapped.
    """
    low, high = widest_range(pair, matcher.min_disparity, matcher.max_disparity)
    reach = max(high, _WIDEST * pair.left.shape[1])
    i, j = matcher.pairs(left, right, pair.left.shape[0], -reach, reach)
    every = left.uv[i, 0] - right.uv[j, 0]
    disparity = every[supported(left.uv[i], every, tolerance=2.0)]
    behind = np.count_nonzero(disparity + pair.rig.doffs < 0)
    if behind >= _FEW and 2 * behind > len(disparity):
        raise GeometryError(
            f"{pair.name}: {behind} of {len(disparity)} disparities are negative, expected positive ones; "
            "the left and right images look swapped"
        )
    disparity = disparity[(disparity >= low) & (disparity <= high)]
    if len(disparity) >= _FEW:
        first, last = np.quantile(disparity, (0.005, 0.995))
        margin = 4 + 0.1 * (last - first)
        low, high = max(low, first - margin), min(high, last + margin)
    inside = (every >= low) & (every <= high)
    return (low, high), i[inside], j[inside]


def median_and_spread(values: FloatArray) -> tuple[float, float]:
    """Median, and 1.4826 times the median absolute deviation; zeros for no values."""
    if len(values) == 0:
        return 0.0, 0.0
    median = float(np.median(values))
    return median, 1.4826 * float(np.median(np.abs(values - median)))


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise InputError unless ``low <= value <= high``."""
    if not low <= value <= high:
        raise InputError(f"matcher: {name} is {value}, expected {low} to {high}")


def check_limits(lowest: float | None, highest: float | None) -> None:
    """Raise InputError unless both limits of disparity are None or finite, and in order."""
    for name, value in (("min_disparity", lowest), ("max_disparity", highest)):
        if value is not None and not np.isfinite(value):
            raise InputError(f"matcher: {name} is {value}, expected a finite number of px")
    if lowest is not None and highest is not None and lowest > highest:
        raise InputError(f"matcher: min_disparity is {lowest}, expected at most max_disparity, {highest}")


def _nearest(
    points: Features, other: Features, low: float, high: float, height: int, tolerance: float
) -> NDArray[np.int64]:
    from ._kernels import match_rows

    words, other_words = _as_words(points), _as_words(other)
    row = np.clip(np.rint(other.uv[:, 1]).astype(np.int64), 0, height - 1)
    order = np.argsort(row, kind="stable")
    row_start = np.searchsorted(row[order], np.arange(height + 1))
    found: NDArray[np.int64] = match_rows(
        _places(points), words, _places(other)[order], other_words[order], row_start, np.array([low, high, tolerance])
    )
    some = found[:, 0] >= 0
    found[some, 0] = order[found[some, 0]]
    return found


def _places(features: Features) -> FloatArray:
    return np.column_stack([features.uv, features.scale.astype(np.float64)])


def _as_words(features: Features) -> NDArray[np.uint64]:
    """Descriptors as 64-bit words, padded with zeros."""
    if features.descriptor.dtype != np.uint8 or features.descriptor.ndim != 2:
        raise InputError(f"descriptors are {features.descriptor.dtype}, expected binary ones (uint8)")
    count, size = features.descriptor.shape
    padded = np.zeros((count, -(-size // 8) * 8), np.uint8)
    padded[:, :size] = features.descriptor
    return padded.view(np.uint64).reshape(count, -1)
