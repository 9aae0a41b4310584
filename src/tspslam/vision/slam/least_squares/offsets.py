"""What an adjusted path tells of quantities of its calibration: one linear step, with honest standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....errors import GeometryError
from ....types import FloatArray, Rig
from ...se3 import inverse
from .bundle import Observations, lens_of

_HUBER = 2.5  # standard deviations beyond which an observation counts less, as in `adjust`
WEAK = 0.01  # information added, 1/px²: 0 ± 10 px, for what nothing tells
_FEWEST = 3  # keyframes whose scatter says something: the votes of one, after a step, are 0, and those of two opposed


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
    """Normal equations of quantities of a calibration, from an adjusted piece of a path whose poses and points move.

    The first G quantities are offsets of disparities, px, of a keyframe or of several.

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
    group : (K,) int64
        Which offset the disparities of each keyframe have, from 0 to G - 1.
    columns : (O, 3, E) float64
        Derivatives of (u, v, disparity) of each observation by E more quantities, Q = G + E in all; 0 where there is no
        disparity.

    Attributes
    ----------
    offsets : int
        G.
    normal : (Q, Q) float64
        The equations of the quantities alone.
    right : (Q,) float64
        Their right side.
    cluster : (M,) int64
        Points of one number err together: those that one keyframe saw first.
    share : float
        By how much points scatter more than their votes do, as the poses follow these (HC1, MacKinnon and White 1985).

    Raises
    ------
    GeometryError
        If the observations do not fix the poses.
    """

    def __init__(
        self, rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, seen: Observations, group: NDArray[np.int64],
        columns: FloatArray,
    ) -> None:  # fmt: skip
        T, order = inverse(T_world_camera), np.lexsort((seen.pose, seen.point))
        pose, point = (np.ascontiguousarray(x[order], np.int32) for x in (seen.pose, seen.point))
        self._given = (
            lens_of(rig), np.ascontiguousarray(T[:, :3, :3]), T[:, :3, 3].copy(), xyz, pose,
            np.searchsorted(point, np.arange(len(xyz) + 1)).astype(np.int64),
            np.column_stack([seen.uv, seen.disparity])[order],
            np.column_stack([seen.sigma_uv, seen.sigma_disparity])[order] ** -2.0, _HUBER,
        )  # fmt: skip
        self.offsets = int(group.max()) + 1
        self._row, self._columns = np.arange(-1, len(T) - 1, dtype=np.int32), np.ascontiguousarray(columns[order])
        has = np.where(np.isfinite(seen.disparity[order]), group[pose], -1).astype(np.int32)
        self._own = self._row, has, self._columns
        self._parts = np.empty((len(pose), 6, 3)), np.empty((len(xyz), 3, 3))
        self._eliminate_points()
        self._fill_equations()
        self.share = len(xyz) / max(len(xyz) - len(self._turn), 1)
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

    def _fill_equations(self) -> None:
        """Make the equations of the quantities, with the points and then the poses taken out."""
        from ._offset_kernels import offset_equations

        count, size = len(self._turn), self.offsets + self._columns.shape[2]
        self._shared, self.normal, self.right = np.empty((count, size)), np.empty((size, size)), np.empty(size)
        offset_equations(*self._given, *self._own, *self._parts, self._shared, self.normal, self.right)
        self._toward = self._solve(self._shared)
        self.normal -= self._shared.T @ self._toward
        self.right -= self._toward.T @ self._turn

    def votes(self, directions: FloatArray, delta: FloatArray | None = None) -> FloatArray:
        """Tell how far each point pulls the quantities.

        Parameters
        ----------
        directions : (Q, D) float64
            Along which the pull is told.
        delta : (Q,) float64, optional
            After the quantities have made this step, and poses and points have followed.

        Returns
        -------
        (M, D) float64
        """
        from ._offset_kernels import offset_votes

        step = np.zeros(len(self.right)) if delta is None else delta
        x = np.zeros(len(self._turn)) if delta is None else self._solve(self._turn - self._shared @ delta)
        along, toward = np.ascontiguousarray(directions), np.ascontiguousarray(self._toward @ directions)
        found = np.empty((len(self.cluster), directions.shape[1]))
        offset_votes(*self._given, *self._own, *self._parts, along, toward, step, x, found)
        return found


class Solution:
    """The step of some quantities that pieces of a path ask for.

    Parameters
    ----------
    pieces : sequence of PieceEquations
        At least one, with the same E more quantities.
    basis : (1 + E, P) float64
        Columns of quantities that go together; others stay. The first row is the offset of all keyframes.
    """

    def __init__(self, pieces: Sequence[PieceEquations], basis: FloatArray) -> None:
        self._pieces = pieces
        self._bases = [np.vstack([np.tile(basis[0], (piece.offsets, 1)), basis[1:]]) for piece in pieces]
        both = list(zip(pieces, self._bases, strict=True))
        normal = np.sum([own.T @ piece.normal @ own for piece, own in both], axis=0)
        self._covariance = np.linalg.inv(normal + WEAK * np.eye(basis.shape[1]))
        self._step = self._covariance @ np.sum([own.T @ piece.right for piece, own in both], axis=0)

    def combine(self, weights: Sequence[float], spread: float = 1.0) -> tuple[Estimate, float]:
        """Estimate a combination, taking all that the model does not explain for chance.

        The variance is the larger of two: the scatter of the points' votes, times the square of `spread`, as a point
        that is matched wrongly is so in all its keyframes; the scatter of the votes of whole keyframes, as what stands
        side by side, or moves, errs together (a cluster-robust "sandwich", Liang and Zeger 1986), where there are three
        or more. So it comes from residuals, not from the deviations that observations were given.

        Parameters
        ----------
        weights : sequence of P floats
            Of the columns in the combination.
        spread : float
            How much more whole keyframes scatter than their points say, as a longer path told.

        Returns
        -------
        Estimate
        float
            How much more they do here, 1 or more: the root of Kish's design effect.
        """
        each = np.array([weights], np.float64).T
        along = self._covariance @ each
        alone, together = self._scatter(along, None)
        wider = float(max(1.0, together[0] / alone[0]) ** 0.5) if alone[0] > 0 else 1.0
        return self._estimates(each, along, np.maximum(alone * spread**2, together))[0], wider

    def contrast(self, *weights: Sequence[float]) -> list[Estimate]:
        """Estimate combinations that are themselves what a simpler model would take for chance.

        Returns: as `combine`, with votes after the step.

        Parameters
        ----------
        *weights : sequence of P floats
            Of the columns in each combination.
        """
        each = np.array(weights, np.float64).T
        along = self._covariance @ each
        return self._estimates(each, along, np.maximum(*self._scatter(along, self._step)))

    def _estimates(self, each: FloatArray, along: FloatArray, variance: FloatArray) -> list[Estimate]:
        """Combinations `each` (P, D), with the variance that the weak information has added to it."""
        total = variance + WEAK * (along**2).sum(axis=0)
        return [Estimate(float(a), float(b) ** 0.5) for a, b in zip(self._step @ each, total, strict=True)]

    def _scatter(self, along: FloatArray, step: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Variances (D,) that votes of points, and of keyframes, give steps `along` (P, D); 0 of too few keyframes."""
        alone, together, clusters = np.zeros(along.shape[1]), np.zeros(along.shape[1]), 0
        for piece, basis in zip(self._pieces, self._bases, strict=True):
            votes = piece.votes(basis @ along, None if step is None else basis @ step)
            groups, place = np.unique(piece.cluster, return_inverse=True)
            sums = np.zeros((len(groups), along.shape[1]))
            np.add.at(sums, place, votes)
            alone, together = alone + piece.share * (votes**2).sum(axis=0), together + (sums**2).sum(axis=0)
            clusters += len(groups)
        return alone, together * clusters / (clusters - 1) if clusters >= _FEWEST else np.zeros_like(together)
