from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from skimage import data

from tspslam.errors import InputError
from tspslam.types import Features, Rig, StereoPair
from tspslam.vision.features.orb import OrbDetector
from tspslam.vision.images import grey_levels, smooth_plane
from tspslam.vision.stereo.descriptor_matcher import (
    DescriptorMatcher,
    median_and_spread,
    survey_disparities,
    widest_range,
)
from tspslam.vision.stereo.matches import find_supported
from tspslam.vision.stereo.patches import Patches, measure_vertical_offsets, refine, search, shift_rows
from tspslam.vision.stereo.row_matcher import RowMatcher

from ..conftest import noise
from .shifts import pair_with_disparity

DETECT = OrbDetector(count=600)


def detect(pair: StereoPair) -> tuple[Features, Features]:
    return DETECT(grey_levels(pair.left)), DETECT(grey_levels(pair.right))


def features_at(uv: np.ndarray, descriptor: np.ndarray) -> Features:
    ones = np.ones(len(uv), np.float32)
    return Features(np.asarray(uv, np.float64), descriptor, ones, ones, ones)


def blank_pair(height: int, width: int) -> StereoPair:
    rig = Rig(fx=100, fy=100, cx=0, cy=0, baseline=0.1, width=width, height=height)
    return StereoPair(np.zeros((height, width), np.uint8), np.zeros((height, width), np.uint8), rig)


def plain_nearest(left: Features, right: Features, low: float, high: float) -> set[tuple[int, int]]:
    """Mutual nearest neighbours within 45 bits on rows at most 1.5 px apart, one pair at a time."""
    bits = {}
    for i, j in itertools.product(range(len(left.uv)), range(len(right.uv))):
        disparity, rows = left.uv[i] - right.uv[j]
        if low <= disparity <= high and abs(rows) <= 1.5:
            bits[i, j] = int(np.unpackbits(left.descriptor[i] ^ right.descriptor[j]).sum())
    best = [min((k for k in bits if k[side] == n), key=bits.get, default=None) for side in (0, 1) for n in range(80)]
    return {k for k in bits if best.count(k) == 2 and bits[k] <= 45}


def test_descriptor_matches_are_the_mutual_nearest_of_exhaustive_search() -> None:
    rng = np.random.default_rng(3)
    uv = np.column_stack([rng.permutation(80) * 2, rng.uniform(0, 60, 80)])
    words = rng.integers(0, 256, (80, 32), np.uint8)
    changed = words ^ (rng.random((80, 32)) < 0.15)
    order = rng.permutation(80)
    left = features_at(uv, words)
    right = features_at((uv - (7, 0) + rng.normal(0, 0.8, (80, 2)))[order], changed[order].astype(np.uint8))
    i, j = DescriptorMatcher(max_hamming=45, ratio=1.0).pairs(left, right, 60, 0, 30)
    assert set(zip(i.tolist(), j.tolist(), strict=True)) == plain_nearest(left, right, 0, 30)
    assert len(i) > 40


def test_real_descriptors_match_by_their_euclidean_distance() -> None:
    rng = np.random.default_rng(4)
    uv = np.column_stack([rng.permutation(60) * 2.0, rng.integers(0, 40, 60)])
    values = rng.normal(size=(60, 16)).astype(np.float32)
    order = rng.permutation(60)
    left = features_at(uv, values)
    right = features_at((uv - (6, 0))[order], (values + rng.normal(0, 0.1, (60, 16)).astype(np.float32))[order])
    i, j = DescriptorMatcher(ratio=1.0).pairs(left, right, 40, 0, 30)
    assert np.array_equal(order[j], i)
    assert len(i) == 60
    assert len(DescriptorMatcher(max_l2=0.01).pairs(left, right, 40, 0, 30)[0]) == 0
    matches = DescriptorMatcher(ratio=1.0)(left, right, blank_pair(40, 200))
    assert 0.8 < matches.score.min() < matches.score.max() < 1


def test_ambiguous_descriptors_do_not_match() -> None:
    word = np.zeros((1, 32), np.uint8)
    left, right = features_at([[50.0, 5]], word), features_at([[40.0, 5], [30.0, 5]], np.repeat(word, 2, axis=0))
    assert len(DescriptorMatcher().pairs(left, right, 10, 0, 60)[0]) == 0
    alone = features_at([[40.0, 5]], word)
    assert len(DescriptorMatcher().pairs(left, alone, 10, 0, 60)[0]) == 1


def test_descriptors_of_other_kinds_are_refused(pair: StereoPair) -> None:
    uv = np.array([[50.0, 5]])
    binary, real = features_at(uv, np.zeros((1, 32), np.uint8)), features_at(uv, np.zeros((1, 32), np.float32))
    whole = features_at(uv, np.zeros((1, 32), np.int64))
    with pytest.raises(InputError, match=r"int64 of shape \(32,\), expected rows of uint8 or float32"):
        DescriptorMatcher()(whole, whole, pair)
    none = features_at(uv, np.zeros((1, 0), np.uint8))
    with pytest.raises(InputError, match="keypoints have no descriptors"):
        DescriptorMatcher()(none, none, pair)
    with pytest.raises(InputError, match=r"uint8 of shape \(32,\) on the left and float32"):
        DescriptorMatcher()(binary, real, pair)
    with pytest.raises(InputError, match=r"\(32,\) on the left and uint8 of shape \(16,\) on the right"):
        DescriptorMatcher()(binary, features_at(uv, np.zeros((1, 16), np.uint8)), pair)


def test_survey_finds_the_range_of_disparities(pair: StereoPair) -> None:
    (low, high), i, _ = survey_disparities(DescriptorMatcher(), *detect(pair), pair)
    assert -5 < low < 8
    assert 60 < high < 75
    assert len(i) > 100


def test_survey_stays_within_the_limits_given(pair: StereoPair) -> None:
    (low, high), _, _ = survey_disparities(DescriptorMatcher(20.0, 10.0), *detect(pair), pair)
    assert 10 <= low < high <= 20


@pytest.mark.parametrize("disparity", np.round(np.arange(4, 5, 0.1), 1))
def test_disparity_is_unbiased_on_fractional_shifts(disparity: float) -> None:
    pair = pair_with_disparity(grey_levels(data.stereo_motorcycle()[0]), float(disparity), reduce=2)
    matches = RowMatcher()(*detect(pair), pair)
    error = matches.disparity - disparity
    assert len(matches) > 250
    assert abs(error.mean()) <= 0.012
    assert error.std() <= 0.1
    assert abs(matches.vertical_offset_px) <= 0.01


@pytest.mark.parametrize("rows", [1, -3])
def test_vertical_offset_is_measured_and_does_not_disturb_disparities(rows: int) -> None:
    pair = pair_with_disparity(grey_levels(data.stereo_motorcycle()[0]), 4.3, reduce=2, rows=rows)
    matches = RowMatcher()(*detect(pair), pair)
    assert abs(matches.vertical_offset_px - rows / 2) <= 0.02
    assert matches.vertical_offset_std_px <= 0.1
    assert len(matches) > 250
    assert abs(np.mean(matches.disparity) - 4.3) <= 0.02


def test_brightness_and_contrast_do_not_matter(pair: StereoPair) -> None:
    plain = RowMatcher()(*detect(pair), pair)
    dim = StereoPair(pair.left, np.rint(0.7 * pair.right + 10).astype(np.uint8), pair.rig)
    matches = RowMatcher()(*detect(dim), dim)
    assert len(matches) > 0.8 * len(plain)


def test_row_search_finds_what_has_no_keypoint_on_the_right(pair: StereoPair) -> None:
    left, right = detect(pair)
    matches = RowMatcher(max_disparity=64, min_disparity=0)(left, right, pair)
    assert (matches.right_index < 0).sum() > 50
    half = Features(*(getattr(right, name)[::2] for name in ("uv", "descriptor", "score", "scale", "angle")))
    assert len(RowMatcher()(left, half, pair)) > 0.9 * len(matches)


def test_matches_obey_the_limits(pair: StereoPair) -> None:
    for matcher in (RowMatcher(max_disparity=30, min_disparity=12), DescriptorMatcher(30.0, 12.0)):
        disparity = matcher(*detect(pair), pair).disparity
        assert len(disparity) > 20
        assert disparity.min() >= 12
        assert disparity.max() <= 30


@pytest.mark.parametrize("matcher", [RowMatcher(), DescriptorMatcher()])
def test_matches_keep_to_the_range_that_the_pair_knows(
    pair: StereoPair, matcher: RowMatcher | DescriptorMatcher
) -> None:
    known = replace(pair, disparity_range=(12.0, 30.0))
    every, inside = (matcher(*detect(pair), each).disparity for each in (pair, known))
    assert every.min() < 12 < 30 < every.max()
    assert len(inside) > 20
    assert 12 <= inside.min() < inside.max() <= 30


def test_limits_of_the_matcher_go_before_the_range_of_the_pair(pair: StereoPair) -> None:
    known = replace(pair, disparity_range=(12.0, 30.0))
    assert widest_range(known, 5.0, 60.0) == (5, 60)
    assert widest_range(known, None, 60.0) == (12, 60)
    assert widest_range(known, 5.0, None) == (5, 30)
    assert widest_range(known, 40.0, None) == (40, 40 + widest_range(pair, 0.0, None)[1])
    assert widest_range(replace(known, disparity_range=(-500.0, 30.0)), None, None) == (-pair.rig.doffs, 30)


def test_search_finds_whole_shifts_in_both_directions() -> None:
    image = noise().astype(np.float32)
    moved = np.roll(image, -9, axis=1)
    uv = np.array([[60.0, 50.0], [90.4, 70.0], [3.0, 3.0], [80.0, 119.0]])
    ranges = np.array([[0.0] * 4, [30.0] * 4])
    disparity, score, rival = search(image, moved, uv, ranges, Patches())
    np.testing.assert_array_equal(disparity[:2], 9)
    assert (score[:2] > 0.99).all()
    assert (rival[:2] < 0.9).all()
    np.testing.assert_array_equal(score[2:], -1)
    back, _, _ = search(moved, image, uv[:2] - (9, 0), -ranges[::-1, :2], Patches())
    np.testing.assert_array_equal(back, -9)


def test_search_reports_the_window_correlation() -> None:
    image, other = noise(seed=1).astype(np.float32), noise(seed=2).astype(np.float32)
    patches = Patches(radius=3, contrast=0.0)
    _, score, _ = search(image, other, np.array([[60.0, 50.0]]), np.array([[12.0], [12.0]]), patches)
    offset = np.arange(-3, 4)
    weight = 1 / (1 + (offset[:, None] ** 2 + offset**2) / 9)
    cov = np.cov(image[47:54, 57:64].ravel(), other[47:54, 45:52].ravel(), aweights=weight.ravel(), ddof=0)
    np.testing.assert_allclose(score, cov[0, 1] / np.sqrt(cov[0, 0] * cov[1, 1]), atol=1e-5)


def test_refinement_rejects_flat_windows_and_runaways() -> None:
    flat = np.full((60, 80), 90, np.float32)
    uv = np.array([[40.0, 30.0]])
    assert not refine(flat, flat, uv, np.zeros(1), Patches()).good.any()
    image = smooth_plane(noise(60, 80))
    assert refine(image, image, uv, np.full(1, 0.3), Patches()).good.all()
    assert not refine(image, image, uv, np.full(1, 39.0), Patches()).good.any()
    assert len(measure_vertical_offsets(flat, flat, uv, np.zeros(1), Patches())) == 0
    assert len(measure_vertical_offsets(image, image, np.array([[1.0, 1.0]]), np.zeros(1), Patches())) == 0


@pytest.mark.parametrize("offset", [0.0, 0.3, -0.5, 2.25, -3.75])
def test_rows_are_shifted_as_a_parabola_tells(offset: float) -> None:
    rows = np.arange(40, dtype=np.float32)[:, None] ** 2 * np.ones(3, np.float32)
    expected = (np.arange(10, 30) + offset) ** 2
    np.testing.assert_allclose(shift_rows(rows, offset)[10:30, 1], expected, atol=1e-2)


def test_support_keeps_slanted_planes_and_drops_strays() -> None:
    rng = np.random.default_rng(5)
    uv = rng.uniform(0, 100, (200, 2))
    disparity = 20 + 0.05 * uv[:, 0]
    stray = np.arange(200) % 40 == 0
    kept = find_supported(uv, np.where(stray, disparity + 15, disparity), tolerance=1.0)
    np.testing.assert_array_equal(kept, ~stray)
    assert find_supported(uv[:5], disparity[:5] * [1, 2, 3, 4, 5], tolerance=1.0).all()


def test_median_and_spread_of_a_normal_sample_are_its_parameters() -> None:
    median, spread = median_and_spread(np.random.default_rng(0).normal(3, 2, 20_000))
    assert abs(median - 3) < 0.1
    assert abs(spread - 2) < 0.1
    assert median_and_spread(np.zeros(0)) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [("row_tolerance", -1), ("max_hamming", -1), ("max_l2", 3.0), ("ratio", 1.5), ("max_disparity", np.nan), ("min_disparity", np.inf),
     ("min_correlation", 1.0), ("uniqueness", -0.1), ("max_disagreement", -1), ("max_gain", 0.5)],
)  # fmt: skip
def test_matcher_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"matcher: {name} is"):
        RowMatcher(**{name: value})  # type: ignore[arg-type]
    if hasattr(DescriptorMatcher, name):
        with pytest.raises(InputError, match=f"matcher: {name} is"):
            DescriptorMatcher(**{name: value})  # type: ignore[arg-type]


def test_limits_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(InputError, match="at most max_disparity"):
        DescriptorMatcher(max_disparity=5, min_disparity=6)


@pytest.mark.parametrize(("name", "value"), [("radius", 0), ("radius", 16), ("contrast", -1.0), ("contrast", np.nan)])
def test_window_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"patches: {name} is"):
        Patches(**{name: value})  # type: ignore[arg-type]
