"""Which reader a folder, a bag or a video is for, told by its name and by what lies in it."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from .._checks import require_path
from .._files import PathLike, bad_input, one_line, reason_of
from ..errors import InputError
from ..vision.depth.sensor import DepthSensor
from ._kinds import is_video, listed, no_source
from ._rgbd_layouts import is_rgbd
from ._rgbd_topics import is_rgbd_bag
from ._ros import STORED, is_bag
from ._sides import PLAIN, find_sides
from .euroc import EurocSequence
from .folder import StereoFolder
from .kitti import KittiSequence
from .rgbd import RgbdSequence
from .rosbag import RosbagSequence
from .rosbag_depth import RgbdBag
from .utias import UtiasRun
from .video import OnIndex, VideoSequence, image_size

Sequence = (
    StereoFolder | KittiSequence | EurocSequence | UtiasRun | RosbagSequence | VideoSequence | RgbdSequence | RgbdBag
)


_KNOWN = (
    "one with left/ and right/, mav0/, image_0/ or image_2/, image_00/ or image_02/, images/left/, rgb/ and depth/, "
    "a bag of ROS or a video"
)
_OWN = ("mav0", "cam0", "image_0", "image_2", "image_00", "image_02")  # of layouts that bring a calibration
_GO_WITH = {  # for each option, the kinds that it goes with, and what to say of another one
    "topics": ({"bag"}, "is no bag, expected one with topics {}"),
    "layout": ({"video"}, "is no video, expected one with both images in it, {}"),
    "fps": ({"video", "plain"}, "has times of its own, expected no frames a second beside it (--fps, fps=)"),
    "unit": ({"rgbd"}, "has no depths, expected a folder of RGB-D with unit={}"),
    "sensor": ({"rgbd", "bag"}, "has no depths, expected a folder or a bag of RGB-D with a sensor"),
    "calib": ({"bag", "video", "plain", "rgbd", "utias"}, "brings its own calibration, expected none beside it ({})"),
}


def open_sequence(
    path: PathLike | list[PathLike] | tuple[PathLike, ...], *,
    calib: PathLike | None = None, topics: tuple[str, str] | None = None, bits: int | None = None,
    layout: str | None = None, fps: float | None = None, unit: float | None = None, sensor: DepthSensor | None = None,
    on_index: OnIndex | None = None,
) -> Sequence:  # fmt: skip
    """Open a folder, a bag or a video of stereo pairs, or a folder of colour images and depths, with its reader.

    Parameters
    ----------
    path : str, path or sequence of them
        A folder with `left/` and `right/`, or with sides that `StereoFolder` knows; with `mav0/` (EuRoC, ASL); with
        `image_0/` or `image_2/` (KITTI odometry), `image_00/` or `image_02/` (KITTI raw); with `images/left/` (UTIAS);
        with `rgb/` or `color/` and `depth/` (TUM's RGB-D benchmark, ICL-NUIM, ScanNet, plain ones); with
        `metadata.yaml` and `.db3` or `.mcap` files (ROS 2); with `.bag` files of one recording (ROS 1). Or a `.bag`,
        `.mcap` or `.db3` file, or a video with both images. Of several paths: two folders or two videos, of left and
        of right images, or the files of one recording.
    calib : str or path, optional
        Calibration of a plain folder, one of RGB-D, a video or a UTIAS run, or of a bag, where it stands in for the
        camera infos; the other layouts bring their own.
    topics : tuple of 2 str, optional
        Topics of a bag with the left and the right images, or with colour images and depths.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.
    layout : str, optional
        How both images are in a video, as in `VideoImages`.
    fps : float, optional
        Frames a second of a plain folder or a video, as in `StereoFolder` and `VideoImages`; the others have times.
    unit, sensor : optional
        Metres in one step of the depths of a folder of RGB-D, and how those of a folder or a bag scatter, as in
        `RgbdSequence`.
    on_index : callable, optional
        Called with frames done and in all while a video is gone through, as in `VideoImages`.

    Returns
    -------
    StereoFolder, EurocSequence, KittiSequence, UtiasRun, RosbagSequence, VideoSequence, RgbdSequence or RgbdBag
        Grey cameras where KITTI has both.

    Raises
    ------
    InputError
        If the folder has none of these layouts, its reader refuses it, or an option is given that does not go with it.

    Examples
    --------
    >>> open_sequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is no folder, expected one with left/ and right/, mav0/, image_0/ ...
    """
    several = [Path(each) for each in map(_checked, path)] if isinstance(path, list | tuple) else []
    folder = several[0] if several else Path(_checked(path))
    try:
        kind = _kind(folder, several, has_depth=not (unit is None and sensor is None))
    except OSError as error:
        raise bad_input(folder, f"cannot be looked at ({reason_of(error)})", _KNOWN) from error
    given = {"calib": calib, "topics": topics, "layout": layout, "fps": fps, "unit": unit, "sensor": sensor}
    _refuse_others(folder, kind, given)
    source: Any = several or folder
    match kind:
        case "video":
            return _open_video(source, calib, layout, fps, bits, on_index)
        case "bag":
            one, other = topics or (None, None)
            if sensor is not None or is_rgbd_bag(source, topics):
                return RgbdBag(source, colour=one, depth=other, calib=calib, sensor=sensor, bits=bits)
            return RosbagSequence(source, left=one, right=other, calib=calib, bits=bits)
        case "plain":
            return StereoFolder(source, calib, bits=bits, fps=fps)
        case "rgbd":
            return RgbdSequence(folder, calib, unit=unit, sensor=sensor, bits=bits)
        case "utias":
            return UtiasRun(folder, calib, bits=bits)
        case "euroc":
            return EurocSequence(folder, bits=bits)
        case "kitti":
            return KittiSequence(folder, colour=not _has(folder, "image_0", "image_00"), bits=bits)
    raise AssertionError(kind)


def is_known(path: PathLike) -> bool:
    """Tell whether a path is for one of the readers, by its name and by what lies in it; nothing is read.

    Parameters
    ----------
    path : str or path
        A folder or a file.

    Returns
    -------
    bool
        False also where it cannot be looked at.

    Examples
    --------
    >>> is_known("no-such-folder"), is_known("notes.txt")
    (False, False)
    """
    try:
        _kind(Path(_checked(path)), [], has_depth=False)
    except (InputError, OSError):
        return False
    return True


def are_parts(paths: list[Path]) -> bool:
    """Tell whether several paths are one sequence: two folders of images, two videos, or files of one bag.

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
    is_pair = len(paths) == 2 and (all(path.is_dir() for path in paths) or all(map(is_video, paths)))
    return is_pair or all(map(is_bag, paths))


def are_recordings(paths: list[Path]) -> bool:
    """Tell whether several paths are recordings of their own: one of them at least is a folder with a whole one in it.

    Parameters
    ----------
    paths : list of path
        What a user names.

    Returns
    -------
    bool
        False of two folders of left and of right images, and of files of one bag.

    Examples
    --------
    >>> are_recordings([Path("left.png"), Path("right.png")])
    False
    """
    return len(paths) > 1 and any(path.is_dir() and _is_whole(path) for path in paths)


def _is_whole(folder: Path) -> bool:
    try:
        _kind(folder, [], has_depth=True)
    except (InputError, OSError):
        return False
    return True


def _checked(path: object) -> Any:
    require_path(path)
    return path


def _has(folder: Path, *names: str) -> bool:
    return any((folder / name).is_dir() for name in names)


def _kind(folder: Path, several: list[Path], *, has_depth: bool) -> str:
    """What kind of source it is; InputError if it is none that is known."""
    if several and not are_parts(several):
        names = ", ".join(str(each) for each in several[:6])
        raise InputError(one_line(f"{names}: are no sequence, expected two folders, two videos or files of one bag"))
    if is_video(folder) and folder.exists():
        return "video"
    if several:
        return "bag" if is_bag(folder) else "plain"
    if _has(folder, *PLAIN):
        return "rgbd" if has_depth and is_rgbd(folder) else "plain"
    if _has(folder, "images/left", "images/right"):
        return "utias"
    if is_bag(folder):
        return "bag"
    if not folder.is_dir():
        raise _unknown(folder)
    return _kind_of_folder(folder)


def _kind_of_folder(folder: Path) -> str:
    """What a folder is that is neither plain nor a bag of ROS 2, by what lies in it."""
    is_own = _has(folder, *_OWN[2:]) or _has(folder, "mav0")
    of_cam0 = (folder / "cam0" / name for name in ("data", "data.csv", "sensor.yaml"))
    if not is_own and not any(map(os.path.exists, of_cam0)):
        if is_rgbd(folder):
            return "rgbd"
        if find_sides(folder) is not None:
            return "plain"
        if any(file.suffix.lower() == ".bag" for file in folder.iterdir()):
            return "bag"
    if not _has(folder, *_OWN):
        raise _unknown(folder)
    return "euroc" if _has(folder, "mav0", "cam0") else "kitti"


def _refuse_others(folder: Path, kind: str, given: dict[str, Any]) -> None:
    """Refuse options that do not go with a kind of source."""
    for option, (kinds, said) in _GO_WITH.items():
        value = given[option]
        if value is not None and kind not in kinds:
            shown = " and ".join(map(str, value)) if option == "topics" else str(value)
            raise InputError(one_line(f"{folder}: {said.format(shown)}"))


def _open_video(
    source: Any, calib: PathLike | None, layout: str | None, fps: float | None, bits: int | None,
    on_index: OnIndex | None,
) -> VideoSequence:  # fmt: skip
    if calib is None:
        image_size(source, layout)  # what is wrong with the file comes first
        said = "is a video without a calibration, expected a file by --calib (calib=)"
        raise InputError(one_line(f"{source[0] if isinstance(source, list) else source}: {said}"))
    return VideoSequence(source, layout, calib=calib, fps=fps, bits=bits, on_index=on_index)


def _unknown(folder: Path) -> InputError:
    """Say what a path is that no reader is for."""
    if not folder.is_dir():
        return no_source(folder) or InputError(one_line(f"{folder}: is no folder, expected {_KNOWN}"))
    stored = sorted(file for file in folder.iterdir() if file.name.endswith(STORED))
    way = f"{_KNOWN}; {stored[0].name} is of a bag of ROS 2 without metadata.yaml: give it alone" if stored else _KNOWN
    return InputError(one_line(f"{folder}: has none of the known layouts (it holds {listed(folder)}), expected {way}"))
