"""One frame's results on disk: a versioned npz; one set of versions gives the same frame the same bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import require
from .._files import PathLike
from .._npz import Arrays
from ..errors import InputError
from ..frame import Frame
from ..types import BoolArray, Cloud, Image, Surface
from ._form import part_of, read_arrays, rig_arrays, rig_of, write_arrays
from ._frame_schema import FORM, complex_arrays, complex_of


def write_frame(path: PathLike, frame: Frame) -> None:
    """Write one frame as npz, whole or not at all; equal frames give equal bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    frame : Frame
        Its parts are computed, if they are not yet; quality, what was tracked and times are not written. Its image is
        (of float64, as float32) if it has the size of the rig's, and so is which of its pixels the cameras saw.

    Raises
    ------
    InputError
        If the frame's arrays do not fit each other, or hold a value that is not finite (``uv`` and ``disparity`` may
        be NaN where a point has no projection).
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam import Response, Rig, Signals, build_complex
    >>> shape, three, yes = build_complex([[0, 1, 2]], 3), np.zeros(3), np.ones(3, bool)
    >>> frame = Frame(
    ...     index=7,
    ...     stamp=0.5,
    ...     name="seventh",
    ...     rig=Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480),
    ...     cloud=Cloud(np.eye(3), np.zeros((3, 2)), three),
    ...     surface=Surface(shape.faces),
    ...     complex_=shape,
    ...     signals=Signals(three, three, np.zeros(1), np.zeros((3, 2)), np.zeros((1, 2)),
    ...                     np.zeros(3, int), np.zeros(1, int), yes, yes, yes[:1]),
    ...     response=Response(three.astype(complex), 1, yes),
    ... )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_frame(f"{folder}/000007.npz", frame)
    ...     read_frame(f"{folder}/000007.npz").name
    'seventh'
    """
    require(frame, Frame, "frame")
    write_arrays(path, FORM, _collected(frame))


def read_frame(path: PathLike) -> Frame:
    """Read a frame that `write_frame` wrote.

    Nothing is unpickled; every claimed size is compared with what is there before memory is taken.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Frame
        The frame; with its image, if one was written.

    Raises
    ------
    InputError
        If the file is no such npz, of another version, damaged, or its arrays are missing or inconsistent.

    Examples
    --------
    >>> from tspslam import InputError
    >>> try:
    ...     read_frame("no such frame.npz")
    ... except InputError as error:
    ...     print(str(error)[:35])
    no such frame.npz: cannot be opened
    """
    return read_arrays(path, FORM, _frame)


def read_frame_image(path: PathLike) -> Image:
    """Read the image of a frame that `write_frame` wrote, and nothing else of it.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    (H, W) or (H, W, 3) uint8, uint16 or float32

    Raises
    ------
    InputError
        As `read_frame`, or if the frame has none.
    """
    return read_arrays(path, FORM, _image_of, only=("image",))


def renumber_frame(
    path: PathLike, target: PathLike, *, index: int, stamp: float, name: str, more_landmarks: int
) -> None:  # fmt: skip
    """Copy the file of a frame for a run in which it has another place.

    Parameters
    ----------
    path : str or path
        What `write_frame` wrote.
    target : str or path
        Where the copy goes.
    index, stamp, name : int, float, str
        Of the frame there; s.
    more_landmarks : int
        What is added to the numbers of landmarks.

    Raises
    ------
    InputError
        As `read_frame`.
    OutputError
        If the copy cannot be written.
    """
    arrays = read_arrays(path, FORM, dict)
    arrays |= {"index": np.array(index), "stamp": np.array(stamp), "name": _name_array(name)}
    if "landmark" in arrays:
        arrays["landmark"] = np.where(arrays["landmark"] < 0, -1, arrays["landmark"] + more_landmarks)
    write_arrays(target, FORM, arrays)


def read_frame_valid(path: PathLike) -> BoolArray | None:
    """Read which pixels of a frame that `write_frame` wrote the cameras saw, and nothing else of it.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    (H, W) bool or None
        None is all of them.

    Raises
    ------
    InputError
        As `read_frame`.
    """
    return read_arrays(path, FORM, lambda arrays: arrays.get("valid"), only=("valid",))


def _image_of(arrays: Arrays) -> Image:
    if "image" not in arrays:
        raise InputError("has no image")
    return arrays["image"]


def _collected(frame: Frame) -> dict[str, Any]:
    cloud = frame.cloud
    values: dict[str, Any] = {
        "index": frame.index,
        "stamp": float(frame.stamp),
        "name": _name_array(frame.name),
        **rig_arrays(frame.rig),
        "T_world_camera": frame.T_world_camera,
        "is_keyframe": frame.is_keyframe,
        "is_lost": frame.is_lost,
        "cloud_xyz": cloud.xyz,
        "cloud_uv": cloud.uv,
        "cloud_disparity": cloud.disparity,
        "surface_faces": frame.surface.faces,
        **complex_arrays(frame.complex_, frame.signals, frame.response),
    }
    others = {
        "cloud_covariance": cloud.covariance,
        "landmark": frame.landmark,
        "image": storable_image(frame),
        "valid": frame.valid,
    }
    return values | {name: value for name, value in others.items() if value is not None}


def _name_array(name: str) -> NDArray[np.uint8]:
    return np.frombuffer(name.encode("utf-8", "backslashreplace"), np.uint8)


def storable_image(frame: Frame) -> Image | None:
    """Return a frame's image as its file holds it: float64 says no more of pixels than float32.

    Parameters
    ----------
    frame : Frame
        With or without an image.

    Returns
    -------
    (H, W) or (H, W, 3) uint8, uint16 or float32, or None
        None where there is none, or it is not the rig's.
    """
    image = frame.image
    if image is None or image.shape[:2] != (frame.rig.height, frame.rig.width):
        return None
    return image.astype(np.float32) if image.dtype == np.float64 else image


def _frame(arrays: Arrays) -> Frame:
    complex_, signals, response = complex_of(arrays)
    return Frame(
        index=int(arrays["index"]),
        stamp=float(arrays["stamp"]),
        name=arrays["name"].tobytes().decode("utf-8"),
        rig=rig_of(arrays),
        cloud=Cloud(**part_of(arrays, "cloud_")),
        surface=Surface(arrays["surface_faces"]),
        complex_=complex_,
        signals=signals,
        response=response,
        image=arrays.get("image"),
        T_world_camera=arrays["T_world_camera"],
        landmark=arrays.get("landmark"),
        is_keyframe=bool(arrays["is_keyframe"]),
        is_lost=bool(arrays["is_lost"]),
        valid=arrays.get("valid"),
    )
