"""Kalibr's camera chain."""

from __future__ import annotations

from .....errors import InputError
from .....types import Camera, RawRig, Rig
from ._numbers import as_raw, check_no_skew, listed

_MODELS = {  # of each lens: Kalibr's camera and distortion model, how many coefficients are of the camera
    "brown": ("pinhole", "radtan", 0),
    "equidistant": ("pinhole", "equidistant", 0),
    "mei": ("omni", "radtan", 1),
    "double_sphere": ("ds", "none", 2),
    "eucm": ("eucm", "none", 2),
}


def kalibr_files(cameras: Rig | RawRig) -> dict[str, str]:
    """Write a pair as a chain of cam0 and cam1.

    Parameters
    ----------
    cameras : Rig or RawRig
        The cameras; their lenses are some of Kalibr's.

    Returns
    -------
    dict of str
        One text.

    Raises
    ------
    InputError
        If a camera has a skew or a k3, which Kalibr's models have not.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> kalibr_files(rig)["camchain.yaml"].splitlines()[:3]
    ['cam0:', '  camera_model: pinhole', '  intrinsics: [500.0, 500.0, 320.0, 240.0]']
    """
    rig = as_raw(cameras) if isinstance(cameras, Rig) else cameras
    check_no_skew(rig, "kalibr")
    pose = "".join(f"  - {listed(row)}\n" for row in rig.T_right_left)
    left, right = (_camera(name, camera) for name, camera in (("left", rig.left), ("right", rig.right)))
    return {
        "camchain.yaml": f"cam0:\n{left}  cam_overlaps: [1]\ncam1:\n{right}  cam_overlaps: [0]\n  T_cn_cnm1:\n{pose}"
    }


def _camera(name: str, camera: Camera) -> str:
    model, warp, own = _MODELS[camera.lens]
    values, rest = camera.distortion[:own], camera.distortion[own:]
    if camera.lens == "brown":
        if rest[4] != 0:
            wanted = "0, or --to ours, opencv, ros or colmap"
            raise InputError(f"the {name} lens has k3 {rest[4]:g}, which kalibr's radtan has not, expected {wanted}")
        rest = rest[:4]
    return (
        f"  camera_model: {model}\n"
        f"  intrinsics: {listed((*values, camera.fx, camera.fy, camera.cx, camera.cy))}\n"
        f"  distortion_model: {warp}\n"
        f"  distortion_coeffs: {listed(rest)}\n"
        f"  resolution: [{int(camera.width)}, {int(camera.height)}]\n"
    )
