"""Which files a run folder has, and that none of them leads out of it."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from .._files import bad_input, is_link
from .lock import LOCK_NAME

CONFIG, MANIFEST, TIMINGS = "config.yaml", "manifest.jsonl", "timings.json"
PARTS = "frames", "pictures"
_BOOKS = frozenset({CONFIG, MANIFEST, TIMINGS, LOCK_NAME})
MAP, LANDMARKS = "map.npz", "landmarks.npz"
_RESULTS = frozenset(
    {"run.json", "report.html", MAP, LANDMARKS, "map.vtu", "map.ply", "trajectory.tum", "trajectory.kitti.txt"}
    | {"state.npz"}
)
_FRAME = re.compile(r"frames/(?:[0-9]{6}|[1-9][0-9]{6,11})\.(?:npz|json)")
_PATH = re.compile(r"trajectory_([\w-]{1,80})\.tum")  # of one recording of several
_PICTURE = re.compile(r"pictures/(.+)\.png")
_LONGEST = 100  # characters of a picture's name
_EXPECTED = "a run folder whose files and folders are its own"


def is_word(name: str) -> bool:
    """Whether a picture may be called so: letters, digits, - and _."""
    return 0 < len(name) <= _LONGEST and all(character.isalnum() or character in "-_" for character in name)


def is_result(name: str) -> bool:
    """Whether a run makes and lists a file of that name, relative to its folder, with ``/``.

    Examples
    --------
    >>> [is_result(name) for name in ("map.ply", "frames/000001.npz", "../map.ply", "config.yaml")]
    [True, True, False, False]
    """
    picture = _PICTURE.fullmatch(name)
    is_known = name in _RESULTS or bool(_FRAME.fullmatch(name)) or bool(_PATH.fullmatch(name))
    return is_known or (picture is not None and is_word(picture[1]))


def is_of_a_run(name: str) -> bool:
    """Whether a name is one of ours in a run folder, or lies in a folder of ours; in any case, as some disks take it.

    Examples
    --------
    >>> [is_of_a_run(name) for name in ("Map.ply", "frames/mine.txt", ".lock", "mine.txt")]
    [True, True, True, False]
    """
    lower = name.lower()
    is_book = lower in _BOOKS or lower in _RESULTS or bool(_PATH.fullmatch(lower))
    return is_book or lower.split("/")[0] in PARTS


def check_places(folder: Path) -> None:
    """Refuse a folder where what a run would write is a link, or no file or folder, so that none is followed.

    Files of other names are the user's: they are never written, removed or looked at.

    Raises
    ------
    InputError
        Naming the first such file.
    OSError
        If the folder cannot be listed; one that is not there has nothing in it.
    """
    for name, status in _listed(folder):
        if name not in PARTS and name not in _BOOKS and not is_result(name):
            continue
        if is_link(status):
            raise bad_input(folder / name, "is a link", _EXPECTED)
        is_right = stat.S_ISDIR if name in PARTS else stat.S_ISREG
        if not is_right(status.st_mode):
            raise bad_input(folder / name, f"is no {'folder' if name in PARTS else 'regular file'}", _EXPECTED)


def _listed(folder: Path) -> Iterator[tuple[str, os.stat_result]]:
    """Names in a folder and, once it was seen what they are, in its parts."""
    try:
        names = sorted(os.listdir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return
    for name in names:
        yield from _status(folder, name)
        if name in PARTS:
            for inner in sorted(os.listdir(folder / name)):
                yield from _status(folder, f"{name}/{inner}")


def _status(folder: Path, name: str) -> Iterator[tuple[str, os.stat_result]]:
    with contextlib.suppress(FileNotFoundError):  # a run that goes on renames its files meanwhile
        yield name, os.lstat(folder / name)
