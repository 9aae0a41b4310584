"""OFF, and COFF, NOFF, STOFF and their like: vertices and faces as text."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from .._files import PathLike, bad_input
from .._text import Line, is_whole, numbers, read_lines
from ..errors import InputError
from ..topology.cells import Polygons
from ..types import FloatArray
from ._polygons import polygons_of

_EXPECTED = "an OFF file of vertices and faces, as text"
_HEAD = re.compile(r"(ST)?C?N?(4?n?)OFF(?=[ 0-9]|$)(.*)")  # some files have the counts right behind the word
_DIGITS = 10  # of a count or a corner


def read_off(path: PathLike) -> tuple[FloatArray, Polygons]:
    """Read the vertices and faces of an OFF file; colours, normals and texture places are left out."""
    lines = _said(path)
    n, count = _counts(path, lines)
    xyz: list[list[float]] = []
    corners: list[int] = []
    lengths: list[int] = []
    for line in lines:
        words = line[1].split()
        if len(xyz) < n:
            xyz.append(_position(path, line, words))
        elif len(lengths) < count:
            corners += _corners(path, line, words)
            lengths.append(int(words[0]))
        else:
            raise bad_input(path, f"line {line[0]} stands behind the last of {count} faces", _EXPECTED)
    if len(xyz) < n or len(lengths) < count or not n:
        said = f"ends after {len(xyz)} of {n} vertices and {len(lengths)} of {count} faces"
        raise bad_input(path, said if n else "has no vertices", _EXPECTED)
    try:
        return np.array(xyz, np.float64), polygons_of(lengths, corners, n)
    except InputError as error:
        raise bad_input(path, str(error), _EXPECTED) from error


def _said(path: PathLike) -> Iterator[Line]:
    """Lines that say something."""
    for number, text in read_lines(path, _EXPECTED):
        words = text.partition("#")[0].strip()
        if words:
            yield number, words


def _counts(path: PathLike, lines: Iterator[Line]) -> tuple[int, int]:
    """Vertices and faces that the head claims; as many are read, and none is made room for before."""
    number, text = next(lines, (1, ""))
    head = _HEAD.fullmatch(text)
    if head is None or "BINARY" in text:
        raise bad_input(path, f"line {number} begins with {text[:20]!r}, where OFF or COFF goes", _EXPECTED)
    if head[2]:
        raise bad_input(path, f"is {text[:20]}, whose vertices have another dimension than 3", _EXPECTED)
    rest = head[3].strip()
    number, text = (number, rest) if rest else next(lines, (number, ""))
    words = text.split()
    if len(words) not in (2, 3) or not all(is_whole(word, _DIGITS) for word in words):
        raise bad_input(path, f"line {number} is {text[:40]!r}, where the numbers of vertices and faces go", _EXPECTED)
    return int(words[0]), int(words[1])


def _position(path: PathLike, line: Line, words: list[str]) -> list[float]:
    position = numbers(path, line, words[:3], _EXPECTED)
    if len(position) < 3 or not np.isfinite(position).all():
        raise bad_input(path, f"line {line[0]} has no three finite coordinates", _EXPECTED)
    return position


def _corners(path: PathLike, line: Line, words: list[str]) -> list[int]:
    count = int(words[0]) if is_whole(words[0], _DIGITS) else -1
    corners = words[1 : 1 + max(count, 0)]
    if count < 0 or len(corners) < count or not all(is_whole(word, _DIGITS) for word in corners):
        raise bad_input(path, f"line {line[0]} is no face: a number of corners, then as many of them", _EXPECTED)
    return [int(word) for word in corners]
