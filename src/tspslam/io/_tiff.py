"""Checks of a TIFF that its decoder leaves out: the sums of pixels that are compressed by deflate."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any, BinaryIO

from ..errors import InputError

if TYPE_CHECKING:
    from PIL import Image

_COMPRESSION = 259
_DEFLATE = (8, 32946)
_STRIP_PLACES, _STRIP_LENGTHS, _TILE_PLACES, _TILE_LENGTHS = 273, 279, 324, 325
_PIECE = 1 << 20  # bytes at once
_WIDEST = 32  # bytes of a pixel, 4 of 64 bits: more would be a bomb
_SLACK = 1 << 24  # bytes: tiles at the borders are whole


def check_deflate(image: Image.Image, handle: BinaryIO) -> None:
    """Refuse an open TIFF whose strips or tiles end early or have another sum than they say; others pass."""
    tags: Any = getattr(image, "tag_v2", {})
    if tags.get(_COMPRESSION) not in _DEFLATE:
        return
    places = tags.get(_STRIP_PLACES) or tags.get(_TILE_PLACES) or ()
    lengths = tags.get(_STRIP_LENGTHS) or tags.get(_TILE_LENGTHS) or ()
    if len(places) != len(lengths) or not places:
        raise InputError(f"has {len(places)} parts and the lengths of {len(lengths)}")
    left = image.size[0] * image.size[1] * _WIDEST + _SLACK
    before = handle.tell()
    for place, length in zip(places, lengths, strict=True):
        handle.seek(place)
        left -= _inflated_size(handle.read(length), left)
    handle.seek(before)


def _inflated_size(stored: bytes, most: int) -> int:
    """Bytes of a stream that is whole."""
    reader, size = zlib.decompressobj(), 0
    while not reader.eof:
        size += len(reader.decompress(stored, _PIECE))
        if size > most:
            raise InputError("has compressed pixels that are more than its size")
        if not reader.unconsumed_tail and not reader.eof:
            raise InputError("is truncated or damaged: compressed pixels end early")
        stored = reader.unconsumed_tail
    return size
