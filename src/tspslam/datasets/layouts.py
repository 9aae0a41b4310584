"""Which reader a folder or a bag is for, told by what lies in it."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from .._checks import require_path
from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ._kinds import listed, no_source
from ._ros import STORED, is_bag
from ._sides import PLAIN, find_sides
from .euroc import EurocSequence
from .folder import StereoFolder
from .kitti import KittiSequence
from .rosbag import RosbagSequence
from .utias import UtiasRun

Sequence = StereoFolder | KittiSequence | EurocSequence | UtiasRun | RosbagSequence


_KNOWN = "one with left/ and right/, mav0/, image_0/ or image_2/, image_00/ or image_02/, images/left/, or a bag of ROS"
_OWN = ("mav0", "cam0", "image_0", "image_2", "image_00", "image_02")  # of layouts that bring a calibration


def open_sequence(
    path: PathLike | Iterable[PathLike], *, calib: PathLike | None = None, topics: tuple[str, str] | None = None,
    bits: int | None = None, fps: float | None = None,
) -> Sequence:  # fmt: skip
    """Open a folder or a bag of stereo pairs with the reader of its layout.

    Parameters
    ----------
    path : str, path or sequence of them
        A folder with `left/` and `right/`, or with sides that `StereoFolder` knows; with `mav0/` (EuRoC, ASL); with
        `image_0/` or `image_2/` (KITTI odometry), `image_00/` or `image_02/` (KITTI raw); with `images/left/` (UTIAS);
        with `metadata.yaml` and `.db3` or `.mcap` files (ROS 2); with `.bag` files of one recording (ROS 1). Or a
        `.bag`, `.mcap` or `.db3` file. Of several paths: two folders, of left and of right images, or the files of one
        recording.
    calib : str or path, optional
        Calibration of a plain folder or a UTIAS run, or of a bag, where it stands in for the camera infos; the other
        layouts bring their own.
    topics : tuple of 2 str, optional
        Topics of a bag with the left and the right images.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.
    fps : float, optional
        Frames a second, as in `StereoFolder`; the other layouts have times.

    Returns
    -------
    StereoFolder, EurocSequence, KittiSequence, UtiasRun or RosbagSequence
        Grey cameras where KITTI has both.

    Raises
    ------
    InputError
        If the folder has none of these layouts, its reader refuses it, or `calib`, `topics` or `fps` are given where
        they are not used.

    Examples
    --------
    >>> open_sequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is no folder, expected one with left/ and right/, mav0/, image_0/ ...
    """
    several = list(path) if isinstance(path, list | tuple) else []
    for each in several or [path]:
        require_path(each)
    folder = Path(several[0] if several else path)  # type: ignore[arg-type]

    def has(*names: str) -> bool:
        return any((folder / name).is_dir() for name in names)

    plain, utias = has(*PLAIN), has("images/left", "images/right")
    layout = _layout(folder, plain or bool(several), utias)
    is_of_bag = is_bag(folder) and not (plain or utias) if not several else all(map(is_bag, map(Path, several)))
    if is_of_bag or layout == "bags":
        _refuse_rate(folder, fps)
        left, right = topics or (None, None)
        return RosbagSequence(several or folder, left=left, right=right, calib=calib, bits=bits)
    if topics is not None:
        raise InputError(one_line(f"{folder}: is no bag, expected one with topics {' and '.join(map(str, topics))}"))
    if layout == "plain":
        return StereoFolder(several or folder, calib, bits=bits, fps=fps)
    _refuse_rate(folder, fps)
    if utias:
        return UtiasRun(folder, calib, bits=bits)
    if calib is not None and has(*_OWN):
        raise InputError(f"{folder}: brings its own calibration, expected none beside it ({calib})")
    if has("mav0", "cam0"):
        return EurocSequence(folder, bits=bits)
    if has(*_OWN):
        return KittiSequence(folder, colour=not has("image_0", "image_00"), bits=bits)
    raise _unknown(folder)


def are_parts(paths: list[Path]) -> bool:
    """Tell whether several paths are one sequence: two folders of images, or files of one bag.

    Parameters
    ----------
    paths : list of path
        What a user names.

    Returns
    -------
    bool

    Examples
    --------
    >>> are_parts([Path("a_0.bag"), Path("a_1.bag")]), are_parts([Path("left.png"), Path("right.png")])
    (True, False)
    """
    if len(paths) < 2:
        return False
    return all(map(is_bag, paths)) or (len(paths) == 2 and all(path.is_dir() for path in paths))


def _layout(folder: Path, is_plain: bool, is_utias: bool) -> str:
    """Whether a folder is a plain one, or one of bags of ROS 1; else nothing."""
    if is_plain or is_utias:
        return "plain" if is_plain else ""
    cameras = [folder / "cam0" / name for name in ("data", "data.csv", "sensor.yaml")]
    if any((folder / name).is_dir() for name in _OWN if name != "cam0") or any(map(os.path.exists, cameras)):
        return ""
    if folder.is_dir() and find_sides(folder) is not None:
        return "plain"
    return "bags" if folder.is_dir() and any(file.suffix.lower() == ".bag" for file in folder.iterdir()) else ""


def _refuse_rate(folder: Path, fps: float | None) -> None:
    if fps is not None:
        raise bad_input(folder, "has times of its own", "no frames a second beside it (--fps, fps=)")


def _unknown(folder: Path) -> InputError:
    """Say what a path is that no reader is for."""
    if not folder.is_dir():
        return no_source(folder) or InputError(one_line(f"{folder}: is no folder, expected {_KNOWN}"))
    stored = sorted(file for file in folder.iterdir() if file.name.endswith(STORED))
    way = f"{_KNOWN}; {stored[0].name} is of a bag of ROS 2 without metadata.yaml: give it alone" if stored else _KNOWN
    return InputError(one_line(f"{folder}: has none of the known layouts (it holds {listed(folder)}), expected {way}"))
