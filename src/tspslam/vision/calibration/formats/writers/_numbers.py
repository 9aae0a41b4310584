"""Numbers as every reader of YAML takes them, and cameras as writers need them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .....errors import InputError
from .....types import Camera, FloatArray, RawRig, Rig


def said(value: float) -> str:
    """Return a number with all its digits; with a dot, which YAML 1.1 needs before an exponent.

    Examples
    --------
    >>> said(1e-05), said(640.0), said(0.1)
    ('1.0e-05', '640.0', '0.1')
    """
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def listed(values: Iterable[float]) -> str:
    """Return numbers in brackets."""
    return f"[{', '.join(map(said, values))}]"


def matrix(camera: Camera) -> FloatArray:
    """Return the 3 x 3 camera matrix."""
    return np.array([[camera.fx, camera.skew, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)


def as_raw(rig: Rig) -> RawRig:
    """Return a rectified pair as two cameras without distortion, side by side."""
    left = Camera(rig.fx, rig.fy, rig.cx, rig.cy, rig.width, rig.height, skew=rig.skew)
    right = Camera(rig.fx, rig.fy, rig.cx + rig.doffs, rig.cy, rig.width, rig.height, skew=rig.skew)
    beside = ((1.0, 0.0, 0.0, -rig.baseline), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    return RawRig(left, right, beside)


def projections(rig: Rig) -> tuple[FloatArray, FloatArray]:
    """Return the 3 x 4 projection matrices of a rectified pair."""
    left = np.array([[rig.fx, rig.skew, rig.cx, 0], [0, rig.fy, rig.cy, 0], [0, 0, 1, 0]], np.float64)
    right = left.copy()
    right[0, 2:] = rig.cx + rig.doffs, -rig.fx * rig.baseline
    return left, right


def check_no_skew(cameras: RawRig, to: str) -> None:
    """Refuse a skew, for a format that has no place for it."""
    for side, camera in (("left", cameras.left), ("right", cameras.right)):
        if camera.skew != 0:
            raise InputError(f"the {side} camera's skew of {camera.skew:g} px cannot be written for {to}, expected 0")
