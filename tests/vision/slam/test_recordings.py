"""Several recordings in one map: a further one goes on where it is found, or stands apart until a loop leads back."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tspslam import InputError, Session, datasets
from tspslam.datasets import synthetic
from tspslam.session import Settings
from tspslam.vision.images import prepare
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.keyframes.keyframe import Keyframe
from tspslam.vision.slam.keyframes.parts import join_parts, part_seen
from tspslam.vision.slam.locating.locator import Locator
from tspslam.vision.slam.odometry import StereoOdometry

from ... import sequences
from ...sequences import DETECTOR, RIG, SMALL_RIG, Kept

BLIND = slice(26, 28)


@pytest.fixture(scope="module")
def walk():
    return sequences.corridor(18.0, SMALL_RIG)


@pytest.fixture(scope="module")
def elsewhere():
    return Kept(synthetic.corridor(5.0, seed=1), SMALL_RIG, synthetic.Faults(noise=0.01))


def drive(odometry, pairs, start=0.0):
    return [odometry.process(replace(pair, stamp=start + n / 10)) for n, pair in enumerate(pairs)]


def pieces(walk, *ranges):
    return [[walk[k] for k in piece] for piece in ranges]


def driven(*recordings, finish=True):
    """An odometry that has gone through recordings, and what it said of their frames."""
    odometry, tracked = StereoOdometry(SMALL_RIG, detector=DETECTOR), []
    for k, pairs in enumerate(recordings):
        if k:
            odometry.begin()
        tracked.append(drive(odometry, pairs, 100.0 * k))
    if finish:
        odometry.finish()
    return odometry, tracked


def off(odometry, truth):
    return np.linalg.norm((odometry.trajectory.T_world_camera - truth)[:, :3, 3], axis=1)


def origins(odometry):
    return odometry.path.origins(odometry.map).tolist()


def test_a_recording_of_a_known_place_goes_on_there_from_its_first_frame_on(walk):
    first, second = pieces(walk, range(20), range(7, 28))
    odometry, (_, tracked) = driven(first, second)
    assert not any(one.is_lost for one in tracked)
    assert tracked[0].is_keyframe
    ((frame, earlier, landmarks),) = odometry.mapper.joins
    assert (frame, landmarks) == (20, tracked[0].matches)
    assert earlier < 20
    assert origins(odometry) == [0] * 41
    assert off(odometry, walk.truth[[*range(20), *range(7, 28)]]).max() < 0.1  # an image so small drifts by 0.05 m
    assert np.isfinite(odometry.covariance_from_start(30)).all()


def test_another_world_stands_apart(walk, elsewhere):
    first, second = list(pieces(walk, range(16))[0]), list(elsewhere)
    odometry, (_, tracked) = driven(first, second)
    assert [one.is_lost for one in tracked] == [False] * len(second)
    assert np.array_equal(tracked[0].T_world_camera, np.eye(4))
    assert odometry.mapper.joins == []
    assert origins(odometry) == [0] * 16 + [16] * len(second)
    parts = {frame.index >= 16: set() for frame in odometry.map.keyframes}
    for frame in odometry.map.keyframes:
        parts[frame.index >= 16] |= set(frame.landmark.tolist())
    assert not parts[False] & parts[True]  # no landmark of one is seen from the other
    own = inverse(odometry.trajectory.T_world_camera[16]) @ odometry.trajectory.T_world_camera[16:]
    assert np.linalg.norm((own - elsewhere.truth)[:, :3, 3], axis=1).max() < 0.05
    assert off(odometry, np.concatenate([walk.truth[:16], own]))[:16].max() < 0.05
    assert np.isinf(odometry.covariance_from_start(20)).all()


def test_a_recording_that_is_not_found_is_joined_by_a_loop(monkeypatch):
    """At the size at which keyframes share enough words."""
    walk = sequences.corridor(19.0, RIG)
    monkeypatch.setattr(Locator, "look_up", lambda *_: None)
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    drive(odometry, pieces(walk, range(37))[0])
    odometry.begin()
    drive(odometry, pieces(walk, range(6, 9))[0], 100.0)
    assert origins(odometry)[37:] == [37] * 3
    drive(odometry, pieces(walk, range(9, 21))[0], 101.0)
    odometry.finish()
    assert odometry.mapper.joins
    assert odometry.mapper.joins[0][0] > 37 > odometry.mapper.joins[0][1]
    assert set(origins(odometry)) == {0}
    assert {frame.part for frame in odometry.map.keyframes} == {0}
    assert off(odometry, walk.truth[[*range(37), *range(6, 21)]]).max() < 0.05


def test_what_lies_between_two_that_are_joined_stays_apart(walk, elsewhere):
    first, third = pieces(walk, range(16), range(6, 16))
    odometry, _ = driven(first, list(elsewhere)[:6], third)
    assert origins(odometry) == [0] * 16 + [16] * 6 + [0] * 10
    assert [(frame, earlier < 16) for frame, earlier, _ in odometry.mapper.joins] == [(22, True)]
    assert {frame.part for frame in odometry.map.keyframes if frame.index >= 22} == {0}
    rest = [*range(16), *range(22, 32)]
    truth = walk.truth[[*range(16), *range(6, 16)]]
    found = odometry.trajectory.T_world_camera[rest]
    assert np.linalg.norm((found - truth)[:, :3, 3], axis=1).max() < 0.03


def test_a_recording_begins_with_the_first_frame_that_shows_something(walk):
    first, second = pieces(walk, range(12), range(4, 10))
    blind = [replace(pair, left=0 * pair.left, right=0 * pair.right) for pair in second[:2]]
    odometry, (_, tracked) = driven(first, blind, finish=False)
    assert all(one.is_lost for one in tracked)
    assert origins(odometry) == [0] * 12 + [-1] * 2
    after = drive(odometry, second[2:], 200.0)
    assert odometry.path.begun == [14]
    assert not any(one.is_lost for one in after)
    assert np.linalg.norm((after[0].T_world_camera - walk.truth[6])[:3, 3]) < 0.03


def test_a_recording_that_never_shows_anything_is_forgotten_by_the_next(walk):
    first, third = pieces(walk, range(12), range(4, 8))
    blind = [replace(pair, left=0 * pair.left, right=0 * pair.right) for pair in first[:2]]
    odometry, _ = driven(first, blind, third)
    assert odometry.path.begun == [14]


@pytest.mark.parametrize("stop", [0, 1, 5])
def test_a_state_goes_on_in_a_further_recording_to_the_same_bytes(walk, elsewhere, stop):
    """Also from before its first frame, and where it stands apart."""
    first = pieces(walk, range(14))[0]
    for second in (pieces(walk, range(7, 15))[0], list(elsewhere)[:8]):
        whole, _ = driven(first, second, finish=False)
        part, _ = driven(first, second[:stop], finish=False)
        again = StereoOdometry(SMALL_RIG, detector=DETECTOR)
        again.restore(part.state(), lambda n, second=second: [*first, *second][n].left)
        for n, pair in enumerate(second[stop:], stop):
            again.process(replace(pair, stamp=100 + n / 10))
        one, other = whole.state(), again.state()
        assert [name for name in one if not np.array_equal(one[name], other[name], equal_nan=True)] == []


def spoilt(name, values):
    return lambda state: state | {name: np.array(values, state[name].dtype)}


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (spoilt("begun", [14, 14]), "a recording begins with a frame that is none"),
        (spoilt("begun", [0]), "a recording begins with a frame that is none"),
        (spoilt("begun", [1000]), "a recording begins with a frame that is none"),
        (spoilt("joins", [[14, 16, 30]]), "parts of the map became one at a frame that is none"),
        (spoilt("joins", [[14, 2, 0]]), "parts of the map became one at a frame that is none"),
        (lambda state: state | {"keyframe_part": state["keyframe_part"] + 1}, "a keyframe is in a part of the map"),
        (lambda state: state | {"keyframe_part": state["keyframe_part"] - 1}, "a keyframe is in a part of the map"),
    ],
)
def test_states_that_cannot_be_are_refused(walk, elsewhere, spoil, said):
    odometry, _ = driven(pieces(walk, range(14))[0], list(elsewhere)[:4], finish=False)
    with pytest.raises(InputError, match=said):
        StereoOdometry(SMALL_RIG, detector=DETECTOR).restore(spoil(odometry.state()), lambda n: walk[n].left)


def test_to_begin_before_anything_was_seen_says_nothing(walk):
    odometry = StereoOdometry(SMALL_RIG, detector=DETECTOR)
    odometry.begin()
    drive(odometry, pieces(walk, range(4))[0])
    assert odometry.path.begun == []


def test_views_of_another_world_are_found_nowhere(walk, elsewhere):
    odometry, _ = driven(pieces(walk, range(24))[0])
    look_up = odometry._locator.look_up
    assert [look_up(prepare(pair).left_image) for pair in elsewhere] == [None] * len(elsewhere)
    known = [look_up(prepare(walk[k]).left_image) for k in (3, 9, 16)]
    for k, found in zip((3, 9, 16), known, strict=True):
        assert found is not None
        assert np.linalg.norm((found.T_world_camera - walk.truth[k])[:3, 3]) < 0.05


def keyframes(*parts):
    nothing = np.empty(0, np.int64), np.empty((0, 2)), np.empty(0), np.empty(0)
    starts = [False, *(a != b for a, b in pairwise(parts))]
    return [
        Keyframe(k, np.eye(4), None, *nothing, start, part)
        for k, (part, start) in enumerate(zip(parts, starts, strict=True))
    ]


def test_joined_parts_have_the_lower_number_and_what_is_between_still_begins_anew():
    frames = keyframes(0, 0, 1, 1, 2)
    joined = join_parts(frames, 4, 1)
    assert [(frame.part, frame.is_start) for frame in joined] == [
        (0, False), (0, False), (1, True), (1, False), (0, True),
    ]  # fmt: skip
    assert all(one is other for one, other in zip(frames[:4], joined[:4], strict=True))
    rest = join_parts(joined, 0, 3)
    assert [(frame.part, frame.is_start) for frame in rest] == [(0, False)] * 5


def test_a_view_is_in_the_part_that_most_of_its_sights_are_in():
    frames = keyframes(0, 0, 1)
    assert part_seen(frames, np.array([2, 2, 2, 0, 1])) == 1
    assert part_seen(frames, np.array([0, 1, 2])) == 0
    assert part_seen(frames, np.empty(0, np.int64)) == 2
    assert part_seen([], np.empty(0, np.int64)) == 0


def test_a_session_of_a_joined_sequence_is_one_path(walk):
    class Piece(list):
        rig, name = SMALL_RIG, "walk"

    both = datasets.JoinedSequence([Piece(piece) for piece in pieces(walk, range(12), range(5, 15))])
    with Session(both.rig, Settings(detector=DETECTOR)) as session:
        for index, pair in enumerate(both):
            if index in both.starts:
                session.begin()
            session.process(pair)
        path = session.finish()
    assert (np.diff(path.stamp) > 0).all()
    truth = walk.truth[[*range(12), *range(5, 15)]]
    assert np.linalg.norm((path.T_world_camera - truth)[:, :3, 3], axis=1).max() < 0.03
