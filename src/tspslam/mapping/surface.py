"""One surface over all landmarks: the border between what rays say is free and what lies behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._settings import Checked, setting
from ..errors import GeometryError
from ..types import FloatArray

_SCALE = 100  # of capacities, which the maximum flow takes as whole numbers
_LARGEST = 1 << 24


@dataclass(frozen=True)
class SurfaceSettings(Checked, what="mapping.surface"):
    quality: float = setting(0.5, 0, 10, unit="rays", source="")
    behind: float = setting(3.0, 0, 10, unit="sigmas", source="")
    longest_edge: float = setting(0.4, 0.01, 10, unit="m per m of depth", source="")


class Rays(NamedTuple):
    origin: FloatArray
    vertex: NDArray[np.int64]
    sigma: FloatArray
    weight: FloatArray


def carve_surface(points: FloatArray, rays: Rays, depth: FloatArray, settings: SurfaceSettings) -> NDArray[np.int32]:
    from scipy.spatial import Delaunay

    box = _box(points, rays.origin)
    mesh = Delaunay(np.concatenate([points, box]))
    cells = _Cells(np.ascontiguousarray(mesh.points), np.ascontiguousarray(mesh.simplices), np.ascontiguousarray(mesh.neighbors))
    inside = _cut(cells, rays, settings)
    return _faces(cells, inside, len(points), points, depth, settings)


class _Cells(NamedTuple):
    points: FloatArray
    vertices: NDArray[np.int32]
    neighbours: NDArray[np.int32]


def _box(points: FloatArray, origins: FloatArray) -> FloatArray:
    both = np.concatenate([points, origins])
    low, high = both.min(axis=0), both.max(axis=0)
    size = (high - low).max()
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    jitter = np.random.default_rng(0).uniform(-0.05, 0.05, (8, 3))
    return low - size + corners * (high - low + 2 * size) + jitter * size


def _cut(cells, rays, settings):
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow
    from . import _carving

    points, tets, near = cells
    m = len(tets)
    planes, cosines = np.empty((m, 4, 4)), np.empty((m, 4))
    _carving.facet_planes(points, tets, planes)
    _carving.sphere_angles(points, tets, planes, cosines)
    order = np.argsort(tets.ravel(), kind="stable")
    start = np.searchsorted(tets.ravel()[order], np.arange(len(points) + 1))
    out = np.zeros((m, 4)), np.zeros(m), np.zeros(m)
    lost = _carving.carve(points, tets, near, planes, start, order // 4, *rays, settings.behind, out)
    capacity, free, full = out
    t, k = np.nonzero(near >= 0)
    other = near[t, k]
    back = np.argmax(near[other] == t[:, None], axis=1)
    quality = 1 - np.minimum(cosines[t, k], cosines[other, back])
    cap = capacity[t, k] + settings.quality * quality
    both = np.minimum(free, full)
    free, full = free - both, full - both
    s, e = np.flatnonzero(free), np.flatnonzero(full)
    rows = np.concatenate([t, np.full(len(s), m), e])
    cols = np.concatenate([other, s, np.full(len(e), m + 1)])
    # source edges are what the camera's cell insists on
    values = np.concatenate([cap, free[s], full[e]])
    whole = np.minimum(np.rint(values * _SCALE), _LARGEST).astype(np.int32)
    graph = csr_array((whole, (rows, cols)), shape=(m + 2, m + 2)).tocsr()
    graph.indices, graph.indptr = graph.indices.astype(np.int32), graph.indptr.astype(np.int32)
    from scipy.sparse import csr_matrix
    flow = maximum_flow(csr_matrix(graph), m, m + 1).flow
    rest = csr_matrix(graph) - flow
    rest.data[rest.data < 0] = 0
    rest.eliminate_zeros()
    reached = breadth_first_order(rest, m, directed=True, return_predecessors=False)
    is_free = np.zeros(m + 2, bool)
    is_free[reached] = True
    return ~is_free[:m]


def _faces(cells, full, n, points, depth, settings):
    from . import _carving
    corners = _carving.CORNERS
    t, k = np.nonzero(full[:, None] & (cells.neighbours >= 0) & ~full[cells.neighbours])
    faces = cells.vertices[t[:, None], corners[k]]
    apex = cells.vertices[t, k]
    p = cells.points
    a, b, c = (p[faces[:, j]] for j in range(3))
    side = np.einsum("ij,ij->i", np.cross(b - a, c - a), p[apex] - a)
    faces[side > 0] = faces[side > 0][:, ::-1]
    keep = (faces < n).all(axis=1)
    faces = faces[keep]
    edge = np.linalg.norm(points[faces] - points[np.roll(faces, -1, axis=1)], axis=2).max(axis=1)
    return faces[edge <= settings.longest_edge * depth[faces].min(axis=1)].astype(np.int32)


def clean(faces, points, n):
    """edges with two faces, short faces first; then the largest fan of each vertex"""
    perimeter = np.linalg.norm(points[faces] - points[np.roll(faces, -1, axis=1)], axis=2).sum(axis=1)
    faces = faces[np.argsort(perimeter, kind="stable")]
    from . import _cleaning
    keep = _cleaning.limit_edges(faces, n)
    faces = faces[keep]
    while True:
        keep = _cleaning.largest_fans(faces, n)
        if keep.all():
            return faces
        faces = faces[keep]
