"""ROS's ``camera_info`` files, one a camera, as camera_calibration writes them, and RTAB-Map after it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ....._files import PathLike
from .._beside import partner
from .._calibration import Calibration, raw
from .._camera_info import Keys, check_model, from_camera_infos, lens
from .._opencv_yaml import read_mapping
from .._source import Source
from .._values import Size, agreed_size, motion, rotation, size_from_keys

KIND, KIND_OF_RTABMAP = "ROS camera_info", "RTAB-Map calibration"
PLACES = ("left.yaml", "left.yml", "left_camera_info.yaml", "camera_info_left.yaml")
"""Names of the left camera's file in a folder."""
_KEYS = Keys(
    "image_width",
    "image_height",
    "distortion_model",
    "distortion_coefficients",
    "camera_matrix",
    "rectification_matrix",
    "projection_matrix",
)
_POSE = ("rotation_matrix", "translation_matrix")
_MODELS = ("camera_model",)  # older names of distortion_model


def is_ros(source: Source) -> bool:
    """Tell whether a mapping is the file of one camera.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    return "camera_matrix" in source and bool({_KEYS.P, _KEYS.R, "camera_name"} & source.values.keys())


def read_ros(source: Source, size: Size | None = None) -> Calibration:
    """Read the files of the left and of the right camera, of which one is given and the other beside it.

    Their names, or those of their folders, differ in ``left`` and ``right`` or in ``cam0`` and ``cam1``. Where the
    projection matrices hold no baseline, the pose is that of RTAB-Map's third file, ``NAME_pose.yaml``.

    Parameters
    ----------
    source : Source
        Either of the two.
    size : (width, height), optional
        Of the images, px; it must be the files'.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the other file is not there, a value is missing or out of range, or the lens is none of plumb_bob,
        rational_polynomial and equidistant.

    Examples
    --------
    >>> import tempfile
    >>> text = '''
    ... image_width: 640
    ... image_height: 480
    ... camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}
    ... distortion_model: plumb_bob
    ... distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
    ... rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    ... projection_matrix: {rows: 3, cols: 4, data: [500, 0, 320, %s, 0, 500, 240, 0, 0, 0, 1, 0]}'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = [Path(folder, f"{side}.yaml") for side in ("left", "right")]
    ...     done = [path.write_text(text % x) for path, x in zip(paths, (0, -50))]
    ...     read_ros(Source(paths[0], read_mapping(paths[0], "a camera_info"))).cameras.baseline
    0.1
    """
    both = _both(source)
    left, right = (Keys(*(f"{side}.{key}" for key in _KEYS)) for side in ("left", "right"))
    agreed_size(both, size_from_keys(both, left.width, left.height), size)
    third = _third(source.path)
    kind = KIND_OF_RTABMAP if third or "left.local_transform" in both else KIND
    if third and not _has_baseline(both, right):
        return _posed(both, left, right, third)
    return from_camera_infos(both, left, right, kind=kind)


def _both(source: Source) -> Source:
    """All values of both files, by side and name."""
    places = partner(source.path)
    if places is None:
        wanted = "a name with left or right, cam0 or cam1, and the other camera's file beside it"
        raise source.error(f"is of one camera, and its name does not tell which, expected {wanted}")
    values: dict[object, object] = {}
    for side, path in zip(("left", "right"), places, strict=True):
        is_given = os.path.abspath(path) == os.path.abspath(source.path)
        part = source if is_given else Source(path, read_mapping(path, f"the camera_info of the {side} camera"))
        values |= {f"{side}.{key}": value for key, value in _completed(part).items()}
    return Source(source.path, values)


def _completed(part: Source) -> dict[str, object]:
    """Values of one file; what may be left out is put in: no rotation, no distortion."""
    values = {str(key): value for key, value in part.values.items()}
    older = next((values[name] for name in _MODELS if name in values), "")
    return {_KEYS.model: older, _KEYS.R: np.eye(3).tolist()} | values


def _has_baseline(both: Source, right: Keys) -> bool:
    return right.P in both and both.matrix(right.P, 3, 4)[0, 3] != 0


def _third(path: PathLike) -> Path | None:
    """RTAB-Map's file of the pose, if it is there."""
    given = Path(path)
    for side in ("left", "right"):
        place = given.with_name(given.name.replace(f"_{side}", "_pose"))
        if place != given and os.path.exists(place):
            return place
    return None


def _posed(both: Source, left: Keys, right: Keys, path: Path) -> Calibration:
    for keys in (left, right):
        check_model(both, keys)
    turn = Source(path, read_mapping(path, "the pose of a stereo calibration of RTAB-Map"))
    T_right_left = motion(rotation(turn, _POSE[0]), turn.vector(_POSE[1], 3))
    return raw(both, (lens(both, left), lens(both, right)), (T_right_left, ", ".join(_POSE)), KIND_OF_RTABMAP)
