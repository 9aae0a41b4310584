"""Keyframes and landmarks: the map that a camera is tracked against."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray, FloatArray, Rig
from ...images import Pyramid
from ...rig import back_project
from ...se3 import inverse
from ..least_squares.bundle import Adjustment
from ..pose import PoseEstimate
from ..tracking import Reference
from .images import KeyframeImages
from .keyframe import Keyframe, Keypoints, MapSnapshot
from .settings import MapSettings

_NOTHING = {"landmark": np.empty(0, np.int64), "uv": np.empty((0, 2)), "disparity": np.empty(0), "sigma": np.empty(0)}


class Map:
    """Landmarks and the keyframes that saw them, in the frame of the first keyframe.

    Arrays of landmarks are in the order of their numbers (`landmark_id`); rows move when landmarks are culled, numbers
    stay. Disparities are as measured.

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
    xyz : (M, 3) float64
        Landmarks, m.
    descriptors : (M, P) uint64
        Theirs.
    landmark_id : (M,) int64
        Their numbers, ascending.
    next_id : int
        Number of the next landmark.
    merged : (R, 2) int64
        Pairs (merged, kept) of landmark numbers, in the order of their merging.
    loop : Keyframe or None
        The last keyframe as older landmarks have it, while a loop is being closed.
    unsettled : set of int
        Keyframes that were not adjusted since a loop was closed: numbers of their frames.
    dropped : list of (int, int, (4, 4) float64)
        Keyframes culled since the path was last told: frame, its replacement, T_replacement_frame.
    """

    def __init__(self, rig: Rig, *, window: int, settings: MapSettings | None = None) -> None:
        self.rig, self.window, self.settings = rig, window, settings or MapSettings()
        self.keyframes: list[Keyframe] = []
        self.images = KeyframeImages(self.settings.image_bytes)
        self.xyz, self.descriptors = np.empty((0, 3)), np.empty((0, 4), np.uint64)
        self.landmark_id, self.next_id = np.empty(0, np.int64), 0
        self.merged = np.empty((0, 2), np.int64)
        self.loop: Keyframe | None = None
        self.unsettled: set[int] = set()
        self.dropped: list[tuple[int, int, FloatArray]] = []

    def snapshot(self) -> MapSnapshot:
        """Copy the map as it is now.

        Returns
        -------
        MapSnapshot
        """
        frames = self.keyframes
        columns = self.observations()
        return MapSnapshot(
            landmark_id=self.landmark_id.copy(),
            xyz=self.xyz.copy(),
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
        is_seen = np.zeros(len(self.xyz), np.bool_)
        is_seen[self.keyframes[place].landmark] = True
        shared = [int(is_seen[frame.landmark].sum()) for frame in self.keyframes]
        return [(k, count) for k, count in enumerate(shared) if k != place and count >= least]

    def references(self) -> list[Reference]:
        """The last keyframes, newest first, each with the landmarks that no later one saw.

        Returns
        -------
        list of Reference
        """
        taken = np.zeros(len(self.xyz), np.bool_)
        found = []
        for frame in reversed(self.keyframes[-self.settings.references :]):
            new = ~taken[frame.landmark]
            taken[frame.landmark] = True
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
        born = np.arange(len(rows))
        landmark = np.concatenate([old.landmark, len(self.xyz) + born])
        self.xyz = np.concatenate([self.xyz, points])
        descriptors = keypoints.descriptors[rows]
        self.descriptors = np.concatenate([self.descriptors, descriptors]) if self.keyframes else descriptors
        self.landmark_id = np.concatenate([self.landmark_id, self.next_id + born])
        self.next_id += len(rows)
        uv = np.concatenate([old.uv, keypoints.uv[rows]])
        disparity = np.concatenate([old.disparity, keypoints.disparity[rows]])
        is_start = bool(self.keyframes) and estimate is None
        self.keyframes.append(Keyframe(index, T, images[0], landmark, uv, disparity, spread(uv), is_start))
        self.images.add(index, images[1])
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
        if len(self.keyframes) % self.settings.cull_every == 0:
            self._cull_landmarks()
            self._cull_keyframes()

    def _change(self, place: int, **changes: Any) -> None:
        self.keyframes[place] = replace(self.keyframes[place], **changes)

    def _cull_landmarks(self) -> None:
        """Drop landmarks that only one keyframe saw, unless that is in the window."""
        kept = self._view_counts() > 1
        for frame in self.keyframes[-self.window :]:
            kept[frame.landmark] = True
        row = np.cumsum(kept) - 1
        self.xyz, self.descriptors, self.landmark_id = self.xyz[kept], self.descriptors[kept], self.landmark_id[kept]
        self._renumber(np.where(kept, row, -1))

    def _view_counts(self) -> NDArray[np.int64]:
        """How many keyframes see each landmark."""
        return np.bincount(np.concatenate([f.landmark for f in self.keyframes]), minlength=len(self.xyz))

    def _renumber(self, row: NDArray[np.int64]) -> None:
        """Move landmarks to other rows, -1 for those that go; of two that become one a keyframe keeps one."""
        for k, frame in enumerate(self.keyframes):
            landmark = row[frame.landmark]
            if np.array_equal(landmark, frame.landmark):
                continue
            _, first = np.unique(landmark, return_index=True)
            kept = np.sort(first[landmark[first] >= 0])
            columns = {name: getattr(frame, name)[kept] for name in _NOTHING}
            self._change(k, **columns | {"landmark": landmark[kept]})

    def _cull_keyframes(self) -> None:
        """Drop keyframes before the window that show hardly anything that others do not; the first one stays.

        A keyframe goes if most of its landmarks are seen by three others (Mur-Artal et al. 2015), or if an older one
        looks from about there at the same: each place keeps a bounded number.
        """
        counts, frames = self._view_counts(), self.keyframes
        stays = np.ones(len(frames), np.bool_)
        for k in self._seen_by_the_window():
            other = None if k == 0 or frames[k].is_start else self._replacement(k, stays, counts)
            if other is not None:
                stays[k] = False
                counts[frames[k].landmark] -= 1
                T = inverse(frames[other].T_world_camera) @ frames[k].T_world_camera
                self.dropped.append((frames[k].index, frames[other].index, T))
                self.images.drop(frames[k].index)
        self.keyframes = [frame for frame, is_kept in zip(frames, stays, strict=True) if is_kept]

    def _seen_by_the_window(self) -> list[int]:
        """Keyframes before the window that see a landmark of it: others have not changed."""
        is_seen = np.zeros(len(self.xyz), np.bool_)
        for frame in self.keyframes[-self.window :]:
            is_seen[frame.landmark] = True
        recent = max(self.window, self.settings.references)
        return [k for k, frame in enumerate(self.keyframes[:-recent]) if is_seen[frame.landmark].any()]

    def _replacement(self, k: int, stays: BoolArray, counts: NDArray[np.int64]) -> int | None:
        """Which older keyframe can stand for one, if that can go."""
        frame, settings = self.keyframes[k], self.settings
        if (counts[frame.landmark] > settings.min_views).sum() >= settings.redundant_share * len(frame.landmark):
            return int(np.flatnonzero(stays[:k])[-1])
        T = frame.T_world_camera
        near = settings.twin_distance * np.median((self.xyz[frame.landmark] - T[:3, 3]) @ T[:3, 2])
        older = stays[: max(k - self.window, 0)]  # later ones are no place to come back to
        for other in np.flatnonzero(older).tolist():
            T_other = self.keyframes[other].T_world_camera
            is_near = np.linalg.norm(T_other[:3, 3] - T[:3, 3]) < near
            looks_alike = T_other[:3, 2] @ T[:3, 2] > np.cos(np.radians(settings.twin_angle))
            shared = np.isin(frame.landmark, self.keyframes[other].landmark)
            if is_near and looks_alike and shared.mean() >= settings.twin_share:
                return other
        return None

    def merge_landmarks(self, landmark: NDArray[np.int64], other: NDArray[np.int64]) -> None:
        """Make pairs of landmarks one each; the first of a pair stays where it is, and so does its number.

        Parameters
        ----------
        landmark, other : (K,) int64
            Rows.
        """
        row = np.arange(len(self.xyz))
        row[other] = landmark
        pairs = np.column_stack([self.landmark_id[other], self.landmark_id[landmark]])
        self.merged = np.concatenate([self.merged, pairs])
        self._renumber(row)

    def apply(self, rows: NDArray[np.int64], found: Adjustment, keyframes: Mapping[int, tuple[int, BoolArray]]) -> None:
        """Take over poses and landmarks of an adjustment, and drop outliers.

        Parameters
        ----------
        rows : (P,) int64
            Landmarks that were adjusted.
        found : Adjustment
            Their places, and the poses of the keyframes.
        keyframes : dict of int to (int, (K,) bool)
            For the number of each frame: its row in the adjustment, and which of its observations stay.
        """
        self.xyz[rows] = found.xyz
        for k, frame in enumerate(self.keyframes):
            if frame.index in keyframes:
                row, kept = keyframes[frame.index]
                columns = {name: getattr(frame, name)[kept] for name in _NOTHING}
                self._change(k, T_world_camera=found.T_world_camera[row], **columns)
