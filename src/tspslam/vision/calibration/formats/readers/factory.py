"""Calibrations that cameras come with: ZED's ``SN12345.conf`` (sections of each resolution, px and mm), T265's JSON."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ....._files import PathLike
from .....types import FloatArray
from .._calibration import Calibration, Remarks, raw
from .._lines import key_and_value
from .._source import Source, plain_value
from .._values import (
    DISTORTION,
    Found,
    Size,
    agreed_size,
    checked,
    coefficients,
    from_keys,
    from_list,
    inverse,
    motion,
    size_from_list,
    turned,
    with_lens,
)

KIND, KIND_OF_T265 = "ZED calibration", "RealSense T265 calibration"
_SECTION = re.compile(r"^[ \t]*\[(LEFT|RIGHT)_CAM_\w+\]", re.MULTILINE)
_SIZES = {
    (2208, 1242): "2K",
    (1920, 1200): "FHD1200",
    (1920, 1080): "FHD",
    (1280, 720): "HD",
    (960, 600): "SVGA",
    (672, 376): "VGA",
}
"""Sizes of one image, px, and what the sections of each are named."""
_FURTHER = ("k4", "k5", "k6")
_SHIFTS = ("TY", "TZ")
_MILLIMETRE = 1e-3  # m
_FISHEYE, _PINHOLE = "kannalabrandt4", "undistorted"
_TYPES = f"{_FISHEYE} or {_PINHOLE} (the FOV model, 'fisheye', and 'polynomial' are not read)"


def is_zed(text: str) -> bool:
    """Tell whether a text has a section of a ZED's camera.

    Parameters
    ----------
    text : str
        Of a file.

    Returns
    -------
    bool
    """
    return _SECTION.search(text) is not None


def parse_zed(text: str, path: PathLike) -> Source:
    """Return the lines ``key=number`` of a file, each named by its section, such as ``LEFT_CAM_HD.fx``.

    Parameters
    ----------
    text : str
        Of the file.
    path : str or path
        Its name, for errors.

    Returns
    -------
    Source
    """
    values: dict[Any, Any] = {}
    section = ""
    for number, line in enumerate(text.split("\n"), 1):
        said = line.partition(";")[0].partition("#")[0].strip()
        if said.startswith("[") and said.endswith("]"):
            section = f"{said[1:-1].strip()}."
        elif said:
            name, rest = key_and_value(path, (number, said), values, section)
            values[name] = plain_value(rest)
    return Source(path, values)


def read_zed(source: Source, size: Size | None = None) -> Calibration:
    r"""Read the pair of one resolution, which the size of the images chooses.

    The right camera is turned by the rotation vector ``(RX, CV, RZ)`` and displaced by ``(Baseline, TY, TZ)`` mm.

    Parameters
    ----------
    source : Source
        The lines of the file.
    size : (width, height), optional
        Of one image, px; needed where the file is of more than one resolution.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the resolution is not known, or a value is missing or out of range.

    Examples
    --------
    >>> lens = "fx=700\nfy=700\ncx=640\ncy=360\nk1=-0.17\nk2=0.03\n"
    >>> text = f"[LEFT_CAM_HD]\n{lens}[RIGHT_CAM_HD]\n{lens}[STEREO]\nBaseline=120\nRX_HD=0\nCV_HD=0\nRZ_HD=0\n"
    >>> read_zed(parse_zed(text, "SN1.conf"), (1280, 720)).cameras.T_right_left[0]
    (1.0, 0.0, 0.0, -0.12)
    """
    pixels, name = _resolution(source, size)
    found: Found = agreed_size(source, None, pixels) if size else _told(pixels, name)
    left, right = (_side(source, f"{side}_CAM_{name}.") | found for side in ("LEFT", "RIGHT"))
    return raw(source, (left, right), _pose(source, name), f"{KIND} ({name})")


def _told(pixels: Size, name: str) -> Found:
    return {side: (value, f"the size of {name}") for side, value in zip(("width", "height"), pixels, strict=True)}


def _resolution(source: Source, size: Size | None) -> tuple[Size, str]:
    """Size of the images and the name of its sections."""
    known = {pixels: name for pixels, name in _SIZES.items() if f"LEFT_CAM_{name}.fx" in source}
    listed = (
        ", ".join(f"{name} ({width} x {height})" for (width, height), name in known.items()) or "no size that is known"
    )
    if size is None:
        if len(known) != 1:
            raise source.error(f"is for images of {listed}, expected the size of one of them (--size, or size=)")
        size = next(iter(known))
    if size not in known:
        raise source.error(f"is for images of {listed}, but {size[0]} x {size[1]} px are given, expected one of these")
    return size, known[size]


def _side(source: Source, prefix: str) -> Found:
    given = [name for name in (*DISTORTION, *_FURTHER) if f"{prefix}{name}" in source]
    found = from_keys(source, prefix) | from_keys(source, prefix, given)
    is_rational = any(found[name][0] != 0 for name in _FURTHER if name in found)
    if not is_rational:
        return {name: each for name, each in found.items() if name not in _FURTHER}
    return with_lens(found, "rational", f"{prefix}k4, k5, k6")


def _pose(source: Source, name: str) -> tuple[FloatArray, str]:
    import cv2

    keys = [f"STEREO.{each}_{name}" for each in ("RX", "CV", "RZ")]
    vector = np.array([source.number(key) for key in keys])
    if np.linalg.norm(vector) > np.pi:
        raise source.error(f"{', '.join(keys)} turn by {np.linalg.norm(vector):.3g}, expected radians up to pi")
    R = np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    baseline = checked(source, {"baseline": (source.number("STEREO.Baseline") * _MILLIMETRE, "STEREO.Baseline / 1000")})
    further = [-_MILLIMETRE * source.number(f"STEREO.{key}") if f"STEREO.{key}" in source else 0.0 for key in _SHIFTS]
    return motion(R, [-baseline["baseline"][0], *further]), f"STEREO.Baseline, TY, TZ / 1000, {', '.join(keys)}"


def is_t265(source: Source) -> bool:
    """Tell whether a mapping is a calibration of a T265.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    listed = source.values.get("cameras")
    return isinstance(listed, list) and any(isinstance(each, dict) and "focal_length_px" in each for each in listed)


def read_t265(source: Source, size: Size | None = None) -> Calibration:
    """Read the first camera as the left and the second as the right one; ``T_right_left = T_body_cam1⁻¹ T_body_cam0``.

    A pose is a rotation vector W, radians, and a translation T, m: ``x_body = exp(W) x_camera + T``.

    Parameters
    ----------
    source : Source
        The file.
    size : (width, height), optional
        Of the images, px; it must be the file's, where that has one.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing or out of range, or a lens is neither kannalabrandt4 nor undistorted.

    Examples
    --------
    >>> lens = {"type": "kannalabrandt4", "k": [-0.004, 0.037, -0.035, 0.006]}
    >>> camera = {"size_px": [848, 800], "center_px": [419, 387], "focal_length_px": [286, 287], "distortion": lens}
    >>> poses = [{"T": [x, 0, 0], "W": [0, 0, 0]} for x in (0.0, 0.064)]
    >>> cameras = read_t265(Source("t265.json", {"cameras": [camera | {"extrinsics": T} for T in poses]})).cameras
    >>> cameras.left.lens, cameras.T_right_left[0]
    ('equidistant', (1.0, 0.0, 0.0, -0.064))
    """
    left, right = (_t265_camera(source, at) for at in (0, 1))
    sides = _t265_side(left, size), _t265_side(right, size)
    T_body_left, T_body_right = _t265_pose(left), _t265_pose(right)
    origin = f"inverse of {right.label('extrinsics')}, {left.label('extrinsics')}"
    return raw(source, sides, (inverse(T_body_right) @ T_body_left, origin), KIND_OF_T265, _t265_remarks(source))


def _t265_camera(source: Source, at: int) -> Source:
    listed = source.values["cameras"]
    if len(listed) <= at:
        raise source.wrong("cameras", f"a list of {len(listed)}", "a list of two cameras")
    return Source(source.path, {f"cameras[{at}]": listed[at]}).part(f"cameras[{at}]")


def _t265_side(camera: Source, size: Size | None) -> Found:
    found = from_list(camera, "focal_length_px", ("fx", "fy")) | from_list(camera, "center_px", ("cx", "cy"))
    found |= agreed_size(camera, size_from_list(camera, "size_px") if "size_px" in camera else None, size)
    lens = camera.part("distortion")
    kind = lens.text("type", _TYPES)
    if kind not in (_FISHEYE, _PINHOLE):
        raise lens.wrong("type", kind, _TYPES)
    return found | coefficients(lens, "k", "equidistant", lens.label("type")) if kind == _FISHEYE else found


def _t265_pose(camera: Source) -> FloatArray:
    """T_body_camera."""
    part = camera.part("extrinsics")
    if "W" not in part and "R" in part:
        raise part.error(f"{part.label('R')} may be by rows or by columns, expected a rotation vector W, radians")
    W = np.array(part.vector("W", 3))
    angle = float(np.linalg.norm(W))
    if angle > 2 * np.pi:
        raise part.wrong("W", W.tolist(), "a rotation vector of at most a turn, radians")
    axis = W / angle if angle > 0 else W
    half = [float(np.cos(angle / 2)), *(np.sin(angle / 2) * axis).tolist()]
    return motion(turned(part, "W", half), part.vector("T", 3))


def _t265_remarks(source: Source) -> Remarks:
    return ("the cameras after the second are not read",) if len(source.values["cameras"]) > 2 else ()
