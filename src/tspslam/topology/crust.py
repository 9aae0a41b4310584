"""Points all around a body to its closed surface: the Crust of Amenta, Bern and Kamvysselis, then a flood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError
from ..types import BoolArray, Cloud, FloatArray, Surface
from .complex import first_of_equals
from .diagnosis import checked_positions, diagnose_surface, edges_of

# Lengths from here on are in units of the cloud's longest side; the cloud stands around the origin.
BOX = 5.0 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
"""Corners around the cloud, so that the Voronoi cell of every sample is bounded."""

FARTHEST_POLE = 8.0
"""Poles beyond this are pulled in: only their direction matters there."""

POLE_CELL = 1 / 32
"""Poles that are this close, as a share of the distance to their samples, do the work of one."""

JITTER = 1e-7
"""How far samples move for the triangulation, as a share of their mean spacing: enough to part those on one sphere."""

FACETS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Corners of a tetrahedron opposite to each corner."""


@dataclass(frozen=True)
class CrustReport:
    """What `crust_surface` did, and whether it came off.

    Attributes
    ----------
    points, distinct_points : int
        Rows given, and how many of them differ.
    raw_faces, raw_nonmanifold_edges : int
        Triangles of the Crust before the flood, and their edges with more than two of them.
    faces : int
        Triangles kept.
    boundary_edges, nonmanifold_edges : int
        Edges of the result with one face (holes), and with more than two.
    misoriented_edges : int
        Edges that their two faces run along in the same direction: 0, unless scales a billionfold apart meet.
    pinched_vertices : int
        Vertices whose faces fall into several fans.
    unused_points : int
        Distinct points without a face.
    components : int
        Parts of the result that share no vertex.
    euler : int
        ``V - E + F`` over the vertices that have a face: 2 for a sphere, 0 for a torus.

    Examples
    --------
    >>> report = CrustReport(6, 6, 8, 0, 8, 0, 0, 0, 0, 0, 1, 2)
    >>> print(report)
    6 points, 8 faces, Euler characteristic 2: closed manifold
    """

    points: int
    distinct_points: int
    raw_faces: int
    raw_nonmanifold_edges: int
    faces: int
    boundary_edges: int
    nonmanifold_edges: int
    misoriented_edges: int
    pinched_vertices: int
    unused_points: int
    components: int
    euler: int

    @property
    def is_closed_manifold(self) -> bool:
        """Whether the result is a closed manifold through all the points."""
        return self.faces > 0 and not any(count for count, _ in self._flaws())

    @property
    def verdict(self) -> str:
        """``"closed manifold"``, or in one line what is wrong and what to try."""
        if self.is_closed_manifold:
            return "closed manifold"
        flaws = ", ".join(f"{count} {flaw}" for count, flaw in self._flaws() if count) or "no face"
        return f"no closed manifold ({flaws}): too sparse, too noisy or open; for an open cloud use delaunay_surface"

    def __str__(self) -> str:
        return f"{self.points} points, {self.faces} faces, Euler characteristic {self.euler}: {self.verdict}"

    def _flaws(self) -> tuple[tuple[int, str], ...]:
        return (
            (self.unused_points, "points without a face"),
            (self.boundary_edges, "edges at holes"),
            (self.nonmanifold_edges, "edges with more than two faces"),
            (self.misoriented_edges, "edges with faces wound apart"),
            (self.pinched_vertices, "vertices with several fans"),
        )


@dataclass(frozen=True, repr=False)
class CrustSurface(Surface):
    """Triangles around a body, with the account of how they came about.

    Attributes
    ----------
    faces : (F, 3) int32
        Vertex triples, counter-clockwise seen from outside.
    report : CrustReport
        What was done and whether the surface is a closed manifold.
    """

    report: CrustReport


@dataclass(frozen=True)
class Crust:
    """The closed surface around a cloud, as a stage; takes the place of `DelaunaySurface`.

    Examples
    --------
    >>> xyz = np.array([[1., 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    >>> len(Crust()(Cloud(xyz + [0, 0, 4], np.zeros((6, 2)), np.ones(6))).faces)
    8
    """

    def __call__(self, cloud: Cloud) -> CrustSurface:
        """Wrap `cloud`; see `crust_surface`."""
        return crust_surface(cloud.xyz)


def crust_surface(xyz: FloatArray) -> CrustSurface:
    """Wrap a surface around points that were sampled densely all over a closed body.

    The Crust: the poles of a sample are the Voronoi vertices of its cell that lie farthest from it, on either side;
    triangles of the Delaunay triangulation of samples and poles whose corners are all samples are candidates. Where
    slivers lie flat on the surface these make a thick shell. So at last the tetrahedra are flooded from outside,
    candidates being walls, and the walls with water on just one side are kept.

    The samples must be dense against the body's curvature and thickness: a mean spacing of a third of the distance to
    the medial axis was enough on tori with 1 000 random points. An open or noisy sheet comes out in shreds, without an
    error: read ``report``. Bodies inside a closed body are not seen.

    Parameters
    ----------
    xyz : (N, 3) float64
        N >= 4 points, m; repeated rows are merged.

    Returns
    -------
    CrustSurface
        faces (F, 3) int32 into the rows of `xyz` (the first of equal rows), counter-clockwise seen from outside, each
        from its smallest vertex on, in lexicographic order; F may be 0. The same points give the same faces.

    Raises
    ------
    InputError
        If `xyz` has another shape, or a position is not finite (or beyond 1e100 m).
    GeometryError
        If there are fewer than 4 points, all of them lie in one plane, on one line or at one place, or Qhull gives up.

    Examples
    --------
    >>> angle, height = np.arange(200) * 2.4, np.linspace(-1, 1, 200)
    >>> ring = np.sqrt(1 - height**2)
    >>> surface = crust_surface(np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height]))
    >>> print(surface.report)
    200 points, 396 faces, Euler characteristic 2: closed manifold
    """
    from ._crust import flood_outside

    xyz = checked_positions(xyz, "crust")
    rows = first_of_equals(xyz)
    samples = _jittered(_normalised(xyz, rows))
    corners = np.concatenate([samples, _poles(samples), BOX])
    simplices, neighbours = _delaunay(corners, len(rows))
    is_sample = simplices < len(rows)
    is_candidate = is_sample.sum(axis=1)[:, None] - is_sample == 3
    outside = flood_outside(neighbours, is_candidate)
    # the box stands around the samples, so no candidate lies on the hull and each has a tetrahedron on either side
    shore = _facets(simplices, corners, is_candidate & outside[:, None] & ~outside[neighbours])
    walls = _facets(simplices, corners, is_candidate & (np.arange(len(simplices))[:, None] < neighbours))
    faces = _in_order(rows[shore].astype(np.int32))
    return CrustSurface(faces, _report(faces, xyz, len(rows), walls))


def _normalised(xyz: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """Distinct points around the origin, longest side 1; refuses those that span no volume."""
    if len(xyz) < 4:
        raise GeometryError(f"crust: {len(xyz)} points, expected at least 4")
    points = xyz[rows]
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    blur = 16 * np.finfo(np.float64).eps * float(np.abs(points).max())  # what rounding alone can spread
    rank = 0
    if extent > blur:
        points = (points - (low + high) / 2) / extent
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        rank = int(np.sum(spread > max(1e-9, blur / extent) * spread[0]))
    if rank < 3:
        what = ("at one place", "on one line", "in one plane")[rank]
        raise GeometryError(f"crust: all {len(xyz)} points lie {what}, expected a spread in all three directions")
    return points


def _jittered(points: FloatArray) -> FloatArray:
    """Points in general position: the Delaunay triangulation of a regular grid, full of cospheres, is not unique."""
    raw = np.random.PCG64(0).random_raw(points.size)  # raw words: promised to stay the same in every NumPy
    step = (raw >> np.uint64(11)) * 2.0**-52 - 1
    moved: FloatArray = points + JITTER / np.sqrt(len(points)) * step.reshape(points.shape)
    return moved


def _delaunay(corners: FloatArray, n: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Tetrahedra (T, 4), and the neighbour opposite to each corner, -1 on the hull."""
    from scipy.spatial import Delaunay, QhullError

    try:
        mesh = Delaunay(corners)
    except QhullError as error:
        reason = str(error).strip().splitlines()[0]
        raise GeometryError(f"crust: {n} points cannot be triangulated ({reason})") from error
    return mesh.simplices, mesh.neighbors


def _poles(samples: FloatArray) -> FloatArray:
    """For each sample the farthest Voronoi vertex of its cell and the farthest on the opposite side, thinned."""
    from ._crust import farthest_centres

    corners = np.concatenate([samples, BOX])
    simplices, _ = _delaunay(corners, len(samples))
    centres = _circumcentres(corners, simplices)
    first, far = farthest_centres(samples, simplices, centres, np.zeros_like(samples))
    second, near = farthest_centres(samples, simplices, centres, centres[first] - samples)
    chosen, squared = np.concatenate([first, second]), np.concatenate([far, near])
    return _thinned(centres[chosen[chosen >= 0]], np.sqrt(squared[chosen >= 0]))


def _circumcentres(corners: FloatArray, simplices: NDArray[np.int32]) -> FloatArray:
    """Circumcentres (T, 3), the far ones pulled in; NaN where a tetrahedron is flat."""
    origin = corners[simplices[:, 0]]
    a, b, c = (corners[simplices[:, k]] - origin for k in (1, 2, 3))
    ab, bc, ca = np.cross(a, b), np.cross(b, c), np.cross(c, a)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        weighted = sum(np.sum(side**2, axis=1, keepdims=True) * cross for side, cross in ((a, bc), (b, ca), (c, ab)))
        centre = origin + weighted / (2 * np.sum(a * bc, axis=1, keepdims=True))
        centre *= np.minimum(1.0, FARTHEST_POLE / np.linalg.norm(centre, axis=1, keepdims=True))
    return centre


def _thinned(poles: FloatArray, radius: FloatArray) -> FloatArray:
    """One pole of each cell; the cells are as fine as the body is thin there.

    Poles of a torus crowd along one circle; triangulated all, they would cost most of the time and the memory.
    """
    cell = 2.0 ** np.round(np.log2(POLE_CELL * radius))[:, None]
    kept: FloatArray = poles[first_of_equals(np.hstack([np.round(poles / cell), cell]))]
    return kept


def _facets(simplices: NDArray[np.int32], corners: FloatArray, chosen: BoolArray) -> NDArray[np.int32]:
    """The chosen (T, 4) facets, wound counter-clockwise as seen from the corner opposite to each."""
    t, k = np.nonzero(chosen)
    facet = simplices[t[:, None], FACETS[k]]
    a, b, c = (corners[facet[:, side]] for side in range(3))
    faces_away = np.sum(np.cross(b - a, c - a) * (corners[simplices[t, k]] - a), axis=1) < 0
    facet[faces_away] = facet[faces_away][:, [0, 2, 1]]
    return facet


def _in_order(faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Each face from its smallest vertex on, the winding kept; then in lexicographic order."""
    turn = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    turned = np.take_along_axis(faces, turn, axis=1)
    return np.ascontiguousarray(turned[np.lexsort(turned.T[::-1])])


def _report(faces: NDArray[np.int32], xyz: FloatArray, distinct: int, walls: NDArray[np.int32]) -> CrustReport:
    found = diagnose_surface(faces, xyz)
    return CrustReport(
        points=len(xyz),
        distinct_points=distinct,
        raw_faces=len(walls),
        raw_nonmanifold_edges=int(np.sum(edges_of(walls)[1] > 2)),
        faces=len(faces),
        boundary_edges=found.boundary_edges,
        nonmanifold_edges=found.nonmanifold_edges,
        misoriented_edges=found.misoriented_edges,
        pinched_vertices=len(found.pinched),
        unused_points=distinct - (len(xyz) - len(found.unused)),
        components=found.components,
        euler=found.euler,
    )
