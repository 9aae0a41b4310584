"""Landmarks that an adjustment did not move follow what it moved: their keyframe, and the offset of the disparities."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray, Rig
from ..rig import project
from .keyframes.keyframe import Keyframe
from .keyframes.map import Map

_LEAST_SHARE = 0.5  # of a disparity that a change of the offset may leave: what is left of less is no depth


def follow_keyframes(map_: Map, adjusted: NDArray[np.int64], before: Sequence[Keyframe], gate: float) -> None:
    """Move landmarks with the keyframe that alone saw them, where the adjustment of that one leaves them behind.

    Beyond the gate the next frame would drop them, or find one place of the world twice in the map: in small rooms
    that looked like two motions, and steps were two to four times as far off. Nearer ones stay: they hold the next
    frames to what was tracked before. With all of them moved, the paths of two recordings of KITTI came out 0.1 %
    longer.

    Parameters
    ----------
    map_ : Map
        After the adjustment; its landmarks are changed.
    adjusted : (P,) int64
        Landmarks that the adjustment moved.
    before : sequence of Keyframe
        The keyframes as they were.
    gate : float
        How far from where their keyframe had them landmarks may stay, px of (u, v, disparity).
    """
    poses = {now.index: was.T_world_camera for was, now in zip(before, map_.keyframes, strict=True) if was is not now}
    for frame, rows in _left(map_, adjusted, (frame for frame in map_.keyframes if frame.index in poses)):
        T, camera = frame.T_world_camera, _in_camera(map_.xyz[rows], poses[frame.index])
        off = np.linalg.norm(_seen(map_.rig, camera) - _seen(map_.rig, _in_camera(map_.xyz[rows], T)), axis=1)
        is_behind = ~(off <= gate)
        map_.xyz[rows[is_behind]] = camera[is_behind] @ T[:3, :3].T + T[:3, 3]


def follow_offset(map_: Map, adjusted: NDArray[np.int64], rig_before: Rig) -> None:
    """Move landmarks of the last keyframes that were not adjusted along their rays, to the offset as it is now.

    Parameters
    ----------
    map_ : Map
        After the adjustment; its landmarks are changed.
    adjusted : (P,) int64
        Landmarks that the adjustment moved.
    rig_before : Rig
        The cameras, with the offset of the disparities as it was.
    """
    more = map_.rig.doffs - rig_before.doffs
    for frame, rows in _left(map_, adjusted, map_.keyframes[-map_.window :]):
        ray = map_.xyz[rows] - frame.T_world_camera[:3, 3]
        total = rig_before.fx * rig_before.baseline / (ray @ frame.T_world_camera[:3, 2])
        with np.errstate(divide="ignore", invalid="ignore"):
            stretch = np.where(total > 0, total / np.maximum(total + more, _LEAST_SHARE * total), 1.0)
        map_.xyz[rows] = frame.T_world_camera[:3, 3] + ray * stretch[:, None]


def _left(
    map_: Map, adjusted: NDArray[np.int64], frames: Iterable[Keyframe]
) -> Iterator[tuple[Keyframe, NDArray[np.int64]]]:
    """Keyframes, the newest first, each with the landmarks that neither an adjustment moved nor a newer one saw."""
    is_left = np.ones(len(map_.xyz), np.bool_)
    is_left[adjusted] = False
    for frame in reversed(list(frames)):
        rows = frame.landmark[is_left[frame.landmark]]
        is_left[rows] = False
        yield frame, rows


def _in_camera(xyz: FloatArray, T: FloatArray) -> FloatArray:
    camera: FloatArray = (xyz - T[:3, 3]) @ T[:3, :3]
    return camera


def _seen(rig: Rig, camera: FloatArray) -> FloatArray:
    """(u, v, disparity + doffs) of points in the camera, px; NaN behind it."""
    with np.errstate(divide="ignore"):
        return np.column_stack([project(rig, camera), rig.fx * rig.baseline / camera[:, 2]])
