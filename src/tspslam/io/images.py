"""Images from disk as arrays, and arrays as PNG."""

from __future__ import annotations

import contextlib
import io
import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._files import PathLike, bad_input, open_input, reason_of
from ..errors import InputError
from . import _exr
from ._tiff import check_deflate

if TYPE_CHECKING:
    from PIL import Image

Pixels = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]

LARGEST_AREA = 64_000_000
LARGEST_SIDE = 32_767
_FORMATS = ("PNG", "JPEG", "TIFF", "PPM", "BMP", "WEBP")
_EXPECTED = "a PNG, JPEG, TIFF, PGM, PPM, BMP, WebP, PFM or OpenEXR image"
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_TIFF_MAGIC = (b"II", b"MM")
_WHITE_IS_ZERO, _PHOTOMETRIC, _ORIENTATION = 0, 262, 274  # of a TIFF; the last of EXIF too
_TURNED = range(2, 9)  # of its values, those that are not upright
_OTHERS = {
    b"ftypavif": "AVIF",
    b"ftypavis": "AVIF",
    b"ftypheic": "HEIC",
    b"ftypheix": "HEIC",
    b"ftypmif1": "HEIF",
    b"JXL \r\n": "JPEG XL",
    b"\xff\x0a": "JPEG XL",
    b"jP  \r\n": "JPEG 2000",
    b"#?RADIANCE": "Radiance HDR",
    b"GIF8": "GIF",
}
"""Of images that are not read: what stands at the head of the file, or 4 bytes behind it."""
# Pillow's decoders meet damaged files with all of these.
_DECODER_ERRORS = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    AttributeError,
    RuntimeError,
    EOFError,
    MemoryError,
    struct.error,
    zlib.error,
)
_HEAD = 16  # bytes that tell the kind
_quiet_lock = threading.Lock()


def read_image(path: PathLike) -> Pixels:
    """Read a PNG, JPEG, TIFF, PGM, PPM, BMP, WebP, grey PFM or OpenEXR image.

    The header comes first: more than 64 megapixels, or a side over 32 767 px, is refused before any pixel is decoded.
    A PNG's checksums are all verified. Alpha is dropped, not blended. Palettes, CMYK, YCbCr and HSV become RGB; one
    bit becomes 0 and 255. 16-bit grey and colour stay 16-bit, whatever part of the 16 bits they use; a PGM or PPM is
    spread from its own largest value to 65535. Floats (PFM, TIFF, OpenEXR of one channel or R, G, B) stay, if they are
    from 0 to 1. Of several pages the first is read. Gamma is not applied. An image whose EXIF orientation is not
    upright is refused: programs that calibrate turn it or don't, and nothing tells which. A damaged JPEG or WebP that
    still decodes is returned, since the formats have no checksum; so is a TIFF, but for one of deflate.

    Parameters
    ----------
    path : str or path
        The image file.

    Returns
    -------
    (H, W) or (H, W, 3) uint8, uint16 or float32
        uint16 for pixels of more than 8 bits; colour is RGB.

    Raises
    ------
    InputError
        If the file is missing, not an image of these kinds, truncated, damaged, too large, to be turned, or holds
        pixels that are neither integers of at most 16 bits nor floats from 0 to 1.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_png(f"{folder}/grey.png", np.zeros((2, 3), np.uint16))
    ...     read_image(f"{folder}/grey.png").shape
    (2, 3)
    """
    with open_input(path, _EXPECTED) as handle, _named(path, _EXPECTED):
        if is_exr(handle):
            return _luminance(_exr_pixels(handle))
        return load_pixels(_opened(handle), handle)


def read_numbers(path: PathLike, expected: str) -> NDArray[Any]:
    """Read an image file whose pixels are numbers rather than luminance, such as depths, as they were written.

    Parameters
    ----------
    path : str or path
        A PNG, TIFF, PGM, BMP or JPEG, or a PFM or OpenEXR of floats.
    expected : str
        What to say was expected, if it is none.

    Returns
    -------
    (H, W) or (H, W, 3) uint8, uint16, int32 or float32
        A PFM's last row comes first in the file and last here.

    Raises
    ------
    InputError
        As `read_image`, except that pixels need not be integers of 16 bits.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_png(f"{folder}/depth.png", np.full((2, 3), 1500, np.uint16))
    ...     int(read_numbers(f"{folder}/depth.png", "a map")[0, 0])
    1500
    """
    with open_input(path, expected) as handle, _named(path, expected):
        if is_exr(handle):
            return _exr_pixels(handle)
        image = _opened(handle)
        most = _declared(image)
        if image.mode not in ("I", "F"):
            pixels = load_pixels(image, handle)
            return pixels if most is None or pixels.ndim == 3 else _undone(pixels, most, 255)
        _load(image, handle)
        numbers = np.array(image)
        return numbers if most is None or image.mode == "F" else _undone(numbers, most, 65_535)


def image_size(path: PathLike) -> tuple[int, int]:
    """Read the width and height of an image from its header; no pixel is decoded.

    Parameters
    ----------
    path : str or path
        The image file.

    Returns
    -------
    width, height : int
        px.

    Raises
    ------
    InputError
        As `read_image`, but for damage behind the header.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_png(f"{folder}/grey.png", np.zeros((2, 3), np.uint16))
    ...     image_size(f"{folder}/grey.png")
    (3, 2)
    """
    with open_input(path, _EXPECTED) as handle, _named(path, _EXPECTED):
        if is_exr(handle):
            found = _exr.parse_header(handle.read(_exr.LONGEST))
            size = found.width, found.height
        else:
            with _quiet():
                size = _open_header(handle).size
        _check_size(size)
        return size


def write_png(path: PathLike, array: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write an array as PNG, whole or not at all; one version of Pillow gives the same array the same bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    array : (H, W) uint8 or uint16, or (H, W, 3) uint8
        Grey values, or RGB.

    Raises
    ------
    InputError
        If the array has another shape or dtype, or no pixel.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_png(f"{folder}/red.png", np.full((2, 2, 3), (255, 0, 0), np.uint8))
    ...     read_image(f"{folder}/red.png")[0, 0].tolist()
    [255, 0, 0]
    """
    from PIL import Image

    pixels = np.ascontiguousarray(array)
    grey = pixels.ndim == 2 and pixels.dtype in (np.uint8, np.uint16)
    colour = pixels.ndim == 3 and pixels.shape[2] == 3 and pixels.dtype == np.uint8
    if not (grey or colour) or pixels.size == 0:
        raise bad_input(
            path, f"cannot hold a {pixels.dtype} array of shape {pixels.shape}", "grey uint8 or uint16, or RGB uint8"
        )
    encoded = io.BytesIO()
    Image.fromarray(pixels).save(encoded, format="PNG", compress_level=6)
    write_bytes(path, encoded.getvalue())


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    # The filters are global to the process: without the lock two threads could restore each other's.
    with _quiet_lock, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def _named(path: PathLike, expected: str) -> Iterator[None]:
    """Turn whatever decoders raise into the one line about a file."""
    try:
        yield
    except InputError as error:
        raise bad_input(path, str(error), expected) from error
    except _DECODER_ERRORS as error:
        raise bad_input(path, f"cannot be decoded ({reason_of(error)})", expected) from error


def _opened(handle: BinaryIO) -> Image.Image:
    """An image whose header is read, and whose size is one that goes."""
    _check_png(handle)
    with _quiet():
        image = _open_header(handle)
    _check_size(image.size)
    return image


def _open_header(handle: BinaryIO) -> Image.Image:
    from PIL import Image, UnidentifiedImageError

    try:
        return Image.open(handle, formats=_FORMATS)
    except UnidentifiedImageError as error:
        handle.seek(0)
        head = handle.read(_HEAD)
        kind = next(
            (kind for mark, kind in _OTHERS.items() if head.startswith(mark) or head[4:].startswith(mark)), None
        )
        if kind:
            raise InputError(f"is an image of a kind that is not read, {kind}") from error
        if head[:2] in _TIFF_MAGIC:
            said = "is a TIFF that is damaged, or of pixels that are not read (such as float64 or planes of 16 bits)"
            raise InputError(f"{said}: uint8, uint16 and, for maps, float32 are") from error
        raise InputError("is not an image, or its header is damaged") from error
    except Image.DecompressionBombError as error:
        raise InputError(f"has more than {LARGEST_AREA} px") from error


def _check_size(size: tuple[int, int]) -> None:
    width, height = size
    if min(size) < 1 or max(size) > LARGEST_SIDE or width * height > LARGEST_AREA:
        raise InputError(f"is {width} x {height} px, where 1 to {LARGEST_SIDE} a side and {LARGEST_AREA} in all go")


def _check_png(handle: BinaryIO) -> None:
    """Verify every chunk of a PNG up to its end mark; Pillow leaves out the pixels' checksums."""
    size = handle.seek(0, io.SEEK_END)
    handle.seek(0)
    magic = handle.read(len(_PNG_MAGIC))
    kind = b""
    while magic == _PNG_MAGIC and kind != b"IEND":
        header = handle.read(8)
        if len(header) < 8:
            raise InputError("is truncated")
        length, kind = struct.unpack(">I4s", header)
        if length + 4 > size - handle.tell():
            raise InputError("is truncated")
        body, checksum = handle.read(length), handle.read(4)
        if zlib.crc32(kind + body).to_bytes(4, "big") != checksum:
            raise InputError("has a wrong checksum")
    handle.seek(0)


def load_pixels(image: Image.Image, handle: BinaryIO) -> Pixels:
    """Decode an image, grey or RGB.

    Parameters
    ----------
    image : PIL.Image.Image
        As it was opened from `handle`.
    handle : binary file
        The open file.

    Returns
    -------
    (H, W) or (H, W, 3) uint8 or uint16, or (H, W) float32
    """
    _refuse_turned(image)
    deep, most = _depth_that_is_cut(image), _declared(image)
    _load(image, handle)
    return _pixels(image) if deep is None else _deep_pixels(image, handle, deep, most)


def is_exr(handle: BinaryIO) -> bool:
    """Tell whether an open file is an OpenEXR image; it is left at its begin.

    Parameters
    ----------
    handle : binary file
        The open file.

    Returns
    -------
    bool
    """
    handle.seek(0)
    head = handle.read(len(_exr.MAGIC))
    handle.seek(0)
    return head == _exr.MAGIC


def _exr_pixels(handle: BinaryIO) -> NDArray[np.float32]:
    data = handle.read()
    header = _exr.parse_header(data)
    _check_size((header.width, header.height))
    return _exr.read_pixels(data, header)


def _load(image: Image.Image, handle: BinaryIO) -> None:
    check_deflate(image, handle)
    with _quiet() if image.format == "TIFF" else contextlib.nullcontext():
        image.load()


def _layout(image: Image.Image) -> tuple[str, list[Any]]:
    """Name of the decoder that an image asks for, and its arguments; before it is loaded."""
    tiles: list[Any] = getattr(image, "tile", [])
    if not tiles:
        return "", [""]
    arguments = tiles[0][3]
    return str(tiles[0][0]), list(arguments) if isinstance(arguments, tuple) and arguments else [arguments or ""]


def _declared(image: Image.Image) -> int | None:
    """Largest value that a PGM or PPM declares, if its pixels are spread from it; before it is loaded."""
    codec, arguments = _layout(image)
    return int(arguments[1]) if codec in ("ppm", "ppm_plain") and len(arguments) > 1 else None


def _undone(values: NDArray[Any], declared: int, spread: int) -> NDArray[np.uint16]:
    """Values as they stand in a PGM file, which were spread from its largest value."""
    return np.rint(values * (declared / spread)).astype(np.uint16)


def _depth_that_is_cut(image: Image.Image) -> str | None:
    """Name of the layout of colour, or of grey with alpha, whose 16 bits Pillow cuts to 8; before it is loaded."""
    layout = str(_layout(image)[1][0])
    is_colour = image.mode in ("RGB", "RGBA", "RGBX", "LA")
    return layout if is_colour and (";16" in layout or (_declared(image) or 0) > 255) else None


def _deep_pixels(image: Image.Image, handle: BinaryIO, layout: str, most: int | None) -> NDArray[np.uint16]:
    """All 16 bits of an image that Pillow found whole."""
    import cv2

    handle.seek(0)
    try:
        pixels = cv2.imdecode(np.frombuffer(handle.read(), np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise InputError(f"cannot be decoded ({reason_of(error)})") from error
    if pixels is None or pixels.dtype != np.uint16 or pixels.shape[:2] != image.size[::-1] or pixels.ndim != 3:
        raise InputError(f"has 16-bit colour of a kind that is not read ({layout})")
    if most is not None:
        pixels = np.rint(np.minimum(pixels, most) * (65_535 / most)).astype(np.uint16)
    return np.ascontiguousarray(pixels[..., 0] if layout.startswith("LA") else pixels[..., 2::-1])


def _pixels(image: Image.Image) -> Pixels:
    mode = image.mode
    if mode in ("L", "RGB"):
        return np.array(image)
    if mode in ("RGBA", "RGBX"):
        return np.ascontiguousarray(np.asarray(image)[..., :3])
    if mode == "LA":
        return np.array(image.getchannel("L"))
    if mode == "I" or mode.startswith("I;16"):
        return _upright(image, _grey16(np.asarray(image)))
    if mode == "F":
        return _luminance(np.array(image))
    image.info.pop("transparency", None)
    if mode in ("1", "La"):
        return np.array(image.convert("LA").getchannel("L") if mode == "La" else image.convert("L"))
    if mode in ("RGBa", "PA"):
        return np.ascontiguousarray(np.asarray(image.convert("RGBA"))[..., :3])
    return np.array(image.convert("RGB"))


def _luminance(values: NDArray[np.float32]) -> NDArray[np.float32]:
    low, high = float(values.min()), float(values.max())
    if not (low >= 0 and high <= 1):  # NaN too
        said = f"holds floating-point pixels from {low:g} to {high:g}, as maps of depth do (--depth, --disparity)"
        raise InputError(f"{said}, where luminance goes from 0 to 1")
    return values


def _refuse_turned(image: Image.Image) -> None:
    """Refuse an image that viewers turn; before it is loaded, since Pillow turns TIFFs then."""
    from PIL.Image import Exif

    exif = Exif()
    with contextlib.suppress(*_DECODER_ERRORS), _quiet():  # cameras write damaged ones
        exif.load(image.info.get("exif", b""))
    flag = getattr(image, "tag_v2", exif).get(_ORIENTATION)
    if flag in _TURNED:
        ways = "magick mogrify -auto-orient turns it, exiftool -Orientation#=1 drops the flag"
        raise InputError(f"has the EXIF orientation {flag}, and its calibration may be of turned pixels or not: {ways}")


def _upright(image: Image.Image, values: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Grey values, bright ones large; Pillow turns TIFFs whose 0 is white only if they have 8 bits."""
    tags = getattr(image, "tag_v2", {})
    return np.uint16(65_535) - values if tags.get(_PHOTOMETRIC, 1) == _WHITE_IS_ZERO else values


def _grey16(values: NDArray[np.generic]) -> NDArray[np.uint16]:
    wide = values.astype(np.int64)
    if wide.size and (wide.min() < 0 or wide.max() > 65_535):
        raise InputError(f"holds grey values from {wide.min()} to {wide.max()}, where 0 to 65535 go")
    return wide.astype(np.uint16)
