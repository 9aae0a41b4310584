"""When a rig was knocked: the offset of each keyframe's disparities over a path, and where it steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ....types import FloatArray
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..least_squares.offsets import WEAK, Estimate, PieceEquations

_ENDS = 2  # keyframes on either side of a step at least: a single one may be wrong by itself
_FEWEST = 4  # changes between keyframes at least: their median is then none of a step's
_FINEST = 1e-3  # px; no change is known to less
_COMMON = 10  # landmarks that tell a median change at least
_NORMAL = 0.6745  # median of absolute values over the standard deviation, of normal values
LEAST_DEPTH = 1e-3  # m; what is nearer is not seen
_TAIL = 0.00135  # probability beyond three standard deviations, on one side


@dataclass(frozen=True)
class OffsetStep:
    """The most certain step of the offset over a path, at a time that was not known.

    Attributes
    ----------
    size : Estimate
        Offset after it less that before, px, were its time known.
    before, after : int
        Frames of the keyframes that it lies between.
    tried : int
        At how many times it was looked for.
    """

    size: Estimate
    before: int
    after: int
    tried: int

    def exceeds(self, least: float) -> bool:
        """Tell whether it is large, and as certain as three deviations are where one time is tried (Bonferroni).

        Parameters
        ----------
        least : float
            px.

        Returns
        -------
        bool

        Examples
        --------
        >>> step = OffsetStep(Estimate(-0.9, 0.26), 17, 20, tried=10)
        >>> step.exceeds(0.5), OffsetStep(Estimate(-0.9, 0.2), 17, 20, tried=10).exceeds(0.5)
        (False, True)
        """
        from scipy.special import ndtri

        return self.size.exceeds(least, float(-ndtri(_TAIL / self.tried)))


class _Series(NamedTuple):
    """Offsets of keyframes in a row, (K,) px, with their covariance, (K, K) px²."""

    offset: FloatArray
    covariance: FloatArray

    @property
    def variance_of_changes(self) -> FloatArray:
        """That of the change from each keyframe to the next, (K - 1,) px²."""
        C = self.covariance
        return np.asarray(np.diag(C)[1:] + np.diag(C)[:-1] - 2 * np.diag(C, 1))


def find_step(pieces: Mapping[int, PieceEquations], map_: Map) -> OffsetStep | None:
    """Find where the offset of the disparities steps the most, in its own deviations.

    The offsets of the keyframes, o = c + s [k >= t] + walk + noise, are fitted for each t by generalised least squares.
    The noise is what the votes of the points give; the walk, by which what is wrong in a lens shows as scenes change,
    has the variance a keyframe that the median change from one to the next has beyond that noise. How large the step
    is, is then told by the landmarks that the keyframes before and after it both see: those that a step moves out of
    the gates of the tracking are missing, so a mean is too small. By what the two differ, the step is uncertain.

    Parameters
    ----------
    pieces : mapping of int to PieceEquations
        Of keyframes in a row, by the row of the first.
    map_ : Map
        Its keyframes.

    Returns
    -------
    OffsetStep or None
        None where there are too few keyframes.
    """
    series = {first: _series(piece) for first, piece in pieces.items()}
    changes = np.concatenate([np.diff(one.offset) for one in series.values()])
    tried = sum(max(0, len(one.offset) - 2 * _ENDS + 1) for one in series.values())
    if len(changes) < _FEWEST or not tried:
        return None
    noise = np.median(np.concatenate([one.variance_of_changes for one in series.values()]))
    walk = max(0.0, (float(np.median(np.abs(changes))) / _NORMAL) ** 2 - float(noise))
    found = [(first, *_best(one, walk)) for first, one in series.items() if len(one.offset) >= 2 * _ENDS]
    first, t, size = max(found, key=lambda one: abs(one[2].value) / one[2].std)
    before, after = map_.keyframes[first + t - 1 : first + t + 1]
    seen = _median_change(map_, before, after)
    if seen is not None:
        size = Estimate(seen, float(np.hypot(size.std, seen - size.value)))
    return OffsetStep(size, before.index, after.index, tried)


def _series(piece: PieceEquations) -> _Series:
    """The offset of each keyframe of a piece; the covariance as observations have it, as large as votes scatter."""
    count, more = piece.offsets, len(piece.right) - piece.offsets
    C = np.asarray(np.linalg.inv(piece.normal[:count, :count] + WEAK * np.eye(count)), np.float64)
    offset: FloatArray = C @ piece.right[:count]
    votes = piece.votes(np.vstack([C, np.zeros((more, count))]), np.concatenate([offset, np.zeros(more)]))
    said = float(_Series(offset, C).variance_of_changes.mean())
    scattered = piece.share * float((np.diff(votes, axis=1) ** 2).sum(axis=0).mean())
    return _Series(offset, C * (max(scattered, _FINEST**2) / said))


def _best(series: _Series, walk: float) -> tuple[int, Estimate]:
    """The keyframe before which the step is the most certain, and the step, px."""
    count = len(series.offset)
    place = np.arange(count)
    P = np.linalg.inv(series.covariance + walk * np.minimum(place[:, None], place))
    tail = np.cumsum(P[::-1, ::-1], axis=0).cumsum(axis=1)[::-1, ::-1]  # sums of P from (i, j) on
    right = np.cumsum((P @ series.offset)[::-1])[::-1]
    share = tail[0] / tail[0, 0]
    information = np.diag(tail) - share * tail[0]
    size = right - share * right[0]
    times = slice(_ENDS, count - _ENDS + 1)
    t = _ENDS + int(np.argmax(size[times] ** 2 / information[times]))
    return t, Estimate(float(size[t] / information[t]), float(information[t] ** -0.5))


def _median_change(map_: Map, before: Keyframe, after: Keyframe) -> float | None:
    """Median by which disparities change more than the motion says, px, of the farther half of the common landmarks.

    The farther a point, the less a motion that is wrong changes its disparity.
    """
    rows, *places = np.intersect1d(before.landmark, after.landmark, return_indices=True)
    measured, expected = [], []
    for frame, place in zip((before, after), places, strict=True):
        depth = (map_.xyz[rows] - frame.T_world_camera[:3, 3]) @ frame.T_world_camera[:3, 2]
        measured.append(frame.disparity[place])
        expected.append(map_.rig.fx * map_.rig.baseline / np.maximum(depth, LEAST_DEPTH))
    change = np.subtract(*measured[::-1]) - np.subtract(*expected[::-1])
    known = np.isfinite(change)
    if known.sum() < 2 * _COMMON:
        return None
    far = np.median(expected[0][known])
    return float(np.median(change[known & (expected[0] <= far)]))
