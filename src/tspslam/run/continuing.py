"""A finished run gone on with: further recordings into its map."""

from __future__ import annotations

import os
import shutil
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from .._atomic import atomic_write, bad_output
from .._checks import require_path
from .._files import PathLike, bad_input, one_line
from .._npz import Arrays
from ..datasets.joined import Excerpt, JoinedSequence, Source, StoredRecording, check_same_rig
from ..errors import InputError
from ..io import RunFolder, StoredRun, load_run, read_frame
from ..io._places import is_of_a_run
from ..io._settling import is_run_folder
from ..io.frames import read_frame_image
from ..io.lock import FolderLock
from ..session import Session
from ..types import Image, Rig
from ..vision.slam.odometry import StereoOdometry
from ._checkpoint import read_checkpoint
from ._stages import OnStep
from .config import Resolved, resolve
from .pipeline import Progress, RunResult, run, settings_of
from .record import FrameRecord, Row, pair_hash
from .sequence import MADE_BY, STATE_NAME, OnFrame

_OF_READERS = (
    "join_",
    "camera_lost",
    "frames_dropped",
    "frames_missed",
    "unpaired",
    "video_",
    "depth_",
)  # warnings by those who read pairs, or joined runs
_FEWEST = 2  # frames of a run that has a path, and that tell a recording


def run_into(
    folder: PathLike, recordings: Sequence[Source], given: Resolved | None = None, *,
    progress: Progress | None = None, on_frame: OnFrame | None = None, on_step: OnStep | None = None,
) -> RunResult:  # fmt: skip
    """Go on with a finished run: track further recordings in its map, and make its results anew.

    What comes of it is what one run of all recordings gives, byte for byte. It is made in a folder beside the run,
    ``RUN-joining``, which takes its place when all is there: until then the run is as it was. The same call goes on
    after a stop. Frames that the run has stored serve instead of its pairs.

    Parameters
    ----------
    folder : path
        The run.
    recordings : sequence of sequences of pairs
        What to add, of the same rig.
    given : Resolved, optional
        Settings: those that were given must be the run's; the run's by default.
    progress, on_frame, on_step : callable, optional
        As for `run`.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If the run is not finished, of another version, of a single pair, or of part of its source; made with
        ``--fix-offset``, with other settings (each is named) or of another rig; if a recording is in it already, or
        none of its pairs can be used: the run stays as it was; or if another process uses it.
    OutputError
        If something cannot be written.
    """
    require_path(folder, "into")
    place = Path(folder).resolve()
    work, before = place.with_name(f"{place.name}-joining"), place.with_name(f".{place.name}-before-joining")
    _recover(place, work, before)
    if os.path.lexists(before):
        raise bad_input(before, "is there", "a free name, for the run while its results change places")
    stored = load_run(place)
    lock = FolderLock(place)
    try:
        resolved = _settings(place, given)
        _refuse_excerpt(stored)
        rows, _, parts = stored_parts(stored)
        _refuse_again(stored, rows, parts, recordings)
        source = JoinedSequence([*parts, *recordings])
        _bring(place, work, settings_of(source, None, resolved))
        result = run(source, work, resolved, progress=progress, on_frame=on_frame, on_step=on_step)
        _refuse_untracked(result, len(recordings), work)
    finally:
        lock.release()
    _take_place(place, work, before)
    return replace(result, folder=Path(folder))


def excerpts(source: Source, frames: range | None) -> list[Source]:
    """Take a source, or some of its frames, for recordings to be added to a run.

    Parameters
    ----------
    source : Source
        One recording, or several.
    frames : range or None
        Which of its frames; None for all.

    Returns
    -------
    list of sequences of pairs
    """
    if isinstance(source, JoinedSequence):
        return list(source.recordings)
    return [source if frames is None else Excerpt(source, frames)]


def _settings(place: Path, given: Resolved | None) -> Resolved:
    """The run's settings; those that were given must be the same."""
    own = resolve(file=place / "config.yaml")
    values = own.values
    for name, value in {} if given is None else given.values.items():
        if given is not None and given.origin[name] != "default" and values.get(name) != value:
            said = f"{name} was {values.get(name)!r} and is now {value!r}"
            raise bad_input(place, said, "the settings of the run that is gone on with")
    if own.settings.mapping.fix_offset:
        way = "one without: tspslam run A B --fix-offset --out NEW makes both at once"
        raise bad_input(place, "was made with --fix-offset: its frames are those of the shorter path", way)
    return own


def _refuse_excerpt(stored: StoredRun) -> None:
    """Refuse a run of later pairs of its source: those that come into it go on from the first one."""
    frames = frames_of(stored)
    if frames.start != 0 or frames.step != 1:
        said = f"is of frames {frames.start}:{frames.stop}:{frames.step} of its source"
        raise bad_input(stored.path, said, "frames from 0 on")


def stored_parts(stored: StoredRun) -> tuple[list[Row], Arrays, list[StoredRecording]]:
    """Find what of a finished run can be gone on with.

    Parameters
    ----------
    stored : StoredRun
        The run.

    Returns
    -------
    rows : list of FrameRecord or SkippedPair
        Of its checkpoint, numbered from 0 on.
    state : dict of str to array, such as ``xyz`` (M, 3) float64
        Likewise; the odometry's, before the end of the path.
    recordings : list of StoredRecording
        What it is of.

    Raises
    ------
    InputError
        If it is of another version, of a single pair, or not of pairs.
    """
    place, record = stored.path, stored.record
    folder = RunFolder.open(place)
    if "command" in folder.config or "per_frame" not in record:
        raise bad_input(place, "is no run of pairs", "one of a sequence")
    if record["frames"] < _FEWEST:
        raise bad_input(place, "is a run of a single pair", "one of a sequence")
    rows, state = _checkpoint(folder)
    rows = number_rows(rows, frames_of(stored))
    rig = read_frame(folder.finished_frame(stored.stored[0])).rig
    return rows, state, list(_recordings(record, rows, rig))


def frames_of(stored: StoredRun) -> range:
    """Find which pairs of its source a run is of.

    Parameters
    ----------
    stored : StoredRun
        The run.

    Returns
    -------
    range
    """
    chosen = RunFolder.open(stored.path).config.get("source", {}).get("frames")
    return range(stored.record["frames"]) if chosen is None else range(*chosen)


def number_rows(rows: Sequence[Row], frames: range) -> list[Row]:
    """Number rows from 0 on.

    Parameters
    ----------
    rows : sequence of FrameRecord or SkippedPair
        By the indices of pairs.
    frames : range
        Which those are.

    Returns
    -------
    list of FrameRecord or SkippedPair
        By their places among these.
    """
    return [row if frames[place] == place else replace(row, index=place) for place, row in enumerate(rows)]


def _checkpoint(folder: RunFolder) -> tuple[list[Row], Arrays]:
    """The checkpoint of a run: its rows, and the state of the odometry."""
    path = folder.path / STATE_NAME
    if STATE_NAME not in folder.units:
        raise bad_input(folder.path, f"has no {STATE_NAME}", "a run whose path is from its pairs")
    folder.check_unchanged(path)
    try:
        return read_checkpoint(path, MADE_BY)
    except InputError as error:
        raise bad_input(path, f"cannot be gone on with ({error})", "the checkpoint of a run of this version") from error


def restore_odometry(rig: Rig, resolved: Resolved, state: Arrays, image_of: Callable[[int], Image]) -> StereoOdometry:
    """Restore the odometry of a run.

    Parameters
    ----------
    rig : Rig
        Its cameras.
    resolved : Resolved
        Its settings.
    state : dict of str to array
        As `stored_parts` gives it.
    image_of : callable
        Left image of a tracked frame by its number.

    Returns
    -------
    StereoOdometry
        To be closed.

    Raises
    ------
    InputError
        If the state is none that it can have had.
    """
    odometry = Session(rig, resolved.settings, keep=False).odometry
    assert isinstance(odometry, StereoOdometry)
    odometry.restore(state, image_of)
    return odometry


def _recordings(record: dict[str, Any], rows: Sequence[Row], rig: Any) -> Iterator[StoredRecording]:
    """The recordings of a run, as its record and its rows tell of them."""
    alone = {"name": record["source"], "first": 0, "frames": record["frames"], "stamp_offset_s": 0.0}
    warnings = tuple(one for one in record["warnings"] if one["code"].startswith(_OF_READERS))
    for k, one in enumerate(record.get("recordings", [alone])):
        own = [row for row in rows if one["first"] <= row.index < one["first"] + one["frames"]]
        tracked = [row for row in own if isinstance(row, FrameRecord)]
        stamps = [row.stamp if row.own_stamp is None else row.own_stamp for row in tracked] or [0.0]
        ends = np.array([stamps[0], stamps[-1]])
        yield StoredRecording(
            one["name"], rig, one["frames"], ends, one["stamp_offset_s"], () if k else warnings,
        )  # fmt: skip


def _refuse_again(
    stored: StoredRun, rows: Sequence[Row], parts: Sequence[StoredRecording], given: Sequence[Source]
) -> None:
    """Refuse a recording that is in the run already, by two of its pairs; and one of another rig."""
    folder, ends = RunFolder.open(stored.path), list(accumulate(map(len, parts)))
    tracked: dict[int, list[FrameRecord]] = {}  # of each part
    for row in rows:
        if isinstance(row, FrameRecord):
            tracked.setdefault(bisect_right(ends, row.index), []).append(row)
    for recording in given:
        check_same_rig(parts[0].rig, parts[0].name, recording.rig, recording.name)
        for k, own in tracked.items():
            if _is_of(recording, own, ends[k] - len(parts[k]), parts[k].offset, folder):
                said = f"is in the run already, as {parts[k].name} (frame {own[0].index} is the same)"
                raise InputError(one_line(f"{recording.name}: {said}; expected another recording"))


def _is_of(recording: Source, own: Sequence[FrameRecord], start: int, offset: float, folder: RunFolder) -> bool:
    """Whether frames are of a recording: the first two that have files show it, or the last one is made from it.

    One image alone says little: two recordings may begin at the same place, in pictures without noise.
    """
    seen = [row for row in own if row.complex_ is not None][:_FEWEST]
    checks = [partial(_shows, image=read_frame_image(folder.finished_frame(row.index))) for row in seen]
    if len(seen) < _FEWEST:
        seen, checks = [*seen, own[-1]], [*checks, partial(_makes, row=own[-1])]
    return all(
        any(check(recording, at) for at in _places_of(recording, row, row.index - start, offset))
        for row, check in zip(seen, checks, strict=True)
    )


def _places_of(recording: Source, row: FrameRecord, place: int, offset: float) -> set[int]:
    """Which pairs of a recording a frame may be of: at its place, or of its stamp, as where it is one of a piece."""
    stamps = getattr(recording, "stamps", None)
    own = row.stamp - offset if row.own_stamp is None else row.own_stamp
    same = [] if stamps is None else np.flatnonzero(np.asarray(stamps) == own).tolist()
    return {at for at in (place, *same) if at < len(recording)}


def _shows(recording: Source, index: int, image: Image) -> bool:
    """Whether a pair can be read and has that left image."""
    try:
        return np.array_equal(recording[index].left, image)
    except InputError:
        return False


def _makes(recording: Source, index: int, row: FrameRecord) -> bool:
    """Whether a pair can be read and is what a frame was made from, as it is numbered there or here."""
    try:
        pair = recording[index]
    except InputError:
        return False
    there = replace(pair, index=row.index, stamp=row.stamp, name=row.name)
    return row.input_hash in (pair_hash(pair), pair_hash(there))


def _refuse_untracked(result: RunResult, count: int, work: Path) -> None:
    """Refuse recordings of which no pair could be used: the run that they were to join would only be worse."""
    for one in result.run["recordings"][-count:]:
        if one["relative_to"] is None:
            skipped = set(range(one["first"], one["first"] + one["frames"])) & set(result.run["skipped"])
            why = f", frame {min(skipped)} first ({_reason(result, min(skipped))})" if skipped else ""
            _remove(work)
            said = f"none of its {one['frames']} pairs could be used{why}"
            raise InputError(one_line(f"{one['name']}: {said}; expected a recording to add: the run is as it was"))


def _reason(result: RunResult, frame: int) -> str:
    """Why a frame was skipped, as the run's warning has it."""
    start = f"frame {frame}: "
    said = (one["message"] for one in result.run["warnings"] if one["code"] == "frame_skipped")
    return next(message.removeprefix(start) for message in said if message.startswith(start))


def _remove(folder: Path) -> None:
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise bad_output(folder, error) from error


def _bring(place: Path, work: Path, settings: dict[str, Any]) -> None:
    """Bring what a run has stored of its frames, and its checkpoint, to the folder where it goes on."""
    run_folder = RunFolder.open(place)
    names = [name for name in run_folder.units if name.startswith("frames/")]
    with RunFolder.create(work, settings) as folder:
        if STATE_NAME in folder.units:
            return
        for name in (*sorted(names), STATE_NAME):  # the checkpoint counts once all is there
            unit = run_folder.units[name]
            if name not in folder.units:
                link_file(place / name, work / name)
                folder.record(work / name, input_hash=unit.input)
            if folder.units[name].sha256 != unit.sha256:
                raise bad_input(place / name, "was changed since the run", "the file that the manifest lists")


def link_file(file: Path, target: Path) -> None:
    """Give a file a second name, which costs no room; a copy where the disk cannot.

    Parameters
    ----------
    file : path
        What is there.
    target : path
        Its other name; what has that name goes.
    """
    try:
        target.unlink(missing_ok=True)
        os.link(file, target)
    except OSError:
        with open(file, "rb") as source, atomic_write(target) as copy:
            shutil.copyfileobj(source, copy)


def _recover(place: Path, work: Path, before: Path) -> None:
    """Take up a change of places that was stopped in its middle."""
    if not is_run_folder(before):
        return
    if not place.exists() and is_run_folder(work):
        _rename(before, place)
    elif is_run_folder(place):
        _clear(before, place)


def _take_place(place: Path, work: Path, before: Path) -> None:
    """Put the new run in the place of the old one, which goes; what else lay in that folder stays in it."""
    _rename(place, before)
    _rename(work, place)
    _clear(before, place)


def _rename(one: Path, other: Path) -> None:
    try:
        one.rename(other)
    except OSError as error:
        raise bad_output(other, error) from error


def _clear(before: Path, place: Path) -> None:
    """Remove a run that another has taken the place of, once the user's own files are in that one's folder."""
    try:
        for file in before.iterdir():
            if not is_of_a_run(file.name) and not (place / file.name).exists():
                file.rename(place / file.name)
    except OSError as error:
        raise bad_output(before, error) from error
    _remove(before)
