"""Complexes to and from TopoNetX."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._checks import require
from ..errors import InputError
from ..topology.complex import Complex, build_complex


def to_toponetx(complex_: Complex) -> Any:
    """Give a complex to TopoNetX.

    Parameters
    ----------
    complex_ : Complex
        Of triangles.

    Returns
    -------
    toponetx.classes.SimplicialComplex
        With the same vertices, also those without an edge; its edges and faces come in lexicographic order, so the
        columns of its B2 are those of ours where our faces are in that order.

    Raises
    ------
    InputError
        If TopoNetX is not installed, or the complex has polygons.
    """
    require(complex_, Complex, "complex_")
    if not isinstance(complex_.faces, np.ndarray):
        raise InputError("complex: its faces are polygons, expected triangles")
    simplices = [[i] for i in range(complex_.n)] + complex_.edges.tolist() + complex_.faces.tolist()
    return _module().SimplicialComplex(simplices)


def from_toponetx(complex_: Any) -> Complex:
    """Take a complex from TopoNetX.

    Parameters
    ----------
    complex_ : toponetx.classes.SimplicialComplex
        Of dimension 2 at most; its vertices are the integers 0 to n - 1.

    Returns
    -------
    Complex

    Raises
    ------
    InputError
        If it is none, has simplices of more than three vertices, or other vertices.
    """
    if not isinstance(complex_, _module().SimplicialComplex):
        raise InputError(f"complex is {type(complex_).__name__}, expected a toponetx SimplicialComplex")
    if complex_.dim > 2:
        raise InputError(f"complex has dimension {complex_.dim}, expected 2 at most")
    skeletons = [[tuple(s) for s in complex_.skeleton(rank)] if rank <= complex_.dim else [] for rank in range(3)]
    vertices = [v for (v,) in skeletons[0]]
    if not all(isinstance(v, int | np.integer) and not isinstance(v, bool) for v in vertices):
        raise InputError("complex has vertices that are no integers, expected 0 to n - 1")
    if sorted(vertices) != list(range(len(vertices))):
        found, last = f"{min(vertices)} to {max(vertices)}", len(vertices) - 1
        raise InputError(f"complex has {len(vertices)} vertices, {found}, expected 0 to {last}")
    faces, edges = (np.array(skeletons[rank], np.int64).reshape(-1, rank + 1) for rank in (2, 1))
    return build_complex(faces, len(vertices), edges)


def _module() -> Any:
    try:
        from toponetx import classes
    except ImportError as error:
        raise InputError("TopoNetX is not installed, expected an installation of it: pip install TopoNetX") from error
    return classes
