"""A run's path beside the true one: what `tspslam eval` says."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import real_array, require_path
from .._files import PathLike
from ..datasets import open_sequence
from ..errors import GeometryError, InputError
from ..io import RunFolder, read_trajectory
from ..io.trajectory import has_stamps
from ..types import FloatArray, Trajectory
from ..vision.evaluate import TrajectoryErrors, evaluate_trajectory

_TEN = 10.0  # m
_FEWEST = 3  # poses: fewer are not compared
_NUMBER = re.compile(r"[0-9]{1,15}")
_HALF = 0.25  # of the numbers of frames, which stand for stamps
_WORDS = {
    "ate_rmse_m": ("m", "error of positions after the best rigid motion, root mean square"),
    "ate_sim3_rmse_m": ("m", "the same after the best motion and scale"),
    "scale": ("", "that scale; below 1 where the path is too large"),
    "rpe_translation_m_frame": ("m", "error of the motion from one frame to the next, root mean square"),
    "rpe_rotation_deg_frame": ("degrees", "of its rotation"),
    "rpe_translation_percent_10m": ("%", "error of the motion over 10 m of the way"),
    "rpe_rotation_deg_10m": ("degrees", "of its rotation"),
    "rpe_pairs": ("pairs", "of poses, which the errors from frame to frame are from"),
    "rpe_frames": ("frames", "from one pose of such a pair to the other"),
    "matched": ("poses", "of the path, which have a true one"),
    "total": ("poses", "of the path in all"),
    "truth_total": ("poses", "of the true path in all"),
    "unknown": ("poses", "of the path that are NaN, left out"),
    "truth_unknown": ("poses", "of the true path that are NaN, left out"),
    "covered": ("%", "of the path's time from the first match to the last"),
    "truth_covered": ("%", "of the true path's time from the first match to the last"),
}
"""Unit and meaning of each number of `summary`; shares are shown in per cent."""
_SHARES = ("covered", "truth_covered")


def evaluated(run: PathLike, truth: PathLike, *, max_stamp_difference: float = 0.01) -> TrajectoryErrors:
    """Compare the path of a run with a true one.

    Parameters
    ----------
    run : path
        A run folder, or a trajectory file in TUM's or KITTI's form.
    truth : path
        Such a file, or a sequence folder that has true poses. A file in KITTI's form has no stamps: its line k, from
        0, is for frame k of the run, or, where images without a partner were left out of the run, for image number k.
        Beside a file without stamps, one with stamps must have as many lines.
    max_stamp_difference : float
        Farthest that two matched stamps are apart, s.

    Returns
    -------
    TrajectoryErrors

    Raises
    ------
    InputError
        If one of them cannot be read, which pose is for which frame cannot be told, or too few match (fewer than 3, or
        5 % of the path).
    """
    require_path(run, "run")
    require_path(truth, "truth")
    run, truth = Path(run), Path(truth)
    if run.is_dir():
        estimate, rows = _of_run(run)
        if truth.is_dir() or has_stamps(truth):
            return evaluate_trajectory(estimate, _truth(truth), max_stamp_difference=max_stamp_difference)
        reference = _truth(truth)
        return _by_number(Trajectory(_frames(rows, len(reference)), estimate.T_world_camera), reference)
    estimate, reference = read_trajectory(run), _truth(truth)
    stamped = has_stamps(run), truth.is_dir() or has_stamps(truth)
    if all(stamped):
        return evaluate_trajectory(estimate, reference, max_stamp_difference=max_stamp_difference)
    if any(stamped) and len(estimate) != len(reference):
        said = "has stamps" if stamped[0] else "has no stamps"
        raise InputError(
            f"{run}: {said} and {len(estimate)} poses, {truth} has {len(reference)} and the other form: which is for "
            "which frame cannot be told; expected both with stamps, a run folder, or as many poses"
        )
    return _by_number(_numbered(estimate), _numbered(reference))


def measured(
    source: object, path: Trajectory, wanted: Sequence[int]
) -> tuple[TrajectoryErrors | None, list[dict[str, str]]]:
    """Compare a path with the true one of its source, if there is one; what does not fit is a warning.

    Parameters
    ----------
    source : Source
        What was processed; some have ``truth``.
    path : Trajectory
        Its path.
    wanted : sequence of int
        Which of its frames were processed: true poses of others are left out.

    Returns
    -------
    TrajectoryErrors or None
        None without a truth that fits, and of a path too short to be compared.
    list of dict
        Warnings, each a ``code`` and a ``message``.
    """
    if len(path) < _FEWEST:
        return None, []
    try:
        reference = _true_path(source)
        if reference is not None and reference.stamp.size == len(reference.T_world_camera) > max(wanted):
            at = list(wanted)
            reference = Trajectory(reference.stamp[at], reference.T_world_camera[at])
        errors = None if reference is None else evaluate_trajectory(path, reference)
    except (GeometryError, InputError) as error:
        return None, [{"code": "truth", "message": f"the path is not compared with the true one ({error})"}]
    return errors, [{"code": "truth", "message": line} for line in (errors.warnings if errors else ())]


def _true_path(source: object) -> Trajectory | None:
    """True poses of a sequence, by stamp; None if it has none."""
    truth = getattr(source, "truth", None)
    if truth is None:
        return None
    truth = real_array(truth, "truth", "(n, 4, 4)")
    if truth.shape != (len(truth) if truth.ndim else 0, 4, 4):
        raise InputError(f"truth has shape {truth.shape}, expected (n, 4, 4)")
    stamps = getattr(source, "stamps", None)
    if stamps is None:
        stamps = np.arange(len(truth), dtype=np.float64)
    return Trajectory(real_array(stamps, "stamps", "(n,)").astype(np.float64), truth.astype(np.float64))


def _numbered(path: Trajectory) -> Trajectory:
    return Trajectory(np.arange(len(path), dtype=np.float64), path.T_world_camera)


def _by_number(estimate: Trajectory, reference: Trajectory) -> TrajectoryErrors:
    return evaluate_trajectory(estimate, reference, max_stamp_difference=_HALF)


def describe_errors(errors: TrajectoryErrors) -> dict[str, Any]:
    """Describe the errors in plain numbers, fit for JSON.

    Parameters
    ----------
    errors : TrajectoryErrors
        What was measured.

    Returns
    -------
    dict of str to plain values
        Numbers with their unit in the name; None is not measured.
    """
    ten = errors.per_distance[_TEN]
    return {
        "ate_rmse_m": errors.ate_rmse_m,
        "ate_sim3_rmse_m": errors.ate_sim3_rmse_m,
        "scale": errors.scale,
        "rpe_translation_m_frame": errors.rpe_translation_m,
        "rpe_rotation_deg_frame": errors.rpe_rotation_deg,
        "rpe_translation_percent_10m": ten.translation_percent if ten.pairs else None,
        "rpe_rotation_deg_10m": ten.rotation_deg if ten.pairs else None,
        "rpe_pairs": errors.rpe_pairs,
        "rpe_frames": errors.rpe_frames,
        "matched": errors.matched,
        "total": errors.total,
        "truth_total": errors.truth_total,
        "unknown": errors.unknown,
        "truth_unknown": errors.truth_unknown,
        "covered": errors.covered,
        "truth_covered": errors.truth_covered,
        "warnings": list(errors.warnings),
    }


def tabulate(errors: TrajectoryErrors) -> list[str]:
    """Describe the errors in lines for people: name, value with its unit, and what it is.

    Parameters
    ----------
    errors : TrajectoryErrors
        What was measured.

    Returns
    -------
    list of str
        One for each number of `summary`; "-" is not measured.
    """
    found, lines = describe_errors(errors), []
    for name, (unit, meaning) in _WORDS.items():
        value = found[name]
        shown = "-" if value is None else f"{value * (100 if name in _SHARES else 1):.6g} {unit}".rstrip()
        lines.append(f"{name:<28}  {shown:<16}  {meaning}")
    return lines


def _of_run(run: Path) -> tuple[Trajectory, list[dict[str, Any]]]:
    """Path of a run, and what ``run.json`` says of the frame of each pose."""
    folder = RunFolder.open(run)
    folder.check_unchanged(run / "trajectory.tum")
    path, found = read_trajectory(run / "trajectory.tum"), folder.read_rows()
    rows = {float(row["stamp"]): row for row in reversed(found)}  # of frames of one moment, the first
    lost = [stamp for stamp in path.stamp.tolist() if stamp not in rows]
    if lost:
        raise InputError(f"{run / 'trajectory.tum'}: stamp {lost[0]!r} is not in run.json, expected those of one run")
    return path, [rows[stamp] for stamp in path.stamp.tolist()]


def _frames(rows: list[dict[str, Any]], lines: int) -> FloatArray:
    """Which line of a file of true poses without stamps is for which frame.

    The frame's place in the run; but where images are named by number and numbers between are missing, since an image
    had no partner, the number, if the file goes so far.
    """
    index = np.array([row["index"] for row in rows], np.float64)
    names = [str(row.get("name", "")) for row in rows]
    if not all(_NUMBER.fullmatch(name) for name in names):
        return index
    numbers = np.array(names, np.float64)
    has_gaps = (np.diff(numbers) > np.diff(index)).any() and (np.diff(numbers) > 0).all()
    return numbers if has_gaps and numbers.max() < lines else index


def _truth(place: Path) -> Trajectory:
    return _of_sequence(place) if place.is_dir() else read_trajectory(place)


def _of_sequence(folder: Path) -> Trajectory:
    truth = _true_path(open_sequence(folder))
    if truth is None:
        wanted = "a sequence with them (KITTI, EuRoC, UTIAS), or a file of them, such as poses.txt"
        raise InputError(f"{folder}: has no true poses, expected {wanted}")
    return truth
