"""Making a store: one pass over the source, sorted by place through files beside it, in bounded memory."""

from __future__ import annotations

import contextlib
import mmap
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import require
from ..._files import PathLike
from ...errors import InputError
from ...io._folders import new_folder
from . import _zarr
from ._cells import Group, RowCounter, grids_of
from ._spill import BUCKETS, Buckets, append_rows, blocks_of
from .images import ImageReference, to_json
from .mesh import CHUNK, FORMAT, VERSION, checked_chunk, row_type
from .sources import BLOCK, Source, Vertices
from .store import Store, open_store

_FARTHEST = 1e9  # m, px


def write_store(path: PathLike, source: Source, *, chunk: int = CHUNK) -> Store:
    """Make a store of a source: vertices sorted into spatial cells, each chunk with all the faces that touch it.

    The source is read once. Memory does not grow with it but for 8 bytes a cell (64 vertices) and, on disk while it
    is made, about 150 bytes a vertex beside the store.

    Parameters
    ----------
    path : str or path
        The store: a folder that is not there yet, or empty.
    source : Source
        `tspslam.scale.stores.sources.of_arrays` and `of_file` make one.
    chunk : int
        Vertices of a chunk, 1 to 2^24: a file of each column.

    Returns
    -------
    Store

    Raises
    ------
    InputError
        If zarr is not installed, the folder is in use, or a block is not as described: a position that is not finite,
        a face that repeats a vertex or leaves them, an image that is not there.
    OutputError
        If the system refuses; nothing is left then.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.scale.stores.sources import of_arrays
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = write_store(f"{folder}/a.zarr", of_arrays(np.eye(3), [[0, 1, 2]], luminance=[0, 1, 0]))
    ...     store.n, store.n_faces
    (3, 1)
    """
    require(source, Source, "source")
    chunk = checked_chunk(chunk)
    zarr = _zarr.zarr()
    with new_folder(path) as folder:
        work = folder / "unsorted"
        work.mkdir()
        with _said_by(source.name):
            _fill(zarr.open_group(str(folder), mode="a", zarr_format=3), work, source, chunk, Path(path))
        shutil.rmtree(work)
    return open_store(path)


@contextlib.contextmanager
def _said_by(name: str) -> Iterator[None]:
    """What is wrong with a source is said with its name."""
    try:
        yield
    except InputError as error:
        said = str(error)
        raise InputError(said if name in said else f"{name}: {said}") from error


def _fill(group: Any, work: Path, source: Source, chunk: int, target: Path) -> None:
    groups, dtype = _spill_vertices(work, source)
    n = sum(each.count for each in groups)
    if not n:
        raise InputError("has no vertices, expected one or more")
    counts = np.cumsum([0, *(each.count for each in groups)])
    _sort_vertices(work, grids_of(groups), dtype, (n, chunk), group)
    faces = _sort_faces(work, source, (n, chunk), group)
    group.attrs.update(
        {
            "format": FORMAT, "version": VERSION, "vertices": n, "faces": faces, "chunk": chunk,
            "image_start": counts[1:].tolist(), "images": [to_json(each, target) for each in source.images],
        }
    )  # fmt: skip


def _spill_vertices(work: Path, source: Source) -> tuple[list[Group], np.dtype[Any]]:
    """The one pass over the vertices: checked, each with its image, to a file. Groups: those of no image come first."""
    groups, dtype, first = [Group() for _ in range(len(source.images) + 1)], None, 0
    for block in source.vertices:
        rows = _checked(block, source.images, first)
        if dtype is not None and rows.dtype != dtype:
            raise InputError(f"vertex {first}: a block of vertices has other columns than those before it")
        dtype, first = rows.dtype, first + len(rows)
        append_rows(work / "vertices.raw", rows)
        for k in np.unique(rows["image"]).tolist():
            groups[k + 1].add(rows["xyz"][rows["image"] == k])
    return groups, dtype or np.dtype([("xyz", "f8", 3)])


def _checked(block: Vertices, images: tuple[ImageReference, ...], first: int) -> NDArray[Any]:
    """A block as rows, or `InputError` with the number of the first vertex that is wrong."""
    n = len(block.xyz)
    given = {"xyz": (block.xyz, 3, "f8"), "uv": (block.uv, 2, "f8"), "luminance": (block.luminance, 1, "f8")}
    there = {name: (width, kind) for name, (values, width, kind) in given.items() if values is not None}
    parts = [(name, kind, width) if width > 1 else (name, kind) for name, (width, kind) in there.items()]
    rows = np.zeros(n, np.dtype([*parts, ("image", "i4")]))
    for name, (values, _, _) in given.items():
        if values is None:
            continue
        if values.shape != rows[name].shape:
            raise InputError(f"vertex {first}: {name} has shape {values.shape}, expected {rows[name].shape}")
        far = ~(np.abs(values) <= _FARTHEST) if name == "xyz" else np.abs(values) > _FARTHEST
        bad = np.flatnonzero(far.reshape(n, -1).any(axis=1))
        if len(bad):
            raise InputError(
                f"vertex {first + bad[0]}: {name} is {values[bad[0]].tolist()}, expected numbers up to {_FARTHEST:g}"
            )
        rows[name] = values
    rows["image"] = _image_of(block, images) if block.image is None else block.image
    bad = np.flatnonzero((rows["image"] < -1) | (rows["image"] >= len(images)))
    if len(bad):
        raise InputError(f"vertex {first + bad[0]}: image is {rows['image'][bad[0]]}, expected -1 to {len(images) - 1}")
    return rows


def _image_of(block: Vertices, images: tuple[ImageReference, ...]) -> NDArray[np.int32]:
    """The image of each vertex: of those that it falls into, the one whose border is farthest; the first of equals."""
    best, image = np.full(len(block.xyz), -1.0), np.full(len(block.xyz), -1, np.int32)
    for k, each in enumerate(images):
        width, height = each.size
        u, v = each.places(block.xyz, block.uv).T
        inside = np.minimum(np.minimum(u, width - 1 - u), np.minimum(v, height - 1 - v))
        closer = inside > best  # NaN is not
        closer &= inside >= 0
        best[closer], image[closer] = inside[closer], k
    return image


def _sort_vertices(work: Path, grids: list[Any], dtype: np.dtype[Any], sizes: tuple[int, int], group: Any) -> None:
    """Rows of all vertices, then their columns, chunk by chunk; the file ``rows`` tells the row of each number."""
    (n, chunk), counter = sizes, RowCounter(grids)
    for block in blocks_of(work / "vertices.raw", dtype, BLOCK):
        counter.count(block["image"] + 1, block["xyz"])
    counter.begin()
    kept = np.dtype([("row", "i8"), ("id", "i8"), *[(name, *_field(dtype, name)) for name in dtype.names or ()]])
    buckets, first = Buckets(work, "vertices", kept), 0
    step = _rows_of_bucket(n, chunk)
    for block in blocks_of(work / "vertices.raw", dtype, BLOCK):
        rows = np.empty(len(block), kept)
        rows["row"] = counter.rows(block["image"] + 1, block["xyz"])
        rows["id"] = np.arange(first, first + len(block))
        for name in dtype.names or ():
            rows[name] = block[name]
        append_rows(work / "rows.raw", rows["row"].astype(row_type(n)))
        buckets.append(rows["row"] // step, rows)
        first += len(block)
    (work / "vertices.raw").unlink()
    columns = [name for name in kept.names or () if name not in ("row", "image")]
    arrays = {name: _zarr.create(group, name, (n, *kept[name].shape), kept[name].base, chunk) for name in columns}
    at = 0
    for rows in buckets.drain():
        ordered = np.empty(len(rows), kept)
        ordered[rows["row"] - at] = rows
        for name, array in arrays.items():
            if len(rows):
                _zarr.write(array, at, ordered[name])
        at += len(rows)


def _field(dtype: np.dtype[Any], name: str) -> tuple[Any, ...]:
    kind = dtype[name]
    return (kind.base, kind.shape) if kind.shape else (kind.base,)


def _rows_of_bucket(n: int, chunk: int) -> int:
    """Whole chunks, so that all vertices fall into `BUCKETS`."""
    return chunk * max(1, -(-n // (chunk * BUCKETS)))


def _sort_faces(work: Path, source: Source, sizes: tuple[int, int], group: Any) -> int:
    """Copy each face to every chunk that it has a corner in; within a chunk they stand in the order of the source."""
    n, chunk = sizes
    kind = row_type(n)
    row_of, forget = _mapped(work / "rows.raw", kind)
    record = np.dtype([("chunk", "i8"), ("id", "i8"), ("rows", kind, (3,))])
    buckets, first = Buckets(work, "faces", record), 0
    counts, step = np.zeros(-(-n // chunk), np.int64), _rows_of_bucket(n, chunk) // chunk
    for block in source.faces:
        _check_faces(block, n, first)
        rows = row_of[block]
        copies = _copies(rows, np.arange(first, first + len(block)), chunk, record)
        counts += np.bincount(copies["chunk"], minlength=len(counts))
        buckets.append(copies["chunk"] // step, copies)
        first += len(block)
        forget()
    total, each = int(counts.sum()), 2 * chunk
    arrays = {
        "face_rows": _zarr.create(group, "face_rows", (total, 3), kind, each),
        "face_id": _zarr.create(group, "face_id", (total,), np.int64, each),
    }
    ends = _zarr.create(group, "face_end", (len(counts),), np.int64, len(counts))
    _zarr.write(ends, 0, np.cumsum(counts))
    _write_faces(buckets, arrays, each)
    return first


def _mapped(path: Path, kind: np.dtype[Any]) -> tuple[NDArray[Any], Callable[[], object]]:
    """A file of numbers as an array, and what lets go of the memory that looking at it took, where the system can."""
    with open(path, "rb") as handle:
        mapped = mmap.mmap(handle.fileno(), 0, access=mmap.ACCESS_READ)
    drop = getattr(mmap, "MADV_DONTNEED", None)
    return np.frombuffer(mapped, kind), (lambda: None) if drop is None else (lambda: mapped.madvise(drop))


def _check_faces(block: NDArray[Any], n: int, first: int) -> None:
    if block.ndim != 2 or block.shape[1] != 3 or block.dtype.kind not in "iu":
        raise InputError(f"faces are {block.dtype} of shape {block.shape}, expected (F, 3) integers")
    a, b, c = block.T
    bad = np.flatnonzero((block < 0).any(axis=1) | (block >= n).any(axis=1) | (a == b) | (b == c) | (a == c))
    if len(bad):
        said = f"face {first + bad[0]} is {block[bad[0]].tolist()}"
        raise InputError(f"{said}, expected three vertices from 0 to {n - 1}")


def _copies(rows: NDArray[Any], number: NDArray[np.int64], chunk: int, record: np.dtype[Any]) -> NDArray[Any]:
    at = rows.astype(np.int64) // chunk
    other = at[:, 1] != at[:, 0]
    third = (at[:, 2] != at[:, 0]) & (at[:, 2] != at[:, 1])
    which = np.concatenate([np.arange(len(rows)), np.flatnonzero(other), np.flatnonzero(third)])
    copies = np.empty(len(which), record)
    copies["chunk"] = np.concatenate([at[:, 0], at[other, 1], at[third, 2]])
    copies["id"], copies["rows"] = number[which], rows[which]
    return copies


def _write_faces(buckets: Buckets, arrays: dict[str, Any], each: int) -> None:
    """Write the columns of faces, whole chunks at a time."""
    left: NDArray[Any] | None = None
    at = 0
    for rows in buckets.drain():
        ordered = rows[np.lexsort((rows["id"], rows["chunk"]))]
        left = ordered if left is None else np.concatenate([left, ordered])
        full = len(left) // each * each
        _write_columns(arrays, at, left[:full])
        at, left = at + full, left[full:]
    if left is not None:
        _write_columns(arrays, at, left)


def _write_columns(arrays: dict[str, Any], at: int, rows: NDArray[Any]) -> None:
    if len(rows):
        _zarr.write(arrays["face_rows"], at, np.ascontiguousarray(rows["rows"]))
        _zarr.write(arrays["face_id"], at, np.ascontiguousarray(rows["id"]))
