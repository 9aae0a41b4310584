"""Places that look alike are not one place: rooms, houses and storeys, each the same as the last to the texel."""

import numpy as np
import pytest

from tspslam.datasets import synthetic
from tspslam.datasets.synthetic import shapes
from tspslam.datasets.synthetic.texture import leaves
from tspslam.vision.features.binary import binary_descriptors
from tspslam.vision.images import build_pyramid
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.slam.places.loop_closing import PlaceRecognition
from tspslam.vision.slam.places.settings import LoopSettings
from tspslam.vision.slam.pose import PoseEstimate
from tspslam.vision.slam.tracking import TrackingSettings

from ...sequences import DETECTOR, SMALL_RIG

WALL = np.pi / 2


def look(seed, texel=0.01):
    return synthetic.Texture(seed, texel, 0.5, 0.9)


def panel(width, height, seed, place, turn=(0, 0, 0)):
    return synthetic.plane(width, height, texture=look(seed)).at(*place, turn=turn)


def chest(rng, seed, z):
    height = rng.uniform(0.5, 2)
    made = synthetic.box(rng.uniform(0.4, 1), height, rng.uniform(0.4, 0.9), texture=look(seed, 0.005))
    return made.at(rng.choice((-2, 2)), 1.4 - height / 2, z + rng.uniform(-2, 2))


def one_room(z, corridor):
    """A room of 5 m around z, the same wherever it stands, and a corridor of 4 m behind it with a look of its own."""
    rng = np.random.default_rng(0)
    yield from (chest(rng, 100 + k, z) for k in range(12))
    for side in (-1, 1):
        yield panel(5, 2.7, 10 + side, (side * 2.5, 0.05, z), (0, WALL, 0))
        yield panel(1.9, 2.7, 7, (side * 1.6, 0.05, z + 2.5))
        yield panel(5, 9, 5, (0, 0.05 + side * 1.35, z + 2), (WALL, 0, 0))
        yield panel(4, 2.7, corridor + side, (side * 0.65, 0.05, z + 4.5), (0, WALL, 0))


def rooms():
    path = [shapes.pose_at((0, 0, 0.4 * k)) for k in range(36)]
    return [*one_room(3, 50), *one_room(12, 60), panel(6, 2.7, 9, (0, 0.05, 19))], path


def one_house(z):
    for side in (-1, 1):
        yield synthetic.box(7, 6, 8, texture=look(20 + side)).at(side * 7.5, -1.35, z)
        yield synthetic.box(1.8, 1.4, 4.2, texture=look(30 + side, 0.005)).at(side * 2.8, 0.95, z + 3)
    yield panel(8, 10, 3, (0, 1.65, z), (WALL, 0, 0))


def houses():
    path = [shapes.pose_at((0, 0, 1.0 * k)) for k in range(32)]
    return [shape for k in range(-1, 8) for shape in one_house(10.0 * k)], path


def one_storey(y):
    """A round of a winding staircase: walls of ten panels, and 24 steps."""
    for k in range(10):
        a = 2 * np.pi * k / 10
        for radius, seed in ((4.6, 60), (1.6, 80)):
            width = 2 * radius * np.tan(np.pi / 10) + 0.02
            yield panel(width, 2.9, seed + k, (radius * np.cos(a), y, radius * np.sin(a)), (0, WALL - a, 0))
    for k in range(24):
        a = 2 * np.pi * (k + 0.5) / 24
        step = synthetic.box(3.0, 0.12, 1.2, texture=look(100 + k))
        yield step.at(3 * np.cos(a), y - 2.9 * (k + 0.5) / 24 + 1.5, 3 * np.sin(a), turn=(0, -a, 0))


def staircase():
    turns = [2 * np.pi * k / 32 for k in range(60)]
    path = [shapes.pose_at((3 * np.cos(a), -2.9 * a / (2 * np.pi), 3 * np.sin(a)), (0, -a, 0)) for a in turns]
    return [shape for k in range(-1, 3) for shape in one_storey(-2.9 * k)], path


@pytest.mark.parametrize(("place", "apart", "most"), [(rooms, 9.0, 0.1), (houses, 10.0, 0.2), (staircase, 2.9, 0.2)])
def test_what_looks_alike_closes_no_loop(place, apart, most):
    things, path = place()
    sequence = synthetic.SyntheticSequence(
        synthetic.Scene(tuple(things), np.array(path), background=0.9),
        SMALL_RIG,
        synthetic.Faults(noise=0.01, blur=0.5),
    )
    odometry = StereoOdometry(SMALL_RIG, detector=DETECTOR)
    tracked = [odometry.process(pair) for pair in sequence]
    assert not any(one.is_lost for one in tracked)
    assert np.linalg.norm(np.ptp(sequence.truth[:, :3, 3], axis=0)) > apart  # the second of its kind was reached
    assert odometry.loops == 0
    odometry.finish()
    off = inverse(inverse(sequence.truth[0]) @ sequence.truth) @ odometry.trajectory.T_world_camera
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < most


LENGTH, STEP = 8.0, 0.5  # m


def hall(z, walls, floor):
    """A stretch of a corridor: patterns of its left and right wall, and that of floor and ceiling."""
    middle = z + LENGTH / 2
    for side, image in zip((-1, 1), walls, strict=True):
        wall = synthetic.plane(LENGTH, 2.7, texture=synthetic.Texture(texel=0.01, image=image))
        yield wall.at(side * 1.3, 0.05, middle, turn=(0, WALL, 0))
        level = synthetic.plane(2.6, LENGTH, texture=synthetic.Texture(texel=0.01, image=floor))
        yield level.at(0, 0.05 + side * 1.35, middle, turn=(WALL, 0, 0))


@pytest.mark.parametrize("is_mirrored", [True, False])
def test_the_mirror_image_of_a_corridor_is_another_place(is_mirrored):
    """Without a bound on what the path may have drifted, the copy of a corridor is taken for it; its image is not."""
    left, right, floor, other = (leaves(k) for k in range(4))
    again = ((right, left), floor[:, ::-1].copy()) if is_mirrored else ((left, right), floor)
    between = (other, other), (other[:, ::-1] + other) / 2  # the same in a mirror
    halls = [hall(k * LENGTH, *each) for k, each in enumerate([((left, right), floor), between, again, between])]
    path = np.array([shapes.pose_at((0, 0, STEP * k)) for k in range(int(2.3 * LENGTH / STEP))])
    scene = synthetic.Scene(tuple(one for things in halls for one in things), path, background=0.9)
    sequence = synthetic.SyntheticSequence(scene, SMALL_RIG, synthetic.Faults(noise=0.01))
    first, image = (sequence[k].left.astype(float) for k in (2, 2 + int(2 * LENGTH / STEP)))
    more = round(2 * SMALL_RIG.cx) - (SMALL_RIG.width - 1)  # columns: the mirror is before the lens
    same = image[:, ::-1][:, :-more] if is_mirrored else image[:, more:]
    assert np.median(np.abs(first[:, more:] - same)) < 12  # grey levels: the two do look alike
    odometry = StereoOdometry(SMALL_RIG, detector=DETECTOR)
    tracked = [odometry.process(pair) for pair in sequence]
    assert not any(one.is_lost for one in tracked)
    assert odometry.loops == 0
    odometry.finish()
    off = inverse(inverse(sequence.truth[0]) @ sequence.truth) @ odometry.trajectory.T_world_camera
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.2
    last, pair = odometry.map.keyframes[-1], sequence[len(sequence) - 1]
    estimate = PoseEstimate(last.T_world_camera, last.landmark, last.uv, last.disparity, np.eye(6))
    boundless = PlaceRecognition(odometry.map, TrackingSettings(), LoopSettings(drift_rate=1.0, drift_slack=1.0))
    features = DETECTOR(pair.left)
    found = boundless.detect_loop(
        build_pyramid(pair.left), estimate, features.uv, binary_descriptors(features.descriptor)
    )
    assert (found is None) is is_mirrored
