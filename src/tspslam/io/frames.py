"""One frame's results on disk: a versioned npz; one set of versions gives the same frame the same bytes."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._checks import require
from .._files import PathLike, bad_input, read_bytes
from .._npz import Arrays, read_npz
from ..errors import InputError
from ..frame import Frame
from ..topology.complex import Complex
from ..types import Cloud, Response, Rig, Signals, Surface
from ._frame_schema import MAGIC, OPTIONAL, SCHEMA, SINCE_LAST, VERSION, check, to_schema

_EXPECTED = f"a frame of format version {VERSION}"
_RIG = ("fx", "fy", "cx", "cy", "baseline", "skew", "doffs")


def write_frame(path: PathLike, frame: Frame) -> None:
    """Write one frame as npz, whole or not at all; equal frames give equal bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    frame : Frame
        Its parts are computed, if they are not yet; image, quality, what was tracked and times are not written.

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
    >>> from tspslam.topology.complex import build_complex
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
    try:
        arrays = {name: to_schema(name, value) for name, value in _collected(frame).items()}
        check(arrays)
    except InputError as error:
        raise bad_input(path, f"cannot hold this frame: {error}", "a consistent frame") from error
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name in SCHEMA:
            if name in arrays:
                archive.writestr(_entry(name), _npy(arrays[name]), zipfile.ZIP_DEFLATED, 1)
    write_bytes(path, packed.getvalue())


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
        The frame.

    Raises
    ------
    InputError
        If the file is no such npz, of another version, damaged, or its arrays are missing or inconsistent.

    Examples
    --------
    >>> try:
    ...     read_frame("no such frame.npz")
    ... except InputError as error:
    ...     print(str(error)[:35])
    no such frame.npz: cannot be opened
    """
    data = read_bytes(path, _EXPECTED)
    try:
        arrays = read_npz(data, SCHEMA, optional=OPTIONAL | SINCE_LAST, check=_check_mark)
        _check_all_there(arrays)
        check(arrays)
        return _frame(arrays)
    except (InputError, UnicodeDecodeError, MemoryError) as error:
        raise bad_input(path, str(error), _EXPECTED) from error


def _collected(frame: Frame) -> dict[str, Any]:
    cloud, complex_, response = frame.cloud, frame.complex_, frame.response
    values: dict[str, Any] = {
        "magic": np.frombuffer(MAGIC.encode("ascii"), np.uint8),
        "version": VERSION,
        "index": frame.index,
        "stamp": float(frame.stamp),
        "name": np.frombuffer(frame.name.encode("utf-8", "backslashreplace"), np.uint8),
        "rig": [float(getattr(frame.rig, key)) for key in _RIG],
        "image_size": [frame.rig.width, frame.rig.height],
        "T_world_camera": frame.T_world_camera,
        "is_keyframe": frame.is_keyframe,
        "is_lost": frame.is_lost,
        "cloud_xyz": cloud.xyz,
        "cloud_uv": cloud.uv,
        "cloud_disparity": cloud.disparity,
        "surface_faces": frame.surface.faces,
        "complex_n": complex_.n,
        "complex_edges": complex_.edges,
        "complex_faces": complex_.faces,
        "complex_face_edges": complex_.face_edges,
        "response_z": response.z,
        "response_order": response.order,
        "response_defined": response.defined,
    }
    values |= {"cloud_covariance": cloud.covariance} if cloud.covariance is not None else {}
    values |= {"landmark": frame.landmark} if frame.landmark is not None else {}
    keys = [name for name in SCHEMA if name.startswith("signals_")]
    return values | {key: getattr(frame.signals, key.removeprefix("signals_")) for key in keys}


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
    # Otherwise these two tell the operating system that wrote the file.
    entry.create_system, entry.external_attr = 3, 0o600 << 16
    return entry


def _npy(values: np.ndarray[Any, Any]) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, values, version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def _check_mark(name: str, values: NDArray[Any]) -> None:
    if name == "magic" and values.tobytes() != MAGIC.encode("ascii"):
        raise InputError("does not carry the mark of a frame")
    if name == "version" and (values.shape != () or int(values) != VERSION):
        former = " of a former tspslam, and the run is to be made anew" if values.tolist() == VERSION - 1 else ""
        raise InputError(f"has the format version {str(values.tolist())[:40]}{former}")


def _check_all_there(arrays: Arrays) -> None:
    """Refuse a file of this version without what the last one had not."""
    missing = sorted(SINCE_LAST - arrays.keys())
    if missing:
        raise InputError(f"has no array {missing[0]}")


def _frame(arrays: Arrays) -> Frame:
    def part(prefix: str) -> Arrays:
        return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}

    rig = dict(zip(_RIG, arrays["rig"].tolist(), strict=True))
    width, height = arrays["image_size"].tolist()
    complex_, response = part("complex_"), part("response_")
    return Frame(
        index=int(arrays["index"]),
        stamp=float(arrays["stamp"]),
        name=arrays["name"].tobytes().decode("utf-8"),
        rig=Rig(width=width, height=height, **rig),
        cloud=Cloud(**part("cloud_")),
        surface=Surface(arrays["surface_faces"]),
        complex_=Complex(int(complex_.pop("n")), **complex_),
        signals=Signals(**part("signals_")),
        response=Response(response["z"], int(response["order"]), response["defined"]),
        T_world_camera=arrays["T_world_camera"],
        landmark=arrays.get("landmark"),
        is_keyframe=bool(arrays["is_keyframe"]),
        is_lost=bool(arrays["is_lost"]),
    )
