"""What is adjusted together: keyframes, the landmarks that they see, and the keyframes that hold them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....types import BoolArray, FloatArray, Rig
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..least_squares.bundle import Adjustment, Observations, adjust
from .new_landmarks import follow_keyframes


@dataclass(frozen=True, repr=False)
class AdjustmentProblem(Brief):
    """Keyframes and landmarks of a map to adjust, copied, so that the map can be used meanwhile.

    Attributes
    ----------
    frames : tuple of Keyframe
        K keyframes.
    fixed : (K,) bool
        Those whose poses stay.
    landmark_id : (P,) int64
        Numbers of the landmarks: their rows may move meanwhile.
    xyz : (P, 3) float64
        Where they are, m.
    used : (O,) int64
        Rows of all observations of the keyframes, one keyframe after another, that are of these landmarks.
    seen : Observations
        These.
    """

    frames: tuple[Keyframe, ...]
    fixed: BoolArray
    landmark_id: NDArray[np.int64]
    xyz: FloatArray
    used: NDArray[np.int64]
    seen: Observations

    @property
    def moving(self) -> list[int]:
        """Numbers of the frames whose poses are adjusted."""
        return [frame.index for frame, stays in zip(self.frames, self.fixed, strict=True) if not stays]

    def solve(self, rig: Rig, offset: float, offset_sigma: float | None, max_steps: int) -> Adjustment:
        """Adjust the keyframes, the landmarks and the offset of the disparities.

        Parameters
        ----------
        rig : Rig
            The cameras as calibrated.
        offset : float
            Offset to start from, px.
        offset_sigma : float or None
            Its standard deviation before anything is seen, px; None where it stays.
        max_steps : int
            Steps at most.

        Returns
        -------
        Adjustment

        Raises
        ------
        GeometryError
            If the observations do not fix the keyframes.
        """
        T = np.stack([frame.T_world_camera for frame in self.frames])
        return adjust(
            rig, T, self.xyz, self.seen, fixed=self.fixed, max_steps=max_steps, offset=offset, offset_sigma=offset_sigma
        )

    def apply(self, map_: Map, found: Adjustment) -> None:
        """Take over poses and landmarks, and drop outliers; what one keyframe alone saw goes with it.

        Parameters
        ----------
        map_ : Map
            Changed; its landmarks may have moved to other rows since.
        found : Adjustment
            What `solve` gave.
        """
        rows, settings = np.searchsorted(map_.landmark_id, self.landmark_id), map_.settings
        before = list(map_.keyframes)
        map_.apply(rows, found, self.inliers(found, settings.outlier))
        follow_keyframes(map_, rows, before, settings.left_behind * float(self.seen.sigma_uv[0]))

    def inliers(self, found: Adjustment, outlier: float) -> dict[int, tuple[int | None, BoolArray]]:
        """Tell which observations stay, of each keyframe that moves or loses some.

        Parameters
        ----------
        found : Adjustment
            What `solve` gave.
        outlier : float
            Standard deviations beyond which an observation goes.

        Returns
        -------
        dict of int to (int or None, (K,) bool)
            By the number of each frame: its row in the adjustment, None if it was held; which observations stay.
        """
        ends = np.cumsum([len(frame.landmark) for frame in self.frames])
        good = np.ones(ends[-1], np.bool_)
        good[self.used[found.distance > outlier]] = False
        parts = enumerate(zip(self.frames, self.fixed, np.split(good, ends[:-1]), strict=True))
        return {f.index: (None if held else k, part) for k, (f, held, part) in parts if not (held and part.all())}


def window_of(map_: Map) -> list[int]:
    """Find the last keyframes of a map, which are adjusted after each keyframe.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.

    Returns
    -------
    list of int
        Their places.
    """
    return list(range(max(len(map_.keyframes) - map_.window, 0), len(map_.keyframes)))


def choose_piece(map_: Map, frames: set[int], size: int, *, last: int) -> list[int]:
    """Choose keyframes to adjust next: the newest, and those that see most of what it sees, and so on.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    frames : set of int
        Numbers of the frames to choose from; the first keyframe is not chosen.
    size : int
        How many at most.
    last : int
        Keyframes at the end of the map that are not chosen.

    Returns
    -------
    list of int
        Places, ascending.
    """
    count = len(map_.keyframes) - last
    wanted = {k for k in range(1, count) if map_.keyframes[k].index in frames}
    chosen: list[int] = []
    while wanted and len(chosen) < size:
        queue = deque([max(wanted)])
        while queue and len(chosen) < size:
            place = queue.popleft()
            wanted.discard(place)
            chosen.append(place)
            near = sorted(map_.covisible(place), key=lambda found: (-found[1], -found[0]))
            queue.extend(k for k, _ in near if k in wanted and k not in queue)
    return sorted(chosen)


def collect_problem(map_: Map, moving: Sequence[int], sigma_uv: float) -> AdjustmentProblem | None:
    """Collect what to adjust: keyframes and what they see, held by the others that see it too.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    moving : sequence of int
        Places of the keyframes, ascending; of each part of the map that no other keyframe holds, the first is held.
    sigma_uv : float
        Standard deviation of a tracked point, px.

    Returns
    -------
    AdjustmentProblem or None
        None where there is too little to adjust.
    """
    rows = np.unique(np.concatenate([map_.keyframes[k].landmark for k in moving]))
    held = _holding(map_, moving, rows)
    is_held = {map_.keyframes[k].part for k in held}
    first = {map_.keyframes[k].part: k for k in reversed(moving)}
    held += sorted(k for part, k in first.items() if part not in is_held)
    places = [*held, *sorted(set(moving) - set(held))]
    return _problem(map_, [map_.keyframes[k] for k in places], rows, len(held), sigma_uv) if len(places) > 1 else None


def _holding(map_: Map, moving: Sequence[int], rows: NDArray[np.int64]) -> list[int]:
    """Places of the other keyframes that see enough of the landmarks."""
    numbers, shared = np.unique(map_.sightings.of(rows)[1], return_counts=True)
    likely = [map_.place_of(number) for number in numbers[shared >= map_.settings.min_shared].tolist()]
    own = set(moving)
    return [k for k in likely if k not in own]


def _find(rows: NDArray[np.int64], landmark: NDArray[np.int64]) -> tuple[BoolArray, NDArray[np.int64]]:
    """Which landmarks are among ascending rows, and where."""
    at = np.searchsorted(rows, landmark)
    at[at == len(rows)] = 0
    return (rows[at] == landmark) if len(rows) else np.zeros(len(landmark), np.bool_), at


def _problem(
    map_: Map, frames: Sequence[Keyframe], rows: NDArray[np.int64], held: int, sigma_uv: float
) -> AdjustmentProblem | None:
    """Adjustment of frames, the first `held` of which stay, and of the landmarks that two of them see."""
    landmark = np.concatenate([frame.landmark for frame in frames])
    pose = np.repeat(np.arange(len(frames)), [len(frame.landmark) for frame in frames])
    is_there, at = _find(rows, landmark)
    is_twice = np.bincount(at[is_there], minlength=len(rows)) >= 2
    if is_twice.sum() < map_.settings.min_points:
        return None
    used = np.flatnonzero(is_there & is_twice[at])
    point = (np.cumsum(is_twice) - 1)[at[used]]
    uv = np.concatenate([frame.uv for frame in frames])[used]
    disparity, sigma = (np.concatenate([getattr(f, name) for f in frames])[used] for name in ("disparity", "sigma"))
    seen = Observations(pose[used], point, uv, disparity, np.full(len(used), sigma_uv), sigma)
    kept, fixed = rows[is_twice], np.arange(len(frames)) < held
    return AdjustmentProblem(tuple(frames), fixed, map_.landmark_id[kept], map_.xyz[kept], used, seen)
