"""Which keyframes see each landmark: asked of some landmarks, it costs as many steps as these have been seen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....types import FloatArray
from .columns import Column

Rows = NDArray[np.int64]
_NONE = -1  # no (further) sighting
_ROOM = 8  # sightings of a landmark for which there is room at first: twice as many as in a street


class Sightings:
    """Keyframes by landmarks, as chains in one table: each sighting of a landmark leads to the one before.

    Landmarks go by their rows in the map, keyframes by the numbers of their frames. What is said of a landmark takes
    8 bytes for each keyframe that sees it, and 4 more.

    Examples
    --------
    >>> sightings = Sightings()
    >>> sightings.cover(3)
    >>> sightings.add(np.array([0, 1]), 7)
    >>> sightings.add(np.array([1, 2]), 9)
    >>> at, frames = sightings.of(np.array([1]))
    >>> sorted(frames.tolist())
    [7, 9]
    """

    def __init__(self) -> None:
        self._last = Column(np.empty(0, np.int32))  # of each landmark, its last sighting
        self._before, self._frame = Column(np.empty(0, np.int32)), Column(np.empty(0, np.int32))  # of each sighting
        self._free = Column(np.empty(0, np.int32))  # sightings that are none any more

    def cover(self, count: int) -> None:
        """Make room for landmarks that nobody sees yet.

        Parameters
        ----------
        count : int
            How many landmarks there are.
        """
        self._last.extend(np.full(max(0, count - len(self._last)), _NONE, np.int32))

    def add(self, rows: Rows, frame: int) -> None:
        """Note that a keyframe sees landmarks.

        Parameters
        ----------
        rows : (K,) int64
            Landmarks that it was not noted to see, each once.
        frame : int
            Number of the frame.
        """
        entries = self._take(len(rows))
        self._before.rows[entries], self._frame.rows[entries] = self._last.rows[rows], frame
        self._last.rows[rows] = entries

    def of(self, rows: Rows) -> tuple[Rows, Rows]:
        """Find which keyframes see landmarks.

        Parameters
        ----------
        rows : (K,) int64
            Landmarks.

        Returns
        -------
        at : (S,) int64
            For each sighting, which of `rows` is seen.
        frame : (S,) int64
            Number of the frame that sees it.
        """
        at, entry = self._walk(rows)
        return at, self._frame.rows[entry].astype(np.int64)

    def count(self, rows: Rows) -> Rows:
        """Count the keyframes that see landmarks.

        Parameters
        ----------
        rows : (K,) int64
            Landmarks.

        Returns
        -------
        (K,) int64
        """
        return np.bincount(self._walk(rows)[0], minlength=len(rows))

    def drop(self, rows: Rows, frames: Rows | int) -> None:
        """Note that keyframes see landmarks no more.

        Parameters
        ----------
        rows : (K,) int64
            Landmarks.
        frames : (K,) int64 or int
            Numbers of the frames.
        """
        landmark, which = np.unique(rows, return_inverse=True)
        at, frame = self.of(landmark)
        gone = np.isin(_pairs(at, frame), _pairs(which, np.broadcast_to(frames, len(rows))))
        self.replace(landmark, at[~gone], frame[~gone])

    def replace(self, rows: Rows, at: Rows, frames: Rows) -> None:
        """Say anew who sees landmarks.

        Parameters
        ----------
        rows : (K,) int64
            Landmarks, each once.
        at : (S,) int64
            For each sighting, which of `rows` is seen.
        frames : (S,) int64
            Number of the frame that sees it.
        """
        self._free.extend(self._walk(rows)[1])
        self._last.rows[rows] = _NONE
        order = np.argsort(at, kind="stable")
        at, entries = at[order], self._take(len(at))
        is_first, is_last = np.diff(at, prepend=_NONE) != 0, np.diff(at, append=_NONE) != 0
        self._frame.rows[entries] = frames[order]
        self._before.rows[entries] = np.where(is_first, _NONE, np.roll(entries, 1))
        self._last.rows[rows[at[is_last]]] = entries[is_last]

    def merge(self, rows: Rows, others: Rows) -> None:
        """Note that who sees the second of a pair of landmarks sees the first instead.

        Parameters
        ----------
        rows, others : (K,) int64
            Landmarks; none is in both.
        """
        landmark, which = np.unique(np.concatenate([rows, others]), return_inverse=True)
        of = np.arange(len(landmark))
        of[which[len(rows) :]] = which[: len(rows)]
        at, frame = self.of(landmark)
        pairs = np.unique(np.column_stack([of[at], frame]), axis=0)
        self.replace(landmark, pairs[:, 0], pairs[:, 1])

    def keep(self, first: int, kept: NDArray[np.bool_]) -> None:
        """Keep some landmarks from a row on, of which those that go are seen by nobody; the others move up.

        Parameters
        ----------
        first : int
            The row.
        kept : (K,) bool
            Which of the K from there on stay.
        """
        self._last.keep(first, kept)

    def _walk(self, rows: Rows) -> tuple[Rows, NDArray[np.int32]]:
        """All sightings of landmarks, one landmark after the other, the last sighting first."""
        from ._kernels import walk_chains

        rows, room = np.ascontiguousarray(rows, np.int64), _ROOM * len(rows)
        while True:
            at, entry = np.empty(room, np.int64), np.empty(room, np.int32)
            count = walk_chains(rows, self._last.rows, self._before.rows, at, entry)
            if count <= room:
                return at[:count], entry[:count]
            room = count

    def _take(self, count: int) -> NDArray[np.int32]:
        """Places in the table for new sightings."""
        free: NDArray[np.int32] = self._free.pop(count)
        start, more = len(self._frame), count - len(free)
        for column in (self._before, self._frame):
            column.extend(np.empty(more, np.int32))
        return np.concatenate([free, np.arange(start, start + more, dtype=np.int32)])


def _pairs(at: Rows, frame: Rows) -> Rows:
    """One number for each pair."""
    return at << 32 | frame


def match_sights(first: FloatArray, second: FloatArray, within: float) -> tuple[Rows, Rows]:
    """Find sights in the same place: for each of the second, the nearest of the first.

    Parameters
    ----------
    first, second : (N, 3) float64, (M, 3) float64
        (u, v, disparity), px; those whose disparity is NaN match none.
    within : float
        Largest distance, px.

    Returns
    -------
    (K,) int64, (K,) int64
        Rows of the first, where several of the second may match one; rows of the second, ascending.
    """
    from scipy.spatial import cKDTree

    known = [np.flatnonzero(np.isfinite(sights).all(axis=1)) for sights in (first, second)]
    away, nearest = map(np.asarray, cKDTree(first[known[0]]).query(second[known[1]], distance_upper_bound=within))
    is_same = np.isfinite(away)
    return known[0][nearest[is_same]], known[1][is_same]
