"""Landmarks found again by their patches in keyframes that did not track them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..types import BoolArray, FloatArray, Rig
from ..vision.images import Pyramid, are_usable, find_usable, smooth_plane
from ..vision.rig import project
from ..vision.se3 import inverse
from ..vision.slam.patch_tracking import compute_warps, track_patches
from ..vision.slam.tracking import TrackingSettings
from .settings import ObservationSettings
from .views import Rows, Sightings, View, join_sightings, to_camera

_MAX_ZOOM = 3.0  # a patch so much nearer or farther is another one
_ALIKE, _NEAR = 0.7, 0.5  # cosine between the views, distance over depth: of keyframes that may see one place


def find_again(
    views: Sequence[View], rig: Rig, xyz: FloatArray, known: Sightings, settings: ObservationSettings
) -> Sightings:
    """Look for landmarks in the keyframes that should see them and did not track them.

    The patch around an observation, warped as the poses say, is aligned near where the landmark's place has it. Each
    landmark is followed from keyframe to keyframe, both ways, until it is missed; then keyframes of other passes are
    looked at.

    Parameters
    ----------
    views : sequence of View
        K keyframes, in order.
    rig : Rig
        The cameras.
    xyz : (M, 3) float64
        Landmarks, m.
    known : Sightings
        What is known, in the order of the keyframes.
    settings : ObservationSettings
        How far to look.

    Returns
    -------
    Sightings
        What was found besides; disparities are those of the landmarks' places.
    """
    return _Search(views, rig, xyz, known, settings).run()


class _Search:
    def __init__(
        self, views: Sequence[View], rig: Rig, xyz: FloatArray, known: Sightings, settings: ObservationSettings
    ) -> None:
        self._rig, self._xyz, self._settings, self._known = rig, xyz, settings, known.split(len(views))
        self._views, self._planes = views, dict[int, Pyramid]()
        self._shape = rig.height, rig.width
        self._T = np.array([view.T_world_camera for view in views])
        self._patch = replace(
            TrackingSettings().patch, radius=settings.radius, reach=settings.reach,
            min_correlation=settings.min_correlation,
        )  # fmt: skip
        self._seen = [sights.landmark for sights in self._known]
        self._found: list[Sightings] = []

    def run(self) -> Sightings:
        order = range(len(self._T))
        self._follow(order)
        self._follow(order[::-1])
        for k in order if self._settings.revisits else ():
            places = self._other_passes(k)
            if places:
                self._look(k, places, np.ones(len(self._xyz), np.bool_))
        found = join_sightings(self._found)
        return found.take(np.argsort(found.keyframe, kind="stable"))

    def _follow(self, order: range) -> None:
        """Follow each landmark from keyframe to keyframe, until it is missed some times in a row."""
        missed = np.full(len(self._xyz), self._settings.misses)
        for place, k in enumerate(order):
            missed += 1
            near = order[max(place - self._settings.neighbours, 0) : place][::-1]
            found = self._look(k, near, missed <= self._settings.misses)
            missed[found], missed[self._seen[k]] = 0, 0

    def _other_passes(self, k: int) -> list[int]:
        """Keyframes that are near in space and far in time, and look the same way, nearest first."""
        centre, ahead, landmark = self._T[:, :3, 3], self._T[:, :3, 2], self._known[k].landmark
        if not len(landmark):
            return []
        depth = float(np.median(to_camera(self._xyz[landmark], self._T[k])[:, 2]))
        away = np.linalg.norm(centre - centre[k], axis=1)
        is_other = np.abs(np.arange(len(centre)) - k) > self._settings.neighbours
        near = np.flatnonzero(is_other & (ahead @ ahead[k] > _ALIKE) & (away < _NEAR * depth))
        return near[np.argsort(away[near], kind="stable")][: self._settings.revisits].tolist()

    def _look(self, k: int, sources: Sequence[int], is_wanted: BoolArray) -> Rows:
        """Look in a keyframe for landmarks that others know, each until it is found."""
        is_wanted = is_wanted.copy()
        is_wanted[self._seen[k]] = False
        found = []
        for source in sources:
            rows = np.flatnonzero(is_wanted[self._known[source].landmark])
            if len(rows):
                found.append(self._track(source, k, rows))
                is_wanted[found[-1].landmark] = False
        together = join_sightings(found)
        self._found.append(together)
        self._seen[k] = np.concatenate([self._seen[k], together.landmark])
        return together.landmark

    def _plane(self, k: int) -> Pyramid:
        """A smoothed image; the last ones that were asked for are kept."""
        plane = self._planes.pop(k, None)
        plane = self._read(k) if plane is None else plane
        self._planes[k] = plane
        if len(self._planes) > self._settings.neighbours + self._settings.revisits + 1:
            del self._planes[next(iter(self._planes))]
        return plane

    def _read(self, k: int) -> Pyramid:
        image = self._views[k].image
        if image.shape[:2] != self._shape:
            what = f"keyframe {self._views[k].number}: its image is {image.shape[1]} x {image.shape[0]} px"
            raise InputError(f"{what}, expected the rig's {self._shape[1]} x {self._shape[0]}")
        valid = self._views[k].valid
        return Pyramid((smooth_plane(image),), None if valid is None else find_usable(valid))

    def _track(self, source: int, k: int, rows: Rows) -> Sightings:
        """Find some of what one keyframe knows in another."""
        rig, known, T = self._rig, self._known[source].take(rows), self._T
        points = self._xyz[known.landmark]
        before, now = to_camera(points, T[source]), to_camera(points, T[k])
        with np.errstate(divide="ignore", invalid="ignore"):
            guess, zoom = project(rig, now), before[:, 2] / now[:, 2]
            is_inside = ((guess >= 0) & (guess <= (rig.width - 1, rig.height - 1))).all(axis=1)
        good = np.flatnonzero((now[:, 2] > 0) & (zoom < _MAX_ZOOM) & (zoom * _MAX_ZOOM > 1) & is_inside)
        known, guess, now = known.take(good), guess[good], now[good]
        warp = compute_warps(rig, inverse(T[k]) @ T[source], before[good])
        planes = self._plane(source), self._plane(k)
        uv, is_found = track_patches(*planes, known.uv, warp, guess, range(1), self._patch)
        is_found &= np.linalg.norm(uv - guess, axis=1) <= self._settings.reach
        is_found &= are_usable(planes[1].usable, uv)
        disparity = rig.fx * rig.baseline / now[:, 2] - rig.doffs
        return Sightings(known.landmark, np.full(len(good), k), uv, disparity).take(is_found)
