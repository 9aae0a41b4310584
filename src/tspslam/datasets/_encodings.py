"""The pixels of messages with images: every encoding that is read, and compressed images."""

from __future__ import annotations

import io
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._files import reason_of
from ..errors import InputError
from ..io.images import _DECODER_ERRORS, _check_png, _check_size, _open_header, _quiet, load_pixels
from ..types import Image

COMPRESSED = "sensor_msgs/msg/CompressedImage"
_SMALLEST_MOSAIC = 3  # px a side
_PADDED, _PADDING = 2, 4096  # of a row: one image of two side by side, and bytes to the end of a page of memory
_GREY, _RGB, _BGR = (0,), (0, 1, 2), (2, 1, 0)
_ENCODINGS: dict[str, tuple[str, int, tuple[int, ...]]] = {
    "mono8": ("u1", 1, _GREY),
    "8UC1": ("u1", 1, _GREY),
    "mono16": ("u2", 1, _GREY),
    "16UC1": ("u2", 1, _GREY),
    "rgb8": ("u1", 3, _RGB),
    "bgr8": ("u1", 3, _BGR),
    "8UC3": ("u1", 3, _BGR),  # OpenCV's order, as cv_bridge takes it
    "rgba8": ("u1", 4, _RGB),
    "bgra8": ("u1", 4, _BGR),
    "8UC4": ("u1", 4, _BGR),
    "rgb16": ("u2", 3, _RGB),
    "bgr16": ("u2", 3, _BGR),
    "16UC3": ("u2", 3, _BGR),
    "rgba16": ("u2", 4, _RGB),
    "bgra16": ("u2", 4, _BGR),
}
"""For each encoding: type of a value, values of a pixel, and which of them are grey or R, G, B."""
_MOSAICS = {
    f"bayer_{order}{bits}": f"COLOR_Bayer{order.upper()}2RGB"
    for bits in (8, 16)
    for order in ("rggb", "bggr", "gbrg", "grbg")
}
"""For each encoding of a Bayer mosaic: OpenCV's name of what makes it RGB."""
_ENCODINGS |= {name: ("u2" if name.endswith("16") else "u1", 1, _GREY) for name in _MOSAICS}
_UYVY, _YUYV = "COLOR_YUV2RGB_UYVY", "COLOR_YUV2RGB_YUY2"
_PAIRED = {"yuv422": _UYVY, "uyvy": _UYVY, "yuv422_yuy2": _YUYV, "yuyv": _YUYV}
"""For each encoding whose two pixels share their colour, 4:2:2: OpenCV's name of what makes it RGB."""
_ENCODINGS |= dict.fromkeys(_PAIRED, ("u1", 2, _GREY))
_PLANES = {"nv12": "COLOR_YUV2RGB_NV12", "nv21": "COLOR_YUV2RGB_NV21"}
"""For each encoding with half as many rows of colour, 4:2:0, below those of luma: OpenCV's name, likewise."""
_ENCODINGS |= dict.fromkeys(_PLANES, ("u1", 1, _GREY))
# OpenCV's conversions of YUV are those of BT.601 with luma from 16 to 235, as cv_bridge has them.
_MOSAIC = re.compile(r"bayer_(?:rggb|bggr|gbrg|grbg)(?:8|16)")


def image_of(message: Any, kind: str) -> Image:
    """Return the pixels of an image message, grey or RGB; the InputError says what is wrong, not where."""
    return _compressed(message) if kind == COMPRESSED else _raw(message)


def _raw(message: Any) -> Image:
    encoding = str(message.encoding)
    if encoding not in _ENCODINGS:
        floats = ": floats are maps of depth, no luminance" if encoding.startswith(("32F", "64F")) else ""
        raise InputError(f"has the encoding {encoding[:40]!r}, not one of {', '.join(_ENCODINGS)}{floats}")
    width, height = int(message.width), int(message.height)
    _check_size((width, height))
    _check_even(encoding, width, height)
    kind, count, channels = _ENCODINGS[encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    rows = _rows(message, width * count * dtype.itemsize).view(dtype).astype(dtype.newbyteorder("="), copy=False)
    if encoding in _MOSAICS:
        return _coloured(rows, _MOSAICS[encoding])
    if encoding in _PAIRED:
        return _of_yuv(rows.reshape(height, width, 2), _PAIRED[encoding])
    if encoding in _PLANES:
        return _of_yuv(rows, _PLANES[encoding])
    return rows if count == 1 else np.ascontiguousarray(rows.reshape(height, width, count)[..., channels])


def _rows(message: Any, used: int) -> NDArray[np.uint8]:
    """Bytes of each row without what fills it up; of luma and colour in planes, those of the colour below."""
    encoding, step, height = str(message.encoding), int(message.step), int(message.height)
    count = height * 3 // 2 if encoding in _PLANES else height
    if not used <= step <= _PADDED * used + _PADDING or message.data.size != step * count:
        said = f"{message.data.size} bytes of data and a step of {step}"
        wanted = f"{message.width} x {height} px of {encoding} go with a step of {used} or somewhat more"
        raise InputError(f"has {said}, where {wanted}")
    return np.array(message.data.reshape(count, step)[:, :used], np.uint8, order="C")


def _check_even(encoding: str, width: int, height: int) -> None:
    """Refuse an odd side along which pixels share their colour."""
    if (encoding in _PAIRED and width % 2) or (encoding in _PLANES and (width % 2 or height % 2)):
        raise InputError(f"is {width} x {height} px of {encoding}, where colour that pixels share needs even sides")


def _of_yuv(values: Image, conversion: str) -> Image:
    import cv2

    made: Image = cv2.cvtColor(values, getattr(cv2, conversion))
    return made


def _coloured(mosaic: Image, conversion: str) -> Image:
    import cv2

    if min(mosaic.shape) < _SMALLEST_MOSAIC:
        said = f"{mosaic.shape[1]} x {mosaic.shape[0]} px"
        raise InputError(f"is a Bayer mosaic of {said}, where at least {_SMALLEST_MOSAIC} a side go")
    made: Image = cv2.cvtColor(mosaic, getattr(cv2, conversion))
    return made


def _compressed(message: Any) -> Image:
    handle = io.BytesIO(message.data.tobytes())
    try:
        _check_png(handle)
        with _quiet():
            image = _open_header(handle)
        if image.format not in ("JPEG", "PNG"):
            raise InputError(f"is a {image.format}, not a JPEG or PNG")
        _check_size(image.size)
        return _unmixed(load_pixels(image, handle), str(message.format))
    except _DECODER_ERRORS as error:
        raise InputError(f"cannot be decoded ({reason_of(error)})") from error


def _unmixed(pixels: Image, said: str) -> Image:
    """Colour of a mosaic that was compressed as it is; what was decoded otherwise."""
    before, _, after = said.partition("compressed")
    kind = after.strip() or before
    if "bayer" not in kind:
        return pixels
    mosaic = _MOSAIC.search(kind)
    if mosaic is None or pixels.ndim != 2:
        what = "another order of colours" if mosaic is None else "an image in colour"
        raise InputError(f"has the format {said[:40]!r}: {what}, not a grey mosaic of {', '.join(_MOSAICS)}")
    return _coloured(pixels, _MOSAICS[mosaic[0]])
