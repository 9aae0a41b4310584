"""Bundle adjustment: exact on exact data, at the optimum that SciPy finds on noisy data, never worse than the start."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import tspslam
from tspslam.errors import GeometryError, InputError
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.least_squares.bundle import Observations, adjust

ROOT = Path(__file__).parents[3]
RIG = tspslam.Rig(fx=400, fy=410, cx=320, cy=240, baseline=0.2, width=640, height=480, skew=1.5, doffs=4.0)


def seen_by(T, xyz, noise=0.0, seed=0, bearings=0.0):
    """All points seen by all cameras."""
    rng = np.random.default_rng(seed)
    pose, point = (index.ravel() for index in np.indices((len(T), len(xyz))))
    p = np.einsum("kij,kj->ki", inverse(T)[pose, :3, :3], xyz[point]) + inverse(T)[pose, :3, 3]
    x, y, z = p.T
    uv = np.column_stack([RIG.cx + (RIG.fx * x + RIG.skew * y) / z, RIG.cy + RIG.fy * y / z])
    disparity = RIG.fx * RIG.baseline / z - RIG.doffs
    uv, disparity = uv + rng.normal(0, noise, uv.shape), disparity + rng.normal(0, noise / 2, len(z))
    disparity[rng.random(len(z)) < bearings] = np.nan
    one = np.ones(len(z))
    return Observations(pose, point, uv, disparity, one, one / 2)


def world(poses=5, points=40, seed=0):
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (poses, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(rng.normal(0, 0.05, (poses, 3))).as_matrix()
    T[:, :3, 3] = np.outer(np.arange(poses), (0.1, 0, 0.4))
    T[0] = np.eye(4)
    return T, rng.uniform((-3, -2, 5), (3, 2, 12), (points, 3))


def shaken(T, xyz, seed=1, far=0.05):
    rng = np.random.default_rng(seed)
    off = T.copy()
    off[1:, :3, :3] = off[1:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, far / 3, (len(T) - 1, 3))).as_matrix()
    off[1:, :3, 3] += rng.normal(0, far, (len(T) - 1, 3))
    return off, xyz + rng.normal(0, 3 * far, xyz.shape)


def test_exact_sights_give_the_exact_world():
    T, xyz = world()
    found = adjust(RIG, *shaken(T, xyz), seen_by(T, xyz, bearings=0.3))
    np.testing.assert_allclose(found.T_world_camera, T, atol=1e-7)
    np.testing.assert_allclose(found.xyz, xyz, atol=1e-6)
    assert found.cost < 1e-9 < found.cost_before
    assert found.distance.max() < 1e-4


@pytest.mark.parametrize("huber", [1e9, 1.0])
def test_the_optimum_is_that_of_a_plain_solver(huber):
    T, xyz = world(poses=3, points=12)
    seen = seen_by(T, xyz, noise=1.0, bearings=0.2)
    start = shaken(T, xyz, far=0.02)
    ours = adjust(RIG, *start, seen, huber=huber, max_steps=60)

    def unpacked(x):
        poses = start[0].copy()
        poses[1:, :3, :3] = Rotation.from_rotvec(x[:6].reshape(2, 3)).as_matrix() @ poses[1:, :3, :3]
        poses[1:, :3, 3] = x[6:12].reshape(2, 3)
        return poses, x[12:].reshape(-1, 3)

    def lengths(x):
        poses, points = unpacked(x)
        there = seen_by(poses, points)
        off = np.column_stack([there.uv - seen.uv, 2 * np.nan_to_num(there.disparity - seen.disparity)])
        length = np.linalg.norm(off, axis=1)
        shrunk = np.where(length > huber, np.sqrt(2 * huber * np.maximum(length, huber) - huber**2), length)
        return (off * (shrunk / np.maximum(length, 1e-12))[:, None]).ravel()

    x = np.concatenate([np.zeros(6), start[0][1:, :3, 3].ravel(), start[1].ravel()])
    theirs = least_squares(lengths, x, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=200)
    assert ours.cost == pytest.approx(2 * theirs.cost, rel=1e-4)
    np.testing.assert_allclose(ours.T_world_camera, unpacked(theirs.x)[0], atol=2e-3)


@pytest.mark.parametrize("offset", [0.0, 0.3, -0.5])
def test_a_common_offset_of_disparities_is_found_from_motion(offset):
    T, xyz = world(poses=8, points=300)
    xyz[::2] *= 4  # near and far
    seen = seen_by(T, xyz)
    shifted = Observations(**{**vars(seen), "disparity": seen.disparity + offset})
    exact = adjust(RIG, *shaken(T, xyz, far=0.02), shifted, offset_sigma=10.0, max_steps=50)
    assert exact.offset == pytest.approx(offset, abs=1e-3)
    np.testing.assert_allclose(exact.T_world_camera, T, atol=1e-4)
    noisy = seen_by(T, xyz, noise=0.5, seed=3)
    noisy = Observations(**{**vars(noisy), "disparity": noisy.disparity + offset})
    found = adjust(RIG, *shaken(T, xyz, far=0.02), noisy, offset_sigma=1.0, max_steps=50)
    assert abs(found.offset - offset) < 3 * found.offset_std
    assert 0 < found.offset_std < 0.2
    stays = adjust(RIG, *shaken(T, xyz, far=0.02), noisy, offset=offset)
    assert (stays.offset, stays.offset_std) == (offset, 0.0)


def test_a_still_camera_leaves_the_offset_where_it_was():
    _, xyz = world()
    T = np.tile(np.eye(4), (5, 1, 1))
    seen = seen_by(T, xyz, noise=0.3)
    shifted = Observations(**{**vars(seen), "disparity": seen.disparity + 0.4})
    found = adjust(RIG, T, xyz, shifted, offset_sigma=0.5)
    assert abs(found.offset) < 0.1
    assert found.offset_std == pytest.approx(0.5, rel=0.1)


def test_a_wild_sight_hardly_moves_the_result():
    T, xyz = world()
    seen = seen_by(T, xyz, noise=0.3)
    seen.uv[7::31] += 80
    found = adjust(RIG, *shaken(T, xyz), seen)
    np.testing.assert_allclose(found.T_world_camera[:, :3, 3], T[:, :3, 3], atol=0.05)
    assert (found.distance[7::31] > 50).all()
    assert np.median(found.distance) < 2


def test_fixed_poses_and_points_stay_to_the_bit():
    T, xyz = world()
    off, about = shaken(T, xyz)
    seen = seen_by(T, xyz, noise=0.5)
    fixed = np.array([True, False, True, False, False])
    found = adjust(RIG, off, about, seen, fixed=fixed)
    np.testing.assert_allclose(found.T_world_camera[fixed], off[fixed], atol=1e-15)
    assert (found.T_world_camera[~fixed] != off[~fixed]).any(axis=(1, 2)).all()
    only_poses = adjust(RIG, off, xyz, seen, move_points=False)
    assert np.array_equal(only_poses.xyz, xyz)
    np.testing.assert_allclose(only_poses.T_world_camera[:, :3, 3], T[:, :3, 3], atol=0.05)
    only_points = adjust(RIG, T, about, seen, fixed=np.ones(5, bool))
    np.testing.assert_allclose(only_points.T_world_camera, T, atol=1e-15)
    assert np.linalg.norm(only_points.xyz - xyz, axis=1).mean() < 0.1


@pytest.mark.parametrize("seed", range(5))
def test_the_cost_never_rises_and_the_order_of_sights_does_not_matter(seed):
    T, xyz = world(seed=seed)
    seen = seen_by(T, xyz, noise=2.0, seed=seed)
    start = shaken(T, xyz, seed=seed, far=0.3)
    found = adjust(RIG, *start, seen)
    assert found.cost <= found.cost_before
    mixed = np.random.default_rng(seed).permutation(len(seen.pose))
    again = adjust(RIG, *start, Observations(*(getattr(seen, name)[mixed] for name in vars(seen))))
    assert np.array_equal(found.T_world_camera, again.T_world_camera)
    assert np.array_equal(found.distance[mixed], again.distance)


def test_points_behind_a_camera_are_told_and_do_no_harm():
    T, xyz = world()
    xyz[3, 2] = -4
    seen = seen_by(T, np.abs(xyz))
    found = adjust(RIG, T, xyz, seen)
    assert np.isfinite(found.T_world_camera).all()
    assert np.isfinite(found.xyz).all()
    assert np.isinf(found.distance[seen.point == 3]).any()


def test_a_pose_from_which_nothing_is_seen_stays_and_one_sight_is_met():
    T, xyz = world()
    seen, off = seen_by(T, xyz), T.copy()
    off[0, 0, 3] += 0.3
    alone = Observations(*(getattr(seen, name)[:1] for name in vars(seen)))  # the first point from the first camera
    found = adjust(RIG, off, xyz, alone, fixed=np.zeros(5, bool), move_points=False)
    np.testing.assert_allclose(found.T_world_camera[1:], T[1:], atol=1e-12)
    assert found.cost < 1e-9 < found.cost_before
    assert found.distance[0] < 1e-4
    assert np.abs(found.T_world_camera[0] - off[0]).max() > 0.01


def test_a_world_that_no_pose_holds_is_found_up_to_its_place():
    T, xyz = world()
    found = adjust(RIG, *shaken(T, xyz), seen_by(T, xyz), fixed=np.zeros(5, bool))
    there = inverse(found.T_world_camera[:1]) @ found.T_world_camera
    assert found.cost < 1e-9
    np.testing.assert_allclose(there, inverse(T[:1]) @ T, atol=1e-6)


def test_many_points_settle_in_few_steps_on_equations_of_the_cameras_alone(monkeypatch):
    """Four steps, each one pass over the observations and 54 equations; the optimum is that of fifty steps."""
    from tspslam.vision.slam.least_squares import _kernels as _least_squares
    from tspslam.vision.slam.least_squares import bundle

    sizes, passes, solved, reduce = [], [], bundle._solved, _least_squares.reduce
    monkeypatch.setattr(bundle, "_solved", lambda S, b: (sizes.append(S.shape), solved(S, b))[1])
    monkeypatch.setattr(_least_squares, "reduce", lambda *given: (passes.append(1), reduce(*given))[1])
    T, xyz = world(poses=10, points=1500)
    seen, start = seen_by(T, xyz, noise=0.5), shaken(T, xyz, far=0.02)
    found = adjust(RIG, *start, seen, max_steps=6)
    assert set(sizes) == {(54, 54)}  # nine cameras move
    assert len(passes) <= found.steps + 3
    assert found.cost == pytest.approx(adjust(RIG, *start, seen, max_steps=50).cost, rel=1e-6)
    # of 0.5 px about pixels (sigma 1) and 0.25 px about disparities (sigma 0.5): a quarter each, the points' share less
    free = 3 * len(seen.pose) - 54 - 3 * 1500
    assert found.cost == pytest.approx(0.25 * free, rel=6 * (2 / free) ** 0.5)


GOOD = seen_by(*world(2, 5))
BAD = {
    "shapes": lambda: adjust(RIG, np.eye(4), np.zeros((5, 3)), GOOD),
    "not finite, or huber": lambda: adjust(RIG, world(2)[0] * np.nan, world(2, 5)[1], GOOD),
    "huber, -1": lambda: adjust(RIG, *world(2, 5), GOOD, huber=-1),
    "observations have shapes": lambda: adjust(RIG, *world(2, 5), replace(uv=np.zeros((3, 2)))),
    "point is int64 up to 4": lambda: adjust(RIG, *world(2, 4), GOOD),
    "pose is float64": lambda: adjust(RIG, *world(2, 5), replace(pose=GOOD.pose * 1.0)),
    "sigma is not positive": lambda: adjust(RIG, *world(2, 5), replace(sigma_uv=0 * GOOD.sigma_uv)),
    "uv or disparity is not finite": lambda: adjust(RIG, *world(2, 5), replace(uv=GOOD.uv * np.inf)),
    "offset, offset_sigma": lambda: adjust(RIG, *world(2, 5), GOOD, offset_sigma=-1),
    "fixed is int64": lambda: adjust(RIG, *world(2, 5), GOOD, fixed=np.zeros(2, int)),
}


def replace(**changes):
    return Observations(**{**vars(GOOD), **changes})


@pytest.mark.parametrize("said", BAD)
def test_bad_input_gets_one_line(said):
    with pytest.raises(InputError, match=said):
        BAD[said]()


def test_a_problem_without_solution_is_a_geometry_error(monkeypatch):
    from tspslam.vision.slam.least_squares import bundle

    monkeypatch.setattr(bundle, "_solved", lambda S, b: None)
    with pytest.raises(GeometryError, match="no solution"):
        adjust(RIG, *world(2, 5), GOOD)


_ADJUSTED = """
import hashlib
from tests.vision.slam.test_bundle import RIG, adjust, seen_by, shaken, world
T, xyz = world(60, 200)
found = adjust(RIG, *shaken(T, xyz), seen_by(T, xyz, noise=0.5), offset_sigma=0.3)
print(hashlib.sha256(found.T_world_camera.tobytes() + found.xyz.tobytes()).hexdigest())
"""


def test_any_number_of_threads_gives_the_same_bytes():
    def printed(threads):
        given = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), threads)
        command = [sys.executable, "-c", _ADJUSTED]
        return subprocess.run(command, env=given, cwd=ROOT, check=True, capture_output=True).stdout

    assert printed("1") == printed("2") != b""
