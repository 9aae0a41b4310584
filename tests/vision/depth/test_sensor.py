"""Spread of depths, virtual rigs, pixels that fly, and depths moved into another camera."""

from __future__ import annotations

import numpy as np
import pytest

from tspslam.errors import InputError
from tspslam.types import Camera, FloatArray, Rig
from tspslam.vision.depth.registration import register_depth
from tspslam.vision.depth.sensor import SENSORS, DepthSensor, disparity_sigma, flying_pixels, virtual_rig
from tspslam.vision.rig import back_project, covariance

CAMERA = Rig(fx=262.5, fy=262.5, cx=159.5, cy=119.5, width=320, height=240)
DEPTH_CAMERA = Camera(fx=200, fy=200, cx=119.5, cy=89.5, width=240, height=180)
KINECT = SENSORS["structured_light"]
FINE = DepthSensor(constant=1e-4, quadratic=0.0)


def plane_depth(camera: Camera | Rig, normal: FloatArray, distance: float) -> FloatArray:
    """Depths of the plane ``normal · p = distance``."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    return np.asarray(distance / (rays @ normal))


@pytest.mark.parametrize("kind", list(SENSORS))
def test_spread_of_a_disparity_is_that_of_its_depth(kind: str) -> None:
    sensor, rig = SENSORS[kind], virtual_rig(CAMERA, SENSORS[kind])
    z = np.linspace(0.5, 8, 40)
    d = rig.fx * rig.baseline / z
    across = rig.fx * rig.baseline / (d - 1e-6) - rig.fx * rig.baseline / (d + 1e-6)
    np.testing.assert_allclose(disparity_sigma(rig, d, sensor) * across / 2e-6, sensor.sigma(z), rtol=1e-5)


def test_disparities_of_structured_light_scatter_alike_at_any_depth() -> None:
    rig = virtual_rig(CAMERA, KINECT)
    sigma = disparity_sigma(rig, np.geomspace(10, 200, 9), KINECT)
    np.testing.assert_allclose(sigma, sigma[0])


@pytest.mark.parametrize("kind", list(SENSORS))
def test_nearest_depth_is_within_the_image_and_spread_that_of_stereo_at_most(kind: str) -> None:
    sensor, rig = SENSORS[kind], virtual_rig(CAMERA, SENSORS[kind])
    assert rig.fx * rig.baseline / sensor.nearest <= 0.9 * rig.width + 1e-9
    assert 0.001 < disparity_sigma(rig, np.array([rig.fx * rig.baseline / 2.0]), sensor)[0] <= 0.3 + 1e-12


def test_steps_of_the_map_add_to_the_spread() -> None:
    rig = virtual_rig(CAMERA, FINE)
    d = np.array([rig.fx * rig.baseline / 2.0])
    alone, rounded = (disparity_sigma(rig, d, FINE, step=step)[0] for step in (0.0, 0.012))
    assert rounded**2 - alone**2 == pytest.approx(12e-6 * (d[0] / 2.0) ** 2, rel=1e-6)


@pytest.mark.parametrize(("values", "message"), [
    ({"quadratic": 0.0}, "constant, linear and quadratic are 0"),
    ({"nearest": 20.0}, "nearest is 20 m, expected less than 10 m"),
    ({"constant": -1.0}, "constant is -1.0, expected 0 to 1"),
])  # fmt: skip
def test_sensors_that_are_none_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        DepthSensor(**values)


def test_covariance_of_a_disparity_of_its_own_is_that_of_samples() -> None:
    rig, rng = Rig(500, 510, 320, 240, 0.4, 640, 480, skew=2.0), np.random.default_rng(0)
    uv, d, n = np.array([100.0, 400.0]), 80.0, 200_000
    points = back_project(rig, uv + rng.normal(size=(n, 2)) * 0.5, d + rng.normal(size=n) * 0.2)
    found = covariance(rig, uv[None], [d], 0.5, sigma_disparity=[0.2])[0]
    np.testing.assert_allclose(found, np.cov(points.T), rtol=0.03, atol=1e-7)
    with pytest.raises(InputError, match="sigma_disparity holds a value that is no spread"):
        covariance(rig, uv[None], [d], 0.5, sigma_disparity=[np.nan])


def test_depths_between_two_surfaces_fly_and_surfaces_stay() -> None:
    rng = np.random.default_rng(0)
    depth = np.where(np.arange(320) < 160, 1.5, 3.0) * np.ones((240, 1))
    mixed = np.arange(100, 140)
    depth[mixed, 160] = rng.uniform(1.9, 2.6, len(mixed))
    noisy = depth + rng.normal(size=depth.shape) * KINECT.sigma(depth)
    flies = flying_pixels(noisy, 262.5, KINECT)
    assert flies[mixed, 160].mean() > 0.95
    flies[mixed, 160] = False
    assert flies.mean() < 1e-3


@pytest.mark.parametrize("tilt", [0.0, 40.0, 70.0])
def test_no_pixel_of_a_tilted_wall_flies(tilt: float) -> None:
    angle = np.radians(tilt)
    depth = plane_depth(CAMERA, np.array([np.sin(angle), 0.0, np.cos(angle)]), 1.5 * np.cos(angle) + 0.3)
    depth = np.where((depth > 0.4) & (depth < 8), depth, np.nan)
    noisy = depth + np.random.default_rng(0).normal(size=depth.shape) * KINECT.sigma(depth)
    assert flying_pixels(noisy, 262.5, KINECT).sum() <= 0.001 * np.isfinite(depth).sum()


def test_lone_depths_fly_and_holes_do_not() -> None:
    depth = np.full((9, 9), np.nan)
    depth[4, 4] = 2.0
    assert np.argwhere(flying_pixels(depth, 262.5, KINECT)).tolist() == [[4, 4]]


def motion(degrees: float = 3.0) -> FloatArray:
    angle, T = np.radians(degrees), np.eye(4)
    T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    T[:3, 3] = 0.05, -0.01, 0.02
    return T


def test_a_plane_is_a_plane_in_another_camera() -> None:
    T, normal, distance = motion(), np.array([0.3, -0.2, 0.9]), 1.6
    depth = plane_depth(DEPTH_CAMERA, normal, distance)
    turned = T[:3, :3] @ normal
    moved = register_depth(depth, DEPTH_CAMERA, T, CAMERA, FINE)
    known = np.isfinite(moved)
    assert known.mean() > 0.7
    expected = plane_depth(CAMERA, turned, distance + turned @ T[:3, 3])
    np.testing.assert_allclose(moved[known], expected[known], rtol=1e-9)


def test_what_is_near_hides_what_is_far_and_nothing_is_drawn_between() -> None:
    depth = np.full((180, 240), 3.0)
    depth[60:120, 90:150] = 1.0
    T = np.eye(4)
    T[0, 3] = 0.1
    moved = register_depth(depth, DEPTH_CAMERA, T, CAMERA, FINE)
    known = moved[np.isfinite(moved)]
    assert np.all((np.abs(known - 1) < 1e-9) | (np.abs(known - 3) < 1e-9))
    near = np.abs(moved - 1) < 1e-9
    u = CAMERA.fx * ((np.array([90, 149]) - DEPTH_CAMERA.cx) / DEPTH_CAMERA.fx + 0.1) + CAMERA.cx
    assert np.flatnonzero(near[119])[[0, -1]].tolist() == [int(np.ceil(u[0])), int(np.floor(u[1]))]
    assert np.isnan(moved[119, int(u[0]) - 20 : int(u[0])]).any()  # behind it, seen by no ray


def test_a_lens_is_taken_out_before_depths_move() -> None:
    bent = Camera(200, 200, 119.5, 89.5, 240, 180, distortion=(0.1, -0.05, 0.001, -0.001, 0.0))
    moved = register_depth(np.full((180, 240), 2.0), bent, np.eye(4), CAMERA, FINE)
    assert np.nanmax(np.abs(moved - 2.0)) < 1e-9
    straight = register_depth(np.full((180, 240), 2.0), DEPTH_CAMERA, np.eye(4), CAMERA, FINE)
    assert not np.array_equal(np.isfinite(moved), np.isfinite(straight))


@pytest.mark.parametrize(("camera", "T", "message"), [
    (Camera(200, 200, 119.5, 89.5, 241, 180), np.eye(4), "depth map is 240 x 180 px, but its camera has 241 x 180 px"),
    (DEPTH_CAMERA, 2 * np.eye(4), "T_colour_depth is .*, expected a .4, 4. rigid motion"),
    (Camera(200, 200, 119.5, 89.5, 240, 180, (1.0, 0.5), lens="double_sphere"), np.eye(4), "its lens is double_sphere"),
])  # fmt: skip
def test_cameras_that_do_not_fit_are_refused(camera: Camera, T: FloatArray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        register_depth(np.full((180, 240), 2.0), camera, T, CAMERA, FINE)
