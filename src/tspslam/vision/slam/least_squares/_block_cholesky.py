"""Compiled loops of Cholesky's factor of sparse symmetric equations made of 6 x 6 blocks.

The factor is held by columns of blocks: block `p` of column `j`, ``start[j] <= p < start[j + 1]``, is in row `row[p]`;
rows ascend, the diagonal block comes first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel, reassociated_kernel

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@kernel
def factor_pattern(n: int, first: Int64, neighbour: Int64) -> tuple[Int64, Int64]:
    """Columns `start` (n + 1,) and `row` of the factor of equations whose lower half has `neighbour` in its rows.

    Row i of the lower half has the columns ``neighbour[first[i] : first[i + 1]]``, each below i. Two walks up the
    elimination tree (Liu 1990): one counts the blocks of each column, the other fills in their rows.
    """
    parent, mark, counts = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    parent[:], mark[:], counts[:] = -1, -1, 1
    for i in range(n):
        mark[i] = i
        for e in range(first[i], first[i + 1]):
            j = neighbour[e]
            while mark[j] != i:
                mark[j] = i
                counts[j] += 1
                if parent[j] < 0:
                    parent[j] = i
                j = parent[j]
    start, end = np.empty(n + 1, np.int64), np.empty(n, np.int64)
    start[0] = 0
    for i in range(n):
        start[i + 1], end[i] = start[i] + counts[i], start[i]
    row = np.empty(start[n], np.int64)
    mark[:] = -1
    for i in range(n):
        mark[i] = i
        row[end[i]] = i
        end[i] += 1
        for e in range(first[i], first[i + 1]):
            j = neighbour[e]
            while mark[j] != i:
                mark[j] = i
                row[end[j]] = i
                end[j] += 1
                j = parent[j]
    return start, row


@inlined
def _factor_block(A: Float64) -> bool:
    """Cholesky's factor of a (6, 6) block in place, its upper half 0; False if there is none."""
    for i in range(6):
        for j in range(i + 1):
            value = A[i, j]
            for k in range(j):
                value -= A[i, k] * A[j, k]
            if i > j:
                A[i, j] = value / A[j, j]
            elif value > 0:
                A[i, i] = np.sqrt(value)
            else:
                return False
        for j in range(i + 1, 6):
            A[i, j] = 0.0
    return True


@reassociated_kernel
def _subtract_products(L: Float64, first: int, end: int, turned: Float64, place: Int64, row: Int64) -> None:
    """Take ``L[p] @ turned`` from the blocks at `place` of their rows, for ``first <= p < end``."""
    for p in range(first, end):
        A, C = L[p], L[place[row[p]]]
        for i in range(6):
            for j in range(6):
                C[i, j] -= (
                    A[i, 0] * turned[0, j]
                    + A[i, 1] * turned[1, j]
                    + A[i, 2] * turned[2, j]
                    + A[i, 3] * turned[3, j]
                    + A[i, 4] * turned[4, j]
                    + A[i, 5] * turned[5, j]
                )


@kernel
def factor_blocks(start: Int64, row: Int64, L: Float64) -> bool:
    """Turn the lower half of positive equations, laid out as their factor, into the factor, column after column.

    False if they are not positive; `L` then holds nothing of use.
    """
    n = start.shape[0] - 1
    head, after = np.empty(n, np.int64), np.empty(n, np.int64)  # lists of the columns that are next to change a column
    now, place = np.empty(n, np.int64), np.empty(n, np.int64)
    head[:], after[:] = -1, -1
    turned = np.empty((6, 6))
    for j in range(n):
        for p in range(start[j], start[j + 1]):
            place[row[p]] = p
        k = head[j]
        while k >= 0:
            following, p = after[k], now[k]
            for i in range(6):
                for m in range(6):
                    turned[m, i] = L[p, i, m]
            _subtract_products(L, p, start[k + 1], turned, place, row)
            _queue(k, p + 1, start, row, head, after, now)
            k = following
        if not _factor_block(L[start[j]]):
            return False
        D = L[start[j]]
        for p in range(start[j] + 1, start[j + 1]):
            for i in range(6):
                for m in range(6):
                    value = L[p, i, m]
                    for q in range(m):
                        value -= L[p, i, q] * D[m, q]
                    L[p, i, m] = value / D[m, m]
        _queue(j, start[j] + 1, start, row, head, after, now)
    return True


@inlined
def _queue(k: int, p: int, start: Int64, row: Int64, head: Int64, after: Int64, now: Int64) -> None:
    """Note column k with the next column that it changes: the row of its block p, if it has one."""
    if p < start[k + 1]:
        now[k], after[k] = p, head[row[p]]
        head[row[p]] = k


@kernel
def solve_blocks(start: Int64, row: Int64, L: Float64, b: Float64) -> None:
    """Solve the equations of a factor: `b` (n, 6) receives the solution."""
    n = start.shape[0] - 1
    for j in range(n):
        D = L[start[j]]
        for i in range(6):
            for m in range(i):
                b[j, i] -= D[i, m] * b[j, m]
            b[j, i] /= D[i, i]
        for p in range(start[j] + 1, start[j + 1]):
            for i in range(6):
                for m in range(6):
                    b[row[p], i] -= L[p, i, m] * b[j, m]
    for j in range(n - 1, -1, -1):
        for p in range(start[j] + 1, start[j + 1]):
            for i in range(6):
                for m in range(6):
                    b[j, m] -= L[p, i, m] * b[row[p], i]
        D = L[start[j]]
        for i in range(5, -1, -1):
            for m in range(i + 1, 6):
                b[j, i] -= D[m, i] * b[j, m]
            b[j, i] /= D[i, i]
