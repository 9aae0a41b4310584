"""What an adjusted path tells of quantities of its calibration: one linear step, with honest standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....types import FloatArray, Rig
from ...se3 import inverse
from .bundle import Observations, lens_of

_HUBER = 2.5  # standard deviations beyond which an observation counts less, as in `adjust`
_TINY = 1e-9  # information added, 1/px², so that what nothing tells is very uncertain


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


@dataclass(frozen=True, repr=False)
class Influence(Brief):
    """Normal equations of Q quantities of a calibration, all poses and points free, and who votes for what.

    Attributes
    ----------
    normal : (Q, Q) float64
        Of the quantities alone.
    votes : (M, Q) float64
        The right side of the equations as a sum over points.
    cluster : (M,) int64
        Points of one number err together: those that one keyframe saw first.
    """

    normal: FloatArray
    votes: FloatArray
    cluster: NDArray[np.int64]

    def estimate(self, basis: FloatArray, weights: Sequence[float]) -> Estimate:
        """Estimate a combination of quantities.

        The standard deviation is the largest of three: what the deviations of single observations give; the scatter of
        the points' votes, as a point that is matched wrongly is so in all its keyframes; the scatter of the votes of
        whole keyframes, as what stands side by side, or moves, errs together (a cluster-robust "sandwich", Liang and
        Zeger 1986).

        Parameters
        ----------
        basis : (Q, P) float64
            Columns of quantities that go together; others are zero.
        weights : sequence of P floats
            Of the columns in the combination.

        Returns
        -------
        Estimate
        """
        weight = np.asarray(weights, np.float64)
        covariance = np.linalg.inv(basis.T @ self.normal @ basis + _TINY * np.eye(basis.shape[1]))
        toward = covariance @ weight
        pull = self.votes @ (basis @ toward)
        together = np.bincount(self.cluster, pull) if len(pull) else pull
        variances = weight @ toward, (pull**2).sum(), (together**2).sum()
        return Estimate(float(pull.sum()), float(max(variances) ** 0.5))


def join_influences(parts: Sequence[Influence]) -> Influence:
    """Join what separate pieces of a path tell.

    Parameters
    ----------
    parts : sequence of Influence
        At least one.

    Returns
    -------
    Influence
    """
    first = np.cumsum([0, *(part.cluster.max(initial=-1) + 1 for part in parts)])
    cluster = [part.cluster + start for part, start in zip(parts, first[:-1], strict=True)]
    normal = np.sum([part.normal for part in parts], axis=0)
    return Influence(normal, np.concatenate([part.votes for part in parts]), np.concatenate(cluster))


def find_influence(
    rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, seen: Observations, columns: FloatArray
) -> Influence | None:
    """Find what observations of adjusted keyframes tell of quantities of the calibration.

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
        Derivatives of (u, v, disparity) of each observation by the quantities.

    Returns
    -------
    Influence or None
        None where the observations do not fix the poses.
    """
    from scipy.linalg import LinAlgError, cho_factor, cho_solve

    S, shared, normal, votes, turns = _equations(rig, inverse(T_world_camera), xyz, seen, columns)
    try:
        toward = cho_solve(cho_factor(S, lower=True), shared)
    except LinAlgError:
        return None
    cluster = np.full(len(xyz), len(T_world_camera))
    np.minimum.at(cluster, seen.point, seen.pose)
    return Influence(normal - shared.T @ toward, votes - turns @ toward, cluster)


def _equations(
    rig: Rig, T_camera_world: FloatArray, xyz: FloatArray, seen: Observations, columns: FloatArray
) -> tuple[FloatArray, ...]:
    """Equations without the points: of the poses, what they share with the columns, of these; right sides by point."""
    from ._kernels import reduce
    from ._offset_kernels import offset_equations

    order, count, size = np.lexsort((seen.pose, seen.point)), 6 * len(T_camera_world) - 6, columns.shape[2]
    pose, point = (np.ascontiguousarray(x[order], np.int32) for x in (seen.pose, seen.point))
    row = np.arange(-1, len(T_camera_world) - 1, dtype=np.int32)
    given = (
        lens_of(rig), np.ascontiguousarray(T_camera_world[:, :3, :3]), T_camera_world[:, :3, 3].copy(), xyz, pose,
        np.searchsorted(point, np.arange(len(xyz) + 1)).astype(np.int64),
        np.column_stack([seen.uv, seen.disparity])[order],
        np.column_stack([seen.sigma_uv, seen.sigma_disparity])[order] ** -2.0, _HUBER,
    )  # fmt: skip
    S, b = np.empty((count, count)), np.empty(count)
    W, V, g, U = np.empty((len(pose), 6, 3)), np.empty((len(xyz), 3, 3)), np.empty_like(xyz), np.empty_like(xyz)
    reduce(*given, 0.0, row, True, S, b, W, V, g, U)
    shared, normal = np.empty((count, size)), np.empty((size, size))
    votes, turns = np.empty((len(xyz), size)), np.empty((len(xyz), count))
    offset_equations(*given, row, np.ascontiguousarray(columns[order]), W, V, g, shared, normal, votes, turns)
    return S, shared, normal, votes, turns
