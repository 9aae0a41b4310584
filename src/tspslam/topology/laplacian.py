"""Laplacians: what is taken for one, and those of unsigned signals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import require
from ..errors import InputError
from ..types import BoolArray, FloatArray, Signals, real_array
from .complex import Complex, check_product

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Level = Literal["vertex", "edge", "face"]

LARGEST_VALUE = 1e100
"""Larger numbers are refused: sums of their squares would overflow."""


def unsigned_laplacian(complex_: Complex, level: Level, ok: ArrayLike | None = None) -> csr_array:
    """``D - A`` of the elements of one level, for unsigned signals such as textures.

    Vertices are adjacent along an edge, edges when they share a vertex or a face, faces when they share an edge.

    Parameters
    ----------
    complex_ : Complex
        The complex.
    level : {"vertex", "edge", "face"}
        Which elements.
    ok : (n,) bool, optional
        Elements that take part; the others stand alone.

    Returns
    -------
    (n, n) csr_array of float64

    Raises
    ------
    InputError
        If the level is unknown, `ok` does not fit, or so many edges meet in a vertex that it would take over 4 GiB.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> unsigned_laplacian(build_complex([[0, 1, 2], [1, 2, 3]], 4), "face").toarray().tolist()
    [[1.0, -1.0], [-1.0, 1.0]]
    """
    from scipy.sparse import csr_array, diags_array

    require(complex_, Complex, "complex_")
    if level not in ("vertex", "edge", "face"):
        raise InputError(f"level is {level!r}, expected 'vertex', 'edge' or 'face'")
    if level == "edge":
        check_product(complex_.edges, "the unsigned Laplacian of the edges")
    boundary = abs(complex_.B2 if level == "face" else complex_.B1).astype(np.float64)
    shared = (boundary @ boundary.T if level == "vertex" else boundary.T @ boundary).tocoo()
    others = np.flatnonzero((shared.row != shared.col) & (shared.data > 0))  # `setdiag` of SciPy 1.13 is not reliable
    places = shared.row[others], shared.col[others]
    adjacency = csr_array((np.ones(len(others)), places), shape=shared.shape)
    if ok is not None:
        keep = diags_array(checked_mask(ok, adjacency.shape[0]).astype(np.float64))
        adjacency = csr_array(keep @ adjacency @ keep)
    adjacency.eliminate_zeros()
    return csr_array(diags_array(adjacency.sum(axis=1)) - adjacency)


def parts_of(matrix: csr_array) -> tuple[NDArray[np.uint32], NDArray[np.uint32], FloatArray]:
    """CSR arrays for the kernels; unsigned, so that no index is checked for wrap-around.

    Parameters
    ----------
    matrix : (n, m) csr_array
        Sparse, of k stored values.

    Returns
    -------
    indptr, indices : (n + 1,), (k,) uint32
    data : (k,) float64
    """
    indptr, indices = (np.ascontiguousarray(part, np.int32).view(np.uint32) for part in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data


def checked(L: Any, signal: ArrayLike) -> tuple[csr_array, FloatArray]:
    """Return a Laplacian and a signal on its rows, both of float64, or raise `InputError`.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric.
    signal : (n,) or (n, C) float array
        Finite.

    Returns
    -------
    matrix : (n, n) csr_array
    values : (n,) or (n, C) float64
    """
    matrix = checked_matrix(L)
    if isinstance(signal, Signals):
        raise InputError("signal is a Signals, expected an array of one level; for all levels there is smooth_signals")
    values = np.ascontiguousarray(real_array(signal, "signal", f"({matrix.shape[0]},) or (.., C)"))
    if values.ndim not in (1, 2) or len(values) != matrix.shape[0]:
        raise InputError(f"signal is {values.dtype} of shape {values.shape}, expected ({matrix.shape[0]},) or (.., C)")
    values = values.astype(np.float64)
    check_values(values, "signal", "element")
    return matrix, values


def checked_matrix(L: Any) -> csr_array:
    """Return a Laplacian as CSR, or raise `InputError` where it is not square, finite and symmetric.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Of real numbers.

    Returns
    -------
    (n, n) csr_array of float64
    """
    from scipy.sparse import csr_array, issparse

    sparse: Any = L  # what issparse narrows has no shape
    if not issparse(L) or len(sparse.shape) != 2 or sparse.shape[0] != sparse.shape[1]:
        if isinstance(L, Complex):
            raise InputError("L is a complex, expected one of its Laplacians: .L0, .L1 or .L2")
        raise InputError(f"L is {type(sparse).__name__} of shape {np.shape(sparse)}, expected a square sparse matrix")
    if sparse.dtype.kind not in "biuf":
        raise InputError(f"L is {sparse.dtype}, expected real numbers")
    matrix = csr_array(sparse, dtype=np.float64)
    _check_symmetric(matrix)
    return matrix


def check_values(values: FloatArray, what: str, where: str) -> None:
    """Refuse values that are not finite, or so large that their squares are not.

    Parameters
    ----------
    values : (n,) or (n, C) float64
        The values.
    what, where : str
        What to call the values, and what a row is, in the error.
    """
    rows = values.reshape(len(values), -1 if values.size else 0)
    bad = np.flatnonzero(~(np.abs(rows) <= LARGEST_VALUE).all(axis=1))
    if len(bad):
        found = "too large" if np.isfinite(rows[bad[0]]).all() else "not finite"
        raise InputError(f"{what} is {found} at {where} {bad[0]}, expected finite values, at most {LARGEST_VALUE:g}")


def _check_symmetric(matrix: csr_array) -> None:
    """Refuse a matrix for which xᵀ L y is not yᵀ L x, for one pair of vectors, the same each time."""
    from . import _spectral

    largest = float(np.abs(matrix.data).max(initial=0))
    if not largest <= LARGEST_VALUE:
        raise InputError(f"L holds values that are not finite or too large, expected at most {LARGEST_VALUE:g}")
    if _spectral.asymmetry(*parts_of(matrix), largest or 1.0) > 1e-10:
        raise InputError("L is not symmetric, expected L = Lᵀ")


def checked_mask(ok: ArrayLike, n: int) -> BoolArray:
    """Return a mask of n elements, or raise `InputError`.

    Parameters
    ----------
    ok : (n,) bool array
        The mask.
    n : int
        Number of elements.

    Returns
    -------
    (n,) bool
    """
    mask = np.asarray(ok)
    if mask.shape != (n,) or mask.dtype != bool:
        raise InputError(f"ok is {mask.dtype} of shape {mask.shape}, expected ({n},) bool")
    return mask
