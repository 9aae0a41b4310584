"""The cameras that images come from: a rectified pair, or two cameras with lenses of their own."""

from __future__ import annotations

from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

LENSES: dict[str, tuple[str, ...]] = {
    "brown": ("k1", "k2", "p1", "p2", "k3"),
    "rational": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "thin_prism": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"),
    "equidistant": ("k1", "k2", "k3", "k4"),
    "double_sphere": ("xi", "alpha"),
    "eucm": ("alpha", "beta"),
    "mei": ("xi", "k1", "k2", "p1", "p2"),
}
"""Names of the coefficients of each lens model, in the order in which `Camera` has them.

Brown's, the rational and the thin prism model are OpenCV's of 5, 8 and 12 coefficients; the equidistant one is
Kannala and Brandt's, OpenCV's ``fisheye``; Mei's is Kalibr's ``omni`` with ``radtan``. Of the last four, fx, fy, cx, cy
are the model's own.
"""


@dataclass(frozen=True)
class Rig:
    """A rectified stereo pair of cameras: both share ``fx, fy, cy, skew`` and see a point on the same row.

    Or a single camera, without a baseline: a mesh can be seen by it, but no disparity turned into depth.

    Attributes
    ----------
    fx, fy : float
        Focal lengths, px, positive.
    cx, cy : float
        Principal point of the left camera, px.
    baseline : float
        Distance between the cameras, m, positive; 0, the default, is a single camera.
    width, height : int
        Image size, px, positive: give them, by name where there is no baseline.
    skew : float
        Skew of eq. (2), px.
    doffs : float
        ``cx_right - cx_left``, px; depth is ``fx * baseline / (disparity + doffs)``.

    Raises
    ------
    InputError
        If a value is no number in its range: focal lengths 1e-3 to 1e7 px, baseline 0 or 1e-6 to 1e6 m, sizes whole
        and 1 to 1e6 px, the others within 1e7 px of 0.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> rig.baseline, Rig(fx=500, fy=500, cx=320, cy=240, width=640, height=480).baseline
    (0.1, 0.0)
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float = 0.0
    width: int = 0
    height: int = 0
    skew: float = 0.0
    doffs: float = 0.0

    def __post_init__(self) -> None:
        _check_numbers(self, "rig")


@dataclass(frozen=True)
class Camera:
    """A camera as it is before rectification: a lens of one of the models of `LENSES`, Brown's by default.

    Attributes
    ----------
    fx, fy : float
        Focal lengths, px, positive.
    cx, cy : float
        Principal point, px.
    width, height : int
        Image size, px.
    distortion : tuple of floats
        Coefficients of the lens, by default ``k1, k2, p1, p2, k3`` of Brown's model, all 0.
    skew : float
        px.
    lens : str
        Model of the lens, one of `LENSES`.

    Raises
    ------
    InputError
        If the lens is none of these, or a value is no number in its range (as `Rig`; coefficients within 1e4 of 0,
        alpha 0 to 1, beta above 0, xi above -1, and not below 0 for Mei's model).

    Examples
    --------
    >>> Camera(fx=500, fy=500, cx=320, cy=240, width=640, height=480).distortion
    (0.0, 0.0, 0.0, 0.0, 0.0)
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    skew: float = 0.0
    lens: str = "brown"

    def __post_init__(self) -> None:
        _check_numbers(self, "camera")
        if not isinstance(self.lens, str) or self.lens not in LENSES:
            raise InputError(f"camera: lens is {repr(self.lens)[:60]}, expected one of {', '.join(LENSES)}")
        names = LENSES[self.lens]
        if not isinstance(self.distortion, tuple):
            raise InputError(f"camera: distortion is {repr(self.distortion)[:60]}, expected a tuple of numbers")
        if len(self.distortion) != len(names):
            wanted = ", ".join(names)
            raise InputError(f"camera: distortion has {len(self.distortion)} numbers, expected {wanted}")
        for name, value in zip(names, self.distortion, strict=True):
            low, high = _RANGES_OF_LENSES.get(f"{self.lens}.{name}", _RANGES_OF_LENSES.get(name, (-1e4, 1e4)))
            _check_number("camera", name, value, low, high)


@dataclass(frozen=True)
class RawRig:
    """Two cameras as they were calibrated: distorted, not rectified.

    Attributes
    ----------
    left, right : Camera
        The cameras.
    T_right_left : 4 x 4 tuple of floats
        Maps a point of the left camera's frame to the right camera's, m; for a camera on the right, ``x`` of its
        translation is negative.
    field_of_view : float or None
        Across the rectified image, degrees, 1 to 170; None leaves it to `rectification`.

    Raises
    ------
    InputError
        If the rotation is none (to 1e-3), the cameras are at one place, or the field of view is out of its range.
    """

    left: Camera
    right: Camera
    T_right_left: tuple[tuple[float, float, float, float], ...]
    field_of_view: float | None = None

    def __post_init__(self) -> None:
        if self.field_of_view is not None:
            _check_number("raw rig", "field_of_view, degrees,", self.field_of_view, 1.0, 170.0)
        for camera in (self.left, self.right):
            if not isinstance(camera, Camera):
                raise InputError(f"raw rig: left or right is {repr(camera)[:60]}, expected a Camera")
        try:
            T = self.matrix
        except (ValueError, TypeError) as error:
            said = repr(self.T_right_left)[:60]
            raise InputError(
                f"raw rig: T_right_left is {said}, expected 4 x 4 numbers with last row 0 0 0 1"
            ) from error
        if T.shape != (4, 4) or not np.isfinite(T).all() or np.abs(T[3] - (0, 0, 0, 1)).max() > 1e-9:
            raise InputError(f"raw rig: T_right_left is {T.tolist()}, expected 4 x 4 numbers with last row 0 0 0 1")
        off = float(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max())
        if off > 1e-3 or np.linalg.det(T[:3, :3]) < 0:
            raise InputError(f"raw rig: T_right_left holds no rotation (R Rᵀ - I has {off:.2g}), expected one to 1e-3")
        _check_number("raw rig", "distance of the cameras, m,", float(np.linalg.norm(T[:3, 3])), *_RANGES["baseline"])

    @property
    def matrix(self) -> NDArray[np.float64]:
        """``T_right_left`` as a (4, 4) float64 array."""
        return np.array(self.T_right_left, np.float64)


_RANGES: dict[str, tuple[float, float]] = {
    "fx": (1e-3, 1e7),
    "fy": (1e-3, 1e7),
    "baseline": (1e-6, 1e6),
    "width": (1, 1_000_000),
    "height": (1, 1_000_000),
}

_RANGES_OF_LENSES = {"alpha": (0.0, 1.0), "beta": (1e-6, 1e4), "xi": (-1.0, 1e4), "mei.xi": (0.0, 1e4)}
"""Of coefficients, by name, or by lens and name."""


def _check_numbers(values: Rig | Camera, what: str) -> None:
    for field in fields(values):
        value = getattr(values, field.name)
        if field.name not in ("distortion", "lens") and not _is_absent(field.name, value):
            _check_number(what, field.name, value, *_RANGES.get(field.name, (-1e7, 1e7)))


def _is_absent(name: str, value: Any) -> bool:
    """Whether it is the baseline of a single camera."""
    return name == "baseline" and isinstance(value, Real) and not isinstance(value, bool) and value == 0


def _check_number(what: str, name: str, value: Any, low: float, high: float) -> None:
    kind: Any
    kind, said = (Integral, "a whole number") if isinstance(low, int) else (Real, "a number")
    if isinstance(value, bool) or not (isinstance(value, kind) and low <= value <= high):
        raise InputError(f"{what}: {name} is {repr(value)[:60]}, expected {said} from {low:.8g} to {high:.8g}")
