"""A run's path beside the true one: what `tspslam eval` says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .datasets import open_sequence
from .errors import InputError
from .io import RunFolder, read_trajectory
from .io.trajectory import has_stamps
from .types import Trajectory
from .vision.evaluate import TrajectoryErrors, evaluate_trajectory

_TEN = 10.0  # m
_HALF = 0.25  # of the numbers of frames, which stand for stamps


def evaluated(run: Path, truth: Path, *, max_stamp_difference: float = 0.01) -> TrajectoryErrors:
    """Compare the path of a run with a true one.

    Parameters
    ----------
    run : path
        A run folder, or a trajectory file in TUM's or KITTI's form.
    truth : path
        Such a file, or a sequence folder that has true poses. A file in KITTI's form has no stamps: its line k, from
        0, is for frame k of the run.
    max_stamp_difference : float
        Farthest that two matched stamps are apart, s.

    Returns
    -------
    TrajectoryErrors

    Raises
    ------
    InputError
        If one of them cannot be read, or fewer than 2 poses match.
    """
    estimate, frames = _estimate(run)
    if truth.is_dir():
        return evaluate_trajectory(estimate, _of_sequence(truth), max_stamp_difference=max_stamp_difference)
    reference = read_trajectory(truth)
    if not has_stamps(truth):
        estimate = Trajectory(frames, estimate.T_world_camera)
        return evaluate_trajectory(estimate, reference, max_stamp_difference=_HALF)
    return evaluate_trajectory(estimate, reference, max_stamp_difference=max_stamp_difference)


def summary(errors: TrajectoryErrors) -> dict[str, Any]:
    """Describe the errors in plain numbers, fit for JSON."""
    ten = errors.per_distance[_TEN]
    return {
        "ate_rmse_m": errors.ate_rmse_m,
        "ate_sim3_rmse_m": errors.ate_sim3_rmse_m,
        "scale": errors.scale,
        "rpe_translation_m_frame": errors.rpe_translation_m,
        "rpe_rotation_deg_frame": errors.rpe_rotation_deg,
        "rpe_translation_percent_10m": ten.translation_percent if ten.pairs else None,
        "rpe_rotation_deg_10m": ten.rotation_deg if ten.pairs else None,
        "matched": errors.matched,
        "total": errors.total,
    }


def _estimate(run: Path) -> tuple[Trajectory, np.ndarray]:
    """Path of a run, and the numbers of its frames."""
    if not run.is_dir():
        path = read_trajectory(run)
        return path, np.arange(len(path), dtype=np.float64)
    rows = RunFolder.open(run).read_rows()
    path = read_trajectory(run / "trajectory.tum")
    numbers = {float(row["stamp"]): row["index"] for row in reversed(rows)}  # of one moment, the first
    lost = [stamp for stamp in path.stamp.tolist() if stamp not in numbers]
    if lost:
        raise InputError(f"{run / 'trajectory.tum'}: stamp {lost[0]!r} is not in run.json, expected those of one run")
    return path, np.array([numbers[stamp] for stamp in path.stamp.tolist()], np.float64)


def _of_sequence(folder: Path) -> Trajectory:
    sequence = open_sequence(folder)
    truth = getattr(sequence, "truth", None)
    if truth is None:
        raise InputError(f"{folder}: has no true poses, expected a sequence with them, or a file")
    return Trajectory(getattr(sequence, "stamps", np.arange(len(truth), dtype=np.float64)), truth)
