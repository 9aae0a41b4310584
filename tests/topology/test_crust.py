import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy.spatial
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tspslam import Cloud, GeometryError, InputError, delaunay_surface, reconstruct
from tspslam.topology.crust import Crust, crust_surface
from tspslam.topology.diagnosis import diagnose_surface


def on_torus(around, along):
    """Points of the paper's torus: R = 1, r = 0.4, centre (0, 0, 4), tilted by 45° about x, m."""
    ring, half = 1 + 0.4 * np.cos(along), np.sqrt(0.5)
    x, y, z = ring * np.cos(around), ring * np.sin(around), 0.4 * np.sin(along)
    return np.column_stack([x, half * (y - z), 4 + half * (y + z)])


def torus_grid(rows, columns):
    row, column = np.divmod(np.arange(rows * columns), columns)
    return on_torus(2 * np.pi * column / columns, 2 * np.pi * row / rows)


def torus_random(n, seed=0):
    return on_torus(*(2 * np.pi * np.random.default_rng(seed).random((2, n))))


def sphere_random(n, seed=0):
    points = np.random.default_rng(seed).normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def sphere_grid(rows=30, columns=40):
    """Meridians and parallels: the points of each ring are on one circle, all of them on one sphere."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    polar, around = np.pi * (row + 0.5) / rows, 2 * np.pi * column / columns
    return np.column_stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)])


def noisy_sheet(n=2000):
    rng = np.random.default_rng(0)
    x, y = rng.random((2, n))
    return np.column_stack([x, y, 0.1 * np.sin(6 * x) + rng.normal(0, 0.3 / np.sqrt(n), n)])


def volume(faces, xyz):
    a, b, c = (xyz[faces[:, k]] - xyz.mean(axis=0) for k in range(3))
    return np.sum(a * np.cross(b, c)) / 6


def assert_closed(surface, xyz, euler):
    found, report = diagnose_surface(surface.faces, xyz), surface.report
    assert found.is_closed
    assert found.is_manifold
    assert found.is_oriented
    assert (found.euler, len(surface.faces)) == (euler, 2 * (len(xyz) - euler))
    assert (report.euler, report.faces, report.unused_points) == (euler, len(surface.faces), 0)
    assert report.verdict == "closed manifold"


CLOUDS = {
    "torus grid": (lambda: torus_grid(20, 50), 0),
    "square torus grid": (lambda: torus_grid(25, 40), 0),
    "random torus": (lambda: torus_random(1000), 0),
    "random sphere": (lambda: sphere_random(1000), 2),
    "sphere grid": (sphere_grid, 2),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_a_dense_closed_cloud_gives_the_closed_surface_of_its_genus(name):
    points, euler = CLOUDS[name]
    xyz = points()
    surface = crust_surface(xyz)
    assert_closed(surface, xyz, euler)
    assert volume(surface.faces, xyz) > 0  # outward normals
    assert surface.faces.dtype == np.int32


@pytest.mark.parametrize("seed", range(1, 9))
def test_random_clouds_leave_no_point_out(seed):
    assert_closed(crust_surface(torus_random(1000, seed)), torus_random(1000, seed), 0)


def test_faces_of_the_sphere_look_outwards_one_by_one():
    xyz = sphere_random(1000)
    found = diagnose_surface(crust_surface(xyz).faces, xyz)
    assert np.sum(found.vertex_normal * xyz, axis=1).min() > 0.9


def test_the_hull_of_a_convex_body_is_its_crust():
    xyz = sphere_random(500)
    hull = scipy.spatial.ConvexHull(xyz).simplices
    ours = crust_surface(xyz).faces
    assert {tuple(sorted(face)) for face in ours.tolist()} == {tuple(sorted(face)) for face in hull.tolist()}


@pytest.mark.parametrize("points", [lambda: torus_grid(20, 50), lambda: torus_random(1000)])
@pytest.mark.parametrize(("scale", "shift"), [(1e-3, 0), (1e3, 0), (1e-3, 1), (1e3, -1e5), (1e-90, 0), (1e90, 0)])
def test_scale_and_place_leave_the_genus(points, scale, shift):
    xyz = points() * scale + shift
    assert_closed(crust_surface(xyz), xyz, 0)


@pytest.mark.parametrize("points", [lambda: torus_grid(20, 50), lambda: torus_random(1000)])
def test_the_same_points_give_the_same_faces_in_order(points):
    faces = crust_surface(points()).faces
    np.testing.assert_array_equal(crust_surface(points()).faces, faces)
    np.testing.assert_array_equal(faces.argmin(axis=1), 0)
    np.testing.assert_array_equal(np.lexsort(faces.T[::-1]), np.arange(len(faces)))


def test_bodies_of_different_sizes_come_out_side_by_side():
    xyz = np.vstack([torus_random(1500), 0.01 * sphere_random(500) + [2, 0, 4]])
    surface = crust_surface(xyz)
    assert_closed(surface, xyz, 2)
    assert surface.report.components == 2
    assert len(surface.faces) == 2 * 1500 + 2 * 500 - 4


def test_repeated_points_are_named_by_their_first_row():
    xyz = sphere_random(300)
    shuffled = np.vstack([xyz, xyz[::-1], -0.0 * xyz + xyz])
    surface = crust_surface(shuffled)
    np.testing.assert_array_equal(surface.faces, crust_surface(xyz).faces)
    assert (surface.report.points, surface.report.distinct_points) == (900, 300)
    assert surface.report.is_closed_manifold


def test_a_million_copies_of_a_few_points_are_a_few_points():
    corners = np.vstack([np.eye(3), -np.eye(3)])
    surface = crust_surface(np.tile(corners, (170_000, 1)))
    assert len(surface.faces) == 8
    assert surface.report.distinct_points == 6
    with pytest.raises(GeometryError, match="all 1000000 points lie in one plane"):
        crust_surface(np.tile(corners[:4], (250_000, 1)) * [1, 1, 0])


def test_an_open_noisy_sheet_says_that_it_failed_and_where_to_go():
    surface = crust_surface(noisy_sheet())
    report = surface.report
    assert len(surface.faces) == report.faces > 0
    assert not report.is_closed_manifold
    assert report.unused_points > 100
    assert f"{report.unused_points} points without a face" in report.verdict
    assert "use delaunay_surface" in str(report)
    assert "\n" not in str(report)


def test_a_smooth_open_sheet_loses_walls_between_water_and_water():
    x, y = 2 * np.random.default_rng(0).random((2, 500)) - 1
    report = crust_surface(np.column_stack([x, y, x**2 + y**2])).report
    assert 900 < report.faces < 0.7 * report.raw_faces
    assert report.unused_points > 0
    assert not report.is_closed_manifold


def test_a_torus_too_sparse_is_said_to_have_failed():
    report = crust_surface(torus_random(60)).report
    assert not report.is_closed_manifold
    assert report.verdict.startswith("no closed manifold (")


def test_a_point_inside_stays_without_a_face_and_is_told():
    xyz = np.vstack([sphere_random(500), [[0.1, 0.2, 0.3]]])
    report = crust_surface(xyz).report
    assert (report.faces, report.unused_points, report.boundary_edges) == (996, 1, 0)
    assert "(1 points without a face)" in report.verdict


FLAWS = ["boundary_edges", "nonmanifold_edges", "misoriented_edges", "pinched_vertices", "unused_points"]


@pytest.mark.parametrize(
    ("change", "said"), [({"faces": 0}, "no face"), *(({flaw: 3}, "3 [a-z -]+") for flaw in FLAWS)]
)
def test_one_flaw_is_enough_to_fail_and_is_said(change, said):
    report = replace(crust_surface(sphere_random(100)).report, **change)
    assert not report.is_closed_manifold
    assert re.search(rf"^no closed manifold \({said}\): ", report.verdict)


@pytest.mark.parametrize("dtype", [np.float32, np.int16, np.longdouble, list])
def test_numbers_of_any_type_will_do(dtype):
    whole = (sphere_random(300) * 30_000).round()
    given = whole.tolist() if dtype is list else whole.astype(dtype)
    np.testing.assert_array_equal(crust_surface(given).faces, crust_surface(whole).faces)


def test_the_stage_reads_positions_only():
    xyz = torus_random(1000)
    surface = Crust()(Cloud(xyz, np.full((1000, 2), np.nan), np.zeros(1000)))
    np.testing.assert_array_equal(surface.faces, crust_surface(xyz).faces)
    assert Crust() == Crust()


@pytest.mark.parametrize(("xyz", "message"), [
    (np.empty((0, 3)), "crust: 0 points, expected at least 4"),
    (np.eye(3), "crust: 3 points, expected at least 4"),
    (np.full((9, 3), 7.3), "all 9 points lie at one place, expected a spread in all three directions"),
    (np.outer(np.arange(9), [1, 2, 3.3]) + 0.1, "all 9 points lie on one line"),
    (np.arange(1000)[:, None] ** [[1, 2, 0]] @ np.array([[1, 2, 3], [3, 1, 0], [5, 5, 5]]) / 7, "all 1000 points lie in one plane"),
    (1e6 + 1e-9 * sphere_random(50), "all 50 points lie at one place"),
])  # fmt: skip
def test_points_without_a_volume_are_named(xyz, message):
    with pytest.raises(GeometryError, match=message):
        crust_surface(xyz)


@pytest.mark.parametrize(("xyz", "message"), [
    (np.zeros((5, 2)), r"crust: xyz is float64 of shape \(5, 2\), expected numbers of shape \(N, 3\)"),
    (np.zeros(3), r"crust: xyz is float64 of shape \(3,\)"),
    (np.full((5, 3), "a"), "crust: xyz is <U1"),
    (np.where(np.eye(5, 3) > 0, np.nan, 1.0), r"crust: point 0 is \[nan, 1.0, 1.0\], expected finite metres"),
    (np.vstack([np.eye(3), [[0, 0, -np.inf]]]), "crust: point 3 is"),
])  # fmt: skip
def test_arrays_that_are_no_points_are_named(xyz, message):
    with pytest.raises(InputError, match=message):
        crust_surface(xyz)


def test_points_that_qhull_refuses_are_named(monkeypatch):
    def refuse(points):
        raise scipy.spatial.QhullError("QH6154 initial simplex is flat\nmore")

    monkeypatch.setattr(scipy.spatial, "Delaunay", refuse)
    with pytest.raises(
        GeometryError, match=r"crust: 50 points cannot be triangulated \(QH6154 initial simplex is flat\)"
    ):
        crust_surface(sphere_random(50))


@settings(deadline=None, max_examples=60)
@given(arrays(np.float64, st.tuples(st.integers(4, 30), st.just(3)), elements=st.integers(-3, 3).map(float)))
def test_any_small_lattice_cloud_with_a_volume_gives_faces_without_holes(xyz):
    if np.linalg.matrix_rank(xyz - xyz[0]) < 3:
        with pytest.raises(GeometryError, match="points lie"):
            crust_surface(xyz)
        return
    surface = crust_surface(xyz)
    assert surface.report.boundary_edges == 0
    equal = (xyz[:, None] == xyz[None]).all(axis=2)
    assert set(surface.faces.ravel().tolist()) <= set(equal.argmax(axis=1).tolist())


LARGE = """
import resource
from tests.topology.test_crust import crust_surface, torus_random
crust_surface(torus_random(100))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
report = crust_surface(torus_random(20_000)).report
unit = 2**20 if __import__("sys").platform == "darwin" else 2**10
print(report.faces, report.euler, report.is_closed_manifold)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / unit)
"""


def test_twenty_thousand_points_fit_in_memory(request):
    pytest.importorskip("resource")
    run = subprocess.run(
        [sys.executable, "-c", LARGE], cwd=request.config.rootpath, capture_output=True, text=True, check=True
    )
    found, megabytes = run.stdout.splitlines()
    assert found == "40000 0 True"
    assert float(megabytes) < 400


def test_the_open_cloud_of_a_stereo_pair_fails_and_points_to_the_delaunay_surface(motorcycle):
    cloud = reconstruct(motorcycle)
    report = crust_surface(cloud.xyz).report
    assert not report.is_closed_manifold
    assert report.unused_points > 0
    assert "for an open cloud use delaunay_surface" in str(report)
    assert diagnose_surface(delaunay_surface(cloud).faces, cloud.xyz).is_edge_manifold
