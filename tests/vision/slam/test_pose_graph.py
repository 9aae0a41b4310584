"""Pose graphs: exact edges give exact poses, information is respected, what is not fixed is told."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam.errors import GeometryError, InputError
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.least_squares.pose_graph import PoseEdges, marginal_covariance, optimise_poses


def ring(count=30, seed=0):
    """True poses on a circle of 10 m, each turned by something."""
    rng, angle = np.random.default_rng(seed), np.linspace(0, 2 * np.pi, count, endpoint=False)
    T = np.tile(np.eye(4), (count, 1, 1))
    turns = np.column_stack([0 * angle, angle, 0 * angle]) + rng.normal(0, 0.2, (count, 3))
    T[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    T[:, :3, 3] = 10 * np.column_stack([np.cos(angle), 0.1 * rng.normal(size=count), np.sin(angle)])
    T = inverse(T[0]) @ T
    T[0] = np.eye(4)
    return T


def edges_of(T, i, j, information=None):
    information = np.tile(np.eye(6), (len(i), 1, 1)) if information is None else information
    return PoseEdges(i, j, inverse(T[i]) @ T[j], information)


def chords(count, seed=1):
    """Each pose with the next, the last with the first, and some across."""
    rng = np.random.default_rng(seed)
    i = np.concatenate([np.arange(count), rng.integers(0, count // 2, 5)])
    j = np.concatenate([(np.arange(count) + 1) % count, rng.integers(count // 2, count, 5)])
    return i, j


def moved(T, turn, shift, seed=2):
    """Poses off by up to so much, but the first."""
    rng, off = np.random.default_rng(seed), T.copy()
    off[1:, :3, :3] = off[1:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, turn, (len(T) - 1, 3))).as_matrix()
    off[1:, :3, 3] += rng.normal(0, shift, (len(T) - 1, 3))
    return off


def random_information(count, seed=3):
    A = np.random.default_rng(seed).normal(size=(count, 6, 6))
    return A @ np.swapaxes(A, 1, 2) + np.eye(6)


@pytest.mark.parametrize("huber", [np.inf, 1.0])
def test_exact_edges_give_the_exact_poses(huber):
    T = ring()
    edges = edges_of(T, *chords(30), random_information(35))
    found = optimise_poses(moved(T, 0.1, 0.5), edges, huber=huber)
    np.testing.assert_allclose(found.T_world, T, rtol=0, atol=1e-9)
    assert found.cost < 1e-15 < found.cost_before
    assert found.distance.max() < 1e-8


def test_edges_of_half_a_turn_are_met():
    T = np.tile(np.eye(4), (4, 1, 1))
    T[1:, :3, :3] = Rotation.from_euler("xyz", np.pi * np.eye(3)).as_matrix()
    edges = edges_of(T, np.array([0, 0, 0, 1]), np.array([1, 2, 3, 2]))
    found = optimise_poses(moved(T, 0.3, 0.5), edges)
    np.testing.assert_allclose(found.T_world, T, rtol=0, atol=1e-9)


def test_the_optimum_is_that_of_a_plain_solver():
    from scipy.optimize import least_squares

    T, (i, j) = ring(8), chords(8)
    rng, information = np.random.default_rng(5), random_information(len(i))
    edges = edges_of(T, i, j, information)
    noisy = edges.T_ij.copy()
    noisy[:, :3, :3] = noisy[:, :3, :3] @ Rotation.from_rotvec(rng.normal(0, 0.1, (len(i), 3))).as_matrix()
    noisy[:, :3, 3] += rng.normal(0, 0.3, (len(i), 3))
    edges, root = PoseEdges(i, j, noisy, information), np.linalg.cholesky(information)

    def residuals(x):
        poses = T.copy()
        poses[1:, :3, :3] = poses[1:, :3, :3] @ Rotation.from_rotvec(x[:21].reshape(7, 3)).as_matrix()
        poses[1:, :3, 3] += x[21:].reshape(7, 3)
        E = inverse(noisy) @ inverse(poses[i]) @ poses[j]
        r = np.column_stack([Rotation.from_matrix(E[:, :3, :3]).as_rotvec(), E[:, :3, 3]])
        return np.einsum("eba,eb->ea", root, r).ravel()

    theirs = least_squares(residuals, np.zeros(42), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert optimise_poses(T, edges).cost == pytest.approx(2 * theirs.cost, rel=1e-5)


def test_the_error_goes_where_information_is_least():
    """A loop of 1 m in a row of four steps: each takes its variance's share of it, in closed form."""
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 0, 3] = np.arange(5)
    i, j, variance = np.array([0, 1, 2, 3, 0]), np.array([1, 2, 3, 4, 4]), np.array([1.0, 4.0, 0.25, 1.0, 0.5])
    edges = edges_of(T, i, j, np.eye(6) / variance[:, None, None])
    edges.T_ij[4, 0, 3] = 5.0
    found = optimise_poses(T, edges)
    taken = np.diff(found.T_world[:, 0, 3]) - 1
    np.testing.assert_allclose(taken, variance[:4] / variance.sum(), atol=1e-9)
    assert found.cost == pytest.approx(1 / variance.sum())


def test_the_whole_graph_may_lie_anywhere():
    T, edges = ring(), edges_of(ring(), *chords(30), random_information(35))
    edges.T_ij[::7, :3, 3] += 0.1
    elsewhere = np.eye(4)
    elsewhere[:3, :3], elsewhere[:3, 3] = Rotation.from_rotvec([0.3, -1, 2]).as_matrix(), (5, -40, 3)
    here, there = optimise_poses(T, edges), optimise_poses(elsewhere @ T, edges)
    np.testing.assert_allclose(there.T_world, elsewhere @ here.T_world, atol=1e-5)
    assert there.cost == pytest.approx(here.cost, rel=1e-6)


def test_fixed_poses_stay_to_the_bit_and_the_cost_never_rises():
    T, (i, j) = ring(), chords(30)
    start, fixed = moved(T, 0.5, 3.0), np.arange(30) % 10 == 4
    edges = edges_of(T, i, j)
    costs = [optimise_poses(start, edges, fixed=fixed, max_steps=n).cost for n in range(12)]
    assert (np.diff(costs) <= 0).all()
    found = optimise_poses(start, edges, fixed=fixed)
    assert np.array_equal(found.T_world[fixed], start[fixed])
    assert found.cost < costs[0]


def test_a_false_edge_hardly_counts_beyond_the_bend_of_hubers_cost():
    T, (i, j) = ring(), chords(30)
    edges = edges_of(T, i, j, np.tile(np.diag([1e6] * 3 + [100.0] * 3), (35, 1, 1)))
    edges.T_ij[-1, :3, 3] += 20
    off = [np.abs(optimise_poses(T, edges, huber=h).T_world - T).max() for h in (0.1, np.inf)]
    assert off[0] < 0.05 * off[1]


def test_several_edges_of_one_pair_add_up_and_edges_may_go_back():
    T = ring(6)
    i, j = np.array([0, 1, 2, 3, 4, 5, 3, 2]), np.array([1, 2, 3, 4, 5, 0, 2, 3])
    found = optimise_poses(moved(T, 0.1, 0.3), edges_of(T, i, j))
    np.testing.assert_allclose(found.T_world, T, atol=1e-9)


def test_a_pose_that_hangs_on_nothing_is_told():
    T, (i, j) = ring(), chords(30)
    kept = (i != 7) & (j != 7)
    with pytest.raises(GeometryError, match="pose 7 hangs on no fixed pose"):
        optimise_poses(T, edges_of(T, i[kept], j[kept]))
    with pytest.raises(GeometryError, match="pose 0 hangs on no fixed pose"):
        optimise_poses(T, edges_of(T, i, j), fixed=np.zeros(30, bool))


def test_edges_that_leave_a_direction_open_are_told():
    T = ring(3)
    flat = np.diag([1.0, 1, 1, 1, 1, 0])
    information = np.stack([np.eye(6), flat * 0])
    with pytest.raises(GeometryError, match="pose graph: the equations have no solution"):
        optimise_poses(moved(T, 0.1, 0.1), edges_of(T, np.array([0, 1]), np.array([1, 2]), information))
    # A direction that no residual depends on stays where it is, or is told: which, rounding decides. Nothing is NaN.
    open_too = np.stack([np.eye(6), np.diag([1.0, 1, 1, 1, 0, 0])])
    try:
        half = optimise_poses(moved(T, 0.0, 0.1), edges_of(T, np.array([0, 1]), np.array([1, 2]), open_too))
    except GeometryError:
        return
    assert np.isfinite(half.T_world).all()
    assert half.cost < half.cost_before


def changed(**values):
    edges = edges_of(ring(6), np.arange(5), np.arange(1, 6))
    return PoseEdges(**{**vars(edges), **values})


BAD = {
    "shapes are": lambda: optimise_poses(ring(6), changed(i=np.arange(4))),
    "shapes are .*, expected": lambda: optimise_poses(np.eye(4), changed()),
    "j is int64 up to 9": lambda: optimise_poses(ring(6), changed(j=np.arange(5, 10))),
    "edge 2 joins pose 3 to itself": lambda: optimise_poses(ring(6), changed(i=np.array([0, 1, 3, 3, 4]))),
    "i is float64": lambda: optimise_poses(ring(6), changed(i=np.arange(5.0))),
    "no rigid motion": lambda: optimise_poses(2 * ring(6), changed()),
    "an edge is no rigid motion": lambda: optimise_poses(ring(6), changed(T_ij=np.full((5, 4, 4), np.nan))),
    "not symmetric or negative": lambda: optimise_poses(ring(6), changed(information=np.tile(-np.eye(6), (5, 1, 1)))),
    "expected an inverse": lambda: optimise_poses(ring(6), changed(information=np.tile(np.tri(6), (5, 1, 1)))),
    "fixed is int64": lambda: optimise_poses(ring(6), changed(), fixed=np.zeros(6, int)),
    "huber, max_steps are 0": lambda: optimise_poses(ring(6), changed(), huber=0),
}


@pytest.mark.parametrize("said", BAD)
def test_bad_input_gets_one_line(said):
    with pytest.raises(InputError, match=said):
        BAD[said]()


def sparse_blocks(n, links, seed=0):
    """Positive equations of 6 x 6 blocks in a random pattern."""
    rng = np.random.default_rng(seed)
    A = np.zeros((6 * n, 6 * n))
    for a, b in rng.integers(0, n, (links, 2)):
        J = np.zeros((6, 6 * n))
        J[:, 6 * a : 6 * a + 6], J[:, 6 * b : 6 * b + 6] = rng.normal(size=(2, 6, 6))
        A += J.T @ J
    return A + np.eye(6 * n), rng.normal(size=(n, 6))


@pytest.mark.parametrize(("n", "links"), [(1, 1), (2, 1), (12, 20), (40, 60)])
def test_the_factor_of_blocks_solves_the_equations(n, links):
    from tspslam.vision.slam.least_squares._block_cholesky import factor_blocks, factor_pattern, solve_blocks

    A, b = sparse_blocks(n, links)
    blocks = A.reshape(n, 6, n, 6).transpose(0, 2, 1, 3)
    high, low = np.nonzero(np.tril(np.abs(blocks).max(axis=(2, 3)) > 0, -1))
    first = np.searchsorted(high, np.arange(n + 1))
    start, row = factor_pattern(n, first, low)
    for j in range(n):
        assert (np.diff(row[start[j] : start[j + 1]]) > 0).all()
        assert row[start[j]] == j
    L = np.zeros((len(row), 6, 6))
    place = [start[j] + row[start[j] : start[j + 1]].tolist().index(i) for i, j in zip(high, low, strict=True)]
    L[place], L[start[:-1]] = blocks[high, low], blocks[np.arange(n), np.arange(n)]
    x = b.copy()
    assert factor_blocks(start, row, L)
    solve_blocks(start, row, L, x)
    np.testing.assert_allclose(x.ravel(), np.linalg.solve(A, b.ravel()), rtol=1e-8, atol=1e-9)
    L[:] = 0
    assert not factor_blocks(start, row, L)


def test_the_covariance_of_a_pose_is_its_block_of_the_inverse_equations():
    """NumPy's truth: residuals differentiated by differences, all equations inverted at once."""
    count, step = 8, 1e-6
    T, (i, j) = ring(count), chords(count)
    edges = edges_of(T, i, j, random_information(len(i)))

    def residuals(x):
        off = T.copy()
        off[:, :3, :3] = T[:, :3, :3] @ Rotation.from_rotvec(x[:, :3]).as_matrix()
        off[:, :3, 3] += (T[:, :3, :3] @ x[:, 3:, None])[..., 0]
        D = inverse(edges.T_ij) @ inverse(off[i]) @ off[j]
        return np.concatenate([Rotation.from_matrix(D[:, :3, :3]).as_rotvec(), D[:, :3, 3]], axis=1)

    columns = [(residuals(d.reshape(count, 6)) - residuals(-d.reshape(count, 6))) / (2 * step)
               for d in step * np.eye(6 * count)[6:]]  # fmt: skip
    J = np.stack(columns, axis=-1)
    C = np.linalg.inv(np.einsum("eai,eab,ebj->ij", J, edges.information, J))
    for place in range(1, count):
        rows = slice(6 * place - 6, 6 * place)
        np.testing.assert_allclose(marginal_covariance(T, edges, place), C[rows, rows], atol=1e-6)
    assert not marginal_covariance(T, edges, 0).any()


def test_a_covariance_needs_edges_that_fix_the_pose():
    T = ring(3)
    with pytest.raises(GeometryError, match="hangs on no fixed pose"):
        marginal_covariance(T, edges_of(T, np.array([0]), np.array([1])), 1)
    loose = edges_of(T, np.array([0, 1]), np.array([1, 2]), np.zeros((2, 6, 6)))
    with pytest.raises(GeometryError, match="the equations have no solution"):
        marginal_covariance(T, loose, 1)
