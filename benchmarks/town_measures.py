"""What a path that comes back is measured by: places seen again, and whether they were known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tspslam.vision.se3 import inverse, rotation_angle

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

NEAR, ALIKE, SINCE = 5.0, 40.0, 30.0  # m, degrees, s: what is a revisit
CLOSED = 0.5  # m, error of the motion since the place was seen before
FAR = 10.0  # m, true distance of a closure's ends


def revisits(stamps: Float64, poses: Float64) -> Int64:
    """(R, 2) frames that see a place again, and the nearest frame of over 30 s before, within 5 m and 40 degrees."""
    found = []
    tree = cKDTree(poses[:, :3, 3])
    for k, near in enumerate(tree.query_ball_point(poses[:, :3, 3], NEAR)):
        before = np.array([i for i in near if stamps[k] - stamps[i] > SINCE], np.int64)
        if not len(before):
            continue
        turn = np.degrees(rotation_angle(inverse(poses[before])[:, :3, :3] @ poses[k, :3, :3]))
        before = before[turn <= ALIKE]
        if len(before):
            away: Float64 = np.linalg.norm(poses[before, :3, 3] - poses[k, :3, 3], axis=1)
            found.append((k, int(before[np.argmin(away)])))
    return np.array(found, np.int64).reshape(-1, 2)


def motion_errors(estimate: Float64, truth: Float64, pairs: Int64) -> Float64:
    """(R,) errors of the motions between pairs of frames, m."""
    j, i = pairs.T
    found = inverse(inverse(truth[i]) @ truth[j]) @ (inverse(estimate[i]) @ estimate[j])
    return np.asarray(np.linalg.norm(found[:, :3, 3], axis=1))


def far_closures(closures: Int64, truth: Float64) -> Int64:
    """Those of closures (C, 2), frames and what they came back to, whose true places are over 10 m apart.

    A place may be known from so far away, too: a closure is false if the path between its ends is wrong.
    """
    ends = truth[closures[:, 0], :3, 3] - truth[closures[:, 1], :3, 3]
    return closures[np.linalg.norm(ends, axis=1) > FAR]


def tied(keyframes: Int64, start: Int64, observed: Int64, stamps: Float64) -> Int64:
    """Keyframes that observe a landmark which one of over 30 s before observes too."""
    of = np.repeat(np.arange(len(keyframes)), np.diff(start))
    _, landmark = np.unique(observed, return_inverse=True)
    times = stamps[keyframes][of]
    first = np.full(landmark.max(initial=0) + 1, np.inf)
    np.minimum.at(first, landmark, times)
    return keyframes[np.unique(of[times - first[landmark] > SINCE])]


def runs(frames: Int64) -> list[str]:
    """Frames as spans, to be read: 3, 10-14."""
    if not len(frames):
        return []
    parts = np.split(frames, np.flatnonzero(np.diff(frames) > 5) + 1)
    return [f"{part[0]}" if len(part) == 1 else f"{part[0]}-{part[-1]}" for part in parts]
