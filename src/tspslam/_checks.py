"""What a caller gave, held against what was expected, so that one line says how to go on."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError

_WAYS = {
    "Session": "tspslam.Session(rig) makes one",
    "MappingSettings": "tspslam.MappingSettings(surface=tspslam.SurfaceSettings(longest=0.3)), say",
    "ObservationSettings": "tspslam.ObservationSettings(misses=1), say",
    "SurfaceSettings": "tspslam.SurfaceSettings(longest=0.3), say",
    "ViewSettings": "tspslam.ViewSettings(max_angle=80), say",
    "TopologicalMap": "what tspslam.build_map makes and tspslam.load_map reads",
    "StereoPair": "tspslam.read_pair(left, right, calib) reads one from files",
    "Rig": "tspslam.load_rig(path) reads one from a file",
    "RawRig": "tspslam.read_calibration(path).cameras is one, where the file has two raw cameras",
    "Camera": "tspslam.Camera(fx, fy, cx, cy, width, height) is one",
    "DepthSensor": "tspslam.vision.depth.sensor.DepthSensor(quadratic=1.4e-3), say",
    "Corners": "tspslam.vision.calibration.board.detect(board, image) gives them",
    "BoardView": "BoardView(name, left, right), of what detect(board, image) gives",
    "Cloud": "tspslam.reconstruct(pair) gives one",
    "Surface": "tspslam.delaunay_surface(cloud) gives one",
    "Complex": "tspslam.build_complex(faces) gives one",
    "Signals": "tspslam.sample_signals(image, uv, complex_) gives one",
    "Features": "such as tspslam.OrbDetector()(grey) gives",
    "Matches": "such as tspslam.RowMatcher()(left, right, pair) gives",
    "Response": "such as tspslam.tmahf(complex_, uv, signals) gives",
    "Tracking": "tspslam.Tracking(window=...)",
    "TrackingSettings": "tspslam.TrackingSettings(min_matches=...)",
    "MapSettings": "tspslam.MapSettings(spacing=...)",
    "LoopSettings": "tspslam.LoopSettings(min_landmarks=...)",
    "Tracked": "tspslam.Tracked(T_world_camera) is one",
    "Trajectory": "tspslam.io.read_trajectory(path) reads one",
    "Settings": "tspslam.Settings(detector=...)",
    "Tmahf": "tspslam.Tmahf(order=1)",
    "MapSnapshot": "Map.snapshot() of the odometry gives one",
    "Frame": "Session.process(pair) gives one, tspslam.io.read_frame(path) reads one",
}
"""Where one gets each of our data classes from."""

_ORTHONORMAL = 1e-6  # off R Rᵀ = I, of a rotation; products of thousands stay within 1e-12
_PIXELS = (np.uint8, np.uint16, np.float32, np.float64)


def told(value: Any) -> str:
    """What a value is, in a few words."""
    if isinstance(value, str | os.PathLike):
        return f"the {'path' if _is_path(value) else 'text'} {os.fspath(value)!r:.80}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} of shape {value.shape}"
    return type(value).__name__


def with_part(value: Any, name: str) -> str:
    """What a value is, and that it has a part of that name, if so: one gave the whole for it."""
    return f"{told(value)} (give its .{name})" if hasattr(value, name) else told(value)


def require_path(value: Any, what: str = "path") -> None:
    """Refuse what names no file."""
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"{what} is {told(value)}, expected the path of a file, text or pathlib.Path")
    if value == "":
        raise InputError(f"{what} is empty, expected the path of a file, text or pathlib.Path")


def require_stage(value: Any, what: str, such: str) -> None:
    """Refuse what cannot be called as a stage: a name, or a class where an object of it goes."""
    if not callable(value) or isinstance(value, type):
        given = repr(value) if isinstance(value, str | type) else told(value)
        raise InputError(f"{what} is {given:.80}, expected a callable, such as {such}")


def refuse_path(value: Any, what: str, expected: str, reader: str) -> None:
    """Refuse the path of a file where what it holds goes; the line says which function reads it."""
    if isinstance(value, str | os.PathLike):
        raise InputError(f"{what} is {told(value)}, expected {expected}; {reader} reads files")


def _is_path(value: Any) -> bool:
    return isinstance(value, os.PathLike) or (isinstance(value, str) and ("." in value or os.sep in value))


def require(value: Any, kind: type, what: str) -> None:
    """Refuse what is not of one of our data classes; the line says how to come by one."""
    if not isinstance(value, kind):
        way = f": {_WAYS[kind.__name__]}" if kind.__name__ in _WAYS else ""
        raise InputError(f"{what} is {told(value)}, expected a {kind.__name__}{way}")


def real_array(values: ArrayLike, what: str, shape: str) -> NDArray[Any]:
    """Numbers as an array of their own type; paths, text, masks, objects and rows of different lengths are refused."""
    if _is_path(values):
        raise InputError(f"{what} is {told(values)}, expected {shape} real numbers")
    if isinstance(values, np.ma.MaskedArray):  # its mask would be lost without a word
        raise InputError(f"{what} is a masked array, expected a plain one, such as {what}.filled(np.nan)")
    try:
        array: NDArray[Any] = np.asarray(values)
    except ValueError as error:
        raise InputError(f"{what} has rows of different lengths, expected {shape}") from error
    except (TypeError, RuntimeError) as error:  # a tensor on another device, or one that asks for a gradient
        raise InputError(f"{what} is {told(values)} and gives no array ({error}), expected {shape}") from error
    if array.ndim == 0 and array.dtype.kind == "O" and values is not None:
        raise InputError(f"{what} is {with_part(values, what.split()[-1])}, expected {shape} real numbers")
    if array.size and array.dtype.kind not in "biuf":
        raise InputError(f"{what} is {array.dtype} of shape {array.shape}, expected {shape} real numbers")
    return array


def check_pixels(what: str, image: Any, shape: str = "(H, W) or (H, W, 3)") -> None:
    """Refuse what is no array of pixels of a type that is known; it costs no look at them."""
    refuse_path(image, what, f"an array {shape}", "tspslam.io.read_image(path)")
    if not isinstance(image, np.ndarray):
        raise InputError(f"{what} is {told(image)}, expected an array {shape} of uint8, uint16 or float")
    if isinstance(image, np.ma.MaskedArray):
        raise InputError(f"{what} is a masked array, expected a plain one: every pixel counts")
    if image.dtype not in _PIXELS:
        raise InputError(f"{what} is {image.dtype}, expected uint8, uint16 or float in [0, 1]")
    if image.ndim not in (2, 3) or image.size == 0:
        raise InputError(f"{what} shape is {image.shape}, expected {shape}, not empty")
    if image.ndim == 3 and image.shape[0] in (1, 3, 4) and min(image.shape[1:]) > 4:
        raise InputError(f"{what} shape is {image.shape}, expected {shape}: channels last, np.moveaxis(image, 0, -1)")


def check_luminance(what: str, image: NDArray[Any]) -> None:
    """Refuse floats beyond [0, 1]; integers are not looked at."""
    if image.dtype.kind != "f":
        return
    low, high = float(image.min()), float(image.max())
    if not (low >= 0 and high <= 1):
        way = next((f": divide by {top}" for top in (255, 65535) if low >= 0 and 1.5 < high <= top), "")
        way = way or (": np.clip(image, 0, 1), where it is noise or overshoot" if low >= -1 and high <= 1.5 else "")
        expected = "0 to 1 (float images), no NaN or infinite ones"
        raise InputError(f"{what} has values from {low:g} to {high:g}, expected {expected}{way}")


def is_rigid(T: NDArray[np.float64]) -> bool:
    """Whether matrices are rigid motions: rotations to 1e-6, and a last row of 0 0 0 1.

    Parameters
    ----------
    T : (..., 4, 4) float64
        Matrices, none of them included.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_rigid(np.eye(4)), is_rigid(2 * np.eye(4))
    (True, False)
    """
    if not np.isfinite(T).all():
        return False
    R = T[..., :3, :3]
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(initial=0.0)
    return bool(off < _ORTHONORMAL and (np.linalg.det(R) > 0).all() and (T[..., 3, :] == (0, 0, 0, 1)).all())
