import numpy as np
import pytest

from tspslam import (
    InputError,
    betti_numbers,
    build_cells,
    build_complex,
    grow_labels,
    hodge_decompose,
    merge_cells,
    merge_signals,
    sample_signals,
    smooth_signals,
    tmahf,
    tmahf_bank,
)

from .scenes import grid_faces, noise, scattered, torus_faces

UV, COMPLEX = scattered(60)
MARKED = np.where(np.arange(60)[:, None] % 13 == 5, np.nan, UV)
IMAGE = noise()
LABELS = grow_labels(COMPLEX, 4)
TORUS = build_complex(torus_faces(), 192)


def loose(complex_):
    """The same complex with edges that stand without a face."""
    return build_complex(complex_.faces[10:], complex_.n, edges=[*complex_.edges[:5], [0, complex_.n - 1]])


def test_one_cell_per_face_is_what_the_simplices_are():
    for complex_ in (COMPLEX, TORUS, loose(COMPLEX)):
        cells = merge_cells(complex_, np.arange(len(complex_.faces)))
        for name in ("B1", "B2", "L0", "L1", "L2"):
            assert abs(getattr(cells, name) - getattr(complex_, name)).max() == 0
        for one, other in zip(cells.neighbours(), complex_.neighbours(), strict=True):
            np.testing.assert_array_equal(one.toarray(), other.toarray())
        assert (cells.euler, betti_numbers(cells)) == (complex_.euler, betti_numbers(complex_))
        np.testing.assert_array_equal([cell.tolist() for cell in cells.faces], complex_.faces)


def test_one_cell_per_face_has_the_same_signals_and_responses():
    signals = sample_signals(IMAGE, MARKED, COMPLEX)
    labels = np.arange(len(COMPLEX.faces))
    cells, merged = merge_cells(COMPLEX, labels), merge_signals(COMPLEX, labels, signals)
    for name in vars(signals):
        np.testing.assert_allclose(getattr(merged, name), getattr(signals, name), atol=1e-15)
    for weight in (None, lambda d: float(d <= 2)):
        one, other = (tmahf(c, MARKED, s, weight=weight) for c, s in ((cells, merged), (COMPLEX, signals)))
        np.testing.assert_allclose(one.z, other.z, atol=1e-12)
        np.testing.assert_array_equal(one.defined, other.defined)


@pytest.mark.parametrize("size", [2, 4, 9])
def test_boundary_of_boundary_is_zero_and_the_topology_stays(size):
    for complex_ in (COMPLEX, TORUS, loose(COMPLEX)):
        cells = merge_cells(complex_, grow_labels(complex_, size))
        assert abs(cells.B1 @ cells.B2).max() == 0
        inside = cells.n - len(np.unique(cells.edges))
        unused = complex_.n - len(np.unique(complex_.edges))
        before, after = betti_numbers(complex_), betti_numbers(cells)
        assert after == (before.components + inside - unused, before.cycles, before.voids)


def test_a_cell_is_the_signed_sum_of_its_faces():
    cells = merge_cells(COMPLEX, LABELS)
    kept = [COMPLEX.edges.tolist().index(edge) for edge in cells.edges.tolist()]
    uv = UV[COMPLEX.faces]
    u, v = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    turn = np.sign(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).astype(int)
    oriented = COMPLEX.B2.toarray() * turn
    for k in range(len(cells.faces)):
        total = oriented[:, k == LABELS].sum(axis=1)
        column = cells.B2.toarray()[:, k]
        assert np.array_equal(total[kept], column) or np.array_equal(total[kept], -column)
        assert np.delete(total, kept).any() == 0


def test_cycles_start_at_their_smallest_vertex_and_go_to_its_smaller_neighbour():
    for cell in merge_cells(COMPLEX, LABELS).faces:
        assert cell[0] == cell.min()
        assert cell[1] < cell[-1]
        assert len(set(cell.tolist())) == len(cell)
    turned = build_cells([[3, 2, 1, 0], [5, 4, 3, 2]], 6)
    assert [cell.tolist() for cell in turned.faces] == [[0, 1, 2, 3], [2, 3, 4, 5]]
    assert turned.faces[-1].tolist() == [2, 3, 4, 5]
    with pytest.raises(IndexError):
        turned.faces[2]


def test_cells_that_are_given_are_those_that_are_merged():
    merged = merge_cells(COMPLEX, LABELS)
    given = build_cells([np.roll(cell, 2)[::-1] for cell in merged.faces], COMPLEX.n)
    np.testing.assert_array_equal(given.edges, merged.edges)
    assert abs(given.B2 - merged.B2).max() == 0


def test_the_signal_of_a_cell_is_the_mean_over_the_pixels_of_its_faces():
    signals = sample_signals(noise((40, 60, 3)), MARKED, COMPLEX, channels="all")
    merged = merge_signals(COMPLEX, LABELS, signals)
    for k in range(LABELS.max() + 1):
        mine = k == LABELS
        assert merged.face_ok[k] == signals.face_ok[mine].all()
        if merged.face_ok[k]:
            weight = signals.face_pixels[mine]
            np.testing.assert_allclose(merged.face[k], np.average(signals.face[mine], axis=0, weights=weight))
            np.testing.assert_allclose(merged.face_uv[k], np.average(signals.face_uv[mine], axis=0, weights=weight))
            assert merged.face_pixels[k] == weight.sum()
        else:
            assert (merged.face[k], merged.face_pixels[k]) == (pytest.approx(0), 0)


def test_cells_without_a_pixel_take_the_plain_mean():
    uv, square = np.array([[3.2, 3.2], [3.6, 3.2], [3.6, 3.6], [3.2, 3.6]]), build_complex([[0, 1, 2], [0, 2, 3]], 4)
    signals = sample_signals(IMAGE, uv, square)
    assert signals.face_pixels.tolist() == [0, 0]
    assert merge_signals(square, [0, 0], signals).face[0] == pytest.approx(signals.face.mean())


@pytest.mark.parametrize("order", [0, 1, 2])
def test_the_filter_on_cells_is_the_sum_over_their_elements(order):
    cells = merge_cells(COMPLEX, LABELS)
    signals = merge_signals(COMPLEX, LABELS, sample_signals(IMAGE, MARKED, COMPLEX))
    got = tmahf(cells, MARKED, signals, order=order, centering="none")
    for i in np.flatnonzero(got.defined):
        mine = [f for f, cell in enumerate(cells.faces) if i in cell]
        edges = sorted({e for f in mine for e in cells.face_edges[f].tolist()})
        ends = np.unique([edge for edge in cells.edges.tolist() if i in edge])
        z = signals.vertex[i] if order == 0 else 0
        for rows, values, places, ok in (
            ([int(j) for j in ends if j != i], signals.vertex, MARKED, signals.vertex_ok),
            (edges, signals.edge, signals.edge_uv, signals.edge_ok),
            (mine, signals.face, signals.face_uv, signals.face_ok),
        ):
            for x in rows:
                if ok[x]:
                    du, dv = places[x] - MARKED[i]
                    z += values[x] * np.exp(1j * order * np.arctan2(dv, du))
        assert got.z[i] == pytest.approx(z, abs=1e-10)


def test_every_tool_takes_cells():
    cells = merge_cells(TORUS, grow_labels(TORUS, 3))
    flow = np.random.default_rng(0).normal(size=len(cells.edges))
    parts = hodge_decompose(cells, flow)
    np.testing.assert_allclose(sum(parts), flow)
    assert abs(parts.gradient @ parts.curl) + abs(parts.curl @ parts.harmonic) < 1e-9
    assert np.linalg.norm(cells.B2.T @ parts.harmonic) + np.linalg.norm(cells.B1 @ parts.curl) < 1e-9
    flat = merge_signals(COMPLEX, LABELS, sample_signals(np.full((40, 60), 0.3), UV, COMPLEX))
    planar = merge_cells(COMPLEX, LABELS)
    np.testing.assert_allclose(smooth_signals(planar, flat, 2.0).face, 0.3, atol=1e-9)
    bank = tmahf_bank(planar, UV, flat, (1,), (1, 2))
    assert np.abs(bank.z).max() < 1e-9


def test_discs_have_at_most_so_many_faces_and_hold_all():
    for size in (1, 2, 7, 1000):
        labels = grow_labels(COMPLEX, size)
        assert np.bincount(labels).max() <= size
        assert np.bincount(labels).min() >= 1
        merge_cells(COMPLEX, labels)  # refuses what is no disc
    assert grow_labels(build_complex([], 3), 2).tolist() == []
    assert len(merge_cells(build_complex([], 3), []).faces) == 0


def test_labels_may_be_any_integers():
    odd = np.array([-5, 10**15])[LABELS % 2] + 7 * LABELS
    names = np.unique(odd)
    place = np.searchsorted(names, odd)
    one, other = merge_cells(COMPLEX, odd), merge_cells(COMPLEX, place)
    np.testing.assert_array_equal(one.faces.items, other.faces.items)


GRID = build_complex(grid_faces(4, 4), 16)


@pytest.mark.parametrize(("call", "message"), [
    (lambda: merge_cells(COMPLEX, LABELS[:-1]), r"labels are int64 of shape"),
    (lambda: merge_cells(COMPLEX, LABELS * 1.0), r"labels are float64 of shape"),
    (lambda: merge_cells(merge_cells(COMPLEX, LABELS), LABELS), "has cells already"),
    (lambda: grow_labels(merge_cells(COMPLEX, LABELS), 2), "has cells already"),
    (lambda: grow_labels(COMPLEX, 0), "size is 0, expected a positive integer"),
    (lambda: merge_cells(TORUS, np.zeros(384, int)), "label 0 joins 384 faces whose rim is not one cycle"),
    (lambda: merge_cells(GRID, np.r_[0, np.arange(1, 17), 0]), "label 0 joins 2 faces whose rim is not one cycle"),
    (lambda: merge_cells(build_complex([[0, 1, 2], [2, 3, 4]], 5), [3, 3]), "label 3 joins 2 faces whose rim is not one"),
    (lambda: merge_cells(build_complex([[0, 1, 2], [0, 1, 3], [0, 1, 4]], 5), [1, 1, 1]), "3 faces that are no disc"),
    (lambda: merge_cells(TORUS, (np.arange(384) > 0) * 1), "label 1 joins 383 faces that are no disc"),
    (lambda: sample_signals(IMAGE, UV, merge_cells(COMPLEX, LABELS)), "its faces are polygons, expected triangles"),
    (lambda: merge_signals(TORUS, np.arange(384), sample_signals(IMAGE, UV, COMPLEX)), "expected those of 384 faces"),
    (lambda: merge_signals(COMPLEX, sample_signals(IMAGE, UV, COMPLEX), LABELS), "signals is ndarray, expected a Signals"),
    (lambda: build_cells([[0, 1]], 3), r"cell 0 is \[0, 1\], expected a cycle of 3 or more"),
    (lambda: build_cells([[0, 1, 2], [0, 1, 2, 1]], 3), r"cell 1 is \[0, 1, 2, 1\]"),
    (lambda: build_cells([[0, 1, 3]], 3), "expected a cycle of 3 or more distinct vertices in 0..2"),
    (lambda: build_cells([[0.5, 1, 2]], 3), r"cell 0 is float64 of shape \(3,\), expected a row of integers"),
    (lambda: build_cells([[0, 1, 2]], 3, edges=[[0, 0]]), "edge 0"),
    (lambda: build_cells([], -1), "n is -1"),
])  # fmt: skip
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
