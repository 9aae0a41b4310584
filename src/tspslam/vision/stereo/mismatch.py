"""What is wrong with a pair: one picture twice, or rows that hardly match, as descriptors tell wherever they are."""

from __future__ import annotations

import numpy as np

from ...errors import GeometryError
from ...types import Features, FloatArray, StereoPair
from ..features.detecting import detect_usable
from ..features.orb import OrbDetector
from ..images import SAME_PICTURE, PreparedPair
from .descriptor_matcher import refuse_swapped
from .matches import Matches

_FEW = 0.1  # points per keypoint, below which it is asked why
_FEW_BARE = 0.5  # the same for keypoints without descriptors, whose matcher saw disparities with a depth only
_NEEDED = 20  # free matches that allow a verdict
_RATIO = 0.75  # of distances of the nearest and the second nearest descriptor
_LARGEST_OFFSET = 2.0  # px between the rows of a rectified pair
_LARGEST_TURN = 20.0  # degrees
# px of disparity of one picture that was stored twice. The Motorcycle pair's left image against itself as JPEG of
# quality 40 to 95 or WebP of 60: 0.05 in the median and 0.28 in 95 % of the matches, rows 0.01; moved by 0.1 px, 0.11
# in the median.
_SAME_MEDIAN, _SAME_MOST, _SAME_ROWS = 0.06, 0.3, 0.05


def refuse_one_picture_stored_twice(pair: StereoPair, matches: Matches) -> None:
    """Raise GeometryError if no match has a disparity or another row: one picture, encoded or resized twice.

    Scenes so distant that all of their disparities vanish go the same way: they have no depth either. Cameras with an
    offset (doffs) see zero disparity at one depth only.

    Parameters
    ----------
    pair : StereoPair
        The images.
    matches : Matches
        Theirs.
    """
    if len(matches) < _NEEDED or abs(matches.vertical_offset_px) > _SAME_ROWS:
        return
    median, most = np.quantile(np.abs(matches.disparity), (0.5, 0.95))
    if median <= _SAME_MEDIAN and most <= _SAME_MOST:
        raise GeometryError(
            f"{pair.name}: {SAME_PICTURE} (of {len(matches)} matches, 95 % have disparities within {most:.2g} px of 0)"
        )


def explain_mismatch(pair: PreparedPair, left: Features, right: Features, points: int) -> None:
    """Raise GeometryError if few points were found because of a turn, rows that do not agree, or swapped sides.

    Parameters
    ----------
    pair : PreparedPair
        The images.
    left, right : Features
        Their keypoints.
    points : int
        How many points came of them.

    Raises
    ------
    GeometryError
        If descriptors that are compared without regard to rows agree on a turn of over 20°, on places whose rows
        differ by over 2 px in the median, or on disparities behind the camera.
    """
    count, is_bare = len(left.uv), left.descriptor.shape[1] == 0
    if points >= (_FEW_BARE if is_bare else _FEW) * count:
        return
    if is_bare:
        left, right = (detect_usable(image, OrbDetector()) for image in (pair.left_image, pair.right_image))
    i, j = _free_matches(left, right)
    if len(i) < _NEEDED:
        return
    turn, agreement = _turn(left.angle[i].astype(np.float64), right.angle[j].astype(np.float64))
    seen = f"{pair.name}: {points} points from {count} keypoints; of {len(i)} matches anywhere in the images"
    if agreement > 0.5 and abs(turn) > _LARGEST_TURN:
        raise GeometryError(f"{seen} most turn by {turn:.0f}°, expected none: the right image is turned")
    offset = float(np.median(np.abs(right.uv[j, 1] - left.uv[i, 1])))
    if offset > _LARGEST_OFFSET:
        raise GeometryError(
            f"{seen} the rows differ by {offset:.1f} px in the median, expected under {_LARGEST_OFFSET:g}: the pair is "
            "not rectified, or twice, or not of these cameras, or left and right are swapped"
        )
    refuse_swapped(pair, left.uv[i, 0] - right.uv[j, 0])


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
