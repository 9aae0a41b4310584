from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tspslam.datasets import motorcycle_truth
from tspslam.errors import GeometryError, InputError
from tspslam.types import Rig, StereoPair
from tspslam.vision.features.grid import GridDetector
from tspslam.vision.rig import project
from tspslam.vision.stereo.dense import cloud_from_depth, cloud_from_disparity, disparity_of_depth, sample_map
from tspslam.vision.stereo.reconstruct import reconstruct, reconstruct_with_quality
from tspslam.vision.stereo.sgbm import SgbmMatcher

from ..conftest import noise

RIG = Rig(fx=100, fy=110, cx=30, cy=20, baseline=0.2, width=64, height=48, skew=0.5, doffs=3.0)
UV = np.array([[3.25, 4.5], [10, 20], [40.75, 30.125]])


def ramp() -> np.ndarray:
    v, u = np.mgrid[:48, :64]
    return 5 + 0.1 * u + 0.05 * v


def test_a_plane_is_sampled_between_its_pixels() -> None:
    assert np.abs(sample_map(ramp(), UV) - (5 + 0.1 * UV[:, 0] + 0.05 * UV[:, 1])).max() < 1e-12
    corner = np.array([[0, 0], [63, 47]])
    np.testing.assert_allclose(sample_map(ramp(), corner), [5, 5 + 6.3 + 2.35])


def test_nothing_is_interpolated_across_an_edge_or_into_a_hole() -> None:
    step = np.where(np.arange(64) < 32, 5.0, 20.0) * np.ones((48, 1))
    assert set(sample_map(step, np.column_stack([np.linspace(30, 33, 40), np.full(40, 7.3)]))) == {5.0, 20.0}
    step[:, 31:33] = np.nan
    found = sample_map(step, np.array([[31.4, 3.0], [30.4, 3], [30.6, 3]]))
    np.testing.assert_array_equal(found, [np.nan, 5, np.nan])


def test_depth_and_disparity_maps_give_the_same_cloud() -> None:
    z = RIG.fx * RIG.baseline / (ramp() + RIG.doffs)
    one, other = cloud_from_disparity(RIG, ramp(), UV), cloud_from_depth(RIG, z, UV)
    np.testing.assert_allclose(project(RIG, one.xyz), UV)
    np.testing.assert_allclose(one.xyz, other.xyz, rtol=1e-3)
    np.testing.assert_allclose(disparity_of_depth(RIG, z), ramp())
    millimetres = np.rint(z * 1000).astype(np.uint16)
    np.testing.assert_allclose(cloud_from_depth(RIG, millimetres, UV, unit=0.001).xyz, one.xyz, rtol=1e-2)


def test_holes_are_dropped_and_the_rest_keeps_its_order() -> None:
    holes = ramp()
    holes[18:23, 8:13] = [[np.nan], [np.inf], [-3.0], [-9.0], [np.nan]]
    cloud = cloud_from_disparity(RIG, holes, UV, sigma=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(cloud.uv, UV[[0, 2]])
    unit = cloud_from_disparity(RIG, holes, UV, sigma=1.0)
    assert cloud.covariance is not None
    assert unit.covariance is not None
    np.testing.assert_allclose(
        cloud.covariance / unit.covariance, np.array([1.0, 9.0])[:, None, None] * np.ones((3, 3))
    )


def test_a_pair_with_a_map_is_sampled_at_its_keypoints(pair: StereoPair) -> None:
    truth = motorcycle_truth()
    mapped = replace(pair, disparity=truth)
    cloud, quality = reconstruct_with_quality(mapped)
    assert len(cloud) > 1500
    assert quality.matched == len(cloud)
    pixel = np.rint(cloud.uv).astype(int)
    error = np.abs(cloud.disparity - truth[pixel[:, 1], pixel[:, 0]])
    assert np.nanpercentile(error, 99) < 1
    grid = reconstruct(mapped, detector=GridDetector(step=20))
    assert len(grid) > 700
    assert set(np.diff(np.unique(grid.uv[:, 0]))) == {20}


def test_a_map_that_knows_too_little_is_named_with_the_pair(pair: StereoPair) -> None:
    few = np.full((500, 741), np.nan)
    with pytest.raises(GeometryError, match="motorcycle: the map knows the disparity of none of 2000 places, expected"):
        reconstruct(replace(pair, disparity=few))
    few[250, 300] = 30.0
    grid = GridDetector(step=10)
    uv = grid(np.zeros((500, 741), np.uint8)).uv.astype(int)
    few[uv[:2, 1], uv[:2, 0]] = 30.0
    with pytest.raises(GeometryError, match="motorcycle: 2 places of the map are known, expected at least 3"):
        reconstruct(replace(pair, disparity=few), detector=grid)


@pytest.mark.parametrize("block", [3, 7])
def test_block_matching_is_right_on_motorcycle(pair: StereoPair, block: int) -> None:
    truth = motorcycle_truth()
    cloud = reconstruct(pair, matcher=SgbmMatcher(block=block))
    pixel = np.rint(cloud.uv).astype(int)
    error = np.abs(cloud.disparity - truth[pixel[:, 1], pixel[:, 0]])
    assert len(cloud) > 1300
    assert np.nanmean(error[np.isfinite(error)] < 1) > 0.85


@pytest.mark.parametrize("low", [-3000.0, -1000.0, -500.0])
def test_block_matching_knows_no_disparity_beyond_its_limits(pair: StereoPair, low: float) -> None:
    found = SgbmMatcher().disparity_map(pair, low, 70)
    assert not (found < -740).any()
    cloud = reconstruct(pair, matcher=SgbmMatcher(min_disparity=low, max_disparity=70), detector=GridDetector(step=25))
    assert len(cloud) > 300


@pytest.mark.parametrize("shape", [(1, 50), (24, 100), (12, 12)])
def test_block_matching_of_a_tiny_pair_knows_nothing(shape: tuple[int, int]) -> None:
    rig = Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=shape[1], height=shape[0])
    tiny = StereoPair(noise(*shape), noise(*shape, seed=1), rig)
    assert np.isnan(SgbmMatcher(block=15).disparity_map(tiny, 30, 90)).all()
    with pytest.raises(GeometryError, match="expected at least 3"):
        reconstruct(tiny, matcher=SgbmMatcher(block=15), detector=GridDetector(step=5))


def test_block_matching_on_a_grid_needs_no_descriptors(pair: StereoPair) -> None:
    cloud = reconstruct(pair, matcher=SgbmMatcher(max_disparity=70), detector=GridDetector(step=25))
    assert len(cloud) > 300


@pytest.mark.parametrize(("function", "arguments", "message"), [
    (cloud_from_disparity, (np.ones((48, 63)), UV), "disparity map is 63 x 48, expected 64 x 48 px"),
    (cloud_from_disparity, (np.ones((48, 64), int), UV), "disparity map is int64, expected floats"),
    (cloud_from_disparity, (ramp(), UV[:, :1]), r"uv has shape \(3, 1\)"),
    (cloud_from_disparity, (ramp(), [[64.0, 3]]), "uv holds places outside of 64 x 48 px"),
    (cloud_from_disparity, (ramp(), [[np.nan, 3]]), "uv holds places outside"),
    (cloud_from_disparity, (np.full((48, 64), 1e30), UV), "median of 1e\\+30 px, expected at most the width, 64 px"),
    (cloud_from_disparity, (np.full((48, 64), -20.0), UV), "none of 3 places .values are negative: left and right"),
    (cloud_from_depth, (np.ones((48, 64), np.uint16), UV), "uint16 without a unit"),
    (cloud_from_depth, (np.full((48, 64), 2400.0), UV), "median of 2400 m, expected metres; unit=0.001"),
    (cloud_from_depth, (np.ones((10, 10)), UV), "depth map is 10 x 10"),
])  # fmt: skip
def test_maps_that_do_not_fit_are_named(function, arguments, message) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=message):
        function(RIG, *arguments)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"uv": [[1, 2], [3]]}, "uv has rows of different lengths"),
    ({"uv": [["a", "b"]]}, "uv is <U1, expected numbers"),
    ({"disparity": [[1.0], [2.0, 3.0]]}, "disparity map has rows of different lengths"),
    ({"sigma": [1.0, 2.0]}, r"sigma is float64 of shape \(2,\), expected one number or 3"),
    ({"disparity": np.full((48, 64), np.longdouble("1e4000"))}, "none of 3 places"),
])  # fmt: skip
def test_odd_arrays_are_named(arguments: dict[str, object], message: str) -> None:
    given = {"disparity": ramp(), "uv": UV} | arguments
    with pytest.raises(InputError, match=message):
        cloud_from_disparity(RIG, **given)  # type: ignore[arg-type]


@pytest.mark.parametrize("unit", [0.0, -1.0, np.nan, "mm", 10**400])
def test_a_unit_is_positive(unit: float) -> None:
    with pytest.raises(InputError, match="unit is"):
        cloud_from_depth(RIG, np.ones((48, 64)), UV, unit=unit)


@pytest.mark.parametrize("empty", [0.0, np.nan, np.inf])
def test_a_map_without_values_is_named(empty: float) -> None:
    with pytest.raises(GeometryError, match="disparity of none of 3 places"):
        cloud_from_depth(RIG, np.full((48, 64), empty), UV)


@pytest.mark.parametrize(("kind", "setting", "message"), [
    (GridDetector, {"step": 0}, "grid: step is 0"), (SgbmMatcher, {"block": 4}, "block is 4, expected an odd"),
    (SgbmMatcher, {"block": 17}, "sgbm: block is 17, expected 1 to 15"),
    (GridDetector, {"step": 2.5}, "grid: step is 2.5, expected an integer"),
    (SgbmMatcher, {"min_disparity": -1e12}, "min_disparity is -1000000000000.0, expected -100000 to 100000"),
    (SgbmMatcher, {"uniqueness": 101}, "sgbm: uniqueness is 101, expected 0 to 100"),
    (SgbmMatcher, {"min_disparity": 9.0, "max_disparity": 3.0}, "expected at most max_disparity"),
])  # fmt: skip
def test_settings_out_of_range_are_named(kind: type, setting: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        kind(**setting)


def test_the_grid_has_equal_margins() -> None:
    uv = GridDetector(step=10)(noise(48, 64)).uv
    assert (uv.min(axis=0).tolist(), uv.max(axis=0).tolist()) == ([1, 3], [61, 43])


def test_the_largest_of_a_type_of_whole_numbers_is_no_depth() -> None:
    rig = Rig(fx=500, fy=500, cx=1, cy=0, baseline=0.1, width=3, height=1)
    disparity = disparity_of_depth(rig, np.array([[2000, 0, 65_535]], np.uint16), unit=0.001)
    np.testing.assert_array_equal(disparity, [[25.0, np.nan, np.nan]])
