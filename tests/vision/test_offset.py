"""The offset of two clocks is found where the motions fix it, and refused where they do not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.vision.test_evaluate import elsewhere
from tspslam import InputError, Trajectory
from tspslam.vision.evaluate import find_offset


def walk(stamps, seed=0, noise=0.0):
    """A camera that turns and moves as smooth noise does, seen at any stamps of 60 s; and poses with errors."""
    rng = np.random.default_rng(seed)
    waves, phases = rng.uniform(0.3, 4, (6, 8)), rng.uniform(0, 2 * np.pi, (6, 8))
    values = (np.sin(stamps[:, None, None] * waves + phases) / waves).sum(axis=2)
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(0.2 * values[:, :3]).as_matrix()
    poses[:, :3, 3] = values[:, 3:]
    error = np.random.default_rng(seed + 1)
    poses[:, :3, 3] += error.normal(0, noise, (len(stamps), 3))
    poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(error.normal(0, noise, (len(stamps), 3))).as_matrix()
    return Trajectory(stamps, poses)


def late(path, seconds):
    return Trajectory(path.stamp + seconds, path.T_world_camera)


@pytest.mark.parametrize(("offset", "every"), [(0.0, 0.05), (0.137, 0.005), (-2.5, 0.05), (-1.4e9, 0.1)])
def test_the_offset_is_found_between_frames_and_from_any_clock(offset, every):
    truth = walk(np.arange(0, 60, every))
    estimate = elsewhere(walk(np.arange(5, 50, 0.05), noise=1e-3))
    found = find_offset(late(estimate, -offset), truth)
    assert found.seconds == pytest.approx(offset, abs=0.004)
    assert abs(found.seconds - offset) < 5 * found.sigma_s + 1e-6
    assert found.sigma_s < 0.004
    assert found.contrast < 0.5


def test_poses_that_are_missing_do_not_matter():
    truth, estimate = walk(np.arange(0, 60, 0.05)), walk(np.arange(5, 50, 0.05))
    kept = np.random.default_rng(3).random(900) > 0.2
    kept[200:300] = False
    part = Trajectory(estimate.stamp[kept] - 3, estimate.T_world_camera[kept])
    assert find_offset(part, truth).seconds == pytest.approx(3, abs=0.005)


def even(stamps):
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 2, 3] = stamps
    return Trajectory(stamps, poses)


def swinging(stamps):
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 0, 3] = np.sin(stamps)
    return Trajectory(stamps, poses)


def nudged(stamps, noise):
    """A camera that stands, but for one push within a second."""
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 0, 3] = np.interp(stamps, [14, 14.2, 14.8], [0, 0.4, 1])
    poses[:, :3, 3] += np.random.default_rng(len(stamps)).normal(0, noise, (len(stamps), 3))
    return Trajectory(stamps, poses)


TIMES = np.arange(0, 60, 0.05)
REFUSED = {
    "100 % of what fixes it is in one of 8 parts": (late(nudged(TIMES[100:1100], 0), 3), nudged(TIMES, 0)),
    "9?[0-9]+ % of what fixes it is in one": (late(nudged(TIMES[100:1100], 1e-4), 3), nudged(TIMES, 1e-4)),
    "turn and move evenly": (even(TIMES), even(TIMES)),
    "the next best fits nearly as well": (swinging(TIMES), swinging(TIMES)),
    "nearly as well": (walk(TIMES, seed=1), walk(TIMES, seed=9)),
    "the estimate has 10 poses": (walk(TIMES[:10]), walk(TIMES)),
    "fewer than 20 steps without a gap": (walk(TIMES), walk(np.sort(np.r_[TIMES[:15], TIMES[100::100], 1e9]))),
}


@pytest.mark.parametrize("said", REFUSED)
def test_motions_that_do_not_fix_the_offset_are_refused(said):
    with pytest.raises(InputError, match=f"offset: .*{said}"):
        find_offset(*REFUSED[said])
