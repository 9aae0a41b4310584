"""Compiled loops of the map: chains of sightings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import kernel

Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]


@kernel
def walk_chains(rows: Int64, last: Int32, before: Int32, at: Int64, entry: Int32) -> int:
    """Find all sightings of some landmarks: for each, which of `rows` is seen, and its place in the table.

    A chain begins at ``last[row]`` and goes on at ``before[entry]``; a negative number ends it. Returns how many there
    are; as many of them as there is room for are filled in.
    """
    count = 0
    for i in range(rows.shape[0]):
        place = last[rows[i]]
        while place >= 0:
            if count < at.shape[0]:
                at[count], entry[count] = i, place
            count += 1
            place = before[place]
    return count
