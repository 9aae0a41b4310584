"""Stereo settings of stella_vslam and of OpenVSLAM before it."""

from __future__ import annotations

from .._calibration import Calibration, raw, rectified
from .._source import Source
from .._values import (
    OPENCV_COUNTS,
    Found,
    Size,
    agreed_size,
    beside,
    checked,
    coefficients,
    distortion,
    from_camera_matrix,
    from_keys,
    rotation,
    size_from_keys,
)

KIND = "stella_vslam settings"
_FLAT = ("Camera", "StereoRectifier")  # parts whose keys OpenVSLAM writes as Camera.fx
_PERSPECTIVE, _FISHEYE = "perspective", "fisheye"
_DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4")


def is_stella(source: Source) -> bool:
    """Tell whether a mapping is a settings file.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    camera = source.values.get("Camera")
    names = camera.keys() if isinstance(camera, dict) else {str(key).removeprefix("Camera.") for key in source.values}
    return bool({"setup", "model", "focal_x_baseline"} & names) and ("Camera" in source or "Camera.fx" in source)


def read_stella(source: Source, size: Size | None = None) -> Calibration:
    """Read a stereo pair of settings.

    ``StereoRectifier`` (``K_left D_left R_left`` and those of the right camera) is a raw pair; without it ``Camera``
    is a rectified one, its baseline ``focal_x_baseline / fx``.

    Parameters
    ----------
    source : Source
        The settings.
    size : (width, height), optional
        Of the images, px; it must be that of ``Camera.cols`` and ``Camera.rows``.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the setup is not stereo, the model is neither perspective nor fisheye, a rectified camera is distorted, or a
        value is missing or out of range.

    Examples
    --------
    >>> camera = {"setup": "stereo", "model": "perspective", "fx": 700, "fy": 700, "cx": 600, "cy": 180}
    >>> camera |= {"focal_x_baseline": 350, "cols": 1241, "rows": 376}
    >>> read_stella(Source("KITTI.yaml", {"Camera": camera})).cameras.baseline
    0.5
    """
    camera = _part(source, "Camera")
    setup = camera.text("setup", "stereo")
    if setup.lower() != "stereo":
        raise camera.wrong("setup", setup, "stereo")
    pixels = agreed_size(source, size_from_keys(camera, "cols", "rows"), size)
    baseline = _baseline(camera)
    if _has(source, "StereoRectifier"):
        return _unrectified(source, _part(source, "StereoRectifier"), pixels, baseline)
    _check_rectified(camera)
    return rectified(from_keys(camera, "") | baseline | pixels, KIND)


def _has(source: Source, name: str) -> bool:
    return name in source or any(str(key).startswith(f"{name}.") for key in source.values)


def _part(source: Source, name: str) -> Source:
    """A part of the file, of keys below its name or of keys that begin with it."""
    if name in source:
        return source.part(name)
    keys = {key: str(key).removeprefix(f"{name}.") for key in source.values if str(key).startswith(f"{name}.")}
    return Source(source.path, {short: source.values[key] for key, short in keys.items()}, f"{name}.")


def _baseline(camera: Source) -> Found:
    fx = checked(camera, {"fx": (camera.number("fx"), camera.label("fx"))})["fx"][0]
    key = f"{camera.label('focal_x_baseline')} / {camera.label('fx')}"
    return checked(camera, {"baseline": (camera.number("focal_x_baseline") / fx, key)})


def _model(part: Source, default: str = _PERSPECTIVE) -> str:
    model = part.text("model", _PERSPECTIVE) if "model" in part else default
    if model not in (_PERSPECTIVE, _FISHEYE):
        raise part.wrong("model", model, f"{_PERSPECTIVE} or {_FISHEYE}")
    return model


def _check_rectified(camera: Source) -> None:
    model = _model(camera)
    if model != _PERSPECTIVE:
        raise camera.wrong("model", model, f"{_PERSPECTIVE} of a rectified pair, or a StereoRectifier")
    for key in _DISTORTION:
        if key in camera and camera.number(key) != 0:
            raise camera.wrong(key, camera.values[key], "0 of a rectified pair, or a StereoRectifier")


def _unrectified(source: Source, part: Source, pixels: Found, baseline: Found) -> Calibration:
    """The cameras before they are rectified: x_rectified = R x in both, which differ by the baseline only."""
    model = _model(part)
    left, right = (_side(part, side, model) | pixels for side in ("left", "right"))
    T_right_left = beside(rotation(part, "R_left"), rotation(part, "R_right"), baseline["baseline"][0])
    origin = f"{part.label('R_left')}, {part.label('R_right')}, {baseline['baseline'][1]}"
    unused = "the cameras before rectification are read; Camera.fx and so on describe them after it"
    return raw(source, (left, right), (T_right_left, origin), KIND, (unused,))


def _side(part: Source, side: str, model: str) -> Found:
    found = from_camera_matrix(part, f"K_{side}")
    if model == _FISHEYE:
        named = part.label("model")
        return found | coefficients(part, f"D_{side}", "equidistant", named, 4, 5)
    return found | distortion(part, f"D_{side}", *OPENCV_COUNTS)
