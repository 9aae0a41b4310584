"""Pose graphs with loops that come with GTSAM: our optimum is its."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam.vision.slam.least_squares.pose_graph import PoseEdges, optimise_poses

gtsam = pytest.importorskip("gtsam")
DATA = Path(gtsam.__file__).parent / "Data"


def read(name, key, parse):
    """Edges of a text file, a line each."""
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"this gtsam has no {name}")
    lines = (line.split() for line in path.read_text().splitlines())
    i, j, T_ij, information = zip(*(parse(words) for words in lines if words and words[0] == key), strict=True)
    return PoseEdges(np.array(i), np.array(j), np.array(T_ij), np.array(information))


def sphere(words):
    """``EDGE3 i j x y z roll pitch yaw`` and the upper half of the information, the translation first."""
    values, T, upper = np.array(words[3:], float), np.eye(4), np.zeros((6, 6))
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", values[3:6]).as_matrix(), values[:3]
    upper[np.triu_indices(6)] = values[6:]
    order = [3, 4, 5, 0, 1, 2]
    return int(words[1]), int(words[2]), T, (upper + np.triu(upper, 1).T)[np.ix_(order, order)]


def city(words):
    """``EDGE2 i _ j _ count x y angle ...`` in a plane, of which the first hypothesis counts; the rest of the motion is tight."""
    x, y, angle = map(float, words[6:9])
    T = np.eye(4)
    T[:3, :3], T[:2, 3] = Rotation.from_euler("z", angle).as_matrix(), (x, y)
    return int(words[1]), int(words[3]), T, np.diag([1e4, 1e4, 1e4, 900.0, 900.0, 900.0])


def chained(edges):
    """Poses from the edges that join each to the next."""
    T = np.tile(np.eye(4), (max(edges.i.max(), edges.j.max()) + 1, 1, 1))
    for i, j, T_ij in zip(edges.i, edges.j, edges.T_ij, strict=True):
        if j == i + 1:
            T[j] = T[i] @ T_ij
    return T


def graph_of(edges, T):
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i, j, T_ij, information in zip(edges.i.tolist(), edges.j.tolist(), edges.T_ij, edges.information, strict=True):
        model = gtsam.noiseModel.Gaussian.Information(information)
        graph.add(gtsam.BetweenFactorPose3(i, j, gtsam.Pose3(T_ij), model))
    graph.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(T[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
    for k, pose in enumerate(T):
        values.insert(k, gtsam.Pose3(pose))
    return graph, values


GRAPHS = {
    "sphere2500": ("sphere2500.txt", "EDGE3", sphere, 2500),
    "city10000": ("T1_city10000_04.txt", "EDGE2", city, 10000),
}


@pytest.mark.parametrize("name", GRAPHS)
def test_the_optimum_is_gtsams(name):
    """Measured: costs equal to 1e-6 by either cost; translations of residuals are measured a little differently."""
    *given, count = GRAPHS[name]
    edges = read(*given)
    start = chained(edges)
    assert len(start) == count
    ours = optimise_poses(start, edges)
    graph, values = graph_of(edges, start)
    settings = gtsam.LevenbergMarquardtParams()
    settings.setRelativeErrorTol(1e-6)
    theirs = gtsam.LevenbergMarquardtOptimizer(graph, values, settings).optimize()
    there = np.array([theirs.atPose3(k).matrix() for k in range(count)])
    assert ours.cost < 1.01 * optimise_poses(there, edges, max_steps=0).cost
    found = gtsam.Values()
    for k, pose in enumerate(ours.T_world):
        found.insert(k, gtsam.Pose3(pose))
    assert graph.error(found) < 1.01 * graph.error(theirs)
