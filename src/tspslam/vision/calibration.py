"""Calibration files: a flat YAML mapping of plain numbers."""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from ..errors import InputError
from ..types import POSITIVE, Rig

LARGEST_FILE = 1 << 20  # bytes
_REQUIRED = ("fx", "fy", "cx", "cy", "baseline", "width", "height")
_OPTIONAL = ("skew", "doffs")
_RAW = ("left", "right", "T_right_left")
_COUNTS = frozenset({"width", "height"})
_LARGEST_COUNT = 1_000_000


def load_rig(path: str | os.PathLike[str]) -> Rig:
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
    mapping = _parse(path, _read(path))
    _check_keys(path, mapping)
    numbers: dict[str, Any] = {key: _number(path, key, value) for key, value in mapping.items()}
    return Rig(**numbers)


def save_rig(rig: Rig, path: str | os.PathLike[str]) -> None:
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

    lines = [f"{key}: {_plain(getattr(rig, key))}" for key in (*_REQUIRED, *_OPTIONAL)]
    write_bytes(path, ("\n".join(lines) + "\n").encode("ascii"))


class _PlainLoader(yaml.SafeLoader):
    """YAML without anchors, aliases, tags or repeated keys."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise yaml.MarkedYAMLError(problem="anchors and aliases are not allowed", problem_mark=event.start_mark)
        if getattr(event, "tag", None) is not None:
            raise yaml.MarkedYAMLError(problem=f"the tag {event.tag} is not allowed", problem_mark=event.start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for place, key in enumerate(keys):
            if key in keys[:place]:
                raise yaml.MarkedYAMLError(problem=f"the key {key} is there twice", problem_mark=node.start_mark)
        return super().construct_mapping(node, deep)


def _read(path: str | os.PathLike[str]) -> bytes:
    try:
        with open(path, "rb") as handle:
            content = handle.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise InputError(f"{path}: cannot be read ({reason}), expected a calibration file") from error
    if len(content) > LARGEST_FILE:
        raise InputError(f"{path}: is larger than {LARGEST_FILE} bytes, expected a calibration file")
    return content


def _parse(path: str | os.PathLike[str], content: bytes) -> dict[Any, Any]:
    try:
        data = yaml.load(content.decode("utf-8-sig"), Loader=_PlainLoader)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f" in line {error.problem_mark.line + 1}"
        raise InputError(f"{path}: is not plain YAML: {error.problem}{line}") from error
    except (yaml.YAMLError, ValueError, LookupError, TypeError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: is not plain YAML: {reason}") from error
    if not isinstance(data, dict):
        kind = "empty" if data is None else f"a {type(data).__name__}"
        raise InputError(f"{path}: is {kind}, expected a mapping with the keys {', '.join(_REQUIRED)}")
    return data


def _check_keys(path: str | os.PathLike[str], mapping: dict[Any, Any]) -> None:
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


def _number(path: str | os.PathLike[str], key: str, value: Any) -> float | int:
    place = f"{Path(path)}: {key} is"
    wanted = "a positive whole number" if key in _COUNTS else "a positive number" if key in POSITIVE else "a number"
    shown = " ".join(repr(value).split())[:60]
    if isinstance(value, str) and _reads_as_number(value):
        raise InputError(f"{place} the text {shown}, expected {wanted} (in YAML 1e5 is text: write 1.0e+5, no quotes)")
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{place} {shown}, expected {wanted}")
    if key in _COUNTS and (not isinstance(value, int) or value > _LARGEST_COUNT):
        raise InputError(f"{place} {shown}, expected {wanted} of at most {_LARGEST_COUNT}")
    if abs(value) > 1e300 or not math.isfinite(value) or (key in POSITIVE and value <= 0):
        raise InputError(f"{place} {shown}, expected {wanted}, finite")
    return value if key in _COUNTS else float(value)


def _reads_as_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _plain(value: float | int) -> str:
    """Shortest text that YAML reads back as the same number; 1e-05 would be text."""
    text = repr(value)
    mantissa, mark, exponent = text.partition("e")
    if not mark:
        return text
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{int(exponent):+d}"
