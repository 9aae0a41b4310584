"""Responses handed on: a VTU or PLY file for each chunk of a store, and an index that opens them together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._atomic import write_bytes
from ..._files import PathLike
from ...errors import InputError
from ...io import write_ply, write_vtu
from ...io._export_folder import fill_folder
from ...topology.complex import Complex
from . import _zarr
from .halo import faces_of
from .stored_response import StoredResponse

KINDS = ("vtu", "ply")
"""Formats of the files."""


def write_tiles(response: StoredResponse, folder: PathLike, kind: str = "vtu", *, is_forced: bool = False) -> int:
    """Write a file for each chunk that has faces: each face stands in that of its lowest row.

    Vertices carry the response (real, imaginary part, magnitude, phase, defined), their luminance, if they have one,
    and in VTU their numbers. ``tiles.pvd`` opens all VTU files in ParaView at once. One chunk is in memory at a time.

    Parameters
    ----------
    response : StoredResponse
        The responses.
    folder : str or path
        A folder that is not there yet, or empty.
    kind : {"vtu", "ply"}
        The format.
    is_forced : bool
        Whether an earlier export of that kind may be replaced.

    Returns
    -------
    int
        How many files there are, without the index.

    Raises
    ------
    InputError
        If the format is another, a chunk is damaged, or the folder holds something else.
    OutputError
        If the system refuses; nothing is left then.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.scale import write_store
    >>> from tspslam.scale.stores.sources import of_arrays
    >>> source = of_arrays(np.eye(3), [[0, 1, 2]], luminance=[0, 1, 0])
    >>> with tempfile.TemporaryDirectory() as above:
    ...     response = write_store(f"{above}/a.zarr", source).filter()
    ...     write_tiles(response, f"{above}/tiles"), sorted(path.name for path in Path(above, "tiles").iterdir())
    (1, ['000000.vtu', 'tiles.pvd', 'tspslam-export.json'])
    """
    if kind not in KINDS:
        raise InputError(f"kind is {kind!r:.40}, expected {' or '.join(KINDS)}")
    mesh, names = response.store, []
    with fill_folder(Path(folder), f"tiles-{kind}", is_forced=is_forced) as made:
        for k in range(len(mesh.face_end)):
            name = f"{k:06d}.{kind}"
            if _write_tile(response, made / name, k * mesh.chunk, min((k + 1) * mesh.chunk, mesh.n)):
                names.append(name)
        if kind == "vtu":
            write_bytes(made / "tiles.pvd", _index(names).encode())
    return len(names)


def _write_tile(response: StoredResponse, path: Path, first: int, last: int) -> bool:
    """Write the faces whose lowest row is in a chunk; False where there are none."""
    mesh = response.store
    faces = faces_of(mesh, np.arange(first, last))[0]
    lowest = np.minimum(np.minimum(faces[:, 0], faces[:, 1]), faces[:, 2])
    faces = faces[lowest >= first]
    if not len(faces):
        return False
    rows, local = np.unique(faces, return_inverse=True)
    outside = rows[rows >= last]
    kept = np.concatenate([rows[rows < last] - first, last - first + np.arange(len(outside))])
    triangles = local.reshape(-1, 3).astype(np.int32)

    def column(array: Any) -> NDArray[Any]:
        return _zarr.read_around(array, first, last, outside.astype(np.int64))[kept]

    z, xyz = column(response.z), column(mesh.arrays["xyz"])
    vertex = {"real": z.real, "imaginary": z.imag, "magnitude": np.abs(z), "phase": np.angle(z)}
    vertex["defined"] = column(response.flags)
    if "luminance" in mesh.arrays:
        vertex["luminance"] = np.nan_to_num(column(mesh.arrays["luminance"]))
    if path.suffix == ".ply":
        write_ply(path, xyz, triangles, vertex=vertex)
        return True
    vertex["number"] = column(mesh.arrays["id"])
    empty = np.empty((0, 2), np.int32)
    write_vtu(path, Complex(len(xyz), empty, triangles, np.empty((0, 3), np.int32)), xyz, vertex=vertex)
    return True


def _index(names: list[str]) -> str:
    lines = [f'<DataSet timestep="0" part="{k}" file="{name}"/>' for k, name in enumerate(names)]
    head = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">']
    return "\n".join([*head, "<Collection>", *lines, "</Collection>", "</VTKFile>", ""])
