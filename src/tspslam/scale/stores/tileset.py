"""3D Tiles 1.1 of a store: a tree of glTF files, triangles of a chunk in each leaf, points of it in the tiles above."""

from __future__ import annotations

import json
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._atomic import write_bytes
from ..._brief import brief
from ...io.glb import Drawn, Mode, write_glb
from ...types import BoolArray, FloatArray
from ._cells import Grid
from .stored_response import StoredResponse
from .tile import load_tile

INDEX = "tileset.json"
"""The file that is opened."""

_CHILDREN = 4  # of a tile, as in a quadtree
_DEPTH = 15  # 2^15 cells a side, in whose Morton order chunks are put together; `Grid` counts up to 2^16
_EACH = 64  # rows to one whose magnitude decides on the scale of colours
_FLATTEST = 1e-3  # m: half of a box, which viewers turn into a volume


class Points(NamedTuple):
    """Vertices with what is known of them.

    Attributes
    ----------
    xyz : (N, 3) float64
        m; z up.
    rgb : (N, 3) uint8
        The magnitude of the response in colours.
    values : (N, k) float32
        Its numbers, in the order of the names.
    """

    xyz: FloatArray
    rgb: NDArray[np.uint8]
    values: NDArray[np.float32]

    def __repr__(self) -> str:
        return brief(self)


class Node(NamedTuple):
    """A tile that is written.

    Attributes
    ----------
    tile : dict
        Its JSON, with that of the tiles below.
    low, high : (3,) float64
        The box around it and those below, m.
    points : Points
        Its vertices.
    """

    tile: dict[str, Any]
    low: FloatArray
    high: FloatArray
    points: Points

    def __repr__(self) -> str:
        return brief(self)


def write_tileset(response: StoredResponse, folder: Path) -> int:
    """Write ``tileset.json`` and a glTF file for each tile.

    A leaf has the faces whose lowest row is in its chunk, and no error. A tile above has as many points as one of those
    below, taken from them evenly; those below replace them. Each vertex below lies within its ``geometricError`` of a
    point. Places are the store's, z up; each file stands at the middle of its box, so that float32 is enough.

    Parameters
    ----------
    response : StoredResponse
        The responses.
    folder : path
        Where the files go.

    Returns
    -------
    int
        Number of leaves.

    Raises
    ------
    InputError
        If a chunk is damaged, or a tile too large for float32.
    OutputError
        If the system refuses.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.scale import write_store
    >>> from tspslam.scale.stores.sources import of_arrays
    >>> source = of_arrays(np.eye(3), [[0, 1, 2]], luminance=[0, 1, 0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     count = write_tileset(write_store(f"{folder}/a.zarr", source).filter(), Path(folder))
    ...     count, json.loads(Path(folder, INDEX).read_bytes())["root"]["content"]
    (1, {'uri': '000000.glb'})
    """
    writer = _Writer(response, folder)
    root = writer.write(_in_morton_order(response).tolist())
    assert root is not None, "a store without faces has no responses"
    whole = max(float(np.linalg.norm(root.high - root.low)), root.tile["geometricError"])
    tileset = {
        "asset": {"version": "1.1", "extras": writer.legend},
        "geometricError": whole,
        "root": root.tile | {"refine": "REPLACE"},
    }
    write_bytes(folder / INDEX, json.dumps(tileset, allow_nan=False, indent=1).encode())
    return writer.leaves


def _in_morton_order(response: StoredResponse) -> NDArray[np.int64]:
    """Chunks, such that four that follow each other lie together."""
    mesh = response.store
    firsts = range(0, mesh.n, mesh.chunk)
    middle = np.array([mesh.read("xyz", first, min(first + mesh.chunk, mesh.n)).mean(axis=0) for first in firsts])
    low, extent = middle.min(axis=0), np.ptp(middle, axis=0)
    one, other = sorted(np.argsort(-extent, kind="stable")[:2].tolist())
    cells = Grid(0, _DEPTH, (one, other), low, float(extent.max()) or 1.0).cells(middle)
    return np.argsort(cells, kind="stable")


class _Writer:
    """Tiles while they are written, those below first: a few of them are in memory."""

    def __init__(self, response: StoredResponse, folder: Path) -> None:
        self.response, self.folder = response, folder
        self.leaves = self.above = 0
        self.span = _span_of(response)
        self.names = ["magnitude", "phase", "defined"]
        self.names += ["luminance"] if "luminance" in response.store.arrays else []
        scale = {"layer": "magnitude", "of": "|r|", "scale": "inferno", "span": list(self.span), "is_log10": True}
        self.legend = {"generator": "tspslam", "response": response.name, "unit": "m"} | scale

    def write(self, chunks: list[int]) -> Node | None:
        """Write a tile of some chunks and those below it; None where they have no face."""
        if len(chunks) == 1:
            return self._leaf(chunks[0])
        size = 1
        while size * _CHILDREN < len(chunks):
            size *= _CHILDREN
        parts = [self.write(chunks[k : k + size]) for k in range(0, len(chunks), size)]
        children = [part for part in parts if part is not None]
        return self._parent(children) if len(children) > 1 else children[0] if children else None

    def _leaf(self, chunk: int) -> Node | None:
        tile = load_tile(self.response, chunk)
        if tile is None:
            return None
        numbers = [np.abs(tile.z), np.angle(tile.z), tile.defined]
        numbers += [] if tile.luminance is None else [tile.luminance]
        rgb = _colours(tile.z, tile.defined, self.span)
        points = Points(tile.xyz, rgb, np.stack(numbers, axis=1).astype(np.float32))
        self.leaves += 1
        low, high = self._draw(f"{chunk:06d}.glb", points, tile.faces)
        return _node(f"{chunk:06d}.glb", low, high, points)

    def _parent(self, children: list[Node]) -> Node:
        """Every second to fourth of the children's points, as there are two to four of them."""
        parts = zip(*(child.points for child in children), strict=True)
        points = Points(*(np.concatenate(part)[:: len(children)] for part in parts))
        name = f"above-{self.above:06d}.glb"
        self.above += 1
        low, high = self._draw(name, points, None)
        low = reduce(np.minimum, [child.low for child in children], low)
        high = reduce(np.maximum, [child.high for child in children], high)
        made = _node(name, low, high, points, error=_error_of(children, points))
        return made._replace(tile=made.tile | {"children": [child.tile for child in children]})

    def _draw(self, name: str, points: Points, faces: NDArray[np.int32] | None) -> tuple[FloatArray, FloatArray]:
        """Write a file; the box of what stands in it."""
        middle = (points.xyz.min(axis=0) + points.xyz.max(axis=0)) / 2
        local = points.xyz - middle
        values = dict(zip(self.names, points.values.T, strict=True))
        mode: Mode = "points" if faces is None else "triangles"
        drawn = Drawn(name[:-4], mode, _turned(local), points.rgb, faces, values=values, at=_turned(middle))
        write_glb(self.folder / name, [drawn], extras=self.legend)
        rounded = local.astype(np.float32).astype(np.float64)
        return middle + rounded.min(axis=0), middle + rounded.max(axis=0)


def _node(name: str, low: FloatArray, high: FloatArray, points: Points, error: float = 0.0) -> Node:
    """A tile; its box is that of its JSON, so that the one above holds what is drawn of a flat one too."""
    middle, half = (low + high) / 2 + 0.0, np.maximum((high - low) / 2, _FLATTEST)  # no -0
    box = [*middle.tolist(), *np.diag(half).ravel().tolist()]
    tile = {"boundingVolume": {"box": box}, "geometricError": error, "content": {"uri": name}}
    return Node(tile, np.minimum(low, middle - half), np.maximum(high, middle + half), points)


def _error_of(children: list[Node], points: Points) -> float:
    """How far a vertex below may be from the nearest point, m: as far as a child's point is, and what it stands for."""
    from scipy.spatial import KDTree

    near = KDTree(points.xyz)
    return max(float(near.query(child.points.xyz)[0].max()) + child.tile["geometricError"] for child in children)


def _turned(xyz: FloatArray) -> FloatArray:
    """Axes of the store, z up, as `write_glb` takes them, y down and z forward: 3D Tiles turn what it writes back."""
    return xyz[..., [0, 2, 1]] * (1.0, -1.0, 1.0)


def _log_magnitude(z: NDArray[np.complex128], defined: BoolArray) -> tuple[FloatArray, BoolArray]:
    """``log10 |r|`` and where there is one."""
    size = np.abs(z)
    ok = defined & (size > 0)
    return np.log10(np.where(ok, size, 1.0)), ok


def _span_of(response: StoredResponse) -> tuple[float, float]:
    """Ends of the scale of colours, of every 64th row: those of a map's magnitude."""
    from ...view._frame import limits

    found = []
    for _, z, defined in response.tiles():
        values, ok = _log_magnitude(z[::_EACH], defined[::_EACH])
        found.append(values[ok])
    return limits(np.concatenate(found))


def _colours(z: NDArray[np.complex128], defined: BoolArray, span: tuple[float, float]) -> NDArray[np.uint8]:
    """Colours of the magnitude, as a map has them."""
    from ...view._layers import Layer, colours_of

    values, ok = _log_magnitude(z, defined)
    return colours_of(Layer("magnitude", "Magnitude", "vertex", values, ok, "|r|", "inferno", span, "", is_log=True))
