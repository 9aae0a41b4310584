"""Kalibr's camera chain: a mapping of cam0, cam1, each with its lens and its pose relative to the one before."""

from __future__ import annotations

from ._calibration import Calibration, raw
from ._source import Source
from ._values import Found, Size, agreed_size, distortion, from_list, pose, size_from_list

KIND = "Kalibr camchain"


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
        If a value is missing or out of range, or a lens is no pinhole, with Brown's distortion or without.

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
    return raw(source, sides, (pose(right, "T_cn_cnm1"), "cam1.T_cn_cnm1"), KIND, further)


def _side(source: Source) -> Found:
    model = source.text("camera_model", "pinhole")
    if model != "pinhole":
        raise source.wrong("camera_model", model, "pinhole")
    lens, warp = from_list(source, "intrinsics"), source.text("distortion_model", "radtan or none")
    if warp not in ("radtan", "none"):
        raise source.wrong("distortion_model", warp, "radtan (k1, k2, p1, p2) or none")
    if warp == "radtan":
        lens |= distortion(source, "distortion_coeffs", 4)
    return lens | size_from_list(source, "resolution")
