"""Frame-to-frame stereo odometry from OpenCV's parts: what a short script gives, as a reference."""

from __future__ import annotations

import cv2
import numpy as np

from tspslam import Rig, StereoPair
from tspslam.types import FloatArray


class Naive:
    """ORB on both images, matches along rows, then matches to the last frame and a pose by random samples."""

    def __init__(self, rig: Rig, count: int = 2000) -> None:
        self.rig, self.pose = rig, np.eye(4)
        self.orb, self.matcher = cv2.ORB.create(count), cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        self.last: tuple[np.ndarray, FloatArray] | None = None
        self.K = np.array([[rig.fx, 0, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])

    def process(self, pair: StereoPair) -> FloatArray:
        """Pose of the left camera in the world."""
        descriptors, uv, xyz, known = self._points(pair)
        if self.last is not None:
            self._move(descriptors, uv)
        self.last = descriptors[known], xyz
        return self.pose.copy()

    def _points(self, pair: StereoPair) -> tuple[np.ndarray, np.ndarray, FloatArray, np.ndarray]:
        (k1, d1), (k2, d2) = (self.orb.detectAndCompute(image, None) for image in (pair.left, pair.right))
        left, right = (cv2.KeyPoint.convert(k).astype(np.float64) for k in (k1, k2))
        matches = np.array([(m.queryIdx, m.trainIdx) for m in self.matcher.match(d1, d2)])
        shift = left[matches[:, 0]] - right[matches[:, 1]]
        good = (np.abs(shift[:, 1]) < 2) & (shift[:, 0] > 1)
        known, disparity = matches[good, 0], shift[good, 0]
        z = self.rig.fx * self.rig.baseline / (disparity + self.rig.doffs)
        rays = (left[known] - (self.rig.cx, self.rig.cy)) / (self.rig.fx, self.rig.fy)
        return d1, left, np.column_stack([rays, np.ones(len(z))]) * z[:, None], known

    def _move(self, descriptors: np.ndarray, uv: np.ndarray) -> None:
        assert self.last is not None
        before, xyz = self.last
        found = self.matcher.match(before, descriptors)
        X, x = xyz[[m.queryIdx for m in found]], uv[[m.trainIdx for m in found]]
        if len(found) < 6:
            return
        cv2.setRNGSeed(0)
        ok, turn, t, kept = cv2.solvePnPRansac(X, x, self.K, None, reprojectionError=2.0, iterationsCount=200)
        if ok and kept is not None and len(kept) >= 6:
            kept = kept[:, 0]
            turn, t = cv2.solvePnPRefineLM(X[kept], x[kept], self.K, None, turn, t)
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = cv2.Rodrigues(turn)[0].T, 0
            T[:3, 3] = -T[:3, :3] @ t[:, 0]
            self.pose = self.pose @ T
