"""Keyframes and landmarks: the map that a camera is tracked against, adjusted as it grows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...types import BoolArray, FloatArray, Image, Rig
from ..images import Pyramid, grey_levels, pyramid
from ..rig import back_project
from ..se3 import inverse, normalised, repeated
from .bundle import Adjustment, Observations, adjust
from .tracking import SIGMA, PoseEstimate, Reference

_MIN_TOTAL = 1.5  # px of disparity + doffs: farther points are landmarks only once they come nearer
_MIN_SHARED = 4  # landmarks in common that make an older keyframe hold the window
_MIN_POINTS = 30  # landmarks seen twice, below which there is nothing to adjust
_APART = 12.0  # px between a new landmark and one that is followed
_LOOKED_FOR = 3  # last keyframes whose landmarks are looked for in a new image
_CULLED = 10  # keyframes between cullings
_MAX_IMAGES = 100e6  # bytes of the images of older keyframes
_SEEN_ENOUGH, _REDUNDANT = 3, 0.9  # other keyframes that see a landmark; share of such ones that makes a keyframe go
_MIN_STEP, _GUESSED = 1e-6, 1e6  # m from keyframe to keyframe: who only turns drifts too; of a pose that is a guess
_CLOSE, _SAME_WAY, _SHARED = 0.1, np.cos(np.radians(15)), 0.3  # m per m of depth; angle; landmarks: of two alike
_MAX_AT_ONCE = 500  # keyframes; their equations take 72 MB
_OUTLIER = 5.0  # standard deviations
_STEPS = 8


@dataclass(frozen=True)
class Keyframe:
    """A frame that the map rests on, and the landmarks that it sees.

    Attributes
    ----------
    index : int
        Number of the frame, from 0.
    T_world_camera : (4, 4) float64
        Its pose.
    image : Pyramid or None
        Its left image, while landmarks are looked for in it.
    grey : (H, W) uint8 or None
        Its left image, while there is room: in case the camera comes back.
    landmark : (K,) int64
        Which landmarks.
    uv : (K, 2) float64
        Where, px.
    disparity : (K,) float64
        As measured, px; NaN where not known.
    is_start : bool
        Whether the map began anew with it: its pose against the earlier ones is a guess.
    """

    index: int
    T_world_camera: FloatArray
    image: Pyramid | None
    grey: NDArray[np.uint8] | None
    landmark: NDArray[np.int64]
    uv: FloatArray
    disparity: FloatArray
    is_start: bool = False


@dataclass(frozen=True)
class NewPoints:
    """Keypoints that may become landmarks.

    Attributes
    ----------
    uv : (N, 2) float64
        px.
    disparity : (N,) float64
        px; NaN where not known.
    descriptors : (N, D) uint64
        Descriptors.
    """

    uv: FloatArray
    disparity: FloatArray
    descriptors: NDArray[np.uint64]


class DisparityBias:
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

    def settle(self, offset: float, std: float) -> None:
        """Take over what all keyframes together say."""
        self.value, self._information = offset, std**-2.0

    @property
    def state(self) -> tuple[float, float]:
        """Value and information."""
        return self.value, self._information

    @state.setter
    def state(self, state: tuple[float, float]) -> None:
        """Take them over."""
        self.value, self._information = state

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
        Keyframes that are adjusted together; all older ones that see the same hold them.
    sigma_disparity : float
        Standard deviation of a disparity, px.
    sigma_offset : float
        Of the offset of all disparities before anything is seen, px.
    """

    def __init__(self, rig: Rig, *, window: int, sigma_disparity: float, sigma_offset: float) -> None:
        self.rig, self.window, self.sigma_disparity = rig, window, sigma_disparity
        self.offset = DisparityBias(sigma_offset, window)
        self.keyframes: list[Keyframe] = []
        self.xyz, self.descriptors = np.empty((0, 3)), np.empty((0, 4), np.uint64)
        self.has_new_loop = False
        self.dropped: list[tuple[int, int, FloatArray]] = []

    def state(self) -> dict[str, NDArray[Any]]:
        """All of it but the images, as arrays."""
        frames = self.keyframes
        columns = {
            name: np.concatenate([getattr(f, name) for f in frames])
            for name in ("landmark", "uv", "disparity")
            if frames
        }
        return columns | {
            "keyframe_index": np.array([frame.index for frame in frames], np.int64),
            "keyframe_pose": np.array([frame.T_world_camera for frame in frames]).reshape(-1, 4, 4),
            "keyframe_is_start": np.array([frame.is_start for frame in frames], np.bool_),
            "keyframe_has_image": np.array([frame.grey is not None for frame in frames], np.bool_),
            "keyframe_observations": np.array([len(frame.landmark) for frame in frames], np.int64),
            "xyz": self.xyz,
            "descriptors": self.descriptors,
            "offset": np.array(self.offset.state),
            "has_new_loop": np.array(self.has_new_loop),
        }

    def restore(self, state: Mapping[str, NDArray[Any]], image_of: Callable[[int], Image]) -> None:
        """Become the map of that `state`, once checked; `image_of` gives the left image of a frame by its number."""
        shown = state["keyframe_has_image"]
        if not shown[-_LOOKED_FOR:].all() or shown.sum() > self._most_images():
            raise InputError("map: the state has too few or too many images, expected those of the last keyframes")
        self.xyz, self.descriptors = state["xyz"], state["descriptors"]
        self.offset.state, self.has_new_loop = tuple(state["offset"].tolist()), bool(state["has_new_loop"])
        ends = np.cumsum(state["keyframe_observations"])
        self.keyframes = []
        for k, index in enumerate(state["keyframe_index"].tolist()):
            rows = slice(ends[k] - state["keyframe_observations"][k], ends[k])
            left = image_of(index) if shown[k] else None
            grey = None if left is None else np.array(grey_levels(left))
            image = pyramid(left) if left is not None and k >= len(ends) - _LOOKED_FOR else None
            landmark, uv, disparity = (state[name][rows] for name in ("landmark", "uv", "disparity"))
            T, is_start = state["keyframe_pose"][k], bool(state["keyframe_is_start"][k])
            self.keyframes.append(Keyframe(index, T, image, grey, landmark, uv, disparity, is_start))

    def references(self) -> list[Reference]:
        """The last keyframes, newest first, each with the landmarks that no later one saw."""
        taken = np.zeros(len(self.xyz), np.bool_)
        found = []
        for frame in reversed(self.keyframes[-_LOOKED_FOR:]):
            new = ~taken[frame.landmark]
            taken[frame.landmark] = True
            assert frame.image is not None
            found.append(Reference(frame.image, frame.T_world_camera, frame.uv[new], frame.landmark[new]))
        return found

    def add(
        self, index: int, T_world_camera: FloatArray, images: tuple[Pyramid, NDArray[np.uint8]],
        estimate: PoseEstimate | None, new: NewPoints,
    ) -> None:  # fmt: skip
        """Make a frame a keyframe: what it follows is seen again, its other points are new landmarks."""
        old = estimate or PoseEstimate(
            T_world_camera, np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty((6, 6))
        )
        rows = self._fresh(new, old.uv)
        T, corrected = T_world_camera, new.disparity[rows] - self.offset.value
        points = back_project(self.rig, new.uv[rows], corrected) @ T[:3, :3].T + T[:3, 3]
        born = len(self.xyz) + np.arange(len(rows))
        self.xyz = np.concatenate([self.xyz, points])
        self.descriptors = (
            np.concatenate([self.descriptors, new.descriptors[rows]]) if self.keyframes else new.descriptors[rows]
        )
        landmark = np.concatenate([old.landmark, born])
        uv = np.concatenate([old.uv, new.uv[rows]])
        disparity = np.concatenate([old.disparity, new.disparity[rows]])
        is_start = bool(self.keyframes) and estimate is None
        self.keyframes.append(Keyframe(index, T, *images, landmark, uv, disparity, is_start))
        self._let_go()

    def _fresh(self, new: NewPoints, followed: FloatArray) -> NDArray[np.int64]:
        """Rows of points with a depth, away from those that are followed."""
        from scipy.spatial import cKDTree

        with np.errstate(invalid="ignore"):
            rows = np.flatnonzero(new.disparity - self.offset.value + self.rig.doffs > _MIN_TOTAL)
        if len(followed):
            away, _ = cKDTree(followed).query(new.uv[rows], distance_upper_bound=_APART)
            rows = rows[np.isinf(away)]
        return rows

    def _let_go(self) -> None:
        """Forget images that are not looked for; now and then, landmarks and keyframes that are of no use."""
        if len(self.keyframes) > _LOOKED_FOR:
            self._change(-_LOOKED_FOR - 1, image=None)
        if len(self.keyframes) % _CULLED == 0:
            self._cull_landmarks()
            self._cull_keyframes()
        if len(self.keyframes) > self._most_images():
            self._change(-self._most_images() - 1, grey=None)

    def _change(self, place: int, **changes: Any) -> None:
        self.keyframes[place] = replace(self.keyframes[place], **changes)

    def _most_images(self) -> int:
        return max(2 * self.window, int(_MAX_IMAGES / (self.rig.width * self.rig.height)))

    def _cull_landmarks(self) -> None:
        """Drop landmarks that only one keyframe saw, unless that is in the window."""
        kept = self._counts() > 1
        for frame in self.keyframes[-self.window :]:
            kept[frame.landmark] = True
        number = np.cumsum(kept) - 1
        self.xyz, self.descriptors = self.xyz[kept], self.descriptors[kept]
        self._relabel(np.where(kept, number, -1))

    def _counts(self) -> NDArray[np.int64]:
        """How many keyframes see each landmark."""
        return np.bincount(np.concatenate([f.landmark for f in self.keyframes]), minlength=len(self.xyz))

    def _relabel(self, number: NDArray[np.int64]) -> None:
        """Give all landmarks new numbers, -1 to those that go; of two that become one a keyframe keeps one sight."""
        for k, frame in enumerate(self.keyframes):
            landmark = number[frame.landmark]
            if np.array_equal(landmark, frame.landmark):
                continue
            _, first = np.unique(landmark, return_index=True)
            rows = np.sort(first[landmark[first] >= 0])
            self._change(k, landmark=landmark[rows], uv=frame.uv[rows], disparity=frame.disparity[rows])

    def _cull_keyframes(self) -> None:
        """Drop keyframes before the window that show hardly anything that others do not; the first one stays.

        A keyframe goes if nine tenths of its landmarks are seen by three others (Mur-Artal et al. 2015), or if an
        older one looks from about there at the same: each place keeps a bounded number.
        """
        counts, frames = self._counts(), self.keyframes
        stays = np.ones(len(frames), np.bool_)
        for k in self._seen_by_the_window():
            replacement = None if k == 0 or frames[k].is_start else self._replacement(k, stays, counts)
            if replacement is not None:
                stays[k] = False
                counts[frames[k].landmark] -= 1
                T = inverse(frames[replacement].T_world_camera) @ frames[k].T_world_camera
                self.dropped.append((frames[k].index, frames[replacement].index, T))
        self.keyframes = [frame for frame, left in zip(frames, stays, strict=True) if left]

    def _seen_by_the_window(self) -> list[int]:
        """Keyframes before the window that see a landmark of it: others have not changed."""
        is_seen = np.zeros(len(self.xyz), np.bool_)
        for frame in self.keyframes[-self.window :]:
            is_seen[frame.landmark] = True
        return [k for k, frame in enumerate(self.keyframes[: -self.window]) if is_seen[frame.landmark].any()]

    def _replacement(self, k: int, stays: BoolArray, counts: NDArray[np.int64]) -> int | None:
        """Which older keyframe can stand for one, if that can go."""
        frame = self.keyframes[k]
        if (counts[frame.landmark] > _SEEN_ENOUGH).sum() >= _REDUNDANT * len(frame.landmark):
            return int(np.flatnonzero(stays[:k])[-1])
        T = frame.T_world_camera
        depth = np.median((self.xyz[frame.landmark] - T[:3, 3]) @ T[:3, 2])
        for other in np.flatnonzero(
            stays[: max(k - self.window, 0)]
        ).tolist():  # later ones are no place to come back to
            T_other = self.keyframes[other].T_world_camera
            near = np.linalg.norm(T_other[:3, 3] - T[:3, 3]) < _CLOSE * depth and T_other[:3, 2] @ T[:3, 2] > _SAME_WAY
            if near and np.isin(frame.landmark, self.keyframes[other].landmark).mean() >= _SHARED:
                return other
        return None

    def merge_landmarks(self, landmark: NDArray[np.int64], other: NDArray[np.int64]) -> None:
        """Make each landmark of `other` one with that of `landmark`, which stays where it is."""
        number = np.arange(len(self.xyz))
        number[other] = landmark
        self._relabel(number)

    def distribute_loop_error(self, place: int, T: FloatArray, T_world_camera: FloatArray) -> None:
        """Close a loop: a camera at `T_world_camera` is at ``T @ T_world_camera``, as keyframe number `place` knows.

        The keyframes since then take their share of T by the way they have come, and their landmarks go with them; a
        step that was guessed takes almost all. The next adjustment is of the whole map.
        """
        since = self.keyframes[place:]
        centres = np.array([frame.T_world_camera[:3, 3] for frame in since] + [T_world_camera[:3, 3]])
        guessed = np.array([frame.is_start for frame in since[1:]] + [False])
        way = np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1) + np.where(guessed, _GUESSED, _MIN_STEP))
        born = np.full(len(self.xyz), place)
        for k in range(len(self.keyframes) - 1, -1, -1):
            born[self.keyframes[k].landmark] = max(k, place)
        for k in range(place + 1, len(self.keyframes)):
            part = repeated(T, way[k - place - 1] / way[-1])
            self._change(k, T_world_camera=normalised(part @ self.keyframes[k].T_world_camera), is_start=False)
            self.xyz[born == k] = self.xyz[born == k] @ part[:3, :3].T + part[:3, 3]
        self.has_new_loop = True

    def adjustment(self) -> Callable[[], Adjustment] | None:
        """What will adjust the last keyframes and what they saw, held by older ones; `apply` takes its result.

        Of a map that was bent, all keyframes but the first. It works on copies, so the map can be used meanwhile.
        """
        if self.has_new_loop and len(self.keyframes) <= _MAX_AT_ONCE:
            return self._problem(self.keyframes, np.arange(len(self.xyz)), 1)
        moving = self.keyframes[-self.window :]
        if len(moving) < 2:
            return None
        is_seen = np.zeros(len(self.xyz), np.bool_)
        is_seen[np.concatenate([frame.landmark for frame in moving])] = True
        points = np.flatnonzero(is_seen)
        holding = [f for f in self.keyframes[: -self.window] if is_seen[f.landmark].sum() >= _MIN_SHARED]
        holding = holding or moving[:1]
        frames = holding + [frame for frame in moving if frame is not holding[0] or len(holding) > 1]
        return self._problem(frames, points, len(holding))

    def adjust_whole(self) -> None:
        """Adjust all keyframes but the first, and all landmarks, at once; maps of very many keyframes stay."""
        if 2 <= len(self.keyframes) <= _MAX_AT_ONCE:
            work = self._problem(self.keyframes, np.arange(len(self.xyz)), 1)
            if work is not None:
                found = work()
                self.apply(found)
                self.offset.settle(found.offset, found.offset_std)

    def _problem(self, frames: list[Keyframe], points: NDArray[np.int64], held: int) -> Callable[[], Adjustment] | None:
        """Adjustment of frames, the first `held` of which stay, and of the points that two of them see."""
        landmark = np.concatenate([frame.landmark for frame in frames])
        pose = np.repeat(np.arange(len(frames)), [len(frame.landmark) for frame in frames])
        counts = np.bincount(landmark, minlength=len(self.xyz))
        kept = points[counts[points] >= 2]
        if len(kept) < _MIN_POINTS:
            return None
        row = np.full(len(self.xyz), -1)
        row[kept] = np.arange(len(kept))
        used = np.flatnonzero(row[landmark] >= 0)
        uv = np.concatenate([frame.uv for frame in frames])[used]
        disparity = np.concatenate([frame.disparity for frame in frames])[used]
        ones = np.ones(len(used))
        seen = Observations(pose[used], row[landmark[used]], uv, disparity, SIGMA * ones, self.sigma_disparity * ones)
        self._asked = frames, kept, pose, used
        T, xyz, fixed = np.stack([f.T_world_camera for f in frames]), self.xyz[kept], np.arange(len(frames)) < held
        offset, sigma = self.offset.value, self.offset.sigma
        return lambda: adjust(self.rig, T, xyz, seen, fixed=fixed, max_steps=_STEPS, offset=offset, offset_sigma=sigma)

    def apply(self, found: Adjustment) -> None:
        """Take over what the last `adjustment` found, and drop outliers."""
        frames, kept, pose, used = self._asked
        self.xyz[kept] = found.xyz
        good = np.ones(len(pose), np.bool_)
        good[used[found.distance > _OUTLIER]] = False
        place = {frame.index: k for k, frame in enumerate(self.keyframes)}
        parts = np.split(good, np.searchsorted(pose, np.arange(1, len(frames))))
        for frame, T, stays in zip(frames, found.T_world_camera, parts, strict=True):
            k = place[frame.index]
            observations = {name: getattr(frame, name)[stays] for name in ("landmark", "uv", "disparity")}
            self._change(k, T_world_camera=T, **observations)
        self.offset.update(found.offset, found.offset_std)
