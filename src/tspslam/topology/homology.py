"""Betti numbers and closed cochains by a tree of the vertices and a cotree of the faces: linear time on surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from .._checks import require
from ..types import FloatArray
from .complex import Complex

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_PRIME = 2_147_483_647  # ranks are taken modulo this prime: exact arithmetic without fractions

Indices = NDArray[np.int64]


class BettiNumbers(NamedTuple):
    """Numbers of components, of independent cycles that bound nothing, and of enclosed voids."""

    components: int
    cycles: int
    voids: int


@dataclass(frozen=True, repr=False)
class Homology(Brief):
    """What a tree and a cotree say of a complex.

    Attributes
    ----------
    anchors : (β0,) int64
        One vertex of each component.
    generators : (G,) int64
        Edges in neither tree; a closed cochain that is 0 on the tree is given by its values there.
    order, position : (F,) int64
        Faces, each after all that its cotree edge depends on, and where in ``complex_.boundary`` that edge stands
        (-1: none, the face is residual).
    residual : (R, G) csr_array
        The conditions that residual faces put on the values on the generators.
    voids : (β2,) int64
        Faces, one for each independent void.
    """

    anchors: Indices
    generators: Indices
    order: Indices
    position: Indices
    residual: csr_array
    voids: Indices

    @property
    def betti(self) -> BettiNumbers:
        """Betti numbers."""
        rank = self.residual.shape[0] - len(self.voids)
        return BettiNumbers(len(self.anchors), len(self.generators) - rank, len(self.voids))


def betti_numbers(complex_: Complex) -> BettiNumbers:
    """Betti numbers over the rationals: components, independent cycles that bound nothing, enclosed voids.

    Parameters
    ----------
    complex_ : Complex
        Manifold or not.

    Returns
    -------
    BettiNumbers
        ``(components, cycles, voids)``; components - cycles + voids is the Euler characteristic.

    Notes
    -----
    Exact up to a chance of one in 2³¹: ranks are taken modulo a prime. Linear time where few edges have more than two
    faces.

    Examples
    --------
    >>> from tspslam import build_complex
    >>> betti_numbers(build_complex([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]], 4))
    BettiNumbers(components=1, cycles=0, voids=1)
    """
    return homology_of(complex_).betti


def homology_of(complex_: Complex) -> Homology:
    """Tree, cotree and what they leave; kept with the complex, as its other derived properties are.

    Parameters
    ----------
    complex_ : Complex
        Of triangles.

    Returns
    -------
    Homology
    """
    require(complex_, Complex, "complex_")
    kept = vars(complex_)
    if "homology" not in kept:
        kept["homology"] = _analyse(complex_)
    found: Homology = kept["homology"]
    return found


def closed_cochains(complex_: Complex) -> FloatArray:
    """A basis of the closed edge cochains modulo gradients.

    Parameters
    ----------
    complex_ : Complex
        Of triangles.

    Returns
    -------
    (E, β1) float64
    """
    from . import _homology

    found = homology_of(complex_)
    free = _null_space(found.residual)
    cochains = np.zeros((len(complex_.edges), free.shape[1]))
    cochains[found.generators] = free
    _homology.extend(*complex_.boundary, found.order, found.position, cochains)
    return cochains


def _analyse(complex_: Complex) -> Homology:
    from . import _homology

    start, rim, sign = complex_.boundary
    in_tree, anchors = _homology.spanning_tree(complex_.n, complex_.edges)
    count, sides = _homology.sides_of_edges(start, rim, len(complex_.edges))
    in_cotree = _homology.cotree(in_tree, count, sides, len(start) - 1)
    order, position = _homology.peel(start, rim, in_cotree, sides)
    generators = np.flatnonzero(~(in_tree | in_cotree))
    weight, part = _homology.sum_residual_faces(start, rim, sign, order, position)
    left = np.sort(order[position < 0])
    residual = _conditions(complex_, weight, part, left, generators)
    return Homology(anchors, generators, order, position, residual, left[_dependent_rows(residual)])


def _conditions(
    complex_: Complex, weight: NDArray[np.int8], part: Indices, left: Indices, generators: Indices
) -> csr_array:
    """Row r: boundaries of the faces of residual face r's part, each with its weight, on the generators."""
    from scipy.sparse import csr_array

    start, rim, sign = complex_.boundary
    faces = np.repeat(np.arange(len(start) - 1), np.diff(start))
    place = np.full(len(complex_.edges), -1)
    place[generators] = np.arange(len(generators))
    chosen = (part[faces] >= 0) & (place[rim] >= 0)
    faces = faces[chosen]
    rows, columns = np.searchsorted(left, part[faces]), place[rim[chosen]]
    shape = (len(left), len(generators))
    matrix = csr_array(((weight[faces] * sign[chosen]).astype(np.int64), (rows, columns)), shape=shape)
    matrix.eliminate_zeros()
    return matrix


def _dependent_rows(matrix: csr_array) -> list[int]:
    """Rows that are combinations of earlier ones, by elimination modulo a prime."""
    pivots: dict[int, dict[int, int]] = {}
    dependent = []
    for r, (a, b) in enumerate(zip(matrix.indptr[:-1].tolist(), matrix.indptr[1:].tolist(), strict=True)):
        row = dict(zip(matrix.indices[a:b].tolist(), (matrix.data[a:b] % _PRIME).tolist(), strict=True))
        while row and (lead := min(row)) in pivots:
            _eliminate(row, pivots[lead], row[lead])
        if row:
            scale = pow(row[lead], -1, _PRIME)
            pivots[lead] = {column: value * scale % _PRIME for column, value in row.items()}
        else:
            dependent.append(r)
    return dependent


def _eliminate(row: dict[int, int], pivot: dict[int, int], factor: int) -> None:
    for column, value in pivot.items():
        left = (row.get(column, 0) - factor * value) % _PRIME
        if left:
            row[column] = left
        else:
            row.pop(column, None)


def _null_space(matrix: csr_array) -> FloatArray:
    """Orthonormal basis of the vectors (G, β1) that meet all conditions."""
    used: Any = np.unique(matrix.indices)
    free = np.ones(matrix.shape[1], bool)
    free[used] = False
    kept = np.flatnonzero(free)
    vectors = _dense_null_space(matrix[:, used].toarray().astype(np.float64))
    basis = np.zeros((matrix.shape[1], len(kept) + vectors.shape[1]))
    basis[kept, np.arange(len(kept))] = 1
    basis[used, len(kept) :] = vectors
    return basis


def _dense_null_space(dense: FloatArray) -> FloatArray:
    if not dense.size:
        return np.eye(dense.shape[1])
    _, values, right = np.linalg.svd(dense)
    rank = int((values > 1e-9 * max(values.max(), 1)).sum())
    return np.ascontiguousarray(right[rank:].T)
