"""The measures of a drive through town give the known answer on paths of a few poses."""

import numpy as np
import pytest

from benchmarks import town_measures as measures
from tspslam.datasets.synthetic import town_path
from tspslam.datasets.synthetic.shapes import pose_at


@pytest.fixture(scope="module")
def drive():
    """Two laps of a frame a metre, ten a second: stamps and poses."""
    path = town_path(2, block=60)
    return np.arange(len(path)) / 10, path


def test_the_second_lap_sees_the_first_again(drive):
    stamps, path = drive
    again = measures.revisits(stamps, path)
    lap = len(path) // 2
    assert set(range(lap + 5, len(path))) <= set(again[:, 0])
    assert (stamps[again[:, 0]] - stamps[again[:, 1]] > measures.SINCE).all()
    away = np.linalg.norm(path[again[:, 0], :3, 3] - path[again[:, 1], :3, 3], axis=1)
    assert away.max() <= measures.NEAR
    assert away[again[:, 0] > lap + 5].max() < 1


def test_a_place_seen_the_other_way_or_soon_after_is_no_revisit():
    there = np.stack([pose_at((0, 0, z), (0, 0, 0)) for z in np.arange(100.0)])
    back = np.stack([pose_at((0, 0, z), (0, np.pi, 0)) for z in np.arange(99.0, -1, -1)])
    path = np.concatenate([there, back])
    assert not len(measures.revisits(np.arange(200.0), path))
    twice = np.concatenate([there, there])
    assert len(measures.revisits(np.arange(200.0), twice)) == 100
    assert not len(measures.revisits(np.arange(200.0) / 10, twice))


def test_errors_between_frames_do_not_depend_on_the_world_and_show_a_shift(drive):
    _, path = drive
    pairs = np.array([[300, 5], [320, 40]])
    moved = pose_at((5, -3, 8), (0.3, 0.2, -1)) @ path
    np.testing.assert_allclose(measures.motion_errors(moved, path, pairs), 0, atol=1e-9)
    moved[310:, :3, 3] += moved[310, :3, 0] * 2
    np.testing.assert_allclose(measures.motion_errors(moved, path, pairs), [0, 2], atol=1e-9)


def test_closures_of_far_places_are_found(drive):
    _, path = drive
    lap = len(path) // 2
    closures = np.array([[lap, 0], [lap + 3, 30], [lap + 20, 20]])
    assert measures.far_closures(closures, path).tolist() == [[lap + 3, 30]]
    assert measures.far_closures(np.zeros((0, 2), np.int64), path).shape == (0, 2)


def test_keyframes_that_share_an_old_landmark_are_tied():
    keyframes, stamps = np.array([0, 10, 400, 500]), np.arange(600) / 10
    seen = [[1, 2], [2, 3], [3, 4], [4, 5]]  # 400 sees landmark 3 again after 39 s, 500 landmark 4 after 10 s
    start = np.cumsum([0, *map(len, seen)])
    assert measures.tied(keyframes, start, np.concatenate(seen), stamps).tolist() == [400]


def test_frames_are_told_as_spans():
    assert measures.runs(np.array([3, 10, 11, 13, 40])) == ["3", "10-13", "40"]
    assert measures.runs(np.array([], np.int64)) == []
