"""Basalt's calibration: JSON with a list of cameras, their poses in the IMU's frame, and their sizes."""

from __future__ import annotations

from typing import Any

from .....types import LENSES, FloatArray
from .._calibration import Calibration, Remarks, raw
from .._source import Source
from .._values import Found, Size, agreed_size, from_keys, inverse, motion, size_from_list, turned, with_lens

KIND = "Basalt calibration"
_LENSES = {
    "pinhole": "brown",
    "pinhole-radtan8": "rational",
    "kb4": "equidistant",
    "ds": "double_sphere",
    "eucm": "eucm",
    "ucm": "eucm",
}
"""For each model of Basalt's: ours; ucm is eucm of beta 1."""


def is_basalt(source: Source) -> bool:
    """Tell whether a mapping is a calibration of Basalt.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    inner = source.values.get("value0")
    return isinstance(inner, dict) and ("intrinsics" in inner or "T_imu_cam" in inner)


def read_basalt(source: Source, size: Size | None = None) -> Calibration:
    """Read the first camera as the left and the second as the right one; ``T_right_left = T_imu_cam1⁻¹ T_imu_cam0``.

    Parameters
    ----------
    source : Source
        The file.
    size : (width, height), optional
        Of the images, px; it must be the file's.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing or out of range, or a camera is none of pinhole, pinhole-radtan8, kb4, ds, eucm, ucm.

    Examples
    --------
    >>> camera = {"camera_type": "ds", "intrinsics": {"fx": 158, "fy": 158, "cx": 254, "cy": 256, "xi": -0.2}}
    >>> camera["intrinsics"]["alpha"] = 0.6
    >>> poses = [{"px": x, "py": 0, "pz": 0, "qx": 0, "qy": 0, "qz": 0, "qw": 1} for x in (0, 0.1)]
    >>> file = {"T_imu_cam": poses, "intrinsics": [camera] * 2, "resolution": [[512, 512]] * 2}
    >>> cameras = read_basalt(Source("calibration.json", {"value0": file})).cameras
    >>> cameras.left.lens, cameras.left.distortion
    ('double_sphere', (-0.2, 0.6))
    """
    inner = source.part("value0")
    sides = [_side(inner, at) for at in (0, 1)]
    agreed_size(source, sides[0], size)
    left, right = (_pose(_item(inner, "T_imu_cam", at)) for at in (0, 1))
    origin = f"inverse of {inner.label('T_imu_cam[1]')}, {inner.label('T_imu_cam[0]')}"
    return raw(source, (sides[0], sides[1]), (inverse(right) @ left, origin), KIND, _remarks(inner))


def _side(source: Source, at: int) -> Found:
    camera = _item(source, "intrinsics", at)
    kind = camera.text("camera_type", ", ".join(_LENSES))
    if kind not in _LENSES:
        raise camera.wrong("camera_type", kind, f"one of {', '.join(_LENSES)}")
    part, lens = camera.part("intrinsics"), _LENSES[kind]
    found = from_keys(part, "")
    if kind == "ucm":
        found |= from_keys(part, "", ("alpha",)) | {"beta": (1.0, "1 of ucm")}
    elif lens != "brown":
        found |= from_keys(part, "", LENSES[lens])
    return with_lens(found, lens, camera.label("camera_type")) | _size(source, at)


def _size(source: Source, at: int) -> Found:
    rows = _list(source, "resolution", at)
    return size_from_list(Source(source.path, {f"resolution[{at}]": rows[at]}, source.prefix), f"resolution[{at}]")


def _pose(part: Source) -> FloatArray:
    quaternion = [part.number(key) for key in ("qw", "qx", "qy", "qz")]
    return motion(turned(part, "qw", quaternion), [part.number(key) for key in ("px", "py", "pz")])


def _item(source: Source, key: str, at: int) -> Source:
    """A mapping in a list, as a source of its own."""
    name = f"{key}[{at}]"
    return Source(source.path, {name: _list(source, key, at)[at]}, source.prefix).part(name)


def _list(source: Source, key: str, at: int) -> list[Any]:
    values = source.value(key, "a list of two cameras")
    if not isinstance(values, list) or len(values) <= at:
        raise source.wrong(key, values, "a list of two cameras")
    return values


def _remarks(source: Source) -> Remarks:
    remarks = []
    if len(source.values["intrinsics"]) > 2:
        remarks.append("the cameras after the second are not read")
    if any("rpmax" in _item(source, "intrinsics", at).part("intrinsics") for at in (0, 1)):
        remarks.append("rpmax, how far from the axis the lens holds, is not read")
    return tuple(remarks)
