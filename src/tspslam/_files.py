"""Opening what a user names, and saying in one line what is wrong with it."""

from __future__ import annotations

import errno
import os
import stat
from typing import BinaryIO

from ._checks import require_path
from .errors import InputError

PathLike = str | os.PathLike[str]

LARGEST_FILE = 1 << 32
"""Bytes; a larger file is refused before it is read."""
_JUNCTION = 0xA0000003  # IO_REPARSE_TAG_MOUNT_POINT

# Deflate packs up to 1032 : 1, and arrays of a file may share their bytes; real ones stay below 64 : 1 as a whole.
_UNPACKED, _UNPACKED_EACH = 1 << 28, 64  # bytes for any file, and for each of its bytes


def one_line(text: str) -> str:
    """Return `text` without line breaks and control characters; bytes of a name that are no text are escaped."""
    plain = text.encode("utf-8", "backslashreplace").decode("utf-8")
    return " ".join("".join(character if character.isprintable() else " " for character in plain).split())


def bad_input(path: PathLike, reason: str, expected: str) -> InputError:
    """Return the one-line error for a file: where, what is wrong, what was expected."""
    return InputError(one_line(f"{path}: {reason}; expected {expected}"))


def reason_of(error: Exception) -> str:
    """Return why the operating system or a decoder refused, in a few words."""
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return said[:200] or type(error).__name__


def unpacked_limit(size: int) -> int:
    """Bytes that all arrays of a file of `size` bytes may take together once they are unpacked."""
    return min(LARGEST_FILE, _UNPACKED + _UNPACKED_EACH * size)


def is_link(status: os.stat_result) -> bool:
    """Whether `os.lstat` found a link: a symbolic one, or a junction of Windows."""
    return stat.S_ISLNK(status.st_mode) or getattr(status, "st_reparse_tag", 0) == _JUNCTION


def open_own(path: str, flags: int) -> int:
    """As `opener` of `open`: writes only into a regular file that has this one name, never through a link."""
    # Windows has neither flag; there, who writes has looked for links before.
    kept = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    descriptor = os.open(path, flags | kept, 0o666)
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and status.st_nlink <= 1:
        return descriptor
    os.close(descriptor)
    raise OSError(errno.EMLINK, "is no regular file, or has a second name")


def open_input(path: PathLike, expected: str, largest: int = LARGEST_FILE) -> BinaryIO:
    """Open a regular, non-empty file for reading; anything else (a folder, a pipe, a device) is an `InputError`."""
    require_path(path)
    try:
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode):
            raise bad_input(path, "is a directory", expected)
        if not stat.S_ISREG(status.st_mode):
            raise bad_input(path, "is not a regular file", expected)
        if status.st_size == 0:
            raise bad_input(path, "is empty", expected)
        if status.st_size > largest:
            raise bad_input(path, f"has {status.st_size} bytes", f"{expected} of at most {largest} bytes")
        return open(path, "rb")
    except (OSError, ValueError) as error:
        raise bad_input(path, f"cannot be opened ({reason_of(error)})", expected) from error


def read_bytes(path: PathLike, expected: str, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a regular, non-empty file."""
    with open_input(path, expected, largest) as handle:
        try:
            return handle.read()
        except (OSError, MemoryError) as error:
            raise bad_input(path, f"cannot be read ({reason_of(error)})", expected) from error
