"""The path of a stereo camera: each frame is located in a map that grows with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._stopwatch import Stopwatch
from ...errors import GeometryError, InputError
from ...types import FloatArray, Image, Rig, StereoPair, Trajectory
from ..features.binary import binary_descriptors
from ..features.orb import OrbDetector
from ..images import PreparedPair, grey_levels, prepare
from ..stereo.reconstruct import Detector, Matcher, Stereo, match_stereo
from ..stereo.row_matcher import RowMatcher, search_near
from ._state import check_state, map_state, restore_map
from .back_end.calibration_health import settle_offset
from .foresight import Foresight
from .keyframes.map import Map
from .local_mapping import LocalMapper, follow_merges
from .locating.locator import Locator, covariance_against_keyframe
from .path import CameraPath
from .places.loop_closing import PlaceRecognition
from .pose import PoseEstimate, Tracked, distance_to_sights
from .settings import Tracking as Tracking
from .tracking import level_planes, measure_disparities, refine_pose, spread_of

_JOINED = 2  # frames after a keyframe at which its adjustment counts, or at the next keyframe
_CLOSED = 3  # frames after a loop was found at which it is closed, and a frame more for so many keyframes: the graph
_PER_FRAME = 60  # of 1 100 took 0.4 s beside the tracking; it has 21 frames: 0.6 s at 34 frames/s
_CORRECTING = 2  # in a state's counts: a loop is being closed; 1: an adjustment is under way; 3: both


class StereoOdometry:
    """Tracks a stereo camera, one pair after another.

    Patches around the landmarks of the last keyframes are tracked into the left image, from where a constant velocity
    predicts them, and the pose is the least-squares one of (u, v); then of (u, v, disparity), with disparities searched
    near where the pose has them. If that fails, the camera is relocalised by descriptors. Where few landmarks of the
    last keyframe are left, or the motion has changed by more than patches reach, the frame becomes a keyframe: both
    images are searched for new points, and the last keyframes and what they saw are adjusted together, with the offset
    that all disparities have in common: a calibration that is off by a fifth of a pixel makes a path 1 % too long, and
    the motion tells. The adjustment goes on while the next frame is tracked; its result counts from a fixed frame on,
    so that runs repeat.

    Parameters
    ----------
    rig : Rig
        The cameras of all pairs.
    detector : callable, optional
        Grey image -> `Features`; `OrbDetector()` by default.
    matcher : callable, optional
        Left features, right features, pair -> `Matches`; `RowMatcher()` by default.
    tracking : Tracking, optional
        How; the defaults serve.

    Attributes
    ----------
    rig, tracking
        As given.
    map : Map
        Keyframes and landmarks.
    mapper : LocalMapper
        What makes the map grow.
    path : CameraPath
        Poses of the frames.
    foresight : Foresight
        Whether the next frame's keypoints are likely to be needed.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> sequence = synthetic.SyntheticSequence(synthetic.corridor(2.0))
    >>> odometry = StereoOdometry(sequence.rig)
    >>> tracked = [odometry.process(pair) for pair in sequence]
    >>> error = odometry.trajectory.T_world_camera[-1][:3, 3] - sequence.truth[-1][:3, 3]
    >>> bool(np.linalg.norm(error) < 0.02)
    True
    """

    def __init__(
        self, rig: Rig, *, detector: Detector | None = None, matcher: Matcher | None = None,
        tracking: Tracking | None = None,
    ) -> None:  # fmt: skip
        self.rig, self.tracking = rig, Tracking() if tracking is None else tracking
        self._detect = OrbDetector() if detector is None else detector
        self._match = RowMatcher() if matcher is None else matcher
        self._near, self._row_offset, self._is_closed = search_near(self._match), 0.0, False
        settings = self.tracking
        self.map, self.path = Map(rig, window=settings.window, settings=settings.map), CameraPath()
        self._places = PlaceRecognition(self.map, settings.pose, settings.loops)
        self._locator = Locator(self.map, self._places, settings.pose, self._detect)
        sigmas = {"sigma_disparity": settings.sigma_disparity, "sigma_offset": settings.sigma_offset}
        self.mapper = LocalMapper(self.map, self._places, **sigmas)
        self.foresight = Foresight(settings.keyframe_share)

    def __repr__(self) -> str:
        frames, keyframes, landmarks = len(self.path), len(self.map.keyframes), len(self.map.xyz)
        return f"StereoOdometry({frames} frames, {keyframes} keyframes, {landmarks} landmarks)"

    @property
    def disparity_offset(self) -> tuple[float, float]:
        """Measured less true disparity, px, and its standard deviation, as the motion tells."""
        return self.mapper.bias.value, self.mapper.bias.std

    @property
    def loops(self) -> int:
        """How many loops were closed."""
        return len(self.mapper.closures)

    @property
    def unsolved(self) -> int:
        """How many adjustments had no solution."""
        return self.mapper.unsolved

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, those of keyframes as adjusted since."""
        return self.path.trajectory(self.map)

    def covariance_from_start(self, frame: int) -> FloatArray:
        """Find the covariance of the pose of a frame against the first frame's.

        It adds up, from keyframe to keyframe, how well each was located against the one before: errors of one step
        turn and lever all that follows. Keyframes that saw an old place again are tied to it too, by what they saw:
        with such loops it is a block of the inverse of the normal equations of all these poses. Steps and loops count
        as independent, though they share landmarks and the offset of the disparities: that makes it too small.
        Adjustments bring in more than a step's own sights; that is left out, and makes it too large.

        Parameters
        ----------
        frame : int
            Number of the frame, from 0.

        Returns
        -------
        (6, 6) float64
            Of (ω, υ), rad and m, in that camera's frame, as `trajectory` has it. Infinite where the path was guessed on
            the way, as after the map began anew.

        Raises
        ------
        InputError
            If there is no such frame.

        Examples
        --------
        >>> from tspslam.datasets import synthetic
        >>> sequence = synthetic.SyntheticSequence(synthetic.corridor(2.0))
        >>> odometry = StereoOdometry(sequence.rig)
        >>> tracked = [odometry.process(pair) for pair in sequence]
        >>> metres = np.sqrt(np.diag(odometry.covariance_from_start(4))[3:])
        >>> bool((metres > 0).all() and (metres < 0.1).all())
        True
        """
        if not (isinstance(frame, int | np.integer) and 0 <= frame < len(self.path)):
            raise InputError(f"odometry: frame is {frame!r}, expected one of 0 to {len(self.path) - 1}")
        return self.path.covariance_from_start(int(frame), self.trajectory.T_world_camera, self.mapper.loops)

    def begin(self) -> None:
        """Begin a further recording with the next pair: it may be anywhere in the map, or in none of it.

        Its first frame is looked up in the whole map, and becomes a keyframe. Where it is found, the path goes on
        there. Else a new part of the map begins, whose origin it is, until a loop leads back to an earlier part.
        """
        if len(self.path):
            self._follow(self.mapper.join)
            self.path.begin(is_instead=self.is_beginning)

    @property
    def is_beginning(self) -> bool:
        """Whether a recording has begun that has no keyframe yet."""
        return bool(self.path.begun) and self.map.keyframes[-1].index < self.path.begun[-1]

    def process(self, pair: StereoPair) -> Tracked:
        """Locate the next pair, and make it a keyframe where the map needs one.

        Parameters
        ----------
        pair : StereoPair
            Of this rig, not earlier than the last one.

        Returns
        -------
        Tracked

        Raises
        ------
        InputError
            If the pair is of another rig, earlier than the last one, or its images do not fit.
        GeometryError
            If left and right are the same picture, or the first pair shows too little texture for three points.
        """
        self._check(pair.name, pair.rig, pair.stamp)
        images, watch, path = prepare(pair), Stopwatch(), self.path
        estimate, stereo, is_origin, predicted = None, None, False, None
        if self.map.keyframes:
            if len(path) - self.map.keyframes[-1].index >= _JOINED:
                self._take_over()
            watch.lap("wait")
            predicted = path.predict(images.stamp)
            estimate = self._locate(images, predicted)
            path.advance(predicted, estimate, estimate is None and self._locator.is_dark(images.left_image))
        is_wanted, count = self._wants_keyframe(images, estimate, predicted), 0 if estimate is None else len(estimate)
        if not is_wanted:
            self.foresight.note(count, self.mapper.expected, is_keyframe=False)
        link = self._link(images, estimate)
        watch.lap("follow")
        if is_wanted:
            estimate = self._join(estimate)
            watch.lap("wait")
            is_first = self.is_beginning or not self.map.keyframes
            stereo = self._add_keyframe(images, estimate, watch)
            if is_origin := is_first and stereo is not None:
                path.start()
                self.mapper.joins += [] if estimate is None else [(len(path), link[0], len(estimate))]
            self.foresight.note(count, self.mapper.expected, is_keyframe=stereo is not None)
        path.record(images.stamp, self.map, link)
        return self._tracked(estimate, stereo, watch, is_origin=is_origin)

    def _check(self, name: str, rig: Rig, stamp: float) -> None:
        if self._is_closed:
            raise InputError(f"{name}: the odometry is closed, expected an open one")
        if rig != self.rig:
            raise InputError(f"{name}: its rig is {rig}, expected the odometry's {self.rig}")
        if len(self.path) and not stamp >= self.path.stamps[-1]:
            raise InputError(f"{name}: its stamp is {stamp} s, expected {self.path.stamps[-1]} s or later")

    def _locate(self, images: PreparedPair, predicted: FloatArray) -> PoseEstimate | None:
        """Pose of the left image, refined by disparities, with its covariance against a keyframe."""
        map_, settings, path = self.map, self.tracking.pose, self.path
        is_steady = path.is_motion_known and not path.is_gap(images.stamp)
        if self.is_beginning:
            estimate = self._locator.look_up(images.left_image)
        elif is_steady:
            estimate = self._locator.follow(images.left_image, predicted, is_doubted=path.is_doubted)
        else:
            last = path.last_found(map_)
            estimate = self._locator.find(images.left_image, [predicted, last, last @ path.motion])
        if estimate is None:
            return None
        spread = spread_of(images.sigma, estimate.uv, self.tracking.sigma_disparity)
        return refine_pose(map_.rig, estimate, map_.xyz, self._measure(images, estimate), spread, settings)

    def fill(self, images: PreparedPair) -> None:
        """Make ready what the next frame needs of its images, in any thread, while the last one is tracked.

        Parameters
        ----------
        images : PreparedPair
            What it shows.
        """
        images.fill()
        if images.disparity is None:
            level_planes(images, self._row_offset)

    def detect(self, images: PreparedPair) -> None:
        """Make ready what a keyframe needs of its images besides, in any thread.

        Parameters
        ----------
        images : PreparedPair
            What it shows.
        """
        images.detect(self._detect)

    def _measure(self, images: PreparedPair, estimate: PoseEstimate) -> FloatArray:
        """Disparities of the landmarks of an estimate."""
        return measure_disparities(self.map.rig, images, estimate, self.map.xyz, self._near, self._row_offset)

    def _link(self, images: PreparedPair, estimate: PoseEstimate | None) -> tuple[int, FloatArray]:
        """Which keyframe a frame was located against, and the covariance of its pose against it; none of the first."""
        if not self.map.keyframes:
            return 0, np.zeros((6, 6))
        if estimate is None:
            return self.map.keyframes[-1].index, np.full((6, 6), np.inf)
        settings, bias = self.tracking, self.mapper.bias
        spread = spread_of(images.sigma, estimate.uv, settings.sigma_disparity)
        against, covariance = covariance_against_keyframe(self.map, estimate, settings.pose.sigma_uv, spread, bias.std)
        if estimate.rival is None:
            covariance = covariance + self.path.doubt_since(against)
        return against, covariance

    def _wants_keyframe(
        self, images: PreparedPair, estimate: PoseEstimate | None, predicted: FloatArray | None
    ) -> bool:
        """Whether few landmarks are left, or fewer and far from where they were expected, or the map begins anew."""
        if estimate is None or predicted is None:
            return not self.map.keyframes or self.is_beginning or self.path.unplaced >= self.tracking.patience
        count, expected, least = len(estimate), self.mapper.expected, self.tracking.keyframe_share
        if self.path.was_lost or self.is_beginning or count < least * expected:
            return True
        is_some_fewer = count < (1 + least) / 2 * expected
        return is_some_fewer and self.path.is_motion_known and self._is_out_of_reach(images, estimate, predicted)

    def _is_out_of_reach(self, images: PreparedPair, estimate: PoseEstimate, predicted: FloatArray) -> bool:
        """Whether patches hardly reach most landmarks from where the motion led: the next frame's may be farther."""
        reach = self.tracking.pose.reach(images.left_image.pyramid)
        return distance_to_sights(self.map.rig, predicted, self.map.xyz, estimate) > reach

    def _take_over(self) -> None:
        """Take over the adjustment under way, if any, and what closes a loop, if it is time."""
        if self.mapper.is_adjusting:
            self._follow(self.mapper.join_adjustment)
        if self.mapper.is_correcting and self._is_time_to_close():
            self._follow(self.mapper.join)

    def _is_time_to_close(self) -> bool:
        """Whether a loop is closed now: the later, the more keyframes there are."""
        loop, keyframes = self.map.loop, len(self.map.keyframes)
        return loop is not None and len(self.path) - loop.index >= _CLOSED + keyframes // _PER_FRAME

    def _join(self, estimate: PoseEstimate | None) -> PoseEstimate | None:
        """Take over what is due; the estimate, with landmarks that became one as they are called now."""
        since = len(self.map.merged)
        self._take_over()
        return None if estimate is None else follow_merges(self.map, estimate, since)

    def _follow(self, adjust: Callable[[FloatArray], FloatArray]) -> None:
        """Move the path with the keyframes that an adjustment moves."""
        before = list(self.map.keyframes)
        self.path.pose = adjust(self.path.pose)
        self.path.follow(before, self.map)

    def _add_keyframe(self, images: PreparedPair, estimate: PoseEstimate | None, watch: Stopwatch) -> Stereo | None:
        """Make a frame a keyframe, if its images show enough; the first one must."""
        try:
            stereo = match_stereo(images, self._detect, self._match)
        except GeometryError:
            if not self.map.keyframes:
                raise
            return None
        finally:
            watch.lap("points")
        if self.map.keyframes and np.isfinite(stereo.disparity).sum() < self.tracking.pose.min_matches:
            return None
        T = np.eye(4) if self.is_beginning and estimate is None else self.path.pose
        measure = partial(self._measure, images)
        self.path.pose = self.mapper.add_keyframe(len(self.path), images, T, estimate, stereo, measure)
        self._row_offset = stereo.quality.vertical_offset_px
        watch.lap("map")
        return stereo

    def _tracked(
        self, estimate: PoseEstimate | None, stereo: Stereo | None, watch: Stopwatch, *, is_origin: bool
    ) -> Tracked:
        """What is said of the last frame, which may be the first keyframe of its recording."""
        seen = self.map.keyframes[-1] if stereo is not None else estimate
        return Tracked(
            T_world_camera=self.path.pose.copy(),
            covariance=self.path.covariance,
            matches=len(estimate) if estimate is not None else self.mapper.expected if is_origin else 0,
            is_keyframe=stereo is not None,
            is_lost=estimate is None and not is_origin,
            stereo=stereo,
            seconds=watch.seconds,
            landmark=np.empty(0, np.int64) if seen is None else self.map.landmark_id[seen.landmark],
            uv=np.empty((0, 2)) if seen is None else seen.uv.copy(),
            disparity=np.empty(0) if seen is None else seen.disparity.copy(),
        )

    def finish(self) -> None:
        """Wait for the adjustment under way, then adjust all keyframes together: the trajectory is final."""
        if self.map.keyframes:
            self.adjust()
            self.settle()

    def adjust(self) -> None:
        """Adjust all keyframes together, of which there must be one; the path goes with them."""
        self._follow(self.mapper.finish)

    def settle(self) -> None:
        """Judge the offset of the disparities; where one does not explain what was seen, adjust once more, without."""
        if not settle_offset(self.mapper.bias, self.map, self.rig, self.tracking.pose.sigma_uv):
            self.adjust()

    def close(self) -> None:
        """Release the threads beside this one; no further pair can be processed."""
        self._is_closed = True
        self.mapper.close()
        self.map.images.close()

    def state(self) -> dict[str, NDArray[Any]]:
        """Collect all that the next frame depends on, as arrays of its own: the map goes on. `restore` takes them.

        Returns
        -------
        dict of str to array
            As `_state.SCHEMA` has them, such as ``xyz`` (M, 3) float64.
        """
        path, mapper = self.path, self.mapper
        under_way = mapper.is_adjusting + _CORRECTING * mapper.is_correcting
        counts = mapper.expected, path.lost, mapper.unsolved, under_way, path.unplaced
        own = {"counts": np.array(counts, np.int64), "row_offset": np.array(self._row_offset)}
        state = map_state(self.map) | path.state() | mapper.state() | own  # the map goes on: what is its own is copied
        return {name: values if values.flags.owndata else values.copy() for name, values in state.items()}

    def restore(self, state: Mapping[str, NDArray[Any]], image_of: Callable[[int], Image]) -> None:
        """Go on from a state.

        Parameters
        ----------
        state : dict of str to array
            As `state` gave it, such as ``xyz`` (M, 3) float64.
        image_of : callable
            Left image of a frame by its number, from 0.

        Raises
        ------
        InputError
            If it is none that this odometry can have given.
        """
        check_state(state, self.rig)
        state = {name: values.copy() for name, values in state.items()}
        restore_map(self.map, state, image_of)
        self._check_descriptors(image_of)
        path, mapper = self.path, self.mapper
        path.restore(state)
        mapper.expected, path.lost, mapper.unsolved, under_way, path.unplaced = state["counts"].tolist()
        mapper.restore(state, is_correcting=under_way >= _CORRECTING)
        self._row_offset = float(state["row_offset"])
        if under_way % _CORRECTING:  # it began from this very map
            mapper.start_adjustment()

    def _check_descriptors(self, image_of: Callable[[int], Image]) -> None:
        """Refuse landmarks whose descriptors are not as long as those of the detector's features."""
        if self.map.keyframes:
            features = self._detect(grey_levels(image_of(self.map.keyframes[-1].index)))
            expected, found = binary_descriptors(features.descriptor).shape[1], self.map.descriptors.shape[1]
            if found != expected:
                raise InputError(f"odometry: the state has descriptors of {found} x 64 bits, expected {expected}")
