"""VTK unstructured grids (.vtu): a complex with its signals, as ParaView opens it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._atomic import write_bytes
from .._brief import brief
from .._files import PathLike, bad_input, read_bytes, unpacked_limit
from .._text import is_whole
from ..errors import InputError
from ..topology.cells import Polygons
from ..types import FloatArray
from ._polygons import polygons_of, rows_of_triangles, triangles_of
from ._vtk_data import (
    COMPRESSORS,
    LARGEST_ARRAY,
    NAMES,
    TYPES,
    Budget,
    Layout,
    decode_binary,
    decode_text,
    encode,
    packed,
)

if TYPE_CHECKING:
    from ..topology.complex import Complex

_EXPECTED = "a VTK unstructured grid of lines and faces"
_LINE, _TRIANGLE, _POLYGON, _PIXEL, _QUAD = 3, 5, 7, 8, 9  # VTK's numbers of cell types
_CORNERS = {_LINE: 2, _TRIANGLE: 3, _PIXEL: 4, _QUAD: 4}  # a polygon has as many as its offset says
_MAX_ELEMENTS = 10_000
_MAX_SIGNS = 20 * _MAX_ELEMENTS  # "=": one an attribute, and a few to fill up base64


class VtuMesh(NamedTuple):
    """What a .vtu file holds.

    Attributes
    ----------
    xyz : (N, 3) float64
        Positions, m.
    edges : (E, 2) int32
        Its lines.
    faces : (F, 3) int32
        Its triangles.
    point_data : dict
        (N,) or (N, C) arrays by name, as they stand in the file; one component gives (N,).
    cell_data : dict
        (E + F,) or (E + F, C) arrays by name: all lines first, then all triangles; those that are cut from one face
        have its values.
    """

    xyz: FloatArray
    edges: NDArray[np.int32]
    faces: NDArray[np.int32]
    point_data: dict[str, NDArray[Any]]
    cell_data: dict[str, NDArray[Any]]

    def __repr__(self) -> str:
        return brief(self)


def write_vtu(
    path: PathLike,
    complex_: Complex,
    xyz: ArrayLike,
    *,
    vertex: Mapping[str, ArrayLike] | None = None,
    edge: Mapping[str, ArrayLike] | None = None,
    face: Mapping[str, ArrayLike] | None = None,
) -> None:
    """Write a complex and its signals as one unstructured grid: a line an edge, then a triangle a face.

    Point data are the vertex signals. Every cell array covers edges, then faces: a name given in both `edge` and
    `face` is one array; where only one is given, the other's cells are 0. The cell array ``dim`` (1 for edges, 2 for
    faces) tells them apart. Numbers are exact (zlib-compressed binary); booleans become 0 and 1.

    Parameters
    ----------
    path : str or path
        The file to write.
    complex_ : Complex
        The complex.
    xyz : (N, 3) float array
        Positions of its vertices, m.
    vertex, edge, face : dict of (n,) or (n, C) float arrays, optional
        Signals by name; real and finite.

    Raises
    ------
    InputError
        If an array has the wrong length, is not finite, is complex, or a name cannot stand in XML.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.topology.complex import build_complex
    >>> triangle = build_complex(np.array([[0, 1, 2]]), 3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_vtu(f"{folder}/a.vtu", triangle, np.eye(3), face={"mean": [0.5]})
    ...     read_vtu(f"{folder}/a.vtu").cell_data["mean"].tolist()
    [0.0, 0.0, 0.0, 0.5]
    """
    from .._checks import require
    from ..topology.complex import Complex

    require(complex_, Complex, "complex_")
    n_edges, n_faces = len(complex_.edges), len(complex_.faces)
    points = _signal(path, "xyz", np.asarray(xyz, np.float64), complex_.n)
    if points.shape != (complex_.n, 3):
        raise bad_input(path, f"xyz has shape {points.shape}", f"({complex_.n}, 3)")
    point_data = {name: _signal(path, name, values, complex_.n) for name, values in (vertex or {}).items()}
    edge_data = {name: _signal(path, name, values, n_edges) for name, values in (edge or {}).items()}
    face_data = {name: _signal(path, name, values, n_faces) for name, values in (face or {}).items()}
    if "dim" in edge_data or "dim" in face_data:
        raise bad_input(path, "a cell array is called dim", "another name, since dim tells edges from faces")
    cell_data = {"dim": np.repeat(np.array([1, 2], np.int32), [n_edges, n_faces])}
    for name in [*edge_data, *(name for name in face_data if name not in edge_data)]:
        cell_data[name] = _joined(path, name, edge_data.get(name), face_data.get(name), (n_edges, n_faces))
    write_bytes(path, _document(complex_, points, point_data, cell_data).encode("utf-8"))


def _signal(path: PathLike, name: str, values: ArrayLike, length: int) -> NDArray[Any]:
    array = np.asarray(values)
    if not isinstance(name, str) or not name or not name.isprintable():
        raise bad_input(path, f"an array is called {name!r}", "a printable name")
    if array.dtype == np.bool_:
        array = array.astype(np.uint8)
    if array.dtype.newbyteorder("=") not in NAMES:
        raise bad_input(path, f"{name} has dtype {array.dtype}", "real numbers (a magnitude and a phase, say)")
    if array.ndim not in (1, 2) or len(array) != length or 0 in array.shape[1:]:
        raise bad_input(path, f"{name} has shape {array.shape}", f"({length},) or ({length}, C)")
    if not np.isfinite(array).all():
        raise bad_input(path, f"{name} holds a value that is not finite", "finite numbers")
    return array


def _joined(
    path: PathLike, name: str, edge: NDArray[Any] | None, face: NDArray[Any] | None, counts: tuple[int, int]
) -> NDArray[Any]:
    given = [part for part in (edge, face) if part is not None]
    parts = [
        np.zeros((count, *given[0].shape[1:]), given[0].dtype) if part is None else part
        for part, count in zip((edge, face), counts, strict=True)
    ]
    if parts[0].shape[1:] != parts[1].shape[1:]:
        raise bad_input(path, f"{name} has {parts[0].shape} on edges, {parts[1].shape} on faces", "equal channels")
    return np.concatenate(parts)


def _document(
    complex_: Complex, points: NDArray[Any], point_data: dict[str, NDArray[Any]], cell_data: dict[str, NDArray[Any]]
) -> str:
    n_edges, n_faces = len(complex_.edges), len(complex_.faces)
    sizes = np.repeat(np.array([2, 3], np.int64), [n_edges, n_faces])
    cells: dict[str, NDArray[Any]] = {
        "connectivity": np.concatenate([complex_.edges.ravel(), complex_.faces.ravel()]).astype(np.int64),
        "offsets": np.cumsum(sizes),
        "types": np.repeat(np.array([_LINE, _TRIANGLE], np.uint8), [n_edges, n_faces]),
    }
    sections: dict[str, Mapping[str, NDArray[Any]]] = {
        "PointData": point_data,
        "CellData": cell_data,
        "Points": {"xyz": points},
        "Cells": cells,
    }
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        ' compressor="vtkZLibDataCompressor">',
        f'<UnstructuredGrid><Piece NumberOfPoints="{complex_.n}" NumberOfCells="{n_edges + n_faces}">',
    ]
    for tag, arrays in sections.items():
        body = "\n".join(_data_array(name, values) for name, values in arrays.items())
        lines.append(f"<{tag}>\n{body}\n</{tag}>")
    return "\n".join([*lines, "</Piece></UnstructuredGrid>", "</VTKFile>", ""])


def _data_array(name: str, values: NDArray[Any]) -> str:
    kind = NAMES[values.dtype.newbyteorder("=")]
    # Some readers make an (n, 1) array of an (n,) one when told of its one component.
    channels = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    attributes = f'type="{kind}" Name={quoteattr(name)}{channels} format="binary"'
    return f"<DataArray {attributes}>{encode(values)}</DataArray>"


def read_vtu(path: PathLike) -> VtuMesh:
    """Read a VTK unstructured grid of lines, triangles, quads, pixels and polygons.

    Text, base64 and raw, inline and appended, plain, zlib- and LZMA-compressed arrays are read. Faces of more than
    three corners are cut into triangles, as `read_mesh` says. Claimed sizes are compared with what is there before
    memory is taken, and all arrays together with 256 MiB and 64 times the file's size (4 GiB at most), even if they
    share their bytes; a document type or an entity is refused.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    VtuMesh
        Positions, lines, triangles, point data and cell data.

    Raises
    ------
    InputError
        If the file is not such a grid, is damaged, has other cells, several pieces, positions that are not finite or
        indices out of range.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.topology.complex import build_complex
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_vtu(f"{folder}/a.vtu", build_complex(np.array([[0, 1, 2]]), 3), np.eye(3))
    ...     xyz, edges, faces, point_data, cell_data = read_vtu(f"{folder}/a.vtu")
    >>> edges.tolist(), faces.tolist()
    ([[0, 1], [0, 2], [1, 2]], [[0, 1, 2]])
    """
    return read_grid(path)[0]


def read_grid(path: PathLike) -> tuple[VtuMesh, Polygons]:
    """Read a VTK grid as `read_vtu`, and its faces as they stand in it.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    VtuMesh
        As `read_vtu`.
    Polygons
        Faces of three corners and more, winding kept.

    Raises
    ------
    InputError
        As `read_vtu`.
    """
    data = read_bytes(path, _EXPECTED)
    try:
        root, appended = _parsed(data)
        return _mesh(root, _layout(root, appended, Budget(unpacked_limit(len(data)))))
    except InputError as error:
        raise bad_input(path, str(error), _EXPECTED) from error
    except (ET.ParseError, ValueError, LookupError, MemoryError) as error:
        raise bad_input(path, f"is not well-formed XML ({error})", _EXPECTED) from error


class _Builder(ET.TreeBuilder):
    """A tree of bounded size, without document types (and so without entities)."""

    def __init__(self) -> None:
        super().__init__()
        self.left = _MAX_ELEMENTS

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse a document type."""
        raise InputError("declares a document type")

    def start(self, tag: Any, attrs: Any, /) -> ET.Element:
        """Count the elements."""
        self.left -= 1
        if self.left < 0:
            raise InputError(f"has more than {_MAX_ELEMENTS} elements")
        return super().start(tag, attrs)


def _parsed(data: bytes) -> tuple[ET.Element, bytes]:
    """Return the tree and the appended bytes, which need not be XML and are cut out first."""
    appended = b""
    start = data.find(b"<AppendedData")
    if start >= 0:
        mark, end = data.find(b"_", data.find(b">", start)), data.rfind(b"</AppendedData")
        if not start < mark < end:
            raise InputError("has an appended section without begin or end")
        appended, data = data[mark + 1 : end], data[: mark + 1] + data[end:]
    if data.count(b"=") > _MAX_SIGNS:
        raise InputError(f"has more than {_MAX_SIGNS} attributes")
    parser = ET.XMLParser(target=_Builder())
    parser.feed(data)
    return parser.close(), appended


def _layout(root: ET.Element, appended: bytes, budget: Budget) -> Layout:
    if root.tag != "VTKFile" or root.get("type") != "UnstructuredGrid":
        raise InputError(f"is a {root.tag} of type {root.get('type')}")
    order = {"LittleEndian": "<", "BigEndian": ">"}.get(root.get("byte_order", "LittleEndian"))
    header = {"UInt32": "u4", "UInt64": "u8"}.get(root.get("header_type", "UInt32"))
    if order is None or header is None:
        raise InputError("has an unknown byte order or header type")
    compressor = root.get("compressor")
    if compressor not in COMPRESSORS:
        raise InputError(f"is compressed by {compressor}, where zlib and LZMA are read")
    section = root.find("AppendedData")
    raw = section is not None and section.get("encoding") == "raw"
    if not raw:
        appended = packed(appended)
    return Layout(order, header, COMPRESSORS[compressor], budget, memoryview(appended), raw)


def _mesh(root: ET.Element, layout: Layout) -> tuple[VtuMesh, Polygons]:
    pieces = root.findall("UnstructuredGrid/Piece")
    if len(pieces) != 1:
        raise InputError(f"has {len(pieces)} pieces, where 1 is read")
    n, n_cells = (_count(pieces[0], key) for key in ("NumberOfPoints", "NumberOfCells"))
    points = list(_arrays(pieces[0], "Points", n, layout).values())
    if len(points) != 1 or points[0].shape != (n, 3):
        raise InputError(f"has no {n} points with 3 coordinates")
    xyz = points[0].astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(xyz).all(axis=1))
    if bad.size:
        raise InputError(f"vertex {bad[0]} has a coordinate that is not finite")
    edges, polygons, rank = _cells(pieces[0], n, n_cells, layout)
    rank = np.concatenate([rank[: len(edges)], rank[len(edges) :][rows_of_triangles(polygons)]])
    cell_data = {name: values[rank] for name, values in _arrays(pieces[0], "CellData", n_cells, layout).items()}
    faces = triangles_of(xyz, polygons)
    return VtuMesh(xyz, edges, faces, _arrays(pieces[0], "PointData", n, layout), cell_data), polygons


def _cells(
    piece: ET.Element, n: int, n_cells: int, layout: Layout
) -> tuple[NDArray[np.int32], Polygons, NDArray[np.intp]]:
    """Lines, faces, and the places of the one and the other among the cells."""
    kept = {element.get("Name"): element for element in piece.iterfind("Cells/DataArray")}
    if n_cells == 0:
        return np.empty((0, 2), np.int32), polygons_of([], [], n), np.empty(0, np.intp)
    if not {"connectivity", "offsets", "types"} <= kept.keys():
        raise InputError("has cells without connectivity, offsets or types")
    types = _integers(kept["types"], n_cells, layout)
    other = np.flatnonzero(~np.isin(types, [*_CORNERS, _POLYGON]))
    if other.size:
        read = "3 (line), 5 (triangle), 7 (polygon), 8 (pixel) and 9 (quad) are read"
        raise InputError(f"cell {other[0]} is of VTK type {types[other[0]]}, where {read}")
    ends = _integers(kept["offsets"], n_cells, layout)
    lengths = np.diff(ends, prepend=0)
    wanted = np.select([types == kind for kind in _CORNERS], list(_CORNERS.values()), lengths)
    if (lengths != wanted).any() or (lengths < 2).any() or ends.max() > LARGEST_ARRAY or ends.min() < 0:
        raise InputError("has offsets that do not fit its cells' types")
    corners = _integers(kept["connectivity"], int(ends[-1]), layout)
    if corners.min() < 0 or corners.max() >= n:
        raise InputError(f"has a cell with a vertex outside 0 to {n - 1}")
    pixels = np.flatnonzero(types == _PIXEL)  # along x first, then y: not around
    corners[ends[pixels, None] + [-2, -1]] = corners[ends[pixels, None] + [-1, -2]]
    lines, faces = np.flatnonzero(types == _LINE), np.flatnonzero(types != _LINE)
    edges = corners[ends[lines, None] + np.arange(-2, 0)].astype(np.int32)
    polygons = polygons_of(lengths[faces], corners[np.repeat(types != _LINE, lengths)], n)
    return edges, polygons, np.concatenate([lines, faces])


def _integers(element: ET.Element, count: int, layout: Layout) -> NDArray[np.int64]:
    values = _values(element, count, layout)
    if values.ndim != 1 or values.dtype.kind == "f":
        raise InputError(f"array {element.get('Name')} does not hold {count} integers")
    return values.astype(np.int64)


def _arrays(piece: ET.Element, section: str, rows: int, layout: Layout) -> dict[str, NDArray[Any]]:
    found: dict[str, NDArray[Any]] = {}
    for element in piece.iterfind(f"{section}/DataArray"):
        name = element.get("Name", section)
        if name in found:
            raise InputError(f"has two arrays called {name} in {section}")
        found[name] = _values(element, rows, layout)
    return found


def _values(element: ET.Element, rows: int, layout: Layout) -> NDArray[Any]:
    name = element.get("Name", "?")
    code = TYPES.get(element.get("type", ""))
    channels = _count(element, "NumberOfComponents", "1")
    if code is None or not 1 <= channels <= 1 << 16 or rows * channels * 8 > LARGEST_ARRAY:
        raise InputError(f"array {name} has type {element.get('type')}, {rows} rows and {channels} components")
    text, form = element.text or "", element.get("format", "ascii")
    try:
        layout.budget.take(8 * rows * channels)
        if form == "ascii":
            values = decode_text(text, code, rows * channels)
        elif form == "binary":
            source = memoryview(packed(text.encode("utf-8")))
            values = decode_binary(source, False, layout, code, rows * channels)
        elif form == "appended":
            source = layout.appended[_count(element, "offset") :]
            values = decode_binary(source, layout.raw, layout, code, rows * channels)
        else:
            raise InputError(f"has the format {form}")
    except InputError as error:
        raise InputError(f"array {name} {error}") from error
    return values.reshape(rows, channels) if channels > 1 else values


def _count(element: ET.Element, key: str, default: str = "") -> int:
    text = element.get(key, default)
    if not is_whole(text, 19) or int(text) > LARGEST_ARRAY:
        raise InputError(f"{element.tag} has {key} {text!r}, where a count should stand")
    return int(text)
