"""PLY: triangle meshes with a scalar or colour on every vertex and face."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._atomic import write_bytes
from .._brief import Brief
from .._files import PathLike, bad_input, read_bytes
from .._text import unmarked
from ..errors import InputError
from ..topology.cells import Polygons
from ..types import FloatArray, real_array
from ._ply_body import FACES, Columns, corners_of, length_of, read_elements
from ._ply_header import Element, parse_header
from ._polygons import polygons_of, rows_of_triangles, strip_triangles, triangles_of

_EXPECTED = "a PLY file of points and faces"
_HEAD = 1 << 12  # bytes in which the format of a file is told
_WORDS = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}


@dataclass(frozen=True, repr=False)
class PlyMesh(Brief):
    """What a PLY file holds.

    Attributes
    ----------
    xyz : (N, 3) float64
        Positions, in the file's unit (metres in ours).
    faces : (F, 3) int32
        Triangles, winding kept.
    vertex : dict
        (N,) scalars of the vertices by name, in the file's type.
    face : dict
        (F,) scalars of the faces by name, in the file's type; triangles that are cut from one face have its.
    """

    xyz: FloatArray
    faces: NDArray[np.int32]
    vertex: dict[str, NDArray[Any]]
    face: dict[str, NDArray[Any]]


def write_ply(
    path: PathLike,
    xyz: ArrayLike,
    faces: ArrayLike,
    *,
    vertex: Mapping[str, ArrayLike] | None = None,
    face: Mapping[str, ArrayLike] | None = None,
    edges: ArrayLike | None = None,
) -> None:
    """Write a mesh as binary little-endian PLY, whole or not at all; the same arrays give the same bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    xyz : (N, 3) float array
        Positions, m; stored as double.
    faces : (F, 3) integers
        Triangles, winding kept.
    vertex, face : dict of (N,), (F,) float arrays, optional
        Scalars by name, each in its own type (booleans as uchar). Viewers take uint8 ``red``, ``green``, ``blue`` as
        colour.
    edges : (E, 2) integers, optional
        Written as an ``edge`` element when given.

    Raises
    ------
    InputError
        If an array has the wrong shape, is not finite, does not fit a PLY type, or refers to no vertex.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_ply(f"{folder}/a.ply", np.eye(3), [[0, 2, 1]], vertex={"quality": [0.0, 0.5, 1.0]})
    ...     mesh = read_ply(f"{folder}/a.ply")
    >>> mesh.faces.tolist(), mesh.vertex["quality"].tolist()
    ([[0, 2, 1]], [0.0, 0.5, 1.0])
    """
    points = real_array(xyz, "xyz", "(N, 3)").astype(np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise bad_input(path, f"xyz has shape {points.shape} or a value that is not finite", "finite (N, 3)")
    triangles = _indices(path, "faces", faces, (len(points), 3))
    columns = {axis: points[:, i] for i, axis in enumerate("xyz")}
    columns |= _scalars(path, vertex, len(points), {"x", "y", "z"})
    tables = [("vertex", *_table(columns, len(points)))]
    face_columns = _scalars(path, face, len(triangles), {"vertex_indices", "vertex_index"})
    lines, table = _table({" length": np.full(len(triangles), 3, np.uint8), " corners": triangles, **face_columns})
    tables.append(("face", ["property list uchar int vertex_indices", *lines[2:]], table))
    if edges is not None:
        pairs = _indices(path, "edges", edges, (len(points), 2))
        tables.append(("edge", *_table({"vertex1": pairs[:, 0], "vertex2": pairs[:, 1]})))
    write_bytes(path, _document(tables))


def _document(tables: list[tuple[str, list[str], NDArray[Any]]]) -> bytes:
    header = ["ply", "format binary_little_endian 1.0"]
    for name, lines, table in tables:
        header += [f"element {name} {len(table)}", *lines]
    head = "\n".join([*header, "end_header", ""]).encode("ascii")
    return head + b"".join(table.tobytes() for _, _, table in tables)


def _table(columns: Mapping[str, NDArray[Any]], count: int | None = None) -> tuple[list[str], NDArray[Any]]:
    """Return the property lines of columns, and the columns as one packed little-endian table."""
    codes = {name: values.dtype.str[1:] for name, values in columns.items()}
    rows = len(next(iter(columns.values()))) if count is None else count
    table = np.zeros(rows, [(name, "<" + codes[name], values.shape[1:]) for name, values in columns.items()])
    for name, values in columns.items():
        table[name] = values
    return [f"property {_WORDS[code]} {name}" for name, code in codes.items()], table


def _scalars(
    path: PathLike, arrays: Mapping[str, ArrayLike] | None, count: int, taken: set[str]
) -> dict[str, NDArray[Any]]:
    return {name: _scalar(path, name, values, count, taken) for name, values in (arrays or {}).items()}


def _scalar(path: PathLike, name: str, values: ArrayLike, count: int, taken: set[str]) -> NDArray[Any]:
    array = np.asarray(values)
    if not (name.isascii() and name.isprintable()) or name in taken or len(name.split()) != 1 or " " in name:
        raise bad_input(path, f"a scalar is called {name!r}", "another name, one ASCII word")
    if array.shape != (count,):
        raise bad_input(path, f"{name} has shape {array.shape}", f"({count},)")
    if array.dtype == np.bool_:
        return array.astype(np.uint8)
    if array.dtype.kind in "iu" and array.dtype.itemsize == 8:
        array = _narrowed(path, name, array)
    if array.dtype.str[1:] not in _WORDS or not np.isfinite(array).all():
        raise bad_input(path, f"{name} has dtype {array.dtype} or a value that is not finite", "finite real numbers")
    return array


def _narrowed(path: PathLike, name: str, array: NDArray[Any]) -> NDArray[np.int32]:
    narrow = array.astype(np.int32)
    if not np.array_equal(narrow, array):
        raise bad_input(path, f"{name} holds {array.min()} to {array.max()}", "integers of 32 bits")
    return narrow


def _indices(path: PathLike, name: str, values: ArrayLike, limits: tuple[int, int]) -> NDArray[np.int32]:
    n, width = limits
    array = np.asarray(values)
    if array.size == 0:
        return np.empty((0, width), np.int32)
    if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "iu":
        raise bad_input(path, f"{name} is {array.dtype} of shape {array.shape}", f"integers of shape (n, {width})")
    if array.min() < 0 or array.max() >= n:
        raise bad_input(path, f"{name} refers to vertices {array.min()} to {array.max()}", f"0 to {n - 1}")
    return array.astype(np.int32)


def read_ply(path: PathLike) -> PlyMesh:
    """Read a PLY file of points and faces: text, or binary of either byte order.

    Faces of more than three corners are cut into triangles, as `read_mesh` says; strips of triangles are faces.
    Elements other than ``vertex``, ``face`` and ``tristrips``, and lists other than the faces' corners, are skipped.
    Claimed sizes are compared with the file's before memory is taken.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    PlyMesh
        Positions, triangles and scalars.

    Raises
    ------
    InputError
        If the file is no PLY, is truncated, has an unknown type, a face of fewer than three corners or one that no
        fan of triangles covers (named), a coordinate that is not finite (its vertex named), or a corner that is no
        vertex.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_ply(f"{folder}/a.ply", np.eye(3), [[0, 1, 2]])
    ...     read_ply(f"{folder}/a.ply").xyz.shape
    (3, 3)
    """
    return read_faces(path)[0]


def read_faces(path: PathLike) -> tuple[PlyMesh, Polygons]:
    """Read a PLY file as `read_ply`, and its faces as they stand in it.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    PlyMesh
        As `read_ply`.
    Polygons
        Faces of three corners and more, winding kept.

    Raises
    ------
    InputError
        As `read_ply`.
    """
    data = _plain_lines(unmarked(read_bytes(path, _EXPECTED)))
    try:
        header = parse_header(data)
        tables = read_elements(data, header)
        xyz = _positions(tables.get("vertex", {}))
        vertex = {name: values for name, values in tables.get("vertex", {}).items() if name not in ("x", "y", "z")}
        polygons = _polygons(tables, header.elements, len(xyz))
        rows = rows_of_triangles(polygons)
        face = {name: values[rows] for name, values in tables.get("face", {}).items()}
        return PlyMesh(xyz, triangles_of(xyz, polygons), vertex, face), polygons
    except InputError as error:
        raise bad_input(path, str(error), _EXPECTED) from error
    except MemoryError as error:
        raise bad_input(path, "is larger than the memory", _EXPECTED) from error


def _plain_lines(data: bytes) -> bytes:
    """Return a text file whose lines end with CR alone with LF instead; a binary one as it is."""
    is_old = data.startswith(b"ply\r") and not data.startswith(b"ply\r\n") and b"\rformat ascii" in data[:_HEAD]
    return data.replace(b"\r", b"\n") if is_old else data


def _positions(columns: dict[str, NDArray[Any]]) -> FloatArray:
    if not {"x", "y", "z"} <= columns.keys():
        raise InputError("has no vertices with x, y and z")
    xyz = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    bad = np.flatnonzero(~np.isfinite(xyz).all(axis=1))
    if bad.size:
        raise InputError(f"vertex {bad[0]} has a coordinate that is not finite")
    return xyz


def _polygons(tables: dict[str, Columns], elements: list[Element], n: int) -> Polygons:
    """Take the corners out of the faces' columns; of a file with strips they are faces, and no scalars are theirs."""
    lengths, values = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for element in elements:
        corners = corners_of(element)
        if element.name not in FACES or (corners is None and not element.count):
            continue
        columns = tables[element.name]
        if corners is None:
            raise InputError(f"has a {element.name} without vertex_indices")
        found, counts = columns.pop(corners.name), columns.pop(length_of(corners))
        if found.dtype.kind == "f":
            raise InputError(f"has a {element.name} whose corners are no integers")
        if element.name != "face" and len(found):
            found = _of_strips(found.astype(np.int64), counts)
            counts = np.full(len(found) // 3, 3)
            tables.get("face", {}).clear()
        lengths.append(counts)
        values.append(found.astype(np.int64))
    return polygons_of(np.concatenate(lengths), np.concatenate(values), n)


def _of_strips(corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Corners of the triangles of strips; -1 ends one within a row."""
    ends = np.union1d(np.flatnonzero(corners == -1), np.cumsum(counts)[:-1])
    strips = np.split(corners, ends)
    return np.concatenate([strip_triangles(strip[int(strip[:1].tolist() == [-1]) :]) for strip in strips]).ravel()
