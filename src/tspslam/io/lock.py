"""One process at a time in a folder."""

from __future__ import annotations

import contextlib
import os
import re
import stat
import sys
from pathlib import Path

from .._atomic import bad_output
from .._files import PathLike, bad_input, is_link, one_line, open_own
from ..errors import InputError

LOCK_NAME = ".lock"
# Windows forbids others to read locked bytes: the locked one lies far behind the process id.
_FAR = 1 << 30
_PROCESS = re.compile(rb"\d{0,20}\n?")  # all that a lock holds
_EXPECTED = "the lock of a run: a file of its own with a process id"


class FolderLock:
    """A lock on a folder, held through a file in it; the system lets go of it when the process ends, however it ends.

    Parameters
    ----------
    folder : str or path
        An existing folder.

    Raises
    ------
    InputError
        If another run holds the lock, or what has its name is something else: a link, a file with a second name, a
        file with other content. That stays as it is.
    OutputError
        If the lock file cannot be made.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     lock = FolderLock(folder)
    ...     lock.release()
    """

    def __init__(self, folder: PathLike) -> None:
        self.path = Path(folder) / LOCK_NAME
        self._descriptor: int | None = None
        while self._descriptor is None:
            self._descriptor = self._try()

    def _try(self) -> int | None:
        """Return the locked descriptor; None if the file was removed meanwhile."""
        self._refuse_foreign()
        try:
            descriptor = open_own(os.fspath(self.path), os.O_RDWR | os.O_CREAT)
        except (OSError, ValueError) as error:
            raise bad_output(self.path, error) from error
        kept = False
        try:
            _lock(descriptor)
            kept = _same_file(descriptor, self.path)
            if kept:
                self._check_content(descriptor)
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"{os.getpid()}\n".encode("ascii"))
        except (BlockingIOError, PermissionError) as error:
            holder = one_line(os.pread(descriptor, 32, 0).decode("ascii", "replace")) if hasattr(os, "pread") else ""
            whom = f"process {holder}" if holder else "another process"
            raise InputError(one_line(f"{self.path.parent}: is in use by {whom}; expected one run a folder")) from error
        except OSError as error:
            kept = False
            raise bad_output(self.path, error) from error
        except InputError:
            kept = False
            raise
        finally:
            if not kept:
                os.close(descriptor)
        return descriptor if kept else None

    def _refuse_foreign(self) -> None:
        with contextlib.suppress(OSError, ValueError):  # opening it will say
            status = os.lstat(self.path)
            if is_link(status) or not stat.S_ISREG(status.st_mode):
                raise bad_input(self.path, "is a link, or no regular file", _EXPECTED)
            if status.st_nlink > 1:
                raise bad_input(self.path, "is a file that has a second name", _EXPECTED)

    def _check_content(self, descriptor: int) -> None:
        if not _PROCESS.fullmatch(os.read(descriptor, 32)):
            raise bad_input(self.path, "holds something else", _EXPECTED)
        os.lseek(descriptor, 0, os.SEEK_SET)

    def release(self) -> None:
        """Let go; a second call does nothing."""
        if self._descriptor is None:
            return
        descriptor, self._descriptor = self._descriptor, None
        # An open file cannot be removed on Windows, and a closed one could be another's: there it stays.
        if sys.platform != "win32":
            with contextlib.suppress(OSError):
                self.path.unlink()
        os.close(descriptor)


def _lock(descriptor: int) -> None:
    if sys.platform == "win32":
        import msvcrt

        os.lseek(descriptor, _FAR, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _same_file(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except FileNotFoundError:
        return False
