"""Images of two cameras without a calibration, from wherever they are: folders, a video, a bag."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..io.images import read_image
from ..types import FloatArray, Image
from ._kinds import SUFFIXES, listed, no_source
from ._pairing import images_in, name_of, natural, path_of
from ._reader import StoredImages
from ._ros import is_bag

_FOLDERS = (
    ("left", "right"), ("images/left", "images/right"), ("cam0", "cam1"), ("mav0/cam0/data", "mav0/cam1/data"),
    ("cam0/data", "cam1/data"), ("image_0", "image_1"), ("image_00/data", "image_01/data"), ("image_00", "image_01"),
    ("image_2", "image_3"), ("image_02/data", "image_03/data"), ("image_02", "image_03"), ("l", "r"), ("L", "R"),
)  # fmt: skip
_SIDES = (("left", "right"), ("cam0", "cam1"), ("l", "r"))
_KNOWN = "two folders, one with left/ and right/ in it, one whose names tell left from right, a video or a bag"


class ImageFolders:
    """Left and right images of two folders, or of one whose names tell which are which.

    Images of one name are a pair; where no name is on both sides, those of one name but for the words left and right,
    and failing that those of one number, as ``left01.jpg`` and ``right01.jpg``.

    Parameters
    ----------
    left, right : sequence of Path
        Image files of each side.
    name : str
        What to call them.

    Attributes
    ----------
    name : str
        As given.
    names : list of str
        What to call each pair: the left file's stem.
    stamps : (n,) float64
        Places from 0: files have no times.
    unpaired : list of str
        Files without a partner.

    Raises
    ------
    InputError
        If no pair is found.

    Examples
    --------
    >>> ImageFolders([Path("left01.jpg"), Path("left02.jpg")], [Path("right02.jpg")], "views").names
    ['left02']
    """

    def __init__(self, left: Sequence[Path], right: Sequence[Path], name: str) -> None:
        self._files, lone = _paired(left, right)
        if not self._files:
            said = f"has {len(left)} left and {len(right)} right images, but none of one name or number"
            raise bad_input(name, said, "pairs such as left/01.png and right/01.png")
        self.name, self.names = one_line(name), [one_line(one.stem) for one, _ in self._files]
        self.stamps: FloatArray = np.arange(len(self._files), dtype=np.float64)
        self.unpaired = [one_line(f"{file.parent.name}/{file.name}") for file in lone]

    def __len__(self) -> int:
        return len(self._files)

    def images(self, index: int) -> Iterator[Image]:
        """Read the left and the right image of a pair.

        Parameters
        ----------
        index : int
            From 0.

        Yields
        ------
        (H, W) or (H, W, 3) uint8 or uint16
            As `tspslam.io.read_image` reads it.
        """
        return map(read_image, self._files[index])


def open_views(
    paths: Sequence[PathLike], layout: str | None = None, topics: tuple[str, str] | None = None
) -> StoredImages:
    """Open the images of two cameras as they are stored, to calibrate by them.

    Parameters
    ----------
    paths : sequence of 1 or 2 str or path
        Two folders of images, left and right; a folder with both in folders of their own, or with names that tell which
        are which; a video with both, or one of each; a bag of ROS.
    layout : str, optional
        Of a video with both: ``"side-by-side"``, ``"over-under"`` or ``"alternate"``.
    topics : tuple of 2 str, optional
        Topics of a bag with the left and the right images.

    Returns
    -------
    StoredImages

    Raises
    ------
    InputError
        If there is no such source, or no pair of images in it.

    Examples
    --------
    >>> open_views(["no-such-folder"])
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is not there; expected two folders, one with left/ and right/ in it, ...
    """
    places = [path_of(path) for path in paths]
    if len(places) not in (1, 2):
        raise InputError(f"{len(places)} sources are given, expected one or two: {_KNOWN}")
    missing = next((place for place in places if not place.exists()), None)
    if missing is not None:
        raise bad_input(missing, "is not there", _KNOWN)
    if len(places) == 1 and is_bag(places[0]):
        from ._bag_images import BagImages

        return BagImages(places[0], topics)
    if topics is not None:
        raise InputError(one_line(f"{places[0]}: is no bag, expected one with topics {' and '.join(topics)}"))
    if all(place.is_file() and place.suffix.lower() not in SUFFIXES for place in places):
        from .video import VideoImages

        return VideoImages(places if len(places) == 2 else places[0], layout)
    if layout is not None:
        raise InputError(one_line(f"{places[0]}: is no video, expected one of layout {layout}"))
    return _of_two(*places) if len(places) == 2 else _of_one(places[0])


def _of_two(left: Path, right: Path) -> ImageFolders:
    for place in (left, right):
        if not place.is_dir():
            raise no_source(place) or bad_input(place, "is no folder", _KNOWN)
    sides = [list(images_in(place).values()) for place in (left, right)]
    return ImageFolders(sides[0], sides[1], f"{name_of(left)} and {name_of(right)}")


def _of_one(folder: Path) -> ImageFolders:
    if not folder.is_dir():
        raise no_source(folder) or bad_input(folder, "is no folder", _KNOWN)
    for left, right in _FOLDERS:
        if (folder / left).is_dir() and (folder / right).is_dir():
            sides = [list(images_in(folder / side).values()) for side in (left, right)]
            return ImageFolders(sides[0], sides[1], name_of(folder))
    files = list(images_in(folder).values())
    for words in _SIDES:
        one, other = ([file for file in files if _without(file.stem, word) is not None] for word in words)
        if one and other:
            return ImageFolders(one, other, name_of(folder))
    raise bad_input(folder, f"does not tell left from right (it holds {listed(folder)})", _KNOWN)


def _without(stem: str, word: str) -> str | None:
    """A name without the word for its side, which stands between what is no letter; None if it has none."""
    rest, count = re.subn(rf"(?<![a-z]){word}(?![a-z])", "", stem.lower())
    return rest if count == 1 else None


def _keys(file: Path) -> tuple[str, str, str]:
    """Name of a file, name without its side, and last number in it."""
    stem = file.stem
    rest = next((found for pair in _SIDES for word in pair if (found := _without(stem, word)) is not None), stem)
    numbers = re.findall(r"[0-9]+", rest)
    return stem, rest, numbers[-1].lstrip("0") or "0" if numbers else stem


def _paired(left: Sequence[Path], right: Sequence[Path]) -> tuple[list[tuple[Path, Path]], list[Path]]:
    """Pairs in natural order, by the first kind of key that some files of both sides share; and files in none."""
    pairs: list[tuple[Path, Path]] = []
    for kind in range(3):
        one, other = ({_keys(file)[kind]: file for file in side} for side in (left, right))
        is_unique = len(one) == len(left) and len(other) == len(right)
        if is_unique and (pairs := [(one[key], other[key]) for key in sorted(one.keys() & other.keys(), key=natural)]):
            break
    taken = {file for pair in pairs for file in pair}
    return pairs, [file for side in (left, right) for file in side if file not in taken]
