"""Heat and other functions of a Laplacian: on vertices, on oriented cochains, on unsigned signals of every level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..types import BoolArray, FloatArray, Signals

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from .complex import Complex

Level = Literal["vertex", "edge", "face"]

LARGEST_DENSE = 4000
"""Rows of a matrix whose eigenvectors are still computed."""

LARGEST_DEGREE = 100_000
"""Terms of a polynomial that are still summed."""

LARGEST_ROWS = 1 << 31
"""Bytes of a block of kernel rows that are still given out."""


def heat_filter(
    L: Any, signal: ArrayLike, t: float, *, method: Literal["chebyshev", "exact"] = "chebyshev", error: float = 1e-10
) -> FloatArray:
    """Let a signal diffuse: ``exp(-t L) s``.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric, positive semidefinite: ``L0`` for vertices, ``L1`` and ``L2`` for oriented cochains (which flip with
        their element), `unsigned_laplacian` for unsigned edge and face signals, such as textures.
    signal : (n,) or (n, C) array
        Finite values.
    t : float
        Time, >= 0.
    method : {"chebyshev", "exact"}
        A polynomial in L, its coefficients modified Bessel functions, on a guaranteed bound of the spectrum; or the
        eigenvectors, for at most 4000 rows.
    error : float
        Largest norm of the error, as a share of the signal's, for the polynomial.

    Returns
    -------
    (n,) or (n, C) float64

    Raises
    ------
    InputError
        If the matrix is not square and symmetric, or has negative eigenvalues that make the signal grow; if a value is
        not finite, a size does not fit, t is negative, or the work would be too large (over 100 000 terms, or 4000
        rows for "exact").

    Examples
    --------
    >>> from tspslam import build_complex
    >>> L0 = build_complex([[0, 1, 2]], 3).L0
    >>> heat_filter(L0, [3.0, 0, 0], t=1e3).round(9).tolist()
    [1.0, 1.0, 1.0]
    """
    time = _checked_time(t)
    if method == "exact":
        return spectral_filter(L, signal, lambda values: np.exp(-time * values))
    if method != "chebyshev":
        raise InputError(f"method is {method!r}, expected 'chebyshev' or 'exact'")
    matrix, values = _checked(L, signal)
    filtered = _polynomial(matrix, values, *_heat_series(matrix, time, error))
    if np.linalg.norm(filtered) > (1 + 1e-6) * np.linalg.norm(values):
        raise InputError("L has negative eigenvalues: the signal grows; expected a positive semidefinite L")
    return filtered


def spectral_filter(L: Any, signal: ArrayLike, response: Callable[[FloatArray], ArrayLike]) -> FloatArray:
    """Apply any function of the eigenvalues, ``U h(λ) Uᵀ s``, by the eigenvectors of a matrix of at most 4000 rows.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric.
    signal : (n,) or (n, C) array
        Finite values.
    response : callable
        h: eigenvalues (n,), ascending -> (n,) finite values.

    Returns
    -------
    (n,) or (n, C) float64

    Raises
    ------
    InputError
        As `heat_filter`; also if h gives something else.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> L0 = build_complex([[0, 1, 2]], 3).L0
    >>> spectral_filter(L0, [3.0, 0, 0], lambda values: values < 1).round(9).tolist()
    [1.0, 1.0, 1.0]
    """
    matrix, values = _checked(L, signal)
    if matrix.shape[0] > LARGEST_DENSE:
        raise InputError(f"{matrix.shape[0]} rows are too many for eigenvectors, expected at most {LARGEST_DENSE}")
    eigenvalues, vectors = np.linalg.eigh(matrix.toarray())
    gain = np.asarray(response(eigenvalues), np.float64)
    if gain.shape != eigenvalues.shape or not np.isfinite(gain).all():
        raise InputError(f"response gives shape {gain.shape}, expected {eigenvalues.shape} finite values")
    filtered: FloatArray = vectors @ (gain.reshape(-1, *[1] * (values.ndim - 1)) * (vectors.T @ values))
    return filtered


@dataclass(frozen=True)
class HeatKernel:
    """The heat kernel ``K = exp(-t L)`` of a matrix, row by row: N × N numbers are never stored.

    Attributes
    ----------
    L : (n, n) csr_array
        The Laplacian.
    t : float
        Time.
    """

    L: csr_array
    t: float

    def rows(self, index: ArrayLike) -> FloatArray:
        """Rows of the kernel, (k, n) float64; by symmetry also its columns.

        Raises
        ------
        InputError
            If an index is out of range, or the rows would take over 2 GiB.
        """
        chosen = np.atleast_1d(np.asarray(index))
        n = self.L.shape[0]
        if chosen.ndim != 1 or chosen.dtype.kind not in "iu" or not ((chosen >= 0) & (chosen < n)).all():
            raise InputError(f"rows of a kernel are {chosen.dtype} of shape {chosen.shape}, expected 0 to {n - 1}")
        if 8 * n * len(chosen) > LARGEST_ROWS:
            size = 8 * n * len(chosen) / 2**30
            raise InputError(f"{len(chosen)} rows of {n} take {size:.1f} GiB, expected at most 2: ask for fewer")
        impulses = np.zeros((n, len(chosen)))
        impulses[chosen, np.arange(len(chosen))] = 1
        return np.ascontiguousarray(heat_filter(self.L, impulses, self.t).T)


def heat_kernel(L: Any, t: float) -> HeatKernel:
    """Heat kernel of a symmetric matrix, eq. (10), whose rows are computed on demand.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric.
    t : float
        Time, >= 0.

    Returns
    -------
    HeatKernel

    Raises
    ------
    InputError
        As `heat_filter`.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> kernel = heat_kernel(build_complex([[0, 1, 2]], 3).L0, 0.5)
    >>> kernel.rows([0]).sum().round(9)
    np.float64(1.0)
    """
    return HeatKernel(_checked_matrix(L), _checked_time(t))


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
        If the level is unknown or `ok` does not fit.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> unsigned_laplacian(build_complex([[0, 1, 2], [1, 2, 3]], 4), "face").toarray().tolist()
    [[1.0, -1.0], [-1.0, 1.0]]
    """
    from scipy.sparse import csr_array, diags_array

    if level not in ("vertex", "edge", "face"):
        raise InputError(f"level is {level!r}, expected 'vertex', 'edge' or 'face'")
    boundary = abs(complex_.B2 if level == "face" else complex_.B1).astype(np.float64)
    shared = boundary @ boundary.T if level == "vertex" else boundary.T @ boundary
    adjacency = csr_array(shared > 0, dtype=np.float64)
    if ok is not None:
        keep = diags_array(_checked_mask(ok, adjacency.shape[0]).astype(np.float64))
        adjacency = csr_array(keep @ adjacency @ keep)
    adjacency.setdiag(0)
    adjacency.eliminate_zeros()
    return csr_array(diags_array(adjacency.sum(axis=1)) - adjacency)


def smooth_signals(complex_: Complex, signals: Signals, t: float) -> Signals:
    """Smooth the unsigned signals of every level, each by its own ``exp(-t (D - A))``.

    Parameters
    ----------
    complex_ : Complex
        The complex of the signals.
    signals : Signals
        Marked elements take no part.
    t : float
        Time, >= 0.

    Returns
    -------
    Signals
        The same but for the values; constants stay.

    Raises
    ------
    InputError
        As `heat_filter`, or if the signals are of another complex.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> square, uv = build_complex([[0, 1, 2], [0, 2, 3]], 4), [[0, 0], [9, 0], [9, 9], [0, 9]]
    >>> image = np.random.default_rng(0).random((10, 10))
    >>> smooth = smooth_signals(square, sample_signals(image, uv, square), t=50.0)
    >>> bool(np.ptp(smooth.vertex) < 1e-6)
    True
    """
    from dataclasses import replace

    smoothed: dict[str, Any] = {}
    levels: tuple[Level, ...] = ("vertex", "edge", "face")
    for level in levels:
        ok: BoolArray = getattr(signals, f"{level}_ok")
        L = unsigned_laplacian(complex_, level, ok)
        smoothed[level] = heat_filter(L, getattr(signals, level), t)
    return replace(signals, **smoothed)


def _heat_series(matrix: csr_array, t: float, error: float) -> tuple[float, FloatArray]:
    """Half of the spectrum's bound, and the Chebyshev coefficients of exp(-tλ) from 0 to that bound."""
    from scipy.special import ive

    from . import _spectral

    if not 1e-15 <= error < 1:
        raise InputError(f"error is {error}, expected 1e-15 to 1")
    half = max(_spectral.largest_eigenvalue(*_parts(matrix)) / 2, 1e-300)
    terms = 2 * np.sqrt(t * half * (1 - np.log(error))) - 2 * np.log(error) + 10  # more than are needed
    if terms > LARGEST_DEGREE:
        wanted = f"a smaller t: over {LARGEST_DEGREE} terms"
        raise InputError(f"t is {t:g} on a spectrum up to {2 * half:.4g}, expected {wanted}")
    k = np.arange(int(terms))
    series = 2 * (-1.0) ** k * ive(k, t * half)
    series[0] /= 2
    tail = np.cumsum(np.abs(series[::-1]))[::-1]
    return half, series[: max(2, int(np.argmax(tail < error)))]


def _polynomial(matrix: csr_array, signal: FloatArray, half: float, series: FloatArray) -> FloatArray:
    """``Σ c_k T_k(L / half - 1) s``."""
    from . import _spectral

    step = _spectral.step if signal.ndim == 1 else _spectral.step_channels
    parts = _parts(matrix)
    out, now, before = series[0] * signal, signal.copy(), np.zeros_like(signal)
    for k in range(1, len(series)):
        step(*parts, half, (1 if k == 1 else 2) / half, now, before, series[k], out)
        now, before = before, now
    return out


def _parts(matrix: csr_array) -> tuple[NDArray[np.uint32], NDArray[np.uint32], FloatArray]:
    """CSR arrays for the kernels; unsigned, so that no index is checked for wrap-around."""
    indptr, indices = (np.ascontiguousarray(part, np.int32).view(np.uint32) for part in (matrix.indptr, matrix.indices))
    return indptr, indices, matrix.data


def _checked(L: Any, signal: ArrayLike) -> tuple[csr_array, FloatArray]:
    matrix = _checked_matrix(L)
    values: NDArray[Any] = np.ascontiguousarray(signal)
    if values.ndim not in (1, 2) or len(values) != matrix.shape[0] or values.dtype.kind not in "biuf":
        raise InputError(f"signal is {values.dtype} of shape {values.shape}, expected ({matrix.shape[0]},) or (.., C)")
    values = values.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(values.reshape(len(values), -1 if values.size else 0)).all(axis=1))
    if len(bad):
        raise InputError(f"signal is not finite at element {bad[0]}, expected finite values")
    return matrix, values


def _checked_matrix(L: Any) -> csr_array:
    from scipy.sparse import csr_array, issparse

    sparse: Any = L  # what issparse narrows has no shape
    if not issparse(L) or len(sparse.shape) != 2 or sparse.shape[0] != sparse.shape[1]:
        raise InputError(f"L is {type(sparse).__name__} of shape {np.shape(sparse)}, expected a square sparse matrix")
    if sparse.dtype.kind not in "biuf":
        raise InputError(f"L is {sparse.dtype}, expected real numbers")
    matrix = csr_array(sparse, dtype=np.float64)
    _check_symmetric(matrix)
    return matrix


def _check_symmetric(matrix: csr_array) -> None:
    """Refuse a matrix for which xᵀ L y is not yᵀ L x, for one random pair, the same each time."""
    if not np.isfinite(matrix.data).all():
        raise InputError("L holds values that are not finite, expected finite ones")
    x, y = np.random.default_rng(0).standard_normal((2, matrix.shape[0]))
    one, other = matrix @ x, matrix @ y
    scale = np.linalg.norm(one) * np.linalg.norm(y) + np.linalg.norm(other) * np.linalg.norm(x)
    if abs(y @ one - x @ other) > 1e-10 * scale:
        raise InputError("L is not symmetric, expected L = Lᵀ")


def _checked_time(t: float) -> float:
    if isinstance(t, bool) or not isinstance(t, int | float | np.number) or not 0 <= t < np.inf:
        raise InputError(f"t is {t!r}, expected a finite time >= 0")
    return float(t)


def _checked_mask(ok: ArrayLike, n: int) -> BoolArray:
    mask = np.asarray(ok)
    if mask.shape != (n,) or mask.dtype != bool:
        raise InputError(f"ok is {mask.dtype} of shape {mask.shape}, expected ({n},) bool")
    return mask
