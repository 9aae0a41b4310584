"""A drift that is put into a map: its keyframes take their shares of a motion by the way they have come."""

from dataclasses import replace

import numpy as np

from tspslam.vision.se3 import normalised, repeated


def bend(world, T):
    """Move keyframe after keyframe, up to T for the last, and each landmark with the keyframe that first saw it."""
    centres = np.array([frame.T_world_camera[:3, 3] for frame in world.keyframes])
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1))])
    first_seen = np.zeros(len(world.xyz), int)
    for k in range(len(world.keyframes) - 1, -1, -1):
        first_seen[world.keyframes[k].landmark] = k
    for k, share in enumerate(way / way[-1]):
        part, frame = repeated(T, share), world.keyframes[k]
        world.keyframes[k] = replace(frame, T_world_camera=normalised(part @ frame.T_world_camera))
        world.xyz[first_seen == k] = world.xyz[first_seen == k] @ part[:3, :3].T + part[:3, 3]
