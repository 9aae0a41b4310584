"""What compares several pixels at a time says what the equations say, to the last row and column that it reads."""

import numba
import numpy as np
import pytest

from tspslam.vision._sampling import LANES, row_moments, sample_cubic, window_moments
from tspslam.vision.images import build_pyramid
from tspslam.vision.slam.patch_tracking import Patch, Sought, track_patches, track_sought
from tspslam.vision.stereo._patches import lagrange_taps
from tspslam.vision.stereo.patches import Patches, refine, search

RNG = np.random.default_rng(0)
IMAGE, OTHER = (RNG.uniform(0, 255, (40, 60)).astype(np.float32) for _ in range(2))


@numba.njit
def cubic(image, start, stride, taps, across, down):
    return sample_cubic(image, start, stride, taps, across, down)


@numba.njit
def window(image, start, stride, taps, factors, side, blocks, middle):
    return window_moments(image, start, stride, taps, factors, side, blocks, middle)


@numba.njit
def rows(left, first, right, second, stride, taps, weight, side, blocks, middle):
    return row_moments(left, first, right, second, stride, taps, weight, side, blocks, middle)


def padded(side, count):
    """Weights or factors of a patch, with zeros beyond it; and the same without these."""
    blocks = -(-side // LANES)
    values = np.zeros((count, side, blocks * LANES), np.float32)
    values[:, :, :side] = RNG.uniform(0, 1, (count, side, side))
    return blocks, values, values[:, :, :side].astype(np.float64)


def test_a_sample_is_the_sum_of_its_sixteen_points():
    taps = RNG.uniform(-1, 1, 12).astype(np.float32)
    expected = taps[4:8] @ IMAGE[7:11, 5:9] @ taps[8:12]
    assert np.isclose(cubic(IMAGE.ravel(), 7 * 60 + 5, 60, taps, 8, 4), expected, rtol=1e-5)


@pytest.mark.parametrize("side", [3, 11, 17])
def test_moments_of_a_window_are_those_of_its_samples(side):
    blocks, factors, (w, *others) = padded(side, 4)
    taps = RNG.uniform(0, 0.5, 8).astype(np.float32)
    near = np.lib.stride_tricks.sliding_window_view(IMAGE[4 : 7 + side, 3 : 6 + side].astype(np.float64), (4, 4))
    r = np.einsum("abki,k,i->ab", near, taps[4:], taps[:4]) - 100
    found = window(IMAGE.ravel(), 4 * 60 + 3, 60, taps, factors.ravel(), side, blocks, np.float32(100))
    np.testing.assert_allclose(found, [np.sum(w * r * a) for a in (1, r, *others)], rtol=1e-4)


@pytest.mark.parametrize("side", [3, 9, 17])
def test_moments_along_rows_are_those_of_both_patches(side):
    blocks, weight, (w,) = padded(side, 1)
    taps = np.empty(6, np.float32)
    lagrange_taps.py_func(0.3, taps)
    l = IMAGE[5 : 5 + side, 3 : 5 + side].astype(np.float64)  # noqa: E741 - the equation's name
    near = np.lib.stride_tricks.sliding_window_view(OTHER[5 : 5 + side, 2 : 9 + side].astype(np.float64), 6, axis=1)
    r = near @ taps
    g = (r[:, 2:] - r[:, :-2] + l[:, 2:] - l[:, :-2]) / 4
    l, r = l[:, 1:-1] - 100, r[:, 1:-1] - 100  # noqa: E741
    given = IMAGE.ravel(), 5 * 60 + 3, OTHER.ravel(), 5 * 60 + 2, 60, taps, weight.ravel(), side, blocks
    expected = [np.sum(w * a) for a in (l, r, g, l * l, l * r, l * g, r * r, r * g, g * g)]
    np.testing.assert_allclose(rows(*given, np.float32(100)), expected, rtol=1e-3, atol=0.1)


@pytest.mark.parametrize("radius", [1, 4, 8])
def test_search_is_the_weighted_correlation_to_the_last_corner(radius):
    first, second = (np.ascontiguousarray(image[:20, :40]) for image in (IMAGE, OTHER))
    low, last = 10.0, np.array([39 - radius, 19 - radius])
    uv = np.array([last, last - (0, 1), (20.0, radius), (radius + 12, 10.0)])
    ranges = np.array([np.full(4, -low), np.full(4, low)])
    disparity, score, _ = search(first, second, uv, ranges, Patches(radius=radius, contrast=0.02))
    for (x, y), best, found in zip(uv.astype(int), disparity, score, strict=True):
        shifts = [k for k in range(-10, 11) if radius <= x - k < 40 - radius]
        every = [correlation(first, second, (x, y), (x - k, y), radius, 0.02) for k in shifts]
        assert found == pytest.approx(max(every), abs=1e-4)
        assert best == shifts[int(np.argmax(every))]


def correlation(first, second, here, there, radius, contrast):
    a, b = (
        image[y - radius : y + radius + 1, x - radius : x + radius + 1].astype(np.float64)
        for image, (x, y) in ((first, here), (second, there))
    )
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    w = 1 / ((1 + ((a - a[radius, radius]) * contrast) ** 2) * (1 + (u * u + v * v) / radius**2))
    w /= w.sum()
    a, b = a - (w * a).sum(), b - (w * b).sum()
    return (w * a * b).sum() / np.sqrt((w * a * a).sum() * (w * b * b).sum())


@pytest.mark.parametrize("radius", [4, 10])
def test_patches_to_the_last_row_are_aligned_or_refused(radius):
    v, u = np.mgrid[:50, :90].astype(np.float32)
    first, second = (np.ascontiguousarray(128 + 60 * np.sin(0.4 * (u + by)) * np.cos(0.3 * v)) for by in (0, 0.4))
    uv = np.array([(x, y) for x in range(90) for y in range(50)], float)
    found = refine(first, second, uv, np.zeros(len(uv)), Patches(radius=radius))
    inner = (uv >= radius + 4).all(axis=1) & (uv < (90 - radius - 22, 50 - radius)).all(axis=1)
    assert found.good[inner].mean() > 0.99
    assert np.abs(found.disparity[found.good] - 0.4).max() < 0.05


def test_images_hardly_higher_than_a_patch_are_not_searched():
    thin = np.ascontiguousarray(IMAGE[:3, :8])
    _, score, _ = search(thin, thin, np.array([[4.0, 1.0]]), np.array([[-3.0], [3.0]]), Patches(radius=1))
    assert score.tolist() == [-1]


def test_points_of_several_images_are_tracked_as_those_of_each():
    patch, levels = Patch(5, 0.03, 4.0, 0.5), range(1, -1, -1)
    first, second = (build_pyramid(np.kron(image, np.ones((4, 4))).astype(np.uint8)) for image in (IMAGE, OTHER))
    place = RNG.uniform(20, 130, (160, 2))
    same = np.repeat(np.eye(2)[None], 160, axis=0)
    sought = [Sought(first, place, same, place + 0.7), Sought(second, place[:3], same[:3], place[:3])]
    for each, (uv, good) in zip(sought, track_sought(sought, first, levels, patch), strict=True):
        alone = track_patches(each.reference, first, each.place, each.warp, each.guess, levels, patch)
        np.testing.assert_array_equal(uv, alone[0])
        np.testing.assert_array_equal(good, alone[1])
    assert good.shape == (3,)
