"""Which of the places that two maps share agree: a chance match has no fellows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray, FloatArray
from ...se3 import inverse, rotation_angle
from ..keyframes.map import Map
from .settings import LoopSettings
from .shared_places import SharedPlaces

_FEWEST = 2  # keyframes that must agree, where none of them sees enough landmarks to be sure of alone


def agreeing(map_: Map, shared: SharedPlaces, loops: LoopSettings) -> BoolArray:
    """Find the largest set of shared places that agree pairwise on how two parts of a map stand to one another.

    Two places agree if the way from one to the other is the same in both parts, but for what P3P leaves open and what
    the paths may have drifted between them (pairwise consistent measurements; Mangelson et al. 2018). The set
    grows from the place that agrees with most. One that agrees with none counts only if it is sure of itself. Where two
    such sets contradict each other, places look alike, and neither is believed.

    Parameters
    ----------
    map_ : Map
        With both parts, each in a world of its own.
    shared : SharedPlaces
        Keyframes of one part, as the other has them.
    loops : LoopSettings
        How far they may be apart (`same_motion`, `drift_rate`), and what is sure (`sure_landmarks`).

    Returns
    -------
    (S,) bool
        Which are believed; all False where nothing is.
    """
    agrees = _agree(map_, shared, loops)
    believed = _largest(agrees, shared.counts, np.ones(len(shared), np.bool_))
    contradicts = agrees[believed].sum(axis=0) == 0
    other = _largest(agrees, shared.counts, contradicts)
    is_sure = _is_enough(believed, shared, loops) and not _is_enough(other, shared, loops)
    return believed & is_sure


def _largest(agrees: BoolArray, counts: NDArray[np.int64], among: BoolArray) -> BoolArray:
    """The set of places, of some, that grows from the one that agrees with most."""
    order = np.lexsort((np.arange(len(counts)), -counts, -agrees[:, among].sum(axis=1)))
    chosen: list[int] = []
    for s in order[among[order]].tolist():
        if agrees[s, chosen].all():
            chosen.append(s)
    found = np.zeros(len(counts), np.bool_)
    found[chosen] = True
    return found


def _is_enough(chosen: BoolArray, shared: SharedPlaces, loops: LoopSettings) -> bool:
    return int(chosen.sum()) >= _FEWEST or bool((shared.counts[chosen] >= loops.sure_landmarks).any())


def _agree(map_: Map, shared: SharedPlaces, loops: LoopSettings) -> BoolArray:
    """Which pairs of places agree, (S, S)."""
    numbers = np.array([frame.index for frame in map_.keyframes])
    poses = np.array([frame.T_world_camera for frame in map_.keyframes]).reshape(-1, 4, 4)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1))])
    own, place = (np.searchsorted(numbers, at) for at in (shared.keyframe, shared.place))
    agrees = np.empty((len(shared), len(shared)), np.bool_)
    for s, T in enumerate(shared.T_world_camera):  # row by row: poses of all pairs at once would be gigabytes
        off = inverse(inverse(poses[own[s]]) @ poses[own]) @ (inverse(T) @ shared.T_world_camera)
        depth = np.minimum(shared.depth[s], shared.depth)
        drift = loops.drift_rate * sum(np.abs(way[at] - way[at[s]]) for at in (own, place))
        slack = loops.same_motion + drift / depth  # m per m of depth, and as an angle
        away: FloatArray = np.linalg.norm(off[:, :3, 3], axis=1)
        agrees[s] = (away <= slack * depth) & (rotation_angle(off[:, :3, :3]) <= slack)
    return agrees
