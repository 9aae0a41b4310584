"""What a calibration file says, for a person to check, or to be written in another format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...errors import InputError
from ...types import LENSES, Camera, RawRig, Rig
from ..rig import doubts
from .formats import Calibration, read_calibration
from .lenses import field_of_view
from .rectify import rectification

Size = tuple[int, int]
_UNITS = {"baseline": "m", "field_of_view": "°"}
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
        Plain, fit for JSON; of raw cameras also the values after rectification, as ``rectified.fx``, and the fields of
        view across their images before and after it.

    Raises
    ------
    InputError
        If the file cannot be understood, or its cameras cannot be rectified.
    """
    found = read_calibration(file, size)
    cameras = found.cameras
    rig = _rectified(file, cameras)
    rows = _raw_values(cameras) if isinstance(cameras, RawRig) else dict(vars(rig))
    values = {name: {"value": value, "origin": found.origin.get(name, _default(name))} for name, value in rows.items()}
    if isinstance(cameras, RawRig):
        values |= {name: {"value": value, "origin": "computed"} for name, value in _computed(cameras, rig).items()}
    kind = (
        "two raw cameras" if isinstance(cameras, RawRig) else "a rectified pair" if rig.baseline else "a single camera"
    )
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
    return "px" if last in _PIXELS else _UNITS.get(last, "")


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
        plain = {name: value for name, value in vars(camera).items() if name != "distortion"}
        lens = dict(zip(LENSES[camera.lens], camera.distortion, strict=True))
        values |= {f"{side}.{name}": value for name, value in (plain | lens).items()}
    stated = {} if cameras.field_of_view is None else {"field_of_view": cameras.field_of_view}
    return values | {"T_right_left": [list(row) for row in cameras.T_right_left]} | stated


def _default(name: str) -> str:
    """Where a value that no file has comes from."""
    return "by default" if name.endswith(".lens") else "0 by default"


def _computed(cameras: RawRig, rig: Rig) -> dict[str, Any]:
    """The rectified pair, and how wide the images are before and after, degrees."""
    before = {f"{side}.field_of_view": field_of_view(getattr(cameras, side))[0] for side in ("left", "right")}
    after = Camera(rig.fx, rig.fy, rig.cx, rig.cy, rig.width, rig.height)
    rectified = {**vars(rig), "field_of_view": field_of_view(after)[0]}
    return before | {f"rectified.{name}": value for name, value in rectified.items()}
