"""Why a pair hardly matches along its rows: descriptors are compared wherever they are, and tell."""

from __future__ import annotations

import numpy as np

from ..errors import GeometryError
from ..types import Features, FloatArray, StereoPair

_FEW = 0.1  # points per keypoint, below which it is asked why
_NEEDED = 20  # free matches that allow a verdict
_RATIO = 0.75  # of distances of the nearest and the second nearest descriptor
_LARGEST_OFFSET = 2.0  # px between the rows of a rectified pair
_LARGEST_TURN = 20.0  # degrees


def explain_mismatch(pair: StereoPair, left: Features, right: Features, points: int) -> None:
    """Raise GeometryError if few points were found because one image is turned, or rows do not agree.

    Parameters
    ----------
    pair : StereoPair
        The images.
    left, right : Features
        Their keypoints.
    points : int
        How many points came of them.

    Raises
    ------
    GeometryError
        If descriptors that are compared without regard to rows agree on a turn of over 20°, or on places whose rows
        differ by over 2 px in the median.
    """
    if points >= _FEW * len(left.uv) or left.descriptor.shape[1] == 0:
        return
    i, j = _free_matches(left, right)
    if len(i) < _NEEDED:
        return
    turn, agreement = _turn(left.angle[i].astype(np.float64), right.angle[j].astype(np.float64))
    seen = f"{pair.name}: {points} points from {len(left.uv)} keypoints; of {len(i)} matches anywhere in the images"
    if agreement > 0.5 and abs(turn) > _LARGEST_TURN:
        raise GeometryError(f"{seen} most turn by {turn:.0f}°, expected none: the right image is turned")
    offset = float(np.median(np.abs(right.uv[j, 1] - left.uv[i, 1])))
    if offset > _LARGEST_OFFSET:
        raise GeometryError(
            f"{seen} the rows differ by {offset:.1f} px in the median, expected under {_LARGEST_OFFSET:g}: the pair is "
            "not rectified, or twice, or not of these cameras"
        )


def _free_matches(left: Features, right: Features) -> tuple[np.ndarray, np.ndarray]:
    """Rows of nearest descriptors that are clearly nearer than the second."""
    import cv2

    norm = cv2.NORM_HAMMING if left.descriptor.dtype == np.uint8 else cv2.NORM_L2
    found = cv2.BFMatcher(norm).knnMatch(left.descriptor, right.descriptor, k=2)
    clear = [two[0] for two in found if len(two) == 2 and two[0].distance < _RATIO * two[1].distance]
    return np.array([m.queryIdx for m in clear], int), np.array([m.trainIdx for m in clear], int)


def _turn(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    """Mean difference of directions, degrees, and how far they agree on it, 0 to 1."""
    mean = np.exp(1j * (second - first)).mean()
    return float(np.degrees(np.angle(mean))), float(abs(mean))
