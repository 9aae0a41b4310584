"""Eigenvalues and eigenvectors of Laplacians, and the Fourier transform that they define."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import Brief
from ..errors import InputError
from ..types import FloatArray
from .laplacian import checked_matrix, parts_of
from .spectral import LARGEST_DENSE

if TYPE_CHECKING:
    from scipy.sparse import csr_array

LARGEST_VECTORS = 1 << 31
"""Bytes of eigenvectors that are still computed."""


@dataclass(frozen=True, repr=False)
class Spectrum(Brief):
    """Eigenpairs of a symmetric matrix, ``L U = U diag(λ)``.

    Attributes
    ----------
    values : (k,) float64
        Eigenvalues, ascending.
    vectors : (n, k) float64
        Orthonormal eigenvectors as columns, the entry of the largest magnitude positive.
    """

    values: FloatArray
    vectors: FloatArray

    def transform(self, signal: ArrayLike) -> FloatArray:
        """Fourier coefficients ``Uᵀ s`` of a signal.

        Parameters
        ----------
        signal : (n,) or (n, C) float array
            The signal.

        Returns
        -------
        (k,) or (k, C) float64

        Raises
        ------
        InputError
            If the signal does not fit.
        """
        result: FloatArray = self.vectors.T @ _checked(signal, len(self.vectors), "signal")
        return result

    def inverse(self, coefficients: ArrayLike) -> FloatArray:
        """Signal ``U c`` of Fourier coefficients.

        Parameters
        ----------
        coefficients : (k,) or (k, C) float array
            The coefficients.

        Returns
        -------
        (n,) or (n, C) float64

        Raises
        ------
        InputError
            If the coefficients do not fit.
        """
        result: FloatArray = self.vectors @ _checked(coefficients, len(self.values), "coefficients")
        return result


def spectrum(L: Any, k: int | None = None, which: Literal["lowest", "highest"] = "lowest") -> Spectrum:
    """Eigenvalues and eigenvectors: all of them, or the k lowest or highest.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric: ``L0`` for vertices, ``L1`` and ``L2`` for oriented cochains, `unsigned_laplacian` for unsigned
        signals such as textures.
    k : int, optional
        How many, 1 to n. Default: all, for at most 4000 rows.
    which : {"lowest", "highest"}
        Which end of the spectrum.

    Returns
    -------
    Spectrum

    Raises
    ------
    InputError
        If the matrix is not square and symmetric, k is out of range, or the vectors would take over 2 GiB; if the
        iteration does not converge.

    Notes
    -----
    Up to 500 rows, and where k is over a third of them, all are computed and some kept; else ARPACK on
    the inverse of the shifted matrix (which should have no negative eigenvalues); what it finds is taken
    out and looked through again, since one vector of a repeated eigenvalue is easily missed. Where eigenvalues
    coincide, their vectors are one basis of many. Equal to rounding, not in every bit, whatever the number of threads.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> spectrum(build_complex([[0, 1, 2]], 3).L0).values.round(9).tolist()
    [0.0, 3.0, 3.0]
    """
    matrix = checked_matrix(L)
    n = matrix.shape[0]
    count = _checked_count(k, n)
    if which not in ("lowest", "highest"):
        raise InputError(f"which is {which!r}, expected 'lowest' or 'highest'")
    if n <= 500 or (3 * count > n and n <= LARGEST_DENSE):
        values, vectors = np.linalg.eigh(matrix.toarray())
        kept = slice(count) if which == "lowest" else slice(n - count, n)
        values, vectors = values[kept], vectors[:, kept]
    else:
        values, vectors = _by_iteration(matrix, count, which)
    return Spectrum(values, _with_signs(vectors))


def _by_iteration(matrix: csr_array, k: int, which: str) -> tuple[FloatArray, FloatArray]:
    """The wanted eigenpairs are the largest of an operator; one that the iteration missed shows in what is left."""
    from scipy.sparse.linalg import ArpackError

    if not matrix.count_nonzero():
        return np.zeros(k), np.eye(matrix.shape[0], k)
    try:
        operate = _inverse(matrix, which)
        sizes, vectors = _largest(operate, np.zeros((matrix.shape[0], 0)), k)
        while k < matrix.shape[0]:
            size, left = _largest(operate, vectors, 1)
            worst = int(sizes.argmin())
            if size[0] <= sizes[worst] * (1 + 1e-9):
                break
            sizes[worst], vectors[:, worst] = size[0], left[:, 0]
    except (ArpackError, RuntimeError) as error:
        raise InputError(f"eigenvalues do not converge: {error}; expected a smaller k or another matrix") from error
    except MemoryError as error:
        raise InputError(f"a factor of {matrix.shape[0]} rows does not fit into memory, expected fewer") from error
    values = np.einsum("nk,nk->k", vectors, matrix @ vectors)
    order = np.argsort(values, kind="stable")
    return values[order], vectors[:, order]


def _largest(
    operate: Callable[[FloatArray], FloatArray], found: FloatArray, k: int, tolerance: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Largest eigenpairs of a positive operator on what is orthogonal to the vectors already found."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    def rest(x: FloatArray) -> FloatArray:
        return x - found @ (found.T @ x)

    n = len(found)
    operator = LinearOperator((n, n), matvec=lambda x: rest(operate(rest(x.ravel()))), dtype=np.float64)
    start = rest(np.random.default_rng(found.shape[1]).standard_normal(n))
    values, vectors = eigsh(operator, k, which="LA", v0=start, tol=tolerance)
    return values, vectors


def _inverse(matrix: csr_array, which: str) -> Callable[[FloatArray], FloatArray]:
    """Inverse of ``L + shift``, or of ``high - L``, where high is above all eigenvalues: its largest are wanted."""
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import splu

    from . import _spectral

    bound = _spectral.largest_eigenvalue(*parts_of(matrix)) or 1.0
    high = min(bound, 1.01 * _largest(lambda x: matrix @ x, np.zeros((matrix.shape[0], 0)), 1, 1e-3)[0][0])
    shift, sign = (1e-4 * bound, 1) if which == "lowest" else (high + 1e-4 * bound, -1)
    positive = csc_array(sign * matrix + shift * eye_array(matrix.shape[0]))
    options = {"SymmetricMode": True}
    factor = splu(positive, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    solve: Callable[[FloatArray], FloatArray] = factor.solve
    return solve


def _with_signs(vectors: NDArray[np.float64]) -> FloatArray:
    if not vectors.size:
        return vectors
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    return np.ascontiguousarray(vectors * np.where(largest < 0, -1.0, 1.0))


def _checked_count(k: int | None, n: int) -> int:
    if k is None:
        if n > LARGEST_DENSE:
            raise InputError(f"{n} rows are too many for all eigenvectors, expected at most {LARGEST_DENSE}, or k=")
        return n
    if isinstance(k, bool) or not isinstance(k, int | np.integer) or not 1 <= k <= n:
        raise InputError(f"k is {k!r}, expected an integer from 1 to {n}")
    if 3 * k > n > LARGEST_DENSE or 8 * n * k > LARGEST_VECTORS:
        raise InputError(f"{k} vectors of {n} take {8 * n * k / 2**30:.1f} GiB, expected at most 2 and a third of all")
    return int(k)


def _checked(values: ArrayLike, count: int, name: str) -> FloatArray:
    array: NDArray[Any] = np.asarray(values)
    if array.ndim not in (1, 2) or len(array) != count or array.dtype.kind not in "biuf":
        raise InputError(f"{name} is {array.dtype} of shape {array.shape}, expected ({count},) or (.., C)")
    return array.astype(np.float64)
