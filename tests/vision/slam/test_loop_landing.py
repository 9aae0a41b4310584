"""A loop is closed beside the tracking, and lands at a fixed frame: same bytes with any threads, and resumed meanwhile."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam import InputError, Trajectory, evaluate_trajectory
from tspslam._threads import set_threads
from tspslam.vision.se3 import inverse
from tspslam.vision.slam import odometry as odometry_module
from tspslam.vision.slam.back_end import jobs
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.odometry import StereoOdometry, Tracking

from ...sequences import DETECTOR, SMALL_RIG, corridor
from .bending import bend

THERE = 40  # frames; 0.5 m each: after 30 a loop is found too late for keyframes to come before it lands


@pytest.fixture(scope="module")
def walk():
    """Pairs and true poses of a walk down a corridor and back."""
    sequence = corridor(THERE * 0.5, SMALL_RIG)
    order = [*range(THERE), *range(THERE - 1, -1, -1)]
    pairs = [replace(sequence[k], stamp=float(n), index=n) for n, k in enumerate(order)]
    return pairs, sequence.truth[order]


def began(walk, tracking=None):
    """An odometry that walked there, whose map then drifted by 6 cm and a quarter of a degree."""
    odometry, T = StereoOdometry(SMALL_RIG, detector=DETECTOR, tracking=tracking), np.eye(4)
    for pair in walk[0][:THERE]:
        odometry.process(pair)
    odometry.path.pose = odometry.mapper.join(odometry.path.pose)
    before, (c, s) = odometry.map.keyframes[-1].T_world_camera, (np.cos(0.004), np.sin(0.004))
    T[:3, :3], T[:3, 3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]], (0.05, 0, 0.03)
    bend(odometry.map, T)
    odometry.path.pose = odometry.map.keyframes[-1].T_world_camera @ inverse(before) @ odometry.path.pose
    return odometry


def proceed(odometry, pairs, until=None):
    """Process pairs, up to where something is so; returns the rest."""
    for k, pair in enumerate(pairs):
        if until and until():
            return pairs[k:]
        odometry.process(pair)
    return []


def ends_alike(one, other):
    for odometry in (one, other):
        odometry.finish()
        odometry.close()
    same = [np.array_equal(one.trajectory.T_world_camera, other.trajectory.T_world_camera)]
    same += [np.array_equal(getattr(one.map, name), getattr(other.map, name)) for name in ("xyz", "landmark_id")]
    return all(same) and one.mapper.closures == other.mapper.closures


def resumed(odometry, walk):
    other = StereoOdometry(SMALL_RIG, detector=DETECTOR, tracking=odometry.tracking)
    other.restore(odometry.state(), lambda number: walk[0][number].left)
    return other


@pytest.mark.parametrize(
    "when", ["a loop is found", "a loop is being closed", "the map has gone on", "pieces are left"]
)
def test_resumed_with_one_thread_while_something_is_under_way_it_goes_on_alike(walk, monkeypatch, when):
    monkeypatch.setattr(jobs, "PIECE", 3)
    if when == "the map has gone on":
        monkeypatch.setattr(odometry_module, "_CLOSED", 12)
    odometry = began(walk)
    world = odometry.map
    moments = {
        "a loop is found": lambda: world.loop is not None,
        "a loop is being closed": lambda: odometry.mapper.is_correcting,
        "the map has gone on": lambda: world.loop is not None and world.keyframes[-1].index > world.loop.index,
        "pieces are left": lambda: world.unsettled and odometry.mapper.is_adjusting,
    }
    rest = proceed(odometry, walk[0][THERE:], moments[when])
    assert rest
    assert odometry.mapper.is_adjusting or odometry.mapper.is_correcting
    try:
        set_threads(1)
        other = resumed(odometry, walk)
    finally:
        set_threads(None)
    proceed(odometry, rest)
    proceed(other, rest)
    assert ends_alike(odometry, other)


def test_a_state_with_a_loop_that_nothing_closes_is_refused(walk):
    odometry = began(walk)
    proceed(odometry, walk[0][THERE:], lambda: odometry.map.loop is not None)
    state = odometry.state()
    odometry.close()
    state["counts"][3] = 0
    with pytest.raises(InputError, match="a loop is left that nothing closes"):
        StereoOdometry(SMALL_RIG, detector=DETECTOR).restore(state, lambda number: walk[0][number].left)


def test_a_state_whose_loop_moves_what_it_cannot_is_refused(walk):
    odometry = began(walk)
    proceed(odometry, walk[0][THERE:], lambda: odometry.mapper.is_correcting)
    state = odometry.state()
    odometry.close()
    assert len(state["correction_keyframe"])
    faults = {
        "do not ascend": ("correction_keyframe", state["correction_keyframe"][::-1].copy()),
        "with a keyframe that is none": ("correction_holder", state["correction_holder"] + 1000),
        "does not move a keyframe or a landmark": ("correction_keyframe", state["correction_keyframe"] + 1),
        "no rigid motion": ("correction_motions", 2 * state["correction_motions"]),
        "by a frame that is no keyframe": ("closures", state["closures"] - 1),
        "that is not being closed": ("counts", np.where(np.arange(5) == 3, 1, state["counts"])),
    }
    for said, (name, values) in faults.items():
        with pytest.raises(InputError, match=said):
            StereoOdometry(SMALL_RIG, detector=DETECTOR).restore(state | {name: values}, lambda k: walk[0][k].left)


def test_a_loop_lands_at_its_frame_and_the_camera_goes_with_its_keyframe(walk):
    odometry = began(walk)
    world, mapper, path = odometry.map, odometry.mapper, odometry.path
    proceed(odometry, walk[0][THERE:], lambda: world.loop is not None)
    begun = world.keyframes[-1].index
    assert mapper.closures[-1][0] == begun
    T = inverse(world.keyframes[-1].T_world_camera) @ path.pose
    moved = mapper.join(path.pose)
    np.testing.assert_allclose(inverse(world.keyframes[-1].T_world_camera) @ moved, T, atol=1e-9)
    assert world.loop is None
    assert not mapper.is_adjusting
    path.pose = moved


def test_keyframes_come_while_a_loop_is_closed_and_it_lands_at_a_frame_that_their_number_tells(walk, monkeypatch):
    monkeypatch.setattr(odometry_module, "_CLOSED", 12)
    odometry = began(walk)
    world, came, landed = odometry.map, [], None
    rest = proceed(odometry, walk[0][THERE:], lambda: world.loop is not None)
    begun = world.loop.index
    for index, pair in enumerate(rest, begun + 1):
        due = begun + 12 + len(world.keyframes) // 60
        is_due = index >= due and (index - world.keyframes[-1].index >= 2)
        came += [index] if odometry.process(pair).is_keyframe and world.loop is not None else []
        assert not (is_due and world.loop is not None)
        if world.loop is None:
            landed = index
            break
    odometry.close()
    assert came
    assert landed >= begun + 12
    assert len(odometry.mapper.closures) == 1  # no other loop is looked for meanwhile


def test_a_large_map_is_adjusted_in_pieces_at_the_end(walk):
    """As many keyframes as there may be: the path is as good as where all are adjusted at once."""
    ends = []
    for most in (2, 500):
        odometry = began(walk, Tracking(map=MapSettings(max_keyframes=most)))
        proceed(odometry, walk[0][THERE:])
        assert len(odometry.map.keyframes) > 2
        odometry.finish()
        odometry.close()
        assert not odometry.map.unsettled
        path = odometry.trajectory
        ends.append(evaluate_trajectory(path, Trajectory(path.stamp, walk[1])).ate_rmse_m)
    assert ends[0] < 2 * ends[1]


def test_a_keyframe_sees_no_landmark_that_became_another_while_it_was_tracked(walk, monkeypatch):
    """A loop that lands with a keyframe: by then that is tracked, against landmarks as they were."""
    odometry = began(walk)
    world = odometry.map
    rest = proceed(odometry, walk[0][THERE:], lambda: world.loop is not None)
    with monkeypatch.context() as patched:
        patched.setattr(odometry, "_wants_keyframe", lambda *_: True)
        patched.setattr(odometry, "_is_time_to_close", lambda: True)
        proceed(odometry, rest[:1])
    assert world.loop is None
    assert len(world.merged)
    assert not np.isin(world.landmark_id[world.keyframes[-1].landmark], world.merged[:, 0]).any()
    proceed(odometry, rest[1:])
    gone = world.merged[:, 0]
    assert len(np.unique(gone)) == len(gone)
