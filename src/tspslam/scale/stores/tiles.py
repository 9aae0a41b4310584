"""How large tiles may be: a model of the memory that a vertex takes, and runs of chunks that are still to do."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from pathlib import Path

from ...errors import InputError
from ...io import image_size
from .images import ImageReference
from .mesh import StoredMesh

BYTES_PER_VERTEX = 1000
"""Of a tile with its halo, at the peak: faces as read, complex, stars, signals, sums. Measured: 860, three rings."""

BLOCK_BYTES_PER_VERTEX = BYTES_PER_VERTEX // 2
"""Of these, what large arrays stand in and what is kept of such: tiles differ in size, and none fits blocks of all."""

BASE_BYTES = 400 << 20
"""Of a process with NumPy, kernels and Dask, before a tile."""

LEAST_TILE = 256
"""Vertices; a memory that does not admit so many is refused."""

_UNITS = {"": 1, "B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
_BYTES_PER_PIXEL = 24  # of an image with its luminance and its sums over rows


def checked_memory(memory: float | str) -> int:
    """Return an amount of memory in bytes, or raise `InputError`.

    Parameters
    ----------
    memory : float or str
        Bytes, or a number with a unit: B, kB, MB, GB, KiB, MiB, GiB.

    Returns
    -------
    int

    Examples
    --------
    >>> checked_memory("1.5 GB")
    1500000000
    """
    text = "" if isinstance(memory, bool) else str(memory).strip()
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([kKMG]?i?B?)", text)
    amount = float(found[1]) * _UNITS.get(found[2], math.inf) if found else math.inf
    if not math.isfinite(amount):
        raise InputError(f"memory is {memory!r:.40}, expected bytes or a number with B, kB, MB, GB, KiB, MiB or GiB")
    return int(amount)


def tile_for(store: StoredMesh, memory: int) -> int:
    """Vertices of a tile that a process of so much memory can filter.

    Parameters
    ----------
    store : StoredMesh
        The store; its largest image counts.
    memory : int
        Bytes.

    Returns
    -------
    int

    Raises
    ------
    InputError
        If not even a small tile fits.
    """
    pixels = max(map(_area, store.images, store.image_paths), default=0)
    left = 0.8 * memory - BASE_BYTES - _BYTES_PER_PIXEL * pixels
    tile = int(left / BYTES_PER_VERTEX)
    if tile < LEAST_TILE:
        needed = (BASE_BYTES + _BYTES_PER_PIXEL * pixels + LEAST_TILE * BYTES_PER_VERTEX) / 0.8
        raise InputError(f"memory is {memory / 1e9:.3g} GB, expected {needed / 1e9:.3g} or more for the largest image")
    return min(tile, 1 << 24)


def checked_tile(tile: int) -> int:
    """Return the vertices of a tile as an int, or raise `InputError`.

    Parameters
    ----------
    tile : int
        1 to 2^24.

    Returns
    -------
    int
    """
    if isinstance(tile, bool) or not isinstance(tile, int) or not 1 <= tile <= 1 << 24:
        raise InputError(f"tile is {tile!r:.40}, expected 1 to {1 << 24} vertices")
    return tile


def runs_to_do(n: int, chunk: int, tile: int, done: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """Runs of whole chunks that no finished run covers, each about a tile long.

    No two share a chunk, so that they can be written at the same time.

    Parameters
    ----------
    n, chunk, tile : int
        Vertices of the store, of a chunk, of a tile.
    done : iterable of (first, last)
        Rows that are finished, in whole chunks.

    Returns
    -------
    list of (first, last)

    Examples
    --------
    >>> runs_to_do(10, 2, 4, [(2, 4)])
    [(0, 2), (4, 8), (8, 10)]
    """
    step, at = max(chunk, tile // chunk * chunk), 0
    runs = []
    for first, last in [*sorted(done), (n, n)]:
        runs += [(low, min(low + step, first)) for low in range(at, first, step)]
        at = max(at, last)
    return runs


def _area(image: ImageReference, path: Path) -> int:
    """Pixels of an image; 0 where it is not there."""
    if image.rig is not None:
        return image.rig.width * image.rig.height
    width, height = image_size(path) if os.path.exists(path) else (0, 0)
    return width * height
