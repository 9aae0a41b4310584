"""Points of one image found again in another: patches aligned from coarse to fine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._threads import both
from ...types import BoolArray, FloatArray, Rig
from ..images import Pyramid
from ..se3 import inverse
from .least_squares.bundle import lens_of

_WORTH = 150  # points that make a second thread worth its start


@dataclass(frozen=True)
class Patch:
    """What is compared around a point, and what counts as found.

    Attributes
    ----------
    radius : int
        Half width, px.
    contrast : float
        A pixel that differs from the centre by ``1 / contrast`` grey levels counts half.
    reach : float
        Farthest that it moves at each level, px.
    min_correlation : float
        Of a patch that is found.
    """

    radius: int
    contrast: float
    reach: float
    min_correlation: float


def track_patches(
    reference: Pyramid, current: Pyramid, place: FloatArray, warp: FloatArray, guess: FloatArray, levels: range,
    patch: Patch,
) -> tuple[FloatArray, BoolArray]:  # fmt: skip
    """Find the patches around points of one image in another.

    Parameters
    ----------
    reference, current : Pyramid
        The images.
    place : (N, 2) float64
        Points of the reference, px.
    warp : (N, 2, 2) float64
        From offsets in the current image to offsets in the reference: what nearness and turning do to a patch.
    guess : (N, 2) float64
        Where the points are expected, px.
    levels : range
        Levels to go through, the coarsest first; those that a small image does not have are left out.
    patch : Patch
        What is compared.

    Returns
    -------
    uv : (N, 2) float64
        Where they are, px; the guess, refined as far as it went, where they are not found.
    good : (N,) bool
        Whether the patch was found at the last level.

    Examples
    --------
    >>> noise = np.random.default_rng(0).integers(0, 255, (64, 64)).astype(np.float32)
    >>> import cv2
    >>> from tspslam import TrackingSettings
    >>> from tspslam.vision.images import build_pyramid
    >>> image = cv2.GaussianBlur(noise, (0, 0), 2).astype(np.uint8)
    >>> one, same = np.array([[30.0, 30.0]]), np.eye(2)[None]
    >>> images = build_pyramid(image), build_pyramid(np.roll(image, 3, 1))
    >>> uv, good = track_patches(*images, one, same, one, range(0, -1, -1), TrackingSettings().patch)
    >>> uv.round(1).tolist(), good.tolist()
    ([[33.0, 30.0]], [True])
    """
    return track_sought([Sought(reference, place, warp, guess)], current, levels, patch)[0]


@dataclass(frozen=True)
class Sought:
    """Points of one image that are looked for in another.

    Attributes
    ----------
    reference : Pyramid
        The image.
    place : (N, 2) float64
        The points, px.
    warp : (N, 2, 2) float64
        As `compute_warps` gives them.
    guess : (N, 2) float64
        Where they are expected, px.
    """

    reference: Pyramid
    place: FloatArray
    warp: FloatArray
    guess: FloatArray


def track_sought(
    sought: Sequence[Sought], current: Pyramid, levels: range, patch: Patch
) -> list[tuple[FloatArray, BoolArray]]:  # fmt: skip
    """`track_patches` of points of several images, half of each image's in a second thread if they are many.

    Parameters
    ----------
    sought : sequence of Sought
        The points.
    current : Pyramid
        The image that they are looked for in.
    levels, patch
        As `track_patches` takes them.

    Returns
    -------
    list of ((N, 2) float64, (N,) bool)
        Of each image's points what `track_patches` returns.
    """
    found = [(np.array(each.guess, np.float64), np.full(len(each.place), -1.0)) for each in sought]
    there = [level for level in levels if level < len(current.levels)]

    def part(half: int) -> None:
        for each, (uv, score) in zip(sought, found, strict=True):
            middle = len(uv) // 2
            rows = slice(0, middle) if half == 0 else slice(middle, len(uv))
            _track_rows(each, current, there, patch, rows, uv[rows], score[rows])

    if sum(len(each.place) for each in sought) >= _WORTH:
        both(part, (0, 1))
    else:
        part(0)
        part(1)
    return [(uv, np.asarray(score >= patch.min_correlation)) for uv, score in found]


def _track_rows(
    sought: Sought, current: Pyramid, levels: list[int], patch: Patch, rows: slice, uv: FloatArray, score: FloatArray
) -> None:
    """Some of the points of an image, from level to level; `uv` and `score`, of these alone, are changed."""
    from ._patch_tracking import track_level

    place, warp, given = sought.place[rows], sought.warp[rows], (patch.radius, patch.contrast, patch.reach)
    if len(uv):
        for level in levels:
            planes = sought.reference.levels[level], current.levels[level]
            track_level(*planes, place, warp, 2.0**level, *given, uv, score)


def aim_patches(
    rig: Rig, xyz: FloatArray, landmark: NDArray[np.int64], T_world_reference: FloatArray,
    T_world_current: FloatArray, *, min_depth: float = 0.0, max_zoom: float = np.inf,
) -> tuple[FloatArray, FloatArray, BoolArray]:  # fmt: skip
    """Find where landmarks that one camera saw are expected in another's image, and how their patches look there.

    Parameters
    ----------
    rig : Rig
        The cameras.
    xyz : (M, 3) float64
        All landmarks, m.
    landmark : (K,) int64
        Which of them.
    T_world_reference, T_world_current : (4, 4) float64
        Poses of the camera that saw them and of the other.
    min_depth : float
        Least depth in the other's image, m.
    max_zoom : float
        Largest ratio of the depths in both, either way.

    Returns
    -------
    warp : (K, 2, 2) float64
        As `compute_warps` gives them.
    guess : (K, 2) float64
        Where they are expected, px, also where that is outside.
    in_view : (K,) bool
        Whether they lie in the image, at depths within these limits.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> ahead, one = np.eye(4), np.array([[0.0, 0.2, 4.0]])
    >>> ahead[2, 3] = 2.0
    >>> warp, guess, in_view = aim_patches(rig, one, np.array([0]), np.eye(4), ahead)
    >>> warp[0].tolist(), guess.tolist(), in_view.tolist()
    ([[0.5, -0.0], [-0.0, 0.5]], [[320.0, 290.0]], [True])
    """
    from ._patch_tracking import aim

    K = len(landmark)
    found = np.empty((K, 2, 2)), np.empty((K, 2)), np.empty(K, np.bool_)
    poses = np.ascontiguousarray(T_world_reference), np.ascontiguousarray(T_world_current)
    aim(lens_of(rig), np.array([rig.width, rig.height]), xyz, landmark, *poses, min_depth, max_zoom, *found)
    return found


def compute_warps(rig: Rig, T: FloatArray, xyz: FloatArray) -> FloatArray:
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
    return aim_patches(rig, np.ascontiguousarray(xyz), np.arange(len(xyz)), np.eye(4), inverse(T))[0]
