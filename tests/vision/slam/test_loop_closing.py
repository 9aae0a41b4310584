"""A camera that comes back: old landmarks are seen again, the map is closed, and it stops growing."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam import InputError, Trajectory, evaluate_trajectory
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.texture import leaves
from tspslam.vision.features.binary import binary_descriptors
from tspslam.vision.images import build_pyramid, grey_levels
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.locating.path_covariance import Links
from tspslam.vision.slam.odometry import StereoOdometry, Tracking
from tspslam.vision.slam.places.loop_closing import PlaceRecognition
from tspslam.vision.slam.places.settings import LoopSettings
from tspslam.vision.slam.pose import PoseEstimate
from tspslam.vision.slam.tracking import TrackingSettings

from ...sequences import DETECTOR, RIG, SMALL_RIG, corridor
from .bending import bend

THERE = 40  # frames; 0.5 m each


def places(odometry, loops=None):
    return PlaceRecognition(odometry.map, TrackingSettings(), loops or LoopSettings())


@pytest.fixture(scope="module")
def walk():
    """Pairs and true poses of a walk down a corridor."""
    sequence = corridor(THERE * 0.5)
    return [replace(sequence[k], stamp=float(k), index=k) for k in range(THERE)], sequence.truth[:THERE]


@pytest.fixture(scope="module")
def state(walk):
    odometry = went(walk[0])
    odometry.path.pose = odometry.mapper.join(odometry.path.pose)
    return odometry.state()


@pytest.fixture
def there(walk, state):
    """An odometry that walked there."""
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    odometry.restore({name: values.copy() for name, values in state.items()}, lambda number: walk[0][number].left)
    return odometry


def to_and_fro(walk, passes):
    """The walk there, back, there, ...: pairs and true poses."""
    legs = (range(THERE) if k % 2 == 0 else range(THERE - 1, -1, -1) for k in range(passes))
    order = list(itertools.chain(*legs))
    return [replace(walk[0][k], stamp=float(n), index=n) for n, k in enumerate(order)], walk[1][order]


def went(pairs, tracking=None):
    odometry = StereoOdometry(RIG, detector=DETECTOR, tracking=tracking)
    for pair in pairs:
        odometry.process(pair)
    return odometry


def off(odometry, truth):
    T = odometry.trajectory
    return evaluate_trajectory(T, Trajectory(T.stamp, truth[: len(T.stamp)])).ate_rmse_m


def size(odometry):
    frames = odometry.map.keyframes
    return np.array([len(odometry.map.xyz), len(frames), sum(len(frame.landmark) for frame in frames)])


def test_a_map_of_one_place_stops_growing(walk):
    """A map that grew would be three times as large.

    With thresholds nudged by 2 %, keypoints by 1e-6 px, other noise, and other registers of the processor, the largest
    was 1.0 to 1.6 times that of the first two passes (landmarks, keyframes and observations), and the path's error 3 to 7 mm.
    """
    pairs, truth = to_and_fro(walk, 6)
    odometry, sizes = StereoOdometry(RIG, detector=DETECTOR), []
    for k, pair in enumerate(pairs, 1):
        odometry.process(pair)
        if k % (2 * THERE) == 0:
            sizes.append(size(odometry))
    assert (np.max(sizes, axis=0) <= 2 * sizes[0]).all(), sizes
    odometry.finish()
    assert off(odometry, truth) < 0.02


def test_each_keyframe_sees_a_landmark_once_and_frames_keep_their_poses_when_theirs_goes(walk):
    pairs, _ = to_and_fro(walk, 4)
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    before, gone = None, 0
    thin = odometry.map._cull_keyframes

    def watched():
        nonlocal gone
        thin()
        gone += len(odometry.map.dropped)

    odometry.map._cull_keyframes = watched
    for pair in pairs:
        odometry.process(pair)
        assert all(len(np.unique(frame.landmark)) == len(frame.landmark) for frame in odometry.map.keyframes)
        assert not odometry.map.dropped
    assert gone > 0
    odometry.finish()
    before = odometry.trajectory.T_world_camera
    odometry.map.keyframes[1:-7] = [replace(frame) for frame in odometry.map.keyframes[1:-7]]
    for share in (0.6, 0.3, 0.0):  # less and less is needed
        odometry.map.settings = MapSettings(min_views=1, redundant_share=share)
        thin()
    assert odometry.map.dropped
    odometry.path.record(1e3, odometry.map, (0, np.eye(6)))
    np.testing.assert_allclose(odometry.trajectory.T_world_camera[:-1], before, atol=1e-9)


@pytest.fixture
def bent(walk, there):
    """An odometry that walked there, whose map was then bent as by a drift of 6 cm and a quarter of a degree."""
    pairs, truth = to_and_fro(walk, 2)
    odometry, T = there, np.eye(4)
    T[:3, 3] = 0.05, 0.0, 0.03
    c, s = np.cos(0.004), np.sin(0.004)
    T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    before = odometry.map.keyframes[-1].T_world_camera
    bend(odometry.map, T)
    odometry.path.pose = odometry.map.keyframes[-1].T_world_camera @ inverse(before) @ odometry.path.pose
    return odometry, pairs, truth


def test_a_loop_is_closed_and_the_drift_goes(bent, monkeypatch):
    """The last ten frames are off by 10 mm, and by 20 mm if no place is known again; the drift put in is 58 mm.

    In corridors of four other seeds by 5 to 12, and 14 to 21 mm, 0.4 to 0.9 times as much. The covariance of the last
    pose, by its trace, is 0.14 of that without loops; 0.001 to 0.3 in others.
    """
    odometry, pairs, truth = bent
    other = StereoOdometry(RIG, detector=DETECTOR)
    other.restore(odometry.state(), lambda number: pairs[number].left)
    closed = come_back(odometry, pairs, truth)
    monkeypatch.setattr(PlaceRecognition, "detect_loop", lambda *_: None)
    assert closed < 0.75 * come_back(other, pairs, truth)
    assert odometry.loops > other.loops == 0
    assert len(odometry.mapper.loops.frame) > len(other.mapper.loops.frame) == 0
    last = len(odometry.path) - 1
    known = np.trace(odometry.covariance_from_start(last))
    odometry.mapper.loops = Links.of_none()
    assert known < 0.5 * np.trace(odometry.covariance_from_start(last))


def come_back(odometry, pairs, truth):
    """Go on to the end; how far the last ten frames are off, root mean square, m."""
    for pair in pairs[THERE:]:
        odometry.process(pair)
    odometry.finish()
    away = (odometry.trajectory.T_world_camera - truth)[-10:, :3, 3]
    return np.sqrt((away**2).sum(axis=1).mean())


def test_old_landmarks_are_found_where_they_are_and_the_drift_is_told(walk, there):
    world, image = there.map, build_pyramid(walk[0][3].left)
    features = DETECTOR(walk[0][3].left)
    T = walk[1][3].copy()
    T[0, 3] += 0.05
    estimate = PoseEstimate(
        T, world.keyframes[-1].landmark, world.keyframes[-1].uv, world.keyframes[-1].disparity, np.eye(6)
    )
    found = places(there).detect_loop(image, estimate, features.uv, binary_descriptors(features.descriptor))
    assert found is not None
    assert np.linalg.norm((found.estimate.T_world_camera - walk[1][3])[:3, 3]) < 0.01
    assert found.drift > LoopSettings().min_error
    assert len(found.estimate) >= 30


def test_what_is_followed_anyway_or_far_away_is_no_place_to_come_back_to(there):
    world, places_near = there.map, places(there).places_near
    frame = world.keyframes[0]
    here = PoseEstimate(frame.T_world_camera, frame.landmark, frame.uv, frame.disparity, np.eye(6))
    none = np.zeros(len(world.xyz), np.bool_)
    assert places_near(here, none)[0][0] == 0
    assert 0 not in dict(places_near(here, ~none))
    turned = here.T_world_camera @ np.diag([-1.0, 1, -1, 1])
    assert places_near(replace(here, T_world_camera=turned), none) == []
    beyond = here.T_world_camera.copy()
    beyond[2, 3] -= 50
    assert places_near(replace(here, T_world_camera=beyond), none) == []


def test_a_place_too_far_for_any_drift_is_not_believed(walk, there):
    """Such as the same poster on another wall."""
    odometry = there
    image, features = build_pyramid(walk[0][3].left), DETECTOR(walk[0][3].left)
    descriptors, frame, T = binary_descriptors(features.descriptor), odometry.map.keyframes[-1], walk[1][3].copy()
    for shift, is_found in ((0.05, True), (1.5, False)):
        T[0, 3] = shift
        estimate = PoseEstimate(T.copy(), frame.landmark, frame.uv, frame.disparity, np.eye(6))
        found = places(odometry).detect_loop(image, estimate, features.uv, descriptors)
        assert (found is not None) is is_found


@pytest.fixture(scope="module")
def return_state(walk):
    """State of an odometry that walked there, and then found itself near the beginning without knowing it."""
    pairs, _ = walk
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(PlaceRecognition, "relocalize", lambda *_: None)
        patched.setattr(PlaceRecognition, "detect_loop", lambda *_: None)
        for n, k in enumerate([*range(26), *range(5, 13)]):
            odometry.process(replace(pairs[k], stamp=float(n)))
    odometry.path.pose = odometry.mapper.join(odometry.path.pose)
    return odometry.state()


def journey(walk, state, drift, out=1500.0):
    """A map of the corridor's beginning, of a place `out` m away, and of the beginning again, `drift` m beside it.

    Returns the odometry, and which keyframe begins the last part.
    """
    pairs, truth = walk
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    order = [*range(26), *range(5, 13)]
    odometry.restore({name: values.copy() for name, values in state.items()}, lambda n: pairs[order[n]].left)
    world = odometry.map
    start = max(k for k, frame in enumerate(world.keyframes) if frame.is_start)
    back = np.eye(4)
    back[0, 3] = drift
    back = back @ truth[order[world.keyframes[start].index]] @ inverse(world.keyframes[start].T_world_camera)
    first = np.concatenate([frame.landmark for frame in world.keyframes[:start]]).max() + 1
    world.xyz[first:] = world.xyz[first:] @ back[:3, :3].T + back[:3, 3]
    for k in range(start, len(world.keyframes)):
        moved = back @ world.keyframes[k].T_world_camera
        world.keyframes[k] = replace(world.keyframes[k], T_world_camera=moved, is_start=False, part=0)
    far = world.keyframes[start - 1].T_world_camera.copy()
    far[2, 3] += out
    world.keyframes[start - 1] = replace(world.keyframes[start - 1], T_world_camera=far)
    return odometry, order, start


def asked_again(walk, journeyed, drift, loops=None, frame=9):
    """What a camera at a frame of the walk, thought to be `drift` m beside it, is told of loops."""
    (pairs, truth), (odometry, _, start) = walk, journeyed
    last = odometry.map.keyframes[-1]
    T = truth[frame].copy()
    T[0, 3] += drift
    features = DETECTOR(pairs[frame].left)
    estimate = PoseEstimate(T, last.landmark, last.uv, last.disparity, np.eye(6))
    descriptors = binary_descriptors(features.descriptor)
    image = build_pyramid(pairs[frame].left)
    return places(odometry, loops).detect_loop(image, estimate, features.uv, descriptors), start


@pytest.mark.parametrize("drift", [30.0, 100.0])
def test_three_kilometres_may_end_thirty_metres_beside_their_beginning_and_not_a_hundred(walk, return_state, drift):
    """The way out and back is 3 km: 2 % are 60 m. Beyond them it is another place that looks the same."""
    found, start = asked_again(walk, journey(walk, return_state, drift), drift)
    assert (found is not None) is (drift < 60)
    if found is not None:
        assert found.place < start
        assert np.linalg.norm((found.estimate.T_world_camera - walk[1][9])[:3, 3]) < 0.05
        assert found.drift > LoopSettings().min_error


def test_a_place_far_away_needs_two_keyframes_that_agree_or_very_many_landmarks(walk, return_state):
    """Once the keyframe before shows another place, its landmarks confirm nothing; once many are few, they prove nothing."""
    journeyed, all_are_few = journey(walk, return_state, 30.0), LoopSettings(sure_landmarks=100_000)
    assert asked_again(walk, journeyed, 30.0, all_are_few)[0] is not None
    world = journeyed[0].map
    world.descriptors[world.keyframes[-1].landmark] ^= np.uint64(0x5A5A5A5A5A5A5A5A)
    assert asked_again(walk, journeyed, 30.0, all_are_few)[0] is None
    assert asked_again(walk, journeyed, 30.0)[0] is not None


def test_a_keyframe_that_is_at_the_place_but_looks_elsewhere_confirms_nothing(walk, return_state):
    """Turned by 0.2 rad about its own centre: where it is agrees, how it stands does not (0.1, as between runs)."""
    all_are_few = LoopSettings(sure_landmarks=100_000)
    for angle, is_found in ((0.0, True), (0.2, False)):
        journeyed = journey(walk, return_state, 30.0)
        world, turn = journeyed[0].map, np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec((0, angle, 0)).as_matrix()
        last = world.keyframes[-1]
        world.keyframes[-1] = replace(last, T_world_camera=last.T_world_camera @ turn)
        assert (asked_again(walk, journeyed, 30.0, all_are_few)[0] is not None) is is_found


def test_a_corridor_whose_parts_look_alike_is_not_closed():
    """Walls, floor and ceiling repeat every 10.24 m, and so do the pictures, to the noise."""
    tile = leaves(0)
    period, steps, laps = 0.01 * len(tile), 12, 4
    span, middle = (laps + 6) * period, laps * period / 2
    look = synthetic.Texture(texel=0.01, image=tile)
    sides = [
        synthetic.plane(2.6, span, texture=look).at(0, height, middle, turn=(np.pi / 2, 0, 0)) for height in (1.4, -1.3)
    ] + [
        synthetic.plane(span, 2.7, texture=look).at(aside, 0.05, middle, turn=(0, np.pi / 2, 0))
        for aside in (-1.3, 1.3)
    ]
    path = [synthetic.shapes.pose_at((0, 0, k * period / steps)) for k in range(laps * steps)]
    scene = synthetic.Scene(tuple(sides), np.array(path))
    sequence = synthetic.SyntheticSequence(scene, SMALL_RIG, synthetic.Faults(noise=0.01))
    first, second = (sequence[k].left.astype(float) for k in (2, 2 + steps))
    assert np.abs(first - second).mean() < 5  # grey levels: they do look alike
    odometry = StereoOdometry(SMALL_RIG, detector=DETECTOR)
    for pair in sequence:
        odometry.process(pair)
    odometry.finish()
    assert odometry.loops == 0
    assert off(odometry, sequence.truth) < 0.05
    last, features = odometry.map.keyframes[-1], DETECTOR(pair.left)
    estimate = PoseEstimate(last.T_world_camera, last.landmark, last.uv, last.disparity, np.eye(6))
    boundless = LoopSettings(drift_rate=1.0, drift_slack=1.0)  # a path may drift as far as it is long
    for loops, is_found in ((LoopSettings(), False), (boundless, True)):
        found = places(odometry, loops).detect_loop(
            build_pyramid(pair.left), estimate, features.uv, binary_descriptors(features.descriptor)
        )
        assert (found is not None) is is_found


def test_landmarks_in_one_place_become_one(there):
    world = there.map
    frame = world.keyframes[-1]
    n = len(frame.landmark)
    twin = np.arange(len(world.xyz), len(world.xyz) + n)
    again = PoseEstimate(frame.T_world_camera, twin, frame.uv + 0.2, frame.disparity, np.eye(6))
    world.xyz, world.descriptors = (
        np.concatenate([world.xyz, world.xyz[frame.landmark]]),
        np.tile(world.descriptors, (2, 1)),
    )
    world.landmark_id = np.concatenate([world.landmark_id, world.next_id + np.arange(n)])
    tracked = PoseEstimate(frame.T_world_camera, frame.landmark, frame.uv, frame.disparity, np.eye(6))
    estimate = places(there).merge_observations(again, tracked, lambda uv: np.full(len(uv), 0.3))
    known = np.isfinite(frame.disparity)
    assert np.isin(twin[known], world.keyframes[-1].landmark).all()
    assert not np.isin(frame.landmark[known], world.keyframes[-1].landmark).any()
    assert len(np.unique(estimate.landmark)) == len(estimate.landmark)


def test_a_camera_carried_away_blind_is_found_at_an_old_place(walk):
    pairs, truth = walk
    blind = [replace(pairs[0], left=0 * pairs[0].left, right=0 * pairs[0].right) for _ in range(2)]
    order = [*pairs[:30], *blind, *pairs[4:12]]
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    tracked = [odometry.process(replace(pair, stamp=float(n))) for n, pair in enumerate(order)]
    assert [n for n, one in enumerate(tracked) if one.is_lost] == [30, 31]
    assert tracked[32].is_keyframe
    for k, one in enumerate(tracked[32:]):
        np.testing.assert_allclose(one.T_world_camera[:3, 3], truth[4 + k][:3, 3], atol=0.03)


def test_two_parts_of_a_map_are_joined_when_the_camera_comes_back(walk, monkeypatch):
    pairs, truth = walk
    order = [*range(26), *range(5, 16)]
    monkeypatch.setattr(PlaceRecognition, "relocalize", lambda *_: None)
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    tracked = [odometry.process(replace(pairs[k], stamp=float(n))) for n, k in enumerate(order)]
    assert [n for n, one in enumerate(tracked) if one.is_lost] == [26, 27, 28]
    assert tracked[28].is_keyframe
    ((frame, earlier),) = odometry.mapper.closures
    assert (odometry.loops, tracked[frame].is_keyframe) == (1, True)
    assert earlier < 26 < frame
    assert not any(frame.is_start for frame in odometry.map.keyframes)
    odometry.finish()
    off = (odometry.trajectory.T_world_camera - truth[order])[:, :3, 3]
    assert np.linalg.norm(off[:26], axis=1).max() < 0.05
    assert np.linalg.norm(off[28:], axis=1).max() < 0.05
    assert np.linalg.norm(off[26:28], axis=1).max() > 5  # guesses


def test_nobody_is_recognised_where_nobody_was(walk):
    odometry = went(walk[0][:12])
    odometry.path.pose = odometry.mapper.join(odometry.path.pose)
    noise = np.random.default_rng(0).integers(0, 255, walk[0][0].left.shape[:2]).astype(np.uint8)
    features = DETECTOR(noise)
    descriptors = binary_descriptors(features.descriptor)
    assert places(odometry).relocalize(build_pyramid(noise), features.uv, descriptors) is None


def test_images_of_old_keyframes_take_bounded_memory_and_are_not_forgotten(walk):
    pairs = to_and_fro(walk, 2)[0]
    odometry = went(pairs, Tracking(map=MapSettings(image_bytes=1)))
    images, frames = odometry.map.images, odometry.map.keyframes
    assert len(frames) > 14
    assert len(images._held) == 1
    for frame in frames:
        assert np.array_equal(images.get(frame.index), grey_levels(pairs[frame.index].left))
    odometry.close()


def test_a_path_is_the_same_wherever_the_images_are(walk):
    pairs = to_and_fro(walk, 2)[0]
    inside, outside = (went(pairs, Tracking(map=MapSettings(image_bytes=room))) for room in (1e9, 0))
    assert np.array_equal(inside.trajectory.T_world_camera, outside.trajectory.T_world_camera)
    inside.close()
    outside.close()


@pytest.mark.parametrize("stop", [2 * THERE - 7, 2 * THERE + 15])
def test_going_on_from_a_state_gives_the_same_bytes(bent, stop):
    """Also where a loop is just being closed."""
    odometry, pairs, _ = bent
    pairs = pairs + [replace(pair, stamp=pair.stamp + 2 * THERE) for pair in pairs]
    for pair in pairs[THERE:stop]:
        odometry.process(pair)
    other = StereoOdometry(RIG, detector=DETECTOR)
    other.restore(odometry.state(), lambda number: pairs[number].left)
    for one in (odometry, other):
        for pair in pairs[stop : stop + 20]:
            one.process(pair)
        one.finish()
    assert np.array_equal(odometry.trajectory.T_world_camera, other.trajectory.T_world_camera)
    assert np.array_equal(odometry.map.xyz, other.map.xyz)


def test_a_state_right_after_a_bend_adjusts_the_whole_map_too(bent):
    odometry, pairs, _ = bent
    for pair in pairs[THERE:]:
        odometry.process(pair)
        if odometry.map.loop is not None and odometry.mapper.is_adjusting:
            break
    else:
        pytest.fail("no loop was closed")
    other = StereoOdometry(RIG, detector=DETECTOR)
    other.restore(odometry.state(), lambda number: pairs[number].left)
    for one in (odometry, other):
        one.finish()
    assert np.array_equal(odometry.trajectory.T_world_camera, other.trajectory.T_world_camera)
    assert inverse(odometry.trajectory.T_world_camera[0])[0, 0] == pytest.approx(1, abs=1e-6)


def test_a_state_whose_frames_hang_on_no_keyframe_is_refused(walk):
    odometry = went(walk[0][:5])
    state = odometry.state()
    state["anchors"] = state["anchors"] + 100
    with pytest.raises(InputError, match="the state does not hold together"):
        StereoOdometry(RIG, detector=DETECTOR).restore(state, lambda number: walk[0][number].left)
