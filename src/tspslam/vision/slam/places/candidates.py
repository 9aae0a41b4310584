"""Keyframes of several maps that look alike: one index of all, which each keyframe asks once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....types import BoolArray, FloatArray
from ...features.binary import Descriptors
from .index import PlaceIndex
from .settings import LoopSettings

_ASKED = 50  # keyframes of other maps that one is told to look like, at most: ten times as many as are tried


class _Alike(NamedTuple):
    """Keyframes of two maps each, by their places among those of all, and how many words they share."""

    later: NDArray[np.int64]
    earlier: NDArray[np.int64]
    words: FloatArray

    def chosen(self, rows: NDArray[np.int64] | BoolArray) -> _Alike:
        return _Alike(self.later[rows], self.earlier[rows], self.words[rows])


def find_candidates(shown: Sequence[Sequence[Descriptors]], loops: LoopSettings) -> NDArray[np.int64]:
    """Find keyframes of several maps that may show the same place.

    Each keyframe is looked up once among those of all maps, and named with a few others (`lost_candidates`), however
    many maps there are. Any word in common can make a candidate, as nothing but its looks leads to another map: where
    two maps share no keyframes of `min_words`, they are compared if either has few others that share more with it. A
    pair of `min_words` makes candidates of the keyframes beside the later one too: for these, at most twice as many
    more. The first and the last keyframes of maps that are compared, and of those beside each other in the given order,
    are always tried, four pairs each: where a recording was cut, one map begins where the other ends. The tries of
    first and last keyframes grow with the maps that theirs is compared with.

    Parameters
    ----------
    shown : sequence of sequences of (N, P) uint64
        Descriptors of what each keyframe of each map shows; a map has one keyframe or more.
    loops : LoopSettings
        How many places are tried for each keyframe, and maps for each map that is sure of none (`lost_candidates`), and
        what makes a pair sure (`min_words`).

    Returns
    -------
    (C, 4) int64
        Map and keyframe there, map and keyframe here: of two maps the earlier one first, pairs of maps ascending, then
        keyframes of the later one; the places of each in the order in which they are to be tried.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> one, other = ([rng.integers(0, 2**63, (20, 4), dtype=np.uint64) for _ in range(5)] for _ in range(2))
    >>> other[3] = one[1] ^ np.uint64(1)
    >>> [0, 1, 1, 3] in find_candidates([one, other], LoopSettings()).tolist()
    True
    """
    starts = np.cumsum([0, *map(len, shown)])
    map_of = np.repeat(np.arange(len(shown)), np.diff(starts))
    found = _look_up([view for views in shown for view in views], map_of, loops.lost_candidates)
    found = found.chosen(_is_compared(found, map_of, loops))
    found = found.chosen(_best(found, map_of, loops))
    alike = np.column_stack([found.earlier, found.later])
    beside = _beside(alike[found.words >= loops.min_words], map_of)
    return _in_order(np.concatenate([alike, beside, _ends(alike, map_of, starts)]), map_of, starts)


def _look_up(views: Sequence[Descriptors], map_of: NDArray[np.int64], most: int) -> _Alike:
    """Pairs of keyframes that look alike, as either has it: of each other map so many for a keyframe."""
    index, pairs, words = PlaceIndex(), [np.empty((0, 2), np.int64)], [np.empty(0)]
    for k, view in enumerate(views):
        index.add(k, view)
    for k, view in enumerate(views):
        at, count = index.query(view, len(views))
        is_other = map_of[at] != map_of[k]
        at, count = at[is_other], count[is_other]
        kept = np.flatnonzero(_rank(map_of[at]) < most)[:_ASKED]
        pairs.append(np.column_stack([np.maximum(at[kept], k), np.minimum(at[kept], k)]))
        words.append(count[kept])
    both, own = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    best = np.zeros(len(both))
    np.maximum.at(best, own.ravel(), np.concatenate(words))
    return _Alike(both[:, 0], both[:, 1], best)


def _rank(of: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many of the same value are before each."""
    order = np.argsort(of, kind="stable")
    is_first = np.diff(of[order], prepend=-1) != 0
    first = np.maximum.accumulate(np.where(is_first, np.arange(len(of)), 0))
    rank = np.empty(len(of), np.int64)
    rank[order] = np.arange(len(of)) - first
    return rank


def _is_compared(found: _Alike, map_of: NDArray[np.int64], loops: LoopSettings) -> BoolArray:
    """Which pairs are of two maps that share a sure one, or of which either shares little more with others."""
    maps = np.column_stack([map_of[found.earlier], map_of[found.later]])
    pairs, own = np.unique(maps, axis=0, return_inverse=True)
    own = own.ravel()
    total, most = np.bincount(own, found.words, len(pairs)), np.zeros(len(pairs))
    np.maximum.at(most, own, found.words)
    order, is_near = np.lexsort((np.arange(len(pairs)), -total)), np.zeros(len(pairs), np.bool_)
    ends = pairs[order].ravel()  # both maps of a pair, best pairs first
    np.logical_or.at(is_near, np.repeat(order, 2), _rank(ends) < loops.lost_candidates)
    return np.asarray((is_near | (most >= loops.min_words))[own])


def _best(found: _Alike, map_of: NDArray[np.int64], loops: LoopSettings) -> NDArray[np.int64]:
    """The pairs that are tried: few of each later keyframe, the sure ones first, in turns of several maps."""
    order = np.lexsort((found.earlier, -found.words, found.later))
    later, earlier = found.later[order], found.earlier[order]
    turn = _rank(later * (len(map_of) + 1) + map_of[earlier])
    is_doubted = found.words[order] < loops.min_words
    order = order[np.lexsort((earlier, -found.words[order], turn, is_doubted, later))]
    return order[_rank(found.later[order]) < loops.lost_candidates]


def _beside(alike: NDArray[np.int64], map_of: NDArray[np.int64]) -> NDArray[np.int64]:
    """The same places for the keyframes beside the later ones."""
    own = np.concatenate([alike, alike])
    moved = own + np.repeat([[0, -1], [0, 1]], len(alike), axis=0)
    inside = (moved[:, 1] >= 0) & (moved[:, 1] < len(map_of))
    moved, own = moved[inside], own[inside]
    return moved[map_of[moved[:, 1]] == map_of[own[:, 1]]]


def _ends(alike: NDArray[np.int64], map_of: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """First and last keyframes of maps that are compared, or beside each other in the given order."""
    count = len(starts) - 1
    beside = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    pairs = np.unique(np.concatenate([beside, map_of[alike]]), axis=0)
    first, last = starts[:-1][pairs], starts[1:][pairs] - 1
    ends = [(one[:, 0], other[:, 1]) for other in (first, last) for one in (first, last)]
    return np.concatenate([np.column_stack(pair) for pair in ends])


def _in_order(tried: NDArray[np.int64], map_of: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Candidates, each once, by maps and keyframes; those of a keyframe as they come."""
    first = np.sort(np.unique(tried, axis=0, return_index=True)[1])
    earlier, later = tried[first].T
    here, there = map_of[earlier], map_of[later]
    order = np.lexsort((np.arange(len(first)), later, there, here))
    return np.column_stack([here, earlier - starts[here], there, later - starts[there]])[order]
