"""What an adjusted path tells of quantities of its calibration: one linear step, with honest standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....errors import GeometryError
from ....types import FloatArray, Rig
from ...se3 import inverse
from .bundle import Observations, lens_of

_HUBER = 2.5  # standard deviations beyond which an observation counts less, as in `adjust`
_WEAK = 0.01  # information added, 1/px²: 0 ± 10 px, for what nothing tells


@dataclass(frozen=True)
class Estimate:
    """A value and its standard deviation.

    Attributes
    ----------
    value : float
        What was found.
    std : float
        Its standard deviation.

    Examples
    --------
    >>> Estimate(-0.98, 0.05).exceeds(0.5, 3), Estimate(-0.98, 0.4).exceeds(0.5, 3)
    (True, False)
    """

    value: float
    std: float

    def exceeds(self, least: float, sure: float) -> bool:
        """Tell whether the value is large for certain.

        Parameters
        ----------
        least : float
            What it must exceed.
        sure : float
            Standard deviations that it must exceed too.

        Returns
        -------
        bool
        """
        return abs(self.value) > max(least, sure * self.std)

    def plus(self, number: float) -> Estimate:
        """Add a number that is certain.

        Parameters
        ----------
        number : float
            What is added.

        Returns
        -------
        Estimate
        """
        return Estimate(self.value + number, self.std)

    def less(self, other: Estimate) -> Estimate:
        """Subtract an independent estimate.

        Parameters
        ----------
        other : Estimate
            From other observations.

        Returns
        -------
        Estimate
        """
        return Estimate(self.value - other.value, float(np.hypot(self.std, other.std)))


class PieceEquations:
    """Normal equations of Q quantities of a calibration, from an adjusted piece of a path whose poses and points move.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (K, 4, 4) float64
        Poses; the first stays.
    xyz : (M, 3) float64
        Points, m.
    seen : Observations
        What the keyframes saw.
    columns : (O, 3, Q) float64
        Derivatives of (u, v, disparity) of each observation by the quantities; 0 where there is no disparity.

    Attributes
    ----------
    normal : (Q, Q) float64
        The equations of the quantities alone.
    right : (Q,) float64
        Their right side.
    cluster : (M,) int64
        Points of one number err together: those that one keyframe saw first.

    Raises
    ------
    GeometryError
        If the observations do not fix the poses.
    """

    def __init__(
        self, rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, seen: Observations, columns: FloatArray
    ) -> None:
        T, order = inverse(T_world_camera), np.lexsort((seen.pose, seen.point))
        pose, point = (np.ascontiguousarray(x[order], np.int32) for x in (seen.pose, seen.point))
        self._given = (
            lens_of(rig), np.ascontiguousarray(T[:, :3, :3]), T[:, :3, 3].copy(), xyz, pose,
            np.searchsorted(point, np.arange(len(xyz) + 1)).astype(np.int64),
            np.column_stack([seen.uv, seen.disparity])[order],
            np.column_stack([seen.sigma_uv, seen.sigma_disparity])[order] ** -2.0, _HUBER,
        )  # fmt: skip
        self._row, self._columns = np.arange(-1, len(T) - 1, dtype=np.int32), np.ascontiguousarray(columns[order])
        self._parts = np.empty((len(pose), 6, 3)), np.empty((len(xyz), 3, 3))
        self._eliminate_points()
        self._still = np.zeros(columns.shape[2]), np.zeros(len(self._turn))
        self._shared, normal, votes, _ = self._after(*self._still)
        self._toward = self._solve(self._shared)
        self.normal = normal - self._shared.T @ self._toward
        self.right = votes.sum(axis=0) - self._toward.T @ self._turn
        self.cluster = np.full(len(xyz), len(T))
        np.minimum.at(self.cluster, point, pose)

    def _eliminate_points(self) -> None:
        """Make the equations of the poses, without the points."""
        from scipy.linalg import LinAlgError, cho_factor

        from ._kernels import reduce

        xyz, count = self._given[3], 6 * len(self._row) - 6
        S, self._turn = np.empty((count, count)), np.empty(count)
        further = np.empty_like(xyz), np.empty_like(xyz)
        reduce(*self._given, 0.0, self._row, True, S, self._turn, *self._parts, *further)
        try:
            self._factor = cho_factor(S, lower=True)
        except LinAlgError:
            raise GeometryError("a piece of the path is not fixed, expected observations that fix its poses") from None

    def _solve(self, right: FloatArray) -> FloatArray:
        from scipy.linalg import cho_solve

        return np.asarray(cho_solve(self._factor, right))

    def _after(self, delta: FloatArray, x: FloatArray) -> tuple[FloatArray, ...]:
        """What the quantities share with the poses, their equations, and right sides by point, after steps."""
        from ._offset_kernels import offset_equations

        count, size, points = len(self._turn), self._columns.shape[2], len(self._given[3])
        shared, normal = np.empty((count, size)), np.empty((size, size))
        votes, turns = np.empty((points, size)), np.empty((points, count))
        offset_equations(*self._given, self._row, self._columns, *self._parts, delta, x, shared, normal, votes, turns)
        return shared, normal, votes, turns

    def votes(self, direction: FloatArray, delta: FloatArray | None = None) -> FloatArray:
        """Tell how far each point pulls the quantities.

        Parameters
        ----------
        direction : (Q,) float64
            Along which the pull is told.
        delta : (Q,) float64, optional
            After the quantities have made this step, and poses and points have followed.

        Returns
        -------
        (M,) float64
        """
        steps = self._still if delta is None else (delta, self._solve(self._turn - self._shared @ delta))
        _, _, votes, turns = self._after(*steps)
        found: FloatArray = votes @ direction - turns @ (self._toward @ direction)
        return found


class Solution:
    """The step of some quantities that pieces of a path ask for.

    Parameters
    ----------
    pieces : sequence of PieceEquations
        At least one.
    basis : (Q, P) float64
        Columns of quantities that go together; others stay.
    """

    def __init__(self, pieces: Sequence[PieceEquations], basis: FloatArray) -> None:
        self._pieces, self._basis = pieces, basis
        normal = basis.T @ np.sum([piece.normal for piece in pieces], axis=0) @ basis
        self._covariance = np.linalg.inv(normal + _WEAK * np.eye(basis.shape[1]))
        self._step = self._covariance @ basis.T @ np.sum([piece.right for piece in pieces], axis=0)

    def combine(self, weights: Sequence[float]) -> Estimate:
        """Estimate a combination, taking all that the model does not explain for chance.

        The standard deviation is the largest of three: what the deviations of single observations give; the scatter of
        the points' votes, as a point that is matched wrongly is so in all its keyframes; the scatter of the votes of
        whole keyframes, as what stands side by side, or moves, errs together (a cluster-robust "sandwich", Liang and
        Zeger 1986).

        Parameters
        ----------
        weights : sequence of P floats
            Of the columns in the combination.

        Returns
        -------
        Estimate
        """
        return self._estimate(weights, None)

    def contrast(self, weights: Sequence[float]) -> Estimate:
        """Estimate a combination that is itself what a simpler model would take for chance.

        Returns: as `combine`, with votes after the step.

        Parameters
        ----------
        weights : sequence of P floats
            Of the columns in the combination.
        """
        return self._estimate(weights, self._basis @ self._step)

    def _estimate(self, weights: Sequence[float], delta: FloatArray | None) -> Estimate:
        weight = np.asarray(weights, np.float64)
        direction, alone, together = self._basis @ self._covariance @ weight, 0.0, 0.0
        for piece in self._pieces:
            votes = piece.votes(direction, delta)
            alone += float((votes**2).sum())
            together += float((np.bincount(piece.cluster, votes) ** 2).sum())
        variance = max(float(weight @ self._covariance @ weight), alone, together)
        return Estimate(float(weight @ self._step), variance**0.5)
