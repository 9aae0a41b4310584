"""What each thread has asked for last, such as the image of the tiles that it filters."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from threading import Lock, local
from typing import Generic, TypeVar
from weakref import WeakValueDictionary

from ...vision.images import MadeOnce

T = TypeVar("T")


class LastMade(Generic[T]):
    """Keep the last value of each thread: as many as there are threads, and one of those that ask for the same.

    Examples
    --------
    >>> kept = LastMade()
    >>> [kept.get(key, lambda: print("made", key)) for key in "aab"]
    made a
    made b
    [None, None, None]
    """

    def __init__(self) -> None:
        self._lock, self._mine = Lock(), local()
        self._made: WeakValueDictionary[Hashable, MadeOnce[None, T]] = WeakValueDictionary()

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Give what is kept, or make it; what this thread had before goes first, unless another one has it too.

        Parameters
        ----------
        key : hashable
            What the value depends on.
        make : callable
            Called if nobody has it; others who ask for it meanwhile wait. If it raises, the next one calls again.

        Returns
        -------
        T
        """
        with self._lock:
            made = self._made.setdefault(key, MadeOnce())
        self._mine.made = made
        return made.of(None, make)
