"""A mesh with the signals that its file carries: VTU with all three levels, PLY with vertices, faces or colours."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from .._files import PathLike, bad_input
from ..topology.complex import Complex, build_complex
from ..types import REC601, UNIT_OF, BoolArray, FloatArray, Signals
from .mesh import read_mesh
from .ply import PlyMesh, read_ply
from .vtu import VtuMesh, read_vtu

_COLOURS = ("red", "green", "blue")
Level = tuple[FloatArray, BoolArray, NDArray[np.int32]]  # values, which of them are signals, pixels behind them
Columns = Mapping[str, NDArray[Any]]


class TexturedMesh(NamedTuple):
    """A mesh and what its file says of luminance.

    Attributes
    ----------
    xyz : (N, 3) float64
        Positions, m.
    faces : (F, 3) int32
        Triangles, winding kept.
    complex_ : Complex
        Of these triangles and of edges that stand without one.
    signals : Signals
        Luminance; what the file has none for is marked.
    """

    xyz: FloatArray
    faces: NDArray[np.int32]
    complex_: Complex
    signals: Signals

    def __repr__(self) -> str:
        return brief(self)


def read_textured(path: PathLike) -> TexturedMesh:
    """Read a mesh with its signals: ``luminance`` of a VTU or PLY file, or the colours of a PLY's vertices.

    Where a file gives vertices alone, an edge and a face have the mean of their ends and corners, and 0 pixels. A file
    without luminance or colours gives a mesh without signals.

    Parameters
    ----------
    path : str or path
        What `read_mesh` takes; the suffix tells.

    Returns
    -------
    TexturedMesh

    Raises
    ------
    InputError
        If the file is not a sound triangle mesh with at least one face, or has signals and one triangle twice.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".vtu":
        return _of_vtu(path, read_vtu(path))
    if suffix == ".ply":
        return _of_ply(path, read_ply(path))
    xyz, faces = read_mesh(path)
    return _mesh(path, xyz, faces, None, None, None, None)


def _of_vtu(path: PathLike, mesh: VtuMesh) -> TexturedMesh:
    cells, count = mesh.cell_data, len(mesh.edges)
    edge, face = ({name: values[part] for name, values in cells.items()} for part in _parts(count))
    has_cells = "luminance" in cells
    found = [
        _luminance(path, columns) if has_cells or columns is mesh.point_data else None
        for columns in (mesh.point_data, edge, face)
    ]
    return _mesh(path, mesh.xyz, mesh.faces, mesh.edges, *found)


def _parts(count: int) -> tuple[slice, slice]:
    return slice(count), slice(count, None)


def _of_ply(path: PathLike, mesh: PlyMesh) -> TexturedMesh:
    vertex = _luminance(path, mesh.vertex)
    return _mesh(path, mesh.xyz, mesh.faces, None, vertex, None, _luminance(path, mesh.face))


def _luminance(path: PathLike, columns: Columns) -> Level | None:
    """Values and marks of a level: its luminance, else its colours as luminance; None where it has neither."""
    if "luminance" in columns:
        values = columns["luminance"].astype(np.float64)
    elif all(name in columns for name in _COLOURS):
        unit = UNIT_OF.get(columns["red"].dtype, 1.0)
        values = np.stack([columns[name] for name in _COLOURS], axis=1).astype(np.float64) @ REC601 * unit
    else:
        return None
    ok = columns["ok"].astype(bool) if "ok" in columns else np.ones(len(values), bool)
    if not np.isfinite(values[ok]).all():
        raise bad_input(path, "has luminance that is not finite", "numbers, or ok = 0 where there is none")
    pixels = columns.get("pixels", ok)
    return np.where(ok if values.ndim == 1 else ok[:, None], values, 0.0), ok, np.asarray(pixels, np.int32)


def _mesh(
    path: PathLike, xyz: FloatArray, faces: NDArray[np.int32], lines: NDArray[np.int32] | None,
    vertex: Level | None, edge: Level | None, face: Level | None,
) -> TexturedMesh:  # fmt: skip
    if not len(faces):
        raise bad_input(path, f"has {len(xyz)} vertices and no faces", "a triangle mesh")
    complex_ = build_complex(faces, len(xyz), lines)
    if len(complex_.faces) != len(faces):
        twice = len(faces) - len(complex_.faces)
        raise bad_input(path, f"has {twice} triangles that are there already", "each triangle once")
    if edge is not None and lines is not None:
        edge = _sorted(complex_, lines, edge)
    shape = next((level[0].shape[1:] for level in (vertex, edge, face) if level is not None), ())
    vertex = vertex or _none(len(xyz), shape)
    edge, face = edge or _means(complex_.edges, vertex), face or _means(complex_.faces, vertex)
    return TexturedMesh(xyz, faces, complex_, _signals(vertex, edge, face))


def _sorted(complex_: Complex, lines: NDArray[np.int32], edge: Level) -> Level:
    """Values of a file's lines in the order of the complex' edges; edges that are no line of the file are marked."""
    n = complex_.n
    keys = np.sort(lines.astype(np.int64), axis=1) @ (n, 1)
    wanted = complex_.edges.astype(np.int64) @ (n, 1)
    values = np.zeros((len(wanted), *edge[0].shape[1:]))
    ok, pixels, rows = np.zeros(len(wanted), bool), np.zeros(len(wanted), np.int32), np.searchsorted(wanted, keys)
    values[rows], ok[rows], pixels[rows] = edge
    return values, ok, pixels


def _none(count: int, channels: tuple[int, ...]) -> Level:
    return np.zeros((count, *channels)), np.zeros(count, bool), np.zeros(count, np.int32)


def _means(elements: NDArray[Any], vertex: Level) -> Level:
    """The mean of each element's vertices, where all of them have a signal."""
    values, ok, _ = vertex
    has_all = ok[elements].all(axis=1)
    means = values[elements].mean(axis=1)
    return (
        np.where(has_all if means.ndim == 1 else has_all[:, None], means, 0.0),
        has_all,
        np.zeros(len(elements), np.int32),
    )


def _signals(vertex: Level, edge: Level, face: Level) -> Signals:
    E, F = len(edge[0]), len(face[0])
    return Signals(
        vertex=vertex[0], edge=edge[0], face=face[0], edge_uv=np.zeros((E, 2)), face_uv=np.zeros((F, 2)),
        edge_pixels=edge[2], face_pixels=face[2],
        vertex_ok=vertex[1], edge_ok=edge[1], face_ok=face[1],
    )  # fmt: skip
