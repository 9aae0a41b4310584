"""The path of a camera: poses of all frames, each held by a keyframe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray, Trajectory
from ..se3 import inverse, normalised, repeated
from .keyframes.columns import Column
from .keyframes.keyframe import Keyframe
from .keyframes.map import Map
from .locating.path_covariance import Links, covariance_from_start
from .locating.uncertainty import rival_spread
from .pose import PoseEstimate

_COLUMNS = "stamps", "anchors", "anchored", "links", "linked"  # a row a frame
_LONGEST = 10.0  # intervals over which a motion is taken to go on
_LAST = 5  # intervals that tell what the next one is
_GAP = 1.5  # times their median, from which an interval is a gap: one frame left out makes 2


class CameraPath:
    """Poses of all frames, each held by a keyframe, and the motion that is taken to go on.

    A frame takes some 1000 bytes.

    Attributes
    ----------
    pose : (4, 4) float64
        Of the last frame.
    lost : int
        Frames lost in a row.
    unplaced : int
        The same without those that showed nothing.
    was_lost : bool
        Whether the frame before the last one was.
    doubted : list of (int, int, int)
        Frames that another motion explains about as well: their numbers, the landmarks that agree with the pose, and
        those that agree with the other.
    begun : list of int
        Numbers of the first keyframes of further recordings: what was seen before says nothing of their motion. While
        the last one has none, that of its first frame.
    """

    def __init__(self) -> None:
        self._stamps = Column(np.empty(0))
        self._anchors, self._anchored = Column(np.empty(0, np.int64)), Column(np.empty((0, 4, 4)))
        self._held: dict[int, list[int]] = {}  # frames by the number of the keyframe that holds them
        self._links, self._linked = Column(np.empty(0, np.int64)), Column(np.empty((0, 6, 6)))
        self.pose, self.motion = np.eye(4), np.eye(4)
        self.lost, self.unplaced, self.was_lost = 0, 0, False
        self.begun: list[int] = []
        self.doubted: list[tuple[int, int, int]] = []
        self._doubt = np.zeros((6, 6))

    @property
    def stamps(self) -> FloatArray:
        """When the frames were taken, (T,) float64, s."""
        return self._stamps.rows

    @property
    def anchors(self) -> NDArray[np.int64]:
        """Numbers of the keyframes that hold the frames, (T,) int64."""
        return self._anchors.rows

    @property
    def anchored(self) -> FloatArray:
        """Poses of the frames in these, ``T_keyframe_camera``, (T, 4, 4) float64."""
        return self._anchored.rows

    @property
    def links(self) -> NDArray[np.int64]:
        """Numbers of the keyframes that the frames were located against, (T,) int64."""
        return self._links.rows

    @property
    def linked(self) -> FloatArray:
        """Covariances of the frames' poses against these, (T, 6, 6) float64; NaN where they were guessed."""
        return self._linked.rows

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the last frame's pose against its keyframe, (6, 6) float64; infinite where it was guessed."""
        last = self.linked[-1]
        return np.where(np.isnan(last), np.inf, last)

    def state(self) -> dict[str, NDArray[Any]]:
        """Collect the frames so far as arrays; `restore` takes them.

        Returns
        -------
        dict of str to array
            As `_state.SCHEMA` has them, such as ``stamps`` (T,) float64.
        """
        columns = {name: getattr(self, name) for name in _COLUMNS}
        own = {
            "poses": np.stack([self.pose, self.motion]),
            "begun": np.array(self.begun, np.int64),
            "doubted": np.array(self.doubted, np.int64).reshape(-1, 3),
            "doubt": self._doubt,
        }
        return columns | own

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Put the frames of a state in the place of these.

        Parameters
        ----------
        state : dict of str to array
            As `state` gave it, such as ``stamps`` (T,) float64.
        """
        for name in _COLUMNS:
            setattr(self, f"_{name}", Column(state[name]))
        self.pose, self.motion = state["poses"]
        self.begun = state["begun"].tolist()
        self.doubted = [(frame, agree, other) for frame, agree, other in state["doubted"].tolist()]
        self._doubt = state["doubt"]
        self._held = {}
        for frame, keyframe in enumerate(state["anchors"].tolist()):
            self._held.setdefault(keyframe, []).append(frame)

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def is_motion_known(self) -> bool:
        """Whether the last frames tell how the camera moves."""
        return len(self) - self._first > 1 and self.lost == 0

    @property
    def is_doubted(self) -> bool:
        """Whether another motion explains the last frame about as well."""
        return bool(self.doubted) and self.doubted[-1][0] == len(self) - 1

    def doubt_since(self, frame: int) -> FloatArray:
        """Tell what the last doubted frame adds to covariances against frames before it.

        That frame's motion may have been the other one, which then goes on: after n more frames the pose is off by
        n + 1 times what it was off by then.

        Parameters
        ----------
        frame : int
            Number of the frame that the next one is located against.

        Returns
        -------
        (6, 6) float64
            Of (ω, υ), rad and m, in the camera's frame, which has hardly turned since; 0 where there was no doubt.
        """
        last = self.doubted[-1][0] if self.doubted else 0
        return (len(self) - last + 1) ** 2 * self._doubt if frame < last < len(self) else np.zeros((6, 6))

    @property
    def _first(self) -> int:
        """Number of the first frame of the recording."""
        return self.begun[-1] if self.begun else 0

    def begin(self, *, is_instead: bool) -> None:
        """Begin a further recording with the next frame.

        Parameters
        ----------
        is_instead : bool
            Whether it takes the place of the last one, which never had a keyframe.
        """
        self.begun = [*self.begun[: len(self.begun) - is_instead], len(self)]
        self.motion = np.eye(4)
        self.lost, self.unplaced, self.was_lost = 0, 0, False

    def is_gap(self, stamp: float) -> bool:
        """Whether a frame comes so late that its motion may be another one than the last.

        Parameters
        ----------
        stamp : float
            Its time, s.

        Returns
        -------
        bool
        """
        last = self.stamps[max(self._first, len(self) - _LAST - 1) :].tolist()
        usual = [after - before for before, after in pairwise(last)]
        return bool(usual) and stamp - last[-1] > _GAP * median(usual)

    def predict(self, stamp: float) -> FloatArray:
        """Find the pose at a stamp if the last motion goes on at its speed.

        Parameters
        ----------
        stamp : float
            Time, s.

        Returns
        -------
        (4, 4) float64
        """
        if len(self) - self._first < 2:
            return self.pose
        before, last = self.stamps[-2:].tolist()
        share = (stamp - last) / (last - before) if last > before else 1.0
        return normalised(self.pose @ repeated(self.motion, min(share, _LONGEST)))

    def last_found(self, map_: Map) -> FloatArray:
        """Tell where the camera was when it was last found.

        Parameters
        ----------
        map_ : Map
            Its keyframes.

        Returns
        -------
        (4, 4) float64
        """
        row = max(self._first, len(self) - 1 - self.lost)
        holder = next(frame for frame in reversed(map_.keyframes) if frame.index == self.anchors[row])
        pose: FloatArray = holder.T_world_camera @ self.anchored[row]
        return pose

    def advance(self, predicted: FloatArray, estimate: PoseEstimate | None, is_dark: bool = False) -> None:
        """Go to a frame's pose, or to the predicted one where it is lost.

        Parameters
        ----------
        predicted : (4, 4) float64
            Where a constant velocity has it.
        estimate : PoseEstimate or None
            Where it was found.
        is_dark : bool
            Whether the frame shows nothing.
        """
        self.unplaced = 0 if estimate is not None else self.unplaced + (not is_dark)
        self.was_lost, self.lost = self.lost > 0, self.lost + 1 if estimate is None else 0
        pose = predicted if estimate is None else estimate.T_world_camera
        if estimate is not None and estimate.rival is not None:
            self.doubted.append((len(self), len(estimate), estimate.rival.landmarks))
            self._doubt = rival_spread(estimate.T_world_camera, estimate.rival)
        moved = predicted if self.was_lost else pose  # what was guessed says nothing of the motion since
        is_first = len(self) == self._first
        self.motion, self.pose = np.eye(4) if is_first else normalised(inverse(self.pose) @ moved), pose

    def start(self) -> None:
        """Take the frame that is noted next for the first keyframe of its recording: nothing is lost before it."""
        self.lost, self.unplaced, self.was_lost = 0, 0, False
        if self.begun:
            self.begun[-1] = len(self)

    def record(self, stamp: float, map_: Map, link: tuple[int, FloatArray]) -> None:
        """Note the last frame, relative to the last keyframe; frames of culled ones go to their replacements.

        Parameters
        ----------
        stamp : float
            Time of the frame, s.
        map_ : Map
            Its keyframes.
        link : (int, (6, 6) float64)
            Number of the keyframe that it was located against, and the covariance of its pose against it.
        """
        self._links.extend([link[0]])
        self._linked.extend([np.where(np.isfinite(link[1]), link[1], np.nan)])
        for gone, other, T in map_.dropped:
            held = self._held.pop(gone, [])
            self._held.setdefault(other, []).extend(held)
            self.anchors[held] = other
            for frame in held:
                self.anchored[frame] = T @ self.anchored[frame]
        map_.dropped.clear()
        last = map_.keyframes[-1]
        self._held.setdefault(last.index, []).append(len(self))
        self._stamps.extend([stamp])
        self._anchors.extend([last.index])
        self._anchored.extend([inverse(last.T_world_camera) @ self.pose])

    def follow(self, before: Sequence[Keyframe], map_: Map) -> None:
        """Let frames between two keyframes take their share of how far these moved against each other.

        A frame is held by the keyframe before it. Without this, the step into the next one would take all that an
        adjustment moved that: 0.03 m in the median of KITTI 05, where other steps are wrong by 0.01.

        Parameters
        ----------
        before : sequence of Keyframe
            The keyframes as they were.
        map_ : Map
            The same keyframes, adjusted.
        """
        now = map_.keyframes
        steps = [k for k in range(len(now) - 1) if not (before[k] is now[k] and before[k + 1] is now[k + 1])]
        ends = np.array([(now[k].index, now[k + 1].index) for k in steps]).reshape(-1, 2)
        between = [(frame, n) for n, (first, last) in enumerate(ends.tolist()) for frame in self._between(first, last)]
        if not between:
            return
        frame, n = np.array(between).T
        start, end = self.stamps[ends[n]].T
        share = (self.stamps[frame] - start) / np.where(end > start, end - start, np.inf)
        was, came = (_steps(one, steps) for one in (before, now))
        self.anchored[frame] = normalised(repeated((came @ inverse(was))[n], share) @ self.anchored[frame])

    def _between(self, first: int, last: int) -> list[int]:
        """Frames between two keyframes of one recording, held by the first."""
        if any(first < begun <= last for begun in self.begun):
            return []
        return [frame for frame in self._held.get(first, []) if first < frame < last]

    def trajectory(self, map_: Map) -> Trajectory:
        """Put the frames where their keyframes are now.

        Parameters
        ----------
        map_ : Map
            Its keyframes.

        Returns
        -------
        Trajectory
        """
        keyframes = np.array([frame.index for frame in map_.keyframes], np.int64)
        poses = np.array([frame.T_world_camera for frame in map_.keyframes]).reshape(-1, 4, 4)
        return Trajectory(self.stamps.copy(), poses[np.searchsorted(keyframes, self.anchors)] @ self.anchored)

    def origins(self, map_: Map) -> NDArray[np.int64]:
        """Find the frame whose camera is the origin that each frame's pose is known in.

        That is the first one of its recording, or of the earlier one that a part of the map joins it to. What was
        tracked after a loss goes with what was before: where it stands to that is a guess, but one of the same path.

        Parameters
        ----------
        map_ : Map
            Its keyframes.

        Returns
        -------
        (T,) int64
            Numbers of frames; -1 while the last recording has no keyframe.
        """
        part_of = {frame.index: frame.part for frame in map_.keyframes}
        parts = np.array([part_of[anchor] for anchor in self.anchors.tolist()], np.int64)
        origin_of: dict[int, int] = {}
        for first, end in pairwise([0, *self.begun, len(self)]):
            before = None
            for part in dict.fromkeys(parts[first:end].tolist()):
                origin_of.setdefault(part, first if before is None else origin_of[before])
                before = part
        found = np.array([origin_of[part] for part in parts.tolist()], np.int64)
        if self.begun and map_.keyframes[-1].index < self.begun[-1]:
            found[self.begun[-1] :] = -1
        return found

    def covariance_from_start(self, frame: int, poses: FloatArray, loops: Links) -> FloatArray:
        """Find the covariance of a frame's pose against the first one, by the steps to it and by loops.

        Parameters
        ----------
        frame : int
            Number of the frame.
        poses : (T, 4, 4) float64
            Of all frames.
        loops : Links
            Frames that saw an old place again, against keyframes there.

        Returns
        -------
        (6, 6) float64
            Of (ω, υ), rad and m, in the camera's frame.
        """
        return covariance_from_start(frame, poses, Links(np.arange(len(self)), self.links, self.linked), loops)


def _steps(frames: Sequence[Keyframe], places: Sequence[int]) -> FloatArray:
    """Poses of the keyframes after some, each as the one before has it."""
    T, T_next = (np.stack([frames[k + more].T_world_camera for k in places]) for more in (0, 1))
    steps: FloatArray = inverse(T) @ T_next
    return steps
