"""Scans of a LiDAR in the world to one set of faces: where an earlier scan has a surface, later ones add nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from ..errors import GeometryError, InputError
from ..types import BoolArray, FloatArray

_CELLS = 1 << 20  # of a voxel's number along an axis, to both sides of 0: three of them fit 64 bits
_MOST_SAMPLES = 1 << 26  # on the sides of one scan's faces


class PlacedScan(NamedTuple):
    """A scan in the world.

    Attributes
    ----------
    xyz : (N, 3) float64
        Points, m.
    faces : (F, 3) int32
        Its surface.
    """

    xyz: FloatArray
    faces: NDArray[np.int32]

    def __repr__(self) -> str:
        return brief(self)


def join_scans(scans: Sequence[PlacedScan], voxel: float) -> PlacedScan:
    """Put scans together: of each, the faces whose corners lie in no voxel that a side of an earlier scan's face meets.

    Sheets of several scans are not sewn together: between them a strip as wide as a face is left.

    Parameters
    ----------
    scans : sequence of PlacedScan
        In the order in which they count.
    voxel : float
        Side of the voxels, m.

    Returns
    -------
    PlacedScan
        Points that have a face, in the order of the scans.

    Raises
    ------
    InputError
        If a point is a million voxels away from the origin, or a scan meets too many voxels.
    GeometryError
        If no face is left.

    Examples
    --------
    >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    >>> one = PlacedScan(square, np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    >>> other = PlacedScan(square + (0, 0, 3), one.faces)
    >>> len(join_scans([one, one, other], 0.1).faces)
    4
    """
    filled = np.empty(0, np.int64)
    xyz, faces, count = [], [], 0
    for scan in scans:
        is_new = ~np.isin(_voxels(scan.xyz, voxel), filled)
        kept = scan.faces[is_new[scan.faces].all(axis=1)]
        is_used = np.zeros(len(scan.xyz), np.bool_)
        is_used[kept] = True
        faces.append((np.cumsum(is_used) - 1)[kept] + count)
        xyz.append(scan.xyz[is_used])
        count += int(is_used.sum())
        filled = np.union1d(filled, _met(scan.xyz, kept, voxel))
    if not any(map(len, faces)):
        raise GeometryError(f"scans: no face of {len(scans)} scans is left, expected scans with a surface")
    return PlacedScan(np.concatenate(xyz), np.concatenate(faces).astype(np.int32))


def _voxels(xyz: FloatArray, voxel: float) -> NDArray[np.int64]:
    """One number for the voxel of each point."""
    cell = np.floor(xyz / voxel)
    far: BoolArray = np.abs(cell).max(axis=1, initial=0.0) >= _CELLS
    if far.any():
        at = xyz[int(np.argmax(far))].tolist()
        raise InputError(
            f"scans: a point is at {at}, expected less than {_CELLS} voxels of {voxel:g} m from the origin"
        )
    whole = cell.astype(np.int64) + _CELLS
    numbers: NDArray[np.int64] = (whole[:, 0] * (2 * _CELLS) + whole[:, 1]) * (2 * _CELLS) + whole[:, 2]
    return numbers


def _met(xyz: FloatArray, faces: NDArray[np.int32], voxel: float) -> NDArray[np.int64]:
    """Voxels that the sides of faces meet, looked at every half voxel."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    sides = np.unique(np.sort(sides, axis=1), axis=0)
    a, b = xyz[sides[:, 0]], xyz[sides[:, 1]]
    steps = np.maximum(1, np.ceil(2 * np.linalg.norm(b - a, axis=1) / voxel)).astype(np.int64)
    total = int((steps + 1).sum())
    if total > _MOST_SAMPLES:
        raise InputError(f"scans: voxels of {voxel:g} m are met {total} times by one scan, expected larger voxels")
    side = np.repeat(np.arange(len(sides)), steps + 1)
    first = np.cumsum(steps + 1) - (steps + 1)
    share = (np.arange(total) - first[side]) / steps[side]
    return np.unique(_voxels(a[side] + share[:, None] * (b[side] - a[side]), voxel))
