"""Rays through tetrahedra, beside all facets of all tetrahedra tried one by one."""

from typing import NamedTuple

import numpy as np
import pytest

from tspslam.mapping import _carving, surface


class Carved(NamedTuple):
    cells: surface._Cells
    planes: np.ndarray
    cosines: np.ndarray
    crossed: np.ndarray
    free: np.ndarray
    full: np.ndarray


def carve(xyz, origin, vertex, sigma, behind):
    cells = surface._tetrahedra(xyz, origin)
    count = len(cells.vertices)
    planes, cosines = np.empty((count, 4, 4)), np.empty((count, 4))
    _carving.facet_planes(cells.points, cells.vertices, planes)
    _carving.sphere_angles(cells.points, cells.vertices, planes, cosines)
    order = np.argsort(cells.vertices.ravel(), kind="stable")
    start = np.searchsorted(cells.vertices.ravel()[order], np.arange(len(cells.points) + 1))
    out = np.zeros((count, 4)), np.zeros(count), np.zeros(count)
    _carving.carve(*cells, planes, start, order // 4, origin, vertex, sigma, behind, out)
    return Carved(cells, planes, cosines, *out)


def cross(o, d, corners):
    """How far along a ray it meets a triangle, by Möller and Trumbore; None if it does not."""
    one, two = corners[1] - corners[0], corners[2] - corners[0]
    p = np.cross(d, two)
    det = one @ p
    u = (o - corners[0]) @ p / det
    q = np.cross(o - corners[0], one)
    v = d @ q / det
    return two @ q / det if u >= 0 and v >= 0 and u + v <= 1 else None


def slow_crossings(cells, origin, vertex, sigma):
    crossed = np.zeros((len(cells.vertices), 4))
    for at, i, s in zip(origin, vertex, sigma, strict=True):
        o = cells.points[i]
        length = np.linalg.norm(at - o)
        d = (at - o) / length
        for t, corners in enumerate(cells.vertices):
            for k in range(4):
                facet = np.delete(corners, k)
                if i in facet:
                    continue
                points = cells.points[facet]
                normal = np.cross(points[1] - points[0], points[2] - points[0])
                enters = (normal @ d) * (normal @ (cells.points[corners[k]] - points[0])) > 0
                far = cross(o, d, points) if enters else None
                if far is not None and 0 < far < length:
                    crossed[t, k] += 1 - np.exp(-((far / s) ** 2) / 2)
    return crossed


def holder(cells, point):
    """The tetrahedron around a point."""
    corners = cells.points[cells.vertices]
    sides = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
    shares = np.linalg.solve(sides, (point - corners[:, 0])[..., None])[..., 0]
    return int(np.argmax(np.minimum(shares.min(axis=1), 1 - shares.sum(axis=1))))


def scene(seed, rays=12):
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(-1, 1, (60, 3))
    return xyz, rng.uniform(-2, 2, (rays, 3)), rng.choice(60, rays), rng.uniform(0.05, 0.5, rays)


@pytest.mark.parametrize("seed", range(3))
def test_a_ray_takes_from_each_facet_that_it_crosses_from_the_camera_s_other_side(seed):
    given = scene(seed)
    carved = carve(*given, 1.0)
    true = slow_crossings(carved.cells, *given[1:])
    assert carved.crossed == pytest.approx(true, abs=1e-9)
    assert carved.crossed.sum() == pytest.approx(true.sum(), abs=1e-9)
    assert true.sum() > 20


@pytest.mark.parametrize("behind", [0.01, 0.1, 1.0, 3.0])  # standard deviations
def test_cameras_are_in_free_tetrahedra_and_full_ones_lie_behind_the_landmarks(behind):
    xyz, origin, vertex, sigma = scene(7)
    carved = carve(xyz, origin, vertex, sigma, behind)
    away = xyz[vertex] - origin
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    free, full = np.zeros_like(carved.free), np.zeros_like(carved.full)
    for at, o, d, s in zip(origin, carved.cells.points[vertex], away, sigma, strict=True):
        free[holder(carved.cells, at)] += 1
        full[holder(carved.cells, o + behind * s * d)] += 1
    assert np.array_equal(carved.free, free)
    assert np.array_equal(carved.full, full)


@pytest.mark.parametrize("side", [2, 4, 9])
def test_rays_through_corners_and_sides_of_a_lattice_end_and_leave_no_more_than_one_each(side):
    at = np.stack(np.meshgrid(*[np.arange(float(side))] * 3), axis=-1).reshape(-1, 3)
    origin = np.array([[x, y, z] for x in (-2.0, 1, 20) for y in (-2.0, 1.5, 20) for z in (-2.0, 2, 20)])
    vertex, origin = np.repeat(np.arange(len(at)), len(origin)), np.tile(origin, (len(at), 1))
    carved = carve(at, origin, vertex, np.full(len(vertex), 0.3), 1.0)
    rays = len(vertex)  # those that go in circles among the flat tetrahedra say nothing
    assert np.isfinite(carved.crossed).all()
    assert carved.crossed.min() > -1e-6
    assert carved.crossed.max() <= rays
    assert 0 < carved.free.sum() <= rays
    assert 0 < carved.full.sum() <= rays


def test_a_landmark_in_the_place_of_another_says_nothing():
    xyz, origin, _, sigma = scene(1, rays=2)
    xyz = np.concatenate([xyz, xyz[:1]])
    carved = carve(xyz, origin, np.array([0, 60]), sigma, 1.0)
    assert np.isin([0, 60], carved.cells.vertices).sum() == 1
    assert carved.free.sum() == carved.full.sum() == 1


def test_planes_of_facets_hold_their_corners_and_look_outwards():
    carved = carve(*scene(2), 1.0)
    corners = carved.cells.points[carved.cells.vertices]
    signed = np.einsum("tki,tji->tkj", carved.planes[..., :3], corners) + carved.planes[..., 3:]
    is_opposite = np.broadcast_to(np.eye(4, dtype=bool), signed.shape)
    assert np.linalg.norm(carved.planes[..., :3], axis=-1) == pytest.approx(1)
    assert np.abs(signed[~is_opposite]).max() < 1e-9
    assert signed[is_opposite].max() < 0


def test_cosines_are_those_of_facets_and_spheres():
    carved = carve(*scene(3), 1.0)
    corners = carved.cells.points[carved.cells.vertices]
    sides = corners[:, 1:] - corners[:, :1]
    middle = np.linalg.solve(sides, (sides**2).sum(axis=2)[..., None] / 2)[..., 0]
    radius = np.linalg.norm(middle, axis=1)
    for k in range(4):
        points = corners[:, np.delete(np.arange(4), k)]
        normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        inwards = np.einsum("ti,ti->t", normal, corners[:, k] - points[:, 0])
        away = np.einsum("ti,ti->t", normal, middle + corners[:, 0] - points[:, 0]) * np.sign(inwards)
        assert carved.cosines[:, k] == pytest.approx(away / radius, abs=1e-6)


def test_the_best_view_of_a_face_is_that_of_a_keyframe_that_sees_all_three_corners():
    rng = np.random.default_rng(0)
    sees = rng.random((9, 6)) < 0.4
    vertex, keyframe = np.nonzero(sees)
    start = np.searchsorted(vertex, np.arange(10))
    faces = np.array([rng.choice(9, 3, replace=False) for _ in range(60)])
    centres, points, normals = rng.normal(size=(6, 3)), rng.normal(size=(60, 3)), rng.normal(size=(60, 3))
    found = _carving.shared_cosines(faces, start, keyframe, centres, points, normals)
    away = centres - points[:, None]
    cosines = np.einsum("fi,fki->fk", normals, away) / np.linalg.norm(away, axis=2)
    cosines /= np.linalg.norm(normals, axis=1, keepdims=True)
    shared = sees[faces].all(axis=1)
    assert found == pytest.approx(np.where(shared, cosines, -1).max(axis=1))
    assert 5 < shared.any(axis=1).sum() < 55
