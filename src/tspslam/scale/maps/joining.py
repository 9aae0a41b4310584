"""Finished runs of one place become one run: a graph of steps on the workers of a Dask cluster, or in this process."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..._atomic import bad_output, is_temporary, make_folder
from ..._checks import require_path
from ..._files import PathLike, bad_input, one_line
from ...errors import InputError, OutputError, TspSlamError
from ...io import write_bytes
from ...io.lock import LOCK_NAME, FolderLock
from ...run._stages import OnStep
from ...run.guard import check_folder, is_inside
from ...run.pipeline import RunResult
from ..cluster import Workers, connected, require_dask
from ..dispatching import Dispatcher
from ..job import Outcome
from .offsets import unlike_offsets
from .runs import find_runs
from .steps import FRAMES, PARTS, Plan, Step, cut, run_step
from .writing import check_out, is_of_fewer, write_run

Outcomes = Callable[[Sequence[Step]], Iterator[tuple[Step, Outcome]]]
_MARK = "join.txt"  # in the folder of the steps
_FEWEST = 2  # runs


@dataclass(frozen=True)
class JoinResult:
    """What a join left.

    Attributes
    ----------
    run : RunResult
        The joined run.
    left_out : dict of str to str
        Why runs were left out, by their paths.
    """

    run: RunResult
    left_out: dict[str, str]

    @property
    def is_degraded(self) -> bool:
        """Whether a run was left out, or was not found in the map of the first."""
        return bool(self.left_out) or self.run.is_degraded


def join_runs(
    runs: Sequence[PathLike], out: PathLike, *,
    workers: Workers | None = None, on_note: Callable[[str], object] | None = None, on_step: OnStep | None = None,
) -> JoinResult:  # fmt: skip
    """Join the maps of finished runs of one place, without tracking anew.

    Keyframes of each two runs are compared by their looks; what looks alike is proved by the landmarks of one and by
    the keyframe beside the other, and by how places agree among themselves. A graph of all poses then takes the runs to
    the world of the first, landmarks that several see become one, and all is adjusted together. The result is a run
    folder like that of a run of all recordings. Each step leaves a file beside it, in ``OUT-steps``, until all is done:
    the same call goes on after a stop, and gives the same bytes with any workers.

    Parameters
    ----------
    runs : sequence of path
        Folders of finished runs with one rig and the same settings. One that cannot be read or does not fit is left
        out; one that shares no place with the others keeps a path of its own, as in a run of all recordings.
    out : path
        The run folder; new, empty, or of the same join.
    workers : Workers, optional
        Where, on Dask; by default in this process. The run at the end is always made in this one.
    on_note : callable, optional
        Called with remarks for people.
    on_step : callable, optional
        As for `tspslam.run.pipeline.run`.

    Returns
    -------
    JoinResult

    Raises
    ------
    InputError
        If fewer than two runs can be joined, Dask is wanted and not there, or `out` is an input, holds something else,
        or is used by another join.
    OutputError
        If something cannot be written.
    TspSlamError
        If the scheduler dies: the same call goes on.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.datasets import synthetic
    >>> from tspslam.run import config, pipeline
    >>> walk = synthetic.SyntheticSequence(synthetic.corridor(4.0))
    >>> settings = config.resolve()
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name, frames in ("one", range(6)), ("two", range(3, 9)):
    ...         _ = pipeline.run(walk, f"{folder}/{name}", settings, frames=frames)
    ...     joined = join_runs([f"{folder}/one", f"{folder}/two"], f"{folder}/both")
    >>> joined.run.run["recordings"][1]["relative_to"]
    'corridor'
    """
    for path in runs:
        require_path(path, "runs")
    require_path(out, "out")
    if workers is not None:
        require_dask()
    found, left_out = find_runs(runs)
    place = Path(os.path.abspath(out))
    _check_place(place, [Path(path) for path in runs])
    with _held(place.with_name(f"{place.name}-steps")) as folder:
        join = _Join(Plan(tuple(found), str(folder)), left_out, on_note or (lambda _: None))
        join.require_runs()
        for path, why in left_out.items():
            join.say(f"{path} is left out: {why}")
        if is_of_fewer(place, join.plan) or not check_out(place, join.plan):
            join.make(workers, place)
        result = write_run(join.plan, place, join.left_out, on_step)
        _clear(folder)
    return JoinResult(RunResult(Path(out), result.run, result.times), join.left_out)


def _check_place(place: Path, runs: Sequence[Path]) -> None:
    """Refuse, before anything is done, a place that cannot be a folder, or is in a run or holds one."""
    check_folder(place, runs)
    if os.path.lexists(place) and not place.is_dir():
        raise bad_input(place, "is a file, or a link to nothing", "a new folder, for the joined run")
    inner = next((run for run in runs if is_inside(place, run)), None)
    if inner is not None:
        raise bad_input(place, f"is in the run {inner}", "a new folder beside the runs")


@contextlib.contextmanager
def _held(folder: Path) -> Iterator[Path]:
    """The folder of the steps, for this join alone; it goes when it is empty."""
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        names = [name for name in os.listdir(folder) if name != LOCK_NAME and not is_temporary(name)]
        if names and _MARK not in names:
            raise bad_input(folder, f"holds {sorted(names)[0]!r}", "a free name, for the steps of the join")
    made = make_folder(folder)
    try:
        lock = FolderLock(folder)
        try:
            write_bytes(folder / _MARK, b"Steps of tspslam join: they go when it is done.\n")
            yield folder
        finally:
            lock.release()
    finally:
        with contextlib.suppress(OSError):
            _drop_empty(folder, made)


def _drop_empty(folder: Path, made: Sequence[Path]) -> None:
    if set(os.listdir(folder)) <= {_MARK}:
        (folder / _MARK).unlink(missing_ok=True)
        for path in reversed(made or [folder]):
            path.rmdir()


def _clear(folder: Path) -> None:
    """Remove the files of the steps."""
    try:
        for entry in folder.iterdir():
            if entry.is_dir():
                shutil.rmtree(entry)
            elif entry.name not in (LOCK_NAME, _MARK):
                entry.unlink()
    except OSError as error:
        raise bad_output(folder, error) from error


def _here(steps: Sequence[Step]) -> Iterator[tuple[Step, Outcome]]:
    """Do steps in this process."""
    return ((step, run_step(step)) for step in steps)


class _Join:
    """The steps of one join, up to the state of the joined run."""

    def __init__(self, plan: Plan, left_out: dict[str, str], say: Callable[[str], object]) -> None:
        self.plan, self.left_out, self.say = plan, left_out, say

    def require_runs(self) -> None:
        """Refuse to join fewer than two."""
        if len(self.plan.runs) < _FEWEST:
            why = next(iter(self.left_out.values()), "")
            count = len(self.plan.runs) + len(self.left_out)
            said = f"{len(self.plan.runs)} of {count} runs can be joined, expected {_FEWEST} or more"
            raise InputError(one_line(f"{said}; {why}" if why else said))

    def make(self, workers: Workers | None, out: Path) -> None:
        """Do what is not done yet for a run folder."""
        if self.plan.file("adjustment").is_file():
            return
        with self._ticket() as ticket:
            if workers is None:
                self._do_all(_here, Step("state", self.plan, (), ticket), out)
                return
            paths = [ticket, *(run.path for run in self.plan.runs)]
            with connected(workers, self._most(), paths) as (client, threads, said):
                self.say(said)
                like = Step("state", self.plan, (), ticket, os.path.basename(ticket), threads)
                self._do_all(Dispatcher(client, run_step, self.say).outcomes, like, out)

    def _most(self) -> int:
        """How many steps there may be at a time."""
        return len(self.plan.runs) * PARTS

    @contextlib.contextmanager
    def _ticket(self) -> Iterator[str]:
        """A folder that says that this join goes on, and how often each step was begun."""
        ticket = Path(self.plan.folder) / f"ticket-{secrets.token_hex(8)}"
        for old in Path(self.plan.folder).glob("ticket-*"):
            shutil.rmtree(old, ignore_errors=True)
        make_folder(ticket)
        try:
            yield str(ticket)
        finally:
            shutil.rmtree(ticket, ignore_errors=True)

    def _do_all(self, outcomes: Outcomes, like: Step, out: Path) -> None:
        """Do the steps, level by level: each needs files of those before it alone."""
        states = self._steps(like, "state", [(r,) for r in range(len(self.plan.runs))])
        new = [step.target for step in states if not step.is_done]
        self._leave_out(self._follow(outcomes, states))
        if self._is_there(out, new):
            return
        plan = self.plan
        moved = [(r, run) for r, run in enumerate(plan.runs) if r or not run.is_numbered]
        frames = [(r, part) for r, run in moved for part in range(len(cut(run.stored, FRAMES)))]
        both = [*self._steps(like, "candidates", [()]), *self._steps(like, "frames", frames)]
        _require(self._follow(outcomes, both))
        shared = [(i, j, part) for (i, j), parts in plan.candidates.items() for part in range(len(parts))]
        for kind, which in (("shared", shared), ("map", [()]), ("adjustment", [()])):
            _require(self._follow(outcomes, self._steps(like, kind, which)))

    def _steps(self, like: Step, kind: str, which: Sequence[tuple[int, ...]]) -> list[Step]:
        return [replace(like, kind=kind, plan=self.plan, which=each) for each in which]

    def _follow(self, outcomes: Outcomes, wanted: Sequence[Step]) -> Iterator[tuple[Step, Outcome]]:
        """Do those steps of a level that are not done yet."""
        left = [step for step in wanted if not step.is_done]
        if wanted:
            self.say(f"{' and '.join(dict.fromkeys(step.kind for step in wanted))}: {len(left)} of {len(wanted)} to do")
        return outcomes(left)

    def _leave_out(self, outcomes: Iterator[tuple[Step, Outcome]]) -> None:
        """Go on without the runs whose state cannot be used."""
        bad = {}
        for step, outcome in outcomes:
            if outcome.state == "refused":
                bad[self.plan.runs[step.which[0]].path] = outcome.error
            else:
                _raise(outcome)
        self._go_on_without(bad)
        self._go_on_without(unlike_offsets(self.plan.runs, self.plan.states))

    def _go_on_without(self, bad: dict[str, str]) -> None:
        self.left_out |= bad
        self.plan = replace(self.plan, runs=tuple(run for run in self.plan.runs if run.path not in bad))
        for path in sorted(bad):
            self.say(f"{path} is left out: {bad[path]}")

    def _is_there(self, out: Path, new: Sequence[Path]) -> bool:
        """Whether the folder has the map, now that its runs are known; where all is refused, new files go."""
        try:
            self.require_runs()
            return check_out(out, self.plan)
        except InputError:
            for path in new:
                path.unlink(missing_ok=True)
            raise


def _require(outcomes: Iterator[tuple[Step, Outcome]]) -> None:
    for _, outcome in outcomes:
        _raise(outcome)


def _raise(outcome: Outcome) -> None:
    """Raise what a step could not do."""
    if outcome.state == "not written":
        raise OutputError(outcome.error)
    if outcome.state == "failed":
        raise TspSlamError(outcome.error)
    if outcome.state != "run":
        raise InputError(outcome.error)
