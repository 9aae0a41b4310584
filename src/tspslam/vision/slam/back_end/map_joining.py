"""Maps that share places become one: moved together, bent by one graph of poses, landmarks seen by both fused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....errors import GeometryError
from ....types import FloatArray
from ...se3 import inverse, move_points, normalised
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..keyframes.parts import join_parts
from ..least_squares.pose_graph import PoseEdges, optimise_poses
from ..places.agreement import agreeing
from ..places.settings import LoopSettings
from ..places.shared_places import SharedPlaces
from .loop_correction import LoopProblem
from .part_tree import PartTree
from .seen_again import called_now, join_sights

_MAX_STEPS = 100  # by the default of `optimise_poses`: many loops at once, and nobody waits


@dataclass(frozen=True, repr=False)
class JoinedParts(Brief):
    """What joined the parts of a map.

    Attributes
    ----------
    shared : SharedPlaces
        Places that were believed, by keyframe; poses as in the map before it was bent.
    is_join : (S,) bool
        Those that first joined two parts; the others are loops.
    refused : SharedPlaces
        Places of two parts that agree among themselves, but not with what joins these parts through others.
    """

    shared: SharedPlaces
    is_join: NDArray[np.bool_]
    refused: SharedPlaces


def join_maps(map_: Map, shared: SharedPlaces, sigma_uv: float, loops: LoopSettings) -> JoinedParts:
    """Join the parts of a map that share places; parts that share none stay as they are.

    Parameters
    ----------
    map_ : Map
        Its parts are in worlds of their own; changed: those that were joined are in that of the lowest one.
    shared : SharedPlaces
        Keyframes as other parts have them.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    loops : LoopSettings
        When places agree, and which landmarks are the same.

    Returns
    -------
    JoinedParts
    """
    pairs = _believed(map_, shared, loops)
    if not pairs:
        nothing = SharedPlaces.joined([])
        return JoinedParts(nothing, np.zeros(0, np.bool_), nothing)
    tree = PartTree(map_, loops)
    agrees = [tree.add(pair) for pair in pairs]
    held, refused = (SharedPlaces.joined([*compress(pairs, of)]) for of in (agrees, [not one for one in agrees]))
    first = _parts_of(map_, held.place)
    held = replace(held, T_world_camera=normalised(tree.motions[first] @ held.T_world_camera))
    _move_parts(map_, tree.motions)
    sights = [_sights(map_, held, s) for s in range(len(held))]
    _bend(map_, held, sights, sigma_uv)
    for again in sights:
        _fuse(map_, again, loops.same_landmark)
    for keyframe, place in tree.joining:
        map_.keyframes = join_parts(map_.keyframes, map_.place_of(keyframe), map_.place_of(place))
    is_join = np.array(
        [(k, p) in tree.joining for k, p in zip(held.keyframe.tolist(), held.place.tolist(), strict=True)]
    )
    order = np.argsort(held.keyframe, kind="stable")
    return JoinedParts(held.chosen(order), is_join[order], refused)


def _parts_of(map_: Map, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.array([map_.keyframes[map_.place_of(number)].part for number in numbers.tolist()], np.int64)


def _believed(map_: Map, shared: SharedPlaces, loops: LoopSettings) -> list[SharedPlaces]:
    """Shared places of each two parts that agree; those with most landmarks first."""
    parts = np.column_stack([_parts_of(map_, shared.place), _parts_of(map_, shared.keyframe)])
    found = []
    for pair in np.unique(parts, axis=0):
        of_pair = shared.chosen((parts == pair).all(axis=1) & (pair[0] != pair[1]))
        if len(of_pair):
            found.append(of_pair.chosen(agreeing(map_, of_pair, loops)))
    return sorted((one for one in found if len(one)), key=lambda one: -int(one.start[-1]))


def _move_parts(map_: Map, motions: FloatArray) -> None:
    """Move each part, with its landmarks, as a whole."""
    for k, frame in enumerate(map_.keyframes):
        if not np.array_equal(motions[frame.part], np.eye(4)):
            map_.keyframes[k] = replace(frame, T_world_camera=normalised(motions[frame.part] @ frame.T_world_camera))
    part = np.zeros(len(map_.xyz), np.int64)
    for frame in map_.keyframes:
        part[frame.landmark] = frame.part
    map_.xyz[:] = move_points(motions[part], map_.xyz)


def _sights(map_: Map, shared: SharedPlaces, s: int) -> Keyframe:
    """What a keyframe sees of another part, by numbers of landmarks; with the disparities that they should have."""
    rows = slice(shared.start[s], shared.start[s + 1])
    ids, T, rig = shared.landmark_id[rows], shared.T_world_camera[s], map_.rig
    xyz = map_.xyz[np.searchsorted(map_.landmark_id, ids)]
    depth = (xyz - T[:3, 3]) @ T[:3, 2]
    own = map_.keyframes[map_.place_of(int(shared.keyframe[s]))]
    sigma = np.full(len(ids), np.median(own.sigma))
    return Keyframe(own.index, T, None, ids, shared.uv[rows], rig.fx * rig.baseline / depth - rig.doffs, sigma)


def _bend(map_: Map, shared: SharedPlaces, sights: list[Keyframe], sigma_uv: float) -> None:
    """Have a graph of all poses agree with all places; where it has no solution the parts stay as they were moved."""
    frames = tuple(map_.keyframes)
    problem = LoopProblem(frames, frames[-1], map_.landmark_id, map_.xyz, map_.rig, sigma_uv)
    T = np.stack([frame.T_world_camera for frame in frames])
    i, j, _, information = problem.neighbours(T)
    ends = np.array([[map_.place_of(n) for n in numbers.tolist()] for numbers in (shared.place, shared.keyframe)]).T
    rows = [np.searchsorted(map_.landmark_id, one.landmark) for one in sights]
    told = [
        problem.edge_from(place, replace(one, landmark=row, disparity=np.full(len(row), np.nan)), T)
        for (place, _), one, row in zip(ends.tolist(), sights, rows, strict=True)
    ]
    edges = PoseEdges(
        np.concatenate([i, ends[:, 0]]), np.concatenate([j, ends[:, 1]]),
        np.concatenate([normalised(inverse(T[i]) @ T[j]), [T_ij for T_ij, _ in told]]),
        np.concatenate([information, [own for _, own in told]]),
    )  # fmt: skip
    try:
        found = optimise_poses(T, edges, max_steps=_MAX_STEPS).T_world
    except GeometryError:
        return
    motions = normalised(found @ inverse(T))
    motions[0] = np.eye(4)
    map_.xyz[:] = move_points(motions[problem.first_seen()], map_.xyz)
    map_.keyframes = [replace(f, T_world_camera=T) for f, T in zip(frames, normalised(motions @ T), strict=True)]
    map_.keyframes[0] = frames[0]


def _fuse(map_: Map, again: Keyframe, same_landmark: float) -> None:
    """Have a keyframe see landmarks of another part, by numbers; those that it sees in the same place become one."""
    place = map_.place_of(again.index)
    older, gone = join_sights(map_, place, called_now(map_, again), same_landmark)
    map_.gaps = np.union1d(map_.gaps, gone)
    map_.observe(place, replace(older, disparity=np.full(len(older.landmark), np.nan)))
