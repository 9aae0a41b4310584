"""The real pair that ships with scikit-image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import FloatArray, Rig, StereoPair

_MOTORCYCLE = Rig(
    fx=994.978, fy=994.978, cx=311.193, cy=254.877, baseline=0.193001, width=741, height=500, doffs=31.086
)


def motorcycle() -> StereoPair:
    """The Motorcycle pair of the Middlebury 2014 data (Scharstein et al.), a quarter of its full size.

    Returns
    -------
    StereoPair
        500 x 741 px, RGB, uint8; disparities from 7 to 60 px.

    Examples
    --------
    >>> motorcycle().left.shape
    (500, 741, 3)
    """
    left, right, _ = _load()
    return StereoPair(left, right, _MOTORCYCLE, name="motorcycle")


def motorcycle_truth() -> FloatArray:
    """Measured disparities of the left image of `motorcycle`.

    Returns
    -------
    (500, 741) float64
        ``u_left - u_right``, px; NaN where it is not known.

    Examples
    --------
    >>> float(np.isfinite(motorcycle_truth()).mean().round(2))
    0.93
    """
    disparity = _load()[2].astype(np.float64)
    return np.where(np.isfinite(disparity), disparity, np.nan)


def _load() -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[Any]]:
    from skimage import data

    left, right, disparity = data.stereo_motorcycle()
    return left, right, disparity
