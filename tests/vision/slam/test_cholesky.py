"""Solving the reduced equations: LAPACK's result, in the same bytes with any number of threads, zeros skipped."""

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve

from tspslam.vision.slam.least_squares._kernels import solve_positive


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


class Counted:
    """A matrix that counts the numbers that are asked for."""

    def __init__(self, values):
        self.values, self.shape, self.asked = values, values.shape, 0

    def __getitem__(self, at):
        found = self.values[at]
        self.asked += np.size(found)
        return found

    def __setitem__(self, at, value):
        self.values[at] = value


def test_the_zeros_of_a_long_drive_are_skipped():
    """Its work grows with its length; of full equations with the third power."""

    def asked(n, band):
        S, b = equations(n, band)
        counted = Counted(np.where(np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= band, S, 0) + n * np.eye(n))
        assert solve_positive.py_func(counted, b)
        return counted.asked

    assert asked(160, 6) < 2.5 * asked(80, 6) + 160**2 / 2  # the zeros before a row are looked at once
    assert asked(80, 80) > 5 * asked(40, 40)
    assert asked(160, 6) < asked(160, 160) / 10
