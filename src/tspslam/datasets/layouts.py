"""Which reader a folder or a bag is for, told by what lies in it."""

from __future__ import annotations

from pathlib import Path

from .._files import PathLike
from ..errors import InputError
from ._ros import is_bag
from .euroc import EurocSequence
from .folder import StereoFolder
from .kitti import KittiSequence
from .rosbag import RosbagSequence
from .utias import UtiasRun

Sequence = StereoFolder | KittiSequence | EurocSequence | UtiasRun | RosbagSequence


def open_sequence(path: PathLike, *, calib: PathLike | None = None, bits: int | None = None) -> Sequence:
    """Open a folder or a bag of stereo pairs with the reader of its layout.

    Parameters
    ----------
    path : str or path
        A folder with `left/` and `right/`; with `mav0/` (EuRoC, ASL); with `image_0/` or `image_2/` (KITTI odometry),
        `image_00/` or `image_02/` (KITTI raw); with `images/left/` (UTIAS); with `metadata.yaml` and `.db3` or `.mcap`
        files (ROS 2). Or a `.bag`, `.mcap` or `.db3` file.
    calib : str or path, optional
        Calibration of a plain folder or a UTIAS run; the other layouts bring their own.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.

    Returns
    -------
    StereoFolder, EurocSequence, KittiSequence, UtiasRun or RosbagSequence
        Grey cameras where KITTI has both.

    Raises
    ------
    InputError
        If the folder has none of these layouts, its reader refuses it, or `calib` is given where it is not used.

    Examples
    --------
    >>> open_sequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is no folder, expected one with left/ and right/, mav0/, image_0/ ...
    """
    folder = Path(path)

    def has(*names: str) -> bool:
        return any((folder / name).is_dir() for name in names)

    if has("left", "right"):
        return StereoFolder(folder, calib, bits=bits)
    if has("images/left", "images/right"):
        return UtiasRun(folder, calib, bits=bits)
    bag = is_bag(folder)
    if calib is not None and (bag or has("mav0", "cam0", "image_0", "image_2", "image_00", "image_02")):
        raise InputError(f"{folder}: brings its own calibration, expected none beside it ({calib})")
    if bag:
        return RosbagSequence(folder, bits=bits)
    if has("mav0", "cam0"):
        return EurocSequence(folder, bits=bits)
    if has("image_0", "image_2", "image_00", "image_02"):
        return KittiSequence(folder, colour=not has("image_0", "image_00"), bits=bits)
    said = "has none of the known layouts" if folder.is_dir() else "is no folder"
    raise InputError(
        f"{folder}: {said}, expected one with left/ and right/, mav0/, image_0/ or image_2/, image_00/ or image_02/, "
        "images/left/, or a bag of ROS"
    )
