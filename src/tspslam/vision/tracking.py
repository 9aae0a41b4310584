"""The pose of a camera from landmarks: search near the predicted place, then least squares without outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..types import BoolArray, FloatArray, Rig
from .bundle import Observations, adjust, pose_information
from .rig import project

LEAST_MATCHES = 15
_RADII = (15.0, 45.0)  # px per unit of scale, of the first and the second search
_CLOSE = 5.0  # px per unit of scale, once a pose is found
_MOST_BITS, _RATIO = 64, 0.9  # of 256; the best distance against the second
_GATES = (8.0, 5.0, 3.5)  # standard deviations beyond which a match is dropped, round by round
_ENOUGH = 50  # matches that make a wider search needless


@dataclass(frozen=True)
class Sight:
    """What one frame shows: keypoints, descriptors as 64-bit words, disparities (NaN where not known), scales.

    Attributes
    ----------
    uv : (N, 2) float64
        px.
    words : (N, D) uint64
        Binary descriptors.
    disparity : (N,) float64
        px.
    scale : (N,) float64
        Size of one detector pixel, px.
    """

    uv: FloatArray
    words: NDArray[np.uint64]
    disparity: FloatArray
    scale: FloatArray


@dataclass(frozen=True)
class Landmarks:
    """Points that keyframes have seen.

    Attributes
    ----------
    xyz : (M, 3) float64
        In the world, m.
    words : (M, D) uint64
        Their latest descriptors.
    scale : (M,) float64
        And scales.
    """

    xyz: FloatArray
    words: NDArray[np.uint64]
    scale: FloatArray

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True)
class Fix:
    """A pose, and the matches that agree with it.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        The pose.
    landmark, keypoint : (K,) int64
        Rows of the landmarks and of the sight.
    covariance : (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame; infinite where the pose was not measured.
    """

    T_world_camera: FloatArray
    landmark: NDArray[np.int64]
    keypoint: NDArray[np.int64]
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.landmark)


def locate(rig: Rig, sight: Sight, landmarks: Landmarks, T_guess: FloatArray, *, sigma_disparity: float) -> Fix | None:
    """Find a camera's pose near a guess; None where too few landmarks agree on one.

    Parameters
    ----------
    rig : Rig
        The cameras.
    sight : Sight
        What the frame shows.
    landmarks : Landmarks
        What might be seen.
    T_guess : (4, 4) float64
        ``T_world_camera`` to search around; a search of the whole image by descriptors alone is the last resort.
    sigma_disparity : float
        Standard deviation of a disparity, px per unit of scale.
    """
    best: Fix | None = None
    if min(len(landmarks), len(sight.uv)) < LEAST_MATCHES:
        return None
    for radius in _RADII:
        matches = _near(rig, sight, landmarks, T_guess, radius)
        best = _better(best, _settle_again(rig, sight, landmarks, T_guess, matches, sigma_disparity))
        if best and len(best) >= _ENOUGH:
            return best
    matches = _anywhere(sight, landmarks)
    T = _resected(rig, sight, landmarks, *matches)
    return best if T is None else _better(best, _settle_again(rig, sight, landmarks, T, matches, sigma_disparity))


def observations(
    sight: Sight, keypoint: NDArray[np.int64], pose: NDArray[np.int64], point: NDArray[np.int64], sigma_disparity: float
) -> Observations:
    """Keypoints as observations; standard deviations are the keypoint's scale, and so many px of disparity per unit."""
    scale = sight.scale[keypoint]
    return Observations(pose, point, sight.uv[keypoint], sight.disparity[keypoint], scale, sigma_disparity * scale)


_Matches = tuple[NDArray[np.int64], NDArray[np.int64]]


def _near(rig: Rig, sight: Sight, landmarks: Landmarks, T: FloatArray, radius: float) -> _Matches:
    """Landmarks that are seen near their predicted places, and their keypoints; each once."""
    places = project(rig, (landmarks.xyz - T[:3, 3]) @ T[:3, :3])
    rows = np.flatnonzero(_inside(rig, places))
    return _searched(sight, landmarks, rows, places[rows], radius)


def _anywhere(sight: Sight, landmarks: Landmarks) -> _Matches:
    """Landmarks found by descriptors alone."""
    rows = np.arange(len(landmarks))
    middle = np.zeros((len(rows), 2)) + sight.uv.mean(axis=0)
    return _searched(sight, landmarks, rows, middle, 1e5)


def _searched(
    sight: Sight, landmarks: Landmarks, rows: NDArray[np.int64], places: FloatArray, radius: float
) -> _Matches:
    from ._tracking import search_near

    best, distance, rival = (np.empty(len(rows), np.int64) for _ in range(3))
    if len(rows):
        search_near(
            sight.uv, sight.words, sight.scale, np.ascontiguousarray(places), landmarks.words[rows],
            landmarks.scale[rows], radius, best, distance, rival,
        )  # fmt: skip
    most = _MOST_BITS * landmarks.words.shape[1] // 4
    clear = np.flatnonzero((best >= 0) & (distance <= most) & (distance <= _RATIO * rival))
    order = clear[np.lexsort((rows[clear], distance[clear]))]
    _, first = np.unique(best[order], return_index=True)
    kept = np.sort(order[first])
    return rows[kept], best[kept]


def _inside(rig: Rig, uv: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore"):
        inside = (uv >= 0) & (uv <= (rig.width - 1, rig.height - 1))
    return np.asarray(inside[:, 0] & inside[:, 1])


def _settle(
    rig: Rig, sight: Sight, landmarks: Landmarks, T: FloatArray, matches: _Matches, sigma_disparity: float
) -> Fix | None:
    """Least squares on the pose, with fewer and fewer outliers."""
    landmark, keypoint = matches
    for gate in _GATES:
        if len(landmark) < LEAST_MATCHES:
            return None
        seen = _of_one(sight, keypoint, sigma_disparity)
        found = adjust(rig, T[None], landmarks.xyz[landmark], seen, move_points=False, most_steps=10)
        T, good = found.T_world_camera[0], found.distance <= gate
        landmark, keypoint = landmark[good], keypoint[good]
    if len(landmark) < LEAST_MATCHES:
        return None
    seen = _of_one(sight, keypoint, sigma_disparity)
    information = pose_information(rig, T[None], landmarks.xyz[landmark], seen)
    return Fix(T, landmark, keypoint, np.linalg.inv(information).astype(np.float64))


def _settle_again(
    rig: Rig, sight: Sight, landmarks: Landmarks, T: FloatArray, matches: _Matches, sigma_disparity: float
) -> Fix | None:
    """Least squares on matches, then once more on those near where the first pose has them."""
    first = _settle(rig, sight, landmarks, T, matches, sigma_disparity)
    if first is None:
        return None
    matches = _near(rig, sight, landmarks, first.T_world_camera, _CLOSE)
    return _better(first, _settle(rig, sight, landmarks, first.T_world_camera, matches, sigma_disparity))


def _better(one: Fix | None, other: Fix | None) -> Fix | None:
    """The fix with more matches, the first of two alike."""
    return other if other and (one is None or len(other) > len(one)) else one


def _of_one(sight: Sight, keypoint: NDArray[np.int64], sigma_disparity: float) -> Observations:
    point = np.arange(len(keypoint))
    return observations(sight, keypoint, np.zeros_like(point), point, sigma_disparity)


def _resected(
    rig: Rig, sight: Sight, landmarks: Landmarks, landmark: NDArray[np.int64], keypoint: NDArray[np.int64]
) -> FloatArray | None:
    """Pose from matches of which most may be wrong: P3P in random samples of a fixed seed."""
    import cv2

    if len(landmark) < LEAST_MATCHES:
        return None
    K = np.array([[rig.fx, rig.skew, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])
    cv2.setRNGSeed(0)
    found, turn, t, kept = cv2.solvePnPRansac(
        landmarks.xyz[landmark], sight.uv[keypoint], K, None,
        iterationsCount=300, reprojectionError=4.0, confidence=0.999, flags=cv2.SOLVEPNP_P3P,
    )  # fmt: skip
    if not found or kept is None or len(kept) < LEAST_MATCHES:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(turn)[0].T
    T[:3, 3] = -T[:3, :3] @ t[:, 0]
    return T
