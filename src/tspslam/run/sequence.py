"""Frame by frame through a source, each noted when it is finished; a stopped run is resumed."""

from __future__ import annotations

import itertools
import logging
from bisect import bisect_right
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from .. import __version__
from .._files import one_line
from .._npz import Arrays
from .._stopwatch import Stopwatch
from .._threads import Worker
from ..datasets.joined import JoinedSequence, Source
from ..errors import InputError
from ..frame import Frame
from ..io import RunFolder, write_bytes, write_frame
from ..io.frames import read_frame_image
from ..session import Session
from ..types import Image, StereoPair, Trajectory
from ..vision.rig import check_pair
from ..vision.slam.odometry import StereoOdometry
from ._checkpoint import STATE_NAME as STATE_NAME
from ._checkpoint import is_recorded, read_checkpoint, record_checkpoint
from ._stored_rows import changed, find_row, text_of
from .record import FrameRecord, Row, SkippedPair, hash_of, pair_hash, record_complex, record_frame

OnFrame = Callable[[Frame], object]
_Arrived = tuple[StereoPair | InputError, str]  # a pair, or why it cannot be read; hash of what it is made from
MADE_BY = f"tspslam {__version__}, state 9".encode()  # others' checkpoints do not count
_LOG = logging.getLogger(__name__)
_BACKLOG = 2  # frames that may wait to be written
_EVERY, _SHARE = 25, 0.1  # frames between checkpoints, or this share of the frames so far: long runs write fewer


@runtime_checkable
class GrowingSource(Source, Protocol):
    """Pairs that are still being taken; its length is that of those that are there."""

    def wait_for(self, index: int) -> bool:
        """Wait until a pair is there.

        Parameters
        ----------
        index : int
            From 0; none before it is waited for later.

        Returns
        -------
        bool
            False if it never will be there.
        """


@dataclass(frozen=True)
class Step:
    """How far a run is.

    Attributes
    ----------
    stage : str
        What is being done: "indexing" (of a video), "tracking", "adjustment", "map", "pictures" or "report"; "corners"
        or "calibration".
    done, total : int
        Frames, while a video is gone through; pairs, while tracking or looking for corners; of other stages, 0 of 1.
    keyframes, lost, loops : int
        So far: keyframes, frames where tracking was lost, loops that were closed.
    """

    stage: str
    done: int = 0
    total: int = 1
    keyframes: int = 0
    lost: int = 0
    loops: int = 0


class SequenceRun:
    """The frames of a run.

    Parameters
    ----------
    source : Source
        The pairs.
    wanted : range
        Which of them; of a `GrowingSource` none yet, it takes all.
    session : Session
        What processes them.
    folder : RunFolder
        Where finished keyframes and checkpoints go, and where an earlier run may have left some.

    Attributes
    ----------
    rows : list of FrameRecord or SkippedPair
        One for each pair tried.
    seconds : dict
        Time of each stage, s, by the name of the frame; varies from run to run.
    map_seconds : float
        Time of making the map at the end, s; 0 where it was there.
    keyframes, lost : int
        How many of the rows are keyframes, and how many of frames where tracking was lost.
    """

    def __init__(self, source: Source, wanted: range, session: Session, folder: RunFolder) -> None:
        self.source, self.wanted, self.session, self.folder = source, wanted, session, folder
        self.rows: list[Row] = []
        self.seconds: dict[str, dict[str, float]] = {}
        self.map_seconds = 0.0
        self._errors: dict[int, InputError] = {}
        self._writing: list[tuple[int, Future[FrameRecord]]] = []  # place in `rows`, its record once it is written
        self._saving: Future[None] | None = None
        self._resume()
        self._saved = len(self.rows)
        self.keyframes = sum(row.is_keyframe for row in self.tracked)
        self.lost = sum(row.is_lost for row in self.tracked)

    @property
    def tracked(self) -> list[FrameRecord]:
        """Rows of the pairs that could be used, each with a pose."""
        return [row for row in self.rows if isinstance(row, FrameRecord)]

    @property
    def stored(self) -> list[FrameRecord]:
        """Rows of the frames that have a file: keyframes, lost ones, or all."""
        return [row for row in self.tracked if row.complex_ is not None]

    def step(self, stage: str) -> Step:
        """How far the run is, in a stage of it.

        Parameters
        ----------
        stage : str
            Its name.

        Returns
        -------
        Step
        """
        odometry = self.session.odometry
        loops = odometry.loops if isinstance(odometry, StereoOdometry) else 0
        done, total = (len(self.rows), max(len(self.wanted), 1)) if stage == "tracking" else (0, 1)
        return Step(stage, done, total, self.keyframes, self.lost, loops)

    @property
    def last_error(self) -> InputError | None:
        """Why the last pair that could not be used could not."""
        return self._errors[max(self._errors)] if self._errors else None

    @property
    def trajectory(self) -> Trajectory:
        """Path of the frames; of several of one moment, the first."""
        path = self.session.trajectory
        first = np.diff(path.stamp, prepend=-np.inf) > 0
        return Trajectory(path.stamp[first], path.T_world_camera[first])

    def proceed(
        self, on_frame: OnFrame | None = None, on_end: Callable[[], object] | None = None
    ) -> Iterator[tuple[int, int]]:  # fmt: skip
        """Process one pair after another, the next one read meanwhile; after the last one the path is final.

        Parameters
        ----------
        on_frame : callable, optional
            Called with each `Frame`, before a checkpoint counts it as done.
        on_end : callable, optional
            Called when the last pair is done, before the path is made final.

        Yields
        ------
        tuple of 2 int
            Pairs done, and the index of the last.
        """
        is_growing = isinstance(self.source, GrowingSource)
        coming = self._arriving() if is_growing else self._read(self.wanted[len(self.rows) :])
        with Worker() as self._writer:
            for index, (pair, key) in coming:
                frame = self._process(index, pair, key)
                if frame is not None and on_frame is not None:
                    on_frame(frame)
                self._finish_saving(is_urgent=False)
                done = len(self.rows)
                is_last = done == len(self.wanted) and not is_growing
                if is_last or (done >= self._saved + _EVERY + _SHARE * self._saved and not self._is_closing_loop):
                    self._save()
                yield done, index
            if is_growing:
                self._save()
            if on_end is not None:
                on_end()
            self._finish()

    def _arriving(self) -> Iterator[tuple[int, _Arrived]]:
        """Pairs as they come; the wanted ones grow with them."""
        with Worker() as reader:
            coming = reader.submit(self._next, 0)
            for index in itertools.count():
                pair = coming.result()
                if pair is None:
                    return
                self.wanted = range(index + 1)
                coming = reader.submit(self._next, index + 1)
                yield index, pair

    def _next(self, index: int) -> _Arrived | None:
        """Wait for a pair; None if there is no further one."""
        assert isinstance(self.source, GrowingSource)
        return self._ready(index) if self.source.wait_for(index) else None

    def _read(self, wanted: range) -> Iterator[tuple[int, _Arrived]]:
        """Pairs, each made ready while the one before is processed."""
        if not wanted:
            return
        with Worker() as reader:
            coming = reader.submit(self._ready, wanted[0])
            for index, following in itertools.zip_longest(wanted, wanted[1:]):
                pair = coming.result()
                if following is not None:
                    coming = reader.submit(self._ready, following)
                yield index, pair

    def _ready(self, index: int) -> _Arrived:
        """One pair made ready for the session, or why it cannot be read; and the hash of it."""
        pair = self._one(index)
        return (pair if isinstance(pair, InputError) else self.session.prepare(pair)), input_hash(pair, self.session)

    def _one(self, index: int) -> StereoPair | InputError:
        """One pair, numbered by its place, after which its files are named; or why it cannot be read."""
        try:
            pair = self.source[index]
            check_pair(pair)
        except InputError as error:
            return error
        return pair if pair.index == index else replace(pair, index=index)

    def _process(self, index: int, pair: StereoPair | InputError, key: str) -> Frame | None:
        """Add the row of one pair; its frame goes to the folder if it carries a complex."""
        try:
            if isinstance(pair, InputError):
                raise pair
            frame = self._begun(index).process(pair)
        except InputError as error:
            self._errors[index] = error
            self.rows.append(SkippedPair(index, key, str(error)))
            return None
        row, place = record_frame(frame, pair, key), len(self.rows)
        if isinstance(self.source, JoinedSequence):
            row = replace(row, own_stamp=self.source.own_stamp(index, pair.stamp))
        self.rows.append(row)
        self.keyframes, self.lost = self.keyframes + row.is_keyframe, self.lost + row.is_lost
        self.seconds[frame.name] = frame.seconds
        if self.session.settings.tracking.every_frame or frame.is_keyframe or frame.is_lost:
            self._wait_for_writing(_BACKLOG)
            self._writing.append((place, self._writer.submit(self._store_after, self.session.busy, frame, row)))
        return frame

    def _store_after(self, busy: Future[object] | None, frame: Frame, row: FrameRecord) -> FrameRecord:
        """Write a frame once the session has computed it: else it would be computed here, while tracking goes on."""
        if busy is not None:
            wait([busy])
        return self._store(frame, row)

    def _begun(self, index: int) -> Session:
        """The session, which is told if a pair is the first one of a further recording that is processed."""
        starts = getattr(self.source, "starts", (0,))
        last = next((row.index for row in reversed(self.rows) if isinstance(row, FrameRecord)), index)
        if bisect_right(starts, last) != bisect_right(starts, index):
            self.session.begin()
        return self.session

    def _store(self, frame: Frame, row: FrameRecord) -> FrameRecord:
        """Write a frame and its numbers; one without a complex has a pose, but no file."""
        try:
            row = replace(row, complex_=record_complex(frame))
        except InputError as error:
            self._errors[frame.index] = error
            return replace(row, no_complex=str(error))
        path, watch = self.folder.frame_path(frame.index), Stopwatch()
        write_frame(path, frame)
        self.folder.record(path, input_hash=row.input_hash)
        beside = path.with_suffix(".json")
        write_bytes(beside, text_of(row))
        self.folder.record(beside, input_hash=row.input_hash)
        watch.lap("write")
        frame.seconds.update(watch.seconds)
        return row

    def rewrite(self, frame: Frame) -> None:
        """Write a stored frame anew, and its row; what is written has no say in the path.

        Parameters
        ----------
        frame : Frame
            Of a row that is there.
        """
        place = next(k for k, row in enumerate(self.rows) if row.index == frame.index)
        row = self.rows[place]
        assert isinstance(row, FrameRecord)
        self.rows[place] = self._store(frame, replace(row, complex_=None))

    def _wait_for_writing(self, left: int) -> None:
        """Wait until no more than so many frames are still to be written; what went wrong with them is raised."""
        while len(self._writing) > left:
            place, written = self._writing.pop(0)
            self.rows[place] = written.result()

    def _save(self) -> None:
        """Have a checkpoint written after the frames so far: all that the next frame depends on, as it is now."""
        self._finish_saving()
        self._saved = len(self.rows)
        odometry = self.session.odometry
        if isinstance(odometry, StereoOdometry):
            given = list(self.rows), list(self._writing), odometry.state()
            self._saving = self._writer.submit(self._write_checkpoint, *given)

    def _write_checkpoint(
        self, rows: list[Row], writing: list[tuple[int, Future[FrameRecord]]], state: Arrays
    ) -> None:  # fmt: skip
        """Write a checkpoint once its frames are written; of a run that has given nothing yet there is none."""
        for place, written in writing:
            rows[place] = written.result()
        if any(isinstance(row, FrameRecord) and row.complex_ is not None for row in rows):
            record_checkpoint(self.folder, MADE_BY, rows, state)

    @property
    def _is_closing_loop(self) -> bool:
        """Whether a checkpoint would wait until a loop is closed."""
        odometry = self.session.odometry
        return isinstance(odometry, StereoOdometry) and odometry.mapper.is_correcting

    def _finish_saving(self, *, is_urgent: bool = True) -> None:
        """Wait for the checkpoint that is being written, or only look whether it is; what went wrong is raised."""
        if self._saving is not None and (is_urgent or self._saving.done()):
            saving, self._saving = self._saving, None
            saving.result()

    def _finish(self) -> None:
        """Make the path final while the last frames and the checkpoint, which is from before that, are written.

        All is adjusted together, unless a step of a join has done that; then its calibration is judged alone.
        """
        odometry = self.session.odometry
        if isinstance(odometry, StereoOdometry) and getattr(self.source, "is_adjusted", False):
            odometry.settle()
        elif self.tracked:
            self.session.finish()
        self._wait_for_writing(0)
        self._finish_saving()

    def save_rows(self) -> None:
        """Write the rows of the last checkpoint anew, if they are others now; the state stays that from before.

        That is the one from before the path was final: with the pairs that it has seen it leads to the same end.
        """
        path = self.folder.path / STATE_NAME
        if STATE_NAME in self.folder.units:
            rows, state = read_checkpoint(path, MADE_BY)
            if rows != self.rows:
                record_checkpoint(self.folder, MADE_BY, self.rows, state)

    def _resume(self) -> None:
        """Take over the last checkpoint, if the pairs are still those that led to it and the files are there."""
        unit, path = self.folder.units.get(STATE_NAME), self.folder.path / STATE_NAME
        is_needed = bool(getattr(self.source, "stored", 0))  # pairs that only the checkpoint tells of
        if not is_needed and (unit is None or not isinstance(self.session.odometry, StereoOdometry)):
            return
        try:
            if not is_recorded(self.folder):
                raise InputError("it was changed since the run")
            self._take_over(path)
        except InputError as error:
            if is_needed:
                raise InputError(one_line(f"{path}: does not count ({error}), expected that of the run")) from error
            _LOG.warning(one_line(f"{path}: does not count ({error}); all frames are made anew"))

    def _take_over(self, path: Path) -> None:
        """Go on from a checkpoint of this version whose images and files are as they were."""
        rows, state = read_checkpoint(path, MADE_BY)
        if len(rows) > len(self.wanted):
            raise InputError(f"it has {len(rows)} frames, expected {len(self.wanted)} at most")
        is_whole = len(rows) == len(self.wanted)
        rows = [self._as_before(index, row, is_whole) for index, row in zip(self.wanted, rows, strict=False)]
        places = [row.index for row in rows if isinstance(row, FrameRecord)]
        session = Session(self.source.rig, self.session.settings, keep=False)
        odometry = session.odometry
        assert isinstance(odometry, StereoOdometry)
        odometry.restore(state, lambda number: self._image(places[number]))
        self.session, self.rows = session, rows

    def _image(self, index: int) -> Image:
        if index < getattr(self.source, "stored", 0):
            return read_frame_image(self.folder.frame_path(index))
        return self.source[index].left

    def _as_before(self, index: int, row: Row, is_whole: bool) -> Row:
        """The row of a pair, as its files have it; `InputError` unless pair and files are what they were."""
        if index < getattr(self.source, "stored", 0):
            return self._as_stored(index, row)
        pair = self._one(index)
        is_same = row.index == index and row.input_hash == input_hash(pair, self.session)
        if isinstance(row, SkippedPair):
            is_same &= not isinstance(pair, InputError) or row.skipped == str(pair)
        elif isinstance(pair, InputError):
            is_same = False
        else:
            is_same &= (row.name, row.stamp) == (pair.name, pair.stamp)
            if is_same and row.complex_ is not None:
                return find_row(self.folder, row, self.source.rig, is_whole=is_whole)
        if not is_same:
            raise changed(index)
        return row

    def _as_stored(self, index: int, row: Row) -> Row:
        """The row of a pair that is not to be had any more, as its files have it."""
        if row.index != index:
            raise changed(index)
        if isinstance(row, FrameRecord) and row.complex_ is not None:
            return find_row(self.folder, row, self.source.rig, is_whole=False)
        return row


def input_hash(pair: StereoPair | InputError, session: Session) -> str:
    """Hash all that a frame is made from besides the settings: the pair, and files that stages read.

    Parameters
    ----------
    pair : StereoPair or InputError
        The pair, or why it cannot be read.
    session : Session
        With these stages.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    key = hash_of(str(pair)) if isinstance(pair, InputError) else pair_hash(pair)
    prints = session.fingerprints
    return hash_of([key, prints]) if any(prints) else key
