"""The arrays inside a VTK XML file: text, base64 and raw bytes, plain, or compressed by zlib or LZMA."""

from __future__ import annotations

import base64
import binascii
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ._words import words_of

LARGEST_ARRAY = 1 << 32
BLOCK = 1 << 15
# Each compressor that is read, and how far it can shrink: deflate 1032 : 1, LZMA's zeros some 7000 : 1.
COMPRESSORS = {None: 1, "vtkZLibDataCompressor": 1032, "vtkLZMADataCompressor": 1 << 13}
_LZMA_RATIO = COMPRESSORS["vtkLZMADataCompressor"]
_LZMA_MEMORY = 1 << 28  # bytes that a block's decoder may take: its dictionary is as large as the file says

TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}
NAMES = {np.dtype(code): name for name, code in TYPES.items()}


@dataclass
class Budget:
    """Bytes that the arrays of a file may take together, however often they share the file's.

    Attributes
    ----------
    limit : int
        What a file of this size may take in all.
    taken : int
        By the arrays so far, 8 for each number.
    """

    limit: int
    taken: int = 0

    def take(self, size: int) -> None:
        """Take so many more bytes, before they are."""
        self.taken += size
        if self.taken > self.limit:
            raise InputError(
                f"brings all arrays to {self.taken} bytes, where a file of this size may take {self.limit}"
            )


@dataclass(frozen=True)
class Layout:
    """How a file stores its binary arrays.

    Attributes
    ----------
    order : str
        ``"<"`` or ``">"``.
    header : str
        Type of the size fields, ``"u4"`` or ``"u8"``.
    ratio : int
        Of `COMPRESSORS`: how far arrays can be shrunk.
    budget : Budget
        What all its arrays may take.
    appended : memoryview
        What stands behind the underscore of the appended section.
    raw : bool
        Whether that section is raw, not base64.
    """

    order: str
    header: str
    ratio: int
    budget: Budget
    appended: memoryview
    raw: bool = False


def encode(values: NDArray[Any]) -> str:
    """Return an array as base64 of zlib blocks behind a header of little-endian 64-bit sizes."""
    data = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    blocks = [zlib.compress(data[start : start + BLOCK], 6) for start in range(0, len(data), BLOCK)]
    sizes = [len(blocks), BLOCK, len(data) % BLOCK, *map(len, blocks)]
    header = np.array(sizes, "<u8").tobytes()
    return (base64.b64encode(header) + base64.b64encode(b"".join(blocks))).decode("ascii")


def decode_text(text: str, code: str, count: int) -> NDArray[Any]:
    """Return `count` numbers that stand in `text`, in the type of `code`."""
    parts, found = [], 0
    for words in words_of(text):
        found += len(words)
        if found <= count:
            parts.append(_numbers(words, code))
    if found != count:
        raise InputError(f"holds {found} numbers where {count} are claimed")
    return np.concatenate([np.empty(0, code), *parts])


def _numbers(words: list[str], code: str) -> NDArray[Any]:
    try:
        if code.startswith("f"):
            return np.array(words, dtype="f8").astype(code)
        return np.array([int(word) for word in words], dtype=code)
    except (ValueError, OverflowError) as error:
        raise InputError("holds a word that is no number of its type") from error


def packed(text: bytes) -> bytes:
    """Return text without its blanks."""
    return text.translate(None, b" \t\n\r\v\f")


def decode_binary(source: memoryview, raw: bool, layout: Layout, code: str, count: int) -> NDArray[Any]:
    """Return `count` numbers stored at the start of `source`, base64 unless `raw`, in native byte order."""
    dtype = np.dtype(layout.order + code)
    expected = count * dtype.itemsize
    if expected > min(LARGEST_ARRAY, layout.ratio * len(source) + 64):
        raise InputError(f"claims {expected} bytes, more than its {len(source)} can hold")
    data = _inflated(source, raw, layout, expected) if layout.ratio > 1 else _plain(source, raw, layout, expected)
    return np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))


def _plain(source: memoryview, raw: bool, layout: Layout, expected: int) -> bytes:
    width = np.dtype(layout.header).itemsize
    claimed = _sizes(_take(source, 0, width, raw), layout)[0]
    if claimed != expected:
        raise InputError(f"holds {claimed} bytes where {expected} are claimed")
    # Some writers encode the size and the data apart, which shows by padding between them.
    characters = _length(width, raw)
    if not raw and source[:characters].tobytes().endswith(b"="):
        return _take(source, characters, expected, raw)
    return _take(source, 0, width + expected, raw)[width:]


def _inflated(source: memoryview, raw: bool, layout: Layout, expected: int) -> bytes:
    width = np.dtype(layout.header).itemsize
    count, block, last = _sizes(_take(source, 0, 3 * width, raw), layout)
    if count == 0 and expected == 0:
        return b""
    if count * width > len(source):
        raise InputError(f"claims {count} blocks, more than its {len(source)} bytes can hold")
    if (count - 1) * block + (last or block) != expected:
        raise InputError(f"holds {count} blocks of {block} bytes where {expected} bytes are claimed")
    header = (3 + count) * width
    packed = _sizes(_take(source, 0, header, raw), layout)[3:]
    stream = _take(source, _length(header, raw), sum(packed), raw)
    parts, start = [], 0
    for number, size in enumerate(packed):
        whole = block if number < count - 1 else last or block
        parts.append(_inflate(stream[start : start + size], whole, layout.ratio))
        start += size
    return b"".join(parts)


def _inflate(block: bytes, size: int, ratio: int) -> bytes:
    from lzma import FORMAT_AUTO, LZMADecompressor, LZMAError

    machine = LZMADecompressor(FORMAT_AUTO, _LZMA_MEMORY) if ratio == _LZMA_RATIO else zlib.decompressobj()
    try:
        data = machine.decompress(block, size + 1)
    except (zlib.error, LZMAError, EOFError) as error:
        raise InputError(f"has a damaged block ({error})") from error
    if len(data) != size or not machine.eof:
        raise InputError(f"has a block that does not give {size} bytes")
    return data


def _length(size: int, raw: bool) -> int:
    return size if raw else (size + 2) // 3 * 4


def _take(source: memoryview, start: int, size: int, raw: bool) -> bytes:
    part = source[start : start + _length(size, raw)].tobytes()
    if not raw:
        try:
            part = base64.b64decode(part, validate=True)
        except (binascii.Error, ValueError) as error:
            raise InputError("has damaged base64") from error
    if len(part) < size:
        raise InputError("is truncated")
    return part[:size]


def _sizes(header: bytes, layout: Layout) -> list[int]:
    return [int(size) for size in np.frombuffer(header, layout.order + layout.header)]
