"""Stereo settings of ORB-SLAM2 and ORB-SLAM3."""

from __future__ import annotations

from .....types import LENSES, FloatArray
from .._calibration import Calibration, Remarks, raw, rectified
from .._source import Source
from .._values import (
    OPENCV_COUNTS,
    Found,
    Size,
    agreed_size,
    beside,
    check_rotation,
    checked,
    distortion,
    from_camera_matrix,
    from_keys,
    from_projections,
    inverse,
    motion,
    pose,
    rotation,
    size_from_keys,
    with_lens,
)

KIND = "ORB-SLAM settings"
_PINHOLE, _RECTIFIED, _FISHEYE = "PinHole", "Rectified", "KannalaBrandt8"
_NEEDED = ("k1", "k2", "p1", "p2")
_FURTHER = ("k4", "k5", "k6")


def is_orbslam(source: Source) -> bool:
    """Tell whether a mapping is a settings file.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    return any(isinstance(key, str) and key.startswith(("Camera.", "Camera1.", "LEFT.")) for key in source.values)


def read_orbslam(source: Source, size: Size | None = None) -> Calibration:
    """Read a stereo pair of settings.

    ``LEFT.K, LEFT.D, LEFT.R, LEFT.P`` and ``RIGHT.*`` (ORB-SLAM2), or ``Camera1.*``, ``Camera2.*`` and
    ``Stereo.T_c1_c2``, which maps points of camera 2 to camera 1 (ORB-SLAM3; ``Tlr`` in its earlier files), are a raw
    pair, of pinholes or of fisheyes (``KannalaBrandt8``, k1 to k4). ``Camera.*`` with ``Camera.bf``, focal length times
    baseline, or ``Camera1.*`` with ``Stereo.b`` are a rectified one.

    Parameters
    ----------
    source : Source
        The settings.
    size : (width, height), optional
        Of the images, px; needed where the settings have no Camera.width and Camera.height.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing or out of range, the lens is none of PinHole, Rectified and KannalaBrandt8, a rectified
        camera is distorted, or no image size is known.

    Examples
    --------
    >>> lens = {"Camera.fx": 700, "Camera.fy": 700, "Camera.cx": 600, "Camera.cy": 180}
    >>> settings = Source("KITTI.yaml", lens | {"Camera.bf": 350, "Camera.width": 1241, "Camera.height": 376})
    >>> read_orbslam(settings).cameras.baseline
    0.5
    """
    kind = _model(source)
    if "LEFT.K" in source or "RIGHT.K" in source:
        return _unrectified(source, size)
    name = "Camera1." if any(str(key).startswith("Camera1.") for key in source.values) else "Camera."
    has_pose = "Stereo.T_c1_c2" in source or "Tlr" in source
    if kind == _FISHEYE or (kind == _PINHOLE and (has_pose or name == "Camera1.")):
        return _chained(source, name, size, kind)
    return _rectified(source, name, size)


def _model(source: Source) -> str:
    kind = source.text("Camera.type", _PINHOLE) if "Camera.type" in source else _PINHOLE
    if kind not in (_PINHOLE, _RECTIFIED, _FISHEYE):
        raise source.wrong("Camera.type", kind, f"{_PINHOLE}, {_RECTIFIED} or {_FISHEYE}")
    return kind


def _rectified(source: Source, name: str, size: Size | None) -> Calibration:
    found = from_keys(source, name)
    for key, (value, label) in _brown(source, name).items():
        if value != 0:
            raise source.error(f"{label} is {value:g}, expected {key} 0 of a rectified pair")
    found |= _baseline(source, *found["fx"])
    found |= agreed_size(source, _size(source), size)
    return rectified(found, KIND, _remarks(source))


def _baseline(source: Source, fx: float, fx_key: str) -> Found:
    if "Stereo.b" in source:
        return checked(source, {"baseline": (source.number("Stereo.b"), "Stereo.b")})
    key = "Stereo.b" if fx_key.startswith("Camera1") and "Camera.bf" not in source else "Camera.bf"
    return checked(source, {"baseline": (source.number(key) / fx, f"{key} / {fx_key}")})


def _chained(source: Source, name: str, size: Size | None, kind: str) -> Calibration:
    read = _fisheye if kind == _FISHEYE else _brown
    sides = [from_keys(source, each) | read(source, each) for each in (name, "Camera2.")]
    pixels = agreed_size(source, _size(source), size)
    return raw(source, (sides[0] | pixels, sides[1] | pixels), _pose(source), KIND, _remarks(source))


def _pose(source: Source) -> tuple[FloatArray, str]:
    """T_right_left and where it comes from."""
    if "Tlr" in source and "Stereo.T_c1_c2" not in source:
        T = source.matrix("Tlr", 3, 4)
        check_rotation(source, "Tlr", T[:, :3])
        return inverse(motion(T[:, :3], T[:, 3].tolist())), "inverse of Tlr"
    return inverse(pose(source, "Stereo.T_c1_c2")), "inverse of Stereo.T_c1_c2"


def _fisheye(source: Source, name: str) -> Found:
    """Coefficients of a lens of Kannala and Brandt."""
    return with_lens(from_keys(source, name, LENSES["equidistant"]), "equidistant", "Camera.type")


def _brown(source: Source, name: str) -> Found:
    """Coefficients of a camera; either none or k1, k2, p1, p2 and perhaps k3."""
    for further in _FURTHER:
        if f"{name}{further}" in source and source.number(f"{name}{further}") != 0:
            raise source.wrong(f"{name}{further}", source.values[f"{name}{further}"], "0: only k1, k2, p1, p2, k3")
    if not any(f"{name}{each}" in source for each in (*_NEEDED, "k3")):
        return {}
    return from_keys(source, name, (*_NEEDED, "k3") if f"{name}k3" in source else _NEEDED)


def _unrectified(source: Source, size: Size | None) -> Calibration:
    """The cameras before ORB-SLAM2 rectifies them: x_rectified = R x in both, which differ by the baseline only."""
    sides = []
    for name in ("LEFT", "RIGHT"):
        own = size_from_keys(source, f"{name}.width", f"{name}.height") if _has_size(source, name) else _size(source)
        lens = from_camera_matrix(source, f"{name}.K") | distortion(source, f"{name}.D", *OPENCV_COUNTS)
        sides.append(lens | agreed_size(source, own, size))
    baseline = from_projections(source, "LEFT.P", "RIGHT.P")["baseline"][0]
    T_right_left = beside(rotation(source, "LEFT.R"), rotation(source, "RIGHT.R"), baseline)
    unused = "the cameras before rectification are read; Camera.fx, Camera.bf and so on describe them after it"
    origin = "LEFT.R, RIGHT.R, RIGHT.P"
    return raw(source, (sides[0], sides[1]), (T_right_left, origin), KIND, (unused, *_remarks(source)))


def _has_size(source: Source, name: str) -> bool:
    return f"{name}.width" in source or f"{name}.height" in source


def _size(source: Source) -> Found | None:
    return size_from_keys(source, "Camera.width", "Camera.height") if _has_size(source, "Camera") else None


def _remarks(source: Source) -> Remarks:
    resized = "Camera.newWidth" in source or "Camera.newHeight" in source
    return ("Camera.newWidth and Camera.newHeight, a resizing, are not applied",) if resized else ()
