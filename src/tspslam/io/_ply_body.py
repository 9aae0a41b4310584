"""The data of a PLY file: rows of numbers and lists, as text or binary."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ._ply_header import Element, Header, Property
from ._words import words_of

Columns = dict[str, NDArray[Any]]
_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_CORNERS = ("vertex_indices", "vertex_index")


class _EndError(InputError):
    """The data end within an element."""


def corners_of(element: Element) -> Property | None:
    """Return the list property that holds the corners of the faces."""
    return next((each for each in element.lists if element.name == "face" and each.name in _CORNERS), None)


def read_elements(data: bytes, header: Header) -> dict[str, Columns]:
    """Return the columns of every element: scalars, and the faces' corners as (F, 3); other lists are skipped."""
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
    if len(element.lists) == 1 and corners_of(element):
        return _text_triangles(words, start, element)
    if element.lists:

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


def _text_triangles(words: NDArray[np.float64], start: int, element: Element) -> tuple[Columns, int]:
    """Read faces in one go, as if all were triangles, and see whether they were."""
    width = len(element.properties) + 3
    whole = min(element.count, (len(words) - start) // width)
    part = words[start : start + whole * width]
    columns: Columns = {}
    at = 0
    for each in element.properties:
        if each.length_code is None:
            columns[each.name] = _numbers(part[at::width], each.code, element)
            at += 1
            continue
        lengths = _numbers(part[at::width], "f8", element)
        other = np.flatnonzero(lengths != 3)
        if other.size:
            raise _not_a_triangle(int(other[0]), lengths[other[0]])
        sides = [_numbers(part[at + i :: width], each.code, element) for i in (1, 2, 3)]
        columns[each.name] = np.stack(sides, axis=1)
        at += 4
    _check_whole(whole, element)
    return columns, start + whole * width


def _check_whole(whole: int, element: Element) -> None:
    if whole < element.count:
        raise _EndError(f"ends within face {whole}, or that is no triangle")


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
        table = np.frombuffer(data, _row_type(element, order), element.count, start)
        return _native(table, element.properties), start + table.nbytes
    if len(element.lists) == 1 and corners_of(element):
        return _triangles(data, start, element, order)

    def take(code: str, number: int) -> tuple[Any, ...]:
        nonlocal start
        layout = f"{order}{number}{_STRUCT[code]}"
        if struct.calcsize(layout) > len(data) - start:
            raise InputError("is truncated")
        values = struct.unpack_from(layout, data, start)
        start += struct.calcsize(layout)
        return values

    return _rows(take, element), start


def _triangles(data: bytes, start: int, element: Element, order: str) -> tuple[Columns, int]:
    """Read faces in one go, as if all were triangles, and see whether they were."""
    corners = corners_of(element)
    assert corners is not None
    dtype = _row_type(element, order)
    whole = min(element.count, (len(data) - start) // dtype.itemsize)
    table = np.frombuffer(data, dtype, whole, start)
    lengths = table[_length_of(corners)]
    other = np.flatnonzero(lengths != 3)
    if other.size:
        raise _not_a_triangle(int(other[0]), int(lengths[other[0]]))
    _check_whole(whole, element)
    return _native(table, element.properties), start + table.nbytes


def _not_a_triangle(face: int, corners: float) -> InputError:
    return InputError(f"face {face} has {corners:g} corners, where 3 go")


def _length_of(each: Property) -> str:
    # A blank cannot stand in a property's name, so this one is free.
    return f"{each.name} length"


def _row_type(element: Element, order: str) -> np.dtype[Any]:
    parts: list[tuple[Any, ...]] = []
    for each in element.properties:
        if each.length_code is None:
            parts.append((each.name, order + each.code))
        else:
            parts += [(_length_of(each), order + each.length_code), (each.name, order + each.code, (3,))]
    return np.dtype(parts)


def _native(table: NDArray[Any], properties: list[Property]) -> Columns:
    return {each.name: np.ascontiguousarray(table[each.name], each.code) for each in properties}


def _rows(take: Callable[[str, int], Any], element: Element) -> Columns:
    """Read row by row, since lists differ in length."""
    corners = corners_of(element)
    kept = [each for each in element.properties if each.length_code is None or each is corners]
    values: dict[str, list[Any]] = {each.name: [] for each in kept}
    for row in range(element.count):
        for each in element.properties:
            if each.length_code is None:
                values[each.name].append(take(each.code, 1)[0])
                continue
            length = int(take(each.length_code, 1)[0])
            if each is corners and length != 3:
                raise _not_a_triangle(row, length)
            if length < 0:
                raise InputError(f"has a list {each.name[:80]} of {length} values")
            numbers = take(each.code, length)
            if each is corners:
                values[each.name].append(numbers)
    shapes = {each.name: (-1, 3) if each is corners else (-1,) for each in kept}
    return {each.name: np.array(values[each.name], each.code).reshape(shapes[each.name]) for each in kept}
