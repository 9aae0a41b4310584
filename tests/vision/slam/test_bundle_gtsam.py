"""Bundle adjustment of windows as odometry's finds the optimum that GTSAM finds: same factors, same noise, QR."""

import numpy as np
import pytest

from tests.vision.slam import gtsam_oracle as oracle  # skips all of this where there is no gtsam
from tspslam.vision.slam.least_squares import bundle


@pytest.fixture
def to_the_end(monkeypatch):
    """The search goes on until the cost stands still."""
    monkeypatch.setattr(bundle, "_ENOUGH", 1e-15)


@pytest.fixture(scope="module", params=[0, 1])
def problem(request):
    return oracle.window(seed=request.param)


def test_the_problem_is_of_odometrys_size(problem):
    observations, points = len(problem.seen.pose), len(problem.xyz)
    assert 9_000 < observations < 11_000
    assert 1_500 < points < 3_000
    known = np.bincount(problem.seen.point, np.isfinite(problem.seen.disparity))
    assert (known == 0).any()  # points of which there are bearings only
    assert problem.fixed.sum() == 7


def test_the_cost_is_twice_gtsams(problem):
    graph, start = oracle.graph_of(problem), oracle.start_of(problem)
    assert oracle.adjusted(problem, max_steps=0).cost_before == pytest.approx(2 * graph.error(start), rel=1e-12)


def test_the_optimum_is_gtsams(problem, to_the_end):
    """Measured: costs equal to 1e-14, poses to 1e-9."""
    ours = oracle.adjusted(problem, max_steps=300)
    graph = oracle.graph_of(problem)
    theirs, _ = oracle.solved(graph, oracle.start_of(problem))
    assert ours.cost == pytest.approx(2 * graph.error(theirs), rel=1e-6)
    there = oracle.poses_of(theirs, len(problem.fixed))
    np.testing.assert_allclose(ours.T_world_camera[:, :3, 3], there[:, :3, 3], rtol=0, atol=1e-6)
    turn = np.swapaxes(ours.T_world_camera[:, :3, :3], 1, 2) @ there[:, :3, :3]
    np.testing.assert_allclose(turn - np.eye(3), 0, atol=1e-6)
    assert ours.cost < 0.5 * ours.cost_before


def test_the_usual_end_is_near_the_optimum(problem, monkeypatch):
    """The steps that odometry takes leave the poses within a tenth of a millimetre of the optimum."""
    usual = oracle.adjusted(problem, max_steps=20)
    monkeypatch.setattr(bundle, "_ENOUGH", 1e-15)
    best = oracle.adjusted(problem, max_steps=300)
    assert usual.cost < 1.001 * best.cost
    off = usual.T_world_camera - best.T_world_camera
    assert np.abs(off[:, :3, 3]).max() < 1e-4
