"""Landmarks keep their numbers, whatever is culled or merged, and frames say which of them their points are."""

import itertools

import numpy as np
import pytest

from tspslam import Session, Settings, Tracking
from tspslam.io import read_frame, write_frame
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.odometry import StereoOdometry

from ...sequences import DETECTOR, RIG, corridor


@pytest.fixture(scope="module")
def walk():
    return list(corridor(8.0))


@pytest.fixture(scope="module")
def snapshots(walk):
    """The map after each frame, keyframes and landmarks often culled."""
    tracking = Tracking(window=3, keyframe_share=0.9, map=MapSettings(cull_every=4))
    odometry, found = StereoOdometry(RIG, detector=DETECTOR, tracking=tracking), []
    for pair in walk:
        odometry.process(pair)
        found.append(odometry.map.snapshot())
    odometry.close()
    return found


def test_a_number_is_given_once_and_stays(snapshots):
    gone, highest = set(), -1
    for before, after in itertools.pairwise(snapshots):
        old, new = set(before.landmark_id.tolist()), set(after.landmark_id.tolist())
        highest = max(highest, before.landmark_id[-1])
        assert min(new - old, default=highest + 1) > highest
        gone |= old - new
        assert not gone & new
    assert gone


def test_a_number_is_of_one_place(snapshots):
    """What is adjusted moves a little; rows, which culling moves, would be metres off."""
    for before, after in itertools.pairwise(snapshots):
        _, i, j = np.intersect1d(before.landmark_id, after.landmark_id, return_indices=True)
        assert np.median(np.linalg.norm(before.xyz[i] - after.xyz[j], axis=1)) < 0.02


def test_a_snapshot_is_the_map_at_one_moment(snapshots, walk):
    last = snapshots[-1]
    assert len(last.start) == len(last.keyframe) + 1
    assert last.start[-1] == len(last.observed_id) == len(last.uv) == len(last.disparity)
    assert np.isin(last.observed_id, last.landmark_id).all()
    assert (np.diff(last.landmark_id) > 0).all()
    assert last.T_world_camera.shape == (len(last.keyframe), 4, 4)
    assert len(snapshots[0].xyz) < len(last.xyz)  # a copy: the first one has not grown


def test_points_of_a_frame_are_landmarks_where_these_are(walk, tmp_path):
    with Session(RIG, Settings(detector=DETECTOR)) as session:
        frames = [session.process(pair) for pair in walk[:6]]
        world = session.odometry.map.snapshot()
    assert {True, False} == {frame.is_keyframe for frame in frames}
    assert (frames[0].landmark >= 0).mean() > 0.9
    for frame in frames:
        known = np.flatnonzero(np.isin(frame.landmark, world.landmark_id))
        assert len(known) > 0.05 * len(frame.cloud)  # keypoints are found again elsewhere
        assert len(np.unique(frame.landmark[known])) == len(known)
        T, rows = frame.T_world_camera, np.searchsorted(world.landmark_id, frame.landmark[known])
        off = frame.cloud.xyz[known] @ T[:3, :3].T + T[:3, 3] - world.xyz[rows]
        assert np.median(np.linalg.norm(off, axis=1) / frame.cloud.xyz[known, 2]) < 0.02
    write_frame(tmp_path / "frame.npz", frames[0])
    assert np.array_equal(read_frame(tmp_path / "frame.npz").landmark, frames[0].landmark)
