"""Parts of a map that share places become one: on maps without images, with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam import GeometryError
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.back_end import map_joining
from tspslam.vision.slam.back_end.map_joining import join_maps
from tspslam.vision.slam.places.agreement import agreeing
from tspslam.vision.slam.places.settings import LoopSettings
from tspslam.vision.slam.places.shared_places import SharedPlaces

from .loop_maps import NOISE, error, looped, sights

LOOPS = LoopSettings()
HALF = 20  # keyframes of each part
AWAY = np.eye(4)
AWAY[:3, :3] = Rotation.from_rotvec([0.1, 2.0, -0.2]).as_matrix()
AWAY[:3, 3] = 40.0, -3.0, 7.0  # m


def apart(seed=0, parts=2):
    """A drive each part of which, but the first, is in another world, with landmarks of its own. And true poses."""
    world, truth = looped(parts * HALF, seed=seed)
    world.loop = None
    count, xyz = len(world.xyz), world.xyz
    world.xyz = np.concatenate([xyz] * parts)
    world.descriptors = np.zeros((parts * count, 4), np.uint64)
    world.landmark_id, world.next_id = np.arange(parts * count), parts * count
    for part in range(1, parts):
        world.xyz[part * count : (part + 1) * count] = xyz @ AWAY[:3, :3].T + part * AWAY[:3, 3]
        for k in range(part * HALF, (part + 1) * HALF):
            frame, T = world.keyframes[k], AWAY @ world.keyframes[k].T_world_camera
            T[:3, 3] += (part - 1) * AWAY[:3, 3]
            landmark, is_start = frame.landmark + part * count, k == part * HALF
            world.keyframes[k] = replace(frame, T_world_camera=T, landmark=landmark, part=part, is_start=is_start)
    world.note_sightings()
    return world, truth


def shared_of(world, truth, keyframes, place=HALF - 1, seed=1, seen_from=None):
    """Keyframes of one part, as the keyframe `place` of another has them; maybe said to be where others are."""
    rng, found = np.random.default_rng(seed), []
    older = world.keyframes[place]
    to_own = older.T_world_camera @ inverse(truth[place])
    before = world.keyframes[max(0, place - 5) : place + 1]
    for k, at in zip(keyframes, keyframes if seen_from is None else seen_from, strict=True):
        rows = np.unique(np.concatenate([frame.landmark for frame in before]))
        true = (world.xyz[rows] - to_own[:3, 3]) @ to_own[:3, :3]
        seen, uv, _ = sights(rng, truth[at], true)
        ids, number = world.landmark_id[rows[seen]], np.array([world.keyframes[k].index])
        T = (to_own @ truth[at])[None]
        ends = np.array([0, len(ids)])
        found.append(SharedPlaces(number, np.array([older.index]), T, np.array([10.0]), ends, ids, uv))
    return SharedPlaces.joined(found)


def test_parts_are_joined_as_they_stand_and_their_landmarks_become_one():
    world, truth = apart()
    first = [frame.T_world_camera for frame in world.keyframes[:1]]
    before = len(world.landmark_id) - len(world.gaps)
    found = join_maps(world, shared_of(world, truth, [HALF, HALF + 1, HALF + 2]), NOISE, LOOPS)
    assert {frame.part for frame in world.keyframes} == {0}
    assert not any(frame.is_start for frame in world.keyframes)
    assert found.is_join.sum() == 1
    assert np.array_equal(world.keyframes[0].T_world_camera, first[0])
    assert error(world, truth) < 0.4  # m, over 80 m of way, each step of which is off by 0.01
    assert world.landmark_count < before - 50
    assert all(len(np.unique(frame.landmark)) == len(frame.landmark) for frame in world.keyframes)
    assert not np.isin(np.concatenate([frame.landmark for frame in world.keyframes]), world.gaps).any()


def test_parts_that_share_no_place_stay_as_they_are():
    world, _ = apart()
    frames, xyz = list(world.keyframes), world.xyz.copy()
    found = join_maps(world, SharedPlaces.joined([]), NOISE, LOOPS)
    assert len(found.shared) == 0
    assert world.keyframes == frames
    assert np.array_equal(world.xyz, xyz)


def test_one_place_that_is_not_sure_joins_nothing_and_two_that_agree_do():
    world, truth = apart()
    both = shared_of(world, truth, [HALF, HALF + 1])
    assert (both.counts > 10).all()
    settings = replace(LOOPS, sure_landmarks=int(both.counts.max()) + 1)
    assert not agreeing(world, both.chosen(np.array([0])), settings).any()
    assert agreeing(world, both, settings).all()
    assert agreeing(world, both.chosen(np.array([0])), replace(LOOPS, sure_landmarks=4)).all()


@pytest.mark.parametrize("turn", [0.0, 1.0])
def test_a_place_that_does_not_agree_with_the_others_is_not_believed(turn):
    world, truth = apart()
    shared = shared_of(world, truth, range(HALF, HALF + 4))
    off = np.eye(4)
    off[:3, :3] = Rotation.from_rotvec([0, turn, 0]).as_matrix()
    off[:3, 3] = 0 if turn else 6.0  # m, at 10 m of depth
    wrong = shared.T_world_camera.copy()
    wrong[2] = wrong[2] @ off
    assert agreeing(world, replace(shared, T_world_camera=wrong), LOOPS).tolist() == [True, True, False, True]


def test_of_two_sets_of_places_that_contradict_each_other_neither_is_believed():
    world, truth = apart()
    settings = replace(LOOPS, sure_landmarks=10**4)
    shared = shared_of(world, truth, range(HALF, HALF + 5))
    elsewhere = shared.T_world_camera.copy()
    elsewhere[3:, 0, 3] += 20.0
    assert agreeing(world, shared, settings).all()
    assert not agreeing(world, replace(shared, T_world_camera=elsewhere), settings).any()
    lone = shared.chosen(np.arange(4))
    found = agreeing(world, replace(lone, T_world_camera=elsewhere[:4]), settings)  # one alone is a chance match
    assert found.tolist() == [True, True, True, False]


@pytest.mark.parametrize(("ring", "seen_from"), [((58, 59), (58, 59)), ((50, 51), (6, 7))])
def test_what_closes_a_ring_is_believed_only_where_it_agrees_with_what_joins_the_parts(ring, seen_from):
    world, truth = apart(parts=3)
    chain = [shared_of(world, truth, [k, k + 1], place=k - 1) for k in (HALF, 2 * HALF)]
    closing = shared_of(world, truth, ring, place=5, seen_from=seen_from)
    found = join_maps(world, SharedPlaces.joined([*chain, closing]), NOISE, LOOPS)
    assert {frame.part for frame in world.keyframes} == {0}
    assert error(world, truth) < 0.4  # m; bent by what is false, 16
    refused = [] if seen_from == ring else [2 * k for k in ring]
    assert found.refused.keyframe.tolist() == refused
    assert set(found.shared.keyframe.tolist()).isdisjoint(refused)


def test_where_the_graph_has_no_solution_the_parts_are_moved_as_wholes(monkeypatch):
    def fail(*_, **__):
        raise GeometryError("no solution")

    monkeypatch.setattr(map_joining, "optimise_poses", fail)
    world, truth = apart()
    steps = inverse(world.keyframes[HALF].T_world_camera) @ world.keyframes[-1].T_world_camera
    join_maps(world, shared_of(world, truth, [HALF, HALF + 1]), NOISE, LOOPS)
    after = inverse(world.keyframes[HALF].T_world_camera) @ world.keyframes[-1].T_world_camera
    np.testing.assert_allclose(after, steps, atol=1e-9)
    assert {frame.part for frame in world.keyframes} == {0}


def test_chosen_places_keep_their_sights():
    world, truth = apart()
    shared = shared_of(world, truth, range(HALF, HALF + 3))
    turned = shared.chosen(np.array([2, 0]))
    assert turned.keyframe.tolist() == shared.keyframe[[2, 0]].tolist()
    assert np.array_equal(turned.uv[: turned.start[1]], shared.uv[shared.start[2] :])
    assert np.array_equal(turned.landmark_id[turned.start[1] :], shared.landmark_id[: shared.start[1]])
    moved = shared.moved(5, 7, 11)
    assert np.array_equal(moved.keyframe - 5, shared.keyframe)
    assert np.array_equal(moved.place - 7, shared.place)
    assert np.array_equal(moved.landmark_id - 11, shared.landmark_id)
