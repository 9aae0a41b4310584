import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam import InputError, build_complex, unsigned_laplacian

from . import truth
from .scenes import FIGURE_2, OCTAHEDRON, grid_faces, scattered, torus_faces


@st.composite
def complexes(draw):
    n = draw(st.integers(3, 12))
    triple = st.lists(st.integers(0, n - 1), min_size=3, max_size=3, unique=True)
    pair = st.lists(st.integers(0, n - 1), min_size=2, max_size=2, unique=True)
    return build_complex(draw(st.lists(triple, max_size=20)), n, draw(st.lists(pair, max_size=6)))


@given(complexes())
@settings(max_examples=60, deadline=None)
def test_boundary_of_boundary_is_zero(complex_):
    assert abs(complex_.B1 @ complex_.B2).sum() == 0


@pytest.mark.parametrize(("faces", "n", "euler"), [
    (grid_faces(), 30, 1), (OCTAHEDRON, 6, 2), (torus_faces(), 192, 0), (torus_faces(3, 3), 9, 0),
])  # fmt: skip
def test_euler_characteristic_of_plane_sphere_and_torus(faces, n, euler):
    assert build_complex(faces, n).euler == euler


def test_figure_2_of_the_paper_to_the_letter():
    toy = build_complex(FIGURE_2, 5)
    assert (toy.n, len(toy.edges), len(toy.faces)) == (5, 7, 3)
    assert (toy.edges + 1).tolist() == [[1, 2], [1, 3], [1, 4], [2, 3], [2, 5], [3, 4], [3, 5]]
    columns = [[0, 1, -1, 0, 0, 1, 0], [1, -1, 0, 1, 0, 0, 0], [0, 0, 0, 1, -1, 0, 1]]
    assert toy.B2.toarray().T.tolist() == columns
    assert toy.B1.toarray()[:, 0].tolist() == [-1, 1, 0, 0, 0]


@given(complexes())
@settings(max_examples=40, deadline=None)
def test_laplacians_are_products_of_incidences_symmetric_and_positive_semidefinite(complex_):
    B1, B2 = complex_.B1.toarray().astype(float), complex_.B2.toarray().astype(float)
    for got, expected in ((complex_.L0, B1 @ B1.T), (complex_.L1, B1.T @ B1 + B2 @ B2.T), (complex_.L2, B2.T @ B2)):
        assert np.array_equal(got.toarray(), expected)
        assert np.array_equal(expected, expected.T)
        assert len(expected) == 0 or np.linalg.eigvalsh(expected).min() > -1e-9


@given(complexes())
@settings(max_examples=60, deadline=None)
def test_neighbourhoods_are_those_of_equations_14_to_16(complex_):
    rows = (complex_.vertex_rows, complex_.edge_rows, complex_.face_rows)
    for i in range(complex_.n):
        for (start, indices), expected in zip(rows, truth.neighbour_sets(complex_, i), strict=True):
            row = indices[start[i] : start[i + 1]].tolist()
            assert len(row) == len(set(row))
            assert set(row) == expected


def test_neighbour_matrices_are_the_unsigned_products():
    _, complex_ = scattered()
    vertex, edge, face = complex_.neighbours()
    incident = abs(complex_.B1) @ abs(complex_.B2) > 0
    assert (face.toarray() > 0).tolist() == incident.toarray().tolist()
    assert (edge.toarray() > 0).tolist() == ((incident @ abs(complex_.B2).T) > 0).toarray().tolist()
    adjacent = (complex_.L0.toarray() != 0) & ~np.eye(complex_.n, dtype=bool)
    assert np.array_equal(vertex.toarray() > 0, adjacent)


def test_edges_are_the_sorted_unique_sides_and_the_given_ones():
    complex_ = build_complex([[2, 0, 1], [1, 2, 3]], 6, edges=[[5, 4], [1, 0], [0, 3]])
    assert complex_.edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3], [4, 5]]
    assert complex_.faces.tolist() == [[0, 1, 2], [1, 2, 3]]
    sides = complex_.edges[complex_.face_edges]
    assert sides.tolist() == [[[0, 1], [1, 2], [0, 2]], [[1, 2], [2, 3], [1, 3]]]


@pytest.mark.parametrize("fan", [1, 100])
def test_repeated_faces_merge_into_the_first(fan):
    faces = [[0, 1, k + 2] for k in range(fan)]
    complex_ = build_complex([*faces, [2, 1, 0], *reversed(faces)], fan + 2)
    assert complex_.faces.tolist() == faces
    assert abs(complex_.B1 @ complex_.B2).sum() == 0


def test_a_vertex_of_a_thousand_faces_is_no_special_case():
    fan = np.array([[0, k, k + 1] for k in range(1, 1000)])
    complex_ = build_complex(fan, 1001)
    assert complex_.euler == 1
    assert len(complex_.edge_rows.indices[: complex_.edge_rows.indptr[1]]) == len(complex_.edges)


def test_permuting_vertices_permutes_the_complex():
    _, complex_ = scattered()
    order = np.random.default_rng(1).permutation(complex_.n)
    moved = build_complex(order[complex_.faces], complex_.n)
    assert {tuple(sorted(order[e])) for e in complex_.edges} == {tuple(e) for e in moved.edges.tolist()}
    assert np.array_equal(np.sort(order[complex_.faces], axis=1), moved.faces)
    assert np.allclose(moved.L0.toarray()[np.ix_(order, order)], complex_.L0.toarray())


@pytest.mark.parametrize("dtype", [np.int32, np.int64, np.uint8, np.uint64])
def test_any_integer_type_and_memory_layout_gives_the_same_complex(dtype):
    faces = np.asfortranarray(grid_faces().astype(dtype))
    assert np.array_equal(build_complex(faces, 30).edges, build_complex(grid_faces(), 30).edges)


def test_no_faces_no_vertices_and_edges_alone_are_complexes():
    assert build_complex([], 0).euler == 0
    assert build_complex(np.empty((0, 3), int), 3).euler == 3
    alone = build_complex([], 3, edges=[[2, 0]])
    assert (alone.edges.tolist(), alone.B2.shape, alone.L1.shape) == ([[0, 2]], (1, 0), (1, 1))


def test_what_a_caller_does_to_the_matrices_leaves_the_complex_alone():
    complex_ = build_complex(grid_faces(), 30)
    before = [rows.indices.copy() for rows in (complex_.vertex_rows, complex_.edge_rows, complex_.face_rows)]
    for matrix in complex_.neighbours():
        matrix.indices[:] = 0
        matrix.indptr[:] = 0
    after = [rows.indices for rows in (complex_.vertex_rows, complex_.edge_rows, complex_.face_rows)]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


@pytest.mark.parametrize(("faces", "n", "edges", "message"), [
    ([[0, 1, 1]], 3, None, r"face 0 is \[0, 1, 1\]"),
    ([[0, 1, 2], [0, 1, 3]], 3, None, r"face 1 is \[0, 1, 3\], expected distinct vertices in 0..2"),
    ([[0, 1, -2]], 3, None, r"face 0"),
    ([[0, 1, 2**40]], 3, None, r"face 0"),
    (np.array([[0, 1, 2**63 + 5]], np.uint64), 3, None, r"face 0 is \[0, 1, 4611686018427387904\]"),
    (np.zeros((5, 0)), 3, None, r"shape \(5, 0\), expected \(count, 3\)"),
    ([[0, 1, 2], [0, 1]], 3, None, "rows of different lengths"),
    ([["a", "b", "c"]], 3, None, "<U1, expected integers"),
    ([[0, 1]], 3, None, r"shape \(1, 2\), expected \(count, 3\)"),
    ([[0.0, 1.0, 2.0]], 3, None, "float64, expected integers"),
    ([], 3, [[0, 0]], r"edge 0 is \[0, 0\]"),
    ([], 3, [[0, 1], [1, 3]], "edge 1"),
    ([], 3, [[0, 1, 2]], "shape"),
    ([], -1, None, "n is -1"),
    ([], 3.5, None, "n is 3.5, expected an integer"),
    ([], 2**31, None, "n is 2147483648"),
])  # fmt: skip
def test_bad_input_is_named(faces, n, edges, message):
    with pytest.raises(InputError, match=message):
        build_complex(faces, n, edges)


def test_a_hub_of_too_many_edges_is_refused_before_the_matrix_is_built():
    hub = build_complex([], 40_000, edges=np.column_stack([np.zeros(39_999, int), np.arange(1, 40_000)]))
    with pytest.raises(InputError, match=r"L1 takes 18 GiB, since so many edges meet in vertex 0; expected at most 4"):
        hub.L1  # noqa: B018
    with pytest.raises(InputError, match="the unsigned Laplacian of the edges takes 18 GiB"):
        unsigned_laplacian(hub, "edge")
