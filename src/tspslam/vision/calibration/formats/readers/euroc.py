"""EuRoC's (ASL's) camera files: a ``sensor.yaml`` for each camera, with its pose in the body's frame."""

from __future__ import annotations

from pathlib import Path

from ....._files import PathLike, bad_input
from .._calibration import Calibration, raw
from .._opencv_yaml import read_mapping
from .._source import Source
from .._values import Found, Size, agreed_size, coefficients, distortion, from_list, inverse, pose, size_from_list

KIND = "EuRoC sensor.yaml"
PLACES = ("mav0/cam0/sensor.yaml", "cam0/sensor.yaml", "cam0_sensor.yaml")
"""Where the left camera's file is in the folder of a recording."""
_BROWN = ("radial-tangential", "radtan", "plumb_bob", "plumb-bob", "brown")
_FISHEYE = ("equidistant", "equi", "kannala-brandt", "fisheye")


def is_euroc(source: Source) -> bool:
    """Tell whether a mapping is that of one EuRoC sensor.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    return "T_BS" in source


def read_euroc(source: Source, size: Size | None = None) -> Calibration:
    """Read the values of cam0's file and of cam1's beside it; ``T_right_left = T_BS1⁻¹ T_BS0``.

    Parameters
    ----------
    source : Source
        The left camera's file, ``cam0/sensor.yaml`` or ``cam0_sensor.yaml``.
    size : (width, height), optional
        Of the images, px; it must be the file's.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the right camera's file is not there, a value is missing or out of range, or the lens is neither a pinhole
        with Brown's distortion nor an equidistant fisheye.

    Examples
    --------
    >>> import tempfile
    >>> text = '''
    ... sensor_type: camera
    ... T_BS: {rows: 4, cols: 4, data: [1, 0, 0, %s, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}
    ... resolution: [752, 480]
    ... camera_model: pinhole
    ... intrinsics: [458, 457, 367, 248]
    ... distortion_model: radial-tangential
    ... distortion_coefficients: [-0.28, 0.07, 0, 0]'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     paths = [Path(folder, f"cam{k}_sensor.yaml") for k in (0, 1)]
    ...     done = [path.write_text(text % x) for path, x in zip(paths, (0.0, 0.11))]
    ...     read_euroc(Source(paths[0], read_mapping(paths[0], "a sensor.yaml"))).cameras.T_right_left[0]
    (1.0, 0.0, 0.0, -0.11)
    """
    path = _right_file(source.path)
    right = Source(path, read_mapping(path, "the sensor.yaml of the right camera"), "cam1.")
    left = Source(source.path, source.values, "cam0.")
    sides = _side(left), _side(right)
    agreed_size(left, sides[0], size)
    T_body_left, T_body_right = pose(left, "T_BS"), pose(right, "T_BS")
    T_right_left = inverse(T_body_right) @ T_body_left
    return raw(source, sides, (T_right_left, "inverse of cam1.T_BS, cam0.T_BS"), KIND)


def _side(source: Source) -> Found:
    kind = source.values.get("sensor_type", "camera")
    if kind != "camera":
        raise source.wrong("sensor_type", kind, "camera")
    _check_model(source, "camera_model", ("pinhole",))
    model = _check_model(source, "distortion_model", (*_BROWN, *_FISHEYE))
    if model in _FISHEYE:
        lens = coefficients(source, "distortion_coefficients", "equidistant", source.label("distortion_model"))
    else:
        lens = distortion(source, "distortion_coefficients", 4, 5)
    return from_list(source, "intrinsics") | lens | size_from_list(source, "resolution")


def _check_model(source: Source, key: str, known: tuple[str, ...]) -> str:
    model = source.text(key, known[0]).lower()
    if model not in known:
        raise source.wrong(key, model, "a pinhole camera, radial-tangential (k1, k2, p1, p2) or equidistant")
    return model


def _right_file(path: PathLike) -> Path:
    """Where cam1's file is: ``cam1_sensor.yaml`` beside ``cam0_sensor.yaml``, or ``../cam1/sensor.yaml``."""
    own = Path(path).absolute()
    if "cam0" in own.name:
        return Path(path).with_name(own.name.replace("cam0", "cam1"))
    if own.parent.name == "cam0":
        return own.parent.parent / "cam1" / own.name
    raise bad_input(path, "is not the left camera's by its name", "cam0/sensor.yaml or cam0_sensor.yaml")
