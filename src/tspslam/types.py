"""What flows between the stages: frozen data classes over NumPy arrays.

Conventions, in one place: camera frame x right, y down, z forward, in metres; pixels ``(u, v)`` with the
centre of the top-left pixel at ``(0, 0)``; ``disparity = u_left - u_right``; luminance in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32] | NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | NDArray[np.float64]

REC601 = np.array([0.299, 0.587, 0.114])
"""Luminance weights of R, G, B."""

UNIT_OF = {np.dtype(np.uint8): 1 / 255, np.dtype(np.uint16): 1 / 65535}
"""What makes pixels of an integer type luminance in [0, 1]."""


def phase_of(z: NDArray[np.complex128]) -> FloatArray:
    """``arg z`` in (-π, π], rad: -π is mapped to π."""
    angle = np.angle(z)
    return np.where(angle == -np.pi, np.pi, angle)


def one_channel(values: NDArray[Any]) -> NDArray[Any]:
    """Mean over the channels of an (n,) or (n, C) signal or response, (n,)."""
    return values if values.ndim == 1 else values.mean(axis=1)


@dataclass(frozen=True)
class Rig:
    """A rectified stereo pair of cameras: both share ``fx, fy, cy, skew`` and see a point on the same row.

    Attributes
    ----------
    fx, fy : float
        Focal lengths, px, positive.
    cx, cy : float
        Principal point of the left camera, px.
    baseline : float
        Distance between the cameras, m, positive.
    width, height : int
        Image size, px.
    skew : float
        Skew of eq. (2), px.
    doffs : float
        ``cx_right - cx_left``, px; depth is ``fx * baseline / (disparity + doffs)``.

    Raises
    ------
    InputError
        If a value is no number in its range: focal lengths 1e-3 to 1e7 px, baseline 1e-6 to 1e6 m, sizes whole and
        1 to 1e6 px, the others within 1e7 px of 0.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> rig.baseline
    0.1
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    width: int
    height: int
    skew: float = 0.0
    doffs: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), _RANGES.get(field.name, (-1e7, 1e7))
            kind: Any
            kind, said = (Integral, "a whole number") if isinstance(low, int) else (Real, "a number")
            if isinstance(value, bool) or not (isinstance(value, kind) and low <= value <= high):
                shown = repr(value)[:60]
                raise InputError(f"rig: {field.name} is {shown}, expected {said} from {low:.8g} to {high:.8g}")


_RANGES: dict[str, tuple[float, float]] = {
    "fx": (1e-3, 1e7),
    "fy": (1e-3, 1e7),
    "baseline": (1e-6, 1e6),
    "width": (1, 1_000_000),
    "height": (1, 1_000_000),
}


@dataclass(frozen=True)
class StereoPair:
    """A rectified pair of images of one moment.

    Attributes
    ----------
    left, right : (H, W) or (H, W, 3) array
        uint8, uint16, or float32 in [0, 1]; colour is RGB.
    rig : Rig
        The cameras that took it.
    stamp : float
        Time, s.
    index : int
        Place in its sequence.
    name : str
        What to call it in messages and file names.
    """

    left: Image
    right: Image
    rig: Rig
    stamp: float = 0.0
    index: int = 0
    name: str = "pair"


@dataclass(frozen=True)
class Features:
    """Keypoints of one image with their descriptors.

    Attributes
    ----------
    uv : (N, 2) float64
        Positions, px.
    descriptor : (N, D) uint8 or float32
        Binary (Hamming) or real (L2) descriptors.
    score : (N,) float32
        Detector response, larger is better.
    scale : (N,) float32
        Size of one detector pixel in image pixels (1 at full resolution).
    angle : (N,) float32
        Orientation, rad.
    """

    uv: FloatArray
    descriptor: NDArray[np.uint8] | NDArray[np.float32]
    score: NDArray[np.float32]
    scale: NDArray[np.float32]
    angle: NDArray[np.float32]


@dataclass(frozen=True)
class Cloud:
    """Points that the left camera sees, in its frame.

    Attributes
    ----------
    xyz : (N, 3) float64
        Positions, m.
    uv : (N, 2) float64
        Positions in the left image, px.
    disparity : (N,) float64
        ``u_left - u_right``, px.
    covariance : (N, 3, 3) float64 or None
        Covariance of ``xyz``, m².
    """

    xyz: FloatArray
    uv: FloatArray
    disparity: FloatArray
    covariance: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True)
class Surface:
    """Triangles over the rows of a cloud.

    Attributes
    ----------
    faces : (F, 3) int32
        Vertex triples, winding kept.
    """

    faces: NDArray[np.int32]


@dataclass(frozen=True)
class Signals:
    """Unsigned texture signals on every level of a complex, eqs (4)-(6).

    Attributes
    ----------
    vertex, edge, face : (n,) or (n, C) float64
        Values; 0 where there is no signal.
    edge_uv, face_uv : (E, 2), (F, 2) float64
        Barycentres of the pixels behind each value, px; 0 where there is no signal.
    edge_pixels, face_pixels : (E,), (F,) int32
        How many pixels each element has; 0 without a signal. An edge of 1 and a face of 0 pixels carry a bilinear
        sample instead of a mean.
    vertex_ok, edge_ok, face_ok : (n,) bool
        False where there is no signal.
    """

    vertex: FloatArray
    edge: FloatArray
    face: FloatArray
    edge_uv: FloatArray
    face_uv: FloatArray
    edge_pixels: NDArray[np.int32]
    face_pixels: NDArray[np.int32]
    vertex_ok: BoolArray
    edge_ok: BoolArray
    face_ok: BoolArray


@dataclass(frozen=True)
class Response:
    """A complex harmonic response at every vertex.

    Attributes
    ----------
    z : (N,) or (N, C) complex128
        The response; 0 where it is not defined.
    order : int
        Angular order m of the filter.
    defined : (N,) bool
        False where the vertex or its neighbourhood admits no response.
    """

    z: NDArray[np.complex128]
    order: int
    defined: BoolArray

    @property
    def magnitude(self) -> FloatArray:
        """``|z|``, same shape as ``z``, in units of the signal (of signal per px for ``centering="plane"``)."""
        return np.abs(self.z)

    @property
    def phase(self) -> FloatArray:
        """``arg z`` in (-π, π], same shape as ``z``, rad; grows clockwise on the screen."""
        return phase_of(self.z)
