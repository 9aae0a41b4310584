"""How far a camera path is from the true one: absolute and relative errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import Brief
from .._checks import require
from ..errors import InputError
from ..types import FloatArray, Trajectory, real_array
from .se3 import alignment, inverse, rotation_angle

_FARTHEST = 1e10  # m
_FEWEST = 3  # positions: through fewer, the motion that lays a path on another is not one
_MIN = 0.05  # of the estimate: below, what is compared says nothing of it
_FEW = 0.5  # of a path: below, it is a part, which is said
_LONGEST_GAP = 1 << 40  # frames
_SLACK = 0.1  # of a distance, by which the nearest pair of poses may miss it
_ROTATION = 1e-3


@dataclass(frozen=True, repr=False)
class TrajectoryErrors(Brief):
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
        Root mean square error of the motion from one frame to the next.
    rpe_pairs, rpe_frames : int
        The pairs of matched poses that this is from, and how many frames of the estimate each pair is apart: 1 unless
        true poses are sparser than frames; errors are divided by it.
    per_distance : dict of float to DistanceErrors
        Errors of the motion over each distance along the true path; distances longer than the path have no pairs.
    matched, total : int
        Poses of the estimate with a true one, and all that are known.
    truth_total : int
        True poses that are known.
    unknown, truth_unknown : int
        Poses of the estimate and true ones that are NaN and left out.
    covered, truth_covered : float
        Share of the estimate's time, and of the true path's, that lies between the first match and the last.
    warnings : tuple of str
        Why the figures may not tell of the whole path, a line each; empty if at least half of it is compared.
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
    rpe_pairs: int
    rpe_frames: int
    matched: int
    total: int
    truth_total: int
    unknown: int
    truth_unknown: int
    covered: float
    truth_covered: float
    warnings: tuple[str, ...]
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
    Sturm et al. 2012: distances after the rigid motion that minimises their squares. The relative pose error (RPE) of a
    pair is ``(Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j)``, Q true and P estimated. The RPE per frame is over pairs of matched poses that
    are one frame apart, by the median interval of the estimate's stamps; where true poses are sparser than frames, over
    those that are as many frames apart as most neighbours, divided by that number. A gap is no frame.

    Parameters
    ----------
    estimate, reference : Trajectory
        Poses of the same camera, each in a world of its own. Poses that are NaN are left out and counted.
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
        If an argument is no trajectory, fewer than 3 poses match, or less than 5 % of the estimate does.

    Notes
    -----
    The share of a path that is compared is that of its time between the first match and the last, times the share of
    poses there that match, of the estimate or of the truth, whichever has fewer: so a truth of 200 Hz or of 1 Hz is as
    good as one of the estimate's rate. Below half of either path, `warnings` says so: of the true one too, which may go
    on after the end of the estimate, where errors would be larger.

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
    known, truth = _checked(estimate, "estimate"), _checked(reference, "reference")
    own, other = _matches(known.stamps, truth.stamps, max_stamp_difference)
    overlap = _Overlap(known, truth, own, other)
    overlap.check(max_stamp_difference)
    return _errors(overlap, lengths)


@dataclass(frozen=True)
class _Known:
    """Stamps and poses that are known, ascending, and how many are not."""

    stamps: FloatArray
    poses: FloatArray
    unknown: int


@dataclass(frozen=True)
class _Overlap:
    """Two paths, and the places of poses that match."""

    estimate: _Known
    truth: _Known
    own: NDArray[np.int64]
    other: NDArray[np.int64]

    def span_of(self, path: _Known, at: NDArray[np.int64]) -> float:
        """Share of a path's time between the first match and the last."""
        return float(np.ptp(path.stamps[at]) / np.ptp(path.stamps))

    @property
    def density(self) -> float:
        """Share of poses between the first match and the last that match, of the path that has fewer there."""
        return len(self.own) / (1 + int(min(np.ptp(self.own), np.ptp(self.other))))

    def check(self, most: float) -> None:
        """Refuse an overlap that says nothing of the path."""
        matched, total = len(self.own), len(self.estimate.stamps)
        said = f"evaluation: {matched} of {total} poses have a true one within {most:g} s"
        spans = f"stamps are {_span(self.estimate.stamps)}, true ones {_span(self.truth.stamps)}"
        if matched < _FEWEST:
            raise InputError(f"{said}, expected at least {_FEWEST}; {spans}")
        share = self.density * self.span_of(self.estimate, self.own)
        if share < _MIN:
            raise InputError(f"{said}, {100 * share:.2g} % of the path, expected at least {100 * _MIN:g} %; {spans}")

    def warnings(self) -> tuple[str, ...]:
        """What to say where less than half is compared."""
        found = []
        paths = ("estimated", self.estimate, self.own), ("true", self.truth, self.other)
        for name, path, at in paths:
            share = self.density * self.span_of(path, at)
            if share < _FEW:
                said = (
                    f"only {100 * share:.2g} % of the {name} path is compared ({len(at)} of {len(path.stamps)} poses)"
                )
                found.append(f"{said}: the errors are those of a part")
        return tuple(found)

    def frames_between(self) -> NDArray[np.int64]:
        """How many frames of the estimate each match is behind the one before it."""
        stamps = self.estimate.stamps
        interval = float(np.median(np.diff(stamps)))
        return np.clip(np.rint(np.diff(stamps[self.own]) / interval), 1, _LONGEST_GAP).astype(np.int64)


def _errors(overlap: _Overlap, lengths: FloatArray) -> TrajectoryErrors:
    """Errors of matched poses."""
    P, Q = overlap.estimate.poses[overlap.own], overlap.truth.poses[overlap.other]
    position, true_position = P[:, :3, 3], Q[:, :3, 3]
    T, _ = alignment(position, true_position)
    S, scale = alignment(position, true_position, with_scale=True)
    laid = position @ T[:3, :3].T + T[:3, 3]
    scaled = scale * position @ S[:3, :3].T + S[:3, 3]
    ate = np.linalg.norm(laid - true_position, axis=1)
    between = overlap.frames_between()
    numbers, counts = np.unique(between, return_counts=True)
    frames = int(numbers[np.argmax(counts)])  # the commonest, of equally common ones the least
    steps = np.flatnonzero(between == frames)
    translation, rotation = (values / frames for values in _relative(P, Q, steps, steps + 1))
    return TrajectoryErrors(
        ate_rmse_m=_rms(ate),
        ate_sim3_rmse_m=_rms(np.linalg.norm(scaled - true_position, axis=1)),
        scale=scale,
        ate_m=ate,
        rpe_translation_m=_rms(translation),
        rpe_rotation_deg=_rms(rotation),
        per_distance={float(length): _over(P, Q, float(length)) for length in lengths},
        rpe_pairs=len(steps),
        rpe_frames=frames,
        matched=len(P),
        total=len(overlap.estimate.stamps),
        truth_total=len(overlap.truth.stamps),
        unknown=overlap.estimate.unknown,
        truth_unknown=overlap.truth.unknown,
        covered=overlap.span_of(overlap.estimate, overlap.own),
        truth_covered=overlap.span_of(overlap.truth, overlap.other),
        warnings=overlap.warnings(),
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


def _checked(trajectory: Trajectory, what: str) -> _Known:
    """Stamps and poses that are known, ascending."""
    require(trajectory, Trajectory, what)
    stamps = real_array(trajectory.stamp, f"{what}: stamp", "(T,)").astype(np.float64)
    poses = real_array(trajectory.T_world_camera, f"{what}: T_world_camera", "(T, 4, 4)").astype(np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or stamps.shape != poses.shape[:1]:
        raise InputError(f"{what}: stamp and poses have shapes {stamps.shape}, {poses.shape}, expected (T,), (T, 4, 4)")
    count, known = len(poses), ~np.isnan(poses).any(axis=(1, 2))
    stamps, poses = stamps[known], poses[known]
    if not len(stamps):
        raise InputError(f"{what}: has no pose that is known of {count}, expected at least {_FEWEST}")
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
    return _Known(stamps, poses, count - len(stamps))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


def _span(stamps: FloatArray) -> str:
    return f"{stamps[0]:.9g} to {stamps[-1]:.9g} s"
