"""Errors of motions: over one length of the way, of time or of frames, and in KITTI's table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ...types import FloatArray
from ..se3 import inverse, rotation_angle
from .relative import Delta, DistanceErrors, KittiErrors

_SLACK = 0.1  # of a distance or a time, by which the nearest pair of poses may miss it
_KITTI_LENGTHS = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)  # m: Geiger et al. 2012
_KITTI_STEP = 10  # poses from one start to the next: a second of KITTI's


@dataclass(frozen=True, repr=False)
class Motions(Brief):
    """Matched poses, (M, 4, 4), estimated and true; stamps of the estimated, s, numbers of their frames and parts."""

    P: FloatArray
    Q: FloatArray
    stamps: FloatArray
    frames: NDArray[np.int64]
    part: NDArray[np.int64]

    @property
    def travelled(self) -> FloatArray:
        """Along the true path, m; nothing is travelled from one part to the next."""
        ways = np.linalg.norm(np.diff(self.Q[:, :3, 3], axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(np.where(self.part[1:] == self.part[:-1], ways, 0.0))])


def errors_over(motions: Motions, delta: Delta) -> DistanceErrors:
    """Errors over all pairs of poses that are one length apart."""
    along = {"m": motions.travelled, "s": motions.stamps, "f": motions.frames.astype(np.float64)}[delta.unit]
    start = np.arange(len(along) - 1)
    after = np.clip(np.searchsorted(along, along[start] + delta.size), start + 1, len(along) - 1)
    before = np.maximum(after - 1, start + 1)
    miss = [np.abs(along[end] - along[start] - delta.size) for end in (before, after)]
    end = np.where(miss[0] <= miss[1], before, after)
    kept = np.minimum(*miss) <= (0.0 if delta.unit == "f" else _SLACK * delta.size)
    kept &= motions.part[start] == motions.part[end]
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
    for length in _KITTI_LENGTHS:
        end = np.searchsorted(along, along[start] + length, "right")
        kept = end < len(along)
        kept[kept] = motions.part[start[kept]] == motions.part[end[kept]]
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
