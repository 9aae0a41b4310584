"""Workers: some of this machine's processes, or a Dask cluster that is there already, looked over before any work."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import importlib.util
import logging
import multiprocessing
import os
import re
import signal
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Any

from .._files import one_line
from ..errors import InputError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

LEAST_MEMORY = 10**9  # bytes: a run of images of 128 x 96 takes 0.42e9
INSTALL = "pip install 'tspslam[scale]'"
_PATIENCE = 10.0  # s for a scheduler to answer, and for a first worker to be there
_SAME = ("tspslam", "numpy", "scipy", "opencv-python-headless", "numba", "dask", "distributed")
"""Packages on which results, or messages, depend."""
_MOST_NAMED = 4  # workers, or paths, in a line
_ADDRESS = re.compile(r"(?:[a-z]+://)?[^/\s]+:([0-9]{1,5})")
_LAST_PORT = 65535
_SUCH = "expected one such as tcp://127.0.0.1:8786"
_LOGS = ("distributed", "distributed.client", "bokeh", "tornado")  # that Dask sets levels of
_POOLS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class Workers:
    """Where a batch runs.

    Attributes
    ----------
    count : int or None
        Processes on this machine; None for one a core, and no more than there is work for.
    scheduler : str or None
        Address of a scheduler of Dask that is there, in their place.
    threads : int or None
        Of all processes on this machine together, None for one a core; of a cluster's, for each worker, None for 1.
    memory : int or None
        Bytes for each process on this machine; None for an equal share of what there is.

    Raises
    ------
    InputError
        If a count is below 1, or what goes with processes of this machine is given beside a scheduler.
    """

    count: int | None = None
    scheduler: str | None = None
    threads: int | None = None
    memory: int | None = None

    def __post_init__(self) -> None:
        for name, least in (("count", 1), ("threads", 1), ("memory", LEAST_MEMORY)):
            value = getattr(self, name)
            if value is not None and (type(value) is not int or value < least):
                raise InputError(f"workers: {name} is {value!r:.40}, expected an integer of {least} or more")
        if self.scheduler is not None and (self.count, self.memory) != (None, None):
            raise InputError("workers: a scheduler has workers of its own, expected no count and no memory beside it")


@contextlib.contextmanager
def connected(workers: Workers, most: int, paths: Collection[str]) -> Iterator[tuple[Client, int, str]]:
    """The workers that were asked for.

    Parameters
    ----------
    workers : Workers
        Where.
    most : int
        Recordings to be run: there are no more processes.
    paths : collection of str
        What the workers of a cluster must see.

    Yields
    ------
    tuple of distributed.Client, int and str
        The cluster, threads for each run, and words for both.
    """
    if workers.scheduler is not None:
        with running_cluster(workers.scheduler, paths) as client:
            held = client.nthreads()
            yield client, workers.threads or 1, _say_cluster(workers.scheduler, held)
        return
    budget = workers.threads or os.cpu_count() or 1
    count = min(workers.count or budget, most)
    threads = max(1, budget // count)
    memory = workers.memory or _memory_of_this_machine() // count
    said = f"{_count(count, 'worker')} of {_count(threads, 'thread')}, each ended beyond {memory / 1e9:.3g} GB"
    with local_workers(count, threads, memory) as client:
        yield client, threads, f"{said}; what a run keeps beyond tracking.map.image_bytes goes to temporary files"


def _memory_of_this_machine() -> int:
    from distributed.system import MEMORY_LIMIT

    return int(MEMORY_LIMIT)


def _say_cluster(address: str, held: dict[str, int]) -> str:
    said = f"{_count(len(held), 'worker')} at {address}"
    several = sum(threads > 1 for threads in held.values())
    return said + (
        f"; {several} have several threads, of which one is used: --nthreads 1 gives more" if several else ""
    )


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def require_dask() -> None:
    """Raise `InputError`, with how to install it, unless Dask is there; nothing of it is loaded.

    Raises
    ------
    InputError
    """
    if importlib.util.find_spec("distributed") is None:
        raise InputError(f"Dask is not installed, expected the extra scale: {INSTALL}")


@contextlib.contextmanager
def local_workers(count: int, threads: int, memory: int, *, allowed_failures: int = 100) -> Iterator[Client]:
    """Worker processes on this machine, which listen on loopback alone and end with the block.

    Parameters
    ----------
    count : int
        Processes; each does one thing at a time.
    threads : int
        That OpenBLAS, OpenMP and numba have in each of them, where the environment does not say (``OMP_NUM_THREADS``).
    memory : int
        Bytes for each; one that goes beyond is ended and begun anew. Nothing is spilled to disk: results are small.
    allowed_failures : int
        Workers that may die over one job before it fails. The default leaves that to those who count where jobs begin
        (job.py).

    Yields
    ------
    distributed.Client
    """
    import dask

    with quiet(), dask.config.set(_settings(threads, allowed_failures)), contextlib.ExitStack() as stack:
        from distributed import Client, LocalCluster

        with _without_interrupts():
            cluster = LocalCluster(
                n_workers=count, threads_per_worker=1, memory_limit=memory, host="127.0.0.1", protocol="tcp",
                worker_dashboard_address=None, silence_logs=logging.CRITICAL,
                scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            )  # fmt: skip
            stack.callback(_close, cluster)
            client = stack.enter_context(Client(cluster, timeout=_PATIENCE, set_as_default=False))
        yield client


def _close(cluster: LocalCluster) -> None:
    """End the workers; those that do not end are killed: what they have is on disk."""
    try:
        cluster.close(timeout=_PATIENCE)
    except TimeoutError:  # some versions wait for ever for a worker that is just being begun anew
        for process in multiprocessing.active_children():
            if process.name.startswith("Dask Worker"):
                process.kill()


def _settings(threads: int, allowed_failures: int) -> dict[str, Any]:
    """What differs from Dask's defaults: no sampling, no limits but one, no spilling."""
    beyond = {f"distributed.worker.memory.{name}": False for name in ("target", "spill", "pause")}
    return beyond | {
        "distributed.worker.memory.terminate": 0.95,  # of the limit: Dask's own default
        "distributed.worker.profile.enabled": False,
        "distributed.scheduler.allowed-failures": allowed_failures,
        "distributed.admin.tick.limit": "1h",  # a worker that compiles does not answer for seconds
        "distributed.nanny.pre-spawn-environ": dict.fromkeys(_POOLS, threads),
    }


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """Begin threads and processes that ctrl-C does not reach: a terminal sends it to all, and this one ends the others.

    What is blocked here is so for them as long as they live; it comes to this thread at the end of the block.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    resource_tracker.ensure_running()  # it would let them through in the thread that begins it
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def running_cluster(address: str, paths: Collection[str]) -> Iterator[Client]:
    """A cluster that is there, once its workers have been found to fit.

    Parameters
    ----------
    address : str
        Of its scheduler, such as ``tcp://10.0.0.1:8786``.
    paths : collection of str
        What each worker must see, by these absolute paths.

    Yields
    ------
    distributed.Client

    Raises
    ------
    InputError
        If no scheduler answers in 10 s, it has no worker, a worker has other versions, or does not see a path.
    """
    found = _ADDRESS.fullmatch(address)
    if not found or int(found[1]) > _LAST_PORT:
        raise InputError(one_line(f"{address[:80]}: is no address of a scheduler, {_SUCH}"))
    with quiet():
        from distributed import Client

        _require_scheduler(address)
        with Client(address, timeout=_PATIENCE, set_as_default=False) as client:
            check_workers(client, paths)
            yield client


def _require_scheduler(address: str) -> None:
    """Ask who is there: a client itself would wait for ever for somebody who says nothing."""
    try:
        with ThreadPoolExecutor(1) as pool:  # this thread may have a loop that runs, as a notebook's
            kind = pool.submit(asyncio.run, asyncio.wait_for(_identify(address), _PATIENCE)).result()
    except (TimeoutError, OSError, ValueError, TypeError, RuntimeError, ImportError) as error:
        why = f" ({' '.join(str(error).split())[:160]})" if str(error) else ""
        raise InputError(one_line(f"{address}: no scheduler answers within {_PATIENCE:g} s{why}; {_SUCH}")) from error
    if kind != "Scheduler":
        raise InputError(one_line(f"{address}: is a {kind} of Dask, {_SUCH}, a scheduler's"))


async def _identify(address: str) -> str:
    from distributed.core import rpc
    from distributed.security import Security

    async with rpc(address, connection_args=Security().get_connection_args("client")) as remote:
        return str((await remote.identity()).get("type"))


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Be without what Dask logs: what matters of it is said by events, or in a line of error.

    Yields
    ------
    None
    """
    import dask

    with dask.config.set({"logging": dict.fromkeys(_LOGS, "critical")}):  # read when distributed is first imported
        import distributed  # noqa: F401
    before = {name: logging.getLogger(name).level for name in _LOGS}
    try:
        for name in _LOGS:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        yield
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)


def check_workers(client: Client, paths: Collection[str]) -> None:
    """Ask every worker for its versions and for what it sees.

    Parameters
    ----------
    client : distributed.Client
        Of the cluster.
    paths : collection of str
        Absolute.

    Raises
    ------
    InputError
        If there is no worker, or one does not fit; the differing ones are named.
    """
    address = client.scheduler.address
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        raise InputError(f"{address}: has no worker, expected one at least: dask worker {address}") from error
    _check_versions(address, client.get_versions(packages=[*_SAME]))
    _check_sight(client, sorted(paths))


def _check_versions(address: str, found: Any) -> None:
    wanted, differing, keys = _versions(found["client"]), [], set()
    for name, worker in found["workers"].items():
        own = _versions(worker)
        others = [key for key in wanted if own[key] != wanted[key]]
        if others:
            keys |= {*others}
            differing.append(f"{name} has {', '.join(f'{key} {own[key]}' for key in others)}")
    if differing:
        here = ", ".join(f"{key} {value}" for key, value in wanted.items() if key in keys)
        raise InputError(f"{address}: workers differ: {_some(differing)}; expected {here} on each, as here")


def _check_sight(client: Client, paths: list[str]) -> None:
    for worker, unseen in client.run(unseen_paths, paths).items():
        if unseen:
            said = f"worker {worker} does not see {_some(unseen)}"
            raise InputError(one_line(f"{client.scheduler.address}: {said}; expected the same paths on each worker"))


def unseen_paths(paths: list[str]) -> list[str]:
    """Which of the paths are not there for this process.

    Parameters
    ----------
    paths : list of str
        Absolute.

    Returns
    -------
    list of str

    Examples
    --------
    >>> unseen_paths(["/", "/no/such/path"])
    ['/no/such/path']
    """
    return [path for path in paths if not os.path.exists(path)]


def _versions(told: dict[str, Any]) -> dict[str, str]:
    """Of Python, to its minor number, and of the packages that must agree."""
    packages = dict(told["packages"])
    python = ".".join(str(packages.get("python")).split(".")[:2])
    return {"python": python, **{name: str(packages.get(name) or "missing") for name in _SAME}}


def _some(words: list[str]) -> str:
    more = len(words) - _MOST_NAMED
    return "; ".join(words[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
