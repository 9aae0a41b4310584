"""A triangle mesh from any format that we read; the suffix tells which."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, read_bytes
from .._text import Line, is_plain, numbers, read_lines, unmarked
from ..errors import InputError
from ..types import FloatArray
from ._ply_header import parse_header
from .frames import read_frame
from .ply import read_ply
from .vtu import read_vtu

_EXPECTED = "a triangle mesh in .ply, .vtu, .obj, or a frame's .npz"


def read_mesh(path: PathLike) -> tuple[FloatArray, NDArray[np.int32]]:
    r"""Read positions and triangles from a .ply, .vtu or .obj file, or a stored frame (.npz).

    Parameters
    ----------
    path : str or path
        The file; its suffix, in any case, tells the format.

    Returns
    -------
    xyz : (N, 3) float64
        Positions, m.
    faces : (F, 3) int32
        Triangles, winding kept.

    Raises
    ------
    InputError
        If the suffix is another, or the file is not a sound triangle mesh with at least one face.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "a.obj").write_text("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n")
    ...     xyz, faces = read_mesh(f"{folder}/a.obj")
    >>> faces.tolist()
    [[0, 1, 2]]
    """
    xyz, faces = _read(path)
    if not len(faces):
        strips = " but triangle strips, which are not read" if _has_strips(path) else ""
        raise bad_input(path, f"has {len(xyz)} vertices and no faces{strips}", _EXPECTED)
    return xyz, faces


def _read(path: PathLike) -> tuple[FloatArray, NDArray[np.int32]]:
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        ply = read_ply(path)
        return ply.xyz, ply.faces
    if suffix == ".vtu":
        vtu = read_vtu(path)
        return vtu.xyz, vtu.faces
    if suffix == ".npz":
        frame = read_frame(path)
        return frame.cloud.xyz, frame.surface.faces
    if suffix == ".obj":
        return _read_obj(path)
    raise bad_input(path, f"has the suffix {suffix!r}", _EXPECTED)


def _has_strips(path: PathLike) -> bool:
    """Whether a sound file without faces has an element of triangle strips, as PLY files of range scans do."""
    if Path(path).suffix.lower() != ".ply":
        return False
    elements = parse_header(unmarked(read_bytes(path, _EXPECTED))).elements
    return any(each.name == "tristrips" and each.count for each in elements)


def merge_corners(xyz: FloatArray, faces: NDArray[np.int32]) -> tuple[FloatArray, NDArray[np.int32]]:
    """Make one vertex of those with equal coordinates, so that faces which touch share an edge.

    Parameters
    ----------
    xyz : (N, 3) float64
        Positions, finite; -0 equals 0.
    faces : (F, 3) int32
        Triangles.

    Returns
    -------
    xyz : (M, 3) float64
        The distinct positions, in the order in which each comes first.
    faces : (G, 3) int32
        Triangles over them, winding and order kept, without those of which two corners are now one.

    Examples
    --------
    >>> soup = np.array([[0, 0, 1.0], [1, 0, 1], [0, 1, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    >>> xyz, faces = merge_corners(soup, np.array([[0, 1, 2], [3, 4, 5]], np.int32))
    >>> len(xyz), faces.tolist()
    (4, [[0, 1, 2], [1, 3, 2]])
    """
    first, place = _distinct(xyz)
    merged = place[faces]
    a, b, c = merged.T
    return xyz[first], merged[(a != b) & (b != c) & (a != c)].astype(np.int32)


def repeated_corners(xyz: FloatArray) -> int:
    """Count the vertices that have the coordinates of an earlier one.

    Parameters
    ----------
    xyz : (N, 3) float64
        Vertices, m.

    Returns
    -------
    int

    Examples
    --------
    >>> repeated_corners(np.array([[0, 0, 1.0], [1, 0, 1], [-0.0, 0, 1]]))
    1
    """
    return len(xyz) - len(_distinct(xyz)[0])


def _distinct(xyz: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows that equal no earlier one, ascending, and for each row its place among them."""
    order = np.lexsort(xyz.T)  # stable: of equal rows the earliest comes first
    ordered = xyz[order]
    is_new = np.ones(len(xyz), bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    earliest = order[is_new][np.cumsum(is_new) - 1]
    first = np.sort(order[is_new])
    place = np.empty(len(xyz), np.int64)
    place[order] = np.searchsorted(first, earliest)
    return first, place


def _read_obj(path: PathLike) -> tuple[FloatArray, NDArray[np.int32]]:
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for line in read_lines(path, _EXPECTED):
        words = line[1].split("#", 1)[0].split()
        try:
            if words and words[0] == "v":
                vertices.append(_position(path, line, words))
            elif words and words[0] == "f":
                faces.append(_triangle(words, len(vertices)))
        except ValueError as error:
            raise bad_input(path, f"line {line[0]} holds a word that is no number", _EXPECTED) from error
        except _LineError as error:
            raise bad_input(path, f"line {line[0]} {error}", _EXPECTED) from error
    if not vertices:
        raise bad_input(path, "has no vertices", _EXPECTED)
    triangles = np.array(faces, np.int64).reshape(-1, 3)
    bad = np.flatnonzero(((triangles < 0) | (triangles >= len(vertices))).any(axis=1))
    if bad.size:
        reason = f"face {bad[0]} has corners {(triangles[bad[0]] + 1).tolist()} of {len(vertices)} vertices"
        raise bad_input(path, reason, _EXPECTED)
    return np.array(vertices, np.float64), triangles.astype(np.int32)


class _LineError(InputError):
    """What is wrong with a line, without its number."""


def _position(path: PathLike, line: Line, words: list[str]) -> list[float]:
    position = numbers(path, line, words[1:4], _EXPECTED)
    if len(position) < 3:
        raise _LineError(f"has no three finite coordinates, but {len(position)}")
    if not np.isfinite(position).all():
        raise _LineError(f"has no three finite coordinates: {' '.join(words[1:4])[:60]}")
    return position


def _triangle(words: list[str], n: int) -> list[int]:
    if len(words) != 4:
        raise _LineError(f"has a face of {len(words) - 1} corners, where 3 go")
    if not is_plain("".join(words)):
        raise ValueError
    corners = [int(word.split("/", 1)[0]) for word in words[1:]]
    if not all(0 < abs(corner) < 1 << 31 for corner in corners):
        raise _LineError("has a corner that counts neither from the first vertex nor from the last")
    return [corner - 1 if corner > 0 else n + corner for corner in corners]
