"""A tile with its halo: the rows of a tile, and as many rings around them as a filter looks at, found by topology."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._brief import brief
from ...topology.complex import Complex, build_complex
from ...types import FloatArray
from . import _zarr
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
    xyz : (N, 3) float64 or None
        Their places, m, if they were asked for.
    uv : (N, 2) float64 or None
        Their places in the plane of the images.
    luminance : (N,) float64 or None
        Their own values.
    """

    complex_: Complex
    own: NDArray[np.int64]
    number: NDArray[np.int64]
    xyz: FloatArray | None
    uv: FloatArray | None
    luminance: FloatArray | None

    def __repr__(self) -> str:
        return brief(self)


def load_piece(store: StoredMesh, first: int, last: int, rings: int, columns: Collection[str]) -> Piece:
    """Load rows of a store and the halo that responses over so many rings need.

    Parameters
    ----------
    store : StoredMesh
        The store.
    first, last : int
        Rows of the tile, at least one.
    rings : int
        How far the filter looks, in topological distance; 0 loads the rows and their faces alone.
    columns : collection of str
        What is asked for of the vertices: ``xyz``, ``uv``, ``luminance``.

    Returns
    -------
    Piece

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    from . import _kernels

    faces, order = _faces_around(store, first, last, max(rings, 1))
    outside = np.unique(_kernels.rows_outside(faces, first, last))
    number = _zarr.read_around(store.arrays["id"], first, last, outside)
    visit = np.argsort(number, kind="stable")
    place = np.empty(len(number), np.int32)
    place[visit] = np.arange(len(number), dtype=np.int32)
    local = _kernels.local_faces(faces, order, first, last, outside, place)
    found = {
        name: _zarr.read_around(store.arrays[name], first, last, outside).take(visit, axis=0)
        for name in columns
        if name in store.arrays
    }
    own = place[: last - first].astype(np.int64)
    return Piece(
        build_complex(local, len(number)), own, number.take(visit), *map(found.get, ("xyz", "uv", "luminance"))
    )


def _faces_around(store: StoredMesh, first: int, last: int, rings: int) -> tuple[NDArray[Any], Rows]:
    """Faces, by rows, with a corner within ``rings - 1`` of the tile's vertices; and their order, each once."""
    from . import _kernels

    faces, number = faces_of(store, np.arange(first, last))
    inner = np.empty(0, np.int64)  # vertices outside the tile whose faces are there
    for _ in range(rings - 1):
        met = np.unique(_kernels.rows_outside(faces, first, last))
        new = np.setdiff1d(met, inner, assume_unique=True)
        if not len(new):
            break
        more, named = faces_of(store, new)
        faces, number = np.concatenate([faces, more]), np.concatenate([number, named])
        inner = met
    order = np.argsort(number, kind="stable")
    ordered = number[order]
    is_new = np.ones(len(order), bool)
    is_new[1:] = ordered[1:] != ordered[:-1]
    return faces, order[is_new]


def faces_of(store: StoredMesh, rows: Rows) -> tuple[NDArray[Any], Rows]:
    """Read the faces that have a corner among some rows, chunk by chunk: a face comes with each of its chunks.

    Parameters
    ----------
    store : StoredMesh
        The store.
    rows : (n,) int64
        Rows, ascending, at least one.

    Returns
    -------
    faces : (M, 3) int32 or int64
        By rows.
    number : (M,) int64
        Theirs in the source.

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    from . import _kernels

    found, named = [], []
    for chunk, low, high in _zarr.runs_by_chunk(rows, store.chunk):
        begin, end = int(store.face_end[chunk - 1]) if chunk else 0, int(store.face_end[chunk])
        faces, number = store.read("face_rows", begin, end), store.read("face_id", begin, end)
        if high - low < min(store.chunk, store.n - chunk * store.chunk):
            kept = _kernels.faces_among(faces, rows[low:high])
            faces, number = faces.take(kept, axis=0), number.take(kept)
        found.append(faces)
        named.append(number)
    return np.concatenate(found), np.concatenate(named)
