"""Responses handed on: a VTU, PLY or glTF file for each chunk of a store, and an index that opens them together."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..._atomic import write_bytes
from ..._files import PathLike
from ...errors import InputError
from ...io import write_ply, write_vtu
from ...io._export_folder import fill_folder
from ...topology.complex import Complex
from . import tileset
from .stored_response import StoredResponse
from .tile import Tile, load_tile

KINDS = ("vtu", "ply", "3dtiles")
"""Formats of the files."""

EXPORT = {kind: f"tiles-{kind}" for kind in KINDS}
"""What the list in a folder of them calls it."""

INDEX = {"vtu": "tiles.pvd", "3dtiles": tileset.INDEX}
"""The file that opens them together, where there is one."""


def write_tiles(response: StoredResponse, folder: PathLike, kind: str = "vtu", *, is_forced: bool = False) -> int:
    """Write a file for each chunk that has faces: each face stands in that of its lowest row.

    Vertices carry the response (real, imaginary part, magnitude, phase, defined), their luminance, if they have one,
    and in VTU their numbers. ``tiles.pvd`` opens all VTU files in ParaView at once, ``tileset.json`` all of 3D Tiles in
    Cesium (`tspslam.scale.stores.tileset.write_tileset`). One chunk is in memory at a time; of 3D Tiles a few.

    Parameters
    ----------
    response : StoredResponse
        The responses.
    folder : str or path
        A folder that is not there yet, or empty.
    kind : {"vtu", "ply", "3dtiles"}
        The format.
    is_forced : bool
        Whether an earlier export of that kind may be replaced.

    Returns
    -------
    int
        How many files of chunks there are.

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
        raise InputError(f"kind is {kind!r:.40}, expected one of {', '.join(KINDS)}")
    with fill_folder(Path(folder), EXPORT[kind], is_forced=is_forced) as made:
        if kind == "3dtiles":
            return tileset.write_tileset(response, made)
        names = []
        for chunk in range(len(response.store.face_end)):
            name, tile = f"{chunk:06d}.{kind}", load_tile(response, chunk)
            if tile is not None:
                _write_tile(tile, made / name)
                names.append(name)
        if kind == "vtu":
            write_bytes(made / INDEX[kind], _index(names).encode())
    return len(names)


def _write_tile(tile: Tile, path: Path) -> None:
    """Write a tile as VTU or PLY."""
    z = tile.z
    vertex = {"real": z.real, "imaginary": z.imag, "magnitude": np.abs(z), "phase": np.angle(z)}
    vertex["defined"] = tile.defined
    if tile.luminance is not None:
        vertex["luminance"] = tile.luminance
    if path.suffix == ".ply":
        write_ply(path, tile.xyz, tile.faces, vertex=vertex)
        return
    vertex["number"] = tile.number
    empty = np.empty((0, 2), np.int32)
    complex_ = Complex(len(tile.xyz), empty, tile.faces, np.empty((0, 3), np.int32))
    write_vtu(path, complex_, tile.xyz, vertex=vertex)


def _index(names: list[str]) -> str:
    lines = [f'<DataSet timestep="0" part="{k}" file="{name}"/>' for k, name in enumerate(names)]
    head = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">']
    return "\n".join([*head, "<Collection>", *lines, "</Collection>", "</VTKFile>", ""])
