"""A source of pairs to a run folder: frame by frame, each noted when it is finished, resumed where it stopped."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from .config import Resolved
from .errors import InputError
from .io import RunFolder, StoredFrame, read_frame, write_bytes, write_frame
from .io.maps import write_maps
from .records import Summary, Warning_, frame_summary, hash_of, machine, pair_hash, run_record
from .session import Session
from .topology.complex import Complex
from .types import Cloud, Image, Response, Rig, Signals, StereoPair, Surface

Progress = Callable[[int, int, str], None]


class Source(Protocol):
    """Pairs of one rig, by index."""

    @property
    def name(self) -> str:
        """What to call it."""

    @property
    def rig(self) -> Rig:
        """The cameras of all pairs."""

    def __len__(self) -> int:
        """How many pairs there are."""

    def __getitem__(self, index: int) -> StereoPair:
        """Read one pair."""


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
        """Whether frames were skipped."""
        return bool(self.run["status"] != "complete")


def run(
    source: Source, out: Path, resolved: Resolved, *, frames: range | None = None, progress: Progress | None = None
) -> RunResult:
    """Process each pair of `source` on its own and fill the run folder `out`.

    A pair that cannot be used is skipped with a warning, and the run is degraded; if none can, its error is raised.

    Parameters
    ----------
    source : Source
        The pairs.
    out : path
        The run folder; new, empty, or of the same settings (then finished frames are kept).
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
        shown, done, skipped = _process_all(source, wanted, Session(source.rig, resolved.settings), folder, progress)
        unpaired = getattr(source, "unpaired", [])
        record = run_record(source.name, unpaired, source.rig, done, skipped, folder.config_hash, shown.name)
        _write_results(folder, shown, record, done)
        seconds = {unit["name"]: unit["seconds"] for unit in done if unit["seconds"]}
        folder.write_timings({"frames": seconds, "total_s": time.perf_counter() - started, "machine": machine()})
    return RunResult(out, record)


def _process_all(
    source: Source, wanted: range, session: Session, folder: RunFolder, progress: Progress | None
) -> tuple[StereoPair, list[Summary], list[Warning_]]:
    """The first pair that can be used, a summary of each, and what was skipped."""
    first: StereoPair | None = None
    done: list[Summary] = []
    skipped: list[Warning_] = []
    last: InputError | None = None
    for count, index in enumerate(wanted, 1):
        try:
            pair = source[index]
            done.append(_process_one(pair, session, folder))
            first = first or pair
        except InputError as error:
            last = error
            skipped.append({"code": "frame_skipped", "message": f"frame {index}: {error}"})
        if progress:
            progress(count, len(wanted), f"frame {index}")
    if first is None:
        if last and len(wanted) == 1:
            raise last
        raise InputError(f"{source.name}: none of {len(wanted)} pairs can be used; the last: {last}")
    return first, done, skipped


def _process_one(pair: StereoPair, session: Session, folder: RunFolder) -> Summary:
    """Summary of one frame; computed anew only if the folder does not hold it."""
    key, path = _input_hash(pair, session), folder.frame_path(pair.index)
    summary_path = path.with_suffix(".json")
    if folder.is_done(path, input_hash=key) and folder.is_done(summary_path, input_hash=key):
        stored: Summary = json.loads(summary_path.read_text(encoding="utf-8"))
        return stored | {"seconds": {}}
    frame = session.process(pair)
    summary = frame_summary(frame, key)
    write_frame(path, frame)
    write_bytes(summary_path, (json.dumps(summary, indent=1, allow_nan=False) + "\n").encode())
    folder.record(path, input_hash=key)
    folder.record(summary_path, input_hash=key)
    return summary | {"seconds": frame.seconds}


def _input_hash(pair: StereoPair, session: Session) -> str:
    """Hash of all that a frame is made from besides the settings: the pair, and files that stages read."""
    key, prints = pair_hash(pair), session.fingerprints
    return hash_of([key, prints]) if any(prints) else key


def _write_results(folder: RunFolder, pair: StereoPair, record: dict[str, Any], done: list[Summary]) -> None:
    """Trajectory, map, pictures and report of the first frame; the report comes last, so its line says all is there."""
    key = hash_of([record, folder.units[f"frames/{pair.index:06d}.npz"].sha256])
    if not _is_finished(folder, key):
        stored = read_frame(folder.frame_path(pair.index))
        paths = folder.write_trajectory([done[0]["stamp"]], np.eye(4)[None])
        finish(folder, paths, pair.left, stored, record, key)
    frames = [f"frames/{unit['index']:06d}.{kind}" for unit in done for kind in ("npz", "json")]
    folder.keep([*frames, *(name for name, unit in folder.units.items() if unit.input == key)])


def _is_finished(folder: RunFolder, key: str) -> bool:
    names = [name for name, unit in folder.units.items() if unit.input == key]
    return "report.html" in names and all(folder.is_done(folder.path / name, input_hash=key) for name in names)


def finish(
    folder: RunFolder, paths: list[Path], image: Image, frame: StoredFrame, record: dict[str, Any], key: str
) -> None:
    """Write maps, pictures, report and ``run.json``; note them and `paths` as finished from input `key`."""
    from .view import pictures, report

    shown = ImagedFrame(frame.name, image, frame.cloud, frame.surface, frame.complex_, frame.signals, frame.response)
    write_maps(folder.map_vtu_path, folder.map_ply_path, frame)
    drawn = pictures.write_pictures(shown, folder.path / "pictures")
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
