"""Which recordings a batch is of: from lists and folders, each with a name of its own and a guess at its work."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from .._files import PathLike, bad_input, one_line
from .._text import read_lines
from ..datasets import open_sequence
from ..datasets.layouts import is_known
from ..errors import InputError

_LIST = "a list of recordings, one a line; a recording; or a folder of recordings"
_LARGEST_LIST = 1 << 26  # bytes: half a million lines


@dataclass(frozen=True)
class Recording:
    """One recording of a batch.

    Attributes
    ----------
    name : str
        Of its run folder; no other of the batch has it.
    source : Path
        The folder or the file, absolute.
    sequence : str
        What its sequence is called; others may be called so too.
    frames : int
        Pairs in it; 0 where it cannot be opened.
    pixels : int
        Of all its left images together: by how much it is longer than others.
    error : str
        Why it cannot be opened; empty where it can.
    """

    name: str
    source: Path
    sequence: str = ""
    frames: int = 0
    pixels: int = 0
    error: str = ""


def find_sources(given: Iterable[PathLike]) -> list[Path]:
    r"""The recordings that lists and folders name, each once, in their order.

    Parameters
    ----------
    given : iterable of path
        Each a recording, as `tspslam.datasets.open_sequence` takes it; a folder with recordings in it; or a text file
        that names such, one a line, relative to itself, with comments after a #.

    Returns
    -------
    list of Path
        Absolute. What a list names is in it even if there is no such recording: opening it says why.

    Raises
    ------
    InputError
        If a file of `given` is no text, or there is no recording at all.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "list.txt").write_text("first  # by day\n\nsecond\nfirst\n")
    ...     [each.name for each in find_sources([f"{folder}/list.txt"])]
    ['first', 'second']
    """
    found: dict[str, Path] = {}
    for path in map(Path, given):
        for source in _expanded(path, is_list=os.path.isfile(path) and not is_known(path)):
            found.setdefault(os.path.realpath(source), Path(os.path.abspath(source)))
    if not found:
        raise InputError(one_line(f"{', '.join(map(str, given))}: names no recording, expected {_LIST}"))
    return list(found.values())


def _expanded(path: Path, *, is_list: bool) -> Iterator[Path]:
    """A path, or the recordings in it."""
    if is_list:
        for _, line in read_lines(path, _LIST, _LARGEST_LIST):
            words = line.partition(" #")[0].strip()
            if words:
                yield from _expanded(path_in(path, words), is_list=False)
    elif os.path.isdir(path) and not is_known(path):
        yield from _children(path) or [path]
    else:
        yield path


def path_in(listing: Path, words: str) -> Path:
    """The path that a line of a list names: relative to the list, or from a home that is there.

    Parameters
    ----------
    listing : path
        The list.
    words : str
        Of the line.

    Returns
    -------
    Path
        Of a user who is not known as it stands: opening it says that it is not there.
    """
    return listing.parent / os.path.expanduser(words)


def _children(folder: Path) -> list[Path]:
    try:
        return sorted(each for each in folder.iterdir() if not each.name.startswith(".") and is_known(each))
    except OSError as error:
        raise bad_input(folder, f"cannot be looked at ({error.strerror})", _LIST) from error


def open_recordings(sources: Sequence[Path], before: Mapping[str, str]) -> list[Recording]:
    """Look into each recording, and name it.

    Its name is that of its sequence, as for ``tspslam run``. Of several with one name the first has it; the others are
    called by the folders above them too, then numbered. A source keeps the name that an earlier batch gave it, and no
    other gets that one.

    Parameters
    ----------
    sources : sequence of Path
        As `find_sources` gives them.
    before : mapping of str to str
        Names that an earlier batch gave, by source.

    Returns
    -------
    list of Recording
        In the order of `sources`; no image is decoded.
    """
    found = [_look(source) for source in sources]
    taken, named = {name.casefold() for name in before.values()}, []
    for each in found:
        name = before.get(str(each.source)) or next(n for n in _names(each) if n.casefold() not in taken)
        taken.add(name.casefold())
        named.append(replace(each, name=name))
    return named


def _look(source: Path) -> Recording:
    try:
        sequence = open_sequence(source)
    except InputError as error:
        return Recording(source.name, source, error=str(error))
    rig = sequence.rig
    return Recording(
        sequence.name, source, sequence.name, len(sequence), len(sequence) * int(rig.width) * int(rig.height)
    )


def _names(recording: Recording) -> Iterator[str]:
    """What a recording may be called, the best name first; none is hidden or a path."""
    parts = [part.replace(os.sep, "-").lstrip(".") for part in (*recording.source.parent.parts[1:], recording.name)]
    parts = [part for part in parts if part] or ["recording"]
    for count in range(1, len(parts) + 1):
        yield "-".join(parts[-count:])
    for number in itertools.count(2):
        yield f"{parts[-1]}-{number}"


def longest_first(recordings: Iterable[Recording]) -> list[Recording]:
    """Recordings in the order in which they are best begun: those with most pixels first, equal ones by name.

    Parameters
    ----------
    recordings : iterable of Recording
        In any order.

    Returns
    -------
    list of Recording

    Examples
    --------
    >>> short, long = Recording("a", Path("a"), "a", 2, 20), Recording("b", Path("b"), "b", 3, 30)
    >>> [each.name for each in longest_first([short, long])]
    ['b', 'a']
    """
    return sorted(recordings, key=lambda each: (-each.pixels, each.name))
