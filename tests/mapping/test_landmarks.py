"""Observations of one landmark become one, and landmarks are where their observations say."""

import numpy as np
import pytest

from tspslam.errors import GeometryError
from tspslam.mapping._tracks import unite
from tspslam.mapping.landmarks import (
    Landmarks,
    depth_sigmas,
    join_observations,
    measure_covariances,
    place_landmarks,
)
from tspslam.mapping.settings import ObservationSettings
from tspslam.mapping.views import NOTHING, Sightings, to_camera
from tspslam.vision.rig import project

from .worlds import RIG, looking, sightings, wall

SETTINGS = ObservationSettings()
POSES = looking([(0, 0, 0), (0.5, 0.1, 0), (-0.4, -0.2, 0.3), (0.2, 0.5, 0.6), (-0.1, -0.5, -0.2)])


def rows(*given):
    """Sightings of (landmark, keyframe, u, v, disparity)."""
    columns = np.array(given, float).reshape(-1, 5)
    return Sightings(*columns[:, :2].T.astype(int), columns[:, 2:4], columns[:, 4])


def pairs(seen):
    return list(zip(seen.landmark.tolist(), seen.keyframe.tolist(), strict=True))


def by_landmark(seen):
    return seen.take(np.lexsort((seen.keyframe, seen.landmark)))


def some_points(count=20, seed=0):
    return np.random.default_rng(seed).uniform((-0.8, -0.6, 3.5), (0.8, 0.6, 5), (count, 3))


def place(seen, xyz, poses=POSES, settings=SETTINGS):
    return place_landmarks(RIG, poses, 7 + 3 * np.arange(len(xyz)), xyz, by_landmark(seen), settings)


KNOWN = rows((0, 0, 50, 50, 9), (1, 0, 90, 30, 7), (2, 1, 61, 41, 9), (3, 1, 20, 80, 5))


def test_two_landmarks_in_one_place_at_one_depth_are_the_first():
    joined = join_observations(KNOWN, rows((0, 1, 61.5, 41, 9.2)), 4, 2, SETTINGS)
    assert pairs(joined) == [(0, 0), (0, 1), (1, 0), (3, 1)]
    assert joined.uv[1].tolist() == [61, 41]  # as the path had it
    assert joined.disparity.tolist() == [9, 9, 7, 5]


def test_the_first_row_stands_whichever_was_found():
    found = rows((2, 0, 50.5, 50, 9))
    assert pairs(join_observations(KNOWN, found, 4, 2, SETTINGS)) == [(0, 0), (0, 1), (1, 0), (3, 1)]


@pytest.mark.parametrize("disparity", [11, 7, np.nan])
def test_two_landmarks_in_one_pixel_at_different_depths_stay_two(disparity):
    joined = join_observations(KNOWN, rows((0, 1, 61, 41, disparity)), 4, 2, SETTINGS)
    assert pairs(joined) == pairs(by_landmark(KNOWN))


def test_what_is_found_where_nothing_is_known_is_a_bearing():
    joined = join_observations(KNOWN, rows((0, 1, 120, 90, 9)), 4, 2, SETTINGS)
    assert pairs(joined) == [(0, 0), (0, 1), (1, 0), (2, 1), (3, 1)]
    assert np.isnan(joined.disparity[1])
    assert joined.uv[1].tolist() == [120, 90]


def test_a_keyframe_sees_a_landmark_once_and_by_its_disparity():
    known = rows((0, 0, 50, 50, 9), (1, 0, 51, 50, np.nan), (0, 1, 60, 40, 9), (1, 2, 70, 70, 8))
    joined = join_observations(known, rows((0, 2, 70.1, 70, 8)), 2, 3, SETTINGS)
    assert pairs(joined) == [(0, 0), (0, 1), (0, 2)]
    assert joined.disparity.tolist() == [9, 9, 8]


def test_landmarks_that_a_keyframe_sees_apart_stay_two():
    known = rows((0, 0, 50, 50, 9), (1, 0, 54, 50, 9), (1, 1, 61, 41, 9))
    joined = join_observations(known, rows((0, 1, 61, 41, 9)), 2, 2, SETTINGS)
    assert pairs(joined) == [(0, 0), (1, 0), (1, 1)]


def test_to_join_nothing_sorts():
    assert pairs(join_observations(KNOWN, NOTHING, 4, 2, SETTINGS)) == sorted(pairs(KNOWN))
    assert pairs(join_observations(NOTHING, KNOWN, 4, 2, SETTINGS)) == sorted(pairs(KNOWN))
    assert pairs(join_observations(NOTHING, NOTHING, 4, 2, SETTINGS)) == []


def test_a_keyframe_that_goes_takes_its_own_sightings_along_and_no_others():
    known = wall().known()
    joined = join_observations(known, NOTHING, 150, 7, SETTINGS)
    for k in range(7):
        fewer = join_observations(known.take(known.keyframe != k), NOTHING, 150, 7, SETTINGS)
        assert all(map(np.array_equal, fewer, joined.take(joined.keyframe != k)))


def test_pairs_unite_in_chains_unless_a_keyframe_sees_both_apart():
    # landmarks 0 to 4; keyframe 9 sees 1 and 3 apart, keyframe 8 sees 2 and 4 in one place
    start = np.array([0, 1, 2, 4, 5, 6])
    keyframe = np.array([1, 9, 2, 8, 9, 8])
    uv = np.array([[0, 0], [10, 10], [0, 0], [30, 30], [20, 10], [30.5, 30.5]])
    given = start, keyframe, uv, 1.5
    assert unite(np.array([[4, 2], [2, 1], [1, 0]]), *given).tolist() == [0, 0, 0, 3, 0]
    assert unite(np.array([[3, 1], [1, 3]]), *given).tolist() == [0, 1, 2, 3, 4]
    assert unite(np.array([[3, 2], [2, 1]]), *given).tolist() == [0, 1, 2, 2, 4]  # 3 came with 2, and 1 stays out
    assert unite(np.empty((0, 2), int), *given).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("seed", range(4))
def test_united_landmarks_are_never_apart_in_a_keyframe(seed):
    rng = np.random.default_rng(seed)
    sees = rng.random((30, 8)) < 0.3
    landmark, keyframe = np.nonzero(sees)
    uv = rng.integers(0, 3, (len(landmark), 2)).astype(float)
    one = unite(rng.integers(0, 30, (60, 2)), np.searchsorted(landmark, np.arange(31)), keyframe, uv, 1.5)
    assert np.array_equal(one[one], one)
    assert (one <= np.arange(30)).all()
    assert len(np.unique(one)) < 30
    for i, j in np.argwhere((one[landmark][:, None] == one[landmark]) & (keyframe[:, None] == keyframe)):
        assert np.linalg.norm(uv[i] - uv[j]) <= 1.5


@pytest.mark.parametrize("bearings", [False, True])
def test_exact_observations_give_exact_places(bearings):
    xyz = some_points()
    seen = sightings(RIG, POSES, xyz)
    if bearings:
        seen = seen._replace(disparity=np.where(seen.keyframe > 0, np.nan, seen.disparity))
    off = np.random.default_rng(1).normal(0, 0.05, xyz.shape)
    found = place(seen, xyz + off)
    assert found.xyz == pytest.approx(xyz, abs=1e-6)
    assert found.id.tolist() == (7 + 3 * np.arange(20)).tolist()
    assert len(found.seen.landmark) == len(seen.landmark)


@pytest.mark.parametrize(("axis", "off"), [("uv", 30.0), ("disparity", 9.0)])
def test_one_wild_observation_among_five_is_dropped(axis, off):
    xyz = some_points()
    seen = by_landmark(sightings(RIG, POSES, xyz))
    wild = np.flatnonzero((seen.landmark == 4) & (seen.keyframe == 2))
    getattr(seen, axis)[wild] += off
    found = place(seen, xyz)
    assert pairs(found.seen) == [pair for pair in pairs(seen) if pair != (4, 2)]
    assert found.xyz == pytest.approx(xyz, abs=1e-6)


def test_a_keyframe_with_a_wild_pose_loses_its_observations_and_the_others_stay():
    xyz = some_points(40)
    seen = sightings(RIG, POSES, xyz)
    poses = POSES.copy()
    poses[3, :3, 3] += (1.0, 0.4, -0.5)
    found = place(seen, xyz, poses)
    assert pairs(found.seen) == [pair for pair in pairs(by_landmark(seen)) if pair[1] != 3]
    assert found.xyz == pytest.approx(xyz, abs=1e-3)


def test_landmarks_of_one_keyframe_go_and_the_others_keep_their_numbers():
    xyz = some_points(6)
    seen = sightings(RIG, POSES, xyz)
    seen = seen.take((seen.landmark != 2) | (seen.keyframe == 1))
    found = place(seen, xyz)
    assert found.id.tolist() == [7, 10, 16, 19, 22]
    assert np.array_equal(np.unique(found.seen.landmark), np.arange(5))
    assert len(place(NOTHING, xyz).id) == 0


def covariance_of(poses, xyz, seen):
    given = Landmarks(np.arange(len(xyz)), xyz, by_landmark(seen))
    return measure_covariances(RIG, poses, given, SETTINGS)[1]


def residuals(poses, x, seen):
    """What exact observations of a point differ by, were it at x: standard deviations."""
    off = []
    for k, uv, disparity in zip(seen.keyframe, seen.uv, seen.disparity, strict=True):
        local = to_camera(x[None], poses[k])
        off.append((project(RIG, local)[0] - uv) / SETTINGS.sigma_uv)
        if not np.isnan(disparity):
            off.append([(RIG.fx * RIG.baseline / local[0, 2] - RIG.doffs - disparity) / SETTINGS.sigma_disparity])
    return np.concatenate(off)


@pytest.mark.parametrize("bearings", [False, True])
def test_covariance_is_the_inverse_of_the_numerical_hessian(bearings):
    xyz = some_points(5)
    seen = sightings(RIG, POSES, xyz)
    if bearings:
        seen = seen._replace(disparity=np.full(len(seen.disparity), np.nan))
    covariance = covariance_of(POSES, xyz, seen)
    for i, x in enumerate(xyz):
        mine = seen.take(seen.landmark == i)
        step = 1e-4 * np.eye(3)
        J = np.stack([(residuals(POSES, x + h, mine) - residuals(POSES, x - h, mine)) / 2e-4 for h in step], axis=1)
        assert covariance[i] == pytest.approx(np.linalg.inv(J.T @ J), rel=1e-4, abs=1e-9)


def test_covariance_is_that_of_many_draws():
    xyz = np.tile([0.3, -0.2, 4.0], (2000, 1))
    seen = by_landmark(sightings(RIG, POSES, xyz))
    noise = np.random.default_rng(2).normal(size=(len(seen.landmark), 3))
    uv = seen.uv + SETTINGS.sigma_uv * noise[:, :2]
    noisy = seen._replace(uv=uv, disparity=seen.disparity + SETTINGS.sigma_disparity * noise[:, 2])
    told = covariance_of(POSES, xyz[:1], seen.take(seen.landmark == 0))[0]
    drawn = np.cov(place(noisy, xyz).xyz.T)
    assert np.linalg.norm(drawn - told) < 0.1 * np.linalg.norm(told)
    assert np.diag(drawn) == pytest.approx(np.diag(told), rel=0.1)


def test_deviations_along_axes_are_roots_of_the_diagonal():
    covariance = np.diag([1.0, 4, 9])[None]
    assert depth_sigmas(covariance, np.zeros(3, int), np.eye(3)) == pytest.approx([1, 2, 3])


def test_two_bearings_from_one_place_are_no_place():
    xyz = some_points(6)
    poses = POSES.copy()
    poses[1] = poses[0]
    seen = sightings(RIG, poses, xyz)
    blind = (seen.landmark == 3) & (seen.keyframe < 2)
    seen = seen._replace(disparity=np.where(blind, np.nan, seen.disparity)).take((seen.landmark != 3) | blind)
    landmarks = Landmarks(np.arange(6), xyz, by_landmark(seen))
    kept, covariance = measure_covariances(RIG, poses, landmarks, SETTINGS)
    assert kept.id.tolist() == [0, 1, 2, 4, 5]
    assert np.linalg.eigvalsh(covariance).min() > 0
    alone = Landmarks(np.zeros(1, int), xyz[3:4], seen.take(seen.landmark == 3)._replace(landmark=np.zeros(2, int)))
    with pytest.raises(GeometryError, match=r"map: 1 landmarks .* expected some"):
        measure_covariances(RIG, poses, alone, SETTINGS)
