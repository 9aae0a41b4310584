"""Rows of a binary or text PLY whose lists differ in length, read a length at a time and not a row at a time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._ply_header import Element, Property

Columns = dict[str, NDArray[Any]]
Exact = Callable[[NDArray[np.float64], str, Element], NDArray[Any]]
Take = Callable[[NDArray[np.int64], list[int]], dict[str, NDArray[Any]]]
_KINDS = 64  # of rows by the lengths of their lists: more are read row by row
_LONGEST = 1 << 10  # of a list that is read in one go
_LISTS = 6  # of an element: kinds of rows are told by numbers of 63 bits
_FEWEST = 3  # corners


def read_ragged(data: bytes, start: int, element: Element, order: str, corners: Property) -> tuple[Columns, int] | None:
    """Read a binary element with lists; None where a row is not as it should be, or they are of too many kinds."""
    found = _places(data, start, element, order, corners)
    if found is None:
        return None
    places, lengths, stop = found
    all_bytes = np.frombuffer(data, np.uint8)

    def take(rows: NDArray[np.int64], kind: list[int]) -> dict[str, NDArray[Any]]:
        dtype = _row_type(element, order, kind)
        table = all_bytes[places[rows, None] + np.arange(dtype.itemsize)].view(dtype)[:, 0]
        return {str(name): table[name] for name in dtype.names or ()}

    columns = _gathered(take, lengths, element, corners)
    return None if columns is None else (columns, stop)


def read_ragged_words(
    words: NDArray[np.float64], start: int, element: Element, corners: Property, exact: Exact
) -> tuple[Columns, int] | None:
    """Read an element of a text with lists as `read_ragged`; `exact` makes numbers those of a type."""
    found = _places_of_words(words, start, element, corners)
    if found is None:
        return None
    places, lengths, stop = found

    def take(rows: NDArray[np.int64], kind: list[int]) -> dict[str, NDArray[Any]]:
        taken, at, left = {}, places[rows], iter(kind)
        for each in element.properties:
            if each.length_code is None:
                taken[each.name] = exact(words[at], each.code, element)
                at = at + 1
                continue
            count = next(left)
            taken[each.name] = exact(words[at[:, None] + 1 + np.arange(count)], each.code, element)
            at = at + 1 + count
        return taken

    columns = _gathered(take, lengths, element, corners)
    return None if columns is None else (columns, stop)


def _gathered(take: Take, lengths: NDArray[np.int64], element: Element, corners: Property) -> Columns | None:
    """Columns of the scalars and of the corners; rows are taken together whose lists are as long."""
    key_of = lengths @ (_LONGEST + 1) ** np.arange(lengths.shape[1])  # a number for each kind of row
    _, example, of = np.unique(key_of, return_index=True, return_inverse=True)
    if len(example) > _KINDS:
        return None
    corner_counts = lengths[:, element.lists.index(corners)]
    columns: Columns = {
        each.name: np.empty(element.count, each.code) for each in element.properties if each.length_code is None
    }
    first = np.cumsum(corner_counts) - corner_counts
    items = np.empty(int(corner_counts.sum()), corners.code)
    for kind, row in enumerate(example.tolist()):
        rows = np.flatnonzero(of == kind)
        taken = take(rows, lengths[row].tolist())
        for name, column in columns.items():
            column[rows] = taken[name]
        found = taken[corners.name]
        items[first[rows, None] + np.arange(found.shape[1])] = found
    return columns | {corners.name: items, f"{corners.name} length": corner_counts.copy()}


def _places(
    data: bytes, start: int, element: Element, order: str, corners: Property
) -> tuple[NDArray[np.int64], NDArray[np.int64], int] | None:
    """Where each row begins, the lengths of its lists, and where the last ends; None if one is not as it should be."""
    steps, tail = _steps(element, corners)
    if len(steps) > _LISTS:
        return None
    if len(steps) == 1 and steps[0][1:3] == (1, False):
        return _places_of_bytes(data, start, element.count, steps[0][0], steps[0][3], tail)
    names = "little" if order == "<" else "big"
    starts, lengths, at, size = [0] * element.count, [], start, len(data)
    for row in range(element.count):
        starts[row] = at
        for skip, width, is_signed, item, least in steps:
            at += skip
            stop = at + width
            if width == 1 and stop <= size:
                count = data[at]
                count -= 256 if is_signed and count > 127 else 0
            else:
                count = int.from_bytes(data[at:stop], names, signed=is_signed)  # type: ignore[arg-type]
            at = stop + count * item
            if not least <= count <= _LONGEST or at > size:
                return None
            lengths.append(count)
        at += tail
    if at > size:
        return None
    shape = element.count, len(steps)
    return np.array(starts, np.int64), np.array(lengths, np.int64).reshape(shape), at


def _places_of_bytes(
    data: bytes, start: int, rows: int, skip: int, item: int, tail: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int] | None:
    """As `_places`, of rows with one list, the corners, whose length is a byte: the most usual."""
    lengths = bytearray(rows)
    at, last, fixed = start + skip, len(data) - 1, skip + 1 + tail
    for row in range(rows):
        if at > last:
            return None
        count = data[at]
        lengths[row] = count
        at += fixed + count * item
    counts = np.frombuffer(lengths, np.uint8).astype(np.int64)
    ends = start + np.cumsum(fixed + counts * item)
    if rows and (ends[-1] > len(data) or counts.min() < _FEWEST):
        return None
    return (
        np.concatenate([[start], ends[:-1]]).astype(np.int64)[:rows],
        counts[:, None],
        int(ends[-1]) if rows else start,
    )


def _places_of_words(
    words: NDArray[np.float64], start: int, element: Element, corners: Property
) -> tuple[NDArray[np.int64], NDArray[np.int64], int] | None:
    """As `_places`, counted in words."""
    if len(element.lists) > _LISTS:
        return None
    alone = [each.length_code is None for each in element.properties]
    lists = [k for k, is_alone in enumerate(alone) if not is_alone]
    skips = [b - a - 1 for a, b in pairwise([-1, *lists])]
    steps = [(skip, _FEWEST if element.properties[k] is corners else 0) for skip, k in zip(skips, lists, strict=True)]
    tail, size = len(alone) - 1 - lists[-1], len(words)
    starts, lengths, at = [0] * element.count, [], start
    for row in range(element.count):
        starts[row] = at
        for skip, least in steps:
            at += skip
            count = words[at] if at < size else -1.0
            if not (least <= count <= _LONGEST and count == int(count)):
                return None
            lengths.append(int(count))
            at += 1 + int(count)
        at += tail
        if at > size:
            return None
    shape = element.count, len(steps)
    return np.array(starts, np.int64), np.array(lengths, np.int64).reshape(shape), at


def _steps(element: Element, corners: Property) -> tuple[list[tuple[int, int, bool, int, int]], int]:
    """For each list: bytes before its length, of its length, whether that has a sign, of an item, and the fewest."""
    steps, skip = [], 0
    for each in element.properties:
        if each.length_code is None:
            skip += int(each.code[1])
            continue
        width, item = int(each.length_code[1]), int(each.code[1])
        steps.append((skip, width, each.length_code[0] == "i", item, _FEWEST if each is corners else 0))
        skip = 0
    return steps, skip


def _row_type(element: Element, order: str, lengths: list[int]) -> np.dtype[Any]:
    """Type of a row whose lists have so many values."""
    parts: list[tuple[Any, ...]] = []
    left = iter(lengths)
    for each in element.properties:
        if each.length_code is None:
            parts.append((each.name, order + each.code))
        else:
            parts += [(f"{each.name} length", order + each.length_code), (each.name, order + each.code, (next(left),))]
    return np.dtype(parts)
