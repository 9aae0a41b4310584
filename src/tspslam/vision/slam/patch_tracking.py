"""Points of one image found again in another: windows aligned from coarse to fine."""

from __future__ import annotations

import numpy as np

from ...types import BoolArray, FloatArray, Rig
from .._parallel import in_halves
from ..images import Plane, Pyramid

_RADIUS, _CONTRAST = 5, 0.03
_REACH = 4.0  # px at each level that a window may move
_MIN_SCORE = 0.8
_WORTH = 150  # points that make a second thread worth its start


def follow(
    reference: Pyramid, current: Pyramid, place: FloatArray, warp: FloatArray, guess: FloatArray, levels: range
) -> tuple[FloatArray, BoolArray]:
    """Find the windows around points of one image in another.

    Parameters
    ----------
    reference, current : Pyramid
        The images.
    place : (N, 2) float64
        Points of the reference, px.
    warp : (N, 2, 2) float64
        From offsets in the current image to offsets in the reference: what nearness and turning do to a window.
    guess : (N, 2) float64
        Where the points are expected, px.
    levels : range
        Levels to go through, the coarsest first; those that a small image does not have are left out.

    Returns
    -------
    uv : (N, 2) float64
        Where they are, px; the guess, bettered as far as it went, where they are not found.
    good : (N,) bool
        Whether the window was found at the last level.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 255, (64, 64)).astype(np.float32)
    >>> import cv2
    >>> image = cv2.GaussianBlur(noise, (0, 0), 2).astype(np.uint8)
    >>> one, same = np.array([[30.0, 30.0]]), np.eye(2)[None]
    >>> uv, good = follow(pyramid(image), pyramid(np.roll(image, 3, 1)), one, same, one, range(0, -1, -1))
    >>> uv.round(1).tolist(), good.tolist()
    ([[33.0, 30.0]], [True])
    """
    uv, score = np.array(guess, np.float64), np.full(len(place), -1.0)
    for level in levels:
        if level < len(current.levels):
            size, planes = 2.0**level, (reference.levels[level], current.levels[level])
            uv /= size
            _follow_level(planes, place / size, warp, uv, score)
            uv *= size
    return uv, np.asarray(score >= _MIN_SCORE)


def _follow_level(
    planes: tuple[Plane, Plane], place: FloatArray, warp: FloatArray, uv: FloatArray, score: FloatArray
) -> None:
    """One level of `follow`; `uv` and `score` are changed."""
    from ._patch_tracking import follow_level

    def part(rows: slice) -> None:
        follow_level(*planes, place[rows], warp[rows], _RADIUS, _CONTRAST, _REACH, uv[rows], score[rows])

    in_halves(part, len(place), _WORTH)


def warps(rig: Rig, T: FloatArray, xyz: FloatArray) -> FloatArray:
    """From offsets around points in the current image to offsets in the reference, for patches that face the latter.

    Parameters
    ----------
    rig : Rig
        The camera.
    T : (4, 4) float64
        ``T_current_reference``.
    xyz : (N, 3) float64
        The points in the reference camera's frame, m.

    Returns
    -------
    (N, 2, 2) float64
    """
    fx, fy = rig.fx, rig.fy
    R, near = T[:3, :3], xyz @ T[:3, :3].T + T[:3, 3]
    ratio = (xyz[:, 2] / near[:, 2])[:, None]
    tilt = near[:, :2] / near[:, 2:]
    # d(u, v) current / d(u, v) reference
    by_u = ratio * (R[:2, 0] - tilt * R[2, 0]) * (1.0, fy / fx)
    by_v = ratio * (R[:2, 1] - tilt * R[2, 1]) * (fx / fy, 1.0)
    forth = np.stack([by_u, by_v], axis=-1)
    determinant = forth[:, 0, 0] * forth[:, 1, 1] - forth[:, 0, 1] * forth[:, 1, 0]
    back = np.stack([forth[:, 1, 1], -forth[:, 0, 1], -forth[:, 1, 0], forth[:, 0, 0]], axis=-1)
    return (back / determinant[:, None]).reshape(-1, 2, 2)
