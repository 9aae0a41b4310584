"""Values of a camera, its image size and its motions, each with the key it came from, checked to be in range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....types import LENSES, FloatArray
from ._source import Source, whole

Found = dict[str, tuple[Any, str]]
"""For each name of a field: its value and the key of the file. All are numbers but the lens, a name."""

Size = tuple[int, int]
"""Width and height, px."""

_LENS = ("fx", "fy", "cx", "cy")
DISTORTION = ("k1", "k2", "p1", "p2", "k3")
OPENCV_COUNTS = (4, 5, 8, 12, 14)  # of coefficients that OpenCV writes
_RANGES = {
    "fx": (1e-3, 1e7, "a focal length, px,"),
    "fy": (1e-3, 1e7, "a focal length, px,"),
    "baseline": (1e-6, 1e6, "a baseline, m,"),
    **{name: (-1e4, 1e4, "a distortion coefficient") for names in LENSES.values() for name in names},
    "xi": (-1.0, 1e4, "xi of a lens"),
    "alpha": (0.0, 1.0, "alpha of a lens"),
    "beta": (1e-6, 1e4, "beta of a lens"),
}
_SAME = 1e-3  # px, between the projection matrices of a rectified pair
_ZERO = 1e-6
_ROTATION = 1e-3  # off R Rᵀ = I, and off 1 of the length of a quaternion
_BESIDE = 1e-3  # of the baseline: how far the right camera may be off the x axis of the left


def checked(source: Source, found: Found) -> Found:
    """Return the values if each is in the range of its field."""
    for name, (value, key) in found.items():
        if name == "lens":
            continue
        low, high, what = _RANGES.get(name, (-1e7, 1e7, "a number"))
        if not low <= value <= high:
            hint = ": left and right look swapped" if name == "baseline" and value < 0 else ""
            raise source.error(f"{key} is {value:.8g}, expected {what} from {low:g} to {high:g}{hint}")
    return found


def from_camera_matrix(source: Source, key: str) -> Found:
    """Return fx, fy, cx, cy and skew of a 3 x 3 camera matrix."""
    return _from_matrix(source, key, source.matrix(key, 3, 3))


def from_list(source: Source, key: str, names: Sequence[str] = _LENS) -> Found:
    """Return fx, fy, cx, cy, or other values, of a list of as many numbers."""
    values = source.vector(key, len(names))
    named = enumerate(zip(names, values, strict=True))
    return checked(source, {name: (value, f"{source.label(key)}[{k}]") for k, (name, value) in named})


def from_keys(source: Source, prefix: str, names: Sequence[str] = _LENS) -> Found:
    """Return values that have a key each, such as ``Camera.fx``."""
    keys = {name: f"{prefix}{name}" for name in names}
    return checked(source, {name: (source.number(key), source.label(key)) for name, key in keys.items()})


def distortion(source: Source, key: str, *counts: int) -> Found:
    """Return OpenCV's coefficients, as many as one of `counts`, of the simplest of its lenses that has them.

    That is Brown's where the sixth and all after it are 0, the rational one where the ninth and all after it are.
    """
    values = source.vector(key, *counts)
    for k, (name, value) in enumerate(zip(("tx", "ty"), values[12:], strict=False), start=12):
        if value != 0:
            raise source.wrong(f"{key}[{k}] ({name})", value, "0: a tilted sensor is not supported")
    lens = "thin_prism" if any(values[8:12]) else "rational" if any(values[5:8]) else "brown"
    return _named(source, key, lens, values, f"{len(values)} of {source.label(key)}")


def coefficients(source: Source, key: str, lens: str, origin: str, *counts: int) -> Found:
    """Return the coefficients of a lens that `origin`, a key, names; of `counts`, those beyond its own must be 0."""
    names = LENSES[lens]
    values = source.vector(key, *(counts or (len(names),)))
    for k, value in enumerate(values[len(names) :], start=len(names)):
        if value != 0:
            raise source.wrong(f"{key}[{k}]", value, f"0 after {', '.join(names)}")
    return _named(source, key, lens, values, origin)


def _named(source: Source, key: str, lens: str, values: Sequence[float], origin: str) -> Found:
    named = zip(LENSES[lens], values, strict=False)
    found: Found = {name: (value, f"{source.label(key)}[{k}]") for k, (name, value) in enumerate(named)}
    return checked(source, with_lens(found, lens, origin))


def with_lens(found: Found, lens: str, origin: str) -> Found:
    """Return the values with the lens that they are of, where that is not Brown's."""
    return found if lens == "brown" else {**found, "lens": (lens, origin)}


def from_projections(source: Source, left: str, right: str) -> Found:
    """Return all of a rectified pair but its size, from the 3 x 4 projection matrices of its cameras."""
    matrices = P_left, P_right = source.matrix(left, 3, 4), source.matrix(right, 3, 4)
    found, other = (_from_matrix(source, key, P) for key, P in zip((left, right), matrices, strict=True))
    for name in ("fx", "fy", "cy", "skew"):
        (value, key), (second, its_key) = found[name], other[name]
        if abs(value - second) > _SAME:
            raise source.error(f"{key} is {value:.8g}, {its_key} is {second:.8g}, expected the same (a rectified pair)")
    _check_column(source, left, P_left, (0, 1, 2))
    _check_column(source, right, P_right, (1, 2))
    one, two = source.label(left), source.label(right)
    found["baseline"] = float(-P_right[0, 3]) / float(P_right[0, 0]), f"{two}[0,3] / -{two}[0,0]"
    found["doffs"] = float(P_right[0, 2] - P_left[0, 2]), f"{two}[0,2] - {one}[0,2]"
    return checked(source, found)


def _from_matrix(source: Source, key: str, K: FloatArray) -> Found:
    for row, column, wanted in ((1, 0, 0), (2, 0, 0), (2, 1, 0), (2, 2, 1)):
        if abs(K[row, column] - wanted) > _ZERO:
            raise source.wrong(f"{key}[{row},{column}]", float(K[row, column]), f"{wanted} of a camera matrix")
    places = {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2), "skew": (0, 1)}
    label = source.label(key)
    return checked(source, {name: (float(K[r, c]), f"{label}[{r},{c}]") for name, (r, c) in places.items()})


def _check_column(source: Source, key: str, P: FloatArray, rows: tuple[int, ...]) -> None:
    offset = P[:, 3] / (P[0, 0], P[1, 1], 1)  # of the camera, m
    allowed = _ZERO if 0 in rows else max(_ZERO, _BESIDE * abs(offset[0]))
    for row in rows:
        if abs(offset[row]) > allowed:
            wanted = "0: the left camera at the origin, the right one beside it"
            raise source.wrong(f"{key}[{row},3]", float(P[row, 3]), wanted)


def size_from_keys(source: Source, width: str, height: str) -> Found:
    """Return the image size that has a key for each side."""
    sides = (("width", width), ("height", height))
    return {name: (_side(source, key, source.number(key)), source.label(key)) for name, key in sides}


def size_from_list(source: Source, key: str) -> Found:
    """Return the image size that is a list of width and height."""
    names = (f"{key}[0]", f"{key}[1]")
    width, height = (_side(source, name, value) for name, value in zip(names, source.vector(key, 2), strict=True))
    return {"width": (width, source.label(names[0])), "height": (height, source.label(names[1]))}


def agreed_size(source: Source, found: Found | None, given: Size | None) -> Found:
    """Return the file's image size, else the caller's; they must be the same if there are both."""
    if found is None:
        if given is None:
            raise source.error("holds no image size; expected width and height from elsewhere (--size, or size=)")
        return {name: (value, "given size") for name, value in zip(("width", "height"), given, strict=True)}
    seen = found["width"][0], found["height"][0]
    if given is not None and seen != given:
        keys = f"{found['width'][1]}, {found['height'][1]}"
        raise source.error(
            f"is for images of {seen[0]} x {seen[1]} px ({keys}), but {given[0]} x {given[1]} px are given, "
            "expected the same"
        )
    return found


def _side(source: Source, key: str, value: float) -> float:
    if not (1 <= value <= 1_000_000 and value == int(value)):
        raise source.wrong(key, whole(value), "a whole number of px from 1 to 1000000")
    return int(value)


def pose(source: Source, key: str) -> FloatArray:
    """Return a 4 x 4 rigid motion."""
    T = source.matrix(key, 4, 4)
    if np.abs(T[3] - (0, 0, 0, 1)).max() > _ZERO:
        raise source.wrong(key, T.tolist()[3], "0 0 0 1 in the last row")
    T[3] = 0, 0, 0, 1
    check_rotation(source, key, T[:3, :3])
    return T


def motion(R: FloatArray, t: Sequence[float]) -> FloatArray:
    """Return the 4 x 4 matrix of ``x -> R x + t``."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def inverse(T: FloatArray) -> FloatArray:
    """Return the motion back."""
    return np.asarray(np.linalg.inv(T), np.float64)


def beside(R_left: FloatArray, R_right: FloatArray, baseline: float) -> FloatArray:
    """Return T_right_left of cameras that differ by the baseline only once R has turned them: x_rectified = R x."""
    return motion(R_right.T @ R_left, (R_right.T @ (-baseline, 0, 0)).tolist())


def turned(source: Source, key: str, quaternion: Sequence[float]) -> FloatArray:
    """Return the 3 x 3 rotation of a quaternion w, x, y, z, of length 1 to 1e-3."""
    q = np.array(quaternion, np.float64)
    length = float(np.linalg.norm(q))
    if not abs(length - 1) <= _ROTATION:
        raise source.error(f"{source.label(key)} is a quaternion of length {length:.6g}, expected 1")
    w, x, y, z = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation(source: Source, key: str) -> FloatArray:
    """Return a 3 x 3 rotation."""
    R = source.matrix(key, 3, 3)
    check_rotation(source, key, R)
    return R


def check_rotation(source: Source, key: str, R: FloatArray) -> None:
    """Refuse what is no rotation to 1e-3."""
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > _ROTATION or np.linalg.det(R) < 0:
        mirrored = " and mirrors" if off <= _ROTATION else ""
        raise source.error(f"{source.label(key)} holds no rotation (R Rᵀ - I has {off:.2g}{mirrored}), expected one")
