"""Pairs from image files: two files and a calibration, or a folder of them."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from .._checks import require_path
from .._files import PathLike, one_line
from ..errors import InputError
from ..io.images import image_size
from ..types import FloatArray, RawRig, Rig, StereoPair
from ..vision.calibration.formats import read_stereo
from ._kinds import no_image, only_images
from ._reader import FileReader

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


class StereoFolder:
    """A folder with `left/`, `right/` and a calibration; images are paired by name, in natural order.

    Parameters
    ----------
    path : str or path
        The folder.
    calib : str or path, optional
        Calibration, as `tspslam.read_calibration` reads it; by default `calib.yaml`, `calib.txt` or
        `calib_cam_to_cam.txt` in the folder. Raw pairs are rectified.
    bits : int, optional
        How many bits 16-bit pixels use; by default they are found in a sample of all images. Pixels are moved up to
        the full range.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    names : list of str
        Stems of the paired files; ``2`` comes before ``10``.
    stamps : (n,) float64
        Places of these names among those of both sides, from 0: one without a partner leaves a gap. There are no times.
    unpaired : list of str
        Files without a partner, as ``left/name.png``.

    Raises
    ------
    InputError
        If a part is missing, the calibration is bad, two files of one side share a stem, or no pair is found.

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

    def __init__(self, path: PathLike, calib: PathLike | None = None, *, bits: int | None = None) -> None:
        require_path(path)
        self.path = Path(path)
        left, right = (_images(self.path, side) for side in ("left", "right"))
        places = {name: place for place, name in enumerate(sorted(left.keys() | right.keys(), key=_natural))}
        self.names = [name for name in places if name in left and name in right]
        lone = [name for name in places if not (name in left and name in right)]
        self.stamps = np.array([places[name] for name in self.names], np.float64)
        self.unpaired = [one_line(f"left/{left[k].name}" if k in left else f"right/{right[k].name}") for k in lone]
        self._files = [(left[name], right[name]) for name in self.names]
        if not self.names:
            raise InputError(
                f"{self.path}: {len(left)} files in left/ and {len(right)} in right/ have no name in common, "
                "expected pairs of the same name"
            )
        cameras = read_stereo(calib or _calibration_in(self.path), self._size())
        self._reader = FileReader(cameras, self._files, bits)
        self.rig = self._reader.rig

    @property
    def name(self) -> str:
        """The folder's own name."""
        return one_line(self.path.resolve().name)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is bad."""
        index = range(len(self))[index]
        return replace(self._reader.read(index), stamp=float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))

    def _size(self) -> tuple[int, int] | None:
        """Size of the first image that has one."""
        for left, _ in self._files:
            with contextlib.suppress(InputError):
                return image_size(left)
        return None


def _calibration_in(folder: Path) -> Path:
    found = next((folder / name for name in _CALIBRATIONS if (folder / name).exists()), None)
    if found is None:
        wanted = f"{', '.join(_CALIBRATIONS)} in it, or a file by --calib (calib=)"
        raise InputError(one_line(f"{folder}: holds no calibration, expected {wanted}"))
    return found


def _images(folder: Path, side: str) -> dict[str, Path]:
    """Image files of one side by stem; hidden files are passed over, and others beside them."""
    try:
        files = sorted((folder / side).iterdir())
    except OSError as error:
        raise InputError(f"{folder}: lacks the folder {side}, expected left/, right/ and calib.yaml") from error
    found: dict[str, Path] = {}
    for file in only_images(folder / side, files):
        if file.stem in found:
            raise InputError(f"{folder}: {found[file.stem].name} and {file.name} in {side}/ share a name, expected one")
        found[file.stem] = file
    return found


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key that compares runs of digits as numbers."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(part), part) if part[0] in "0123456789" else (1, 0, part) for part in parts]
