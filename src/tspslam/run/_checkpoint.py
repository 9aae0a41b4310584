"""The checkpoint that a stopped run goes on from: rows of the frames so far, and the odometry's state.

A stranger's file with a fitting hash can be anything: what no run can have written does not count.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._npz import Arrays, Schema, read_npz
from .._text import parse_json
from ..errors import InputError
from ..vision.slam._state import SCHEMA

Row = dict[str, Any]
_SCHEMA: Schema = {"made_by": ("|u1", ("b",)), "rows": ("|u1", ("r",))} | SCHEMA
_LARGEST_COUNT = 1 << 40
_LARGEST_NUMBER = 1e100
_TRACKED = {
    "name": str,
    "stamp": float,
    "is_keyframe": bool,
    "is_lost": bool,
    "landmarks_seen": int,
}
_COMPLEX = {
    "defined": int,
    "points": int,
    "edges": int,
    "faces": int,
    "euler": int,
    "pinched_vertices": list,
    "surface": str,
    "keypoints_left": int,
    "keypoints_right": int,
    "matched": int,
    "by_row_search": int,
    "vertical_offset_px": float,
    "vertical_offset_std_px": float,
}


def pack(made_by: bytes, rows: list[Row], state: Arrays) -> bytes:
    """Return a checkpoint as npz."""
    text = json.dumps(rows, allow_nan=False).encode()
    heads = {name: np.frombuffer(data, np.uint8) for name, data in (("made_by", made_by), ("rows", text))}
    buffer = io.BytesIO()
    arrays = {name: np.ascontiguousarray(values).reshape(np.shape(values)) for name, values in state.items()}
    np.savez(buffer, allow_pickle=False, **heads, **arrays)
    return buffer.getvalue()


def unpack(data: bytes, made_by: bytes) -> tuple[list[Row], Arrays]:
    """Return the rows and the state of a checkpoint.

    Raises
    ------
    InputError
        If something else made it, or a row, or the number of rows, cannot be; the state is left to `check_state`.
    """

    def check_maker(name: str, values: NDArray[Any]) -> None:
        if name == "made_by" and values.tobytes() != made_by:
            raise InputError("another version made it")

    state = read_npz(data, _SCHEMA, check=check_maker)
    del state["made_by"]
    rows = _rows(state.pop("rows").tobytes())
    tracked = [row for row in rows if "skipped" not in row]
    if [row["stamp"] for row in tracked] != state["stamps"].tolist():
        raise InputError("its rows are not those of the path")
    keyframes = {number for number, row in enumerate(tracked) if row["is_keyframe"]}
    if not keyframes.issuperset(state["keyframe_index"].tolist()):
        raise InputError("a keyframe of its map is none in its rows")
    return rows, state


def _rows(data: bytes) -> list[Row]:
    try:
        rows = parse_json(data)
    except (ValueError, RecursionError) as error:
        raise InputError("its rows are no JSON") from error
    if not isinstance(rows, list):
        raise InputError("its rows are no list")
    for number, row in enumerate(rows):
        if not (isinstance(row, dict) and _is_row(row)):
            raise InputError(f"row {number} is none of a frame")
    return rows


def _is_row(row: Row) -> bool:
    kinds: dict[str, type] = {"index": int, "input_hash": str}
    if "skipped" in row:
        kinds |= {"skipped": str}
    else:
        kinds |= _TRACKED | (_COMPLEX if "points" in row else {})
    if not all(name in row and _is(row[name], kind) for name, kind in kinds.items()):
        return False
    plain = int, float, bool, str, list, type(None)
    return all(any(_is(value, kind) for kind in plain) for value in row.values())


def _is(value: object, kind: type) -> bool:
    if kind is list:
        return isinstance(value, list) and all(_is(each, float) for each in value)
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST_NUMBER
    return type(value) is kind and (not isinstance(value, int) or abs(value) < _LARGEST_COUNT)
