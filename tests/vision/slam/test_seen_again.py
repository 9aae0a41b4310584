"""What a loop, or another map, saw of landmarks is found by what these have become: one law for both."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam.vision.slam.back_end.loop_correction import LoopProblem, close_loop
from tspslam.vision.slam.back_end.seen_again import called_now, join_sights

from .loop_maps import NOISE, looped


@pytest.fixture
def world():
    return looped(60)[0]


def renamed(world):
    """The loop's first landmark becomes another, and that another; its third becomes its second. Rows as they are now."""
    rows = called_now(world, world.loop).landmark
    one, other = (world.keyframes[30].landmark[k : k + 1] for k in (0, 1))
    assert not np.isin([one, other], rows).any()
    for kept, gone in ((one, rows[:1]), (other, one), (rows[1:2], rows[2:3])):
        world.merge_landmarks(kept, gone)
    return np.concatenate([other, rows[1:2], rows[3:]])


def test_landmarks_that_were_merged_are_those_that_they_became(world):
    before = called_now(world, world.loop)
    expected = renamed(world)
    now = called_now(world, world.loop)
    assert now.landmark.tolist() == expected.tolist()
    assert np.array_equal(now.uv, np.delete(before.uv, 2, axis=0))


def test_landmarks_that_nobody_sees_any_more_are_left_out(world):
    before, ids = called_now(world, world.loop).landmark, world.loop.landmark
    assert world.landmark_id[before[0]] == ids[0]
    for gone in (world.next_id + 5, ids[1] - 1):
        changed = replace(world.loop, landmark=np.append(gone, ids[1:]))
        assert called_now(world, changed).landmark.tolist() == before[1:].tolist()


def test_a_loop_whose_landmarks_were_merged_meanwhile_is_seen_by_what_they_became(world):
    first = renamed(world)[0]
    close_loop(world, LoopProblem.of(world, NOISE).solve(), 1.0)
    rows = world.keyframes[-1].landmark
    assert first in rows
    assert len(rows) == len(np.unique(rows))


def test_what_a_keyframe_sees_twice_in_one_place_becomes_one_and_what_it_sees_anyway_is_not_added(world):
    place = len(world.keyframes) - 1
    own, loop = world.keyframes[place], called_now(world, world.loop)
    again = replace(
        loop,
        landmark=np.append(loop.landmark[:2], own.landmark[2]),
        uv=own.uv[:3] + 0.1, disparity=own.disparity[:3].copy(), sigma=own.sigma[:3].copy(),
    )  # fmt: skip
    left, gone = join_sights(world, place, again, 1.0)
    assert left.landmark.tolist() == loop.landmark[:2].tolist()
    assert gone.tolist() == own.landmark[:2].tolist()
    assert np.array_equal(world.keyframes[place].landmark[:3], again.landmark)
    assert join_sights(world, place, again, 1.0)[1].size == 0
