"""Finished runs as one sequence: how pairs, tracked frames and landmarks of each are numbered among those of all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

import numpy as np

from ...datasets.joined import JoinedSequence
from ...io.frames import renumber_frame
from ...run.joining import join_doubts
from ...run.record import FrameRecord, Row
from ...types import FloatArray, Rig, StereoPair
from .runs import FinishedRun


@dataclass(frozen=True)
class _Moving:
    """A recording whose stamps may be moved: the first and the last of them."""

    name: str
    rig: Rig
    count: int
    stamps: FloatArray

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> StereoPair:
        raise IndexError(index)


class JoinedRuns(JoinedSequence):
    """The recordings of several finished runs, one run after another; none of their pairs is at hand.

    Parameters
    ----------
    runs : sequence of FinishedRun
        Two or more, of one rig.
    refused, left_out : sequence of str
        What is to be said of places that were not believed, and of runs that could not be joined.

    Attributes
    ----------
    runs : tuple of FinishedRun
        As given.
    joined_from : tuple of str
        Hashes of their states.
    first : tuple of int
        Which recording is the first of each run.
    first_pair, first_tracked, first_id : tuple of int
        What is added to the numbers of the pairs, the tracked frames and the landmarks of each run.
    left_out : list of dict
        Warnings, each a ``code`` and a ``message``: of runs that the map is without.
    """

    is_adjusted = True
    """A step before has adjusted the map."""

    def __init__(self, runs: Sequence[FinishedRun], refused: Sequence[str] = (), left_out: Sequence[str] = ()) -> None:
        self.runs, own = tuple(runs), [part for run in runs for part in run.parts]
        kept = len(runs[0].parts)
        moving = [_Moving(part.name, part.rig, part.count, part.stamps) for part in own[kept:]]
        offsets = JoinedSequence([*own[:kept], *moving]).offsets
        super().__init__([replace(part, offset=float(offset)) for part, offset in zip(own, offsets, strict=True)])
        self.joined_from = tuple(run.state for run in runs)
        self._refused, self.left_out = join_doubts(refused, left_out)
        self.first = _starts(len(run.parts) for run in runs)
        self.first_pair = _starts(run.pairs for run in runs)
        self.first_tracked = _starts(run.tracked for run in runs)
        self.first_id = _starts(run.next_id for run in runs)

    @property
    def warnings(self) -> list[dict[str, str]]:
        """What is to be doubted of the recordings, and places that were not believed."""
        return [*super().warnings, *self._refused]

    def rows(self, r: int, own: Sequence[Row]) -> list[Row]:
        """Number the rows of a run among those of all.

        Parameters
        ----------
        r : int
            Which run.
        own : sequence of FrameRecord or SkippedPair
            Its rows.

        Returns
        -------
        list of FrameRecord or SkippedPair
            Of the first run, the same.
        """
        return [*own] if r == 0 else [self._row(r, row) for row in own]

    def _row(self, r: int, row: Row) -> Row:
        index = row.index + self.first_pair[r]
        if not isinstance(row, FrameRecord):
            return replace(row, index=index)
        starts = np.array(self.starts[self.first[r] :])
        own = int(np.searchsorted(starts, index, side="right")) - 1
        k, stamp = self.first[r] + own, row.stamp if row.own_stamp is None else row.own_stamp
        offset = float(self.offsets[k])
        bare = row.name.removeprefix(f"{self.runs[r].parts[own].name}/") if own else row.name
        return replace(
            row, index=index, name=f"{self.names[k]}/{bare}", stamp=stamp + offset, own_stamp=stamp if offset else None
        )

    def copy_frame(self, r: int, file: Path, target: Path, row: FrameRecord) -> None:
        """Write the file of a frame as that of the frame among all.

        Parameters
        ----------
        r : int
            Which run it is of.
        file, target : Path
            Its file there, and the new one.
        row : FrameRecord
            Its row among those of all.
        """
        more = self.first_id[r]
        renumber_frame(file, target, index=row.index, stamp=row.stamp, name=row.name, more_landmarks=more)


def _starts(counts: Iterable[int]) -> tuple[int, ...]:
    return (0, *accumulate(counts))[:-1]
