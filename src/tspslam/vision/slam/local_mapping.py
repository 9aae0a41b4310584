"""The map grows: keyframes are added, loops closed, the last keyframes adjusted while the next frames are tracked."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._threads import Worker
from ...errors import GeometryError
from ...types import BoolArray, FloatArray, Rig
from ..features.binary import binary_descriptors
from ..images import PreparedPair, Pyramid
from ..se3 import inverse, normalised
from ..stereo.reconstruct import Stereo
from .disparity_bias import DisparityBias
from .keyframes.keyframe import Keyframe, Keypoints
from .keyframes.map import Map
from .least_squares.bundle import Adjustment, Observations, adjust
from .loop_correction import distribute_loop_error
from .new_landmarks import follow_offset
from .places.loop_closing import PlaceRecognition
from .pose import PoseEstimate
from .tracking import spread_of


@dataclass(frozen=True)
class AdjustmentProblem:
    """Keyframes and landmarks of a map to adjust, copied, so that the map can be used meanwhile.

    Attributes
    ----------
    frames : tuple of Keyframe
        K keyframes.
    fixed : (K,) bool
        Those whose poses stay.
    rows : (P,) int64
        Landmarks.
    xyz : (P, 3) float64
        Where they are, m.
    used : (O,) int64
        Rows of all observations of the keyframes, one keyframe after another, that are of these landmarks.
    seen : Observations
        These.
    """

    frames: tuple[Keyframe, ...]
    fixed: BoolArray
    rows: NDArray[np.int64]
    xyz: FloatArray
    used: NDArray[np.int64]
    seen: Observations

    def solve(self, rig: Rig, offset: float, offset_sigma: float | None, max_steps: int) -> Adjustment:
        """Adjust the keyframes, the landmarks and the offset of the disparities.

        Parameters
        ----------
        rig : Rig
            The cameras as calibrated.
        offset, offset_sigma : float
            Offset to start from, and its standard deviation before anything is seen, px; None where it stays.
        max_steps : int
            Steps at most.

        Returns
        -------
        Adjustment

        Raises
        ------
        GeometryError
            If the observations do not fix the keyframes.
        """
        T = np.stack([frame.T_world_camera for frame in self.frames])
        return adjust(
            rig, T, self.xyz, self.seen, fixed=self.fixed, max_steps=max_steps, offset=offset, offset_sigma=offset_sigma
        )

    def inliers(self, found: Adjustment, outlier: float) -> dict[int, tuple[int, BoolArray]]:
        """Tell which observations of each keyframe stay.

        Parameters
        ----------
        found : Adjustment
            What `solve` gave.
        outlier : float
            Standard deviations beyond which an observation goes.

        Returns
        -------
        dict of int to (int, (K,) bool)
            By the number of each frame: its row in the adjustment, and which of its observations stay.
        """
        ends = np.cumsum([len(frame.landmark) for frame in self.frames])
        good = np.ones(ends[-1], np.bool_)
        good[self.used[found.distance > outlier]] = False
        parts = np.split(good, ends[:-1])
        return {frame.index: (k, part) for k, (frame, part) in enumerate(zip(self.frames, parts, strict=True))}


class LocalMapper:
    """Adds keyframes to a map and keeps it adjusted.

    After each keyframe the last ones are adjusted in a thread, together with what they saw, held by older ones, and
    with the offset that all disparities have in common; after a loop, the whole map. The result counts when it is
    joined, at frames that do not depend on how fast the thread is.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks; its rig follows the offset of the disparities.
    places : PlaceRecognition
        Finds places seen before.
    sigma_disparity : float
        Standard deviation of a disparity, where the pair does not tell it, px.
    sigma_offset : float
        Of the offset of all disparities before anything is seen, px.

    Attributes
    ----------
    bias : DisparityBias
        Offset of the disparities.
    expected : int
        Landmarks of the last keyframe when it was added.
    closures : list of (int, int)
        Loops closed: number of the frame, and that of the keyframe that it came back to.
    unsolved : int
        Adjustments that had no solution.
    """

    def __init__(self, map_: Map, places: PlaceRecognition, *, sigma_disparity: float, sigma_offset: float) -> None:
        self.map, self._places, self._rig = map_, places, map_.rig
        self.sigma_disparity, self.bias = sigma_disparity, DisparityBias(sigma_offset, map_.window)
        self.expected = self.unsolved = 0
        self.closures: list[tuple[int, int]] = []
        self._worker = Worker()
        self._asked: tuple[AdjustmentProblem, Future[Adjustment]] | None = None

    @property
    def is_adjusting(self) -> bool:
        """Whether an adjustment is under way."""
        return self._asked is not None

    def add_keyframe(
        self, index: int, images: PreparedPair, T_world_camera: FloatArray, estimate: PoseEstimate | None,
        stereo: Stereo, measure: Callable[[PoseEstimate], FloatArray],
    ) -> FloatArray:  # fmt: skip
        """Make a frame a keyframe, close a loop if it sees an old place again, and have the last ones adjusted.

        Parameters
        ----------
        index : int
            Number of the frame.
        images : PreparedPair
            What it shows.
        T_world_camera : (4, 4) float64
            Its pose.
        estimate : PoseEstimate or None
            The landmarks that it tracks; None where the map begins anew.
        stereo : Stereo
            Its keypoints with disparities.
        measure : callable
            Disparities of the landmarks of an estimate in these images, (K,) px.

        Returns
        -------
        (4, 4) float64
            Its pose, which a loop may have moved.
        """
        T, image = T_world_camera, images.left_image
        keypoints = Keypoints(stereo.left.uv, stereo.disparity, binary_descriptors(stereo.left.descriptor))

        def spread(uv: FloatArray) -> FloatArray:
            return spread_of(images, uv, self.sigma_disparity)

        if estimate is not None:
            estimate = self._close_loop(
                index, image.pyramid, replace(estimate, T_world_camera=T), keypoints, measure, spread
            )
            T = estimate.T_world_camera
        self.map.add(index, T, (image.pyramid, np.array(image.grey)), estimate, keypoints, spread)
        self.expected = len(self.map.keyframes[-1].landmark)
        self.start_adjustment()
        return T

    def _close_loop(
        self, index: int, image: Pyramid, estimate: PoseEstimate, keypoints: Keypoints,
        measure: Callable[[PoseEstimate], FloatArray], spread: Callable[[FloatArray], FloatArray],
    ) -> PoseEstimate:  # fmt: skip
        """The estimate with what is seen again of old places; where the map has drifted, the error is distributed."""
        T = estimate.T_world_camera
        loop = self._places.detect_loop(image, estimate, keypoints.uv, keypoints.descriptors)
        if loop is None:
            return estimate
        again = replace(loop.estimate, disparity=measure(loop.estimate))
        if loop.drift > self._places.loops.min_error:
            distribute_loop_error(self.map, loop.place, normalised(again.T_world_camera @ inverse(T)), T)
            T = again.T_world_camera
            self.closures.append((index, self.map.keyframes[loop.place].index))
        return self._places.merge_observations(again, replace(estimate, T_world_camera=T), spread)

    def start_adjustment(self) -> None:
        """Have the last keyframes adjusted, or all where a loop was closed."""
        map_ = self.map
        is_whole = map_.has_new_loop and len(map_.keyframes) <= map_.settings.max_keyframes
        problem = collect_problem(map_, self._sigma_uv, is_whole=is_whole)
        self._asked = None if problem is None else (problem, self._worker.submit(problem.solve, *self._given))

    @property
    def _sigma_uv(self) -> float:
        return self._places.tracking.sigma_uv

    @property
    def _given(self) -> tuple[Rig, float, float | None, int]:
        return self._rig, *self.bias.prior, self.map.settings.max_steps

    def join(self, T_world_camera: FloatArray) -> FloatArray:
        """Wait for the adjustment under way, if any, and take it over.

        Parameters
        ----------
        T_world_camera : (4, 4) float64
            The camera's pose.

        Returns
        -------
        (4, 4) float64
            The same, moved with the last keyframe.
        """
        if self._asked is None:
            return T_world_camera
        (problem, asked), self._asked = self._asked, None
        try:
            found = asked.result()
        except GeometryError:  # what was seen does not fix the keyframes: they stay
            self.unsolved += 1
            return T_world_camera
        finally:
            self.map.has_new_loop = False
        self.bias.update(found.offset, found.offset_std)
        return self._apply(problem, found, T_world_camera)

    def finish(self, T_world_camera: FloatArray) -> FloatArray:
        """Take over the adjustment under way, then adjust all keyframes but the first; maps of very many stay.

        Parameters
        ----------
        T_world_camera : (4, 4) float64
            The camera's pose.

        Returns
        -------
        (4, 4) float64
            The same, moved with the last keyframe.
        """
        T, map_ = self.join(T_world_camera), self.map
        if not 2 <= len(map_.keyframes) <= map_.settings.max_keyframes:
            return T
        problem = collect_problem(map_, self._sigma_uv, is_whole=True)
        if problem is None:
            return T
        try:
            found = problem.solve(*self._given)
        except GeometryError:
            self.unsolved += 1
            return T
        self.bias.settle(found.offset, found.offset_std)
        return self._apply(problem, found, T)

    def _apply(self, problem: AdjustmentProblem, found: Adjustment, T: FloatArray) -> FloatArray:
        """Take over an adjustment; returns the pose T, moved with the last keyframe."""
        before, rig = self.map.keyframes[-1].T_world_camera, self.map.rig
        self.map.apply(problem.rows, found, problem.inliers(found, self.map.settings.outlier))
        self.map.rig = self.bias.correct(self._rig)
        follow_offset(self.map, problem.rows, rig)
        return normalised(self.map.keyframes[-1].T_world_camera @ inverse(before) @ T)

    def restore_bias(self, state: tuple[float, float]) -> None:
        """Take over the offset of a stored state.

        Parameters
        ----------
        state : (float, float)
            As `DisparityBias.state` gave it.
        """
        self.bias.state = state
        self.map.rig = self.bias.correct(self._rig)

    def close(self) -> None:
        """Let the thread go."""
        self._worker.close()


def collect_problem(map_: Map, sigma_uv: float, *, is_whole: bool) -> AdjustmentProblem | None:
    """Collect what to adjust: the last keyframes and what they saw, held by the older ones that see it too, or all.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    is_whole : bool
        All keyframes, the first of which stays, and all landmarks.

    Returns
    -------
    AdjustmentProblem or None
        None where there is too little to adjust.
    """
    frames, rows, held = (map_.keyframes, np.arange(len(map_.xyz)), 1) if is_whole else _window(map_)
    return _problem(map_, frames, rows, held, sigma_uv) if len(frames) > 1 else None


def _window(map_: Map) -> tuple[list[Keyframe], NDArray[np.int64], int]:
    """The older keyframes that hold the last ones, then those; landmarks that these see; how many hold."""
    moving = map_.keyframes[-map_.window :]
    is_seen = np.zeros(len(map_.xyz), np.bool_)
    is_seen[np.concatenate([frame.landmark for frame in moving])] = True
    least = map_.settings.min_shared
    holding = [f for f in map_.keyframes[: -map_.window] if is_seen[f.landmark].sum() >= least] or moving[:1]
    frames = holding + [frame for frame in moving if frame is not holding[0] or len(holding) > 1]
    return frames, np.flatnonzero(is_seen), len(holding)


def _problem(
    map_: Map, frames: Sequence[Keyframe], rows: NDArray[np.int64], held: int, sigma_uv: float
) -> AdjustmentProblem | None:
    """Adjustment of frames, the first `held` of which stay, and of the landmarks that two of them see."""
    landmark = np.concatenate([frame.landmark for frame in frames])
    pose = np.repeat(np.arange(len(frames)), [len(frame.landmark) for frame in frames])
    counts = np.bincount(landmark, minlength=len(map_.xyz))
    kept = rows[counts[rows] >= 2]
    if len(kept) < map_.settings.min_points:
        return None
    point = np.full(len(map_.xyz), -1)
    point[kept] = np.arange(len(kept))
    used = np.flatnonzero(point[landmark] >= 0)
    uv = np.concatenate([frame.uv for frame in frames])[used]
    disparity, sigma = (np.concatenate([getattr(f, name) for f in frames])[used] for name in ("disparity", "sigma"))
    seen = Observations(pose[used], point[landmark[used]], uv, disparity, np.full(len(used), sigma_uv), sigma)
    return AdjustmentProblem(tuple(frames), np.arange(len(frames)) < held, kept, map_.xyz[kept], used, seen)
