"""Compiled loops of the halo: rows of faces become vertices of a piece."""

from __future__ import annotations

import numpy as np

from ..._jit import kernel


@kernel
def faces_among(faces, rows):  # type: ignore[no-untyped-def]
    """Which faces have a corner among `rows`, ascending, at least one."""
    found, count = np.empty(faces.shape[0], np.int64), 0
    low, high = rows[0], rows[-1]
    is_run = high - low + 1 == rows.shape[0]
    for f in range(faces.shape[0]):
        for corner in range(3):
            row = faces[f, corner]
            if low <= row <= high and (is_run or rows[np.searchsorted(rows, row)] == row):
                found[count] = f
                count += 1
                break
    return found[:count]


@kernel
def rows_outside(faces, first, last):  # type: ignore[no-untyped-def]
    """Rows that faces name beyond `first` to `last`, as they come, with repetitions."""
    found, count = np.empty(faces.size, np.int64), 0  # pages that are not written take no memory
    for f in range(faces.shape[0]):
        for corner in range(3):
            found[count] = faces[f, corner]
            count += faces[f, corner] < first or faces[f, corner] >= last
    return found[:count].copy()


@kernel
def local_faces(faces, order, first, last, outside, place):  # type: ignore[no-untyped-def]
    """Faces in the order given, each row by its place: rows from `first` to `last` come first, then `outside`."""
    found = np.empty((order.shape[0], 3), np.int32)
    for f in range(order.shape[0]):
        for corner in range(3):
            row = faces[order[f], corner]
            if first <= row < last:
                found[f, corner] = place[row - first]
            else:
                found[f, corner] = place[last - first + np.searchsorted(outside, row)]
    return found


@kernel
def join_parts(faces, parent):  # type: ignore[no-untyped-def]
    """Join the parts that the corners of faces are in; a part is told by its lowest row, up from parent to parent."""
    for f in range(faces.shape[0]):
        for corner in range(3):
            one, other = faces[f, 0], faces[f, corner]
            while parent[one] != one:
                parent[one] = parent[parent[one]]
                one = parent[one]
            while parent[other] != other:
                parent[other] = parent[parent[other]]
                other = parent[other]
            parent[max(one, other)] = min(one, other)
