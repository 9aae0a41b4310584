"""Keyframes and landmarks: the map that a camera is tracked against."""

from __future__ import annotations

import operator
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray, FloatArray, Rig
from ...features.binary import Descriptors
from ...images import Pyramid
from ...rig import back_project
from ...se3 import inverse
from ..least_squares.bundle import Adjustment
from ..pose import PoseEstimate
from ..tracking import Reference
from .columns import Column
from .images import KeyframeImages
from .keyframe import Keyframe, Keypoints, MapSnapshot
from .parts import part_seen
from .redundancy import find_replacement
from .settings import MapSettings
from .sightings import Sightings

_NOTHING = {"landmark": np.empty(0, np.int64), "uv": np.empty((0, 2)), "disparity": np.empty(0), "sigma": np.empty(0)}
_index_of = operator.attrgetter("index")
_GAPS = 0.1  # share of the rows from a gap to the end that are gaps, from which these rows move up: 10 moves for each


class Map:
    """Landmarks and the keyframes that saw them, in the frame of the first keyframe.

    Arrays of landmarks are in the order of their numbers (`landmark_id`); rows move when landmarks are culled, numbers
    stay. Where a few are culled among many, their rows stay as `gaps` that no keyframe sees, until there are more: what
    a keyframe costs depends on what it sees, not on how many there are. Disparities are as measured.

    Parameters
    ----------
    rig : Rig
        The cameras; their `doffs` follow what the motion tells of the disparities (`DisparityBias`).
    window : int
        Last keyframes that are adjusted together.
    settings : MapSettings, optional
        What is kept.

    Attributes
    ----------
    keyframes : list of Keyframe
        In order.
    images : KeyframeImages
        Their left images, by the numbers of the frames.
    gaps : (G,) int64
        Rows, ascending, of landmarks that were culled.
    next_id : int
        Number of the next landmark.
    added : int
        Keyframes so far, culled ones included.
    loop : Keyframe or None
        A keyframe as older landmarks, by their numbers, have it, while that loop is being closed.
    unsettled : set of int
        Keyframes that were not adjusted since a loop was closed: numbers of their frames.
    dropped : list of (int, int, (4, 4) float64)
        Keyframes culled since the path was last told: frame, its replacement, T_replacement_frame.
    """

    def __init__(self, rig: Rig, *, window: int, settings: MapSettings | None = None) -> None:
        self.rig, self.window, self.settings = rig, window, settings or MapSettings()
        self.keyframes: list[Keyframe] = []
        self.images = KeyframeImages(self.settings.image_bytes, (rig.height, rig.width))
        self._xyz, self._descriptors = Column(np.empty((0, 3))), Column(np.empty((0, 4), np.uint64))
        self._landmark_id, self._merged = Column(np.empty(0, np.int64)), Column(np.empty((0, 2), np.int64))
        self._sightings, self._doubtful = Sightings(), [np.empty(0, np.int64)]  # rows that may be of no use
        self._references: tuple[list[Keyframe], list[Reference]] = [], []  # of which keyframes, as they were
        self.gaps, self.next_id, self.added = np.empty(0, np.int64), 0, 0
        self.loop: Keyframe | None = None
        self.unsettled: set[int] = set()
        self.dropped: list[tuple[int, int, FloatArray]] = []

    @property
    def xyz(self) -> FloatArray:
        """Landmarks, (M, 3) float64, m."""
        return self._xyz.rows

    @xyz.setter
    def xyz(self, values: FloatArray) -> None:
        """Put others in their place."""
        self._xyz = Column(values)
        self._sightings.cover(len(values))

    @property
    def descriptors(self) -> Descriptors:
        """Theirs, (M, P) uint64."""
        return self._descriptors.rows

    @descriptors.setter
    def descriptors(self, values: Descriptors) -> None:
        """Put others in their place."""
        self._descriptors = Column(values)

    @property
    def landmark_id(self) -> NDArray[np.int64]:
        """Their numbers, (M,) int64, ascending."""
        return self._landmark_id.rows

    @landmark_id.setter
    def landmark_id(self, values: NDArray[np.int64]) -> None:
        """Put others in their place."""
        self._landmark_id = Column(values)

    @property
    def merged(self) -> NDArray[np.int64]:
        """Pairs (merged, kept) of landmark numbers, (R, 2) int64, in the order of their merging."""
        return self._merged.rows

    @merged.setter
    def merged(self, values: NDArray[np.int64]) -> None:
        """Put others in their place."""
        self._merged = Column(values)

    @property
    def landmark_count(self) -> int:
        """How many landmarks there are: rows but gaps."""
        return len(self.xyz) - len(self.gaps)

    def snapshot(self) -> MapSnapshot:
        """Copy the map as it is now.

        Returns
        -------
        MapSnapshot
        """
        frames = self.keyframes
        columns = self.observations()
        return MapSnapshot(
            landmark_id=np.delete(self.landmark_id, self.gaps),
            xyz=np.delete(self.xyz, self.gaps, axis=0),
            keyframe=np.array([frame.index for frame in frames], np.int64),
            T_world_camera=np.array([frame.T_world_camera for frame in frames]).reshape(-1, 4, 4),
            start=np.cumsum([0, *(len(frame.landmark) for frame in frames)]),
            observed_id=self.landmark_id[columns["landmark"]],
            uv=columns["uv"],
            disparity=columns["disparity"],
            merged=self.merged.copy(),
        )

    def observations(self) -> dict[str, NDArray[Any]]:
        """Collect what the keyframes see: landmarks' rows, places and disparities, keyframe after keyframe.

        Returns
        -------
        dict of str to array
            ``landmark`` (O,) int64, ``uv`` (O, 2) float64, ``disparity`` and ``sigma`` (O,) float64, px.
        """
        return {
            name: np.concatenate([empty, *(getattr(frame, name) for frame in self.keyframes)])
            for name, empty in _NOTHING.items()
        }

    def covisible(self, place: int, least: int = 15) -> list[tuple[int, int]]:
        """Find the keyframes that see landmarks of another.

        Parameters
        ----------
        place : int
            Which keyframe of the map.
        least : int
            Landmarks in common.

        Returns
        -------
        list of (int, int)
            Keyframes other than `place`, in order, and how many landmarks each shares with it.
        """
        _, frame = self._sightings.of(self.keyframes[place].landmark)
        frames, shared = np.unique(frame, return_counts=True)
        found = [(self.place_of(k), count) for k, count in zip(frames.tolist(), shared.tolist(), strict=True)]
        return [(k, count) for k, count in found if k != place and count >= least]

    def seen_by(self, rows: NDArray[np.int64]) -> list[int]:
        """Find the keyframes that see any of some landmarks.

        Parameters
        ----------
        rows : (K,) int64
            Landmarks.

        Returns
        -------
        list of int
            Which keyframes of the map, ascending.
        """
        return [self.place_of(index) for index in np.unique(self._sightings.of(rows)[1]).tolist()]

    @property
    def sightings(self) -> Sightings:
        """Which keyframes see each landmark."""
        return self._sightings

    def place_of(self, index: int) -> int:
        """Find which keyframe of the map a frame is.

        Parameters
        ----------
        index : int
            Number of the frame.

        Returns
        -------
        int
            Where one that was culled would be.
        """
        return bisect_left(self.keyframes, index, key=_index_of)

    def note_sightings(self) -> None:
        """Note who sees what, after keyframes and landmarks were put in place from outside."""
        self._sightings, self._doubtful = Sightings(), [np.arange(len(self.xyz))]
        self._sightings.cover(len(self.xyz))
        for frame in self.keyframes:
            self._sightings.add(frame.landmark, frame.index)

    def references(self) -> list[Reference]:
        """The last keyframes, newest first, each with the landmarks that no later one saw.

        Returns
        -------
        list of Reference
            The same objects until one of these keyframes changes.
        """
        last = self.keyframes[-self.settings.references :]
        known, _ = self._references
        if len(known) != len(last) or not all(map(operator.is_, known, last)):
            self._references = last, self._find_references(last)
        return self._references[1]

    def _find_references(self, last: list[Keyframe]) -> list[Reference]:
        taken, found = np.empty(0, np.int64), []
        for frame in reversed([frame for frame in last if frame.part == last[-1].part]):
            new = ~np.isin(frame.landmark, taken)
            taken = np.concatenate([taken, frame.landmark])
            assert frame.image is not None
            found.append(Reference(frame.image, frame.T_world_camera, frame.uv[new], frame.landmark[new]))
        return found

    def add(
        self, index: int, T_world_camera: FloatArray, images: tuple[Pyramid, NDArray[np.uint8]],
        estimate: PoseEstimate | None, keypoints: Keypoints, spread: Callable[[FloatArray], FloatArray],
    ) -> None:  # fmt: skip
        """Make a frame a keyframe: the landmarks that it tracks are seen again, its other keypoints are new ones.

        Parameters
        ----------
        index : int
            Number of the frame.
        T_world_camera : (4, 4) float64
            Its pose.
        images : (Pyramid, (H, W) uint8)
            Its left image.
        estimate : PoseEstimate or None
            Landmarks that it tracks; None where the map begins anew.
        keypoints : Keypoints
            What may become landmarks.
        spread : callable
            Standard deviations of the disparities at places (K, 2) of its image, (K,) px.
        """
        nothing = np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty((6, 6))
        old = estimate or PoseEstimate(T_world_camera, *nothing)
        rows = self._new_landmarks(keypoints, old.uv)
        T = T_world_camera
        points = back_project(self.rig, keypoints.uv[rows], keypoints.disparity[rows]) @ T[:3, :3].T + T[:3, 3]
        landmark = np.concatenate([old.landmark, len(self.xyz) + np.arange(len(rows))])
        if not self.keyframes:
            self.descriptors = keypoints.descriptors[:0]  # as long as these are
        self._xyz.extend(points)
        self._descriptors.extend(keypoints.descriptors[rows])
        self._landmark_id.extend(self.next_id + np.arange(len(rows)))
        self.next_id += len(rows)
        uv = np.concatenate([old.uv, keypoints.uv[rows]])
        disparity = np.concatenate([old.disparity, keypoints.disparity[rows]])
        part = part_seen(self.keyframes, self._sightings.of(old.landmark)[1])
        is_start = bool(self.keyframes) and part != self.keyframes[-1].part
        self.keyframes.append(Keyframe(index, T, images[0], landmark, uv, disparity, spread(uv), is_start, part))
        self.images.add(index, images[1])
        self.added += 1
        self._sightings.cover(len(self.xyz))
        self._sightings.add(landmark, index)
        self._doubtful.append(landmark[len(old.landmark) :])
        self._tidy()

    def _new_landmarks(self, keypoints: Keypoints, tracked: FloatArray) -> NDArray[np.int64]:
        """Rows of keypoints with a depth, away from those that are tracked."""
        from scipy.spatial import cKDTree

        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(keypoints.disparity + self.rig.doffs > self.settings.min_total)
        if len(tracked):
            away, _ = cKDTree(tracked).query(keypoints.uv[rows], distance_upper_bound=self.settings.spacing)
            rows = rows[np.isinf(away)]
        return rows

    def _tidy(self) -> None:
        """Forget images that are not looked for; now and then, landmarks and keyframes that are of no use."""
        last = self.settings.references
        if len(self.keyframes) > last:
            self._change(-last - 1, image=None)
        if self.added % self.settings.cull_every == 0:
            self._cull_landmarks()
            self._cull_keyframes()

    def _change(self, place: int, **changes: Any) -> None:
        self.keyframes[place] = replace(self.keyframes[place], **changes)

    def _in_window(self) -> NDArray[np.int64]:
        """Landmarks that the keyframes of the window see, ascending."""
        return np.unique(np.concatenate([frame.landmark for frame in self.keyframes[-self.window :]]))

    def _cull_landmarks(self) -> None:
        """Drop landmarks that only one keyframe saw, unless that is in the window."""
        doubtful = np.unique(np.concatenate(self._doubtful))
        is_new = np.isin(doubtful, self._in_window())
        old, self._doubtful = doubtful[~is_new], [doubtful[is_new]]
        gone = old[self._sightings.count(old) <= 1]
        for k in self.seen_by(gone):
            self._keep(k, ~np.isin(self.keyframes[k].landmark, gone))
        nobody = np.empty(0, np.int64)
        self._sightings.replace(gone, nobody, nobody)
        self.gaps = np.union1d(self.gaps, gone)
        self._close_gaps(_GAPS)

    def _keep(self, place: int, kept: NDArray[Any], **changes: Any) -> None:
        """Keep some of a keyframe's observations."""
        columns = {name: getattr(self.keyframes[place], name)[kept] for name in _NOTHING}
        self._change(place, **columns | changes)

    def _close_gaps(self, least: float) -> None:
        """Move the rows up from the first gap on from which at least such a share are gaps."""
        after = len(self.xyz) - self.gaps
        is_dense = np.arange(len(self.gaps), 0, -1) >= least * after
        if not is_dense.any():
            return
        place = int(is_dense.argmax())
        first, kept = int(self.gaps[place]), np.ones(after[place], np.bool_)
        kept[self.gaps[place:] - first] = False
        gone = np.append(np.cumsum(~kept), 0)  # before each row, and before what is before the first

        def moved(rows: NDArray[np.int64]) -> NDArray[np.int64]:
            return rows - gone[np.maximum(rows - first, -1)]

        for k in self.seen_by(np.arange(first, len(self.xyz))):
            self._change(k, landmark=moved(self.keyframes[k].landmark))
        self._doubtful = [moved(rows) for rows in self._doubtful]
        for column in (self._xyz, self._descriptors, self._landmark_id, self._sightings):
            column.keep(first, kept)
        self.gaps = self.gaps[:place]

    def _cull_keyframes(self) -> None:
        """Drop keyframes before the window that show hardly anything that others do not; the first one stays.

        A keyframe goes if most of its landmarks are seen by three others (Mur-Artal et al. 2015), or if an older one
        looks from about there at the same: each place keeps a bounded number.
        """
        frames, gone = self.keyframes, list[int]()
        known: dict[str, Any] = {
            "sightings": self._sightings, "xyz": self.xyz, "window": self.window, "settings": self.settings
        }  # fmt: skip
        looped = -1 if self.loop is None else self.loop.index
        for k in self._seen_by_the_window():
            stays = k == 0 or frames[k].is_start or frames[k].index == looped
            other = None if stays else find_replacement(frames, k, gone, **known)
            if other is not None:
                gone.append(k)
                self._sightings.drop(frames[k].landmark, frames[k].index)
                self._doubtful.append(frames[k].landmark)
                T = inverse(frames[other].T_world_camera) @ frames[k].T_world_camera
                self.dropped.append((frames[k].index, frames[other].index, T))
                self.images.drop(frames[k].index)
                self.unsettled.discard(frames[k].index)
        for k in reversed(gone):
            del self.keyframes[k]

    def _seen_by_the_window(self) -> list[int]:
        """Keyframes before the window that see a landmark of it: others have not changed."""
        before = len(self.keyframes) - max(self.window, self.settings.references)
        return [k for k in self.seen_by(self._in_window()) if k < before]

    def merge_landmarks(self, landmark: NDArray[np.int64], other: NDArray[np.int64]) -> None:
        """Make pairs of landmarks one each; the first of a pair stays where it is, and so does its number.

        Parameters
        ----------
        landmark, other : (K,) int64
            Rows.
        """
        self._merged.extend(np.column_stack([self.landmark_id[other], self.landmark_id[landmark]]))
        order = np.argsort(other)
        for k in self.seen_by(other):
            rows = self.keyframes[k].landmark
            at = np.minimum(np.searchsorted(other, rows, sorter=order), len(other) - 1)
            at = order[at]
            rows = np.where(other[at] == rows, landmark[at], rows)
            kept = np.sort(np.unique(rows, return_index=True)[1])  # of two that become one it keeps one
            self._keep(k, kept, landmark=rows[kept])
        self._sightings.merge(landmark, other)
        self._doubtful.append(other)

    def observe(self, place: int, again: Keyframe) -> None:
        """Note what a keyframe sees besides.

        Parameters
        ----------
        place : int
            Which keyframe of the map.
        again : Keyframe
            Sights of landmarks, by their rows; those that it sees already do not count.
        """
        own = self.keyframes[place]
        new = ~np.isin(again.landmark, own.landmark)
        self._change(place, **{n: np.concatenate([getattr(own, n), getattr(again, n)[new]]) for n in _NOTHING})
        self._sightings.add(again.landmark[new], own.index)

    def apply(
        self, rows: NDArray[np.int64], found: Adjustment, keyframes: Mapping[int, tuple[int | None, BoolArray]]
    ) -> None:
        """Take over poses and landmarks of an adjustment, and drop outliers.

        Parameters
        ----------
        rows : (P,) int64
            Landmarks that were adjusted.
        found : Adjustment
            Their places, and the poses of the keyframes.
        keyframes : dict of int to (int or None, (K,) bool)
            For the number of each frame: its row in the adjustment, None if it was held; which observations stay.
        """
        self.xyz[rows] = found.xyz
        outliers = [(np.empty(0, np.int64), np.empty(0, np.int64))]
        for index, (row, kept) in keyframes.items():
            k = self.place_of(index)
            if k == len(self.keyframes) or self.keyframes[k].index != index:  # culled meanwhile
                continue
            gone = self.keyframes[k].landmark[~kept]
            outliers.append((gone, np.full(len(gone), index)))
            self._keep(k, kept, **({} if row is None else {"T_world_camera": found.T_world_camera[row]}))
        landmark, frame = (np.concatenate(parts) for parts in zip(*outliers, strict=True))
        self._sightings.drop(landmark, frame)
        self._doubtful.append(landmark)
