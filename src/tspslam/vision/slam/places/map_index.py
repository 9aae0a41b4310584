"""The place index of a map: it follows what the map's keyframes see."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray, FloatArray
from ...features.binary import Descriptors
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from .index import PlaceIndex, grown


class MapIndex:
    """A place index that follows a map: what it finds depends on what the map holds now, not on how it came there.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    """

    def __init__(self, map_: Map) -> None:
        self._map, self._index = map_, PlaceIndex()
        self._held: dict[int, tuple[NDArray[np.int64], NDArray[np.int64]]] = {}  # rows and numbers of the landmarks
        self._frames: list[Keyframe] = []
        self._poses, self._number = np.zeros((0, 4, 4)), np.zeros(0, np.int64)
        self._part = np.zeros(0, np.int64)

    def __repr__(self) -> str:
        return f"MapIndex({self._index!r})"

    @property
    def poses(self) -> FloatArray:
        """Poses of all keyframes as they are now, (K, 4, 4)."""
        self._follow_poses()
        return self._poses[: len(self._frames)]

    @property
    def is_elsewhere(self) -> BoolArray:
        """Which keyframes are in another part of the map than the last one, (K,): how far away they are is a guess."""
        self._follow_poses()
        part = self._part[: len(self._frames)]
        return np.asarray(part != part[-1:])

    def query(self, descriptors: Descriptors, most: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Find the keyframes that share most with a view, of those before the last `MapSettings.references`.

        Parameters
        ----------
        descriptors : (N, P) uint64
            What it shows.
        most : int
            How many to return.

        Returns
        -------
        places : (R,) int64
            Which keyframes of the map, the most similar first.
        words : (R,) float64
            As `PlaceIndex.query` gives them.
        """
        self._follow_poses()
        self._follow_words()
        numbers, words = self._index.query(descriptors, most)
        return np.searchsorted(self._number[: len(self._frames)], numbers), words

    def _follow_poses(self) -> None:
        """Take over poses and numbers of the keyframes that are not the same objects as before."""
        frames, before = self._map.keyframes, self._frames
        self._poses, self._number = grown(self._poses, len(frames)), grown(self._number, len(frames))
        self._part = grown(self._part, len(frames))
        same = min(len(frames), len(before))
        for k in [k for k in range(same) if frames[k] is not before[k]] + list(range(same, len(frames))):
            frame = frames[k]
            self._poses[k], self._number[k], self._part[k] = frame.T_world_camera, frame.index, frame.part
        self._frames = frames.copy()

    def _follow_words(self) -> None:
        """Enter keyframes that are new or see other landmarks than before, and forget those that are gone."""
        map_, held = self._map, self._held
        frames = map_.keyframes[: -map_.settings.references]
        for frame in frames:
            known = held.get(frame.index)
            if known is not None and known[0] is frame.landmark:
                continue
            numbers = map_.landmark_id[frame.landmark]
            if known is None or not np.array_equal(known[1], numbers):
                if known is not None:
                    self._index.drop(frame.index)
                self._index.add(frame.index, map_.descriptors[frame.landmark])
            held[frame.index] = frame.landmark, numbers
        if len(held) > len(frames):
            for number in held.keys() - {frame.index for frame in frames}:
                self._index.drop(number)
                del held[number]
