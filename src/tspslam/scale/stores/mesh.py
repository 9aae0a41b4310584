"""The mesh of a store: how large it is, its columns by rows, its images; checked when it is opened."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ..._checks import require_path
from ..._files import PathLike, bad_input, reason_of
from ...errors import InputError
from . import _zarr
from .images import ImageReference, from_json

FORMAT, VERSION = "tspslam store", 1
CHUNK = 1 << 16
"""Vertices of a chunk: 1.5 MB of positions, and 1500 chunks of 10^8 vertices."""

_LARGEST_CHUNK = 1 << 24
_COLUMNS = {"xyz": (np.dtype("f8"), (3,)), "id": (np.dtype("i8"), ()), "uv": (np.dtype("f8"), (2,)),
            "luminance": (np.dtype("f8"), ())}  # fmt: skip
_FACES = "face_rows", "face_id", "face_end"


def checked_chunk(chunk: int) -> int:
    """Return the vertices of a chunk as an int, or raise `InputError`.

    Parameters
    ----------
    chunk : int
        1 to 2^24.

    Returns
    -------
    int
    """
    if isinstance(chunk, bool) or not isinstance(chunk, int | np.integer) or not 1 <= chunk <= _LARGEST_CHUNK:
        raise InputError(f"chunk is {chunk!r:.40}, expected 1 to {_LARGEST_CHUNK} vertices")
    return int(chunk)


@dataclass(frozen=True, repr=False)
class StoredMesh(Brief):
    """A mesh on disk, larger than the memory perhaps. Open it with `open_mesh`.

    Vertices stand by image and place: *rows*. Their numbers, in which results are told, are those of the source.

    Attributes
    ----------
    path : Path
        The folder.
    n, n_faces : int
        Vertices, and triangles.
    chunk : int
        Vertices of a chunk.
    images : tuple of ImageReference
        What the vertices are seen in, as they were given.
    image_paths : tuple of Path
        Where these lie now.
    image_start : (K + 1,) int64
        Rows of the vertices of image k: ``image_start[k]`` to ``image_start[k + 1]``; those before have no image.
    arrays : dict
        The arrays of Zarr by name.
    moved : str or None
        The folder that the images lie in now, if it was told.
    """

    path: Path
    n: int
    n_faces: int
    chunk: int
    images: tuple[ImageReference, ...]
    image_paths: tuple[Path, ...]
    image_start: NDArray[np.int64]
    arrays: Mapping[str, Any]
    moved: str | None

    @cached_property
    def face_end(self) -> NDArray[np.int64]:
        """Where the faces of each chunk end, (chunks,) int64; they begin where those of the one before end."""
        ends = self.read("face_end", 0, self.arrays["face_end"].shape[0])
        if (np.diff(ends, prepend=0) < 0).any() or ends[-1] != self.arrays["face_rows"].shape[0]:
            said = "has ends of chunks that do not rise to the number of faces"
            raise bad_input(self.path / "face_end", said, _zarr.EXPECTED)
        return ends

    def read(self, column: str, first: int, last: int) -> NDArray[Any]:
        """Rows of a column.

        Parameters
        ----------
        column : str
            ``xyz``, ``id`` (the vertex's number), ``uv``, ``luminance``; of faces ``face_rows`` and ``face_id``.
        first, last : int
            Which rows.

        Returns
        -------
        (n, k) or (n,) float64, int32 or int64 array

        Raises
        ------
        InputError
            If there is no such column, the rows are not there, or a chunk is damaged.
        """
        if column not in self.arrays:
            raise InputError(f"{self.path}: has no column {column!r:.40}, expected one of {', '.join(self.arrays)}")
        if not 0 <= first <= last <= self.arrays[column].shape[0]:
            raise InputError(f"{self.path}: rows are {first} to {last}, expected 0 to {self.arrays[column].shape[0]}")
        values = _zarr.read(self.arrays[column], first, last)
        limit = {"id": self.n, "face_rows": self.n, "face_id": self.n_faces}.get(column)
        if limit is not None and values.size and not 0 <= values.min() <= values.max() < limit:
            raise bad_input(self.path / column, f"holds {values.min()} to {values.max()}", f"0 to {limit - 1}")
        return values


def open_mesh(path: PathLike, *, images: PathLike | None = None) -> StoredMesh:
    """Open the mesh of a store that `write_store` made, after a look at all its files' sizes.

    Parameters
    ----------
    path : str or path
        The folder.
    images : str or path, optional
        The folder in which the images lie now. Without it they are looked for from the store's place on, then where
        they were.

    Returns
    -------
    StoredMesh

    Raises
    ------
    InputError
        If zarr is not installed, the folder is no store, of another version, half-written, or its parts do not fit
        each other.

    Examples
    --------
    >>> open_mesh("nowhere.zarr")
    Traceback (most recent call last):
    tspslam.errors.InputError: nowhere.zarr: is not there; expected a store: tspslam.scale.write_store makes one
    """
    require_path(path)
    zarr, folder = _zarr.zarr(), Path(path)
    if not folder.is_dir():
        said = "is no folder" if folder.exists() else "is not there"
        raise bad_input(path, said, "a store: tspslam.scale.write_store makes one")
    try:
        group = zarr.open_group(str(folder), mode="r", zarr_format=3)
        attributes = dict(group.attrs)
    except _zarr.UNREADABLE as error:
        raise bad_input(path, f"is no Zarr group of version 3 ({reason_of(error)})", _zarr.EXPECTED) from error
    _check_version(folder, attributes)
    arrays = {name: _zarr.opened(folder, name, "r") for name in (*_COLUMNS, *_FACES) if (folder / name).exists()}
    found = _parts(folder, attributes)
    _check_arrays(folder, arrays, *found)
    n, n_faces, chunk, start = found
    references = tuple(_reference(folder, k, each) for k, each in enumerate(attributes["images"]))
    moved = None if images is None else os.path.abspath(images)
    places = tuple(_place(folder, each, images) for each in attributes["images"])
    return StoredMesh(folder, n, n_faces, chunk, references, places, np.array(start, np.int64), arrays, moved)


def _check_version(folder: Path, attributes: dict[str, Any]) -> None:
    if attributes.get("format") != FORMAT:
        raise bad_input(folder, "is a Zarr group of something else, or a store that was not finished", _zarr.EXPECTED)
    if attributes.get("version") != VERSION:
        raise bad_input(folder, f"is a store of version {attributes.get('version')!r:.20}", f"version {VERSION}")


def _parts(folder: Path, attributes: dict[str, Any]) -> tuple[int, int, int, list[int]]:
    """Sizes of a store, as its attributes claim them."""
    try:
        n, n_faces, chunk = (int(attributes[name]) for name in ("vertices", "faces", "chunk"))
        start = [int(value) for value in attributes["image_start"]]
        is_sound = n > 0 and n_faces >= 0 and chunk > 0 and len(start) == len(attributes["images"]) + 1
    except _zarr.UNREADABLE as error:
        raise bad_input(folder, f"has attributes that are damaged ({reason_of(error)})", _zarr.EXPECTED) from error
    if not is_sound or start != sorted(start) or start[0] < 0 or start[-1] != n:
        raise bad_input(folder, "has attributes that do not fit each other", _zarr.EXPECTED)
    return n, n_faces, chunk, start


def _check_arrays(folder: Path, arrays: Mapping[str, Any], n: int, n_faces: int, chunk: int, _: list[int]) -> None:
    """Hold the arrays against what the attributes claim, and their files against the arrays."""
    copies = arrays["face_id"].shape[0] if "face_id" in arrays else 0
    kind = row_type(n)
    wanted: dict[str, tuple[Any, tuple[int, ...], int]] = {
        name: (dtype, (n, *tail), chunk) for name, (dtype, tail) in _COLUMNS.items()
    }
    wanted |= {"face_rows": (kind, (copies, 3), 2 * chunk), "face_id": (np.dtype("i8"), (copies,), 2 * chunk)}
    wanted["face_end"] = (np.dtype("i8"), (-(-n // chunk),), -(-n // chunk))
    for name, (dtype, shape, rows) in wanted.items():
        if name not in arrays:
            if name in ("uv", "luminance"):
                continue
            raise bad_input(folder, f"has no array {name}", _zarr.EXPECTED)
        array = arrays[name]
        if array.dtype != dtype or array.shape != shape or array.chunks[0] != rows:
            said = f"is {array.dtype} of shape {array.shape} in chunks of {array.chunks[0]} rows"
            raise bad_input(folder / name, said, f"{dtype} of shape {shape} in chunks of {rows}")
        _zarr.check_whole(array)
    if not n_faces <= copies <= 3 * n_faces:
        raise bad_input(folder, f"has {copies} rows of faces for {n_faces} faces", _zarr.EXPECTED)


def _reference(folder: Path, k: int, told: Any) -> ImageReference:
    """Image k of a store, as its attributes describe it."""
    try:
        if not all(isinstance(told[name], str) and "\0" not in told[name] for name in ("path", "relative")):
            raise TypeError("its path is no text")
        return from_json(told)
    except (InputError, KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise bad_input(folder, f"has an image {k} that is damaged ({reason_of(error)})", _zarr.EXPECTED) from error


def _place(folder: Path, image: dict[str, Any], images: PathLike | None) -> Path:
    if images is not None:
        return Path(images) / Path(image["path"]).name
    relative = folder / image["relative"]
    return relative if os.path.exists(relative) else Path(image["path"])


def row_type(n: int) -> np.dtype[Any]:
    """Type of the rows of so many vertices.

    Parameters
    ----------
    n : int
        How many.

    Returns
    -------
    dtype
    """
    return np.dtype(np.int32 if n < 1 << 31 else np.int64)
