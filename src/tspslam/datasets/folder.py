"""Pairs from image files: two files and a calibration, or a folder of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from .._files import PathLike, one_line
from ..errors import InputError
from ..types import Rig, StereoPair
from ..vision.rig import check_pair, load_rig

_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm"})


def pair_from_files(left: PathLike, right: PathLike, calib: PathLike) -> StereoPair:
    """Read a rectified pair from two images and a calibration file.

    Parameters
    ----------
    left, right : str or path
        Images of the same size and depth.
    calib : str or path
        Calibration, as `tspslam.load_rig` reads it.

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
    >>> pair_from_files("left.png", "right.png", "no-such-calib.yaml")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-calib.yaml: cannot be opened (No such file or directory); expected a ...
    """
    return _read_pair(Path(left), Path(right), load_rig(calib), 0)


class StereoFolder:
    """A folder with `left/`, `right/` and `calib.yaml`; images are paired by name, in natural order.

    Parameters
    ----------
    path : str or path
        The folder.

    Attributes
    ----------
    rig : Rig
        The cameras, from `calib.yaml`.
    names : list of str
        Stems of the paired files; ``2`` comes before ``10``.
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
    unpaired: list[str]

    def __init__(self, path: PathLike) -> None:
        self.path = Path(path)
        left, right = (_images(self.path, side) for side in ("left", "right"))
        self.rig = load_rig(self.path / "calib.yaml")
        self.names = sorted(left.keys() & right.keys(), key=_natural)
        lone = sorted(left.keys() ^ right.keys(), key=_natural)
        self.unpaired = [one_line(f"left/{left[k].name}" if k in left else f"right/{right[k].name}") for k in lone]
        self._files = [(left[name], right[name]) for name in self.names]
        if not self.names:
            raise InputError(
                f"{self.path}: {len(left)} files in left/ and {len(right)} in right/ have no name in common, "
                "expected pairs of the same name"
            )

    @property
    def name(self) -> str:
        """The folder's own name."""
        return one_line(self.path.resolve().name)

    def __len__(self) -> int:
        return len(self._files)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is bad."""
        index = range(len(self))[index]
        return _read_pair(*self._files[index], self.rig, index)

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))


def _read_pair(left: Path, right: Path, rig: Rig, index: int) -> StereoPair:
    from ..io.images import read_image

    pair = StereoPair(read_image(left), read_image(right), rig, index=index, name=one_line(left.stem))
    check_pair(pair)
    return pair


def _images(folder: Path, side: str) -> dict[str, Path]:
    """Image files of one side by stem; hidden files and other kinds are passed over."""
    try:
        files = sorted(path for path in (folder / side).iterdir() if path.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise InputError(f"{folder}: lacks the folder {side}, expected left/, right/ and calib.yaml") from error
    found: dict[str, Path] = {}
    for file in files:
        if file.name.startswith("."):
            continue
        if file.stem in found:
            raise InputError(f"{folder}: {found[file.stem].name} and {file.name} in {side}/ share a name, expected one")
        found[file.stem] = file
    return found


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Sort key that compares runs of digits as numbers."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(part), part) if part[0] in "0123456789" else (1, 0, part) for part in parts]
