"""A session: one frame after another, an end that makes the path final, and what goes wrong said once and for all."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import tspslam
from tspslam import GeometryError, InputError, Session, Settings, Trajectory, evaluate_trajectory
from tspslam._threads import both
from tspslam.io import RunFolder
from tspslam.run.config import resolve
from tspslam.run.offset_doubts import offset_doubts
from tspslam.run.pipeline import run
from tspslam.run.sequence import SequenceRun
from tspslam.run.summary import summarize_run
from tspslam.vision.slam.back_end.disparity_bias import DisparityBias
from tspslam.vision.slam.back_end.jobs import AdjustmentJob
from tspslam.vision.slam.odometry import Tracked
from tspslam.vision.stereo.descriptor_matcher import DescriptorMatcher
from tspslam.vision.stereo.row_matcher import RowMatcher, search_near

from .sequences import DETECTOR, RIG, SETTINGS, corridor

STAGES = Settings(detector=DETECTOR)


@pytest.fixture(scope="module")
def walk():
    sequence = corridor(4.0)
    return [sequence[k] for k in range(len(sequence))], Trajectory(sequence.stamps, sequence.truth)


def test_the_path_is_final_once_the_session_is_finished(walk):
    pairs, truth = walk
    with Session(RIG, STAGES) as session:
        for pair in pairs:
            session.process(pair)
        path = session.finish()
    assert len(path) == len(pairs)
    assert path.T_world_camera.tobytes() == session.trajectory.T_world_camera.tobytes()
    assert evaluate_trajectory(path, truth).ate_rmse_m < 0.02


def test_a_path_is_made_final_once_until_a_further_pair_is_processed(walk, monkeypatch):
    pairs, _ = walk
    with Session(RIG, STAGES) as session:
        finished, finish = [], session.odometry.finish
        monkeypatch.setattr(session.odometry, "finish", lambda: finished.append(finish()))
        for pair in pairs[:-1]:
            session.process(pair)
        path = session.finish()
        assert path.T_world_camera.tobytes() == session.finish().T_world_camera.tobytes()
        assert len(finished) == 1
        session.process(pairs[-1])
        assert len(session.finish()) == len(pairs)
        assert len(finished) == 2


def test_a_pair_made_ready_gives_the_same_frame_whoever_writes_over_it_since(walk):
    pair = walk[0][0]
    mine = replace(pair, left=pair.left.copy(), right=pair.right.copy())
    with Session(RIG, STAGES) as session, Session(RIG, STAGES) as other:
        ready = session.prepare(mine)
        mine.left[:], mine.right[:] = 0, 0
        frame, expected = session.process(ready), other.process(pair)
        assert frame.image.tobytes() == expected.image.tobytes()
        assert frame.response.z.tobytes() == expected.response.z.tobytes()


def test_what_is_wrong_with_a_pair_is_said_when_it_is_processed(walk):
    pair = walk[0][0]
    with Session(RIG, STAGES) as session:
        twice, cut = replace(pair, right=pair.left), replace(pair, left=pair.left[1:])
        for wrong, kind, said in ((twice, GeometryError, "same picture"), (cut, InputError, "left")):
            ready = session.prepare(wrong)
            with pytest.raises(kind, match=said):
                session.process(ready)
        with pytest.raises(InputError, match="pair"):
            session.prepare(None)


def test_a_closed_session_takes_no_pair_and_leaves_no_thread(walk):
    both(len, ("", ""))  # begins the second thread of this one, which stays
    before = set(threading.enumerate())
    with Session(RIG, STAGES) as session:
        frame = session.process(walk[0][0])
    assert len(frame.response.z) == len(frame.cloud)
    left = set(threading.enumerate()) - before
    for each in left:
        each.join(60)  # the second thread of one that has ended ends behind it
    assert not any(each.is_alive() for each in left)
    with pytest.raises(InputError, match="session is closed"):
        session.process(walk[0][1])


def test_a_keyframe_s_complex_waits_for_the_adjustment_that_tracking_waits_for(walk, monkeypatch):
    order, is_begun, solve, surface = [], threading.Event(), AdjustmentJob.solve, STAGES.surface

    def make_surface(cloud):
        order.append("surface")
        is_begun.set()
        return surface(cloud)

    def adjust(job):
        is_begun.clear()
        is_begun.wait(0.3)  # in vain
        order.append("adjustment")
        return solve(job)

    monkeypatch.setattr(AdjustmentJob, "solve", adjust)
    with Session(RIG, replace(STAGES, surface=make_surface)) as session:
        frames = [session.process(pair) for pair in walk[0]]
        session.finish()
    keyframes = sum(frame.is_keyframe for frame in frames)
    assert keyframes > 2
    assert order[: 2 * keyframes - 1] == ["surface", *["adjustment", "surface"] * (keyframes - 1)]


@pytest.mark.parametrize("error", [GeometryError("no surface"), ZeroDivisionError("of the user's own")])
def test_a_failing_stage_is_tried_once_and_its_error_raised_at_each_ask(walk, error):
    calls = []

    def failing(cloud):
        calls.append(len(cloud))
        raise error

    with Session(RIG, replace(STAGES, surface=failing)) as session:
        frames = [session.process(pair) for pair in walk[0][:2]]
        for _ in range(3):
            with pytest.raises(type(error), match=str(error)):
                _ = frames[0].response
    assert len(calls) == 1
    assert len(frames[0].cloud) > 100


class Given:
    """An odometry of another kind: poses that something else has measured; every other frame is a keyframe."""

    def __init__(self, poses):
        self.poses, self.stamps, self.is_open = poses, [], True

    @property
    def trajectory(self):
        return Trajectory(np.array(self.stamps), self.poses[: len(self.stamps)])

    def process(self, pair):
        self.stamps.append(pair.stamp)
        k = len(self.stamps) - 1
        return Tracked(self.poses[k], np.zeros((6, 6)), 0, k % 2 == 0, False, None, {"wheels": 0.25})

    def finish(self):
        self.poses = self.poses.copy()

    def close(self):
        self.is_open = False


def test_a_session_takes_an_odometry_of_another_kind(walk):
    pairs, truth = walk
    given = Given(truth.T_world_camera)
    with Session(RIG, STAGES, odometry=given) as session:
        frames = [session.process(pair) for pair in pairs[:3]]
        path = session.finish()
    assert [frame.is_keyframe for frame in frames] == [True, False, True]
    for frame, T in zip(frames, truth.T_world_camera, strict=False):
        assert frame.T_world_camera is not truth.T_world_camera
        np.testing.assert_array_equal(frame.T_world_camera, T)
        assert len(frame.response) == len(frame.cloud) > 100
        assert {"wheels", "points", "surface", "response"} <= frame.seconds.keys()
    np.testing.assert_array_equal(path.T_world_camera, truth.T_world_camera[:3])
    assert not given.is_open


def test_a_run_is_made_with_an_odometry_of_another_kind(walk, tmp_path):
    pairs, truth = walk
    source = type("Source", (list,), {"name": "walk", "rig": RIG})(pairs[:3])
    with RunFolder.create(tmp_path / "run", {}) as folder:
        session = Session(RIG, STAGES, odometry=Given(truth.T_world_camera))
        sequence = SequenceRun(source, range(3), session, folder)
        list(sequence.proceed())
        session.close()
        record = summarize_run("walk", sequence.rows, session, settings_hash=folder.config_hash)
    assert (record["status"], record["keyframes"], record["landmarks"]) == ("complete", 2, 0)
    assert [row.index for row in sequence.stored] == [0, 2]


@pytest.mark.parametrize(("odometry", "said"), [
    ("wheels", "odometry is the text 'wheels' without close, expected an object with close, finish, process, "),
    (Given, "odometry is <class .*Given'>, expected an object with"),
    (SimpleNamespace(process=len, trajectory=None), "odometry is SimpleNamespace without close"),
])  # fmt: skip
def test_what_is_no_odometry_is_named(odometry, said):
    with pytest.raises(InputError, match=said):
        Session(RIG, STAGES, odometry=odometry)


def test_disparities_of_followed_points_are_searched_as_the_matcher_says():
    strict = RowMatcher(min_correlation=0.99)
    assert search_near(strict).__self__ is strict
    limited = search_near(DescriptorMatcher(max_disparity=30.0, min_disparity=2.0)).__self__
    assert (limited.max_disparity, limited.min_disparity) == (30.0, 2.0)
    assert search_near(lambda left, right, pair: None).__self__ == RowMatcher()


def test_disparities_outside_of_the_matchers_limits_are_not_known(walk):
    pair = walk[0][0]
    with Session(RIG, STAGES) as session:
        cloud = session.process(pair).cloud
    planes = pair.left.astype(np.float32), pair.right.astype(np.float32)
    middle = float(np.median(cloud.disparity))
    every = RowMatcher().near(planes, cloud.uv, cloud.disparity)
    some = RowMatcher(max_disparity=middle).near(planes, cloud.uv, cloud.disparity)
    assert np.isfinite(every[cloud.disparity > middle]).sum() > 50
    assert not (some > middle).any()
    np.testing.assert_array_equal(some[every <= middle], every[every <= middle])


def test_a_calibration_that_the_motion_contradicts_is_told(tmp_path):
    """An offset of -1 px comes out as -0.9 to -1."""
    found = run(corridor(6.0, right_shift=(1.0, 0.0)), tmp_path / "run", resolve(assignments=SETTINGS)).run
    (said,) = [warning["message"] for warning in found["warnings"] if warning["code"] == "disparity_offset"]
    assert found["calibration"]["disparity_offset_px"] == pytest.approx(-1.0, abs=0.2)
    assert "disparities are off by -" in said
    assert "10 m come out as 11" in said or "10 m come out as 12" in said  # 93 px m / (9.3 - 1) px
    assert "disparities are off by" in (tmp_path / "run" / "report.html").read_text()


@pytest.mark.parametrize(
    ("offset", "std", "count"), [(0.2, 0.001, 0), (-0.98, 0.007, 1), (0.6, 0.3, 0), (0.6, 0.1, 1), (-40.0, 0.1, 1)]
)
def test_only_a_large_and_certain_offset_is_told(offset, std, count):
    bias = DisparityBias(1.0, window=1)
    bias.settle(offset, std)
    said = [warning["message"] for warning in offset_doubts(RIG, bias, is_fixed=False)]
    assert len(said) == count
    assert not any("nan" in line or "inf" in line for line in said)


def test_what_a_stage_gives_is_named_if_it_is_something_else(walk):
    pair = walk[0][0]
    wrong = {
        "detector": (lambda grey: ([], []), "detector: result is tuple, expected a Features"),
        "matcher": (
            lambda left, right, pair: np.zeros((9, 2)),
            "matcher: result is float64 of shape .*, expected a Matc",
        ),
        "surface": (
            lambda cloud: np.zeros((9, 3), int),
            "settings: surface: result is int64 of shape .*, expected a Surf",
        ),
        "filter": (
            lambda complex_, uv, signals: np.zeros(9),
            "settings: filter: result is float64 of shape .*, expected",
        ),
    }
    for name, (stage, said) in wrong.items():
        with pytest.raises(InputError, match=said), Session(RIG, replace(STAGES, **{name: stage})) as session:
            _ = session.process(pair).response


def test_what_an_odometry_gives_is_named_if_it_is_something_else(walk):
    given = Given(walk[1].T_world_camera)
    given.process = lambda pair: np.eye(4)
    said = "odometry: result is float64 of shape .4, 4., expected a Tracked"
    with pytest.raises(InputError, match=said), Session(RIG, STAGES, odometry=given) as session:
        session.process(walk[0][0])


def test_groups_of_settings_are_of_their_kinds():
    for make, said in (
        (lambda: Settings(tracking={"window": 3}), "settings: tracking is dict, expected a Tracking"),
        (
            lambda: tspslam.Tracking(pose=tspslam.MapSettings()),
            "tracking: pose is MapSettings, expected a TrackingSettings",
        ),
        (lambda: tspslam.Tracking(loops=None), "tracking: loops is NoneType, expected a LoopSettings"),
    ):
        with pytest.raises(InputError, match=said):
            make()


def test_a_frame_says_what_is_known_of_it(walk):
    with Session(RIG, STAGES) as session:
        frame = session.process(walk[0][0])
    assert len(frame.response) > 0
    assert repr(frame).startswith(
        f"Frame(0, {frame.name!r}, {len(frame.cloud)} points, {len(frame.complex_.edges)} edges"
    )
