from __future__ import annotations

import io
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from tspslam import _threads
from tspslam.datasets import motorcycle_truth
from tspslam.errors import GeometryError, InputError
from tspslam.types import Features, Rig, StereoPair
from tspslam.vision.features.grid import GridDetector
from tspslam.vision.features.orb import OrbDetector
from tspslam.vision.rig import covariance, project
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.stereo import reconstruct
from tspslam.vision.stereo.descriptor_matcher import DescriptorMatcher
from tspslam.vision.stereo.matches import Matches
from tspslam.vision.stereo.reconstruct import reconstruct_with_quality
from tspslam.vision.stereo.row_matcher import RowMatcher
from tspslam.vision.stereo.sgbm import SgbmMatcher
from tspslam.vision.stereo.triangulate import triangulate

from ..conftest import noise


def errors(uv: np.ndarray, disparity: np.ndarray) -> np.ndarray:
    """Disparity minus the truth at the nearest pixel, where it is known."""
    column, row = np.rint(uv).astype(int).T
    error = disparity - motorcycle_truth()[row, column]
    return error[np.isfinite(error)]


@pytest.mark.parametrize("limit", [None, 60.0, 64.0, 128.0])
def test_motorcycle_is_reconstructed_within_a_pixel(pair: StereoPair, limit: float | None) -> None:
    cloud = reconstruct.reconstruct(pair, max_disparity=limit)
    error = np.abs(errors(cloud.uv, cloud.disparity))
    assert len(cloud) >= 1250
    assert (error <= 1).mean() >= 0.95
    assert np.median(error) <= 0.13


def test_cloud_is_consistent_with_its_rig(pair: StereoPair) -> None:
    cloud, quality = reconstruct_with_quality(pair)
    np.testing.assert_allclose(project(pair.rig, cloud.xyz), cloud.uv, atol=1e-9)
    depth = pair.rig.fx * pair.rig.baseline / (cloud.disparity + pair.rig.doffs)
    np.testing.assert_allclose(cloud.xyz[:, 2], depth)
    assert cloud.covariance is not None
    assert np.linalg.eigvalsh(cloud.covariance).min() > 0
    assert (cloud.uv >= 0).all()
    assert (cloud.uv <= (740, 499)).all()
    assert len(np.unique(np.floor(cloud.uv + 0.5), axis=0)) == len(cloud)
    assert quality.matched == len(cloud)
    assert (quality.keypoints_left, quality.keypoints_right) == (2000, 2000)
    assert 0 < quality.by_row_search < len(cloud) + 50
    assert abs(quality.vertical_offset_px) < 0.15
    assert 0 < quality.vertical_offset_std_px < 0.3


def test_result_does_not_depend_on_threads(pair: StereoPair, monkeypatch: pytest.MonkeyPatch) -> None:
    two = reconstruct.reconstruct(pair)
    monkeypatch.setattr(_threads, "_budget", 1)
    one = reconstruct.reconstruct(pair)
    for name in ("xyz", "uv", "disparity", "covariance"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()


def test_paper_preset_is_plain_hamming_up_to_48_px(pair: StereoPair) -> None:
    cloud, quality = reconstruct_with_quality(pair, preset="paper")
    assert quality.by_row_search == 0
    assert len(cloud) > 300
    assert cloud.disparity.max() <= 48
    same = reconstruct.reconstruct(pair, matcher=DescriptorMatcher(max_disparity=48))
    assert same.xyz.tobytes() == cloud.xyz.tobytes()
    assert reconstruct.reconstruct(pair, preset="paper", max_disparity=20).disparity.max() <= 20


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_every_dtype_reconstructs(pair: StereoPair, dtype: type) -> None:
    unit = 257 if dtype is np.uint16 else np.float32(1 / 255)
    left, right = ((image.mean(axis=2) * unit).astype(dtype) for image in (pair.left, pair.right))
    assert len(reconstruct.reconstruct(StereoPair(left, right, pair.rig))) > 900


def test_swapped_images_are_noticed(pair: StereoPair) -> None:
    plain = replace(pair.rig, doffs=0.0)
    for rig in (pair.rig, plain):
        with pytest.raises(GeometryError, match="look swapped"):
            reconstruct.reconstruct(StereoPair(pair.right, pair.left, rig))


@pytest.mark.parametrize("doffs", [0.0, 31.086])
@pytest.mark.parametrize("options", [{}, {"preset": "paper"}, {"matcher": SgbmMatcher()},
                                     {"detector": GridDetector(), "matcher": SgbmMatcher()},
                                     {"detector": GridDetector()}], ids=str)  # fmt: skip
def test_swapped_images_are_noticed_by_every_matcher(motorcycle: StereoPair, options: Any, doffs: float) -> None:
    rig = replace(motorcycle.rig, doffs=doffs)
    with pytest.raises(GeometryError, match=r"disparities are negative.*left and right images look swapped"):
        reconstruct_with_quality(StereoPair(motorcycle.right, motorcycle.left, rig), **options)


@pytest.mark.parametrize("doffs", [0.0, 31.086])
def test_one_picture_twice_is_refused(pair: StereoPair, doffs: float) -> None:
    twice = replace(pair, right=pair.left.copy(), rig=replace(pair.rig, doffs=doffs))
    for options in ({}, {"preset": "paper"}, {"detector": GridDetector()}):
        with pytest.raises(GeometryError, match=r"^motorcycle: left and right show the same picture, expected two"):
            reconstruct_with_quality(twice, **options)  # type: ignore[arg-type]
    with pytest.raises(GeometryError, match="show the same picture"):
        StereoOdometry(twice.rig).process(twice)


@pytest.mark.parametrize("doffs", [0.0, 31.086])
@pytest.mark.parametrize("stored", [("JPEG", 95), ("JPEG", 40), ("WEBP", 60)])
def test_one_picture_stored_twice_is_refused(motorcycle: StereoPair, stored: tuple[str, int], doffs: float) -> None:
    buffer = io.BytesIO()
    PillowImage.fromarray(motorcycle.left).save(buffer, stored[0], quality=stored[1])
    again = np.asarray(PillowImage.open(buffer).convert("RGB"))
    with pytest.raises(GeometryError, match=r"show the same picture.* 95 % have disparities within"):
        reconstruct_with_quality(replace(motorcycle, right=again, rig=replace(motorcycle.rig, doffs=doffs)))


@pytest.mark.parametrize(("doffs", "shift"), [(0.0, 0.3), (31.086, 0.3), (31.086, -0.3), (31.086, 0.15)])
def test_two_views_of_a_distant_or_flat_scene_are_not_one_picture(
    motorcycle: StereoPair, doffs: float, shift: float
) -> None:
    rng = np.random.default_rng(0)
    left = cv2.cvtColor(motorcycle.left, cv2.COLOR_RGB2GRAY).astype(np.float32)
    move = np.array([[1, 0, -shift], [0, 1, 0]])
    right = cv2.warpAffine(left, move, left.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    taken = [np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8) for image in (left, right)]
    cloud, _ = reconstruct_with_quality(StereoPair(*taken, replace(motorcycle.rig, doffs=doffs)))
    assert np.median(cloud.disparity) == pytest.approx(shift, abs=0.06)


def test_textureless_pairs_are_refused_with_numbers(plain_rig: Rig) -> None:
    flat = np.full((120, 160), 70, np.uint8)
    with pytest.raises(GeometryError, match="0 left and 0 right keypoints, expected at least 3"):
        reconstruct.reconstruct(StereoPair(flat, flat, plain_rig))


def test_unrelated_images_are_refused_with_numbers(plain_rig: Rig) -> None:
    with pytest.raises(GeometryError, match=r"\d points from \d+ left and \d+ right keypoints and \d matches"):
        reconstruct.reconstruct(StereoPair(noise(seed=1), noise(seed=2), plain_rig))


def test_contradicting_options_are_refused(pair: StereoPair) -> None:
    with pytest.raises(InputError, match="preset is 'fast', expected 'paper'"):
        reconstruct.reconstruct(pair, preset="fast")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="the one or the other"):
        reconstruct.reconstruct(pair, matcher=RowMatcher(), max_disparity=10)
    with pytest.raises(InputError, match="the one or the other"):
        reconstruct.reconstruct(pair, matcher=RowMatcher(), preset="paper")


def test_user_functions_can_stand_in_for_both_stages(pair: StereoPair) -> None:
    def match(left: Features, right: Features, pair: StereoPair) -> Matches:
        index = np.arange(5)
        return Matches(index, index, np.arange(5) + 10.0, np.ones(5))

    cloud = reconstruct.reconstruct(pair, detector=lambda grey: OrbDetector(count=5)(grey), matcher=match)
    np.testing.assert_array_equal(cloud.disparity, np.arange(5) + 10)


def points(uv: list[list[float]], scale: list[float]) -> Features:
    nothing = np.zeros(len(uv), np.float32)
    return Features(
        np.array(uv), np.zeros((len(uv), 32), np.uint8), nothing, np.array(scale, np.float32), nothing
    )  # fmt: skip


def test_triangulation_drops_bad_depths_outsiders_and_duplicates(plain_rig: Rig) -> None:
    features = points([[10, 10], [10.2, 10.3], [20, 20], [30, 30], [159.2, 5]], [1, 2, 1, 1, 1])
    matches = Matches(np.arange(5), np.arange(5), np.array([5, 5, 0, 5.0, 5]), np.array([0.8, 0.9, 1, 0.7, 1]))
    cloud = triangulate(plain_rig, features, matches)
    np.testing.assert_array_equal(cloud.uv, [[10.2, 10.3], [30, 30]])
    np.testing.assert_allclose(cloud.covariance, covariance(plain_rig, cloud.uv, [5, 5], [1.0, 0.5]))


def test_triangulating_nothing_gives_an_empty_cloud(plain_rig: Rig) -> None:
    none = np.zeros(0, np.int64)
    cloud = triangulate(plain_rig, points([[1, 1]], [1]), Matches(none, none, np.zeros(0), np.zeros(0)))
    assert len(cloud) == 0
    assert cloud.xyz.shape == (0, 3)
