"""Depths of one camera as another one sees them: drawn as a surface, the nearest at each pixel."""

from __future__ import annotations

import numpy as np

from ..._checks import is_rigid, told
from ...errors import InputError
from ...types import Camera, FloatArray, Rig
from .sensor import DepthSensor, neighbour_step

_NEAREST = 1e-3  # m before the camera, of a point that it sees


def register_depth(
    depth: FloatArray, camera: Camera, T_colour_depth: FloatArray, rig: Rig, sensor: DepthSensor
) -> FloatArray:
    """Move a depth map into another camera.

    Squares of four pixels whose depths go together (`neighbour_step`) are drawn as two triangles; of several that fall
    on a pixel the nearest is seen. Between surfaces nothing is drawn.

    Parameters
    ----------
    depth : (h, w) float64
        z in the depth camera, m; NaN where not known.
    camera : Camera
        The depth camera; of a lens that OpenCV knows.
    T_colour_depth : (4, 4) float64
        Maps points of the depth camera's frame to the other's, m.
    rig : Rig
        The other camera, without distortion.
    sensor : DepthSensor
        What measured the depths.

    Returns
    -------
    (H, W) float64
        z in the other camera, m; NaN where nothing is known.

    Raises
    ------
    InputError
        If the map has another size than its camera, or the motion is none.

    Examples
    --------
    >>> from tspslam.vision.depth.sensor import SENSORS
    >>> camera = Camera(fx=50, fy=50, cx=9.5, cy=7.5, width=20, height=16)
    >>> rig = Rig(fx=50, fy=50, cx=9.5, cy=7.5, width=20, height=16)
    >>> moved = register_depth(np.full((16, 20), 2.0), camera, np.eye(4), rig, SENSORS["structured_light"])
    >>> bool(np.allclose(moved, 2.0))
    True
    """
    from ._registration import draw_depth

    if depth.shape != (camera.height, camera.width):
        size = f"{depth.shape[1]} x {depth.shape[0]}"
        raise InputError(f"depth map is {size} px, but its camera has {camera.width} x {camera.height} px")
    if np.shape(T_colour_depth) != (4, 4) or not is_rigid(np.asarray(T_colour_depth, np.float64)):
        raise InputError(f"T_colour_depth is {told(T_colour_depth)}, expected a (4, 4) rigid motion")
    x, y = rays_of(camera)
    R, t = T_colour_depth[:3, :3], T_colour_depth[:3, 3]
    X, Y, Z = (depth * (R[k, 0] * x + R[k, 1] * y + R[k, 2]) + t[k] for k in range(3))
    with np.errstate(invalid="ignore", divide="ignore"):
        near = np.where(Z > _NEAREST, 1 / Z, np.nan)
    u = rig.cx + (rig.fx * X + rig.skew * Y) * near
    v = rig.cy + rig.fy * Y * near
    inverse = np.zeros((rig.height, rig.width))
    draw_depth(u, v, near, neighbour_step(depth, camera.fx, sensor), depth, inverse)
    with np.errstate(divide="ignore"):
        return np.where(inverse > 0, 1 / inverse, np.nan)


def rays_of(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Directions (x, y, 1) that the pixels of a camera see.

    Parameters
    ----------
    camera : Camera
        Of a lens that OpenCV knows.

    Returns
    -------
    x, y : (h, w) float64
    """
    import cv2

    K, lens = opencv_lens(camera)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    if not any(camera.distortion):
        y = (v - camera.cy) / camera.fy
        return (u - camera.cx - camera.skew * y) / camera.fx, y
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    undistort = cv2.fisheye.undistortPoints if camera.lens == "equidistant" else cv2.undistortPoints
    rays = undistort(pixels, K, lens).reshape(camera.height, camera.width, 2)
    return np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])


def opencv_lens(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Intrinsic matrix and distortion of a camera as OpenCV takes them.

    Parameters
    ----------
    camera : Camera
        The camera.

    Returns
    -------
    K : (3, 3) float64
    distortion : (n,) float64

    Raises
    ------
    InputError
        If OpenCV does not know its lens, or it has skew and distortion.
    """
    known = ("brown", "rational", "thin_prism", "equidistant")
    if camera.lens not in known:
        raise InputError(f"camera of depth or colour: its lens is {camera.lens}, expected one of {', '.join(known)}")
    if camera.skew and any(camera.distortion):
        raise InputError(f"camera of depth or colour: skew is {camera.skew:g} px, expected 0 with a distortion")
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)
    return K, np.array(camera.distortion, np.float64)
