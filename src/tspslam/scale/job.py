"""One recording on a worker: run in its folder, told about while it goes on, withdrawn when the batch ends."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from .._atomic import NO_ROOM, bad_output
from .._files import reason_of
from .._threads import set_threads
from ..errors import InputError, OutputError
from ..io._places import MANIFEST
from ..io.lock import LOCK_NAME, FolderLock
from ..run.config import Resolved
from ..run.pipeline import run_path
from ..run.sequence import Step

MOST_ATTEMPTS = 2
"""How often a recording may take its worker with it, before it is not tried again."""
_PATIENCE = 60.0  # s for a run of a batch that has ended to see that, and to let go of its folder
_LOOK = 1.0  # s between two looks whether the batch still goes on
_TELL = 0.3  # s between two messages on how far a run is
_one = threading.Lock()  # a process runs one recording at a time: its budget of threads is one


class _WithdrawnError(Exception):
    """The batch has ended; whoever begins it again goes on from the last checkpoint."""


class Attempted(Protocol):
    """What is handed to a worker and counted there."""

    @property
    def name(self) -> str:
        """One word that no other of its batch has."""

    @property
    def source(self) -> str:
        """What it is about, for people."""

    @property
    def ticket(self) -> str:
        """A folder that is there as long as the batch goes on; attempts are counted in it."""

    @property
    def topic(self) -> str:
        """Under which it tells how far it is."""


AnyJob = TypeVar("AnyJob", bound=Attempted)


@dataclass(frozen=True)
class Job:
    """All that a worker needs to know of one recording.

    Attributes
    ----------
    name : str
        Of the recording.
    source, out : str
        Where it is, and its run folder; absolute.
    settings : Resolved
        Of the run.
    ticket : str
        A folder that is there as long as the batch goes on; attempts are counted in it.
    threads : int
        For this run.
    topic : str
        Under which it tells how far it is.
    """

    name: str
    source: str
    out: str
    settings: Resolved
    ticket: str
    threads: int
    topic: str


@dataclass(frozen=True)
class Outcome:
    """How a recording went on its worker.

    Attributes
    ----------
    state : str
        "run"; "refused" (the input is bad), "not written", "poisoned" (its workers died), "withdrawn".
    error : str
        Why it was not run.
    attempts : int
        How often it was begun in this batch.
    is_resumed : bool
        Whether an earlier attempt had left finished units.
    """

    state: str
    error: str = ""
    attempts: int = 1
    is_resumed: bool = False


def run_job(job: Job) -> Outcome:
    """Run one recording, as ``tspslam run`` does; its run folder gets the same bytes.

    Parameters
    ----------
    job : Job
        What to run.

    Returns
    -------
    Outcome
        Bad input and a full disk are one too. Anything else is an error of ours, and is raised.
    """
    return attempt(job, _run, is_resumed=_is_begun(Path(job.out)))


def attempt(job: AnyJob, work: Callable[[AnyJob], object], *, is_resumed: bool = False) -> Outcome:
    """Do what is handed to this worker, once more: an attempt is counted before it begins.

    Parameters
    ----------
    job : Attempted
        What is done.
    work : callable
        Does it.
    is_resumed : bool
        Whether an earlier attempt had left finished units.

    Returns
    -------
    Outcome
        Bad input and a full disk are one too. Anything else is an error of ours, and is raised.
    """
    with _one:
        try:
            attempts = _count_attempt(job)
            if attempts > MOST_ATTEMPTS:
                return Outcome("poisoned", _say_poisoned(job), attempts - 1, is_resumed)
            work(job)
        except _WithdrawnError:
            return Outcome("withdrawn", "the batch was stopped", is_resumed=is_resumed)
        except InputError as error:
            return Outcome("refused", str(error), is_resumed=is_resumed)
        except OutputError as error:
            return Outcome("not written", str(error), is_resumed=is_resumed)
        except OSError as error:
            if error.errno not in NO_ROOM:
                raise
            return Outcome("not written", str(bad_output(error.filename or job.source, error)), is_resumed=is_resumed)
    return Outcome("run", attempts=attempts, is_resumed=is_resumed)


def _run(job: Job) -> None:
    set_threads(job.threads)
    _wait_for_folder(Path(job.out))
    run_path(job.source, job.out, job.settings, on_step=_Teller(job))


def _say_poisoned(job: Attempted) -> str:
    return (
        f"{job.source}: its worker died {MOST_ATTEMPTS} times, killed or out of memory; expected one that fits "
        "(--memory), the same command tries it again"
    )


def _is_begun(out: Path) -> bool:
    manifest = out / MANIFEST
    return manifest.is_file() and manifest.stat().st_size > 0


def _count_attempt(job: Attempted) -> int:
    """Note that an attempt begins, on disk, as the process may not live to tell; how many there were, with this one."""
    _refuse_ended(job)
    path = Path(job.ticket) / job.name
    try:
        with open(path, "ab", buffering=0) as handle:
            handle.write(b".")
            os.fsync(handle.fileno())
            return handle.tell()
    except FileNotFoundError as error:
        raise _WithdrawnError from error
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({reason_of(error)}); expected a place with space") from error


def _refuse_ended(job: Attempted) -> None:
    if not os.path.isdir(job.ticket):
        raise _WithdrawnError


def _wait_for_folder(out: Path) -> None:
    """Wait until a run of an earlier batch, which is about to see that it has ended, has let go of the folder."""
    last = time.monotonic() + _PATIENCE
    while (out / LOCK_NAME).exists():
        try:
            FolderLock(out).release()
            return
        except InputError:
            if time.monotonic() > last:
                return  # the run itself will say who holds it
            time.sleep(_TELL)


class _Teller:
    """Tells the batch how far a run is, now and then, and ends the run when the batch has ended.

    Parameters
    ----------
    job : Attempted
        What is run.
    """

    def __init__(self, job: Attempted) -> None:
        self._job, self._stage, self._told, self._looked = job, "", 0.0, time.monotonic()

    def __call__(self, step: Step) -> None:
        """Take a step of the run."""
        now = time.monotonic()
        if now - self._looked > _LOOK:
            self._looked = now
            _refuse_ended(self._job)
        if step.stage != self._stage or now - self._told > _TELL:
            self._stage, self._told = step.stage, now
            tell(self._job.topic, {"name": self._job.name, **vars(step)})


def tell(topic: str, values: dict[str, Any]) -> None:
    """Send a message to the batch that this worker's task is of.

    Parameters
    ----------
    topic : str
        Of the batch.
    values : dict
        Plain values.
    """
    from distributed import get_worker

    get_worker().log_event(topic, values)
