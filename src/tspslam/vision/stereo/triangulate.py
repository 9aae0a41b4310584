"""Matches to points with covariance."""

from __future__ import annotations

import numpy as np

from ...types import BoolArray, Cloud, Features, FloatArray, Rig
from ..rig import MIN_TOTAL, back_project, covariance
from .matches import Matches

PIXEL_SIGMA = 0.5  # px of standard deviation per unit of a keypoint's scale


def triangulate(rig: Rig, features: Features, matches: Matches) -> Cloud:
    """Points behind the matched keypoints of the left image.

    ``z = fx · baseline / (disparity + doffs)``; matches without positive depth and keypoints outside the image are
    dropped, and of several matches on one pixel the one with the best score stays. The covariance takes 0.5 px times
    the keypoint's scale as the standard deviation of u_left, u_right and v.

    Parameters
    ----------
    rig : Rig
        The cameras.
    features : Features
        Keypoints of the left image.
    matches : Matches
        Their disparities.

    Returns
    -------
    Cloud
        In the order of the matches; it may be empty.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> one = np.ones(1, np.float32)
    >>> features = Features(np.array([[320.0, 290.0]]), np.zeros((1, 32), np.uint8), one, one, one)
    >>> first = np.zeros(1, np.int64)
    >>> triangulate(rig, features, Matches(first, first, np.array([25.0]), np.ones(1))).xyz.tolist()
    [[0.0, 0.2, 2.0]]
    """
    uv = features.uv[matches.left_index]
    kept = _in_front_and_inside(rig, uv, matches.disparity)
    kept = kept[_best_on_pixel(uv[kept], matches.score[kept])]
    uv, disparity = uv[kept], matches.disparity[kept]
    sigma = PIXEL_SIGMA * features.scale[matches.left_index[kept]].astype(np.float64)
    return Cloud(back_project(rig, uv, disparity), uv, disparity, covariance(rig, uv, disparity, sigma))


def _in_front_and_inside(rig: Rig, uv: FloatArray, disparity: FloatArray) -> np.ndarray:
    inside = (uv >= 0).all(axis=1) & (uv <= (rig.width - 1, rig.height - 1)).all(axis=1)
    return np.flatnonzero(inside & (disparity + rig.doffs >= MIN_TOTAL))


def _best_on_pixel(uv: FloatArray, score: FloatArray) -> BoolArray:
    pixel = np.floor(uv + 0.5).astype(np.int64) @ np.array([1, 1 << 20])
    order = np.lexsort((-score, pixel))
    best = np.zeros(len(uv), np.bool_)
    best[order[np.diff(pixel[order], prepend=-1) != 0]] = True
    return best
