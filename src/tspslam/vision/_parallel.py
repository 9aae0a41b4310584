"""Two threads for work that releases the GIL; the result does not depend on how many there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

A = TypeVar("A")
B = TypeVar("B")


def both(function: Callable[[A], B], items: Iterable[A]) -> list[B]:
    """Apply `function` to each item, two at a time, results in order."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(function, items))


def in_halves(function: Callable[[slice], None], count: int) -> None:
    """Call `function` on the slices of two halves of `count` independent rows."""
    middle = count // 2
    both(function, [part for part in (slice(0, middle), slice(middle, count)) if part.start < part.stop])
