import numpy as np
import pytest

from tspslam import InputError, Signals, build_complex, sample_signals, tmahf
from tspslam.topology.harmonic import Tmahf

from . import truth
from .scenes import noise, scattered, torus_faces

both = pytest.mark.parametrize("filter_", [truth.tmahf, tmahf], ids=["truth", "kernels"])
modes = pytest.mark.parametrize(("order", "centering"), [
    (0, "none"), (1, "none"), (1, "mean"), (1, "harmonic"), (1, "plane"), (2, "none"), (2, "harmonic"), (5, "mean"),
])  # fmt: skip
weights = pytest.mark.parametrize("weight", [
    None, lambda d: float(d <= 2), lambda d: 0.5**d if d < 4 else 0.0, lambda d: np.exp(-d), lambda d: float(d == 0),
], ids=["one ring", "two rings", "three fading rings", "whole complex", "nothing"])  # fmt: skip


def scene(n=40, image=None, seed=0):
    uv, complex_ = scattered(n, seed=seed)
    return complex_, uv, sample_signals(noise() if image is None else image, uv, complex_)


@modes
@weights
def test_kernels_equal_the_truth(order, centering, weight):
    uv, complex_ = scattered()
    complex_ = build_complex(complex_.faces[:50], complex_.n, edges=[[0, 39], [1, 38], [2, 3]])
    uv[3], uv[7] = np.nan, uv[8]
    signals = sample_signals(noise(), uv, complex_)
    got = tmahf(complex_, uv, signals, order=order, centering=centering, weight=weight)
    expected = truth.tmahf(complex_, uv, signals, order=order, centering=centering, weight=weight)
    assert np.array_equal(got.defined, expected.defined)
    assert np.abs(got.z - expected.z).max() <= 1e-12 * np.abs(expected.z).max()


def test_the_indicator_is_the_default_weight():
    complex_, uv, signals = scene()
    walked = tmahf(complex_, uv, signals, weight=lambda d: float(d <= 1))
    default = tmahf(complex_, uv, signals)
    assert np.abs(walked.z - default.z).max() < 1e-13


@both
@pytest.mark.parametrize("centering", ["mean", "harmonic", "plane"])
def test_a_constant_image_has_no_response(filter_, centering):
    complex_, uv, signals = scene(image=np.full((40, 60), 200, np.uint8))
    assert np.abs(filter_(complex_, uv, signals, centering=centering).z).max() < 1e-9
    assert np.abs(filter_(complex_, uv, signals, centering="none").z).max() > 1e-2


@both
@pytest.mark.parametrize("direction", [0.0, 0.7, -2.0, np.pi])
def test_plane_centring_finds_the_exact_phase_of_a_ramp(filter_, direction):
    v, u = np.mgrid[:40, :60]
    gradient = 0.004 * np.array([np.cos(direction), np.sin(direction)])
    complex_, uv, signals = scene(image=0.5 + gradient[0] * u + gradient[1] * v)
    response = filter_(complex_, uv, signals, centering="plane")
    turn = np.angle(response.z[response.defined] * np.exp(-1j * direction))
    assert response.defined.mean() > 0.9
    assert np.abs(turn).max() < 1e-6
    assert np.allclose(np.abs(response.z[response.defined]), 0.004, rtol=1e-9)


def test_harmonic_centring_equals_the_published_sum_on_an_even_neighbourhood():
    angle = np.arange(6) * np.pi / 3
    uv = 200.5 + np.vstack([[0, 0], 100 * np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    complex_ = build_complex([[0, k + 1, (k + 1) % 6 + 1] for k in range(6)], 7)
    rng = np.random.default_rng(0)
    middle = lambda e: uv[e].mean(axis=1)  # noqa: E731
    n_e, n_f = len(complex_.edges), len(complex_.faces)
    signals = Signals(
        rng.random(7), rng.random(n_e), rng.random(n_f), middle(complex_.edges), middle(complex_.faces),
        np.ones(n_e, np.int32), np.ones(n_f, np.int32), np.ones(7, bool), np.ones(n_e, bool), np.ones(n_f, bool),
    )  # fmt: skip
    published, fitted = (tmahf(complex_, uv, signals, centering=c).z[0] for c in ("none", "harmonic"))
    assert abs(published - fitted) < 1e-12


@modes
def test_turning_image_and_points_by_90_degrees_turns_the_phase_and_keeps_the_magnitude(order, centering):
    image = noise((41, 41))
    uv, complex_ = scattered(size=(41, 41))
    uv = np.round(uv * 8) / 8
    turned = np.stack([40 - uv[:, 1], uv[:, 0]], axis=1)  # u' = H - 1 - v, v' = u: a quarter turn clockwise
    sides = [sample_signals(image, uv, complex_), sample_signals(np.rot90(image, -1), turned, complex_)]
    assert np.allclose(sides[0].vertex, sides[1].vertex, atol=1e-15)
    assert np.allclose(sides[0].face, sides[1].face, atol=1e-15)
    no_edges = [_without_edges(s) for s in sides]
    a = tmahf(complex_, uv, no_edges[0], order=order, centering=centering)
    b = tmahf(complex_, turned, no_edges[1], order=order, centering=centering)
    assert np.array_equal(a.defined, b.defined)
    assert np.abs(b.z - a.z * 1j**order).max() < 1e-11


def _without_edges(s):
    return Signals(
        s.vertex, s.edge, s.face, s.edge_uv, s.face_uv, s.edge_pixels, s.face_pixels,
        s.vertex_ok, np.zeros_like(s.edge_ok), s.face_ok,
    )  # fmt: skip


@modes
def test_scaling_luminance_scales_the_response(order, centering):
    image = noise().astype(float) / 255
    complex_, uv, signals = scene(image=image)
    half = sample_signals(image / 4, uv, complex_)
    a, b = (tmahf(complex_, uv, s, order=order, centering=centering).z for s in (signals, half))
    assert np.abs(a / 4 - b).max() < 1e-14


@modes
def test_permuting_vertices_permutes_the_response(order, centering):
    complex_, uv, signals = scene()
    shuffle = np.random.default_rng(1).permutation(complex_.n)
    moved_uv = np.empty_like(uv)
    moved_uv[shuffle] = uv
    moved = build_complex(shuffle[complex_.faces], complex_.n)
    a = tmahf(complex_, uv, signals, order=order, centering=centering)
    b = tmahf(moved, moved_uv, sample_signals(noise(), moved_uv, moved), order=order, centering=centering)
    assert np.abs(a.z - b.z[shuffle]).max() < 1e-12


@both
def test_marked_elements_are_left_out(filter_):
    uv, complex_ = scattered()
    uv[5] = np.nan
    marked = sample_signals(noise(), uv, complex_)
    kept = ~(complex_.faces == 5).any(axis=1)
    loose = complex_.edges[~(complex_.edges == 5).any(axis=1)]
    smaller = build_complex(complex_.faces[kept], complex_.n, edges=loose)
    expected = filter_(smaller, uv, sample_signals(noise(), uv, smaller), centering="none", order=0)
    got = filter_(complex_, uv, marked, centering="none", order=0)
    touches = np.unique(complex_.faces[~kept])
    others = np.setdiff1d(np.arange(complex_.n), touches)
    assert np.abs(got.z[others] - expected.z[others]).max() < 1e-12
    assert got.z[5] == 0
    assert not got.defined[5]


@both
def test_a_poor_neighbourhood_is_undefined_and_zero(filter_):
    uv = np.array([[10.0, 10.0], [20.0, 10.0], [30.0, 10.0], [5, 30]])
    complex_ = build_complex([[0, 1, 2]], 4)
    response = filter_(complex_, uv, sample_signals(noise(), uv, complex_), centering="plane")
    assert not response.defined.any()
    assert not response.z.any()


@both
def test_an_element_at_the_vertex_has_no_direction_but_counts_for_order_0(filter_):
    uv = np.array([[10.0, 10.0], [10.0, 10.0], [30.0, 10.0]])
    complex_ = build_complex([], 3, edges=[[0, 1], [0, 2]])
    signals = sample_signals(noise(), uv, complex_)
    assert np.isclose(filter_(complex_, uv, signals, order=1, centering="none").z[0], signals.vertex[2])
    assert np.isclose(filter_(complex_, uv, signals, order=0).z[0], signals.vertex.sum())


def test_channels_are_filtered_one_by_one():
    image = noise((40, 60, 3))
    uv, complex_ = scattered()
    colour = tmahf(complex_, uv, sample_signals(image, uv, complex_, channels="all"))
    assert colour.z.shape == (complex_.n, 3)
    green = tmahf(complex_, uv, sample_signals(image[:, :, 1], uv, complex_))
    assert np.array_equal(colour.z[:, 1], green.z)
    assert np.array_equal(colour.defined, green.defined)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_single_and_double_precision_signals_agree(dtype):
    complex_, uv, signals = scene()
    levels = (signals.vertex.astype(dtype), signals.edge.astype(dtype), signals.face.astype(dtype))
    rest = [getattr(signals, name) for name in ("edge_uv", "face_uv", "edge_pixels", "face_pixels")]
    flags = [signals.vertex_ok, signals.edge_ok, signals.face_ok]
    got = tmahf(complex_, uv.astype(dtype), Signals(*levels, *rest, *flags))
    assert np.abs(got.z - tmahf(complex_, uv, signals).z).max() < 1e-4


def test_phase_and_magnitude_are_views_of_z():
    complex_, uv, signals = scene()
    response = tmahf(complex_, uv, signals)
    assert np.allclose(response.magnitude * np.exp(1j * response.phase), response.z)
    assert (response.phase > -np.pi).all()


def test_a_closed_surface_and_an_empty_complex_are_filtered():
    uv = np.random.default_rng(0).random((192, 2)) * [59, 39]
    torus = build_complex(torus_faces(), 192)
    signals = sample_signals(noise(), uv, torus)
    got, expected = tmahf(torus, uv, signals), truth.tmahf(torus, uv, signals)
    assert np.array_equal(got.defined, expected.defined)
    assert np.abs(got.z - expected.z).max() < 1e-11
    empty = build_complex([], 0)
    assert tmahf(empty, np.empty((0, 2)), sample_signals(noise(), np.empty((0, 2)), empty)).z.shape == (0,)


def test_the_stage_is_the_function():
    complex_, uv, signals = scene()
    assert np.array_equal(Tmahf(order=2)(complex_, uv, signals).z, tmahf(complex_, uv, signals, order=2).z)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"order": -1}, "order is -1"),
    ({"order": 1.5}, "order is 1.5"),
    ({"order": 1001}, "order is 1001, expected an integer from 0 to 1000"),
    ({"order": 10**30}, "order is 10{30}"),
    ({"weight": lambda d: None}, r"weight\(0\) is None, expected a number"),
    ({"order": True}, "order is True"),
    ({"centering": "planar"}, "centering is 'planar', expected one of none, mean, harmonic, plane"),
    ({"order": 0, "centering": "mean"}, "order 0, expected 'none'"),
    ({"order": 2, "centering": "plane"}, "expected order 1"),
    ({"weight": 2}, "weight is 2, expected a function"),
    ({"weight": lambda d: 0.5}, r"weight\(0\) is 0.5, expected 1"),
    ({"weight": lambda d: 1.0 + d}, r"weight\(1\) is 2.0, expected non-increasing"),
    ({"weight": lambda d: 1.0 if d != 1 else np.nan}, r"weight\(1\) is nan"),
])  # fmt: skip
def test_bad_settings_are_named(arguments, message):
    complex_, uv, signals = scene()
    with pytest.raises(InputError, match=message):
        tmahf(complex_, uv, signals, **arguments)


def test_arrays_of_another_complex_are_named():
    complex_, uv, signals = scene()
    with pytest.raises(InputError, match=r"uv has shape \(3, 2\), expected \(40, 2\)"):
        tmahf(complex_, uv[:3], signals)
    with pytest.raises(InputError, match=r"signals are on \(40, .*\) vertices, edges, faces, expected \(5, 7, 3\)"):
        tmahf(build_complex([[0, 2, 3], [0, 1, 2], [1, 2, 4]], 5), uv[:5], signals)
    with pytest.raises(InputError, match="vertex 4 has a signal, but its value or position is not finite"):
        tmahf(complex_, np.where(np.arange(40)[:, None] == 4, np.nan, uv), signals)


@pytest.mark.parametrize("name", ["vertex_ok", "edge_ok", "face_ok", "edge_uv", "face_uv"])
def test_signals_whose_arrays_disagree_are_named(name):
    from dataclasses import replace

    complex_, uv, signals = scene()
    with pytest.raises(InputError, match=f"signals.{name} has shape"):
        tmahf(complex_, uv, replace(signals, **{name: getattr(signals, name)[:2]}))
