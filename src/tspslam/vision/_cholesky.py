"""Cholesky's factors of a symmetric matrix whose rows begin with zeros: those are skipped, and stay.

A camera shares points with few others, so most of the reduced equations are zeros. One thread, one order of sums: the
result has the same bytes however many threads the machine has, which those of a threaded LAPACK do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import kernel, reassociated_kernel

Float64 = NDArray[np.float64]


@reassociated_kernel
def _dot(a: Float64, b: Float64) -> float:
    total = 0.0
    for k in range(a.shape[0]):
        total += a[k] * b[k]
    return total


@kernel
def solve_positive(S: Float64, b: Float64) -> bool:
    """Solve ``S x = b`` for a symmetric positive S, of which the lower half is read and overwritten by its factor.

    `b` (n,) receives x. False if S is not positive; both then hold nothing of use.
    """
    n = S.shape[0]
    begin = np.empty(n, np.int64)
    for i in range(n):
        begin[i] = i
        for j in range(i):
            if S[i, j] != 0:
                begin[i] = j
                break
        for j in range(begin[i], i + 1):
            first = max(begin[i], begin[j])
            value = S[i, j] - _dot(S[i, first:j], S[j, first:j])
            if j < i:
                S[i, j] = value / S[j, j]
            elif value > 0:
                S[i, i] = np.sqrt(value)
            else:
                return False
        b[i] = (b[i] - _dot(S[i, begin[i] : i], b[begin[i] : i])) / S[i, i]
    for i in range(n - 1, -1, -1):
        b[i] /= S[i, i]
        for j in range(begin[i], i):
            b[j] -= S[i, j] * b[i]
    return True
