"""Jobs handed to the workers of a cluster, one each at a time; what a dead worker lost is handed out again."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic

from .._files import one_line
from ..errors import TspSlamError
from .job import MOST_ATTEMPTS, AnyJob, Attempted, Outcome

if TYPE_CHECKING:
    from distributed import Client, Future

_POLL = 1.0  # s between two looks for workers that have come or gone


class SchedulerLostError(TspSlamError):
    """The scheduler is gone; what is not finished can be gone on with."""


class Dispatcher(Generic[AnyJob]):
    """Hands jobs to a cluster.

    A worker has one job at a time, so that the order of the jobs is kept, those who die take one with them, and it does
    not matter how a scheduler queues. Workers may come and go.

    Parameters
    ----------
    client : distributed.Client
        Of the cluster.
    work : callable
        Does a job on a worker.
    say : callable
        Called with remarks for people.
    """

    def __init__(self, client: Client, work: Callable[[AnyJob], Outcome], say: Callable[[str], object]) -> None:
        self._client, self._work, self._say = client, work, say
        self._running: dict[Future[Outcome], AnyJob] = {}
        self._submitted, self._is_alone = 0, False

    def outcomes(self, jobs: Sequence[AnyJob]) -> Iterator[tuple[AnyJob, Outcome]]:
        """How each job went, as they end.

        Parameters
        ----------
        jobs : sequence of Attempted
            The first is begun first.

        Yields
        ------
        tuple of Attempted and Outcome

        Raises
        ------
        SchedulerLostError
            If the scheduler does not answer any more.
        """
        waiting = deque(jobs)
        try:
            while waiting or self._running:
                while waiting and len(self._running) < self._room():
                    self._submit(waiting.popleft())
                for future in self._ended():
                    job = self._running.pop(future)
                    outcome = self._outcome_of(job, future)
                    if outcome is None:
                        waiting.appendleft(job)
                    else:
                        yield job, outcome
        finally:
            self._let_go()

    def _submit(self, job: AnyJob) -> None:
        self._submitted += 1
        key = f"{job.topic}-{self._submitted}-{job.name}"
        with self._connected():
            self._running[self._client.submit(self._work, job, key=key, pure=False)] = job

    def _room(self) -> int:
        """How many jobs may run: one a worker; one waits for a worker where there is none."""
        with self._connected():
            count = len(self._client.nthreads())
        if count == 0 and not self._is_alone:
            self._say("no worker is there; the batch waits for one")
        self._is_alone = count == 0
        return max(count, 1)

    def _ended(self) -> list[Future[Outcome]]:
        """Jobs that are done or failed; none if nothing happens for a second."""
        from distributed import wait

        with self._connected(), contextlib.suppress(TimeoutError), self._client.as_current():
            wait(list(self._running), timeout=_POLL, return_when="FIRST_COMPLETED")
        if self._client.status != "running":
            raise self._lost("it has closed the connection")
        return [future for future in self._running if future.done()]

    def _outcome_of(self, job: AnyJob, future: Future[Outcome]) -> Outcome | None:
        """How a job went; None if it is to be handed out again."""
        from distributed.scheduler import KilledWorker

        with self._connected():
            error: Any = future.exception(timeout=_POLL)
        attempts = _attempts_of(job)
        if isinstance(error, KilledWorker) and attempts <= MOST_ATTEMPTS:
            return None  # by the scheduler's own count, in which jobs that only waited are too
        if error is not None:
            said = f"internal error: {type(error).__name__}: {error}"
            return Outcome("failed", one_line(said), max(attempts, 1))
        with self._connected():
            outcome: Outcome = future.result(timeout=_POLL)
        return outcome

    @contextlib.contextmanager
    def _connected(self) -> Iterator[None]:
        """What goes wrong between client and scheduler, as one error."""
        try:
            yield
        except TimeoutError:
            raise
        except (OSError, CancelledError, RuntimeError) as error:
            raise self._lost(str(error)) from error

    def _lost(self, why: str) -> SchedulerLostError:
        return SchedulerLostError(one_line(f"the scheduler does not answer any more ({' '.join(why.split())[:120]})"))

    def _let_go(self) -> None:
        """Take back what was handed out."""
        with contextlib.suppress(OSError, CancelledError, RuntimeError, TimeoutError):
            if self._running and self._client.status == "running":
                self._client.cancel(list(self._running), force=True)
        self._running.clear()


def _attempts_of(job: Attempted) -> int:
    with contextlib.suppress(OSError):
        return (Path(job.ticket) / job.name).stat().st_size
    return 0
