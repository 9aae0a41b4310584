"""What flows between the stages: frozen data classes over NumPy arrays.

Conventions, in one place: camera frame x right, y down, z forward, in metres; pixels ``(u, v)`` with the
centre of the top-left pixel at ``(0, 0)``; ``disparity = u_left - u_right``; luminance in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._brief import Brief
from ._channels import one_channel as one_channel
from ._channels import phase_of as phase_of
from ._checks import real_array as real_array
from ._checks import refuse_path, require
from .errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32] | NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | NDArray[np.float64]

REC601 = np.array([0.299, 0.587, 0.114])
"""Luminance weights of R, G, B."""

UNIT_OF = {np.dtype(np.uint8): 1 / 255, np.dtype(np.uint16): 1 / 65535}
"""What makes pixels of an integer type luminance in [0, 1]."""


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
    """A pinhole camera with Brown's distortion, as it is before rectification.

    Attributes
    ----------
    fx, fy : float
        Focal lengths, px, positive.
    cx, cy : float
        Principal point, px.
    width, height : int
        Image size, px.
    distortion : tuple of 5 floats
        ``k1, k2, p1, p2, k3`` of OpenCV's model.
    skew : float
        px.

    Raises
    ------
    InputError
        If a value is no number in its range (as `Rig`; coefficients within 1e4 of 0).

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
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    skew: float = 0.0

    def __post_init__(self) -> None:
        _check_numbers(self, "camera")
        if len(self.distortion) != 5:
            raise InputError(f"camera: distortion has {len(self.distortion)} numbers, expected k1, k2, p1, p2, k3")
        for name, value in zip(("k1", "k2", "p1", "p2", "k3"), self.distortion, strict=True):
            _check_number("camera", name, value, -1e4, 1e4)


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

    Raises
    ------
    InputError
        If the rotation is none (to 1e-3), or the cameras are at one place.
    """

    left: Camera
    right: Camera
    T_right_left: tuple[tuple[float, float, float, float], ...]

    def __post_init__(self) -> None:
        T = self.matrix
        if T.shape != (4, 4) or not np.isfinite(T).all() or np.abs(T[3] - (0, 0, 0, 1)).max() > 1e-9:
            raise InputError(f"raw rig: T_right_left is {T.tolist()}, expected 4 x 4 numbers with last row 0 0 0 1")
        off = float(np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max())
        if off > 1e-3 or np.linalg.det(T[:3, :3]) < 0:
            raise InputError(f"raw rig: T_right_left holds no rotation (R Rᵀ - I has {off:.2g}), expected one to 1e-3")
        _check_number("raw rig", "distance of the cameras, m,", float(np.linalg.norm(T[:3, 3])), *_RANGES["baseline"])

    @property
    def matrix(self) -> FloatArray:
        """``T_right_left`` as a (4, 4) float64 array."""
        return np.array(self.T_right_left, np.float64)


_RANGES: dict[str, tuple[float, float]] = {
    "fx": (1e-3, 1e7),
    "fy": (1e-3, 1e7),
    "baseline": (1e-6, 1e6),
    "width": (1, 1_000_000),
    "height": (1, 1_000_000),
}


def _check_numbers(values: Rig | Camera, what: str) -> None:
    for field in fields(values):
        value = getattr(values, field.name)
        if field.name != "distortion" and not _is_absent(field.name, value):
            _check_number(what, field.name, value, *_RANGES.get(field.name, (-1e7, 1e7)))


def _is_absent(name: str, value: Any) -> bool:
    """Whether it is the baseline of a single camera."""
    return name == "baseline" and isinstance(value, Real) and not isinstance(value, bool) and value == 0


def _check_number(what: str, name: str, value: Any, low: float, high: float) -> None:
    kind: Any
    kind, said = (Integral, "a whole number") if isinstance(low, int) else (Real, "a number")
    if isinstance(value, bool) or not (isinstance(value, kind) and low <= value <= high):
        raise InputError(f"{what}: {name} is {repr(value)[:60]}, expected {said} from {low:.8g} to {high:.8g}")


@dataclass(frozen=True, repr=False)
class StereoPair(Brief):
    """A rectified pair of images of one moment.

    Attributes
    ----------
    left, right : (H, W) or (H, W, 3) array
        uint8, uint16 (65535 is white: readers of files move pixels of fewer bits up), or float32 in [0, 1]; colour is
        RGB.
    rig : Rig
        The cameras that took it.
    stamp : float
        Time, s.
    index : int
        Place in its sequence.
    name : str
        What to call it in messages and file names.
    disparity : (H, W) float array or None
        Disparities of the left image that something else has measured (an RGB-D camera, a network), px; NaN where not
        known. Where there is one, `right` is not looked at.
    bits : int or None
        Of 16-bit pixels that were read from a file: how many of their bits it uses; they now fill the range.
    unknown : tuple of float
        Values in the file of disparities or depths that were taken for "not known", besides 0 in whole numbers.

    Raises
    ------
    InputError
        If an image is the path of one, or the rig is none. The images themselves are looked at when they are worked on.
    """

    left: Image
    right: Image
    rig: Rig
    stamp: float = 0.0
    index: int = 0
    name: str = "pair"
    disparity: FloatArray | None = None
    bits: int | None = None
    unknown: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for side in ("left", "right"):
            refuse_path(getattr(self, side), f"pair: {side}", "an array", "tspslam.read_pair(left, right, calib)")
        require(self.rig, Rig, "pair: rig")


@dataclass(frozen=True, repr=False)
class Trajectory(Brief):
    """A camera's path.

    Attributes
    ----------
    stamp : (T,) float64
        Times, s, ascending.
    T_world_camera : (T, 4, 4) float64
        Poses: each maps points of the camera's frame to the world, m.
    """

    stamp: FloatArray
    T_world_camera: FloatArray

    def __len__(self) -> int:
        return len(self.stamp)


@dataclass(frozen=True, repr=False)
class Features(Brief):
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


@dataclass(frozen=True, repr=False)
class Cloud(Brief):
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


@dataclass(frozen=True, repr=False)
class Surface(Brief):
    """Triangles over the rows of a cloud.

    Attributes
    ----------
    faces : (F, 3) int32
        Vertex triples, winding kept.
    """

    faces: NDArray[np.int32]


@dataclass(frozen=True, repr=False)
class Signals(Brief):
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


@dataclass(frozen=True, repr=False)
class Response(Brief):
    """A complex harmonic response at every vertex; ``len(response)`` is their number.

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

    def __len__(self) -> int:
        return len(self.z)

    @property
    def magnitude(self) -> FloatArray:
        """``|z|``, same shape as ``z``, in units of the signal (of signal per px for ``centering="plane"``)."""
        return np.abs(self.z)

    @property
    def phase(self) -> FloatArray:
        """``arg z`` in (-π, π], same shape as ``z``, rad; grows clockwise on the screen."""
        return phase_of(self.z)

    def steer(self, angle: ArrayLike) -> FloatArray:
        """Response of the filter turned to a direction: ``Re(z e^{-jmθ})``, same shape as ``z``.

        The harmonic ``cos m(ψ - θ)`` in the place of ``e^{jmψ}`` gives this, so that one complex response holds those
        of all directions; it is largest, ``|z|``, at θ = phase / m.

        Parameters
        ----------
        angle : float or (N,) float array
            θ, rad, clockwise on the screen from the direction of u; one for all vertices or one each.

        Returns
        -------
        (N,) or (N, C) float64

        Examples
        --------
        >>> response = Response(np.array([2j]), 1, np.array([True]))
        >>> response.steer(np.pi / 2).round(9).tolist()
        [2.0]
        """
        theta = real_array(angle, "angle", "one angle or (N,)").astype(np.float64)
        if theta.shape not in ((), self.z.shape[: theta.ndim]) or not np.isfinite(theta).all():
            raise InputError(f"angle has shape {theta.shape}, expected one finite angle or one for each vertex")
        turn = np.exp(-1j * self.order * theta)
        return (self.z * turn.reshape(theta.shape + (1,) * (self.z.ndim - theta.ndim))).real


@dataclass(frozen=True, repr=False)
class Bank(Brief):
    """Responses of K filters at every vertex (or pixel). ``len(bank)`` is K, ``bank[k]`` the k-th response.

    Attributes
    ----------
    z : (N, K) or (N, K, C) complex128
        The responses; (H, W, K) on an image.
    orders : (K,) int64
        Angular order of each filter.
    scales : (K,) float64
        Scale of each filter: rings (T-MAHF), time (MAHF) or standard deviation, px (CHF).
    defined : (N, K) bool
        False where a filter has no response; (H, W, K) on an image.
    """

    z: NDArray[np.complex128]
    orders: NDArray[np.int64]
    scales: FloatArray
    defined: BoolArray

    def __len__(self) -> int:
        return len(self.orders)

    def __getitem__(self, k: int) -> Response:
        last = (slice(None),) * (self.defined.ndim - 1) + (k,)
        return Response(self.z[last], int(self.orders[k]), self.defined[last])

    @property
    def magnitude(self) -> FloatArray:
        """``|z|``, same shape as ``z``."""
        return np.abs(self.z)

    @property
    def phase(self) -> FloatArray:
        """``arg z`` in (-π, π], same shape as ``z``, rad."""
        return phase_of(self.z)
