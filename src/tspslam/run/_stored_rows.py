"""Rows of the frames that a stopped run has left: its checkpoint and the frames' own files must agree."""

from __future__ import annotations

import json
from dataclasses import replace

from .._files import read_bytes
from ..errors import InputError
from ..io import RunFolder, read_frame
from ..topology.complex import Complex
from ..types import Rig
from ._checkpoint import parse_row
from .record import FrameRecord, flatten_row


def text_of(row: FrameRecord) -> bytes:
    """What is written beside a frame.

    Parameters
    ----------
    row : FrameRecord
        Its numbers.

    Returns
    -------
    bytes
        JSON.
    """
    return (json.dumps(flatten_row(row), indent=1, allow_nan=False) + "\n").encode()


def changed(index: int) -> InputError:
    """Say that a frame is no longer what it was.

    Parameters
    ----------
    index : int
        Of its pair.

    Returns
    -------
    InputError
        To be raised.
    """
    return InputError(f"the images or the files of frame {index} are not those that it was made from")


def find_row(folder: RunFolder, row: FrameRecord, rig: Rig, *, is_whole: bool) -> FrameRecord:
    """Find the row of a stored frame: the checkpoint's, or that of a frame made anew at the path's end before a stop.

    What is made anew is what that end of the path makes of it: where pairs have come since, the end is another one.

    Parameters
    ----------
    folder : RunFolder
        With the frame's files.
    row : FrameRecord
        As the checkpoint has it, with a complex.
    rig : Rig
        Of the pairs.
    is_whole : bool
        Whether the checkpoint is of all pairs.

    Returns
    -------
    FrameRecord

    Raises
    ------
    InputError
        If the files are not as they were left, or of another frame than the row's.
    """
    path = folder.frame_path(row.index)
    files = path, path.with_suffix(".json")
    if not all(folder.is_done(file, input_hash=row.input_hash) for file in files):
        raise changed(row.index)
    frame, text = read_frame(path), read_bytes(files[1], "the numbers of a frame")
    is_anew = frame.rig != rig
    if is_anew and not is_whole:
        raise InputError(f"frame {row.index} was made for the offset of a shorter path")
    stored = parse_row(text) if is_anew else row
    found = frame.index, frame.is_keyframe, frame.is_lost, *_sizes(frame.complex_)
    same_path = replace(stored, complex_=None) == replace(row, complex_=None)
    if not same_path or text != text_of(stored) or found != _noted(stored):
        raise changed(row.index)
    return stored


def _noted(row: FrameRecord) -> tuple[int, ...] | None:
    """What a row says of its frame."""
    complex_ = row.complex_
    if complex_ is None:
        return None
    return row.index, row.is_keyframe, row.is_lost, complex_.points, complex_.edges, complex_.faces


def _sizes(complex_: Complex) -> tuple[int, int, int]:
    return complex_.n, len(complex_.edges), len(complex_.faces)
