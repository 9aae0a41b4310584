"""OpenCV's FileStorage in YAML: the names of its stereo calibration sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .....errors import InputError
from .....types import Camera, RawRig, Rig
from ._numbers import listed, matrix, projections


def opencv_files(cameras: Rig | RawRig) -> dict[str, str]:
    """Write raw cameras as ``M1 D1 M2 D2 R T``, a rectified pair as ``P1`` and ``P2``, with the size of the images.

    Lenses of a fisheye are named by ``distortion_model: equidistant``; OpenCV itself leaves that to who reads them.

    Parameters
    ----------
    cameras : Rig or RawRig
        The cameras; their lenses are some of OpenCV's.

    Returns
    -------
    dict of str
        One text.

    Raises
    ------
    InputError
        If one lens is a fisheye and the other is not.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> opencv_files(rig)["stereo.yml"].splitlines()[2:5]
    ['image_width: 640', 'image_height: 480', 'P1: !!opencv-matrix']
    """
    if isinstance(cameras, Rig):
        P1, P2 = projections(cameras)
        parts = [_matrix("P1", P1), _matrix("P2", P2)]
    else:
        parts = [*_lenses(cameras.left, cameras.right)]
        T = np.array(cameras.T_right_left, np.float64)
        parts += [_matrix("R", T[:3, :3]), _matrix("T", T[:3, 3:])]
    camera = cameras if isinstance(cameras, Rig) else cameras.left
    size = f"image_width: {int(camera.width)}\nimage_height: {int(camera.height)}\n"
    return {"stereo.yml": f"%YAML:1.0\n---\n{size}{''.join(parts)}"}


def _lenses(left: Camera, right: Camera) -> list[str]:
    fisheyes = [camera.lens == "equidistant" for camera in (left, right)]
    if any(fisheyes) and not all(fisheyes):
        raise InputError(f"one lens is {left.lens}, the other {right.lens}: opencv has one model for both, expected so")
    parts = ["distortion_model: equidistant\n"] if all(fisheyes) else []
    for at, camera in ((1, left), (2, right)):
        parts += [_matrix(f"M{at}", matrix(camera)), _matrix(f"D{at}", [camera.distortion])]
    return parts


def _matrix(name: str, values: ArrayLike) -> str:
    table = np.asarray(values, np.float64)
    rows, columns = table.shape
    shape = f"   rows: {rows}\n   cols: {columns}\n   dt: d\n"
    return f"{name}: !!opencv-matrix\n{shape}   data: {listed(table.ravel().tolist())}\n"
