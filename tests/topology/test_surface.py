from dataclasses import replace

import numpy as np
import pytest
import scipy.spatial

from tspslam import Cloud, GeometryError, InputError, build_complex, delaunay_surface
from tspslam.topology.surface import DelaunaySurface, pinched_vertices

from .scenes import grid_faces, torus_faces


def two_planes(n=300, near=2.0, far=4.0, covariance=0.0) -> Cloud:
    """A wall at depth `far` with a nearer wall before its left half, seen at random pixels."""
    uv = np.random.default_rng(0).random((n, 2)) * [100, 80]
    z = np.where(uv[:, 0] < 50, near, far)
    xyz = np.column_stack([uv * z[:, None] / 100, z])
    return Cloud(xyz, uv, 100 / z, np.tile(np.eye(3) * covariance, (n, 1, 1)))


def test_no_face_bridges_a_depth_step_and_few_others_are_lost():
    cloud = two_planes()
    faces = delaunay_surface(cloud).faces
    assert np.ptp(cloud.xyz[faces, 2], axis=1).max() == 0
    whole = delaunay_surface(two_planes(far=2.0)).faces
    assert len(whole) > 550
    assert len(faces) > 0.85 * len(whole)


def test_a_step_within_its_uncertainty_is_no_step():
    certain, unsure = (delaunay_surface(two_planes(covariance=c)).faces for c in (0.0, 9.0))
    assert len(unsure) > len(certain)
    assert len(delaunay_surface(two_planes(covariance=1.0), significance=3).faces) == len(unsure)
    assert len(delaunay_surface(two_planes(covariance=9.0), significance=0).faces) == len(certain)


def tilted(covariance=None, noise=0.0, n=300) -> Cloud:
    """A road: a plane under the camera, depth 3 to 30 m, seen at random pixels."""
    rng = np.random.default_rng(1)
    uv = rng.random((n, 2)) * [100, 80]
    inverse = (8 + uv[:, 1] + noise * rng.normal(size=n)) / 264
    xyz = np.column_stack([(uv - 50) / inverse[:, None] / 100, 1 / inverse])
    return Cloud(xyz, uv, 100 * inverse, None if covariance is None else covariance * xyz[:, 2:, None] ** 4 * np.eye(3))


def test_a_slope_is_no_step_however_steep():
    whole = DelaunaySurface(max_depth_ratio=1e9)
    for cloud in (tilted(), tilted(covariance=1e-5, noise=0.15)):
        assert len(delaunay_surface(cloud).faces) > 0.95 * len(whole(cloud).faces)
    doubtless = tilted(noise=0.15)  # without a covariance, a rough slope is taken for steps
    assert len(delaunay_surface(doubtless).faces) < 0.9 * len(whole(doubtless).faces)


def test_a_step_on_a_slope_is_cut():
    road = tilted()
    near = road.uv[:, 0] < 50
    scale = np.where(near, 0.6, 1.0)[:, None]
    cloud = Cloud(road.xyz * scale, road.uv, road.disparity / scale[:, 0])
    faces = delaunay_surface(cloud).faces
    assert set(near[faces].sum(axis=1)) == {0, 3}
    assert len(faces) > 0.8 * len(delaunay_surface(road).faces)


def test_every_side_has_at_most_two_faces():
    faces = delaunay_surface(two_planes()).faces
    complex_ = build_complex(faces, 300)
    assert np.bincount(complex_.face_edges.ravel()).max() == 2
    assert complex_.n == 300


def test_slivers_are_dropped():
    uv = np.array([[0, 0], [50, 0.5], [100, 0], [50, 80]])
    cloud = Cloud(np.column_stack([uv, np.ones(4)]), uv, np.ones(4))
    assert len(delaunay_surface(cloud).faces) == 2
    assert len(DelaunaySurface(min_angle=0)(cloud).faces) == 3


def test_pinched_vertices_are_those_with_several_fans():
    assert pinched_vertices(grid_faces().astype(np.int32), 30).tolist() == []
    assert pinched_vertices(torus_faces().astype(np.int32), 192).tolist() == []
    bow_tie = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6], [4, 6, 3]], np.int32)
    assert pinched_vertices(bow_tie, 8).tolist() == [2]
    assert pinched_vertices(np.empty((0, 3), np.int32), 3).tolist() == []


@pytest.mark.parametrize(("uv", "message"), [
    ([[0, 0], [1, 1]], "2 points, expected at least 3"),
    ([[k, 2 * k] for k in range(9)], "all 9 points lie on one line"),
    ([[3, 3]] * 5, "all 5 points lie at one place"),
    ([], "0 points"),
])  # fmt: skip
def test_points_without_a_triangle_are_named(uv, message):
    uv = np.array(uv, float).reshape(-1, 2)
    with pytest.raises(GeometryError, match=message):
        delaunay_surface(Cloud(np.column_stack([uv, np.ones(len(uv))]), uv, np.ones(len(uv))))


def test_coincident_points_stay_without_a_face():
    cloud = two_planes()
    doubled = Cloud(*(np.concatenate([a, a[:50]]) for a in (cloud.xyz, cloud.uv, cloud.disparity)))
    faces = delaunay_surface(doubled).faces
    assert len(np.unique(faces)) <= 300
    assert len(faces) > 400


@pytest.mark.parametrize(("row", "values"), [(0, [np.nan, 0, 1]), (7, [0, 0, -1.0]), (7, [0, 0, np.inf])])
def test_a_bad_point_is_named(row, values):
    cloud = two_planes()
    cloud.xyz[row] = values
    with pytest.raises(InputError, match=f"point {row} is uv .* expected finite values with z > 0"):
        delaunay_surface(cloud)


def test_arrays_that_do_not_fit_and_covariances_that_are_not_finite_are_named():
    cloud = two_planes(covariance=1.0)
    with pytest.raises(InputError, match=r"shapes .*expected"):
        delaunay_surface(replace(cloud, uv=cloud.uv[:-1]))
    cloud.covariance[4, 2, 2] = np.nan
    with pytest.raises(InputError, match="the covariance of point 4 is not finite"):
        delaunay_surface(cloud)


def test_points_that_qhull_refuses_are_named(monkeypatch):
    def refuse(points):
        raise scipy.spatial.QhullError("QH6154 initial simplex is flat\nmore")

    monkeypatch.setattr(scipy.spatial, "Delaunay", refuse)
    with pytest.raises(GeometryError, match=r"300 points cannot be triangulated \(QH6154 initial simplex is flat\)"):
        delaunay_surface(two_planes())


@pytest.mark.parametrize("setting", [{"max_depth_ratio": -1.0}, {"significance": np.nan}])
def test_a_bad_setting_is_named(setting):
    with pytest.raises(InputError, match=f"{next(iter(setting))} is"):
        delaunay_surface(two_planes(), **setting)
