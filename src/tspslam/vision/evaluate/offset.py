"""How far the clocks of two paths are apart, from how fast they turn and move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...types import FloatArray, Trajectory
from ..se3 import rotation_angle
from ._matching import Known, checked_path

_FEWEST = 20  # steps that overlap: fewer make no shape
# Between poses noise is smoothed, at some offsets more than at others if steps go with the poses: so they do not.
_STEP = (1 + 5**0.5) / 2  # of the longer interval between poses
_MOST = 1 << 15  # steps of a path: a longer one has longer steps
_GAP = 3.0  # steps without a pose: what lies within is not known
_OVERLAP = 0.5  # of the shorter path's known steps, that must lie on the other
_STILL = 1e-5  # rad/s, m/s: a rate that varies less does not vary; stamps since 1970 are rounded to 2e-7 s
_FLOOR = 0.01  # mismatch that no two measured paths are below
_CONTRAST = 0.5  # of the mismatch at the next best offset: above, the best is one of many
_REACH, _FINE = 1.5, 61  # steps around the best whole step that are searched, and how many places there
_ONE_EVENT = 0.9  # of what fixes the offset: if a part of the overlap holds more, no other part confirms it
_BLOCKS = 8  # parts of the overlap, of which each is left out in turn


@dataclass(frozen=True)
class Offset:
    """What `find_offset` found.

    Attributes
    ----------
    seconds : float
        To be added to the estimate's stamps, s.
    sigma_s : float
        Its standard deviation, s: by leaving out an eighth of the overlap in turn (jackknife).
    step_s : float
        The interval over which motions were compared, s.
    mismatch : float
        Mean squared difference of the rates at this offset, over their variance: 0 for equal ones, about 1 for
        unrelated ones.
    contrast : float
        That over the mismatch at the next best offset: 0 is clear, 1 is a guess.
    """

    seconds: float
    sigma_s: float
    step_s: float
    mismatch: float
    contrast: float


class _Rates(NamedTuple):
    """Rates of a path at even steps from a stamp on: of turning, rad/s, and of moving, m/s; NaN in gaps."""

    first: float
    values: FloatArray


def find_offset(estimate: Trajectory, reference: Trajectory) -> Offset:
    """Find the offset of two paths' clocks, at which they turn and move most alike.

    How fast a camera turns and moves depends neither on the world that its poses are in nor on when its clock began.
    Both rates are sampled at 1.6 times the longer of the two median intervals; their mean squared difference, over
    their variance, is computed at all offsets at which at least half of the shorter path lies on the other, and refined
    between steps around the least of them.

    Parameters
    ----------
    estimate, reference : Trajectory
        Poses of one camera, each in a world of its own, with stamps in seconds of clocks of their own.

    Returns
    -------
    Offset

    Raises
    ------
    InputError
        If the paths are too short, turn and move too evenly, fit at many offsets alike, vary in one eighth of the
        overlap alone, or fix the offset no better than to a step.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> stamps, poses = 0.1 * np.arange(200), np.tile(np.eye(4), (200, 1, 1))
    >>> turns = np.cumsum(np.random.default_rng(0).normal(0, 0.02, 200))
    >>> poses[:, :3, :3] = Rotation.from_euler("y", (np.cumsum(turns) * 0.1)[:, None]).as_matrix()
    >>> found = find_offset(Trajectory(stamps - 1000, poses), Trajectory(stamps, poses))
    >>> round(found.seconds, 3)
    1000.0
    """
    known, truth = checked_path(estimate, "estimate"), checked_path(reference, "reference")
    step = _step(known, truth)
    own, other = _rates(known, step), _rates(truth, step)
    weight = _weights(own, other)
    lag, contrast = _whole_lag(own.values * weight, other.values * weight)
    rough = other.first - own.first + lag * step
    offsets = rough + step * np.linspace(-_REACH, _REACH, _FINE)
    blocks = _blocks(known, other, weight, step, offsets)
    total = blocks.sum(axis=2)
    _check_events(blocks)
    seconds = _lowest(offsets, total)
    parts = np.array([_lowest(offsets, total - blocks[:, :, k]) for k in range(_BLOCKS)])
    sigma = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * ((parts - parts.mean()) ** 2).sum()))
    if sigma > step or abs(seconds - rough) > (_REACH - 0.1) * step:
        raise InputError(f"offset: is known to {sigma:.2g} s only, expected motions that fix it to {step:.3g} s")
    return Offset(seconds, sigma, step, float((total[:, 0] / total[:, 1]).min()), contrast)


def _step(known: Known, truth: Known) -> float:
    paths = ("estimate", known.stamps), ("reference", truth.stamps)
    for name, stamps in paths:
        if len(stamps) < _FEWEST:
            raise InputError(f"offset: the {name} has {len(stamps)} poses that are known, expected {_FEWEST} or more")
    return float(max(max(_STEP * np.median(np.diff(stamps)), np.ptp(stamps) / _MOST) for _, stamps in paths))


def _rates(path: Known, step: float) -> _Rates:
    count = int(np.ptp(path.stamps) / step) + 1
    first = float(path.stamps[0])
    return _Rates(first, _rates_at(path, first + step * np.arange(count, dtype=np.float64), step))


def _rates_at(path: Known, stamps: FloatArray, step: float) -> FloatArray:
    """Rates of a path from each of some even stamps to the next, (n, 2); NaN beyond its ends and in gaps."""
    from scipy.spatial.transform import Rotation, Slerp

    inside = np.clip(stamps, path.stamps[0], path.stamps[-1])
    R = Slerp(path.stamps - path.stamps[0], Rotation.from_matrix(path.poses[:, :3, :3]))(inside - path.stamps[0])
    matrices = R.as_matrix()
    xyz = np.stack([np.interp(inside, path.stamps, path.poses[:, i, 3]) for i in range(3)], axis=1)
    turned = rotation_angle(np.swapaxes(matrices[:-1], 1, 2) @ matrices[1:])
    rates: FloatArray = np.stack([turned, np.linalg.norm(np.diff(xyz, axis=0), axis=1)], axis=1) / step
    after = np.clip(np.searchsorted(path.stamps, inside), 1, len(path.stamps) - 1)
    is_known = (inside == stamps) & (path.stamps[after] - path.stamps[after - 1] <= _GAP * step)
    rates[~(is_known[1:] & is_known[:-1])] = np.nan
    return rates


def _weights(own: _Rates, other: _Rates) -> FloatArray:
    """One over the spread of each rate; 0 for one that does not vary in either path."""
    known = [rates.values[~np.isnan(rates.values).any(axis=1)] for rates in (own, other)]
    if min(map(len, known)) < _FEWEST:
        raise InputError(f"offset: a path has fewer than {_FEWEST} steps without a gap, expected as many or more")
    spread = np.sqrt(sum(values.var(axis=0) for values in known))
    if (spread < _STILL).all():
        raise InputError("offset: both paths turn and move evenly, expected motions that vary")
    return np.where(spread < _STILL, 0.0, 1 / np.maximum(spread, _STILL)) / np.sqrt((spread >= _STILL).sum())


def _whole_lag(own: FloatArray, other: FloatArray) -> tuple[int, float]:
    """By how many steps the first lags, and the mismatch there over that at the next best lag."""
    mask = [np.isfinite(values.sum(axis=1)) for values in (own, other)]
    filled = [np.where(known[:, None], values, 0.0) for known, values in zip(mask, (own, other), strict=True)]
    counts = _correlated(mask[0].astype(float), mask[1].astype(float))
    squares = _correlated((filled[0] ** 2).sum(axis=1), mask[1].astype(float))
    squares += _correlated(mask[0].astype(float), (filled[1] ** 2).sum(axis=1))
    products = sum(_correlated(filled[0][:, k], filled[1][:, k]) for k in range(own.shape[1]))
    enough = np.rint(counts) >= max(_FEWEST, _OVERLAP * min(known.sum() for known in mask))
    if not enough.any():
        raise InputError("offset: at no offset half of the shorter path lies on the other, expected paths without gaps")
    cost = np.where(enough, np.maximum(squares - 2 * products, 0) / np.maximum(counts, 1), np.inf)
    best = int(np.argmin(cost))
    after = _next_best(cost, best)
    contrast = float((cost[best] + _FLOOR) / (after + _FLOOR))
    if not contrast < _CONTRAST:
        raise InputError(
            f"offset: the next best fits nearly as well (mismatch {cost[best]:.2g}, {after:.2g}), "
            "expected motions that fit at one alone"
        )
    return best - (len(own) - 1), contrast


def _correlated(a: FloatArray, b: FloatArray) -> FloatArray:
    """Sums of ``a[k] b[k + lag]`` for lags from ``1 - len(a)`` to ``len(b) - 1``."""
    size = len(a) + len(b) - 1
    made: FloatArray = np.fft.irfft(np.fft.rfft(a[::-1], size) * np.fft.rfft(b, size), size)
    return made


def _next_best(cost: FloatArray, best: int) -> float:
    """The least cost outside of the valley around the best; 0 where nothing is outside."""
    low, high = best, best
    while low > 0 and cost[low - 1] > cost[low]:
        low -= 1
    while high < len(cost) - 1 and cost[high + 1] > cost[high]:
        high += 1
    outside = np.concatenate([cost[:low], cost[high + 1 :]])
    finite = outside[np.isfinite(outside)]
    return float(finite.min()) if finite.size else 0.0


def _blocks(known: Known, other: _Rates, weight: FloatArray, step: float, offsets: FloatArray) -> FloatArray:
    """Sums of squared differences at offsets, and how many there are, of parts of the overlap: (offsets, 2, parts)."""
    stamps = other.first + step * np.arange(len(other.values) + 1, dtype=np.float64)
    off = [(((_rates_at(known, stamps - x, step) - other.values) * weight) ** 2).sum(axis=1) for x in offsets]
    middle = np.flatnonzero(~np.isnan(off[len(off) // 2]))
    edges = middle[np.arange(1, _BLOCKS) * len(middle) // _BLOCKS]  # as many steps in each part
    block = np.searchsorted(edges, np.arange(len(stamps) - 1), "right")
    found = np.zeros((len(offsets), 2, _BLOCKS))
    for row, values in zip(found, off, strict=True):
        at = np.flatnonzero(~np.isnan(values))
        row[:] = np.bincount(block[at], values[at], _BLOCKS), np.bincount(block[at], minlength=_BLOCKS)
    return found


def _check_events(blocks: FloatArray) -> None:
    """Refuse differences of which one part alone tells one offset from another: leaving parts out then says nothing."""
    cost = blocks.sum(axis=2)
    best = int(np.argmin(cost[:, 0] / np.maximum(cost[:, 1], 1)))
    rise = np.maximum(blocks[0, 0] + blocks[-1, 0] - 2 * blocks[best, 0], 0)
    if rise.max() > _ONE_EVENT * rise.sum():
        raise InputError(
            f"offset: {100 * rise.max() / rise.sum():.0f} % of what fixes it is in one of {_BLOCKS} parts of the "
            "overlap, expected motions that vary in several"
        )


def _lowest(offsets: FloatArray, total: NDArray[np.float64]) -> float:
    """Where the parabola through the least mean and its neighbours is least."""
    cost = total[:, 0] / np.maximum(total[:, 1], 1)
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    left, middle, right = cost[k - 1 : k + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return float(offsets[k] + np.clip(shift, -1, 1) * (offsets[1] - offsets[0]))
