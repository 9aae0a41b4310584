"""Calibration files of other programs: the content of a file tells its format, and the cameras that it describes."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from numbers import Integral
from pathlib import Path
from typing import Any

from ...._checks import require_path
from ...._files import PathLike, bad_input, reason_of
from ...._lazy import load_files
from ...._text import parse_json, read_text
from ...._yaml import LARGEST_FILE
from ....errors import InputError
from ....types import RawRig, Rig
from ._beside import first_of
from ._calibration import Calibration as Calibration
from ._opencv_yaml import parse_mapping
from ._source import Source
from ._values import Size
from .own import is_own, read_own
from .readers import colmap, euroc, ros
from .readers.basalt import is_basalt, read_basalt
from .readers.factory import is_t265, is_zed, parse_zed, read_t265, read_zed
from .readers.kalibr import is_kalibr, read_kalibr
from .readers.kitti import is_kitti, parse_kitti, read_kitti
from .readers.middlebury import is_middlebury, parse_middlebury, read_middlebury
from .readers.opencv import is_opencv, read_opencv
from .readers.orbslam import is_orbslam, read_orbslam
from .readers.stella import is_stella, read_stella

__getattr__ = load_files(__name__)
_EXPECTED = "a calibration of tspslam, KITTI, EuRoC, OpenCV, Kalibr, ROS, ORB-SLAM or another program that is known"
_PLACES = (*euroc.PLACES, *ros.PLACES, *colmap.PLACES)  # in a folder
_JSON = re.compile(r"\s*[\[{]\s*[\"\[{\]}]")  # a mapping of YAML may begin with a brace as well, but not with a quote
_Reader = Callable[[Source, Size | None], Calibration]
_TEXTS: tuple[tuple[Callable[[str], bool], Callable[[str, PathLike], Source], _Reader], ...] = (
    (is_kitti, parse_kitti, read_kitti),
    (is_middlebury, parse_middlebury, read_middlebury),
    (is_zed, parse_zed, read_zed),
)
"""Files of lines: what tells one, what takes its lines apart, what reads it."""
_MAPPINGS: tuple[tuple[Callable[[Source], bool], _Reader], ...] = (
    (euroc.is_euroc, euroc.read_euroc),
    (is_kalibr, read_kalibr),
    (is_stella, read_stella),
    (is_orbslam, read_orbslam),
    (ros.is_ros, ros.read_ros),
    (is_opencv, read_opencv),
    (is_basalt, read_basalt),
    (is_t265, read_t265),
    (colmap.is_rig_config, colmap.read_rig_config),
    (is_own, read_own),
)
"""Files of keys and values, YAML, XML or JSON: what tells one, what reads it."""


def read_calibration(path: PathLike, size: tuple[int, int] | None = None) -> Calibration:
    """Read a stereo calibration of ours or of another program; ours may also be of a single camera, without a baseline.

    Known are files of Kalibr, OpenCV (FileStorage, YAML and XML), ROS and RTAB-Map (``camera_info``), ORB-SLAM,
    stella_vslam, Basalt, RealSense T265, COLMAP (rigs), EuRoC, KITTI, Middlebury, ZED, and our own: the page on
    calibration files lists them. The content tells which it is, not the name, but for COLMAP's binary files.

    Parameters
    ----------
    path : str or path
        The file. Of two, such as those of a left and a right camera, either; the other is found beside it. For EuRoC
        cam0's. Also the folder of an EuRoC recording, of ``left.yaml`` or of a model of COLMAP.
    size : (width, height), optional
        Of the images, px. Needed where the file has none, as KITTI's ``calib.txt``; in KITTI's
        ``calib_cam_to_cam.txt`` it chooses between the recorded and the rectified pair, in ZED's the resolution; else
        it must be the file's.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the file cannot be read, is of no known kind, lacks a value or has one that is no number in its range, or
        describes a lens that is none of those of `Camera`, which is named.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/calib.txt", "w") as file:
    ...         print("P0: 700 0 600 0 0 700 180 0 0 0 1 0", file=file)
    ...         print("P1: 700 0 600 -350 0 700 180 0 0 0 1 0", file=file)
    ...     found = read_calibration(f"{folder}/calib.txt", size=(1241, 376))
    >>> found.format, found.cameras.baseline, found.origin["baseline"]
    ('KITTI odometry calib.txt', 0.5, 'P1[0,3] / -P1[0,0]')
    """
    pixels = _checked_size(size)
    require_path(path, "calibration")
    if os.path.isdir(path):
        path = _file_of(path)
    if Path(path).name in ("cameras.bin", "rigs.bin"):
        return colmap.read_colmap(path, pixels)
    text = read_text(path, _EXPECTED, LARGEST_FILE)
    for is_text, parse, read in _TEXTS:
        if is_text(text):
            return read(parse(text, path), pixels)
    if colmap.is_colmap(text):
        return colmap.read_colmap(path, pixels)
    return _read_mapping(Source(path, _mapping(text, path)), pixels)


def _read_mapping(source: Source, size: Size | None) -> Calibration:
    for is_one, read in _MAPPINGS:
        if is_one(source):
            return read(source, size)
    keys = ", ".join(str(key)[:30] for key in list(source.values)[:6])
    raise source.error(f"holds no calibration that is known (its keys: {keys}); expected {_EXPECTED}")


def _mapping(text: str, path: PathLike) -> dict[Any, Any]:
    """What a text says in JSON, XML or YAML; a list in JSON, as COLMAP's, stands under the key ``rigs``."""
    if not _JSON.match(text):
        return parse_mapping(text, path, _EXPECTED)
    try:
        content = parse_json(text.encode())
    except (ValueError, RecursionError) as error:
        raise bad_input(path, f"is no whole JSON ({reason_of(error)[:80]})", _EXPECTED) from error
    return content if isinstance(content, dict) else {"rigs": content}


def _file_of(folder: PathLike) -> PathLike:
    found = first_of(folder, _PLACES)
    if found is None:
        wanted = f"a calibration file, or a folder with one of {', '.join(_PLACES)}"
        raise bad_input(folder, "is a folder without a known calibration", wanted)
    return found


def read_stereo(path: PathLike, size: tuple[int, int] | None = None) -> Rig | RawRig:
    """Read the cameras of a pair; a single one is an `InputError`.

    Parameters
    ----------
    path, size
        As `read_calibration`.

    Returns
    -------
    Rig or RawRig
    """
    return read_stereo_calibration(path, size).cameras


def read_stereo_calibration(path: PathLike, size: tuple[int, int] | None = None) -> Calibration:
    """Read the calibration of a pair, with what is to be said of it; one of a single camera is an `InputError`.

    Parameters
    ----------
    path, size
        As `read_calibration`.

    Returns
    -------
    Calibration
    """
    found = read_calibration(path, size)
    if isinstance(found.cameras, Rig) and not found.cameras.baseline:
        raise bad_input(path, "has no baseline", "that of a pair of cameras, m")
    return found


def read_rectified(path: PathLike, size: tuple[int, int] | None = None) -> Rig:
    """Read a rectified pair or a single camera; raw cameras are an `InputError`.

    Parameters
    ----------
    path, size
        As `read_calibration`.

    Returns
    -------
    Rig
    """
    cameras = read_calibration(path, size).cameras
    if isinstance(cameras, RawRig):
        raise InputError(f"{path}: describes raw cameras, expected a rectified one, as the image must be")
    return cameras


def _checked_size(size: Any) -> Size | None:
    if size is None:
        return None
    if not isinstance(size, tuple | list) or len(size) != 2 or not all(map(_is_side, size)):
        raise InputError(f"image size is {repr(size)[:60]}, expected width and height, whole numbers of px to 1000000")
    return int(size[0]), int(size[1])


def _is_side(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool) and 1 <= int(value) <= 1_000_000
