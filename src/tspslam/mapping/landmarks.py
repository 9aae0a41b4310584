"""Landmarks of the map: observations joined, places found anew with the keyframes held, outliers dropped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from ..errors import GeometryError
from ..types import BoolArray, FloatArray, Rig
from ..vision.slam.least_squares.bundle import Observations, adjust
from .settings import ObservationSettings
from .views import Rows, Sightings, join_sightings

_STEPS = 6, 4  # of each adjustment, before and after outliers are dropped
_LEAST = 2  # keyframes that must see a landmark


class Landmarks(NamedTuple):
    """Landmarks and their observations.

    Attributes
    ----------
    id : (N,) int64
        Numbers, ascending.
    xyz : (N, 3) float64
        Places, m.
    seen : Sightings
        Observations by landmark, then by keyframe; each keyframe sees a landmark at most once.
    """

    id: NDArray[np.int64]
    xyz: FloatArray
    seen: Sightings

    def __repr__(self) -> str:
        return brief(self)

    def keep(self, is_kept: NDArray[np.bool_]) -> Landmarks:
        """Return some of the landmarks, with their observations.

        Parameters
        ----------
        is_kept : (N,) bool
            Which.

        Returns
        -------
        Landmarks
        """
        new = np.cumsum(is_kept) - 1
        seen = self.seen.take(is_kept[self.seen.landmark])
        return Landmarks(self.id[is_kept], self.xyz[is_kept], seen._replace(landmark=new[seen.landmark]))


def join_observations(
    known: Sightings, found: Sightings, count: int, views: int, settings: ObservationSettings
) -> Sightings:
    """Join what was found to what the keyframes know: landmarks seen in one place, at one depth, become one.

    What is found where a keyframe knows another landmark at another depth is dropped.

    Parameters
    ----------
    known, found : Sightings
        In the order of the keyframes.
    count, views : int
        Number of landmarks, and of keyframes.
    settings : ObservationSettings
        What counts as one place.

    Returns
    -------
    Sightings
        By landmark, then by keyframe; of landmarks that became one, the first one's row.
    """
    from . import _tracks

    pairs, rest = [np.empty((0, 2), np.int64)], []
    for sights, those in zip(found.split(views), known.split(views), strict=True):
        same, new = _compare(sights, those, settings)
        pairs.append(same)
        rest.append(new)
    both = join_sightings([known, *rest])
    both = both.take(np.lexsort((both.keyframe, both.landmark)))
    start = np.searchsorted(both.landmark, np.arange(count + 1))
    one = _tracks.unite(np.concatenate(pairs), start, both.keyframe, both.uv, settings.same_place)
    joined = both._replace(landmark=one[both.landmark])
    joined = joined.take(np.lexsort((np.isnan(joined.disparity), joined.keyframe, joined.landmark)))
    is_first = (np.diff(joined.landmark, prepend=-1) != 0) | (np.diff(joined.keyframe, prepend=-1) != 0)
    return joined.take(is_first)


def _compare(sights: Sightings, known: Sightings, settings: ObservationSettings) -> tuple[Rows, Sightings]:
    """Pairs of landmarks that are one in a keyframe; what was found where it knows none, without a disparity."""
    from scipy.spatial import cKDTree

    if not len(known.landmark) or not len(sights.landmark):
        return np.empty((0, 2), np.int64), sights._replace(disparity=np.full(len(sights.landmark), np.nan))
    away, nearest = map(np.asarray, cKDTree(known.uv).query(sights.uv, distance_upper_bound=settings.same_place))
    is_near = np.isfinite(away)
    nearest = np.where(is_near, nearest, 0)
    is_same = is_near & (np.abs(known.disparity[nearest] - sights.disparity) <= settings.same_disparity)
    new = sights.take(~is_near)
    pairs = np.column_stack([sights.landmark[is_same], known.landmark[nearest[is_same]]])
    return pairs, new._replace(disparity=np.full(len(new.landmark), np.nan))


def place_landmarks(
    rig: Rig, T_world_camera: FloatArray, id_: NDArray[np.int64], xyz: FloatArray, seen: Sightings,
    settings: ObservationSettings,
) -> Landmarks:  # fmt: skip
    """Adjust the landmarks that two keyframes see, the keyframes held, and drop outliers.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (K, 4, 4) float64
        Poses of the keyframes.
    id_ : (M,) int64
        Numbers of the landmarks, ascending.
    xyz : (M, 3) float64
        Where they are thought to be, m.
    seen : Sightings
        By landmark, then by keyframe.
    settings : ObservationSettings
        Standard deviations, and what an outlier is.

    Returns
    -------
    Landmarks
        Those that two keyframes still see.
    """
    for steps in _STEPS:
        count = np.bincount(seen.landmark, minlength=len(id_))
        seen = seen.take(count[seen.landmark] >= _LEAST)
        if not len(seen.landmark):
            break
        rows, point = np.unique(seen.landmark, return_inverse=True)
        ones = np.ones(len(point))
        sigmas = settings.sigma_uv * ones, settings.sigma_disparity * ones
        data = Observations(seen.keyframe, point, seen.uv, seen.disparity, *sigmas)
        is_held = np.ones(len(T_world_camera), np.bool_)
        found = adjust(rig, T_world_camera, xyz[rows], data, fixed=is_held, max_steps=steps)
        xyz = xyz.copy()
        xyz[rows] = found.xyz
        seen = seen.take(_agreeing(found.distance <= settings.outlier, seen.keyframe, settings.min_agreement))
    count = np.bincount(seen.landmark, minlength=len(id_))
    return Landmarks(id_, xyz, seen).keep(count >= _LEAST)


def _agreeing(is_near: BoolArray, keyframe: Rows, least: float) -> BoolArray:
    """Observations that are no outliers, of keyframes most of whose are none."""
    agreeing, every = np.bincount(keyframe, is_near), np.bincount(keyframe)
    return is_near & (agreeing >= least * every)[keyframe]


def measure_covariances(
    rig: Rig, T_world_camera: FloatArray, landmarks: Landmarks, settings: ObservationSettings
) -> tuple[Landmarks, FloatArray]:
    """Find the covariance of each landmark, the keyframes held, and drop those whose place is hardly known.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (K, 4, 4) float64
        Poses of the keyframes.
    landmarks : Landmarks
        And all their observations.
    settings : ObservationSettings
        Standard deviations, and what a place needs.

    Returns
    -------
    landmarks : Landmarks
        N that have a place.
    covariance : (N, 3, 3) float64
        Inverse of the information of all their observations, m².

    Raises
    ------
    GeometryError
        If there is none.
    """
    seen, n = landmarks.seen, len(landmarks.xyz)
    T, points = T_world_camera[seen.keyframe], landmarks.xyz[seen.landmark]
    x, y, z = np.einsum("oji,oj->io", T[:, :3, :3], points - T[:, :3, 3])
    nothing = np.zeros_like(z)
    J = np.array([
        [rig.fx / z, rig.skew / z, -(rig.fx * x + rig.skew * y) / z**2],
        [nothing, rig.fy / z, -rig.fy * y / z**2],
        [nothing, nothing, -rig.fx * rig.baseline / z**2],
    ]).transpose(2, 0, 1) / np.array([settings.sigma_uv] * 2 + [settings.sigma_disparity])[:, None]  # fmt: skip
    J[np.isnan(seen.disparity), 2] = 0
    J = J @ T[:, :3, :3].transpose(0, 2, 1)
    products = np.einsum("oki,okj->oij", J, J).reshape(-1, 9)
    information = np.stack([np.bincount(seen.landmark, column, minlength=n) for column in products.T], axis=1)
    information, depth = information.reshape(n, 3, 3), np.full(n, np.inf)
    np.minimum.at(depth, seen.landmark, z)
    is_known = (
        np.linalg.eigvalsh(information)[:, 0] * (settings.max_sigma * depth) ** 2 >= 1 if n else np.empty(0, bool)
    )
    if not is_known.any():
        wanted = f"some to {settings.max_sigma:g} of their depth (mapping.observe.max_sigma)"
        raise GeometryError(
            f"map: {n} landmarks are seen by two keyframes or more, the place of none is known; expected {wanted}"
        )
    return landmarks.keep(is_known), np.linalg.inv(information[is_known])


def depth_sigmas(covariance: FloatArray, rows: Rows, directions: FloatArray) -> FloatArray:
    """Standard deviation of landmarks along directions.

    Parameters
    ----------
    covariance : (N, 3, 3) float64
        Of all landmarks, m².
    rows : (O,) int64
        Which landmarks.
    directions : (O, 3) float64
        Unit vectors.

    Returns
    -------
    (O,) float64
        m.
    """
    return np.sqrt(np.einsum("oi,oij,oj->o", directions, covariance[rows], directions))
