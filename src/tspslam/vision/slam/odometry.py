"""The path of a stereo camera: each frame is located in a map that grows with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import check_ranges
from ..._stopwatch import Stopwatch
from ...errors import GeometryError, InputError
from ...types import FloatArray, Image, Rig, StereoPair, Trajectory
from ..features.orb import OrbDetector
from ..images import Pyramid, grey_levels, pyramid, smooth_plane
from ..rig import check_pair
from ..se3 import inverse, normalised, repeated
from ..stereo.dense import checked_map, sample_map
from ..stereo.mismatch import refuse_one_picture
from ..stereo.reconstruct import Detector, Matcher, Stereo, match_stereo
from ..stereo.row_matcher import RowMatcher, level_rows, search_near
from ._state import check_state
from .bundle import Adjustment
from .loop_closing import MAX_DRIFT, detect_loop, merge_observations
from .map import Map, NewPoints
from .relocalization import binary_descriptors, relocalize
from .tracking import MIN_MATCHES, PoseEstimate, choose_pose, is_clear, refine_pose, track_pose

_LONGEST = 10.0  # intervals over which a motion is taken to go on
_KINDS = {int: "an integer", bool: "True or False"}
_JOINED = 2  # frames after a keyframe at which its adjustment counts, or at the next keyframe


@dataclass(frozen=True)
class Tracking:
    """How a camera is tracked.

    Parameters
    ----------
    window : int
        Keyframes that are adjusted together.
    keyframe_share : float
        Of the last keyframe's landmarks: fewer that are followed ask for a new keyframe.
    patience : int
        Frames lost in a row after which the map begins anew, where a steady motion has the camera.
    sigma_disparity : float
        Standard deviation of a disparity, px.
    sigma_offset : float
        Standard deviation of the calibration's disparity offset, px.
    every_frame : bool
        Whether each frame carries a cloud, a complex, signals and a response, not only keyframes.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> Tracking(window=5).keyframe_share
    0.5
    """

    window: int = 7
    keyframe_share: float = 0.5
    patience: int = 3
    sigma_disparity: float = 0.3
    sigma_offset: float = 0.3
    every_frame: bool = False

    def __post_init__(self) -> None:
        """Check the ranges."""
        for name, kind in (("window", int), ("patience", int), ("every_frame", bool)):
            if type(getattr(self, name)) is not kind:
                raise InputError(f"tracking: {name} is {repr(getattr(self, name))[:40]}, expected {_KINDS[kind]}")
        for name in ("keyframe_share", "sigma_disparity", "sigma_offset"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float | np.number):
                raise InputError(f"tracking: {name} is {repr(value)[:40]}, expected a number")
        ranges: dict[str, tuple[float, float]] = {"window": (2, 50), "keyframe_share": (0, 1), "patience": (1, 1000)}
        check_ranges("tracking", self, ranges | {"sigma_disparity": (0.01, 10), "sigma_offset": (0.001, 10)})


@dataclass(frozen=True)
class Tracked:
    """Where a frame was taken.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        Pose of the left camera; the world is the first frame's.
    covariance : (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame: of the pose against the map. Infinite where it is a guess.
    matches : int
        Landmarks that agree with it.
    is_keyframe : bool
        Whether the map rests on it.
    is_lost : bool
        Whether too few landmarks were found: the pose is that of a steady motion.
    stereo : Stereo or None
        What both images show, where that was looked for.
    seconds : dict
        Time of following, of the points of a keyframe, of looking for places seen before, and of waiting for an
        adjustment, s; varies from run to run.
    """

    T_world_camera: FloatArray
    covariance: FloatArray
    matches: int
    is_keyframe: bool
    is_lost: bool
    stereo: Stereo | None
    seconds: dict[str, float]


class Odometry:
    """Tracks a stereo camera, one pair after another.

    Windows around the landmarks of the last keyframes are followed into the left image, from where a steady motion has
    them, and the pose is the least-squares one of (u, v); then of (u, v, disparity), with disparities searched near
    where the pose has them. If that fails, landmarks are recognised by their descriptors. Where few landmarks of the
    last keyframe are left, the frame becomes a keyframe: both images are searched for new points, and the last
    keyframes and what they saw are adjusted together, with the offset that all disparities have in common: a
    calibration that is off by a fifth of a pixel makes a path 1 % too long, and the motion tells. The adjustment goes
    on while the next frame is tracked; its result counts from a fixed frame on, so that runs repeat.

    Attributes
    ----------
    rig, tracking
        As given.
    map : Map
        Keyframes and landmarks.
    loops : int
        How often the map was bent because a place was seen again.
    unsolved : int
        Adjustments that had no solution.

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

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> sequence = synthetic.SyntheticSequence(synthetic.corridor(2.0))
    >>> odometry = Odometry(sequence.rig)
    >>> tracked = [odometry.process(pair) for pair in sequence]
    >>> error = odometry.trajectory.T_world_camera[-1][:3, 3] - sequence.truth[-1][:3, 3]
    >>> bool(np.linalg.norm(error) < 0.02)
    True
    """

    def __init__(
        self,
        rig: Rig,
        *,
        detector: Detector | None = None,
        matcher: Matcher | None = None,
        tracking: Tracking | None = None,
    ) -> None:
        self.rig, self.tracking = rig, tracking or Tracking()
        self.map = Map(
            rig, window=self.tracking.window, sigma_disparity=self.tracking.sigma_disparity,
            sigma_offset=self.tracking.sigma_offset,
        )  # fmt: skip
        self._detect, self._match = detector or OrbDetector(), matcher or RowMatcher()
        self._near = search_near(self._match)
        self._stamps: list[float] = []
        self._anchors: list[tuple[int, FloatArray]] = []  # number of the keyframe, T_keyframe_camera
        self._pose, self._motion, self._wanted, self._lost, self._row_offset = np.eye(4), np.eye(4), 0, 0, 0.0
        self.unsolved = self.loops = 0
        self._watch = Stopwatch()
        self._worker = ThreadPoolExecutor(1)
        self._asked: Future[Adjustment] | None = None

    @property
    def disparity_offset(self) -> tuple[float, float]:
        """Measured less true disparity, px, and its standard deviation, as the motion tells."""
        return self.map.offset.value, self.map.offset.std

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, those of keyframes as adjusted since."""
        pose_of = {frame.index: frame.T_world_camera for frame in self.map.keyframes}
        poses = [pose_of[index] @ T for index, T in self._anchors]
        return Trajectory(np.array(self._stamps), np.array(poses).reshape(-1, 4, 4))

    def state(self) -> dict[str, NDArray[Any]]:
        """All that the next frame depends on, as arrays; `restore` takes them."""
        counts = self._wanted, self._lost, self.unsolved, self.loops, self._asked is not None
        return self.map.state() | {
            "stamps": np.array(self._stamps),
            "anchors": np.array([index for index, _ in self._anchors], np.int64),
            "anchored": np.array([T for _, T in self._anchors]).reshape(-1, 4, 4),
            "poses": np.stack([self._pose, self._motion]),
            "counts": np.array(counts, np.int64),
            "row_offset": np.array(self._row_offset),
        }

    def restore(self, state: Mapping[str, NDArray[Any]], image_of: Callable[[int], Image]) -> None:
        """Go on from a `state`; `image_of` gives the left image of a frame by its number, from 0.

        Raises
        ------
        InputError
            If it is none that this odometry can have given.
        """
        check_state(state, self.rig)
        self.map.restore(state, image_of)
        self._check_descriptors(image_of)
        self._stamps = state["stamps"].tolist()
        self._anchors = list(zip(state["anchors"].tolist(), state["anchored"], strict=True))
        self._pose, self._motion = state["poses"]
        self._wanted, self._lost, self.unsolved, self.loops, asked = state["counts"].tolist()
        self._row_offset = float(state["row_offset"])
        if asked:  # what was under way began from this very map
            self._ask()

    def _check_descriptors(self, image_of: Callable[[int], Image]) -> None:
        """Refuse landmarks whose descriptors are not as long as those of the detector's features."""
        if self.map.keyframes:
            features = self._detect(grey_levels(image_of(self.map.keyframes[-1].index)))
            expected = binary_descriptors(features.descriptor).shape[1]
            if self.map.descriptors.shape[1] != expected:
                found = self.map.descriptors.shape[1]
                raise InputError(f"odometry: the state has landmarks of {found} descriptors, expected {expected}")

    def finish(self) -> None:
        """Wait for the adjustment under way, then adjust all keyframes together: the trajectory is final."""
        self._join()
        if not self.map.keyframes:
            return
        before = self._last_pose()
        try:
            self.map.adjust_whole()
        except GeometryError:
            self.unsolved += 1
        self._follow_map(before)

    def close(self) -> None:
        """Let the worker thread go; no further pair can be processed."""
        self._worker.shutdown()

    def process(self, pair: StereoPair) -> Tracked:
        """Locate the next pair.

        Raises
        ------
        InputError
            If the pair is of another rig, its stamp is not later than the last one, or its images do not fit.
        GeometryError
            If the first pair shows too little texture for three points.
        """
        self._check(pair)
        self._watch = Stopwatch()
        image = pyramid(pair.left)
        if not self.map.keyframes:
            return self._begin(pair, image)
        if self._asked and len(self._stamps) >= self.map.keyframes[-1].index + _JOINED:
            self._join()
        self._watch.lap("wait")
        ahead = self._ahead(pair.stamp)
        estimate = self._locate(pair, image, ahead)
        self._watch.lap("follow")
        was_lost, self._lost = self._lost > 0, self._lost + 1 if estimate is None else 0
        pose = ahead if estimate is None else estimate.T_world_camera
        moved = ahead if was_lost else pose  # what was guessed says nothing of the motion since
        self._motion, self._pose = normalised(inverse(self._pose) @ moved), pose
        stereo = self._grow(pair, image, estimate) if self._wants_keyframe(estimate, was_lost) else None
        self._remember(pair.stamp)
        covariance, matches = (np.full((6, 6), np.inf), 0) if estimate is None else (estimate.covariance, len(estimate))
        is_keyframe = stereo is not None
        return Tracked(self._pose, covariance, matches, is_keyframe, estimate is None, stereo, self._watch.seconds)

    def _begin(self, pair: StereoPair, image: Pyramid) -> Tracked:
        """Make the first frame the first keyframe."""
        stereo = match_stereo(pair, self._detect, self._match)
        self._watch.lap("points")
        self._add(pair, image, None, _new_points(stereo), stereo)
        self._remember(pair.stamp)
        return Tracked(self._pose, np.zeros((6, 6)), self._wanted, True, False, stereo, self._watch.seconds)

    def _locate(self, pair: StereoPair, image: Pyramid, ahead: FloatArray) -> PoseEstimate | None:
        """Pose of a frame: from where its landmarks are followed to, or recognised; then with their disparities."""
        references, xyz = self.map.references(), self.map.xyz
        estimate = track_pose(self.rig, image, references, xyz, ahead)
        is_motion_known = len(self._stamps) > 1 and self._lost == 0
        if estimate is None or not is_clear(estimate, xyz, ahead if is_motion_known else None):
            estimate = choose_pose(estimate, self._relocalize(pair, image), xyz)
        if estimate is None:
            return None
        disparity = self._disparities(pair, image, estimate) - self.map.offset.value
        better = refine_pose(self.rig, estimate, xyz, disparity, self.map.sigma_disparity)
        return PoseEstimate(
            better.T_world_camera, better.landmark, better.uv, better.disparity + self.map.offset.value,
            better.covariance,
        )  # fmt: skip

    def _relocalize(self, pair: StereoPair, image: Pyramid) -> PoseEstimate | None:
        """Pose from descriptors alone, then from landmarks followed."""
        features = self._detect(grey_levels(pair.left))
        return relocalize(self.map, image, features.uv, binary_descriptors(features.descriptor))

    def _disparities(self, pair: StereoPair, image: Pyramid, estimate: PoseEstimate) -> FloatArray:
        """Disparities of a estimate's landmarks, near where the estimate has them."""
        if pair.disparity is not None:
            return sample_map(checked_map("disparity", pair.disparity, self.rig), estimate.uv)
        T = estimate.T_world_camera
        depth = (self.map.xyz[estimate.landmark] - T[:3, 3]) @ T[:3, 2]
        guess = self.rig.fx * self.rig.baseline / depth - self.rig.doffs + self.map.offset.value
        planes = level_rows((image.levels[0], smooth_plane(pair.right)), self._row_offset)
        return self._near(planes, estimate.uv, guess)

    def _ahead(self, stamp: float) -> FloatArray:
        """Pose at a stamp if the last motion goes on at its speed."""
        if len(self._stamps) < 2:
            return self._pose
        last = self._stamps[-1] - self._stamps[-2]
        share = (stamp - self._stamps[-1]) / last if last > 0 else 1.0
        return normalised(self._pose @ repeated(self._motion, min(share, _LONGEST)))

    def _wants_keyframe(self, estimate: PoseEstimate | None, was_lost: bool) -> bool:
        """Whether few of the last keyframe's landmarks are left, or a lost camera is found; or the map begins anew."""
        if estimate is None:
            return self._lost >= self.tracking.patience
        return was_lost or len(estimate) < self.tracking.keyframe_share * self._wanted

    def _grow(self, pair: StereoPair, image: Pyramid, estimate: PoseEstimate | None) -> Stereo | None:
        """Make a frame a keyframe, if its images show enough, and have the last ones adjusted."""
        self._join()
        self._watch.lap("wait")
        try:
            stereo = match_stereo(pair, self._detect, self._match)
        except GeometryError:
            return None
        self._watch.lap("points")
        if np.isfinite(stereo.disparity).sum() < MIN_MATCHES:
            return None
        new = _new_points(stereo)
        if estimate is not None:
            estimate = self._revisit(pair, image, estimate, new)
            self._watch.lap("loops")
        self._add(pair, image, estimate, new, stereo)
        return stereo

    def _revisit(self, pair: StereoPair, image: Pyramid, estimate: PoseEstimate, new: NewPoints) -> PoseEstimate:
        """The estimate with what is seen again of old places; where the map has drifted, a loop is closed."""
        estimate = replace(estimate, T_world_camera=self._pose)
        seen = detect_loop(self.map, image, estimate, new.uv, new.descriptors)
        if seen is None:
            return estimate
        again = replace(seen.estimate, disparity=self._disparities(pair, image, seen.estimate))
        if seen.drift > MAX_DRIFT:
            T = normalised(again.T_world_camera @ inverse(self._pose))
            self.map.distribute_loop_error(seen.place, T, self._pose)
            self._pose, self.loops = again.T_world_camera, self.loops + 1
        estimate = merge_observations(self.map, again, replace(estimate, T_world_camera=self._pose))
        self._pose = estimate.T_world_camera
        return estimate

    def _add(
        self, pair: StereoPair, image: Pyramid, estimate: PoseEstimate | None, new: NewPoints, stereo: Stereo
    ) -> None:
        images = image, np.array(grey_levels(pair.left))
        self.map.add(len(self._stamps), self._pose, images, estimate, new)
        self._hand_over()
        self._wanted = len(self.map.keyframes[-1].landmark)
        self._row_offset = stereo.quality.vertical_offset_px
        self._ask()

    def _hand_over(self) -> None:
        """Frames that were placed by keyframes which are no more go to those that took over."""
        while self.map.dropped:
            gone, replacement, T = self.map.dropped.pop(0)
            self._anchors = [
                (replacement, T @ pose) if index == gone else (index, pose) for index, pose in self._anchors
            ]

    def _ask(self) -> None:
        """Have the last keyframes adjusted."""
        work = self.map.adjustment()
        self._asked = None if work is None else self._worker.submit(work)

    def _join(self) -> None:
        """Wait for the adjustment under way, if any, and go on from where it has the last keyframe."""
        if self._asked is None:
            return
        asked, self._asked = self._asked, None
        try:
            found = asked.result()
        except GeometryError:  # what was seen does not estimate the keyframes: they stay
            self.unsolved += 1
            return
        finally:
            self.map.has_new_loop = False
        before = self._last_pose()
        self.map.apply(found)
        self._follow_map(before)

    def _last_pose(self) -> FloatArray:
        return self.map.keyframes[-1].T_world_camera

    def _follow_map(self, before: FloatArray) -> None:
        """Go on from where the last keyframe, once at `before`, is now."""
        self._pose = normalised(self._last_pose() @ inverse(before) @ self._pose)

    def _remember(self, stamp: float) -> None:
        self._stamps.append(stamp)
        self._anchors.append((self.map.keyframes[-1].index, inverse(self._last_pose()) @ self._pose))

    def _check(self, pair: StereoPair) -> None:
        if pair.rig != self.rig:
            raise InputError(f"{pair.name}: its rig is {pair.rig}, expected the odometry's {self.rig}")
        if self._stamps and not pair.stamp >= self._stamps[-1]:
            raise InputError(f"{pair.name}: its stamp is {pair.stamp} s, expected {self._stamps[-1]} s or later")
        check_pair(pair)
        refuse_one_picture(pair)


def _new_points(stereo: Stereo) -> NewPoints:
    return NewPoints(stereo.left.uv, stereo.disparity, binary_descriptors(stereo.left.descriptor))
