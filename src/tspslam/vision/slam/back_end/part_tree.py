"""Parts of a map that places join one after another, without a ring: what closes one has to agree with it."""

from __future__ import annotations

import numpy as np

from ....types import FloatArray
from ...se3 import inverse, normalised, rotation_angle
from ..keyframes.map import Map
from ..places.settings import LoopSettings
from ..places.shared_places import SharedPlaces


class PartTree:
    """How parts of a map stand to one another, by one place of each two; a place that closes a ring is asked of it.

    Parameters
    ----------
    map_ : Map
        Its parts, each in a world of its own.
    loops : LoopSettings
        How far places may be apart (`same_motion`, `drift_rate`).

    Attributes
    ----------
    joining : list of (int, int)
        Places that join parts, numbers of keyframe and place each.
    motions : (P, 4, 4) float64
        What takes the world of each part to that of the lowest one that it is joined to.
    """

    def __init__(self, map_: Map, loops: LoopSettings) -> None:
        self._map, self._loops = map_, loops
        self._part = [frame.part for frame in map_.keyframes]
        at = np.array([frame.T_world_camera[:3, 3] for frame in map_.keyframes])
        self._way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(at, axis=0), axis=1))]).tolist()
        count = 1 + max(self._part)
        self._root, self.motions = np.arange(count), np.tile(np.eye(4), (count, 1, 1))
        self.joining: list[tuple[int, int]] = []
        self._links: list[tuple[int, int]] = []  # the same by places in the map, either way

    def add(self, shared: SharedPlaces) -> bool:
        """Join two parts; where others join them already, only ask whether all agree.

        Parameters
        ----------
        shared : SharedPlaces
            Keyframes of one part as the other has them, which agree among themselves; the one that sees most
            landmarks tells.

        Returns
        -------
        bool
            Whether they are to be believed.
        """
        s = int(np.argmax(shared.counts))
        ends = int(shared.keyframe[s]), int(shared.place[s])
        k, place = map(self._map.place_of, ends)
        own, other = self._part[k], self._part[place]
        here = self.motions[own] @ self._map.keyframes[k].T_world_camera
        there = self.motions[other] @ shared.T_world_camera[s]
        if self._root[own] == self._root[other]:
            return self._is_near(inverse(there) @ here, float(shared.depth[s]), *self._between(k, place))
        self.joining.append(ends)
        self._links += [(k, place), (place, k)]
        self._join(own, other, there @ inverse(here))
        return True

    def _join(self, own: int, other: int, motion: FloatArray) -> None:
        """Take all that one part is joined to to the world of another's, or back: the lowest world stays."""
        keep, gone = self._root[other], self._root[own]
        if gone < keep:
            keep, gone, motion = gone, keep, inverse(motion)
        self.motions[self._root == gone] = normalised(motion @ self.motions[self._root == gone])
        self._root[self._root == gone] = keep

    def _between(self, start: int, end: int) -> tuple[int, float]:
        """How many joins, and how long a way, m, lead from one keyframe to another."""
        left, seen = [(start, 0, 0.0)], {self._part[start]}
        while self._part[left[-1][0]] != self._part[end]:
            at, joins, way = left.pop()
            for a, b in self._links:
                if self._part[a] == self._part[at] and self._part[b] not in seen:
                    seen.add(self._part[b])
                    left.append((b, joins + 1, way + abs(self._way[a] - self._way[at])))
        at, joins, way = left[-1]
        return joins, way + abs(self._way[end] - self._way[at])

    def _is_near(self, off: FloatArray, depth: float, joins: int, way: float) -> bool:
        """Whether poses are as near as P3P at each join, and what paths drift, may leave them."""
        slack = self._loops.same_motion * joins + self._loops.drift_rate * way / depth  # m per m of depth, or angle
        return bool(np.linalg.norm(off[:3, 3]) <= slack * depth and rotation_angle(off[:3, :3]) <= slack)
