"""Which pose is believed: never one that fewer landmarks tell than another that is not."""

import numpy as np
from scipy.spatial.transform import Rotation

from tspslam import Rig
from tspslam.vision.slam.locating.choosing import choose_pose, choose_widest, with_rival, with_unknown
from tspslam.vision.slam.locating.uncertainty import adjoint, rival_spread
from tspslam.vision.slam.pose import PoseEstimate, Rival
from tspslam.vision.slam.tracking import TrackingSettings

XYZ = np.random.default_rng(0).uniform((-5, -2, 5), (5, 2, 20), (2000, 3))


def pose(count, in_view, x=0.0):
    T = np.eye(4)
    T[0, 3] = x
    nothing = np.full(count, np.nan)
    return PoseEstimate(T, np.arange(count), np.zeros((count, 2)), nothing, np.eye(6), in_view)


def test_descriptors_that_lead_elsewhere_to_fewer_landmarks_than_were_found_near_the_guess_are_not_believed():
    """Seen on a flight through a room: 61 of 400 five metres away, where 159 of 1455 were found at the right place."""
    settings = TrackingSettings()
    assert choose_pose(pose(159, 1455), pose(61, 400, 5.0), XYZ, settings) is None
    assert len(choose_pose(None, pose(61, 400, 5.0), XYZ, settings)) == 61
    assert len(choose_pose(pose(159, 1455), pose(200, 400, 5.0), XYZ, settings)) == 200
    assert len(choose_pose(pose(159, 1455), pose(61, 400), XYZ, settings)) == 159  # they say the same
    assert len(choose_pose(pose(300, 1455), pose(200, 400, 5.0), XYZ, settings)) == 300


def seen(rig, xyz, rows, T):
    """The pose of a camera at T that sees some landmarks where they are."""
    x, y, z = ((xyz[rows] - T[:3, 3]) @ T[:3, :3]).T
    uv = np.column_stack([rig.cx + rig.fx * x / z, rig.cy + rig.fy * y / z])
    return PoseEstimate(T, rows, uv, np.full(len(rows), np.nan), np.eye(6), in_view=len(xyz))


def behind_a_rear(half=(250, 185)):
    """A vehicle's rear 4 m ahead, and the street around it, near and far: the poses that each says, and landmarks."""
    rig = Rig(fx=400, fy=400, cx=320, cy=240, baseline=0.2, width=640, height=480)
    rng = np.random.default_rng(0)
    uv = rng.uniform((0, 0), (640, 480), (1000, 2))
    is_rear = (abs(uv - (320, 240)) < half).all(axis=1)
    depth = np.where(is_rear, rng.uniform(3.9, 4.1, 1000), np.exp(rng.uniform(np.log(5), np.log(40), 1000)))
    xyz = np.column_stack([(uv - (320, 240)) / 400, np.ones(1000)]) * depth[:, None]
    moved = np.eye(4)
    moved[2, 3] = 1.0
    street, rear = np.flatnonzero(~is_rear)[::2], np.flatnonzero(is_rear)
    return rig, xyz, seen(rig, xyz, street, moved), seen(rig, xyz, rear, np.eye(4))


def test_what_is_wide_and_deep_is_the_world_and_not_what_has_more_landmarks():
    """The rear has 0.6 of the image and most landmarks: there is no doubt."""
    rig, xyz, world, car = behind_a_rear()
    assert len(car) > 2.5 * len(world)
    for found in ([world, car], [car, world]):
        assert choose_widest(rig, found, xyz, TrackingSettings()) is world


def halves():
    """The left half of the image has moved ahead, the right one to the side, near and far alike: each as its pose."""
    rig, rng = Rig(fx=400, fy=400, cx=320, cy=240, baseline=0.2, width=640, height=480), np.random.default_rng(0)
    uv, depth = rng.uniform((0, 0), (640, 480), (1000, 2)), rng.uniform(4, 12, 1000)
    xyz = np.column_stack([(uv - (320, 240)) / 400, np.ones(1000)]) * depth[:, None]
    ahead, aside = np.eye(4), np.eye(4)
    ahead[2, 3] = aside[0, 3] = 1.0
    is_left = uv[:, 0] < 320
    rows = [np.flatnonzero(is_left), np.flatnonzero(~is_left)]
    return rig, xyz, [seen(rig, xyz, some, T) for some, T in zip(rows, (ahead, aside), strict=True)]


def test_another_pose_that_is_about_as_likely_stays_beside_the_one_that_is_believed():
    """One half of the image moves ahead, the other one to the side, near and far alike: each is the other's rival."""
    rig, xyz, (left, right) = halves()
    for one, other in ((left, right), (right, left)):
        rival = with_rival(rig, one, [one, other], xyz, TrackingSettings()).rival
        assert rival.T_world_camera is other.T_world_camera
        assert rival.landmarks == len(other)
        assert 0.25 < rival.probability < 0.75
    assert choose_widest(rig, [left, right], xyz, TrackingSettings()).rival is not None
    few = seen(rig, xyz, left.landmark[:90], left.T_world_camera)  # 0.09 of those in view are no pose
    assert with_rival(rig, right, [few, right], xyz, TrackingSettings()) is right


def test_parts_of_the_image_that_nothing_agrees_with_leave_a_pose_open_where_they_are_wide_and_deep():
    """Behind a rear that fills the view the street does not agree with the pose that the rear tells."""
    rig, xyz, _, car = behind_a_rear((240, 160))
    all_, settings = np.arange(len(xyz)), TrackingSettings()
    rival = with_unknown(rig, car, all_, xyz, settings).rival
    assert 0.2 < rival.probability < 1
    assert rival.landmarks > 100
    assert 0.5 < np.sqrt(rival.covariance[5, 5]) < 10  # m: a quarter of how far away these are
    assert rival.covariance[0, 0] == 0.05**2
    assert with_unknown(rig, car, car.landmark, xyz, settings) is car  # nothing else was looked for
    world = seen(rig, xyz, all_, np.eye(4))
    assert with_unknown(rig, world, all_, xyz, settings) is world
    rng = np.random.default_rng(0)
    by_chance = seen(rig, xyz, np.flatnonzero(rng.random(len(xyz)) < 0.6), np.eye(4))
    assert with_unknown(rig, by_chance, all_, xyz, settings) is by_chance  # a long step, or blur: some everywhere


def test_a_pose_that_other_landmarks_tell_is_not_doubted_by_those_that_were_not_looked_for_from_it():
    """One that older keyframes led to shares some landmarks with the last ones, or none; or all, at the rim."""
    rig, xyz, _, car = behind_a_rear((240, 160))
    all_, settings = np.arange(len(xyz)), TrackingSettings()
    for known in (car.landmark[::2], car.landmark):
        assert with_unknown(rig, car, np.setdiff1d(all_, known), xyz, settings) is car
    rim = np.flatnonzero(xyz[:, 0] / xyz[:, 2] < (settings.patch_radius - rig.cx) / rig.fx)
    assert len(rim) > 5
    at_rim = seen(rig, xyz, rim, np.eye(4))
    assert with_unknown(rig, at_rim, all_, xyz, settings) is at_rim


def test_a_thing_that_moves_within_the_view_does_not_leave_the_pose_of_the_world_open():
    """A fifth of the image, and flat, beside what is deep."""
    rig, xyz, _, _ = behind_a_rear()
    uv = xyz[:, :2] / xyz[:, 2:] * 400 + (320, 240)
    is_thing = (abs(uv - (200, 240)) < (130, 130)).all(axis=1)
    depth = np.where(is_thing, 4.0, np.exp(np.random.default_rng(1).uniform(np.log(5), np.log(40), len(xyz))))
    xyz = xyz * (depth / xyz[:, 2])[:, None]
    world = seen(rig, xyz, np.flatnonzero(~is_thing), np.eye(4))
    assert is_thing.mean() > 0.15
    assert with_unknown(rig, world, np.arange(len(xyz)), xyz, TrackingSettings()) is world


def test_a_rival_widens_the_covariance_along_the_way_to_it_by_its_probability():
    T, apart, C = np.eye(4), np.eye(4), np.diag([1e-6] * 3 + [1e-4] * 3)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.1, 0.4, 0]).as_matrix(), (1, 2, 3)
    xi = np.array([0, 0.02, 0, 0, 0, 1.5])
    apart[:3, :3], apart[:3, 3] = Rotation.from_rotvec(xi[:3]).as_matrix(), xi[3:]
    spread = rival_spread(T, Rival(T @ apart, 100, 0.25, 0 * C))
    np.testing.assert_allclose(spread, 0.25 * np.outer(xi, xi), atol=1e-12)
    wide = rival_spread(T, Rival(T @ apart, 100, 0.25, C)) - spread
    A = adjoint(apart)
    np.testing.assert_allclose(wide, 0.25 * A @ C @ A.T, atol=1e-12)
    # if the other one is right, the error is xi: one in p, for its one degree of freedom
    assert abs(xi @ np.linalg.solve(spread + 1e-9 * np.eye(6), xi) - 1 / 0.25) < 0.01
