"""Keyframes and landmarks: the map that a camera is tracked against, adjusted as it grows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..types import FloatArray, Rig
from .bundle import Adjustment, adjust
from .rig import back_project
from .tracking import Fix, Landmarks, Sight, observations

_LEAST_TOTAL = 1.5  # px of disparity + doffs: farther points are landmarks only once they come nearer
_LEAST_SHARED = 10  # landmarks in common that make an older keyframe hold the window
_LEAST_POINTS = 30  # landmarks seen twice, below which there is nothing to adjust
_OUTLIER = 5.0  # standard deviations
_STEPS = 8


@dataclass(frozen=True)
class Keyframe:
    """A frame that the map rests on.

    Attributes
    ----------
    index : int
        Number of the frame, from 0.
    T_world_camera : (4, 4) float64
        Its pose.
    sight : Sight
        Its keypoints that are landmarks.
    landmark : (K,) int64
        Which landmark each of them is.
    """

    index: int
    T_world_camera: FloatArray
    sight: Sight
    landmark: NDArray[np.int64]


class OffsetFilter:
    """The offset that all disparities have in common, measured less true, px: what the windows say, weighed.

    Windows share keyframes, so each counts for its share only. Before the first one the offset is 0 ± `sigma`.
    """

    def __init__(self, sigma: float, window: int) -> None:
        self.sigma, self._window = sigma, window
        self.value, self._information = 0.0, sigma**-2.0

    @property
    def std(self) -> float:
        """Its standard deviation, px."""
        return float(self._information**-0.5)

    def update(self, offset: float, std: float) -> None:
        """Weigh in what a window found, which began at the same 0 ± `sigma`."""
        own = std**-2.0 - self.sigma**-2.0
        if own <= 0:
            return
        measured, weight = offset * std**-2.0 / own, own / self._window
        self._information += weight
        self.value += (measured - self.value) * weight / self._information


class Map:
    """Landmarks and the keyframes that saw them, in the frame of the first keyframe.

    Disparities in the map are as measured; `offset` is taken off where they are used.

    Parameters
    ----------
    rig : Rig
        The cameras.
    window : int
        Keyframes that are adjusted together; as many older ones hold them.
    sigma_disparity : float
        Standard deviation of a disparity, px per unit of scale.
    sigma_offset : float
        Of the offset of all disparities before anything is seen, px.
    """

    def __init__(self, rig: Rig, *, window: int, sigma_disparity: float, sigma_offset: float) -> None:
        self.rig, self.window, self.sigma_disparity = rig, window, sigma_disparity
        self.offset = OffsetFilter(sigma_offset, window)
        self.keyframes: list[Keyframe] = []
        self.landmarks: Landmarks | None = None

    def local(self) -> NDArray[np.int64]:
        """Landmarks that the last keyframes saw, ascending."""
        return np.unique(np.concatenate([frame.landmark for frame in self.keyframes[-self.window :]]))

    def chosen(self, rows: NDArray[np.int64]) -> Landmarks:
        """Some of the landmarks."""
        assert self.landmarks is not None
        return Landmarks(self.landmarks.xyz[rows], self.landmarks.words[rows], self.landmarks.scale[rows])

    def corrected(self, sight: Sight) -> Sight:
        """A sight whose disparities are without the offset."""
        return replace(sight, disparity=sight.disparity - self.offset.value)

    def add(
        self, index: int, sight: Sight, T_world_camera: FloatArray, fix: Fix | None, rows: NDArray[np.int64]
    ) -> None:
        """Make a frame a keyframe: its matches are seen again, its other points are new landmarks.

        `rows` are the landmarks that the fix counts.
        """
        owner = np.full(len(sight.uv), -1)
        if fix is not None:
            owner[fix.keypoint] = rows[fix.landmark]
        disparity = self.corrected(sight).disparity
        with np.errstate(invalid="ignore"):
            new = np.flatnonzero((owner < 0) & (disparity + self.rig.doffs > _LEAST_TOTAL))
        T = T_world_camera
        xyz = back_project(self.rig, sight.uv[new], disparity[new]) @ T[:3, :3].T + T[:3, 3]
        count = 0 if self.landmarks is None else len(self.landmarks)
        owner[new] = count + np.arange(len(new))
        self._extend(Landmarks(xyz, sight.words[new], sight.scale[new]))
        seen = np.flatnonzero(owner >= 0)
        own = Sight(sight.uv[seen], sight.words[seen], sight.disparity[seen], sight.scale[seen])
        self._refresh(owner[seen], own)
        self.keyframes.append(Keyframe(index, T, own, owner[seen]))

    def adjust(self) -> Adjustment | None:
        """Adjust the last keyframes and what they saw; older keyframes that saw it hold them."""
        moving = self.keyframes[-self.window :]
        if len(moving) < 2:
            return None
        points = np.unique(np.concatenate([frame.landmark for frame in moving]))
        holding = [f for f in self.keyframes[: -self.window] if np.isin(f.landmark, points).sum() >= _LEAST_SHARED]
        holding = holding[-self.window :] or moving[:1]
        frames = holding + [frame for frame in moving if frame is not holding[0] or len(holding) > 1]
        return self._solve(frames, points, len(holding))

    def _solve(self, frames: list[Keyframe], points: NDArray[np.int64], held: int) -> Adjustment | None:
        """Adjust frames, the first `held` of which stay; keep what was found and drop outliers."""
        pose = np.repeat(np.arange(len(frames)), [len(frame.landmark) for frame in frames])
        landmark = np.concatenate([frame.landmark for frame in frames])
        kept, counts = np.unique(landmark[np.isin(landmark, points)], return_counts=True)
        kept = kept[counts >= 2]
        used = np.flatnonzero(np.isin(landmark, kept))
        if len(kept) < _LEAST_POINTS or self.landmarks is None:
            return None
        sight = _joined([frame.sight for frame in frames])
        seen = observations(sight, used, pose[used], np.searchsorted(kept, landmark[used]), self.sigma_disparity)
        found = adjust(
            self.rig, np.stack([frame.T_world_camera for frame in frames]), self.landmarks.xyz[kept], seen,
            fixed=np.arange(len(frames)) < held, most_steps=_STEPS, offset=self.offset.value,
            offset_sigma=self.offset.sigma,
        )  # fmt: skip
        self.landmarks.xyz[kept] = found.xyz
        good = np.ones(len(landmark), np.bool_)
        good[used[found.distance > _OUTLIER]] = False
        self._keep(frames, found.T_world_camera, np.split(good, np.flatnonzero(np.diff(pose)) + 1))
        self.offset.update(found.offset, found.offset_std)
        return found

    def _keep(self, frames: list[Keyframe], T: FloatArray, good: list[NDArray[np.bool_]]) -> None:
        """New poses of keyframes, without the sights that do not fit."""
        place = {frame.index: k for k, frame in enumerate(self.keyframes)}
        for frame, pose, kept in zip(frames, T, good, strict=True):
            s = frame.sight
            sight = Sight(s.uv[kept], s.words[kept], s.disparity[kept], s.scale[kept])
            self.keyframes[place[frame.index]] = Keyframe(frame.index, pose, sight, frame.landmark[kept])

    def _extend(self, new: Landmarks) -> None:
        old = self.landmarks
        if old is None:
            self.landmarks = new
            return
        self.landmarks = Landmarks(
            np.concatenate([old.xyz, new.xyz]),
            np.concatenate([old.words, new.words]),
            np.concatenate([old.scale, new.scale]),
        )

    def _refresh(self, rows: NDArray[np.int64], sight: Sight) -> None:
        """Landmarks look as they did last."""
        assert self.landmarks is not None
        self.landmarks.words[rows], self.landmarks.scale[rows] = sight.words, sight.scale


def _joined(sights: list[Sight]) -> Sight:
    return Sight(
        np.concatenate([s.uv for s in sights]),
        np.concatenate([s.words for s in sights]),
        np.concatenate([s.disparity for s in sights]),
        np.concatenate([s.scale for s in sights]),
    )
