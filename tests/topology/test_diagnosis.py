import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tspslam import GeometryError, InputError, build_complex
from tspslam.topology.diagnosis import diagnose_surface, edges_of, orient_faces

from .scenes import OCTAHEDRON, grid_faces, torus_faces

CORNERS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
BOW_TIE = np.array([[0, 1, 2], [2, 3, 4]])
BOOK = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
MOEBIUS = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 1], [5, 0, 1]])


def shaken(n, seed=0):
    return np.random.default_rng(seed).random((n, 3))


def plane(rows=5, columns=6):
    return np.column_stack([*np.divmod(np.arange(rows * columns), columns), np.zeros(rows * columns)])[:, [1, 0, 2]]


def boundary_of(faces):
    edges, count, _ = edges_of(faces)
    return edges[count % 2 == 1]


def edges_along(loops):
    pairs = [np.stack([loop, np.roll(loop, -1)], 1) for loop in loops]
    return np.sort(np.concatenate([*pairs, np.empty((0, 2), int)]), axis=1)


def test_normals_of_the_octahedron_point_outwards_and_areas_add_up():
    found = diagnose_surface(OCTAHEDRON, CORNERS)
    outward = CORNERS[OCTAHEDRON].sum(axis=1) / np.sqrt(3)
    np.testing.assert_allclose(found.face_normal, outward, atol=1e-15)
    np.testing.assert_allclose(found.vertex_normal, CORNERS, atol=1e-15)
    np.testing.assert_allclose(found.face_area, np.sqrt(3) / 2)
    assert found.has_normal.all()


@pytest.mark.parametrize("scale", [1e-90, 1e-3, 1e3, 1e90])
def test_scale_leaves_normals_and_squares_areas(scale):
    ours, theirs = diagnose_surface(OCTAHEDRON, CORNERS * scale), diagnose_surface(OCTAHEDRON, CORNERS)
    np.testing.assert_allclose(ours.face_normal, theirs.face_normal, atol=1e-14)
    np.testing.assert_allclose(ours.face_area, theirs.face_area * scale**2)


def test_vertex_normal_weighs_faces_by_area():
    xyz = np.array([[0, 0, 0], [4, 0, 0], [0, 1, 0], [0, 0, 1]], float)  # 2 m² upwards, 0.5 m² along x
    normal = diagnose_surface(np.array([[0, 1, 2], [0, 2, 3]]), xyz).vertex_normal[0]
    np.testing.assert_allclose(normal, np.array([0.5, 0, 2]) / np.hypot(0.5, 2))


def test_normals_that_do_not_exist_are_zero_and_marked():
    xyz = np.vstack([CORNERS[:3], CORNERS[0] * 3, CORNERS[0] * 2])
    flat = diagnose_surface(np.array([[0, 3, 4]]), xyz)
    assert not flat.face_normal.any()
    assert not flat.face_area.any()
    cancelled = diagnose_surface(np.array([[0, 1, 2], [2, 1, 0]]), xyz / 3)
    assert not cancelled.vertex_normal.any()
    assert not cancelled.has_normal.any()
    assert cancelled.face_normal.any(axis=1).all()


@pytest.mark.parametrize(("faces", "n", "euler", "loops", "components"), [
    (OCTAHEDRON, 6, 2, 0, 1), (torus_faces(), 192, 0, 0, 1), (grid_faces(), 30, 1, 1, 1), (MOEBIUS, 6, 0, 1, 1),
    (OCTAHEDRON[1:], 6, 1, 1, 1), (np.vstack([OCTAHEDRON, 6 + OCTAHEDRON]), 12, 4, 0, 2), (BOW_TIE, 5, 1, 2, 1),
])  # fmt: skip
def test_euler_characteristic_holes_and_components(faces, n, euler, loops, components):
    found = diagnose_surface(faces, shaken(n))
    assert (found.euler, len(found.boundary_loops), found.components) == (euler, loops, components)
    assert found.is_closed == (loops == 0)
    assert found.is_edge_manifold
    assert found.n_edges == len(build_complex(faces, n).edges)


def test_a_surface_without_faces_is_nothing_at_all():
    found = diagnose_surface(np.empty((0, 3), np.int32), shaken(3))
    assert (found.euler, found.components, found.n_edges, found.boundary_loops) == (0, 0, 0, ())
    assert found.unused.tolist() == [0, 1, 2]
    assert not found.is_closed
    assert not found.has_normal.any()
    assert diagnose_surface(np.empty((0, 3), np.int32), np.empty((0, 3))).vertex_normal.shape == (0, 3)
    assert orient_faces(np.empty((0, 3), np.int32)).shape == (0, 3)


def test_loops_have_the_surface_on_their_left():
    whole = orient_faces(grid_faces())
    rim, gap = diagnose_surface(whole[(whole != 14).all(axis=1)], plane()).boundary_loops
    assert rim[:7].tolist() == [0, 1, 2, 3, 4, 5, 11]
    assert set(gap.tolist()) == set(whole[(whole == 14).any(axis=1)].ravel().tolist()) - {14}
    for loop, sign in ((rim, 1), (gap, -1)):  # the gap is on the right of its loop: clockwise
        x, y, _ = plane()[loop].T
        assert np.sign(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) == sign


def test_loops_at_a_pinched_vertex_are_two():
    found = diagnose_surface(BOW_TIE, shaken(5))
    assert [loop.tolist() for loop in found.boundary_loops] == [[0, 1, 2], [2, 3, 4]]
    assert found.pinched.tolist() == [2]
    assert not found.is_manifold


@given(st.integers(0, 10**6), st.integers(0, 60))
def test_loops_are_closed_and_cover_the_boundary_once(seed, count):
    rng = np.random.default_rng(seed)
    faces = rng.permutation(torus_faces(6, 7))[:count]
    turn = rng.random(count) < 0.5
    faces[turn] = faces[turn, ::-1]
    loops = diagnose_surface(faces, shaken(42)).boundary_loops
    assert sorted(edges_along(loops).tolist()) == boundary_of(faces).tolist()
    assert all(len(set(loop.tolist())) == len(loop) >= 3 and loop[0] == loop.min() for loop in loops)


def test_an_edge_of_three_faces_is_counted_and_the_loops_stay_closed():
    found = diagnose_surface(BOOK, shaken(5))
    assert (found.nonmanifold_edges, found.boundary_edges, found.is_edge_manifold) == (1, 6, False)
    assert sorted(edges_along(found.boundary_loops).tolist()) == boundary_of(BOOK).tolist()
    assert found.is_oriented  # only edges of two faces are asked


def test_misoriented_edges_are_those_run_along_twice_the_same_way():
    faces = torus_faces()
    assert diagnose_surface(faces, shaken(192)).is_oriented
    faces[5] = faces[5, ::-1]
    found = diagnose_surface(faces, shaken(192))
    assert (found.misoriented_edges, found.is_oriented) == (3, False)


def test_unused_vertices_are_named():
    assert diagnose_surface(OCTAHEDRON + 2, shaken(9)).unused.tolist() == [0, 1, 8]


@pytest.mark.parametrize("dtype", [np.int32, np.int64, np.uint8])
@given(seed=st.integers(0, 10**6))
def test_orienting_undoes_any_turning_up_to_a_whole_part(dtype, seed):
    rng = np.random.default_rng(seed)
    faces = np.vstack([torus_faces(4, 5), 20 + OCTAHEDRON, 26 + grid_faces(3, 4)]).astype(dtype)
    mixed = np.where(rng.random(len(faces))[:, None] < 0.5, faces[:, ::-1], faces)
    oriented = orient_faces(mixed)
    assert oriented.dtype == dtype
    assert diagnose_surface(oriented, shaken(38)).misoriented_edges == 0
    np.testing.assert_array_equal(np.sort(oriented, axis=1), np.sort(faces, axis=1))
    np.testing.assert_array_equal(oriented[[0, 40, 48]], mixed[[0, 40, 48]])
    np.testing.assert_array_equal(orient_faces(oriented), oriented)


def test_a_one_sided_surface_is_named():
    with pytest.raises(GeometryError, match="the part with face 8 is one-sided, expected an orientable surface"):
        orient_faces(np.vstack([OCTAHEDRON, 6 + MOEBIUS]))


def test_a_part_ends_at_an_edge_of_three_faces():
    np.testing.assert_array_equal(orient_faces(BOOK), BOOK)


@pytest.mark.parametrize(("faces", "message"), [
    ([[0, 1]], r"faces are int64 of shape \(1, 2\), expected integers \(F, 3\)"),
    ([[0.0, 1, 2]], r"faces are float64 of shape \(1, 3\), expected integers"),
    ([[0, 1, 2], [0, 1]], "faces has rows of several lengths"),
    ([[0, 1, 2], [3, 1, 3]], r"face 1 is \[3, 1, 3\], expected three vertices from 0 to"),
    ([[0, 1, 2], [0, 1, -1]], r"face 1 is \[0, 1, -1\], expected"),
])  # fmt: skip
def test_faces_that_are_none_are_named(faces, message):
    with pytest.raises(InputError, match=message):
        diagnose_surface(faces, shaken(6))
    with pytest.raises(InputError, match=message):
        orient_faces(faces)


def test_a_vertex_that_is_not_there_is_named():
    with pytest.raises(InputError, match=r"face 0 is \[0, 1, 6\], expected three vertices from 0 to 5"):
        diagnose_surface(np.array([[0, 1, 6]]), shaken(6))


@pytest.mark.parametrize(("xyz", "message"), [
    (np.zeros((4, 2)), r"surface: xyz is float64 of shape \(4, 2\), expected numbers of shape \(N, 3\)"),
    (np.zeros((4, 3), complex), "surface: xyz is complex128"),
    ([[0, 0, 0], [0, 0]], "surface: xyz has rows of several lengths"),
    ([[0, 0, 0], [0, np.nan, 0]], r"surface: point 1 is \[0.0, nan, 0.0\], expected finite metres"),
    ([[0, 0, 0], [0, 1e101, 0]], "surface: point 1 is .*at most 1e"),
])  # fmt: skip
def test_positions_that_are_none_are_named(xyz, message):
    with pytest.raises(InputError, match=message):
        diagnose_surface(np.empty((0, 3), int), xyz)
