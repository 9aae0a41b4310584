"""PCD, the point clouds of PCL: a header of text, then a table as text, as rows, or as packed columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._files import unpacked_limit
from .._text import is_plain, is_whole
from ..errors import InputError
from ._vtk_data import Budget
from ._words import words_of

LARGEST_HEADER = 1 << 14  # bytes
_TYPES = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (4, 8)}
_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_DATA = ("ascii", "binary", "binary_compressed")
_MOST_VALUES = 1 << 12  # of one field of one point: a histogram has some hundreds
_MOST_DIGITS = 10
_EXPANSION = 100  # LZF makes at most 264 bytes of 3

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Field:
    """A field: its name, the type code of its values, and how many a point has."""

    name: str
    code: str
    count: int

    @property
    def size(self) -> int:
        """Bytes of a point."""
        return int(self.code[1:]) * self.count


@dataclass(frozen=True)
class Header:
    """What the header of a PCD file says, and where the data start."""

    fields: list[Field]
    points: int
    data: str
    size: int

    @property
    def row_size(self) -> int:
        """Bytes of a point."""
        return sum(field.size for field in self.fields)


def read_pcd(data: bytes) -> Columns:
    """Return the fields of one value a point, by name, in their own types; fields of several are passed over.

    Raises
    ------
    InputError
        If the header is not as PCL writes it, or claims more or other data than there are.
    """
    header = parse_header(data)
    body = memoryview(data)[header.size :]
    if header.data == "ascii":
        return _of_text(bytes(body), header)
    if header.data == "binary":
        return _of_rows(body, header)
    return _of_columns(_unpacked(body, header), header)


def parse_header(data: bytes) -> Header:
    """Parse the header of a PCD file."""
    said: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in said:
        end = data.find(b"\n", at, LARGEST_HEADER)
        if end < 0:
            raise InputError(f"has no PCD header with a line DATA within {LARGEST_HEADER} bytes")
        words = data[at:end].decode("latin-1").split()
        at = end + 1
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYS or words[0] in said:
            raise InputError(f"has the header line {' '.join(words)[:60]!r}")
        said[words[0]] = words[1:]
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "HEIGHT") if key not in said]
    if missing:
        raise InputError(f"has a header without {', '.join(missing)}")
    if said["DATA"] not in [[kind] for kind in _DATA]:
        raise InputError(f"has the data {' '.join(said['DATA'])[:40]!r}, where one of {', '.join(_DATA)} goes")
    return Header(_fields(said), _points(said), said["DATA"][0], at)


def _points(said: dict[str, list[str]]) -> int:
    """Number of points: width times height, and what POINTS says where it is there."""
    width, height = (_whole(said, key) for key in ("WIDTH", "HEIGHT"))
    points = _whole(said, "POINTS") if "POINTS" in said else width * height
    if points != width * height:
        raise InputError(f"claims {points} points of {width} x {height}")
    return points


def _whole(said: dict[str, list[str]], key: str) -> int:
    if len(said[key]) != 1 or not is_whole(said[key][0], _MOST_DIGITS):
        raise InputError(f"has the header line {' '.join([key, *said[key]])[:60]!r}")
    return int(said[key][0])


def _fields(said: dict[str, list[str]]) -> list[Field]:
    names = said["FIELDS"]
    counts = said.get("COUNT", ["1"] * len(names))
    columns = [said["TYPE"], said["SIZE"], counts]
    if not names or any(len(column) != len(names) for column in columns):
        raise InputError(f"has {len(names)} FIELDS, {len(said['SIZE'])} SIZE, {len(said['TYPE'])} TYPE of a point")
    fields = [_field(*words) for words in zip(names, *columns, strict=True)]
    real = [field.name for field in fields if field.name != "_"]  # padding has that name, as often as it likes
    if len(set(real)) != len(real):
        raise InputError("has two fields of one name")
    return fields


def _field(name: str, kind: str, size: str, count: str) -> Field:
    code = _TYPES.get(kind, "")
    if not code or not is_whole(size, 1) or int(size) not in _SIZES[code]:
        raise InputError(f"has the field {name[:40]} of type {kind[:10]} and size {size[:10]}")
    if not is_whole(count, _MOST_DIGITS) or not 1 <= int(count) <= _MOST_VALUES:
        raise InputError(f"has {count[:20]} values in the field {name[:40]}, where 1 to {_MOST_VALUES} go")
    return Field(name, f"{code}{size}", int(count))


def _of_text(body: bytes, header: Header) -> Columns:
    width = sum(field.count for field in header.fields)
    if header.points * width > (len(body) + 1) // 2:
        raise InputError(f"claims {header.points} points, more than the file can hold")
    parts = [np.empty(0)]
    for words in words_of(body):
        try:
            if not is_plain(b"".join(words).decode("latin-1")):
                raise ValueError
            parts.append(np.array([float(word) for word in words]))
        except ValueError as error:
            raise InputError("has a word in its data that is no number") from error
    values = np.concatenate(parts)
    if len(values) != header.points * width:
        raise InputError(f"has {len(values)} numbers, where {header.points} points of {width} go")
    table = values.reshape(header.points, width)
    starts = np.cumsum([0, *(field.count for field in header.fields)])
    return {
        field.name: table[:, start] for field, start in zip(header.fields, starts[:-1], strict=True) if field.count == 1
    }


def _of_rows(body: memoryview, header: Header) -> Columns:
    _check_size(len(body), header)
    parts = [(f"{k}", f"<{field.code}", (field.count,)) for k, field in enumerate(header.fields)]
    table = np.frombuffer(body, np.dtype(parts), header.points)
    return {
        field.name: table[f"{k}"][:, 0].astype(field.code) for k, field in enumerate(header.fields) if field.count == 1
    }


def _check_size(size: int, header: Header) -> None:
    """Refuse data that end too early; PCL leaves bytes of a page after the last point, which are passed over."""
    if size < header.points * header.row_size:
        raise InputError(f"has {size} bytes of data, where {header.points} points of {header.row_size} bytes go")


def _unpacked(body: memoryview, header: Header) -> memoryview:
    """Data of a compressed file, which has two sizes before it."""
    from ._lzf import unpack

    if len(body) < 8:
        raise InputError("ends before the sizes of its compressed data")
    packed, whole = (int(size) for size in np.frombuffer(body[:8], "<u4"))
    if packed > len(body) - 8 or whole != header.points * header.row_size or whole > _EXPANSION * packed:
        there = f"{len(body) - 8} bytes of data and {header.points} points of {header.row_size} bytes"
        raise InputError(f"claims {packed} bytes that become {whole}, with {there}")
    columns = sum(field.count == 1 for field in header.fields)
    Budget(unpacked_limit(packed)).take(whole + 8 * columns * header.points)  # columns become float64
    out = np.empty(whole, np.uint8)
    if not unpack(np.frombuffer(body[8 : 8 + packed], np.uint8), out):
        raise InputError("has compressed data that are damaged")
    return memoryview(out.tobytes())


def _of_columns(body: memoryview, header: Header) -> Columns:
    """Fields one after another, each for all points."""
    found, at = {}, 0
    for field in header.fields:
        if field.count == 1:
            found[field.name] = np.frombuffer(body, f"<{field.code}", header.points, at).astype(field.code)
        at += header.points * field.size
    return found
