"""Maps of as many keyframes as one likes, without images: what it costs to add one is that of the map alone."""

from contextlib import nullcontext

import numpy as np

from tspslam.vision.images import build_pyramid
from tspslam.vision.rig import project
from tspslam.vision.slam.keyframes.keyframe import Keypoints
from tspslam.vision.slam.keyframes.map import Map
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.path import CameraPath
from tspslam.vision.slam.pose import PoseEstimate

from ...sequences import SMALL_RIG

STEP = 2.0  # m from keyframe to keyframe
SEEN = 100  # new keypoints in each


class Drive:
    """A camera that drives along a line, or round and round, past points that it sees for some keyframes each.

    Parameters
    ----------
    around : int, optional
        Keyframes in a round; in a second one it sees the points of the first again.
    measure : callable, optional
        Gives a context that each keyframe is added in.
    """

    def __init__(self, around=None, measure=nullcontext, **settings):
        self.map, self.path = Map(SMALL_RIG, window=7, settings=MapSettings(**settings)), CameraPath()
        self.rng, self.around, self.measure = np.random.default_rng(0), around, measure
        self.image = np.zeros((SMALL_RIG.height, SMALL_RIG.width), np.uint8)
        self.pyramid = build_pyramid(self.image)

    def pose(self, index):
        T, turn = np.eye(4), 0.0 if self.around is None else 2 * np.pi * index / self.around
        if self.around is None:
            T[2, 3] = STEP * index
            return T
        c, s, radius = np.cos(turn), np.sin(turn), STEP * self.around / (2 * np.pi)
        T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        T[:3, 3] = radius * (1 - c), 0, radius * s
        return T

    def go(self, count):
        """Add so many keyframes."""
        for _ in range(count):
            index = len(self.path)
            self.path.pose = self.pose(index)
            estimate, keypoints = self._estimate(self.path.pose), self._keypoints()
            with self.measure():
                self.map.add(index, self.path.pose, (self.pyramid, self.image), estimate, keypoints, self._spread)
                self.map.references()
                self.map.seen_by(self.map.keyframes[-1].landmark)
                self.map.covisible(len(self.map.keyframes) - 1)
                self.path.record(float(index), self.map, (max(0, index - 1), np.eye(6)))
        return self

    def _spread(self, uv):
        return np.full(len(uv), 0.3)

    def _keypoints(self):
        rng, size = self.rng, (SMALL_RIG.width - 1, SMALL_RIG.height - 1)
        uv, disparity = rng.uniform(0, size, (SEEN, 2)), rng.uniform(2, 20, SEEN)
        return Keypoints(uv, disparity, rng.integers(0, 2**63, (SEEN, 4), np.int64).astype(np.uint64))

    def _estimate(self, T):
        """What is still in view of the landmarks of the last keyframes, but for a few; in later rounds also of old ones."""
        world = self.map
        if not world.keyframes:
            return None
        places = [*range(max(0, len(world.keyframes) - 3), len(world.keyframes)), *self._before()]
        rows = np.unique(np.concatenate([world.keyframes[k].landmark for k in places]))
        seen = (world.xyz[rows] - T[:3, 3]) @ T[:3, :3]
        uv = project(SMALL_RIG, np.where(seen[:, 2:] > 0.5, seen, 1.0))
        inside = (seen[:, 2] > 0.5) & (uv >= 0).all(axis=1) & (uv < self.image.shape[::-1]).all(axis=1)
        inside &= self.rng.random(len(rows)) < 0.8
        depth = seen[inside, 2]
        disparity = SMALL_RIG.fx * SMALL_RIG.baseline / depth
        return PoseEstimate(T, rows[inside], uv[inside], disparity, np.eye(6), int(inside.sum()))

    def _before(self):
        """The keyframe of the last round nearest to here."""
        if self.around is None or len(self.path) <= self.around:
            return []
        indices = np.array([frame.index for frame in self.map.keyframes[:-3]])
        return [int(np.abs(indices - (len(self.path) - self.around)).argmin())]
