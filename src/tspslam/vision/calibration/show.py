"""What a calibration file says, for a person to check, or to be written in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import InputError
from ...types import LENSES, RawRig, Rig
from ..rig import doubts
from .formats import Calibration, read_calibration
from .rectify import rectification

Size = tuple[int, int]
_PIXELS = frozenset({"fx", "fy", "cx", "cy", "width", "height", "skew", "doffs"})


def described(file: Path, size: Size | None = None) -> dict[str, Any]:
    """Describe a calibration file: ``format``, ``kind``, ``values`` with their origin, ``remarks``.

    Parameters
    ----------
    file : path
        As `read_calibration` takes it.
    size : (width, height), optional
        Of the images, px.

    Returns
    -------
    dict
        Plain, fit for JSON; of raw cameras also the values after rectification, as ``rectified.fx``.

    Raises
    ------
    InputError
        If the file cannot be understood, or its cameras cannot be rectified.
    """
    found = read_calibration(file, size)
    cameras = found.cameras
    is_raw = isinstance(cameras, RawRig)
    rig = _rectified(file, cameras)
    rows = _raw_values(cameras) if isinstance(cameras, RawRig) else dict(vars(rig))
    values = {name: {"value": value, "origin": found.origin.get(name, "0 by default")} for name, value in rows.items()}
    if is_raw:
        values |= {f"rectified.{name}": {"value": value, "origin": "computed"} for name, value in vars(rig).items()}
    kind = "two raw cameras" if is_raw else "a rectified pair" if rig.baseline else "a single camera"
    return {"format": found.format, "kind": kind, "values": values, "remarks": _remarks(found, rig)}


def unit_of(name: str) -> str:
    """Return the unit of a value of `described`; empty for a plain number, and for a matrix.

    Parameters
    ----------
    name : str
        Such as ``"left.fx"``.

    Returns
    -------
    str

    Examples
    --------
    >>> unit_of("rectified.fx"), unit_of("baseline"), unit_of("left.k1")
    ('px', 'm', '')
    """
    last = name.split(".")[-1]
    return "px" if last in _PIXELS else "m" if last == "baseline" else ""


def converted(file: Path, size: Size | None = None, rectify: bool = False) -> tuple[Rig | RawRig, list[str]]:
    """Return the cameras of a calibration file as they are to be written, and remarks on them.

    Parameters
    ----------
    file : path
        As `read_calibration` takes it.
    size : (width, height), optional
        Of the images, px.
    rectify : bool
        Whether to return the rectified pair in place of raw cameras.

    Returns
    -------
    cameras : Rig or RawRig
    remarks : list of str

    Raises
    ------
    InputError
        As `described`.
    """
    found = read_calibration(file, size)
    rig = _rectified(file, found.cameras)
    return rig if rectify else found.cameras, _remarks(found, rig)


def _rectified(file: Path, cameras: Rig | RawRig) -> Rig:
    try:
        return rectification(cameras).rig if isinstance(cameras, RawRig) else cameras
    except InputError as error:
        raise InputError(f"{file}: {error}") from error


def _remarks(found: Calibration, rig: Rig) -> list[str]:
    return [*found.remarks, *doubts(rig)]


def _raw_values(cameras: RawRig) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for side, camera in (("left", cameras.left), ("right", cameras.right)):
        plain = {name: value for name, value in vars(camera).items() if name not in ("distortion", "lens")}
        lens = dict(zip(LENSES[camera.lens], camera.distortion, strict=True))
        values |= {f"{side}.{name}": value for name, value in (plain | lens).items()}
    return values | {"T_right_left": [list(row) for row in cameras.T_right_left]}
