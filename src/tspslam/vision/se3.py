"""Rigid motions as (..., 4, 4) matrices, and the one that aligns two sets of points."""

from __future__ import annotations

import numpy as np

from ..types import FloatArray


def inverse(T: FloatArray) -> FloatArray:
    """Inverse of rigid motions.

    Parameters
    ----------
    T : (..., 4, 4) float64
        Rotation and translation.

    Returns
    -------
    (..., 4, 4) float64

    Examples
    --------
    >>> T = np.eye(4)
    >>> T[:3, 3] = 1, 2, 3
    >>> inverse(T)[:3, 3].tolist()
    [-1.0, -2.0, -3.0]
    """
    turned = np.swapaxes(T[..., :3, :3], -1, -2)
    back = np.zeros(T.shape, T.dtype)
    back[..., :3, :3] = turned
    back[..., :3, 3] = -(turned @ T[..., :3, 3:])[..., 0]
    back[..., 3, 3] = 1
    return back


def normalised(T: FloatArray) -> FloatArray:
    """Nearest rigid motions to matrices that are rigid motions but for rounding.

    Products of inverses double the rounding of a rotation at each step; this takes it out.

    Parameters
    ----------
    T : (..., 4, 4) float64
        Rigid motions but for rounding.

    Returns
    -------
    (..., 4, 4) float64

    Examples
    --------
    >>> bool(np.allclose(normalised(np.diag([1.001, 1.0, 1.0, 1.0])), np.eye(4)))
    True
    """
    U, _, Vt = np.linalg.svd(T[..., :3, :3])
    exact = T.copy()
    exact[..., :3, :3] = U @ Vt
    return exact


def move_points(T: FloatArray, points: FloatArray) -> FloatArray:
    """Move each point by a rigid motion of its own.

    Parameters
    ----------
    T : (N, 4, 4) float64
        The motions.
    points : (N, 3) float64
        The points, m.

    Returns
    -------
    (N, 3) float64

    Examples
    --------
    >>> move_points(np.eye(4)[None], np.ones((1, 3))).tolist()
    [[1.0, 1.0, 1.0]]
    """
    moved: FloatArray = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
    return moved


def repeated(T: FloatArray, times: float | FloatArray) -> FloatArray:
    """Motions repeated: their rotation vectors and their translations times a number each.

    Parameters
    ----------
    T : (..., 4, 4) float64
        Rigid motions, m.
    times : float or (...,) float64
        Any numbers; 0.5 is half of the way.

    Returns
    -------
    (..., 4, 4) float64

    Examples
    --------
    >>> T = np.eye(4)
    >>> T[:3, 3] = 0, 0, 2
    >>> repeated(T, 1.5)[2, 3].tolist()
    3.0
    """
    from scipy.spatial.transform import Rotation

    more, times = np.zeros(T.shape), np.asarray(times)[..., None]
    more[..., :3, :3] = Rotation.from_rotvec(times * Rotation.from_matrix(T[..., :3, :3]).as_rotvec()).as_matrix()
    more[..., :3, 3] = times * T[..., :3, 3]
    more[..., 3, 3] = 1.0
    return more


def rotation_angle(R: FloatArray) -> FloatArray:
    """Angle of rotations, exact also for small ones: ``atan2(|axis part|, (tr R - 1) / 2)``.

    Parameters
    ----------
    R : (..., 3, 3) float64
        Rotations.

    Returns
    -------
    (...,) float64
        rad, 0 to π.

    Examples
    --------
    >>> float(rotation_angle(np.diag([1.0, -1.0, -1.0])).round(9))
    3.141592654
    """
    skew = R - np.swapaxes(R, -1, -2)
    sine = np.sqrt(skew[..., 0, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 2] ** 2) / 2
    angle: FloatArray = np.arctan2(sine, (np.trace(R, axis1=-2, axis2=-1) - 1) / 2)
    return angle


def alignment(source: FloatArray, target: FloatArray, *, with_scale: bool = False) -> tuple[FloatArray, float]:
    """Rigid motion, and scale, that align points with others in the least-squares sense (Umeyama 1991).

    Parameters
    ----------
    source, target : (n, 3) float64
        Points, n >= 1.
    with_scale : bool
        Whether the scale is free; 1 otherwise.

    Returns
    -------
    T : (4, 4) float64
        Rotation and translation: ``target ≈ scale R source + t``. Where points lie on a line or in one place, one of
        the motions that fit alike.
    scale : float
        1 where all points of `source` are in one place.

    Examples
    --------
    >>> points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> T, scale = alignment(points, 2 * points + 5, with_scale=True)
    >>> T[:3, 3].round(9).tolist(), round(scale, 9)
    ([5.0, 5.0, 5.0], 2.0)
    """
    middle, there = source.mean(axis=0), target.mean(axis=0)
    U, sizes, Vt = np.linalg.svd((target - there).T @ (source - middle))
    mirror = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    spread = float(((source - middle) ** 2).sum())
    scale = float((sizes * mirror).sum()) / spread if with_scale and spread > 0 else 1.0
    T = np.eye(4)
    T[:3, :3] = (U * mirror) @ Vt
    T[:3, 3] = there - scale * T[:3, :3] @ middle
    return T, scale
