"""A source of pairs to a run folder: the camera's path, keyframes, map, pictures and report."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._checks import refuse_path, require_path, require_stage, told
from .._files import PathLike
from .._stopwatch import Stopwatch
from ..datasets import JoinedSequence, open_sequence
from ..datasets.joined import Source
from ..errors import GeometryError, InputError
from ..frame import Frame
from ..io import RunFolder, read_frame, write_map
from ..io._places import TIMINGS
from ..io.maps import write_maps
from ..session import Session, Settings
from ..topological_map import TopologicalMap
from ..types import FloatArray, Rig, StereoPair
from ..vision.evaluate import TrajectoryErrors
from ._stages import OnStep, Stages
from .config import Resolved, as_resolved
from .evaluate import describe_errors, measured
from .joining import describe_recordings, note_landmarks, placed_path, placed_poses, write_own_paths
from .map import join_keyframes, stored_keyframes
from .offset import fix_offset
from .record import hash_of, machine
from .sequence import STATE_NAME, GrowingSource, OnFrame, SequenceRun
from .sequence import Step as Step
from .summary import Warning_, describe_map, doubts_of_map, summarize_run

if TYPE_CHECKING:
    from ..view._report_parts import WholeRun

Progress = Callable[[int, int, str], None]
_INCOMPLETE = "camera_lost", "join_left_out"  # warnings by a source, or by a run gone on with: something is missing


@dataclass(frozen=True)
class OnePair:
    """A source of a single pair, and remarks on it."""

    pair: StereoPair
    remarks: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The pair's name."""
        return self.pair.name

    @property
    def rig(self) -> Rig:
        """The pair's cameras."""
        return self.pair.rig

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> StereoPair:
        range(1)[index]
        return self.pair


@dataclass(frozen=True)
class RunResult:
    """What a run left: its folder, and the content of its ``run.json`` and, of a sequence, its ``timings.json``."""

    folder: Path
    run: dict[str, Any]
    times: dict[str, Any] = field(default_factory=dict)

    @property
    def is_degraded(self) -> bool:
        """Whether frames were skipped or lost."""
        return bool(self.run["status"] != "complete")


def run(
    source: Source, out: PathLike, resolved: Resolved | Settings, *,
    frames: range | None = None, progress: Progress | None = None, on_frame: OnFrame | None = None,
    on_step: OnStep | None = None,
) -> RunResult:  # fmt: skip
    """Track the camera through the pairs of `source` and fill the run folder `out`.

    A pair that cannot be used is skipped with a warning, and the run is degraded; if none can, its error is raised.
    A run that was stopped goes on from the last checkpoint and, on the same machine with the same versions, ends with
    the same bytes.

    Parameters
    ----------
    source : Source
        The pairs; `OnePair` makes one of a single pair, `tspslam.datasets.open_sequence` of a path. One that has
        ``wait_for(index)``, as `tspslam.datasets.LiveSequence`, is asked for its pairs as they come.
    out : path
        The run folder; new, empty, or of the same settings (then it goes on from the last checkpoint).
    resolved : Resolved or Settings
        The settings; as for `run_path`, stages are of the kinds that settings have names for.
    frames : range, optional
        Which pairs, such as ``range(0, 100)``; all by default.
    progress : callable, optional
        Called with (frames done, frames in all, name) after each.
    on_frame : callable, optional
        Called with each `Frame`, in order, in this thread, as soon as its pose is known; asking for a part of it waits
        until that is computed. Not of pairs that are skipped, nor of frames that an earlier run has finished. What it
        raises ends the run; the same command goes on from the last checkpoint.
    on_step : callable, optional
        Called with a `Step` after each pair, and where a stage begins: what is done now, how far, and how it goes.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If an argument is of another kind, `frames` go beyond the pairs, no pair can be used, or `out` is not ours or
        has other settings.
    OutputError
        If something cannot be written.
    """
    for called, name in ((on_frame, "on_frame"), (progress, "progress"), (on_step, "on_step")):
        if called is not None:
            require_stage(called, name, "print")
    _require_source(source)
    resolved, wanted = as_resolved(resolved), _wanted(source, frames)
    require_path(out, "out")
    started = time.perf_counter()
    with RunFolder.create(out, settings_of(source, frames, resolved)) as folder:
        sequence = SequenceRun(source, wanted, Session(source.rig, resolved.settings, keep=False), folder)
        at = Stages(sequence, on_step)
        try:
            record = _process_all(sequence, progress, on_frame, at)
        finally:
            sequence.session.close()
        times = {"frames": sequence.seconds, "map_s": sequence.map_seconds, "total_s": time.perf_counter() - started}
        times |= at.end()
        _write_timings(sequence, times)
    return RunResult(Path(out), record, times)


def run_path(
    path: PathLike, out: PathLike, settings: Resolved | Settings | None = None, *,
    frames: range | None = None, progress: Progress | None = None, on_frame: OnFrame | None = None,
    on_step: OnStep | None = None,
) -> RunResult:  # fmt: skip
    """Open the sequence at a path and run it: one call of plain arguments, which a worker process can make.

    Parameters
    ----------
    path : str or path
        A folder or a bag, as `tspslam.datasets.open_sequence` takes it.
    out : str or path
        The run folder, as in `run`.
    settings : Resolved or Settings, optional
        Stages of the kinds that settings have names for; the defaults serve.
    frames, progress, on_frame, on_step
        As `run`; the functions are called in the process that runs.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If the path holds no sequence, a stage is none that settings can name, or as `run`.
    OutputError
        If something cannot be written.
    """
    resolved = as_resolved(Settings() if settings is None else settings)
    return run(open_sequence(path), out, resolved, frames=frames, progress=progress, on_frame=on_frame, on_step=on_step)


def settings_of(source: Source, frames: range | None, resolved: Resolved) -> dict[str, Any]:
    """Say what ``config.yaml`` holds: the settings, and what is run.

    Parameters
    ----------
    source : Source
        The pairs.
    frames : range or None
        Which of them; None for all.
    resolved : Resolved
        The settings.

    Returns
    -------
    dict
        Plain values.
    """
    chosen = None if frames is None else [frames.start, frames.stop, frames.step]
    said: dict[str, Any] = {"name": source.name, "frames": chosen}
    if isinstance(source, JoinedSequence):
        pairs = zip(source.names, map(len, source.recordings), strict=True)
        said["recordings"] = [{"name": name, "pairs": count} for name, count in pairs]
        said |= {"joined_from": list(source.joined_from)} if source.joined_from else {}
    return resolved.nested | {"source": said}


def _write_timings(sequence: SequenceRun, times: dict[str, Any]) -> None:
    """Write the times of what was done; where all was there already, those of the call that did it stay."""
    if sequence.seconds or not (sequence.folder.path / TIMINGS).exists():
        sequence.folder.write_timings(times | {"machine": machine()})


def _require_source(source: object) -> None:
    """Refuse what is no sequence of pairs."""
    refuse_path(source, "source", "a sequence of pairs", "tspslam.datasets.open_sequence(path)")
    lacking = [part for part in ("name", "rig", "__len__", "__getitem__") if not hasattr(source, part)]
    if lacking or isinstance(source, type):
        way = "OnePair(pair)" if isinstance(source, StereoPair) else "tspslam.datasets.open_sequence(path) gives one"
        found = repr(source) if isinstance(source, type) else f"{told(source)} without {lacking[0]}"
        raise InputError(f"source is {found:.80}, expected a sequence of pairs: {way}")


def _wanted(source: Source, frames: range | None) -> range:
    """The indices of the pairs to process; of a source that grows, none yet."""
    if isinstance(source, GrowingSource):
        if frames is not None:
            raise InputError(f"{source.name}: frames {frames} are given, expected none: they are taken as they come")
        return range(0)
    count = len(source)
    wanted = range(count) if frames is None else frames
    if not isinstance(wanted, range):
        raise InputError(f"frames is {told(wanted)} {wanted!r:.40}, expected a range, such as range(0, 3)")
    if not wanted:
        raise InputError(f"{source.name}: frames {wanted} select none of {count} pairs")
    if min(wanted) < 0 or max(wanted) >= count:
        raise InputError(f"{source.name}: frames {wanted} go beyond its pairs, expected a range within 0 to {count}")
    return wanted


def _process_all(
    sequence: SequenceRun, progress: Progress | None, on_frame: OnFrame | None, at: Stages
) -> dict[str, Any]:
    """Process what is left, then write what is known at the end; returns the content of ``run.json``."""
    at("tracking")
    for done, index in sequence.proceed(on_frame, lambda: at("adjustment")):
        at("tracking")
        if progress:
            progress(done, len(sequence.wanted), f"frame {index}")
    total = len(sequence.wanted)
    if not total:
        raise InputError(f"{sequence.source.name}: ended before it gave a pair, expected one at least")
    if not sequence.stored:
        if sequence.last_error and total == 1:
            raise sequence.last_error
        raise InputError(f"{sequence.source.name}: none of {total} pairs can be used; the last: {sequence.last_error}")
    if sequence.session.settings.mapping.fix_offset:
        fix_offset(sequence)
    record = summarize_run(
        sequence.source.name, sequence.rows, sequence.session,
        settings_hash=sequence.folder.config_hash, unpaired=getattr(sequence.source, "unpaired", ()),
    )  # fmt: skip
    errors, said = measured(sequence.source, placed_path(sequence), sequence.wanted)
    record = _of_recordings(sequence, record)
    said = [*getattr(sequence.source, "warnings", ()), *said]
    record |= {"status": "degraded"} if any(one["code"] in _INCOMPLETE for one in said) else {}
    record |= {"evaluation": describe_errors(errors)} if errors else {}
    record, said = _of_depths(sequence.source, record), [*said, *getattr(sequence.source, "doubts", list)()]
    return _write_all(sequence, record | {"warnings": [*record["warnings"], *said]}, errors, at)


def _of_recordings(sequence: SequenceRun, record: dict[str, Any]) -> dict[str, Any]:
    """What is said of a run, with what there is to say of its recordings, if it has several."""
    told, warnings = describe_recordings(sequence)
    if not told:
        return record
    placed = placed_poses(sequence)
    rows = [row if row["index"] in placed else row | {"is_apart": True} for row in record["per_frame"]]
    record |= {"recordings": told, "per_frame": rows, "warnings": [*record["warnings"], *warnings]}
    return record | ({"status": "degraded"} if warnings else {})


def _of_depths(source: Source, record: dict[str, Any]) -> dict[str, Any]:
    """What is said of a run, with what its source tells of its depths, if it has some."""
    if isinstance(source, OnePair) and source.pair.disparity_range is not None:
        record |= {"calibration": record["calibration"] | {"disparity_range_px": list(source.pair.disparity_range)}}
    return record | {"depth": source.describe()} if hasattr(source, "describe") else record


def _write_all(
    sequence: SequenceRun, record: dict[str, Any], errors: TrajectoryErrors | None, at: Stages
) -> dict[str, Any]:
    """Trajectory, map, pictures and report; the report comes last, so its line says all is there."""
    folder = sequence.folder
    frames = [f"frames/{folder.frame_path(row.index).name}" for row in sequence.stored]
    key = hash_of([record, *(folder.units[name].sha256 for name in frames)])
    record = folder.read_run() if _is_finished(folder, key) else _write_results(sequence, record, key, errors, at)
    results = [name for name, unit in folder.units.items() if unit.input == key]
    folder.keep([STATE_NAME, *frames, *(name.replace(".npz", ".json") for name in frames), *results])
    return record


def _write_results(
    sequence: SequenceRun, record: dict[str, Any], key: str, errors: TrajectoryErrors | None, at: Stages
) -> dict[str, Any]:
    """All that is made once the path is final; returns the record with what is said of the map."""
    from .report import describe_whole

    at("map")
    folder, trajectory, watch = sequence.folder, placed_path(sequence), Stopwatch()
    paths = [note_landmarks(sequence)]
    folder.record(paths[0], input_hash=key)
    made, warnings = _make_map(folder, sequence.session.settings, record["landmarks"])
    if made is not None:
        write_map(folder.map_npz_path, made)
        paths.append(folder.map_npz_path)
    watch.lap("map")
    sequence.map_seconds = watch.seconds["map"]
    record = describe_map(record, made, warnings)
    paths += folder.write_trajectory(trajectory.stamp, trajectory.T_world_camera)
    paths += write_own_paths(sequence)
    shown = read_frame(folder.frame_path(sequence.stored[0].index))
    whole = describe_whole(
        folder, record, sequence.session.settings, [row.index for row in sequence.stored],
        rig=shown.rig, made=made, poses=placed_poses(sequence), errors=errors,
    )  # fmt: skip
    write_results(folder, paths, shown, record, key, made=made, poses=trajectory.T_world_camera, whole=whole, at=at)
    return record


def _make_map(folder: RunFolder, settings: Settings, landmarks: int) -> tuple[TopologicalMap | None, list[Warning_]]:
    """The map of the stored keyframes, if they span one; and what is to be said."""
    try:
        given = stored_keyframes(folder)
        made, landmarks = join_keyframes(given, settings), min(landmarks, len(given.snapshot.landmark_id))
    except (GeometryError, InputError) as error:  # landmarks that span none, or too many: the path is there
        return None, [{"code": "map", "message": f"there is no map of all keyframes ({error})"}]
    return made, list(doubts_of_map(made, landmarks)) if len(made.keyframes) > 1 else []


def _is_finished(folder: RunFolder, key: str) -> bool:
    names = [name for name, unit in folder.units.items() if unit.input == key]
    return "report.html" in names and all(folder.is_done(folder.path / name, input_hash=key) for name in names)


def write_results(
    folder: RunFolder, paths: list[Path], frame: Frame, record: dict[str, Any], key: str,
    *, made: TopologicalMap | None = None, poses: FloatArray | None = None, whole: WholeRun | None = None,
    at: Callable[[str], object] = lambda _: None,
) -> None:  # fmt: skip
    """Write maps, pictures, report and ``run.json``; note them and `paths` as finished from input `key`.

    Parameters
    ----------
    folder : RunFolder
        Where to.
    paths : list of Path
        Files of the folder that are written already.
    frame : Frame
        What pictures and report show; with its image.
    record : dict
        Content of ``run.json``.
    key : str
        Hash of what all of it was made from.
    made : TopologicalMap, optional
        The map; where there is none, or it is of one keyframe, `frame` is shown as the map.
    poses : (T, 4, 4) float64, optional
        The path; of several, there is a picture too.
    whole : WholeRun, optional
        What the report shows of a run besides.
    at : callable, optional
        Called with the name of each stage, "pictures" and "report", where it begins.
    """
    from ..view import pictures, report, write_plan_picture
    from ..view.map_pictures import write_map_pictures

    of_all = None if made is None or len(made.keyframes) < 2 else made
    write_maps(folder.map_vtu_path, folder.map_ply_path, frame if of_all is None else of_all)
    at("pictures")
    drawn = pictures.write_pictures(frame, folder.path / "pictures")
    if poses is not None and len(poses) > 1:
        drawn.insert(0, folder.picture_path("path"))
        write_plan_picture(poses[:, :3, 3], frame.cloud.xyz if of_all is None else of_all.xyz, drawn[0])
    drawn += [] if of_all is None else write_map_pictures(of_all, folder.path / "pictures")
    run_path = folder.write_run(record)
    at("report")
    report.write_report(frame, record, drawn, folder.report_path, map_=of_all, whole=whole)
    for path in (*paths, folder.map_vtu_path, folder.map_ply_path, *drawn, run_path, folder.report_path):
        folder.record(path, input_hash=key)
