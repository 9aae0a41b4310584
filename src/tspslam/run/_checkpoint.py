"""The checkpoint that a stopped run goes on from: rows of the frames so far, and the odometry's state.

A stranger's file with a fitting hash can be anything: what no run can have written does not count.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from .._atomic import atomic_write
from .._files import PathLike, read_bytes
from .._npz import Arrays, Schema, read_npz
from .._text import parse_json
from ..errors import InputError
from ..io._places import MANIFEST
from ..io.manifest import recorded_hashes, sha256_file
from ..io.runfolder import RunFolder
from ..vision.slam._state import SCHEMA
from .record import ComplexRecord, FrameRecord, Row, SkippedPair, flatten_row, hash_of

_SCHEMA: Schema = {"made_by": ("|u1", ("b",)), "rows": ("|u1", ("r",))} | SCHEMA
STATE_NAME = "state.npz"
_LARGEST_COUNT = 1 << 40
_LARGEST_NUMBER = 1e100
_KINDS: dict[type, dict[str, Any]] = {each: get_type_hints(each) for each in (SkippedPair, FrameRecord, ComplexRecord)}


def write_checkpoint(
    path: Path, made_by: bytes, rows: Sequence[Row], state: Arrays,
    on_written: Callable[[Path], object] = lambda _: None,
) -> None:  # fmt: skip
    """Write a checkpoint as npz, whole or not at all.

    Parameters
    ----------
    path : path
        Where to.
    made_by : bytes
        What writes it; others' checkpoints do not count.
    rows : sequence of FrameRecord or SkippedPair
        One for each pair so far.
    state : dict of str to array
        The odometry's.
    on_written : callable, optional
        Called with the temporary file, before it takes its place.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    # Row by row, so that another thread gets its turn between: all at once would be 0.3 s for an hour of frames.
    text = f"[{', '.join(json.dumps(flatten_row(row), allow_nan=False) for row in rows)}]".encode()
    heads = {name: np.frombuffer(data, np.uint8) for name, data in (("made_by", made_by), ("rows", text))}
    arrays = {name: np.ascontiguousarray(values).reshape(np.shape(values)) for name, values in state.items()}
    columns: dict[str, Any] = {**heads, **arrays}  # numbers only: no object is pickled
    with atomic_write(path) as handle:
        np.savez(handle, **columns)
        handle.flush()
        on_written(Path(handle.name))


def record_checkpoint(folder: RunFolder, made_by: bytes, rows: Sequence[Row], state: Arrays) -> None:
    """Write the checkpoint of a run folder; it is noted before it takes the place of the one before.

    So a run that is killed in between goes on from that one: `is_recorded` knows both.

    Parameters
    ----------
    folder : RunFolder
        The run's.
    made_by, rows, state
        As for `write_checkpoint`.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    path, made_from = folder.path / STATE_NAME, hash_of([row.input_hash for row in rows])
    note = partial(folder.record, path, input_hash=made_from)
    write_checkpoint(path, made_by, rows, state, lambda written: note(content=written))


def is_recorded(folder: RunFolder) -> bool:
    """Whether a folder's checkpoint is one that its run has noted, of these settings: the last, or one before.

    Parameters
    ----------
    folder : RunFolder
        The run's.

    Returns
    -------
    bool
    """
    path, unit = folder.path / STATE_NAME, folder.units.get(STATE_NAME)
    if unit is None or unit.config != folder.config_hash or not path.is_file():
        return False
    found = sha256_file(path)
    return found == unit.sha256 or found in recorded_hashes(folder.path / MANIFEST, STATE_NAME)


def unpack(data: bytes, made_by: bytes) -> tuple[list[Row], Arrays]:
    """Return the rows and the state of a checkpoint.

    Parameters
    ----------
    data : bytes
        What `write_checkpoint` wrote, or anything else.
    made_by : bytes
        What must have written it.

    Returns
    -------
    rows : list of FrameRecord or SkippedPair
    state : dict of str to array

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
    tracked = [row for row in rows if isinstance(row, FrameRecord)]
    if [row.stamp for row in tracked] != state["stamps"].tolist():
        raise InputError("its rows are not those of the path")
    keyframes = {number for number, row in enumerate(tracked) if row.is_keyframe}
    if not keyframes.issuperset(state["keyframe_index"].tolist()):
        raise InputError("a keyframe of its map is none in its rows")
    return rows, state


def read_checkpoint(path: PathLike, made_by: bytes) -> tuple[list[Row], Arrays]:
    """Read the rows and the state of a checkpoint.

    Parameters
    ----------
    path : str or path
        Its file.
    made_by : bytes
        As for `unpack`.

    Returns
    -------
    rows : list of FrameRecord or SkippedPair
    state : dict of str to array, such as ``xyz`` (M, 3) float64

    Raises
    ------
    InputError
        If it cannot be read, is damaged, or of another version.
    """
    return unpack(read_bytes(path, "a checkpoint"), made_by)


def parse_row(data: bytes) -> FrameRecord:
    """Return the row of a frame from the text beside it.

    Parameters
    ----------
    data : bytes
        JSON, as `flatten_row` has it.

    Returns
    -------
    FrameRecord

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        row = _row(0, parse_json(data))
    except (ValueError, RecursionError) as error:
        raise InputError("the numbers of a frame are no JSON") from error
    if not isinstance(row, FrameRecord):
        raise InputError("the numbers of a frame are those of none")
    return row


def _rows(data: bytes) -> list[Row]:
    try:
        rows = parse_json(data)
    except (ValueError, RecursionError) as error:
        raise InputError("its rows are no JSON") from error
    if not isinstance(rows, list):
        raise InputError("its rows are no list")
    return [_row(number, row) for number, row in enumerate(rows)]


def _row(number: int, values: Any) -> Row:
    """The record that a plain row was made from, as `flatten_row` has it."""
    try:
        if not isinstance(values, dict):
            raise TypeError
        if "skipped" in values:
            return SkippedPair(**_fitted(values, SkippedPair))
        inner = {name: value for name, value in values.items() if name in _KINDS[ComplexRecord]}
        outer = {name: value for name, value in values.items() if name not in inner}
        complex_ = ComplexRecord(**_fitted(inner, ComplexRecord)) if inner else None
        return FrameRecord(**_fitted(outer, FrameRecord), complex_=complex_)
    except TypeError as error:  # also of a record that lacks a value, or has one more
        raise InputError(f"row {number} is none of a frame") from error


def _fitted(values: dict[str, Any], record: type) -> dict[str, Any]:
    """The values of a record; TypeError if one is not of its type."""
    return {name: _value(value, _KINDS[record].get(name)) for name, value in values.items()}


def _value(value: object, kind: Any) -> object:
    if isinstance(kind, UnionType):
        kind = get_args(kind)[0]  # None is not written
    if get_origin(kind) is tuple and isinstance(value, list):
        return tuple(_value(each, get_args(kind)[0]) for each in value)
    if not _is(value, kind):
        raise TypeError
    return value


def _is(value: object, kind: Any) -> bool:
    if kind is float:
        return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _LARGEST_NUMBER
    return type(value) is kind and (not isinstance(value, int) or abs(value) < _LARGEST_COUNT)
