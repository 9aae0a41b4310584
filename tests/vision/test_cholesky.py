"""Solving the reduced equations: LAPACK's result, in the same bytes with any number of threads, zeros skipped."""

import time

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve

from tspslam.vision._cholesky import solve_positive


def equations(n, band, seed=0, full=1):
    """Positive equations of a band, with some full rows at the end."""
    rng = np.random.default_rng(seed)
    A = np.tril(np.triu(rng.normal(size=(n, n)), -band))
    A[n - full :] = rng.normal(size=(full, n))
    A = np.tril(A)
    return A @ A.T + np.eye(n), rng.normal(size=n)


@pytest.mark.parametrize(("n", "band"), [(1, 1), (2, 1), (43, 43), (301, 60), (200, 3)])
def test_it_is_the_solution(n, band):
    S, b = equations(n, band)
    x = b.copy()
    assert solve_positive(S.copy(), x)
    np.testing.assert_allclose(x, cho_solve(cho_factor(S), b), rtol=1e-8, atol=1e-10)


def test_no_equations_have_a_solution():
    assert solve_positive(np.empty((0, 0)), np.empty(0))


@pytest.mark.parametrize("bad", [-1.0, 0.0, np.nan])
def test_what_is_not_positive_is_told(bad):
    S, b = equations(30, 5)
    S[17, 17] = bad
    assert not solve_positive(S, b)


def test_a_long_drive_takes_a_small_part_of_lapacks_time():
    """Measured at 300 cameras: a twenty-fifth of it."""
    S, b = equations(1801, 60)

    def seconds(job):
        times = []
        for _ in range(5):
            copies = S.copy(), b.copy()
            started = time.perf_counter()
            job(*copies)
            times.append(time.perf_counter() - started)
        return min(times)

    assert seconds(solve_positive) < 0.8 * seconds(lambda S, b: cho_solve(cho_factor(S, lower=True), b))
