"""Faces of three corners and more: as rows of a file, and cut into triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..topology.cells import Polygons
from ..types import FloatArray

_MOST = (1 << 31) - 1  # corners of all faces: they are counted in 32 bits
_TIPS = 64  # corners of a face that are tried: a fan from one of the first covers any that is convex or nearly so
_THIN = 1e-9  # of a face's area: a triangle below is as good as none
_SHOWN = 8  # corners of a bad face in a message


def polygons_of(lengths: ArrayLike, items: ArrayLike, n: int) -> Polygons:
    """Faces of so many corners each, checked: three at least, and all of them among `n` vertices."""
    counts, corners = np.asarray(lengths, np.int64).ravel(), np.asarray(items, np.int64).ravel()
    few = np.flatnonzero(counts < 3)
    if few.size:
        raise InputError(f"face {few[0]} has {counts[few[0]]} corners, where 3 or more go")
    if len(corners) > _MOST:
        raise InputError(f"has {len(corners)} corners of faces, where at most {_MOST} are read")
    start = np.concatenate([[0], np.cumsum(counts)])
    bad = np.flatnonzero((corners < 0) | (corners >= n))
    if bad.size:
        row = int(np.searchsorted(start, bad[0], "right")) - 1
        shown = corners[start[row] : start[row + 1]][:_SHOWN].tolist()
        raise InputError(f"face {row} has corners {shown}, where 0 to {n - 1} go")
    return Polygons(start.astype(np.int32), corners.astype(np.int32))


def triangles_of(xyz: FloatArray, polygons: Polygons) -> NDArray[np.int32]:
    """Cut faces into fans of triangles, in their order, winding kept: a face of k corners gives k - 2.

    A quad is cut along the shorter of its diagonals that lie inside; a larger face from its first corner from which
    a fan covers it.
    """
    lengths = np.diff(polygons.start)
    faces = np.empty((int((lengths - 2).sum()), 3), np.int32)
    first = np.cumsum(lengths - 2) - (lengths - 2)
    for k in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == k)
        corners = polygons.items[polygons.start[rows, None] + np.arange(k)]
        if k > 3:
            turned = (_tips(xyz, corners, rows)[:, None] + np.arange(k)) % k
            corners = np.take_along_axis(corners, turned, axis=1)
        tip = np.broadcast_to(corners[:, :1], (len(rows), k - 2))
        fans = np.stack([tip, corners[:, 1:-1], corners[:, 2:]], axis=2)
        faces[first[rows, None] + np.arange(k - 2)] = fans
    return faces


def rows_of_triangles(polygons: Polygons) -> NDArray[np.int64]:
    """From which face each of `triangles_of` is cut."""
    return np.repeat(np.arange(len(polygons)), np.diff(polygons.start) - 2)


def strip_triangles(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles of a strip, all wound as the first; those that have a corner twice join parts, and are left out."""
    k = np.arange(max(len(corners) - 2, 0))
    found = corners[np.stack([k, k + 1 + k % 2, k + 2 - k % 2], axis=1)]
    a, b, c = found.T
    return found[(a != b) & (b != c) & (a != c)]


def _tips(xyz: FloatArray, corners: NDArray[np.int32], rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """The corner of each face, (R, k), from which it is cut."""
    ordered = np.sort(corners, axis=1)
    twice = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    if twice.size:
        raise InputError(f"face {rows[twice[0]]} has a vertex twice: {corners[twice[0]][:_SHOWN].tolist()}")
    k = corners.shape[1]
    with np.errstate(over="ignore", invalid="ignore"):
        points = xyz[corners] - xyz[corners[:, :1]]
        size = np.abs(points).max(axis=(1, 2))
        points = points / np.where(size > 0, size, 1)[:, None, None]
    area = np.cross(points, np.roll(points, -1, axis=1)).sum(axis=1)  # Newell: twice it, along the normal
    flat = np.flatnonzero((size > 0) & (np.linalg.norm(area, axis=1) <= _THIN))
    if flat.size:
        said = f"face {rows[flat[0]]} has {k} corners, and no area"
        raise InputError(f"{said}: they are in one line, or its sides cross")
    tip = np.full(len(rows), -1)
    for least in (_THIN, -_THIN):  # flat triangles only where no fan is without
        tried = (_quad_tips(points, area, least),) if k == 4 else range(min(k, _TIPS))
        for corner in tried:
            left = np.flatnonzero(tip < 0)
            at = np.broadcast_to(corner, len(rows))[left]
            tip[left] = np.where(_covers(points[left], area[left], at, least), at, -1)
    if (tip < 0).any():
        row = rows[np.argmax(tip < 0)]
        raise InputError(f"face {row} has {k} corners, and no fan of triangles from one of them covers it")
    return tip


def _covers(points: FloatArray, area: FloatArray, tip: NDArray[np.int64], least: float) -> NDArray[np.bool_]:
    """Whether all triangles of a fan are turned as the face is."""
    k = points.shape[1]
    turned = np.take_along_axis(points, ((tip[:, None] + np.arange(k)) % k)[:, :, None], axis=1)
    turned = turned - turned[:, :1]
    along = (np.cross(turned[:, 1:-1], turned[:, 2:]) * area[:, None]).sum(axis=2)
    kept: NDArray[np.bool_] = along.min(axis=1) >= least * (area**2).sum(axis=1)
    return kept


def _quad_tips(points: FloatArray, area: FloatArray, least: float) -> NDArray[np.int64]:
    """0 or 1: the end of the shorter diagonal that cuts a quad into two triangles."""
    across = [np.linalg.norm(points[:, i + 2] - points[:, i], axis=1) for i in (0, 1)]
    inside = [_covers(points, area, np.full(len(points), i), least) for i in (0, 1)]
    return np.where(inside[1] & ((across[1] < across[0]) | ~inside[0]), 1, 0)
