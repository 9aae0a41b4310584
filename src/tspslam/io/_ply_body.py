"""The data of a PLY file: rows of numbers and lists, as text or binary."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ._ply_header import Element, Header, Property
from ._ply_ragged import read_ragged, read_ragged_words
from ._words import words_of

Columns = dict[str, NDArray[Any]]
_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_ALIKE = 1 << 10  # corners of faces that are read in one go; larger ones are read row by row
FACES = ("face", "tristrips")  # elements that have corners
_CORNERS = ("vertex_indices", "vertex_index")


class _EndError(InputError):
    """The data end within an element."""


def corners_of(element: Element) -> Property | None:
    """Return the list property that holds the corners of the faces, or of strips of them."""
    return next((each for each in element.lists if element.name in FACES and each.name in _CORNERS), None)


def read_elements(data: bytes, header: Header) -> dict[str, Columns]:
    """Return the columns of every element: scalars, the faces' corners in a row and their lengths; no other lists."""
    read = _read_text if header.order == "" else _read_binary
    return read(data, header)


def _read_text(data: bytes, header: Header) -> dict[str, Columns]:
    body = data[header.size :]
    for element in header.elements:
        if element.properties and element.count > len(body):
            raise InputError(f"claims {element.count} rows of {element.name[:80]}, more than the file can hold")
    words, is_whole = _text_numbers(body)
    found, start = {}, 0
    for element in header.elements:
        try:
            found[element.name], start = _text_element(words, start, element)
        except _EndError as error:
            if is_whole:
                raise
            raise InputError(f"has a word in {element.name[:80]} that is no number") from error
    return found


def _text_numbers(body: bytes) -> tuple[NDArray[np.float64], bool]:
    """Numbers up to the first word that is none, and whether there is no such word."""
    parts = [np.empty(0)]
    for words in words_of(body):
        try:
            parts.append(np.array([float(word) for word in words]))
        except ValueError:
            parts.append(np.array(list(_leading(words))))
            return np.concatenate(parts), False
    return np.concatenate(parts), True


def _leading(words: list[bytes]) -> Iterator[float]:
    """Numbers before the first word that is none."""
    for word in words:
        try:
            yield float(word)
        except ValueError:
            return


def _text_element(words: NDArray[np.float64], start: int, element: Element) -> tuple[Columns, int]:
    count, width = element.count, len(element.properties)
    if not width:
        return {}, start
    if element.lists:
        read = _text_alike(words, start, element) if len(element.lists) == 1 and corners_of(element) else None
        corners = corners_of(element)
        if read is None and corners is not None:
            read = read_ragged_words(words, start, element, corners, _numbers)
        if read:
            return read

        def take(code: str, number: int) -> list[Any]:
            nonlocal start
            part = words[start : start + number]
            if len(part) < number:
                raise _EndError("is truncated")
            start += number
            return _numbers(part, code, element).tolist()

        return _rows(take, element), start
    part = words[start : start + count * width]
    if len(part) < count * width:
        raise _EndError(f"ends within its {count} rows of {element.name[:80]}")
    columns = {each.name: _numbers(part[i::width], each.code, element) for i, each in enumerate(element.properties)}
    return columns, start + count * width


def _text_alike(words: NDArray[np.float64], start: int, element: Element) -> tuple[Columns, int] | None:
    """Read faces in one go, if all have as many corners as the first, as most files' do."""
    before = element.properties.index(element.lists[0])
    k = _whole(words[start + before]) if start + before < len(words) else 0
    width = len(element.properties) + k
    part = words[start : start + element.count * width]
    if not k or len(part) < element.count * width or (part[before::width] != k).any():
        return None
    columns: Columns = {}
    at = 0
    for each in element.properties:
        if each.length_code is None:
            columns[each.name] = _numbers(part[at::width], each.code, element)
            at += 1
            continue
        sides = [_numbers(part[at + i :: width], each.code, element) for i in range(1, k + 1)]
        columns |= {each.name: np.stack(sides, axis=1).ravel(), length_of(each): np.full(element.count, k)}
        at += 1 + k
    return columns, start + element.count * width


def _whole(value: float) -> int:
    """A number of corners that faces have, or 0."""
    return int(value) if 3 <= value <= _ALIKE and value == int(value) else 0


def _numbers(exact: NDArray[np.float64], code: str, element: Element) -> NDArray[Any]:
    if code.startswith("f"):
        with np.errstate(over="ignore"):
            return exact.astype(code)
    limits = np.iinfo(code)
    fits = (exact == np.rint(exact)) & (exact >= limits.min) & (exact <= limits.max)
    if not fits.all():
        raise InputError(f"has {exact[~fits][0]} in {element.name[:80]}, which does not fit its integer type")
    return exact.astype(code)


def _read_binary(data: bytes, header: Header) -> dict[str, Columns]:
    found, start = {}, header.size
    for element in header.elements:
        if element.count * element.smallest_row > len(data) - start:
            raise InputError(f"claims {element.count} rows of {element.name[:80]}, more than the file can hold")
        found[element.name], start = _binary_element(data, start, element, header.order)
    return found


def _binary_element(data: bytes, start: int, element: Element, order: str) -> tuple[Columns, int]:
    if not element.properties:
        return {}, start
    if not element.lists:
        table = np.frombuffer(data, _row_type(element, order, 0), element.count, start)
        return _native(table, element.properties), start + table.nbytes
    read = _alike(data, start, element, order) if len(element.lists) == 1 and corners_of(element) else None
    corners = corners_of(element)
    if read is None and corners is not None:
        read = read_ragged(data, start, element, order, corners)
    if read:
        return read

    def take(code: str, number: int) -> tuple[Any, ...]:
        nonlocal start
        layout = f"{order}{number}{_STRUCT[code]}"
        if struct.calcsize(layout) > len(data) - start:
            raise _EndError("is truncated")
        values = struct.unpack_from(layout, data, start)
        start += struct.calcsize(layout)
        return values

    return _rows(take, element), start


def _alike(data: bytes, start: int, element: Element, order: str) -> tuple[Columns, int] | None:
    """Read faces in one go, if all have as many corners as the first, as most files' do."""
    corners = corners_of(element)
    assert corners is not None
    head = np.frombuffer(data, _row_type(element, order, 0), 1, start) if element.count else None
    k = _whole(float(head[length_of(corners)][0])) if head is not None else 0
    dtype = _row_type(element, order, k)
    if not k or element.count * dtype.itemsize > len(data) - start:
        return None
    table = np.frombuffer(data, dtype, element.count, start)
    if (table[length_of(corners)] != k).any():
        return None
    columns = _native(table, element.properties)
    columns |= {corners.name: columns[corners.name].ravel(), length_of(corners): np.full(element.count, k)}
    return columns, start + table.nbytes


def length_of(each: Property) -> str:
    """Name of the column that has the lengths of a list."""
    # A blank cannot stand in a property's name, so this one is free.
    return f"{each.name} length"


def _row_type(element: Element, order: str, k: int) -> np.dtype[Any]:
    """Type of a row whose lists have `k` values."""
    parts: list[tuple[Any, ...]] = []
    for each in element.properties:
        if each.length_code is None:
            parts.append((each.name, order + each.code))
        else:
            parts += [(length_of(each), order + each.length_code), (each.name, order + each.code, (k,))]
    return np.dtype(parts)


def _native(table: NDArray[Any], properties: list[Property]) -> Columns:
    return {each.name: np.ascontiguousarray(table[each.name], each.code) for each in properties}


def _rows(take: Callable[[str, int], Any], element: Element) -> Columns:
    """Read row by row, since lists differ in length."""
    corners = corners_of(element)
    kept = [each for each in element.properties if each.length_code is None or each is corners]
    values: dict[str, list[Any]] = {each.name: [] for each in kept}
    lengths: list[int] = []
    for row in range(element.count):
        try:
            for each in element.properties:
                if each.length_code is None:
                    values[each.name].append(take(each.code, 1)[0])
                    continue
                numbers = _list(take, each, row, 3 if each is corners else 0)
                if each is corners:
                    values[each.name].extend(numbers)
                    lengths.append(len(numbers))
        except _EndError as error:
            raise _EndError(f"ends within {'row' if corners is None else 'face'} {row}") from error
    columns = {each.name: np.array(values[each.name], each.code) for each in kept}
    return columns if corners is None else columns | {length_of(corners): np.array(lengths, np.int64)}


def _list(take: Callable[[str, int], Any], each: Property, row: int, least: int) -> Any:
    length = int(take(str(each.length_code), 1)[0])
    if length < 0:
        raise InputError(f"has a list {each.name[:80]} of {length} values")
    if length < least:
        raise InputError(f"face {row} has {length} corners, where 3 or more go")
    return take(each.code, length)
