"""Heat and other functions of a Laplacian: on vertices, on oriented cochains, on unsigned signals of every level."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from .._brief import Brief
from .._checks import require, require_stage
from ..errors import InputError
from ..types import BoolArray, FloatArray, Signals
from .laplacian import Level, checked, checked_matrix, parts_of, unsigned_laplacian

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from .complex import Complex

LARGEST_DENSE = 4000
"""Rows of a matrix whose eigenvectors are still computed."""

LARGEST_DEGREE = 100_000
"""Terms of a polynomial that are still summed."""

_MAX_TERMS = 1 << 14

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
    signal : (n,) or (n, C) float array
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
    time = checked_number(t, "t")
    if method == "exact":
        return spectral_filter(L, signal, lambda values: np.exp(-time * values))
    if method != "chebyshev":
        raise InputError(f"method is {method!r}, expected 'chebyshev' or 'exact'")
    matrix, values = checked(L, signal)
    half = _half_bound(matrix)
    filtered = _polynomial(matrix, values, half, heat_series(half, time, checked_number(error, "error", 1e-15, 1)))
    if np.linalg.norm(filtered) > (1 + 1e-6) * np.linalg.norm(values):
        raise InputError("L has negative eigenvalues: the signal grows; expected a positive semidefinite L")
    return filtered


def chebyshev_filter(
    L: Any,
    signal: ArrayLike,
    response: Callable[[FloatArray], ArrayLike],
    *,
    degree: int | None = None,
    error: float = 1e-10,
) -> FloatArray:
    """Apply a function of the eigenvalues, ``h(L) s``, by a Chebyshev polynomial on a guaranteed bound of the spectrum.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric, positive semidefinite; see `heat_filter` for which signals go with which matrix.
    signal : (n,) or (n, C) float array
        Finite values.
    response : callable
        h: eigenvalues (k,), >= 0 -> (k,) finite values.
    degree : int, optional
        Terms beyond the constant, for functions that no polynomial meets (steps). Default: as many as `error` needs.
    error : float
        Largest norm of the error, as a share of the signal's norm times the largest value of h.

    Returns
    -------
    (n,) or (n, C) float64

    Raises
    ------
    InputError
        As `heat_filter`; also if h gives something else, or 16 384 terms are not enough.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> L0 = build_complex([[0, 1, 2]], 3).L0
    >>> chebyshev_filter(L0, [3.0, 0, 0], lambda values: 1 / (1 + values)).round(9).tolist()
    [1.5, 0.75, 0.75]
    """
    matrix, values = checked(L, signal)
    half = _half_bound(matrix)
    return _polynomial(
        matrix, values, half, _chebyshev_series(response, half, degree, checked_number(error, "error", 1e-15, 1))
    )


def tikhonov_filter(L: Any, signal: ArrayLike, weight: float) -> FloatArray:
    """Smooth a signal: the x that minimises ``|x - s|² + weight xᵀ L x``, which is ``(I + weight L)⁻¹ s``.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric, positive semidefinite; see `heat_filter` for which signals go with which matrix.
    signal : (n,) or (n, C) float array
        Finite values.
    weight : float
        >= 0.

    Returns
    -------
    (n,) or (n, C) float64
        Relative residual at most 1e-10.

    Raises
    ------
    InputError
        As `heat_filter`, with `weight` in the place of t.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> tikhonov_filter(build_complex([[0, 1, 2]], 3).L0, [3.0, 0, 0], 1.0).round(9).tolist()
    [1.5, 0.75, 0.75]
    """
    from scipy.sparse import csr_array, eye_array

    from . import _linear

    matrix, values = checked(L, signal)
    parts = parts_of(csr_array(eye_array(matrix.shape[0]) + checked_number(weight, "weight") * matrix))
    columns = values.reshape(len(values), -1).T.copy() if values.size else np.empty((0, 0))
    for column in columns:
        right = column.copy()
        if not _linear.conjugate_gradient(*parts, right, 1e-12, column) <= 1e-10:
            raise InputError("the system cannot be solved: expected a positive semidefinite L and a smaller weight")
    return np.ascontiguousarray(columns.T).reshape(values.shape)


def spectral_filter(L: Any, signal: ArrayLike, response: Callable[[FloatArray], ArrayLike]) -> FloatArray:
    """Apply any function of the eigenvalues, ``U h(λ) Uᵀ s``, by the eigenvectors of a matrix of at most 4000 rows.

    Parameters
    ----------
    L : (n, n) sparse matrix
        Symmetric.
    signal : (n,) or (n, C) float array
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
    matrix, values = checked(L, signal)
    if matrix.shape[0] > LARGEST_DENSE:
        raise InputError(f"{matrix.shape[0]} rows are too many for eigenvectors, expected at most {LARGEST_DENSE}")
    eigenvalues, vectors = np.linalg.eigh(matrix.toarray())
    gain = _responses(response, eigenvalues)
    filtered: FloatArray = vectors @ (gain.reshape(-1, *[1] * (values.ndim - 1)) * (vectors.T @ values))
    return filtered


@dataclass(frozen=True, repr=False)
class HeatKernel(Brief):
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
        """Rows of the kernel; by symmetry also its columns.

        Parameters
        ----------
        index : (k,) integers, or an integer
            Which rows, 0 to n - 1.

        Returns
        -------
        (k, n) float64

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
    return HeatKernel(checked_matrix(L), checked_number(t, "t"))


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

    require(signals, Signals, "signals")
    smoothed: dict[str, Any] = {}
    levels: tuple[Level, ...] = ("vertex", "edge", "face")
    for level in levels:
        ok: BoolArray = getattr(signals, f"{level}_ok")
        L = unsigned_laplacian(complex_, level, ok)
        smoothed[level] = heat_filter(L, getattr(signals, level), t)
    return replace(signals, **smoothed)


def _half_bound(matrix: csr_array) -> float:
    """Half of a bound of the spectrum."""
    from . import _spectral

    return float(max(_spectral.largest_eigenvalue(*parts_of(matrix)) / 2, 1e-300))


def heat_series(half: float, t: float, error: float) -> FloatArray:
    """Chebyshev coefficients of ``exp(-tλ)`` on 0 to 2 `half`.

    Parameters
    ----------
    half : float
        Half of a bound of the spectrum, > 0.
    t : float
        Time, >= 0.
    error : float
        Bound of the sum of the coefficients that are left out, > 0.

    Returns
    -------
    (K,) float64
    """
    from scipy.special import ive

    terms = 2 * np.sqrt(t * half * (1 - np.log(error))) - 2 * np.log(error) + 10  # more than are needed
    if terms > LARGEST_DEGREE:
        wanted = f"a smaller t: over {LARGEST_DEGREE} terms"
        raise InputError(f"t is {t:g} on a spectrum up to {2 * half:.4g}, expected {wanted}")
    k = np.arange(int(terms))
    series = np.asarray(2 * (-1.0) ** k * ive(k, t * half), np.float64)
    series[0] /= 2
    return _cut(series, error)


def _chebyshev_series(
    response: Callable[[FloatArray], ArrayLike], half: float, degree: int | None, error: float
) -> FloatArray:
    """Coefficients of h on 0 to 2 half, as many as asked for, or until the last half of them is below the error."""
    if degree is not None:
        if isinstance(degree, bool) or not isinstance(degree, int | np.integer) or not 1 <= degree <= LARGEST_DEGREE:
            raise InputError(f"degree is {degree!r}, expected an integer from 1 to {LARGEST_DEGREE}")
        return _interpolate(response, half, int(degree) + 1)[0]
    terms = 16
    while terms <= _MAX_TERMS:
        series, largest = _interpolate(response, half, terms)
        if np.abs(series[terms // 2 :]).sum() <= error * largest:
            return _cut(series, error * largest)
        terms *= 2
    raise InputError(f"{_MAX_TERMS} terms do not follow the response to {error:g}, expected a smoother one, or degree=")


def _interpolate(response: Callable[[FloatArray], ArrayLike], half: float, terms: int) -> tuple[FloatArray, float]:
    """Chebyshev coefficients of h from its values at the Chebyshev nodes, and its largest value."""
    from scipy.fft import dct

    nodes = half * (1 + np.cos(np.pi * (np.arange(terms) + 0.5) / terms))
    values = _responses(response, nodes)
    series = np.asarray(dct(values, type=2), np.float64) / terms
    series[0] /= 2
    return series, float(max(np.abs(values).max(), 1e-300))


def _cut(series: FloatArray, error: float) -> FloatArray:
    """Leave out the last coefficients, whose sum is below the error."""
    tail = np.cumsum(np.abs(series[::-1]))[::-1]
    return series[: max(2, int(np.argmax(tail < error)) if (tail < error).any() else len(series))]


def _responses(response: Callable[[FloatArray], ArrayLike], eigenvalues: FloatArray) -> FloatArray:
    require_stage(response, "response", "lambda x: np.exp(-x)")
    gain = np.asarray(response(eigenvalues), np.float64)
    if gain.shape != eigenvalues.shape or not np.isfinite(gain).all():
        raise InputError(f"response gives shape {gain.shape}, expected {eigenvalues.shape} finite values")
    return gain


def _polynomial(matrix: csr_array, signal: FloatArray, half: float, series: FloatArray) -> FloatArray:
    """``Σ c_k T_k(L / half - 1) s``."""
    from . import _spectral

    step = _spectral.step if signal.ndim == 1 else _spectral.step_channels
    parts = parts_of(matrix)
    out, now, before = series[0] * signal, signal.copy(), np.zeros_like(signal)
    for k in range(1, len(series)):
        step(*parts, half, (1 if k == 1 else 2) / half, now, before, series[k], out)
        now, before = before, now
    return out


def checked_number(value: float, name: str, low: float = 0.0, high: float = np.inf) -> float:
    """Return a finite number in [low, high) as a float, or raise `InputError`.

    Parameters
    ----------
    value : float
        The number.
    name : str
        What to call it in the error.
    low, high : float
        Its range.

    Returns
    -------
    float
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not low <= value < high:
        wanted = f"a finite number >= {low:g}" if high == np.inf else f"{low:g} to {high:g}"
        raise InputError(f"{name} is {value!r}, expected {wanted}")
    return float(value)
