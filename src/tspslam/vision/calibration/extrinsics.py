"""Where a scanner stands in a camera's frame: files of KITTI, of ours, and plain matrices."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..._checks import require_path
from ..._files import PathLike, bad_input
from ..._text import Line, numbers, read_lines, read_text, split
from ..._yaml import LARGEST_FILE, parse_yaml
from ...types import FloatArray
from .formats._source import Source
from .formats._values import check_rotation, motion, rotation
from .formats.readers.kitti import parse_kitti

KEY = "T_camera_scan"
_EXPECTED = (
    f"{KEY} (four rows of four numbers), KITTI's Tr, Tr_velo_to_cam or calib_velo_to_cam.txt, or 12 or 16 plain numbers"
)
_FARTHEST = 1e3  # m from a scanner to the camera
_LAST_ROW = 1e-9
_RAW_CAMERAS = "calib_cam_to_cam.txt"


def read_extrinsics(path: PathLike) -> FloatArray:
    """Read the motion that takes a point of a scanner's frame into that of the rectified left camera.

    Known are KITTI's ``calib.txt`` of the odometry (``Tr``) and of the objects (``Tr_velo_to_cam``, ``R0_rect``), its
    ``calib_velo_to_cam.txt`` of the raw drives, beside which ``calib_cam_to_cam.txt`` must stand (``R_rect_00``), our
    YAML with the key ``T_camera_scan``, and text of 12 or 16 numbers, three or four rows of a matrix. The content tells
    which it is, not the name.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    (4, 4) float64
        ``T_camera_scan``, m; its rotation is made exact.

    Raises
    ------
    InputError
        If the file cannot be read, is none of these, lacks a value, or holds no rotation (to 1e-3) or a place beyond
        1 km.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(f"{folder}/calib.txt", "w") as file:
    ...         print("Tr: 0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3", file=file)
    ...     read_extrinsics(f"{folder}/calib.txt")[:3, 3].tolist()
    [0.1, -0.2, -0.3]
    """
    require_path(path, "extrinsics")
    text = read_text(path, _EXPECTED, LARGEST_FILE)
    first = next((line.strip() for line in text.split("\n") if line.strip() and line.strip()[0] not in "#%"), "")
    if first[:1] in "+-.0123456789" and ":" not in first:
        return _checked(path, "its matrix", _of_numbers(path))
    if f"{KEY}:" in text:
        return _of_ours(path, text)
    return _of_kitti(path, parse_kitti(text, path))


def _of_numbers(path: PathLike) -> FloatArray:
    """Plain numbers, in any lines."""
    rows: list[float] = []
    for line in read_lines(path, _EXPECTED, LARGEST_FILE):
        rows += _row(path, line)
    if len(rows) not in (12, 16):
        raise bad_input(path, f"holds {len(rows)} numbers", _EXPECTED)
    T = np.eye(4)
    T[: len(rows) // 4] = np.reshape(rows, (-1, 4))
    return T


def _row(path: PathLike, line: Line) -> list[float]:
    return numbers(path, line, split(path, line, _EXPECTED), _EXPECTED)


def _of_ours(path: PathLike, text: str) -> FloatArray:
    try:
        content = parse_yaml(text)
    except ValueError as error:
        raise bad_input(path, f"is not plain YAML: {error}", _EXPECTED) from error
    if not isinstance(content, dict):
        raise bad_input(path, "is no mapping", _EXPECTED)
    return _checked(path, KEY, Source(path, content).matrix(KEY, 4, 4))


def _of_kitti(path: PathLike, source: Source) -> FloatArray:
    if "Tr" in source:
        return _checked(path, "Tr", _three_rows(source, "Tr"))
    if "Tr_velo_to_cam" in source:
        turn = motion(rotation(source, "R0_rect"), (0.0, 0.0, 0.0))
        return _checked(path, "Tr_velo_to_cam", turn @ _three_rows(source, "Tr_velo_to_cam"))
    if "R" in source and "T" in source:
        moved = motion(rotation(source, "R"), source.vector("T", 3))
        return _checked(path, "R, T", _rectifying(path) @ moved)
    keys = ", ".join(str(key)[:20] for key in list(source.values)[:6])
    raise bad_input(path, f"says of no scanner where it stands (its keys: {keys})", _EXPECTED)


def _three_rows(source: Source, key: str) -> FloatArray:
    rows = source.matrix(key, 3, 4)
    check_rotation(source, key, rows[:, :3])
    return motion(rows[:, :3], rows[:, 3].tolist())


def _rectifying(path: PathLike) -> FloatArray:
    """Turn from camera 0 as it was recorded to the rectified one."""
    beside = Path(path).parent / _RAW_CAMERAS
    if not os.path.isfile(beside):
        raise bad_input(path, f"is without {_RAW_CAMERAS} beside it", "both: R_rect_00 turns into the rectified camera")
    cameras = parse_kitti(read_text(beside, _EXPECTED, LARGEST_FILE), beside)
    return motion(rotation(cameras, "R_rect_00"), (0.0, 0.0, 0.0))


def _checked(path: PathLike, what: str, T: FloatArray) -> FloatArray:
    """A motion with an exact rotation."""
    if not np.isfinite(T).all() or np.abs(T[3] - (0, 0, 0, 1)).max() > _LAST_ROW:
        raise bad_input(path, f"{what} has a last row of {T[3].tolist()}, or a number that is not finite", "0 0 0 1")
    check_rotation(Source(path, {what: T[:3, :3].tolist()}), what, T[:3, :3])
    if np.abs(T[:3, 3]).max() > _FARTHEST:
        raise bad_input(path, f"{what} is {T[:3, 3].tolist()} away", f"metres, at most {_FARTHEST:g}")
    U, _, Vt = np.linalg.svd(T[:3, :3])
    return motion(U @ Vt, T[:3, 3].tolist())
