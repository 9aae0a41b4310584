"""Checks of what worlds are made of; each refuses in one line: what was wrong, where, what was expected."""

from __future__ import annotations

from numbers import Real
from typing import Any, TypeVar

import numpy as np

from ..._files import one_line
from ...errors import InputError
from ...types import FloatArray, real_array

FARTHEST = 1e6  # m
MAX_POSES = 100_000
_T = TypeVar("_T")


def refused(what: str, value: Any, expected: str) -> InputError:
    """Return the error for a value that is not as it should be."""
    return InputError(one_line(f"{what} is {repr(value)[:60]}, expected {expected}"))


def instance(kind: type[_T], value: Any, what: str) -> _T:
    """Return a value that is of a type."""
    if not isinstance(value, kind):
        raise refused(what, value, f"a {kind.__name__}")
    return value


def label(value: Any, what: str) -> str:
    """Return a text of one line."""
    if not isinstance(value, str) or value != one_line(value):
        raise refused(what, value, "a text of one line")
    return value


def number(value: Any, what: str, low: float, high: float, unit: str = "") -> float:
    """Return a real number of a range."""
    value = value.item() if isinstance(value, np.generic) else value  # so that a bound is not cast to float16
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if not (is_number and low <= value <= high):
        raise refused(what, value, f"a number from {low:g} to {high:g}{unit and f' {unit}'}")
    return float(value)


def whole(value: Any, what: str, low: int, high: int | None = None) -> int:
    """Return a whole number of a range."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < low or (high and value > high):
        raise refused(what, value, f"a whole number from {low} {f'to {high}' if high else 'on'}")
    return int(value)


def finite(values: Any, what: str, shape: tuple[int | None, ...], most: float = FARTHEST) -> FloatArray:
    """Return a copy as float64 of a shape (None: any length), each finite and at most `most`."""
    said = " x ".join("n" if side is None else str(side) for side in shape)
    array = np.array(real_array(values, what, said), np.float64)
    if array.ndim != len(shape) or not all(b in (None, a) for a, b in zip(array.shape, shape, strict=True)):
        raise InputError(f"{what} has shape {array.shape}, expected {said} numbers")
    if not (fits := np.abs(array) <= most).all():  # NaN does not
        raise InputError(f"{what} holds {array[~fits][0]:g}, expected {said} finite numbers, at most {most:g}")
    return array


def rigid(values: Any, what: str, shape: tuple[int | None, ...] = (4, 4)) -> FloatArray:
    """Return matrices that are rigid motions, to 1e-6, as `finite` does."""
    poses = finite(values, what, shape)
    R = poses[..., :3, :3]
    off = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    off = np.maximum(off, np.abs(poses[..., 3, :] - (0, 0, 0, 1)).max(axis=-1))
    for bad in np.argwhere((off > 1e-6) | (np.linalg.det(R) < 0)):
        at, by = "".join(f"[{k}]" for k in bad), off[tuple(bad)]
        raise InputError(f"{what}{at} is off a rigid motion by {by:.2g}, expected rotation and translation, to 1e-6")
    return poses


def keep(frozen: Any, **values: Any) -> None:
    """Put values that were checked in the place of those that a frozen data class was given; no array is written to."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(frozen, name, value)
