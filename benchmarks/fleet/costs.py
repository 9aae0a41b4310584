"""What a recording and a tile cost, fitted to measurements: seconds of a processor, memory, bytes read and written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from .simulate import Task


@dataclass(frozen=True)
class Sample:
    """One measured recording or tile."""

    size: tuple[float, ...]
    """Of a recording: frames, and megapixels of all its left images together. Of a tile: thousands of vertices."""
    seconds: float
    """Of the processor, all threads and child processes together."""
    peak: float
    """Bytes of resident memory at most."""
    reads: float
    """Bytes of the files that it reads."""
    writes: float
    """Bytes of the files that it leaves."""


@dataclass(frozen=True)
class Model:
    """Each cost as a sum of parts that are proportional to one and to the sizes, none negative."""

    seconds: tuple[float, ...]
    peak: tuple[float, ...]
    reads: tuple[float, ...]
    writes: tuple[float, ...]
    worst: float
    """Largest error of the seconds of a sample, as a share of what was measured."""

    def task(self, *size: float) -> Task:
        """What a recording or tile of this size asks for."""
        row = np.array([1.0, *size])
        return Task(*(float(row @ np.array(part)) for part in (self.seconds, self.reads, self.writes)))

    def memory(self, *size: float) -> float:
        """Bytes of resident memory."""
        return float(np.array([1.0, *size]) @ np.array(self.peak))


def fit_costs(samples: Sequence[Sample]) -> Model:
    """Fit each cost by least squares of relative errors, with parts that are not negative (Lawson and Hanson 1974)."""
    rows = np.array([[1.0, *sample.size] for sample in samples])
    measured = {
        name: np.array([getattr(sample, name) for sample in samples])
        for name in Model.__annotations__
        if name != "worst"
    }
    parts = {name: _fit(rows, values) for name, values in measured.items()}
    errors = np.abs(rows @ np.array(parts["seconds"]) / measured["seconds"] - 1)
    return Model(**parts, worst=float(errors.max()))


def _fit(rows: np.ndarray, values: np.ndarray) -> tuple[float, ...]:
    weight = 1 / np.maximum(values, 1e-12)
    return tuple(float(part) for part in nnls(rows * weight[:, None], values * weight)[0])
