"""How well a pose is known: beside the noise of the image, what depths and the calibration leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....types import FloatArray, Rig
from ...se3 import inverse
from ..pose import PoseEstimate, Rival
from .shared_errors import shared_information

_HUBER = 2.5  # standard deviations, as in `fit_pose`
_LEAST_VARIANCE = 0.25  # of what the settings say: patches are found to half of 0.3 px at best, in a still room
_COMMON = 0.02  # px that all disparities are off alike, whatever is known: what corridors without an offset give


@dataclass(frozen=True)
class Sources:
    """What a pose's landmarks were measured with.

    Attributes
    ----------
    T_world_keyframe : (4, 4) float64
        Pose of the keyframe that measured them.
    pull : (K, 3) float64
        How far from its pose that keyframe saw them, in u, v and disparity, px; 0 where it did not.
    views : (K,) int64
        How many keyframes measured them.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    sigma_disparity : (K,) float64
        Standard deviations of disparities, px.
    offset_std : float
        Standard deviation of the offset that all disparities have in common, px.
    """

    T_world_keyframe: FloatArray
    pull: FloatArray
    views: NDArray[np.int64]
    sigma_uv: float
    sigma_disparity: FloatArray
    offset_std: float


def pose_covariance(rig: Rig, estimate: PoseEstimate, xyz: FloatArray, sources: Sources) -> FloatArray:
    """Find the covariance of a pose against the keyframe that measured its landmarks.

    With C the inverse of the normal equations, which take landmarks as known, and a = Jᵀ W ∂r/∂d of each landmark,
    whose disparity d in the keyframe has the variance σ² / views::

        s² / q · (C + C (Σ a aᵀ σ² / views) C)  +  C S C  +  σ_o² · g gᵀ  +  h hᵀ
        g = C Σ (a + Jᵀ W e_d),    h = C Σ Jᵀ W p

    s² is the robust variance of the residuals, in those that σ and the depths let expect, 0.25 at least; q the share
    of the landmarks found that agree: an observation counts for what it is likely to be right. S is what errors of
    neighbouring points have in common, as the residuals show it (`shared_information`). σ_o is the standard
    deviation of the offset that all disparities have in common, now and in the keyframe, with 0.02 px that hold for
    any matcher. h is how far the keyframe's own sights p would move it: an adjustment moves it, but not the landmarks
    that it alone has seen.

    Parameters
    ----------
    rig : Rig
        The cameras, with the offset of the disparities in their `doffs`.
    estimate : PoseEstimate
        The pose that fits, K landmarks that agree, and the inverse of the normal equations as its covariance.
    xyz : (M, 3) float64
        All landmarks, m.
    sources : Sources
        What they were measured with.

    Returns
    -------
    (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame.
    """
    C, points = estimate.covariance, xyz[estimate.landmark]
    J, across, residual = _linearise(rig, estimate, points)
    weight = np.column_stack([np.full((len(points), 2), sources.sigma_uv), sources.sigma_disparity]) ** -2.0
    weight[np.isnan(estimate.disparity), 2] = 0
    square = (residual**2 * weight).sum(axis=1)
    robust = np.minimum(1, _HUBER / np.sqrt(np.maximum(square, 1e-12)))
    shift = _depth_shift(rig, estimate, points, across, sources.T_world_keyframe)
    depth = sources.sigma_disparity / np.sqrt(sources.views)
    expected = np.count_nonzero(weight) - 6 + float(((shift * depth[:, None]) ** 2 * weight).sum())
    variance = max(_LEAST_VARIANCE, float((robust * square).sum()) / max(1.0, expected)) / estimate.agreement
    weight *= robust[:, None]
    moved = np.einsum("nki,nk->ni", J, weight * shift)
    own = moved * depth[:, None]
    common = C @ (moved.sum(axis=0) + weight[:, 2] @ J[:, 2])
    pulled = C @ np.einsum("nki,nk->i", J, weight * sources.pull)
    root = np.sqrt(weight)
    shared = shared_information(estimate.uv, rig.width, residual * root, J * root[:, :, None])
    spread: FloatArray = variance * (C + C @ (own.T @ own) @ C) + C @ shared @ C
    return spread + (sources.offset_std**2 + _COMMON**2) * np.outer(common, common) + np.outer(pulled, pulled)


def rival_spread(T_world_camera: FloatArray, rival: Rival) -> FloatArray:
    """Find what a pose's covariance gains where another pose may be the right one.

    About the pose that is believed, of covariance C, the second moment of a mixture of the two is::

        (1 - p) C + p (A C' Aᵀ + ξ ξᵀ)

    p is the probability of the other one, C' its covariance, ξ its motion (ω, υ) against the first, A the adjoint of
    that motion. This is the second term: the first is taken as C.

    Parameters
    ----------
    T_world_camera : (4, 4) float64
        The pose that is believed.
    rival : Rival
        The other one.

    Returns
    -------
    (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame.

    Examples
    --------
    >>> other = np.eye(4)
    >>> other[2, 3] = 2.0
    >>> float(rival_spread(np.eye(4), Rival(other, 100, 0.25, np.zeros((6, 6))))[5, 5])
    1.0
    """
    from scipy.spatial.transform import Rotation

    apart = inverse(T_world_camera) @ rival.T_world_camera
    xi = np.append(Rotation.from_matrix(apart[:3, :3]).as_rotvec(), apart[:3, 3])
    A = adjoint(apart)
    found: FloatArray = rival.probability * (A @ rival.covariance @ A.T + np.outer(xi, xi))
    return found


def _linearise(rig: Rig, estimate: PoseEstimate, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives of (u, v, disparity) by (ω, υ), (K, 3, 6), and by the point in the camera, (K, 3, 3); residuals."""
    T = estimate.T_world_camera
    camera = (points - T[:3, 3]) @ T[:3, :3]
    x, y, z = camera.T
    across = np.zeros((len(points), 3, 3))
    across[:, 0, 0], across[:, 0, 1], across[:, 0, 2] = rig.fx / z, rig.skew / z, -(rig.fx * x + rig.skew * y) / z**2
    across[:, 1, 1], across[:, 1, 2] = rig.fy / z, -rig.fy * y / z**2
    across[:, 2, 2] = -rig.fx * rig.baseline / z**2
    J = np.empty((len(points), 3, 6))
    J[:, :, 3:] = across
    for k in range(3):  # the cross product of the point and the row
        after, last = (k + 1) % 3, (k + 2) % 3
        J[:, :, k] = camera[:, after, None] * across[:, :, last] - camera[:, last, None] * across[:, :, after]
    u, v = rig.cx + (rig.fx * x + rig.skew * y) / z, rig.cy + rig.fy * y / z
    expected = np.column_stack([u, v, rig.fx * rig.baseline / z - rig.doffs])
    return J, across, np.nan_to_num(np.column_stack([estimate.uv, estimate.disparity]) - expected)


def _depth_shift(
    rig: Rig, estimate: PoseEstimate, points: FloatArray, across: FloatArray, T_world_keyframe: FloatArray
) -> FloatArray:
    """How (u, v, disparity) change with the disparities that a keyframe measured, px per px, (K, 3)."""
    ray = points - T_world_keyframe[:3, 3]
    away = np.maximum(ray @ T_world_keyframe[:3, 2], rig.baseline)  # what lies behind that camera was seen by another
    ray = ray * (away / (rig.fx * rig.baseline))[:, None]
    shift: FloatArray = np.einsum("nij,nj->ni", across, ray @ estimate.T_world_camera[:3, :3])
    return shift


def adjoint(T: FloatArray) -> FloatArray:
    """Make the matrix that takes a small motion (ω, υ) from one frame to another.

    Parameters
    ----------
    T : (4, 4) float64
        Rigid motion from the one to the other.

    Returns
    -------
    (6, 6) float64
        ``T exp(ξ) = exp(adjoint(T) ξ) T``.

    Examples
    --------
    >>> T = np.eye(4)
    >>> T[:3, 3] = 0, 0, 2
    >>> adjoint(T) @ [0, 0.1, 0, 0, 0, 0]
    array([ 0. ,  0.1,  0. , -0.2,  0. ,  0. ])
    """
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    found = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = R
    found[3:, :3] = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ R
    return found
