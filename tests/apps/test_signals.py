from dataclasses import fields, replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from tspslam import InputError, Response, build_cells, build_complex, sample_signals, tmahf
from tspslam.apps import _signals
from tspslam.apps import signals as ours
from tspslam.apps.signals import denoise_signals

LEVELS = ("vertex", "edge", "face")


def picture(size=160):
    """A dark disc and a stripe on a slope of light."""
    v, u = np.mgrid[:size, :size].astype(float)
    disc = np.hypot(u - 0.4 * size, v - 0.5 * size) < 0.25 * size
    return 0.3 + 0.2 * u / size + 0.3 * disc + 0.2 * (np.abs(u + v - 1.4 * size) < 6)


def noisy_scene(noise=0.08, n=900, size=160, channels=1, seed=0):
    """Complex, places, clean and noisy signals."""
    rng = np.random.default_rng(seed)
    uv = rng.random((n, 2)) * (size - 1)
    complex_ = build_complex(Delaunay(uv).simplices, n)
    clean = np.repeat(picture(size)[:, :, None], channels, axis=2)
    noisy = clean + rng.normal(0, noise, clean.shape) if noise else clean
    images = (clean[:, :, 0], noisy[:, :, 0]) if channels == 1 else (clean, noisy)
    return complex_, uv, *(sample_signals(field(i), uv, complex_, channels="all") for i in images)


def field(image):
    return image if image.ndim == 3 or image.dtype != float else image.clip(0, 1)


def allclose(one, other, **tolerance):
    for level in LEVELS:
        np.testing.assert_allclose(getattr(one, level), getattr(other, level), **tolerance)


def mse(one, other, level="vertex"):
    return np.mean((getattr(one, level) - getattr(other, level)) ** 2)


SCENE = noisy_scene()


def test_constants_stay_as_they_are():
    complex_, uv, _, noisy = SCENE
    flat = replace(noisy, **{level: np.full_like(getattr(noisy, level), 0.3) for level in LEVELS})
    for noise in (None, 0.1):
        allclose(denoise_signals(complex_, flat, uv=uv, noise=noise), flat, rtol=0, atol=0)


def test_gain_and_offset_go_through():
    complex_, uv, _, noisy = SCENE
    other = replace(noisy, **{level: 250 * getattr(noisy, level) - 70 for level in LEVELS})
    got, plain = denoise_signals(complex_, other, uv=uv), denoise_signals(complex_, noisy, uv=uv)
    allclose(got, replace(plain, **{level: 250 * getattr(plain, level) - 70 for level in LEVELS}), atol=1e-7)


def test_numbering_does_not_matter():
    complex_, uv, _, noisy = SCENE
    rng = np.random.default_rng(1)
    order, faces = rng.permutation(complex_.n), rng.permutation(len(complex_.faces))  # new row r is old row order[r]
    other = build_complex(np.argsort(order)[complex_.faces[faces]], complex_.n)
    edges = _rows(complex_.edges, order[other.edges], complex_.n)
    moved = replace(
        noisy, vertex=noisy.vertex[order], vertex_ok=noisy.vertex_ok[order],
        edge=noisy.edge[edges], edge_ok=noisy.edge_ok[edges], edge_uv=noisy.edge_uv[edges], edge_pixels=noisy.edge_pixels[edges],
        face=noisy.face[faces], face_ok=noisy.face_ok[faces], face_uv=noisy.face_uv[faces], face_pixels=noisy.face_pixels[faces],
    )  # fmt: skip
    got, plain = denoise_signals(other, moved, uv=uv[order]), denoise_signals(complex_, noisy, uv=uv)
    for level, rows in zip(LEVELS, (order, edges, faces), strict=True):
        np.testing.assert_allclose(getattr(got, level), getattr(plain, level)[rows], atol=1e-9)


def _rows(edges, wanted, n):
    """Where the wanted pairs are among the edges."""
    low, high = wanted.min(axis=1).astype(int), wanted.max(axis=1).astype(int)
    return np.searchsorted(edges[:, 0].astype(int) * n + edges[:, 1], low * n + high)


def test_marked_elements_stay_marked_and_say_nothing():
    complex_, uv, _, noisy = SCENE
    rng = np.random.default_rng(2)
    ok = {f"{level}_ok": rng.random(len(getattr(noisy, level))) < 0.8 for level in LEVELS}
    values = {level: np.where(ok[f"{level}_ok"], getattr(noisy, level), 0.0) for level in LEVELS}
    loud = {level: np.where(ok[f"{level}_ok"], getattr(noisy, level), 1e3) for level in LEVELS}
    got = denoise_signals(complex_, replace(noisy, **ok, **values), uv=uv)
    allclose(got, denoise_signals(complex_, replace(noisy, **ok, **loud), uv=uv), rtol=0, atol=0)
    for level in LEVELS:
        mask = ok[f"{level}_ok"]
        assert not getattr(got, level)[~mask].any()
        assert getattr(got, f"{level}_ok") is ok[f"{level}_ok"]
        assert np.isfinite(getattr(got, level)).all()


def test_noise_goes_on_every_level_and_the_rest_is_kept():
    complex_, uv, true, noisy = SCENE
    got = denoise_signals(complex_, noisy, uv=uv)
    for level, gain in zip(LEVELS, (8.0, 3.0, 2.0), strict=True):
        assert gain * mse(got, true, level) < mse(noisy, true, level)
    kept = [each.name for each in fields(noisy) if each.name not in LEVELS]
    assert all(getattr(got, name) is getattr(noisy, name) for name in kept)


def test_without_noise_signals_come_out_as_they_went_in():
    complex_, uv, true, _ = noisy_scene(0)
    got = denoise_signals(complex_, true, uv=uv)
    for level in LEVELS:
        assert mse(got, true, level) < 1e-3 * getattr(true, level).var()


def test_places_are_found_without_projections():
    complex_, uv, true, noisy = SCENE
    found, given = ours.build_graph(complex_, noisy), ours.build_graph(complex_, noisy, uv)
    assert np.median(np.abs(found.places - given.places)[: complex_.n]) < 0.5
    assert mse(denoise_signals(complex_, noisy), true) < 1.1 * mse(denoise_signals(complex_, noisy, uv=uv), true)


@pytest.mark.parametrize("noise", [0.02, 0.08, 0.3])
def test_the_noise_is_estimated(noise):
    complex_, uv, clean, _ = noisy_scene(0, n=2500, size=250)
    image = picture(250) + np.random.default_rng(3).normal(0, noise, (250, 250))
    both = sample_signals(np.stack([image, image], axis=2), uv, complex_)
    noisy = replace(clean, **{level: getattr(both, level)[:, 0] for level in LEVELS})
    graph = ours.build_graph(complex_, noisy, uv)
    found = ours.estimate_variance(graph, graph.pack(noisy)[0]) ** 0.5
    assert found == pytest.approx(noise, rel=0.2)


def test_corners_are_not_taken_for_noise():
    rng = np.random.default_rng(4)
    uv = np.stack(np.meshgrid(np.arange(10, 400, 20), np.arange(10, 400, 20)), axis=-1).reshape(-1, 2) + rng.random(
        (400, 2)
    )
    complex_ = build_complex(Delaunay(uv).simplices, 400)
    v, u = np.mgrid[:400, :400]
    blob, image = uv.astype(int), np.full((400, 400), 0.5)
    for (a, b), height in zip(blob, rng.normal(0, 0.1, 400), strict=True):  # each vertex stands on something of its own
        image[np.hypot(u - a, v - b) < 5] += height
    noisy = image + rng.normal(0, 0.01, image.shape)
    true, raw = (sample_signals(i.clip(0, 1), uv, complex_) for i in (image, noisy))
    assert mse(denoise_signals(complex_, raw, uv=uv), true) < 1.1 * mse(raw, true)


def test_channels_are_denoised_each_by_itself():
    complex_, uv, _, noisy = noisy_scene(channels=2, n=300, size=90)
    got = denoise_signals(complex_, noisy, uv=uv)
    for c in range(2):
        one = denoise_signals(
            complex_, replace(noisy, **{level: getattr(noisy, level)[:, c] for level in LEVELS}), uv=uv
        )
        for level in LEVELS:
            np.testing.assert_array_equal(getattr(got, level)[:, c], getattr(one, level))


def test_same_input_same_bytes():
    complex_, uv, _, noisy = SCENE
    allclose(denoise_signals(complex_, noisy, uv=uv), denoise_signals(complex_, noisy, uv=uv), rtol=0, atol=0)


def test_of_a_response_only_where_it_points_counts():
    complex_, uv, true, noisy = SCENE
    response = tmahf(complex_, uv, true, centering="plane")
    got = denoise_signals(complex_, noisy, uv=uv, response=response)
    bright = denoise_signals(complex_, noisy, uv=uv, response=replace(response, z=-100 * response.z))
    allclose(got, bright, atol=1e-9)
    assert mse(got, true) < mse(noisy, true) / 8
    nowhere = denoise_signals(complex_, noisy, uv=uv, response=replace(response, z=0 * response.z))
    assert np.isfinite(nowhere.vertex).all()


def system(graph, weights):
    """The dense matrix of what `relax` solves."""
    first_edge, first_face = graph.n, graph.n + len(graph.edges)
    L = np.diag(graph.own)
    rows = [(first_edge + e, k, weights[0][e, s]) for e, edge in enumerate(graph.edges) for s, k in enumerate(edge)]
    rows += [(first_face + f, k, weights[1][f, s]) for f, face in enumerate(graph.faces) for s, k in enumerate(face)]
    sides = [(f, s, k) for f, face in enumerate(graph.face_edges) for s, k in enumerate(face)]
    rows += [(first_face + f, first_edge + k, weights[2][f, s]) for f, s, k in sides]
    rows += [(first_face + f, first_face + g, w) for (f, g), w in zip(graph.pairs, weights[3], strict=True)]
    for i, j, w in rows:
        L[i, i] += w
        L[j, j] += w
        L[i, j] -= w
        L[j, i] -= w
    return L


def small_graph(seed=0):
    """Two components, a face-less edge between other vertices, a lone vertex."""
    rng = np.random.default_rng(seed)
    faces = [[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7], [6, 7, 8]]
    complex_ = build_complex(faces, 12, edges=[[9, 10]])
    uv = rng.random((12, 2)) * 39
    image = rng.random((40, 40))
    return ours.build_graph(complex_, sample_signals(image, uv, complex_), uv), rng


def weights_of(graph):
    return (
        np.empty(graph.edges.shape),
        np.empty(graph.faces.shape),
        np.empty(graph.faces.shape),
        np.empty(len(graph.pairs)),
    )


def test_steps_end_at_the_solution_of_the_system_and_components_are_separate():
    graph, rng = small_graph()
    weights = [rng.random(each.shape) for each in weights_of(graph)]
    topology = (graph.edges, graph.faces, graph.face_edges, graph.pairs)
    y = rng.random(len(graph.own))
    x, other, z = y.copy(), y.copy(), y.copy()
    _signals.relax(x, y, graph.own, *topology, tuple(weights), 60)
    np.testing.assert_allclose(x, np.linalg.solve(system(graph, weights), graph.own * y), atol=1e-12)
    other[4:9] += 10.0
    _signals.relax(z, other, graph.own, *topology, tuple(weights), 60)
    np.testing.assert_allclose(z[:4], x[:4], atol=1e-12)


def test_weights_are_those_of_the_formula():
    graph, rng = small_graph()
    topology = (graph.edges, graph.faces, graph.face_edges, graph.pairs)
    x, slope = rng.random(len(graph.own)), rng.normal(size=(graph.n, 2))
    tensor = np.stack([slope[:, 0] ** 2, slope[:, 0] * slope[:, 1], slope[:, 1] ** 2], axis=1)
    kind, usual, weights = rng.random(4), rng.random(4), weights_of(graph)
    _signals.weigh_evenly(graph.own, *topology, kind, weights)
    _signals.weigh_by_steps(x, graph.places, tensor, *topology, kind, usual, weights)
    T = np.concatenate([tensor, tensor[graph.edges].mean(axis=1), tensor[graph.faces].mean(axis=1)])

    def expected(k, i, j):
        a, b, c = (T[i] + T[j]) / 2
        d = graph.places[j] - graph.places[i]
        return kind[k] / (usual[k] + (x[i] - x[j]) ** 2 + d @ np.array([[a, b], [b, c]]) @ d)

    e, f = graph.n + 3, graph.n + len(graph.edges) + 2
    assert weights[0][3, 1] == pytest.approx(expected(0, graph.edges[3, 1], e))
    assert weights[1][2, 0] == pytest.approx(expected(1, graph.faces[2, 0], f))
    assert weights[2][2, 2] == pytest.approx(expected(2, graph.n + graph.face_edges[2, 2], f))
    pair = graph.n + len(graph.edges) + graph.pairs[1].astype(int)
    assert weights[3][1] == pytest.approx(expected(3, *pair))


def test_pairs_of_faces_share_an_edge_that_their_opposite_vertices_are_off():
    book = build_complex([[0, 1, k] for k in range(2, 5)] + [[5, 6, k] for k in range(7, 7 + _signals.FEW + 1)], 20)
    pairs, opposite = _signals.join_faces(book.faces, book.face_edges, len(book.edges))
    assert sorted(map(tuple, pairs.tolist())) == [(0, 1), (0, 2), (1, 2)]
    assert opposite.tolist() == [[f + 2 for f in pair] for pair in pairs.tolist()]


def test_a_ramp_has_its_own_slope_at_every_vertex():
    complex_, uv, _, noisy = SCENE
    graph = ours.build_graph(complex_, noisy, uv)
    slope = np.empty((complex_.n, 2))
    ramp = graph.places @ (0.3, -0.2)
    _signals.fit_slopes(ramp, graph.own, graph.places, graph.edges, graph.faces, slope)
    inside = np.setdiff1d(np.arange(complex_.n), Delaunay(uv).convex_hull)
    flattened = (
        slope[inside] @ np.array([0.3, -0.2]) / 0.13
    )  # a ridge of 2 % flattens it, the more the narrower the star
    assert np.median(np.abs(flattened - 1)) < 0.06


@pytest.mark.parametrize(
    ("faces", "n", "edges"),
    [([[0, 1, 2]], 3, None), ([], 4, [[0, 1], [1, 2]]), ([], 3, None), ([[0, 1, 2], [3, 4, 5]], 6, [[2, 3]])],
)
def test_the_smallest_complexes_have_an_answer(faces, n, edges):
    complex_ = build_complex(faces, n, edges)
    rng = np.random.default_rng(0)
    signals = sample_signals(rng.random((30, 30)), rng.random((n, 2)) * 29, complex_)
    for noise in (None, 0.1):
        got = denoise_signals(complex_, signals, noise=noise)
        assert all(np.isfinite(getattr(got, level)).all() for level in LEVELS)
        if not len(complex_.edges):
            np.testing.assert_array_equal(got.vertex, signals.vertex)


def test_an_empty_complex_is_left_alone():
    complex_ = build_complex([], 0)
    signals = sample_signals(np.zeros((2, 2)), np.zeros((0, 2)), complex_)
    assert denoise_signals(complex_, signals) is signals


def test_bad_input_is_one_line():
    complex_, uv, _, noisy = SCENE
    n = complex_.n
    cases = [
        ({"complex_": 1}, "complex_"),
        ({"signals": noisy.vertex}, "signals"),
        ({"complex_": build_cells([[0, 1, 2, 3]], 4)}, "polygons|Complex"),
        ({"complex_": build_complex([[0, 1, 2]], 3)}, r"signals.vertex has shape \(900,\)"),
        ({"signals": replace(noisy, face=noisy.face[:, None])}, "signals.face has shape"),
        ({"signals": replace(noisy, edge=np.where(np.arange(len(noisy.edge)) == 7, np.nan, noisy.edge))}, "edge 7"),
        ({"signals": replace(noisy, vertex_ok=noisy.vertex_ok[:5])}, "ok is"),
        ({"signals": replace(noisy, edge_uv=noisy.edge_uv[:5])}, "edge_uv"),
        ({"signals": replace(noisy, face_uv=noisy.face_uv * np.nan)}, "face_uv"),
        ({"signals": replace(noisy, face_pixels=noisy.face_pixels - 10**6)}, "face_uv, _pixels"),
        ({"uv": uv[:5]}, "uv has shape"),
        ({"uv": uv * np.nan}, "uv is NaN"),
        ({"noise": -1}, "noise is -1"),
        ({"noise": 1e200}, "noise is 1e"),
        ({"response": Response(np.zeros(n, complex), 1, np.ones(3, bool))}, r"shape \(900,\), \(3,\) of defined"),
        ({"noise": True}, "noise is True"),
        ({"noise": [0.1, 0.2]}, "noise is"),
        ({"response": 1}, "response"),
        ({"response": Response(np.zeros(n, complex), 2, np.ones(n, bool))}, "response has order 2"),
        ({"response": Response(np.zeros(3, complex), 1, np.ones(3, bool))}, "response has order 1 and shape"),
        ({"response": Response(np.full(n, np.nan + 0j), 1, np.ones(n, bool))}, "response holds values"),
    ]
    for given, line in cases:
        with pytest.raises(InputError, match=line):
            denoise_signals(**{"complex_": complex_, "signals": noisy, "uv": uv, **given})
