"""The records of a bag's file, walked through before a library takes memory for what they say.

What is wrong with one is a ValueError; the caller says of which file.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import sqlite3
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ..types import FloatArray

LARGEST_CHUNK = 1 << 28  # bytes, unpacked: an image of 64 million pixels of 4 bytes
_AT_ONCE = 1 << 29  # bytes, of unpacked chunks of one moment: those of MCAP may overlap in time
_LARGEST_TEXT = 1 << 20  # bytes, of a definition or an index: real ones have some thousands
_PIECE = 1 << 20  # bytes, unpacked at a time
_ROS1 = b"#ROSBAG V2.0\n"
_MCAP = b"\x89MCAP0\r\n"
_MCAP_FOOTER = 37  # bytes, with the magic behind it
# Operations of records, as the formats number them.
_INDEX, _CHUNK, _INFO, _CONNECTION = 4, 5, 6, 7
_MCAP_FOOT, _MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_CHUNK, _MCAP_CHUNK_INDEX = 2, 3, 4, 6, 8
_MCAP_TEXTS = (_MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_CHUNK_INDEX)


def unpacked(kind: str, packed: BinaryIO) -> Any:
    """Return a file that gives the content of a packed one piece by piece; no more memory is taken than is read."""
    if kind == "bz2":
        import bz2

        return bz2.BZ2File(packed)
    if kind == "lz4":
        return importlib.import_module("lz4.frame").LZ4FrameFile(packed)
    if kind != "zstd":
        raise ValueError(f"a chunk is packed by {kind[:20]!r}, where bz2, lz4 or zstd go")
    for name in ("compression.zstd", "backports.zstd"):
        with contextlib.suppress(ImportError):
            return importlib.import_module(name).ZstdFile(packed)
    module = importlib.import_module("zstandard")  # of older versions of rosbags
    return module.ZstdDecompressor().stream_reader(packed, read_across_frames=True)


def unpacked_bytes(kind: str, packed: bytes) -> bytes:
    """Return the content of packed bytes, if it is no larger than a chunk may be."""
    with unpacked(kind, io.BytesIO(packed)) as content:
        found: bytes = content.read(LARGEST_CHUNK + 1)
    _need(len(found) <= LARGEST_CHUNK, f"{len(packed)} bytes unpack to more than {LARGEST_CHUNK}")
    return found


def _need(is_so: bool, otherwise: str) -> None:
    if not is_so:
        raise ValueError(otherwise)


def _check_content(handle: BinaryIO, kind: str, packed: int, said: int) -> None:
    """Refuse a chunk at the handle's place whose content is too large, as it says or as it is, or not as it says."""
    if kind in ("", "none"):
        _need(said == packed, f"a chunk of {packed} bytes says that it holds {said}")
        return
    most = f"where at most {LARGEST_CHUNK} go"
    _need(max(said, packed) <= LARGEST_CHUNK, f"a chunk of {packed} bytes says that it holds {said}, {most}")
    real = 0
    with unpacked(kind, io.BytesIO(handle.read(packed))) as content:
        while real <= said and (piece := content.read(_PIECE)):
            real += len(piece)
    _need(real == said, f"a chunk says that it holds {said} bytes, and has {'more' if real > said else real}")


class _Record(NamedTuple):
    """A record of a bag of ROS 1: where it begins, the values of its header, where its data begins, and their size."""

    at: int
    fields: dict[str, bytes]
    data: int
    size: int

    def number(self, name: str) -> int:
        """Return an unsigned number of the header."""
        value = self.fields.get(name, b"")
        _need(len(value) in (1, 4, 8), f"the record at byte {self.at} has no number {name}")
        return int.from_bytes(value, "little")


@dataclass
class _Table:
    """Where the messages of a chunk are said to be: the number of lists, and each message's offset."""

    size: int
    lists: int
    offsets: list[FloatArray]

    def check(self) -> None:
        """Refuse offsets outside of the chunk, or one that is said to be of two messages."""
        if self.offsets:
            found = np.concatenate(self.offsets)
            _need(int(found.max(initial=0)) < max(self.size, 1), "an index leads out of its chunk")
            _need(len(np.unique(found)) == len(found), "an index leads to one message twice")


def check_ros1(handle: BinaryIO, size: int) -> None:
    """Walk through a bag of ROS 1: records and index inside the file, chunks of bearable size."""
    _need(handle.read(len(_ROS1)) == _ROS1, "it does not begin with #ROSBAG V2.0")
    records = _ros1_records(handle, size)
    first = next(records, None)
    _need(first is not None and first.fields.get("op") == b"\x03", "its first record is no header of a bag")
    assert first is not None
    index, infos = first.number("index_pos"), first.number("chunk_count")
    _need(index > 0, "it has no index, as it was not closed: rosbag reindex makes one")
    tables: dict[int, _Table] = {}
    last, is_found = _Table(0, 0, []), False
    for record in records if infos else ():
        is_found |= record.at == index
        operation = record.number("op")
        if operation == _CHUNK:
            last.check()
            last = tables[record.at] = _chunk(handle, record)
        elif operation == _INDEX:
            _read_offsets(handle, record, last)
        elif operation == _CONNECTION:
            _need(record.size <= _LARGEST_TEXT, f"the connection at byte {record.at} has {record.size} bytes")
        elif operation == _INFO:
            _need(is_found, f"the index at byte {record.at} is not where the bag says")
            _check_info(record, tables)
            infos -= 1
        if not infos:
            break
    last.check()
    _need(not infos and (is_found or not tables), f"its index is not at byte {index}, or not whole")


def _ros1_records(handle: BinaryIO, size: int) -> Iterator[_Record]:
    at = handle.tell()
    while at < size:
        handle.seek(at)
        length = _sized(handle, at, size)
        _need(length <= _LARGEST_TEXT, f"the record at byte {at} has a header of {length} bytes")
        fields = dict(_fields(handle.read(length), at))
        data_size = _sized(handle, at, size)
        data = handle.tell()
        yield _Record(at, fields, data, data_size)
        at = data + data_size


def _sized(handle: BinaryIO, at: int, size: int) -> int:
    """Read the size of what comes next, which must be in the file."""
    said = handle.read(4)
    length = int.from_bytes(said, "little")
    is_inside = len(said) == 4 and handle.tell() + length <= size
    _need(is_inside, f"the record at byte {at} ends behind the file's {size} bytes")
    return length


def _fields(header: bytes, at: int) -> Iterator[tuple[str, bytes]]:
    place = 0
    while place < len(header):
        length = int.from_bytes(header[place : place + 4], "little")
        name, equals, value = header[place + 4 : place + 4 + length].partition(b"=")
        place += 4 + length
        _need(bool(equals) and place <= len(header), f"the record at byte {at} has a damaged header")
        yield name.decode("ascii", "replace"), value


def _chunk(handle: BinaryIO, record: _Record) -> _Table:
    said = record.number("size")
    handle.seek(record.data)
    _check_content(handle, record.fields.get("compression", b"").decode("ascii", "replace"), record.size, said)
    return _Table(said, 0, [])


def _read_offsets(handle: BinaryIO, record: _Record, table: _Table) -> None:
    count = record.number("count")
    _need(record.size == 12 * count, f"the index at byte {record.at} has {record.size} bytes for {count} messages")
    handle.seek(record.data)
    table.offsets.append(np.frombuffer(handle.read(record.size), "<u4")[2::3])
    table.lists += 1


def _check_info(record: _Record, tables: dict[int, _Table]) -> None:
    """Refuse what is said of a chunk that is none, was named before, or has another number of lists."""
    table = tables.pop(record.number("chunk_pos"), None)
    count = record.number("count")
    is_so = table is not None and table.lists == count and record.size == 8 * count
    _need(is_so, f"the index at byte {record.at} is of no chunk, or of one twice, or of other topics than it has")


class _Listed(NamedTuple):
    """What the index of an MCAP file says of a chunk."""

    start: int
    end: int
    at: int
    kind: str
    packed: int
    size: int


def check_mcap(handle: BinaryIO, size: int) -> None:
    """Walk through an MCAP file: records and index inside the file, chunks of bearable size, alone and together."""
    _need(handle.read(8) == _MCAP and size >= 8 + _MCAP_FOOTER, "it does not begin as MCAP, or is cut")
    handle.seek(size - _MCAP_FOOTER)
    foot = handle.read(_MCAP_FOOTER)
    is_whole = foot[0] == _MCAP_FOOT and foot.endswith(_MCAP)
    _need(is_whole, "it does not end as MCAP: it was not closed, or is cut")
    summary = int.from_bytes(foot[9:17], "little")
    chunks: dict[int, tuple[str, int, int]] = {}
    index, is_found = [], summary == 0
    for at, operation, length in _mcap_records(handle, size):
        is_found |= at == summary
        if operation in _MCAP_TEXTS:
            _need(length <= _LARGEST_TEXT, f"the record at byte {at} has {length} bytes")
        if operation == _MCAP_CHUNK:
            chunks[at] = _mcap_chunk(handle, at, length)
        elif operation == _MCAP_CHUNK_INDEX:
            index.append(_mcap_index(handle.read(length), at))
    _need(is_found, f"its summary is not at byte {summary}")
    for each in index:
        is_so = chunks.get(each.at) == (each.kind, each.packed, each.size)
        _need(is_so, f"its index has a chunk at byte {each.at}, where there is none of this size")
    _check_together(index)


def _mcap_records(handle: BinaryIO, size: int) -> Iterator[tuple[int, int, int]]:
    """Place, operation and length of each record."""
    at = 8
    while at < size - 8:
        handle.seek(at)
        head = handle.read(9)
        length = int.from_bytes(head[1:], "little")
        _need(at + 9 + length <= size - 8, f"the record at byte {at} ends behind the file's {size} bytes")
        yield at, head[0], length
        at += 9 + length


def _mcap_chunk(handle: BinaryIO, at: int, length: int) -> tuple[str, int, int]:
    head = handle.read(32)
    _need(length >= 40 and len(head) == 32, f"the chunk at byte {at} is cut")
    size, name = int.from_bytes(head[16:24], "little"), int.from_bytes(head[28:32], "little")
    _need(name <= length - 40, f"the chunk at byte {at} has a damaged header")
    kind = handle.read(name).decode("ascii", "replace")
    packed = int.from_bytes(handle.read(8), "little")
    _need(packed == length - 40 - name, f"the chunk at byte {at} has {length} bytes, and not {packed} packed ones")
    _check_content(handle, kind, packed, size)
    return kind, packed, size


def _mcap_index(content: bytes, at: int) -> _Listed:
    try:
        start, end, place, _, offsets = struct.unpack_from("<QQQQI", content)
        (name,) = struct.unpack_from("<I", content, 44 + offsets)
        kind = content[48 + offsets : 48 + offsets + name].decode("ascii", "replace")
        packed, size = struct.unpack_from("<QQ", content, 48 + offsets + name)
    except struct.error as error:
        raise ValueError(f"the index at byte {at} is cut") from error
    return _Listed(start, end, place, kind, packed, size)


def _check_together(index: list[_Listed]) -> None:
    """Refuse chunks that overlap in time and are too large together: they are unpacked at once."""
    if not index:
        return
    starts, ends, sizes = (np.array([each[k] for each in index], np.uint64) for k in (0, 1, 5))
    begun, over = np.argsort(starts, kind="stable"), np.argsort(np.maximum(starts, ends), kind="stable")
    total = np.cumsum(sizes[begun]), np.concatenate([[np.uint64(0)], np.cumsum(sizes[over])])
    done = np.searchsorted(np.maximum(starts, ends)[over], starts[begun], side="left")
    most = int((total[0] - total[1][done]).max())
    bearable = max(_AT_ONCE, int(sizes.max()))
    _need(most <= bearable, f"chunks of one moment hold {most} bytes together, where at most {bearable} go")


def check_sqlite(path: Path) -> None:
    """Refuse a database with anything but plain tables: what a view or a made column holds has no bound."""
    with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
        for kind, name, made in base.execute("SELECT type, name, sql FROM sqlite_master").fetchall():
            _need(kind in ("table", "index"), f"its {str(name)[:40]} is a {kind}, no table")
            _need(
                "virtual table" not in " ".join(str(made).lower().split()),
                f"its table {str(name)[:40]} is a virtual one",
            )
            columns = (
                base.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)).fetchall() if kind == "table" else []
            )
            _need(not any(hidden for (hidden,) in columns), f"its table {str(name)[:40]} has a column that is made up")
