"""RealSense T265's own calibration: JSON with a list of cameras, their lenses, sizes, and poses in the body's frame."""

from __future__ import annotations

import numpy as np

from .....types import FloatArray
from .._calibration import Calibration, Remarks, raw
from .._source import Source
from .._values import Found, Size, agreed_size, coefficients, from_list, inverse, motion, size_from_list, turned

KIND = "RealSense T265 calibration"
_FISHEYE, _PINHOLE = "kannalabrandt4", "undistorted"
_TYPES = f"{_FISHEYE} or {_PINHOLE} (the FOV model, 'fisheye', and 'polynomial' are not read)"


def is_t265(source: Source) -> bool:
    """Tell whether a mapping is a calibration of a T265.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    listed = source.values.get("cameras")
    return isinstance(listed, list) and any(isinstance(each, dict) and "focal_length_px" in each for each in listed)


def read_t265(source: Source, size: Size | None = None) -> Calibration:
    """Read the first camera as the left and the second as the right one; ``T_right_left = T_body_cam1⁻¹ T_body_cam0``.

    A pose is a rotation vector W, radians, and a translation T, m: ``x_body = exp(W) x_camera + T``.

    Parameters
    ----------
    source : Source
        The file.
    size : (width, height), optional
        Of the images, px; it must be the file's, where that has one.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing or out of range, or a lens is neither kannalabrandt4 nor undistorted.

    Examples
    --------
    >>> lens = {"type": "kannalabrandt4", "k": [-0.004, 0.037, -0.035, 0.006]}
    >>> camera = {"size_px": [848, 800], "center_px": [419, 387], "focal_length_px": [286, 287], "distortion": lens}
    >>> poses = [{"T": [x, 0, 0], "W": [0, 0, 0]} for x in (0.0, 0.064)]
    >>> cameras = read_t265(Source("t265.json", {"cameras": [camera | {"extrinsics": T} for T in poses]})).cameras
    >>> cameras.left.lens, cameras.T_right_left[0]
    ('equidistant', (1.0, 0.0, 0.0, -0.064))
    """
    left, right = (_camera(source, at) for at in (0, 1))
    sides = _side(left, size), _side(right, size)
    T_body_left, T_body_right = _pose(left), _pose(right)
    origin = f"inverse of {right.label('extrinsics')}, {left.label('extrinsics')}"
    return raw(source, sides, (inverse(T_body_right) @ T_body_left, origin), KIND, _remarks(source))


def _camera(source: Source, at: int) -> Source:
    listed = source.values["cameras"]
    if len(listed) <= at:
        raise source.wrong("cameras", f"a list of {len(listed)}", "a list of two cameras")
    return Source(source.path, {f"cameras[{at}]": listed[at]}).part(f"cameras[{at}]")


def _side(camera: Source, size: Size | None) -> Found:
    found = from_list(camera, "focal_length_px", ("fx", "fy")) | from_list(camera, "center_px", ("cx", "cy"))
    found |= agreed_size(camera, size_from_list(camera, "size_px") if "size_px" in camera else None, size)
    lens = camera.part("distortion")
    kind = lens.text("type", _TYPES)
    if kind not in (_FISHEYE, _PINHOLE):
        raise lens.wrong("type", kind, _TYPES)
    return found | coefficients(lens, "k", "equidistant", lens.label("type")) if kind == _FISHEYE else found


def _pose(camera: Source) -> FloatArray:
    """T_body_camera."""
    part = camera.part("extrinsics")
    if "W" not in part and "R" in part:
        raise part.error(f"{part.label('R')} may be by rows or by columns, expected a rotation vector W, radians")
    W = np.array(part.vector("W", 3))
    angle = float(np.linalg.norm(W))
    if angle > 2 * np.pi:
        raise part.wrong("W", W.tolist(), "a rotation vector of at most a turn, radians")
    axis = W / angle if angle > 0 else W
    half = [float(np.cos(angle / 2)), *(np.sin(angle / 2) * axis).tolist()]
    return motion(turned(part, "W", half), part.vector("T", 3))


def _remarks(source: Source) -> Remarks:
    return ("the cameras after the second are not read",) if len(source.values["cameras"]) > 2 else ()
