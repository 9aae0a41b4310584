"""The path of a camera: poses of all frames, each held by a keyframe."""

from __future__ import annotations

import numpy as np

from ...types import FloatArray, Trajectory
from ..se3 import inverse, normalised, repeated
from .keyframes.map import Map
from .pose import PoseEstimate

_LONGEST = 10.0  # intervals over which a motion is taken to go on


class CameraPath:
    """Poses of all frames, each held by a keyframe, and the motion that is taken to go on.

    Attributes
    ----------
    pose : (4, 4) float64
        Of the last frame.
    lost : int
        Frames lost in a row.
    was_lost : bool
        Whether the frame before the last one was.
    """

    def __init__(self) -> None:
        self.stamps: list[float] = []
        self.anchors: list[tuple[int, FloatArray]] = []  # number of the keyframe, T_keyframe_camera
        self.pose, self.motion = np.eye(4), np.eye(4)
        self.lost, self.was_lost = 0, False

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def is_motion_known(self) -> bool:
        """Whether the last frames tell how the camera moves."""
        return len(self) > 1 and self.lost == 0

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

    def advance(self, predicted: FloatArray, estimate: PoseEstimate | None) -> None:
        """Go to a frame's pose, or to the predicted one where it is lost.

        Parameters
        ----------
        predicted : (4, 4) float64
            Where a constant velocity has it.
        estimate : PoseEstimate or None
            Where it was found.
        """
        self.was_lost, self.lost = self.lost > 0, self.lost + 1 if estimate is None else 0
        pose = predicted if estimate is None else estimate.T_world_camera
        moved = predicted if self.was_lost else pose  # what was guessed says nothing of the motion since
        self.motion, self.pose = normalised(inverse(self.pose) @ moved), pose

    def record(self, stamp: float, map_: Map) -> None:
        """Note the last frame, relative to the last keyframe; frames of culled ones go to their replacements.

        Parameters
        ----------
        stamp : float
            Time of the frame, s.
        map_ : Map
            Its keyframes.
        """
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
