"""A LiDAR's scan to faces: strips between its rings, closed around the turn, cut where the range steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import told
from .._settings import Checked, setting
from ..errors import GeometryError, InputError
from ..types import BoolArray, FloatArray, Surface
from .diagnosis import checked_positions

_FEWEST_RINGS, _MOST_RINGS = 4, 1024  # of scanners that are built: 16 to 128
_EXPLAINED = 0.8  # share of the elevations' variance that the rings explain; KITTI's HDL-64E: 0.98
_FEWEST = 8  # points of a ring in the mean: fewer are no scan lines
_SPREAD = 0.25  # of the elevations of one ring, as a share of what is between two
_SAME = 1e-5  # rad: directions of one beam, to the rounding of files; the finest scanners turn by 9e-4
_POLE = 1e-6  # of a direction's way from the pole of the projection, against which nothing is lost


@dataclass(frozen=True, repr=False)
class RangeSurface(Surface):
    """Triangles over a scan, and how they were found.

    Attributes
    ----------
    faces : (F, 3) int32
        Vertex triples, counter-clockwise as the scanner sees them.
    rings : int
        How many rings the strips are between; 0 where none were found, and the faces are a Delaunay triangulation.
    merged : int
        How many points no face may have, since a nearer one is in the same direction: second returns, doubled rows.
    """

    rings: int
    merged: int = 0


@dataclass(frozen=True)
class ScanSurface(Checked, what="scan surface"):
    """The surface of a scan by neighbours in its range image, as a stage.

    Attributes
    ----------
    max_range_ratio : float
        A face jumps where the range at one end of a side exceeds that at the other by more than this share of it.
    range_sigma : float
        Standard deviation of a range.
    significance : float
        Only jumps larger than this many standard deviations of the difference count. A face that jumps stays if it
        continues the planes of all its neighbours, to within as many standard deviations: a slope, such as a road, is
        no step.
    max_gap : float
        Faces whose corners are farther apart than this many steps of the scanner, in azimuth or over rings, are left
        out: returns are missing there.

    Raises
    ------
    InputError
        If a setting is out of its range.

    Examples
    --------
    >>> azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 5.0)), np.radians(np.arange(-20, 0, 4.0)))
    >>> rays = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])
    >>> surface = ScanSurface()(7.0 * rays.reshape(3, -1).T)  # a sphere of 7 m around a scanner of five beams
    >>> surface.rings, len(surface.faces)
    (5, 576)
    """

    max_range_ratio: float = setting(
        0.02, 0.0, 1e9, unit="",
        source="synthetic street, 2 cm noise: 0.02, 0.04, 0.08 leave 0.10, 0.30, 0.51 % of faces over a step of 0.3 m",
    )  # fmt: skip
    range_sigma: float = setting(0.02, 0.0, 1e3, unit="m", source="data sheet of the HDL-64E: under 2 cm")
    significance: float = setting(
        6.0, 0.0, 1e9, unit="standard deviations",
        source="synthetic street, 2 cm noise: 4, 5, 6 lose 6.9, 2.3, 1.1 % of the good faces",
    )  # fmt: skip
    max_gap: float = setting(4.0, 1.0, 1e9, unit="steps", source="by hand")

    def __call__(self, xyz: ArrayLike, ring: ArrayLike | None = None) -> RangeSurface:
        """Connect the points of a scan; see `scan_surface`."""
        points = checked_positions(xyz, "scan surface")
        distance = np.linalg.norm(points, axis=1)
        _refuse(points, distance)
        found = find_rings(points) if ring is None else _checked_rings(ring, points)
        first = _first_returns(points, distance, found)
        if len(first) < 3:
            raise GeometryError(f"scan surface: points are in {len(first)} directions, expected at least 3")
        faces, neighbours, keep = (
            _triangulate(points[first] / distance[first, None], self.max_gap) if found is None
            else _zip(points[first], found[first], self.max_gap)
        )  # fmt: skip
        faces = first[faces].astype(np.int32)
        from . import _scan

        noise = self.significance * self.range_sigma + 1e-9
        _scan.cut_steps(points, distance, faces, neighbours, self.max_range_ratio, noise, keep)
        count = 0 if found is None else len(np.unique(found))
        return RangeSurface(np.ascontiguousarray(faces[keep]), count, len(points) - len(first))


def scan_surface(xyz: ArrayLike, ring: ArrayLike | None = None) -> RangeSurface:
    """Connect the points of a scan that are neighbours in its range image; leave out faces over a step of range.

    Points of one ring are ordered by azimuth, and the strip between two rings is filled with triangles, all around the
    turn: no search, and no sliver of three points of one ring. Where no rings are given or found, it is the Delaunay
    triangulation of the directions on the sphere (that of their stereographic projection, which keeps circles). Either
    is a sheet that is star-shaped about the scanner, so that leaving faces out keeps every edge with at most two. Of
    points in one direction, or at one azimuth of a ring, to 1e-5 rad, only the nearest has faces.

    Parameters
    ----------
    xyz : (N, 3) float array
        N >= 3 points in the scanner's frame, m: the scanner is at the origin, its axis is z.
    ring : (N,) integers, optional
        Which beam each point is of. Without, they are looked for, see `find_rings`.

    Returns
    -------
    RangeSurface
        faces (F, 3) int32 into the rows of `xyz`; F may be 0.

    Raises
    ------
    InputError
        If a shape is another, or a position is not finite or at the scanner itself.
    GeometryError
        If there are fewer than 3 points, or all of them are in one direction or on one great circle.

    Examples
    --------
    >>> wall = np.array([[20.0, y, z] for z in (-1, 0, 1, 2) for y in np.linspace(-2, 2, 21)])
    >>> surface = scan_surface(wall, ring=np.repeat([0, 1, 2, 3], 21))
    >>> surface.rings, len(surface.faces)
    (4, 120)
    """
    return ScanSurface()(xyz, ring)


def find_rings(xyz: FloatArray) -> NDArray[np.int64] | None:
    """Find which ring each point of a scan is of, by the order of the rows or by their elevations.

    Rows that go ring by ring, as in KITTI's files, jump back by a turn where the next ring begins; these rings must
    stand in the order of their elevations. Else elevations that come in a few values, each with little spread, as of a
    scanner whose beams meet in one point, tell them.

    Parameters
    ----------
    xyz : (N, 3) float64
        Points in the scanner's frame, m, none at the origin.

    Returns
    -------
    (N,) int64 or None
        Numbers of the rings from 0; None where the points are in no rings.

    Examples
    --------
    >>> turn = np.radians(np.arange(0, 360, 2.0))
    >>> circles = [np.column_stack([np.cos(turn), np.sin(turn), np.full(180, z)]) for z in (-0.3, -0.2, -0.1, 0.0, 0.1)]
    >>> np.bincount(find_rings(np.concatenate(circles))).tolist()
    [180, 180, 180, 180, 180]
    """
    azimuth, elevation = _angles(xyz)
    for seam in (0.0, np.pi):
        ring = _by_order((azimuth - seam) % (2 * np.pi), elevation)
        if ring is not None:
            return ring
    return _by_elevation(elevation)


def _angles(xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Azimuth and elevation, rad."""
    return np.arctan2(xyz[:, 1], xyz[:, 0]), np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1]))


def _by_order(azimuth: FloatArray, elevation: FloatArray) -> NDArray[np.int64] | None:
    steps = np.diff(azimuth)
    if not len(steps):
        return None
    turns = steps[np.abs(steps) > _SAME]  # a beam may have several returns
    steps *= 1.0 if not turns.size or np.median(turns) >= 0 else -1.0
    ring = np.concatenate([[0], np.cumsum(steps < -np.pi)])
    if not _is_plausible(ring, elevation):
        return None
    first = np.flatnonzero(np.diff(ring, prepend=-1))
    middle = np.array([np.median(part) for part in np.split(elevation, first[1:])])
    is_sorted = (np.diff(middle) > 0).all() or (np.diff(middle) < 0).all()
    return ring if is_sorted else None


def _by_elevation(elevation: FloatArray) -> NDArray[np.int64] | None:
    order = np.argsort(elevation, kind="stable")
    gaps = np.diff(elevation[order])
    widest = float(gaps.max(initial=0.0))
    place = np.concatenate([[0], np.cumsum(gaps > _SPREAD * widest)])
    ring = np.empty(len(order), np.int64)
    ring[order] = place
    if not _is_plausible(ring, elevation):
        return None
    first = np.flatnonzero(np.diff(place, prepend=-1))
    last = np.append(first[1:], len(order)) - 1
    low, high = elevation[order][first], elevation[order][last]
    spacing = np.median(low[1:] - high[:-1])
    return ring if (high - low).max() <= _SPREAD * spacing else None


def _is_plausible(ring: NDArray[np.int64], elevation: FloatArray) -> bool:
    """Whether there are as many rings as a scanner has, of enough points, that explain the elevations."""
    count = np.bincount(ring)
    rings = int((count > 0).sum())
    if not _FEWEST_RINGS <= rings <= _MOST_RINGS or len(ring) < _FEWEST * rings:
        return False
    mean = np.bincount(ring, elevation) / np.maximum(count, 1)
    within, whole = np.mean((elevation - mean[ring]) ** 2), np.var(elevation)
    return bool(within <= (1 - _EXPLAINED) * whole)


def _checked_rings(ring: ArrayLike, points: FloatArray) -> NDArray[np.int64] | None:
    """Given rings; None if they are not those of a scanner whose axis is z."""
    values = np.asarray(ring)
    if values.shape != (len(points),) or values.dtype.kind not in "iu":
        raise InputError(f"scan surface: ring is {told(values)}, expected ({len(points)},) integers")
    _, place = np.unique(values, return_inverse=True)
    return place if _is_plausible(place, _angles(points)[1]) else None


def _refuse(points: FloatArray, distance: FloatArray) -> None:
    if len(points) < 3:
        raise GeometryError(f"scan surface: {len(points)} points, expected at least 3")
    at = np.flatnonzero(distance == 0)
    if at.size:
        raise InputError(f"scan surface: point {at[0]} is at the scanner itself, expected points that came back")


def _first_returns(points: FloatArray, distance: FloatArray, ring: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """Rows of points, ascending, of which no nearer one lies in the same direction."""
    beam = _beams(points / distance[:, None]) if ring is None else _beams_of_rings(_angles(points)[0], ring)
    order = np.lexsort((distance, beam))
    return np.sort(order[np.flatnonzero(np.diff(beam[order], prepend=-1))])


def _beams_of_rings(azimuth: FloatArray, ring: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of the beam of each point: one for those of a ring at one azimuth, around the turn."""
    order = np.lexsort((azimuth, ring))
    is_new = np.diff(ring[order], prepend=-1) != 0
    starts = np.flatnonzero(is_new)
    ends = np.append(starts[1:], len(order)) - 1
    number = np.cumsum(is_new | (np.diff(azimuth[order], prepend=-np.inf) > _SAME)) - 1
    first, last = number[starts], number[ends]
    closes = (azimuth[order[ends]] - azimuth[order[starts]] >= 2 * np.pi - _SAME) & (first < last)
    merged = np.arange(len(order))
    merged[last[closes]] = first[closes]
    beam = np.empty(len(order), np.int64)
    beam[order] = merged[number]
    return beam


def _beams(rays: FloatArray) -> NDArray[np.int64]:
    """Number of the beam of each point: one for directions that are the same."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    distinct, beam = np.unique(rays, axis=0, return_inverse=True)  # pairs of many equal rows would be too many
    pairs = cKDTree(distinct).query_pairs(_SAME, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs), np.bool_), (pairs[:, 0], pairs[:, 1])), shape=(len(distinct),) * 2)
    number: NDArray[np.int64] = connected_components(links, directed=False)[1].astype(np.int64)
    return number[beam.ravel()]


def _zip(
    points: FloatArray, ring: NDArray[np.int64], max_gap: float
) -> tuple[NDArray[np.int32], NDArray[np.int32], BoolArray]:
    """Strips between rings: faces, the neighbour across from each corner, and which faces are over no gap."""
    from . import _scan

    azimuth, elevation = _angles(points)
    count = np.bincount(ring)
    middle = np.bincount(ring, elevation) / np.maximum(count, 1)
    rank = np.empty(len(count), np.int64)
    rank[np.argsort(middle, kind="stable")] = np.arange(len(count))
    place = rank[ring]
    used = np.flatnonzero(count[ring] > 1)  # a ring of one point has no side
    order = used[np.lexsort((azimuth[used], place[used]))]
    ordered, turn = place[order], azimuth[order]
    start = np.append(np.flatnonzero(np.diff(ordered, prepend=-1)), len(order))
    sizes = np.diff(start)
    total = int((sizes[:-1] + sizes[1:]).sum())
    faces, neighbours = np.empty((total, 3), np.int32), np.empty((total, 3), np.int32)
    _scan.zip_rings(turn, start, faces, neighbours)
    steps = np.diff(turn)[np.diff(ordered) == 0]
    keep = np.empty(total, np.bool_)
    widest = min(max_gap * float(np.median(steps)) if steps.size else 0.0, np.pi / 2)
    _scan.within_gaps(turn, faces, ordered, widest, max_gap, keep)
    return order[faces].astype(np.int32), neighbours, keep


def _triangulate(rays: FloatArray, max_gap: float) -> tuple[NDArray[np.int32], NDArray[np.int32], BoolArray]:
    """Delaunay triangles of directions: faces, the neighbour across from each corner, and which are over no gap."""
    from .surface import _triangulate as triangulate

    faces, neighbours = triangulate(_stereographic(rays))
    a, b, c = (rays[faces[:, k]] for k in range(3))
    away = np.einsum("ni,ni->n", a, np.cross(b, c)) > 0
    faces[away] = faces[away][:, [0, 2, 1]]
    neighbours[away] = neighbours[away][:, [0, 2, 1]]
    sides = np.stack([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))])
    return faces, neighbours, sides.max(axis=0) <= min(max_gap * float(np.median(sides)), np.sqrt(2.0))


def _stereographic(rays: FloatArray) -> FloatArray:
    """(N, 2) projection of directions from the pole that is opposite to their mean, or, without a mean, from +z."""
    mean = rays.mean(axis=0)
    length = float(np.linalg.norm(mean))
    axis = mean / length if length > _POLE else np.array([0.0, 0.0, -1.0])
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    away = np.maximum(1 + rays @ axis, _POLE)
    return np.column_stack([rays @ u, rays @ np.cross(axis, u)]) / away[:, None]
