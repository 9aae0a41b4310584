"""Rotations and rigid motions of a calibration file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...types import FloatArray
from ._source import Source

_ROTATION = 1e-3
_ZERO = 1e-6


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
