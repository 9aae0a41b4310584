"""How far a camera path is from the true one: absolute and relative errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import require
from ..errors import InputError
from ..types import FloatArray, Trajectory, real_array
from .se3 import alignment, inverse, rotation_angle

_FARTHEST = 1e10  # m
_FEWEST = 2
_SLACK = 0.1  # of a distance, by which the nearest pair of poses may miss it
_ROTATION = 1e-3


@dataclass(frozen=True)
class TrajectoryErrors:
    """What `evaluate_trajectory` found.

    Attributes
    ----------
    ate_rmse_m : float
        Root mean square distance of positions after the best rigid motion, m.
    ate_sim3_rmse_m : float
        The same after the best motion and scale, m.
    scale : float
        That scale; 0.99 means that the estimate is 1 % too large.
    ate_m : (M,) float64
        The distance of each matched pose after the rigid motion, m.
    rpe_translation_m, rpe_rotation_deg : float
        Root mean square error of the motion from each matched pose to the next one.
    per_distance : dict of float to DistanceErrors
        Errors of the motion over each distance along the true path; distances longer than the path have no pairs.
    matched, total : int
        Poses of the estimate with a true one, and all of them.
    T_reference_estimate : (4, 4) float64
        The rigid motion.
    estimate, reference : (M, 3) float64
        Matched positions, the estimate's after the rigid motion, m.
    """

    ate_rmse_m: float
    ate_sim3_rmse_m: float
    scale: float
    ate_m: FloatArray
    rpe_translation_m: float
    rpe_rotation_deg: float
    per_distance: dict[float, DistanceErrors]
    matched: int
    total: int
    T_reference_estimate: FloatArray
    estimate: FloatArray
    reference: FloatArray


@dataclass(frozen=True)
class DistanceErrors:
    """Errors of the motion over one distance.

    Attributes
    ----------
    pairs : int
        Of poses that are so far apart along the true path, to a tenth; each start with its nearest end.
    translation_m : float
        Root mean square, m; 0 without pairs.
    translation_percent : float
        Mean error over the mean distance, %; 0 without pairs.
    rotation_deg : float
        Root mean square, degrees; 0 without pairs.
    """

    pairs: int
    translation_m: float
    translation_percent: float
    rotation_deg: float


def evaluate_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_stamp_difference: float = 0.01,
    distances: ArrayLike = (10.0,),
) -> TrajectoryErrors:
    """Compare an estimated camera path with the true one.

    Poses are matched by the nearest stamp; each true pose is used once. The absolute trajectory error (ATE) is that of
    Sturm et al. 2012: distances after the motion that makes them least. The relative pose error (RPE) of a pair is
    ``(Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j)``, Q true and P estimated.

    Parameters
    ----------
    estimate, reference : Trajectory
        Poses of the same camera, each in a world of its own. True poses that are NaN are left out.
    max_stamp_difference : float
        Farthest that two matched stamps are apart, s.
    distances : (K,) floats
        Distances along the true path over which motions are compared, m.

    Returns
    -------
    TrajectoryErrors

    Raises
    ------
    InputError
        If a trajectory is no trajectory, or fewer than 2 poses match.

    Examples
    --------
    >>> stamps, poses = np.arange(5.0), np.tile(np.eye(4), (5, 1, 1))
    >>> poses[:, 0, 3] = stamps
    >>> longer = poses.copy()
    >>> longer[:, 0, 3] *= 1.01
    >>> errors = evaluate_trajectory(Trajectory(stamps, longer), Trajectory(stamps, poses), distances=[2])
    >>> round(errors.scale, 4), round(errors.per_distance[2.0].translation_percent, 4)
    (0.9901, 1.0)
    """
    lengths = real_array(distances, "distances", "(K,)").astype(np.float64).ravel()
    if not ((lengths > 0) & np.isfinite(lengths)).all() or not max_stamp_difference >= 0:
        raise InputError(
            f"evaluation: distances, max_stamp_difference are {lengths}, {max_stamp_difference}, expected > 0 m, >= 0 s"
        )
    stamps, P = _checked(estimate, "estimate")
    true_stamps, Q = _checked(reference, "reference")
    own, other = _matches(stamps, true_stamps, max_stamp_difference)
    if len(own) < _FEWEST:
        raise InputError(
            f"evaluation: {len(own)} of {len(P)} poses have a true one within {max_stamp_difference:g} s, expected at "
            f"least {_FEWEST}; stamps are {_span(stamps)} and {_span(true_stamps)}"
        )
    return _errors(P[own], Q[other], lengths, len(P))


def _errors(P: FloatArray, Q: FloatArray, lengths: FloatArray, total: int) -> TrajectoryErrors:
    """Errors of matched poses."""
    position, true_position = P[:, :3, 3], Q[:, :3, 3]
    T, _ = alignment(position, true_position)
    S, scale = alignment(position, true_position, with_scale=True)
    laid = position @ T[:3, :3].T + T[:3, 3]
    scaled = scale * position @ S[:3, :3].T + S[:3, 3]
    ate = np.linalg.norm(laid - true_position, axis=1)
    steps = np.arange(len(P) - 1)
    translation, rotation = _relative(P, Q, steps, steps + 1)
    return TrajectoryErrors(
        ate_rmse_m=_rms(ate),
        ate_sim3_rmse_m=_rms(np.linalg.norm(scaled - true_position, axis=1)),
        scale=scale,
        ate_m=ate,
        rpe_translation_m=_rms(translation),
        rpe_rotation_deg=_rms(rotation),
        per_distance={float(length): _over(P, Q, float(length)) for length in lengths},
        matched=len(P),
        total=total,
        T_reference_estimate=T,
        estimate=laid,
        reference=true_position,
    )


def _over(P: FloatArray, Q: FloatArray, length: float) -> DistanceErrors:
    """Errors over pairs of poses that are `length` apart along the true path."""
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(Q[:, :3, 3], axis=0), axis=1))])
    start = np.arange(len(P) - 1)
    after = np.clip(np.searchsorted(travelled, travelled[start] + length), start + 1, len(P) - 1)
    before = np.maximum(after - 1, start + 1)
    miss = [np.abs(travelled[end] - travelled[start] - length) for end in (before, after)]
    end = np.where(miss[0] <= miss[1], before, after)
    kept = np.minimum(*miss) <= _SLACK * length
    if not kept.any():
        return DistanceErrors(0, 0.0, 0.0, 0.0)
    start, end = start[kept], end[kept]
    translation, rotation = _relative(P, Q, start, end)
    percent = 100 * float(translation.mean() / (travelled[end] - travelled[start]).mean())
    return DistanceErrors(len(start), _rms(translation), percent, _rms(rotation))


def _relative(
    P: FloatArray, Q: FloatArray, start: NDArray[np.int64], end: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Errors of motions: translation, m, and rotation, degrees."""
    error = inverse(inverse(Q[start]) @ Q[end]) @ (inverse(P[start]) @ P[end])
    return np.linalg.norm(error[:, :3, 3], axis=1), np.degrees(rotation_angle(error[:, :3, :3]))


def _matches(stamps: FloatArray, others: FloatArray, most: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places of stamps that are nearest to each other, and near enough."""
    after = np.clip(np.searchsorted(others, stamps), 1, max(len(others) - 1, 1))
    after = np.minimum(after, len(others) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(stamps - others[before] <= others[after] - stamps, before, after)
    off = np.abs(others[nearest] - stamps)
    order = np.lexsort((np.arange(len(stamps)), off))
    order = order[off[order] <= most]
    _, first = np.unique(nearest[order], return_index=True)  # of those that share a true pose, the nearest
    own = np.sort(order[first])
    return own, nearest[own]


def _checked(trajectory: Trajectory, what: str) -> tuple[FloatArray, FloatArray]:
    """Stamps and poses that are known, ascending."""
    require(trajectory, Trajectory, what)
    stamps = real_array(trajectory.stamp, f"{what}: stamp", "(T,)").astype(np.float64)
    poses = real_array(trajectory.T_world_camera, f"{what}: T_world_camera", "(T, 4, 4)").astype(np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or stamps.shape != poses.shape[:1]:
        raise InputError(f"{what}: stamp and poses have shapes {stamps.shape}, {poses.shape}, expected (T,), (T, 4, 4)")
    known = ~np.isnan(poses).any(axis=(1, 2))
    stamps, poses = stamps[known], poses[known]
    if not len(stamps):
        raise InputError(f"{what}: has no pose that is known, expected at least {_FEWEST}")
    if not np.isfinite(stamps).all() or not np.isfinite(poses).all() or (np.diff(stamps) <= 0).any():
        raise InputError(f"{what}: stamps or poses are not finite, or stamps do not increase, expected both")
    if np.abs(poses).max() > _FARTHEST:
        raise InputError(
            f"{what}: a position is {np.abs(poses).max():.3g} m from the origin, expected {_FARTHEST:g} at most"
        )
    R = poses[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > _ROTATION) | (np.linalg.det(R) < 0))
    if bad.size:
        raise InputError(
            f"{what}: pose {bad[0]} holds no rotation (R Rᵀ - I has {off[bad[0]]:.2g}), expected one to 1e-3"
        )
    return stamps, poses


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _span(stamps: FloatArray) -> str:
    return f"{stamps[0]:.9g} to {stamps[-1]:.9g} s"
