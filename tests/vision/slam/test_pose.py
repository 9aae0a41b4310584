"""One camera's pose from known points: what bundle adjustment finds, found with less work."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam import GeometryError
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.least_squares import _kernels as _least_squares
from tspslam.vision.slam.least_squares._kernels import pose_equations
from tspslam.vision.slam.least_squares.bundle import Observations, adjust
from tspslam.vision.slam.pose import PoseEstimate, fit_pose, fit_robustly, lens_of

from .test_bundle import RIG, seen_by, world

SIGMA = 0.8, 0.4


def observations(points=60, noise=0.5, seed=0, wild=0):
    T, xyz = world(poses=2, points=points, seed=seed)
    seen = seen_by(T[1:], xyz, noise, seed, bearings=0.3)
    seen.uv[:wild] += 60
    return T[1], xyz, np.column_stack([seen.uv, seen.disparity])


def as_observations(seen):
    rows, ones = np.arange(len(seen)), np.ones(len(seen))
    return Observations(0 * rows, rows, seen[:, :2], seen[:, 2], SIGMA[0] * ones, SIGMA[1] * ones)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("wild", [0, 15])
def test_it_is_the_pose_of_bundle_adjustment(seed, wild):
    T, xyz, seen = observations(seed=seed, wild=wild)
    start = T.copy()
    start[:3, 3] += 0.2
    start[:3, :3] = start[:3, :3] @ Rotation.from_rotvec([0.02, -0.05, 0.03]).as_matrix()
    ours = fit_pose(RIG, start, xyz, seen, SIGMA)
    other = adjust(RIG, start[None], xyz, as_observations(seen), move_points=False, max_steps=10)
    np.testing.assert_allclose(ours.T_world_camera, other.T_world_camera[0], atol=1e-9)
    np.testing.assert_allclose(ours.distance, other.distance, rtol=1e-6, atol=1e-7)


def test_exact_sights_give_the_exact_pose():
    T, xyz, seen = observations(noise=0.0)
    found = fit_pose(RIG, np.eye(4), xyz, seen, SIGMA)
    np.testing.assert_allclose(found.T_world_camera, T, atol=1e-8)


def test_a_disparity_of_endless_spread_counts_as_none():
    T, xyz, seen = observations(noise=0.3)
    seen[::2, 2] += 30.0
    spread, bearings = np.full(len(xyz), SIGMA[1]), seen.copy()
    spread[::2], bearings[::2, 2] = 1e9, np.nan
    ours, other = fit_pose(RIG, T, xyz, seen, (SIGMA[0], spread)), fit_pose(RIG, T, xyz, bearings, SIGMA)
    np.testing.assert_allclose(ours.T_world_camera, other.T_world_camera, atol=1e-9)
    off = fit_pose(RIG, T, xyz, seen, SIGMA).T_world_camera[:3, 3] - T[:3, 3]
    assert np.linalg.norm(off) > 3 * np.linalg.norm(ours.T_world_camera[:3, 3] - T[:3, 3])


def test_its_equations_are_the_derivatives_of_the_cost():
    T, xyz, seen = observations(noise=0.5)
    T, weights = inverse(T), np.tile(np.array(SIGMA) ** -2.0, (len(xyz), 1))

    def cost(step):
        S, b = np.empty((6, 6)), np.empty(6)
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        R, t = turn @ T[:3, :3], turn @ T[:3, 3] + step[3:]
        return pose_equations(lens_of(RIG), R, t, xyz, seen, weights, 1e9, S, b), S, b

    _, S, b = cost(np.zeros(6))
    steps = 1e-5 * np.eye(6)
    slope = [(cost(h)[0] - cost(-h)[0]) / 2e-5 for h in steps]
    np.testing.assert_allclose(slope, -2 * b, rtol=1e-4, atol=1e-2 * np.abs(b).max())
    bend = np.column_stack([(cost(-h)[2] - cost(h)[2]) / 2e-5 for h in steps])
    assert np.abs(bend - S).max() < 0.01 * np.abs(S).max()


def test_its_covariance_is_the_spread_of_repeated_fits():
    T, xyz, _ = observations()
    clean = seen_by(T[None], xyz)
    rng, found = np.random.default_rng(0), []
    for _ in range(300):
        noisy = np.column_stack([clean.uv + rng.normal(0, 0.8, clean.uv.shape), clean.disparity])
        noisy[:, 2] += rng.normal(0, 0.4, len(noisy))
        found.append(fit_pose(RIG, T, xyz, noisy, SIGMA, huber=1e9))
    off = np.array([(inverse(fit.T_world_camera) @ T)[:3, 3] for fit in found])
    said = np.sqrt(np.diag(np.linalg.inv(found[0].information))[3:])
    np.testing.assert_allclose(off.std(axis=0), said, rtol=0.15)


def test_points_behind_are_infinitely_far_off():
    T, xyz, seen = observations()
    xyz[3] = T[:3, 3] - 2 * T[:3, 2]
    found = fit_pose(RIG, T, xyz, seen, SIGMA)
    assert np.isinf(found.distance[3])
    assert np.isfinite(np.delete(found.distance, 3)).all()
    np.testing.assert_allclose(found.T_world_camera[:3, 3], T[:3, 3], atol=0.05)


def test_points_that_are_nowhere_fix_no_pose():
    T, xyz, seen = observations()
    with pytest.raises(GeometryError, match="the equations have no solution, expected observations that fix the poses"):
        fit_pose(RIG, T, np.full_like(xyz, np.nan), np.nan * seen, SIGMA)


def test_it_asks_nothing_of_bundle_adjustment_and_stops_where_it_has_settled(monkeypatch):
    """More steps allowed are none taken."""
    monkeypatch.setattr(_least_squares, "reduce", None)
    _, xyz, seen = observations(points=60)
    some, most = (fit_pose(RIG, np.eye(4), xyz, seen, SIGMA, max_steps=steps) for steps in (11, 100))
    np.testing.assert_array_equal(some.T_world_camera, most.T_world_camera)


def test_gates_drop_outliers_one_after_another():
    T, xyz, seen = observations(points=60, noise=0.3, wild=10)
    seen[10, 0] += 4.0
    given = PoseEstimate(T, np.arange(60), seen[:, :2], seen[:, 2], np.eye(6))
    wide, narrow = (fit_robustly(RIG, xyz, given, SIGMA, gates, 15) for gates in ((9.0,), (9.0, 3.0)))
    assert wide.landmark.tolist() == list(range(10, 60))
    assert narrow.landmark.tolist() == list(range(11, 60))
    once = fit_pose(RIG, narrow.T_world_camera, xyz[11:], seen[11:], SIGMA, max_steps=0)
    np.testing.assert_allclose(np.linalg.inv(narrow.covariance), once.information, rtol=1e-6, atol=1e-3)
    assert fit_robustly(RIG, xyz, given, SIGMA, (9.0,), 51) is None
    np.testing.assert_array_equal(given.uv, seen[:, :2])
