"""A pose needs most of what should be seen from it: the first step is found however far the camera moved, or is lost."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam.datasets import KittiSequence, open_sequence, synthetic
from tspslam.datasets.synthetic import shapes
from tspslam.vision.features.spread import Features
from tspslam.vision.slam.locating.choosing import choose_pose, is_clear
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.slam.pose import PoseEstimate
from tspslam.vision.slam.tracking import TrackingSettings

from ...datasets.standard import kitti_raw, kitti_seq1, shared
from ...sequences import DETECTOR, RIG


def turned(degrees):
    return shapes.pose_at((0, 0, 0), (0, np.radians(degrees), 0))


def first_step(pairs, truth, detector=DETECTOR):
    """Length of the true step, m; that of the error, m; and what was tracked."""
    odometry = StereoOdometry(pairs[0].rig, detector=detector)
    tracked = [odometry.process(pair) for pair in pairs]
    true, found = (np.linalg.inv(T[0]) @ T[1] for T in (truth, [one.T_world_camera for one in tracked]))
    error = np.linalg.inv(true) @ found
    return np.linalg.norm(true[:3, 3]), np.linalg.norm(error[:3, 3]), tracked[1]


@pytest.fixture(scope="module", params=[0, 1])
def street(request):
    return synthetic.street(60.0, seed=request.param), (10, 40)[request.param]


@pytest.mark.parametrize(
    ("step", "turn"),
    [(0.0, 5.0), (0.0, 15.0), (0.6, 0.0), (1.0, 2.6), (1.0, 15.0), (2.0, 10.0), (3.0, 0.0), (3.0, 5.0), (3.0, 15.0)],
)
def test_the_first_step_of_a_street_is_found_however_long(street, step, turn):
    """Errors are 0.014 m at most with other seeds too; 1.2 m of 3 were believed on 19 landmarks once."""
    scene, start = street
    first = scene.path[start] @ turned(-2 * turn)
    move = turned(turn / 2) @ shapes.pose_at((0, 0, step), (0, 0, 0)) @ turned(turn / 2)
    sequence = synthetic.SyntheticSequence(
        replace(scene, path=np.stack([first, first @ move])), RIG, synthetic.Faults(noise=0.01, blur=0.5)
    )
    _, error, tracked = first_step(list(sequence), sequence.truth)
    assert not tracked.is_lost
    assert error <= max(0.03 * step, 0.02)


def test_three_metres_are_found_in_a_corridor():
    """2.6 m wide: all that is near is gone. The last landmarks around what descriptors show lead there."""
    scene = synthetic.corridor(15.0, seed=1)
    path = np.stack([scene.path[0], scene.path[0] @ shapes.pose_at((0, 0, 3.0), (0, 0, 0))])
    sequence = synthetic.SyntheticSequence(replace(scene, path=path), RIG, synthetic.Faults(noise=0.01, blur=0.5))
    _, error, tracked = first_step(list(sequence), sequence.truth, detector=None)
    assert not tracked.is_lost
    assert error < 0.09


def test_a_path_does_not_depend_on_where_it_begins():
    """Started at three frames, four steps agree with those of the whole run within the two covariances."""
    scene = synthetic.street(20.0, seed=5)
    pairs = list(synthetic.SyntheticSequence(scene, RIG, synthetic.Faults(noise=0.01, blur=0.5)))[:12]
    path = odometry_of(pairs).trajectory.T_world_camera
    for start in (3, 7):
        odometry = odometry_of(pairs[start : start + 5])
        there = np.linalg.inv(path[start]) @ path[start + 4]
        off = twist(np.linalg.inv(there) @ odometry.trajectory.T_world_camera[4])
        covariance = odometry.covariance_from_start(4)
        assert off @ np.linalg.solve(2 * covariance, off) / 6 < 3.7  # 1 in 1 000 of chi-squared are larger
        assert np.sqrt(np.trace(covariance[3:, 3:])) < 0.05 * 4  # and the covariance is of use


def odometry_of(pairs):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    for pair in pairs:
        odometry.process(pair)
    return odometry


def twist(T):
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def test_the_first_keyframes_are_adjusted_as_soon_as_there_are_three(street):
    scene, start = street
    path = np.stack([scene.path[start] @ shapes.pose_at((0, 0, 2.0 * k), (0, 0, 0)) for k in range(8)])
    sequence = synthetic.SyntheticSequence(replace(scene, path=path), RIG, synthetic.Faults(noise=0.01, blur=0.5))
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    for pair in sequence:
        odometry.process(pair)
        if len(odometry.map.keyframes) == 3:
            break
    assert len(odometry.map.keyframes) == 3
    assert odometry.mapper.is_adjusting
    before = odometry.map.xyz.copy()
    odometry.mapper.join(odometry.path.pose)
    moved = np.linalg.norm(odometry.map.xyz - before, axis=1) > 0
    assert moved.mean() > 0.2


@pytest.mark.parametrize("name", ["kitti_seq1", "kitti_05", "kitti_raw_0926"])
def test_real_sequences_start_at_every_tenth_frame(name, tmp_path):
    """Errors are up to 0.03 m, and those of the truth: 0.02 m a step, 0.3 of the raw drive's: so its median counts."""
    sequence = {"kitti_seq1": kitti_seq1, "kitti_raw_0926": kitti_raw}.get(name, lambda _: shared(name))(tmp_path)
    sequence, errors = open_sequence(sequence), []
    for start in range(0, len(sequence) - 1, 10):
        rows = [start, start + 1]
        length, error, tracked = first_step([sequence[k] for k in rows], sequence.truth[rows], detector=None)
        assert not tracked.is_lost, f"from {start}"
        assert tracked.matches >= 0.2 * 500, f"from {start}"
        errors.append(error / max(length, 0.5))
    assert np.median(errors) < 0.06
    assert name == "kitti_raw_0926" or max(errors) < 0.1


@pytest.mark.parametrize("name", ["kitti_seq1", "kitti_05"])
def test_real_first_steps_are_found_with_two_of_three_frames_left_out(name, tmp_path):
    """1.4 m with 6° and 3.6 m a frame. Errors are up to 0.11 m, those of the truth included."""
    sequence = KittiSequence(kitti_seq1(tmp_path)) if name == "kitti_seq1" else open_sequence(shared(name))
    for start in range(0, len(sequence) - 3, 4):
        rows = [start, start + 3]
        length, error, tracked = first_step([sequence[k] for k in rows], sequence.truth[rows], detector=None)
        assert tracked.is_lost or error < 0.1 + 0.08 * length, f"from {start}"
        assert not tracked.is_lost, f"from {start}"


def no_descriptors(image):
    found = DETECTOR(image)
    return Features(found.uv, found.descriptor[:, :0], found.score, found.scale, found.angle)


def test_a_step_that_nothing_confirms_is_lost(street):
    """Without descriptors, nothing leads to a pose that windows alone do not reach."""
    scene, start = street
    path = np.stack([scene.path[start], scene.path[start] @ shapes.pose_at((0, 0, 6.0), (0, 0, 0))])
    sequence = synthetic.SyntheticSequence(replace(scene, path=path), RIG, synthetic.Faults(noise=0.01, blur=0.5))
    _, error, tracked = first_step(list(sequence), sequence.truth, detector=no_descriptors)
    assert tracked.is_lost or error < 0.1
    assert np.isinf(tracked.covariance).all() == tracked.is_lost


def estimate(count, in_view, z=0.0):
    T = np.eye(4)
    T[2, 3] = z
    return PoseEstimate(T, np.arange(count), np.zeros((count, 2)), np.zeros(count), np.eye(6), in_view)


XYZ = np.tile((0.0, 0.0, 10.0), (1000, 1))


@pytest.mark.parametrize(
    ("followed", "recognised", "wanted"),
    [
        (estimate(17, 818), None, None),  # what was believed once
        (estimate(83, 800), None, None),
        (estimate(200, 818), None, "followed"),
        (None, estimate(90, 800), "recognised"),
        (None, estimate(70, 800), None),
        (estimate(17, 818), estimate(400, 800, 1.0), "recognised"),
        (estimate(62, 800), estimate(60, 800, 1.0), None),
        (estimate(90, 800), estimate(85, 800, 0.01), "followed"),  # the same pose: each confirms the other
        (estimate(90, 800), estimate(85, 800, 1.0), None),  # one word against another
        (estimate(90, 800), estimate(95, 800, 1.0), "recognised"),
        (estimate(177, 840), estimate(346, 1040, 1.0), "followed"),  # descriptors found an object that moves
        (estimate(130, 840), estimate(500, 1040, 1.0), "recognised"),
        (None, None, None),
    ],
)
def test_a_pose_is_believed_on_many_landmarks_or_on_a_second_opinion(followed, recognised, wanted):
    found = choose_pose(followed, recognised, XYZ, TrackingSettings())
    assert found is {"followed": followed, "recognised": recognised, None: None}[wanted]


@pytest.mark.parametrize(("z", "wanted"), [(0.01, True), (1.0, False)])
def test_a_steady_motion_is_believed_where_most_landmarks_move_with_something_else(z, wanted):
    T_ahead = np.eye(4)
    T_ahead[2, 3] = z
    followed, recognised = estimate(99, 940), estimate(315, 1150, 0.5)
    assert is_clear(followed, XYZ, T_ahead, TrackingSettings()) == wanted
    assert (
        choose_pose(followed, recognised, XYZ, TrackingSettings()) is recognised
    )  # what is asked where it is not clear
    assert not is_clear(followed, XYZ, None, TrackingSettings())
    assert not is_clear(estimate(17, 818), XYZ, np.eye(4), TrackingSettings())
    assert choose_pose(estimate(17, 818), None, XYZ, TrackingSettings()) is None
