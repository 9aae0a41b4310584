"""Which keyframes see which landmark: what the path knows, keypoints that it did not keep, and patches found again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._settings import Checked, setting
from ..types import BoolArray, FloatArray, Rig
from ..vision.images import Pyramid, smooth_plane
from ..vision.rig import back_project, project
from ..vision.se3 import inverse
from ..vision.slam.patch_tracking import Patch, compute_warps, track_patches
from .views import View

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class ObserveSettings(Checked, what="mapping.observe"):
    neighbours: int = setting(8, 1, 100, unit="keyframes", source="")
    revisits: int = setting(4, 0, 100, unit="keyframes", source="")
    reach: float = setting(2.0, 0.1, 20, unit="px", source="")
    min_correlation: float = setting(0.85, 0, 1, unit="", source="")
    radius: int = setting(5, 2, 20, unit="px", source="")
    same_place: float = setting(1.5, 0.1, 10, unit="px", source="")
    same_disparity: float = setting(1.0, 0.1, 10, unit="px", source="")
    misses: int = setting(2, 1, 10, unit="keyframes", source="")


class Sightings(NamedTuple):
    """One row for each sight of a landmark, keyframe after keyframe.

    landmark, keyframe: (O,) int64 rows; uv (O, 2) px; disparity (O,) px, NaN where not known.
    """

    landmark: Rows
    keyframe: Rows
    uv: FloatArray
    disparity: FloatArray

    def take(self, rows):
        return Sightings(*(column[rows] for column in self))

    @classmethod
    def join(cls, parts):
        return cls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def split(self, count: int) -> list[Sightings]:
        ends = np.searchsorted(self.keyframe, np.arange(count + 1))
        return [self.take(slice(a, b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]


class Search:
    """Landmarks looked for in the keyframes where their place says they are."""

    def __init__(self, views, rig: Rig, xyz: FloatArray, known: Sightings, settings: ObserveSettings) -> None:
        self.views, self.rig, self.xyz, self.settings = views, rig, xyz, settings
        self.known = known.split(len(views))
        self.planes = [Pyramid((smooth_plane(view.image),)) for view in views]
        self.T = np.stack([view.T_world_camera for view in views])
        self.patch = Patch(settings.radius, 0.03, settings.reach, settings.min_correlation)
        self.has = [np.zeros(0, np.int64)] * len(views)
        self.found: list[list[Sightings]] = [[] for _ in views]
        self.tried = 0

    def run(self) -> list[Sightings]:
        count = len(self.views)
        self._sweep(range(count))
        self._sweep(range(count - 1, -1, -1))
        if self.settings.revisits:
            self._revisit()
        nothing = Sightings(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0))
        return [Sightings.join([nothing, *parts]) for parts in self.found]

    def _sweep(self, order: range) -> None:
        """Follow each landmark from keyframe to keyframe, until it is missed some times in a row."""
        missed = np.full(len(self.xyz), self.settings.misses)
        for place, k in enumerate(order):
            seen = self._seen(k)
            missed += 1
            missed[seen] = 0
            active = missed <= self.settings.misses
            active[seen] = False
            sources = [order[j] for j in range(place - 1, max(place - 1 - self.settings.neighbours, -1), -1)]
            missed[self._look(k, sources, active)] = 0

    def _revisit(self) -> None:
        """Look for what other passes saw of a place."""
        centre, look = self.T[:, :3, 3], self.T[:, :3, 2]
        for k in range(len(self.views)):
            depth = np.median((self.xyz[self.known[k].landmark] - centre[k]) @ look[k]) if len(self.known[k].landmark) else 0
            away = np.linalg.norm(centre - centre[k], axis=1)
            other = np.abs(np.arange(len(centre)) - k) > self.settings.neighbours
            near = np.flatnonzero(other & (look @ look[k] > 0.7) & (away < 0.5 * depth))
            near = near[np.argsort(away[near], kind="stable")][: self.settings.revisits]
            if len(near):
                active = np.ones(len(self.xyz), np.bool_)
                active[self._seen(k)] = False
                self._look(k, near.tolist(), active)

    def _seen(self, k: int) -> Rows:
        return np.concatenate([self.known[k].landmark, *(part.landmark for part in self.found[k])])

    def _look(self, k: int, sources: list[int], active: BoolArray) -> Rows:
        """Look for active landmarks of some keyframes in another; those that are found are active no more."""
        done = []
        for source in sources:
            rows = np.flatnonzero(active[self.known[source].landmark])
            if len(rows):
                found = self._track(source, k, rows)
                active[found.landmark] = False
                self.found[k].append(found)
                done.append(found.landmark)
        return np.concatenate([np.empty(0, np.int64), *done])

    def _track(self, source: int, k: int, rows: Rows) -> Sightings:
        known, rig = self.known[source], self.rig
        landmark = known.landmark[rows]
        before, now = (self._in_camera(landmark, view) for view in (source, k))
        with np.errstate(divide="ignore", invalid="ignore"):
            guess, zoom = project(rig, now), before[:, 2] / now[:, 2]
            inside = (guess > 0).all(axis=1) & (guess < (rig.width - 1, rig.height - 1)).all(axis=1)
        good = np.flatnonzero((now[:, 2] > 0) & (zoom < 3) & (zoom > 1 / 3) & inside)
        warp = compute_warps(rig, inverse(self.T[k]) @ self.T[source], before[good])
        self.tried += len(good)
        start = guess[good] + self.shift
        uv, is_found = track_patches(
            self.planes[source], self.planes[k], known.uv[rows[good]], warp, start, range(1), self.patch
        )
        is_found &= np.linalg.norm(uv - start, axis=1) <= self.settings.reach
        n = int(is_found.sum())
        disparity = rig.fx * rig.baseline / now[good][is_found][:, 2] - rig.doffs
        return Sightings(landmark[good][is_found], np.full(n, k), uv[is_found], disparity)

    shift = (0.0, 0.0)

    def _in_camera(self, landmark: Rows, k: int) -> FloatArray:
        points: FloatArray = (self.xyz[landmark] - self.T[k, :3, 3]) @ self.T[k, :3, :3]
        return points


def keypoints_as_landmarks(views, rig, known: Sightings, spacing: float) -> tuple[FloatArray, Sightings]:
    """Keypoints with a depth that are no landmarks of the path: new ones, if they are apart from those."""
    from scipy.spatial import cKDTree

    xyz, parts, first = [], [], 0
    for k, (view, seen) in enumerate(zip(views, known.split(len(views)), strict=True)):
        rows = np.flatnonzero(view.disparity + rig.doffs > 1.5)
        if len(seen.uv):
            away, _ = cKDTree(seen.uv).query(view.uv[rows], distance_upper_bound=spacing)
            rows = rows[np.isinf(away)]
        T = view.T_world_camera
        xyz.append(back_project(rig, view.uv[rows], view.disparity[rows]) @ T[:3, :3].T + T[:3, 3])
        parts.append(Sightings(first + np.arange(len(rows)), np.full(len(rows), k), view.uv[rows], view.disparity[rows]))
        first += len(rows)
    return np.concatenate(xyz), Sightings.join(parts)


def associate(found: list[Sightings], known: Sightings, count: int, views: int, settings: ObserveSettings):
    """Join what was found to what each keyframe knows: the landmark that each landmark is, and the rest of what was found."""
    from scipy.spatial import cKDTree

    pairs, rest = [], []
    for sights, seen in zip(found, known.split(views), strict=True):
        if not len(sights.landmark) or not len(seen.landmark):
            rest.append(sights)
            continue
        away, near = cKDTree(seen.uv).query(sights.uv, distance_upper_bound=settings.same_place)
        is_near = np.isfinite(away)
        near = np.where(is_near, near, 0)
        off = np.abs(seen.disparity[near] - sights.disparity)
        same = is_near & (off <= settings.same_disparity)
        pairs.append(np.column_stack([sights.landmark[same], seen.landmark[near[same]]]))
        clash = is_near & (off > settings.same_disparity)
        left = sights.take(~same & ~clash)
        rest.append(left._replace(disparity=np.full(len(left.landmark), np.nan)))
    return np.concatenate([np.empty((0, 2), np.int64), *pairs]), Sightings.join(rest)
