"""Which true poses go with which recording, and how far its path is from them."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

from .._files import PathLike, bad_input, one_line
from .._text import read_lines
from ..errors import InputError
from ..run.evaluate import describe_errors, evaluated
from .recordings import path_in

Truths = dict[str, Path]
"""Files or folders with true poses, by the name of the recording."""
_SUFFIXES = (".txt", ".tum", ".csv", "")  # the last: a folder of a sequence that has true poses
_EXPECTED = "a folder with NAME.txt, or a list with NAME and a file of poses on each line"


def find_truths(place: PathLike, names: Collection[str]) -> Truths:
    """Find the true poses of each recording.

    Parameters
    ----------
    place : path
        A folder with ``NAME.txt``, ``.tum``, ``.csv`` or a sequence called NAME; or a text file with a name and a path,
        relative to the file, on each line.
    names : collection of str
        Of the recordings.

    Returns
    -------
    dict of str to Path
        Those that there are.

    Raises
    ------
    InputError
        If it is neither, there is none for any of the names, or a list has one twice or without a path.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "drive.txt").write_text("")
    ...     [(name, path.name) for name, path in find_truths(folder, ["drive", "walk"]).items()]
    [('drive', 'drive.txt')]
    """
    path = Path(place)
    found = _listed(path, names) if os.path.isfile(path) else _in_folder(path, names)
    if not found:
        some = ", ".join(sorted(names)[:4])
        raise InputError(one_line(f"{path}: has no true poses of {some}; expected {_EXPECTED}"))
    return found


def _in_folder(folder: Path, names: Collection[str]) -> Truths:
    if not os.path.isdir(folder):
        raise InputError(one_line(f"{folder}: is not there; expected {_EXPECTED}"))
    places = {name: [folder / f"{name}{suffix}" for suffix in _SUFFIXES] for name in names}
    found = {name: next((each for each in tried if os.path.exists(each)), None) for name, tried in places.items()}
    return {name: each for name, each in found.items() if each is not None}


def _listed(path: Path, names: Collection[str]) -> Truths:
    found: Truths = {}
    for number, line in read_lines(path, _EXPECTED):
        name = max((each for each in names if f"{line} ".startswith((f"{each} ", f"{each}\t"))), key=len, default=None)
        if name is not None:
            if name in found or name == line:
                said = f"line {number} names {name} again" if name in found else f"line {number} has no path"
                raise bad_input(path, said, _EXPECTED)
            found[name] = path_in(path, line[len(name) :].strip())
    return found


def measure(folder: Path, truth: Path) -> dict[str, Any]:
    """Errors of the path of a finished run, as ``tspslam eval`` gives them.

    Parameters
    ----------
    folder : path
        The run folder.
    truth : path
        True poses.

    Returns
    -------
    dict
        As `tspslam.run.evaluate.describe_errors`.

    Raises
    ------
    InputError
        If the truth cannot be read or does not fit.
    """
    return describe_errors(evaluated(folder, truth))
