"""OpenCV's FileStorage files, YAML or XML, as its stereo calibration samples and their many descendants write them."""

from __future__ import annotations

import os
import re
from pathlib import Path

from .._calibration import Calibration, raw, rectified
from .._lens import fisheye_key
from .._opencv_yaml import read_mapping
from .._source import Source
from .._values import (
    OPENCV_COUNTS,
    Found,
    Size,
    agreed_size,
    coefficients,
    distortion,
    from_camera_matrix,
    from_projections,
    motion,
    rotation,
    size_from_keys,
    size_from_list,
)

KIND = "OpenCV FileStorage"
_LENSES = (
    ("M1", "D1", "M2", "D2"),
    ("K1", "D1", "K2", "D2"),
    ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2"),
)
_SIDES = (("image_width", "image_height"), ("imageWidth", "imageHeight"), ("imageSize_width", "imageSize_height"))
_SIZES = ("imageSize", "image_size", "size")
_LONG = 5.0  # m; few rigs are as wide, but 60 is what one calibrated in mm says


def is_opencv(source: Source) -> bool:
    """Tell whether a mapping has keys of a stereo calibration.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    keys = {key for names in _LENSES for key in names if not key.startswith(("D", "dist"))}
    has_pose = all(isinstance(source.values.get(key), dict | list) for key in "RT")
    return has_pose or bool((keys | {"P1", "P2"}) & source.values.keys())


def read_opencv(source: Source, size: Size | None = None) -> Calibration:
    """Read the raw cameras, or the rectified pair where the file has only ``P1`` and ``P2``.

    Lenses are ``M1 D1 M2 D2``, ``K1 D1 K2 D2`` or ``cameraMatrix1 distCoeffs1 ...``; ``x2 = R x1 + T``. They may be in
    one file, or in two whose names differ in ``intrinsics`` and ``extrinsics``. Coefficients are Brown's, rational or
    those with a thin prism, 4 to 14 of them; 4 of a fisheye (``cv2.fisheye``) where a key such as ``distortion_model:
    equidistant`` or ``fisheye: 1`` names it.

    Parameters
    ----------
    source : Source
        The file, or either of the two.
    size : (width, height), optional
        Of the images, px; needed where the file has no image_width and image_height, imageSize or the like.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing or out of range, another lens is named, the sensor is tilted, or no image size is known.

    Examples
    --------
    >>> left, right = ([[500, 0, 320, x], [0, 500, 240, 0], [0, 0, 1, 0]] for x in (0, -50))
    >>> read_opencv(Source("rig.yml", {"P1": left, "P2": right, "imageSize": [640, 480]})).cameras.baseline
    0.1
    """
    lenses, turn = _pair(source)
    own = _image_size(lenses) or _image_size(turn)
    if _names(lenses) is None and ("P1" in source or "P2" in source) and not ("R" in source or "T" in source):
        found = from_projections(source, "P1", "P2")
        found |= agreed_size(source, own, size)
        remarks = ("P1 and P2 are of rectified images", *_unit(found["baseline"][0], "P2"))
        return rectified(found, KIND, remarks)
    K1, D1, K2, D2 = _names(lenses) or _LENSES[0]
    named = next(filter(None, [fisheye_key(each) for each in (lenses, turn)]), None)
    one, two = (from_camera_matrix(lenses, K) | _lens(lenses, D, named) for K, D in ((K1, D1), (K2, D2)))
    pixels = agreed_size(source, own, size)
    T_right_left = motion(rotation(turn, "R"), turn.vector("T", 3))
    remarks = (*_unit(float(sum(T_right_left[:3, 3] ** 2) ** 0.5), "T"), *_four(lenses, D1, one, named))
    return raw(source, (one | pixels, two | pixels), (T_right_left, "R, T"), KIND, remarks)


def _lens(source: Source, key: str, named: str | None) -> Found:
    """Coefficients of a fisheye, if some key named it, else of a pinhole's lens."""
    return coefficients(source, key, "equidistant", named) if named else distortion(source, key, *OPENCV_COUNTS)


def _names(source: Source) -> tuple[str, str, str, str] | None:
    return next((names for names in _LENSES if names[0] in source or names[2] in source), None)


def _pair(source: Source) -> tuple[Source, Source]:
    """The source of the lenses and that of R and T: the file itself, or for what it lacks the one beside it."""
    has_lenses, has_pose = _names(source) is not None, "R" in source or "T" in source
    if has_lenses == has_pose:
        return source, source
    path = _beside(source)
    if path is None or not os.path.exists(path):
        lacking = "R, T" if has_lenses else "M1, D1, M2, D2"
        where = f"or in {path.name}" if path else "or in extrinsics.yml beside intrinsics.yml"
        raise source.error(f"lacks {lacking}, expected them in it {where}")
    other = Source(path, read_mapping(path, "the other half of a calibration of OpenCV"))
    return (source, other) if has_lenses else (other, source)


def _beside(source: Source) -> Path | None:
    """Where the other half is, if the name of this one tells."""
    path = Path(source.path)
    swap = {"in": "ex", "ex": "in", "In": "Ex", "Ex": "In"}
    name = re.sub("(in|ex|In|Ex)(?=trinsic)", lambda found: swap[found[0]], path.name)
    return None if name == path.name else path.with_name(name)


def _image_size(source: Source) -> Found | None:
    for width, height in _SIDES:
        if width in source or height in source:
            return size_from_keys(source, width, height)
    return next((size_from_list(source, key) for key in _SIZES if key in source), None)


def _unit(baseline: float, key: str) -> tuple[str, ...]:
    hint = f"; {baseline:g} m looks like mm" if baseline > _LONG else ""
    return (f"{key} names no unit and is taken as metres{hint}",)


def _four(source: Source, key: str, lens: Found, named: str | None) -> tuple[str, ...]:
    """What to know of four coefficients: a lens model that is not named can be either."""
    if named or "k3" in lens or not any(lens[name][0] for name in ("k1", "k2", "p1", "p2")):
        return ()
    said = f"{source.label(key)} has 4 coefficients and no lens model is named: they are read as k1, k2, p1, p2"
    return (f"{said}; those of a fisheye lens (cv2.fisheye) would be read wrongly",)
