"""Landmarks that an adjustment did not move follow what it moved: their keyframe, and the offset of the disparities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ....types import Rig
from ...se3 import inverse
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..pose import expected_sights

_LEAST_SHARE = 0.5  # of a disparity that a change of the offset may leave: what is left of less is no depth


def follow_keyframes(map_: Map, adjusted: NDArray[np.int64], before: Sequence[Keyframe], most: float) -> None:
    """Move landmarks with the keyframe that alone saw them, where the adjustment of that one leaves them behind.

    The next frame would drop them, or find one place of the world twice in the map: in small rooms that looked like
    two motions. Rooms' steps are off by 40 % of what they were; with all landmarks moved by 15 %, but then the paths of
    two recordings of KITTI are 0.1 % longer: those that stay hold the next frames to what was tracked before.

    Parameters
    ----------
    map_ : Map
        After the adjustment; its landmarks are changed.
    adjusted : (P,) int64
        Landmarks that the adjustment moved.
    before : sequence of Keyframe
        The keyframes as they were.
    most : float
        How far from where their keyframe had them landmarks may stay, px of (u, v, disparity).
    """
    both = zip(before, map_.keyframes, strict=True)
    was = {now.index: old.T_world_camera for old, now in both if old.T_world_camera is not now.T_world_camera}
    for frame, rows in _not_adjusted(map_, adjusted, [frame for frame in map_.keyframes if frame.index in was]):
        rows = rows[map_.sightings.count(rows) == 1]
        seen, left = (expected_sights(map_.rig, T, map_.xyz[rows]) for T in (was[frame.index], frame.T_world_camera))
        behind = rows[~(np.linalg.norm(seen - left, axis=1) <= most)]
        T = frame.T_world_camera @ inverse(was[frame.index])
        map_.xyz[behind] = map_.xyz[behind] @ T[:3, :3].T + T[:3, 3]


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
    for frame, rows in _not_adjusted(map_, adjusted, map_.keyframes[-map_.window :]):
        ray = map_.xyz[rows] - frame.T_world_camera[:3, 3]
        total = rig_before.fx * rig_before.baseline / (ray @ frame.T_world_camera[:3, 2])
        with np.errstate(divide="ignore", invalid="ignore"):
            stretch = np.where(total > 0, total / np.maximum(total + more, _LEAST_SHARE * total), 1.0)
        map_.xyz[rows] = frame.T_world_camera[:3, 3] + ray * stretch[:, None]


def _not_adjusted(
    map_: Map, adjusted: NDArray[np.int64], frames: Sequence[Keyframe]
) -> Iterator[tuple[Keyframe, NDArray[np.int64]]]:
    """Keyframes, the newest first, each with the landmarks that neither an adjustment moved nor a newer one saw."""
    is_left = np.ones(len(map_.xyz), np.bool_)
    is_left[adjusted] = False
    for frame in reversed(frames):
        rows = frame.landmark[is_left[frame.landmark]]
        is_left[rows] = False
        yield frame, rows
