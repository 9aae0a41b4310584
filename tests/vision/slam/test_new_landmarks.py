"""Landmarks that an adjustment leaves out follow it: their keyframe, and the offset of the disparities."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam.vision.rig import project
from tspslam.vision.slam.new_landmarks import follow_keyframes, follow_offset
from tspslam.vision.slam.odometry import StereoOdometry

from ...sequences import DETECTOR, RIG, corridor

GATE = 1.8  # px


@pytest.fixture(scope="module")
def walked():
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    for pair in corridor(4.0):
        odometry.process(pair)
    odometry.finish()
    odometry.close()
    return odometry.map


@pytest.fixture
def world(walked):
    """A map of some keyframes, as it was after each test."""
    keyframes, xyz, rig = list(walked.keyframes), walked.xyz.copy(), walked.rig
    yield walked
    walked.keyframes, walked.xyz, walked.rig = keyframes, xyz, rig


def alone(world):
    """Landmarks that the last keyframe alone has seen, and all others."""
    *others, frame = world.keyframes
    first = np.setdiff1d(frame.landmark, np.concatenate([other.landmark for other in others]))
    assert len(first) > 50
    return frame, first, np.setdiff1d(np.arange(len(world.xyz)), first)


def seen(world, frame, rows):
    """(u, v, disparity) of landmarks in a keyframe."""
    camera = (world.xyz[rows] - frame.T_world_camera[:3, 3]) @ frame.T_world_camera[:3, :3]
    return np.column_stack([project(world.rig, camera), RIG.fx * RIG.baseline / camera[:, 2] - world.rig.doffs])


def moved(world, shift):
    """The keyframes as they were; the last one is moved along its first axis."""
    before, frame = list(world.keyframes), world.keyframes[-1]
    T = frame.T_world_camera.copy()
    T[:3, 3] += shift * T[:3, 0]
    world.keyframes[-1] = replace(frame, T_world_camera=T)
    return before


def test_landmarks_that_one_keyframe_saw_go_with_it_where_they_would_be_left_behind(world):
    """Those nearer than 4.3 m: 0.02 m are 1.8 px there."""
    frame, first, kept = alone(world)
    sights, xyz = seen(world, frame, first), world.xyz.copy()
    before = moved(world, 0.02)
    left = np.linalg.norm(seen(world, world.keyframes[-1], first) - sights, axis=1)
    follow_keyframes(world, kept, before, GATE)
    is_behind = left > GATE
    assert 10 < is_behind.sum() < len(first) - 10
    np.testing.assert_allclose(seen(world, world.keyframes[-1], first[is_behind]), sights[is_behind], atol=1e-6)
    assert np.array_equal(world.xyz[first[~is_behind]], xyz[first[~is_behind]])
    assert np.array_equal(world.xyz[kept], xyz[kept])


def test_landmarks_behind_a_keyframe_that_was_moved_go_with_it(world):
    frame, first, kept = alone(world)
    sights, before = seen(world, frame, first), moved(world, 0.0)
    T = world.keyframes[-1].T_world_camera
    T[:3, 3] += 100 * T[:3, 2]
    follow_keyframes(world, kept, before, GATE)
    np.testing.assert_allclose(seen(world, world.keyframes[-1], first), sights, atol=1e-6)


def test_landmarks_that_were_adjusted_or_whose_keyframe_stays_do_not_follow(world):
    xyz = world.xyz.copy()
    follow_keyframes(world, np.arange(len(xyz)), moved(world, 1.0), GATE)
    follow_keyframes(world, np.empty(0, np.int64), list(world.keyframes), GATE)
    assert np.array_equal(world.xyz, xyz)


def test_landmarks_follow_the_offset_of_the_disparities(world):
    """They stay at the same place of their keyframe's image, as deep as its disparities now say."""
    frame, first, kept = alone(world)
    before, sights, others = world.rig, seen(world, frame, first), world.xyz[kept].copy()
    world.rig = replace(before, doffs=before.doffs - 0.2)
    follow_offset(world, kept, before)
    np.testing.assert_allclose(seen(world, frame, first), sights, atol=1e-6)
    assert np.array_equal(world.xyz[kept], others)
