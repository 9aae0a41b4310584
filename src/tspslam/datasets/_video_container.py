"""What a video's file says of itself where OpenCV does not: why it cannot be read, and sizes of its frames."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

_LARGEST_INDEX = 1 << 26  # bytes of a moov box that is looked at
_MOST_BOXES = 1000
_NO_LENGTH = 0xD8, 0x01, *range(0xD0, 0xD8)  # markers of a JPEG that stand alone
_FRAME = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers of a JPEG that its size follows
_MP4 = b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide"  # boxes that such a file begins with


def unreadable(path: Path, codec: str | None) -> str:
    """Say why FFmpeg opens no video in a file.

    Parameters
    ----------
    path : Path
        The file; it is there.
    codec : str or None
        Four characters of the codec, where the container is read and the codec is not.

    Returns
    -------
    str
        What is wrong.
    """
    if codec is not None:
        return f"has the codec {codec!r}, which is not read"
    with contextlib.suppress(OSError), open(path, "rb") as handle:
        index = dict(_boxes(handle, path.stat().st_size))
        if index:
            return _lacking(index)
    return "is not a video, or its header is damaged"


def _lacking(boxes: dict[bytes, bytes]) -> str:
    """What an MP4 or MOV file lacks."""
    if b"moov" not in boxes:
        return "is a video that was cut off: its index (moov), which comes last, is missing"
    has = {kind for kind in (b"vide", b"soun") if kind in boxes[b"moov"]}
    return "has sound alone, no video" if has == {b"soun"} else "has an index (moov) without a video, or a damaged one"


def _boxes(handle: BinaryIO, size: int) -> Iterator[tuple[bytes, bytes]]:
    """Boxes of an MP4 or MOV file that are whole, and the content of its index."""
    place = 0
    for count in range(_MOST_BOXES):
        handle.seek(place)
        head = handle.read(16)
        kind = head[4:8]
        if len(head) < 8 or (count == 0 and kind not in _MP4):
            return
        length = int.from_bytes(head[:4], "big")
        length = int.from_bytes(head[8:16], "big") if length == 1 else length or size - place
        if length < 8:
            return
        is_index = kind == b"moov" and place + length <= size
        handle.seek(place + 8)
        if kind != b"moov" or is_index:
            yield kind, handle.read(min(length - 8, _LARGEST_INDEX)) if is_index else b""
        place += length
        if place >= size:
            return


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height of a JPEG, from its header.

    Parameters
    ----------
    data : bytes
        Its content.

    Returns
    -------
    tuple of 2 int, or None
        px; None where there is no whole header.
    """
    place = 0
    while place + 9 <= len(data) and data[place] == 0xFF:
        marker = data[place + 1]
        if marker in _FRAME:
            return int.from_bytes(data[place + 7 : place + 9], "big"), int.from_bytes(
                data[place + 5 : place + 7], "big"
            )
        place += 2 if marker in _NO_LENGTH else 2 + int.from_bytes(data[place + 2 : place + 4], "big")
    return None
