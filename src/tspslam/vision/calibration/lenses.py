"""Lenses: where a camera sees a ray, and which ray a pixel sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..._checks import require
from ...errors import InputError
from ...types import BoolArray, Camera, FloatArray, real_array
from ._lenses import bend, bend_slopes, divide, is_ahead, is_bent, lift, unbend


def project(camera: Camera, xyz: ArrayLike) -> FloatArray:
    """Pixels at which a camera sees points through its lens.

    ``(x, y) = (X, Y) / n(X, Y, Z)`` with the lens's own n, bent by its distortion, then ``u = fx x + skew y + cx``,
    ``v = fy y + cy``; the lenses page has the equations of every model.

    Parameters
    ----------
    camera : Camera
        With any lens of `LENSES`.
    xyz : (N, 3) float array
        Points in the camera's frame; m, or of any length.

    Returns
    -------
    (N, 2) float64
        px, also outside the image; NaN where the lens has no image of the ray: behind it, or beyond the radius where
        the distortion turns back.

    Raises
    ------
    InputError
        If the shape is another one.

    Examples
    --------
    >>> fisheye = Camera(300, 300, 320, 240, 640, 480, (0.0, 0.0, 0.0, 0.0), lens="equidistant")
    >>> project(fisheye, [[1, 0, 0], [0, 0, 1]]).round(2).tolist()
    [[791.24, 240.0], [320.0, 240.0]]
    """
    rays, _ = _unit_rays(camera, xyz)
    with np.errstate(all="ignore"):
        (x, y), sees, _, _ = _on_plane(camera, rays)
        if is_bent(camera):
            x, y = bend(camera, x, y)
        uv = np.column_stack([camera.fx * x + camera.skew * y + camera.cx, camera.fy * y + camera.cy])
    uv[~(sees & np.isfinite(uv).all(axis=1))] = np.nan
    return uv


def unproject(camera: Camera, uv: ArrayLike) -> FloatArray:
    """Rays that a camera sees at pixels: the inverse of `project`.

    In closed form for the double sphere and the extended unified model; Newton's method, to 1e-12 on the plane, where a
    distortion has no inverse of its own.

    Parameters
    ----------
    camera : Camera
        With any lens of `LENSES`.
    uv : (N, 2) float array
        Pixels, px.

    Returns
    -------
    (N, 3) float64
        Unit vectors in the camera's frame; NaN where the lens has no ray.

    Raises
    ------
    InputError
        If the shape is another one.

    Examples
    --------
    >>> fisheye = Camera(300, 300, 320, 240, 640, 480, (0.0, 0.0, 0.0, 0.0), lens="equidistant")
    >>> unproject(fisheye, [[320 + 300 * np.pi / 4, 240]]).round(6).tolist()
    [[0.707107, 0.0, 0.707107]]
    """
    require(camera, Camera, "lens: camera")
    pixels = _rows(uv, "uv", 2)
    with np.errstate(all="ignore"):
        y = (pixels[:, 1] - camera.cy) / camera.fy
        x = (pixels[:, 0] - camera.cx - camera.skew * y) / camera.fx
        if is_bent(camera):
            x, y = unbend(camera, x, y)
        rays = lift(camera, x, y)
        rays = rays / np.sqrt((rays * rays).sum(axis=1))[:, None]
        known = np.isfinite(rays).all(axis=1) & divide(camera, rays)[2]
    rays[~known] = np.nan
    return rays


def jacobian(camera: Camera, xyz: ArrayLike) -> FloatArray:
    """Derivatives of the pixels of `project` by the points.

    Parameters
    ----------
    camera : Camera
        With any lens of `LENSES`.
    xyz : (N, 3) float array
        Points in the camera's frame, m.

    Returns
    -------
    (N, 2, 3) float64
        px/m; NaN where `project` has no pixel.

    Raises
    ------
    InputError
        If the shape is another one.

    Examples
    --------
    >>> jacobian(Camera(500, 400, 320, 240, 640, 480), [[0, 0, 2]]).tolist()
    [[[250.0, 0.0, 0.0], [0.0, 200.0, 0.0]]]
    """
    rays, length = _unit_rays(camera, xyz)
    with np.errstate(all="ignore"):
        (x, y), sees, n, gradient = _on_plane(camera, rays)
        slopes = np.eye(2, 3) - np.column_stack([x, y])[:, :, None] * gradient[:, None, :]
        slopes = slopes / (n * length)[:, None, None]
        if is_bent(camera):
            slopes = bend_slopes(camera, x, y) @ slopes
        found = np.array([[camera.fx, camera.skew], [0.0, camera.fy]]) @ slopes
    found[~(sees & np.isfinite(found).all(axis=(1, 2)))] = np.nan
    return found


def field_of_view(camera: Camera) -> tuple[float, float, float]:
    """Angles across the part of a camera's image that has rays.

    Between the rays of the outermost pixels of the row, the column and the longer diagonal through the principal point.

    Parameters
    ----------
    camera : Camera
        With any lens of `LENSES`.

    Returns
    -------
    horizontal, vertical, diagonal : float
        Degrees; 0 where no pixel has a ray.

    Raises
    ------
    InputError
        If it is no camera.

    Examples
    --------
    >>> [round(angle, 2) for angle in field_of_view(Camera(500, 500, 320, 240, 641, 481))]
    [65.24, 51.28, 77.32]
    """
    require(camera, Camera, "lens: camera")
    right, bottom = camera.width - 1.0, camera.height - 1.0
    centre = np.clip([camera.cx, camera.cy], 0.0, (right, bottom))
    ends = {(s, t): _angle_towards(camera, centre, (right * s, bottom * t)) for s in (0, 1) for t in (0, 1)}
    across = sum(_angle_towards(camera, centre, (end, centre[1])) for end in (0.0, right))
    down = sum(_angle_towards(camera, centre, (centre[0], end)) for end in (0.0, bottom))
    return across, down, max(ends[0, 0] + ends[1, 1], ends[0, 1] + ends[1, 0])


def _angle_towards(camera: Camera, start: FloatArray, end: tuple[float, float]) -> float:
    """Angle between the ray at a start and that of the farthest pixel towards an end that has one, degrees."""
    count = int(np.ceil(np.hypot(*(np.array(end) - start)))) + 1
    rays = unproject(camera, start + np.linspace(0, 1, count)[:, None] * (np.array(end) - start))
    known = rays[np.isfinite(rays[:, 0])]
    if len(known) == 0:
        return 0.0
    sine = float(np.linalg.norm(np.cross(known[0], known[-1])))
    return float(np.degrees(np.arctan2(sine, known[0] @ known[-1])))


def _on_plane(
    camera: Camera, rays: FloatArray
) -> tuple[tuple[FloatArray, FloatArray], BoolArray, FloatArray, FloatArray]:
    """Points of the plane before it is bent, whether the lens sees them, n of the rays and its gradient."""
    n, gradient, sees = divide(camera, rays)
    x, y = rays[:, 0] / n, rays[:, 1] / n
    return (x, y), sees & is_ahead(camera, x, y) if is_bent(camera) else sees, n, gradient


def _unit_rays(camera: Camera, xyz: ArrayLike) -> tuple[FloatArray, FloatArray]:
    require(camera, Camera, "lens: camera")
    points = _rows(xyz, "xyz", 3)
    with np.errstate(all="ignore"):
        largest = np.abs(points).max(axis=1, initial=0.0)[:, None]  # so that no square overflows
        scaled = points / largest
        length = np.sqrt((scaled * scaled).sum(axis=1))
        return scaled / length[:, None], length * largest[:, 0]


def _rows(values: ArrayLike, name: str, width: int) -> FloatArray:
    rows = real_array(values, f"lens: {name}", f"(N, {width})").astype(np.float64)
    if rows.ndim != 2 or rows.shape[1] != width:
        raise InputError(f"lens: {name} has shape {rows.shape}, expected (N, {width})")
    return rows
