"""Finished runs whose maps can be joined: what each is of, and why another cannot be."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

from ..._brief import Brief
from ..._files import PathLike, bad_input
from ...datasets.joined import StoredRecording, check_same_rig
from ...errors import InputError
from ...io import RunFolder, StoredRun, load_run
from ...run.config import Resolved, resolve
from ...run.continuing import frames_of, stored_parts
from ...run.record import FrameRecord
from ...run.sequence import STATE_NAME
from ...types import Rig


@dataclass(frozen=True, repr=False)
class FinishedRun(Brief):
    """A finished run, as those need to know it who join its map to others.

    Attributes
    ----------
    path : str
        Its folder, absolute.
    state : str
        SHA-256 of its checkpoint.
    parts : tuple of StoredRecording
        What it is of.
    frames : range
        Which pairs of its source it is of.
    pairs, tracked, stored : int
        How many pairs it has, how many of them have a pose, and how many of these a file.
    next_id : int
        Number of the next landmark.
    first_hashes : tuple of str
        Hashes of what the first tracked frame of each recording was made from.
    """

    path: str
    state: str
    parts: tuple[StoredRecording, ...]
    frames: range
    pairs: int
    tracked: int
    stored: int
    next_id: int
    first_hashes: tuple[str, ...]

    @property
    def is_numbered(self) -> bool:
        """Whether its pairs are those of its source from 0 on, one after another."""
        return self.frames == range(self.pairs)

    @property
    def rig(self) -> Rig:
        """Its cameras."""
        return self.parts[0].rig

    @property
    def settings(self) -> Resolved:
        """Its settings."""
        return resolve(file=Path(self.path) / "config.yaml")


def find_runs(paths: Sequence[PathLike]) -> tuple[list[FinishedRun], dict[str, str]]:
    """Read what runs are of; those that cannot be joined are left out.

    Parameters
    ----------
    paths : sequence of path
        Run folders; one that is given twice counts once.

    Returns
    -------
    list of FinishedRun
        In the order in which they were given; the settings and cameras of the first are those of all.
    dict of str to str
        Why each of the others was left out, by its path as it was given.
    """
    runs: list[FinishedRun] = []
    left_out: dict[str, str] = {}
    given: dict[str, PathLike] = {}
    for path in paths:
        given.setdefault(os.path.abspath(path), path)
    for path in given.values():
        try:
            run = _read_run(path)
            if runs:
                _refuse_unlike(path, run, runs)
        except InputError as error:
            left_out[str(path)] = str(error)
        else:
            runs.append(run)
    return runs, left_out


def _read_run(path: PathLike) -> FinishedRun:
    stored = load_run(path)
    rows, state, parts = stored_parts(stored)
    _refuse_gaps(stored)
    frames = frames_of(stored)
    if len(parts) > 1 and frames != range(len(rows)):
        raise bad_input(path, "is of some frames of several recordings", "a run of all of them, or of one recording")
    folder = RunFolder.open(stored.path)
    tracked = [row for row in rows if isinstance(row, FrameRecord)]
    if len(rows) != sum(map(len, parts)):
        raise bad_input(
            path, f"has {len(rows)} frames in its checkpoint", f"{sum(map(len, parts))}, as in its run.json"
        )
    run = FinishedRun(
        os.path.abspath(path), folder.units[STATE_NAME].sha256, tuple(parts), frames, len(rows), len(tracked),
        sum(row.complex_ is not None for row in tracked), int(state["next_id"]), _first_hashes(parts, tracked),
    )  # fmt: skip
    if run.settings.settings.mapping.fix_offset:
        raise bad_input(path, "was made with --fix-offset: its frames are those of its own offset", "a run without")
    return run


def _first_hashes(parts: Sequence[StoredRecording], tracked: Sequence[FrameRecord]) -> tuple[str, ...]:
    """Hashes of the first tracked frames of recordings, which frames keep wherever they are numbered anew."""
    found: dict[int, str] = {}
    ends = list(accumulate(map(len, parts)))
    for row in tracked:
        found.setdefault(bisect_right(ends, row.index), row.input_hash)
    return tuple(found.values())


def _refuse_gaps(stored: StoredRun) -> None:
    """Refuse a run without the files of some of its frames; what is in them is looked at where they are read."""
    folder = RunFolder.open(stored.path)
    for name, unit in folder.units.items():
        file = stored.path / name
        if name.startswith("frames/") and not (file.is_file() and file.stat().st_size == unit.bytes):
            raise bad_input(file, "is missing or was changed since the run", "the file that the manifest lists")


def _refuse_unlike(path: PathLike, run: FinishedRun, runs: Sequence[FinishedRun]) -> None:
    """Refuse what cannot be in one map with runs: other cameras or settings, or what is in it already."""
    first = runs[0]
    for said in _differences(first, run):
        raise bad_input(path, said, f"the settings of {first.path}: one map has one kind of landmarks")
    check_same_rig(first.rig, first.path, run.rig, str(path))
    for other in runs:
        if set(other.first_hashes) & set(run.first_hashes):
            raise bad_input(path, f"is of a recording that {other.path} has", "runs of different recordings")


def _differences(first: FinishedRun, run: FinishedRun) -> Iterator[str]:
    known, own = first.settings.values, run.settings.values
    return (f"{name} is {own.get(name)!r} and was {value!r}" for name, value in known.items() if own.get(name) != value)
