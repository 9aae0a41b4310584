"""Kalibr's camera chain: a mapping of cam0, cam1, each with its lens and its pose relative to the one before."""

from __future__ import annotations

from .....types import FloatArray
from .._calibration import Calibration, raw
from .._source import Source
from .._values import (
    Found,
    Size,
    agreed_size,
    coefficients,
    distortion,
    from_list,
    inverse,
    pose,
    size_from_list,
    with_lens,
)

KIND = "Kalibr camchain"
_PINHOLE = ("fx", "fy", "cx", "cy")
_INTRINSICS = {
    "pinhole": _PINHOLE,
    "omni": ("xi", *_PINHOLE),
    "ds": ("xi", "alpha", *_PINHOLE),
    "eucm": ("alpha", "beta", *_PINHOLE),
}
_LENSES = {
    "pinhole-radtan": "brown",
    "pinhole-none": "brown",
    "pinhole-equidistant": "equidistant",
    "pinhole-equi": "equidistant",
    "omni-radtan": "mei",
    "omni-none": "mei",
    "ds-none": "double_sphere",
    "eucm-none": "eucm",
}
"""For each model of Kalibr's: ours."""


def is_kalibr(source: Source) -> bool:
    """Tell whether a mapping is a camera chain.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    return any(isinstance(source.values.get(name), dict) for name in ("cam0", "cam1"))


def read_kalibr(source: Source, size: Size | None = None) -> Calibration:
    """Read cam0 as the left and cam1 as the right camera; ``T_cn_cnm1`` of cam1 is ``T_right_left``.

    Where it is not there, both cameras' ``T_cam_imu`` or ``T_imu_cam`` tell it, as in files for OpenVINS.

    Parameters
    ----------
    source : Source
        The camera chain.
    size : (width, height), optional
        Of the images, px; it must be the file's.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing or out of range, or a lens is none of pinhole-radtan, pinhole-equi, omni-radtan, ds-none,
        eucm-none.

    Examples
    --------
    >>> camera = {"camera_model": "pinhole", "intrinsics": [500, 500, 320, 240], "resolution": [640, 480]}
    >>> camera |= {"distortion_model": "radtan", "distortion_coeffs": [-0.3, 0.1, 0, 0]}
    >>> beside = [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    >>> chain = Source("camchain.yaml", {"cam0": camera, "cam1": camera | {"T_cn_cnm1": beside}})
    >>> read_kalibr(chain).cameras.left.distortion
    (-0.3, 0.1, 0.0, 0.0, 0.0)
    """
    left, right = source.part("cam0"), source.part("cam1")
    sides = _side(left), _side(right)
    agreed_size(source, sides[0], size)
    further = ("cam2 and what follows it are not read",) if "cam2" in source else ()
    return raw(source, sides, _pose(left, right), KIND, further)


def _pose(left: Source, right: Source) -> tuple[FloatArray, str]:
    """T_right_left and its keys."""
    if "T_cn_cnm1" not in right:
        if "T_cam_imu" in left and "T_cam_imu" in right:
            T_right_left = pose(right, "T_cam_imu") @ inverse(pose(left, "T_cam_imu"))
            return T_right_left, "cam1.T_cam_imu, inverse of cam0.T_cam_imu"
        if "T_imu_cam" in left and "T_imu_cam" in right:
            T_right_left = inverse(pose(right, "T_imu_cam")) @ pose(left, "T_imu_cam")
            return T_right_left, "inverse of cam1.T_imu_cam, cam0.T_imu_cam"
    return pose(right, "T_cn_cnm1"), "cam1.T_cn_cnm1"


def _side(source: Source) -> Found:
    model, warp = source.text("camera_model", "pinhole"), source.text("distortion_model", "radtan, equidistant or none")
    lens = _LENSES.get(f"{model}-{warp}")
    if lens is None:
        known = ", ".join(name for name in _LENSES if name != "pinhole-equidistant")
        key = "distortion_model" if model in _INTRINSICS else "camera_model"
        raise source.wrong(key, source.values[key], f"one of {known} ({model}-{warp} is not supported)")
    found = from_list(source, "intrinsics", _INTRINSICS[model])
    if warp == "radtan":
        found |= distortion(source, "distortion_coeffs", 4)
    if lens == "equidistant":
        found |= coefficients(source, "distortion_coeffs", lens, source.label("distortion_model"))
    else:
        found = with_lens(found, lens, source.label("camera_model"))
    return found | size_from_list(source, "resolution")
