"""A tile with its halo: the rows of a tile, and as many rings around them as a filter looks at, found by topology."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._brief import brief
from ...topology.complex import Complex, build_complex
from ...types import FloatArray
from .mesh import StoredMesh

Rows = NDArray[np.int64]


class Piece(NamedTuple):
    """The part of a mesh that the responses of a tile depend on, numbered in the order of the whole.

    Since vertices and faces keep their order, all sums over a neighbourhood run as they do in the whole mesh.

    Attributes
    ----------
    complex_ : Complex
        Of all faces that have a corner within ``rings - 1`` of the tile.
    own : (n,) int64
        Vertices of the piece that are the tile's, in the order of its rows.
    number : (N,) int64
        Numbers of the piece's vertices in the whole, ascending.
    xyz : (N, 3) float64
        Their places, m.
    uv : (N, 2) float64 or None
        Their places in the plane of the images.
    luminance : (N,) float64 or None
        Their own values.
    """

    complex_: Complex
    own: NDArray[np.int64]
    number: NDArray[np.int64]
    xyz: FloatArray
    uv: FloatArray | None
    luminance: FloatArray | None

    def __repr__(self) -> str:
        return brief(self)


def load_piece(store: StoredMesh, first: int, last: int, rings: int = 1) -> Piece:
    """Load rows of a store and the halo that responses over so many rings need.

    Parameters
    ----------
    store : StoredMesh
        The store.
    first, last : int
        Rows of the tile.
    rings : int
        How far the filter looks, in topological distance; 0 loads the rows and their faces alone.

    Returns
    -------
    Piece

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    faces, number = _faces_around(store, first, last, max(rings, 1))
    outside = np.unique(faces[(faces < first) | (faces >= last)])
    ids = np.concatenate([store.read("id", first, last), _gather(store, "id", outside)])
    order = np.argsort(ids, kind="stable")
    place = np.empty(len(ids), np.int32)
    place[order] = np.arange(len(ids), dtype=np.int32)
    columns = {
        name: np.concatenate([store.read(name, first, last), _gather(store, name, outside)])[order]
        for name in ("xyz", "uv", "luminance")
        if name in store.arrays
    }
    local = np.where(faces < last, faces - first, 0)
    is_outside = (faces < first) | (faces >= last)
    local[is_outside] = last - first + np.searchsorted(outside, faces[is_outside])
    complex_ = build_complex(place[local][np.argsort(number, kind="stable")], len(ids))
    own = place[: last - first].astype(np.int64)
    return Piece(complex_, own, ids[order], columns["xyz"], columns.get("uv"), columns.get("luminance"))


def _faces_around(store: StoredMesh, first: int, last: int, rings: int) -> tuple[Rows, Rows]:
    """Faces, by rows, with a corner within ``rings - 1`` of the tile's vertices, and their numbers; each once."""
    faces, number = _faces_of(store, np.arange(first, last))
    inner = np.empty(0, np.int64)  # vertices outside the tile whose faces are there
    for _ in range(rings - 1):
        met = np.unique(faces[(faces < first) | (faces >= last)])
        new = np.setdiff1d(met, inner, assume_unique=True)
        if not len(new):
            break
        more, named = _faces_of(store, new)
        faces, number = _once(np.concatenate([faces, more]), np.concatenate([number, named]))
        inner = met
    return faces, number


def _faces_of(store: StoredMesh, rows: Rows) -> tuple[Rows, Rows]:
    """Faces that have a corner among some rows, ascending; each once."""
    found, named = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    low, high = int(rows[0]), int(rows[-1]) + 1
    is_run = high - low == len(rows)
    for chunk in np.unique(rows // store.chunk).tolist():
        begin, end = int(store.face_end[chunk - 1]) if chunk else 0, int(store.face_end[chunk])
        faces = store.read("face_rows", begin, end).astype(np.int64)
        is_met = (faces >= low) & (faces < high)
        if not is_run:
            at = np.searchsorted(rows, faces[is_met])
            is_met[is_met] = rows[at] == faces[is_met]
        kept = is_met.any(axis=1)
        found.append(faces[kept])
        named.append(store.read("face_id", begin, end)[kept])
    return _once(np.concatenate(found), np.concatenate(named))


def _once(faces: Rows, number: Rows) -> tuple[Rows, Rows]:
    """Faces by number, each once."""
    order = np.argsort(number, kind="stable")
    ordered = number[order]
    is_new = np.ones(len(order), bool)
    is_new[1:] = ordered[1:] != ordered[:-1]
    return faces[order[is_new]], ordered[is_new]


def _gather(store: StoredMesh, column: str, rows: Rows) -> NDArray[np.generic]:
    """Values of scattered rows, one chunk in memory at a time."""
    array = store.arrays[column]
    values = np.empty((len(rows), *array.shape[1:]), array.dtype)
    chunk = store.chunk
    for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows // chunk)) + 1 if len(rows) else []):
        if not len(run):
            continue
        begin, end = run[0], run[-1] + 1
        low, high = int(rows[begin]), int(rows[end - 1]) + 1
        values[begin:end] = store.read(column, low, high)[rows[begin:end] - low]
    return values
