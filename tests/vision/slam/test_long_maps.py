"""What a keyframe costs does not depend on how many there are, and who sees what is known whatever happened to the map."""

import contextlib
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from tspslam.vision.slam._state import map_state
from tspslam.vision.slam.keyframes.columns import Column
from tspslam.vision.slam.keyframes.sightings import Sightings
from tspslam.vision.slam.least_squares.bundle import Adjustment

from .simulated_maps import Drive

LONG, SHORT, MEASURED = 5000, 500, 60  # keyframes


class Work:
    """What each keyframe takes: calls of functions, Python's and NumPy's, and bytes of arrays that are there at a time."""

    def __init__(self):
        self.calls, self.bytes = [], []

    @contextlib.contextmanager
    def __call__(self):
        before, calls = tracemalloc.get_traced_memory()[0], 0

        def count(_frame, event, _argument):
            nonlocal calls
            calls += event in ("call", "c_call")

        tracemalloc.reset_peak()
        sys.setprofile(count)
        try:
            yield
        finally:
            sys.setprofile(None)
        self.calls.append(calls)
        self.bytes.append(tracemalloc.get_traced_memory()[1] - before)


def work_of(drive):
    """Calls and bytes of the next keyframes, in the median and at most, but for arrays that are given more room."""
    drive.measure = work = Work()
    tracemalloc.start()
    drive.go(MEASURED)
    tracemalloc.stop()
    return np.median(work.calls), np.max(work.calls), np.median(work.bytes), np.sort(work.bytes)[-4]


def test_keyframe_five_thousand_costs_what_keyframe_five_hundred_does():
    """Work is counted, not timed: the ratios are 0.9 to 1.2; ``python -m benchmarks.long_maps`` prints times."""
    long, short = Drive(image_bytes=0).go(LONG), Drive(image_bytes=0).go(SHORT)
    costs = np.array([work_of(long), work_of(short)])
    assert len(long.map.keyframes) == LONG + MEASURED
    assert len(long.map.xyz) > 4 * len(short.map.xyz)
    assert (costs[0] < 1.6 * costs[1]).all(), costs


def test_memory_is_that_of_what_keyframes_see_and_of_landmarks():
    """At most half as much again as the numbers take, where room is made ahead."""
    tracemalloc.start()
    drive = Drive(image_bytes=0).go(200)
    before = tracemalloc.get_traced_memory()[0]
    sizes = [(sum(len(frame.landmark) for frame in drive.map.keyframes), len(drive.map.xyz))]
    drive.go(400)
    sizes.append((sum(len(frame.landmark) for frame in drive.map.keyframes), len(drive.map.xyz)))
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    seen, landmarks = np.diff(sizes, axis=0)[0]
    a_sighting, a_landmark, a_keyframe = 48, 68, 2000  # bytes; of the last: four arrays, a pose, a place in lists
    assert grown < 1.5 * (a_sighting * seen + a_landmark * landmarks + a_keyframe * 400) + 300 * 400


def seen_in(world):
    """Pairs of landmark and frame, as the keyframes have them."""
    return {(row, frame.index) for frame in world.keyframes for row in frame.landmark.tolist()}


def noted_in(world):
    rows = np.arange(len(world.xyz))
    at, frame = world._sightings.of(rows)
    pairs = list(zip(rows[at].tolist(), frame.tolist(), strict=True))
    assert len(pairs) == len(set(pairs))
    return set(pairs)


def test_who_sees_what_is_known_whatever_is_culled_merged_and_dropped():
    drive = Drive(40, cull_every=4, min_views=2, redundant_share=0.5)
    rng, world = np.random.default_rng(1), drive.map
    culled = 0
    for _ in range(60):
        before = len(world.keyframes)
        drive.go(2)
        culled += before + 2 - len(world.keyframes)
        merge_some(world, rng)
        adjust_some(world, rng)
        assert noted_in(world) == seen_in(world)
        assert (np.diff(world.landmark_id) > 0).all()
        assert not np.isin(world.gaps, [row for row, _ in seen_in(world)]).any()
    assert culled > 10
    assert len(world.merged) > 100
    rows = world.keyframes[5].landmark
    assert world.seen_by(rows) == [k for k, f in enumerate(world.keyframes) if np.isin(f.landmark, rows).any()]
    shared = [(k, int(np.isin(frame.landmark, rows).sum())) for k, frame in enumerate(world.keyframes)]
    assert world.covisible(5, least=3) == [(k, count) for k, count in shared if k != 5 and count >= 3]
    assert world.covisible(5, least=3)


def merge_some(world, rng):
    """Make a few pairs of landmarks one, some of which one keyframe sees both."""
    rows = np.unique(np.concatenate([frame.landmark for frame in world.keyframes[-4:]]))
    chosen = rng.permutation(rows)[:8].reshape(2, 4)
    world.merge_landmarks(*chosen)


def adjust_some(world, rng):
    """Take over an adjustment of the last keyframes that drops a tenth of what they see."""
    frames = world.keyframes[-5:]
    rows = np.unique(np.concatenate([frame.landmark for frame in frames]))
    found = Adjustment(np.stack([f.T_world_camera for f in frames]), world.xyz[rows], 1.0, 1.0, np.zeros(1), 1)
    kept = {f.index: (k, rng.random(len(f.landmark)) > 0.1) for k, f in enumerate(frames)}
    before = [len(frame.landmark) for frame in frames]
    world.apply(rows, found, kept)
    after = [len(frame.landmark) for frame in world.keyframes[-5:]]
    assert after == [int(part.sum()) for _, part in kept.values()] != before


def test_a_landmark_that_one_keyframe_saw_goes_once_it_left_the_window():
    drive = Drive(cull_every=1).go(40)
    world = drive.map
    views = world.sightings.count(np.arange(len(world.xyz)))
    recent = np.unique(np.concatenate([frame.landmark for frame in world.keyframes[-world.window :]]))
    alone = np.setdiff1d(np.flatnonzero(views < 2), recent)
    assert np.isin(alone, world.gaps).all()
    assert world.next_id > len(world.xyz) + 40


def test_few_gaps_among_many_landmarks_stay_and_are_nowhere_to_be_seen():
    drive = Drive(redundant_share=1.0, twin_share=1.0).go(30)
    world = drive.map
    world._close_gaps(0.0)
    before, ids = world.snapshot(), world.landmark_id.copy()
    gone = world.keyframes[3].landmark[:5]  # merged into others of the same age: they leave holes far from the end
    world.merge_landmarks(world.keyframes[4].landmark[-5:], gone)
    world._cull_landmarks()
    assert np.isin(gone, world.gaps).all()
    assert np.array_equal(world.landmark_id[: gone.max() + 1], ids[: gone.max() + 1])  # rows have not moved
    after = world.snapshot()
    assert not np.isin(ids[gone], after.landmark_id).any()
    assert len(after.xyz) == len(after.landmark_id) == len(world.xyz) - len(world.gaps)
    assert np.isin(after.observed_id, after.landmark_id).all()
    world._close_gaps(0.0)
    assert not len(world.gaps)
    assert np.array_equal(world.landmark_id, after.landmark_id)
    assert np.array_equal(world.xyz, after.xyz)
    assert np.array_equal(world.snapshot().observed_id, after.observed_id)
    assert len(before.landmark_id) > len(after.landmark_id)


def test_rows_to_the_end_are_never_more_than_a_tenth_gaps_after_a_culling():
    drive = Drive(60, cull_every=5, redundant_share=0.5)
    rng = np.random.default_rng(2)
    for _ in range(30):
        drive.go(5)
        merge_some(drive.map, rng)
        gaps, rows = drive.map.gaps, len(drive.map.xyz)
        assert (np.arange(len(gaps), 0, -1) < 0.1 * (rows - gaps)).all()


def test_a_map_put_in_place_from_outside_goes_on_like_the_one_it_was_copied_from():
    one, other = Drive(50, cull_every=5), Drive(50, cull_every=5)
    one.go(83)
    other.go(83)
    state = {name: values.copy() for name, values in map_state(one.map).items()}
    world = other.map
    world.xyz, world.descriptors, world.landmark_id = state["xyz"], state["descriptors"], state["landmark_id"]
    world.keyframes = [replace(frame) for frame in one.map.keyframes]
    world.gaps = np.empty(0, np.int64)
    world.note_sightings()
    for drive in (one, other):
        drive.go(20)
    for name, values in map_state(one.map).items():
        assert np.array_equal(values, map_state(other.map)[name], equal_nan=True)


def test_frames_of_a_culled_keyframe_keep_their_poses_and_the_path_its_times():
    drive = Drive(30, cull_every=3, min_views=1, redundant_share=0.3)
    truth, gone = [], 0
    for index in range(90):
        truth.append(drive.pose(index))
        drive.go(1)
        gone = index + 1 - len(drive.map.keyframes)
    path = drive.path.trajectory(drive.map)
    assert gone > 10
    assert not set(drive.path.anchors.tolist()) - {frame.index for frame in drive.map.keyframes}
    np.testing.assert_allclose(path.T_world_camera, truth, atol=1e-9)
    assert path.stamp.tolist() == list(range(90))


@pytest.mark.parametrize("shape", [(), (3,), (2, 2)])
def test_a_column_is_what_was_put_into_it(shape):
    rng, column, rows = np.random.default_rng(3), Column(np.empty((0, *shape))), np.empty((0, *shape))
    for count in rng.integers(0, 40, 30).tolist():
        more = rng.normal(size=(count, *shape))
        column.extend(more)
        rows = np.concatenate([rows, more])
        first = int(rng.integers(0, len(rows) + 1))
        kept = rng.random(len(rows) - first) < 0.8
        column.keep(first, kept)
        rows = np.concatenate([rows[:first], rows[first:][kept]])
        assert np.array_equal(column.rows, rows)
    taken = column.pop(7)
    assert np.array_equal(np.concatenate([column.rows, taken]), rows)
    assert np.array_equal(column.pop(10**6), rows[:-7])
    assert len(column) == 0


def test_places_in_the_table_of_sightings_are_used_again():
    sightings, rows = Sightings(), np.arange(50)
    sightings.cover(50)
    for frame in range(200):
        sightings.add(rows, frame)
        if frame >= 3:
            sightings.drop(rows, frame - 3)
    assert sightings.count(rows).tolist() == [3] * 50
    assert len(sightings._frame) == 4 * 50


def test_keyframes_are_culled_once_in_so_many_that_are_added_also_where_as_many_go(monkeypatch):
    """Counted by the keyframes that are left, a map that stays at a multiple of that number is culled at each keyframe."""
    drive, culled = Drive(30, cull_every=10, min_views=1, redundant_share=0.3).go(40), []
    cull = drive.map._cull_keyframes
    monkeypatch.setattr(drive.map, "_cull_keyframes", lambda: (culled.append(drive.map.added), cull()))
    drive.go(60)
    assert culled == list(range(50, 101, 10))
    assert len(drive.map.keyframes) < drive.map.added == 100
