"""STL, binary and as text: triangles without shared corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, read_bytes
from .._text import Line, numbers, read_lines, unmarked
from ..errors import InputError
from ..types import FloatArray

_EXPECTED = "an STL file, binary or as text"
_HEAD = 84  # bytes: 80 of any content, and the number of triangles
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_AFTER = {  # which line follows which, by their first words
    "": ("solid",),
    "solid": ("facet", "endsolid"),
    "facet": ("outer",),
    "outer": ("vertex",),
    "vertex": ("vertex", "endloop"),
    "endloop": ("endfacet",),
    "endfacet": ("facet", "endsolid"),
    "endsolid": ("solid",),
}


def read_stl(path: PathLike) -> FloatArray:
    """Read the corners of an STL file's triangles, (F, 3, 3); its normals are left out, the order of corners tells."""
    data = read_bytes(path, _EXPECTED)
    count = int.from_bytes(data[80:_HEAD], "little") if len(data) >= _HEAD else -1
    claimed = _HEAD + _FACET.itemsize * count
    if len(data) == claimed:  # also where the head says "solid", as some writers let it
        found = np.frombuffer(data, _FACET, count, _HEAD)["corners"].astype(np.float64)
        return _checked(path, found)
    if unmarked(data[:_HEAD]).lstrip()[:5].lower() == b"solid":
        return _checked(path, _of_text(path))
    said = f"claims {count} triangles, which are {claimed} bytes" if count >= 0 else "has no head of 84 bytes"
    raise bad_input(path, f"{said}, has {len(data)} bytes, and does not begin with solid", _EXPECTED)


def _checked(path: PathLike, corners: FloatArray) -> FloatArray:
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))
    if bad.size:
        raise bad_input(path, f"triangle {bad[0]} has a coordinate that is not finite", _EXPECTED)
    return corners


def _of_text(path: PathLike) -> NDArray[np.float64]:
    """Corners of all solids of a file, line by line; any line out of its place is refused."""
    corners: list[list[float]] = []
    last = ""
    for line in read_lines(path, _EXPECTED):
        if not line[1]:
            continue
        words = line[1].split()
        word = words[0].lower()
        if word not in _AFTER[last] or (word == "endloop") != (last == "vertex" and len(corners) % 3 == 0):
            raise _misplaced(path, line, last)
        if word == "vertex":
            corners.append(_corner(path, line, words))
        last = word
    if last != "endsolid":
        raise bad_input(path, f"ends within a solid, behind {last or 'nothing'}", _EXPECTED)
    return np.array(corners, np.float64).reshape(-1, 3, 3)


def _misplaced(path: PathLike, line: Line, last: str) -> InputError:
    wanted = "endloop" if last == "vertex" else " or ".join(_AFTER[last])
    return bad_input(path, f"line {line[0]} is {line[1][:40]!r}, where {wanted} goes", _EXPECTED)


def _corner(path: PathLike, line: Line, words: list[str]) -> list[float]:
    if len(words) != 4:
        raise bad_input(path, f"line {line[0]} has {len(words) - 1} coordinates, where 3 go", _EXPECTED)
    return numbers(path, line, words[1:], _EXPECTED)
