"""Which of several poses is believed, if any: by the share of landmarks in view that agree, and by where these are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....types import FloatArray, Rig
from ...rig import project
from ..pose import PoseEstimate, Rival, distances_to_sights
from ..tracking import TrackingSettings

_APART = 3.0  # px: ten times the spread of a tracked point
_PLACES = 32  # across the image: a place is as wide as the spacing of landmarks
_FLAT = 0.2  # of depth, in its logarithm, below which a thing counts as flat: a wall is a world, too
_DEPTHS = (0.1, 0.9)  # quantiles between which depths count
# Of the support of the pose that is believed: chosen on 40 starts behind a car, where right first steps have rivals of
# up to 0.83 of it, and on eight drives without one, where there is none above it.
_DOUBT = 0.3
# The next six by hand, on first steps behind a vehicle in synthetic streets of seeds 0 and 1.
_PARTS = 8  # across the image: each holds a dozen of 600 landmarks
_FEW = 4  # landmarks that tell of a part of the image
_STRAY = 0.1  # of the landmarks in a part, at most, that agree by chance with a pose that is not theirs
_MISSED = 0.1  # of the landmarks elsewhere that a right pose a short step on may lack: 0.00 to 0.06 in rooms, streets
_TURN = 0.05  # rad, standard deviation of an unknown turn: how far patches reach from where a motion is looked for
_AWAY = 0.25  # of the landmarks' distance, the same of its way: the farthest guess ahead, 0.2, and that reach


def is_clear(
    estimate: PoseEstimate, xyz: FloatArray, T_predicted: FloatArray | None, settings: TrackingSettings
) -> bool:
    """Whether a pose needs no second opinion: many landmarks agree, or some, and a constant velocity leads there.

    Parameters
    ----------
    estimate : PoseEstimate
        The pose.
    xyz : (M, 3) float64
        All landmarks, m.
    T_predicted : (4, 4) float64 or None
        Pose that a constant velocity leads to; None where the last motion is not known.
    settings : TrackingSettings
        Shares.

    Returns
    -------
    bool
    """
    if estimate.share >= settings.clear_share:
        return True
    is_steady = T_predicted is not None and are_close(estimate, T_predicted, xyz, settings)
    return is_steady and estimate.share >= settings.steady_share


def are_close(estimate: PoseEstimate, T_world_camera: FloatArray, xyz: FloatArray, settings: TrackingSettings) -> bool:
    """Whether a pose is where another one has the camera, to the distance of poses that count as the same.

    Parameters
    ----------
    estimate : PoseEstimate
        The pose.
    T_world_camera : (4, 4) float64
        The other.
    xyz : (M, 3) float64
        All landmarks, m.
    settings : TrackingSettings
        With `same_pose`.

    Returns
    -------
    bool
    """
    return _distance(estimate, T_world_camera, xyz) <= settings.same_pose


def choose_pose(
    tracked: PoseEstimate | None, relocalized: PoseEstimate | None, xyz: FloatArray, settings: TrackingSettings
) -> PoseEstimate | None:
    """Choose between the pose tracked from a guess and the one that descriptors led to; None if neither is believed.

    A camera that moved farther than patches are looked for finds a few landmarks near any guess, so a pose needs enough
    of those in view. Where both have enough, descriptors must lead to many more: they may be those of a moving object.
    Where descriptors lead elsewhere, to fewer landmarks than were found near the guess, neither is believed.

    Parameters
    ----------
    tracked, relocalized : PoseEstimate or None
        The two.
    xyz : (M, 3) float64
        All landmarks, m.
    settings : TrackingSettings
        Shares.

    Returns
    -------
    PoseEstimate or None
    """
    least = 0
    if tracked is not None:
        is_confirmed = relocalized is not None and are_close(tracked, relocalized.T_world_camera, xyz, settings)
        if tracked.share < (settings.relocalized_share if is_confirmed else settings.lone_share):
            least = 0 if is_confirmed else len(tracked)
            tracked = None
    if relocalized is not None and (relocalized.share < settings.relocalized_share or len(relocalized) < least):
        relocalized = None
    if tracked is None or relocalized is None:
        return relocalized if tracked is None else tracked
    return relocalized if len(relocalized) >= settings.overrule * len(tracked) else tracked


def choose_widest(
    rig: Rig, found: Sequence[PoseEstimate], xyz: FloatArray, settings: TrackingSettings
) -> PoseEstimate | None:
    """Choose among poses of which none is expected: the one whose landmarks are many and wide apart; None if too few.

    What moves before the camera has its landmarks in one part of the image, the world is around it; what is far away
    agrees with both. So of two poses, the landmarks that only one of them has in their places decide. Where that is a
    near thing, the other one stays as the `rival` of the pose.

    Parameters
    ----------
    rig : Rig
        The camera.
    found : sequence of PoseEstimate
        The poses.
    xyz : (M, 3) float64
        All landmarks, m.
    settings : TrackingSettings
        Shares.

    Returns
    -------
    PoseEstimate or None
        One with the share of landmarks that a pose needs alone (`lone_share`), or `relocalized_share` where another of
        the poses says the same.
    """

    def is_believed(one: PoseEstimate) -> bool:
        others = (other for other in found if other is not one and other.share >= settings.relocalized_share)
        is_confirmed = any(are_close(one, other.T_world_camera, xyz, settings) for other in others)
        return one.share >= (settings.relocalized_share if is_confirmed else settings.lone_share)

    best = None
    for one in filter(is_believed, found):
        if best is None or _support(rig, one, best, xyz) > _support(rig, best, one, xyz):
            best = one
    return None if best is None else with_rival(rig, best, found, xyz, settings)


def with_rival(
    rig: Rig, best: PoseEstimate, found: Sequence[PoseEstimate], xyz: FloatArray, settings: TrackingSettings
) -> PoseEstimate:
    """Note beside a pose another one that may be the right one: the likeliest, by its share of the support of the two.

    Parameters
    ----------
    rig : Rig
        The camera.
    best : PoseEstimate
        The pose.
    found : sequence of PoseEstimate
        The others; it may be among them.
    xyz : (M, 3) float64
        All landmarks, m.
    settings : TrackingSettings
        Shares.

    Returns
    -------
    PoseEstimate
        The pose, with its `rival`; the one that it has stays where none is likelier.
    """
    rival = best.rival
    for one in found:
        if one.share < settings.relocalized_share or are_close(best, one.T_world_camera, xyz, settings):
            continue
        own, other = _support(rig, one, best, xyz), _support(rig, best, one, xyz)
        if own > _DOUBT * other and (rival is None or own / (own + other) > rival.probability):
            rival = Rival(one.T_world_camera, len(one), own / (own + other), one.covariance)
    return best if rival is best.rival else replace(best, rival=rival)


def with_unknown(
    rig: Rig, best: PoseEstimate, rows: NDArray[np.int64], xyz: FloatArray, settings: TrackingSettings
) -> PoseEstimate:
    """Note beside a pose that what is around its landmarks moves otherwise, though nobody knows how.

    That can only be said of a pose that was found among the landmarks in question: one that older keyframes led to was
    never tried on those of the last ones, and stays as it is.

    Before a vehicle that fills the view, too little of the world may be left to tell its motion. But after so short a
    step a pose agrees with nearly all that is in view, wherever it agrees at all; so parts of the image where nothing
    agrees with it are no chance. Where these are wide and deep beside it, as the world is behind a vehicle, the
    pose stays open.

    Parameters
    ----------
    rig : Rig
        The camera.
    best : PoseEstimate
        The pose.
    rows : (R,) int64
        Landmarks that were looked for, if the pose is one of theirs.
    xyz : (M, 3) float64
        All landmarks, m.
    settings : TrackingSettings
        With `patch_radius`.

    Returns
    -------
    PoseEstimate
        The pose; its `rival` is as far away as motions are looked for, in any direction.
    """
    if best.rival is not None or not np.isin(best.landmark, rows).all():
        return best
    uv, depth, rows = _in_view(rig, best.T_world_camera, rows, xyz, 2.0 * settings.patch_radius)
    agrees = np.isin(rows, best.landmark)
    if not agrees.any():
        return best
    cell = np.floor(uv * (_PARTS / rig.width)).astype(np.int64)
    _, part = np.unique(cell[:, 1] * _PARTS + cell[:, 0], return_inverse=True)
    count, agreeing = np.bincount(part), np.bincount(part, agrees)
    is_out = ((count >= _FEW) & (agreeing <= _STRAY * count))[part]
    left = is_out & ~agrees
    if left.sum() < settings.min_matches or agrees[~is_out].sum() < (1 - _MISSED) * (~is_out).sum():
        return best
    own, other = (len(_places(rig, uv[some])) * _depth_spread(depth[some]) for some in (left, agrees))
    if own <= _DOUBT * other:
        return best
    far = np.array([_TURN] * 3 + [_AWAY * float(np.median(depth[left]))] * 3)
    rival = Rival(best.T_world_camera, int(left.sum()), own / (own + other), np.diag(far**2))
    return replace(best, rival=rival)


def _in_view(
    rig: Rig, T: FloatArray, rows: NDArray[np.int64], xyz: FloatArray, margin: float
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Places, px, and depths, m, of landmarks that a camera has in view, and their rows."""
    camera = (xyz[rows] - T[:3, 3]) @ T[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = project(rig, camera)
        inside = ((uv >= margin) & (uv <= np.array([rig.width, rig.height]) - margin)).all(axis=1)
    inside &= camera[:, 2] > 0
    return uv[inside], camera[inside, 2], rows[inside]


def _support(rig: Rig, one: PoseEstimate, other: PoseEstimate, xyz: FloatArray) -> float:
    """Places of the image with landmarks that one pose has where they are, another not, times how far they spread.

    Over the image, in places, and in depth, in its logarithm: a vehicle is flat beside the street around it.
    """
    is_own = ~(distances_to_sights(rig, other.T_world_camera, xyz[one.landmark], one.uv) <= _APART)
    T, cells = one.T_world_camera, _places(rig, one.uv[is_own])
    if len(cells) < 3:
        return 0.0
    deep = _depth_spread((xyz[one.landmark[is_own]] - T[:3, 3]) @ T[:3, 2])
    return float(len(cells) * deep * np.sqrt(max(np.linalg.det(np.cov(cells.T)), 0.0)))


def _places(rig: Rig, uv: FloatArray) -> FloatArray:
    """Places of the image with landmarks."""
    return np.unique(np.floor(uv * (_PLACES / rig.width)), axis=0)


def _depth_spread(depth: FloatArray) -> float:
    """How far landmarks spread in depth, in its logarithm."""
    nearest, farthest = np.quantile(depth, _DEPTHS)
    return max(_FLAT, float(np.log(farthest / nearest)))


def _distance(estimate: PoseEstimate, T_world_camera: FloatArray, xyz: FloatArray) -> float:
    """How far a pose is from another, m per m of depth of its landmarks in the median."""
    T = estimate.T_world_camera
    depth = float(np.median((xyz[estimate.landmark] - T[:3, 3]) @ T[:3, 2]))
    return float(np.linalg.norm((T_world_camera - estimate.T_world_camera)[:3, 3])) / depth
