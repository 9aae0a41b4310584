"""The measures of a map give the known answer on worlds of a few triangles."""

import numpy as np
import pytest

from benchmarks import mapping_measures as measures
from tspslam import Rig

RIG = Rig(fx=100, fy=100, cx=50, cy=40, baseline=0.2, width=101, height=81)
HERE = np.eye(4)[None]
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def square(z, half=1.0):
    """Corners of a square across the axis of the first camera."""
    return np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])


def two_squares(first, second):
    return np.concatenate([square(first), square(second)]), np.concatenate([SQUARE, SQUARE + 4])


def moved(T=HERE, **by):
    T = np.array(T, np.float64)
    T[:, :3, 3] += [by.get(axis, 0.0) for axis in "xyz"]
    return T


def shifted(xyz, **by):
    return xyz + np.array([by.get(axis, 0.0) for axis in "xyz"])


def seen(z, T=HERE):
    """True depth images of an endless wall at z, from cameras that look along z."""
    return np.stack([np.full((RIG.height, RIG.width), z - pose[2, 3], np.float32) for pose in T])


def test_a_square_seen_twice_is_one_layer():
    T = np.concatenate([HERE, moved(x=0.3)])
    assert measures.double_layers(square(4.0), SQUARE, RIG, T, step=1) == 0  # rays along its diagonal too


@pytest.mark.parametrize(("gap", "share"), [(0.03, 1.0), (0.10, 0.0)])
def test_two_layers_are_double_within_five_percent(gap, share):
    xyz, faces = two_squares(4.0, 4.0 * (1 + gap))
    xyz[4:, :2] *= 1 + gap  # the farther one hides exactly behind
    assert measures.double_layers(xyz, faces, RIG, HERE, step=1) == pytest.approx(share, abs=0.02)
    assert measures.double_layers(xyz, faces[::-1], RIG, HERE, step=1) == pytest.approx(share, abs=0.02)


def test_a_face_that_is_there_twice_is_double():
    assert measures.double_layers(square(4.0), SQUARE[[0, 1, 0]], RIG, HERE) == pytest.approx(0.5, abs=0.03)


def test_a_floor_that_passes_below_the_camera_is_met():
    floor = np.array([[-5.0, 1, -5], [5, 1, -5], [5, 1, 20], [-5, 1, 20]])
    near, _ = next(measures.two_layers(floor, SQUARE, RIG, HERE, step=1))
    row = 80
    assert near[row, 10:90, 0] == pytest.approx((row - RIG.cy) / RIG.fy)  # y = 1 at z = fy / (v - cy)
    assert not near[:40].any()


def test_a_face_behind_the_camera_is_not_met():
    assert not next(measures.two_layers(square(-4.0), SQUARE, RIG, HERE))[0].any()


def test_a_far_first_face_does_not_count():
    xyz, faces = two_squares(70.0, 70.5)
    xyz[:, :2] *= 30
    assert measures.double_layers(xyz, faces, RIG, HERE) == 0
    assert measures.double_layers(xyz, faces, RIG, HERE, farthest=100.0) > 0.9


@pytest.mark.parametrize(("before", "conflict"), [(0.5, 1.0), (0.1, 0.0)])
def test_a_face_in_front_of_a_landmark_blocks_its_ray(before, conflict):
    xyz = np.concatenate([square(4.0 - before), [[0.1, 0.2, 4.0]]])
    assert measures.ray_conflicts(xyz, SQUARE, RIG, HERE, [4], [0], [0.0]) == conflict


def test_sigma_lets_faces_in_front_be():
    xyz = np.concatenate([square(3.5), [[0.1, 0.2, 4.0]]])
    assert measures.ray_conflicts(xyz, SQUARE, RIG, HERE, [4], [0], [0.2]) == 0
    assert measures.ray_conflicts(xyz, SQUARE, RIG, HERE, [4], [0]) == 0  # 0.3 z² / (f b) = 0.24 m
    assert measures.ray_conflicts(xyz, SQUARE, RIG, HERE, [4], [0], [0.1]) == 1


def test_faces_of_the_landmark_itself_and_behind_it_do_not_block():
    xyz = np.concatenate([square(4.0), [[0.0, 0, 5.0]], square(6.0)])
    faces = np.concatenate([SQUARE, SQUARE + 5])
    assert measures.ray_conflicts(xyz, faces, RIG, HERE, [0, 1, 2, 3], [0] * 4, [0.0] * 4) == 0
    assert measures.ray_conflicts(xyz, faces, RIG, HERE, [4, 0], [0, 0], [0.0] * 2) == 0.5


def test_a_landmark_outside_the_image_or_behind_the_camera_is_judged():
    xyz = np.concatenate([square(3.0, half=9.0), [[5.0, 0.2, 4.0], [0.0, 0, -1]]])
    assert measures.conflicting_rays(xyz, SQUARE, RIG, HERE, [4, 5], [0, 0], [0.0] * 2).tolist() == [True, True]


def test_rays_agree_with_a_test_of_every_face():
    rng = np.random.default_rng(3)
    xyz = rng.uniform((-3, -3, -1), (3, 3, 8), (60, 3))
    faces = rng.permuted(np.tile(np.arange(60), (80, 1)), axis=1)[:, :3]
    vertex = np.flatnonzero(xyz[:, 2] > 0.2)
    found = measures.conflicting_rays(xyz, faces, RIG, HERE, vertex, 0 * vertex, 0.0 * vertex)
    for v, blocked in zip(vertex, found, strict=True):
        t = [np.linalg.solve(np.c_[xyz[v], xyz[a] - xyz[b], xyz[a] - xyz[c]], xyz[a]) for a, b, c in faces]
        hits = [0 < s < 0.95 and p >= 0 and q >= 0 and p + q <= 1 for s, p, q in t]
        assert blocked == any(hit and v not in face for hit, face in zip(hits, faces, strict=True))


def test_an_edge_of_three_faces_is_found():
    assert measures.manifold_faults(SQUARE, 4) == (0, 0)
    assert measures.manifold_faults([[0, 1, 2], [1, 0, 3], [0, 1, 4]], 5) == (1, 0)
    assert measures.manifold_faults([[0, 1, 2], [1, 2, 0]], 3) == (3, 0)


def test_a_bow_tie_vertex_is_found():
    assert measures.manifold_faults([[0, 1, 2], [0, 3, 4]], 5) == (0, 1)
    assert measures.manifold_faults([[0, 1, 2], [0, 2, 3], [0, 3, 4]], 5) == (0, 0)
    assert measures.manifold_faults(np.zeros((0, 3), int), 5) == (0, 0)


def test_samples_are_uniform_by_area():
    xyz = np.array([[0.0, 0, 1], [3, 0, 1], [0, 2, 1], [5, 5, 1], [6, 5, 1], [5, 7, 1]])
    points, of = measures.face_samples(xyz, np.array([[0, 1, 2], [3, 4, 5]]), 4000)
    assert (of == 0).mean() == pytest.approx(0.75, abs=1e-3)
    assert points[of == 0].mean(axis=0) == pytest.approx(xyz[:3].mean(axis=0), abs=0.03)


@pytest.mark.parametrize(("off", "front", "behind"), [(0.01, 0, 0), (0.05, 0, 1), (-0.05, 1, 0)])
def test_distance_of_a_wall_is_its_offset_over_depth(off, front, behind):
    truth = measures.true_surface(seen(4.0), RIG, HERE, HERE)
    found = measures.distance_to_truth(square(4.0 * (1 + off)), SQUARE, truth, range(4), [0] * 4, n=500)
    assert found.median == pytest.approx(abs(off) / (1 + off), rel=1e-3)
    assert found.p95 == pytest.approx(abs(off) / (1 + off), rel=1e-3)
    assert (found.front, found.behind, found.unviewed) == (front, behind, 0)


def test_drift_does_not_count():
    T, drifted = np.concatenate([HERE, moved(x=0.3)]), moved(np.concatenate([HERE, moved(x=0.3)]), y=0.7)
    truth = measures.true_surface(seen(4.0, T), RIG, drifted, T)
    xyz = shifted(square(4.0), y=0.7)
    assert measures.distance_to_truth(xyz, SQUARE, truth, [0, 1], [0, 1], n=500).p95 < 1e-6
    assert measures.coverage(shifted(square(4.0, 5.0), y=0.7), SQUARE, truth) == 1
    assert max(measures.truth_floor(truth)) < 1e-6


def test_depth_is_that_of_the_nearest_keyframe_which_has_the_face():
    T = np.concatenate([HERE, moved(z=2.0), moved(z=3.0)])
    assert measures.nearest_keyframe(square(4.0), SQUARE, T, [0, 0], [0, 1]).tolist() == [1, 1]
    assert measures.nearest_keyframe(square(4.0), SQUARE, T, [1], [2]).tolist() == [2, -1]


def test_normals_of_a_depth_image_are_those_of_the_plane():
    v, u = np.mgrid[: RIG.height, : RIG.width]
    plane = np.array([0.6, 0.0, -0.8])  # unit normal; the plane is 4 m away
    depth = -4.0 / (plane @ np.stack([(u - RIG.cx) / RIG.fx, (v - RIG.cy) / RIG.fy, 1 + 0.0 * u], axis=-2))
    truth = measures.true_surface(np.where(depth > 0, depth, np.nan)[None], RIG, HERE, HERE)
    assert np.abs(truth.normal @ plane) == pytest.approx(1, abs=1e-4)


def test_coverage_is_the_covered_share_of_what_two_keyframes_see():
    T = np.concatenate([HERE, moved(x=0.4)])
    truth = measures.true_surface(seen(4.0, T), RIG, T, T)
    everything = square(4.0, 9.0)
    assert measures.coverage(everything, SQUARE, truth) == 1
    assert measures.coverage(everything, SQUARE[:0], truth) == 0
    assert measures.coverage(shifted(everything, z=0.11), SQUARE, truth) == 1
    assert measures.coverage(shifted(everything, z=0.13), SQUARE, truth) == 0
    half = everything.copy()
    half[[0, 3], 0] = 0.2  # the middle of what both see
    assert measures.coverage(half, SQUARE, truth, every=1) == pytest.approx(0.53, abs=0.04)
    assert measures.coverage(everything, SQUARE, truth, farthest=3.0) == 0


def test_nearness_agrees_with_distances_to_every_face():
    rng = np.random.default_rng(5)
    xyz, faces = rng.uniform(-1, 1, (30, 3)), rng.integers(0, 30, (12, 3))
    points, reach = rng.uniform(-1.5, 1.5, (400, 3)), rng.uniform(0.02, 0.5, 400)
    share = np.array([(i, j, 40 - i - j) for i in range(41) for j in range(41 - i)]) / 40
    dense = (share @ xyz[faces]).reshape(-1, 3)
    least = np.linalg.norm(points[:, None] - dense, axis=-1).min(axis=1)
    near = measures.near_faces(xyz, faces, points, reach)
    assert near[least <= reach].all()
    assert not near[least > reach + 0.08].any()  # samples are 0.08 m apart at most
