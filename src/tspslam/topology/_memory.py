"""Memory of large arrays, kept for the next ones when they are gone.

The system clears each page that it hands out, and that of a virtual machine may have to fetch it from its host first:
for large arrays that takes as long as filling them. Small ones come from the heap, which keeps its pages by itself.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

LEAST = 1 << 22  # bytes of an array that has a block of its own: two huge pages
MOST = 1 << 30  # bytes that are kept: those of a complex of 10^6 vertices with its signals and responses
_PAGE = 1 << 21  # bytes of a huge page, of which blocks are made
_LINE = 64  # bytes that come from memory together
_SLACK = (
    4  # times the bytes asked for that a block may have: half as large a mesh rests on the blocks of the larger one
)

_kept: list[mmap.mmap] = []  # the longest kept first
_used = 0  # bytes of blocks that arrays stand in
_most_of_all = math.inf  # bytes that are used and kept together, unless more are used
_lock = threading.RLock()  # a block may come back while this thread takes another


class _Block:
    """What an array in a block rests on: gone with the array's last view, it gives the block back."""

    __slots__ = ("__array_interface__", "_memory")

    def __init__(self, memory: mmap.mmap, count: int, kind: np.dtype[Any]) -> None:
        self._memory = memory
        address = np.frombuffer(memory, np.uint8).ctypes.data
        self.__array_interface__ = {"shape": (count,), "typestr": kind.str, "data": (address, False), "version": 3}

    def __del__(self) -> None:
        give_back(self._memory)


def empty(shape: int | tuple[int, ...], dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """Return an array like `numpy.empty`, which begins with a cache line; a large one in a block that was kept."""
    kind = np.dtype(dtype)
    count = math.prod(shape) if isinstance(shape, tuple) else shape
    size = count * kind.itemsize
    if size < LEAST or not hasattr(mmap, "MADV_FREE"):
        return _aligned(count, kind).reshape(shape)
    try:
        memory = _take(-(-size // _PAGE) * _PAGE)
    except OSError:  # no such mapping is given: the heap says what is wrong, if it has no room either
        return _aligned(count, kind).reshape(shape)
    return np.asarray(_Block(memory, count, kind)).reshape(shape)


@contextlib.contextmanager
def bounded(size: int) -> Iterator[None]:
    """Keep no block where those in use and those kept would be more bytes than this."""
    global _most_of_all
    before, _most_of_all = _most_of_all, size
    _drop(0)
    try:
        yield
    finally:
        _most_of_all = before


def give_back(memory: mmap.mmap) -> None:
    """Keep a block, unless that is too much; the system may take its pages when it runs short of them."""
    global _used
    with _lock:
        _used -= len(memory)
        if sum(map(len, _kept)) + len(memory) <= _room():
            _advise(memory, "MADV_FREE")
            _kept.append(memory)


def _take(size: int) -> mmap.mmap:
    """The smallest block that is kept and large enough, but not far too large; else a new one, and the oldest go."""
    global _used
    with _lock:
        fitting = [memory for memory in _kept if size <= len(memory) < _SLACK * size]
        if fitting:
            memory = min(fitting, key=len)
            del _kept[next(k for k, each in enumerate(_kept) if each is memory)]
        else:
            _drop(size)
            memory = _map(size)
        _used += len(memory)
    return memory


def _room() -> float:
    """Bytes that may be kept beside those in use."""
    return min(MOST, _most_of_all - _used)


def _drop(size: int) -> None:
    """Let the oldest blocks go, as far as others and one of this size may not be kept beside them."""
    with _lock:
        while _kept and sum(map(len, _kept)) + size > _room():
            del _kept[0]


def _map(size: int) -> mmap.mmap:
    """A new block; where there is no room for it beside those that are kept, these go."""
    try:
        memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError:
        if not _kept:
            raise
        _kept.clear()
        return _map(size)
    _advise(memory, "MADV_HUGEPAGE")
    return memory


def _advise(memory: mmap.mmap, name: str) -> None:
    """Tell the system how a block is used, if it knows the word; what is in it does not depend on that."""
    with contextlib.suppress(OSError, AttributeError):
        memory.madvise(getattr(mmap, name))


def _renew_lock() -> None:
    """In a process that was forked: whoever held it did not come along."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew_lock)


def _aligned(count: int, kind: np.dtype[Any]) -> NDArray[Any]:
    """An array of the heap, from a cache line on."""
    held = np.empty(count + _LINE // kind.itemsize, kind)
    first = -held.ctypes.data % _LINE // kind.itemsize
    return held[first : first + count]
