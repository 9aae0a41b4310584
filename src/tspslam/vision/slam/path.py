"""The path of a camera: poses of all frames, each held by a keyframe."""

from __future__ import annotations

import numpy as np

from ...types import FloatArray, Trajectory
from ..se3 import inverse, normalised, repeated
from .keyframes.map import Map
from .pose import PoseEstimate
from .uncertainty import adjoint

_LONGEST = 10.0  # intervals over which a motion is taken to go on
_LAST = 5  # intervals that tell what the next one is
_GAP = 1.5  # times their median, from which an interval is a gap: one frame left out makes 2


class CameraPath:
    """Poses of all frames, each held by a keyframe, and the motion that is taken to go on.

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
    """

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.anchors: list[tuple[int, FloatArray]] = []  # number of the keyframe, T_keyframe_camera
        self.links: list[tuple[int, FloatArray]] = []  # frame that it was located against, covariance against it
        self.pose, self.motion = np.eye(4), np.eye(4)
        self.lost, self.unplaced, self.was_lost = 0, 0, False

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def is_motion_known(self) -> bool:
        """Whether the last frames tell how the camera moves."""
        return len(self) > 1 and self.lost == 0

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
        usual = np.diff(self.stamps[-_LAST - 1 :])
        return bool(len(usual) and stamp - self.stamps[-1] > _GAP * np.median(usual))

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
        if len(self) < 2:
            return self.pose
        last = self.stamps[-1] - self.stamps[-2]
        share = (stamp - self.stamps[-1]) / last if last > 0 else 1.0
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
        index, T = self.anchors[max(0, len(self) - 1 - self.lost)]
        pose: FloatArray = next(frame.T_world_camera for frame in reversed(map_.keyframes) if frame.index == index) @ T
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
        moved = predicted if self.was_lost else pose  # what was guessed says nothing of the motion since
        self.motion, self.pose = normalised(inverse(self.pose) @ moved), pose

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
        self.links.append(link)
        for gone, other, T in map_.dropped:
            self.anchors = [(other, T @ pose) if index == gone else (index, pose) for index, pose in self.anchors]
        map_.dropped.clear()
        last = map_.keyframes[-1]
        self.stamps.append(stamp)
        self.anchors.append((last.index, inverse(last.T_world_camera) @ self.pose))

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
        pose_of = {frame.index: frame.T_world_camera for frame in map_.keyframes}
        poses = [pose_of[index] @ T for index, T in self.anchors]
        return Trajectory(np.array(self.stamps), np.array(poses).reshape(-1, 4, 4))

    def covariance_from_start(self, frame: int, poses: FloatArray) -> FloatArray:
        """Find the covariance of a frame's pose against the first one: its own and those of the keyframes before it.

        Parameters
        ----------
        frame : int
            Number of the frame.
        poses : (T, 4, 4) float64
            Of all frames.

        Returns
        -------
        (6, 6) float64
            Of (ω, υ), rad and m, in the camera's frame.
        """
        T_camera_world, total = inverse(poses[frame]), np.zeros((6, 6))
        while frame > 0:
            earlier, covariance = self.links[frame]
            if not np.isfinite(covariance).all():
                return np.full((6, 6), np.inf)
            across = adjoint(T_camera_world @ poses[frame])
            total += across @ covariance @ across.T
            frame = earlier
        return total
