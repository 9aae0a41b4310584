"""What matching finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..types import FloatArray


@dataclass(frozen=True)
class Matches:
    """Keypoints of the left image with their disparities.

    Attributes
    ----------
    left_index : (M,) int64
        Rows of the left features, ascending, each at most once.
    right_index : (M,) int64
        Rows of the right features; -1 where the place was found by searching the row.
    disparity : (M,) float64
        ``u_left - u_right``, px.
    score : (M,) float64
        Likeness of the two windows or descriptors, at most 1.
    vertical_offset_px : float
        Median of ``v_right - v_left`` over the matches.
    vertical_offset_std_px : float
        Its spread: 1.4826 times the median absolute deviation.
    """

    left_index: NDArray[np.int64]
    right_index: NDArray[np.int64]
    disparity: FloatArray
    score: FloatArray
    vertical_offset_px: float = 0.0
    vertical_offset_std_px: float = 0.0

    def __len__(self) -> int:
        return len(self.left_index)
