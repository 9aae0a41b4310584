"""A run's path beside the true one: what `tspslam eval` says."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .._checks import real_array, require_path
from .._files import PathLike, bad_input
from ..datasets import open_sequence
from ..datasets._rgbd_layouts import is_rgbd
from ..datasets.rgbd import read_truth
from ..errors import GeometryError, InputError
from ..io import RunFolder, read_trajectory
from ..io.trajectory import has_stamps
from ..types import FloatArray, Trajectory
from ..vision.evaluate import Align, DistanceErrors, TrajectoryErrors, evaluate_trajectory

_TEN = 10.0  # m
_FEWEST = 3  # poses: fewer are not compared
_NUMBER = re.compile(r"[0-9]{1,15}")
_HALF = 0.25  # of the numbers of frames, which stand for stamps
_SHARES = ("covered", "truth_covered")  # shown in per cent
_OF_RECORDINGS = {
    "name": str, "first": int, "frames": int, "stamp_offset_s": int | float, "trajectory": str | None,
    "relative_to": str | None,
}  # fmt: skip
_LAID = {
    "none": "as they are",
    "origin": "after the first pose is laid on the true one",
    "se3": "after the best rigid motion",
    "sim3": "after the best motion and scale",
}
_UNITS = {"f": "frames", "m": "m of the way", "s": "s"}


class Options(NamedTuple):
    """How two paths are compared: as `evaluated` has it."""

    max_stamp_difference: float
    deltas: Sequence[str]
    align: Align
    offset: float | Literal["auto"]
    parts: Sequence[float] = ()

    def by_stamp(self, estimate: Trajectory, reference: Trajectory) -> TrajectoryErrors:
        """Compare two paths by their stamps.

        Parameters
        ----------
        estimate, reference : Trajectory
            The path, and the true one.

        Returns
        -------
        TrajectoryErrors
        """
        return evaluate_trajectory(
            estimate, reference, max_stamp_difference=self.max_stamp_difference, deltas=self.deltas, align=self.align,
            offset=self.offset, parts=self.parts,
        )  # fmt: skip

    def compare(self, estimate: Trajectory, reference: Trajectory, *, is_stamped: bool) -> TrajectoryErrors:
        """Compare two paths by their stamps, or by numbers of frames that stand for them.

        Parameters
        ----------
        estimate, reference : Trajectory
            The path, and the true one.
        is_stamped : bool
            Whether their stamps are times.

        Returns
        -------
        TrajectoryErrors
        """
        return self.by_stamp(estimate, reference) if is_stamped else self.by_number(estimate, reference)

    def by_number(self, estimate: Trajectory, reference: Trajectory) -> TrajectoryErrors:
        """Compare two paths whose stamps are numbers of frames.

        Parameters, returns: as `by_stamp`.
        """
        if self.offset:
            raise InputError(f"offset {self.offset}: poses without stamps go by their lines, expected stamps of both")
        return self._replace(max_stamp_difference=_HALF).by_stamp(estimate, reference)


def evaluated(
    run: PathLike, truth: PathLike, *, max_stamp_difference: float = 0.01, stamps: PathLike | None = None,
    deltas: Sequence[str] = (), align: Align = "se3", offset: float | Literal["auto"] = 0.0,
) -> TrajectoryErrors:  # fmt: skip
    """Compare the path of a run with a true one.

    Parameters
    ----------
    run : path
        A run folder, or a trajectory file in TUM's, KITTI's or EuRoC's form.
    truth : path
        Such a file, or a sequence folder that has true poses. A file in KITTI's form has no stamps: its line k, from
        0, is for frame k of the run, or, where images without a partner were left out of the run, for image number k.
        Beside a file without stamps, one with stamps must have as many lines.
    max_stamp_difference : float
        Farthest that two matched stamps are apart, s.
    stamps : path, optional
        Stamps of the lines of those files that have none, s.
    deltas : sequence of str
        Lengths over which motions are compared: ``"1f"``, ``"10m"``, ``"1s"``.
    align : {"none", "origin", "se3", "sim3"}
        How the path is laid on the truth.
    offset : float or "auto"
        Added to the path's stamps, s.

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
    how = Options(max_stamp_difference, deltas, align, offset)
    has_own = run.is_dir() or has_stamps(run), truth.is_dir() or has_stamps(truth)
    if stamps is not None and all(has_own):
        raise InputError(f"{stamps}: {run} and {truth} have stamps of their own, expected one in KITTI's form")
    is_stamped = [own or stamps is not None for own in has_own]
    if run.is_dir():
        estimate, rows = _of_run(run)
        _refuse_one_truth(run, is_stamped=is_stamped[1])
        reference = true_path(truth, None if has_own[1] else stamps)
        if is_stamped[1]:
            return how.by_stamp(estimate, reference)
        return how.by_number(Trajectory(frame_numbers(rows, len(reference)), estimate.T_world_camera), reference)
    estimate = read_trajectory(run, None if has_own[0] else stamps)
    reference = true_path(truth, None if has_own[1] else stamps)
    if all(is_stamped):
        return how.by_stamp(estimate, reference)
    if any(is_stamped) and len(estimate) != len(reference):
        said = "has stamps" if is_stamped[0] else "has no stamps"
        raise InputError(
            f"{run}: {said} and {len(estimate)} poses, {truth} has {len(reference)} and the other form: which is for "
            "which frame cannot be told; expected both with stamps, a run folder, or as many poses"
        )
    return how.by_number(_numbered(estimate), _numbered(reference))


def recordings_of(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Tell the recordings of a run of several, as its ``run.json`` has them.

    Parameters
    ----------
    record : dict
        What that holds.

    Returns
    -------
    list of dict
        None of a run of a single source.

    Raises
    ------
    InputError
        If they are not what a run writes.
    """
    told = record.get("recordings", [])
    is_right = isinstance(told, list) and all(
        isinstance(one, dict) and all(isinstance(one.get(name), kind) for name, kind in _OF_RECORDINGS.items())
        for one in told
    )
    if not is_right:
        raise InputError("run.json: its recordings are not what a run writes, expected name, first, frames and more")
    return list(told)


def _refuse_one_truth(run: Path, *, is_stamped: bool) -> None:
    """Refuse a single true path of several recordings where it cannot be told which of them a pose is of."""
    told = recordings_of(RunFolder.open(run).read_run())
    if len(told) > 1 and (not is_stamped or any(one["stamp_offset_s"] for one in told)):
        why = "have stamps in common" if is_stamped else "number their frames each from 0"
        names = ", ".join(str(one["name"]) for one in told)
        raise bad_input(run, f"is of recordings that {why} ({names})", "one --truth for each of them, in this order")


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


def describe_errors(errors: TrajectoryErrors, *, kitti: bool = False) -> dict[str, Any]:
    """Describe the errors in plain numbers, fit for JSON.

    Parameters
    ----------
    errors : TrajectoryErrors
        What was measured.
    kitti : bool
        Whether KITTI's table is told: ``kitti_sections`` has for each length, m, how many sections there are, their
        error, %, and that of their rotation, degrees per 100 m.

    Returns
    -------
    dict of str to plain values
        Numbers with their unit in the name; None is not measured.
    """
    found: dict[str, Any] = {name: value for name, value, _, _ in _rows(errors, kitti)}
    if kitti:
        found["kitti_sections"] = {f"{length:g}": list(row) for length, row in errors.kitti.per_length.items()}
    return found | {"warnings": list(errors.warnings)}


def tabulate(errors: TrajectoryErrors, *, kitti: bool = False) -> list[str]:
    """Describe the errors in lines for people: name, value with its unit, and what it is.

    Parameters
    ----------
    errors : TrajectoryErrors
        What was measured.
    kitti : bool
        Whether KITTI's table is told.

    Returns
    -------
    list of str
        One for each number of `describe_errors`, and for each length of KITTI's table; "-" is not measured.
    """
    lines = []
    for name, value, unit, meaning in _rows(errors, kitti):
        number = value if value is None or name not in _SHARES else 100 * value
        shown = "-" if number is None else f"{number:.6g} {unit}".rstrip()
        lines.append(f"{name:<28}  {shown:<16}  {meaning}")
    for length, (count, percent, degrees) in errors.kitti.per_length.items() if kitti else ():
        lines.append(
            f"  {f'{length:g} m':<26}  {f'{percent:.4g} %':<16}  {degrees:.4g} degrees/100 m, {count} sections"
        )
    return lines


class _Row(NamedTuple):
    """A number, its unit, and what it is; shares are shown in per cent."""

    name: str
    value: float | None
    unit: str
    meaning: str


def _rows(errors: TrajectoryErrors, kitti: bool) -> Iterator[_Row]:
    yield from _of_positions(errors)
    yield _Row(
        "rpe_translation_m_frame", errors.rpe_translation_m, "m", "error of the motion from one frame to the next"
    )
    yield _Row("rpe_rotation_deg_frame", errors.rpe_rotation_deg, "degrees", "of its rotation; both root mean square")
    yield from _of_length("10m", errors.per_distance[_TEN])
    for name, found in errors.per_delta.items():
        yield _Row(f"rpe_translation_m_{name}", found.translation_m if found.pairs else None, "m", "root mean square")
        if name != "10m":
            yield from _of_length(name, found)
        yield _Row(f"rpe_pairs_{name}", found.pairs, "pairs", f"of poses that are {name[:-1]} {_UNITS[name[-1]]} apart")
    if kitti:
        yield from _of_kitti(errors)
    if errors.offset_s or errors.offset_sigma_s:
        yield _Row("offset_s", errors.offset_s, "s", "added to the path's stamps")
        yield _Row("offset_sigma_s", errors.offset_sigma_s, "s", "its standard deviation; 0 where it was given")
    yield _Row("rpe_pairs", errors.rpe_pairs, "pairs", "of poses, which the errors from frame to frame are from")
    yield _Row("rpe_frames", errors.rpe_frames, "frames", "from one pose of such a pair to the other")
    yield from _of_overlap(errors)


def _of_positions(errors: TrajectoryErrors) -> Iterator[_Row]:
    ate = errors.ate_m
    yield _Row("ate_rmse_m", errors.ate_rmse_m, "m", f"error of positions {_LAID[errors.align]}, root mean square")
    yield _Row("ate_mean_m", float(ate.mean()), "m", "its mean")
    yield _Row("ate_median_m", float(np.median(ate)), "m", "its median")
    yield _Row("ate_max_m", float(ate.max()), "m", "its largest")
    yield _Row("ate_sim3_rmse_m", errors.ate_sim3_rmse_m, "m", "root mean square after the best motion and scale")
    yield _Row("scale", errors.scale, "", "that scale; below 1 where the path is too large")


def _of_length(name: str, found: DistanceErrors) -> Iterator[_Row]:
    value = (found.translation_percent, found.rotation_deg) if found.pairs else (None, None)
    said = f"error of the motion over {name[:-1]} {_UNITS[name[-1]]}"
    yield _Row(f"rpe_translation_percent_{name}", value[0], "%", said)
    yield _Row(f"rpe_rotation_deg_{name}", value[1], "degrees", "of its rotation, root mean square")


def _of_kitti(errors: TrajectoryErrors) -> Iterator[_Row]:
    table = errors.kitti
    lengths = list(table.per_length)
    said = f"of sections of {', '.join(f'{length:g}' for length in lengths)} m, mean"
    if not lengths:
        said = f"no section of 100 m or more: the true path is {table.travelled_m:.4g} m long"
    yield _Row("kitti_translation_percent", table.translation_percent if lengths else None, "%", said)
    yield _Row(
        "kitti_rotation_deg_100m", table.rotation_deg_100m if lengths else None, "degrees", "of rotations, in 100 m"
    )


def _of_overlap(errors: TrajectoryErrors) -> Iterator[_Row]:
    yield _Row("matched", errors.matched, "poses", "of the path, which have a true one")
    yield _Row("total", errors.total, "poses", "of the path in all")
    yield _Row("truth_total", errors.truth_total, "poses", "of the true path in all")
    yield _Row("unknown", errors.unknown, "poses", "of the path that are NaN, left out")
    yield _Row("truth_unknown", errors.truth_unknown, "poses", "of the true path that are NaN, left out")
    yield _Row("covered", errors.covered, "%", "of the path's time from the first match to the last")
    yield _Row("truth_covered", errors.truth_covered, "%", "of the true path's time from the first match to the last")


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


def frame_numbers(rows: list[dict[str, Any]], lines: int) -> FloatArray:
    """Tell which line of a file of true poses without stamps is for which frame.

    The frame's place in the run; but where images are named by number and numbers between are missing, since an image
    had no partner, the number, if the file goes so far.

    Parameters
    ----------
    rows : list of dict
        Frames, each with its ``index``, and maybe its ``name``.
    lines : int
        How many the file has.

    Returns
    -------
    (n,) float64
    """
    index = np.array([row["index"] for row in rows], np.float64)
    names = [str(row.get("name", "")) for row in rows]
    if not all(_NUMBER.fullmatch(name) for name in names):
        return index
    numbers = np.array(names, np.float64)
    has_gaps = (np.diff(numbers) > np.diff(index)).any() and (np.diff(numbers) > 0).all()
    return numbers if has_gaps and numbers.max() < lines else index


def true_path(place: Path, stamps: PathLike | None) -> Trajectory:
    """Read true poses.

    Parameters
    ----------
    place : path
        A file, or a sequence folder that has them.
    stamps : path or None
        Stamps of the lines of a file that has none, s.

    Returns
    -------
    Trajectory
    """
    return _of_sequence(place) if place.is_dir() else read_trajectory(place, stamps)


def _of_sequence(folder: Path) -> Trajectory:
    truth = read_truth(folder) if is_rgbd(folder) else _true_path(open_sequence(folder))
    if truth is None:
        wanted = "a sequence with them (KITTI, EuRoC, UTIAS), or a file of them, such as poses.txt"
        raise InputError(f"{folder}: has no true poses, expected {wanted}")
    return truth
