"""Which reader a folder or a bag is for, told by what lies in it."""

from __future__ import annotations

from pathlib import Path

from .._checks import require_path
from .._files import PathLike, one_line
from ..errors import InputError
from ..vision.depth.sensor import DepthSensor
from ._kinds import listed, no_source
from ._rgbd_layouts import is_rgbd
from ._rgbd_topics import is_rgbd_bag
from ._ros import STORED, is_bag
from .euroc import EurocSequence
from .folder import StereoFolder
from .kitti import KittiSequence
from .rgbd import RgbdSequence
from .rosbag import RosbagSequence
from .rosbag_depth import RgbdBag
from .utias import UtiasRun

Sequence = StereoFolder | KittiSequence | EurocSequence | UtiasRun | RosbagSequence | RgbdSequence | RgbdBag


_KNOWN = (
    "one with left/ and right/, mav0/, image_0/ or image_2/, image_00/ or image_02/, images/left/, rgb/ and depth/, "
    "or a bag of ROS"
)
_OWN = ("mav0", "cam0", "image_0", "image_2", "image_00", "image_02")  # of layouts that bring a calibration


def open_sequence(
    path: PathLike, *, calib: PathLike | None = None, topics: tuple[str, str] | None = None, bits: int | None = None,
    unit: float | None = None, sensor: DepthSensor | None = None,
) -> Sequence:  # fmt: skip
    """Open a folder or a bag of stereo pairs with the reader of its layout.

    Parameters
    ----------
    path : str or path
        A folder with `left/` and `right/`; with `mav0/` (EuRoC, ASL); with `image_0/` or `image_2/` (KITTI odometry),
        `image_00/` or `image_02/` (KITTI raw); with `images/left/` (UTIAS); with `rgb/` or `color/` and `depth/` (TUM's
        RGB-D benchmark, ICL-NUIM, ScanNet, plain ones); with `metadata.yaml` and `.db3` or `.mcap`
        files (ROS 2). Or a `.bag`, `.mcap` or `.db3` file.
    calib : str or path, optional
        Calibration of a plain folder, one of RGB-D or a UTIAS run, or of a bag, where it stands in for the camera
        infos; the other layouts bring their own.
    topics : tuple of 2 str, optional
        Topics of a bag with the left and the right images, or with colour images and depths.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.
    unit, sensor : optional
        Metres in one step of the depths of a folder of RGB-D, and how those of a folder or a bag scatter, as in
        `RgbdSequence`.

    Returns
    -------
    StereoFolder, EurocSequence, KittiSequence, UtiasRun, RosbagSequence, RgbdSequence or RgbdBag
        Grey cameras where KITTI has both.

    Raises
    ------
    InputError
        If the folder has none of these layouts, its reader refuses it, or `calib` or `topics` are given where they
        are not used.

    Examples
    --------
    >>> open_sequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is no folder, expected one with left/ and right/, mav0/, image_0/ ...
    """
    require_path(path)
    folder = Path(path)

    def has(*names: str) -> bool:
        return any((folder / name).is_dir() for name in names)

    plain, utias = has("left", "right"), has("images/left", "images/right")
    if is_bag(folder) and not (plain or utias):
        if sensor is not None or is_rgbd_bag(folder, topics):
            colour, depth = topics or (None, None)
            return RgbdBag(folder, colour=colour, depth=depth, calib=calib, sensor=sensor, bits=bits)
        left, right = topics or (None, None)
        return RosbagSequence(folder, left=left, right=right, calib=calib, bits=bits)
    if topics is not None:
        raise InputError(one_line(f"{folder}: is no bag, expected one with topics {' and '.join(map(str, topics))}"))
    if plain and unit is None and sensor is None:
        return StereoFolder(folder, calib, bits=bits)
    if is_rgbd(folder) and not utias and not has(*_OWN):
        return RgbdSequence(folder, calib, unit=unit, sensor=sensor, bits=bits)
    if unit is not None or sensor is not None:
        raise InputError(one_line(f"{folder}: has no depths, expected unit and sensor for a folder of RGB-D alone"))
    if utias:
        return UtiasRun(folder, calib, bits=bits)
    if calib is not None and has(*_OWN):
        raise InputError(f"{folder}: brings its own calibration, expected none beside it ({calib})")
    if has("mav0", "cam0"):
        return EurocSequence(folder, bits=bits)
    if has(*_OWN):
        return KittiSequence(folder, colour=not has("image_0", "image_00"), bits=bits)
    raise _unknown(folder)


def _unknown(folder: Path) -> InputError:
    """Say what a path is that no reader is for."""
    if not folder.is_dir():
        return no_source(folder) or InputError(one_line(f"{folder}: is no folder, expected {_KNOWN}"))
    stored = sorted(file for file in folder.iterdir() if file.name.endswith(STORED))
    way = f"{_KNOWN}; {stored[0].name} is of a bag of ROS 2 without metadata.yaml: give it alone" if stored else _KNOWN
    return InputError(one_line(f"{folder}: has none of the known layouts (it holds {listed(folder)}), expected {way}"))
