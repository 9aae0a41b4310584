"""Arrays that become longer: room is made by half at a time, so that a row costs the same however many there are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_LEAST, _MORE = 64, 0.5  # rows of room at least, and more room than is needed, when it is made


class Column:
    """Rows of one kind, at the end of which others are put.

    Parameters
    ----------
    values : (N,) or (N, D) numbers
        The first rows; copied.

    Examples
    --------
    >>> column = Column(np.zeros((0, 3)))
    >>> column.extend(np.ones((2, 3)))
    >>> column.rows.shape
    (2, 3)
    """

    def __init__(self, values: NDArray[Any]) -> None:
        self._held, self._count = np.array(values), len(values)

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[Any]:
        """All rows: no copy, and good until the next change of their number."""
        return self._held[: self._count]

    def extend(self, values: ArrayLike) -> None:
        """Put rows at the end.

        Parameters
        ----------
        values : (K,) or (K, D) numbers
            The rows.
        """
        values = np.asarray(values)
        end = self._count + len(values)
        if end > len(self._held):
            room = np.empty((max(_LEAST, int((1 + _MORE) * end)), *self._held.shape[1:]), self._held.dtype)
            room[: self._count] = self.rows
            self._held = room
        self._held[self._count : end] = values
        self._count = end

    def keep(self, first: int, kept: NDArray[np.bool_]) -> None:
        """Keep some of the rows from one on; what follows moves up.

        Parameters
        ----------
        first : int
            Row before which none is touched.
        kept : (K,) bool
            Which of the K from there on stay.
        """
        left = self.rows[first:][kept]
        self._count = first + len(left)
        self._held[first : self._count] = left

    def pop(self, count: int) -> NDArray[Any]:
        """Take rows from the end.

        Parameters
        ----------
        count : int
            How many at most.

        Returns
        -------
        (K,) or (K, D) numbers
            A copy.
        """
        end = self._count
        self._count = max(0, end - count)
        return self._held[self._count : end].copy()
