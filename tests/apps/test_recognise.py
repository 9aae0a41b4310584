"""Descriptors of complexes and responses, and what is recognised by them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from tspslam import build_complex, sample_signals, tmahf, tmahf_bank
from tspslam.apps import _recognise
from tspslam.apps.recognise import Places, compare_descriptors, describe, find_places
from tspslam.errors import InputError
from tspslam.types import Bank, Response

SIDE = 96
CELLS = (3, 2)


def picture(seed, side=SIDE):
    """Smooth random texture in [0.2, 0.7]."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:side, :side] / side
    waves = [np.cos(2 * np.pi * (a * u + b * v + c)) for a, b, c in rng.uniform(-9, 9, (12, 3))]
    image = sum(waves)
    return 0.2 + 0.5 * (image - image.min()) / np.ptp(image)


def points(seed=0, n=300):
    return np.random.default_rng(seed).uniform(0, SIDE - 1, (n, 2))


def looked_at(image, uv, faces=None):
    """Complex, signals and bank of an image at vertices."""
    complex_ = build_complex(Delaunay(uv).simplices if faces is None else faces, len(uv))
    signals = sample_signals(image, uv, complex_)
    return complex_, signals, tmahf_bank(complex_, uv, signals, orders=(0, 1, 2), scales=(1, 2))


def described(image, uv, layout=None, faces=None):
    seen = looked_at(image, uv, faces)
    return describe(*seen) if layout is None else describe(*seen, layout=layout, uv=uv, size=(SIDE, SIDE))


LAYOUTS = pytest.mark.parametrize("layout", [None, CELLS])


@LAYOUTS
def test_number_of_vertices_and_faces_does_not_change_the_length(layout):
    sizes = {described(picture(1), points(n=n), layout).shape for n in (4, 50, 300)}
    assert sizes == {(4 * 8 + 48,) if layout is None else (4 * 9 * 6,)}


@LAYOUTS
def test_a_descriptor_has_length_one_and_is_float32(layout):
    made = described(picture(1), points(), layout)
    assert made.dtype == np.float32
    assert np.linalg.norm(made) == pytest.approx(1, abs=1e-6)


@LAYOUTS
def test_renumbered_vertices_and_faces_are_described_alike(layout):
    uv, rng = points(), np.random.default_rng(5)
    faces, order = Delaunay(uv).simplices, rng.permutation(len(uv))
    place = np.argsort(order)
    again = rng.permutation(place[faces])
    first, second = described(picture(1), uv, layout, faces), described(picture(1), uv[order], layout, again)
    np.testing.assert_allclose(first, second, atol=1e-5)


@LAYOUTS
@pytest.mark.parametrize(("gain", "offset"), [(0.5, 0.0), (1.3, 0.0), (1.0, 0.2), (0.1, 0.5)])
def test_gain_and_offset_do_not_matter(layout, gain, offset):
    image = picture(1)
    first, second = described(image, points(), layout), described(gain * image + offset, points(), layout)
    np.testing.assert_allclose(first, second, atol=1e-5)


def test_a_turn_by_90_degrees_in_the_image_does_not_matter():
    uv = points()
    faces = Delaunay(uv).simplices
    turned = np.column_stack([uv[:, 1], SIDE - 1 - uv[:, 0]])  # np.rot90: column u becomes row SIDE - 1 - u
    first, second = described(picture(1), uv, None, faces), described(np.rot90(picture(1)).copy(), turned, None, faces)
    np.testing.assert_allclose(first, second, atol=0.02)  # an edge's line of pixels is not turned exactly


def test_a_turn_changes_what_stands_where():
    turned = np.rot90(picture(1)).copy()
    same = compare_descriptors([described(picture(1), points(), CELLS)], [described(turned, points(), CELLS)])
    assert same[0, 0] < 0.5


def test_other_vertices_on_the_same_picture_are_nearer_than_another_picture():
    known, queries = ([described(picture(k), points(seed, 1500), CELLS) for k in range(6)] for seed in (0, 1))
    assert compare_descriptors(queries, known).argmax(axis=1).tolist() == list(range(6))


def test_without_a_layout_fine_and_coarse_textures_differ_wherever_they_are():
    kinds = [picture, lambda seed: picture(seed, 3 * SIDE)[:SIDE, :SIDE].copy(), lambda seed: picture(seed) > 0.45]
    known, queries = ([described(np.float64(kind(seed)), points(seed)) for kind in kinds] for seed in (0, 1))
    assert compare_descriptors(queries, known).argmax(axis=1).tolist() == [0, 1, 2]


@LAYOUTS
@pytest.mark.parametrize("level", [0.0, 0.3, 1.0])
def test_a_constant_image_is_like_nothing_not_even_itself(layout, level):
    made = described(np.full((SIDE, SIDE), level), points(), layout)
    assert not made.any()
    assert compare_descriptors([made], [made, described(picture(1), points(), layout)]).tolist() == [[0, 0]]


@LAYOUTS
def test_no_edge_is_like_nothing(layout):
    assert not described(picture(1), points(n=4), layout, faces=np.zeros((0, 3), int)).any()
    assert not described(picture(1), points(n=0), layout, faces=np.zeros((0, 3), int)).any()


def test_without_a_defined_response_levels_alone_are_told_and_nothing_with_a_layout():
    complex_, signals, bank = looked_at(picture(1), points())
    none = replace(bank, z=np.zeros_like(bank.z), defined=np.zeros_like(bank.defined))
    assert np.flatnonzero(describe(complex_, signals, none)).min() >= 4 * 8
    assert not describe(complex_, signals, none, layout=CELLS, uv=points(), size=(SIDE, SIDE)).any()


def test_one_face_is_described():
    made = described(picture(1), points(n=3))
    assert np.isfinite(made).all()
    assert np.linalg.norm(made) == pytest.approx(1, abs=1e-6)


@LAYOUTS
def test_marked_elements_do_not_count(layout):
    uv = points()
    uv[:40] += 200  # beyond the image
    complex_, signals, bank = looked_at(picture(1), uv)
    wild = replace(
        signals, vertex=np.where(signals.vertex_ok, signals.vertex, 9), face=np.where(signals.face_ok, signals.face, -5)
    )
    given = {"layout": layout, "uv": uv, "size": (SIDE, SIDE)} if layout else {}
    assert not signals.vertex_ok.all()
    np.testing.assert_array_equal(describe(complex_, signals, bank, **given), describe(complex_, wild, bank, **given))


@LAYOUTS
def test_a_response_is_described_as_a_bank_of_one(layout):
    complex_, signals, _ = looked_at(picture(1), points())
    response = tmahf(complex_, points(), signals, order=2)
    bank = Bank(response.z[:, None], np.array([2]), np.array([1.0]), response.defined[:, None])
    given = {"layout": layout, "uv": points(), "size": (SIDE, SIDE)} if layout else {}
    np.testing.assert_array_equal(
        describe(complex_, signals, response, **given), describe(complex_, signals, bank, **given)
    )


@LAYOUTS
def test_channels_are_filters_of_their_own(layout):
    uv, image = points(), np.dstack([picture(1), picture(2), picture(3)])
    complex_ = build_complex(Delaunay(uv).simplices, len(uv))
    signals = sample_signals(image, uv, complex_, channels="all")
    given = {"layout": layout, "uv": uv, "size": (SIDE, SIDE)} if layout else {}
    made = describe(complex_, signals, tmahf_bank(complex_, uv, signals, orders=(1, 2)), **given)
    assert len(made) == (9 * 6 * 6 if layout else 6 * 8 + 3 * 48)


@LAYOUTS
def test_same_input_gives_the_same_bytes(layout):
    assert described(picture(1), points(), layout).tobytes() == described(picture(1), points(), layout).tobytes()


def test_sums_over_cells_are_those_of_numpy():
    rng = np.random.default_rng(3)
    z, defined = rng.standard_normal((50, 3)) + 1j * rng.standard_normal((50, 3)), rng.random((50, 3)) < 0.8
    size, strength = np.empty(z.shape), np.empty(50)
    mean = _recognise.magnitudes(z, defined, size)
    np.testing.assert_allclose(mean, [np.abs(z[defined[:, k], k]).mean() for k in range(3)])
    typical = _recognise.strengths(size, mean, strength)
    known = defined.any(axis=1)
    joint = np.sqrt(((np.where(defined, np.abs(z), 0) / mean) ** 2).sum(axis=1))
    np.testing.assert_allclose(strength, np.where(known, joint, -1))
    assert typical == pytest.approx(joint[known].mean())
    places, sums, counts = rng.uniform(0, (2, 3), (50, 2)), np.zeros((3, 4, 3, 9)), np.zeros((3, 4))
    _recognise.pool_cells(z, size, mean, strength, typical, places, sums, counts)
    hats = [np.maximum(0, 1 - np.abs(places[:, [a]] - np.arange(n))) for a, n in ((0, 3), (1, 4))]
    share = hats[0][:, :, None] * hats[1][:, None, :] * known[:, None, None]
    np.testing.assert_allclose(counts, share.sum(axis=0))
    size_ = np.where(defined, np.abs(z), 0) / mean / (joint + typical)[:, None]
    turns = [size_ * np.exp(1j * k * np.angle(z)) for k in range(1, 5)]
    values = np.stack([size_, *(part for turn in turns for part in (turn.real, turn.imag))], axis=-1)
    np.testing.assert_allclose(sums, np.einsum("irc,ikx->rckx", share, values), atol=1e-12)


def test_histograms_count_each_magnitude_once():
    size = np.array([[1.0], [4.0], [0.0], [-1.0], [2.0]])
    found = np.zeros((1, 7))
    _recognise.magnitude_histograms(size, np.array([1.0]), -4.0, 2.0, found)
    np.testing.assert_allclose(found, [[1, 0, 0, 0, 1, 1, 1]])


def test_similarity_is_the_cosine():
    rows = np.random.default_rng(0).standard_normal((5, 7))
    lengths = np.linalg.norm(rows, axis=1)
    np.testing.assert_allclose(
        compare_descriptors(rows, rows[:2]), rows @ rows[:2].T / np.outer(lengths, lengths[:2]), atol=1e-6
    )
    assert compare_descriptors(rows, np.zeros((0, 7))).shape == (5, 0)


def test_places_are_the_most_alike_pairs_that_are_apart_in_time():
    turn = np.radians([0, 10, 60, 90, 11, 3])
    found = find_places(np.column_stack([np.cos(turn), np.sin(turn)]), apart=3, least=0.5)
    assert isinstance(found, Places)
    pairs = list(zip(found.first.tolist(), found.second.tolist(), strict=True))
    assert pairs == [(1, 4), (0, 5), (1, 5), (0, 4)]
    assert (np.diff(found.score) <= 0).all()
    assert (found.second - found.first >= 3).all()


def test_what_all_keyframes_share_tells_no_places_apart():
    own = np.eye(60)[np.r_[:30, :30]]  # keyframe k + 30 is where k was
    found = find_places(np.column_stack([np.ones(60), own]), apart=10)
    assert len(found.score) == 30
    assert (found.second - found.first == 30).all()


def test_a_mean_is_taken_out_of_both_but_nothing_stays_nothing():
    rows = np.array([[1.0, 1], [1, -1], [0, 0]])
    assert compare_descriptors(rows, rows, mean=[1, 0]).round(6).tolist() == [[1, -1, 0], [-1, 1, 0], [0, 0, 0]]


def test_words_are_added_and_only_the_later_keyframe_asks():
    words = np.zeros((4, 4))
    words[3, 0], words[0, 2] = 0.5, 0.9
    alone = find_places(np.zeros((4, 2)), apart=1, words=words)
    assert (alone.first.tolist(), alone.second.tolist(), alone.score.tolist()) == ([0], [3], [0.5])
    alike = find_places(np.ones((4, 2)), apart=2, words=words, weight=0.1)
    np.testing.assert_allclose(alike.score, [0.6, 0.1, 0.1], atol=1e-6)


def test_what_is_like_nothing_is_no_place():
    assert len(find_places(np.zeros((30, 5)), apart=1).score) == 0
    assert len(find_places(np.zeros((0, 5))).score) == 0


def test_pairs_of_equal_score_come_in_the_order_of_time():
    found = find_places(np.ones((5, 1)), apart=3)
    assert list(zip(found.first.tolist(), found.second.tolist(), strict=True)) == [(0, 3), (0, 4), (1, 4)]


def test_bad_input_to_describe_is_one_clear_line():
    complex_, signals, bank = looked_at(picture(1), points(n=20))
    uv = points(n=20)
    place = {"layout": CELLS, "uv": uv, "size": (SIDE, SIDE)}
    lost = np.where(np.arange(20)[:, None] == 3, np.nan, uv)
    bad_z = replace(bank, z=np.where(np.arange(20)[:, None] == 3, np.nan, bank.z))
    bad_vertex = replace(signals, vertex=np.where(np.arange(20) == 3, np.nan, signals.vertex))
    for given, words in [
        ((1, signals, bank), "complex_ is int"),
        ((complex_, None, bank), "signals is NoneType"),
        ((complex_, signals, bank.z), "response is complex128"),
        ((complex_, looked_at(picture(1), points(n=21))[1], bank), "signals.vertex has shape"),
        ((complex_, signals, looked_at(picture(1), points(n=21))[2]), "expected 20 vertices"),
        ((complex_, signals, tmahf(complex_, uv, signals, order=0)), "order 0 alone"),
        ((complex_, signals, bad_z), "response is not finite"),
        ((complex_, bad_vertex, bank), "signals.vertex is not finite at vertex 3"),
        ((complex_, signals, bank, {"uv": uv}), "without a layout"),
        ((complex_, signals, bank, {"layout": CELLS}), "without uv or size"),
        ((complex_, signals, bank, place | {"layout": (1, 1)}), "1 by 1 cells, expected 2 to 4096"),
        ((complex_, signals, bank, place | {"layout": 3}), r"layout is 3, expected \(rows, columns\)"),
        ((complex_, signals, bank, place | {"size": (0, 3)}), r"size is \(0, 3\), expected \(width, height\)"),
        ((complex_, signals, bank, place | {"uv": uv[:5]}), "uv has shape"),
        ((complex_, signals, bank, place | {"uv": lost}), "uv is not finite at vertex 3"),
    ]:
        data, options = (given[:-1], given[-1]) if isinstance(given[-1], dict) else (given, {})
        with pytest.raises(InputError, match=words) as error:
            describe(*data, **options)
        assert "\n" not in str(error.value)


def test_bad_input_to_comparisons_is_one_clear_line():
    rows = np.ones((3, 2))
    for call, words in [
        (lambda: compare_descriptors(rows, rows[:, :1]), "expected as many"),
        (lambda: compare_descriptors(rows[0], rows), "queries are float64"),
        (lambda: compare_descriptors(rows, [[np.nan, 1]]), "known are float64"),
        (lambda: compare_descriptors(rows, rows, mean=[1, 2, 3]), "mean has shape"),
        (lambda: find_places(rows, apart=0), "apart is 0"),
        (lambda: find_places(rows, weight=-1), "weight is -1"),
        (lambda: find_places(rows, least=np.inf), "least is inf"),
        (lambda: find_places(rows, words=rows), "words are float64"),
    ]:
        with pytest.raises(InputError, match=words):
            call()


def test_undefined_vertices_may_lie_anywhere():
    complex_, signals, _ = looked_at(picture(1), points(n=20))
    uv, known = points(n=20), np.arange(20) != 3
    response = Response(np.where(known, np.exp(1j * np.arange(20)), 0), 1, known)
    lost = np.where(known[:, None], uv, np.nan)
    given = [describe(complex_, signals, response, layout=CELLS, uv=each, size=(SIDE, SIDE)) for each in (uv, lost)]
    np.testing.assert_array_equal(*given)
