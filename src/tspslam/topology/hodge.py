"""Hodge decomposition of oriented edge signals: gradient, curl and harmonic parts, from factors that are kept."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .._brief import brief
from .._checks import require
from ..errors import InputError
from ..types import FloatArray, Signals, real_array
from . import homology
from .complex import Complex
from .laplacian import check_values
from .solvers import Method, Solver

FEW_CYCLES = 24
"""So many cycles are projected on a basis; for more, a second matrix is factored."""

LARGEST_BASIS = 1 << 31
"""Bytes of a harmonic basis that is still given out."""


class HodgeParts(NamedTuple):
    """The three parts of an edge signal, each (E,) or (E, C): orthogonal to each other, and their sum is the signal."""

    gradient: FloatArray
    curl: FloatArray
    harmonic: FloatArray

    def __repr__(self) -> str:
        return brief(self)


def hodge_decompose(complex_: Complex, edge_signal: ArrayLike, *, method: Method = "auto") -> HodgeParts:
    r"""Split an oriented edge signal into a gradient, a curl and a harmonic part.

    .. math:: s = B_1^\top p + B_2 q + h, \qquad B_1 h = 0, \quad B_2^\top h = 0

    Parameters
    ----------
    complex_ : Complex
        Closed or with boundary, manifold or not, connected or not.
    edge_signal : (E,) or (E, C) float array
        An oriented signal (a flow, a difference), positive from i to j of each edge i < j. Textures are unsigned and
        have no such parts: smooth them with `smooth_signals`.
    method : {"auto", "factor", "cg", "amg"}
        How Laplacians are inverted: by a sparse factorisation, which is kept with the complex for the next signal; by
        conjugate gradients; or by algebraic multigrid, which needs the extra ``mesh``. "auto": a factorisation up to
        400 000 rows, beyond that multigrid where it is installed, else conjugate gradients.

    Returns
    -------
    HodgeParts
        ``(gradient, curl, harmonic)``.

    Raises
    ------
    InputError
        If the signal does not fit, is not finite or is a `Signals`; if the method is not known or not installed.

    Notes
    -----
    ``p`` solves ``L0 p = B1 s``, one vertex of each component held at 0. With at most 24 independent cycles the
    harmonic part is a projection on `harmonic_basis` and the curl is what remains, so that ``L2`` is not needed; with
    more, ``q`` solves ``L2 q = B2ᵀ s``, one face of each void held at 0.

    Examples
    --------
    A flow that only runs around a ring of edges without a face is harmonic:

    >>> from tspslam import build_complex
    >>> ring = build_complex([], 3, edges=[[0, 1], [1, 2], [0, 2]])
    >>> parts = hodge_decompose(ring, [1.0, -1.0, 1.0])
    >>> parts.harmonic.round(9).tolist()
    [1.0, -1.0, 1.0]
    """
    signal = _checked(complex_, edge_signal, "edge")
    potential = _solver(complex_, "L0", method).solve(complex_.B1 @ signal)
    gradient: FloatArray = complex_.B1.T @ potential
    if homology.betti_numbers(complex_).cycles <= FEW_CYCLES:
        harmonic = _project(harmonic_basis(complex_, method=method), signal)
        return HodgeParts(gradient, signal - gradient - harmonic, harmonic)
    curl: FloatArray = complex_.B2 @ _solver(complex_, "L2", method).solve(complex_.B2.T @ signal)
    return HodgeParts(gradient, curl, signal - gradient - curl)


def harmonic_basis(complex_: Complex, *, method: Method = "auto") -> FloatArray:
    """Orthonormal basis of the harmonic edge signals, the null space of ``L1``; kept with the complex.

    Parameters
    ----------
    complex_ : Complex
        Any.
    method : {"auto", "factor", "cg", "amg"}
        As `hodge_decompose`.

    Returns
    -------
    (E, β1) float64
        Not to be written to.

    Raises
    ------
    InputError
        If the basis would take over 2 GiB, or as `hodge_decompose`.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> abs(harmonic_basis(build_complex([], 3, edges=[[0, 1], [1, 2], [0, 2]]))).round(6).ravel().tolist()
    [0.57735, 0.57735, 0.57735]
    """
    from . import _linear

    kept = vars(complex_)
    if "harmonic" not in kept:
        cycles = len(homology.homology_of(complex_).generators)
        if 8 * cycles * len(complex_.edges) > LARGEST_BASIS:
            size = 8 * cycles * len(complex_.edges) / 2**30
            raise InputError(f"a basis for {cycles} cycles takes {size:.1f} GiB, expected at most 2")
        closed = homology.closed_cochains(complex_)
        potential = _solver(complex_, "L0", method).solve(complex_.B1 @ closed)
        rows = np.ascontiguousarray((closed - complex_.B1.T @ potential).T)
        _linear.orthonormalise(rows)
        rows.setflags(write=False)  # kept: a caller must not change it
        kept["harmonic"] = rows.T
    basis: FloatArray = kept["harmonic"]
    return basis


def gradient(complex_: Complex, vertex_signal: ArrayLike) -> FloatArray:
    """Differences along the edges, ``B1ᵀ p``: from a vertex signal to an oriented edge signal.

    Parameters
    ----------
    complex_ : Complex
        N vertices, E edges.
    vertex_signal : (N,) or (N, C) float array
        Finite.

    Returns
    -------
    (E,) or (E, C) float64
        In units of the signal; positive where it grows from i to j.

    Raises
    ------
    InputError
        If the signal does not fit or is not finite.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> gradient(build_complex([[0, 1, 2]], 3), [0.0, 2, 5]).tolist()
    [2.0, 5.0, 3.0]
    """
    result: FloatArray = complex_.B1.T @ _checked(complex_, vertex_signal, "vertex")
    return result


def divergence(complex_: Complex, edge_signal: ArrayLike) -> FloatArray:
    """What flows into each vertex, ``B1 s``: from an oriented edge signal to a vertex signal.

    Parameters
    ----------
    complex_ : Complex
        N vertices, E edges.
    edge_signal : (E,) or (E, C) float array
        Finite.

    Returns
    -------
    (N,) or (N, C) float64
        In units of the signal.

    Raises
    ------
    InputError
        If the signal does not fit, is not finite or is a `Signals`.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> divergence(build_complex([[0, 1, 2]], 3), [2.0, 5, 3]).tolist()
    [-7.0, -1.0, 8.0]
    """
    result: FloatArray = complex_.B1 @ _checked(complex_, edge_signal, "edge")
    return result


def curl(complex_: Complex, edge_signal: ArrayLike) -> FloatArray:
    """Circulation around each face, ``B2ᵀ s``: from an oriented edge signal to an oriented face signal.

    Parameters
    ----------
    complex_ : Complex
        E edges, F faces.
    edge_signal : (E,) or (E, C) float array
        Finite.

    Returns
    -------
    (F,) or (F, C) float64
        In units of the signal.

    Raises
    ------
    InputError
        If the signal does not fit, is not finite or is a `Signals`.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> curl(build_complex([[0, 1, 2]], 3), [2.0, 5, 3]).tolist()
    [0.0]
    """
    result: FloatArray = complex_.B2.T @ _checked(complex_, edge_signal, "edge")
    return result


def _solver(complex_: Complex, which: Literal["L0", "L2"], method: Method) -> Solver:
    """Inverse of a Laplacian, kept with the complex."""
    kept = vars(complex_)
    name = f"{which} by {method}"
    if name not in kept:
        found = homology.homology_of(complex_)
        held = found.anchors if which == "L0" else found.voids
        kept[name] = Solver.prepare(getattr(complex_, which), held, method)
    solver: Solver = kept[name]
    return solver


def _project(basis: FloatArray, signal: FloatArray) -> FloatArray:
    """Orthogonal projection; sums in a fixed order, which a threaded product would not promise."""
    result: FloatArray = np.einsum("eg,g...->e...", basis, np.einsum("eg,e...->g...", basis, signal))
    return result


def _checked(complex_: Complex, signal: ArrayLike, level: Literal["vertex", "edge"]) -> FloatArray:
    require(complex_, Complex, "complex_")
    if isinstance(signal, Signals):
        raise InputError("a Signals is unsigned: it does not flip with orientation; expected an oriented edge signal")
    count = complex_.n if level == "vertex" else len(complex_.edges)
    values = real_array(signal, f"{level} signal", f"({count},) or (.., C)")
    if values.ndim not in (1, 2) or len(values) != count:
        raise InputError(f"{level} signal is {values.dtype} of shape {values.shape}, expected ({count},) or (.., C)")
    real = values.astype(np.float64)
    check_values(real, f"{level} signal", level)
    return real
