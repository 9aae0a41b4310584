"""Arrays in an npz file, read only if names, types, shapes and sizes are those of a schema; nothing is unpickled."""

from __future__ import annotations

import io
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._files import reason_of, unpacked_limit
from .errors import InputError

Arrays = dict[str, NDArray[Any]]
Schema = Mapping[str, tuple[str, tuple[int | str, ...]]]
"""Type of each array, or several apart by blanks, and its axes; those named alike are equally long, and one that ends
with * may be missing."""

# Deflate cannot shrink further than this; smaller entries are let be.
_RATIO = 1032
_NPY = re.compile(
    rb"\x93NUMPY\x01\x00(..)\{'descr': '([<|][a-z]\d{1,2})', 'fortran_order': False, "
    rb"'shape': \((|\d{1,11},|\d{1,11}(?:, \d{1,11}){1,3})\), \} *\n",
    re.DOTALL,
)
# zipfile meets damaged archives with all of these.
_ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    OSError,
    ValueError,
    LookupError,
    EOFError,
    RuntimeError,
    OverflowError,
    MemoryError,
)


def read_npz(
    data: bytes, schema: Schema, *, optional: Collection[str] = (), check: Callable[[str, NDArray[Any]], None],
    only: Collection[str] | None = None,
) -> Arrays:  # fmt: skip
    """Return the arrays of an npz file's bytes, in the order of the schema; shapes are left to `check_shapes`.

    Each is given to `check` before the next one is read, so that marks and versions come first. Of a schema's arrays
    all are looked for, but where there is `only`, just these are read.

    Raises
    ------
    InputError
        If an array is missing, unknown or there twice, of another type, or claims more than is there: before memory
        is taken for it.
    """
    arrays: Arrays = {}
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            by_name = _checked_entries(archive.infolist(), unpacked_limit(len(data)))
            for name in schema:
                entry = by_name.pop(f"{name}.npy", None)
                if entry is not None and (only is None or name in only):
                    with archive.open(entry) as stream:
                        arrays[name] = _parsed(name, schema[name][0], stream.read(entry.file_size))
                    check(name, arrays[name])
                elif entry is None and name not in optional:
                    raise InputError(f"has no array {name}")
            if by_name:
                raise InputError("has a repeated or an unknown array")
    except InputError:
        raise
    except _ZIP_ERRORS as error:
        raise InputError(f"is not a sound npz ({reason_of(error)})") from error
    return arrays


def check_shapes(arrays: Mapping[str, NDArray[Any]], schema: Schema, known: dict[str, tuple[int, ...]]) -> None:
    """Raise `InputError` unless shapes are those of the schema; lengths of named axes are added to `known`."""
    for name, values in arrays.items():
        expected: tuple[int, ...] = ()
        for axis in schema[name][1]:
            at = len(expected)
            if isinstance(axis, int):
                expected += (axis,)
            else:
                expected += known.setdefault(axis, values.shape[at : at + 1])
        if values.shape != expected:
            raise InputError(f"array {name} has shape {values.shape}, where {expected} goes")


def _checked_entries(entries: list[zipfile.ZipInfo], limit: int) -> dict[str, zipfile.ZipInfo]:
    """Entries by name, each there once, of a packing and of sizes that can be."""
    by_name = {entry.filename: entry for entry in entries}
    if len(by_name) < len(entries):
        raise InputError("has a repeated or an unknown array")
    for entry in entries:
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or entry.flag_bits & 1:
            raise InputError(f"has {entry.filename} packed in a way that is not ours")
        if entry.file_size > _RATIO * entry.compress_size + 64:
            raise InputError(f"claims {entry.file_size} bytes in the {entry.compress_size} of {entry.filename}")
    claimed = sum(entry.file_size for entry in entries)
    if claimed > limit:
        raise InputError(f"claims {claimed} bytes in all, where a file of its size may take {limit}")
    return by_name


def _parsed(name: str, kind: str, data: bytes) -> NDArray[Any]:
    """Return the array of one entry, after its header was held against the schema and the entry's size."""
    found = _NPY.match(data)
    if not found or found.end() != 10 + int.from_bytes(found[1], "little"):
        raise InputError(f"array {name} has no header of ours")
    dtype, text = found[2].decode("ascii"), found[3].decode("ascii")
    if dtype not in kind.split():
        raise InputError(f"array {name} has type {dtype}, where {' or '.join(kind.split())} goes")
    shape = tuple(int(size) for size in text.split(",") if size)
    claimed = np.dtype(dtype).itemsize
    for size in shape:
        claimed *= size
    if claimed != len(data) - found.end():
        raise InputError(f"array {name} claims {claimed} bytes and has {len(data) - found.end()}")
    values = np.frombuffer(data, dtype, offset=found.end()).reshape(shape)
    if dtype == "|b1" and values.size and values.view(np.uint8).max() > 1:
        raise InputError(f"array {name} holds a byte that is neither true nor false")
    return values.copy()
