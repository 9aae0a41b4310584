"""Patches are found where they went, to a few hundredths of a pixel, or said not to be found."""

import cv2
import numpy as np
import pytest

from tspslam import Rig, TrackingSettings
from tspslam.vision.images import build_pyramid
from tspslam.vision.rig import project
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.patch_tracking import aim_patches, compute_warps, track_patches

FINE, ALL = range(0, -1, -1), range(3, -1, -1)


@pytest.fixture(scope="module")
def image():
    noise = cv2.GaussianBlur(np.random.default_rng(0).standard_normal((300, 400)), (0, 0), 1.6)
    return ((noise - noise.min()) / np.ptp(noise) * 255).astype(np.uint8)


def follow(*given):
    return track_patches(*given, TrackingSettings().patch)


def moved(image, A):
    """The image under ``A @ (u, v, 1)``."""
    return cv2.warpAffine(image, A, image.shape[::-1], flags=cv2.INTER_CUBIC)


@pytest.mark.parametrize("gain", [1.0, 0.6])
@pytest.mark.parametrize("shift", [(0.3, -0.45), (2.5, 1.25), (-17.3, 11.8)])
@pytest.mark.parametrize("size", [1.0, 1.15])
def test_patches_are_found_to_a_few_hundredths_of_a_pixel(image, shift, size, gain):
    A = np.array([[size, 0.03, shift[0]], [-0.03, size, shift[1]]])
    place = np.random.default_rng(1).uniform((90, 90), (280, 190), (200, 2))
    true = place @ A[:, :2].T + A[:, 2]
    other = np.rint(moved(image, A) * gain + 20).astype(np.uint8)
    back = np.repeat(np.linalg.inv(A[:, :2])[None], len(place), axis=0)
    guess = true + np.random.default_rng(2).normal(0, 4, true.shape)
    uv, good = follow(build_pyramid(image), build_pyramid(other), place, back, guess, ALL)
    off = (uv - true)[good]
    assert good.mean() > 0.9
    assert np.abs(np.median(off, axis=0)).max() < 0.02
    assert np.median(np.linalg.norm(off, axis=1)) < 0.06


def test_what_is_not_there_is_not_found(image):
    place = np.random.default_rng(1).uniform((60, 60), (340, 240), (200, 2))
    same = np.repeat(np.eye(2)[None], len(place), axis=0)
    other = build_pyramid(np.ascontiguousarray(image[::-1, ::-1]))
    assert follow(build_pyramid(image), other, place, same, place, FINE)[1].mean() < 0.05
    black = build_pyramid(np.zeros_like(image))
    assert not follow(build_pyramid(image), black, place, same, place, ALL)[1].any()
    assert not follow(black, build_pyramid(image), place, same, place, ALL)[1].any()
    assert not follow(build_pyramid(image), build_pyramid(image), place, same, place + 1000, ALL)[1].any()
    assert not follow(build_pyramid(image), build_pyramid(image), place - 1000, same, place, ALL)[1].any()


def test_nothing_to_follow_is_fine(image):
    uv, good = follow(
        build_pyramid(image), build_pyramid(image), np.empty((0, 2)), np.empty((0, 2, 2)), np.empty((0, 2)), ALL
    )
    assert uv.shape == (0, 2)
    assert good.shape == (0,)


def test_warps_are_the_derivatives_of_projection():
    rig = Rig(fx=500, fy=430, cx=320, cy=240, baseline=0.1, width=640, height=480)
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0]
    T[:3, 3] = 0.2, -0.1, 0.6
    xyz = np.random.default_rng(0).uniform((-1, -1, 3), (1, 1, 6), (20, 3))

    def seen(uv):  # of points at the same depths
        X = np.column_stack([(uv - (320, 240)) / (500, 430), np.ones(20)]) * xyz[:, 2:]
        return project(rig, X @ T[:3, :3].T + T[:3, 3])

    uv, h = project(rig, xyz), 1e-4
    forth = np.stack([(seen(uv + step) - seen(uv - step)) / (2 * h) for step in ((h, 0), (0, h))], axis=-1)
    np.testing.assert_allclose(compute_warps(rig, T, xyz), np.linalg.inv(forth), atol=1e-6)
    np.testing.assert_allclose(
        compute_warps(rig, inverse(T) @ T, xyz), np.repeat(np.eye(2)[None], 20, axis=0), atol=1e-9
    )


def test_landmarks_are_aimed_at_where_they_project_to_and_in_view_within_the_image_and_the_limits():
    rig = Rig(fx=500, fy=430, cx=320, cy=240, baseline=0.1, width=640, height=480, skew=3.0)
    xyz = np.random.default_rng(0).uniform((-4, -4, -3), (4, 4, 9), (400, 3))
    landmark, reference, current = np.arange(399, -1, -2), np.eye(4), np.eye(4)
    current[:3, :3] = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0]
    current[:3, 3] = 0.2, -0.1, 1.5
    warp, guess, in_view = aim_patches(rig, xyz, landmark, reference, current, min_depth=0.5, max_zoom=1.6)
    there, here = xyz[landmark], (xyz[landmark] - current[:3, 3]) @ current[:3, :3]
    uv, is_near = project(rig, here), here[:, 2] > 0.5
    is_alike = (there[:, 2] < 1.6 * here[:, 2]) & (here[:, 2] < 1.6 * there[:, 2])
    with np.errstate(invalid="ignore"):
        is_inside = ((uv >= 0) & (uv <= (639, 479))).all(axis=1)
    assert in_view.tolist() == (is_near & is_alike & is_inside).tolist()
    for condition in (is_near, is_alike, is_inside):
        assert 0 < np.count_nonzero(condition) < len(condition)
    np.testing.assert_allclose(guess[is_near], uv[is_near], atol=1e-9)
    expected = compute_warps(rig, inverse(current) @ reference, there)
    np.testing.assert_allclose(warp[in_view], expected[in_view], atol=1e-9)
