"""The map grows: keyframes are added, loops closed, the last keyframes adjusted while the next frames are tracked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._threads import Worker
from ...types import FloatArray
from ..features.binary import binary_descriptors
from ..images import PreparedPair, Pyramid
from ..se3 import inverse, normalised
from ..stereo.reconstruct import Stereo
from .back_end.adjustment_problem import collect_problem
from .back_end.disparity_bias import DisparityBias
from .back_end.jobs import AdjustmentJob, collect_job
from .back_end.loop_correction import (
    LoopCorrection,
    LoopProblem,
    close_loop,
    correction_of,
    correction_state,
    note_loop,
    prepare,
)
from .back_end.new_landmarks import follow_offset
from .back_end.sweeping import sweep_map
from .keyframes.keyframe import Keypoints
from .keyframes.map import Map
from .keyframes.parts import join_parts
from .least_squares.bundle import Adjustment
from .locating.locator import covariance_against_keyframe
from .locating.path_covariance import Links
from .places.loop_closing import PlaceRecognition
from .pose import PoseEstimate
from .tracking import refine_pose, spread_of


class LocalMapper:
    """Adds keyframes to a map and keeps it adjusted.

    After each keyframe the last ones are adjusted in a thread, together with what they saw, held by older ones, and
    with the offset that all disparities have in common. Where a loop was found, a graph of all poses then takes out its
    error in another thread, while the map goes on; no other loop is looked for until then. With each further keyframe a
    piece of the map is adjusted beside the last keyframes, until all that has moved is settled. Results count when they
    are joined, at frames that do not depend on how fast the threads are.

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
    loops : Links
        Keyframes that saw an old place again, whether a loop was closed or not, against a keyframe there.
    joins : list of (int, int, int)
        Parts of the map that became one: number of the frame that joined them, that of the keyframe that it saw again,
        and how many of its landmarks.
    unsolved : int
        Adjustments that had no solution.
    """

    def __init__(self, map_: Map, places: PlaceRecognition, *, sigma_disparity: float, sigma_offset: float) -> None:
        self.map, self._places, self._rig = map_, places, map_.rig
        self.sigma_disparity, self.bias = sigma_disparity, DisparityBias(sigma_offset, map_.window)
        self.expected = self.unsolved = 0
        self.closures: list[tuple[int, int]] = []
        self.loops = Links.of_none()
        self.joins: list[tuple[int, int, int]] = []
        self._worker, self._closer = Worker(), Worker()
        self._asked: tuple[AdjustmentJob, Future[Adjustment | None]] | None = None
        self._closing: Future[LoopCorrection | None] | None = None
        self._is_prepared = False  # to close loops

    @property
    def is_adjusting(self) -> bool:
        """Whether an adjustment of the last keyframes is under way."""
        return self._asked is not None

    @property
    def adjustment(self) -> Future[Adjustment | None] | None:
        """The adjustment under way, for which tracking will wait; None if there is none."""
        return None if self._asked is None else self._asked[1]

    @property
    def is_correcting(self) -> bool:
        """Whether what closes a loop is under way."""
        return self._closing is not None

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
            return spread_of(images.sigma, uv, self.sigma_disparity)

        loop = None
        if estimate is not None:
            estimate = replace(estimate, T_world_camera=T)
            estimate, loop = self._find_loop(index, image.pyramid, estimate, keypoints, measure, spread)
            T = estimate.T_world_camera
        self.map.add(index, T, (image.pyramid, np.array(image.grey)), estimate, keypoints, spread)
        if loop is not None:
            note_loop(self.map, *loop, spread)
        self.expected = len(self.map.keyframes[-1].landmark)
        self.start_adjustment()
        if len(self.map.keyframes) > self.map.window and not self._is_prepared:
            self._is_prepared = True
            self._closer.submit(prepare)
        return T

    def _find_loop(
        self, index: int, image: Pyramid, estimate: PoseEstimate, keypoints: Keypoints,
        measure: Callable[[PoseEstimate], FloatArray], spread: Callable[[FloatArray], FloatArray],
    ) -> tuple[PoseEstimate, tuple[PoseEstimate, NDArray[np.int64]] | None]:  # fmt: skip
        """The estimate with what is seen again of old places; where the map has drifted, that apart."""
        if self.map.loop is not None:  # the old places are still where they were before
            return estimate, None
        loop = self._places.detect_loop(image, estimate, keypoints.uv, keypoints.descriptors)
        if loop is None:
            return estimate, None
        again, older = replace(loop.estimate, disparity=measure(loop.estimate)), self.map.keyframes[loop.place]
        self._note_loop(index, loop.place, again, spread)
        is_join = older.part != self.map.keyframes[-1].part
        if is_join:
            self.joins.append((index, older.index, len(again)))
        if loop.drift <= self._places.loops.min_error:
            if is_join:
                self.map.keyframes = join_parts(self.map.keyframes, loop.place, len(self.map.keyframes) - 1)
            return self._places.merge_observations(again, estimate, spread), None
        self.closures.append((index, older.index))
        return estimate, (again, self.map.landmark_id[again.landmark])

    def _note_loop(
        self, index: int, place: int, again: PoseEstimate, spread: Callable[[FloatArray], FloatArray]
    ) -> None:
        """Note how well a frame is known against an old keyframe whose landmarks it sees again."""
        map_, tracking = self.map, self._places.tracking
        found = refine_pose(map_.rig, again, map_.xyz, again.disparity, spread(again.uv), tracking)
        sigma = tracking.sigma_uv, spread(found.uv), self.bias.std
        self.loops = self.loops.and_one(index, *covariance_against_keyframe(map_, found, *sigma, place))

    def start_adjustment(self) -> None:
        """Have the last keyframes adjusted, and a piece of the map that a loop has moved."""
        job = self._collect(self.map)
        if job is None:
            self.start_correction()
        else:
            self._asked = job, self._worker.submit(job.solve)

    def start_correction(self) -> None:
        """Have a loop that was found closed, if there is one; the map goes on meanwhile."""
        if self.map.loop is not None and self._closing is None:
            self._closing = self._closer.submit(LoopProblem.of(self.map, self._sigma_uv).correct)

    def _collect(self, map_: Map) -> AdjustmentJob | None:
        return collect_job(map_, self._sigma_uv, self._rig, *self.bias.prior)

    @property
    def _sigma_uv(self) -> float:
        return self._places.tracking.sigma_uv

    def join_adjustment(self, T_world_camera: FloatArray) -> FloatArray:
        """Wait for the adjustment under way, if any, and take it over; then a loop that was found begins to be closed.

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
        (job, found), self._asked = self._asked, None
        before = self.map.keyframes[-1].T_world_camera
        self._take_over(job, found.result())
        self.start_correction()
        return self._moved(T_world_camera, before)

    def join(self, T_world_camera: FloatArray) -> FloatArray:
        """Wait for what is under way, if anything, and take it over, what closes a loop included.

        Parameters
        ----------
        T_world_camera : (4, 4) float64
            The camera's pose.

        Returns
        -------
        (4, 4) float64
            The same, moved with the last keyframe.
        """
        T = self.join_adjustment(T_world_camera)
        if self._closing is None:
            return T
        closing, self._closing = self._closing, None
        before = self.map.keyframes[-1].T_world_camera
        self._take_over_loop(closing.result())
        return self._moved(T, before)

    def _take_over(self, job: AdjustmentJob, found: Adjustment | None) -> None:
        """Take over an adjustment; where what was seen does not fix the keyframes, they stay."""
        if found is None:
            self.map.unsettled.difference_update(job.problem.moving)
            self.unsolved += 1
            return
        if job.offset_sigma is not None:
            self.bias.update(found.offset, found.offset_std)
        self._apply(job, found)

    def _apply(self, job: AdjustmentJob, found: Adjustment) -> None:
        """Take over poses, landmarks and the offset of the disparities."""
        map_, rig = self.map, self.map.rig
        job.apply(map_, found)
        map_.rig = self.bias.correct(self._rig)
        follow_offset(map_, np.searchsorted(map_.landmark_id, job.problem.landmark_id), rig)

    def _take_over_loop(self, found: LoopCorrection | None) -> None:
        """Close the loop, or leave the map as it is if there is no solution."""
        if found is None:
            assert self.map.loop is not None
            self.joins = [join for join in self.joins if join[0] != self.map.loop.index]
            self.map.loop = None
            self.unsolved += 1
        else:
            close_loop(self.map, found, self._places.loops.same_landmark)

    def finish(self, T_world_camera: FloatArray) -> FloatArray:
        """Take over what is under way, then adjust all keyframes but the first: at once, or piece by piece if many.

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
        if len(map_.keyframes) < 2:
            return T
        before = map_.keyframes[-1].T_world_camera
        if len(map_.keyframes) <= map_.settings.max_keyframes:
            self._adjust_all()
        else:
            self.unsolved += sweep_map(map_, self._sigma_uv, self._rig, self.bias.prior[0])
        map_.unsettled.clear()
        return self._moved(T, before)

    def _adjust_all(self) -> None:
        """Adjust all keyframes but the first, and the offset of the disparities."""
        map_, bias = self.map, self.bias
        problem = collect_problem(map_, range(1, len(map_.keyframes)), self._sigma_uv)
        if problem is None:
            return
        job = AdjustmentJob(problem, self._rig, *bias.prior, map_.settings.max_steps)
        found = job.solve()
        if found is None:
            self.unsolved += 1
            return
        bias.settle(found.offset, found.offset_std)
        self._apply(job, found)

    def _moved(self, T: FloatArray, before: FloatArray) -> FloatArray:
        """The pose T, moved with the last keyframe, which was at `before`."""
        return normalised(self.map.keyframes[-1].T_world_camera @ inverse(before) @ T)

    def state(self) -> dict[str, NDArray[Any]]:
        """Collect what was found about loops and disparities as arrays; `restore` takes them.

        Where a loop is being closed, it waits for that: the map from which that began is no more.

        Returns
        -------
        dict of str to array
            As `_state.SCHEMA` has them, such as ``closures`` (C, 2) int64.
        """
        return {
            "closures": np.array(self.closures, np.int64).reshape(-1, 2),
            "loops": np.column_stack([self.loops.frame, self.loops.against]),
            "looped": self.loops.covariance,
            "joins": np.array(self.joins, np.int64).reshape(-1, 3),
            "bias": np.array(self.bias.state),
            **correction_state(None if self._closing is None else self._closing.result()),
        }

    def restore(self, state: Mapping[str, NDArray[Any]], *, is_correcting: bool) -> None:
        """Put what a state has in the place of this.

        Parameters
        ----------
        state : dict of str to array
            As `state` gave it, such as ``closures`` (C, 2) int64.
        is_correcting : bool
            Whether a loop was being closed.
        """
        self.closures = [(frame, earlier) for frame, earlier in state["closures"].tolist()]
        self.joins = [(frame, earlier, count) for frame, earlier, count in state["joins"].tolist()]
        frame, against = state["loops"].T.copy()
        self.loops = Links(frame, against, state["looped"])
        value, information = state["bias"].tolist()
        self.bias.state = value, information
        self.map.rig = self.bias.correct(self._rig)
        if is_correcting:
            self._closing = self._closer.submit(correction_of, state)

    def close(self) -> None:
        """Let the threads go."""
        self._worker.close()
        self._closer.close()


def follow_merges(map_: Map, estimate: PoseEstimate, since: int) -> PoseEstimate:
    """Name the landmarks of an estimate as they are called now that some became one.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    estimate : PoseEstimate
        From before landmarks were merged.
    since : int
        How many had been merged by then.

    Returns
    -------
    PoseEstimate
        Of two landmarks that became one it keeps one.
    """
    now = map_.landmark_id[estimate.landmark]
    for gone, other in map_.merged[since:].tolist():
        now[now == gone] = other
    kept = np.sort(np.unique(now, return_index=True)[1])
    rows = np.searchsorted(map_.landmark_id, now[kept])
    return replace(estimate, landmark=rows, uv=estimate.uv[kept], disparity=estimate.disparity[kept])
