"""Runs of a store on Dask: each on one worker; a run whose worker dies is done again in smaller tiles."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..cluster import local_workers, require_dask, running_cluster
from .mesh import StoredMesh, open_mesh

Run = tuple[int, int]
Work = Callable[[int, int, int], dict[str, Any]]
_MOST_WORKERS = 1024
_MOST_DEATHS = 8  # of workers over one run: its tiles are then 1/128 of what they were


@contextlib.contextmanager
def opened(client: Any, workers: int, memory: int) -> Iterator[Any]:
    """Give a client: the one that is given, or that of a cluster of processes on this machine, which ends with this.

    Parameters
    ----------
    client : distributed.Client or None
        One that is there already.
    workers : int
        Processes, of one thread each.
    memory : int
        What each may take, bytes; its nanny ends it at 95 % of that.

    Yields
    ------
    distributed.Client

    Raises
    ------
    InputError
        If dask is not installed, or workers are not 1 to 1024.
    """
    if client is not None:
        yield client
        return
    if isinstance(workers, bool) or not isinstance(workers, int) or not 1 <= workers <= _MOST_WORKERS:
        raise InputError(f"workers are {workers!r:.40}, expected 0 to {_MOST_WORKERS} processes")
    require_dask()
    with local_workers(workers, 1, memory, allowed_failures=0) as own:
        yield own


@contextlib.contextmanager
def connected(address: str | None, store: Path) -> Iterator[Any]:
    """Give a client of a scheduler that runs already.

    Parameters
    ----------
    address : str or None
        Such as ``tcp://10.0.0.1:8786``; None gives None.
    store : Path
        What its workers have to see.

    Yields
    ------
    distributed.Client or None

    Raises
    ------
    InputError
        If dask is not installed, nobody answers within ten seconds, or there is no worker, one that does not see the
        store, or one of other versions.
    """
    if address is None:
        yield None
        return
    require_dask()
    with running_cluster(address, [str(store.resolve())]) as client:
        yield client


def spread(client: Any, work: Work, runs: list[Run], tile: int) -> Iterator[tuple[dict[str, Any], Run]]:
    """Do runs on a cluster, in any order; one whose worker was killed is done again, in tiles half as large.

    Parameters
    ----------
    client : distributed.Client
        The cluster.
    work : callable
        (first, last, tile) -> what is kept about the run.
    runs : list of (first, last)
        Rows.
    tile : int
        Vertices of a tile, at first.

    Yields
    ------
    row : dict
        What `work` gave.
    run : (first, last)
        Which run it is of.

    Raises
    ------
    InputError
        If eight workers have died over a run, or one over a tile of one vertex.
    """
    from distributed import Future, KilledWorker, as_completed

    def submit(run: Run, size: int, deaths: int) -> Any:
        future = client.submit(work, *run, size, pure=False)
        asked[future.key] = run, size, deaths
        return future

    asked: dict[str, tuple[Run, int, int]] = {}
    pending = as_completed([submit(run, tile, 0) for run in runs], loop=client.loop)
    try:
        for future in pending:
            run, size, deaths = asked.pop(future.key)
            try:
                row = future.result()
            except KilledWorker as error:
                if size == 1 or deaths + 1 == _MOST_DEATHS:
                    said = f"rows {run[0]} to {run[1]} kill their worker even {size} vertices at a time"
                    raise InputError(f"{said}, expected a worker with more memory (--memory)") from error
                pending.add(submit(run, max(min(size, run[1] - run[0]) // 2, 1), deaths + 1))
                continue
            yield row, run
    finally:
        client.cancel([Future(key, client) for key in asked])


@lru_cache(4)
def kept_store(path: str, images: str | None) -> StoredMesh:
    """Open a store once in a worker.

    Parameters
    ----------
    path : str
        Its folder.
    images : str or None
        The folder of its images, where that is told.

    Returns
    -------
    StoredMesh

    Raises
    ------
    InputError
        If the worker does not see it there.
    """
    if not Path(path).is_dir():
        raise InputError(f"{path}: is not visible to a worker, expected the store by the same path on all machines")
    return open_mesh(path, images=images)
