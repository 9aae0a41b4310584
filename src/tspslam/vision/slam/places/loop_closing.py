"""Places seen before: where a lost camera is (relocalisation), which landmarks are seen again (loop closing)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...._settings import Checked, setting
from ....types import BoolArray, FloatArray
from ...features.binary import Descriptors, match_descriptors, nearest_descriptors
from ...images import Pyramid, build_pyramid
from ...rig import project
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..pose import PoseEstimate, solve_pnp
from ..tracking import Reference, TrackingSettings, refine_pose, track_pose


@dataclass(frozen=True)
class LoopSettings(Checked, what="tracking.loops"):
    """How places seen before are found.

    Parameters
    ----------
    min_error : float
        Error of old landmarks in the image, in the median, above which a loop is closed.
    candidates : int
        Keyframes that a camera may have come back to, tried at each keyframe.
    lost_candidates : int
        Keyframes that a lost camera may be near.
    sample : int
        Descriptors of an image that say which keyframes it is like.
    max_distance : float
        Distance of a keyframe that a camera may have come back to, beside what the path may have drifted.
    drift_rate : float
        How far a path may drift, by the way it has come.
    drift_slack : float
        How far a path may drift whatever its length.
    max_angle : float
        Angle between the viewing directions of the two.
    known_share : float
        Share of a keyframe's landmarks that are tracked already, from which it is not looked at.
    min_landmarks : int
        Landmarks that prove a place.
    same_landmark : float
        Distance of two observations, in u, v and disparity, of one landmark.
    max_hamming : float
        Largest distance of two descriptors, bits in 256.
    ratio : float
        A descriptor's distance must be at most this times that of the second nearest.
    pnp_error : float
        Largest distance of a landmark that agrees with a pose from descriptors.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> LoopSettings(min_landmarks=50).min_error
    1.0
    """

    min_error: float = setting(1.0, 0, 100, unit="px", source="by hand; half, twice: same paths")
    candidates: int = setting(2, 0, 100, unit="keyframes", source="by hand; half, twice: same paths")
    lost_candidates: int = setting(5, 0, 100, unit="keyframes", source="by hand; half, twice: same paths")
    sample: int = setting(400, 1, 100_000, unit="descriptors", source="by hand; half, twice: same paths")
    max_distance: float = setting(
        0.3, 0, 10, unit="m per m of depth", source="by hand; corridor 0.15: 1.5, 0.6: 1.7 mm (1.5)"
    )
    drift_rate: float = setting(0.02, 0, 1, unit="m per m", source="by hand; half, twice: same paths")
    drift_slack: float = setting(0.02, 0, 1, unit="m per m of depth", source="by hand; half, twice: same paths")
    max_angle: float = setting(40.0, 0, 180, unit="degrees", source="by hand; half, twice: same paths")
    known_share: float = setting(0.3, 0, 1, unit="", source="by hand; corridor 0.15: 1.7, 0.6: 1.5 mm (1.5)")
    min_landmarks: int = setting(
        30, 4, 10_000, unit="landmarks", source="twice what a pose needs; half, twice: same paths"
    )
    same_landmark: float = setting(1.0, 0.01, 100, unit="px", source="by hand; corridor 0.5: 1.5, 2: 1.7 mm (1.5)")
    max_hamming: float = setting(
        64.0,
        0,
        256,
        unit="bits",
        source="as in matching left to right; corridor 32: 1.6, 128: 1.5 mm (1.5)",
    )
    ratio: float = setting(
        0.85,
        0,
        1,
        unit="",
        source="as in matching left to right; corridor 0.425: 1.6, 1: 1.5 mm (1.5)",
    )
    pnp_error: float = setting(4.0, 0.1, 100, unit="px", source="by hand; corridor 2: 1.5, 8: 1.6 mm (1.5)")


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


@dataclass(frozen=True)
class PlaceRecognition:
    """What it takes to find places again.

    Attributes
    ----------
    map_ : Map
        Keyframes and landmarks.
    tracking : TrackingSettings
        How landmarks are tracked, and when a pose is believed.
    loops : LoopSettings
        How places are found.
    """

    map_: Map
    tracking: TrackingSettings
    loops: LoopSettings

    def relocalize(self, image: Pyramid, uv: FloatArray, descriptors: Descriptors) -> PoseEstimate | None:
        """Find where a lost camera is: by its descriptors among the landmarks of one keyframe; None if of none.

        The last keyframes are tried, then those whose landmarks the image shows most of.

        Parameters
        ----------
        image : Pyramid
            What the camera shows.
        uv : (N, 2) float64
            Its keypoints, px.
        descriptors : (N, P) uint64
            Theirs.

        Returns
        -------
        PoseEstimate or None
            Without disparities.
        """
        map_, last = self.map_, self.map_.references()
        older = map_.keyframes[: -len(last)]
        similar = [older[k] for k in self._most_similar(older, descriptors)]
        for frame in [*map_.keyframes[: -len(last) - 1 : -1], *similar]:
            T = self._solve_pnp(frame, uv, descriptors)
            if T is not None:
                own = (
                    []
                    if frame.image is not None
                    else self._references_to(frame, np.ones(len(frame.landmark), np.bool_))
                )
                estimate = track_pose(map_.rig, image, own or last, map_.xyz, T, self.tracking)
                if estimate is not None and estimate.share >= self.tracking.relocalized_share:
                    return estimate
        return None

    def detect_loop(
        self, image: Pyramid, estimate: PoseEstimate, uv: FloatArray, descriptors: Descriptors
    ) -> LoopClosure | None:
        """Find landmarks of an older keyframe that a camera sees again; None if there are none, or they are tracked.

        Parameters
        ----------
        image : Pyramid
            The new image.
        estimate : PoseEstimate
            Its pose, and the landmarks that are tracked.
        uv : (N, 2) float64
            Its keypoints, px.
        descriptors : (N, P) uint64
            Theirs.

        Returns
        -------
        LoopClosure or None
        """
        map_ = self.map_
        tracked = np.zeros(len(map_.xyz), np.bool_)
        tracked[estimate.landmark] = True
        for place, slack in [*self.places_near(estimate, tracked), *self._places_before(descriptors)]:
            frame = map_.keyframes[place]
            T = self._solve_pnp(frame, uv, descriptors)
            T = estimate.T_world_camera if T is None else T
            reference = self._references_to(frame, ~tracked[frame.landmark])
            found = track_pose(map_.rig, image, reference, map_.xyz, T, self.tracking) if reference else None
            if found is not None and len(found) >= self.loops.min_landmarks and _distance(found, estimate) <= slack:
                return LoopClosure(place, found, self._drift(found, estimate.T_world_camera))
        return None

    def merge_observations(
        self, again: PoseEstimate, estimate: PoseEstimate, spread: Callable[[FloatArray], FloatArray]
    ) -> PoseEstimate:
        """Join what a camera sees again to what it tracks: landmarks in the same place become one in the map.

        Parameters
        ----------
        again, estimate : PoseEstimate
            Landmarks seen again, and those that are tracked, all with disparities.
        spread : callable
            Standard deviations of the disparities at places (K, 2) of its image, (K,) px.

        Returns
        -------
        PoseEstimate
            The landmarks of both that agree, and their pose.
        """
        from scipy.spatial import cKDTree

        places = np.column_stack([again.uv, again.disparity]), np.column_stack([estimate.uv, estimate.disparity])
        known = [np.flatnonzero(np.isfinite(one).all(axis=1)) for one in places]
        tree, most = cKDTree(places[0][known[0]]), self.loops.same_landmark
        away, nearest = map(np.asarray, tree.query(places[1][known[1]], distance_upper_bound=most))
        is_same = np.isfinite(away)
        others, first = known[1][is_same], known[0][nearest[is_same]]
        self.map_.merge_landmarks(again.landmark[first], estimate.landmark[others])
        rest = np.setdiff1d(np.arange(len(estimate)), others)
        both = replace(
            estimate,
            landmark=np.concatenate([again.landmark, estimate.landmark[rest]]),
            uv=np.concatenate([again.uv, estimate.uv[rest]]),
            disparity=np.concatenate([again.disparity, estimate.disparity[rest]]),
        )
        return refine_pose(self.map_.rig, both, self.map_.xyz, both.disparity, spread(both.uv), self.tracking)

    def places_near(self, estimate: PoseEstimate, tracked: BoolArray) -> list[tuple[int, float]]:
        """Find older keyframes near a camera that look its way, and whose landmarks it does not track, nearest first.

        Parameters
        ----------
        estimate : PoseEstimate
            The camera.
        tracked : (M,) bool
            Landmarks that it tracks.

        Returns
        -------
        list of (int, float)
            Keyframes with an image, none from before the map began anew; and how far, in m, the path may have drifted
            since.
        """
        map_, loops, T = self.map_, self.loops, estimate.T_world_camera
        count = len(map_.keyframes) - map_.window
        if count <= 0:
            return []
        is_older = np.arange(count) >= _last_start(map_)
        poses = np.array([frame.T_world_camera for frame in map_.keyframes])
        depth = float(np.median((map_.xyz[estimate.landmark] - T[:3, 3]) @ T[:3, 2]))
        steps: FloatArray = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        slack = loops.drift_slack * depth + loops.drift_rate * np.cumsum(steps[::-1])[::-1][:count]
        away: FloatArray = np.linalg.norm(poses[:count, :3, 3] - T[:3, 3], axis=1)
        looks_alike = poses[:count, :3, 2] @ T[:3, 2] >= np.cos(np.radians(loops.max_angle))
        near = is_older & (away <= loops.max_distance * depth + slack) & looks_alike
        order = sorted(np.flatnonzero(near).tolist(), key=lambda k: float(away[k]))
        return [(k, float(slack[k])) for k in order if self._is_left(map_.keyframes[k], tracked)][: loops.candidates]

    def _places_before(self, descriptors: Descriptors) -> list[tuple[int, float]]:
        """Keyframes from before the map began anew that look like an image: nobody knows how far away they are."""
        start = _last_start(self.map_)
        return [(k, np.inf) for k in self._most_similar(self.map_.keyframes[:start], descriptors)] if start else []

    def _is_left(self, frame: Keyframe, tracked: BoolArray) -> bool:
        if frame.index not in self.map_.images or not len(frame.landmark):
            return False
        return bool(tracked[frame.landmark].mean() < self.loops.known_share)

    def _solve_pnp(self, frame: Keyframe, uv: FloatArray, descriptors: Descriptors) -> FloatArray | None:
        """Pose from a keyframe's landmarks, by descriptors alone; None if too few agree."""
        map_, loops = self.map_, self.loops
        known = map_.descriptors[frame.landmark]
        keypoint, row = match_descriptors(descriptors, known, max_hamming=loops.max_hamming, ratio=loops.ratio)
        points, least = map_.xyz[frame.landmark[row]], self.tracking.min_matches
        return solve_pnp(map_.rig, points, uv[keypoint], max_error=loops.pnp_error, min_matches=least)

    def _references_to(self, frame: Keyframe, wanted: BoolArray) -> list[Reference]:
        """Some landmarks of an older keyframe, to be tracked; none if its image is gone."""
        grey = self.map_.images.get(frame.index)
        if grey is None:
            return []
        return [Reference(build_pyramid(grey), frame.T_world_camera, frame.uv[wanted], frame.landmark[wanted])]

    def _drift(self, found: PoseEstimate, T: FloatArray) -> float:
        """How far a camera at T would see landmarks from where they are, median, px."""
        map_ = self.map_
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = project(map_.rig, (map_.xyz[found.landmark] - T[:3, 3]) @ T[:3, :3])
        return float(np.median(np.nan_to_num(np.linalg.norm(expected - found.uv, axis=1), nan=np.inf)))

    def _most_similar(self, frames: list[Keyframe], descriptors: Descriptors) -> list[int]:
        """The keyframes, of those with an image, whose landmarks are nearest to most of a sample of descriptors."""
        map_, loops = self.map_, self.loops
        sample = descriptors[:: max(1, len(descriptors) // loops.sample)]
        is_seen = np.zeros(len(map_.xyz), np.bool_)
        is_seen[nearest_descriptors(sample, map_.descriptors, max_hamming=loops.max_hamming)] = True
        votes = np.array([is_seen[f.landmark].sum() if f.index in map_.images else 0 for f in frames], np.int64)
        best = np.argsort(-votes, kind="stable")[: loops.lost_candidates].tolist()
        return [k for k in best if votes[k] >= self.tracking.min_matches]


def _last_start(map_: Map) -> int:
    """Keyframe with which the map last began anew and that is not yet joined to the earlier ones; else 0."""
    return max((k for k, frame in enumerate(map_.keyframes) if frame.is_start), default=0)


def _distance(one: PoseEstimate, other: PoseEstimate) -> float:
    """How far two cameras are apart, m."""
    return float(np.linalg.norm((one.T_world_camera - other.T_world_camera)[:3, 3]))
