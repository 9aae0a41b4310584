"""Calibration files: a flat YAML mapping of plain numbers."""

from __future__ import annotations

import difflib
import math
from typing import Any

from .._files import PathLike, one_line
from .._yaml import read_yaml
from ..errors import InputError
from ..types import Rig

_REQUIRED = ("fx", "fy", "cx", "cy", "baseline", "width", "height")
_OPTIONAL = ("skew", "doffs")
_RAW = ("left", "right", "T_right_left")
_COUNTS = frozenset({"width", "height"})


def load_rig(path: PathLike) -> Rig:
    """Read a calibration file of a rectified pair.

    The file is a YAML mapping of plain numbers: ``fx fy cx cy baseline width height`` and, where they are not 0,
    ``skew`` and ``doffs``. Units: px, and metres for the baseline.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Rig

    Raises
    ------
    InputError
        If the file cannot be read, is over 1 MiB, is not such a mapping, or uses tags, anchors or aliases; if a key is
        unknown, missing or twice there; or if a value is not a number in its range.

    Examples
    --------
    >>> import tempfile
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_rig(rig, f"{folder}/calib.yaml")
    ...     load_rig(f"{folder}/calib.yaml") == rig
    True
    """
    mapping = read_yaml(path, "a calibration file")
    if not isinstance(mapping, dict):
        kind = "blank" if mapping is None else f"a {type(mapping).__name__}"
        raise InputError(f"{path}: is {kind}, expected a mapping with the keys {', '.join(_REQUIRED)}")
    _check_keys(path, mapping)
    numbers: dict[str, Any] = {key: _number(path, key, value) for key, value in mapping.items()}
    try:
        return Rig(**numbers)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def save_rig(rig: Rig, path: PathLike) -> None:
    """Write a calibration file that `load_rig` reads back exactly.

    Parameters
    ----------
    rig : Rig
        The cameras.
    path : str or path
        The file; it is replaced as a whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_rig(rig, f"{folder}/calib.yaml")
    """
    from .._atomic import write_bytes

    lines = [f"{key}: {getattr(rig, key)!r}" for key in (*_REQUIRED, *_OPTIONAL)]
    write_bytes(path, ("\n".join(lines) + "\n").encode("ascii"))


def _check_keys(path: PathLike, mapping: dict[Any, Any]) -> None:
    for key in mapping:
        if key in _RAW:
            raise InputError(f"{path}: has the key {key}; raw pairs are not supported yet, expected a rectified one")
    known = (*_REQUIRED, *_OPTIONAL)
    for key in mapping:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"expected {', '.join(known)}"
            raise InputError(f"{path}: unknown key {str(key)[:40]!r}; {hint}")
    missing = [key for key in _REQUIRED if key not in mapping]
    if missing:
        raise InputError(f"{path}: lacks {', '.join(missing)}, expected {', '.join(_REQUIRED)}")


def _number(path: PathLike, key: str, value: Any) -> float | int:
    """A value as `Rig` takes it; whether it is in range, `Rig` says."""
    wanted = "a whole number" if key in _COUNTS else "a number"
    if isinstance(value, bool) or not isinstance(value, int if key in _COUNTS else int | float):
        shown = one_line(repr(value))[:60]
        quotes = " without quotes" if isinstance(value, str) and _reads_as_number(value) else ""
        raise InputError(f"{path}: {key} is {shown}, expected {wanted}{quotes}")
    return value if key in _COUNTS or abs(value) > 1 << 53 else float(value)


def _reads_as_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
