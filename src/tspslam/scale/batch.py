"""Many recordings, each to a run folder, on the workers of a Dask cluster: longest first, resumed, summed up."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._atomic import bad_output, make_folder
from .._checks import require_path
from .._files import PathLike, one_line
from ..datasets.layouts import is_known
from ..errors import InputError, OutputError
from ..io._config import plain
from ..io._settling import is_run_folder, unmake
from ..io.lock import FolderLock
from ..run.config import Resolved, as_resolved
from ..run.guard import check_folder, is_inside
from ..settings import Settings
from .cluster import Workers, connected, require_dask
from .dispatching import Dispatcher, SchedulerLostError
from .job import Job, Outcome, run_job
from .recordings import Recording, find_sources, longest_first, open_recordings
from .summary import Row, describe_batch, errors_of, found_of, read_names, settings_of, write_summary
from .truths import Truths, find_truths, measure

if TYPE_CHECKING:
    from distributed import Client

_TICKETS = ".batch"  # a folder among the runs: of it a batch that goes on has one
_STATES = {"refused": "refused", "not written": "not written", "poisoned": "poisoned", "withdrawn": "unfinished"}


@dataclass(frozen=True)
class Event:
    """What happens in a batch, for whoever shows it.

    Attributes
    ----------
    kind : str
        "note": `text` says something. "begin": ``total`` recordings, of which ``done`` are, ``refused`` of
        these since they cannot be opened. "step": how far the one of
        ``name`` is, with what `tspslam.run.sequence.Step` has. "row": the one of ``name`` is done, in `row`.
    text : str
        For people.
    values : dict
        For programs.
    row : Row or None
        What has become of a recording.
    """

    kind: str
    text: str = ""
    values: Mapping[str, Any] | None = None
    row: Row | None = None


OnEvent = Callable[[Event], object]


@dataclass(frozen=True)
class BatchResult:
    """What a batch left.

    Attributes
    ----------
    folder : Path
        With the run folders, ``batch.json`` and ``batch.html``.
    rows : list of Row
        One for each recording, in the order in which they were given.
    described : dict
        The content of ``batch.json``.
    lost : str
        Why the batch ended before it was through; empty if it was.
    unmeasured : tuple of str
        Names of finished runs whose true poses were given and could not be compared; their warnings say why.
    """

    folder: Path
    rows: list[Row]
    described: dict[str, Any]
    lost: str = ""
    unmeasured: tuple[str, ...] = ()


def run_batch(
    sources: Sequence[PathLike], out: PathLike, settings: Resolved | Settings | None = None, *,
    workers: Workers | None = None, truths: PathLike | None = None, on_event: OnEvent | None = None,
) -> BatchResult:  # fmt: skip
    """Run each of many recordings into a folder of its own.

    The longest are begun first. Recordings that an earlier batch into `out` has finished with these settings are not
    looked at again, those that it began are gone on with. Each run folder has the same bytes as one of
    `tspslam.run.pipeline.run_path`, however many workers there are. One that fails does not stop the others; one whose
    worker dies is begun again once, from its last checkpoint.

    Parameters
    ----------
    sources : sequence of path
        Recordings, folders of recordings, or lists of both (`find_sources`).
    out : path
        The folder of the run folders; one batch at a time.
    settings : Resolved or Settings, optional
        Of every run; as for `run_path`.
    workers : Workers, optional
        Where; by default one process a core of this machine.
    truths : path, optional
        True poses, as `find_truths` takes them: rows then have the errors of the paths.
    on_event : callable, optional
        Called with each `Event`, from several threads.

    Returns
    -------
    BatchResult

    Raises
    ------
    InputError
        If Dask is not there, nothing is named, no scheduler or worker that fits is there, or `out` is an input, lies
        in a recording, is a run folder, or is used by another batch.
    OutputError
        If the folder or its summary cannot be written. A run that cannot be written is a row that says so.
    """
    require_dask()
    require_path(out, "out")
    resolved = as_resolved(Settings() if settings is None else settings)
    runs, found = Path(os.path.abspath(out)), find_sources(sources)
    check_folder(runs, found)
    within = next((each for each in found if is_known(each) and is_inside(runs, each)), None)
    if within is not None:
        raise InputError(one_line(f"{out}: lies in the recording {within}; expected a folder outside (--out)"))
    if is_run_folder(runs):
        raise InputError(one_line(f"{out}: is a run folder, expected a folder for several of them (--out)"))
    with _held(runs):
        return _Batch(runs, found, resolved, truths, on_event or (lambda _: None)).run(workers or Workers())


@contextlib.contextmanager
def _held(runs: Path) -> Iterator[None]:
    """A folder that is this batch's alone; where nothing was put into it, it goes again."""
    made, lock = make_folder(runs), None
    try:
        lock = FolderLock(runs)
        yield
    finally:
        unmake(runs, made, lock)


class _Batch:
    """One batch: its recordings, what is known of each, and the folder."""

    def __init__(
        self, runs: Path, found: list[Path], resolved: Resolved, truths: PathLike | None, on_event: OnEvent
    ) -> None:  # fmt: skip
        self._runs, self._resolved, self._on_event = runs, resolved, on_event
        names = read_names(runs)
        self._recordings = open_recordings(found, names)
        kept = [each for each in self._recordings if not each.error or os.path.lexists(runs / each.name)]
        self._names = names | {str(each.source): each.name for each in kept}
        self._truths: Truths = {}
        if truths is not None:
            self._truths = find_truths(truths, [each.name for each in self._recordings])
        self._rows = {each.name: self._first_row(each, str(each.source) in names) for each in self._recordings}
        self._began = time.monotonic()

    def _first_row(self, recording: Recording, is_known: bool) -> Row:
        """What is known before the batch begins: it may be finished, or not to be opened."""
        row = Row(recording.name, str(recording.source), frames=recording.frames)
        if recording.error:
            return replace(row, state="refused", error=recording.error)
        folder = self._runs / recording.name
        with contextlib.suppress(InputError):  # then it is not finished
            if is_known and settings_of(folder) == self._config_of(recording):
                found = found_of(folder)
                if found["frames"] == recording.frames or recording.source.is_file():  # a video may end before it says
                    return self._measured(replace(row, how="there", **found))
        return row

    def _config_of(self, recording: Recording) -> Any:
        """The settings of a run, as its folder holds them."""
        return plain(self._resolved.nested | {"source": {"name": recording.sequence, "frames": None}})

    def run(self, workers: Workers) -> BatchResult:
        """Run what is not finished, and sum up."""
        left = [each for each in self._recordings if self._rows[each.name].state == "unfinished"]
        refused = [row for row in self._rows.values() if row.state == "refused"]
        values = {"total": len(self._rows), "done": len(self._rows) - len(left), "refused": len(refused)}
        self._on_event(Event("begin", self._say_begin(left), values))
        for row in refused:
            self._on_event(Event("row", row=row))
        lost = self._run_left(longest_first(left), workers) if left else ""
        rows = list(self._rows.values())
        unmeasured = [row.name for row in rows if row.is_finished and row.name in self._truths and not row.evaluation]
        return BatchResult(self._runs, rows, self._write(), lost, tuple(unmeasured))

    def _say_begin(self, left: Sequence[Recording]) -> str:
        there = sum(row.how == "there" for row in self._rows.values())
        count = len(self._rows)
        said = [f"{count} recording{'' if count == 1 else 's'}"]
        said += [f"{there} finished already"] if there else []
        renamed = [each for each in left if each.name != each.sequence]
        untold = [name for name, row in self._rows.items() if name not in self._truths and not row.error]
        said += [f"no true poses are given of {', '.join(untold)}"] if self._truths and untold else []
        said += [f"{each.source} goes to {each.name}, as another has its name" for each in renamed]
        return "; ".join(said)

    @contextlib.contextmanager
    def _ticket(self) -> Iterator[Path]:
        """A folder that says that this batch goes on; those of earlier ones, which may still have workers, go."""
        tickets = self._runs / _TICKETS
        ticket = tickets / secrets.token_hex(8)
        try:
            shutil.rmtree(tickets, ignore_errors=True)
            ticket.mkdir(parents=True)
        except OSError as error:
            raise bad_output(ticket, error) from error
        try:
            yield ticket
        finally:
            shutil.rmtree(tickets, ignore_errors=True)

    def _run_left(self, left: Sequence[Recording], workers: Workers) -> str:
        """Run what is not finished; why that ended too soon, if it did. However it ends, the summary is there."""
        with self._ticket() as ticket:
            paths = [str(ticket), *(str(each.source) for each in left)]
            with connected(workers, len(left), paths) as (client, threads, said):
                self._on_event(Event("note", said))
                self._write(has_page=False)
                try:
                    self._follow(client, ticket.name, [self._job(each, ticket, threads) for each in left])
                except SchedulerLostError as error:
                    return str(error)
                except BaseException:
                    self._write()
                    raise
                finally:
                    shutil.rmtree(ticket, ignore_errors=True)  # runs that still go on end before their workers do
        return ""

    def _job(self, recording: Recording, ticket: Path, threads: int) -> Job:
        out = str(self._runs / recording.name)
        return Job(recording.name, str(recording.source), out, self._resolved, str(ticket), threads, ticket.name)

    def _follow(self, client: Client, topic: str, jobs: Sequence[Job]) -> None:
        client.subscribe_topic(topic, lambda event: self._on_event(Event("step", values=event[1])))
        for job, outcome in Dispatcher(client, run_job, lambda text: self._on_event(Event("note", text))).outcomes(
            jobs
        ):
            self._rows[job.name] = row = self._row_of(job, outcome)
            self._on_event(Event("row", row=row))
            with contextlib.suppress(OutputError):  # the last one says it
                self._write(has_page=False)

    def _row_of(self, job: Job, outcome: Outcome) -> Row:
        how = "resumed" if outcome.is_resumed else "new"
        row = replace(self._rows[job.name], how=how, attempts=outcome.attempts, error=outcome.error)
        if outcome.state != "run":
            return replace(row, state=_STATES.get(outcome.state, "failed"))
        try:
            return self._measured(replace(row, **found_of(Path(job.out))))
        except InputError as error:  # somebody else has been there
            return replace(row, state="failed", error=str(error))

    def _measured(self, row: Row) -> Row:
        """A row with the errors of the path, where true poses were given."""
        truth = self._truths.get(row.name)
        if truth is None:
            return row
        try:
            return replace(row, evaluation=errors_of(measure(self._runs / row.name, truth)))
        except InputError as error:
            said = f"the path is not compared with the true one ({error})"
            self._on_event(Event("note", f"warning: {row.name}: {said}"))
            return replace(row, evaluation=None, warnings=[*row.warnings, said])

    def _write(self, *, has_page: bool = True) -> dict[str, Any]:
        seconds = round(time.monotonic() - self._began, 1)
        described = describe_batch(list(self._rows.values()), self._names, seconds=seconds)
        write_summary(self._runs, described, has_page=has_page)
        return described
