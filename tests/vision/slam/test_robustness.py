"""What callers do with what they are given, and settings at odds with each other, cost the path nothing."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam import Features, InputError, MapSettings, Matches, Session, Settings, StereoOdometry, Tracked, Tracking

from ...sequences import DETECTOR, RIG, corridor


@pytest.fixture(scope="module")
def walk():
    return list(corridor(7.0))


def drive(pairs, **options):
    odometry = StereoOdometry(RIG, detector=DETECTOR, tracking=Tracking(**options))
    tracked = [odometry.process(pair) for pair in pairs]
    odometry.finish()
    return odometry, tracked


@pytest.mark.parametrize("settings", [
    {"redundant_share": 0.5}, {"spacing": 1000}, {"twin_share": 0, "twin_distance": 10}, {"image_bytes": 0, "references": 9},
])  # fmt: skip
def test_more_references_than_keyframes_in_the_window_are_kept(walk, settings):
    chosen = MapSettings(**{"references": 3, "cull_every": 1} | settings)
    odometry, _ = drive(walk, window=2, keyframe_share=1.0, map=chosen)
    again = StereoOdometry(RIG, detector=DETECTOR, tracking=odometry.tracking)
    again.restore(odometry.state(), lambda number: walk[number].left)
    assert np.array_equal(again.trajectory.T_world_camera, odometry.trajectory.T_world_camera)


@pytest.mark.parametrize("fill", [0, None])
def test_images_may_be_written_over_once_they_are_processed(walk, fill):
    """As a camera's driver does; also where parts are computed late, or in a thread."""
    left, right = np.empty_like(walk[0].left), np.empty_like(walk[0].right)
    with Session(RIG, Settings(detector=DETECTOR)) as session, Session(RIG, Settings(detector=DETECTOR)) as plain:
        frames, expected = [], []
        for pair in walk[:4]:
            left[:], right[:] = pair.left, pair.right
            frames.append(session.process(replace(pair, left=left, right=right)))
            if fill is not None:
                left[:] = fill
            expected.append(plain.process(pair))
        for frame, other in zip(frames, expected, strict=True):
            assert np.array_equal(frame.response.z, other.response.z)
            assert np.array_equal(frame.signals.vertex, other.signals.vertex)


def test_what_is_said_of_a_frame_may_be_changed(walk):
    odometry, _ = drive(walk)
    other = StereoOdometry(RIG, detector=DETECTOR)
    for pair in walk:
        tracked = other.process(pair)
        tracked.T_world_camera[:3, 3] = 0
        tracked.uv[:], tracked.disparity[:], tracked.landmark[:] = 0, 5, 0
        other.trajectory.T_world_camera[:] = 0
    other.finish()
    assert np.array_equal(other.trajectory.T_world_camera, odometry.trajectory.T_world_camera)


def test_a_state_is_of_its_moment(walk):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    for pair in walk[:5]:
        odometry.process(pair)
    state = odometry.state()
    before = {name: values.copy() for name, values in state.items()}
    others = [StereoOdometry(RIG, detector=DETECTOR) for _ in range(2)]
    for one in others:
        one.restore(state, lambda number: walk[number].left)
        for pair in walk[5:9]:
            one.process(pair)
    odometry.process(walk[5])
    assert all(
        np.array_equal(state[name], values, equal_nan=values.dtype.kind == "f") for name, values in before.items()
    )
    assert np.array_equal(*(one.trajectory.T_world_camera for one in others))


def test_a_closed_odometry_takes_no_pair(walk):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    odometry.close()
    with pytest.raises(InputError, match="the odometry is closed, expected an open one"):
        odometry.process(walk[0])


THREE = {"uv": np.zeros((3, 2)), "disparity": np.zeros(3)}


@pytest.mark.parametrize(("given", "said"), [
    ({"T_world_camera": 5 * np.eye(4)}, "expected a .4, 4. rigid motion"),
    ({"T_world_camera": np.full((4, 4), np.nan)}, "expected a .4, 4. rigid motion"),
    ({"T_world_camera": np.eye(3)}, "expected a .4, 4. rigid motion"),
    ({"landmark": np.arange(2)} | THREE, "have shapes .2,., .3, 2., .3,., expected .K,., .K, 2., .K,."),
    ({"landmark": np.arange(3) + 0.7} | THREE, "expected whole numbers from 0, each once"),
    ({"landmark": np.array([-7, 1, 2])} | THREE, "expected whole numbers from 0, each once"),
    ({"landmark": np.array([1, 1, 2])} | THREE, "expected whole numbers from 0, each once"),
])  # fmt: skip
def test_what_is_said_of_a_frame_by_others_is_checked(given, said):
    with pytest.raises(InputError, match=said):
        Tracked(**{"T_world_camera": np.eye(4)} | given)


def changed_features(**columns):
    return lambda grey: replace(DETECTOR(grey), **{name: change(DETECTOR(grey)) for name, change in columns.items()})


@pytest.mark.parametrize(("detector", "said"), [
    (lambda grey: None, "detector: result is NoneType, expected a Features"),
    (changed_features(descriptor=lambda f: None), "detector: result has .*descriptor .., .*expected .N, 2., .N, D."),
    (changed_features(descriptor=lambda f: f.descriptor[:9]), r"detector: result has .*descriptor \(9, 32\)"),
    (changed_features(uv=lambda f: f.uv * np.nan), "detector: result has a keypoint that is not finite"),
    (changed_features(angle=lambda f: f.angle[:-1]), "detector: result has .*angle"),
])  # fmt: skip
def test_keypoints_that_do_not_fit_are_named(walk, detector, said):
    with pytest.raises(InputError, match=said):
        StereoOdometry(RIG, detector=detector).process(walk[0])


def matched(i, j, n=None):
    def match(left: Features, right: Features, pair):
        return Matches(np.array(i), np.array(j), np.ones(n or len(i)), np.ones(len(i)))

    return match


@pytest.mark.parametrize(("matcher", "said"), [
    (lambda *_: None, "matcher: result is NoneType, expected a Matches"),
    (matched([-1, 2], [1, 2]), "matcher: result names a keypoint that is not there"),
    (matched([1, 10**6], [1, 2]), "matcher: result names a keypoint that is not there"),
    (matched([1, 2], [1, 10**6]), "matcher: result names a keypoint that is not there"),
    (matched([1.0, 2.0], [1, 2]), "matcher: result names a keypoint that is not there"),
    (matched([1, 2], [1, 2], n=5), "matcher: result has columns of several lengths"),
    (matched([1, 1], [1, 2]), "matcher: result has a left keypoint twice"),
])  # fmt: skip
def test_matches_that_do_not_fit_are_named(walk, matcher, said):
    with pytest.raises(InputError, match=said):
        StereoOdometry(RIG, detector=DETECTOR, matcher=matcher).process(walk[0])


def test_an_odometry_goes_on_at_times_since_1970(walk):
    odometry, again = (StereoOdometry(RIG, detector=DETECTOR) for _ in range(2))
    for pair in walk[:2]:
        odometry.process(replace(pair, stamp=1.7e9 + pair.stamp))
    odometry.finish()
    again.restore(odometry.state(), lambda number: walk[number].left)
    assert np.array_equal(again.path.stamps, odometry.path.stamps)


def test_a_state_whose_disparities_have_no_spread_is_refused(walk):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    odometry.process(walk[0])
    state = odometry.state()
    for least in (0, 5e-324, np.nextafter(1e-9, 0)):
        state["sigma"][0] = least
        with pytest.raises(InputError, match=r"a disparity has no spread|not finite"):
            StereoOdometry(RIG, detector=DETECTOR).restore(state, lambda number: walk[number].left)


@pytest.mark.parametrize("information", [0.0, -1.0, 5e-324, 1e300])
def test_a_state_whose_offset_has_a_spread_that_cannot_be_is_refused(walk, information):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    odometry.process(walk[0])
    state = odometry.state()
    state["bias"][1] = information
    with pytest.raises(InputError, match=r"the offset has a spread|too large"):
        StereoOdometry(RIG, detector=DETECTOR).restore(state, lambda number: walk[number].left)
