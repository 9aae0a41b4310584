"""Two of ROS's CameraInfo, of a bag or of files, as a pair of cameras."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ....types import Camera
from ._calibration import Calibration, Remarks, camera_of, raw, rectified
from ._source import Source
from ._values import (
    OPENCV_COUNTS,
    Found,
    beside,
    coefficients,
    distortion,
    from_camera_matrix,
    from_projections,
    rotation,
    size_from_keys,
)

BROWN = ("plumb_bob", "rational_polynomial", "")  # the second one is Brown's where k4, k5 and k6 are 0
FISHEYE = ("equidistant", "fisheye")  # the second one is what other programs write into files of this kind
_FISHEYE_COUNTS = (4, 5, 8)  # drivers fill up with zeros
_TURNED = 1e-6  # of R against no rotation
_SAME = 1e-3  # px, of K against P


class Keys(NamedTuple):
    """Keys of one camera's values in a source."""

    width: str
    height: str
    model: str
    D: str
    K: str
    R: str
    P: str


def from_camera_infos(
    source: Source, left: Keys, right: Keys, *, kind: str, is_rectified: bool = False, remarks: Remarks = ()
) -> Calibration:
    """Return the cameras: P of rectified images, else K, D, R and P.

    Raw images whose cameras have no distortion, no rotation and K as in P are rectified ones.
    """
    found = from_projections(source, left.P, right.P)
    if not is_rectified:
        for keys in (left, right):
            check_model(source, keys)
    if is_rectified or not any(_is_raw(source, keys) for keys in (left, right)):
        size = size_from_keys(source, left.width, left.height)
        return rectified(found | size, kind, remarks)
    R_left, R_right = (rotation(source, keys.R) for keys in (left, right))
    pose = beside(R_left, R_right, found["baseline"][0]), f"{left.R}, {right.R}, {right.P}"
    return raw(source, (lens(source, left), lens(source, right)), pose, kind, remarks)


def from_camera_info(source: Source, keys: Keys) -> Camera:
    """Return the camera that took images as they are, by K and D."""
    check_model(source, keys)
    return camera_of(lens(source, keys))


def check_model(source: Source, keys: Keys) -> None:
    """Refuse lenses of other models than Brown's, the rational one and the fisheye."""
    model = source.text(keys.model, "a name") if keys.model in source else ""
    if model not in (*BROWN, *FISHEYE):
        known = ", ".join((*BROWN[:-1], FISHEYE[0]))
        raise source.wrong(keys.model, model, f"one of {known}, or rectified images")


def lens(source: Source, keys: Keys) -> Found:
    """Return the values of a raw camera, its size among them."""
    found = from_camera_matrix(source, keys.K) | size_from_keys(source, keys.width, keys.height)
    if source.values.get(keys.model) in FISHEYE:
        return found | coefficients(source, keys.D, "equidistant", source.label(keys.model), *_FISHEYE_COUNTS)
    has_none = keys.D not in source or source.values[keys.D] == []
    return found if has_none else found | distortion(source, keys.D, *OPENCV_COUNTS)


def _is_raw(source: Source, keys: Keys) -> bool:
    K, P = source.matrix(keys.K, 3, 3), source.matrix(keys.P, 3, 4)
    turn = np.abs(source.matrix(keys.R, 3, 3) - np.eye(3)).max()
    is_bent = source.values.get(keys.model) in FISHEYE or _has_distortion(source, keys.D)
    return bool(is_bent or turn > _TURNED or np.abs(K - P[:, :3]).max() > _SAME)


def _has_distortion(source: Source, key: str) -> bool:
    given = source.values.get(key, [])
    if isinstance(given, dict):
        given = given.get("data")
    return not isinstance(given, list) or any(value != 0 for value in given)
