"""The thread budget: results are the same bytes with any number of threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

from .errors import InputError

A = TypeVar("A")
B = TypeVar("B")
_MAX = 1024
_CORES = os.cpu_count() or 1  # asked once: an answer takes 40 µs where limits of a container are looked up
_budget: int | None = None  # None: as many as there are cores
_own = threading.local()  # each thread's second one


def set_threads(count: int | None) -> None:
    """Set how many threads work at a time in this process, OpenCV's too; results do not depend on it.

    Parameters
    ----------
    count : int or None
        1 to 1024; None for one a core. It counts for sessions and runs that begin later.

    Raises
    ------
    InputError
        If it is out of its range.

    Examples
    --------
    >>> set_threads(1)
    >>> set_threads(None)
    """
    global _budget
    if count is not None and (isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= _MAX):
        raise InputError(f"threads is {repr(count)[:40]}, expected 1 to {_MAX}, or None for one a core")
    import cv2

    _budget = count
    cv2.setNumThreads(-1 if count is None else count)


def thread_count() -> int:
    """Return how many threads may work at a time."""
    return _budget or _CORES


def both(function: Callable[[A], B], items: tuple[A, A]) -> tuple[B, B]:
    """Apply `function` to two items at a time, one of them in this thread."""
    if thread_count() < 2:
        return function(items[0]), function(items[1])
    first = _helper().submit(function, items[0])
    try:
        second = function(items[1])
    finally:
        first.exception()  # waits: nothing goes on behind the back of an error
    return first.result(), second


def _helper() -> ThreadPoolExecutor:
    """The second thread of this one: started once, as that takes as long as half a kernel; it ends with this one."""
    if not hasattr(_own, "helper"):
        _own.helper = ThreadPoolExecutor(1)
    helper: ThreadPoolExecutor = _own.helper
    return helper


def _forget_helpers() -> None:
    """In a process that was forked: threads do not come along."""
    global _own
    _own = threading.local()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_helpers)


def in_halves(function: Callable[[slice], None], count: int, least: int = 2) -> None:
    """Call `function` on the slices of two halves of `count` independent rows; on all at once if fewer than `least`."""
    middle = count // 2
    if count >= least:
        both(function, (slice(0, middle), slice(middle, count)))
    elif count:
        function(slice(0, count))


class Worker:
    """A thread that does one thing after another; with a budget of one thread each is done at once, by the caller."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1) if thread_count() > 1 else None

    @property
    def is_beside(self) -> bool:
        """Whether it is a thread of its own: else what may be in vain is better left."""
        return self._pool is not None

    def submit(self, function: Callable[..., B], *arguments: Any) -> Future[B]:
        """Have `function` called; what it raises is raised by the future's `result`."""
        if self._pool:
            return self._pool.submit(function, *arguments)
        done: Future[B] = Future()
        try:
            done.set_result(function(*arguments))
        except Exception as error:  # as a pool does: whoever asks for the result hears of it
            done.set_exception(error)
        return done

    def close(self) -> None:
        """Wait for what is under way, and end the thread."""
        if self._pool:
            self._pool.shutdown()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
