"""Laws of the quality score: identical is 0, frames, numbers and units don't matter, levels are ordered, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from tspslam import GeometryError, InputError, Signals, build_cells, build_complex, sample_signals
from tspslam.apps import _quality
from tspslam.apps.quality import compare_features, compare_quality, quality_features

WIDTH = 96
ALL = slice(None)


def picture():
    v, u = np.mgrid[:WIDTH, :WIDTH]
    return 0.5 + 0.2 * np.sin(u / 7) * np.cos(v / 9) + 0.2 * np.sign(np.sin((u + 2 * v) / 15))


def hill(n=300, seed=0):
    """Vertices on a hill before a camera, their pixels and faces."""
    uv = np.random.default_rng(seed).uniform(2, WIDTH - 3, (n, 2))
    x, y = (uv.T - WIDTH / 2) / 20
    return np.column_stack([x, y, 6 + np.sin(x) + 0.5 * np.cos(1.3 * y)]), uv, Delaunay(uv).simplices


def side(xyz, uv, faces, image=None):
    complex_ = build_complex(faces, len(xyz))
    return xyz, complex_, sample_signals(picture() if image is None else image, uv, complex_)


def spoiled(kind, amount, seed=1):
    xyz, uv, faces = hill()
    noise = np.random.default_rng(seed)
    if kind == "positions":
        return side(xyz + amount * 0.3 * noise.normal(size=xyz.shape), uv, faces)
    if kind == "texture":
        return side(xyz, uv, faces, np.clip(picture() + amount * 0.3 * noise.normal(size=(WIDTH, WIDTH)), 0, 1))
    if kind == "exposure":
        return side(xyz, uv, faces, picture() * 2**-amount)
    keep = np.argsort(noise.random(len(xyz)))[: round(len(xyz) * (1 - 0.9 * amount))]
    return side(xyz[keep], uv[keep], Delaunay(uv[keep]).simplices)


def by_features(one, other):
    return compare_features(quality_features(*one), quality_features(*other))


KINDS = ("positions", "texture", "exposure", "decimation")
each = pytest.mark.parametrize("kind", KINDS)
both = pytest.mark.parametrize("compare", [compare_quality, by_features], ids=["full", "reduced"])


@both
def test_identical_is_exactly_zero(compare):
    score, parts = compare(side(*hill()), side(*hill()))
    assert score == 0
    assert set(parts.values()) == {0.0}


def test_identical_but_with_other_numbers_is_zero():
    xyz, uv, faces = hill()
    order = np.random.default_rng(2).permutation(len(xyz))
    found = compare_quality(side(xyz, uv, faces), side(xyz[order], uv[order], np.argsort(order)[faces][::-1]))
    assert found.score < 1e-6


@both
@each
def test_score_follows_the_level(compare, kind):
    scores = [compare(side(*hill()), spoiled(kind, amount)).score for amount in (0.02, 0.06, 0.2, 0.6)]
    assert scores[0] > 0
    assert (np.diff(scores) > 0).all()
    assert scores[-1] < 1


@both
@each
def test_a_common_motion_and_unit_do_not_matter(compare, kind):
    def moved(given):
        xyz, complex_, signals = given
        turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
        return 1000 * (xyz @ turn.T + [3, -2, 5]), complex_, signals

    one, other = side(*hill()), spoiled(kind, 0.2)
    assert np.isclose(compare(moved(one), moved(other)).score, compare(one, other).score, rtol=1e-4)


@both
@pytest.mark.parametrize("kind", KINDS[:3])
def test_common_numbers_do_not_matter(compare, kind):
    xyz, uv, faces = hill()
    order = np.random.default_rng(3).permutation(len(xyz))
    moved, image = (xyz + 0.05, picture()) if kind == "positions" else (xyz, picture() ** 2)
    shuffled = np.random.default_rng(4).permutation(np.argsort(order)[faces])
    plain = compare(side(xyz, uv, faces), side(moved, uv, faces, image)).score
    again = compare(side(xyz[order], uv[order], shuffled), side(moved[order], uv[order], shuffled, image)).score
    assert np.isclose(plain, again, rtol=1e-5)


@both
def test_a_small_change_is_a_small_score(compare):
    xyz, uv, faces = hill()
    scores = []
    for step in (1e-3, 1e-4, 1e-5):
        near = side(xyz + step * np.random.default_rng(5).normal(size=xyz.shape), uv, faces, picture() * (1 - step))
        scores.append(compare(side(xyz, uv, faces), near).score)
    assert scores[0] < 0.1
    assert max(scores[1] / scores[0], scores[2] / scores[1]) < 0.2


def test_each_kind_is_seen_by_its_parts():
    reference = side(*hill())
    shape, light = (compare_quality(reference, spoiled(kind, 0.2)).parts for kind in ("positions", "exposure"))
    assert shape["geometry"] > 0.1
    assert shape["luminance"] == shape["face"] == shape["response 0"] == 0
    assert shape["response 2"] > 0.05
    assert light["geometry"] == 0
    assert light["edge"] > 0.05


def test_exposure_has_the_known_value():
    """Relative difference of s and s/2, without floors: |s - s/2| / √(s² + s²/4)."""
    xyz, uv, faces = hill()
    parts = compare_quality(side(xyz, uv, faces), side(xyz, uv, faces, picture() / 2)).parts
    assert np.allclose([parts[name] for name in ("luminance", "edge", "face", "response 0")], 1 / np.sqrt(5), atol=1e-3)


def test_a_lifted_plane_has_the_known_distance():
    v, u = np.mgrid[:6, :6] * 10.0
    uv = np.column_stack([u.ravel(), v.ravel()]) + 5
    faces, flat = Delaunay(uv + 1e-3 * np.random.default_rng(0).normal(size=uv.shape)).simplices, np.zeros((36, 1))
    low, high = (side(np.column_stack([uv, flat + z]), uv, faces) for z in (0.0, 4.0))
    complex_ = low[1]
    length = np.linalg.norm(uv[complex_.edges[:, 0]] - uv[complex_.edges[:, 1]], axis=1)
    unit = np.array([length[(complex_.edges == i).any(axis=1)].mean() for i in range(36)])
    expected = np.sqrt(np.mean((4 / unit) ** 2 / ((4 / unit) ** 2 + 0.25)))
    parts = compare_quality(low, high).parts
    assert np.isclose(parts["geometry"], expected)
    assert parts["response 1"] < 1e-12


def test_filter_agrees_with_the_plain_sum():
    xyz, complex_, signals = side(*hill(60))
    places = np.concatenate([xyz, xyz[complex_.edges].mean(axis=1), xyz[complex_.faces].mean(axis=1)])
    values = np.concatenate([signals.vertex, signals.edge, signals.face])
    ok, orders = np.random.default_rng(6).random(len(values)) < 0.8, np.array([3, 0, 1])
    axes = np.ascontiguousarray(Rotation.random(60, random_state=7).as_matrix())
    plain, texture, shape = np.zeros((60, 3)), np.zeros((60, 3), complex), np.zeros((60, 3), complex)
    _quality.filter_stars(*complex_.stars, places, axes, np.full(60, 0.3), values, ok, orders, plain, texture, shape)
    start, rows = complex_.stars
    for i in np.flatnonzero(ok[:60]):
        star = rows[start[i] : start[i + 1]]
        star = star[ok[star]]
        own = values[np.append(star, i)]
        u, v, h = axes[i] @ (places[star] - places[i]).T
        turn = np.exp(1j * np.outer(np.arctan2(v, u), orders))
        assert np.allclose(plain[i], [len(star) + 1, own.mean(), own.var()])
        assert np.allclose(texture[i], ((values[star] - own.mean())[:, None] * turn).mean(axis=0))
        assert np.allclose(shape[i], (h[:, None] * turn).mean(axis=0) / 0.3)


def test_nearest_point_is_the_nearest():
    """Against 400 points of each triangle, and the weights give the point back from the places of the elements."""
    xyz, complex_, _ = side(*hill(12))
    places = np.concatenate([xyz, xyz[complex_.edges].mean(axis=1), xyz[complex_.faces].mean(axis=1)])
    queries = xyz.mean(axis=0) + np.random.default_rng(8).normal(size=(40, 3))
    near, first = np.tile(np.arange(12), (40, 1)), (12, 12 + len(complex_.edges))
    around = (complex_.faces, complex_.face_edges, np.ones(len(complex_.faces), bool), *complex_.face_rows)
    place, nodes, weights = np.zeros((40, 3)), np.zeros((40, 3), np.int64), np.zeros((40, 3))
    _quality.find_nearest(queries, near, places, first, *around, place, nodes, weights)
    a, b = np.random.default_rng(9).random((2, 400))
    share = np.stack([1 - np.sqrt(a), np.sqrt(a) * (1 - b), np.sqrt(a) * b], axis=1)
    points = np.einsum("sk,fkx->fsx", share, xyz[complex_.faces]).reshape(-1, 3)
    best = np.linalg.norm(queries[:, None] - points, axis=2).min(axis=1)
    off = best - np.linalg.norm(queries - place, axis=1)
    assert off.min() > -1e-12
    assert off.max() < 0.2
    assert np.allclose(np.einsum("qk,qkx->qx", weights, places[nodes]), place)
    assert np.allclose(weights.sum(axis=1), 1)
    assert weights.min() >= 0


def test_other_way_counts_for_geometry():
    """A piece that only the distorted surface has is no part of the nearest points of the reference."""
    xyz, uv, faces = hill()
    extra = np.concatenate([xyz, xyz[:3] + np.array([0, 0, 50])])
    longer = side(extra, np.concatenate([uv, uv[:3]]), np.concatenate([faces, [[300, 301, 302]]]))
    assert compare_quality(side(xyz, uv, faces), longer).parts["geometry"] > 0.08


def without(given, level, rows):
    xyz, complex_, signals = given
    ok, values = getattr(signals, f"{level}_ok").copy(), getattr(signals, level).copy()
    ok[rows], values[rows] = False, 0
    return xyz, complex_, replace(signals, **{level: values, f"{level}_ok": ok})


@pytest.mark.parametrize("level", ["vertex", "edge", "face"])
def test_elements_without_a_signal_are_left_out(level):
    reference, less = side(*hill()), without(side(*hill()), level, slice(0, 40))
    parts = dict(compare_quality(reference, less).parts)
    assert parts.pop("missing") > 0
    assert max(parts.values()) == 0
    assert compare_quality(less, less).score == 0
    assert compare_quality(less, reference).score == 0  # what the original never had is not missed


def test_what_stands_under_a_mark_does_not_matter():
    one, other = side(*hill()), without(spoiled("texture", 0.2), "vertex", [3, 4])
    plain = compare_quality(one, other)
    xyz, complex_, signals = other
    xyz, vertex = xyz.copy(), signals.vertex.copy()
    xyz[3], vertex[4] = np.nan, 77
    assert compare_quality(one, (xyz, complex_, replace(signals, vertex=vertex))) == plain


def test_vertices_alone_can_be_compared():
    bare = [without(without(given, "edge", ALL), "face", ALL) for given in (side(*hill()), spoiled("texture", 0.2))]
    parts = compare_quality(*bare).parts
    assert "edge" not in parts
    assert parts["luminance"] > 0
    assert parts["missing"] == 0


@both
def test_constant_signals_and_one_face(compare):
    xyz, uv, faces = hill()
    grey = side(xyz, uv, faces, np.full((WIDTH, WIDTH), 0.5))
    assert compare(grey, grey).score == 0
    assert np.isfinite(compare(grey, side(xyz, uv, faces)).score)
    corner = [side(xyz[:3], uv[:3], [[0, 1, 2]], picture() * k) for k in (1, 0.5)]
    assert compare(corner[0], corner[0]).score == 0 < compare(*corner).score < 1


@both
def test_several_parts_a_vertex_alone_and_a_flat_face(compare):
    xyz, uv, faces = hill()
    xyz = np.concatenate([xyz, xyz + np.array([9, 0, 0]), xyz[:1]])
    twice = np.concatenate([faces, faces + 300, [[0, 1, 600]]])  # its last face has no area
    uv = np.concatenate([uv, uv, uv[:1]])
    one, other = side(xyz, uv, twice), side(xyz, uv, twice, picture() * 0.8)
    assert compare(one, one).score == 0 < compare(one, other).score < 0.5


@both
def test_an_edge_without_a_face_has_no_plane(compare):
    xyz, uv, faces = hill()
    xyz, uv = np.concatenate([xyz, xyz[:1] + np.array([[1, 2, 0]])]), np.concatenate([uv, uv[:1] + 1])
    complex_ = build_complex(faces, 301, edges=[[0, 300]])
    one, other = (sample_signals(image, uv, complex_) for image in (picture(), picture() ** 2))
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    scores = [compare((x, complex_, one), (x, complex_, other)).score for x in (xyz, xyz @ turn.T)]
    assert np.isclose(*scores, rtol=1e-5)


def test_a_one_sided_strip_has_a_score():
    angle = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    rim = [np.column_stack([(2 + s * np.cos(angle / 2)) * np.cos(angle), (2 + s * np.cos(angle / 2)) * np.sin(angle),
                            s * np.sin(angle / 2)]) for s in (-0.5, 0.5)]  # fmt: skip
    faces = [[i, i + 1, i + 12] for i in range(11)] + [[i + 1, i + 12, i + 13] for i in range(11)]
    faces += [[11, 12, 23], [12, 23, 0]]
    xyz = np.concatenate(rim)
    uv = 48 + 15 * xyz[:, :2]
    one, other = side(xyz, uv, faces), side(xyz, uv, faces, picture() * 0.8)
    assert compare_quality(one, one).score == 0 < compare_quality(one, other).score < 0.5


def test_a_surface_that_has_collapsed_has_a_score():
    xyz, uv, faces = hill()
    score, parts = compare_quality(side(xyz, uv, faces), side(np.zeros_like(xyz), uv, faces))
    assert parts["geometry"] > 0.9
    assert np.isfinite(score)


def test_channels_count_alike():
    one, other = side(*hill()), spoiled("texture", 0.3)

    def doubled(given):
        xyz, complex_, s = given
        return (
            xyz,
            complex_,
            replace(s, **{x: np.stack([getattr(s, x)] * 2, axis=1) for x in ("vertex", "edge", "face")}),
        )

    assert np.isclose(compare_quality(doubled(one), doubled(other)).score, compare_quality(one, other).score)
    assert np.allclose(quality_features(*doubled(one)), quality_features(*one))
    with pytest.raises(InputError, match="signals have 2 channels, expected 1 as in the reference"):
        compare_quality(one, doubled(other))


def test_features_are_few_and_plain():
    found = quality_features(*side(*hill()))
    assert found.shape == (256,)
    assert found.dtype == np.float32
    assert np.isfinite(found).all()


def test_features_of_what_is_enormous_are_refused():
    xyz, complex_, signals = side(*hill())
    with pytest.raises(
        InputError, match=r"quality_features: signals reach .*e\+98, expected luminance, at most 1e\+30"
    ):
        quality_features(xyz, complex_, replace(signals, vertex=signals.vertex * 1e99))


def test_features_of_a_line_are_finite():
    xyz, complex_, signals = side(*hill())
    line = quality_features(xyz * [1, 0, 0], complex_, signals)  # no area
    assert np.isfinite(compare_features(quality_features(xyz, complex_, signals), line).score)


@each
def test_features_do_not_care_which_is_first(kind):
    one, other = side(*hill()), spoiled(kind, 0.3)
    assert np.isclose(by_features(one, other).score, by_features(other, one).score)


@pytest.mark.parametrize("kind", ["texture", "decimation"])
def test_same_input_same_bytes(kind):
    one, other = side(*hill()), spoiled(kind, 0.3)
    assert compare_quality(one, other) == compare_quality(one, other)


def test_nothing_to_compare_is_refused():
    one = side(*hill())
    with pytest.raises(
        InputError, match=r"of the reference's .* elements with a signal have one here, expected at least 10%"
    ):
        compare_quality(one, without(one, "vertex", one[1].faces[1:][~np.isin(one[1].faces[1:], one[1].faces[0])]))


def test_a_complex_without_a_seen_face_is_refused():
    one = side(*hill())
    with pytest.raises(GeometryError, match="distorted: no face has signals at its three vertices"):
        compare_quality(one, without(one, "vertex", ALL))
    with pytest.raises(GeometryError, match="reference: no edge has a length"):
        compare_quality((np.zeros((300, 3)), *one[1:]), one)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda xyz, c, s: (xyz, c), r"distorted is tuple, expected a tuple \(xyz, complex_, signals\)"),
        (lambda xyz, c, s: (xyz, s, s), "distorted: complex_ is Signals, expected a Complex"),
        (lambda xyz, c, s: (xyz, c, c), "distorted: signals is Complex, expected a Signals"),
        (lambda xyz, c, s: (xyz[:-1], c, s), r"distorted: xyz has shape \(299, 3\), expected \(300, 3\)"),
        (lambda xyz, c, s: (xyz * np.nan, c, s), r"distorted: xyz is \[nan, nan, nan\] at vertex 0, expected at most"),
        (
            lambda xyz, c, s: (xyz, c, replace(s, edge=s.edge[1:])),
            r"distorted: signals.edge has shape \(880,\), expected \(881,\) or \(881, C\)",
        ),
        (lambda xyz, c, s: (xyz, c, replace(s, vertex=np.zeros((300, 0)))), r"signals.vertex has shape \(300, 0\), expected"),
        (lambda xyz, c, s: (xyz, c, replace(s, edge_ok=s.edge_ok * 1)), r"ok is int64 of shape \(881,\), expected"),
        (lambda xyz, c, s: (xyz, c, replace(s, face=s.face * np.nan)), "distorted: signals.face is not finite at face 0"),
    ],
)  # fmt: skip
def test_a_side_that_does_not_fit_is_refused(change, message):
    given = side(*hill())
    with pytest.raises(InputError, match=message):
        compare_quality(given, change(*given))


def test_polygons_are_refused():
    xyz, cells = hill(4)[0], build_cells([[0, 1, 2, 3]], 4)
    marks = [np.ones(n, bool) for n in (4, 4, 1)]
    signals = Signals(
        *(m * 0.5 for m in marks), np.zeros((4, 2)), np.zeros((1, 2)), *(np.ones(n, np.int32) for n in (4, 1)), *marks
    )
    with pytest.raises(InputError, match="polygons, expected triangles"):
        quality_features(xyz, cells, signals)


@pytest.mark.parametrize("orders", [(), (1, 1), (-1,), (0.5,)])
def test_orders_that_are_none_are_refused(orders):
    with pytest.raises(InputError, match="compare_quality"):
        compare_quality(side(*hill()), side(*hill()), orders=orders)


@pytest.mark.parametrize("features", [np.zeros(7), np.full(256, np.nan)])
def test_features_that_are_none_are_refused(features):
    with pytest.raises(InputError, match=r"distorted: features have shape .*, expected \(256,\), all of them finite"):
        compare_features(np.zeros(256), features)
