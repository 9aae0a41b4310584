"""Errors of a path: closed forms, and evo's figures to 1e-6."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam import InputError, Trajectory, evaluate_trajectory
from tspslam.vision.se3 import alignment, inverse, rotation_angle


def path(n=120, seed=0, noise=0.0, scale=1.0):
    """A path that turns, and one like it with noise, in a world of its own."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (n, 1, 1))
    turns = np.cumsum(rng.normal(0, 0.03, (n, 3)), axis=0)
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    poses[:, :3, 3] = np.cumsum(poses[:, :3, 2] * rng.uniform(0.3, 1.0, (n, 1)), axis=0) * scale
    if noise:
        poses[:, :3, 3] += rng.normal(0, noise, (n, 3))
        poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, noise / 10, (n, 3))).as_matrix()
    return Trajectory(1e9 + 0.1 * np.arange(n), poses)


def elsewhere(trajectory, seed=5):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(np.random.default_rng(seed).normal(size=4)).as_matrix()
    T[:3, 3] = 10, -20, 30
    return Trajectory(trajectory.stamp, T @ trajectory.T_world_camera)


def test_a_path_in_another_world_has_no_error():
    errors = evaluate_trajectory(elsewhere(path()), path())
    assert errors.ate_rmse_m < 1e-9
    assert errors.rpe_translation_m < 1e-9
    assert errors.rpe_rotation_deg < 1e-6
    assert errors.per_distance[10.0].translation_percent < 1e-9
    assert (errors.matched, errors.total) == (120, 120)
    np.testing.assert_allclose(errors.estimate, errors.reference, atol=1e-9)


def test_scale_is_found():
    errors = evaluate_trajectory(path(scale=1.02), path())
    assert errors.scale == pytest.approx(1 / 1.02, abs=1e-12)
    assert errors.ate_sim3_rmse_m < 1e-9 < errors.ate_rmse_m
    assert errors.per_distance[10.0].translation_percent == pytest.approx(2, abs=0.1)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", range(3))
def test_figures_are_those_of_evo(seed):
    pytest.importorskip("evo", reason="evo is not installed: pip install '.[dev]'")
    from evo.core import metrics, sync
    from evo.core.trajectory import PoseTrajectory3D

    reference, estimate = path(seed=seed), elsewhere(path(seed=seed, noise=0.05, scale=1.01))
    keep = np.random.default_rng(seed).random(120) > 0.2
    jitter = np.random.default_rng(seed).uniform(-0.004, 0.004, keep.sum())
    estimate = Trajectory(estimate.stamp[keep] + jitter, estimate.T_world_camera[keep])
    ours = evaluate_trajectory(estimate, reference)
    theirs = [
        PoseTrajectory3D(poses_se3=list(one.T_world_camera), timestamps=one.stamp) for one in (reference, estimate)
    ]
    theirs = sync.associate_trajectories(*theirs, max_diff=0.01)

    def figure(metric, scale):
        ref, est = theirs[0], PoseTrajectory3D(poses_se3=list(theirs[1].poses_se3), timestamps=theirs[1].timestamps)
        est.align(ref, correct_scale=scale)
        metric.process_data((ref, est))
        return metric.get_statistic(metrics.StatisticsType.rmse)

    def per_frame(metric):
        """Over neighbours that are one frame apart: evo takes the steps over frames left out as well."""
        figure(metric, False)
        return np.sqrt(np.mean(metric.error[np.diff(estimate.stamp) < 0.15] ** 2))

    part, unit = metrics.PoseRelation, metrics.Unit
    ten = {"delta": 10.0, "delta_unit": unit.meters, "all_pairs": True, "pairs_from_reference": True}
    expected = {
        ours.ate_rmse_m: figure(metrics.APE(part.translation_part), False),
        ours.ate_sim3_rmse_m: figure(metrics.APE(part.translation_part), True),
        ours.rpe_translation_m: per_frame(metrics.RPE(part.translation_part, 1, unit.frames)),
        ours.rpe_rotation_deg: per_frame(metrics.RPE(part.rotation_angle_deg, 1, unit.frames)),
        ours.per_distance[10.0].translation_m: figure(metrics.RPE(part.translation_part, **ten), False),
        ours.per_distance[10.0].rotation_deg: figure(metrics.RPE(part.rotation_angle_deg, **ten), False),
    }
    np.testing.assert_allclose(list(expected), list(expected.values()), rtol=1e-6)
    assert ours.matched == keep.sum()


def test_poses_are_matched_by_the_nearest_stamp_and_each_true_one_once():
    reference = path(5)
    estimate = Trajectory(
        reference.stamp[[0, 1, 1, 2, 3]] + [0, 0.001, 0.004, 0, 0.02], reference.T_world_camera[[0, 1, 2, 2, 3]]
    )
    errors = evaluate_trajectory(estimate, reference)
    assert (errors.matched, errors.total) == (3, 5)
    assert evaluate_trajectory(estimate, reference, max_stamp_difference=0.03).matched == 4


def test_unknown_true_poses_are_left_out():
    reference = path(10)
    holes = reference.T_world_camera.copy()
    holes[3:5] = np.nan
    assert evaluate_trajectory(reference, Trajectory(reference.stamp, holes)).matched == 8


def test_a_distance_beyond_the_path_has_no_pairs():
    assert evaluate_trajectory(path(5), path(5), distances=[1000]).per_distance[1000.0].pairs == 0


def test_mirrored_points_are_laid_by_a_rotation():
    points = np.random.default_rng(0).normal(size=(20, 3))
    T, scale = alignment(points, points * (-1, 1, 1))
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert scale == 1.0
    assert alignment(np.zeros((4, 3)), points[:4], with_scale=True)[1] == 1.0


def test_motions_are_inverted_and_small_angles_exact():
    T = path(20, noise=0.1).T_world_camera
    np.testing.assert_allclose(inverse(T) @ T, np.tile(np.eye(4), (20, 1, 1)), atol=1e-12)
    for angle in (1e-9, 0.3, np.pi):
        R = Rotation.from_rotvec(angle * np.array([0.6, 0, 0.8])).as_matrix()
        assert rotation_angle(R) == pytest.approx(angle, rel=1e-6)


GOOD = path(4)
LAST = np.zeros((4, 4, 4))
LAST[1:, 3, 3] = 1
BAD = {
    "shapes": (Trajectory(GOOD.stamp[:2], GOOD.T_world_camera), GOOD, {}),
    "do not increase": (Trajectory(GOOD.stamp[::-1], GOOD.T_world_camera), GOOD, {}),
    "no rotation": (Trajectory(GOOD.stamp, 2 * GOOD.T_world_camera), GOOD, {}),
    "no pose that is known": (GOOD, Trajectory(GOOD.stamp, GOOD.T_world_camera * np.nan), {}),
    "0 of 4 poses have a true one": (Trajectory(GOOD.stamp + 100, GOOD.T_world_camera), GOOD, {}),
    "expected > 0 m": (GOOD, GOOD, {"distances": [0]}),
    ">= 0 s": (GOOD, GOOD, {"max_stamp_difference": -1}),
    "last row 0 0 0 2, expected 0 0 0 1": (GOOD, Trajectory(GOOD.stamp, GOOD.T_world_camera + LAST), {}),
    "offset is the text 'soon'": (GOOD, GOOD, {"offset": "soon"}),
    "offset is NoneType": (GOOD, GOOD, {"offset": None}),
    "offset is bool": (GOOD, GOOD, {"offset": True}),
    "offset is int, expected a number": (GOOD, GOOD, {"offset": 10**400}),
    "offset is float64 of shape": (GOOD, GOOD, {"offset": np.zeros(2)}),
    "max_stamp_difference is NoneType": (GOOD, GOOD, {"max_stamp_difference": None}),
    "max_stamp_difference is the text '1'": (GOOD, GOOD, {"max_stamp_difference": "1"}),
    "deltas is the text '10m'": (GOOD, GOOD, {"deltas": "10m"}),
    "deltas is int": (GOOD, GOOD, {"deltas": 5}),
    "delta 5 is no length": (GOOD, GOOD, {"deltas": [5]}),
    "align is float64 of shape": (GOOD, GOOD, {"align": np.zeros(2)}),
    "align is list": (GOOD, GOOD, {"align": ["se3"]}),
    "not finite": (Trajectory(GOOD.stamp * np.inf, GOOD.T_world_camera), GOOD, {}),
}


@pytest.mark.parametrize("said", BAD)
def test_bad_trajectories_get_one_line(said):
    estimate, reference, options = BAD[said]
    with pytest.raises(InputError, match=said):
        evaluate_trajectory(estimate, reference, **options)


def taken(trajectory, rows):
    return Trajectory(trajectory.stamp[rows], trajectory.T_world_camera[rows])


@pytest.mark.parametrize(
    ("rows", "frames", "pairs"),
    [
        (np.arange(0, 120), 1, 119),
        (np.delete(np.arange(120), [30, 31, 70]), 1, 114),  # gaps are no frames
        (np.arange(0, 120, 3), 3, 39),  # a truth at a third of the rate
        (np.array([0, 1, *range(4, 120, 4)]), 4, 28),
    ],
)
def test_the_error_a_frame_is_a_frame_s_however_sparse_the_truth_is(rows, frames, pairs):
    """A drift of 1 mm a frame along a straight path."""
    truth = Trajectory(0.1 * np.arange(120), np.tile(np.eye(4), (120, 1, 1)))
    truth.T_world_camera[:, 2, 3] = np.arange(120)
    drifted = Trajectory(truth.stamp, truth.T_world_camera.copy())
    drifted.T_world_camera[:, 0, 3] = 0.001 * np.arange(120)
    errors = evaluate_trajectory(drifted, taken(truth, rows))
    assert (errors.rpe_frames, errors.rpe_pairs) == (frames, pairs)
    assert errors.rpe_translation_m == pytest.approx(0.001)


def test_the_rate_of_the_truth_does_not_matter_to_the_overlap():
    whole = path(2000)  # at 10 Hz
    for estimate, truth in ((taken(whole, slice(0, None, 20)), whole), (whole, taken(whole, slice(0, None, 20)))):
        errors = evaluate_trajectory(estimate, truth)
        assert (errors.matched, errors.warnings) == (100, ())
        assert min(errors.covered, errors.truth_covered) > 0.98


def test_a_part_of_a_path_is_said_to_be_one():
    whole = path(200)
    first, scattered = taken(whole, slice(0, 40)), np.arange(0, 200, 5)
    for estimate, truth, said in (
        (first, whole, "only 20 % of the true path is compared (40 of 200 poses)"),
        (whole, first, "only 20 % of the estimated path is compared (40 of 200 poses)"),
    ):
        errors = evaluate_trajectory(estimate, truth)
        assert errors.warnings == (f"{said}: the errors are those of a part",)
    late = whole.stamp + 0.05
    late[scattered] -= 0.05
    errors = evaluate_trajectory(Trajectory(late, whole.T_world_camera), whole)
    assert (errors.matched, len(errors.warnings)) == (40, 2)


def test_next_to_no_overlap_is_an_error():
    whole = path(200)
    for estimate, truth, said in (
        (whole, taken(whole, slice(0, 2)), "2 of 200 poses .*expected at least 3; stamps are"),
        (whole, taken(whole, slice(190, None)), r"10 of 200 poses .*4\.5 % of the path, expected at least 5 %"),
        (whole, Trajectory(whole.stamp + np.where(np.arange(200) % 40, 0.05, 0), whole.T_world_camera), "5 of 200"),
    ):
        with pytest.raises(InputError, match=said):
            evaluate_trajectory(estimate, truth)


def test_a_gap_of_an_age_is_no_frame():
    whole = path(6)
    stamps = np.array([0, 0.1, 0.2, 1e8, 1e8 + 0.1, 1e15])
    errors = evaluate_trajectory(Trajectory(stamps, whole.T_world_camera), Trajectory(stamps, whole.T_world_camera))
    assert (errors.rpe_frames, errors.rpe_pairs) == (1, 3)


def drive(n=2000, seed=3, drift=0.0):
    """A path of 0.97 m a frame that turns, and by `drift` rad more in each."""
    rng = np.random.default_rng(seed)
    turns = np.cumsum(rng.normal(0, 0.02, n))
    steps = np.tile(np.eye(4), (n, 1, 1))
    steps[:, :3, :3] = Rotation.from_rotvec(
        np.stack([0 * turns, np.diff(turns, prepend=0) + drift, 0 * turns], 1)
    ).as_matrix()
    steps[:, 2, 3] = 0.97
    poses = [np.eye(4)]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    return Trajectory(0.1 * np.arange(n), np.array(poses))


def test_the_table_of_kitti_is_that_of_its_definition():
    truth, turned = drive(), drive(drift=1e-4)
    found = evaluate_trajectory(turned, truth).kitti
    assert list(found.per_length) == [100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0]
    assert found.rotation_deg_100m == pytest.approx(np.degrees(1e-4) * 100 / 0.97, rel=0.01)  # they are longer
    assert found.travelled_m == pytest.approx(1999 * 0.97)
    sections, percents, degrees = 0, [], []
    for length in found.per_length:  # by hand, section by section
        for i in range(0, 2000, 10):
            j = i + int(length / 0.97) + 1  # the first beyond
            if j < 2000:
                Q = inverse(truth.T_world_camera[i]) @ truth.T_world_camera[j]
                E = inverse(inverse(turned.T_world_camera[i]) @ turned.T_world_camera[j]) @ Q
                percents.append(100 * np.linalg.norm(E[:3, 3]) / length)
                degrees.append(100 * np.degrees(rotation_angle(E[:3, :3])) / length)
                sections += 1
    np.testing.assert_allclose(found.translation_percent, np.mean(percents), rtol=1e-9)
    np.testing.assert_allclose(found.rotation_deg_100m, np.mean(degrees), rtol=1e-9)
    assert sum(row[0] for row in found.per_length.values()) == sections


def test_a_path_too_short_for_kitti_has_no_section():
    found = evaluate_trajectory(drive(90), drive(90)).kitti
    assert (found.per_length, found.translation_percent) == ({}, 0.0)
    assert found.travelled_m == pytest.approx(89 * 0.97)


def test_errors_over_frames_seconds_and_metres_are_the_same_lengths_of_a_steady_path():
    truth, turned = drive(300), drive(300, drift=1e-3)
    found = evaluate_trajectory(turned, truth, deltas=["10f", "1s", "9.7m"]).per_delta
    assert found["10f"].pairs == 290
    assert found["10f"].rotation_deg == pytest.approx(np.degrees(0.01))
    assert found["10f"].translation_m == pytest.approx(found["9.7m"].translation_m, rel=0.01)
    assert found["10f"].translation_m == pytest.approx(found["1s"].translation_m, rel=0.01)
    assert found["10f"].translation_percent == pytest.approx(100 * found["10f"].translation_m / 9.7, rel=0.01)
    kept = np.delete(np.arange(300), [100, 101])
    assert evaluate_trajectory(taken(turned, kept), truth, deltas=["1f"]).per_delta["1f"].pairs == 296


@pytest.mark.parametrize("delta", ["", "0m", "1", "m", "1.5f", "-1m", "1_0m", "nanm", "1e3m", "10 m", 5])
def test_a_delta_that_is_none_is_refused(delta):
    with pytest.raises(InputError, match="is no length"):
        evaluate_trajectory(path(), path(), deltas=[delta])


def test_each_alignment_lays_the_path_as_it_says():
    truth = path()
    moved = elsewhere(path(scale=1.1))
    errors = {align: evaluate_trajectory(moved, truth, align=align) for align in ("none", "origin", "se3", "sim3")}
    assert errors["sim3"].ate_rmse_m < 1e-9
    assert errors["sim3"].rpe_translation_m < 1e-9 < errors["se3"].rpe_translation_m
    assert errors["origin"].ate_m[0] < 1e-9 < errors["se3"].ate_m[0]
    assert errors["se3"].ate_rmse_m < errors["origin"].ate_rmse_m < errors["none"].ate_rmse_m
    np.testing.assert_array_equal(errors["none"].estimate, moved.T_world_camera[:, :3, 3])
    np.testing.assert_array_equal(errors["none"].T_reference_estimate, np.eye(4))
    for one in errors.values():
        assert one.scale == pytest.approx(1 / 1.1)
        assert one.ate_sim3_rmse_m < 1e-9
        assert one.ate_rmse_m == pytest.approx(np.sqrt(np.mean(one.ate_m**2)))
    with pytest.raises(InputError, match="align"):
        evaluate_trajectory(moved, truth, align="best")


def test_an_offset_is_added_to_the_stamps_of_the_estimate():
    early = Trajectory(path().stamp - 700, path().T_world_camera)
    errors = evaluate_trajectory(early, path(), offset=700)
    assert (errors.matched, errors.offset_s) == (120, 700.0)
    for offset, said in ((0, "0 of 120 poses"), (np.nan, "finite seconds"), (1e30, "do not differ any more")):
        with pytest.raises(InputError, match=said):
            evaluate_trajectory(early, path(), offset=offset)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("delta", "unit"), [("5f", "frames"), ("20m", "meters")])
def test_errors_over_a_delta_are_those_of_evo(delta, unit):
    pytest.importorskip("evo", reason="evo is not installed: pip install '.[dev]'")
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    reference, estimate = path(), elsewhere(path(noise=0.05, scale=1.01))
    found = evaluate_trajectory(estimate, reference, deltas=[delta]).per_delta[delta]
    both = tuple(PoseTrajectory3D(poses_se3=list(p.T_world_camera), timestamps=p.stamp) for p in (reference, estimate))
    for part, ours in (("translation_part", found.translation_m), ("rotation_angle_deg", found.rotation_deg)):
        metric = metrics.RPE(
            metrics.PoseRelation[part], float(delta[:-1]), metrics.Unit[unit], all_pairs=True, pairs_from_reference=True
        )
        metric.process_data(both)
        assert metric.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(ours, rel=1e-6)


@pytest.mark.parametrize("offset", [0.0, 5.0])
def test_no_motion_is_compared_from_one_recording_to_the_next(offset):
    truth = drive(600)
    begin, jumped = float(truth.stamp[300]), truth.T_world_camera.copy()
    jumped[300:, :3, 3] += 4.0
    given = Trajectory(truth.stamp - offset, jumped)
    how = {"deltas": ["10f", "3s", "20m"], "offset": offset}
    one = evaluate_trajectory(given, truth, **how)
    two = evaluate_trajectory(given, truth, parts=[begin - offset], **how)
    assert two.ate_rmse_m == one.ate_rmse_m > 1
    assert (two.rpe_pairs, two.per_delta["10f"].pairs) == (598, 580)
    assert two.kitti.travelled_m == pytest.approx(598 * 0.97)
    for found, is_right in ((one, False), (two, True)):
        errors = [found.rpe_translation_m, found.kitti.translation_percent]
        errors += [each.translation_m for each in (*found.per_delta.values(), *found.per_distance.values())]
        assert all((error < 1e-6) == is_right for error in errors)


def test_recordings_of_one_match_each_have_no_motion():
    errors = evaluate_trajectory(path(3), path(3), parts=path(3).stamp)
    assert (errors.rpe_pairs, errors.rpe_translation_m, errors.kitti.travelled_m) == (0, 0.0, 0.0)
