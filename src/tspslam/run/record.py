"""What a run notes of each frame, and what its results depend on: hashes, versions, machine."""

from __future__ import annotations

import hashlib
import json
import platform
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..frame import Frame
from ..topology.crust import CrustSurface
from ..topology.surface import pinched_vertices
from ..types import Rig, StereoPair


@dataclass(frozen=True)
class ComplexRecord:
    """Numbers of a frame's complex, and of the images that it is from.

    Attributes
    ----------
    defined : int
        Vertices with a response.
    points, edges, faces, euler : int
        Sizes of the complex, and its Euler characteristic.
    pinched_vertices : tuple of int
        Vertices where the surface is not a manifold.
    surface : str
        How the surface was made.
    keypoints_left, keypoints_right : int
        Keypoints of the images.
    matched, by_row_search : int
        How many were matched, and how many of these had no keypoint in the right image.
    vertical_offset_px, vertical_offset_std_px : float
        Median of v_right - v_left, px, and its spread.
    """

    defined: int
    points: int
    edges: int
    faces: int
    euler: int
    pinched_vertices: tuple[int, ...]
    surface: str
    keypoints_left: int
    keypoints_right: int
    matched: int
    by_row_search: int
    vertical_offset_px: float
    vertical_offset_std_px: float


@dataclass(frozen=True)
class FrameRecord:
    """What one frame gave, in numbers; the same frame always gives the same.

    Attributes
    ----------
    index : int
        Place in its sequence.
    input_hash : str
        Hash of what it was made from.
    name : str
        What it is called.
    stamp : float
        Time, s.
    is_keyframe, is_lost : bool
        Whether the map rests on it; whether its pose is a guess.
    landmarks_seen : int
        Landmarks that agree with its pose.
    bits : int or None
        Bits that 16-bit pixels use, where that was found.
    unknown : tuple of float
        Values of its map that were taken for "not known".
    no_complex : str or None
        Why it has no complex, where one was wanted.
    own_stamp : float or None
        Time in its own recording, s, where that is another one.
    complex_ : ComplexRecord or None
        Its complex, if it is stored.
    """

    index: int
    input_hash: str
    name: str
    stamp: float
    is_keyframe: bool
    is_lost: bool
    landmarks_seen: int
    bits: int | None = None
    unknown: tuple[float, ...] = ()
    no_complex: str | None = None
    own_stamp: float | None = None
    complex_: ComplexRecord | None = None


@dataclass(frozen=True)
class SkippedPair:
    """A pair that could not be used.

    Attributes
    ----------
    index : int
        Place in its sequence.
    input_hash : str
        Hash of what it is, or of why it cannot be read.
    skipped : str
        Why.
    """

    index: int
    input_hash: str
    skipped: str


Row = FrameRecord | SkippedPair


def record_frame(frame: Frame, pair: StereoPair, input_hash: str) -> FrameRecord:
    """Numbers of a frame, without those of its complex.

    Parameters
    ----------
    frame : Frame
        What the pair gave.
    pair : StereoPair
        The images.
    input_hash : str
        Hash of what it was made from.

    Returns
    -------
    FrameRecord
    """
    return FrameRecord(
        frame.index, input_hash, frame.name, frame.stamp, frame.is_keyframe, frame.is_lost,
        landmarks_seen=0 if frame.tracked is None else frame.tracked.matches,
        bits=pair.bits, unknown=tuple(pair.unknown),
    )  # fmt: skip


def record_complex(frame: Frame) -> ComplexRecord:
    """Numbers of a frame's complex, which is computed if it is not yet.

    Parameters
    ----------
    frame : Frame
        A frame that a session gave.

    Returns
    -------
    ComplexRecord

    Raises
    ------
    InputError
        If it shows too little for one.
    """
    response, quality = frame.response, frame.quality
    return ComplexRecord(
        defined=int(response.defined.sum()),
        points=len(frame.cloud),
        edges=len(frame.complex_.edges),
        faces=len(frame.complex_.faces),
        euler=frame.complex_.euler,
        pinched_vertices=tuple(pinched_vertices(frame.surface.faces, len(frame.cloud)).tolist()),
        surface=frame.surface.report.verdict if isinstance(frame.surface, CrustSurface) else "image Delaunay",
        **vars(quality),
    )


def flatten_row(row: Row) -> dict[str, Any]:
    """A row as one plain mapping, fit for JSON, without what is usual of it.

    Parameters
    ----------
    row : FrameRecord or SkippedPair

    Returns
    -------
    dict
        As ``frames/*.json`` and the checkpoint hold it.

    Examples
    --------
    >>> flatten_row(FrameRecord(3, "", "third", 0.1, False, False, 80))["landmarks_seen"]
    80
    """
    values = {name: value for name, value in vars(row).items() if value is not None and value != ()}
    complex_ = values.pop("complex_", None)
    return values if complex_ is None else values | vars(complex_)


def pair_hash(pair: StereoPair) -> str:
    """SHA-256 of all that a frame is made from: images, rig, place, time, name, and the disparities that are searched.

    Parameters
    ----------
    pair : StereoPair
        The images.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    known = () if pair.disparity_range is None else (list(pair.disparity_range),)
    digest = hashlib.sha256(_json_bytes([_rig_record(pair.rig), pair.index, pair.stamp, pair.name, *known]))
    for values in (pair.left, pair.right, pair.disparity, pair.sigma, pair.valid):
        digest.update(b"" if values is None else array_hash(values).encode())
    return digest.hexdigest()


def array_hash(values: NDArray[Any]) -> str:
    """SHA-256 of an array's shape, type and content.

    Returns: as `pair_hash`.

    Parameters
    ----------
    values : (...,) array of numbers
        What to hash.
    """
    digest = hashlib.sha256(f"{values.shape} {values.dtype}".encode())
    digest.update(np.ascontiguousarray(values).data)
    return digest.hexdigest()


def _rig_record(rig: Rig) -> dict[str, float]:
    return {key: float(value) for key, value in vars(rig).items()}


def hash_of(value: Any) -> str:
    """SHA-256 of a value as JSON.

    Returns: as `pair_hash`.

    Parameters
    ----------
    value : object
        Fit for JSON, without NaN.
    """
    return hashlib.sha256(_json_bytes(value)).hexdigest()


def _json_bytes(value: Any) -> bytes:
    return (json.dumps(value, sort_keys=True, allow_nan=False) + "\n").encode()


def versions() -> dict[str, str]:
    """Versions of this package and of those that its results depend on.

    Returns
    -------
    dict of str to str
        By package.
    """
    packages = ("numpy", "scipy", "opencv-python-headless", "numba")
    return {"tspslam": __version__, **{name: version(name) for name in packages}}


def machine() -> dict[str, str]:
    """What the run ran on.

    Returns
    -------
    dict of str to str
        ``system``, ``python`` and ``processor``.
    """
    return {"system": platform.platform(), "python": platform.python_version(), "processor": platform.machine()}
