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
from tspslam.vision.slam.places.shared_places import SharedPlaces, find_candidates

from .loop_maps import NOISE, error, looped, sights

LOOPS = LoopSettings()
HALF = 20  # keyframes of each part
AWAY = np.eye(4)
AWAY[:3, :3] = Rotation.from_rotvec([0.1, 2.0, -0.2]).as_matrix()
AWAY[:3, 3] = 40.0, -3.0, 7.0  # m


def apart(seed=0):
    """A drive whose second half is a part in another world; that half's landmarks are its own. And true poses."""
    world, truth = looped(2 * HALF, seed=seed)
    world.loop = None
    count = len(world.xyz)
    world.xyz = np.concatenate([world.xyz, world.xyz])
    world.descriptors = np.zeros((2 * count, 4), np.uint64)
    world.landmark_id, world.next_id = np.arange(2 * count), 2 * count
    world.xyz[count:] = world.xyz[count:] @ AWAY[:3, :3].T + AWAY[:3, 3]
    for k in range(HALF, 2 * HALF):
        frame = world.keyframes[k]
        T, landmark = AWAY @ frame.T_world_camera, frame.landmark + count
        world.keyframes[k] = replace(frame, T_world_camera=T, landmark=landmark, part=1, is_start=k == HALF)
    world.note_sightings()
    return world, truth


def shared_of(world, truth, keyframes, place=HALF - 1, seed=1):
    """Keyframes of the second part, as the keyframe `place` of the first has them."""
    rng, found = np.random.default_rng(seed), []
    older = world.keyframes[place]
    to_own = older.T_world_camera @ inverse(truth[place])
    for k in keyframes:
        rows = np.unique(np.concatenate([frame.landmark for frame in world.keyframes[HALF - 6 : HALF]]))
        true = (world.xyz[rows] - to_own[:3, 3]) @ to_own[:3, :3]
        seen, uv, _ = sights(rng, truth[k], true)
        ids, number = world.landmark_id[rows[seen]], np.array([world.keyframes[k].index])
        T = (to_own @ truth[k])[None]
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


def test_candidates_are_the_same_pairs_whichever_map_is_asked():
    rng = np.random.default_rng(0)
    maps = []
    for seed in (0, 1):
        world, _ = looped(12, seed=seed)
        world.descriptors = rng.integers(0, 2**63, (len(world.xyz), 4), dtype=np.uint64)
        maps.append(world)
    same = min(map(len, (maps[0].keyframes[3].landmark, maps[1].keyframes[7].landmark)))
    maps[1].descriptors[maps[1].keyframes[7].landmark[:same]] = maps[0].descriptors[
        maps[0].keyframes[3].landmark[:same]
    ]
    there, back = find_candidates(maps[0], maps[1], LOOPS), find_candidates(maps[1], maps[0], LOOPS)
    assert [7, 3] in there.tolist()
    assert [3, 7] in back.tolist()
    assert there[there[:, 0] == 7][0].tolist() == [7, 3]
    assert np.array_equal(there[:, 0], np.sort(there[:, 0]))
