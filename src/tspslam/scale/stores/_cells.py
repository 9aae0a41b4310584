"""Spatial cells: vertices of an image are cut into a grid of squares in Morton order, a counting sort puts them there.

What is near then stands near in the store, so that a run of rows has a short rim.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ...types import FloatArray

PER_CELL = 64  # vertices of an evenly filled cell: few of a chunk, so that a chunk's rim is short
MOST_CELLS = 1 << 22  # counters, 8 bytes each
Places = NDArray[np.int64]


@dataclass(repr=False)
class Group(Brief):
    """The vertices of one image, or of none: how many there are, and the box that they lie in."""

    count: int = 0
    low: FloatArray = field(default_factory=lambda: np.full(3, np.inf))
    high: FloatArray = field(default_factory=lambda: np.full(3, -np.inf))

    def add(self, xyz: FloatArray) -> None:
        """Count more vertices in."""
        self.count += len(xyz)
        self.low, self.high = np.minimum(self.low, xyz.min(axis=0)), np.maximum(self.high, xyz.max(axis=0))


@dataclass(frozen=True, repr=False)
class Grid(Brief):
    """A square grid over the two widest axes of a group's box, 2^depth cells a side, counted from `first` on."""

    first: int
    depth: int
    axes: tuple[int, int]
    low: FloatArray
    width: float

    def cells(self, xyz: FloatArray) -> Places:
        """Cell of each vertex, in Morton order."""
        side = 1 << self.depth
        at = [np.clip((xyz[:, a] - self.low[a]) / self.width * side, 0, side - 1).astype(np.uint64) for a in self.axes]
        return (self.first + (_spread(at[0]) | _spread(at[1]) << np.uint64(1))).astype(np.int64)


def grids_of(groups: list[Group]) -> list[Grid]:
    """A grid for each group, the cells counted on from one to the next."""
    total, first, grids = sum(group.count for group in groups), 0, []
    for group in groups:
        share = min(group.count / PER_CELL, MOST_CELLS * group.count / max(total, 1))
        depth = max(0, int(np.log2(max(share, 1)) / 2))
        extent = np.where(np.isfinite(group.low), group.high - group.low, 0.0)
        one, other = sorted(np.argsort(-extent, kind="stable")[:2].tolist())
        grids.append(Grid(first, depth, (one, other), group.low, float(extent.max()) or 1.0))
        first += 1 << 2 * depth
    return grids


class RowCounter:
    """Rows of vertices that come in their own order: those of a cell follow each other as they come."""

    def __init__(self, grids: list[Grid]) -> None:
        self._grids = grids
        last = grids[-1]
        self._next: Places = np.zeros(last.first + (1 << 2 * last.depth), np.int64)

    def count(self, group: NDArray[Any], xyz: FloatArray) -> None:
        """First pass: how many there are in each cell."""
        self._next += np.bincount(self._cells(group, xyz), minlength=len(self._next))

    def begin(self) -> None:
        """Between the passes: where each cell begins."""
        self._next = np.cumsum(self._next) - self._next

    def rows(self, group: NDArray[Any], xyz: FloatArray) -> Places:
        """Second pass: the row of each vertex."""
        cells = self._cells(group, xyz)
        order = np.argsort(cells, kind="stable")
        ordered = cells[order]
        is_first = np.ones(len(cells), bool)
        is_first[1:] = ordered[1:] != ordered[:-1]
        begin = np.flatnonzero(is_first)
        counts = np.diff(np.append(begin, len(cells)))
        rows = np.empty(len(cells), np.int64)
        rows[order] = self._next[ordered] + np.arange(len(cells)) - np.repeat(begin, counts)
        self._next[ordered[begin]] += counts
        return rows

    def _cells(self, group: NDArray[Any], xyz: FloatArray) -> Places:
        cells = np.empty(len(xyz), np.int64)
        for k in np.unique(group).tolist():
            mine = group == k
            cells[mine] = self._grids[k].cells(xyz[mine])
        return cells


def _spread(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put a 0 between the bits of numbers below 2^16."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        values = (values | values << np.uint64(shift)) & np.uint64(mask)
    return values
