"""How good one surface over the landmarks of a sequence is: arrays in, figures out.

What all take: ``xyz`` (N, 3) vertices, m; ``faces`` (F, 3) triples of them; ``rig``; ``T`` (K, 4, 4), the keyframes'
``T_world_camera``; observations as ``vertex`` (M,) and ``keyframe`` (M,), rows of ``xyz`` and ``T``. Shares are in
[0, 1].
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tspslam.types import Rig

from ._mapping_kernels import draw_two_layers, find_blocked, find_near, find_seen, nearest_view

FARTHEST = 60.0  # m; a ray that meets its first face behind it is not looked at
SAME_LAYER = 0.05  # of depth
CELL = 16.0  # px, of the squares in which rays wait for the faces above them


# -- the surface by itself ---------------------------------------------------------------------------------------------


def double_layers(xyz, faces, rig: Rig, T, step: int = 4, farthest: float = FARTHEST) -> float:
    """Share of image rays whose second face is within 5 % of the first one's depth, of those that meet a face.

    Rays go through every `step`-th pixel both ways of every keyframe, and count if their first face is within
    `farthest` m. Faces that share a vertex or a side and meet the ray at one depth, to 1e-6 of it, are one; a face that
    is there twice is two. Both sides of a face count, and faces may reach behind the camera.
    """
    met = doubled = 0
    for near, _ in two_layers(xyz, faces, rig, T, step):
        first = near[..., 0] >= 1 / farthest
        met += int(first.sum())
        doubled += int((first & (near[..., 0] <= (1 + SAME_LAYER) * near[..., 1])).sum())
    return doubled / met if met else 0.0


def two_layers(xyz, faces, rig: Rig, T, step: int = 4):
    """For each keyframe at every `step`-th pixel: 1 / z of the nearest two layers (h, w, 2), else 0; their faces."""
    faces, lens = _faces(faces), lens_of(rig, step)
    shape = (-(-rig.height // step), -(-rig.width // step), 2)
    for pose in np.asarray(T, np.float64):
        near, owner = np.zeros(shape), np.full(shape, -1, np.int32)
        draw_two_layers(to_camera(xyz, pose), faces, lens, near, owner)
        yield near, owner


def ray_conflicts(xyz, faces, rig: Rig, T, vertex, keyframe, sigma=None) -> float:
    """Share of rays from a keyframe to its observed vertex that meet another face clearly in front of it."""
    blocked = conflicting_rays(xyz, faces, rig, T, vertex, keyframe, sigma)
    return float(blocked.mean()) if len(blocked) else 0.0


def conflicting_rays(xyz, faces, rig: Rig, T, vertex, keyframe, sigma=None):
    """(M,) bool: which rays meet a face without their vertex more than 5 % of its depth + 2 sigma in front of it.

    `sigma` (M,) is the standard deviation of the vertex' depth, m: 0.3 z² / (f b) if it is None. A vertex behind the
    camera that is said to observe it is in conflict too.
    """
    faces, lens = _faces(faces), lens_of(rig)
    vertex, keyframe = np.asarray(vertex, np.int64), np.asarray(keyframe, np.int64)
    blocked = np.zeros(len(vertex), bool)
    for k, pose in enumerate(np.asarray(T, np.float64)):
        rows, points = np.flatnonzero(keyframe == k), to_camera(xyz, pose)
        z = points[vertex[rows], 2]
        blocked[rows[z <= 0]] = True
        rows, z = rows[z > 0], z[z > 0]
        if len(rows):
            std = depth_sigma(z, rig) if sigma is None else np.asarray(sigma, np.float64)[rows]
            limit = 1 - SAME_LAYER - 2 * std / z
            there = np.zeros(len(rows), bool)
            columns, start, member = _cells(points[vertex[rows]], rig, lens)
            find_blocked(points, faces, lens, vertex[rows], limit, CELL, columns, start, member, there)
            blocked[rows] = there
    return blocked


def _cells(points, rig: Rig, lens):
    """Columns of cells, and the points in each cell: where they begin, and which they are."""
    columns, rows = -(-rig.width // int(CELL)), -(-rig.height // int(CELL))
    uv = pixels(points, lens)
    at = np.clip(np.floor(uv / CELL), 0, (columns - 1, rows - 1)).astype(np.int64)
    cell = at[:, 1] * columns + at[:, 0]
    start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=columns * rows))])
    return columns, start, np.argsort(cell, kind="stable")


def manifold_faults(faces, n: int) -> tuple[int, int]:
    """How many edges have more than two faces, and how many of `n` vertices more than one fan of faces.

    The sides of a face that is there twice are such edges as well.
    """
    faces = _faces(faces)
    triple = np.sort(faces, axis=1)
    _, same, times = np.unique(triple, axis=0, return_inverse=True, return_counts=True)
    ends = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, edge, count = np.unique(ends @ [n, 1], return_inverse=True, return_counts=True)
    faulty = count > 2
    faulty[edge[np.tile(times[same.ravel()] > 1, 3)]] = True
    return int(faulty.sum()), int((_fans(faces, edge, n) > 1).sum())


def _fans(faces, edge, n: int):
    """(n,) how many fans of faces each vertex has: corners of one vertex that sides join are one."""
    f = len(faces)
    sides = np.array([[0, 1], [1, 2], [2, 0]])
    # a half side is a side with one of its ends: all corners at one half side are joined through it
    corner = np.concatenate([np.arange(f) * 3 + end for side in sides for end in side])
    vertex = np.concatenate([faces[:, end] for side in sides for end in side])
    of = np.repeat(edge.reshape(3, f), 2, axis=0).ravel()
    _, half = np.unique(of * n + vertex, return_inverse=True)
    size = 3 * f + (int(half.max()) + 1 if len(half) else 0)
    joined = coo_array((np.ones(len(corner), np.int8), (corner, 3 * f + half)), shape=(size, size))
    _, label = connected_components(joined, directed=False)
    _, first = np.unique(label[: 3 * f], return_index=True)
    return np.bincount(faces.ravel()[first], minlength=n)


# -- beside the truth --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Truth:
    """What the keyframes truly saw, at the poses that were estimated: the drift of the path does not count.

    ``depth`` (K, H, W) float32 is each keyframe's true depth, m, NaN where there is nothing; ``xyz``, ``normal`` (P, 3)
    are points of it at the estimated poses with the surface's unit normals, ``reach`` (P,) how far the surface goes on
    around each, m, and ``keyframe`` (P,) whose they are.
    """

    depth: np.ndarray
    rig: Rig
    T: np.ndarray
    T_true: np.ndarray
    xyz: np.ndarray
    normal: np.ndarray
    reach: np.ndarray
    keyframe: np.ndarray

    @cached_property
    def tree(self) -> cKDTree:
        return cKDTree(self.xyz, balanced_tree=False, compact_nodes=False)

    def distance(self, points):
        """(n,) m of points from the true surface: discs of size `reach`, of which the nearest eight are looked at."""
        return _to_discs(points, self.tree, self)


def true_surface(depth, rig: Rig, T, T_true, every: int = 3) -> Truth:
    """Every `every`-th pixel of true depth images (K, H, W) as points at the estimated poses ``T`` (K, 4, 4)."""
    depth, T = np.asarray(depth, np.float32), np.asarray(T, np.float64)
    parts = [_surfels(image, rig, pose, every) for image, pose in zip(depth, T, strict=True)]
    owner = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
    return Truth(depth, rig, T, np.asarray(T_true, np.float64), *map(np.concatenate, zip(*parts, strict=True)), owner)


def _surfels(depth, rig: Rig, pose, every: int):
    """Points, normals and reach of one depth image: 1 / z is linear over the image of a plane, its slope the normal."""
    near = 1 / depth.astype(np.float64)
    ray = _rays(rig, depth.shape)
    along_u, along_v = _slope(near, 1), _slope(near, 0)
    x, y = rig.fx * along_u, rig.fy * along_v + rig.skew * along_u
    normal = np.stack([x, y, near - x * ray[..., 0] - y * ray[..., 1]], axis=-1)[::every, ::every]
    ray, z = ray[::every, ::every], depth[::every, ::every].astype(np.float64)
    chosen = np.isfinite(z)
    normal, ray, z = normal[chosen], ray[chosen], z[chosen]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    cosine = np.abs((normal * ray).sum(axis=1)) / np.linalg.norm(ray, axis=1)
    reach = every * z / rig.fx / np.maximum(cosine, 0.1)
    return to_world(ray * z[:, None], pose), normal @ pose[:3, :3].T, reach


def _slope(values, axis: int):
    """Difference to the pixel before or after along an axis, whichever is smaller: surfaces end where depth steps."""
    step = np.diff(values, axis=axis)
    border = np.full_like(np.take(values, [0], axis=axis), np.nan)
    before, after = np.concatenate([border, step], axis=axis), np.concatenate([step, border], axis=axis)
    size = np.abs(np.stack([before, after]))
    smaller = np.where(np.nan_to_num(size[0], nan=np.inf) < np.nan_to_num(size[1], nan=np.inf), before, after)
    return np.nan_to_num(smaller)


def _to_discs(points, tree: cKDTree, truth: Truth, rows=None):
    _, j = tree.query(points, k=min(8, tree.n))
    j = j.reshape(len(points), -1) if rows is None else rows[j.reshape(len(points), -1)]
    apart = points[:, None] - truth.xyz[j]
    off = (apart * truth.normal[j]).sum(axis=-1)
    aside = np.sqrt(np.maximum((apart**2).sum(axis=-1) - off**2, 0))
    return np.hypot(off, np.maximum(aside - truth.reach[j], 0)).min(axis=1)


class Distance(NamedTuple):
    """Of samples of faces from the true surface, over depth; `unviewed` is the share of those before no keyframe."""

    median: float
    p95: float
    behind: float
    front: float
    unviewed: float


def distance_to_truth(
    xyz, faces, truth: Truth, vertex, keyframe, n: int = 20_000, seed: int = 0, by: str = "area"
) -> Distance:
    """Distance of `n` samples of the faces, uniform by area (or as many on each: "face"), from the true surface.

    It is over their depth in the nearest keyframe that observes one of the face's vertices. `behind` and `front` are
    the shares of samples that are more than 3 % behind or in front of what that keyframe truly saw along the ray, by
    all of the four pixels around it; what is before the sky is in front. Samples outside its image are not among them.
    """
    xyz, faces = np.asarray(xyz, np.float64), _faces(faces)
    points, of = face_samples(xyz, faces, n, seed, by)
    view = nearest_keyframe(xyz, faces, truth.T, vertex, keyframe)[of]
    local = np.einsum("nji,nj->ni", truth.T[view, :3, :3], points - truth.T[view, :3, 3])
    viewed = (view >= 0) & (local[:, 2] > 1e-3)
    unviewed = float((~viewed).mean())
    if not viewed.any():
        return Distance(np.nan, np.nan, 0.0, 0.0, unviewed)
    points, view, local = points[viewed], view[viewed], local[viewed]
    share = truth.distance(points) / local[:, 2]
    behind, front = _beside_truth(local, view, truth)
    return Distance(float(np.median(share)), float(np.quantile(share, 0.95)), behind, front, unviewed)


def _beside_truth(local, view, truth: Truth, margin: float = 0.03) -> tuple[float, float]:
    height, width = truth.depth.shape[1:]
    corner = np.floor(pixels(local, lens_of(truth.rig))).astype(np.int64)
    inside = (corner >= 0).all(axis=1) & (corner < (width - 1, height - 1)).all(axis=1)
    (u, v), view, z = corner[inside].T, view[inside], local[inside, 2]
    seen = np.stack([truth.depth[view, v + i, u + j] for i in (0, 1) for j in (0, 1)])
    seen = np.where(np.isnan(seen), np.inf, seen)
    return (
        float((z > (1 + margin) * seen.max(axis=0)).mean()),
        float((z < (1 - margin) * seen.min(axis=0)).mean()),
    )


def truth_floor(truth: Truth, row: int | None = None) -> tuple[float, float]:
    """Median and 95th percentile of the same distance for truth itself: one keyframe's that others saw, from theirs."""
    row = len(truth.T) // 2 if row is None else row
    others = np.flatnonzero(truth.keyframe != row)
    points, z, own = _seen_twice(truth, 6, np.inf)
    points, z = points[own == row], z[own == row]
    tree = cKDTree(truth.xyz[others], balanced_tree=False, compact_nodes=False)
    share = _to_discs(points, tree, truth, others) / z
    return float(np.median(share)), float(np.quantile(share, 0.95))


def coverage(xyz, faces, truth: Truth, farthest: float = np.inf, every: int = 6, within: float = 0.03) -> float:
    """Share of true surface points within 3 % of their depth of a face, of those that two keyframes or more see.

    Points are those of every `every`-th pixel of each keyframe to a depth of `farthest` m. Another keyframe sees one if
    its true depth there is that of the point, to 2 %.
    """
    points, z, _ = _seen_twice(truth, every, farthest)
    return float(near_faces(xyz, faces, points, within * z).mean()) if len(points) else 0.0


def _seen_twice(truth: Truth, every: int, farthest: float):
    """Points at the estimated poses that another keyframe sees too, their depth, and their keyframe."""
    ray = _rays(truth.rig, truth.depth.shape[1:])[::every, ::every]
    z = truth.depth[:, ::every, ::every].astype(np.float64)
    own, v, u = np.nonzero(z < farthest)
    z = z[own, v, u]
    local = ray[v, u] * z[:, None]
    points = np.einsum("nij,nj->ni", truth.T_true[own, :3, :3], local) + truth.T_true[own, :3, 3]
    seen = np.zeros(len(points), bool)
    find_seen(points, own, np.linalg.inv(truth.T_true), truth.depth, lens_of(truth.rig), 0.02, seen)
    local, z, own = local[seen], z[seen], own[seen]
    return np.einsum("nij,nj->ni", truth.T[own, :3, :3], local) + truth.T[own, :3, 3], z, own


def near_faces(xyz, faces, points, reach):
    """(n,) bool: which points are within their `reach` (n,) m of a face."""
    xyz, faces = np.ascontiguousarray(xyz, np.float64), _faces(faces)
    near, octave = np.zeros(len(points), bool), np.floor(np.log2(reach))
    for level in np.unique(octave):  # points of like reach, in a grid that fits them
        rows = np.flatnonzero(octave == level)
        side, low = 2.0 * 2.0**level, points[rows].min(axis=0)
        at = np.floor((points[rows] - low) / side).astype(np.int64)
        size = at.max(axis=0) + 1
        key = (at[:, 0] * size[1] + at[:, 1]) * size[2] + at[:, 2]
        order = np.argsort(key, kind="stable")
        rows, found = rows[order], np.zeros(len(rows), bool)
        find_near(points[rows], reach[rows], key[order], size, low, side, xyz, faces, found)
        near[rows] = found
    return near


# -- parts -------------------------------------------------------------------------------------------------------------


def face_samples(xyz, faces, n: int, seed: int = 0, by: str = "area"):
    """`n` points on the faces, uniform by area, or as many on each face ("face"), and the face of each."""
    if not len(faces):
        raise ValueError("faces are none, expected one or more to take samples of")
    if by not in ("area", "face"):
        raise ValueError(f"by is {by!r}, expected 'area' or 'face'")
    a, b, c = (xyz[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) if by == "area" else np.ones(len(faces))
    rng = np.random.default_rng(seed)
    at = (np.arange(n) + rng.random(n)) / n * area.sum()
    of = np.minimum(np.searchsorted(np.cumsum(area), at, side="right"), len(faces) - 1)
    s, t = np.sort(rng.random((2, n)), axis=0)
    return a[of] * s[:, None] + b[of] * (t - s)[:, None] + c[of] * (1 - t)[:, None], of


def nearest_keyframe(xyz, faces, T, vertex, keyframe):
    """(F,) keyframe in which the face's centre has least depth, of those that observe one of its vertices; or -1."""
    vertex, keyframe = np.asarray(vertex, np.int64), np.asarray(keyframe, np.int64)
    start = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=len(xyz)))])
    keyframe = keyframe[np.argsort(vertex, kind="stable")]
    depth, view = np.empty(len(faces)), np.empty(len(faces), np.int64)
    T = np.ascontiguousarray(T, np.float64)
    nearest_view(xyz[faces].mean(axis=1), faces, start, keyframe, T[:, :3, :3], T[:, :3, 3], depth, view)
    return view


def depth_sigma(z, rig: Rig):
    """Standard deviation of depth from 0.3 px of disparity, m."""
    return 0.3 * z**2 / (rig.fx * rig.baseline)


def lens_of(rig: Rig, step: int = 1):
    """(5,) fx, fy, cx, cy, skew of an image of every `step`-th pixel both ways."""
    return np.array([rig.fx, rig.fy, rig.cx, rig.cy, rig.skew]) / step


def pixels(points, lens):
    """(n, 2) u, v of points in the camera's frame."""
    x, y, z = points.T
    return np.stack([lens[2] + (lens[0] * x + lens[4] * y) / z, lens[3] + lens[1] * y / z], axis=1)


def to_camera(xyz, pose):
    return np.ascontiguousarray((np.asarray(xyz, np.float64) - pose[:3, 3]) @ pose[:3, :3])


def to_world(points, pose):
    return points @ pose[:3, :3].T + pose[:3, 3]


def _rays(rig: Rig, shape):
    """(H, W, 3) directions of the pixels' centres, z = 1."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    y = (v - rig.cy) / rig.fy
    return np.stack([(u - rig.cx - rig.skew * y) / rig.fx, y, np.ones_like(y)], axis=-1)


def _faces(faces):
    return np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
