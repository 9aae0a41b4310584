"""Which keyframes of a map can go: those that show hardly anything that others do not."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import attrgetter

import numpy as np

from ....types import FloatArray
from .keyframe import Keyframe
from .settings import MapSettings
from .sightings import Sightings

_index_of = attrgetter("index")


def find_replacement(
    frames: Sequence[Keyframe], k: int, gone: Sequence[int], *,
    sightings: Sightings, xyz: FloatArray, window: int, settings: MapSettings,
) -> int | None:  # fmt: skip
    """Find the older keyframe that can stand for one, if that can go.

    Parameters
    ----------
    frames : sequence of Keyframe
        All keyframes.
    k : int
        Which of them.
    gone : sequence of int
        Those that go already; they see nothing any more.
    sightings : Sightings
        Who sees what.
    xyz : (M, 3) float64
        Landmarks, m.
    window : int
        Last keyframes that are adjusted together: one so near before another is no place to come back to.
    settings : MapSettings
        What is kept.

    Returns
    -------
    int or None
        Which keyframe; None if this one stays.
    """
    frame, count = frames[k], len(frames[k].landmark)
    at, seen = sightings.of(frame.landmark)
    views = np.bincount(at, minlength=count)
    if (views > settings.min_views).sum() >= settings.redundant_share * count:
        return next(o for o in range(k - 1, -1, -1) if o not in gone and frames[o].part == frame.part)
    numbers, shared = np.unique(seen, return_counts=True)
    likely = numbers[shared / count >= settings.twin_share].tolist()
    older = [place for place in (bisect_left(frames, n, key=_index_of) for n in likely) if place < k - window]
    return next(iter(_twins(frame, [(place, frames[place]) for place in older], xyz, settings)), None)


def _twins(
    frame: Keyframe, others: Sequence[tuple[int, Keyframe]], xyz: FloatArray, settings: MapSettings
) -> list[int]:
    """Keyframes, of some, that look from about where another does, the same way."""
    if not others:
        return []
    T, poses = frame.T_world_camera, np.stack([other.T_world_camera for _, other in others])
    near = settings.twin_distance * np.median((xyz[frame.landmark] - T[:3, 3]) @ T[:3, 2])
    is_near = np.linalg.norm(poses[:, :3, 3] - T[:3, 3], axis=1) < near
    looks_alike = poses[:, :3, 2] @ T[:3, 2] > np.cos(np.radians(settings.twin_angle))
    return [others[i][0] for i in np.flatnonzero(is_near & looks_alike).tolist()]
