"""Bundle adjustment: camera poses and points that agree best with what was seen of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from ....errors import GeometryError, InputError
from ....types import BoolArray, FloatArray, Rig, real_array
from ...se3 import inverse

_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-4, 1e-9, 1e8  # of the diagonal (Marquardt 1963)
_ENOUGH = 1e-6  # relative decrease of the cost below which the search ends
SEARCH = _FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING, _ENOUGH
"""Of the same search, compiled for one camera."""
NO_SOLUTION = "the equations have no solution, expected observations that fix the poses"

State = TypeVar("State")


@dataclass(frozen=True)
class Observations:
    """Points seen by cameras, one row for each sight.

    Attributes
    ----------
    pose : (O,) integers
        Which camera.
    point : (O,) integers
        Which point.
    uv : (O, 2) float64
        Where in the left image, px.
    disparity : (O,) float64
        ``u_left - u_right``, px; NaN for a bearing only.
    sigma_uv, sigma_disparity : (O,) float64
        Standard deviations, px.
    """

    pose: NDArray[np.integer]
    point: NDArray[np.integer]
    uv: FloatArray
    disparity: FloatArray
    sigma_uv: FloatArray
    sigma_disparity: FloatArray


@dataclass(frozen=True)
class Adjustment:
    """What `adjust` found.

    Attributes
    ----------
    T_world_camera : (K, 4, 4) float64
        Poses.
    xyz : (M, 3) float64
        Points, m.
    cost_before, cost : float
        Sums of Huber costs, in squared standard deviations.
    distance : (O,) float64
        Length of each residual, standard deviations; infinity where the point is behind the camera.
    steps : int
        Steps taken.
    offset, offset_std : float
        Offset that all disparities have in common, measured less true, px, and its standard deviation; 0 unless asked
        for.
    """

    T_world_camera: FloatArray
    xyz: FloatArray
    cost_before: float
    cost: float
    distance: FloatArray
    steps: int
    offset: float = 0.0
    offset_std: float = 0.0


def adjust(
    rig: Rig,
    T_world_camera: FloatArray,
    xyz: FloatArray,
    seen: Observations,
    *,
    fixed: BoolArray | None = None,
    move_points: bool = True,
    huber: float = 2.5,
    max_steps: int = 20,
    offset: float = 0.0,
    offset_sigma: float | None = None,
) -> Adjustment:
    """Adjust poses and points to what was seen: least sum of Huber costs of (u, v, disparity).

    Levenberg-Marquardt steps on the cameras' normal equations, from which the points are eliminated (Schur
    complement); a step that does not lower the cost is taken back. The cost never rises.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (K, 4, 4) float64
        Poses to start from.
    xyz : (M, 3) float64
        Points to start from, m, in the world.
    seen : Observations
        At least one.
    fixed : (K,) bool, optional
        Poses that stay; by default the first, or none if points stay.
    move_points : bool
        Whether points are adjusted too.
    huber : float
        Standard deviations beyond which the cost is linear.
    max_steps : int
        Steps at most.
    offset : float
        Offset of all disparities to start from, measured less true, px.
    offset_sigma : float, optional
        Find the offset too, which before the observations is 0 with this standard deviation, px. A camera that moves
        sees it: near and far points then ask for different motions. By default it stays.

    Returns
    -------
    Adjustment

    Raises
    ------
    InputError
        If shapes do not fit, a value is not finite, or an observation names what is not there.
    GeometryError
        If the equations have no solution at any damping.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> xyz = np.random.default_rng(0).uniform((-1, -1, 3), (1, 1, 6), (30, 3))
    >>> uv = xyz[:, :2] / xyz[:, 2:] * 500 + (320, 240)
    >>> one, many = np.ones(30), np.arange(30)
    >>> seen = Observations(0 * many, many, uv, 50 / xyz[:, 2], one, one)
    >>> off = np.eye(4)[None].copy()
    >>> off[0, 0, 3] = 0.2
    >>> found = adjust(rig, off, xyz, seen, move_points=False)
    >>> bool(np.abs(found.T_world_camera[0] - np.eye(4)).max() < 1e-6)
    True
    """
    problem = _Problem(rig, T_world_camera, xyz, seen, fixed, move_points, huber)
    problem.set_offset(offset, offset_sigma)
    return problem.solve(max_steps)


@dataclass(frozen=True)
class Descent(Generic[State]):
    """Where `minimise` came to.

    Attributes
    ----------
    state : object
        The last state.
    cost_before, cost : float
        Of the first state and of the last.
    steps : int
        Steps taken.
    """

    state: State
    cost_before: float
    cost: float
    steps: int


def minimise(
    what: str, state: State, cost_of: Callable[[State], float], propose: Callable[[State, float], State | None],
    max_steps: int, damping: float = _FIRST_DAMPING,
) -> Descent[State]:  # fmt: skip
    """Find a state of least cost by Levenberg-Marquardt steps; the cost never rises.

    Parameters
    ----------
    what : str
        What to call the problem in a message.
    state : object
        Where to start.
    cost_of : callable
        Cost of a state.
    propose : callable
        From a state and a damping to the state after a step; None if its equations have no solution.
    max_steps : int
        Steps at most.
    damping : float
        Of the first step, times the diagonal; where it is small, of those after it too.

    Returns
    -------
    Descent

    Raises
    ------
    GeometryError
        If the equations of a step have no solution at any damping.
    """
    before = cost = cost_of(state)
    steps, floor = 0, min(damping, _MIN_DAMPING)
    while steps < max_steps:
        lower = _descend(what, state, cost, cost_of, propose, damping, floor)
        if lower is None:
            break
        state, taken, damping = lower
        steps, is_enough, cost = steps + 1, cost - taken <= _ENOUGH * cost, taken
        if is_enough:
            break
    return Descent(state, before, cost, steps)


def _descend(
    what: str, state: State, cost: float, cost_of: Callable[[State], float],
    propose: Callable[[State, float], State | None], damping: float, floor: float,
) -> tuple[State, float, float] | None:  # fmt: skip
    """The first step, with more and more damping, that does not raise the cost; its cost; the next damping."""
    is_solvable = False
    while damping <= _MAX_DAMPING:
        proposal = propose(state, damping)
        if proposal is not None:
            is_solvable, taken = True, cost_of(proposal)
            if taken <= cost:
                return proposal, taken, max(damping / 10, floor)
        damping *= 10
    if not is_solvable:
        raise GeometryError(f"{what}: {NO_SOLUTION}")
    return None


_State = tuple[FloatArray, FloatArray, FloatArray, FloatArray]  # R, t, X, lens


class _Problem:
    """Poses, points and observations in the order that the kernels want, and the steps."""

    def __init__(
        self,
        rig: Rig,
        T_world_camera: FloatArray,
        xyz: FloatArray,
        seen: Observations,
        fixed: BoolArray | None,
        moving: bool,
        huber: float,
    ) -> None:
        T = real_array(T_world_camera, "bundle: poses", "(K, 4, 4)").astype(np.float64)
        self.X = real_array(xyz, "bundle: xyz", "(M, 3)").astype(np.float64)
        if T.ndim != 3 or T.shape[1:] != (4, 4) or self.X.ndim != 2 or self.X.shape[1] != 3:
            raise InputError(f"bundle: poses, xyz have shapes {T.shape}, {self.X.shape}, expected (K, 4, 4), (M, 3)")
        if not (np.isfinite(T).all() and np.isfinite(self.X).all() and huber > 0):
            raise InputError(f"bundle: a pose or point is not finite, or huber, {huber}, not positive")
        T_camera_world = inverse(T)
        self.R, self.t = np.ascontiguousarray(T_camera_world[:, :3, :3]), T_camera_world[:, :3, 3].copy()
        self.moving, self.huber = moving, float(huber)
        self.lens = lens_of(rig)
        self._sort(_checked(seen, len(T), len(self.X)))
        stays = _stays(fixed, len(T), moving)
        self.row = np.where(stays, -1, np.cumsum(~stays) - 1).astype(np.int32)

    def _sort(self, seen: Observations) -> None:
        """Observations by point, then by camera."""
        self.order = np.lexsort((seen.pose, seen.point))
        self.pose, self.point = (np.ascontiguousarray(x[self.order], np.int32) for x in (seen.pose, seen.point))
        self.start = np.searchsorted(self.point, np.arange(len(self.X) + 1)).astype(np.int64)
        self.seen = np.column_stack([seen.uv, seen.disparity])[self.order]
        self.information = np.column_stack([seen.sigma_uv, seen.sigma_disparity])[self.order] ** -2.0

    def set_offset(self, offset: float, sigma: float | None) -> None:
        """Where the offset of disparities starts, and how far from 0 it may be."""
        if not (abs(offset) < 1e3 and (sigma is None or 0 < sigma < 1e3)):
            raise InputError(f"bundle: offset, offset_sigma are {offset}, {sigma}, expected px, the latter positive")
        self.lens[7] = offset
        self.prior = 0.0 if sigma is None else sigma**-2.0

    def solve(self, max_steps: int) -> Adjustment:
        count = 6 * int(self.row.max(initial=-1) + 1) + bool(self.prior)
        start = self.R, self.t, self.X, self.lens
        steps = max_steps if count or self.moving else 0
        found = minimise(
            "bundle", start, self._cost, lambda state, damping: self._propose(state, count, damping), steps
        )
        self.R, self.t, self.X, self.lens = found.state
        return self._adjustment(found, count)

    def _propose(self, state: _State, count: int, damping: float) -> _State | None:
        """Poses, points and lens after one step; None if the equations have no solution."""
        from ._kernels import points_step

        S, b, parts = self._equations(state, count, damping)
        x = _solved(S, b)
        if x is None:
            return None
        R, t, X, lens = state
        step, after = np.zeros_like(X), lens.copy()
        if self.moving:
            points_step(self.pose, self.start, self.row, *parts, x, step)
        if self.prior:
            after[7] += x[-1]
        return (*self._moved(R, t, x), X + step, after)

    def _equations(
        self, state: _State, count: int, damping: float
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, ...]]:
        """Reduced normal equations, and what the way back to the points needs."""
        from ._kernels import reduce

        R, t, X, lens = state
        S, b = np.empty((count, count)), np.empty(count)
        parts = np.empty((len(self.pose), 6, 3)), np.empty((len(X), 3, 3)), np.empty_like(X), np.empty_like(X)
        observations = self.pose, self.start, self.seen, self.information
        reduce(lens, R, t, X, *observations, self.huber, damping, self.row, self.moving, S, b, *parts)
        if self.prior:
            S[-1, -1] += self.prior
            b[-1] -= self.prior * lens[7]
        return S, b, parts

    def _moved(self, R: FloatArray, t: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses after steps (ω, υ)."""
        from scipy.spatial.transform import Rotation

        R, t, free = R.copy(), t.copy(), np.flatnonzero(self.row >= 0)
        if free.size:
            steps = x[: 6 * free.size].reshape(-1, 6)
            turn = Rotation.from_rotvec(steps[:, :3]).as_matrix()
            R[free] = turn @ R[free]
            t[free] = (turn @ t[free, :, None])[..., 0] + steps[:, 3:]
        return R, t

    def _cost(self, state: _State) -> float:
        from ._kernels import cost

        R, t, X, lens = state
        total = cost(lens, R, t, X, self.pose, self.point, self.seen, self.information, self.huber)
        return float(total + self.prior * lens[7] ** 2)

    def _adjustment(self, descent: Descent[_State], count: int) -> Adjustment:
        from ._kernels import squares

        found = np.empty(len(self.pose))
        squares(self.lens, self.R, self.t, self.X, self.pose, self.point, self.seen, self.information, found)
        distance = np.empty_like(found)
        distance[self.order] = np.sqrt(found)
        T = np.tile(np.eye(4), (len(self.R), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = self.R, self.t
        std = self._offset_std(count) if self.prior else 0.0
        costs = descent.cost_before, descent.cost
        return Adjustment(inverse(T), self.X, *costs, distance, descent.steps, float(self.lens[7]), std)

    def _offset_std(self, count: int) -> float:
        """Standard deviation of the offset: from the inverse of the reduced equations."""
        S, b, _ = self._equations((self.R, self.t, self.X, self.lens), count, 0.0)
        b[:] = 0
        b[-1] = 1
        x = _solved(S, b)
        return float(self.prior**-0.5) if x is None or not x[-1] > 0 else float(x[-1] ** 0.5)


def _solved(S: FloatArray, b: FloatArray) -> FloatArray | None:
    """Solution of symmetric positive equations, which are overwritten; None if they are not."""
    from ._kernels import solve_positive

    return b if solve_positive(S, b) and np.isfinite(b).all() else None


def lens_of(rig: Rig) -> FloatArray:
    """Collect what the compiled loops know of a rig.

    Parameters
    ----------
    rig : Rig
        The cameras.

    Returns
    -------
    (8,) float64
        fx, fy, cx, cy, skew, fx B, doffs, and 0 for the offset of the disparities.
    """
    return np.array([rig.fx, rig.fy, rig.cx, rig.cy, rig.skew, rig.fx * rig.baseline, rig.doffs, 0.0], np.float64)


def _stays(fixed: BoolArray | None, count: int, moving: bool) -> BoolArray:
    if fixed is None:
        return (np.arange(count) == 0) & moving
    stays = np.asarray(fixed)
    if stays.shape != (count,) or stays.dtype != np.bool_:
        raise InputError(f"bundle: fixed is {stays.dtype} of shape {stays.shape}, expected ({count},) bool")
    return stays


def _checked(seen: Observations, poses: int, points: int) -> Observations:
    """Observations as arrays whose values are in their ranges."""
    pose, point = np.asarray(seen.pose), np.asarray(seen.point)
    uv, *rest = (
        real_array(getattr(seen, name), f"bundle: {name}", "(O, ...)").astype(np.float64)
        for name in ("uv", "disparity", "sigma_uv", "sigma_disparity")
    )
    n = len(pose) if pose.ndim == 1 else -1
    if n < 1 or point.shape != (n,) or uv.shape != (n, 2) or any(values.shape != (n,) for values in rest):
        shapes = [x.shape for x in (pose, point, uv, *rest)]
        raise InputError(f"bundle: observations have shapes {shapes}, expected (O,), (O,), (O, 2), (O,), (O,), (O,)")
    for what, index, count in (("pose", pose, poses), ("point", point, points)):
        if index.dtype.kind not in "iu" or index.min() < 0 or index.max() >= count:
            raise InputError(
                f"bundle: {what} is {index.dtype} up to {index.max()}, expected integers, 0 to {count - 1}"
            )
    disparity, *sigmas = rest
    if not np.isfinite(uv).all() or np.isinf(disparity).any() or not all((s > 0).all() for s in sigmas):
        raise InputError("bundle: uv or disparity is not finite, or a sigma is not positive, expected px")
    return Observations(pose, point, uv, disparity, *sigmas)
