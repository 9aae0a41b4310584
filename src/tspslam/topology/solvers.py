"""Linear systems of singular Laplacians: a kept factorisation, conjugate gradients, algebraic multigrid."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..types import FloatArray
from .laplacian import parts_of

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Method = Literal["auto", "factor", "cg", "amg"]

LARGEST_FACTOR = 400_000
"""Rows up to which a factor pays: beyond, it takes over a gigabyte and longer than a multigrid solution."""

TOLERANCE = 1e-12
"""Relative residual of iterative solutions."""


_MAX_CYCLES = 100

Solve = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Solver:
    """``x = L⁺ b`` up to the null space of L, for b in the range of L.

    Attributes
    ----------
    solve_one : callable
        (n,) -> (n,) or, for a factor, also (n, C) -> (n, C).
    by_column : bool
        Whether channels are solved one by one.
    """

    solve_one: Solve
    by_column: bool

    @staticmethod
    def prepare(L: csr_array, held: NDArray[np.int64], method: Method) -> Solver:
        """Prepare the inverse of a symmetric positive semidefinite matrix.

        Parameters
        ----------
        L : (n, n) csr_array
            The matrix.
        held : (k,) int64
            Rows at which the vectors of its null space, restricted to them, are independent and complete.
        method : {"auto", "factor", "cg", "amg"}
            See `tspslam.hodge_decompose`.

        Returns
        -------
        Solver

        Raises
        ------
        InputError
            If the method is not known or not installed.
        """
        chosen = _chosen(method, L.shape[0])
        if chosen == "factor":
            return Solver(_factor(L, held), by_column=False)
        guess = _multigrid(_grounded(L, held)) if chosen == "amg" else np.zeros_like
        return Solver(_conjugate_gradient(L, guess), by_column=True)

    def solve(self, b: FloatArray) -> FloatArray:
        """Solve for one right side or several.

        Parameters
        ----------
        b : (n,) or (n, C) float64
            Right sides, in the range of L.

        Returns
        -------
        (n,) or (n, C) float64
        """
        if not b.size:
            return np.zeros_like(b)
        if b.ndim == 1 or not self.by_column:
            return self.solve_one(b)
        return np.stack([self.solve_one(np.ascontiguousarray(b[:, c])) for c in range(b.shape[1])], axis=1)


def _chosen(method: Method, rows: int) -> str:
    if method not in ("auto", "factor", "cg", "amg"):
        raise InputError(f"method is {method!r}, expected 'auto', 'factor', 'cg' or 'amg'")
    has_multigrid = importlib.util.find_spec("pyamg") is not None
    if method == "amg" and not has_multigrid:
        raise InputError("method 'amg' needs pyamg, expected an installation with it: pip install 'tspslam[mesh]'")
    if method != "auto":
        return method
    if rows <= LARGEST_FACTOR:
        return "factor"
    return "amg" if has_multigrid else "cg"


def _factor(L: csr_array, held: NDArray[np.int64]) -> Solve:
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    if not L.shape[0]:
        return np.zeros_like
    matrix = csc_array(_grounded(L, held))
    options = {"SymmetricMode": True}
    try:
        solve: Solve = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve
    except MemoryError as error:
        raise InputError(f"a factor of {L.shape[0]} rows does not fit into memory, expected method='cg'") from error
    return solve


def _grounded(L: csr_array, held: NDArray[np.int64]) -> csr_array:
    """``L + Σ e eᵀ`` over the held rows: regular, and its solution, which is 0 there, is one of L."""
    from scipy.sparse import coo_array, csr_array

    return csr_array(L + coo_array((np.ones(len(held)), (held, held)), shape=L.shape))


def _multigrid(matrix: csr_array) -> Solve:
    """A guess good to about 1e-10: conjugate gradients with a V-cycle as preconditioner, sums in one order."""
    import pyamg

    matrix.indices, matrix.indptr = (index.astype(np.int32) for index in (matrix.indices, matrix.indptr))  # as it wants
    cycle = pyamg.ruge_stuben_solver(matrix).aspreconditioner(cycle="V")

    def solve(b: FloatArray) -> FloatArray:
        x, left, direction, energy = np.zeros(len(b)), b.copy(), np.zeros(len(b)), 1.0
        goal = 1e-20 * (b * b).sum()
        for _ in range(_MAX_CYCLES):
            if (left * left).sum() <= goal:
                break
            smoothed = cycle @ left
            before, energy = energy, (left * smoothed).sum()
            direction = smoothed + energy / before * direction
            product = matrix @ direction
            step = energy / (direction * product).sum()
            x += step * direction
            left -= step * product
        return x

    return solve


def _conjugate_gradient(L: csr_array, guess: Solve) -> Solve:
    from . import _linear

    parts = parts_of(L)

    def solve(b: FloatArray) -> FloatArray:
        x = guess(b)
        if _linear.conjugate_gradient(*parts, b, TOLERANCE, x) > 100 * TOLERANCE:
            raise InputError("conjugate gradients do not converge, expected a smaller or better meshed complex")
        return x

    return solve
