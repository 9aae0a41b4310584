"""Wavefront OBJ: vertices and faces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .._files import PathLike, bad_input
from .._text import Line, is_plain, numbers, read_lines
from ..errors import InputError
from ..topology.cells import Polygons
from ..types import FloatArray
from ._polygons import polygons_of

_EXPECTED = "an OBJ file of vertices and faces"


def read_obj(path: PathLike) -> tuple[FloatArray, Polygons]:
    """Read the vertices and faces of an OBJ file; a backslash at the end of a line goes on in the next."""
    vertices: list[list[float]] = []
    corners: list[int] = []
    lengths: list[int] = []
    for line in _whole_lines(path):
        words = line[1].split("#", 1)[0].split()
        try:
            if words and words[0] == "v":
                vertices.append(_position(path, line, words))
            elif words and words[0] == "f":
                corners += _corners(words, len(vertices))
                lengths.append(len(words) - 1)
        except ValueError as error:
            raise bad_input(path, f"line {line[0]} holds a word that is no number", _EXPECTED) from error
        except _LineError as error:
            raise bad_input(path, f"line {line[0]} {error}", _EXPECTED) from error
    if not vertices:
        raise bad_input(path, "has no vertices", _EXPECTED)
    try:
        return np.array(vertices, np.float64), polygons_of(lengths, corners, len(vertices))
    except InputError as error:
        raise bad_input(path, f"{error}, counted from 0", _EXPECTED) from error


class _LineError(InputError):
    """What is wrong with a line, without its number."""


def _whole_lines(path: PathLike) -> Iterator[Line]:
    """Lines, those joined that a backslash goes on."""
    number, parts = 0, list[str]()
    for line in read_lines(path, _EXPECTED):
        number = number if parts else line[0]
        parts.append(line[1].removesuffix("\\"))
        if not line[1].endswith("\\"):
            yield number, " ".join(parts)
            parts = []
    if parts:
        raise bad_input(path, f"line {number} goes on behind the last line", _EXPECTED)


def _position(path: PathLike, line: Line, words: list[str]) -> list[float]:
    position = numbers(path, line, words[1:4], _EXPECTED)
    if len(position) < 3:
        raise _LineError(f"has no three finite coordinates, but {len(position)}")
    if not np.isfinite(position).all():
        raise _LineError(f"has no three finite coordinates: {' '.join(words[1:4])[:60]}")
    return position


def _corners(words: list[str], n: int) -> list[int]:
    if len(words) < 4:
        raise _LineError(f"has a face of {len(words) - 1} corners, where 3 or more go")
    if not is_plain("".join(words)):
        raise ValueError
    corners = [int(word.split("/", 1)[0]) for word in words[1:]]
    if not all(0 < abs(corner) < 1 << 31 for corner in corners):
        raise _LineError("has a corner that counts neither from the first vertex nor from the last")
    return [corner - 1 if corner > 0 else n + corner for corner in corners]
