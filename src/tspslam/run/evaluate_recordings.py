"""A run of several recordings beside their true paths: each by itself, and what was joined as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .._checks import require_path
from .._files import PathLike, bad_input
from ..io import RunFolder, read_trajectory
from ..io.trajectory import has_stamps
from ..types import Trajectory
from ..vision.evaluate import Align, TrajectoryErrors
from .evaluate import Options, frame_numbers, recordings_of, true_path

_APART = 1000.0  # s, or frames, between two recordings when they are compared as one: no stamp matches across


@dataclass(frozen=True)
class RecordingErrors:
    """Errors of a run of several recordings.

    Attributes
    ----------
    each : dict of str to TrajectoryErrors
        Of each recording, laid on its own true path.
    joint : TrajectoryErrors
        Of the first one and those that were joined to it, laid on their true paths as one: it tells how well they were
        joined, if these are in one frame. No motion is compared from one recording to the next.
    """

    each: dict[str, TrajectoryErrors]
    joint: TrajectoryErrors


def evaluated_recordings(
    run: PathLike, truths: Sequence[PathLike], *, max_stamp_difference: float = 0.01, deltas: Sequence[str] = (),
    align: Align = "se3", offset: float | Literal["auto"] = 0.0,
) -> RecordingErrors:  # fmt: skip
    """Compare the paths of a run's recordings with the true ones.

    Parameters
    ----------
    run : path
        A run folder of several recordings.
    truths : sequence of path
        One for each, in their order, as `evaluated` takes them. Line k of a file in KITTI's form, from 0, is for frame
        k of its recording.
    max_stamp_difference, deltas, align, offset
        As `evaluated`.

    Returns
    -------
    RecordingErrors

    Raises
    ------
    InputError
        If the run is of one recording, there is not a truth for each, some of them have stamps and others none, or as
        `evaluated`.
    """
    require_path(run, "run")
    folder = RunFolder.open(Path(run))
    told, rows = recordings_of(folder.read_run()), folder.read_rows()
    if len(told) != len(truths):
        names = ", ".join(one["name"] for one in told)
        has = f"is of {len(told)} recordings ({names})" if told else "is a run of one recording"
        said = f"{has}, {len(truths)} true paths are given"
        raise bad_input(run, said, "one --truth for each of them, in this order" if told else "one --truth")
    how = Options(max_stamp_difference, deltas, align, offset)
    pairs = {one["name"]: _paths(folder, one, rows, Path(truth)) for one, truth in zip(told, truths, strict=True)}
    if len({is_stamped for *_, is_stamped in pairs.values()}) > 1:
        raise bad_input(Path(truths[-1]), "differs from other true paths in having stamps", "stamps in all, or in none")
    each = {name: how.compare(path, true, is_stamped=by) for name, (path, true, by) in pairs.items()}
    first = told[0]["name"]
    joined = [pairs[one["name"]] for one in told if one["relative_to"] == first]
    return RecordingErrors(each, _as_one(joined, how))


def _paths(
    folder: RunFolder, one: dict[str, Any], rows: list[dict[str, Any]], truth: Path
) -> tuple[Trajectory, Trajectory, bool]:
    """Path and true path of a recording, and whether their stamps are times: else they are numbers of its frames."""
    if one["trajectory"] is None:
        raise bad_input(folder.path, f"has no path of {one['name']}", "a run that has tracked each recording")
    file = folder.path / one["trajectory"]
    folder.check_unchanged(file)
    path, reference = read_trajectory(file), true_path(truth, None)
    if truth.is_dir() or has_stamps(truth):
        return path, reference, True
    own = _rows_by_stamp(one, rows)
    if not all(stamp in own for stamp in path.stamp.tolist()):
        raise bad_input(file, "has a stamp that is not in run.json", "those of one run")
    numbers = frame_numbers([own[stamp] for stamp in path.stamp.tolist()], len(reference))
    return Trajectory(numbers, path.T_world_camera), reference, False


def _rows_by_stamp(one: dict[str, Any], rows: list[dict[str, Any]]) -> dict[float, dict[str, Any]]:
    """Place and name of each frame of a recording by its own stamp; of several of one moment, of the first."""
    found: dict[float, dict[str, Any]] = {}
    for row in rows:
        place = row["index"] - one["first"]
        if 0 <= place < one["frames"]:
            name = str(row.get("name", "")).removeprefix(f"{one['name']}/")
            found.setdefault(float(row.get("own_stamp", row["stamp"])), {"index": place, "name": name})
    return found


def _as_one(pairs: Sequence[tuple[Trajectory, Trajectory, bool]], how: Options) -> TrajectoryErrors:
    """Errors of several paths, laid on their true ones as one."""
    moved, end = list[tuple[Trajectory, Trajectory]](), 0.0
    for path, truth, _ in pairs:
        shift = end + _APART - min(path.stamp[0], truth.stamp[0])
        end = max(path.stamp[-1], truth.stamp[-1]) + shift
        moved.append((_later(path, shift), _later(truth, shift)))
    begins = [float(path.stamp[0]) for path, _ in moved]
    path, truth = map(_concatenated, zip(*moved, strict=True))
    return how._replace(parts=begins).compare(path, truth, is_stamped=pairs[0][2])


def _later(path: Trajectory, shift: float) -> Trajectory:
    return Trajectory(path.stamp + shift, path.T_world_camera)


def _concatenated(parts: Sequence[Trajectory]) -> Trajectory:
    columns = ([getattr(part, name) for part in parts] for name in ("stamp", "T_world_camera"))
    return Trajectory(*map(np.concatenate, columns))
