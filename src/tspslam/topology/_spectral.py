"""Compiled kernels of the spectral tools: bounds of a spectrum, Chebyshev filters."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel, reassociated_kernel


@inlined
def _scattered(i, seed):  # type: ignore[no-untyped-def]
    """A number in [-1, 1) from an index: shifts and products stir its bits."""
    bits = np.int64(i) + seed
    for _ in range(2):
        bits = (bits ^ (bits >> 16)) * 73244475 % 4294967296
    return (bits ^ (bits >> 16)) / 2147483648.0 - 1.0


@kernel
def asymmetry(indptr, indices, data, scale):  # type: ignore[no-untyped-def]
    """``xᵀ L y - yᵀ L x`` for two vectors of scattered numbers, as a share of the sum of its terms' magnitudes."""
    difference, total = 0.0, 0.0
    for i in range(indptr.shape[0] - 1):
        x, y = _scattered(i, 1), _scattered(i, 1000000007)
        for p in range(indptr[i], indptr[i + 1]):
            j, value = indices[p], data[p] / scale
            one, other = value * x * _scattered(j, 1000000007), value * y * _scattered(j, 1)
            difference += one - other
            total += abs(one) + abs(other)
    return abs(difference) / total if total > 0 else 0.0


@kernel
def largest_eigenvalue(indptr, indices, data):  # type: ignore[no-untyped-def]
    """Guaranteed bound of the eigenvalues of a symmetric CSR matrix: Gershgorin's discs, plain and scaled.

    The largest absolute row sum of S⁻¹ L S bounds the spectrum for any positive diagonal S: taken are 1 and the
    diagonal, for which a graph Laplacian's bound is the largest degree plus mean degree of the neighbours.
    """
    n = indptr.shape[0] - 1
    scale = np.zeros(n)
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] == i:
                scale[i] = max(scale[i], data[p])
    largest = scale.max() if n else 0.0
    for i in range(n):
        scale[i] = max(scale[i] / largest, 1e-3) if largest > 0 else 1.0
    plain, scaled = 0.0, 0.0
    for i in range(n):
        diagonal, around, weighted = 0.0, 0.0, 0.0
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] == i:
                diagonal += data[p]
            else:
                around += abs(data[p])
                weighted += abs(data[p]) * scale[indices[p]]
        plain = max(plain, diagonal + around)
        scaled = max(scaled, diagonal + weighted / scale[i])
    return min(plain, scaled)


@reassociated_kernel
def step(indptr, indices, data, centre, factor, now, before, coefficient, out):  # type: ignore[no-untyped-def]
    """One term of the three-term recurrence, in the place of `before`: factor (L - centre) now - before.

    Adds `coefficient` times it to `out`; all (N,).
    """
    for i in range(now.shape[0]):
        total = -centre * now[i]
        for p in range(indptr[i], indptr[i + 1]):
            total += data[p] * now[indices[p]]
        value = factor * total - before[i]
        before[i] = value
        out[i] += coefficient * value


@reassociated_kernel
def step_channels(indptr, indices, data, centre, factor, now, before, coefficient, out):  # type: ignore[no-untyped-def]
    """As `step` for C channels at once, (N, C)."""
    channels = now.shape[1]
    row = np.empty(channels)
    for i in range(now.shape[0]):
        for c in range(channels):
            row[c] = -centre * now[i, c]
        for p in range(indptr[i], indptr[i + 1]):
            weight, j = data[p], indices[p]
            for c in range(channels):
                row[c] += weight * now[j, c]
        for c in range(channels):
            value = factor * row[c] - before[i, c]
            before[i, c] = value
            out[i, c] += coefficient * value
