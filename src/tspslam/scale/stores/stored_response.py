"""Responses in a store: written run by run, finished when a last file says so, read by rows or as a whole."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._atomic import bad_output, write_bytes
from ..._brief import Brief
from ..._files import bad_input, reason_of
from ...errors import InputError
from ...types import BoolArray, Response
from . import _zarr
from .tiled_filter import Answer, Options

if TYPE_CHECKING:
    from .mesh import StoredMesh

LARGEST_WHOLE = 1 << 32
"""Bytes of responses that are still read as a whole."""

_FOLDER, _DONE, _COMPLETE = "responses", "done", "complete.json"
_TOLD = "defined", "missing", "peak_bytes", "tile"  # of a run, in the summary
_EXPECTED = "a response that was finished: the same filter again finishes it"


@dataclass(frozen=True, repr=False)
class StoredResponse(Brief):
    """The responses of a store. `Store.filter` makes them, `open_response` opens them again.

    Attributes
    ----------
    store : StoredMesh
        The store.
    name : str
        What they are called in it.
    options : Options
        The filter.
    summary : dict
        ``defined``: how many vertices have one; ``missing``: images that are not there; ``peak_bytes``: the most memory
        that a process took; ``tiles``: in how many runs; ``split``: how many of these with smaller tiles, since a
        worker had died.
    z, flags : zarr arrays
        (n,) complex128 and (n,) bool, by rows.
    """

    store: StoredMesh
    name: str
    options: Options
    summary: dict[str, Any]
    z: Any
    flags: Any

    def __len__(self) -> int:
        return self.store.n

    def rows(self, first: int, last: int) -> tuple[NDArray[np.complex128], BoolArray]:
        """Responses of a run of rows.

        Parameters
        ----------
        first, last : int
            Which rows; their vertices are ``store.read("id", first, last)``.

        Returns
        -------
        z : (n,) complex128
            The responses.
        defined : (n,) bool
            Where there is one.

        Raises
        ------
        InputError
            If a chunk is damaged.
        """
        return _zarr.read(self.z, first, last), _zarr.read(self.flags, first, last)

    def tiles(self) -> Iterator[tuple[NDArray[np.int64], NDArray[np.complex128], BoolArray]]:
        """Go through the responses chunk by chunk.

        Yields
        ------
        number : (m,) int64
            Vertices, as the source counts them.
        z : (m,) complex128
            Their responses.
        defined : (m,) bool
            Where there is one.
        """
        for first in range(0, self.store.n, self.store.chunk):
            last = min(first + self.store.chunk, self.store.n)
            yield self.store.read("id", first, last), *self.rows(first, last)

    def read(self) -> Response:
        """Read all responses, in the order of the source's vertices.

        Returns
        -------
        Response

        Raises
        ------
        InputError
            If they take over 4 GiB; `tiles` goes through them.
        """
        if 16 * self.store.n > LARGEST_WHOLE:
            size = 16 * self.store.n / 2**30
            raise InputError(f"{self.store.path}: responses take {size:.1f} GiB, expected at most 4; tiles() goes on")
        z, defined = np.zeros(self.store.n, np.complex128), np.zeros(self.store.n, bool)
        for number, part, flags in self.tiles():
            z[number], defined[number] = part, flags
        return Response(z, self.options.order, defined)


def open_response(store: StoredMesh, name: str) -> StoredResponse:
    """Open responses that were finished.

    Parameters
    ----------
    store : StoredMesh
        The store.
    name : str
        One of ``store.responses``.

    Returns
    -------
    StoredResponse

    Raises
    ------
    InputError
        If there is none of that name, it was not finished, or its files are not whole.
    """
    folder = folder_of(store, name)
    if name not in names_of(store.path):
        had = ", ".join(names_of(store.path)) or "none"
        raise bad_input(store.path, f"has no response {name!r:.60}", f"one that is there: {had}")
    try:
        options, summary = _read_complete(store, folder)
        z, flags = (_zarr.opened(folder, each, "r") for each in ("z", "defined"))
    except FileNotFoundError as error:
        raise bad_input(folder, "was not finished", _EXPECTED) from error
    except _zarr.UNREADABLE as error:
        raise bad_input(folder, f"is damaged ({reason_of(error)})", _EXPECTED) from error
    for array, dtype in ((z, np.complex128), (flags, np.bool_)):
        if array.dtype != dtype or array.shape != (store.n,) or array.chunks != (store.chunk,):
            raise bad_input(folder, f"has {array.dtype} of shape {array.shape}", f"({store.n},), as the store")
        _zarr.check_whole(array)
    return StoredResponse(store, name, options, summary, z, flags)


def _read_complete(store: StoredMesh, folder: Path) -> tuple[Options, dict[str, Any]]:
    found = json.loads((folder / _COMPLETE).read_bytes())
    options = Options.of(found["options"])
    if options.name != folder.name:
        raise ValueError("has the options of another response")
    return options, _told_of(store, found["summary"], (*_TOLD[:3], "tiles", "split"))


def _told_of(store: StoredMesh, found: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """What is kept about responses; `ValueError` where it is not what was written: counts, and images of the store."""
    told = {name: found[name] for name in names}
    counts = [value for name, value in told.items() if name != "missing"]
    if any(type(value) is not int or value < 0 for value in (*counts, *told["missing"])):
        raise ValueError("has counts that are none")
    if any(k >= len(store.images) for k in told["missing"]):
        raise ValueError("names an image that is not in the store")
    return told


def is_complete(store: StoredMesh, name: str) -> bool:
    """Tell whether responses are said to be whole, in a file that can be read.

    Parameters
    ----------
    store : StoredMesh
        The store.
    name : str
        Of the responses.

    Returns
    -------
    bool
    """
    try:
        _read_complete(store, folder_of(store, name))
    except _zarr.UNREADABLE:
        return False
    return True


def folder_of(store: StoredMesh, name: str) -> Path:
    """Folder of responses.

    Parameters
    ----------
    store : StoredMesh
        The store.
    name : str
        Theirs.

    Returns
    -------
    Path
    """
    return store.path / _FOLDER / name


def names_of(store: Path) -> tuple[str, ...]:
    """Names of the responses in a store, finished or not.

    Parameters
    ----------
    store : Path
        Its folder.

    Returns
    -------
    tuple of str
    """
    folder = store / _FOLDER
    return tuple(sorted(each.name for each in folder.iterdir() if each.is_dir())) if folder.is_dir() else ()


def begin(store: StoredMesh, options: Options) -> Path:
    """Make the folder and the arrays of responses, if they are not there.

    Parameters
    ----------
    store : StoredMesh
        The store.
    options : Options
        The filter.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    OutputError
        If the system refuses.
    """
    folder = folder_of(store, options.name)
    try:
        group = _zarr.zarr().open_group(str(store.path), mode="r+", zarr_format=3)
        inner = group.require_group(f"{_FOLDER}/{options.name}")
        for name, dtype in (("z", np.complex128), ("defined", np.bool_)):
            if not (folder / name / "zarr.json").exists():
                _zarr.create(inner, name, (store.n,), dtype, store.chunk)
        (folder / _DONE).mkdir(exist_ok=True)
    except OSError as error:
        raise bad_output(folder, error) from error
    return folder


def store_answer(store: StoredMesh, name: str, first: int, answer: Answer, told: dict[str, Any]) -> None:
    """Write the responses of a run of whole chunks, then that it is done.

    Parameters
    ----------
    store : StoredMesh
        The store.
    name : str
        Of the responses.
    first : int
        First row.
    answer : Answer
        The responses.
    told : dict
        More to keep about the run.

    Raises
    ------
    OutputError
        If the system refuses.
    """
    folder = folder_of(store, name)
    for each, values in (("z", answer.z), ("defined", answer.defined)):
        _zarr.write(_zarr.opened(folder, each, "r+"), first, values, is_synced=True)
    row = told | {"defined": int(answer.defined.sum()), "missing": list(answer.missing)}
    done = folder / _DONE / f"{first}-{first + len(answer.z)}.json"
    write_bytes(done, json.dumps(row, sort_keys=True).encode())


def runs_done(store: StoredMesh, name: str) -> dict[tuple[int, int], dict[str, Any]]:
    """Runs that are finished and whose files are there, and what is kept about each.

    Not those whose images were missing and are there now, or are other files by size or time of change.

    Parameters
    ----------
    store : StoredMesh
        The store.
    name : str
        Of the responses.

    Returns
    -------
    dict
        By (first, last).
    """
    found, folder = {}, folder_of(store, name)
    arrays = [_zarr.opened(folder, each, "r") for each in ("z", "defined")]
    for path in sorted((folder / _DONE).glob("*-*.json")):
        with suppress(*_zarr.UNREADABLE):
            first, last = map(int, path.stem.split("-"))
            row = json.loads(path.read_bytes())
            is_whole = all(_zarr.are_whole(array, first, last) for array in arrays)
            now = stamps_of(store, first, last)
            if is_whole and all(row["images"][k] == stamp for k, stamp in now.items()):
                found[first, last] = _told_of(store, row, _TOLD)
    return found


def stamps_of(store: StoredMesh, first: int, last: int) -> dict[str, list[int]]:
    """Size, bytes, and time of change, ns, of the images of a run that are there: with them its responses change.

    Parameters
    ----------
    store : StoredMesh
        The store.
    first, last : int
        Rows.

    Returns
    -------
    dict
        By the image's number, as text.
    """
    seen = np.flatnonzero((store.image_start[:-1] < last) & (store.image_start[1:] > first))
    found = {}
    for k in seen.tolist():
        with suppress(OSError, ValueError):
            status = store.image_paths[k].stat()
            found[str(k)] = [status.st_size, status.st_mtime_ns]
    return found


def finish(store: StoredMesh, options: Options, summary: dict[str, Any]) -> None:
    """Say that responses are whole: the last file that is written.

    Parameters
    ----------
    store : StoredMesh
        The store.
    options : Options
        The filter.
    summary : dict
        What is told about them.

    Raises
    ------
    OutputError
        If the system refuses.
    """
    folder = folder_of(store, options.name)
    found = {"options": vars(options), "summary": summary}
    write_bytes(folder / _COMPLETE, json.dumps(found, indent=1, sort_keys=True).encode())


def sweep(folder: Path) -> None:
    """Remove what writers that were killed have left, and the word that the responses are whole.

    Parameters
    ----------
    folder : Path
        Of the responses.

    Raises
    ------
    OutputError
        If the system refuses.
    """
    try:
        for path in (*folder.glob("*/*.partial"), folder / _COMPLETE):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise bad_output(folder, error) from error
