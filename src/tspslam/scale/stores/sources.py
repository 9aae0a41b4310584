"""What a store is made of: vertices and faces in blocks, from arrays, PLY and LAS files, or a run's map."""

from __future__ import annotations

import mmap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._brief import Brief, brief
from ..._checks import real_array
from ..._files import PathLike, bad_input, open_input
from ...errors import InputError
from ...io import load_map, load_run, read_mesh, read_ply, read_textured
from ...io._las_points import parse_header as parse_las
from ...io._ply_header import LARGEST_HEADER, Element, parse_header
from ...io.las import _module
from ...types import FloatArray
from .images import ImageReference

BLOCK = 1 << 18
"""Vertices, or faces, that are in memory at a time."""

_PLY, _LAS = "a PLY file of points and triangles", "a LAS or LAZ file"


class Vertices(NamedTuple):
    """A block of vertices, in the order of their numbers.

    Attributes
    ----------
    xyz : (N, 3) float64
        Positions, m.
    uv : (N, 2) float64 or None
        Places in the plane of the images without a camera, px; NaN where there is none.
    luminance : (N,) float64 or None
        Own values, for a cloud without images; NaN where there is none.
    image : (N,) int32 or None
        The image that each is seen in, a row of the source's `images`; -1 for none.
    """

    xyz: FloatArray
    uv: FloatArray | None = None
    luminance: FloatArray | None = None
    image: NDArray[np.int32] | None = None

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, repr=False)
class Source(Brief):
    """Vertices and faces in blocks, each read once, vertices first.

    Attributes
    ----------
    vertices : iterable of Vertices
        Blocks, all with the same columns.
    faces : iterable of (F, 3) int arrays
        Triples of vertices, counted from 0 over all blocks.
    images : sequence of ImageReference
        Where the vertices are seen.
    name : str
        What it is called in messages.
    """

    vertices: Iterable[Vertices]
    faces: Iterable[NDArray[Any]]
    images: tuple[ImageReference, ...] = ()
    name: str = "source"


def of_arrays(
    xyz: ArrayLike, faces: ArrayLike, *, uv: ArrayLike | None = None, luminance: ArrayLike | None = None,
    image: ArrayLike | None = None, images: Iterable[ImageReference] = (),
) -> Source:  # fmt: skip
    """Take vertices and faces from arrays; memory-mapped ones are read block by block.

    Parameters
    ----------
    xyz : (N, 3) float array
        Vertices, m.
    faces : (F, 3) integers
        Triangles.
    uv : (N, 2) float array, optional
        Places in the plane of the images, px.
    luminance : (N,) float array, optional
        Own values.
    image : (N,) integers, optional
        The image of each vertex, -1 for none; chosen if there are images and this is not given.
    images : iterable of ImageReference
        The images.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        If an array has another shape or kind.
    """
    points = real_array(xyz, "xyz", "(N, 3)")
    n = len(points) if points.ndim else 0
    columns = {"xyz": (points, (n, 3)), "uv": (uv, (n, 2)), "luminance": (luminance, (n,)), "image": (image, (n,))}
    arrays = {name: real_array(v, name, str(shape)) for name, (v, shape) in columns.items() if v is not None}
    for name, values in arrays.items():
        if values.shape != columns[name][1]:
            raise InputError(f"{name} has shape {values.shape}, expected {columns[name][1]}")
    triples = np.asarray(faces)
    if triples.size == 0:
        triples = np.empty((0, 3), np.int32)

    def blocks() -> Iterator[Vertices]:
        for first in range(0, n, BLOCK):
            part: dict[str, Any] = {name: values[first : first + BLOCK] for name, values in arrays.items()}
            real = {name: part[name].astype(np.float64) for name in part if name != "image"}
            yield Vertices(**real, image=part["image"].astype(np.int32) if "image" in part else None)

    return Source(blocks(), (triples[f : f + BLOCK] for f in range(0, len(triples), BLOCK)), tuple(images), "arrays")


def of_file(
    path: PathLike, *, faces: PathLike | None = None, images: Iterable[ImageReference] = ()
) -> Source:  # fmt: skip
    """Take vertices and faces from a file or a run folder; binary PLY of triangles, LAS and LAZ block by block.

    Parameters
    ----------
    path : str or path
        A .ply (its vertices may have ``u`` and ``v``, places in the plane of the images, and ``luminance``), .las,
        .laz, another mesh that `tspslam.io.read_mesh` takes (read as a whole), or a run folder with a map: its vertices
        are seen in the keyframes that their responses are of.
    faces : str or path, optional
        For LAS: (F, 3) integers in a .npy file.
    images : iterable of ImageReference
        The images, of a file.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        If the file is damaged, or not as described.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir():
        return _of_map(path)
    if faces is not None and suffix not in (".las", ".laz"):
        raise bad_input(path, "has faces of its own", ".las or .laz, where faces are given")
    if suffix in (".las", ".laz"):
        triples = np.empty((0, 3), np.int32) if faces is None else _mapped(Path(faces))
        parts = (triples[f : f + BLOCK] for f in range(0, len(triples), BLOCK))
        return Source(_las_blocks(path), parts, tuple(images), str(path))
    streamed = _of_ply(path, tuple(images)) if suffix == ".ply" else None
    return streamed or _of_mesh(path, tuple(images))


def _mapped(path: Path) -> NDArray[Any]:
    try:
        array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise bad_input(path, f"cannot be read ({error})", "(F, 3) integers in a .npy file") from error
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise bad_input(path, f"holds {array.dtype} of shape {array.shape}", "(F, 3) integers in a .npy file")
    return array


def _of_mesh(path: Path, images: tuple[ImageReference, ...]) -> Source:
    uv: FloatArray | None = None
    if path.suffix.lower() == ".ply":
        columns = read_ply(path).vertex
        uv = np.stack([columns["u"], columns["v"]], axis=1, dtype=np.float64) if {"u", "v"} <= set(columns) else None
    if path.suffix.lower() in (".ply", ".vtu"):
        mesh = read_textured(path)
        ok = mesh.signals.vertex_ok
        own = np.where(ok, mesh.signals.vertex, np.nan) if ok.any() and mesh.signals.vertex.ndim == 1 else None
        xyz, faces = mesh.xyz, mesh.faces
    else:
        (xyz, faces), own = read_mesh(path), None
    found = of_arrays(xyz, faces, uv=uv, luminance=None if images else own, images=images)
    return Source(found.vertices, found.faces, images, str(path))


def _of_map(run: Path) -> Source:
    """A run's map, each vertex in the keyframe that its response is of, or else in its best one."""
    map_, stored = load_map(run), load_run(run)
    places = zip(map_.keyframes.tolist(), map_.T_world_camera, strict=True)
    images = [ImageReference(str(stored.path / "frames" / f"{number:06d}.npz"), map_.rig, T) for number, T in places]
    image = np.where(map_.response_view >= 0, map_.response_view, map_.best_view.vertex)
    found = of_arrays(map_.xyz, map_.surface.faces, image=image, images=images)
    return Source(found.vertices, found.faces, tuple(images), str(run))


def _of_ply(path: Path, images: tuple[ImageReference, ...]) -> Source | None:
    """Binary PLY whose elements are vertices, then triangles without lists but their corners; else None."""
    with open_input(path, _PLY, largest=1 << 62) as handle:
        head, size = handle.read(LARGEST_HEADER), path.stat().st_size
    try:
        header = parse_header(head)
    except InputError as error:
        raise bad_input(path, str(error), _PLY) from error
    kinds = [element.name for element in header.elements]
    if header.order == "" or kinds not in (["vertex"], ["vertex", "face"]) or header.elements[0].lists:
        return None
    rows = [_row_type(element, header.order) for element in header.elements]
    if any(row is None for row in rows):
        return None
    start = np.cumsum([header.size, *(e.count * r.itemsize for e, r in zip(header.elements, rows, strict=True))])
    if start[-1] > size:
        if len(rows) == 2 and start[1] + header.elements[1].count <= size:
            return None  # faces of other lengths, perhaps: who reads them whole will tell
        raise bad_input(path, f"claims {header.elements[0].count} vertices, more than the file can hold", _PLY)
    if len(rows) == 2 and not _all_triangles(path, int(start[1]), rows[1], header.elements[1].count):
        return None
    vertices = _ply_vertices(path, int(start[0]), rows[0], header.elements[0].count, bool(images))
    faces = _ply_faces(path, int(start[1]), rows[1], header.elements[1].count) if len(rows) == 2 else iter(())
    return Source(vertices, faces, images, str(path))


def _row_type(element: Element, order: str) -> Any:
    """Type of a row whose only list are three corners; None if there is another."""
    parts: list[tuple[Any, ...]] = []
    for each in element.properties:
        if each.length_code is None:
            parts.append((each.name, order + each.code))
        elif each.name in ("vertex_indices", "vertex_index") and each.code[0] in "iu":
            parts += [(" length", order + each.length_code), (" corners", order + each.code, (3,))]
        else:
            return None
    return np.dtype(parts) if element.name == "vertex" or any(name == " corners" for name, *_ in parts) else None


def _rows(path: Path, start: int, dtype: Any, count: int) -> Iterator[NDArray[Any]]:
    with open(path, "rb") as handle:
        handle.seek(start)
        for first in range(0, count, BLOCK):
            block = np.fromfile(handle, dtype, min(BLOCK, count - first))
            if len(block) < min(BLOCK, count - first):
                raise bad_input(path, "is truncated", "the file to stay as it is")
            yield block


def _all_triangles(path: Path, start: int, dtype: Any, count: int) -> bool:
    """Whether the first faces have three corners; one further on that has not is refused where it comes."""
    return all((block[" length"] == 3).all() for block in _rows(path, start, dtype, min(count, BLOCK)))


def _ply_vertices(path: Path, start: int, dtype: Any, count: int, has_images: bool) -> Iterator[Vertices]:
    names = set(dtype.names or ())
    if not {"x", "y", "z"} <= names:
        raise bad_input(path, "has no vertices with x, y and z", _PLY)
    has_luminance = "luminance" in names and not has_images
    for block in _rows(path, start, dtype, count):
        xyz = np.stack([block[axis].astype(np.float64) for axis in "xyz"], axis=1)
        uv = np.stack([block[axis].astype(np.float64) for axis in "uv"], axis=1) if {"u", "v"} <= names else None
        yield Vertices(xyz, uv, block["luminance"].astype(np.float64) if has_luminance else None)


def _ply_faces(path: Path, start: int, dtype: Any, count: int) -> Iterator[NDArray[Any]]:
    for block in _rows(path, start, dtype, count):
        if (block[" length"] != 3).any():
            said = "has faces of three corners, and further on others"
            raise bad_input(path, said, "triangles alone: in a file this large polygons are not cut")
        yield block[" corners"].astype(np.int64)


def _las_blocks(path: Path) -> Iterator[Vertices]:
    """Places in the file's axes (z up) and intensities, 0 to 1."""
    with open_input(path, _LAS, largest=1 << 62) as handle, mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ) as m:
        try:
            header = parse_las(m)  # type: ignore[arg-type]
        except InputError as error:
            raise bad_input(path, str(error), _LAS) from error
    blocks = _laz_rows(path, header.count) if header.is_packed else _las_rows(path, header)
    for at, intensity in blocks:
        xyz = at * np.array(header.scale) + np.array(header.offset)
        yield Vertices(xyz, luminance=intensity / 65535.0)


def _las_rows(path: Path, header: Any) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    names = {"names": ["at", "intensity"], "formats": ["(3,)<i4", "<u2"], "offsets": [0, 12]}
    dtype: Any = np.dtype({**names, "itemsize": header.row_size})  # type: ignore[call-overload]
    for block in _rows(path, header.start, dtype, header.count):
        yield block["at"], block["intensity"]


def _laz_rows(path: Path, count: int) -> Iterator[tuple[NDArray[Any], NDArray[Any]]]:
    laspy, found = _module("laspy"), 0
    _module("lazrs")
    try:
        with laspy.open(path) as reader:
            for points in reader.chunk_iterator(BLOCK):
                found += len(points)
                yield np.stack([points.X, points.Y, points.Z], axis=1), np.asarray(points.intensity)
    except BaseException as error:  # lazrs panics with what is no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit | InputError):
            raise
        raise bad_input(path, f"has LAZ data that are damaged ({type(error).__name__})", _LAS) from error
    if found != count:
        raise bad_input(path, f"holds {found} points, where {count} are claimed", _LAS)
