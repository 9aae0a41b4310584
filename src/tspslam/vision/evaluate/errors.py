"""How far a camera path is from the true one: absolute and relative errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._brief import Brief
from ..._checks import told
from ...errors import InputError
from ...types import FloatArray, Trajectory, real_array
from ..se3 import alignment, inverse
from ._matching import Known, Overlap, checked_path, match_stamps
from ._motions import Motions, errors_over, kitti_errors, relative_errors, rms
from .offset import Offset, find_offset
from .relative import Delta, DistanceErrors, KittiErrors, parse_delta

Align = Literal["none", "origin", "se3", "sim3"]


@dataclass(frozen=True, repr=False)
class TrajectoryErrors(Brief):
    """What `evaluate_trajectory` found.

    Attributes
    ----------
    ate_rmse_m : float
        Root mean square distance of positions after the alignment, m: by default the best rigid motion.
    ate_sim3_rmse_m : float
        The same after the best motion and scale, m.
    scale : float
        That scale; 0.99 means that the estimate is 1 % too large.
    ate_m : (M,) float64
        The distance of each matched pose after the alignment, m.
    rpe_translation_m, rpe_rotation_deg : float
        Root mean square error of the motion from one frame to the next.
    rpe_pairs, rpe_frames : int
        The pairs of matched poses that this is from, and how many frames of the estimate each pair is apart: 1 unless
        true poses are sparser than frames; errors are divided by it.
    per_distance : dict of float to DistanceErrors
        Errors of the motion over each distance along the true path; distances longer than the path have no pairs.
    per_delta : dict of str to DistanceErrors
        The same over each of `deltas`, by its name.
    kitti : KittiErrors
        Errors of sections of 100 to 800 m.
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
    align : {"none", "origin", "se3", "sim3"}
        How the estimate was laid on the truth.
    offset_s : float
        What was added to the estimate's stamps, s.
    offset_sigma_s : float
        Its standard deviation, s; 0 where it was given.
    T_reference_estimate : (4, 4) float64
        The motion that did so; with ``"sim3"`` positions are multiplied by `scale` before.
    estimate, reference : (M, 3) float64
        Matched positions, the estimate's after the alignment, m.
    """

    ate_rmse_m: float
    ate_sim3_rmse_m: float
    scale: float
    ate_m: FloatArray
    rpe_translation_m: float
    rpe_rotation_deg: float
    per_distance: dict[float, DistanceErrors]
    per_delta: dict[str, DistanceErrors]
    kitti: KittiErrors
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
    align: Align
    offset_s: float
    offset_sigma_s: float
    T_reference_estimate: FloatArray
    estimate: FloatArray
    reference: FloatArray

    @property
    def is_mostly_unknown(self) -> bool:
        """Whether most poses of the estimate are NaN: the figures say little, and ``eval`` ends as degraded."""
        return self.unknown > self.total


def evaluate_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_stamp_difference: float = 0.01,
    distances: ArrayLike = (10.0,),
    deltas: Sequence[str] = (),
    align: Align = "se3",
    offset: float | Literal["auto"] = 0.0,
    parts: ArrayLike = (),
) -> TrajectoryErrors:
    """Compare an estimated camera path with the true one.

    Poses are matched by the nearest stamp; each true pose is used once. The absolute trajectory error (ATE) is that of
    Sturm et al. 2012: distances after the rigid motion that minimises their squares, ``Σ |R p_i + t - q_i|²`` (Umeyama
    1991), p estimated and q true positions. The relative pose error (RPE) of a pair is
    ``(Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j)``, Q true and P estimated. The RPE per frame is over pairs of matched poses that are one
    frame apart, by the median interval of the estimate's stamps; where true poses are sparser than frames, over those
    that are as many frames apart as most neighbours, divided by that number. A gap is no frame.

    Parameters
    ----------
    estimate, reference : Trajectory
        Poses of the same camera, each in a world of its own. Poses that are NaN are left out and counted.
    max_stamp_difference : float
        Farthest that two matched stamps are apart, s.
    distances : (K,) floats
        Distances along the true path over which motions are compared, m.
    deltas : sequence of str
        Lengths with units: frames (``"1f"``), metres along the true path (``"10m"``) or seconds (``"1s"``).
    align : {"none", "origin", "se3", "sim3"}
        How the estimate is laid on the truth: not at all, by its first matched pose, by the best rigid motion, or by
        that and the best scale, which is then the scale of all that is measured.
    offset : float or "auto"
        Added to the estimate's stamps, s; what `find_offset` finds, if it is ``"auto"``.
    parts : (R,) floats
        Stamps of the estimate, as given, at which another recording begins: no motion is compared across, and the way
        between two of them is not travelled.

    Returns
    -------
    TrajectoryErrors

    Raises
    ------
    InputError
        If an argument is no trajectory, or no length, alignment or offset, fewer than 3 poses match, or less than 5 %
        of the estimate does.

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
    _check_kinds(max_stamp_difference, deltas, align, offset)
    lengths = real_array(distances, "distances", "(K,)").astype(np.float64).ravel()
    if not ((lengths > 0) & np.isfinite(lengths)).all() or not max_stamp_difference >= 0:
        raise InputError(
            f"evaluation: distances, max_stamp_difference are {lengths}, {max_stamp_difference}, expected > 0 m, >= 0 s"
        )
    wanted = {text: parse_delta(text) for text in deltas}
    found = find_offset(estimate, reference) if offset == "auto" else Offset(float(offset), 0.0, 0.0, 0.0, 0.0)
    if align not in get_args(Align) or not np.isfinite(found.seconds):
        raise InputError(
            f"evaluation: align, offset are {align!r}, {offset}, expected {get_args(Align)}, finite seconds"
        )
    begins = np.sort(real_array(parts, "parts", "(R,)").astype(np.float64).ravel())
    known, truth = checked_path(estimate, "estimate"), checked_path(reference, "reference")
    known = Known(known.stamps + found.seconds, known.poses, known.unknown)
    if (np.diff(known.stamps) <= 0).any():
        raise InputError(
            f"evaluation: stamps that {found.seconds:g} s are added to do not differ any more, expected less"
        )
    own, other = match_stamps(known.stamps, truth.stamps, max_stamp_difference)
    overlap = Overlap(known, truth, own, other)
    overlap.check(max_stamp_difference)
    part = np.searchsorted(begins + found.seconds, known.stamps[own], "right")
    return _errors(overlap, lengths, wanted, align, found, part)


def _check_kinds(most: object, deltas: object, align: object, offset: object) -> None:
    """Refuse arguments of another type."""
    if not _is_number(most):
        raise InputError(f"evaluation: max_stamp_difference is {told(most)}, expected a number of seconds")
    if not _is_number(offset) and not (isinstance(offset, str) and offset == "auto"):
        raise InputError(f"evaluation: offset is {told(offset)}, expected a number of seconds or 'auto'")
    if not isinstance(align, str):
        raise InputError(f"evaluation: align is {told(align)}, expected one of {get_args(Align)}")
    if isinstance(deltas, str) or not isinstance(deltas, Sequence):
        raise InputError(f"evaluation: deltas is {told(deltas)}, expected a list of lengths, such as ['1f', '10m']")


def _is_number(value: object) -> bool:
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        float(value)
    except OverflowError:
        return False
    return True


def _laid(P: FloatArray, Q: FloatArray, align: Align) -> tuple[FloatArray, float]:
    """The motion, and the scale before it, that lay estimated poses on true ones."""
    if align in ("se3", "sim3"):
        return alignment(P[:, :3, 3], Q[:, :3, 3], with_scale=align == "sim3")
    return (np.eye(4) if align == "none" else Q[0] @ inverse(P[0])), 1.0


def _steps(between: NDArray[np.int64], is_one_part: NDArray[np.bool_]) -> tuple[NDArray[np.int64], int]:
    """Matches whose next one is as many frames away as is commonest, of equally common numbers the least; and it."""
    numbers, counts = np.unique(between[is_one_part], return_counts=True)
    frames = int(numbers[np.argmax(counts)]) if len(numbers) else 1
    return np.flatnonzero(is_one_part & (between == frames)), frames


def _errors(
    overlap: Overlap, lengths: FloatArray, deltas: dict[str, Delta], align: Align, offset: Offset,
    part: NDArray[np.int64],
) -> TrajectoryErrors:  # fmt: skip
    """Errors of matched poses."""
    P, Q = overlap.estimate.poses[overlap.own].copy(), overlap.truth.poses[overlap.other]
    true_position = Q[:, :3, 3]
    S, scale = alignment(P[:, :3, 3], true_position, with_scale=True)
    scaled = scale * P[:, :3, 3] @ S[:3, :3].T + S[:3, 3]
    T, size = _laid(P, Q, align)
    P[:, :3, 3] *= size
    laid = P[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
    ate = np.linalg.norm(laid - true_position, axis=1)
    between = overlap.frames_between()
    steps, frames = _steps(between, np.diff(part) == 0)
    translation, rotation = (values / frames for values in relative_errors(P, Q, steps, steps + 1))
    motions = Motions(P, Q, overlap.estimate.stamps[overlap.own], np.concatenate([[0], np.cumsum(between)]), part)
    return TrajectoryErrors(
        ate_rmse_m=rms(ate),
        ate_sim3_rmse_m=rms(np.linalg.norm(scaled - true_position, axis=1)),
        scale=scale,
        ate_m=ate,
        rpe_translation_m=rms(translation),
        rpe_rotation_deg=rms(rotation),
        per_distance={float(length): errors_over(motions, Delta(float(length), "m")) for length in lengths},
        per_delta={name: errors_over(motions, delta) for name, delta in deltas.items()},
        kitti=kitti_errors(motions),
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
        align=align,
        offset_s=offset.seconds,
        offset_sigma_s=offset.sigma_s,
        T_reference_estimate=T,
        estimate=laid,
        reference=true_position,
    )
