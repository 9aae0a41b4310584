"""Steps of a join: what each makes of which files, named by a digest of all that it depends on."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..._atomic import make_folder, write_bytes
from ..._threads import set_threads
from ...io import RunFolder
from ...run._stored_rows import text_of
from ...run.record import FrameRecord, hash_of
from ...run.sequence import MADE_BY
from ..job import Outcome, attempt
from .assembling import adjust, assemble
from .joined_runs import JoinedRuns
from .matching import read_candidates, read_shared, write_candidates, write_shared
from .runs import FinishedRun
from .states import finish_state, read_step

KEYFRAMES = 25
"""Keyframes that one step looks for at their candidates, at least: few, so that little is lost where it is killed."""
FRAMES = 50
"""Frames that one step numbers anew, at least: likewise."""
PARTS = 8
"""Steps that such a task is cut into at most: each reads the states of its runs, however little is left to do."""
_ABOUT = {"state": 1, "shared": 2, "frames": 1}  # numbers of runs in what a step is of
_DIGITS = 16  # hexadecimal, of a digest in a name: two of 2**32 are the same by chance


def cut(count: int, least: int) -> list[slice]:
    """Cut what a task is of into parts.

    Parameters
    ----------
    count : int
        Of how many things it is.
    least : int
        How many make a part at least.

    Returns
    -------
    list of slice
        `PARTS` at most.

    Examples
    --------
    >>> cut(120, 50)
    [slice(0, 50, None), slice(50, 100, None), slice(100, 150, None)]
    >>> len(cut(4000, 50))
    8
    """
    size = max(least, -(-count // PARTS))
    return [slice(k, k + size) for k in range(0, count, size)]


@dataclass(frozen=True)
class Plan:
    """Where the files of a join are, by what they are made from.

    Attributes
    ----------
    runs : tuple of FinishedRun
        Two or more.
    folder : str
        Of the files of the steps.
    """

    runs: tuple[FinishedRun, ...]
    folder: str

    @cached_property
    def joined(self) -> JoinedRuns:
        """The runs as one sequence."""
        return JoinedRuns(self.runs)

    def __getstate__(self) -> dict[str, object]:
        """What goes to the workers of a step: the rest is found, or read, there."""
        return {"runs": self.runs, "folder": self.folder}

    @property
    def digest(self) -> str:
        """Hash of all that the joined map is made from."""
        return hash_of([MADE_BY.decode(), "joined and adjusted", self._of_all()])

    def file(self, kind: str, *which: int) -> Path:
        """Name the file that is there once a step is done, by all that it is made from, and by nothing else.

        Parameters
        ----------
        kind, which : str, int
            As `Step` has them.

        Returns
        -------
        Path
        """
        made_from: dict[str, Callable[..., list[object]]] = {
            "state": self._of_state, "shared": self._of_shared, "frames": self._of_frames,
        }  # fmt: skip
        digest = self._digest(kind, made_from.get(kind, self._of_all)(*which))
        return Path(self.folder) / f"{kind}-{digest}{'.done' if kind == 'frames' else '.npz'}"

    def frame(self, index: int) -> Path:
        """Name the file of a frame that is numbered anew.

        Parameters
        ----------
        index : int
            Of its pair among all.

        Returns
        -------
        Path
        """
        r = bisect_right(self.joined.first_pair, index) - 1
        return Path(self.folder) / f"frames-{self._digest('frames', self._of_numbers(r))}" / f"{index:06d}.npz"

    @property
    def states(self) -> list[Path]:
        """The files of the states of all runs."""
        return [self.file("state", r) for r in range(len(self.runs))]

    @property
    def remarks(self) -> Path:
        """The file of what is to be said of the joined map."""
        return self.file("map").with_suffix(".txt")

    @cached_property
    def candidates(self) -> dict[tuple[int, int], list[NDArray[np.int64]]]:
        """Candidates that each two runs have, in parts of some keyframes: that of the second run, that of the first."""
        found = read_candidates(self.file("candidates"))
        pairs, starts = np.unique(found[:, [0, 2]], axis=0, return_index=True)
        each = np.split(found[:, [3, 1]], starts[1:])
        return {(i, j): _in_parts(own) for (i, j), own in zip(pairs.tolist(), each, strict=True)}

    @staticmethod
    def _digest(kind: str, made_from: Sequence[object]) -> str:
        return hash_of([MADE_BY.decode(), kind, made_from])[:_DIGITS]

    def _of_all(self) -> list[object]:
        return [run.state for run in self.runs]

    def _of_state(self, r: int) -> list[object]:
        return [self.runs[r].state]

    def _of_shared(self, i: int, j: int, part: int) -> list[object]:
        return [self.runs[i].state, self.runs[j].state, self.candidates[i, j][part].tolist()]

    def _of_frames(self, r: int, part: int) -> list[object]:
        return [*self._of_numbers(r), part, FRAMES, PARTS]

    def _of_numbers(self, r: int) -> list[object]:
        """A run, and what its frames are called among those of all."""
        joined, run = self.joined, self.runs[r]
        own = slice(joined.first[r], joined.first[r] + len(run.parts))
        numbers = joined.first_pair[r], joined.first_id[r], joined.offsets[own].tolist()
        return [run.state, [part.name for part in run.parts], joined.names[own], *numbers]


def _in_parts(found: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Candidates of two runs, some keyframes in each part."""
    keyframes = np.unique(found[:, 0])
    return [found[np.isin(found[:, 0], keyframes[part])] for part in cut(len(keyframes), KEYFRAMES)]


@dataclass(frozen=True)
class Step:
    """One task of a join.

    Attributes
    ----------
    kind : str
        "state", "candidates", "shared", "frames", "map" or "adjustment".
    plan : Plan
        Of the join.
    which : tuple of int
        Numbers of runs and, of a part of a task, which part.
    ticket, topic : str
        As `tspslam.scale.job.Job` has them.
    threads : int or None
        For this step; None for as many as the process has.
    """

    kind: str
    plan: Plan
    which: tuple[int, ...] = ()
    ticket: str = ""
    topic: str = ""
    threads: int | None = None

    @property
    def name(self) -> str:
        """One word that no other step of the join has."""
        return "-".join([self.kind, *map(str, self.which)])

    @property
    def source(self) -> str:
        """What it is about, for people."""
        about = self.which[: _ABOUT.get(self.kind, 0)]
        return " and ".join(self.plan.runs[r].path for r in about) or self.plan.folder

    @property
    def target(self) -> Path:
        """The file that is there once it is done."""
        return self.plan.file(self.kind, *self.which)

    @property
    def is_done(self) -> bool:
        """Whether it was done before."""
        return self.target.is_file()


def run_step(step: Step) -> Outcome:
    """Do a step of a join.

    Parameters
    ----------
    step : Step
        Which.

    Returns
    -------
    Outcome
    """
    return attempt(step, _do)


def _do(step: Step) -> None:
    if step.threads is not None:
        set_threads(step.threads)
    _MAKERS[step.kind](step.plan, step.target, *step.which)


def _make_state(plan: Plan, target: Path, r: int) -> None:
    finish_state(plan.runs[r], target)


def _make_candidates(plan: Plan, target: Path) -> None:
    write_candidates(plan.states, plan.runs[0].settings.settings.tracking.loops, target)


def _make_shared(plan: Plan, target: Path, i: int, j: int, part: int) -> None:
    states = plan.file("state", i), plan.file("state", j)
    write_shared((plan.runs[i], plan.runs[j]), states, plan.candidates[i, j][part], target)


def _make_frames(plan: Plan, target: Path, r: int, part: int) -> None:
    """Number some frames of run r, and their rows, anew."""
    run, (own, _) = plan.runs[r], read_step(plan.file("state", r))
    rows, before = plan.joined.rows(r, own), RunFolder.open(run.path)
    stored = [
        (run.frames[old.index], row) for old, row in zip(own, rows, strict=True)
        if isinstance(row, FrameRecord) and row.complex_ is not None
    ]  # fmt: skip
    for index, row in stored[cut(len(stored), FRAMES)[part]]:
        file = plan.frame(row.index)
        make_folder(file.parent)
        plan.joined.copy_frame(r, before.finished_frame(index), file, row)
        write_bytes(file.with_suffix(".json"), text_of(row))
    write_bytes(target, b"")


def _make_map(plan: Plan, target: Path) -> None:
    shared = [
        (i, j, read_shared(plan.file("shared", i, j, part)))
        for (i, j), parts in plan.candidates.items()
        for part in range(len(parts))
    ]
    assemble(plan.joined, plan.states, shared, target, plan.remarks)


def _make_adjustment(plan: Plan, target: Path) -> None:
    adjust(plan.joined, plan.file("map"), target)


_MAKERS: dict[str, Callable[..., None]] = {
    "state": _make_state,
    "candidates": _make_candidates,
    "shared": _make_shared,
    "frames": _make_frames,
    "map": _make_map,
    "adjustment": _make_adjustment,
}
