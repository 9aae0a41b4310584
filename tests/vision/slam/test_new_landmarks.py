"""Landmarks that an adjustment leaves out follow it: their keyframe, and the offset of the disparities."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam.vision.rig import project
from tspslam.vision.slam.back_end.new_landmarks import follow_keyframes, follow_offset
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.odometry import StereoOdometry, Tracking

from ...sequences import DETECTOR, RIG, corridor
from .bending import bend

MOST = 1.8  # px


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


def moved(world, right=0.0, ahead=0.0):
    """The keyframes as they were; the last one is moved along its axes, m."""
    before, frame = list(world.keyframes), world.keyframes[-1]
    T = frame.T_world_camera.copy()
    T[:3, 3] += T[:3, :3] @ (right, 0, ahead)
    world.keyframes[-1] = replace(frame, T_world_camera=T)
    return before


def test_landmarks_that_one_keyframe_saw_go_with_it_where_they_would_be_left_behind(world):
    """Those nearer than 4.3 m: 0.02 m are 1.8 px there."""
    frame, first, kept = alone(world)
    sights, xyz = seen(world, frame, first), world.xyz.copy()
    before = moved(world, right=0.02)
    left = np.linalg.norm(seen(world, world.keyframes[-1], first) - sights, axis=1)
    follow_keyframes(world, kept, before, MOST)
    is_behind = left > MOST
    assert 10 < is_behind.sum() < len(first) - 10
    np.testing.assert_allclose(seen(world, world.keyframes[-1], first[is_behind]), sights[is_behind], atol=1e-6)
    assert np.array_equal(world.xyz[first[~is_behind]], xyz[first[~is_behind]])
    assert np.array_equal(world.xyz[kept], xyz[kept])


def test_landmarks_that_a_keyframe_has_moved_past_go_with_it(world):
    frame, first, kept = alone(world)
    sights, before = seen(world, frame, first), moved(world, ahead=100)
    follow_keyframes(world, kept, before, MOST)
    np.testing.assert_allclose(seen(world, world.keyframes[-1], first), sights, atol=1e-6)


def test_landmarks_that_were_adjusted_or_that_another_keyframe_saw_stay(world):
    _, first, _ = alone(world)
    xyz = world.xyz.copy()
    follow_keyframes(world, np.arange(len(xyz)), moved(world, right=1.0), MOST)
    assert np.array_equal(world.xyz, xyz)
    follow_keyframes(world, np.empty(0, np.int64), moved(world, right=1.0), MOST)
    assert set(np.flatnonzero((world.xyz != xyz).any(axis=1))) == set(first)


@pytest.mark.parametrize("most", [2, 500])
def test_after_all_keyframes_are_adjusted_each_has_its_landmarks_where_it_saw_them(most):
    """Piece by piece or at once; the map was bent before, by 0.3 m at its end."""
    tracking, T = Tracking(map=MapSettings(max_keyframes=most)), np.eye(4)
    odometry = StereoOdometry(RIG, detector=DETECTOR, tracking=tracking)
    for pair in corridor(4.0):
        odometry.process(pair)
    odometry.path.pose = odometry.mapper.join(odometry.path.pose)
    T[0, 3] = 0.3
    bend(odometry.map, T)
    odometry.finish()
    odometry.close()
    world = odometry.map
    for frame in world.keyframes[1:]:
        rows = np.flatnonzero(world.sightings.count(frame.landmark) == 1)
        off = seen(world, frame, frame.landmark[rows])[:, :2] - frame.uv[rows]
        assert np.linalg.norm(off, axis=1).max() < 2 * MOST


def test_landmarks_follow_the_offset_of_the_disparities(world):
    """They stay at the same place of their keyframe's image, as deep as its disparities now say."""
    frame, first, kept = alone(world)
    before, sights, others = world.rig, seen(world, frame, first), world.xyz[kept].copy()
    world.rig = replace(before, doffs=before.doffs - 0.2)
    follow_offset(world, kept, before)
    np.testing.assert_allclose(seen(world, frame, first), sights, atol=1e-6)
    assert np.array_equal(world.xyz[kept], others)
