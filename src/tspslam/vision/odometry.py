"""The path of a stereo camera: each frame is located in a map that grows with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from ..types import FloatArray, Rig, StereoPair, Trajectory
from ._parallel import both
from .features import grey_levels
from .mapping import Map
from .matching import RowMatcher
from .orb import OrbDetector
from .reconstruct import Detector, Matcher
from .rig import check_pair
from .se3 import inverse, normalised, repeated
from .tracking import LEAST_MATCHES, Fix, Sight, locate

_KEPT = 0.7  # of the last keyframe's landmarks: fewer matches ask for a new keyframe
_LONGEST = 10.0  # intervals over which a motion is taken to go on
_APART = 8  # frames between keyframes, at most


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
    """

    T_world_camera: FloatArray
    covariance: FloatArray
    matches: int
    is_keyframe: bool
    is_lost: bool


class Odometry:
    """Tracks a stereo camera, one pair after another.

    A frame's keypoints are matched with landmarks near their predicted places, and its pose is the least-squares one
    of (u, v, disparity). Where too few landmarks of the last keyframe are left, the frame becomes a keyframe, and the
    last keyframes and what they saw are adjusted together, with the offset that all disparities have in common: a
    calibration that is off by a fifth of a pixel makes a path 1 % too long, and the motion tells.

    Parameters
    ----------
    rig : Rig
        The cameras of all pairs.
    detector : callable, optional
        Grey image -> `Features` with binary descriptors of whole 64-bit words; `OrbDetector()` by default.
    matcher : callable, optional
        Left features, right features, pair -> `Matches`; `RowMatcher()` by default.
    window : int
        Keyframes that are adjusted together.
    sigma_disparity : float
        Standard deviation of a disparity, px per unit of a keypoint's scale.
    sigma_offset : float
        Standard deviation of the calibration's disparity offset, px.

    Raises
    ------
    InputError
        If a parameter is not positive.

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
        window: int = 7,
        sigma_disparity: float = 0.3,
        sigma_offset: float = 0.3,
    ) -> None:
        if not (window >= 2 and 0 < sigma_disparity <= 100 and 0 < sigma_offset <= 100):
            raise InputError(
                f"odometry: window, sigma_disparity, sigma_offset are {window}, {sigma_disparity}, {sigma_offset}, "
                "expected 2 or more, and px, positive, at most 100"
            )
        self.rig = rig
        self.map = Map(rig, window=window, sigma_disparity=sigma_disparity, sigma_offset=sigma_offset)
        self._detect, self._match = detector or OrbDetector(), matcher or RowMatcher()
        self._stamps: list[float] = []
        self._anchors: list[tuple[int, FloatArray]] = []  # place of the keyframe, T_keyframe_camera
        self._pose, self._motion, self._wanted = np.eye(4), np.eye(4), 0

    @property
    def disparity_offset(self) -> tuple[float, float]:
        """Measured less true disparity, px, and its standard deviation, as the motion tells."""
        return self.map.offset.value, self.map.offset.std

    @property
    def trajectory(self) -> Trajectory:
        """Poses of all frames so far, those of keyframes as adjusted since."""
        poses = [self.map.keyframes[at].T_world_camera @ T for at, T in self._anchors]
        return Trajectory(np.array(self._stamps), np.array(poses).reshape(-1, 4, 4))

    def process(self, pair: StereoPair) -> Tracked:
        """Locate the next pair.

        Raises
        ------
        InputError
            If the pair is of another rig, its stamp is not later than the last one, its images do not fit, or the
            descriptors are not binary.
        GeometryError
            If the first pair shows too few points to begin with.
        """
        self._check(pair)
        sight = self._see(pair)
        if not self.map.keyframes:
            return self._begin(pair, sight)
        guess = self._ahead(pair.stamp)
        rows = self.map.local()
        near = self.map.corrected(sight)
        fix = locate(self.rig, near, self.map.chosen(rows), guess, sigma_disparity=self.map.sigma_disparity)
        pose = guess if fix is None else fix.T_world_camera
        self._motion, self._pose = normalised(inverse(self._pose) @ pose), pose
        is_keyframe = self._is_keyframe(sight, fix)
        if is_keyframe:
            self._grow(sight, fix, rows)
        self._remember(pair)
        if fix is None:
            return Tracked(self._pose, np.full((6, 6), np.inf), 0, is_keyframe, True)
        return Tracked(self._pose, fix.covariance, len(fix), is_keyframe, False)

    def _ahead(self, stamp: float) -> FloatArray:
        """Pose at a stamp if the last motion goes on at its speed."""
        if len(self._stamps) < 2:
            return self._pose
        share = (stamp - self._stamps[-1]) / (self._stamps[-1] - self._stamps[-2])
        return normalised(self._pose @ repeated(self._motion, min(share, _LONGEST)))

    def _begin(self, pair: StereoPair, sight: Sight) -> Tracked:
        """Make the first frame the first keyframe."""
        known = int(np.isfinite(sight.disparity).sum())
        if known < LEAST_MATCHES:
            raise GeometryError(f"{pair.name}: {known} points to begin with, expected at least {LEAST_MATCHES}")
        self._grow(sight, None, np.empty(0, np.int64))
        self._remember(pair)
        return Tracked(self._pose, np.zeros((6, 6)), known, True, False)

    def _grow(self, sight: Sight, fix: Fix | None, rows: NDArray[np.int64]) -> None:
        """Add a keyframe, and adjust the last ones."""
        self.map.add(len(self._stamps), sight, self._pose, fix, rows)
        self._wanted = len(self.map.keyframes[-1].landmark)
        if self.map.adjust() is not None:
            self._pose = self.map.keyframes[-1].T_world_camera

    def _is_keyframe(self, sight: Sight, fix: Fix | None) -> bool:
        """Whether the map needs this frame: few of its landmarks are left, or the last keyframe is long ago."""
        known = int(np.isfinite(sight.disparity).sum())
        if known < LEAST_MATCHES:
            return False
        age = len(self._stamps) - self.map.keyframes[-1].index
        return fix is None or len(fix) < _KEPT * self._wanted or age >= _APART

    def _remember(self, pair: StereoPair) -> None:
        self._stamps.append(pair.stamp)
        last = len(self.map.keyframes) - 1
        self._anchors.append((last, inverse(self.map.keyframes[last].T_world_camera) @ self._pose))

    def _check(self, pair: StereoPair) -> None:
        if pair.rig != self.rig:
            raise InputError(f"{pair.name}: its rig is {pair.rig}, expected the odometry's {self.rig}")
        if self._stamps and not pair.stamp > self._stamps[-1]:
            raise InputError(f"{pair.name}: its stamp is {pair.stamp} s, expected later than {self._stamps[-1]} s")
        check_pair(pair)

    def _see(self, pair: StereoPair) -> Sight:
        """Keypoints of the left image, with disparities where the right one shows them too."""
        left, right = both(lambda image: self._detect(grey_levels(image)), (pair.left, pair.right))
        disparity = np.full(len(left.uv), np.nan)
        if min(len(left.uv), len(right.uv)) >= LEAST_MATCHES:
            try:
                matches = self._match(left, right, pair)
                disparity[matches.left_index] = matches.disparity
            except GeometryError:
                pass  # nothing that both images show: bearings only
        if left.descriptor.dtype != np.uint8 or left.descriptor.shape[1] % 8:
            raise InputError(
                f"odometry: descriptors are {left.descriptor.dtype} of {left.descriptor.shape[1]}, expected uint8, a "
                "multiple of 8"
            )
        words = np.ascontiguousarray(left.descriptor).view(np.uint64)
        return Sight(left.uv, words, disparity, left.scale.astype(np.float64))
