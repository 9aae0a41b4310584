"""Compiled linear algebra whose sums run in one order, whatever the number of threads."""

from __future__ import annotations

import numpy as np

from .._jit import kernel, reassociated_kernel


@kernel
def conjugate_gradient(indptr, indices, data, b, tolerance, x):  # type: ignore[no-untyped-def]
    """Solve L x = b from the x that is given, with the diagonal as preconditioner; return the relative residual.

    For a positive semidefinite L and b in its range; sums run in one order, whatever the number of threads.
    """
    n = b.shape[0]
    inverse, product = np.ones(n), np.zeros(n)
    for i in range(n):
        for p in range(indptr[i], indptr[i + 1]):
            if indices[p] == i and data[p] > 0:
                inverse[i] = 1 / data[p]
            product[i] += data[p] * x[indices[p]]
    left = b - product
    direction = inverse * left
    norm, energy = (b * b).sum(), (left * direction).sum()
    for _ in range(20 * int(np.sqrt(n)) + 1000):
        if (left * left).sum() <= tolerance * tolerance * norm:
            break
        curvature = 0.0
        for i in range(n):
            total = 0.0
            for p in range(indptr[i], indptr[i + 1]):
                total += data[p] * direction[indices[p]]
            product[i] = total
            curvature += total * direction[i]
        step = energy / curvature
        before, energy = energy, 0.0
        for i in range(n):
            x[i] += step * direction[i]
            left[i] -= step * product[i]
            energy += left[i] * left[i] * inverse[i]
        for i in range(n):
            direction[i] = inverse[i] * left[i] + energy / before * direction[i]
    return np.sqrt((left * left).sum() / norm) if norm > 0 else 0.0


@reassociated_kernel
def orthonormalise(rows):  # type: ignore[no-untyped-def]
    """Orthonormalise independent rows in place: Gram-Schmidt, each row twice."""
    for i in range(rows.shape[0]):
        for _ in range(2):
            for j in range(i):
                shadow = 0.0
                for k in range(rows.shape[1]):
                    shadow += rows[j, k] * rows[i, k]
                for k in range(rows.shape[1]):
                    rows[i, k] -= shadow * rows[j, k]
        norm = np.sqrt((rows[i] * rows[i]).sum())
        for k in range(rows.shape[1]):
            rows[i, k] /= norm
