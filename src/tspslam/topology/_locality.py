"""Compiled kernels that visit a large complex place by place, so that what is near in the image is near in the cache.

Results do not depend on the order of the visit; only the time does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, kernel
from .._threads import both, in_halves
from ..types import FloatArray
from ._memory import empty

PER_CELL = 16  # vertices in a cell of the grid, about
FEW = 1 << 15  # up to so many vertices everything is near
_KEPT = "_visit"  # among what a complex keeps


@inlined
def _interleave(a, b):  # type: ignore[no-untyped-def]
    """Morton code: the bits of a and b in turn, so that near cells have near codes in both directions."""
    code, bit = 0, 0
    while a or b:
        code |= (a & 1) << bit | (b & 1) << (bit + 1)
        a, b, bit = a >> 1, b >> 1, bit + 2
    return code


@kernel
def find_cells(uv, cells):  # type: ignore[no-untyped-def]
    """Write the cell of each point in a grid in Morton order; return how many there are; no place: the last one."""
    n = uv.shape[0]
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(n):
        for axis in range(2):
            if np.isfinite(uv[i, axis]):
                low[axis], high[axis] = min(low[axis], uv[i, axis]), max(high[axis], uv[i, axis])
    side = 1
    while side * side * PER_CELL < n:
        side *= 2
    scale = np.zeros(2)
    for axis in range(2):
        if high[axis] > low[axis]:
            scale[axis] = side / (high[axis] - low[axis])
    for i in range(n):
        u, v = (uv[i, 0] - low[0]) * scale[0], (uv[i, 1] - low[1]) * scale[1]
        if 0.0 <= u <= side and 0.0 <= v <= side:
            cells[i] = _interleave(min(int(u), side - 1), min(int(v), side - 1))
        else:
            cells[i] = side * side
    return side * side + 1


@kernel
def sort_by_cell(cells, count, first, order):  # type: ignore[no-untyped-def]
    """Write elements by the cell of their first vertex (a counting sort: stable, linear) to `order`."""
    start = np.zeros(count + 1, np.int32)
    for e in range(first.shape[0]):
        start[cells[first[e]] + 1] += 1
    for c in range(count):
        start[c + 1] += start[c]
    for e in range(first.shape[0]):
        c = cells[first[e]]
        order[start[c]] = e
        start[c] += 1


def order_by_cell(cells: NDArray[Any], count: int, first: NDArray[Any]) -> NDArray[np.uint32]:
    """Elements by the cell of their first vertex, of `count` cells."""
    order = empty(len(first), np.uint32)
    sort_by_cell(cells, count, first, order)
    return order


def visits(uv: FloatArray, *firsts: NDArray[np.uint32]) -> tuple[Any, ...]:
    """Whether much is far from the cache, then the order of visit of the vertices and of elements.

    Elements are given by their first vertices.
    """
    n = uv.shape[0]
    if n <= FEW:
        return False, *(np.arange(length, dtype=np.uint32) for length in (n, *map(len, firsts)))
    cells = empty(n, np.int32)
    count = find_cells(uv, cells)
    every = (np.arange(n, dtype=np.uint32), *firsts)
    some, others = both(lambda each: [order_by_cell(cells, count, first) for first in each], (every[:2], every[2:]))
    return True, *some, *others


def visit_vertices(kept: dict[str, Any], uv: FloatArray) -> tuple[bool, NDArray[np.uint32]]:
    """As `visits` of the vertices alone; where an order was kept with the complex, that one."""
    if len(uv) > FEW and _KEPT in kept:
        return True, kept[_KEPT]
    is_far, visit = visits(uv)
    return is_far, visit


def keep_visit(kept: dict[str, Any], is_far: bool, visit: NDArray[np.uint32]) -> None:
    """Keep an order of visit of the vertices with their complex, whose `vars` are given: 4 bytes a vertex."""
    if is_far:
        kept[_KEPT] = visit


def in_parts(function: Callable[[slice], None], count: int) -> None:
    """Call `function` on all that is to be visited, or if that is much on both halves, at a time."""
    in_halves(function, count, FEW + 1)
