"""One process at a time in a folder."""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

from .._atomic import bad_output
from .._files import PathLike, one_line
from ..errors import InputError

LOCK_NAME = ".lock"
# Windows forbids others to read locked bytes: the locked one lies far behind the process id.
_FAR = 1 << 30


class FolderLock:
    """A lock on a folder, held through a file in it; the system lets go of it when the process ends, however it ends.

    Parameters
    ----------
    folder : str or path
        An existing folder.

    Raises
    ------
    InputError
        If another run holds the lock.
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
        try:
            descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        except (OSError, ValueError) as error:
            raise bad_output(self.path, error) from error
        kept = False
        try:
            _lock(descriptor)
            kept = _same_file(descriptor, self.path)
            if kept:
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"{os.getpid()}\n".encode("ascii"))
        except (BlockingIOError, PermissionError) as error:
            holder = one_line(os.pread(descriptor, 32, 0).decode("ascii", "replace")) if hasattr(os, "pread") else ""
            whom = f"process {holder}" if holder else "another process"
            raise InputError(one_line(f"{self.path.parent}: is in use by {whom}; expected one run a folder")) from error
        except OSError as error:
            kept = False
            raise bad_output(self.path, error) from error
        finally:
            if not kept:
                os.close(descriptor)
        return descriptor if kept else None

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
        return os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return False
