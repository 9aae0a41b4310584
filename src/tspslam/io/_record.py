"""What ``run.json`` says of each frame, checked: the file may be a stranger's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .._files import bad_input, read_bytes
from .._text import parse_json

_LARGEST_JSON = 1 << 30  # bytes
_EXPECTED = "rows with the index and the stamp of each frame"
_LARGEST_INDEX = 1 << 53  # which a float64 still holds exactly
_LARGEST_STAMP = 1e300  # s


def read_object(path: Path) -> dict[str, Any]:
    """Return what a file of one JSON object holds; `InputError` if it holds something else."""
    try:
        values = parse_json(read_bytes(path, "a JSON object", _LARGEST_JSON))
    except (ValueError, RecursionError) as error:
        raise bad_input(path, f"is not JSON ({error})", "a JSON object") from error
    if not isinstance(values, dict):
        raise bad_input(path, f"holds a {type(values).__name__}", "a JSON object")
    return values


def checked_rows(path: Path, run: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return ``per_frame`` of the content of the ``run.json`` at `path`; `InputError` if it holds something else."""
    rows = run.get("per_frame", [])
    if not isinstance(rows, list):
        raise bad_input(path, f"holds per_frame, a {type(rows).__name__}", _EXPECTED)
    for number, row in enumerate(rows):
        if not (isinstance(row, dict) and _is_index(row.get("index")) and _is_number(row.get("stamp"))):
            raise bad_input(path, f"row {number} of per_frame has no index or no stamp that can be", _EXPECTED)
    return rows


def _is_index(value: object) -> bool:
    return type(value) is int and 0 <= value < _LARGEST_INDEX


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST_STAMP
