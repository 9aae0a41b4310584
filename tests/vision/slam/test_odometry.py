"""The path through synthetic worlds is the true one; what goes wrong with frames is survived and told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam import GeometryError, InputError, Trajectory, evaluate_trajectory
from tspslam.datasets import synthetic
from tspslam.vision.features.binary import binary_descriptors, match_descriptors
from tspslam.vision.features.sift_brisk import SiftDetector
from tspslam.vision.rig import project
from tspslam.vision.slam.odometry import StereoOdometry, Tracking
from tspslam.vision.slam.pose import PoseEstimate, solve_pnp
from tspslam.vision.slam.tracking import TrackingSettings, refine_pose

from ... import sequences
from ...sequences import DETECTOR, RIG, Kept


def drive(pairs, detector=DETECTOR, **options):
    pairs = list(pairs)
    odometry = StereoOdometry(pairs[0].rig, detector=detector, tracking=Tracking(**options))
    tracked = [odometry.process(pair) for pair in pairs]
    odometry.finish()
    return odometry, tracked


def errors(odometry, sequence, kept=slice(None)):
    return evaluate_trajectory(odometry.trajectory, Trajectory(sequence.stamps[kept], sequence.truth[kept]))


@pytest.fixture(scope="module")
def corridor():
    return sequences.corridor(14.0, blur=0.4)


@pytest.fixture(scope="module")
def walked(corridor):
    return drive(corridor)


def test_a_walk_down_a_corridor_is_found_to_three_in_a_thousand(corridor, walked):
    odometry, tracked = walked
    found = errors(odometry, corridor)
    assert found.ate_rmse_m < 0.003 * 14
    assert found.matched == len(corridor)
    assert not any(one.is_lost for one in tracked)
    assert tracked[0].is_keyframe
    assert np.array_equal(odometry.trajectory.stamp, corridor.stamps)


def mean_distance(errors, covariances):
    """Squared Mahalanobis length of (ω, υ) for each degree of freedom: 1 if the covariances are the errors'."""
    return np.mean([e @ np.linalg.solve(C, e) / 6 for e, C in zip(errors, covariances, strict=True)])


def twist(T):
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def test_the_covariance_is_that_of_errors_where_sights_have_their_standard_deviations():
    """Of 300 draws of six numbers; measured 0.96, as the Huber cost and the gates take some."""
    _, _, xyz = scene(n=150)
    uv, disparity = project(RIG, xyz), RIG.fx * RIG.baseline / xyz[:, 2]
    rng, errors, covariances = np.random.default_rng(0), [], []
    for _ in range(300):
        seen = PoseEstimate(
            np.eye(4), np.arange(150), uv + rng.normal(0, 0.3, uv.shape), np.full(150, np.nan), np.eye(6)
        )
        found = refine_pose(RIG, seen, xyz, disparity + rng.normal(0, 0.3, 150), 0.3, TrackingSettings())
        errors.append(twist(found.T_world_camera))
        covariances.append(found.covariance)
    assert mean_distance(errors, covariances) == pytest.approx(1, abs=4 * (2 / (6 * 300)) ** 0.5)


def test_images_with_noise_scatter_a_pose_by_no_more_than_its_covariance(corridor):
    """Thirty draws of noise of 3 % against one map: 0.3 of what is said, which allows 0.3 px of every kind of error."""

    def noisy(k, seed):
        rng = np.random.default_rng(seed)
        pair = corridor[k]
        both = (np.clip(np.rint(image + rng.normal(0, 7.5, image.shape)), 0, 255) for image in (pair.left, pair.right))
        return replace(
            pair, **{side: image.astype(np.uint8) for side, image in zip(("left", "right"), both, strict=True)}
        )

    odometry = StereoOdometry(RIG, detector=DETECTOR)
    for k in range(3):
        odometry.process(corridor[k])
    odometry.path.pose = odometry.mapper.join(odometry.path.pose)
    state, found = odometry.state(), []
    for seed in range(30):
        again = StereoOdometry(RIG, detector=DETECTOR)
        again.restore({name: values.copy() for name, values in state.items()}, lambda k: corridor[k].left)
        found.append(again.process(noisy(3, seed)))
    middle = np.linalg.inv(found[0].T_world_camera)
    steps = np.array([twist(middle @ one.T_world_camera) for one in found])
    scatter = mean_distance(steps - steps.mean(axis=0), [one.covariance for one in found])
    assert 0.03 < scatter < 1


def test_two_runs_give_the_same_bytes(corridor, walked):
    again, _ = drive(corridor)
    assert again.trajectory.T_world_camera.tobytes() == walked[0].trajectory.T_world_camera.tobytes()
    assert again.disparity_offset == walked[0].disparity_offset


@pytest.mark.parametrize("shift", [0.4, -0.3])
def test_an_offset_of_the_calibration_is_found_from_the_motion(corridor, shift):
    wrong = replace(RIG, doffs=shift)  # true: 0
    pairs = [replace(pair, rig=wrong) for pair in corridor]
    odometry, _ = drive(pairs)
    offset, std = odometry.disparity_offset
    assert offset == pytest.approx(shift, abs=max(0.1, 3 * std))
    blind, _ = drive(pairs, sigma_offset=1e-3)
    assert errors(odometry, corridor).ate_rmse_m < 0.6 * errors(blind, corridor).ate_rmse_m


def test_a_still_camera_does_not_drift():
    odometry, tracked = drive(Kept(synthetic.still(12), RIG, synthetic.Faults(noise=0.01)))
    assert np.abs(odometry.trajectory.T_world_camera[:, :3, 3]).max() < 0.002
    assert sum(one.is_keyframe for one in tracked) <= 2


@pytest.mark.parametrize("spoil", ["black", "right missing"])
def test_a_bad_frame_is_told_and_the_path_goes_on(corridor, spoil):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    tracked = []
    for k, pair in enumerate(corridor):
        if k in (8, 9):
            black = np.zeros_like(pair.left)
            pair = replace(pair, right=black, left=black if spoil == "black" else pair.left)
        tracked.append(odometry.process(pair))
    assert [k for k, one in enumerate(tracked) if one.is_lost] == ([8, 9] if spoil == "black" else [])
    assert all(np.isinf(tracked[k].covariance).all() for k in (8, 9) if spoil == "black")
    assert errors(odometry, corridor).ate_rmse_m < 0.01 * 14


def test_dropped_frames_are_bridged(corridor):
    kept = np.delete(np.arange(len(corridor)), [9, 10, 11])
    odometry, tracked = drive(corridor[k] for k in kept)
    assert not any(one.is_lost for one in tracked)
    assert errors(odometry, corridor, kept).ate_rmse_m < 0.01 * 14


def test_where_the_motion_changes_by_more_than_patches_reach_a_frame_becomes_a_keyframe():
    """Six frames at once, of which 59 % of the landmarks are found again, 73 px from where they were expected."""
    sequence = synthetic.SyntheticSequence(synthetic.room(), RIG, synthetic.Faults(noise=0.01, blur=0.5))
    odometry, tracked = StereoOdometry(RIG, detector=DETECTOR), []
    for n, k in enumerate([0, 1, 2, 3, 9]):
        tracked.append(odometry.process(replace(sequence[k], index=n, stamp=n / 10)))
    assert [one.is_keyframe for one in tracked] == [True, False, False, False, True]
    assert not any(one.is_lost for one in tracked)
    assert tracked[-1].matches > odometry.tracking.keyframe_share * len(tracked[0].landmark)


def test_a_camera_that_shakes_before_the_same_things_makes_no_keyframes():
    """By 8 degrees a frame, 55 px, to and fro: it sees what the first one saw."""
    scene = synthetic.room()
    path = np.tile(scene.path[0], (8, 1, 1))
    path[1::2, :3, :3] = path[0, :3, :3] @ Rotation.from_euler("y", 8, degrees=True).as_matrix()
    sequence = synthetic.SyntheticSequence(replace(scene, path=path), RIG, synthetic.Faults(noise=0.01, blur=0.5))
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    tracked = [odometry.process(pair) for pair in sequence]
    assert [one.is_keyframe for one in tracked] == [True] + 7 * [False]
    assert not any(one.is_lost for one in tracked)


def test_pairs_that_do_not_belong_are_refused(corridor):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    odometry.process(corridor[0])
    with pytest.raises(InputError, match="or later"):
        odometry.process(replace(corridor[1], stamp=-1.0))
    with pytest.raises(InputError, match="expected the odometry's"):
        odometry.process(replace(corridor[1], rig=replace(RIG, baseline=0.3)))
    black = np.zeros_like(corridor[0].left)
    with pytest.raises(GeometryError, match="too little texture"):
        StereoOdometry(RIG).process(replace(corridor[0], left=black, right=black))
    with pytest.raises(InputError, match="tracking: window is 1"):
        Tracking(window=1)


def test_real_descriptors_serve_too(corridor):
    odometry, tracked = drive((corridor[k] for k in range(6)), detector=SiftDetector(count=400))
    assert not any(one.is_lost for one in tracked)
    assert errors(odometry, corridor, slice(6)).ate_rmse_m < 0.02


def scene(seed=0, n=300):
    """Keypoints with descriptors, and the landmarks behind them."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform((0, 0), (511, 383), (n, 2))
    descriptors = rng.integers(0, 1 << 63, (n, 4)).astype(np.uint64)
    z = rng.uniform(2, 9, n)
    x, y = (uv - (RIG.cx, RIG.cy)).T / RIG.fx
    return uv, descriptors, np.column_stack([x, y, np.ones(n)]) * z[:, None]


def pose_by_descriptors(uv, descriptors, xyz, wanted):
    keypoint, row = match_descriptors(descriptors, wanted, max_hamming=64, ratio=0.85)
    return solve_pnp(RIG, xyz[row], uv[keypoint], max_error=4.0, min_matches=15)


def test_a_place_is_recognised_by_descriptors_alone():
    uv, descriptors, xyz = scene()
    rng = np.random.default_rng(1)
    rows = rng.permutation(len(uv))[:200]
    wanted = descriptors[rows] ^ (np.uint64(1) << rng.integers(0, 64, (200, 4)).astype(np.uint64))
    T = pose_by_descriptors(uv, descriptors, xyz[rows], wanted)
    np.testing.assert_allclose(T, np.eye(4), atol=1e-5)
    strangers = rng.integers(0, 1 << 63, wanted.shape).astype(np.uint64)
    assert pose_by_descriptors(uv, descriptors, xyz[rows], strangers) is None
    assert pose_by_descriptors(uv, descriptors[:, :0], xyz[rows], wanted[:, :0]) is None
    assert pose_by_descriptors(uv[:1], descriptors[:1], xyz[rows], wanted) is None


@pytest.mark.parametrize("skew", [0.0, 20.0])
def test_a_pose_is_found_by_a_fifth_of_the_matches_and_the_same_one_again(skew):
    rig, rng, T = replace(RIG, skew=skew), np.random.default_rng(3), np.eye(4)
    T[:3, 3] = 0.2, -0.1, 0.5
    camera = rng.uniform((-1, -1, 3), (1, 1, 9), (100, 3))
    uv = project(rig, camera)
    uv[20:] = rng.uniform((0, 0), (rig.width, rig.height), (80, 2))
    found = [solve_pnp(rig, camera + T[:3, 3], uv, max_error=2.0, min_matches=15) for _ in range(2)]
    np.testing.assert_allclose(found[0], T, atol=1e-3)
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("size", [128, 64])
def test_real_descriptors_become_words_that_keep_what_is_near(size):
    rng = np.random.default_rng(2)
    one = np.abs(rng.normal(size=(200, size))).astype(np.float32)
    near, far = (
        binary_descriptors(one + 0.1 * rng.normal(size=one.shape).astype(np.float32)),
        binary_descriptors(one[::-1]),
    )
    bits = [np.bitwise_count(binary_descriptors(one) ^ other).sum(axis=1) for other in (near, far)]
    assert np.max(bits[0]) < 60 < np.min(bits[1])
    assert binary_descriptors(np.zeros((3, 61), np.uint8)).shape == (3, 8)
