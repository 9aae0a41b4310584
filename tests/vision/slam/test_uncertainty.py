"""A pose's covariance is that of its errors: of the image's noise, of depths that were measured once, of a common offset."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam import InputError
from tspslam.datasets import synthetic
from tspslam.vision.rig import back_project, project
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.locating import uncertainty
from tspslam.vision.slam.locating.shared_errors import shared_information
from tspslam.vision.slam.locating.uncertainty import Sources, adjoint, pose_covariance
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.slam.pose import PoseEstimate
from tspslam.vision.slam.tracking import TrackingSettings, refine_pose

from ...sequences import DETECTOR, RIG

SIGMA, DRAWS = 0.3, 150
AHEAD = np.eye(4)
AHEAD[2, 3] = 1.0


def twist(T):
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def normalised_error(errors, covariances):
    """Squared Mahalanobis length for each degree of freedom: 1 if the covariances are the errors'."""
    return np.mean([e @ np.linalg.solve(C, e) / 6 for e, C in zip(errors, covariances, strict=True)])


def smooth_field(rng, uv, size=100.0):
    """Errors of u, v and disparity that change over some 100 px only: (K, 3), of unit variance at the nodes."""
    at, nodes = uv / size, rng.normal(0, 1, (8, 8, 3))
    low, part = at.astype(int), at - at.astype(int)
    value = 0.0
    for du, dv in np.ndindex(2, 2):
        share = np.abs(1 - du - part[:, :1]) * np.abs(1 - dv - part[:, 1:])
        value = value + share * nodes[low[:, 1] + dv, low[:, 0] + du]
    return value


def located(rng, offset=0.0, offset_std=1e-9, alike=0.0):
    """A step of 1 m ahead from landmarks that one keyframe measured: its error, fitted and full covariances."""
    uv = rng.uniform((20, 20), (490, 360), (150, 2))
    true = back_project(RIG, uv, rng.uniform(4, 25, 150))
    seen = true - AHEAD[:3, 3]
    there = project(RIG, seen)
    rows = (there > 0).all(axis=1) & (there < (RIG.width, RIG.height)).all(axis=1) & (seen[:, 2] > 1)
    uv, true, seen, there = uv[rows], true[rows], seen[rows], there[rows]
    fB, count = RIG.fx * RIG.baseline, len(uv)
    shared = alike * SIGMA * smooth_field(rng, there) if alike else np.zeros((len(uv), 3))
    xyz = back_project(RIG, uv, fB / true[:, 2] + offset + rng.normal(0, SIGMA, count))
    disparity = fB / seen[:, 2] + offset + rng.normal(0, SIGMA, count) + shared[:, 2]
    there = there + rng.normal(0, SIGMA, there.shape) + shared[:, :2]
    estimate = PoseEstimate(AHEAD, np.arange(count), there, np.full(count, np.nan), np.eye(6))
    found = refine_pose(RIG, estimate, xyz, disparity, SIGMA, TrackingSettings(first_gate=20, last_gate=20))
    ones = np.ones(len(found), np.int64)
    sources = Sources(np.eye(4), np.zeros((len(found), 3)), ones, SIGMA, SIGMA * ones, offset_std)
    return twist(inverse(AHEAD) @ found.T_world_camera), found.covariance, pose_covariance(RIG, found, xyz, sources)


def test_depths_that_were_measured_once_are_part_of_the_covariance():
    """Measured 1.3, and 3.7 of the covariance that takes landmarks as known."""
    rng = np.random.default_rng(0)
    errors, fitted, full = zip(*(located(rng) for _ in range(DRAWS)), strict=True)
    assert normalised_error(errors, fitted) > 2
    assert 0.5 < normalised_error(errors, full) < 2


def test_the_offset_of_all_disparities_is_part_of_the_covariance():
    rng, std = np.random.default_rng(1), 0.3
    draws = [located(rng, rng.normal(0, std), std) for _ in range(DRAWS)]
    errors, _, full = zip(*draws, strict=True)
    assert 0.5 < normalised_error(errors, full) < 2
    blind = [located(np.random.default_rng(k), 0.6)[::2] for k in range(20)]
    assert normalised_error(*zip(*blind, strict=True)) > 2


def test_errors_that_neighbours_share_are_part_of_the_covariance(monkeypatch):
    """As large as the noise, in each of u, v and disparity: measured 1.5, and 2.8 of points that err each alone."""
    rng = np.random.default_rng(4)
    errors, _, full = zip(*(located(rng, alike=1.0) for _ in range(DRAWS)), strict=True)
    assert 0.5 < normalised_error(errors, full) < 2
    monkeypatch.setattr(uncertainty, "shared_information", lambda *_: np.zeros((6, 6)))
    rng = np.random.default_rng(4)
    errors, _, alone = zip(*(located(rng, alike=1.0) for _ in range(DRAWS)), strict=True)
    assert normalised_error(errors, alone) > 2


def test_errors_that_neighbours_do_not_share_add_little():
    """Of 500 points by chance a tenth, in the mean over draws."""
    rng, added, own = np.random.default_rng(5), 0.0, 0.0
    for _ in range(20):
        uv = rng.uniform((0, 0), (RIG.width, RIG.height), (500, 2))
        slope = rng.normal(0, 1, (500, 3, 6))
        added += np.trace(shared_information(uv, RIG.width, rng.normal(0, 1, (500, 3)), slope))
        own += (slope**2).sum()
    assert added < 0.25 * own


def test_the_covariance_grows_by_what_cells_of_the_image_have_in_common():
    """Of cells of an error each, the variance is found, and each cell counts once, not each of its points."""
    rng, cells, each = np.random.default_rng(6), 8, 30
    u, v, _ = np.indices((cells, cells, each)).reshape(3, -1)
    uv = (np.column_stack([u, v]) + rng.uniform(0, 1, (len(u), 2))) * 640 / cells
    slope = np.zeros((len(u), 3, 6))
    slope[:, 1, 4] = 1.0
    expected = cells**2 * each**2 * 0.5
    found = []
    for _ in range(40):
        own = rng.normal(0, np.sqrt(0.5), (cells, cells))[u, v]
        residual = np.zeros((len(u), 3))
        residual[:, 1] = own + rng.normal(0, 1, len(u))
        found.append(shared_information(uv, 640, residual, slope))
    assert 0.8 < np.mean(found, axis=0)[4, 4] / expected < 1.5
    assert not np.delete(np.array(found), 4, axis=1).any()


def test_what_is_shared_is_nothing_where_nothing_is_measured():
    empty = shared_information(np.empty((0, 2)), 640, np.empty((0, 3)), np.empty((0, 3, 6)))
    assert not empty.any()
    outside = np.array([[-0.4, -0.2], [639.4, 479.4]])  # a point may lie half a pixel outside
    assert np.isfinite(shared_information(outside, 640, np.ones((2, 3)), np.ones((2, 3, 6)))).all()


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(2)
    uv = rng.uniform((20, 20), (490, 360), (200, 2))
    xyz = back_project(RIG, uv, rng.uniform(4, 25, 200))
    disparity = RIG.fx * RIG.baseline / xyz[:, 2] + rng.normal(0, SIGMA, 200)
    seen = PoseEstimate(np.eye(4), np.arange(200), uv + rng.normal(0, SIGMA, uv.shape), np.full(200, np.nan), np.eye(6))
    return xyz, refine_pose(RIG, seen, xyz, disparity, SIGMA, TrackingSettings())


def covariance_of(xyz, found, pull=0.0):
    count = len(found)
    ones = np.ones(count, np.int64)
    sources = Sources(inverse(AHEAD), np.full((count, 3), pull), ones, SIGMA, SIGMA * ones, 1e-9)
    return pose_covariance(RIG, found, xyz, sources)


def test_outliers_and_a_wide_spread_of_the_inliers_widen_the_covariance(fitted):
    xyz, found = fitted
    plain = covariance_of(xyz, found)
    half = covariance_of(xyz, replace(found, found=2 * len(found)))
    assert 1.5 < np.trace(half) / np.trace(plain) <= 2
    rng = np.random.default_rng(3)
    wide = covariance_of(xyz, replace(found, uv=found.uv + rng.normal(0, 2 * SIGMA, found.uv.shape)))
    assert np.trace(wide) > 1.2 * np.trace(plain)
    assert np.trace(covariance_of(xyz, found, pull=1.0)) > np.trace(plain)
    assert (np.linalg.eigvalsh(plain) > 0).all()


def test_the_adjoint_takes_small_motions_from_frame_to_frame():
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix(), (1, -2, 3)
    small = np.eye(4)
    xi = 1e-6 * np.array([1.0, -2, 3, 2, 1, -1])
    small[:3, :3], small[:3, 3] = Rotation.from_rotvec(xi[:3]).as_matrix(), xi[3:]
    np.testing.assert_allclose(twist(T @ small @ inverse(T)), adjoint(T) @ xi, atol=1e-10)


NOISE = synthetic.Faults(noise=0.01, blur=0.5)
WORLDS = {
    "street": lambda: synthetic.street(14.0, seed=1),
    "fast street": lambda: synthetic.street(30.0, step=2.5, seed=3),
    "corridor": lambda: synthetic.corridor(7.0, seed=1),
    "room": lambda: synthetic.room(laps=0.35, frames=40, seed=1),
}


@pytest.fixture(scope="module", params=WORLDS)
def driven(request):
    """An odometry, the truth, and for each frame the error against the keyframe before it, and its covariance."""
    sequence = synthetic.SyntheticSequence(WORLDS[request.param](), RIG, NOISE)
    odometry, errors, covariances = StereoOdometry(RIG, detector=DETECTOR), [], []
    for k in range(len(sequence)):
        before = odometry.map.keyframes[-1].index if k else 0
        tracked = odometry.process(sequence[k])
        if k:
            keyframe = next(frame for frame in odometry.map.keyframes if frame.index == before)
            true = inverse(sequence.truth[before]) @ sequence.truth[k]
            errors.append(twist(inverse(true) @ inverse(keyframe.T_world_camera) @ tracked.T_world_camera))
            covariances.append(tracked.covariance)
    return odometry, sequence.truth, errors, covariances


def test_the_covariance_of_a_frame_is_that_of_its_error_against_the_last_keyframe(driven):
    """Asked for: 0.5 to 2. Measured 0.7 to 1.7 over ten longer worlds, where 1.5 to 11 were said without depths and offset.

    Here a dozen frames that share keyframes: wider limits.
    """
    _, _, errors, covariances = driven
    assert 0.3 < normalised_error(errors, covariances) < 3


def test_the_covariance_from_the_start_is_that_of_the_path(driven):
    """Measured 0.4 to 1.9 over ten longer worlds."""
    odometry, truth, _, _ = driven
    path, frames = odometry.trajectory.T_world_camera, range(1, len(truth))
    errors = [twist(inverse(inverse(truth[0]) @ truth[k]) @ path[k]) for k in frames]
    covariances = [odometry.covariance_from_start(k) for k in frames]
    assert 0.1 < normalised_error(errors, covariances) < 4
    sizes = [np.trace(C[3:, 3:]) for C in covariances]
    assert sizes[-1] > sizes[0]
    assert not odometry.covariance_from_start(0).any()
    for frame in (-1, len(truth), 0.5, None):
        with pytest.raises(InputError, match=f"frame is {frame}, expected one of 0 to {len(truth) - 1}"):
            odometry.covariance_from_start(frame)


def test_a_restored_odometry_knows_its_covariances():
    pairs = list(synthetic.SyntheticSequence(synthetic.corridor(2.0), RIG, NOISE))
    odometry, again = (StereoOdometry(RIG, detector=DETECTOR) for _ in range(2))
    for pair in pairs:
        odometry.process(pair)
    black = replace(pairs[-1], left=0 * pairs[-1].left, right=0 * pairs[-1].right, stamp=9.0)
    assert np.isinf(odometry.process(black).covariance).all()
    again.restore(odometry.state(), lambda number: pairs[number].left)
    for frame in (3, 5):
        assert np.array_equal(again.covariance_from_start(frame), odometry.covariance_from_start(frame))
    assert again.path.unplaced == odometry.path.unplaced == 0
    assert again.path.lost == 1
