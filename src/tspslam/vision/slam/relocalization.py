"""Where a lost camera is: landmarks found by their descriptors, then the perspective-n-point problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...types import BoolArray, FloatArray, Rig
from ..images import Pyramid, pyramid
from .map import Keyframe, Map
from .tracking import MIN_MATCHES, MIN_RECOGNISED, PoseEstimate, Reference, track_pose

_MAX_BITS = 64  # of 256
_RATIO = 0.85  # of the best distance against the second
_TRIED_LOST = 5  # keyframes that a lost camera may be near
_SAMPLE = 400  # descriptors that say which keyframes a lost camera may be near


def relocalize(world: Map, image: Pyramid, uv: FloatArray, descriptors: NDArray[np.uint64]) -> PoseEstimate | None:
    """Where a lost camera is: found by its descriptors among the landmarks of one keyframe, None if of none.

    Tried are the last keyframes, then those of which the image has most. Parameters as `detect_loop`.
    """
    last = world.references()
    older = world.keyframes[: -len(last)]
    alike = [older[k] for k in most_alike(older, world, descriptors)]
    for frame in [*world.keyframes[: -len(last) - 1 : -1], *alike]:
        found = solve_pnp(world.rig, uv, descriptors, world.xyz[frame.landmark], world.descriptors[frame.landmark])
        if found is not None:
            own = [] if frame.image is not None else [reference_to(frame, np.ones(len(frame.landmark), np.bool_))]
            estimate = track_pose(world.rig, image, own or last, world.xyz, found)
            if estimate is not None and estimate.share >= MIN_RECOGNISED:
                return estimate
    return None


def most_alike(frames: list[Keyframe], world: Map, descriptors: NDArray[np.uint64]) -> list[int]:
    """The keyframes with an image of whose landmarks most are the nearest to a sample of descriptors."""
    sample = descriptors[:: max(1, len(descriptors) // _SAMPLE)]
    is_seen = np.zeros(len(world.xyz), np.bool_)
    is_seen[nearest_descriptors(sample, world.descriptors)] = True
    votes = np.array([is_seen[frame.landmark].sum() if frame.grey is not None else 0 for frame in frames], np.int64)
    return [k for k in np.argsort(-votes, kind="stable")[:_TRIED_LOST].tolist() if votes[k] >= MIN_MATCHES]


def solve_pnp(
    rig: Rig, uv: FloatArray, descriptors: NDArray[np.uint64], xyz: FloatArray, wanted: NDArray[np.uint64]
) -> FloatArray | None:
    """Pose from landmarks recognised by their descriptors alone; None if too few agree.

    Parameters
    ----------
    rig : Rig
        The camera.
    uv : (N, 2) float64
        Keypoints, px.
    descriptors : (N, D) uint64
        Their descriptors (`binary_descriptors`).
    xyz : (M, 3) float64
        Landmarks, m.
    wanted : (M, D) uint64
        Theirs.
    """
    import cv2

    keypoint, landmark = _match_descriptors(descriptors, wanted)
    if len(landmark) < MIN_MATCHES:
        return None
    K = np.array([[rig.fx, rig.skew, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])
    cv2.setRNGSeed(0)
    found, turn, t, kept = cv2.solvePnPRansac(
        xyz[landmark], uv[keypoint], K, None,
        iterationsCount=500, reprojectionError=4.0, confidence=0.999, flags=cv2.SOLVEPNP_P3P,
    )  # fmt: skip
    if not found or kept is None or len(kept) < MIN_MATCHES:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(turn)[0].T
    T[:3, 3] = -T[:3, :3] @ t[:, 0]
    return T


def nearest_descriptors(descriptors: NDArray[np.uint64], wanted: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Rows of `wanted` that are near to some of `descriptors`, each word's nearest."""
    import cv2

    if min(len(descriptors), len(wanted)) < 1 or descriptors.shape[1] == 0:
        return np.empty(0, np.int64)
    found = cv2.BFMatcher(cv2.NORM_HAMMING).match(descriptors.view(np.uint8), wanted.view(np.uint8))
    most = _MAX_BITS * descriptors.shape[1] / 4
    return np.array([one.trainIdx for one in found if one.distance <= most], np.int64)


def _match_descriptors(
    descriptors: NDArray[np.uint64], wanted: NDArray[np.uint64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Keypoints and landmarks that are each other's nearest, and clearly so."""
    import cv2

    if min(len(descriptors), len(wanted)) < 2 or descriptors.shape[1] == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    first, second = descriptors.view(np.uint8), wanted.view(np.uint8)
    forth = matcher.knnMatch(first, second, k=2)
    back = {(one.trainIdx, one.queryIdx) for one in matcher.match(second, first)}
    most = _MAX_BITS * descriptors.shape[1] / 4
    clear = [one for one, other in forth if one.distance <= most and one.distance <= _RATIO * other.distance]
    pairs = [(one.queryIdx, one.trainIdx) for one in clear if (one.queryIdx, one.trainIdx) in back]
    keypoint, landmark = np.array(pairs, np.int64).reshape(-1, 2).T
    return keypoint, landmark


def binary_descriptors(descriptor: NDArray[np.uint8] | NDArray[np.float32]) -> NDArray[np.uint64]:
    """Descriptors as binary ones in 64-bit parts; of real ones the signs of 256 random projections (Charikar 2002).

    Examples
    --------
    >>> binary_descriptors(np.zeros((3, 32), np.uint8)).shape, binary_descriptors(np.ones((3, 128), np.float32)).shape
    ((3, 4), (3, 4))
    """
    if descriptor.shape[1] == 0:
        return np.zeros(descriptor.shape, np.uint64)
    if descriptor.dtype == np.uint8:
        spare = -descriptor.shape[1] % 8
        return np.ascontiguousarray(np.pad(descriptor, ((0, 0), (0, spare)))).view(np.uint64)
    axes = np.random.default_rng(0).standard_normal((descriptor.shape[1], 256))
    axes -= axes.mean(axis=0)  # no descriptor's mean counts
    return np.packbits(descriptor.astype(np.float64) @ axes > 0, axis=1).view(np.uint64)


def reference_to(frame: Keyframe, wanted: BoolArray) -> Reference:
    """Some landmarks of an older keyframe, to be followed."""
    assert frame.grey is not None
    return Reference(pyramid(frame.grey), frame.T_world_camera, frame.uv[wanted], frame.landmark[wanted])
