"""Flows along edges: what a vector field does on the way from one vertex to the next."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from .._checks import require
from ..errors import InputError
from ..types import FloatArray, real_array
from .complex import Complex

Field = Callable[[FloatArray], ArrayLike]


def edge_flow(complex_: Complex, xyz: ArrayLike, field: ArrayLike | Field) -> FloatArray:
    r"""Integrate a vector field along every edge: an oriented edge signal, as `hodge_decompose` takes it.

    .. math:: s_{ij} = \int_0^1 f(x_i + t\,(x_j - x_i)) \cdot (x_j - x_i)\, dt, \qquad i < j

    Parameters
    ----------
    complex_ : Complex
        N vertices, E edges.
    xyz : (N, D) float array
        Positions of the vertices: in space, D = 3, or pixels, D = 2.
    field : (N, D) float array or callable
        The field at each vertex; it is taken as linear along an edge (trapezoid rule). Or a function that gives it at
        any (M, D) positions; it is asked at the vertices and in the middle of the edges (Simpson's rule, exact on
        cubic fields).

    Returns
    -------
    (E,) float64
        In the field's unit times that of the positions; positive where the field points from i to j.

    Raises
    ------
    InputError
        If shapes do not fit, or the positions or the field are not finite where there is an edge.

    Examples
    --------
    A turning field has no divergence and the same curl everywhere, twice the area of each face:

    >>> from tspslam import build_complex
    >>> from tspslam.topology.hodge import curl
    >>> square, corners = build_complex([[0, 1, 2], [0, 2, 3]], 4), np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    >>> flow = edge_flow(square, corners, lambda x: x[:, ::-1] * (-1, 1))
    >>> curl(square, flow).tolist()
    [1.0, 1.0]
    """
    require(complex_, Complex, "complex_")
    points = real_array(xyz, "xyz", f"({complex_.n}, 3)").astype(np.float64)
    if points.ndim != 2 or len(points) != complex_.n:
        raise InputError(f"xyz has shape {points.shape}, expected ({complex_.n}, 3), or ({complex_.n}, 2) for pixels")
    i, j = complex_.edges.T
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused below
        at = _evaluated(field, points)
        mean = (at[i] + at[j]) / 2
        if callable(field):
            mean = (mean + 2 * _evaluated(field, (points[i] + points[j]) / 2)) / 3
        flow: FloatArray = np.einsum("ed,ed->e", mean, points[j] - points[i])
    bad = np.flatnonzero(~np.isfinite(flow))
    if len(bad):
        edge = complex_.edges[bad[0]].tolist()
        said = f"xyz or field is not finite at edge {edge}, or their product is too large"
        raise InputError(f"{said}; expected finite values at vertices with an edge")
    return flow


def _evaluated(field: ArrayLike | Field, points: FloatArray) -> FloatArray:
    values = real_array(field(points) if callable(field) else field, "field", f"{points.shape}").astype(np.float64)
    if values.shape != points.shape:
        raise InputError(f"field has shape {values.shape}, expected {points.shape}, a vector at each position")
    return values
