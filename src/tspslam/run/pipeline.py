"""A source of pairs to a run folder: the camera's path, keyframes, map, pictures and report."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io import RunFolder, StoredFrame, read_frame
from ..io.maps import write_maps
from ..session import Session
from ..topology.complex import Complex
from ..types import Cloud, FloatArray, Image, Response, Rig, Signals, StereoPair, Surface
from .config import Resolved
from .record import hash_of, machine, run_record
from .sequence import STATE_NAME, SequenceRun, folder_name, merged_map
from .sequence import Source as Source

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class OnePair:
    """A source of a single pair."""

    pair: StereoPair

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
    """What a run left: its folder, and the content of its ``run.json``."""

    folder: Path
    run: dict[str, Any]

    @property
    def is_degraded(self) -> bool:
        """Whether frames were skipped or lost."""
        return bool(self.run["status"] != "complete")


def run(
    source: Source, out: Path, resolved: Resolved, *, frames: range | None = None, progress: Progress | None = None
) -> RunResult:
    """Track the camera through the pairs of `source` and fill the run folder `out`.

    A pair that cannot be used is skipped with a warning, and the run is degraded; if none can, its error is raised.
    A run that was stopped goes on from the last checkpoint and, on the same machine with the same versions, ends with
    the same bytes.

    Parameters
    ----------
    source : Source
        The pairs.
    out : path
        The run folder; new, empty, or of the same settings (then it goes on from the last checkpoint).
    resolved : Resolved
        The settings.
    frames : range, optional
        Which pairs; all by default.
    progress : callable, optional
        Called with (frames done, frames in all, name) after each.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If no pair can be used, or `out` is not ours or has other settings.
    OutputError
        If something cannot be written.
    """
    started = time.perf_counter()
    wanted = frames if frames is not None else range(len(source))
    if not wanted:
        raise InputError(f"{source.name}: frames {wanted} select none of {len(source)} pairs")
    chosen = None if frames is None else [frames.start, frames.stop, frames.step]
    settings = resolved.nested | {"source": {"name": source.name, "frames": chosen}}
    with RunFolder.create(out, settings) as folder:
        sequence = SequenceRun(source, wanted, Session(source.rig, resolved.settings), folder)
        try:
            record = _travel(sequence, progress)
        finally:
            sequence.session.close()
        seconds = {row["name"]: row["seconds"] for row in sequence.rows if row.get("seconds")}
        folder.write_timings({"frames": seconds, "total_s": time.perf_counter() - started, "machine": machine()})
    return RunResult(out, record)


def _travel(sequence: SequenceRun, progress: Progress | None) -> dict[str, Any]:
    """Process what is left, then write what is known at the end; returns the content of ``run.json``."""
    total = len(sequence.wanted)
    for done, index in sequence.proceed():
        if progress:
            progress(done, total, f"frame {index}")
    if not sequence.stored:
        if sequence.last_error and total == 1:
            raise sequence.last_error
        raise InputError(f"{sequence.source.name}: none of {total} pairs can be used; the last: {sequence.last_error}")
    sequence.session.finish()
    record = run_record(sequence, getattr(sequence.source, "unpaired", []))
    _write_results(sequence, record)
    return record


def _write_results(sequence: SequenceRun, record: dict[str, Any]) -> None:
    """Trajectory, map, pictures and report; the report comes last, so its line says all is there."""
    folder, trajectory = sequence.folder, sequence.trajectory
    key = hash_of([record, *(folder.units[folder_name(row)].sha256 for row in sequence.stored)])
    if not _is_finished(folder, key):
        shown = sequence.stored[0]
        stored = read_frame(folder.frame_path(shown["index"]))
        paths = folder.write_trajectory(trajectory.stamp, trajectory.T_world_camera)
        image = sequence.source[shown["index"]].left
        finish(folder, paths, image, stored, record, key, whole=merged_map(sequence), poses=trajectory.T_world_camera)
    frames = [f"frames/{row['index']:06d}.{kind}" for row in sequence.stored for kind in ("npz", "json")]
    folder.keep([STATE_NAME, *frames, *(name for name, unit in folder.units.items() if unit.input == key)])


def _is_finished(folder: RunFolder, key: str) -> bool:
    names = [name for name, unit in folder.units.items() if unit.input == key]
    return "report.html" in names and all(folder.is_done(folder.path / name, input_hash=key) for name in names)


def finish(
    folder: RunFolder, paths: list[Path], image: Image, frame: StoredFrame, record: dict[str, Any], key: str,
    *, whole: StoredFrame | None = None, poses: FloatArray | None = None,
) -> None:  # fmt: skip
    """Write maps, pictures, report and ``run.json``; note them and `paths` as finished from input `key`.

    Maps are of `whole`, pictures and report of `frame`; a path of several `poses` gets a picture too.
    """
    from ..view import pictures, report, write_plan_picture

    shown = ImagedFrame(frame.name, image, frame.cloud, frame.surface, frame.complex_, frame.signals, frame.response)
    whole = whole or frame
    write_maps(folder.map_vtu_path, folder.map_ply_path, whole)
    drawn = pictures.write_pictures(shown, folder.path / "pictures")
    if poses is not None and len(poses) > 1:
        drawn.insert(0, folder.picture_path("path"))
        write_plan_picture(poses[:, :3, 3], whole.cloud.xyz, drawn[0])
    run_path = folder.write_run(record)
    report.write_report(shown, record, drawn, folder.report_path)
    for path in (*paths, folder.map_vtu_path, folder.map_ply_path, *drawn, run_path, folder.report_path):
        folder.record(path, input_hash=key)


@dataclass(frozen=True)
class ImagedFrame:
    """A frame with its image, as pictures and report need it."""

    name: str
    image: Image
    cloud: Cloud
    surface: Surface
    complex_: Complex
    signals: Signals
    response: Response
