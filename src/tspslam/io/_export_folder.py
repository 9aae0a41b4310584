"""Folders that are either complete or not there, with a list of the files that are ours."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

from .._atomic import write_bytes
from .._files import bad_input, read_bytes, reason_of
from ..errors import InputError
from ._folders import new_folder

MARK = "tspslam-export.json"
_LARGEST_MARK = 1 << 24  # bytes


def check_free(path: Path, kind: str, *, is_forced: bool = False) -> None:
    """Raise `InputError` unless a folder is not there, or empty, or, if forced, an earlier export and nothing else."""
    expected = "a free name, an empty folder, or with --force an earlier export"
    if os.path.islink(path) or (os.path.exists(path) and not os.path.isdir(path)):
        raise bad_input(path, "is there and is no folder", expected)
    if not os.path.exists(path):
        return
    try:
        found = sorted(each.relative_to(path).as_posix() for each in path.rglob("*") if not _is_folder(each))
    except OSError as error:
        raise bad_input(path, f"cannot be looked into ({reason_of(error)})", expected) from error
    if not found:
        return
    ours = _files_of_ours(path / MARK, kind)
    if ours is None:
        raise bad_input(path, f"is there and is no export as {kind}", expected)
    strange = [name for name in found if name not in ours]
    if strange:
        raise bad_input(path, f"holds {strange[0]}, which no export wrote", expected)
    if not is_forced:
        raise bad_input(path, "is there", "a free name, or --force to write it anew")


@contextlib.contextmanager
def fill_folder(path: Path, kind: str, *, is_forced: bool = False) -> Iterator[Path]:
    """Make a temporary folder beside `path` that takes its place when the block ends without an error.

    What `check_free` refuses is refused. The files in it are synced, and listed in one more. On any failure, an
    interruption included, the temporary folder is removed and `path` is as it was.

    Parameters
    ----------
    path : path
        The folder; that in which it lies must exist.
    kind : str
        What is written into it.
    is_forced : bool
        Whether an earlier export of that kind may be replaced.

    Yields
    ------
    Path
        An empty folder.

    Raises
    ------
    InputError
        As `check_free`.
    OutputError
        If the system refuses.
    """
    with new_folder(path, may_go=lambda found: check_free(found, kind, is_forced=is_forced)) as folder:
        yield folder
        names = sorted(each.relative_to(folder).as_posix() for each in folder.rglob("*") if each.is_file())
        written = json.dumps({"export": kind, "files": [*names, MARK], "of": "tspslam"}, indent=1, ensure_ascii=False)
        write_bytes(folder / MARK, f"{written}\n".encode())


def _files_of_ours(mark: Path, kind: str) -> set[str] | None:
    """Names of the files of an earlier export; None where there is no list of ours of that kind."""
    try:
        found = json.loads(read_bytes(mark, "a list of files", _LARGEST_MARK))
    except (InputError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or (found.get("of"), found.get("export")) != ("tspslam", kind):
        return None
    files = found.get("files")
    return {str(each) for each in files} if isinstance(files, list) else None


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()
