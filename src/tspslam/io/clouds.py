"""Scans of a LiDAR from the files that drivers, data sets and viewers write; the suffix tells which."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from .._checks import require_path
from .._files import PathLike, bad_input, read_bytes
from .._text import numbers, read_lines, split, unmarked
from ..errors import InputError
from ..types import FloatArray
from ._las_points import read_las_points
from ._pcd import read_pcd
from ._ply_body import read_elements
from ._ply_header import parse_header
from .npy import read_npy

_EXPECTED = "a scan in .bin (KITTI), .pcd.bin (nuScenes), .pcd, .las, .laz, .ply, .npy, or text x y z [reflectance]"
_TEXT = (".txt", ".xyz", ".asc", ".csv")
_FARTHEST = 1e9  # m
_MOST = 1 << 28  # points times columns, of a .npy file
_WIDTHS = (3, 4, 5, 6, 7)  # values in a line of text; those after the fourth are passed over
_INTENSITY = ("intensity", "reflectance", "reflectivity", "scalar_intensity", "scalar_Intensity", "i")
_RING = ("ring", "channel", "laser_id", "scalar_ring")
_MOST_RINGS = 1 << 15
Rows = tuple[FloatArray, FloatArray | None, NDArray[np.int64] | None]
"""Places, intensities and rings of all rows of a file."""


@dataclass(frozen=True, repr=False)
class Scan(Brief):
    """One turn of a LiDAR: the points that came back, in its own frame.

    Attributes
    ----------
    xyz : (N, 3) float64
        Places, in the scanner's frame, m (z is up along its axis, as drivers have it).
    intensity : (N,) float64 or None
        How much came back, as the file says it: 0 to 1 in KITTI's and in LAS, 0 to 255 in many others.
    ring : (N,) int64 or None
        Which beam of the scanner each point is of, where the file says so.
    dropped : int
        How many rows of the file are no place: at the scanner itself (0, 0, 0) or not finite, as drivers mark beams
        that did not come back.
    """

    xyz: FloatArray
    intensity: FloatArray | None = None
    ring: NDArray[np.int64] | None = None
    dropped: int = 0

    def __len__(self) -> int:
        return len(self.xyz)


def read_scan(path: PathLike) -> Scan:
    """Read a scan: KITTI's and nuScenes' ``.bin``, PCD, LAS, LAZ, PLY, ``.npy`` or text.

    Parameters
    ----------
    path : str or path
        The file; its suffix, in any case, tells the format. ``.bin`` are float32 rows x y z reflectance, ``.pcd.bin``
        those of five, the last being the ring; PCD is text, binary or compressed, of any fields and types; a ``.npy``
        array and text have the columns x y z and, if there are more, reflectance first. LAZ needs ``tspslam[las]``.

    Returns
    -------
    Scan
        In the order of the file, without the rows that are no place.

    Raises
    ------
    InputError
        If the suffix is another, the file is damaged, claims more than it holds, has no x, y and z, none of its rows is
        a place, or one is beyond 1e9 m.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     rows = np.array([[1, 2, 3, 0.5], [0, 0, 0, 0]], np.float32)
    ...     rows.tofile(f"{folder}/000000.bin")
    ...     scan = read_scan(f"{folder}/000000.bin")
    >>> scan.xyz.tolist(), scan.intensity.tolist(), scan.dropped
    ([[1.0, 2.0, 3.0]], [0.5], 1)
    """
    require_path(path)
    try:
        return _cleaned(path, *_read(path))
    except MemoryError as error:
        raise bad_input(path, "is larger than the memory", _EXPECTED) from error


def _read(path: PathLike) -> Rows:
    """Places, intensities and rings of all rows."""
    name = Path(path).name.lower()
    suffix = Path(name).suffix
    if suffix in _TEXT:
        return _of_table(_text_table(path))
    if suffix == ".npy":
        return _of_table(_npy_table(path))
    reader = next((read for end, read in _READERS.items() if name.endswith(end)), None)
    if reader is None:
        raise bad_input(path, f"has the suffix {suffix!r}", _EXPECTED)
    data = read_bytes(path, _EXPECTED)
    try:
        found: Rows = reader(data)
        return found
    except InputError as error:
        raise bad_input(path, str(error), _EXPECTED) from error


def _of_floats(data: bytes, width: int) -> NDArray[np.float32]:
    if len(data) % (4 * width):
        raise InputError(f"has {len(data)} bytes, which are no rows of {width} float32")
    return np.frombuffer(data, "<f4").reshape(-1, width)


def _of_bin(data: bytes) -> Rows:
    return _of_table(_of_floats(data, 4))


def _of_nuscenes(data: bytes) -> Rows:
    table = _of_floats(data, 5)
    return *_of_table(table)[:2], _rings(table[:, 4])


def _of_pcd(data: bytes) -> Rows:
    return _of_columns(read_pcd(data))


def _of_ply(data: bytes) -> Rows:
    plain = unmarked(data)
    return _of_columns(read_elements(plain, parse_header(plain)).get("vertex", {}))


def _of_las(data: bytes) -> Rows:
    return *read_las_points(data), None


_READERS = {
    ".pcd.bin": _of_nuscenes,
    ".bin": _of_bin,
    ".pcd": _of_pcd,
    ".ply": _of_ply,
    ".las": _of_las,
    ".laz": _of_las,
}


def _text_table(path: PathLike) -> FloatArray:
    rows: list[list[float]] = []
    separator = "," if Path(path).suffix.lower() == ".csv" else None
    for line in read_lines(path, _EXPECTED):
        if line[1]:
            counts = (len(rows[0]),) if rows else _WIDTHS
            rows.append(numbers(path, line, split(path, line, _EXPECTED, counts, separator), _EXPECTED))
    if not rows:
        raise bad_input(path, "has no line of values", _EXPECTED)
    return np.array(rows)


def _npy_table(path: PathLike) -> NDArray[Any]:
    table = read_npy(path, _EXPECTED, _MOST)
    if table.shape[1] not in _WIDTHS:
        raise bad_input(path, f"holds an array of shape {table.shape}", f"{_WIDTHS[0]} to {_WIDTHS[-1]} columns")
    return table


def _of_table(table: NDArray[Any]) -> tuple[FloatArray, FloatArray | None, None]:
    intensity = table[:, 3].astype(np.float64) if table.shape[1] > 3 else None
    return table[:, :3].astype(np.float64), intensity, None


def _of_columns(columns: Mapping[str, NDArray[Any]]) -> Rows:
    if not {"x", "y", "z"} <= columns.keys():
        raise InputError("has no points with x, y and z")
    xyz = np.stack([columns[axis].astype(np.float64) for axis in "xyz"], axis=1)
    intensity = next((columns[name].astype(np.float64) for name in _INTENSITY if name in columns), None)
    return xyz, intensity, next((_rings(columns[name]) for name in _RING if name in columns), None)


def _rings(values: NDArray[Any]) -> NDArray[np.int64]:
    exact = values.astype(np.float64)
    bad = ~((exact == np.rint(exact)) & (exact >= 0) & (exact < _MOST_RINGS))
    if bad.any():
        raise InputError(f"has the ring {exact[bad][0]:g}, where whole numbers from 0 to {_MOST_RINGS - 1} go")
    return exact.astype(np.int64)


def _cleaned(path: PathLike, xyz: FloatArray, intensity: FloatArray | None, ring: NDArray[np.int64] | None) -> Scan:
    """Leave out what is no place."""
    is_place = np.isfinite(xyz).all(axis=1) & xyz.any(axis=1)
    if not is_place.any():
        raise bad_input(path, f"has no point that is a place among its {len(xyz)} rows", _EXPECTED)
    far = np.flatnonzero(is_place & (np.abs(xyz).max(axis=1) > _FARTHEST))
    if far.size:
        raise bad_input(path, f"has point {far[0]} at {xyz[far[0]].tolist()}", f"metres, at most {_FARTHEST:g}")
    if intensity is not None and not np.isfinite(intensity[is_place]).all():
        bad = np.flatnonzero(is_place & ~np.isfinite(intensity))[0]
        raise bad_input(path, f"has point {bad} with a reflectance that is not finite", _EXPECTED)
    strength = None if intensity is None else intensity[is_place]
    return Scan(xyz[is_place], strength, None if ring is None else ring[is_place], int((~is_place).sum()))
