"""Folders, and files that others write, that are either complete or not there."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from .._atomic import TEMPORARY_PREFIX, TEMPORARY_SUFFIX, _sync_folder, bad_output
from .._files import PathLike, bad_input, one_line
from ..errors import InputError, OutputError


@contextlib.contextmanager
def new_folder(path: PathLike, *, may_go: Callable[[Path], None] | None = None) -> Iterator[Path]:
    """Make a folder beside `path` that takes its name when the block ends without an error.

    All files are synced to disk before. On any failure, an interruption included, the folder is removed, and what was
    there before is as it was.

    Parameters
    ----------
    path : str or path
        The folder to make: not there yet, or empty. The folder above it must exist.
    may_go : callable, Path -> None, optional
        Raises `InputError` unless a folder with files in it may go; called at the beginning, and once more with the
        folder out of the way, since somebody may have put something into it meanwhile.

    Yields
    ------
    Path
        The folder, by its temporary name.

    Raises
    ------
    InputError
        If something is there already.
    OutputError
        If the system refuses.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as above:
    ...     with new_folder(f"{above}/made") as folder:
    ...         _ = (folder / "a.txt").write_text("whole")
    ...     Path(above, "made", "a.txt").read_text()
    'whole'
    """
    try:
        target = Path(os.path.abspath(os.fspath(path)))
    except (OSError, ValueError) as error:
        raise bad_output(path, error) from error
    check = _check_free if may_go is None else may_go
    with _beside(path, target, check) as temporary:
        yield temporary
        _sync_files(temporary)
        if target.exists():  # before the folder has its name: nothing that may fail comes after
            temporary.chmod(stat.S_IMODE(target.stat().st_mode))
        _take_place(temporary, target, check)
        _sync_folder(target.parent)


@contextlib.contextmanager
def new_file(path: PathLike) -> Iterator[Path]:
    """Give a place beside `path` to who writes a file by its name; what is there at the end takes the name of `path`.

    As `tspslam.io.atomic_write`, for libraries that open files themselves.

    Parameters
    ----------
    path : str or path
        The file to write; its folder must exist.

    Yields
    ------
    Path
        Where the file goes, with the suffix of `path`.

    Raises
    ------
    OutputError
        If the system refuses, or `path` is there but not a regular file.
    """
    target = Path(os.path.realpath(path))
    with _beside(path, target, _check_file) as temporary:
        made = temporary / f"made{target.suffix}"
        yield made
        _sync_files(temporary)
        os.replace(made, target)
        _sync_folder(target.parent)


@contextlib.contextmanager
def _beside(path: PathLike, target: Path, check: Callable[[Path], None]) -> Iterator[Path]:
    """A folder beside the target that is gone at the end, unless it was renamed; what goes wrong is ours to say."""
    temporary = _temporary(target)
    try:
        _make(temporary, path, target, check)  # an interruption may come as soon as it is there
        yield temporary
    except OSError as error:
        raise bad_output(path, error) from error
    except (InputError, OutputError) as error:  # of a file in the folder: say it by the name that it would have had
        raise type(error)(str(error).replace(str(temporary), str(path))) from error
    finally:
        _in_spite_of_interrupts(lambda: shutil.rmtree(temporary, ignore_errors=True))


def _make(temporary: Path, path: PathLike, target: Path, check: Callable[[Path], None]) -> None:
    try:
        with contextlib.suppress(FileNotFoundError):
            os.lstat(target)  # ValueError of a name that cannot be
        check(target)
        temporary.mkdir()
    except (OSError, ValueError) as error:
        raise bad_output(path, error) from error


def _take_place(temporary: Path, target: Path, check: Callable[[Path], None]) -> None:
    """Give a folder its name; what had it comes back if that fails, and else is removed."""
    aside = _temporary(target)

    def settle() -> None:
        if not temporary.exists():
            shutil.rmtree(aside, ignore_errors=True)
        elif aside.exists():
            aside.rename(target)

    try:
        if target.exists():
            target.rename(aside)
            check(aside)
        temporary.rename(target)
    except InputError as error:
        raise InputError(str(error).replace(str(aside), str(target))) from error
    finally:
        _in_spite_of_interrupts(settle)


def _in_spite_of_interrupts(tidy: Callable[[], object]) -> None:
    """Tidy up; where an interruption comes between, to the end all the same before that goes on."""
    try:
        tidy()
    except KeyboardInterrupt:
        tidy()
        raise


def _temporary(target: Path) -> Path:
    return target.with_name(f"{TEMPORARY_PREFIX}{secrets.token_hex(8)}{TEMPORARY_SUFFIX}")


def _check_file(target: Path) -> None:
    if target.exists() and not target.is_file():
        raise OutputError(one_line(f"{target}: is not a regular file; expected one, or a free name"))


def _check_free(target: Path) -> None:
    try:
        is_folder = stat.S_ISDIR(os.lstat(target).st_mode)
    except FileNotFoundError:
        return
    if not is_folder or os.listdir(target):
        raise bad_input(target, "is there already", "a free name, or an empty folder")


def _sync_files(folder: Path) -> None:
    for above, _, names in os.walk(folder):
        for name in names:
            descriptor = os.open(os.path.join(above, name), os.O_RDWR)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        _sync_folder(Path(above))
