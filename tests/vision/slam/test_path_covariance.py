"""A pose against the first one: steps add up, loops take from it what they know, guesses leave it open."""

import numpy as np
from scipy.spatial.transform import Rotation

from tspslam.vision.se3 import inverse
from tspslam.vision.slam.least_squares.pose_graph import PoseEdges, optimise_poses
from tspslam.vision.slam.locating.path_covariance import Links, covariance_from_start
from tspslam.vision.slam.locating.uncertainty import adjoint

COUNT, DRAWS = 12, 60


def circle():
    """Poses once around."""
    angle, T = 2 * np.pi * np.arange(COUNT) / COUNT, np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(angle, (0, 1, 0))).as_matrix()
    T[:, :3, 3] = 5 * np.column_stack([np.cos(angle), 0 * angle, -np.sin(angle)])
    return T


def steps(covariance):
    """Each frame against the one before, frame 5 against frame 3."""
    against = np.maximum(np.arange(COUNT) - 1, 0)
    against[5] = 3
    return Links(np.arange(COUNT), against, covariance)


def some_covariances(count, seed=0):
    A = np.random.default_rng(seed).normal(0, (3e-3,) * 3 + (0.03,) * 3, (count, 6, 6))
    return np.swapaxes(A, 1, 2) @ A


def test_without_loops_it_is_the_sum_of_the_steps():
    T, own = circle(), some_covariances(COUNT)
    for frame, way in ((1, [1]), (4, [1, 2, 3, 4]), (6, [1, 2, 3, 5, 6])):
        turned = [adjoint(inverse(T[frame]) @ T[k]) for k in way]
        total = sum(A @ own[k] @ A.T for A, k in zip(turned, way, strict=True))
        np.testing.assert_allclose(covariance_from_start(frame, T, steps(own), Links.of_none()), total, rtol=1e-6)
    assert not covariance_from_start(0, T, steps(own), Links.of_none()).any()


def test_a_loop_tells_of_all_frames_on_its_way_and_of_none_beside_it():
    T, own = circle(), some_covariances(COUNT)
    loop = Links.of_none().and_one(9, 0, some_covariances(1)[0])
    for frame in (2, 9, 11):
        plain, closed = (covariance_from_start(frame, T, steps(own), each) for each in (Links.of_none(), loop))
        assert (np.linalg.eigvalsh(plain - closed) > -1e-9 * np.trace(plain)).all()
        assert np.trace(closed) < 0.95 * np.trace(plain)
    beside = Links.of_none().and_one(9, 6, some_covariances(1)[0])
    before = [covariance_from_start(3, T, steps(own), each) for each in (Links.of_none(), beside)]
    np.testing.assert_allclose(before[0], before[1], rtol=1e-6)


def test_it_is_the_spread_of_what_the_graph_of_the_poses_finds():
    """Draws of steps and of the loop: the squared error, in covariances, is 1 for each degree of freedom (to a tenth)."""
    rng, T, own, last = np.random.default_rng(1), circle(), some_covariances(COUNT), COUNT - 1
    loop, way = Links.of_none().and_one(last, 0, some_covariances(1, 5)[0]), steps(own)
    child, parent = np.append(way.frame[1:], last), np.append(way.against[1:], 0)
    covariance = np.concatenate([own[1:], loop.covariance])
    exact, information = inverse(T[parent]) @ T[child], np.linalg.inv(covariance)
    information = (information + np.swapaxes(information, 1, 2)) / 2
    found, squares = {frame: covariance_from_start(frame, T, way, loop) for frame in (4, last)}, []
    for _ in range(DRAWS):
        off = np.stack([rng.multivariate_normal(np.zeros(6), C) for C in covariance])
        noisy = exact.copy()
        noisy[:, :3, :3] = exact[:, :3, :3] @ Rotation.from_rotvec(off[:, :3]).as_matrix()
        noisy[:, :3, 3] += (exact[:, :3, :3] @ off[:, 3:, None])[..., 0]
        ends = optimise_poses(T, PoseEdges(parent, child, noisy, information)).T_world
        for frame, C in found.items():
            D = inverse(T[frame]) @ ends[frame]
            e = np.append(Rotation.from_matrix(D[:3, :3]).as_rotvec(), D[:3, 3])
            squares.append(e @ np.linalg.solve(C, e) / 6)
    assert 0.7 < np.mean(squares) < 1.4


def test_a_guess_leaves_it_open_until_a_loop_leads_back():
    T, own = circle(), some_covariances(COUNT)
    own[7] = np.nan
    for frame, is_known in ((6, True), (7, False), (11, False)):
        found = covariance_from_start(frame, T, steps(own), Links.of_none())
        assert np.isfinite(found).all() == is_known
    back = Links.of_none().and_one(9, 2, some_covariances(1)[0])
    for frame in (7, 8, 9, 11):
        assert np.isfinite(covariance_from_start(frame, T, steps(own), back)).all()
    nothing = Links.of_none().and_one(9, 2, np.full((6, 6), np.nan))
    assert np.isinf(covariance_from_start(11, T, steps(own), nothing)).all()
