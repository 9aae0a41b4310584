"""Small maps whose observations are where the vertices project, with images to go with their keyframes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.view.view_maps import map_of, sheet
from tspslam.topological_map import Observations, TopologicalMap
from tspslam.types import Trajectory
from tspslam.vision.rig import project
from tspslam.vision.se3 import inverse


def turned_poses(count: int):
    """Poses along a curve, (K, 4, 4)."""
    from scipy.spatial.transform import Rotation

    T = np.tile(np.eye(4), (count, 1, 1))
    k = np.arange(count)
    T[:, :3, :3] = Rotation.from_rotvec(np.stack([0.02 * k, 0.03 * k, -0.01 * k], axis=1)).as_matrix()
    T[:, :3, 3] = np.stack([0.05 * k, -0.02 * k, 0.2 * k], axis=1)
    return T


def seen_map(count: int = 4, noise: float = 0.0) -> TopologicalMap:
    """A wall that `count` keyframes see; each vertex is observed where it projects, with noise in px."""
    map_ = map_of([sheet((-2, -1.2, 4), (4, 0, 0), (0, 2.4, 0), 7)], np.zeros((count, 3)))
    return observed(replace(map_, T_world_camera=turned_poses(count)), noise)


def observed(map_: TopologicalMap, noise: float = 0.0) -> TopologicalMap:
    """The map with the observations that its cameras make."""
    random = np.random.default_rng(5)
    T, rig = inverse(map_.T_world_camera), map_.rig
    xyz = np.einsum("kij,nj->nki", T[:, :3, :3], map_.xyz) + T[:, :3, 3]
    uv = project(rig, xyz.reshape(-1, 3)).reshape(len(map_), len(T), 2)
    with np.errstate(invalid="ignore"):
        ok = ((uv >= 0) & (uv <= (rig.width - 1, rig.height - 1))).all(axis=2)
    _, view = np.nonzero(ok)
    found = uv[ok] + noise * random.standard_normal((ok.sum(), 2))
    ones = np.ones(len(view))
    start = np.concatenate([[0], np.cumsum(ok.sum(axis=1))])
    return replace(map_, observations=Observations(start, view.astype(np.int64), found, ones, ones))


def grey_of(map_: TopologicalMap):
    """Gives noise of 8 bits as the image of a keyframe."""
    size = map_.rig.height, map_.rig.width
    return lambda row: np.random.default_rng(row).integers(0, 256, size, np.uint8)


def path_of(map_: TopologicalMap) -> Trajectory:
    """The keyframes as a path, one each second."""
    return Trajectory(np.arange(len(map_.keyframes), dtype=float), map_.T_world_camera)


def files(folder):
    """Bytes of all files below a folder, by name."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
