"""COLMAP's text model of one rig of two cameras, without images."""

from __future__ import annotations

import numpy as np

from .....types import Camera, FloatArray, RawRig, Rig
from ..readers.colmap import TO_CENTRE
from ._numbers import as_raw, check_no_skew, said

_EMPTY = ("frames.txt", "images.txt", "points3D.txt")  # COLMAP reads a model only with these


def colmap_files(cameras: Rig | RawRig) -> dict[str, str]:
    """Write ``cameras.txt`` and ``rigs.txt``, and empty lists of the rest of a model; the left camera is the reference.

    Parameters
    ----------
    cameras : Rig or RawRig
        The cameras; their lenses are some of COLMAP's.

    Returns
    -------
    dict of str
        Five texts.

    Raises
    ------
    InputError
        If a camera has a skew, which COLMAP's models have not.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> colmap_files(rig)["cameras.txt"].splitlines()[0]
    '1 PINHOLE 640 480 500.0 500.0 320.5 240.5'
    """
    rig = as_raw(cameras) if isinstance(cameras, Rig) else cameras
    check_no_skew(rig, "colmap")
    T = np.array(rig.T_right_left, np.float64)
    pose = " ".join(map(said, (*quaternion(T[:3, :3]), *T[:3, 3].tolist())))
    texts = {
        "cameras.txt": _camera(1, rig.left) + _camera(2, rig.right),
        "rigs.txt": f"1 2 CAMERA 1 CAMERA 2 1 {pose}\n",
    }
    return texts | dict.fromkeys(_EMPTY, "# none\n")


def _camera(number: int, camera: Camera) -> str:
    """A line: the simplest of COLMAP's models that has all coefficients which are not 0."""
    values = camera.distortion
    if camera.lens == "equidistant":
        model = "OPENCV_FISHEYE"
    elif camera.lens == "rational" or values[4] != 0:
        model, values = "FULL_OPENCV", (*values, 0.0, 0.0, 0.0)[:8]
    elif any(values):
        model, values = "OPENCV", values[:4]
    else:
        model, values = "PINHOLE", ()
    numbers = (camera.fx, camera.fy, camera.cx + TO_CENTRE, camera.cy + TO_CENTRE, *values)
    size = f"{int(camera.width)} {int(camera.height)}"
    return f"{number} {model} {size} {' '.join(map(said, numbers))}\n"


def quaternion(R: FloatArray) -> tuple[float, float, float, float]:
    """Return the quaternion w, x, y, z, w not negative, of a rotation.

    Parameters
    ----------
    R : (3, 3) float64
        The rotation.

    Returns
    -------
    tuple of 4 floats

    Examples
    --------
    >>> quaternion(np.eye(3))
    (1.0, 0.0, 0.0, 0.0)
    """
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    sign = -1.0 if w < 0 else 1.0
    return sign * w, sign * x + 0.0, sign * y + 0.0, sign * z + 0.0
