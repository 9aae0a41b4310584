"""The error of a loop is taken out of the map: keyframes move, and landmarks with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...types import FloatArray
from ..se3 import normalised, repeated
from .keyframes.map import Map

_MIN_STEP, _GUESSED = (
    1e-6,
    1e6,
)  # m of way added to each step: a camera that only turns drifts too; a guessed step drifts most


def distribute_loop_error(map_: Map, place: int, T: FloatArray, T_world_camera: FloatArray) -> None:
    """Close a loop: a camera at `T_world_camera` is at ``T @ T_world_camera``, as an older keyframe tells.

    The keyframes since then take their share of T by the way they have come, and their landmarks go with them; a
    step that was guessed takes almost all. The next adjustment is of the whole map.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks; changed.
    place : int
        Which keyframe of the map.
    T : (4, 4) float64
        The error of the loop.
    T_world_camera : (4, 4) float64
        The camera's pose before.
    """
    since = map_.keyframes[place:]
    centres = np.array([frame.T_world_camera[:3, 3] for frame in since] + [T_world_camera[:3, 3]])
    guessed = np.array([frame.is_start for frame in since[1:]] + [False])
    way = np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1) + np.where(guessed, _GUESSED, _MIN_STEP))
    first_seen = np.full(len(map_.xyz), place)
    for k in range(len(map_.keyframes) - 1, -1, -1):
        first_seen[map_.keyframes[k].landmark] = max(k, place)
    for k in range(place + 1, len(map_.keyframes)):
        part = repeated(T, way[k - place - 1] / way[-1])
        map_.keyframes[k] = replace(
            map_.keyframes[k],
            T_world_camera=normalised(part @ map_.keyframes[k].T_world_camera),
            is_start=False,
        )
        moved = first_seen == k
        map_.xyz[moved] = map_.xyz[moved] @ part[:3, :3].T + part[:3, 3]
    map_.has_new_loop = True
