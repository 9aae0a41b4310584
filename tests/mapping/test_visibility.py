"""The depth buffer beside rays and triangles tried one by one."""

from typing import NamedTuple

import numpy as np
import pytest

from tspslam import Rig
from tspslam.mapping.views import calibration_matrix
from tspslam.mapping.visibility import OUT_OF_VIEW, VISIBLE, face_normals, look

from .worlds import pose_at

RIG = Rig(fx=31, fy=28, cx=15.3, cy=12.7, baseline=0.2, width=34, height=27, skew=0.7)
POSE = pose_at((0.3, -0.2, 0.5), (0.2, -0.4, 0.1))
BEHIND = np.array([[[1.0, 0, -1], [0, 1, -2], [1, 1, -4]]])  # a triangle that no ray meets
NEAREST = 2e-3  # m: triangles are drawn from half of that on


class Truth(NamedTuple):
    """For each ray: the nearest face, -1 for none, its depth, and whether rounding may decide otherwise."""

    owner: np.ndarray
    depth: np.ndarray
    is_close: np.ndarray


def true_owners(rays, corners):
    """Nearest triangle (F, 3, 3) on rays (R, 3) from the origin with z = 1, by Möller and Trumbore."""
    a, one, two = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(rays[:, None], two)
    det = np.einsum("rfi,fi->rf", p, one)
    u = np.einsum("rfi,fi->rf", p, -a) / det
    q = np.cross(-a, one)
    v = rays @ q.T / det
    depth = np.einsum("fi,fi->f", two, q) / det
    inside = np.min([u, v, 1 - u - v], axis=0)
    hit = np.where((inside >= 0) & (depth > 0), depth, np.inf)
    order = np.sort(hit, axis=1)
    first = order[:, 0]
    with np.errstate(invalid="ignore"):
        is_tie = order[:, 1] - first < 1e-9
    is_side = ((np.abs(inside) < 1e-9) & (depth > 0) & (depth <= first[:, None] + 1e-9)).any(axis=1)
    is_near = (hit < NEAREST).any(axis=1)
    return Truth(np.where(np.isfinite(first), hit.argmin(axis=1), -1), first, is_tie | is_side | is_near)


def rays_of(pixels, step):
    return np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(calibration_matrix(RIG, step)).T


def pixels_of(owner):
    row, column = np.indices(owner.shape)
    return np.column_stack([column.ravel(), row.ravel()]).astype(float)


def triangles(seed, count, behind):
    """Random triangles in the camera's frame, and in the world; some corners lie behind the camera."""
    rng = np.random.default_rng(seed)
    local = rng.uniform((-2, -2, -1.5 if behind else 0.5), (2, 2, 4), (3 * count, 3))
    if not behind:
        local[:, :2] *= local[:, 2:] / 2
    return local, local @ POSE[:3, :3].T + POSE[:3, 3], np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


@pytest.mark.parametrize("step", [1, 2, 3])
@pytest.mark.parametrize("behind", [False, True])
@pytest.mark.parametrize(("seed", "count"), [(0, 1), (1, 3), (2, 40)])
def test_each_pixel_shows_the_nearest_triangle_on_its_ray(seed, count, behind, step):
    local, xyz, faces = triangles(seed, count, behind)
    owner = look(RIG, POSE, xyz, faces, step).owner
    assert owner.shape == (-(-RIG.height // step), -(-RIG.width // step))
    true = true_owners(rays_of(pixels_of(owner), step), np.concatenate([local[faces], BEHIND]))
    clear = ~true.is_close
    assert clear.mean() > 0.95
    assert np.array_equal(owner.ravel()[clear], true.owner[clear])


def test_triangles_that_reach_behind_the_camera_are_drawn():
    shown = [np.unique(look(RIG, POSE, *triangles(seed, 1, True)[1:], 1).owner) for seed in range(40)]
    reach = [(triangles(seed, 1, True)[0][:, 2] < 0).any() for seed in range(40)]
    assert sum(0 in owner for owner, is_behind in zip(shown, reach, strict=True) if is_behind) > 5


@pytest.mark.parametrize("step", [1, 2])
@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_a_point_is_hidden_by_the_face_that_is_nearer_by_more_than_the_margin(step, margin):
    local, xyz, faces = triangles(4, 12, True)
    rng = np.random.default_rng(1)
    empty = look(RIG, POSE, xyz, faces, step).owner
    pixels = pixels_of(empty)
    points = rays_of(pixels, step) * rng.uniform(0.2, 5, (len(pixels), 1))  # amid pixels, where outlines are exact
    sight = look(RIG, POSE, np.concatenate([xyz, points @ POSE[:3, :3].T + POSE[:3, 3]]), faces, step)
    rows = len(xyz) + np.arange(len(points))
    found = sight.hidden_by(rows, np.full(len(rows), margin))
    true = true_owners(rays_of(pixels, step), local[faces])
    is_hidden = true.depth < points[:, 2] - margin
    inner = (pixels > 0).all(axis=1) & (pixels < np.array(empty.shape)[::-1] - 1).all(axis=1)
    clear = inner & ~true.is_close & (np.abs(true.depth - points[:, 2] + margin) > 1e-9)
    assert np.array_equal(found[clear], np.where(is_hidden, true.owner, VISIBLE)[clear])
    assert 50 < is_hidden[clear].sum() < clear.sum() - 50


def test_points_behind_the_camera_or_beside_the_image_are_out_of_view():
    xyz = np.array([[0, 0, -1.0], [9, 0, 1], [0, -9, 1], [0, 0, 0], [0, 0, 2]])
    sight = look(RIG, np.eye(4), xyz, np.empty((0, 3), np.int32))
    assert sight.hidden_by(np.arange(5), np.zeros(5)).tolist() == [OUT_OF_VIEW] * 4 + [VISIBLE]


def test_no_face_hides_its_own_corners():
    _, xyz, faces = triangles(6, 1, False)
    assert set(look(RIG, POSE, xyz, faces).hidden_by(np.arange(3), np.full(3, -1.0))) <= {VISIBLE, OUT_OF_VIEW}


def test_pixels_count_for_faces_that_are_seen_from_the_front():
    _, xyz, faces = triangles(2, 20, False)
    sight = look(RIG, POSE, xyz, faces)
    is_front = np.einsum("fi,fi->f", face_normals(xyz, faces), POSE[:3, 3] - xyz[faces[:, 0]]) > 0
    counts = np.zeros(20, np.int64)
    sight.count_pixels(is_front, counts)
    drawn = np.bincount(sight.owner[sight.owner >= 0], minlength=20)
    wide = drawn > 0
    assert np.array_equal(counts[wide], np.where(is_front, drawn, 0)[wide])
    assert not counts[~is_front].any()


def test_normals_turn_with_the_corners_and_have_twice_the_area():
    xyz, faces = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0]]), np.array([[0, 1, 2], [0, 2, 1]], np.int32)
    assert face_normals(xyz, faces).tolist() == [[0, 0, 6], [0, 0, -6]]
