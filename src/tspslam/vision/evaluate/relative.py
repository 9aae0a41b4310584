"""Errors of motions: over one length of the way, of time or of frames, and in KITTI's table."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...types import FloatArray
from ..se3 import inverse, rotation_angle

_SLACK = 0.1  # of a distance or a time, by which the nearest pair of poses may miss it
_DELTA = re.compile(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)(f|m|s)")
KITTI_LENGTHS = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)  # m: Geiger et al. 2012
_KITTI_STEP = 10  # poses from one start to the next: a second of KITTI's


@dataclass(frozen=True)
class DistanceErrors:
    """Errors of the motion over one length.

    Attributes
    ----------
    pairs : int
        Of poses that are so far apart along the true path, or in time, to a tenth, each start with its nearest end; or
        so many frames apart.
    translation_m : float
        Root mean square, m; 0 without pairs.
    translation_percent : float
        Mean error over the mean distance along the true path, %; 0 without pairs.
    rotation_deg : float
        Root mean square, degrees; 0 without pairs.
    """

    pairs: int
    translation_m: float
    translation_percent: float
    rotation_deg: float


@dataclass(frozen=True)
class KittiErrors:
    """The table of KITTI's odometry benchmark: errors of sections of 100, 200, ..., 800 m (Geiger et al. 2012).

    A section starts at every tenth matched pose, and ends at the first that is farther along the true path than its
    length. Its errors are ``|t(E)| / length`` and ``∠R(E) / length``, with ``E = (P_i⁻¹ P_j)⁻¹ (Q_i⁻¹ Q_j)``, P
    estimated and Q true.

    Attributes
    ----------
    translation_percent : float
        Mean over all sections of all lengths, %; 0 without one.
    rotation_deg_100m : float
        The same of rotations, degrees per 100 m.
    per_length : dict of float to (int, float, float)
        Of each length, m, that the path is long enough for: sections, %, degrees per 100 m.
    travelled_m : float
        Length of the true path from the first matched pose to the last, m.
    """

    translation_percent: float
    rotation_deg_100m: float
    per_length: dict[float, tuple[int, float, float]]
    travelled_m: float


class Delta(NamedTuple):
    """A length over which motions are compared: so many of a unit."""

    size: float
    unit: str


class Motions(NamedTuple):
    """Matched poses, (M, 4, 4), estimated and true; the stamps of the estimated, s, and the numbers of their frames."""

    P: FloatArray
    Q: FloatArray
    stamps: FloatArray
    frames: NDArray[np.int64]

    @property
    def travelled(self) -> FloatArray:
        """Along the true path, m."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.Q[:, :3, 3], axis=0), axis=1))])


def parse_delta(text: str) -> Delta:
    """Parse a length with its unit: frames (f), metres (m) or seconds (s).

    Parameters
    ----------
    text : str
        Such as ``1f``, ``10m``, ``0.5s``.

    Returns
    -------
    Delta

    Raises
    ------
    InputError
        If it is none, or 0.

    Examples
    --------
    >>> parse_delta("2.5m")
    Delta(size=2.5, unit='m')
    """
    found = _DELTA.fullmatch(text.strip()) if isinstance(text, str) else None
    if found is None or float(found[1]) == 0 or (found[2] == "f" and "." in found[1]):
        raise InputError(
            f"delta {text!r:.40} is no length, expected frames, metres or seconds, such as 1f, 10m or 0.5s"
        )
    return Delta(float(found[1]), found[2])


def errors_over(motions: Motions, delta: Delta) -> DistanceErrors:
    """Errors over all pairs of poses that are one length apart."""
    along = {"m": motions.travelled, "s": motions.stamps, "f": motions.frames.astype(np.float64)}[delta.unit]
    start = np.arange(len(along) - 1)
    after = np.clip(np.searchsorted(along, along[start] + delta.size), start + 1, len(along) - 1)
    before = np.maximum(after - 1, start + 1)
    miss = [np.abs(along[end] - along[start] - delta.size) for end in (before, after)]
    end = np.where(miss[0] <= miss[1], before, after)
    kept = np.minimum(*miss) <= (0.0 if delta.unit == "f" else _SLACK * delta.size)
    if not kept.any():
        return DistanceErrors(0, 0.0, 0.0, 0.0)
    start, end = start[kept], end[kept]
    translation, rotation = relative_errors(motions.P, motions.Q, start, end)
    way = float((motions.travelled[end] - motions.travelled[start]).mean())
    percent = 100 * float(translation.mean() / way) if way > 0 else 0.0
    return DistanceErrors(len(start), rms(translation), percent, rms(rotation))


def kitti_errors(motions: Motions) -> KittiErrors:
    """The table of sections of 100 to 800 m."""
    along = motions.travelled
    start = np.arange(0, len(along), _KITTI_STEP)
    rows: dict[float, tuple[int, float, float]] = {}
    every: list[FloatArray] = []
    for length in KITTI_LENGTHS:
        end = np.searchsorted(along, along[start] + length, "right")
        kept = end < len(along)
        if not kept.any():
            continue
        translation, rotation = relative_errors(motions.P, motions.Q, start[kept], end[kept])
        every.append(np.stack([100 * translation / length, 100 * rotation / length]))
        mean = every[-1].mean(axis=1)
        rows[length] = (int(kept.sum()), float(mean[0]), float(mean[1]))
    mean = np.concatenate(every, axis=1).mean(axis=1) if every else np.zeros(2)
    return KittiErrors(float(mean[0]), float(mean[1]), rows, float(along[-1]))


def relative_errors(
    P: FloatArray, Q: FloatArray, start: NDArray[np.int64], end: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Errors of motions: translation, m, and rotation, degrees."""
    error = inverse(inverse(Q[start]) @ Q[end]) @ (inverse(P[start]) @ P[end])
    return np.linalg.norm(error[:, :3, 3], axis=1), np.degrees(rotation_angle(error[:, :3, :3]))


def rms(values: FloatArray) -> float:
    """Root mean square; 0 of no values."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0
