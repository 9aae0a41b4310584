"""The settings of a run as plain, deterministic YAML, and what differs between two of them."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import InputError

FORMAT = 3  # of run folders: of their names, of what stands in frames and checkpoints, of the names of settings
MARK = f"# tspslam run, format {FORMAT}\n"
_MARKED = re.compile(rb"# tspslam run(?:, format ([0-9]{1,9}))?\r?\n")
_LARGEST = 1 << 18
_DEEPEST = 20
_LONGEST = 100  # characters of a value in a message


def format_of(beginning: bytes) -> int | None:
    r"""Return the format of the run folder whose settings begin so; None if no run wrote them.

    Examples
    --------
    >>> format_of(MARK.encode()), format_of(b"# tspslam run\n"), format_of(b"detector: orb\n")
    (3, 1, None)
    """
    found = _MARKED.match(beginning)
    return int(found[1] or 1) if found else None


def plain(value: object, key: str = "", depth: int = 0) -> Any:
    """Return `value` as nested dict, list and scalars that JSON and YAML both keep exactly."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, int) and abs(value) < 1 << 63:
        return int(value)
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    if depth < _DEEPEST and isinstance(value, Mapping) and all(isinstance(name, str) for name in value):
        return {name: plain(value[name], f"{key}.{name}".lstrip("."), depth + 1) for name in sorted(value)}
    if depth < _DEEPEST and isinstance(value, Sequence) and not isinstance(value, (bytes, bytearray)):
        return [plain(each, f"{key}[{i}]", depth + 1) for i, each in enumerate(value)]
    raise InputError(
        f"config: {key or 'the whole'} is {repr(value)[:_LONGEST]}, expected text, finite numbers, lists, mappings"
    )


def hash_of(config: object) -> str:
    """Return the SHA-256 of plain settings, 64 hexadecimal digits."""
    text = json.dumps(config, sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def dump(config: object) -> bytes:
    """Return plain settings as YAML behind our mark."""
    from .._yaml import dump_yaml

    return (MARK + dump_yaml(config)).encode("ascii")


def load(data: bytes) -> Any:
    """Return the settings that `dump` wrote, maybe edited since."""
    from .._yaml import parse_yaml

    if len(data) > _LARGEST:
        raise InputError(f"has {len(data)} bytes, where {_LARGEST} go")
    try:
        return plain(parse_yaml(data.decode("utf-8")))
    except ValueError as error:
        raise InputError(f"is not plain YAML ({' '.join(str(error).split())[:100]})") from error


def differences(old: object, new: object, key: str = "") -> list[str]:
    """Return a line for each key whose value differs."""
    if isinstance(old, dict) and isinstance(new, dict):
        lines = []
        for name in sorted(old.keys() | new.keys()):
            inner = f"{key}.{name}".lstrip(".")
            if name in old and name in new:
                lines += differences(old[name], new[name], inner)
            else:
                said = [_shown(each[name]) if name in each else "absent" for each in (old, new)]
                lines.append(f"{inner} was {said[0]} and is now {said[1]}")
        return lines
    # True == 1 in Python, but not in a config.
    was, now = json.dumps(old, sort_keys=True), json.dumps(new, sort_keys=True)
    return [] if was == now else [f"{key or 'the whole'} was {_shown(old)} and is now {_shown(new)}"]


def _shown(value: object) -> str:
    """Return a value as JSON, the rest of a long one left out."""
    text = json.dumps(value, sort_keys=True)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
