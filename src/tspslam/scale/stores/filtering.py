"""Filtering a store: what is not done yet, in this process or on a Dask cluster, each run written when it is done."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from ..._files import bad_input
from ...io.lock import FolderLock
from ...topology._memory import bounded
from . import cluster
from .mesh import StoredMesh
from .stored_response import (
    StoredResponse,
    begin,
    finish,
    is_complete,
    open_response,
    runs_done,
    stamps_of,
    store_answer,
    sweep,
)
from .tiled_filter import Options, filter_rows
from .tiles import BLOCK_BYTES_PER_VERTEX, checked_tile, runs_to_do, tile_for


class Place(NamedTuple):
    """Where tiles are filtered.

    Attributes
    ----------
    workers : int
        Processes on this machine; 0 is this process alone.
    memory : int
        What each may take, bytes.
    client : distributed.Client or None
        A cluster that runs already.
    """

    workers: int = 0
    memory: int = 1_500_000_000
    client: Any = None


def filter_mesh(
    store: StoredMesh, options: Options, place: Place, *, tile: int | None = None,
    on_tile: Callable[[int, int], None] | None = None,
) -> StoredResponse:  # fmt: skip
    """Filter a store, as `tspslam.scale.Store.filter` says.

    Parameters
    ----------
    store : StoredMesh
        The store.
    options : Options
        The filter.
    place : Place
        Where.
    tile : int, optional
        Vertices of a tile, at most; as many as the memory admits by default.
    on_tile : callable, optional
        Called with how many vertices are done, and how many there are.

    Returns
    -------
    StoredResponse

    Raises
    ------
    InputError, OutputError
        As `tspslam.scale.Store.filter`.
    """
    _check(store, options)
    size = tile_for(store, place.memory) if tile is None else checked_tile(tile)
    folder = begin(store, options)
    lock = FolderLock(folder)
    try:
        done = runs_done(store, options.name)
        runs = runs_to_do(store.n, store.chunk, size, done)
        if runs or not is_complete(store, options.name):
            sweep(folder)
            finished = sum(last - first for first, last in done)
            for row, (first, last) in _run(store, options, runs, size, place):
                finished += last - first
                done[first, last] = row
                if on_tile is not None:
                    on_tile(finished, store.n)
            finish(store, options, _summary(list(done.values())))
    finally:
        lock.release()
    return open_response(store, options.name)


def _check(store: StoredMesh, options: Options) -> None:
    """Refuse a store that has nothing to filter, or no camera from which something is hidden."""
    if not store.n_faces:
        raise bad_input(store.path, "has no faces, so that no vertex has neighbours", "a mesh")
    if not store.images and "luminance" not in store.arrays:
        raise bad_input(store.path, "has neither images nor luminance", "one of them")
    if options.occlusion is not None and all(image.rig is None for image in store.images):
        raise bad_input(store.path, "has no image with a camera", "one, from which faces hide others (--occlusion)")
    if store.images and not any(map(os.path.exists, store.image_paths)):
        said = f"none of its {len(store.images)} images is there, such as {store.image_paths[0]}"
        raise bad_input(store.path, said, "images where they were, or their folder now (--images, images=)")


def _run(
    store: StoredMesh, options: Options, runs: list[tuple[int, int]], tile: int, place: Place
) -> Iterator[tuple[dict[str, Any], tuple[int, int]]]:
    """Do runs, here or on a cluster, and tell each that is done."""
    if not runs:
        return
    if place.client is None and not place.workers:
        for first, last in runs:
            yield filter_run(store, vars(options), first, last, tile), (first, last)
        return
    where, told = (str(store.path.resolve()), store.moved), vars(options)

    def work(first: int, last: int, size: int) -> dict[str, Any]:
        return filter_run(where, told, first, last, size)

    with cluster.opened(place.client, place.workers, place.memory) as client:
        yield from cluster.spread(client, work, runs, tile)


def filter_run(
    store: StoredMesh | tuple[str, str | None], options: dict[str, Any], first: int, last: int, tile: int
) -> dict[str, Any]:
    """Filter a run of whole chunks and write it; a worker's task.

    Parameters
    ----------
    store : StoredMesh or (path, images)
        The store, or where it and its images are.
    options : dict
        The filter.
    first, last : int
        Rows.
    tile : int
        Vertices at a time.

    Returns
    -------
    dict
        What is kept about the run.

    Raises
    ------
    InputError
        If the store or an image is damaged, or not visible here.
    OutputError
        If the responses cannot be written.
    """
    opened = store if isinstance(store, StoredMesh) else cluster.kept_store(*store)
    chosen, stamps = Options.of(options), stamps_of(opened, first, last)
    with bounded(tile * BLOCK_BYTES_PER_VERTEX):
        answer = filter_rows(opened, chosen, first, last, tile)
    told = {"peak_bytes": peak_bytes(), "tile": tile, "images": stamps}
    store_answer(opened, chosen.name, first, answer, told)
    return told | {"defined": int(answer.defined.sum()), "missing": list(answer.missing)}


def peak_bytes() -> int:
    """Measure the most memory that this process has taken so far.

    Returns
    -------
    int
        Bytes; 0 where the system does not tell.
    """
    try:
        import resource
    except ImportError:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    tiles = [row["tile"] for row in rows]
    return {
        "defined": sum(row["defined"] for row in rows),
        "missing": sorted({k for row in rows for k in row["missing"]}),
        "peak_bytes": max((row["peak_bytes"] for row in rows), default=0),
        "tiles": len(rows),
        "split": sum(tile < max(tiles) for tile in tiles),
    }
