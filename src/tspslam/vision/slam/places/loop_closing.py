"""Places seen before: where a lost camera is (relocalisation), which landmarks are seen again (loop closing)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray, FloatArray
from ...features.binary import Descriptors, match_descriptors
from ...images import Pyramid, build_pyramid
from ...rig import project
from ...se3 import inverse
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..keyframes.sightings import match_sights
from ..pose import PoseEstimate, distance_to_sights, solve_pnp
from ..tracking import Reference, TrackingSettings, refine_pose, track_pose
from .map_index import MapIndex
from .same_motion import is_same_motion
from .settings import LoopSettings

_ASKED = 50  # keyframes that look alike, of which those that are left and apart are tried


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

    @cached_property
    def index(self) -> MapIndex:
        """Keyframes by their looks."""
        return MapIndex(self.map_)

    def relocalize(
        self, image: Pyramid, uv: FloatArray, descriptors: Descriptors, most: int | None = None
    ) -> PoseEstimate | None:
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
        most : int, optional
            Keyframes to try that share any word, until one is clear; by default as many, and as similar, as the
            settings have it, until one is believed.

        Returns
        -------
        PoseEstimate or None
            Without disparities.
        """
        map_, last, best = self.map_, self.map_.references(), None
        enough = self.tracking.relocalized_share if most is None else self.tracking.clear_share
        newest = list(range(len(map_.keyframes) - 1, len(map_.keyframes) - 1 - len(last), -1))
        for place in [*newest, *self._most_similar(descriptors, most)]:
            frames = [map_.keyframes[place]] if place in newest else self._group(place)
            T = self._solve_pnp(frames, uv, descriptors)
            if T is not None:
                own = [] if place in newest else self._references_to(frames, np.ones(len(map_.xyz), np.bool_))
                estimate = track_pose(map_.rig, image, own or last, map_.xyz, T, self.tracking)
                if estimate is not None and estimate.share >= enough:
                    return estimate
                best = max(best, estimate, key=lambda one: 0 if one is None else len(one))
        return best if best is not None and best.share >= self.tracking.relocalized_share else None

    def detect_loop(
        self, image: Pyramid, estimate: PoseEstimate, uv: FloatArray, descriptors: Descriptors
    ) -> LoopClosure | None:
        """Find landmarks of an older keyframe that a camera sees again; None if there are none, or they are tracked.

        A camera half of whose landmarks older keyframes see needs none: where it is in the old map is known. Where
        fewer tell that, others are looked for at the places where they should be, without descriptors.
        Keyframes near the camera are tried, then those that look like what it shows, wherever they are. A place is not
        believed if it is farther from the camera than the path may have drifted. Nor is one away from where the camera
        was thought to be, unless the keyframe before is there too, or very many landmarks are.

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
        held = self.held_share(estimate.landmark)
        if held >= self.loops.held_share:
            return None
        tracked = np.zeros(len(self.map_.xyz), np.bool_)
        tracked[estimate.landmark] = True
        near = self.places_near(estimate, tracked)
        keypoints = None if held >= self.loops.known_share else (uv, descriptors)
        for place, slack in near:
            found = self._find_again(image, estimate, tracked, place, keypoints, is_near=True)
            if found is not None and self._is_believed(found, estimate, place, slack):
                return LoopClosure(place, found, self._drift(found, estimate))
        if keypoints is None:
            return None
        for place, slack in self.places_alike(estimate, tracked, descriptors, [place for place, _ in near]):
            found = self._find_again(image, estimate, tracked, place, keypoints, is_near=False)
            if found is not None and self._is_believed(found, estimate, place, slack):
                return LoopClosure(place, found, self._drift(found, estimate))
        return None

    def held_share(self, landmark: NDArray[np.int64]) -> float:
        """Tell how well the older part of the map holds a camera.

        Parameters
        ----------
        landmark : (K,) int64
            Landmarks that it tracks.

        Returns
        -------
        float
            Share of them that keyframes before the window see.
        """
        if len(self.map_.keyframes) <= self.map_.window or not len(landmark):
            return 0.0
        at, frame = self.map_.sightings.of(landmark)
        is_older = frame < self.map_.keyframes[-self.map_.window].index
        return len(np.unique(at[is_older])) / len(landmark)

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
        seen, own = (np.column_stack([one.uv, one.disparity]) for one in (again, estimate))
        first, others = match_sights(seen, own, self.loops.same_landmark)
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
            Keyframes with an image, none of another part of the map; and how far, in m, the path may have drifted
            since.
        """
        loops, T = self.loops, estimate.T_world_camera
        poses, slack = self._older(estimate)
        depth = self._depth(estimate)
        away: FloatArray = np.linalg.norm(poses[:, :3, 3] - T[:3, 3], axis=1)
        looks_alike = poses[:, :3, 2] @ T[:3, 2] >= np.cos(np.radians(loops.max_angle))
        near = np.isfinite(slack) & (away <= loops.max_distance * depth + slack) & looks_alike
        order = np.flatnonzero(near)[np.argsort(away[near], kind="stable")].tolist()
        left = (k for k in order if self._is_left(k, tracked) and self._is_in_view(k, T, tracked))
        return [(k, float(slack[k])) for k in islice(left, loops.candidates)]

    def places_alike(
        self, estimate: PoseEstimate, tracked: BoolArray, descriptors: Descriptors, known: Sequence[int]
    ) -> list[tuple[int, float]]:
        """Find older keyframes that look like what a camera shows, and whose landmarks it does not track.

        How far they are from it weighs, but leaves none out: where the path may have drifted d, a keyframe counts half
        at that distance beyond its view, a fifth at twice that.

        Parameters
        ----------
        estimate : PoseEstimate
            The camera.
        tracked : (M,) bool
            Landmarks that it tracks.
        descriptors : (N, P) uint64
            Of its keypoints.
        known : sequence of int
            Keyframes that were tried: neither they nor their neighbours are named.

        Returns
        -------
        list of (int, float)
            As `places_near`; infinite for those of another part of the map: nobody knows how far away they are.
        """
        poses, slack = self._older(estimate)
        places, words = self.index.query(self._sampled(descriptors), _ASKED)
        places, words = places[places < len(slack)], words[places < len(slack)]
        reach = self.loops.max_distance * self._depth(estimate)
        away = np.linalg.norm(poses[places, :3, 3] - estimate.T_world_camera[:3, 3], axis=1)
        worth = words / (1 + (np.maximum(0, away - reach) / np.maximum(slack[places], 1e-9)) ** 2)
        order = np.lexsort((places, -worth))
        least = np.where(
            np.isinf(slack[places]), 0, self.loops.min_words
        )  # nothing but its looks leads to another part
        likely = places[order][(worth >= least)[order]].tolist()
        left = (k for k in _apart(likely, known) if self._is_left(k, tracked))
        return [(k, float(slack[k])) for k in islice(left, self.loops.candidates)]

    def find_at(
        self, place: int, image: Pyramid, uv: FloatArray, descriptors: Descriptors
    ) -> PoseEstimate | None:  # fmt: skip
        """Find where a view is among the landmarks about one keyframe: by descriptors, then by patches.

        Parameters
        ----------
        place : int
            Which keyframe of the map.
        image : Pyramid
            What the view shows.
        uv : (N, 2) float64
            Its keypoints, px.
        descriptors : (N, P) uint64
            Theirs.

        Returns
        -------
        PoseEstimate or None
            Without disparities; None where too few landmarks prove the place.
        """
        T = self.guess_at(place, uv, descriptors)
        if T is None:
            return None
        return self._track(image, self._references_to(self._group(place), np.ones(len(self.map_.xyz), np.bool_)), T)

    def guess_at(self, place: int, uv: FloatArray, descriptors: Descriptors) -> FloatArray | None:
        """Find the pose of a view among the landmarks about one keyframe, by descriptors alone.

        Parameters
        ----------
        place : int
            Which keyframe of the map.
        uv : (N, 2) float64
            Keypoints of the view, px.
        descriptors : (N, P) uint64
            Theirs.

        Returns
        -------
        (4, 4) float64 or None
            None if too few agree.
        """
        return self._solve_pnp(self._group(place), uv, descriptors)

    def _older(self, estimate: PoseEstimate) -> tuple[FloatArray, FloatArray]:
        """Poses (K, 4, 4) of the keyframes before the window, and how far the path may have drifted since each, m."""
        poses, loops = self.index.poses, self.loops
        count = max(0, len(poses) - self.map_.window)
        steps: FloatArray = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        slack = loops.drift_slack * self._depth(estimate) + loops.drift_rate * np.cumsum(steps[::-1])[::-1][:count]
        slack[self.index.is_elsewhere[:count]] = np.inf
        return poses[:count], slack

    def _depth(self, estimate: PoseEstimate) -> float:
        """Depth of the landmarks that a camera tracks, median, m."""
        T = estimate.T_world_camera
        return float(np.median((self.map_.xyz[estimate.landmark] - T[:3, 3]) @ T[:3, 2]))

    def _is_left(self, place: int, tracked: BoolArray) -> bool:
        frame = self.map_.keyframes[place]
        if frame.index not in self.map_.images or not len(frame.landmark):
            return False
        return bool(tracked[frame.landmark].mean() < self.loops.known_share)

    def _is_in_view(self, place: int, T: FloatArray, tracked: BoolArray) -> bool:
        """Whether a camera at T should see enough of a keyframe's landmarks that it does not track."""
        rows = self.map_.keyframes[place].landmark
        points = (self.map_.xyz[rows[~tracked[rows]]] - T[:3, 3]) @ T[:3, :3]
        points = points[points[:, 2] > self.tracking.min_depth]
        inside = np.abs(project(self.map_.rig, points) / (self.map_.rig.width, self.map_.rig.height) - 0.5) < 0.5
        return bool(inside.all(axis=1).sum() >= self.loops.min_landmarks)

    def _group(self, place: int) -> list[Keyframe]:
        """A keyframe and those that see most of its landmarks."""
        others = sorted(self.map_.covisible(place), key=lambda one: (-one[1], one[0]))
        chosen = [place, *(k for k, _ in others[: self.loops.group - 1])]
        return [self.map_.keyframes[k] for k in chosen]

    def _find_again(
        self, image: Pyramid, estimate: PoseEstimate, tracked: BoolArray, place: int,
        keypoints: tuple[FloatArray, Descriptors] | None, *, is_near: bool,
    ) -> PoseEstimate | None:  # fmt: skip
        """Landmarks about a keyframe that an image shows, by patches; without those that are tracked.

        Where the keyframe is near, they are looked for from the camera's own pose first: where the path has not drifted
        they are there. Else descriptors tell where from.
        """
        frames, found = self._group(place), None
        references = self._references_to(frames, ~tracked)
        if is_near:
            found = self._track(image, references, estimate.T_world_camera)
            if found is not None or keypoints is None:
                return found
        assert keypoints is not None
        T = self._solve_pnp(frames, *keypoints)
        return None if T is None else self._track(image, references, T)

    def _track(self, image: Pyramid, references: list[Reference], T: FloatArray) -> PoseEstimate | None:
        """Landmarks of older keyframes that an image taken at about T shows, if they prove the place."""
        if not references:
            return None
        found = track_pose(self.map_.rig, image, references, self.map_.xyz, T, self.tracking)
        is_enough = found is not None and len(found) >= self.loops.min_landmarks
        return found if found is not None and is_enough and found.share >= self.tracking.relocalized_share else None

    def _is_believed(self, found: PoseEstimate, estimate: PoseEstimate, place: int, slack: float) -> bool:
        """Whether the path may have drifted so far, and it is no chance: near, many landmarks, or two keyframes."""
        away = _distance(found, estimate)
        if away > slack:
            return False
        is_near = np.isfinite(slack) and away <= self.loops.max_distance * self._depth(found)
        if is_near or len(found) >= self.loops.sure_landmarks:
            return True
        return self._is_confirmed(found, estimate, place)

    def _is_confirmed(self, found: PoseEstimate, estimate: PoseEstimate, place: int) -> bool:
        """Whether the map's last keyframe is at the place too, by its own descriptors, and where the path has it."""
        last = self.map_.keyframes[-1]
        before = self._solve_pnp(self._group(place), last.uv, self.map_.descriptors[last.landmark])
        if before is None:
            return False
        expected = found.T_world_camera @ inverse(estimate.T_world_camera) @ last.T_world_camera
        return is_same_motion(before, expected, self._depth(found), self.loops)

    def _solve_pnp(self, frames: Sequence[Keyframe], uv: FloatArray, descriptors: Descriptors) -> FloatArray | None:
        """Pose from the landmarks of some keyframes, by descriptors alone; None if too few agree."""
        map_, loops = self.map_, self.loops
        rows = np.unique(np.concatenate([frame.landmark for frame in frames]))
        known = map_.descriptors[rows]
        keypoint, row = match_descriptors(descriptors, known, max_hamming=loops.max_hamming, ratio=loops.ratio)
        points, least = map_.xyz[rows[row]], self.tracking.min_matches
        return solve_pnp(map_.rig, points, uv[keypoint], max_error=loops.pnp_error, min_matches=least)

    def _references_to(self, frames: Sequence[Keyframe], wanted: BoolArray) -> list[Reference]:
        """Wanted landmarks (M,) that older keyframes see, each in the first of them; none of those without images."""
        left, found = wanted.copy(), []
        for frame in frames:
            own, grey = left[frame.landmark], self.map_.images.get(frame.index)
            if grey is not None and own.any():
                found.append(Reference(build_pyramid(grey), frame.T_world_camera, frame.uv[own], frame.landmark[own]))
                left[frame.landmark] = False
        return found

    def _drift(self, found: PoseEstimate, estimate: PoseEstimate) -> float:
        """How far off a camera's pose has the landmarks of another estimate, median, px."""
        return distance_to_sights(self.map_.rig, estimate.T_world_camera, self.map_.xyz, found)

    def _most_similar(self, descriptors: Descriptors, most: int | None) -> list[int]:
        """Keyframes with an image, before the last ones, that share most words with what a lost camera shows."""
        places, words = self.index.query(self._sampled(descriptors), _ASKED)
        likely = places[words >= (self.loops.min_words if most is None else 0)].tolist()
        kept = (k for k in _apart(likely, []) if self.map_.keyframes[k].index in self.map_.images)
        return list(islice(kept, self.loops.lost_candidates if most is None else most))

    def _sampled(self, descriptors: Descriptors) -> Descriptors:
        return descriptors[:: max(1, len(descriptors) // self.loops.sample)]


def _apart(places: Sequence[int], known: Sequence[int]) -> Iterator[int]:
    """Places in their order, but for those beside an earlier or a known one: their landmarks are looked for with it."""
    taken = set(known)
    for place in places:
        if not taken & {place - 1, place, place + 1}:
            taken.add(place)
            yield place


def _distance(one: PoseEstimate, other: PoseEstimate) -> float:
    """How far two cameras are apart, m."""
    return float(np.linalg.norm((one.T_world_camera - other.T_world_camera)[:3, 3]))
