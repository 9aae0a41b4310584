"""Pairs from image files: two files and a calibration, or a folder of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .._checks import require_path
from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..io.images import image_size, read_image
from ..types import FloatArray, Image, RawRig, Rig, StereoPair
from ..vision.calibration.formats import read_stereo
from ._kinds import no_image
from ._pairing import natural, seconds
from ._reader import FileReader
from ._sides import PLAIN, Sides, find_sides, sides_of
from ._times import FILES, at_rate, file_of_times, nanoseconds_of, read_times

_CALIBRATIONS = ("calib.yaml", "calib.txt", "calib_cam_to_cam.txt")


def read_pair(
    left: PathLike, right: PathLike, calib: PathLike | Rig | RawRig, *, bits: int | None = None
) -> StereoPair:
    """Read a pair from two images and a calibration file; a raw pair is rectified.

    Parameters
    ----------
    left, right : str or path
        Images of the same size and depth.
    calib : str, path, Rig or RawRig
        Calibration file, as `tspslam.read_calibration` reads it, or the cameras themselves.
    bits : int, optional
        How many bits 16-bit pixels use, of both images; found by default. Pixels are moved up to the full range.

    Returns
    -------
    StereoPair
        Named after the left file.

    Raises
    ------
    InputError
        If a file cannot be read, or the images and the calibration do not fit together.

    Examples
    --------
    >>> read_pair("no-such-left.png", "right.png", "calib.yaml")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-left.png: cannot be opened (No such file or directory); expected a PNG, ...
    """
    for side, path in (("left image", left), ("right image", right)):
        require_path(path, side)
    sizes = [_size_of(Path(path)) for path in (left, right)]
    cameras = calib if isinstance(calib, Rig | RawRig) else read_stereo(calib, sizes[0])
    return FileReader(cameras, [(Path(left), Path(right))], bits).read(0)


pair_from_files = read_pair
"""`read_pair` by its earlier name."""


def _size_of(path: Path) -> tuple[int, int]:
    """Size of an image; of what is none, the error says what it is instead."""
    try:
        return image_size(path)
    except InputError as error:
        raise (no_image(path) or error) from error


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


class StereoFolder:
    """A folder with left and right images and a calibration; images are paired by name, in natural order.

    The sides are `left/` and `right/`, or two other folders whose names differ in nothing but the side: left and right,
    l and r, cam0 and cam1, infra1 and infra2, in capitals too. Without such folders they are images beside each other
    whose names differ so: `left01.png` and `right01.png`, `img_0_L.png` and `img_0_R.png`. Images of two folders that
    have few names in common are paired by the stamps in their names, the nearest to each other within a quarter of the
    median interval; else by their names without the side; else by the last number in them.

    Stamps come from `times.txt`, `timestamps.txt` or `stamps.txt` (a line for each left image, or lines of a name and a
    time), in the folder or in that of the left images; else from `fps`; else from names that hold times since 1970, or
    ns or us whose median step is from 5 ms to 2 s.

    Parameters
    ----------
    path : str, path or sequence of 2 of them
        The folder; or two, of the left and of the right images.
    calib : str or path, optional
        Calibration, as `tspslam.read_calibration` reads it; by default `calib.yaml`, `calib.txt` or
        `calib_cam_to_cam.txt` in the folder, or in the one that two folders lie in. Raw pairs are rectified.
    bits : int, optional
        How many bits 16-bit pixels use; by default they are found in a sample of all images. Pixels are moved up to
        the full range.
    fps : float, optional
        Frames a second, where no file tells times; it goes before times in names.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    names : list of str
        Stems of the paired files, of the left one where they differ; ``2`` comes before ``10``.
    stamps : (n,) float64
        Times, s. Where none are known, places of these names among those of both sides, from 0: one without a partner
        leaves a gap.
    unpaired : list of str
        Files without a partner, as ``left/name.png``.
    remarks : list of str
        Where stamps are from, and how images were paired, if not by their names.

    Raises
    ------
    InputError
        If a part is missing, the calibration is bad, two files of one side share a stem, no pair is found, or a file
        of times does not fit the images.

    Examples
    --------
    >>> StereoFolder("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: lacks the folder left, expected left/, right/ and calib.yaml
    """

    rig: Rig
    names: list[str]
    stamps: FloatArray
    unpaired: list[str]
    remarks: list[str]

    def __init__(
        self, path: PathLike | Sequence[PathLike], calib: PathLike | None = None, *,
        bits: int | None = None, fps: float | None = None,
    ) -> None:  # fmt: skip
        self._stored = stored = FolderImages(path, fps=fps)
        self.path, self.names, self.stamps = stored.path, stored.names, stored.stamps
        self.unpaired, self.remarks = stored.unpaired, stored.remarks
        cameras = read_stereo(calib or _calibration_in(self.path), stored.size())
        self._reader = FileReader(cameras, stored.files, bits)
        self.rig = self._reader.rig

    @property
    def name(self) -> str:
        """The folder's own name."""
        return self._stored.name

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._stored)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is bad."""
        index = range(len(self))[index]
        return replace(self._reader.read(index), stamp=float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))


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


def _calibration_in(folder: Path) -> Path:
    found = next((folder / name for name in _CALIBRATIONS if (folder / name).exists()), None)
    if found is None:
        wanted = f"{', '.join(_CALIBRATIONS)} in it, or a file by --calib (calib=)"
        raise InputError(one_line(f"{folder}: holds no calibration, expected {wanted}"))
    return found
