"""Pose of one camera from points whose places are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...errors import GeometryError
from ...types import FloatArray, Rig
from ..se3 import inverse


@dataclass(frozen=True)
class PoseFit:
    """What `fit_pose` found.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        The pose.
    information : (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame: inverse of the covariance.
    distance : (N,) float64
        Length of each residual, standard deviations; infinity where the point is behind the camera.
    """

    T_world_camera: FloatArray
    information: FloatArray
    distance: FloatArray


def lens_of(rig: Rig) -> FloatArray:
    """(fx, fy, cx, cy, skew, fx B, doffs, 0 for the offset): what the compiled loops know of a rig."""
    return np.array([rig.fx, rig.fy, rig.cx, rig.cy, rig.skew, rig.fx * rig.baseline, rig.doffs, 0.0], np.float64)


def fit_pose(
    rig: Rig,
    T_world_camera: FloatArray,
    xyz: FloatArray,
    seen: FloatArray,
    sigma: tuple[float, float],
    *,
    huber: float = 2.5,
    max_steps: int = 10,
) -> PoseFit:
    """Find the pose that agrees best with where known points are seen: `bundle.adjust` of a single camera, compiled.

    Parameters
    ----------
    rig : Rig
        The camera.
    T_world_camera : (4, 4) float64
        Where to start.
    xyz : (N, 3) float64
        Points in the world, m.
    seen : (N, 3) float64
        Their (u, v, disparity), px; a disparity NaN makes a bearing.
    sigma : (float, float)
        Standard deviations of pixels and of disparities, px.
    huber : float
        Width of the Huber cost, standard deviations.
    max_steps : int
        Levenberg-Marquardt steps.

    Raises
    ------
    GeometryError
        If the equations have no solution at any damping.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> xyz = np.random.default_rng(0).uniform((-1, -1, 3), (1, 1, 6), (30, 3))
    >>> uv = xyz[:, :2] / xyz[:, 2:] * 500 + (320, 240)
    >>> off = np.eye(4)
    >>> off[0, 3] = 0.2
    >>> found = fit_pose(rig, off, xyz, np.column_stack([uv, 50 / xyz[:, 2]]), (1.0, 1.0))
    >>> bool(np.abs(found.T_world_camera - np.eye(4)).max() < 1e-6)
    True
    """
    from ._least_squares import improve_pose

    T = inverse(T_world_camera)
    R, t, information, distance = T[:3, :3].copy(), T[:3, 3].copy(), np.empty((6, 6)), np.empty(len(xyz))
    weights = np.array(sigma) ** -2.0
    if not improve_pose(lens_of(rig), R, t, xyz, seen, weights, huber, max_steps, information, distance):
        raise GeometryError("pose: the equations have no solution, expected points that estimate a camera")
    T[:3, :3], T[:3, 3] = R, t
    return PoseFit(inverse(T), information, distance)
