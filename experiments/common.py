"""What the scripts share: where frames come from, what a script gives back, the reference gradient."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter, map_coordinates

import tspslam
from tspslam.datasets import synthetic

SEEDS = (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class Result:
    """What a script gives back: a picture, the rows behind it, the numbers that matter, and the paper's."""

    figure: Figure
    table: Mapping[str, Sequence]
    numbers: Mapping[str, float | int | str]
    paper: Mapping[str, float | int | str] = field(default_factory=dict)


class Source:
    """Frames of a data folder; without one, of the Motorcycle pair and of synthetic scenes. `small` is for tests."""

    def __init__(self, data: Path | None = None, *, small: bool = False) -> None:
        self.data, self.small = data, small
        self._frame = cache(lambda place: tspslam.Session(self._pairs[place].rig).process(self._pairs[place]))

    @property
    def name(self) -> str:
        """What the results are of."""
        return self.data.resolve().name if self.data else "small scenes" if self.small else "Motorcycle, synthetic"

    def frames(self, count: int) -> list[tspslam.Frame]:
        """`count` frames, evenly over the data; InputError where there are fewer."""
        return [self._frame(place) for place in self._places(count)]

    def pairs(self, count: int) -> list[tspslam.StereoPair]:
        """The images of these frames."""
        return [self._pairs[place] for place in self._places(count)]

    def _places(self, count: int) -> list[int]:
        n = len(self._pairs)
        if n < count:
            raise tspslam.InputError(f"{self.data}: has {n} pairs, the figure needs {count}")
        return (np.arange(count) * n // count).tolist() if self.data else list(range(count))

    def true_disparity(self, frame: tspslam.Frame) -> np.ndarray | None:
        """(H, W) measured or rendered disparities of a frame's left image, px; None for a data folder."""
        return None if self.data else self._pairs.truth(frame.name)

    @property
    def _pairs(self) -> Sequence:
        if not hasattr(self, "_opened"):
            self._opened = tspslam.datasets.open_sequence(self.data) if self.data else Samples(self.small)
        return self._opened


class Samples:
    """Motorcycle, a street, a room, a corridor; the room at a quarter of the size four times if `small`."""

    def __init__(self, small: bool) -> None:
        rig, faults = synthetic.PAPER_RIG, synthetic.Faults(noise=0.01)
        half = replace(rig, fx=194, fy=194, cx=128, cy=98, width=256, height=192)
        room = synthetic.SyntheticSequence(synthetic.room(frames=40), half if small else rig, faults)
        others = [synthetic.SyntheticSequence(s(40), rig, faults) for s in (synthetic.street, synthetic.corridor)]
        self._places = (
            [(room, k) for k in (0, 10, 20, 30)] if small else [(s, 15) for s in (others[0], room, others[1])]
        )
        self._real = [] if small else [tspslam.datasets.motorcycle()]

    def __len__(self) -> int:
        return 4

    def __getitem__(self, place: int) -> tspslam.StereoPair:
        if place < len(self._real):
            return self._real[place]
        sequence, k = self._places[place - len(self._real)]
        return sequence[k]

    def truth(self, name: str) -> np.ndarray:
        for sequence, k in self._places:
            if name == f"{sequence.name}_{k:06d}":
                return sequence.geometry(k).disparity
        return tspslam.datasets.motorcycle_truth()


def reference_gradient(
    image: np.ndarray, uv: np.ndarray, complex_: tspslam.Complex, width: float = 0.5
) -> tuple[np.ndarray, np.ndarray]:
    """Gaussian-derivative gradient at each vertex, as a complex number, luminance/px, and its scale, px.

    The scale is `width` times the mean length of the vertex's edges.
    """
    i, j = complex_.edges.T
    length = np.linalg.norm(uv[i] - uv[j], axis=1)
    degree = np.bincount(complex_.edges.ravel(), minlength=len(uv))
    total = np.bincount(complex_.edges.ravel(), np.repeat(length, 2), minlength=len(uv))
    sigma = width * total / np.maximum(degree, 1)
    levels = np.geomspace(*np.percentile(sigma[degree > 0], [2, 98]), 8)
    nearest = np.abs(np.log(np.maximum(sigma, 1e-9))[:, None] - np.log(levels)).argmin(axis=1)
    gradient = np.zeros(len(uv), complex)
    for k, level in enumerate(levels):
        across, down = (gaussian_filter(image, level, order=order, mode="nearest") for order in ((0, 1), (1, 0)))
        at = uv[nearest == k].T[::-1]
        gradient[nearest == k] = map_coordinates(across, at, order=1) + 1j * map_coordinates(down, at, order=1)
    return gradient, levels[nearest]


def degrees_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """|arg a - arg b| in [0, 180], degrees."""
    return np.degrees(np.abs(np.angle(a * np.conj(b))))


def explained(K: np.ndarray, model: np.ndarray) -> float:
    """R²: the share of the variance that a model explains."""
    return 1 - ((K - model) ** 2).sum() / ((K - K.mean()) ** 2).sum()


def strongest(values: np.ndarray, ok: np.ndarray, share: float = 0.2) -> np.ndarray:
    """Which of those that are `ok` have the largest values."""
    return ok & (values >= np.quantile(values[ok], 1 - share))


def median_and_range(values: Sequence[float]) -> tuple[float, float, float]:
    """Median, least and largest over seeds; NaN where there is none."""
    known = np.asarray(values, float)[np.isfinite(values)]
    return (float(np.median(known)), float(known.min()), float(known.max())) if len(known) else (np.nan,) * 3


def columns(names: Sequence[str], rows: Sequence[Sequence]) -> dict[str, list]:
    """Rows as the columns of a table."""
    return {name: [row[k] for row in rows] for k, name in enumerate(names)}
