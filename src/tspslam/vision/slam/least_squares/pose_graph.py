"""Pose graphs: poses that agree best with what is known of them relative to each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ...._checks import is_rigid
from ....errors import GeometryError, InputError
from ....types import BoolArray, FloatArray, real_array
from ...se3 import normalised
from .bundle import minimise

_FIRST_DAMPING = 1e-12  # of the diagonal: the softest bend of a chain of 1000 poses has about as much stiffness
_ASYMMETRY = 1e-6  # of an information matrix, by its largest value: text files round


@dataclass(frozen=True, repr=False)
class PoseEdges(Brief):
    """Relative poses, one row for each.

    Attributes
    ----------
    i, j : (E,) int64
        Which two poses.
    T_ij : (E, 4, 4) float64
        ``inv(T_world_i) @ T_world_j``, as measured, m.
    information : (E, 6, 6) float64
        Inverse covariance of (rotation vector, translation) of ``inv(T_ij) @ inv(T_world_i) @ T_world_j``, rad and m.
    """

    i: NDArray[np.int64]
    j: NDArray[np.int64]
    T_ij: FloatArray
    information: FloatArray


@dataclass(frozen=True, repr=False)
class PoseGraph(Brief):
    """What `optimise_poses` found.

    Attributes
    ----------
    T_world : (K, 4, 4) float64
        Poses.
    cost_before, cost : float
        Sums of Huber costs, in squared standard deviations.
    distance : (E,) float64
        Length of each edge's residual, standard deviations.
    steps : int
        Steps taken.
    """

    T_world: FloatArray
    cost_before: float
    cost: float
    distance: FloatArray
    steps: int


def optimise_poses(
    T_world: FloatArray,
    edges: PoseEdges,
    *,
    fixed: BoolArray | None = None,
    huber: float = np.inf,
    max_steps: int = 100,
) -> PoseGraph:
    """Find the poses that agree best with relative ones: least sum of Huber costs of the edges.

    The residual of an edge is (rotation vector, translation) of ``inv(T_ij) inv(T_i) T_j``. Levenberg-Marquardt steps
    on the normal equations, which are solved by Cholesky's factor of 6 x 6 blocks, eliminated in an order of minimum
    degree; a step that does not lower the cost is taken back. The cost never rises.

    Parameters
    ----------
    T_world : (K, 4, 4) float64
        Poses to start from, m.
    edges : PoseEdges
        At least one.
    fixed : (K,) bool, optional
        Poses that stay; by default the first.
    huber : float
        Standard deviations beyond which the cost of an edge is linear; by default none are.
    max_steps : int
        Steps at most.

    Returns
    -------
    PoseGraph

    Raises
    ------
    InputError
        If shapes do not fit, a value is not finite, a matrix is no rigid motion or no information, or an edge names
        what is not there.
    GeometryError
        If a pose hangs on no fixed one, or the edges do not fix a pose in all directions.

    Examples
    --------
    >>> square = np.tile(np.eye(4), (4, 1, 1))
    >>> square[:, :2, 3] = [[0, 0], [1, 0], [1, 1], [0, 1]]
    >>> i, j = np.array([0, 1, 2, 3]), np.array([1, 2, 3, 0])
    >>> measured = np.linalg.inv(square[i]) @ square[j]
    >>> off = square.copy()
    >>> off[2, 0, 3] += 0.5
    >>> found = optimise_poses(off, PoseEdges(i, j, measured, np.tile(np.eye(6), (4, 1, 1))))
    >>> bool(np.abs(found.T_world - square).max() < 1e-9)
    True
    """
    T = np.ascontiguousarray(real_array(T_world, "pose graph: poses", "(K, 4, 4)"), np.float64)
    edges = _checked(T, edges)
    stays = _stays(fixed, len(T))
    if not (huber > 0 and max_steps >= 0):
        raise InputError(f"pose graph: huber, max_steps are {huber}, {max_steps}, expected positive ones")
    _require_hold(edges, stays)
    return _Graph(edges, stays, float(huber)).solve(T, max_steps)


def marginal_covariance(T_world: FloatArray, edges: PoseEdges, place: int) -> FloatArray:
    """Find the covariance of a pose against the first one, given all edges: a block of the inverse normal equations.

    Parameters
    ----------
    T_world : (K, 4, 4) float64
        Poses, m.
    edges : PoseEdges
        What is known of them relative to each other; the equations are those at these poses.
    place : int
        Which pose.

    Returns
    -------
    (6, 6) float64
        Of (ω, υ), rad and m, in its own frame; 0 for the first.

    Raises
    ------
    InputError, GeometryError
        As `optimise_poses`.

    Examples
    --------
    >>> line, i = np.tile(np.eye(4), (3, 1, 1)), np.array([0, 1])
    >>> step = PoseEdges(i, i + 1, line[:2], np.tile(np.eye(6), (2, 1, 1)))
    >>> float(marginal_covariance(line, step, 2)[3, 3])
    2.0
    >>> twice = PoseEdges(np.append(i, 0), np.append(i + 1, 2), line, np.tile(np.eye(6), (3, 1, 1)))
    >>> round(float(marginal_covariance(line, twice, 2)[3, 3]), 9)
    0.666666667
    """
    T = np.ascontiguousarray(real_array(T_world, "pose graph: poses", "(K, 4, 4)"), np.float64)
    edges, stays = _checked(T, edges), _stays(None, len(T))
    _require_hold(edges, stays)
    return _Graph(edges, stays, np.inf).covariance(T, place)


@dataclass(frozen=True, repr=False)
class _Poses(Brief):
    """Poses (K, 3, 3), (K, 3), their cost, the lengths of the residuals, and the equations of a step from there."""

    R: FloatArray
    t: FloatArray
    cost: float
    distance: FloatArray
    L: FloatArray
    b: FloatArray


class _Graph:
    """Edges in the order that the kernels want, the layout of the equations, and the steps."""

    def __init__(self, edges: PoseEdges, stays: BoolArray, huber: float) -> None:
        from ._block_cholesky import factor_pattern

        self.column = _eliminated(edges, stays)
        self.free, self.count = np.flatnonzero(~stays), int((~stays).sum())
        ends = self.column[edges.i], self.column[edges.j]
        low, high = np.minimum(*ends), np.maximum(*ends)
        is_inner = low >= 0
        self.start, self.row = factor_pattern(self.count, *_lower_half(low[is_inner], high[is_inner], self.count))
        blocks = np.repeat(np.arange(self.count), np.diff(self.start)) * self.count + self.row  # ascend
        self.place = np.where(is_inner, np.searchsorted(blocks, low * self.count + high), -1)
        R_ij, t_ij = np.ascontiguousarray(edges.T_ij[:, :3, :3]), edges.T_ij[:, :3, 3].copy()
        self.edges = edges.i, edges.j, R_ij, t_ij, edges.information, huber

    def solve(self, T: FloatArray, max_steps: int) -> PoseGraph:
        """Search the optimum from poses T."""
        begin = self._at(np.ascontiguousarray(T[:, :3, :3]), T[:, :3, 3].copy())
        steps = max_steps if self.count else 0
        found = minimise("pose graph", begin, lambda poses: poses.cost, self._propose, steps, _FIRST_DAMPING)
        result = T.copy()
        result[self.free, :3, :3], result[self.free, :3, 3] = found.state.R[self.free], found.state.t[self.free]
        result[self.free] = normalised(result[self.free])
        return PoseGraph(result, found.cost_before, found.cost, found.state.distance, found.steps)

    def covariance(self, T: FloatArray, place: int) -> FloatArray:
        """Covariance of a pose at poses T."""
        from ._block_cholesky import factor_blocks, solve_blocks

        column, C = int(self.column[place]), np.zeros((6, 6))
        if column < 0:
            return C
        L = self._at(np.ascontiguousarray(T[:, :3, :3]), T[:, :3, 3].copy()).L
        if not factor_blocks(self.start, self.row, L):
            raise GeometryError("pose graph: the equations have no solution, expected edges that fix the poses")
        for k in range(6):
            x = np.zeros((self.count, 6))
            x[column, k] = 1
            solve_blocks(self.start, self.row, L, x)
            C[:, k] = x[column]
        return (C + C.T) / 2

    def _at(self, R: FloatArray, t: FloatArray) -> _Poses:
        """Poses with their equations."""
        from ._pose_graph import graph_equations

        L, b, distance = np.empty((len(self.row), 6, 6)), np.empty((self.count, 6)), np.empty(len(self.place))
        layout = self.column, self.start[:-1], self.place
        return _Poses(R, t, float(graph_equations(R, t, *self.edges, *layout, L, b, distance)), distance, L, b)

    def _propose(self, poses: _Poses, damping: float) -> _Poses | None:
        """Poses after one step; None if the equations have no solution."""
        from ._block_cholesky import factor_blocks, solve_blocks

        L, x = poses.L.copy(), poses.b.copy()
        L[self.start[:-1, None], np.arange(6), np.arange(6)] *= 1 + damping
        if not factor_blocks(self.start, self.row, L):
            return None
        solve_blocks(self.start, self.row, L, x)
        return self._moved(poses, x[self.column[self.free]]) if np.isfinite(x).all() else None

    def _moved(self, poses: _Poses, x: FloatArray) -> _Poses:
        """Poses after steps (φ, ρ) of those that are free."""
        from scipy.spatial.transform import Rotation

        R, t, free = poses.R.copy(), poses.t.copy(), self.free
        t[free] += (R[free] @ x[:, 3:, None])[..., 0]
        R[free] = R[free] @ Rotation.from_rotvec(x[:, :3]).as_matrix()
        return self._at(R, t)


def _lower_half(low: NDArray[np.int64], high: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], ...]:
    """Columns of the lower half of the equations, row after row: bounds of the rows, and the columns."""
    pairs = np.unique(high * count + low)
    rows = pairs // max(count, 1)
    return np.searchsorted(rows, np.arange(count + 1)).astype(np.int64), pairs % max(count, 1)


def _eliminated(edges: PoseEdges, stays: BoolArray) -> NDArray[np.int64]:
    """When each pose is eliminated, -1 for those that stay: an order of minimum degree, which keeps the factor sparse.

    SuperLU orders the graph of the poses (a number for each block), of which it then has little to factor.
    """
    from scipy.sparse import coo_matrix, identity
    from scipy.sparse.linalg import splu

    free = np.flatnonzero(~stays)
    column = np.where(stays, -1, np.cumsum(~stays) - 1)
    ends = column[edges.i], column[edges.j]
    inner = np.minimum(*ends) >= 0
    links = coo_matrix((np.ones(inner.sum()), (ends[0][inner], ends[1][inner])), (len(free), len(free))).tocsr()
    if len(free) > 1:
        # no pivot grows: the diagonal is more than the sum of its row
        degree = 1.0 + 2.0 * max((links + links.T).sum(axis=0).max(), 1.0)
        graph = (degree * identity(len(free)) - links - links.T).tocsc()
        order = splu(graph, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).perm_c
        column[free] = order
    return column.astype(np.int64)


def _require_hold(edges: PoseEdges, stays: BoolArray) -> None:
    """Refuse poses that no chain of edges joins to a fixed one."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    n = len(stays)
    _, part = connected_components(coo_matrix((np.ones(len(edges.i)), (edges.i, edges.j)), (n, n)), directed=False)
    loose = ~np.isin(part, part[stays])
    if loose.any():
        raise GeometryError(
            f"pose graph: pose {int(loose.argmax())} hangs on no fixed pose, expected edges that join it"
        )


def _stays(fixed: BoolArray | None, count: int) -> BoolArray:
    stays = np.arange(count) == 0 if fixed is None else np.asarray(fixed)
    if stays.shape != (count,) or stays.dtype != np.bool_:
        raise InputError(f"pose graph: fixed is {stays.dtype} of shape {stays.shape}, expected ({count},) bool")
    return stays


def _checked(T: FloatArray, edges: PoseEdges) -> PoseEdges:
    """Edges as arrays whose values are in their ranges."""
    i, j = np.asarray(edges.i), np.asarray(edges.j)
    T_ij, information = (
        np.ascontiguousarray(real_array(getattr(edges, name), f"pose graph: {name}", "(E, ...)"), np.float64)
        for name in ("T_ij", "information")
    )
    n = len(i) if i.ndim == 1 else -1
    shapes = T.shape[1:], i.shape, j.shape, T_ij.shape, information.shape
    if n < 1 or shapes != ((4, 4), (n,), (n,), (n, 4, 4), (n, 6, 6)):
        raise InputError(
            f"pose graph: shapes are {T.shape}, {shapes[1:]}, expected (K, 4, 4); (E,), (E,), (E, 4, 4), (E, 6, 6)"
        )
    for what, index in (("i", i), ("j", j)):
        if index.dtype.kind not in "iu" or index.min() < 0 or index.max() >= len(T):
            raise InputError(
                f"pose graph: {what} is {index.dtype} up to {index.max()}, expected integers, 0 to {len(T) - 1}"
            )
    if (i == j).any():
        e = int(np.argmax(i == j))
        raise InputError(f"pose graph: edge {e} joins pose {i[e]} to itself, expected two poses")
    if not (np.isfinite(T).all() and is_rigid(T) and np.isfinite(T_ij).all() and is_rigid(T_ij)):
        raise InputError("pose graph: a pose or an edge is no rigid motion, expected rotations and finite places")
    _require_information(information)
    return PoseEdges(i.astype(np.int64), j.astype(np.int64), T_ij, information)


def _require_information(information: FloatArray) -> None:
    """Refuse what is no inverse covariance; directions of which nothing is known may be 0."""
    if np.isfinite(information).all():
        scale = np.abs(information).max(axis=(1, 2), initial=0.0)
        skew = np.abs(information - np.swapaxes(information, 1, 2)).max(axis=(1, 2), initial=0.0)
        least = np.linalg.eigvalsh(information)[:, 0]
        if (skew <= _ASYMMETRY * scale).all() and (least >= -_ASYMMETRY * scale).all():
            return
    raise InputError("pose graph: an information is not symmetric or negative, expected an inverse covariance")
