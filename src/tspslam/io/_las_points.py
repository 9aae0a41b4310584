"""Points and intensities of LAS and LAZ files: header and rows are read here, only LAZ is unpacked by laspy."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._files import unpacked_limit
from ..errors import InputError
from ..types import FloatArray
from .las import _module

_SMALLEST = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}  # bytes of each format's row
_HEADERS = (227, 227, 227, 235, 375)  # bytes of the header of LAS 1.0 to 1.4
_LEGACY, _NEW = _HEADERS[0], _HEADERS[4]
_RECORD, _LONG_RECORD = 54, 60  # bytes of the head of a record before the points, and of one after them


@dataclass(frozen=True)
class Header:
    """What is needed of a LAS header."""

    start: int
    count: int
    row_size: int
    is_packed: bool
    scale: tuple[float, ...]
    offset: tuple[float, ...]


def read_las_points(data: bytes) -> tuple[FloatArray, NDArray[np.float64]]:
    """Return places (N, 3) in the file's unit and axes, and intensities (N,), 0 to 1.

    Raises
    ------
    InputError
        If it is no LAS file of versions 1.0 to 1.4, claims more points than it can hold, or is damaged.
    """
    header = parse_header(data)
    rows = _unpacked(data, header) if header.is_packed else _rows(data, header)
    with np.errstate(over="ignore", invalid="ignore"):
        xyz = rows[0] * np.array(header.scale) + np.array(header.offset)
    return xyz, rows[1] / 65535.0


def parse_header(data: bytes) -> Header:
    """Parse the header of a LAS or LAZ file and hold it against the size of the file."""
    if len(data) < _LEGACY or data[:4] != b"LASF":
        raise InputError("has no LAS header")
    major, minor = data[24], data[25]
    if major != 1 or minor > 4:
        raise InputError(f"is LAS {major}.{minor}, where 1.0 to 1.4 go")
    start, kind, row_size, count = struct.unpack_from("<I4xBHI", data, 96)
    if minor == 4 and len(data) >= _NEW:
        (count,) = struct.unpack_from("<Q", data, 247)
    numbers = struct.unpack_from("<6d", data, 131)
    is_packed, kind = bool(kind & 0xC0), kind & 0x3F
    if kind not in _SMALLEST or row_size < _SMALLEST[kind]:
        raise InputError(f"has points of format {kind} in {row_size} bytes")
    if not np.isfinite(numbers).all():
        raise InputError("has a scale or an offset that is not finite")
    _check_records(data, minor, start)
    there = unpacked_limit(len(data)) if is_packed else len(data) - start
    if start > len(data) or count * row_size > there:
        raise InputError(f"claims {count} points of {row_size} bytes, more than the file can hold")
    return Header(start, count, row_size, is_packed, numbers[:3], numbers[3:])


def _check_records(data: bytes, minor: int, start: int) -> None:
    """Hold the header, and how many records are claimed before and after the points, against the size of the file."""
    size, count = struct.unpack_from("<H4xI", data, 94)
    if not _HEADERS[minor] <= size <= start:
        raise InputError(
            f"has a header of {size} bytes and points from byte {start}, where {_HEADERS[minor]} or more go"
        )
    if count * _RECORD > start - size:
        raise InputError(f"claims {count} records before its points, more than {start - size} bytes can hold")
    if minor < 4 or len(data) < _NEW:
        return
    first, count = struct.unpack_from("<QI", data, 235)
    if count and (first < start or count * _LONG_RECORD > len(data) - first):
        raise InputError(f"claims {count} records from byte {first}, more than the file can hold")


def _rows(data: bytes, header: Header) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    names = {"names": ["at", "intensity"], "formats": ["(3,)<i4", "<u2"], "offsets": [0, 12]}
    dtype: Any = np.dtype({**names, "itemsize": header.row_size})  # type: ignore[call-overload]
    table = np.frombuffer(data, dtype, header.count, header.start)
    return table["at"], table["intensity"]


def _unpacked(data: bytes, header: Header) -> tuple[NDArray[np.int32], NDArray[np.uint16]]:
    laspy = _module("laspy")
    _module("lazrs")
    try:
        points = laspy.read(io.BytesIO(data))
        table = np.stack([np.asarray(points.X), np.asarray(points.Y), np.asarray(points.Z)], axis=1)
        intensity = np.asarray(points.intensity)
    except BaseException as error:  # lazrs panics with what is no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        raise InputError(f"has LAZ data that are damaged ({type(error).__name__})") from error
    if len(table) != header.count:
        raise InputError(f"holds {len(table)} points, where {header.count} are claimed")
    return table, intensity
