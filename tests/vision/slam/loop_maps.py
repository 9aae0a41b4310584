"""Maps of a drive round a circle that has drifted, as odometry has them when the camera comes back: no images."""

import numpy as np
from scipy.spatial.transform import Rotation

from tspslam.vision.rig import project
from tspslam.vision.se3 import inverse, normalised
from tspslam.vision.slam.keyframes.keyframe import Keyframe
from tspslam.vision.slam.keyframes.map import Map
from tspslam.vision.slam.keyframes.settings import MapSettings

from ...sequences import RIG

STEP = 2.0  # m from keyframe to keyframe
NEW = 60  # landmarks first seen by each
LONGEST = 5  # keyframes that see one
NOISE = 0.3  # px


def ring(count):
    """True poses: the last is where the first was, seen from a metre before."""
    turn, radius = 2 * np.pi * np.arange(count) / (count - 0.5), STEP * (count - 0.5) / (2 * np.pi)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(turn, (0, 1, 0))).as_matrix()
    T[:, :3, 3] = radius * np.column_stack([1 - np.cos(turn), 0 * turn, np.sin(turn)])
    return T


def drifted(T, rng, turn, shift):
    """Poses whose steps are off, each by so many rad and m (one standard deviation)."""
    steps = inverse(T[:-1]) @ T[1:]
    steps[:, :3, :3] = steps[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, turn, (len(steps), 3))).as_matrix()
    steps[:, :3, 3] += rng.normal(0, shift, (len(steps), 3))
    off = T.copy()
    for k, step in enumerate(steps):
        off[k + 1] = off[k] @ step
    return normalised(off)


def sights(rng, T, xyz):
    """Which of some points a camera at T sees; (u, v) and disparities, with noise."""
    p = (xyz - T[:3, 3]) @ T[:3, :3]
    uv = project(RIG, np.where(p[:, 2:] > 1, p, 1.0))
    inside = np.flatnonzero((p[:, 2] > 1) & (uv > 0).all(axis=1) & (uv < (RIG.width - 1, RIG.height - 1)).all(axis=1))
    uv = uv[inside] + rng.normal(0, NOISE, (len(inside), 2))
    return inside, uv, RIG.fx * RIG.baseline / p[inside, 2] + rng.normal(0, NOISE, len(inside))


def looped(count, *, turn=0.0005, shift=0.01, seed=0, **settings):
    """A map of a drive round, closed by a loop from its last keyframe to the first ones; and its true poses."""
    rng, T = np.random.default_rng(seed), ring(count)
    depth = rng.uniform(3, 25, (count, NEW))
    uv = rng.uniform((0, 0), (RIG.width, RIG.height), (count, NEW, 2))
    p = (
        np.concatenate([(uv - (RIG.cx, RIG.cy)) / (RIG.fx, RIG.fy), np.ones((count, NEW, 1))], axis=2)
        * depth[..., None]
    )
    xyz = np.einsum("kij,kmj->kmi", T[:, :3, :3], p) + T[:, None, :3, 3]
    off = drifted(T, rng, turn, shift)
    world = Map(RIG, window=7, settings=MapSettings(**settings))
    for k in range(count):
        first = max(0, k - LONGEST + 1) * NEW
        seen, places, disparity = sights(rng, T[k], xyz.reshape(-1, 3)[first : (k + 1) * NEW])
        world.keyframes.append(
            Keyframe(2 * k, off[k], None, first + seen, places, disparity, np.full(len(seen), NOISE))
        )
    back, places, disparity = sights(rng, T[-1], xyz[: LONGEST + 3].reshape(-1, 3))
    motion = off @ inverse(T)
    world.xyz = (np.einsum("kij,kmj->kmi", motion[:, :3, :3], xyz) + motion[:, None, :3, 3]).reshape(-1, 3)
    world.descriptors = np.zeros((count * NEW, 4), np.uint64)
    world.landmark_id, world.next_id = 3 * np.arange(count * NEW), 3 * count * NEW
    world.note_sightings()
    again = motion[0] @ T[-1]
    world.loop = Keyframe(2 * count - 2, again, None, 3 * back, places, disparity, np.full(len(back), NOISE))
    return world, T


def copy_map(world):
    """A copy of a map's keyframes and landmarks, that knows who sees what."""
    copy = Map(world.rig, window=world.window, settings=world.settings)
    copy.keyframes, copy.xyz, copy.landmark_id = list(world.keyframes), world.xyz, world.landmark_id
    copy.merged, copy.loop, copy.unsettled = world.merged, world.loop, set(world.unsettled)
    copy.note_sightings()
    return copy


def error(world, T):
    """Root mean square of the keyframes' distances from the truth, m."""
    places = np.array([frame.T_world_camera[:3, 3] for frame in world.keyframes])
    return float(np.sqrt(((places - T[:, :3, 3]) ** 2).sum(axis=1).mean()))


def cost(world, frames=slice(None)):
    """Sum of the squared residuals of all observations, px²."""
    total = 0.0
    for frame in world.keyframes[frames]:
        T = frame.T_world_camera
        p = (world.xyz[frame.landmark] - T[:3, 3]) @ T[:3, :3]
        known = p[:, 2] > 0.1
        off = np.column_stack([project(RIG, p), RIG.fx * RIG.baseline / p[:, 2]]) - np.column_stack(
            [frame.uv, frame.disparity]
        )
        total += float((off[known] ** 2).sum())
    return total
