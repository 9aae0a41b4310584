"""Parts of a map: keyframes that stand to one another as was seen; where two parts do is a guess."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from .keyframe import Keyframe

_index_of = attrgetter("index")


def part_seen(frames: Sequence[Keyframe], seen_by: NDArray[np.int64]) -> int:
    """Find the part of the map that a view shows.

    Parameters
    ----------
    frames : sequence of Keyframe
        Those of the map.
    seen_by : (S,) int64
        For each landmark of the view, the numbers of the frames of those that see it.

    Returns
    -------
    int
        The part of most of them; a new one where there is none, 0 the first.
    """
    if not len(seen_by):
        return 1 + max((frame.part for frame in frames), default=-1)
    numbers, count = np.unique(seen_by, return_counts=True)
    places = [bisect_left(frames, index, key=_index_of) for index in numbers.tolist()]
    return int(np.argmax(np.bincount([frames[k].part for k in places], count)))


def join_parts(frames: Sequence[Keyframe], place: int, other: int) -> list[Keyframe]:
    """Make one of the parts that two keyframes are in; it has the lower number.

    Parameters
    ----------
    frames : sequence of Keyframe
        Those of the map.
    place, other : int
        Which two.

    Returns
    -------
    list of Keyframe
        The same objects where nothing is changed.
    """
    kept, gone = sorted((frames[place].part, frames[other].part))
    parts = [kept if frame.part == gone else frame.part for frame in frames]
    starts = [False, *(part != before for before, part in pairwise(parts))]
    starts[0] = frames[0].is_start
    return [
        frame if (frame.part, frame.is_start) == (part, is_start) else replace(frame, part=part, is_start=is_start)
        for frame, part, is_start in zip(frames, parts, starts, strict=True)
    ]
