"""Rectification to a field of view: of any lens, also one that sees more than a plane can show."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import GeometryError, InputError
from ...types import Camera, FloatArray, RawRig, Rig
from ..se3 import repeated
from .lenses import jacobian, project

LARGEST_BY_DEFAULT = 110.0
"""Degrees: a pixel at the border of the rectified image then covers a third of a middle one's angle (cos²)."""

_SMALLEST = 1.0  # degrees, as `RawRig` has it
_PRECISION = 0.01  # degrees, of the largest field of view that both cameras fill
_ROWS = 64  # whose rays are looked up at a time, so that memory does not grow with the image
LARGEST_ZOOM = 5.0
"""Of the focal length, by rectification."""
_LARGEST_ASKED = 25.0  # the same, of a field of view that somebody states: millimetres differ by a hundred and more
OUTSIDE = -1e6
"""px: where the map of a pixel points that no ray reaches."""


def turn_both(T_right_left: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Turn both cameras by half of the rotation between them, then so that x is the baseline (Bouguet).

    Returns
    -------
    R_left, R_right : (3, 3) float64
        Rotate a point of a raw camera's frame into its rectified frame.
    """
    rotation = np.eye(4)
    rotation[:3, :3] = T_right_left[:3, :3]
    half = repeated(rotation, 0.5)[:3, :3]
    along = _turn_to_x(-half.T @ T_right_left[:3, 3])
    return along @ half, along @ half.T


def _turn_to_x(direction: FloatArray) -> FloatArray:
    """The least rotation that turns a direction ahead of y and z to x."""
    x, y, z = direction / np.linalg.norm(direction)
    return np.array(
        [[x, y, z], [-y, 1 - y * y / (1 + x), -y * z / (1 + x)], [-z, -y * z / (1 + x), 1 - z * z / (1 + x)]]
    )


def wide_rig(raw: RawRig, R_left: FloatArray, R_right: FloatArray) -> Rig:
    """Rectified cameras of the raw pair's size, by its field of view or the largest that both fill."""
    asked = raw.field_of_view
    rig = _rig(raw, _largest_filled(raw, R_left, R_right) if asked is None else asked)
    for camera, R in ((raw.left, R_left), (raw.right, R_right)):
        _check_zoom(camera, R, rig, LARGEST_ZOOM if asked is None else _LARGEST_ASKED)
    return rig


def _check_zoom(camera: Camera, R: FloatArray, rig: Rig, most: float) -> None:
    """Refuse to blow up a few pixels, or to shrink all to a few: the intrinsics are in other units."""
    own = float(np.abs(np.linalg.det(jacobian(camera, R[2:])[0, :, :2])) ** 0.5)  # px to the radian, in the middle
    if not 1 / most < rig.fx / max(own, 1e-12) < most:
        raise GeometryError(
            f"raw rig: rectification would change the focal length from {own:.4g} px in the middle to {rig.fx:.4g}, "
            "expected intrinsics in px, and cameras that see one scene"
        )


def _rig(raw: RawRig, field_of_view: float) -> Rig:
    width, height = raw.left.width, raw.left.height
    f = width / 2 / np.tan(np.radians(field_of_view) / 2)
    baseline = float(np.linalg.norm(raw.matrix[:3, 3]))
    try:
        return Rig(float(f), float(f), (width - 1) / 2, (height - 1) / 2, baseline, width, height)
    except InputError as error:
        raise GeometryError(f"raw rig: a field of view of {field_of_view:g}° cannot be made ({error})") from error


def _largest_filled(raw: RawRig, R_left: FloatArray, R_right: FloatArray) -> float:
    """Largest field of view of which both cameras see the whole border, degrees."""

    def is_filled(field_of_view: float) -> bool:
        rig = _rig(raw, field_of_view)
        sides = ((raw.left, R_left), (raw.right, R_right))
        return all(_sees_border(camera, R, rig) for camera, R in sides)

    if is_filled(LARGEST_BY_DEFAULT):
        return LARGEST_BY_DEFAULT
    low, high = _SMALLEST, LARGEST_BY_DEFAULT
    if not is_filled(low):
        raise GeometryError(
            "raw rig: no field of view is seen by both cameras as a whole, expected cameras that look the same way, or "
            "a stated field_of_view, degrees"
        )
    while high - low > _PRECISION:
        middle = (low + high) / 2
        low, high = (middle, high) if is_filled(middle) else (low, middle)
    return low


def _sees_border(camera: Camera, R: FloatArray, rig: Rig) -> bool:
    u, v = np.meshgrid(np.arange(float(rig.width)), np.arange(float(rig.height)))
    u, v = (np.concatenate([each[0], each[-1], each[:, 0], each[:, -1]]) for each in (u, v))
    seen = project(camera, _rays(rig, u, v) @ R)
    return bool(((seen >= -0.5) & (seen <= (camera.width - 0.5, camera.height - 0.5))).all())


def _rays(rig: Rig, u: FloatArray, v: FloatArray) -> FloatArray:
    return np.column_stack([(u - rig.cx) / rig.fx, (v - rig.cy) / rig.fy, np.ones_like(u)])


def wide_maps(camera: Camera, R: FloatArray, rig: Rig) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of the rectified frame lies in the raw image, (u, v); `OUTSIDE` where no ray goes."""
    maps = np.empty((2, rig.height, rig.width), np.float32)
    columns = np.arange(float(rig.width))
    for top in range(0, rig.height, _ROWS):
        rows = np.arange(top, min(top + _ROWS, rig.height), dtype=np.float64)
        u, v = np.meshgrid(columns, rows)
        uv = project(camera, _rays(rig, u.ravel(), v.ravel()) @ R)
        uv[~(np.abs(uv) < -OUTSIDE).all(axis=1)] = OUTSIDE
        maps[:, top : top + len(rows)] = uv.T.reshape(2, len(rows), rig.width)
    return maps[0], maps[1]
