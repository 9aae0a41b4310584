"""OpenEXR images of scanlines, half or float, not compressed or by RLE or ZIP; a damaged one is an error."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

MAGIC = b"v/1\x01"
_DEEP, _MULTIPART, _TILED = 0x800, 0x1000, 0x200  # flags of the version
_NONE, _RLE, _ZIPS, _ZIP = 0, 1, 2, 3
_LINES = {_NONE: 1, _RLE: 1, _ZIPS: 1, _ZIP: 16}  # in a chunk
_COMPRESSIONS = ["NONE", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"]
_TYPES = {1: "<f2", 2: "<f4"}  # of a channel: half and float
_WAYS = "exrheader tells what it is; oiiotool or ffmpeg write one that is read: scanlines, half or float, ZIP"
LONGEST = 1 << 16  # bytes of a header that are looked at


@dataclass(frozen=True)
class Header:
    """What a file says of its pixels: their layout, where the table of chunks begins, and the channels in order."""

    width: int
    height: int
    top: int
    compression: int
    channels: tuple[tuple[str, str], ...]
    end: int

    @property
    def row(self) -> int:
        """Bytes of a line of pixels."""
        return self.width * sum(np.dtype(kind).itemsize for _, kind in self.channels)


def parse_header(data: bytes) -> Header:
    """Parse the header of a file, given at least its first 64 KiB; `InputError` if its pixels are not read."""
    _check_kind(data)
    attributes, end = _attributes(data[:LONGEST])
    lacking = [name for name in ("channels", "compression", "dataWindow") if name not in attributes]
    if lacking:
        raise InputError(f"is an OpenEXR image without {lacking[0]}")
    left, top, right, bottom = _unpacked("<4i", attributes["dataWindow"])
    (compression,) = _unpacked("<B", attributes["compression"])
    if compression not in _LINES:
        name = _COMPRESSIONS[compression] if compression < len(_COMPRESSIONS) else str(compression)
        raise InputError(f"is an OpenEXR image of a compression that is not read, {name}: {_WAYS}")
    channels = tuple(_channels(attributes["channels"]))
    return Header(right - left + 1, bottom - top + 1, top, compression, channels, end)


def read_pixels(data: bytes, header: Header) -> NDArray[np.float32]:
    """Decode grey (H, W) or R, G, B (H, W, 3); alpha is dropped. The size has been found to be one that goes."""
    chosen = _chosen([name for name, _ in header.channels])
    lines, height = _LINES[header.compression], header.height
    count = -(-height // lines)
    table = np.frombuffer(_slice(data, header.end, 8 * count), "<u8")
    rows = np.empty((height, header.row), np.uint8)
    seen = np.zeros(height, bool)
    for offset in table.tolist():
        y, size = struct.unpack("<ii", _slice(data, offset, 8))
        first = y - header.top
        if not (0 <= first < height and first % lines == 0) or seen[first]:
            raise InputError(f"is an OpenEXR image with a chunk of line {y}, which is outside or there twice")
        last = min(first + lines, height)
        stored = _slice(data, offset + 8, size)
        rows[first:last] = _decoded(stored, header.compression, (last - first) * header.row).reshape(last - first, -1)
        seen[first:last] = True
    planes = dict(_planes(rows, header))
    pixels = [planes[name].astype(np.float32) for name in chosen]
    return pixels[0] if len(pixels) == 1 else np.stack(pixels, axis=2)


def _check_kind(data: bytes) -> None:
    (version,) = struct.unpack("<I", _slice(data, 4, 4))
    if data[:4] != MAGIC or version & 0xFF != 2:
        raise InputError(f"is an OpenEXR image of version {version & 0xFF}, where 2 is read")
    for flag, kind in ((_DEEP, "deep pixels"), (_MULTIPART, "several parts"), (_TILED, "tiles")):
        if version & flag:
            raise InputError(f"is an OpenEXR image of {kind}, which are not read: {_WAYS}")


def _attributes(data: bytes) -> tuple[dict[str, bytes], int]:
    """Attributes by name, and where they end."""
    found: dict[str, bytes] = {}
    at = 8
    while _slice(data, at, 1) != b"\0":
        name, at = _name(data, at)
        _, at = _name(data, at)
        (size,) = struct.unpack("<i", _slice(data, at, 4))
        found[name] = _slice(data, at + 4, size)
        at += 4 + size
    return found, at + 1


def _channels(data: bytes) -> Iterator[tuple[str, str]]:
    """Name and type of each channel."""
    at = 0
    while _slice(data, at, 1) != b"\0":
        name, at = _name(data, at)
        kind, _, across, down = struct.unpack("<iIii", _slice(data, at, 16))
        if kind not in _TYPES or (across, down) != (1, 1):
            what = "whole numbers" if kind not in _TYPES else "fewer pixels than the others"
            raise InputError(f"is an OpenEXR image whose channel {name[:40]} has {what}, which is not read: {_WAYS}")
        yield name, _TYPES[kind]
        at += 16


def _chosen(names: list[str]) -> list[str]:
    """The names of the channels of luminance: of one layer R, G, B, or a single one; alpha is none."""
    seen = [name for name in names if name.rpartition(".")[2] != "A"]
    if len(seen) == 1:
        return seen
    colours = {name.rpartition(".")[2]: name for name in seen}
    if len(seen) != 3 or set(colours) != set("RGB") or len({name.rpartition(".")[0] for name in seen}) > 1:
        said = ", ".join(name[:20] for name in names[:8]) or "none"
        raise InputError(f"is an OpenEXR image with the channels {said}, where one, or R, G and B are read")
    return [colours[name] for name in "RGB"]


def _planes(rows: NDArray[np.uint8], header: Header) -> Iterator[tuple[str, NDArray[Any]]]:
    start = 0
    for name, kind in header.channels:
        stop = start + header.width * np.dtype(kind).itemsize
        yield name, np.ascontiguousarray(rows[:, start:stop]).view(kind)
        start = stop


def _decoded(stored: bytes, compression: int, size: int) -> NDArray[np.uint8]:
    """Bytes of the lines of a chunk."""
    if compression == _NONE or len(stored) == size:
        plain = np.frombuffer(stored, np.uint8)
    else:
        undo: Callable[[bytes, int], bytes] = _unrolled if compression == _RLE else _inflated
        plain = _joined(np.frombuffer(undo(stored, size), np.uint8))
    if len(plain) != size:
        raise InputError(f"is an OpenEXR image with a chunk of {len(plain)} bytes, expected {size}")
    return plain


def _inflated(stored: bytes, size: int) -> bytes:
    reader = zlib.decompressobj()
    data = reader.decompress(stored, size + 1)
    if not reader.eof:
        raise InputError("is an OpenEXR image with a chunk that is cut off")
    return data


def _unrolled(stored: bytes, size: int) -> bytes:
    """Runs: a count of -n and n bytes as they are, or of n and a byte that is there n + 1 times."""
    out, at = bytearray(), 0
    while at < len(stored) and len(out) <= size:
        count = stored[at] - 256 if stored[at] > 127 else stored[at]
        taken = -count if count < 0 else 1
        piece = _slice(stored, at + 1, taken)
        out += piece if count < 0 else piece * (count + 1)
        at += 1 + taken
    return bytes(out)


def _joined(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Bytes that were stored as differences (128 is none), those of even places first."""
    steps = data.copy()
    steps[1:] -= np.uint8(128)
    summed = np.cumsum(steps, dtype=np.uint8)
    half = (len(data) + 1) // 2
    out = np.empty_like(summed)
    out[0::2], out[1::2] = summed[:half], summed[half:]
    return out


def _name(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at)
    if end < 0:
        raise InputError("is an OpenEXR image with a header that is cut off or too long")
    return data[at:end].decode("latin-1"), end + 1


def _slice(data: bytes, at: int, size: int) -> bytes:
    if size < 0 or at + size > len(data):
        raise InputError("is an OpenEXR image that is truncated or damaged")
    return data[at : at + size]


def _unpacked(form: str, data: bytes) -> tuple[Any, ...]:
    if len(data) != struct.calcsize(form):
        raise InputError("is an OpenEXR image with a damaged header")
    return struct.unpack(form, data)
