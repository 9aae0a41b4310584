"""Depths in messages of ROS: 16-bit millimetres, floats in metres, and PNG behind a header of its own."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._files import reason_of
from ..errors import InputError
from ..io.images import _DECODER_ERRORS, _check_png, _check_size, _open_header, _quiet, load_pixels
from ..types import FloatArray

_MILLIMETRE = 1e-3  # m in one step of 16UC1, as REP 118 has it
_HEADER = struct.Struct("<i2f")  # of compressedDepth: a kind, and both constants of the quantisation of floats
_RAW = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


def depth_of(message: Any, *, is_compressed: bool) -> FloatArray:
    """Return the depths of a message, m, NaN where not known; the InputError says what is wrong, not where."""
    return _compressed(message) if is_compressed else _raw(message)


def _raw(message: Any) -> FloatArray:
    encoding = str(message.encoding)
    if encoding not in _RAW:
        raise InputError(f"has the encoding {encoding[:40]!r}, where depths have one of {', '.join(_RAW)}")
    width, height, step = int(message.width), int(message.height), int(message.step)
    _check_size((width, height))
    dtype = np.dtype(_RAW[encoding]).newbyteorder(">" if message.is_bigendian else "<")
    used = width * dtype.itemsize
    if step < used or message.data.size != step * height:
        said = f"{message.data.size} bytes of data and a step of {step}"
        raise InputError(f"has {said}, where {width} x {height} px of {encoding} go with a step of {used} or more")
    rows = np.ascontiguousarray(message.data.reshape(height, step)[:, :used]).view(dtype)
    return _metres(rows)


def _compressed(message: Any) -> FloatArray:
    """Depths of a PNG: of 16 bits as they are, of floats as ``a / (value - b)``."""
    said, _, how = str(message.format).partition(";")
    if "rvl" in how.lower():
        raise InputError(f"has the format {message.format[:60]!r}: RVL, not PNG")
    data = message.data.tobytes()
    if len(data) <= _HEADER.size:
        raise InputError(f"has {len(data)} bytes, where a header of {_HEADER.size} goes before a PNG")
    _, a, b = _HEADER.unpack_from(data)
    values = _png(data[_HEADER.size :])
    if said.strip() == "16UC1" or not said.strip():
        return _metres(values)
    if said.strip() != "32FC1" or not (0 < a < 1e9 and abs(b) < 1e9):
        raise InputError(f"has the format {message.format[:60]!r}, where 16UC1 or 32FC1 go")
    over = values.astype(np.float64) - b
    with np.errstate(divide="ignore"):
        return np.where((values > 0) & (over > 0), a / over, np.nan)


def _png(data: bytes) -> NDArray[Any]:
    handle = io.BytesIO(data)
    try:
        _check_png(handle)
        with _quiet():
            image = _open_header(handle)
        if image.format != "PNG":
            raise InputError(f"is a {image.format} behind its header, not a PNG")
        _check_size(image.size)
        values = load_pixels(image, handle)
    except _DECODER_ERRORS as error:
        raise InputError(f"cannot be decoded ({reason_of(error)})") from error
    if values.ndim != 2 or values.dtype != np.uint16:
        raise InputError(f"holds {values.dtype} of shape {values.shape}, where 16-bit depths go")
    return values


def _metres(values: NDArray[Any]) -> FloatArray:
    """Depths in metres; 0, what is not finite, and the largest of 16 bits are not known."""
    if values.dtype.kind == "u":
        return np.where((values > 0) & (values < 65_535), values * _MILLIMETRE, np.nan)
    known = values.astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.where((known > 0) & (known < np.inf), known, np.nan)
