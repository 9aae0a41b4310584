"""One surface over all landmarks: the border between what rays say is free and what lies behind the landmarks.

Delaunay tetrahedra of the landmarks are labelled free or full by a minimum cut (Labatut, Pons and Keriven 2007, 2009):
each ray from a keyframe to a landmark asks that what it crosses be free, and what is right behind the landmark full.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from ..errors import GeometryError
from ..types import BoolArray, FloatArray, Rig
from .landmarks import Landmarks, depth_sigmas
from .settings import SurfaceSettings, ViewSettings
from .views import Rows, to_camera
from .visibility import face_normals, look

Faces = NDArray[np.int32]
_SCALE = 100  # of capacities, which the maximum flow takes as whole numbers
_LARGEST = 1 << 24  # so that sums stay within 32 bits
_BOX, _JITTER = 1.0, 0.05  # margin and disorder of the box around all points, over their extent
_SHIFT = 1e-7  # of points, over their extent: lattices have flat tetrahedra, among which a ray finds no way
_FOUR = 4


class Rays(NamedTuple):
    """Rays from keyframes to landmarks.

    Attributes
    ----------
    vertex, keyframe : (O,) int64
        Rows of landmarks and of keyframes.
    origin : (O, 3) float64
        Where the camera was, m.
    sigma : (O,) float64
        Standard deviation of the landmark along the ray, m.
    depth : (O,) float64
        Of the landmark, m.
    """

    vertex: Rows
    keyframe: Rows
    origin: FloatArray
    sigma: FloatArray
    depth: FloatArray

    def __repr__(self) -> str:
        return brief(self)


def make_rays(T_world_camera: FloatArray, landmarks: Landmarks, covariance: FloatArray) -> Rays:
    """Make a ray of each observation.

    Parameters
    ----------
    T_world_camera : (K, 4, 4) float64
        Poses of the keyframes.
    landmarks : Landmarks
        And their observations.
    covariance : (N, 3, 3) float64
        Theirs, m².

    Returns
    -------
    Rays
    """
    seen = landmarks.seen
    T = T_world_camera[seen.keyframe]
    along = landmarks.xyz[seen.landmark] - T[:, :3, 3]
    depth = np.einsum("oi,oi->o", along, T[:, :3, 2])
    sigma = depth_sigmas(covariance, seen.landmark, along / np.linalg.norm(along, axis=1, keepdims=True))
    return Rays(seen.landmark, seen.keyframe, np.ascontiguousarray(T[:, :3, 3]), sigma, depth)


def cut_surface(
    rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, rays: Rays, settings: SurfaceSettings, views: ViewSettings
) -> Faces:
    """Cut one surface from the tetrahedra of the landmarks: a manifold with a border.

    Triangles go that are too long, that no keyframe sees from the front, or that several landmarks are seen through.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (K, 4, 4) float64
        Poses of the keyframes.
    xyz : (N, 3) float64
        Landmarks, m.
    rays : Rays
        Their observations.
    settings : SurfaceSettings
        What is cut.
    views : ViewSettings
        When a vertex is hidden.

    Returns
    -------
    (F, 3) int32
        Wound so that normals look at the cameras.

    Raises
    ------
    GeometryError
        If the landmarks span no surface.
    """
    middle = _middle_pose(T_world_camera)  # whose axes the box takes, so that it moves with the world
    origins = np.ascontiguousarray(to_camera(rays.origin, middle))
    cells = _tetrahedra(to_camera(xyz, middle), origins)
    faces = _border(cells, _full(cells, rays._replace(origin=origins), settings), len(xyz))
    faces = make_manifold(faces[_is_short(xyz, faces, rays, T_world_camera[:, :3, 3], settings)], xyz)
    faces = make_manifold(faces[_is_seen(rig, T_world_camera, xyz, faces, rays, settings, views)], xyz)
    if not len(faces):
        wanted = "some apart from one line, with neighbours in mapping.surface.longest"
        raise GeometryError(f"map: {len(xyz)} landmarks span no surface, expected {wanted}")
    return faces


def _middle_pose(T_world_camera: FloatArray) -> FloatArray:
    """Pose of the keyframe nearest to the middle of all."""
    centres = T_world_camera[:, :3, 3]
    pose: FloatArray = T_world_camera[np.argmin(np.linalg.norm(centres - centres.mean(axis=0), axis=1))]
    return pose


class _Cells(NamedTuple):
    """Tetrahedra of landmarks and of the corners of a box: points, vertices (T, 4), neighbours (T, 4)."""

    points: FloatArray
    vertices: NDArray[np.int32]
    neighbours: NDArray[np.int32]

    def __repr__(self) -> str:
        return brief(self)


def _tetrahedra(xyz: FloatArray, origins: FloatArray) -> _Cells:
    from scipy.spatial import Delaunay, QhullError

    both = np.concatenate([xyz, origins])
    middle = both.mean(axis=0)  # so that far from the origin nothing is lost to rounding
    low, high = both.min(axis=0) - middle, both.max(axis=0) - middle
    size = float((high - low).max())
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
    jitter = np.random.default_rng(0).uniform(-_JITTER, _JITTER, corners.shape)
    box = low - _BOX * size + corners * (high - low + 2 * _BOX * size) + jitter * size
    places = xyz - middle + _SHIFT * size * _disorder(xyz)
    try:
        mesh = Delaunay(np.concatenate([places, box]))
    except QhullError as error:
        raise GeometryError(f"map: {len(xyz)} landmarks have no tetrahedra ({str(error).split(chr(10))[0]})") from error
    points = np.ascontiguousarray(mesh.points) + middle
    return _Cells(points, np.ascontiguousarray(mesh.simplices), np.ascontiguousarray(mesh.neighbors))


def _disorder(xyz: FloatArray) -> FloatArray:
    """Numbers of -1 to 1 for each point, (N, 3), the same for points in one place."""
    _, place = np.unique(xyz, axis=0, return_inverse=True)
    return np.random.default_rng(1).uniform(-1, 1, xyz.shape)[place.ravel()]


def _full(cells: _Cells, rays: Rays, settings: SurfaceSettings) -> BoolArray:
    """Which tetrahedra are full: those on the far side of the minimum cut."""
    from . import _carving

    count = len(cells.vertices)
    planes, cosines = np.empty((count, _FOUR, _FOUR)), np.empty((count, _FOUR))
    _carving.facet_planes(cells.points, cells.vertices, planes)
    _carving.sphere_angles(cells.points, cells.vertices, planes, cosines)
    around = np.argsort(cells.vertices.ravel(), kind="stable")
    start = np.searchsorted(cells.vertices.ravel()[around], np.arange(len(cells.points) + 1))
    crossed, free, full = np.zeros((count, _FOUR)), np.zeros(count), np.zeros(count)
    given = rays.origin, rays.vertex, rays.sigma, settings.behind
    _carving.carve(*cells, planes, start, around // _FOUR, *given, (crossed, free, full))
    one, facet = np.nonzero(cells.neighbours >= 0)
    other = cells.neighbours[one, facet]
    back = np.argmax(cells.neighbours[other] == one[:, None], axis=1)
    bent = 1 - np.minimum(cosines[one, facet], cosines[other, back])
    return _far_side(one, other, crossed[one, facet] + settings.quality * bent, free, full)


def _far_side(
    one: Rows, other: NDArray[np.int32], capacity: FloatArray, free: FloatArray, full: FloatArray
) -> BoolArray:
    """Which nodes a minimum cut leaves on the side of the sink."""
    from scipy.sparse import csr_matrix  # which maximum_flow takes in every version; arrays only in newer ones
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    count, both = len(free), np.minimum(free, full)
    sources, sinks = np.flatnonzero(free > both), np.flatnonzero(full > both)
    rows = np.concatenate([one, np.full(len(sources), count), sinks])
    columns = np.concatenate([other, sources, np.full(len(sinks), count + 1)])
    values = np.concatenate([capacity, (free - both)[sources], (full - both)[sinks]])
    whole = np.minimum(np.rint(values * _SCALE), _LARGEST).astype(np.int32)
    graph = csr_matrix((whole, (rows, columns)), shape=(count + 2, count + 2))
    rest = graph - maximum_flow(graph, count, count + 1).flow
    rest.data[rest.data < 0] = 0
    rest.eliminate_zeros()
    is_far = np.ones(count + 2, np.bool_)
    is_far[breadth_first_order(rest, count, return_predecessors=False)] = False
    return is_far[:count]


def _border(cells: _Cells, is_full: BoolArray, n: int) -> Faces:
    """Facets between full and free tetrahedra whose corners are landmarks, wound to look at the free side."""
    from . import _carving

    cell, facet = np.nonzero(is_full[:, None] & (cells.neighbours >= 0) & ~is_full[cells.neighbours])
    faces = cells.vertices[cell[:, None], _carving.CORNERS[facet]]
    inwards = cells.points[cells.vertices[cell, facet]] - cells.points[faces[:, 0]]
    is_turned = np.einsum("fi,fi->f", face_normals(cells.points, faces), inwards) > 0
    faces[is_turned] = faces[is_turned][:, ::-1]
    return np.ascontiguousarray(faces[(faces < n).all(axis=1)], np.int32)


def _is_short(xyz: FloatArray, faces: Faces, rays: Rays, centres: FloatArray, settings: SurfaceSettings) -> BoolArray:
    """Whether no side of a face is too long for its depth; longer ones may be where a keyframe sees it whole."""
    from . import _carving

    depth = np.full(len(xyz), np.inf)
    np.minimum.at(depth, rays.vertex, rays.depth)
    sides = np.linalg.norm(xyz[faces] - xyz[np.roll(faces, -1, axis=1)], axis=2).max(axis=1) / depth[faces].min(axis=1)
    start = np.searchsorted(rays.vertex, np.arange(len(xyz) + 1))
    is_long, is_whole = sides > settings.longest_apart, np.ones(len(faces), np.bool_)
    long = faces[is_long]
    given = np.ascontiguousarray(centres), xyz[long].mean(axis=1), face_normals(xyz, long)
    cosines = _carving.shared_cosines(long, start, rays.keyframe, *given)
    is_whole[is_long] = cosines >= np.cos(np.radians(settings.max_slant))
    return (sides <= settings.longest) & is_whole


def make_manifold(faces: Faces, xyz: FloatArray) -> Faces:
    """Drop faces until each edge has two at most, wound alike, and each vertex one fan; short faces, large fans stay.

    Parameters
    ----------
    faces : (F, 3) int32
        Triangles.
    xyz : (N, 3) float64
        Vertices, m.

    Returns
    -------
    (G, 3) int32
        In the order of their size.
    """
    from . import _cleaning

    around = np.linalg.norm(xyz[faces] - xyz[np.roll(faces, -1, axis=1)], axis=2).sum(axis=1)
    faces = faces[np.lexsort((*faces.T, around))]
    faces = faces[_cleaning.limit_edges(faces, len(xyz))]
    while True:
        is_kept = _cleaning.largest_fans(faces, len(xyz))
        if is_kept.all():
            return faces
        faces = faces[is_kept]


def _is_seen(
    rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, faces: Faces, rays: Rays,
    settings: SurfaceSettings, views: ViewSettings,
) -> BoolArray:  # fmt: skip
    """Whether a keyframe sees each face from the front, and few landmarks are seen through it."""
    normals, corner = face_normals(xyz, faces), xyz[faces[:, 0]]
    pixels, hidden = np.zeros(len(faces), np.int64), []
    by_keyframe = np.argsort(rays.keyframe, kind="stable")
    ends = np.searchsorted(rays.keyframe[by_keyframe], np.arange(len(T_world_camera) + 1))
    for k in np.unique(rays.keyframe):  # one without a ray stood elsewhere
        rows, T = by_keyframe[ends[k] : ends[k + 1]], T_world_camera[k]
        sight = look(rig, T, xyz, faces)
        sight.count_pixels(np.einsum("fi,fi->f", normals, T[:3, 3] - corner) > 0, pixels)
        by = sight.hidden_by(rays.vertex[rows], views.hidden * rays.sigma[rows])
        hidden.append(np.column_stack([by, rays.vertex[rows]])[by >= 0])
    through = np.unique(np.concatenate(hidden), axis=0)[:, 0]
    return (pixels > 0) & (np.bincount(through, minlength=len(faces)) < settings.seen_through)
