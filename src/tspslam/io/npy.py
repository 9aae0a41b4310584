"""A plane of numbers from a .npy file, whose header is matched and never evaluated."""

from __future__ import annotations

import os
import re
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, open_input, reason_of
from ..errors import InputError

LARGEST_HEADER = 10_000  # bytes; NumPy's own limit
_TYPE = re.compile(r"""['"]descr['"]\s*:\s*['"]([<>|=]?[A-Za-z]\d{0,3})['"]""")
_ORDER = re.compile(r"""['"]fortran_order['"]\s*:\s*(True|False)\b""")
# A Python 2 wrote 3L for 3.
_SHAPE = re.compile(r"""['"]shape['"]\s*:\s*\(([0-9]{1,10}L?,\s*(?:[0-9]{1,10}L?,\s*){0,32}(?:[0-9]{1,10}L?)?|)\)""")


class _Header(NamedTuple):
    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    order: str


def read_npy(path: PathLike, expected: str, most: int) -> NDArray[Any]:
    """Read a plane of numbers from a .npy file of format version 1, 2 or 3; nothing is evaluated or unpickled.

    Parameters
    ----------
    path : str or path
        The file.
    expected : str
        What it should be, for the error.
    most : int
        Numbers that it may hold.

    Returns
    -------
    (H, W) integers or floats
        Of the file's own type, in native byte order.

    Raises
    ------
    InputError
        If it cannot be read, is damaged, holds no plane of whole numbers or floats, more than `most`, or fewer than it
        claims.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/depth.npy", np.ones((2, 3)))
    ...     read_npy(f"{folder}/depth.npy", "a map", 100).shape
    (2, 3)
    """
    with open_input(path, expected) as handle:
        try:
            header = _read_header(handle)
            size = _checked_size(header, most, os.fstat(handle.fileno()).st_size - handle.tell())
            values = np.frombuffer(handle.read(size), header.dtype)
        except InputError as error:
            raise bad_input(path, str(error), expected) from error
        except (OSError, ValueError, MemoryError) as error:
            raise bad_input(path, f"is no sound .npy file ({reason_of(error)})", expected) from error
    native = values.astype(header.dtype.newbyteorder("="))
    return np.ascontiguousarray(native.reshape(header.shape, order="F" if header.order == "True" else "C"))


def _read_header(handle: BinaryIO) -> _Header:
    start = handle.read(8)
    if len(start) < 8 or start[:6] != b"\x93NUMPY" or start[6] not in (1, 2, 3):
        raise InputError("is no .npy file of version 1, 2 or 3")
    length = int.from_bytes(handle.read(2 if start[6] == 1 else 4), "little")
    if length > LARGEST_HEADER:
        raise InputError(f"claims a .npy header of {length} bytes, where up to {LARGEST_HEADER} go")
    text = handle.read(length).decode("latin-1")
    found = [pattern.search(text) for pattern in (_TYPE, _ORDER, _SHAPE)]
    code, order, shape = (each.group(1) if each else None for each in found)
    if code is None or order is None or shape is None:
        raise InputError(f"has no plain type, order and shape in its .npy header {text[:60]!r}")
    try:
        dtype = np.dtype(code)
    except TypeError as error:
        raise InputError(f"holds the unknown type {code!r}") from error
    return _Header(dtype, tuple(int(digits) for digits in re.findall(r"\d+", shape)), order)


def _checked_size(header: _Header, most: int, there: int) -> int:
    """Bytes of the numbers, once it is known that they are a plane, not too many, and all there."""
    count = 1
    for side in header.shape:
        count *= side
    what = f"holds {header.dtype} of shape {header.shape}"
    if len(header.shape) != 2 or header.dtype.kind not in "iuf" or count > most:
        raise InputError(what)
    if count * header.dtype.itemsize > there:
        raise InputError(f"{what} in {there} bytes")
    return count * header.dtype.itemsize
