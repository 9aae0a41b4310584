"""Pairs from image files: two files and a calibration, or a folder of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from .._checks import require_path
from .._files import PathLike, one_line
from ..errors import InputError
from ..io.images import image_size
from ..types import FloatArray, RawRig, Rig, StereoPair
from ..vision.calibration.formats import Calibration, read_stereo_calibration
from ._folder_images import FolderImages
from ._kinds import no_image
from ._pairing import checked_index
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
        Named after the left file; with the range of its disparities, where the calibration tells it, as Middlebury's.

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
    return read_pair_with_remarks(left, right, calib, bits=bits)[0]


def read_pair_with_remarks(
    left: PathLike, right: PathLike, calib: PathLike | Rig | RawRig, *, bits: int | None = None
) -> tuple[StereoPair, tuple[str, ...]]:
    """Read a pair as `read_pair`, and what is to be said of its calibration.

    Parameters
    ----------
    left, right, calib, bits
        As `read_pair`.

    Returns
    -------
    StereoPair
        The pair.
    tuple of str
        Remarks on the calibration, a line each; none of cameras that are given themselves.
    """
    for side, path in (("left image", left), ("right image", right)):
        require_path(path, side)
    sizes = [_size_of(Path(path)) for path in (left, right)]
    if isinstance(calib, Rig | RawRig):
        found = Calibration(calib, "given", {})
    else:
        found = read_stereo_calibration(calib, sizes[0])
    pair = FileReader(found.cameras, [(Path(left), Path(right))], bits).read(0)
    return replace(pair, disparity_range=found.disparity_range), found.remarks


pair_from_files = read_pair
"""`read_pair` by its earlier name."""


def _size_of(path: Path) -> tuple[int, int]:
    """Size of an image; of what is none, the error says what it is instead."""
    try:
        return image_size(path)
    except InputError as error:
        raise (no_image(path) or error) from error


class StereoFolder:
    """A folder with left and right images and a calibration; images are paired by name, in natural order.

    The sides are `left/` and `right/`, or two other folders whose names differ in nothing but the side: left and right,
    l and r, cam0 and cam1, infra1 and infra2, in capitals too. Without such folders they are images beside each other
    whose names differ so: `left01.png` and `right01.png`, `img_0_L.png` and `img_0_R.png`. Images of two folders that
    have few names in common are paired by the stamps in their names, the nearest to each other within a quarter of the
    median interval, or within half of it where one side is later by about the same throughout; else by their names
    without the side; else by the last number in them.

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
        Where stamps are from, how images were paired, if not by their names, and what is to be said of the calibration.

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
        found = read_stereo_calibration(calib or _calibration_in(self.path), stored.size())
        self.remarks = [*self.remarks, *found.remarks]
        self._reader = FileReader(found.cameras, stored.files, bits)
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
        index = checked_index(index, len(self))
        return replace(self._reader.read(index), stamp=float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))


def _calibration_in(folder: Path) -> Path:
    found = next((folder / name for name in _CALIBRATIONS if (folder / name).exists()), None)
    if found is None:
        wanted = f"{', '.join(_CALIBRATIONS)} in it, or a file by --calib (calib=)"
        raise InputError(one_line(f"{folder}: holds no calibration, expected {wanted}"))
    return found
