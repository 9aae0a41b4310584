"""ROS's ``camera_info`` files, ``left.yaml`` and ``right.yaml``."""

from __future__ import annotations

import numpy as np

from .....types import Camera, FloatArray, RawRig, Rig
from ._numbers import listed, matrix, projections

_MODELS = {"brown": "plumb_bob", "rational": "rational_polynomial", "equidistant": "equidistant"}


def ros_files(cameras: Rig | RawRig) -> dict[str, str]:
    """Write a file a camera; rotations and projections of raw cameras are those of `rectification`.

    Parameters
    ----------
    cameras : Rig or RawRig
        The cameras; their lenses are some of ROS's.

    Returns
    -------
    dict of str
        Two texts.

    Raises
    ------
    InputError
        If raw cameras cannot be rectified.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> ros_files(rig)["right.yaml"].splitlines()[-1]
    '  data: [500.0, 0.0, 320.0, -50.0, 0.0, 500.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]'
    """
    if isinstance(cameras, Rig):
        rig, turns = cameras, (np.eye(3), np.eye(3))
        size = cameras.width, cameras.height
        seen = [Camera(rig.fx, rig.fy, cx, rig.cy, *size, skew=rig.skew) for cx in (rig.cx, rig.cx + rig.doffs)]
    else:
        from ...rectify import rectification

        made = rectification(cameras)
        rig, turns, seen = made.rig, (made.R_left, made.R_right), [cameras.left, cameras.right]
    sides = zip(("left", "right"), seen, turns, projections(rig), strict=True)
    return {f"{side}.yaml": _info(side, camera, R, P) for side, camera, R, P in sides}


def _info(side: str, camera: Camera, R: FloatArray, P: FloatArray) -> str:
    D = np.array([camera.distortion], np.float64)
    tables = (
        f"image_width: {int(camera.width)}\nimage_height: {int(camera.height)}\ncamera_name: {side}\n"
        f"{_matrix('camera_matrix', matrix(camera))}"
        f"distortion_model: {_MODELS[camera.lens]}\n"
        f"{_matrix('distortion_coefficients', D)}"
    )
    return f"{tables}{_matrix('rectification_matrix', R)}{_matrix('projection_matrix', P)}"


def _matrix(name: str, values: FloatArray) -> str:
    rows, columns = values.shape
    return f"{name}:\n  rows: {rows}\n  cols: {columns}\n  data: {listed(values.ravel().tolist())}\n"
