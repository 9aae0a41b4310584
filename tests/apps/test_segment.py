"""Laws of segmentation: known regions, nothing that depends on names, units or turns, and one line for bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage.metrics import adapted_rand_error

from benchmarks.uses import segment_measures as measures
from tspslam import build_complex, grow_labels, merge_cells, sample_signals, tmahf, tmahf_bank
from tspslam.apps import _segment
from tspslam.apps.segment import disc_labels, segment
from tspslam.errors import InputError


def grid(rows=21, columns=21, step=8.0):
    """A sheet of triangles over the image: complex, uv."""
    uv = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * step
    at = np.arange(rows * columns).reshape(rows, columns)[:-1, :-1].ravel()
    lower = np.stack([at, at + 1, at + columns + 1], axis=1)
    upper = np.stack([at, at + columns + 1, at + columns], axis=1)
    return build_complex(np.concatenate([lower, upper]), len(uv)), uv.astype(float)


def flat_grey(uv):
    return np.full(np.ceil(uv.max(axis=0)[::-1] + 1).astype(int), 0.5)


def crease(uv, noise, seed=0):
    """Two planes at 90 degrees that meet in the middle column, with noise on each axis, in steps of the grid."""
    x, y = (uv / 8 - uv.max(axis=0) / 16).T
    xyz = np.column_stack([x, y, np.abs(x)]) * (np.sqrt(0.5), 1, np.sqrt(0.5))
    return xyz + np.random.default_rng(seed).normal(0, noise, xyz.shape)


def rand(a, b):
    return measures.adjusted_rand(np.asarray(a), np.asarray(b), np.ones(len(a)))


@pytest.fixture(scope="module")
def folded():
    complex_, uv = grid()
    signals = sample_signals(flat_grey(uv), uv, complex_)
    return complex_, uv, signals, crease(uv, 0.05)


def textured(uv, seed=1):
    from scipy.ndimage import gaussian_filter

    image = gaussian_filter(np.random.default_rng(seed).normal(size=flat_grey(uv).shape), 5)
    return (image - image.min()) / np.ptp(image)


def test_a_constant_plane_is_one_region():
    complex_, uv = grid()
    signals = sample_signals(flat_grey(uv), uv, complex_)
    flat = np.column_stack([uv / 8, np.zeros(len(uv))])
    noisy = flat + np.random.default_rng(0).normal(0, 0.1, flat.shape)
    for xyz in (None, flat, noisy):
        labels = segment(complex_, signals, xyz=xyz)
        assert labels.dtype == np.int32
        assert not labels.any()


def test_two_planes_that_meet_in_a_crease_are_two_regions(folded):
    complex_, uv, signals, xyz = folded
    truth = uv[complex_.faces].mean(axis=1)[:, 0] > 80
    labels = segment(complex_, signals, xyz=xyz)
    assert labels.max() == 1
    assert rand(truth, labels) > 0.95


def test_two_planes_are_told_apart_by_normals_alone(folded):
    complex_, uv, signals, _ = folded
    side = np.where(uv[:, 0] > 80, 1.0, -1.0)
    at_vertices = np.column_stack([side, 0 * side, -np.ones(len(uv))]) / np.sqrt(2)
    truth = uv[complex_.faces].mean(axis=1)[:, 0] > 80
    of_faces = np.where(truth[:, None], (0.6, 0, -0.8), (-0.6, 0, -0.8))
    assert rand(truth, segment(complex_, signals, normals=of_faces)) == 1
    assert rand(truth, segment(complex_, signals, normals=at_vertices)) > 0.9


def test_a_covariance_along_the_rays_lets_a_far_plane_be_noisy():
    complex_, uv = grid()
    signals = sample_signals(flat_grey(uv), uv, complex_)
    ray = np.column_stack([(uv - 80) / 400, np.ones(len(uv))])
    depth = np.where(uv[:, 0] > 80, 12.0, 4.0)
    sigma = 0.01 * depth**2
    noisy = depth + sigma * np.random.default_rng(0).normal(size=len(uv))
    covariance = sigma[:, None, None] ** 2 * ray[:, :, None] * ray[:, None, :]
    labels = segment(complex_, signals, xyz=noisy[:, None] * ray, covariance=covariance)
    far = (uv[complex_.faces, 0] > 80).all(axis=1)
    near = (uv[complex_.faces, 0] <= 80).all(axis=1)
    assert np.unique(labels[far]).size == np.unique(labels[near]).size == 1
    assert labels[far][0] != labels[near][0]


def test_a_checkerboard_on_a_plane_is_its_squares():
    complex_, uv = grid(33, 33, step=20.0)
    v, u = np.mgrid[:641, :641]
    bright = ((u // 160 + v // 160) % 2).astype(bool)
    signals = sample_signals(np.where(bright, 0.8, 0.2), uv, complex_)
    labels = segment(complex_, signals, xyz=np.column_stack([uv, np.zeros(len(uv))]))
    column, row = (uv[complex_.faces].mean(axis=1) // 160).T
    assert rand(4 * row + column, labels) > 0.95


def test_texture_tells_regions_of_one_mean_apart():
    complex_, uv = grid(41, 41)
    rough = uv[:, 0] > 160
    signals = sample_signals(flat_grey(uv), uv, complex_)
    z = np.where(rough, 0.3, 0.01) * np.exp(1j * np.arange(len(uv)))
    response = replace(tmahf(complex_, uv, signals), z=z, defined=np.ones(len(uv), bool))
    truth = uv[complex_.faces].mean(axis=1)[:, 0] > 160
    assert not segment(complex_, signals, scale=0.3).any()
    assert rand(truth, segment(complex_, signals, response, scale=0.3)) > 0.9


def test_regions_only_join_as_the_scale_grows(folded):
    complex_, uv, _, xyz = folded
    signals = sample_signals(textured(uv), uv, complex_)
    finer, counts = None, []
    for scale in (0.01, 0.1, 0.5, 1, 3, 10, 1e6):
        labels = segment(complex_, signals, xyz=xyz, scale=scale)
        counts.append(labels.max() + 1)
        if finer is not None:  # each region of the finer one lies in one of the coarser
            assert len(np.unique(np.stack([finer, labels]), axis=1).T) == finer.max() + 1
        finer = labels
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 20
    assert counts[-1] == 1


def test_labels_are_named_by_their_first_faces_and_connected(folded):
    complex_, uv, _, xyz = folded
    labels = segment(complex_, sample_signals(textured(uv), uv, complex_), xyz=xyz, scale=0.1)
    _, first = np.unique(labels, return_index=True)
    assert (np.diff(first) > 0).all()
    assert labels[0] == 0
    pairs, _ = _segment.pairs_at_edges(complex_.face_edges, len(complex_.edges))
    same = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    count, _ = connected_components(coo_array((np.ones(len(same)), same.T), shape=(len(labels),) * 2))
    assert count == labels.max() + 1


@pytest.mark.parametrize("seed", [0, 1])
def test_other_numbers_of_vertices_and_faces_change_names_only(folded, seed):
    complex_, uv, _, xyz = folded
    image, rng = textured(uv), np.random.default_rng(seed)
    vertex, face = rng.permutation(complex_.n), rng.permutation(len(complex_.faces))
    place = np.argsort(vertex)
    other = build_complex(place[complex_.faces[face]], complex_.n)
    one = segment(complex_, sample_signals(image, uv, complex_), xyz=xyz, scale=0.3)
    two = segment(other, sample_signals(image, uv[vertex], other), xyz=xyz[vertex], scale=0.3)
    assert one.max() == two.max() > 3
    assert rand(one[face], two) == 1


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("unit", [1000, 1e30, 1e-30])
def test_units_and_turns_do_not_matter(folded, given, unit):
    complex_, uv, _, xyz = folded
    signals = sample_signals(textured(uv), uv, complex_)
    noise = np.tile(np.diag([0.02, 0.03, 0.04]) ** 2, (len(xyz), 1, 1)) if given else None
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turned = unit**2 * turn @ noise @ turn.T if given else None
    one = segment(complex_, signals, xyz=xyz, covariance=noise, scale=0.3)
    moved = unit * (xyz @ turn.T + (5, -7, 9))
    two = segment(complex_, signals, xyz=moved, covariance=turned, scale=0.3)
    assert one.max() > 3
    assert rand(one, two) == 1


def test_the_same_input_gives_the_same_bytes(folded):
    complex_, _uv, signals, xyz = folded
    assert segment(complex_, signals, xyz=xyz).tobytes() == segment(complex_, signals, xyz=xyz).tobytes()


def test_off_plane_agrees_with_the_generalised_eigenvalue():
    from scipy.linalg import eigh

    rng = np.random.default_rng(0)
    for _ in range(20):
        root = rng.normal(size=(3, 3))
        C, xyz = root @ root.T, rng.normal(size=(9, 3)) * rng.uniform(0.01, 10, 3) + rng.normal(size=3)
        s = np.zeros(_segment.GEOMETRY)
        for x in xyz:
            _segment.add_point(x, C, 1.0, s)
        scatter = (xyz - xyz.mean(axis=0)).T @ (xyz - xyz.mean(axis=0))
        expected = eigh(scatter, len(xyz) * (C + 1e-4 * np.trace(C) * np.eye(3)), eigvals_only=True)[0]
        assert _segment.off_plane(s) == pytest.approx(expected, rel=1e-5)


def test_points_on_a_line_lie_in_a_plane():
    s = np.zeros(_segment.GEOMETRY)
    assert _segment.off_plane(s) == 0
    for t in np.linspace(-3, 7, 9):
        _segment.add_point(np.array([1.1, -0.7, 0.3]) * t + 5, np.eye(3) * 1e-4, 1.0, s)
    assert _segment.off_plane(s) == 0


def test_noise_is_measured_on_the_surface(folded):
    complex_, _, _, xyz = folded
    degree = np.bincount(complex_.edges.ravel(), minlength=complex_.n)
    spread = _segment.ring_spread(complex_.edges, xyz, degree)
    assert np.median(spread[spread >= 0]) == pytest.approx(0.05, rel=0.2)
    assert (spread[degree < 4] == -1).all()


def test_faces_without_a_signal_go_with_their_plane(folded):
    complex_, _uv, signals, xyz = folded
    dark = np.arange(len(complex_.faces)) % 3 == 0
    marked = replace(signals, face=np.where(dark, 0, signals.face), face_ok=~dark)
    assert rand(segment(complex_, signals, xyz=xyz), segment(complex_, marked, xyz=xyz)) > 0.95
    assert not segment(complex_, marked).any()


def without_signal(signals):
    none = {f"{level}_ok": np.zeros_like(getattr(signals, f"{level}_ok")) for level in ("vertex", "edge", "face")}
    return replace(signals, vertex=0 * signals.vertex, edge=0 * signals.edge, face=0 * signals.face, **none)


def test_without_any_signal_geometry_alone_decides_and_else_components(folded):
    complex_, _uv, signals, xyz = folded
    nothing = without_signal(signals)
    assert segment(complex_, nothing, xyz=xyz).max() == 1
    assert not segment(complex_, nothing).any()
    unknown = np.full(xyz.shape, np.nan)
    assert not segment(complex_, nothing, xyz=unknown, normals=unknown).any()


def test_components_are_never_in_one_region():
    two = build_complex([[0, 1, 2], [2, 3, 4], [5, 6, 7]], 8)  # the first two share a vertex only
    signals = sample_signals(np.full((9, 9), 0.5), np.random.default_rng(0).uniform(0, 8, (8, 2)), two)
    assert segment(two, signals, scale=1e9).tolist() == [0, 1, 2]


def test_one_face_and_none():
    one, none = build_complex([[0, 1, 2]], 3), build_complex(np.empty((0, 3), np.int32), 3)
    uv = [[0, 0], [4, 0], [0, 4]]
    for complex_, expected in ((one, [0]), (none, [])):
        signals = sample_signals(np.full((5, 5), 0.5), uv, complex_)
        assert segment(complex_, signals, xyz=np.eye(3), normals=np.eye(3)).tolist() == expected
    assert segment(one, sample_signals(np.full((5, 5), 0.5), uv, one), xyz=np.zeros((3, 3))).tolist() == [0]


def test_colours_tell_apart_what_luminance_does_not():
    complex_, uv = grid()
    image = np.zeros((161, 161, 3))
    image[:, :81, 0], image[:, 81:, 1] = 0.587, 0.299
    colour, grey = sample_signals(image, uv, complex_, channels="all"), sample_signals(image, uv, complex_)
    assert not segment(complex_, grey).any()
    assert segment(complex_, colour, tmahf_bank(complex_, uv, grey, orders=(1, 2))).max() >= 1


def test_three_faces_at_an_edge_are_joined():
    book = build_complex([[0, 1, 2], [0, 1, 3], [0, 1, 4]], 5)
    signals = without_signal(sample_signals(np.full((9, 9), 0.5), np.eye(5, 2) * 8, book))
    assert segment(book, signals).tolist() == [0, 0, 0]


def test_discs_fit_cells(folded):
    complex_, uv, _, xyz = folded
    labels = segment(complex_, sample_signals(textured(uv), uv, complex_), xyz=xyz, scale=0.3)
    ring = (np.abs(uv[complex_.faces].mean(axis=1) - 80).max(axis=1) < 30).astype(int)
    with pytest.raises(InputError, match="expected a disc"):
        merge_cells(complex_, ring)
    for regions in (labels, ring, grow_labels(complex_, 7)):
        discs = disc_labels(complex_, regions)
        merged = merge_cells(complex_, discs)
        assert len(merged.faces) == discs.max() + 1 >= np.unique(regions).size
        assert (merged.B1 @ merged.B2).nnz == 0 or not np.any((merged.B1 @ merged.B2).toarray())
        assert len(np.unique(np.stack([regions, discs]), axis=1).T) == discs.max() + 1
    assert not disc_labels(complex_, np.zeros(len(labels), int)).any()


BAD = {
    "scale is 0, expected a number above 0": {"scale": 0},
    "scale is nan, expected a number above 0": {"scale": np.nan},
    "xyz has shape (3, 3), expected (441, 3)": {"xyz": np.eye(3)},
    "xyz: row 0 has numbers over 1e+75": {"xyz": np.full((441, 3), np.inf)},
    "covariance is given without xyz": {"covariance": np.zeros((441, 3, 3))},
    "covariance has negative variances": {"xyz": np.zeros((441, 3)), "covariance": np.full((441, 3, 3), -1.0)},
    "normals has shape (5, 3), expected (800, 3) or (441, 3)": {"normals": np.ones((5, 3))},
    "normals: row 0 has length 2, expected 1": {"normals": np.tile([0.0, 0, 2], (800, 1))},
    "response is int, expected a Response or a Bank": {"response": 5},
}


@pytest.mark.parametrize("line", BAD)
def test_bad_arguments_get_one_line(folded, line):
    complex_, _, signals, _ = folded
    with pytest.raises(InputError) as error:
        segment(complex_, signals, **BAD[line])
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def test_signals_and_complexes_that_do_not_fit_are_refused(folded):
    complex_, uv, signals, _ = folded
    other, small_uv = grid(3, 3)
    small = sample_signals(flat_grey(small_uv), small_uv, other)
    cells = merge_cells(other, np.arange(len(other.faces)))
    for call, line in (
        (
            lambda: segment(complex_, small),
            "signals are on (9, 16, 8) vertices, edges and faces, expected (441, 1240, 800)",
        ),
        (lambda: segment(cells, small), "expected triangles"),
        (lambda: segment(other, 3), "expected a Signals"),
        (lambda: segment(None, small), "expected a Complex"),
        (lambda: segment(other, small, tmahf(complex_, uv, signals)), "response is at 441 vertices, expected 9"),
        (lambda: segment(other, replace(small, face=np.full(8, np.nan))), "expected a number up to"),
        (lambda: disc_labels(other, [0.5] * 8), "expected (8,) integers"),
    ):
        with pytest.raises(InputError) as error:
            call()
        assert line in str(error.value)


def test_rand_index_agrees_with_hand_and_with_scikit_image():
    truth, labels = np.array([0, 0, 1, 1]), np.array([0, 0, 1, 2])
    assert measures.adjusted_rand(truth, truth[::-1], np.ones(4)) == 1
    assert measures.adjusted_rand(truth, labels, np.ones(4)) == pytest.approx(4 / 7)  # (1 - 1/3) / (3/2 - 1/3)
    assert measures.adjusted_rand(truth, np.zeros(4, int), np.ones(4)) == 0
    rng = np.random.default_rng(0)
    a, b = rng.integers(1, 4, 60), rng.integers(1, 5, 60)
    shared = measures.overlaps(a, b, np.ones(60))
    own = sum((shared.sum(axis=axis) ** 2).sum() for axis in (0, 1))
    error = 1 - 2 * ((shared**2).sum() - 60) / (own - 2 * 60)  # from the same pairs
    assert adapted_rand_error(a, b)[0] == pytest.approx(error)
    weight = rng.integers(1, 4, 60)
    repeated = measures.adjusted_rand(np.repeat(a, weight), np.repeat(b, weight), np.ones(weight.sum()))
    assert measures.adjusted_rand(a, b, weight) == pytest.approx(repeated)


def test_leaks_and_boundaries_of_known_cases():
    truth, whole = np.array([0, 0, 1, 1]), np.zeros(4, int)
    assert measures.under_segmentation(truth, truth, np.ones(4)) == 0
    assert measures.under_segmentation(truth, whole, np.ones(4)) == 1  # it lies in both, and counts for both
    assert measures.under_segmentation(truth, whole, np.array([99.0, 0, 1, 0])) == 0  # 1 % is forgiven
    lines = np.zeros((3, 20, 20), bool)
    lines[0, :, 5], lines[1, :, 8], lines[2, :, 9] = True, True, True
    assert measures.boundary_f(lines[0], lines[1]) == 1
    assert measures.boundary_f(lines[0], lines[2]) == 0
    assert measures.boundary_f(lines[0], lines[0] | lines[2]) == pytest.approx(2 / 3)
    assert measures.boundary_f(0 * lines[0] > 0, lines[0]) == 0


def test_faces_take_the_label_that_most_of_their_pixels_show():
    image = np.zeros((11, 11), int)
    image[:, 4:] = 7
    uv = np.array([[0.0, 0], [10, 0], [10, 10], [3.2, 3.4], [3.3, 3.4], [3.2, 3.5]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    cover = measures.covered(faces, uv, image.shape)
    assert measures.carried(image, cover, 2).tolist() == [7, 0]
    drawn = measures.borders(np.array([0, 1]), np.array([[0, 1]]), np.array([[[2.0, 2], [2, 6]]]), (11, 11))
    assert np.argwhere(drawn).tolist() == [[v, 2] for v in range(2, 7)]


def test_without_signals_shape_alone_counts():
    i, j = np.divmod(np.arange(200), 20)
    bent = np.column_stack([i, np.minimum(j, 10), np.maximum(j - 10, 0)]).astype(float)
    cell = np.array([20 * r + c for r in range(9) for c in range(19)])
    faces = np.concatenate([np.stack([cell, cell + 1, cell + 21], 1), np.stack([cell, cell + 21, cell + 20], 1)])
    complex_ = build_complex(faces, 200)
    labels = segment(complex_, None, xyz=bent)
    is_low = bent[complex_.faces][:, :, 2].max(axis=1) == 0
    assert len(np.unique(labels)) == 2
    assert len(np.unique(labels[is_low])) == 1


def test_a_fan_of_many_faces_on_one_edge_is_cut_into_discs():
    fan = build_complex([[0, 1, k] for k in range(2, 40)], 40)
    discs = disc_labels(fan, np.zeros(38, int))
    assert len(merge_cells(fan, discs).faces) == discs.max() + 1 == 19  # no edge has three faces of one disc


def test_what_stands_in_marked_faces_is_not_looked_at():
    complex_, uv = grid()
    signals = sample_signals(flat_grey(uv), uv, complex_)
    ok, value = np.ones(len(complex_.faces), bool), signals.face.copy()
    ok[7], value[7] = False, np.nan
    other = value.copy()
    other[7] = 0.3
    marked = [segment(complex_, replace(signals, face=each, face_ok=ok)) for each in (value, other)]
    assert np.array_equal(*marked)
