"""A tile as it is handed on: the faces of a chunk, their vertices, and what is known of these."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._brief import brief
from ...types import BoolArray, FloatArray
from . import _zarr
from .halo import faces_of
from .stored_response import StoredResponse


class Tile(NamedTuple):
    """The faces of a chunk with their vertices, as they are handed on.

    Attributes
    ----------
    xyz : (N, 3) float64
        Vertices, m, those of the chunk first, both by rows.
    faces : (F, 3) int32
        Triangles.
    number : (N,) int64
        Numbers of the vertices in the source.
    z : (N,) complex128
        Responses.
    defined : (N,) bool
        Where there is one.
    luminance : (N,) float64 or None
        0 where there is none.
    """

    xyz: FloatArray
    faces: NDArray[np.int32]
    number: NDArray[np.int64]
    z: NDArray[np.complex128]
    defined: BoolArray
    luminance: FloatArray | None

    def __repr__(self) -> str:
        return brief(self)


def load_tile(response: StoredResponse, chunk: int) -> Tile | None:
    """Load the faces whose lowest row is in a chunk.

    Parameters
    ----------
    response : StoredResponse
        The responses.
    chunk : int
        Which.

    Returns
    -------
    Tile or None
        None where there are no such faces.

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    mesh = response.store
    first, last = chunk * mesh.chunk, min((chunk + 1) * mesh.chunk, mesh.n)
    faces = faces_of(mesh, np.arange(first, last))[0]
    lowest = np.minimum(np.minimum(faces[:, 0], faces[:, 1]), faces[:, 2])
    faces = faces[lowest >= first]
    if not len(faces):
        return None
    rows, local = np.unique(faces, return_inverse=True)
    outside = rows[rows >= last].astype(np.int64)
    kept = np.concatenate([rows[rows < last] - first, last - first + np.arange(len(outside))])

    def column(array: Any) -> NDArray[Any]:
        return _zarr.read_around(array, first, last, outside)[kept]

    luminance = np.nan_to_num(column(mesh.arrays["luminance"])) if "luminance" in mesh.arrays else None
    return Tile(
        column(mesh.arrays["xyz"]), local.reshape(-1, 3).astype(np.int32), column(mesh.arrays["id"]),
        column(response.z), column(response.flags), luminance,
    )  # fmt: skip
