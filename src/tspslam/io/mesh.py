"""A mesh from any format that we read; the suffix tells which."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input
from ..errors import InputError
from ..topology.cells import Polygons
from ..types import FloatArray
from ._gltf import read_gltf
from ._obj import read_obj
from ._off import read_off
from ._polygons import polygons_of, triangles_of
from ._stl import read_stl
from .frames import read_frame
from .ply import read_faces
from .vtu import read_grid

Mesh = tuple[FloatArray, Polygons]


def read_mesh(path: PathLike) -> tuple[FloatArray, NDArray[np.int32]]:
    r"""Read positions and triangles from a .ply, .vtu, .obj, .off, .stl, .gltf or .glb file, or a stored frame (.npz).

    A face of more than three corners is cut into a fan of triangles: a quad along the shorter of its diagonals that
    lie inside it, a larger face from its first corner from which a fan covers it.

    Parameters
    ----------
    path : str or path
        The file; its suffix, in any case, tells the format.

    Returns
    -------
    xyz : (N, 3) float64
        Positions, m. Equal corners of an STL file, which shares none, are one. A glTF file's, which has y up and z
        back, are turned to x right, y down, z forward.
    faces : (F, 3) int32
        Triangles, winding kept.

    Raises
    ------
    InputError
        If the suffix is another, or the file is not a sound mesh with at least one face.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "a.obj").write_text("v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 1 2 3 4\n")
    ...     xyz, faces = read_mesh(f"{folder}/a.obj")
    >>> faces.tolist()
    [[0, 1, 2], [0, 2, 3]]
    """
    xyz, polygons = read_polygons(path)
    try:
        return xyz, triangulate_polygons(xyz, polygons)
    except InputError as error:
        raise bad_input(path, str(error), _EXPECTED) from error


def read_polygons(path: PathLike) -> Mesh:
    r"""Read positions and faces as they stand in a file, not cut into triangles.

    Parameters
    ----------
    path : str or path
        As `read_mesh` takes it.

    Returns
    -------
    xyz : (N, 3) float64
        Positions, as `read_mesh` gives them.
    polygons : Polygons
        Faces of three corners and more, winding kept; `tspslam.build_cells` makes a cell complex of them.

    Raises
    ------
    InputError
        As `read_mesh`, but for faces that no fan of triangles covers.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "a.off").write_text("OFF\n4 1 0\n0 0 1\n1 0 1\n1 1 1\n0 1 1\n4 0 1 2 3\n")
    ...     xyz, polygons = read_polygons(f"{folder}/a.off")
    >>> [face.tolist() for face in polygons]
    [[0, 1, 2, 3]]
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise bad_input(path, f"has the suffix {suffix!r}", _EXPECTED)
    xyz, polygons = _READERS[suffix](path)
    if not len(polygons):
        raise bad_input(path, f"has {len(xyz)} vertices and no faces", _EXPECTED)
    return xyz, polygons


def triangulate_polygons(xyz: FloatArray, polygons: Polygons) -> NDArray[np.int32]:
    """Cut faces into fans of triangles, as `read_mesh` does.

    Parameters
    ----------
    xyz : (N, 3) float64
        Positions, m.
    polygons : Polygons
        Faces of three corners and more.

    Returns
    -------
    (F, 3) int32
        Triangles in the order of the faces, winding kept: a face of k corners gives k - 2.

    Raises
    ------
    InputError
        If a face of more than three corners has a vertex twice, or no fan covers it.

    Examples
    --------
    >>> from tspslam import build_cells
    >>> square = build_cells([[0, 1, 2, 3]]).faces
    >>> triangulate_polygons(np.array([[0, 0, 1], [3, 0, 1], [2, 1, 1], [0, 1, 1.0]]), square).tolist()
    [[0, 1, 2], [0, 2, 3]]
    """
    return triangles_of(xyz, polygons)


def _of_ply(path: PathLike) -> Mesh:
    ply, polygons = read_faces(path)
    return ply.xyz, polygons


def _of_vtu(path: PathLike) -> Mesh:
    grid, polygons = read_grid(path)
    return grid.xyz, polygons


def _of_frame(path: PathLike) -> Mesh:
    frame = read_frame(path)
    return frame.cloud.xyz, _triangular(frame.surface.faces, len(frame.cloud.xyz))


def _of_stl(path: PathLike) -> Mesh:
    corners = read_stl(path).reshape(-1, 3)
    xyz, faces = merge_corners(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    return xyz, _triangular(faces, len(xyz))


def _of_gltf(path: PathLike) -> Mesh:
    xyz, faces = read_gltf(path)
    return xyz, _triangular(faces, len(xyz))


def _triangular(faces: NDArray[np.int32] | NDArray[np.int64], n: int) -> Polygons:
    return polygons_of(np.full(len(faces), 3), faces, n)


_READERS: dict[str, Callable[[PathLike], Mesh]] = {
    ".ply": _of_ply, ".vtu": _of_vtu, ".obj": read_obj, ".off": read_off, ".coff": read_off, ".stl": _of_stl,
    ".gltf": _of_gltf, ".glb": _of_gltf, ".npz": _of_frame,
}  # fmt: skip
_EXPECTED = f"a mesh with faces in {', '.join([name for name in _READERS if name != '.npz'])}, or a frame's .npz"


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
    places, merged, kept = merge_corners_of(xyz, faces)
    return places, merged[kept]


def merge_corners_of(
    xyz: FloatArray, faces: NDArray[np.int32]
) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.bool_]]:
    """Merge as `merge_corners`, keeping every face, and tell which of them have three corners still.

    Parameters
    ----------
    xyz, faces
        As `merge_corners`.

    Returns
    -------
    xyz : (M, 3) float64
        The distinct positions.
    faces : (F, 3) int32
        All faces over them.
    kept : (F,) bool
        Those whose corners are three.

    Examples
    --------
    >>> soup = np.array([[0, 0, 1.0], [1, 0, 1], [0, 1, 1], [0, 0, 1]])
    >>> merge_corners_of(soup, np.array([[0, 1, 2], [0, 3, 1]], np.int32))[2].tolist()
    [True, False]
    """
    first, place = _distinct(xyz)
    merged = place[faces]
    a, b, c = merged.T
    return xyz[first], merged.astype(np.int32), (a != b) & (b != c) & (a != c)


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
