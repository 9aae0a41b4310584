"""A cluster, simulated event by event: one scheduler, workers that die, and one storage that all share.

Tasks are given out in order. Each goes through four stations:

1. the *scheduler*, which serves one message at a time, each for a fixed time: one to give a task out, one to take it
   back;
2. the *storage*: bytes are read at ``min(link, bandwidth / flows)``, shared evenly among all flows of the moment;
3. the worker's processor, for the task's seconds;
4. the storage again, for what it writes.

A worker may die at any moment (exponential lifetimes): what it did since the task's last checkpoint is lost, the task
goes to the head of the queue, and a new worker takes its place after the time of a start.
"""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Key = tuple[int, int]  # number and attempt of a task


@dataclass(frozen=True)
class Task:
    """What one recording or tile asks for."""

    seconds: float
    """Of one processor."""
    reads: float = 0.0
    """Bytes from the storage before it begins."""
    writes: float = 0.0
    """Bytes to the storage when it ends."""


@dataclass(frozen=True)
class Cluster:
    """What there is to do it with."""

    workers: int
    scheduler_seconds: float = 0.0
    """Time of the scheduler for one message; a task has two."""
    bandwidth: float = np.inf
    """Bytes/s of the storage, for all together."""
    link: float = np.inf
    """Bytes/s of one worker's network."""
    start_seconds: float = 0.0
    """From asking for a worker to its first task."""
    lifetime: float = np.inf
    """Mean seconds until a worker dies."""
    checkpoint_seconds: float = np.inf
    """Work between two checkpoints: the most that a death costs; without one, all of a task."""
    seed: int = 0


@dataclass
class Outcome:
    """What a simulated run came to; shares are of the makespan."""

    makespan: float
    """Seconds from the first worker's start to the last task's end."""
    computing: float
    """Share of all workers' time that went into tasks' own seconds: the efficiency."""
    scheduler: float
    """Share of the time in which the scheduler was busy."""
    storage: float
    """Share of the time in which the storage's bandwidth, not the workers' links, was what held flows back."""
    last: float
    """Share of the time after the queue was empty: the tail."""
    deaths: int
    lost_seconds: float
    """Work that was done again."""

    @property
    def limit(self) -> str:
        """What holds it back most: the station that is busiest, or the tail where none is."""
        shares = {"scheduler": self.scheduler, "storage": self.storage, "tail": self.last, "workers": self.computing}
        return max(shares, key=lambda name: shares[name])


class Flows:
    """Transfers that share one bandwidth evenly, by virtual time: all flows advance at one rate."""

    def __init__(self, bandwidth: float, link: float) -> None:
        self.bandwidth, self.link = bandwidth, link
        self.ends: list[tuple[float, Key]] = []  # bytes that each flow will have had when it ends
        self.had, self.now, self.held_back = 0.0, 0.0, 0.0
        self.gone: set[Key] = set()

    @property
    def rate(self) -> float:
        """Bytes/s of each flow."""
        return min(self.link, self.bandwidth / max(len(self.ends) - len(self.gone), 1))

    def advance(self, now: float) -> None:
        """Let all flows run until then."""
        passed = now - self.now
        if self.ends and passed > 0:
            self.had += passed * self.rate
            self.held_back += passed * (self.rate < self.link)
        self.now = now

    def add(self, key: Key, size: float) -> None:
        heapq.heappush(self.ends, (self.had + size, key))

    def drop(self, key: Key) -> None:
        """A flow whose worker died."""
        self.gone.add(key)
        self._clear()

    def next_end(self) -> float:
        """When the next flow ends, if none comes or goes before."""
        return self.now + max(self.ends[0][0] - self.had, 0.0) / self.rate if self.ends else np.inf

    def pop(self) -> Key:
        """End the flow that is next."""
        key = heapq.heappop(self.ends)[1]
        self._clear()
        return key

    def _clear(self) -> None:
        while self.ends and self.ends[0][1] in self.gone:
            self.gone.discard(heapq.heappop(self.ends)[1])


@dataclass
class _Job:
    """A task on its way: the seconds that are left, and since when a processor has been at it."""

    number: int
    task: Task
    left: float
    worker: int = -1
    station: str = "queue"
    since: float = 0.0
    attempt: int = 0

    def done_until(self, now: float) -> float:
        """Seconds of this attempt's work until then."""
        return {"computing": now - self.since, "writing": self.left, "returned": self.left}.get(self.station, 0.0)


class Simulation:
    """One run; `proceed` gives its outcome."""

    def __init__(self, tasks: Sequence[Task], cluster: Cluster) -> None:
        self.cluster, self.random = cluster, np.random.default_rng(cluster.seed)
        self.jobs = [_Job(number, task, task.seconds) for number, task in enumerate(tasks)]
        self.queue, self.idle = deque(self.jobs), deque[int]()
        self.of_worker: dict[int, _Job] = {}
        self.flows = Flows(cluster.bandwidth, cluster.link)
        self.events: list[tuple[float, int, str, int, int]] = []
        self.order = itertools.count()
        self.now = self.free_at = self.busy = self.lost = self.emptied = 0.0
        self.unfinished, self.deaths = len(self.jobs), 0
        for worker in range(cluster.workers):
            self._start(worker)

    def proceed(self) -> Outcome:
        """Go from event to event until all tasks are done."""
        while self.unfinished:
            if self.flows.next_end() <= (self.events[0][0] if self.events else np.inf):
                self._advance(self.flows.next_end())
                self._transferred(self.jobs[self.flows.pop()[0]])
            else:
                when, _, what, which, attempt = heapq.heappop(self.events)
                self._advance(when)
                self._handle(what, which, attempt)
        seconds = sum(job.task.seconds for job in self.jobs)
        return Outcome(
            self.now, seconds / (self.cluster.workers * self.now), self.busy / self.now,
            self.flows.held_back / self.now, 1 - self.emptied / self.now, self.deaths, self.lost,
        )  # fmt: skip

    def _advance(self, when: float) -> None:
        self.flows.advance(when)
        self.now = when

    def _at(self, when: float, what: str, which: int, attempt: int = 0) -> None:
        heapq.heappush(self.events, (when, next(self.order), what, which, attempt))

    def _handle(self, what: str, which: int, attempt: int) -> None:
        if what == "ready":
            self.idle.append(which)
            self._give_out()
        elif what == "death":
            self._die(which)
        elif self.jobs[which].attempt == attempt:  # not of an attempt whose worker died since
            self._step(self.jobs[which])

    def _start(self, worker: int) -> None:
        ready = self.now + self.cluster.start_seconds
        self._at(ready, "ready", worker)
        if np.isfinite(self.cluster.lifetime):
            self._at(ready + self.random.exponential(self.cluster.lifetime), "death", worker)

    def _give_out(self) -> None:
        while self.queue and self.idle:
            job = self.queue.popleft()
            job.worker, job.station = self.idle.popleft(), "given"
            self.of_worker[job.worker] = job
            self._at(self._message(), "step", job.number, job.attempt)
            self.emptied = self.now

    def _message(self) -> float:
        """When the scheduler has served a message that comes now."""
        self.free_at = max(self.free_at, self.now) + self.cluster.scheduler_seconds
        self.busy += self.cluster.scheduler_seconds
        return self.free_at

    def _step(self, job: _Job) -> None:
        """A task leaves the scheduler or the processor."""
        if job.station == "given":
            self._transfer(job, "reading", job.task.reads)
        elif job.station == "computing":
            self._transfer(job, "writing", job.task.writes)
        else:
            self._finish(job)

    def _transfer(self, job: _Job, station: str, size: float) -> None:
        job.station = station
        if size:
            self.flows.add((job.number, job.attempt), size)
        else:
            self._transferred(job)

    def _transferred(self, job: _Job) -> None:
        if job.station == "reading":
            job.station, job.since = "computing", self.now
            self._at(self.now + job.left, "step", job.number, job.attempt)
        else:
            job.station = "returned"
            self._at(self._message(), "step", job.number, job.attempt)

    def _finish(self, job: _Job) -> None:
        self.unfinished -= 1
        job.station = "done"
        del self.of_worker[job.worker]
        self.idle.append(job.worker)
        self._give_out()

    def _die(self, worker: int) -> None:
        self.deaths += 1
        job = self.of_worker.pop(worker, None)
        if job is None:
            self.idle.remove(worker)
        else:
            self._take_back(job)
        self._start(worker)
        self._give_out()

    def _take_back(self, job: _Job) -> None:
        """A task whose worker died keeps what its checkpoints hold, and is the next to be given out."""
        done, step = job.done_until(self.now), self.cluster.checkpoint_seconds
        kept = done - done % step if np.isfinite(step) else 0.0
        self.lost += done - kept
        job.left -= kept
        if job.station in ("reading", "writing"):
            self.flows.drop((job.number, job.attempt))
        job.attempt += 1
        job.station = "queue"
        self.queue.appendleft(job)


def simulate(tasks: Sequence[Task], cluster: Cluster) -> Outcome:
    """Run the tasks in their order on the cluster."""
    return Simulation(tasks, cluster).proceed()
