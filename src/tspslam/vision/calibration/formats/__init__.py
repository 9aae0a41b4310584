"""Calibration files of other programs: the content of a file tells its format, and the cameras that it describes."""

from __future__ import annotations

import os
from collections.abc import Callable
from numbers import Integral
from typing import Any

from ...._checks import require_path
from ...._files import PathLike, bad_input
from ...._text import read_text
from ...._yaml import LARGEST_FILE
from ....errors import InputError
from ....types import RawRig, Rig
from ._calibration import Calibration as Calibration
from ._lens import check_lens
from ._opencv_yaml import parse_mapping
from ._source import Source
from ._values import Size
from .euroc import is_euroc, left_file, read_euroc
from .kalibr import is_kalibr, read_kalibr
from .kitti import is_kitti, parse_kitti, read_kitti
from .opencv import is_opencv, read_opencv
from .orbslam import is_orbslam, read_orbslam
from .own import is_own, read_own

_EXPECTED = "a calibration of tspslam, KITTI, EuRoC, OpenCV (YAML), Kalibr or ORB-SLAM"
_Reader = Callable[[Source, Size | None], Calibration]
_YAML: tuple[tuple[Callable[[Source], bool], _Reader], ...] = (
    (is_euroc, read_euroc),
    (is_kalibr, read_kalibr),
    (is_orbslam, read_orbslam),
    (is_opencv, read_opencv),
    (is_own, read_own),
)


def read_calibration(path: PathLike, size: tuple[int, int] | None = None) -> Calibration:
    """Read a stereo calibration of ours or of another program; ours may also be of a single camera, without a baseline.

    Known are KITTI's ``calib.txt`` and ``calib_cam_to_cam.txt``, EuRoC's ``sensor.yaml``, OpenCV's FileStorage YAML,
    Kalibr's camera chain, ORB-SLAM's settings, and our own files. The content tells which it is, not the name.

    Parameters
    ----------
    path : str or path
        The file; for EuRoC cam0's (cam1's is found beside it) or the recording's folder; for OpenCV also either of
        ``intrinsics.yml`` and ``extrinsics.yml``.
    size : (width, height), optional
        Of the images, px. Needed where the file has none, as KITTI's ``calib.txt``; in KITTI's
        ``calib_cam_to_cam.txt`` it chooses between the recorded and the rectified pair; else it must be the file's.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the file cannot be read, is of no known kind, lacks a value or has one that is no number in its range, or
        describes lenses other than a pinhole with k1, k2, p1, p2, k3 (a fisheye lens, say, which is named).

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
        path = left_file(path)
    text = read_text(path, _EXPECTED, LARGEST_FILE)
    if is_kitti(text):
        return read_kitti(parse_kitti(text, path), pixels)
    source = Source(path, parse_mapping(text, path, _EXPECTED))
    if not any("lens" in source.part(side) for side in ("left", "right") if side in source):  # ours: in its own words
        check_lens(source)
    for is_one, read in _YAML:
        if is_one(source):
            return read(source, pixels)
    keys = ", ".join(str(key)[:30] for key in list(source.values)[:6])
    raise bad_input(path, f"holds no calibration that is known (its keys: {keys})", _EXPECTED)


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
    cameras = read_calibration(path, size).cameras
    if isinstance(cameras, Rig) and not cameras.baseline:
        raise bad_input(path, "has no baseline", "that of a pair of cameras, m")
    return cameras


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
