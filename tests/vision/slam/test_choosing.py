"""Which pose is believed: never one that fewer landmarks tell than another that is not."""

import numpy as np

from tspslam import Rig
from tspslam.vision.slam.locating.choosing import choose_pose, choose_widest
from tspslam.vision.slam.pose import PoseEstimate
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


def test_what_is_wide_and_deep_is_the_world_and_not_what_has_more_landmarks():
    """A vehicle's rear 4 m ahead has 0.6 of the image and most landmarks; the street lies around it, near and far."""
    rig = Rig(fx=400, fy=400, cx=320, cy=240, baseline=0.2, width=640, height=480)
    rng = np.random.default_rng(0)
    uv = rng.uniform((0, 0), (640, 480), (1000, 2))
    is_rear = (abs(uv - (320, 240)) < (250, 185)).all(axis=1)
    depth = np.where(is_rear, rng.uniform(3.9, 4.1, 1000), np.exp(rng.uniform(np.log(5), np.log(40), 1000)))
    xyz = np.column_stack([(uv - (320, 240)) / 400, np.ones(1000)]) * depth[:, None]
    moved = np.eye(4)
    moved[2, 3] = 1.0
    street, rear = np.flatnonzero(~is_rear)[::2], np.flatnonzero(is_rear)
    world, car = seen(rig, xyz, street, moved), seen(rig, xyz, rear, np.eye(4))
    assert len(car) > 2.5 * len(world)
    for found in ([world, car], [car, world]):
        assert choose_widest(rig, found, xyz, TrackingSettings()) is world
