"""What a keyframe sees again of older landmarks, whatever they have become; sights in one place become one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..keyframes.sightings import match_sights


def called_now(map_: Map, again: Keyframe) -> Keyframe:
    """Find the rows of landmarks that are known by their numbers: those of what they have become, if they were merged.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    again : Keyframe
        Sights of landmarks, by numbers.

    Returns
    -------
    Keyframe
        The same by rows, without landmarks that no keyframe sees any more; of two that became one, the first stays.
    """
    numbers = _last(map_.merged, again.landmark)
    rows = np.minimum(np.searchsorted(map_.landmark_id, numbers), len(map_.landmark_id) - 1)
    again = replace(again, landmark=rows)
    again = _chosen(again, (map_.landmark_id[rows] == numbers) & (map_.sightings.count(rows) > 0))
    return _chosen(again, np.sort(np.unique(again.landmark, return_index=True)[1]))


def join_sights(
    map_: Map, place: int, again: Keyframe, same_landmark: float
) -> tuple[Keyframe, NDArray[np.int64]]:  # fmt: skip
    """Make landmarks that a keyframe sees in the same place one.

    Parameters
    ----------
    map_ : Map
        Changed.
    place : int
        Which keyframe.
    again : Keyframe
        What it sees again, by rows of landmarks.
    same_landmark : float
        Distance of two observations, in u, v and disparity, of one landmark, px.

    Returns
    -------
    Keyframe
        What it sees again, but for what it sees anyway.
    (G,) int64
        Rows of the landmarks that became one of those.
    """
    own = map_.keyframes[place]
    again = _chosen(again, ~np.isin(again.landmark, own.landmark))
    seen, known = (np.column_stack([frame.uv, frame.disparity]) for frame in (again, own))
    matched, rows = match_sights(seen, known, same_landmark)
    _, once = np.unique(matched, return_index=True)
    kept, gone = again.landmark[matched[once]], own.landmark[rows[once]]
    map_.merge_landmarks(kept, gone)
    return again, gone


def _last(merged: NDArray[np.int64], numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of what landmarks have become, by pairs (merged, kept)."""
    gone, kept = merged[np.argsort(merged[:, 0])].T
    while len(gone):
        at = np.minimum(np.searchsorted(gone, numbers), len(gone) - 1)
        is_gone = gone[at] == numbers
        if not is_gone.any():
            break
        numbers = np.where(is_gone, kept[at], numbers)
    return numbers


def _chosen(again: Keyframe, kept: BoolArray | NDArray[np.int64]) -> Keyframe:
    columns = {name: getattr(again, name)[kept] for name in ("landmark", "uv", "disparity", "sigma")}
    return replace(again, **columns)
