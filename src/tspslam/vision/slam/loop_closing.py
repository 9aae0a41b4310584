"""Places seen before: which keyframes a camera may have come back to, and which of their landmarks it sees again."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...types import BoolArray, FloatArray
from ..images import Pyramid
from ..rig import project
from .map import Keyframe, Map
from .relocalization import most_alike, reference_to, solve_pnp
from .tracking import PoseEstimate, refine_pose, track_pose

MAX_DRIFT = 1.0  # px, of old landmarks in the median: from there on the map is bent
_TRIED = 2  # keyframes that a camera may have come back to
_NEAR, _DRIFT = 0.3, 0.02  # m away per m of depth; m that a path drifts per m of the way
_SLACK = 0.02  # m per m of depth that a path may have drifted without any way
_ALIKE = np.cos(np.radians(40))  # of the angle between viewing directions
_KNOWN = 0.3  # share of a keyframe's landmarks that are seen anyway: it is no news
_MIN_AGAIN = 30  # landmarks that prove a place
_SAME = 1.0  # px between two landmarks, in u, v and disparity, that are one


@dataclass(frozen=True)
class LoopClosure:
    """A keyframe's landmarks in a new image.

    Attributes
    ----------
    place : int
        Which keyframe of the map.
    estimate : PoseEstimate
        Its landmarks, and the pose that they give, without disparities.
    drift : float
        How far off the camera's pose had them, median, px.
    """

    place: int
    estimate: PoseEstimate
    drift: float


def detect_loop(
    world: Map, image: Pyramid, estimate: PoseEstimate, uv: FloatArray, descriptors: NDArray[np.uint64]
) -> LoopClosure | None:
    """Find landmarks of an older keyframe that a camera sees again; None if there are none, or they are followed.

    Parameters
    ----------
    world : Map
        Keyframes and landmarks.
    image : Pyramid
        The new image.
    estimate : PoseEstimate
        Its pose, and the landmarks that are followed.
    uv : (N, 2) float64
        Its keypoints, px.
    descriptors : (N, D) uint64
        Their descriptors.
    """
    followed = np.zeros(len(world.xyz), np.bool_)
    followed[estimate.landmark] = True
    for place, slack in [*places_near(world, estimate, followed), *_places_before(world, descriptors)]:
        frame = world.keyframes[place]
        T = solve_pnp(world.rig, uv, descriptors, world.xyz[frame.landmark], world.descriptors[frame.landmark])
        reference = reference_to(frame, ~followed[frame.landmark])
        found = track_pose(world.rig, image, [reference], world.xyz, estimate.T_world_camera if T is None else T)
        if found is not None and len(found) >= _MIN_AGAIN and _apart(found, estimate) <= slack:
            return LoopClosure(place, found, _drift(world, found, estimate.T_world_camera))
    return None


def places_near(world: Map, estimate: PoseEstimate, followed: BoolArray) -> list[tuple[int, float]]:
    """Older keyframes near a camera and looking its way, whose landmarks it does not follow, the nearest first.

    Each with an image, and none from before the map began anew; and how far, in m, the path may have drifted since.
    """
    T, count = estimate.T_world_camera, len(world.keyframes) - world.window
    if count <= 0:
        return []
    is_older = np.arange(count) >= _last_start(world)
    poses = np.array([frame.T_world_camera for frame in world.keyframes])
    depth = float(np.median((world.xyz[estimate.landmark] - T[:3, 3]) @ T[:3, 2]))
    steps: FloatArray = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    slack = _SLACK * depth + _DRIFT * np.cumsum(steps[::-1])[::-1][:count]
    away: FloatArray = np.linalg.norm(poses[:count, :3, 3] - T[:3, 3], axis=1)
    near = is_older & (away <= _NEAR * depth + slack) & (poses[:count, :3, 2] @ T[:3, 2] >= _ALIKE)
    order = sorted(np.flatnonzero(near).tolist(), key=lambda k: float(away[k]))
    return [(k, float(slack[k])) for k in order if _is_news(world.keyframes[k], followed)][:_TRIED]


def _last_start(world: Map) -> int:
    """Keyframe with which the map last began anew and that is not yet joined to the earlier ones; else 0."""
    return max((k for k, frame in enumerate(world.keyframes) if frame.is_start), default=0)


def _places_before(world: Map, descriptors: NDArray[np.uint64]) -> list[tuple[int, float]]:
    """Keyframes from before the map began anew that look like an image: nobody knows how far away they are."""
    start = _last_start(world)
    return [(k, np.inf) for k in most_alike(world.keyframes[:start], world, descriptors)] if start else []


def _is_news(frame: Keyframe, followed: BoolArray) -> bool:
    if frame.grey is None or not len(frame.landmark):
        return False
    return bool(followed[frame.landmark].mean() < _KNOWN)


def _apart(one: PoseEstimate, other: PoseEstimate) -> float:
    """How far two cameras are apart, m."""
    return float(np.linalg.norm((one.T_world_camera - other.T_world_camera)[:3, 3]))


def _drift(world: Map, found: PoseEstimate, T: FloatArray) -> float:
    """How far a camera at T would see landmarks from where they are, median, px."""
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = project(world.rig, (world.xyz[found.landmark] - T[:3, 3]) @ T[:3, :3])
    return float(np.median(np.nan_to_num(np.linalg.norm(expected - found.uv, axis=1), nan=np.inf)))


def merge_observations(world: Map, again: PoseEstimate, estimate: PoseEstimate) -> PoseEstimate:
    """Both estimates as one: landmarks in the same place become one in the map, and all that agree give the pose.

    Disparities are as measured.
    """
    from scipy.spatial import cKDTree

    places = np.column_stack([again.uv, again.disparity]), np.column_stack([estimate.uv, estimate.disparity])
    known = [np.flatnonzero(np.isfinite(one).all(axis=1)) for one in places]
    tree = cKDTree(places[0][known[0]])
    away, nearest = map(np.asarray, tree.query(places[1][known[1]], distance_upper_bound=_SAME))
    same = np.isfinite(away)
    others, first = known[1][same], known[0][nearest[same]]
    world.merge_landmarks(again.landmark[first], estimate.landmark[others])
    rest = np.setdiff1d(np.arange(len(estimate)), others)
    both = replace(
        estimate,
        landmark=np.concatenate([again.landmark, estimate.landmark[rest]]),
        uv=np.concatenate([again.uv, estimate.uv[rest]]),
        disparity=np.concatenate([again.disparity, estimate.disparity[rest]]),
    )
    offset = world.offset.value
    better = refine_pose(world.rig, both, world.xyz, both.disparity - offset, world.sigma_disparity)
    return replace(better, disparity=better.disparity + offset)
