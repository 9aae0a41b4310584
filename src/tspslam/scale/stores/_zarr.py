"""Zarr v3 behind the store: arrays cut into rows, a file a chunk, whole and with a checksum or refused."""

from __future__ import annotations

import importlib
import math
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..._atomic import bad_output
from ..._files import bad_input, reason_of
from ...errors import InputError

EXPECTED = "a store of this version, whole: made by tspslam.scale.write_store or tspslam store"
UNREADABLE = (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""What a damaged description makes JSON, Zarr and those who take it apart raise."""
_CHECKSUM = 4  # bytes of CRC-32C after each chunk
_RESIDUE = 0x48674BC7  # CRC-32C of any bytes and their CRC-32C after them


def zarr() -> Any:
    """Return the module, of version 3; `InputError` says how to come by it."""
    try:
        module = importlib.import_module("zarr")
        if int(module.__version__.split(".")[0]) < 3:
            raise ImportError("an older one")
    except ImportError as error:
        raise InputError(
            "zarr is not installed, or is older than 3.1, expected an installation of it: pip install 'tspslam[scale]'"
        ) from error
    return module


def create(group: Any, name: str, shape: tuple[int, ...], dtype: DTypeLike, rows: int) -> Any:
    """Create an array of chunks of so many rows: plain bytes, each chunk one file with its CRC-32C."""
    codecs = importlib.import_module("zarr.codecs")
    return group.create_array(
        name, shape=shape, dtype=np.dtype(dtype), chunks=(max(rows, 1), *shape[1:]), compressors=[codecs.Crc32cCodec()],
        filters=None, fill_value=0, chunk_key_encoding={"name": "default", "separator": "."},
        config={"write_empty_chunks": True},
    )  # fmt: skip


def opened(path: Path, name: str, mode: str) -> Any:
    """Open an array, whose description may be damaged; a chunk of zeros is a file too."""
    module = zarr()
    try:
        with module.config.set({"array.write_empty_chunks": True}):
            return module.open_array(str(path / name), mode=mode, zarr_format=3)
    except UNREADABLE as error:
        raise bad_input(path / name, f"is no Zarr array of version 3 ({reason_of(error)})", EXPECTED) from error


def read(array: Any, first: int, last: int) -> NDArray[Any]:
    """Rows `first` to `last`; a chunk that is damaged or cannot be read is refused by the array's name.

    Chunks are read here, as plain as `create` has them: a call of Zarr takes ten times as long as one of these.
    """
    return read_around(array, first, last, np.empty(0, np.int64))


def read_around(array: Any, first: int, last: int, outside: NDArray[np.int64]) -> NDArray[Any]:
    """Rows `first` to `last`, then rows outside them, ascending, of which one chunk is in memory at a time."""
    chunks, kind, folder = array.chunks, array.dtype, os.fspath(array.store.root)
    start, tail = os.path.join(folder, array.path, "c."), ".0" * (len(chunks) - 1)
    rows, at = chunks[0], last - first
    values = np.empty((at + len(outside), *chunks[1:]), kind)
    for k in range(first // rows, -(-last // rows)):
        low, high = max(first, k * rows), min(last, (k + 1) * rows)
        part = _chunk(f"{start}{k}{tail}", chunks, kind)
        values[low - first : high - first] = part[low - k * rows : high - k * rows]
    for k, begin, end in runs_by_chunk(outside, rows):
        part = _chunk(f"{start}{k}{tail}", chunks, kind)
        values[at + begin : at + end] = part.take(outside[begin:end] - k * rows, axis=0)
    return values


def runs_by_chunk(rows: NDArray[np.int64], chunk: int) -> list[tuple[int, int, int]]:
    """Cut ascending rows where their chunks end: a chunk's number, and the first and last + 1 of the rows in it."""
    if not len(rows):
        return []
    numbers = np.arange(rows[0] // chunk, rows[-1] // chunk + 2)
    ends = np.searchsorted(rows, numbers * chunk)
    there = np.flatnonzero(ends[1:] > ends[:-1])
    return list(zip(numbers[there].tolist(), ends[there].tolist(), ends[there + 1].tolist(), strict=True))


def _chunk(path: str, chunks: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
    """Rows of a chunk, which nobody can change; those used last are kept, as tiles share the chunks of their rims."""
    try:
        status = os.stat(path)
        key = (path, kind, status.st_ino, status.st_size, status.st_mtime_ns)
        if (rows := _kept.find(key)) is not None:
            return rows
        with open(path, "rb") as handle:
            data = handle.read()
    except OSError as error:
        raise bad_input(path, f"cannot be read ({reason_of(error)})", EXPECTED) from error
    count = math.prod(chunks)
    if len(data) != count * kind.itemsize + _CHECKSUM or _crc32c(data) != _RESIDUE:
        raise bad_input(path, "is damaged: its checksum is another", EXPECTED)
    rows = np.frombuffer(data, kind, count).reshape(chunks)
    _kept.add(key, rows)
    return rows


class _Kept:
    """Chunks that were used last, up to so many bytes."""

    def __init__(self, most: int) -> None:
        self._most, self._size, self._lock = most, 0, Lock()
        self._rows: dict[Any, NDArray[Any]] = {}

    def find(self, key: Any) -> NDArray[Any] | None:
        """The chunk, if it is there; it goes last then."""
        with self._lock:
            rows = self._rows.pop(key, None)
            if rows is not None:
                self._rows[key] = rows
            return rows

    def add(self, key: Any, rows: NDArray[Any]) -> None:
        """Keep a chunk; those that were not used for longest go for it."""
        with self._lock:
            if key in self._rows or rows.nbytes > self._most:
                return
            self._rows[key] = rows
            self._size += rows.nbytes
            while self._size > self._most:
                self._size -= self._rows.pop(next(iter(self._rows))).nbytes


_kept = _Kept(64 << 20)  # bytes: a tile's chunks and those of its rim, at 65 536 vertices a chunk; of 400 MB a process


def _crc32c(data: bytes) -> int:
    value: int = importlib.import_module("google_crc32c").value(data)  # Zarr stands on it
    return value


def _size(array: Any) -> int:
    """Bytes of a chunk's file."""
    return int(array.dtype.itemsize * np.prod(array.chunks)) + _CHECKSUM


def write(array: Any, first: int, values: NDArray[Any], *, is_synced: bool = False) -> None:
    """Write rows from `first` on; if asked, they are on the disk when this returns."""
    last, rows = first + len(values), array.chunks[0]
    is_whole = first % rows == 0 and (last % rows == 0 or last == array.shape[0])
    try:
        if not is_whole:
            array[first:last] = values
        for k, key in enumerate(chunk_files(array, first, last)):
            if is_whole:
                _put(folder_of(array) / key, array, values[k * rows : (k + 1) * rows])
            if is_synced:
                _sync(folder_of(array) / key)
    except OSError as error:
        raise bad_output(folder_of(array), error) from error


def _put(path: Path, array: Any, values: NDArray[Any]) -> None:
    """Write a whole chunk as Zarr does, under a name of its own until it is whole; a call of Zarr takes far longer."""
    if len(values) == array.chunks[0]:
        data = values.astype(array.dtype, copy=False).tobytes()
    else:
        rows = np.zeros(array.chunks, array.dtype)
        rows[: len(values)] = values
        data = rows.tobytes()
    place = path.with_name(f"{path.name}.{secrets.token_hex(8)}.partial")
    try:
        with open(place, "wb") as handle:
            handle.write(data)
            handle.write(_crc32c(data).to_bytes(_CHECKSUM, "little"))
        place.replace(path)
    except BaseException:
        place.unlink(missing_ok=True)
        raise


def _sync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def folder_of(array: Any) -> Path:
    """Folder of an array, as its store was named when it was opened."""
    return Path(array.store.root) / array.path


def chunk_files(array: Any, first: int, last: int) -> Iterator[str]:
    """Names of the files that rows `first` to `last` stand in, one by one: a damaged store may claim any number."""
    rows = array.chunks[0]
    tail = ".0" * (array.ndim - 1)
    return (f"c.{k}{tail}" for k in range(first // rows, -(-last // rows)))


def are_whole(array: Any, first: int, last: int) -> bool:
    """Whether the files of rows `first` to `last` are there, of the size that they must have."""
    paths = (folder_of(array) / name for name in chunk_files(array, first, last))
    return all(path.is_file() and path.stat().st_size == _size(array) for path in paths)


def check_whole(array: Any) -> None:
    """Refuse an array of which a chunk's file is missing or has another size: Zarr would take zeros for it."""
    folder = folder_of(array)
    size, codecs = _size(array), [each.to_dict() for each in array.metadata.codecs]
    if [each["name"] for each in codecs] != ["bytes", "crc32c"] or "big" in str(codecs[0]):
        raise bad_input(folder, f"has the codecs {[each['name'] for each in codecs]}", "plain bytes with CRC-32C")
    try:
        found = {entry.name: entry.stat().st_size for entry in os.scandir(folder)}
    except OSError as error:
        raise bad_input(folder, f"cannot be read ({reason_of(error)})", EXPECTED) from error
    for name in chunk_files(array, 0, array.shape[0]):
        if found.get(name) != size:
            said = "is missing" if name not in found else f"has {found[name]} bytes where {size} go"
            raise bad_input(folder / name, said, EXPECTED)
