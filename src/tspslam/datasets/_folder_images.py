"""Left and right images of folders as they are stored: their sides, pairs and times."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from .._checks import require_path
from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..io.images import image_size, read_image
from ..types import FloatArray, Image
from ._pairing import natural, seconds
from ._sides import PLAIN, Sides, find_sides, sides_of
from ._times import FILES, at_rate, file_of_times, nanoseconds_of, read_times


class FolderImages:
    """Left and right images of a folder, or of two, as they are stored, without a calibration.

    Parameters
    ----------
    path, fps
        As `StereoFolder` takes them.

    Attributes
    ----------
    path : Path
        The folder, or what two folders have in common.
    names, stamps, unpaired, remarks
        As those of `StereoFolder`.
    files : list of tuple of 2 Path
        Left and right file of each pair.

    Raises
    ------
    InputError
        If there are no sides, or they have no pair of images.

    Examples
    --------
    >>> FolderImages("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: lacks the folder left, expected left/, right/ and calib.yaml
    """

    stamps: FloatArray

    def __init__(self, path: PathLike | Sequence[PathLike], *, fps: float | None = None) -> None:
        self._folders = _folders_of(path)
        self.path, sides = self._folders[0], _sides(self._folders)
        if len(self._folders) == 2 and self._folders[0].resolve().parent == self._folders[1].resolve().parent:
            self.path = self._folders[0].resolve().parent
        left, right = sides.left, sides.right
        places = {name: place for place, name in enumerate(sorted(left.keys() | right.keys(), key=natural))}
        self.names = [name for name in places if name in left and name in right]
        lone = [name for name in places if not (name in left and name in right)]
        labelled = [(sides.labels[0], left[k]) if k in left else (sides.labels[1], right[k]) for k in lone]
        self.unpaired = [one_line(f"{label}{file.name}") for label, file in labelled]
        self.files = [(left[name], right[name]) for name in self.names]
        if not self.names:
            one, other = (label or "it" for label in sides.labels)
            said = f"{len(left)} files in {one} and {len(right)} in {other} have no name in common"
            raise InputError(one_line(f"{self.path}: {said}, expected pairs of the same name"))
        self.remarks = list(sides.remarks)
        every = sorted(left.values(), key=lambda file: natural(file.name))
        self._find_times(every, [places[name] for name in self.names], fps)

    def _find_times(self, every: Sequence[Path], places: Sequence[int], fps: float | None) -> None:
        """Set the stamps, and say where they are from."""
        listed = file_of_times([self.path, every[0].parent])
        if listed is not None and fps is not None:
            raise bad_input(listed, "has the times of the images", "no frames a second beside it (--fps, fps=)")
        if listed is not None:
            times, unit = read_times(listed, every)
            of = dict(zip(every, times.tolist(), strict=True))
            self.stamps = np.array([of[left] for left, _ in self.files])
            self.remarks.append(f"stamps are those of {listed.name}, in {unit}")
        elif fps is not None:
            self.stamps = at_rate(places, fps)
        elif (named := nanoseconds_of([left.stem for left, _ in self.files])) is not None:
            self.stamps = seconds(named.values)
            self.remarks.append(f"stamps are those in the names of the images, in {named.unit}; --fps gives others")
        else:
            self.stamps = np.array(places, np.float64)
            if len(places) > 1:
                wanted = f"--fps F or a file {FILES[0]} gives times"
                self.remarks.append(f"stamps are numbers of frames, as neither names nor a file tell times; {wanted}")

    @property
    def name(self) -> str:
        """The folder's own name."""
        return one_line(self.path.resolve().name)

    def __len__(self) -> int:
        return len(self.files)

    def images(self, index: int) -> Iterator[Image]:
        """Read the left and the right image of a pair; `InputError` if one is bad."""
        return map(read_image, self.files[index])

    def size(self) -> tuple[int, int] | None:
        """Width and height of the first left image that has them, px."""
        for left, _ in self.files:
            with contextlib.suppress(InputError):
                return image_size(left)
        return None


def _folders_of(path: PathLike | Sequence[PathLike]) -> list[Path]:
    """One folder, or two."""
    given: list[PathLike] = [path] if isinstance(path, str) or not isinstance(path, Sequence) else list(path)
    if len(given) not in (1, 2):
        raise InputError(f"path holds {len(given)} folders, expected one, or two of left and right images")
    for each in given:
        require_path(each)
    return [Path(each) for each in given]


def _sides(folders: Sequence[Path]) -> Sides:
    if len(folders) == 2:
        return sides_of(*folders)
    return find_sides(folders[0]) or sides_of(*(folders[0] / side for side in PLAIN))
