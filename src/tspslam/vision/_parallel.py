"""Two threads for work that releases the GIL; the result does not depend on how many there are."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def both(function: Callable[[A], B], items: tuple[A, A]) -> tuple[B, B]:
    """Apply `function` to two items at a time, one of them in this thread."""
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(function, items[0])
        second = function(items[1])
        return first.result(), second


def in_halves(function: Callable[[slice], None], count: int, least: int = 2) -> None:
    """Call `function` on the slices of two halves of `count` independent rows; on all at once if fewer than `least`."""
    middle = count // 2
    if count >= least:
        both(function, (slice(0, middle), slice(middle, count)))
    elif count:
        function(slice(0, count))
