import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.draw import line

from tspslam import InputError, build_complex, sample_signals
from tspslam.topology.texture import luminance

from . import truth
from .scenes import noise, scattered

both = pytest.mark.parametrize("sample", [truth.sample_signals, sample_signals], ids=["truth", "kernels"])


def assert_same(got, expected, tolerance=1e-12):
    for name in ("vertex", "edge", "face", "edge_uv", "face_uv"):
        assert np.allclose(getattr(got, name), getattr(expected, name), rtol=0, atol=tolerance), name
    for name in ("edge_pixels", "face_pixels", "vertex_ok", "edge_ok", "face_ok"):
        assert np.array_equal(getattr(got, name), getattr(expected, name)), name


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(40, 60), (40, 60, 3)])
def test_kernels_equal_the_truth_on_any_image_type(dtype, shape):
    image = noise(shape, dtype=dtype)
    uv, complex_ = scattered()
    uv[3], uv[5], uv[7] = (np.nan, 4), (-1e-9, 3), (10, 39.5)
    got, expected = sample_signals(image, uv, complex_), truth.sample_signals(image, uv, complex_)
    assert_same(got, expected)
    assert 0 < got.face_ok.sum() < len(complex_.faces)


quarter = st.integers(0, 4 * 12).map(lambda k: k / 4)


@given(st.lists(st.tuples(quarter, quarter), min_size=3, max_size=3))
@settings(max_examples=300, deadline=None)
def test_kernels_equal_the_truth_on_triangles_through_pixel_centres(corners):
    image = noise((13, 13))
    uv = np.array(corners)
    triangle = build_complex([[0, 1, 2]], 3)
    assert_same(sample_signals(image, uv, triangle), truth.sample_signals(image, uv, triangle))


@given(st.lists(st.floats(0, 12), min_size=6, max_size=6))
@settings(max_examples=200, deadline=None)
def test_kernels_equal_the_truth_on_any_triangle(coordinates):
    image = noise((13, 13))
    uv = np.array(coordinates).reshape(3, 2)
    triangle = build_complex([[0, 1, 2]], 3)
    assert_same(sample_signals(image, uv, triangle), truth.sample_signals(image, uv, triangle))


@given(*[st.integers(0, 20)] * 4)
@settings(max_examples=200, deadline=None)
def test_an_edge_is_the_textbook_bresenham_line(u0, v0, u1, v1):
    (v0, u0), (v1, u1) = sorted([(v0, u0), (v1, u1)])
    assert truth.line_pixels((u1, v1), (u0, v0)) == list(zip(*reversed(line(v0, u0, v1, u1)), strict=True))


@both
def test_a_constant_image_gives_that_constant_everywhere(sample):
    uv, complex_ = scattered()
    signals = sample(np.full((40, 60), 77, np.uint8), uv, complex_)
    for values in (signals.vertex, signals.edge, signals.face):
        assert np.abs(values - 77 / 255).max() < 1e-14


@both
def test_a_ramp_is_sampled_at_the_barycentres(sample):
    v, u = np.mgrid[:40, :60]
    uv, complex_ = scattered()
    signals = sample(0.3 + 0.005 * u - 0.004 * v, uv, complex_)
    for values, places in ((signals.vertex, uv), (signals.edge, signals.edge_uv), (signals.face, signals.face_uv)):
        assert np.abs(values - (0.3 + places @ [0.005, -0.004])).max() < 1e-12


@both
def test_the_closed_triangle_counts_its_border(sample):
    uv = np.array([[2.0, 1.0], [6.0, 1.0], [2.0, 5.0]])
    signals = sample(noise(), uv, build_complex([[0, 1, 2]], 3))
    assert signals.face_pixels.tolist() == [15]
    assert signals.edge_pixels.tolist() == [5, 5, 5]


@both
def test_elements_smaller_than_a_pixel_take_a_bilinear_sample(sample):
    uv = np.array([[2.2, 1.2], [2.4, 1.2], [2.2, 1.4]])
    image = noise()
    signals = sample(image, uv, build_complex([[0, 1, 2]], 3))
    assert signals.face_pixels.tolist() == [0]
    assert np.allclose(signals.face_uv[0], uv.mean(axis=0))
    assert np.isclose(signals.face[0], truth.bilinear(image / 255, *uv.mean(axis=0)))
    assert np.allclose(signals.edge_uv[0], (uv[0] + uv[1]) / 2)


@both
def test_a_vertex_on_the_image_border_counts_and_one_beyond_is_marked(sample):
    uv = np.array([[0, 0], [59, 0], [0, 39], [59.001, 39], [np.nan, np.nan]])
    signals = sample(noise(), uv, build_complex([[0, 1, 2], [1, 2, 3], [2, 3, 4]], 5))
    assert signals.vertex_ok.tolist() == [True, True, True, False, False]
    assert signals.face_ok.tolist() == [True, False, False]
    assert signals.edge_ok.sum() == 3
    for values in (signals.vertex[3:], signals.face[1:], signals.edge[~signals.edge_ok], signals.face_uv[1:]):
        assert not values.any()


def test_permuting_vertices_permutes_the_signals():
    uv, complex_ = scattered()
    order = np.random.default_rng(1).permutation(complex_.n)
    moved_uv = np.empty_like(uv)
    moved_uv[order] = uv
    moved = build_complex(order[complex_.faces], complex_.n)
    a, b = sample_signals(noise(), uv, complex_), sample_signals(noise(), moved_uv, moved)
    assert np.array_equal(a.vertex, b.vertex[order])
    assert np.array_equal(a.face, b.face)
    ends = {tuple(e): x for e, x in zip(moved.edges.tolist(), b.edge, strict=True)}
    assert [ends[tuple(sorted(order[e]))] for e in complex_.edges] == a.edge.tolist()


def test_all_channels_are_sampled_alike():
    image = noise((40, 60, 5))
    uv, complex_ = scattered()
    signals = sample_signals(image, uv, complex_)
    assert signals.face.shape == (len(complex_.faces), 5)
    for c in range(5):
        assert np.array_equal(signals.edge[:, c], sample_signals(image[:, :, c], uv, complex_).edge)
    assert sample_signals(image[:, :, :3], uv, complex_, channels="all").vertex.shape == (complex_.n, 3)
    assert np.allclose(sample_signals(image[:, :, :1], uv, complex_).vertex, signals.vertex[:, 0])


def test_memory_layout_does_not_matter():
    image = noise((40, 60, 3))
    uv, complex_ = scattered()
    expected = sample_signals(image, uv, complex_)
    assert_same(sample_signals(np.asfortranarray(image), np.asfortranarray(uv), complex_), expected, 0)
    assert_same(sample_signals(np.repeat(image, 2, axis=1)[:, ::2], uv.tolist(), complex_), expected, 0)


def test_a_one_pixel_image_is_an_image():
    signals = sample_signals(np.full((1, 1), 255, np.uint8), [[0, 0]], build_complex([], 1))
    assert signals.vertex.tolist() == [1.0]


def test_luminance_of_colour_uses_float_weights():
    colour = np.zeros((1, 3, 3), np.uint8)
    colour[0, [0, 1, 2], [0, 1, 2]] = 255
    assert luminance(colour)[0].tolist() == pytest.approx([0.299, 0.587, 0.114])


def test_luminance_is_float64_of_any_image_and_of_no_other_channels():
    for image in (noise((4, 4)), np.full((4, 4), 0.5, np.float32), noise((4, 4, 1)), noise((4, 4, 3))):
        assert luminance(image).dtype == np.float64
    for channels in (2, 4):
        with pytest.raises(InputError, match=f"{channels} channels, expected a grey one or R, G, B"):
            luminance(noise((4, 4, channels)))


def test_unknown_channels_are_named():
    with pytest.raises(InputError, match="channels is 'rgb', expected 'luminance' or 'all'"):
        sample_signals(noise((4, 4, 3)), [[0, 0]], build_complex([], 1), channels="rgb")


@pytest.mark.parametrize(("image", "uv", "message"), [
    (np.zeros((4, 4), np.int32), [[0, 0]], "int32, expected uint8, uint16"),
    (np.zeros((4,), np.uint8), [[0, 0]], r"shape is \(4,\)"),
    (np.zeros((0, 4), np.uint8), [[0, 0]], "not empty"),
    ([[1]], [[0, 0]], "image is list, expected an array"),
    (np.full((4, 4), np.nan), [[0, 0]], "NaN or infinite"),
    (np.zeros((4, 4), np.uint8), [[0, 0], [1, 1]], r"uv: shape is \(2, 2\), expected \(1, 2\)"),
])  # fmt: skip
def test_bad_input_is_named(image, uv, message):
    with pytest.raises(InputError, match=message):
        sample_signals(image, uv, build_complex([], 1))
