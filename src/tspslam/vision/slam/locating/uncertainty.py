"""How well a pose is known: beside the noise of the image, what depths and the calibration leave open."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....types import FloatArray, Rig
from ...se3 import inverse
from ..least_squares.bundle import lens_of
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
    any matcher. h is how far the keyframe's own sights p would move it: an adjustment moves it, but not all landmarks
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
    from ._kernels import weigh_sights

    C, K, depth = estimate.covariance, len(estimate), sources.sigma_disparity / np.sqrt(sources.views)
    seen = np.column_stack([estimate.uv, estimate.disparity])
    information = np.column_stack([np.full(K, sources.sigma_uv), sources.sigma_disparity]) ** -2.0
    slope, residual, moved, scale = np.empty((K, 3, 6)), np.empty((K, 3)), np.empty((K, 6)), np.empty((K, 3))
    poses = np.ascontiguousarray(inverse(estimate.T_world_camera)), np.ascontiguousarray(sources.T_world_keyframe)
    given = lens_of(rig), *poses, xyz[estimate.landmark], seen, information, depth, _HUBER
    count, expected, square = weigh_sights(*given, slope, residual, moved, scale)
    variance = max(_LEAST_VARIANCE, square / max(1.0, count - 6 + expected)) / estimate.agreement
    own = moved * depth[:, None]
    common = C @ (moved.sum(axis=0) + scale[:, 2] @ slope[:, 2])
    pulled = C @ ((scale * sources.pull).ravel() @ slope.reshape(-1, 6))
    shared = shared_information(estimate.uv, rig.width, residual, slope)
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
