"""What flows between the stages: frozen data classes over NumPy arrays.

Conventions, in one place: camera frame x right, y down, z forward, in metres; pixels ``(u, v)`` with the
centre of the top-left pixel at ``(0, 0)``; ``disparity = u_left - u_right``; luminance in [0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._brief import Brief
from ._cameras import LENSES as LENSES
from ._cameras import Camera as Camera
from ._cameras import RawRig as RawRig
from ._cameras import Rig as Rig
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
    sigma : (H, W) float array or None
        Standard deviation of each disparity, px; None where the matcher's own is taken.
    valid : (H, W) bool array or None
        Pixels that both cameras saw; None is all of them. Neither image is used elsewhere.
    disparity_range : (low, high) or None
        Smallest and largest disparity of the scene, px, where its calibration tells them: matchers that are given no
        limits keep to these.

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
    sigma: FloatArray | None = None
    valid: BoolArray | None = None
    disparity_range: tuple[float, float] | None = None

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
