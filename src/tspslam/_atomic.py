"""Files that are either complete or not there."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ._files import PathLike, one_line, reason_of
from .errors import OutputError

TEMPORARY_PREFIX = ".tspslam-"
TEMPORARY_SUFFIX = ".tmp"
NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
"""Why the system refuses to write, whoever asks; compiled kernels on their way to disk meet them too."""
_NO_FOLDER_SYNC = {errno.EINVAL, errno.EACCES, errno.EPERM, errno.EBADF, errno.ENOTSUP, errno.EISDIR, errno.ENOSYS}


def bad_output(path: PathLike, error: Exception) -> OutputError:
    """Return the one-line error for a file that could not be written."""
    return OutputError(
        one_line(f"{path}: cannot be written ({reason_of(error)}); expected a writable place with space")
    )


def make_folder(folder: Path) -> list[Path]:
    """Make a folder, and those above it; `OutputError` if that cannot be done. Returns those made, the first first."""
    try:
        made = [place for place in (*reversed(folder.parents), folder) if not place.exists()]
        folder.mkdir(parents=True, exist_ok=True)
        return made
    except (OSError, ValueError) as error:
        raise bad_output(folder, error) from error


@contextlib.contextmanager
def atomic_write(path: PathLike) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that takes its place when the block ends without an error.

    The file is flushed and synced to disk before it is renamed, and its folder after that, where the system can do
    so. On any failure, an interruption included, the temporary file is removed and `path` is as it was.

    Parameters
    ----------
    path : str or path
        The file to write; its folder must exist. A link stays a link, its target is replaced.

    Yields
    ------
    binary file
        Open for writing.

    Raises
    ------
    OutputError
        If the system refuses (read-only, no space, no such folder), or `path` is there but not a regular file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with atomic_write(f"{folder}/a.bin") as handle:
    ...         _ = handle.write(b"whole")
    ...     Path(folder, "a.bin").read_bytes()
    b'whole'
    """
    try:
        target = Path(os.path.realpath(path))
        temporary = target.with_name(f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")
        if target.exists() and not target.is_file():
            raise OutputError(one_line(f"{path}: is not a regular file; expected one, or a free name"))
    except (OSError, ValueError) as error:
        raise bad_output(path, error) from error
    try:
        with _opened(temporary, path) as handle:  # an interruption may come as soon as it is there
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        os.replace(temporary, target)
        _sync_folder(target.parent)
    except OSError as error:
        raise bad_output(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _opened(temporary: Path, path: PathLike) -> BinaryIO:
    try:
        return open(temporary, "xb")
    except (OSError, ValueError) as error:
        raise bad_output(path, error) from error


def write_bytes(path: PathLike, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all.

    Parameters
    ----------
    path : str or path
        The file to write; its folder must exist.
    data : bytes
        The content.

    Raises
    ------
    OutputError
        As `atomic_write`.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_bytes(f"{folder}/a.txt", b"whole")
    ...     Path(folder, "a.txt").read_text()
    'whole'
    """
    with atomic_write(path) as handle:
        handle.write(data)


def is_temporary(name: str) -> bool:
    """Whether a file of that name is what `atomic_write` leaves where it is killed."""
    return name.startswith(TEMPORARY_PREFIX) and name.endswith(TEMPORARY_SUFFIX)


def _sync_folder(folder: Path) -> None:
    if not hasattr(os, "O_DIRECTORY"):
        return
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
    except OSError as error:
        # Some file systems cannot sync a folder; the file itself is safe by then.
        if error.errno not in _NO_FOLDER_SYNC:
            raise
