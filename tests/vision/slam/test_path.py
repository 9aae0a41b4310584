"""Frames between two keyframes go with both of them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tspslam.datasets.synthetic.shapes import pose_at
from tspslam.vision.slam.keyframes.keyframe import Keyframe
from tspslam.vision.slam.path import CameraPath

NOTHING = np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0)


def keyframe(index, T):
    return Keyframe(index, T, None, *NOTHING)


def driven(stamps, keyframes):
    """A camera that drives 1 m/s along z; which of its frames are keyframes is given."""
    path, map_ = CameraPath(), SimpleNamespace(keyframes=[], dropped=[])
    for frame, stamp in enumerate(stamps):
        path.pose = pose_at((0, 0, stamp))
        if frame in keyframes:
            map_.keyframes.append(keyframe(frame, path.pose))
        path.record(stamp, map_, (map_.keyframes[-1].index, np.eye(6)))
    return path, map_


def test_frames_take_the_share_of_a_correction_that_their_time_has():
    path, map_ = driven([0.0, 1.0, 1.5, 4.0, 5.0], {0, 3})
    before = list(map_.keyframes)
    map_.keyframes[1] = replace(before[1], T_world_camera=pose_at((0.4, 0, 4.0)))
    path.follow(before, map_)
    x = path.trajectory(map_).T_world_camera[:, 0, 3]
    assert x == pytest.approx([0, 0.1, 0.15, 0.4, 0.4], abs=1e-12)  # the last one is held by the moved keyframe alone


def test_what_moves_as_a_whole_takes_its_frames_along_unchanged():
    path, map_ = driven([0.0, 1.0, 2.0, 3.0], {0, 2})
    before, moved = list(map_.keyframes), pose_at((1, 2, 3), (0.1, 0.2, 0.3))
    old = path.trajectory(map_).T_world_camera
    map_.keyframes[:] = [replace(one, T_world_camera=moved @ one.T_world_camera) for one in before]
    path.follow(before, map_)
    assert np.allclose(path.trajectory(map_).T_world_camera, moved @ old, atol=1e-12)


def test_frames_of_one_moment_stay_with_the_keyframe_before_them():
    path, map_ = driven([2.0, 2.0, 2.0], {0, 2})
    before = list(map_.keyframes)
    map_.keyframes[1] = replace(before[1], T_world_camera=pose_at((0.4, 0, 2.0)))
    path.follow(before, map_)
    assert path.trajectory(map_).T_world_camera[:, 0, 3].tolist() == [0, 0, 0.4]
