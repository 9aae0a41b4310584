"""Places that two maps share: keyframes that look alike, each proved by landmarks and by the keyframe beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....types import BoolArray, FloatArray
from ...features.binary import Descriptors
from ...images import build_pyramid
from ...se3 import inverse
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..pose import PoseEstimate
from .loop_closing import PlaceRecognition
from .same_motion import is_same_motion


@dataclass(frozen=True, repr=False)
class SharedPlaces(Brief):
    """Keyframes of a map, each as another map has it.

    Attributes
    ----------
    keyframe : (S,) int64
        Numbers of their frames.
    place : (S,) int64
        Number of the other map's keyframe that each was found at.
    T_world_camera : (S, 4, 4) float64
        Their poses in the other map's world, m.
    depth : (S,) float64
        Median depth of the landmarks seen, m.
    start : (S + 1,) int64
        What keyframe s sees of the other map are rows ``start[s]`` to ``start[s + 1]`` of what follows.
    landmark_id : (L,) int64
        Numbers of landmarks of the other map.
    uv : (L, 2) float64
        Where they are seen, px.
    """

    keyframe: NDArray[np.int64]
    place: NDArray[np.int64]
    T_world_camera: FloatArray
    depth: FloatArray
    start: NDArray[np.int64]
    landmark_id: NDArray[np.int64]
    uv: FloatArray

    def __len__(self) -> int:
        return len(self.keyframe)

    @property
    def counts(self) -> NDArray[np.int64]:
        """How many landmarks each sees, (S,)."""
        return np.diff(self.start)

    @classmethod
    def joined(cls, parts: Sequence[SharedPlaces]) -> SharedPlaces:
        """Put several one after another.

        Parameters
        ----------
        parts : sequence of SharedPlaces
            Of the same two maps, or with numbers that are of one; maybe none.

        Returns
        -------
        SharedPlaces
        """
        nothing = np.empty(0, np.int64)
        empty = cls(
            nothing, nothing, np.empty((0, 4, 4)), np.empty(0), np.zeros(1, np.int64), nothing, np.empty((0, 2))
        )
        columns = {
            name: np.concatenate([getattr(one, name) for one in (empty, *parts)])
            for name in vars(empty)
            if name != "start"
        }
        counts = np.concatenate([one.counts for one in (empty, *parts)])
        return cls(**columns, start=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))

    def chosen(self, rows: NDArray[np.int64] | BoolArray) -> SharedPlaces:
        """Choose some of the keyframes.

        Parameters
        ----------
        rows : (K,) int64, or (S,) bool
            Which, in which order.

        Returns
        -------
        SharedPlaces
        """
        rows = np.arange(len(self))[rows]
        counts = self.counts[rows]
        start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        seen = np.repeat(self.start[rows] - start[:-1], counts) + np.arange(start[-1])
        return SharedPlaces(
            self.keyframe[rows], self.place[rows], self.T_world_camera[rows], self.depth[rows], start,
            self.landmark_id[seen], self.uv[seen],
        )  # fmt: skip

    def moved(self, keyframe: int, place: int, landmark_id: int) -> SharedPlaces:
        """Number keyframes and landmarks as in a map that is made of several.

        Parameters
        ----------
        keyframe, place, landmark_id : int
            What is added to the numbers.

        Returns
        -------
        SharedPlaces
        """
        return replace(
            self, keyframe=self.keyframe + keyframe, place=self.place + place,
            landmark_id=self.landmark_id + landmark_id,
        )  # fmt: skip


def verify(places: PlaceRecognition, other: Map, candidates: NDArray[np.int64], clear_share: float) -> SharedPlaces:
    """Prove candidates by geometry: landmarks of the map, and the keyframe beside it.

    A keyframe is believed to be at a place if P3P and the patches of the map's landmarks say so, and these are very
    many (`LoopSettings.sure_landmarks`) and as large a share of those in view as makes a pose clear, or a keyframe
    before or after it is there too: by its own descriptors, where the other map has it against the first.

    Parameters
    ----------
    places : PlaceRecognition
        Of the map in which places are looked for.
    other : Map
        Whose keyframes are looked up, with their images.
    candidates : (C, 2) int64
        Which keyframe of the other map, ascending, and which of the map, in the order in which they are tried.
    clear_share : float
        That share (`TrackingSettings.clear_share`).

    Returns
    -------
    SharedPlaces
        Keyframes of the other map, ascending; each at most once.
    """
    return SharedPlaces.joined([*_proved(places, other, candidates, clear_share)])


def _proved(
    places: PlaceRecognition, other: Map, candidates: NDArray[np.int64], clear_share: float
) -> Iterator[SharedPlaces]:
    for k in np.unique(candidates[:, 0]).tolist():
        grey = other.images.get(other.keyframes[k].index)
        if grey is None:
            continue
        image, frame = build_pyramid(grey), other.keyframes[k]
        for place in candidates[candidates[:, 0] == k, 1].tolist():
            found = places.find_at(place, image, frame.uv, _shown(other, frame))
            if found is None:
                continue
            is_sure = len(found) >= places.loops.sure_landmarks and found.share >= clear_share
            if is_sure or _is_confirmed(places, other, k, place, found):
                yield _as_shared(places.map_, frame, place, found)
                break


def _is_confirmed(places: PlaceRecognition, other: Map, k: int, place: int, found: PoseEstimate) -> bool:
    """Whether a keyframe before or after is at the place too, where the other map has it."""
    frames, depth = other.keyframes, _depth(places.map_, found)
    T_map_other = found.T_world_camera @ inverse(frames[k].T_world_camera)
    for beside in (k - 1, k + 1):
        if not 0 <= beside < len(frames) or frames[beside].part != frames[k].part:
            continue
        T = places.guess_at(place, frames[beside].uv, _shown(other, frames[beside]))
        if T is not None and is_same_motion(T, T_map_other @ frames[beside].T_world_camera, depth, places.loops):
            return True
    return False


def _as_shared(map_: Map, frame: Keyframe, place: int, found: PoseEstimate) -> SharedPlaces:
    return SharedPlaces(
        np.array([frame.index]), np.array([map_.keyframes[place].index]), found.T_world_camera[None],
        np.array([_depth(map_, found)]), np.array([0, len(found)]), map_.landmark_id[found.landmark], found.uv,
    )  # fmt: skip


def _depth(map_: Map, found: PoseEstimate) -> float:
    """Median depth of the landmarks that a camera sees, m."""
    T = found.T_world_camera
    return float(np.median((map_.xyz[found.landmark] - T[:3, 3]) @ T[:3, 2]))


def _shown(map_: Map, frame: Keyframe) -> Descriptors:
    """Descriptors of what a keyframe sees."""
    return map_.descriptors[frame.landmark]
