"""Compiled loops over tracks: which landmarks are one, and what is left of each."""

from __future__ import annotations

import numpy as np

from .._jit import kernel
from ..topology._homology import root


@kernel
def unite(pairs, start, keyframe, uv, distance):  # type: ignore[no-untyped-def]
    """Landmark that each landmark is, of the lowest number, after pairs are joined in order.

    A pair is not joined where a keyframe sees the two more than `distance` px apart. Rows ``start[i]`` to
    ``start[i + 1]`` of the sightings are those of landmark i, by keyframe.
    """
    count = start.shape[0] - 1
    parent, after, last = np.arange(count), np.full(count, -1, np.int64), np.arange(count)
    for r in range(pairs.shape[0]):
        a, b = root(parent, pairs[r, 0]), root(parent, pairs[r, 1])
        if a == b:
            continue
        if a > b:
            a, b = b, a
        good = True
        i = a
        while i >= 0 and good:
            j = b
            while j >= 0 and good:
                p, q = start[i], start[j]
                while p < start[i + 1] and q < start[j + 1]:
                    if keyframe[p] < keyframe[q]:
                        p += 1
                    elif keyframe[p] > keyframe[q]:
                        q += 1
                    else:
                        u, v = uv[p, 0] - uv[q, 0], uv[p, 1] - uv[q, 1]
                        if u * u + v * v > distance * distance:
                            good = False
                        p += 1
                        q += 1
                j = after[j]
            i = after[i]
        if good:
            parent[b] = a
            after[last[a]], last[a] = b, last[b]
    for i in range(count):
        parent[i] = root(parent, i)
    return parent
