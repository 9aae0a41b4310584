"""One surface: the least cut, a disc of a plane, a sphere of a room, and what landmarks are no surface."""

from itertools import product

import numpy as np
import pytest

from tspslam import build_complex
from tspslam.errors import GeometryError
from tspslam.mapping.landmarks import Landmarks, measure_covariances
from tspslam.mapping.settings import ObservationSettings, SurfaceSettings, ViewSettings
from tspslam.mapping.surface import _far_side, _is_seen, _is_short, cut_surface, make_manifold, make_rays
from tspslam.mapping.views import Sightings
from tspslam.mapping.visibility import face_normals

from .worlds import RIG, ROOM, WIDE, border_loops, looking, room, sightings, wall

SETTINGS, WIDE_FACES = SurfaceSettings(), SurfaceSettings(longest=10, longest_apart=10)


def cut(rig, poses, xyz, settings=SETTINGS, seen=None):
    seen = sightings(rig, poses, xyz) if seen is None else seen
    landmarks = Landmarks(np.arange(len(xyz)), xyz, seen.take(np.lexsort((seen.keyframe, seen.landmark))))
    landmarks = landmarks.keep(np.bincount(seen.landmark, minlength=len(xyz)) > 1)
    landmarks, covariance = measure_covariances(rig, poses, landmarks, ObservationSettings())
    rays = make_rays(poses, landmarks, covariance)
    return landmarks.id[cut_surface(rig, poses, landmarks.xyz, rays, settings, ViewSettings())]


def cost(is_far, one, other, capacity, free, full):
    """Of a cut: what goes from near to far, free tetrahedra that are far, full ones that are near."""
    return capacity[~is_far[one] & is_far[other]].sum() + free[is_far].sum() + full[~is_far].sum()


@pytest.mark.parametrize("seed", range(30))
def test_the_cut_is_a_least_one_of_all(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 9))
    one, other = np.nonzero((rng.random((count, count)) < 0.5) & ~np.eye(count, dtype=bool))
    capacity = rng.integers(0, 30, len(one)) / 10  # whole numbers after scaling
    free, full = (rng.integers(0, 40, count) / 10 * (rng.random(count) < 0.6) for _ in range(2))
    given = one, other.astype(np.int32), capacity, free, full
    least = min(cost(np.array(labels, bool), *given) for labels in product((0, 1), repeat=count))
    assert cost(_far_side(*given), *given) == pytest.approx(least, abs=1e-9)


def test_of_least_cuts_the_one_nearest_the_source_is_taken():
    one, other = np.array([0, 1]), np.array([1, 2], np.int32)
    equal = np.ones(2)
    far = _far_side(one, other, equal, np.array([9.0, 0, 0]), np.array([0, 0, 9.0]))
    assert far.tolist() == [False, True, True]
    assert _far_side(one, other, 0 * equal, np.array([1.0, 0, 0]), np.zeros(3)).tolist() == [False, True, True]


@pytest.mark.parametrize("count", [12, 60, 150, 400])
def test_a_plane_seen_from_everywhere_is_one_disc(count):
    world = wall(count)
    xyz, poses = world.snapshot.xyz, world.snapshot.T_world_camera
    faces = cut(RIG, poses, xyz, WIDE_FACES)
    complex_ = build_complex(faces, len(xyz))
    used = len(np.unique(faces))
    assert used > 0.95 * count
    assert complex_.euler - (count - used) == 1
    assert border_loops(faces) == 1
    assert np.abs(xyz[faces][:, :, 2] - 4).max() < 1e-9
    towards = poses[:, :3, 3] - xyz[faces[:, 0], None]
    assert (np.einsum("fi,fki->fk", face_normals(xyz, faces), towards) > 0).all()


@pytest.mark.parametrize("count", [1000, 2500])
def test_a_room_seen_from_inside_is_a_sphere_up_to_its_holes(count):
    world = room(count)
    xyz, poses = world.snapshot.xyz, world.snapshot.T_world_camera
    faces = cut(WIDE, poses, xyz, WIDE_FACES)
    used = len(np.unique(faces))
    assert used > 0.9 * count
    assert build_complex(faces, count).euler - (count - used) == 2 - border_loops(faces)
    assert np.array_equal(make_manifold(faces, xyz), faces)
    centre = xyz[faces].mean(axis=1)
    off = np.abs(0.5 - np.abs(centre) / ROOM).min(axis=1) * ROOM.min()
    assert np.median(off) < 1e-9
    assert np.percentile(off, 95) < 0.1  # of faces across the edges of the room
    inwards = np.einsum("fi,fi->f", face_normals(xyz, faces), -centre)
    assert (inwards > 0).all()


def test_a_closed_room_of_many_landmarks_has_few_holes():
    world = room(2500)
    faces = cut(WIDE, world.snapshot.T_world_camera, world.snapshot.xyz, WIDE_FACES)
    area = np.linalg.norm(face_normals(world.snapshot.xyz, faces), axis=1).sum() / 2
    w, h, d = ROOM
    assert area == pytest.approx(2 * (w * h + h * d + w * d), rel=0.1)


def test_no_side_is_longer_than_its_depth_allows():
    world = wall()
    xyz, poses = world.snapshot.xyz, world.snapshot.T_world_camera
    settings = SurfaceSettings(longest=0.08, longest_apart=0.05)
    faces = cut(RIG, poses, xyz, settings)
    depth = np.einsum("nki,ki->nk", xyz[:, None] - poses[:, :3, 3], poses[:, :3, 2]).min(axis=1)
    sides = np.linalg.norm(xyz[faces] - xyz[np.roll(faces, -1, axis=1)], axis=2)
    assert 10 < len(faces) < 300
    assert (sides.max(axis=1) <= 0.0801 * depth[faces].max(axis=1)).all()


@pytest.mark.parametrize(("side", "shared", "stays"), [(0.5, False, True), (1.0, False, False), (1.0, True, True),
                                                       (1.4, True, False)])  # fmt: skip
def test_a_long_face_stays_where_a_keyframe_sees_it_whole(side, shared, stays):
    """At a depth of 3 m sides up to 0.6 m stay, and up to 1.2 m where one keyframe sees all corners."""
    xyz = side * np.array([[-0.5, -0.3, 0], [0.5, -0.3, 0], [0, 0.4, 0]]) + (0, 0, 3)
    poses = looking([(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0.01, 0.01, 0)], at=(0, 0, 3))
    seen = sightings(RIG, poses, xyz)
    seen = seen.take((seen.landmark != seen.keyframe) & (shared | (seen.keyframe < 3)))  # the fourth sees all three
    seen = seen.take(np.lexsort((seen.keyframe, seen.landmark)))
    rays = make_rays(poses, Landmarks(np.arange(3), xyz, seen), np.tile(1e-4 * np.eye(3), (3, 1, 1)))
    settings = SurfaceSettings(longest=0.4, longest_apart=0.2)
    assert _is_short(xyz, np.array([[0, 2, 1]], np.int32), rays, poses[:, :3, 3], settings).tolist() == [stays]


@pytest.mark.parametrize(
    ("angle", "stays"), [(0, True), (80, True), (83, True), (85, False), (89, False), (100, False)]
)
def test_a_long_face_goes_where_all_that_see_it_whole_see_it_slanted(angle, stays):
    """As where depth steps: the face from an edge to what is behind it lies along the rays."""
    turn = np.radians(angle)
    flat = np.array([[-0.5, -0.3, 0], [0.5, -0.3, 0], [0, 0.4, 0]])
    flat -= flat.mean(axis=0)
    xyz = flat @ np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]]) + (0, 0, 3)
    poses = looking([(0, 0, 0)], at=(0, 0, 3))
    seen = Sightings(np.arange(3), np.zeros(3, np.int64), np.zeros((3, 2)), np.ones(3))
    rays = make_rays(poses, Landmarks(np.arange(3), xyz, seen), np.tile(1e-4 * np.eye(3), (3, 1, 1)))
    settings = SurfaceSettings(longest=1.0, longest_apart=0.1, max_slant=84)
    assert _is_short(xyz, np.array([[0, 2, 1]], np.int32), rays, poses[:, :3, 3], settings).tolist() == [stays]


def test_where_landmarks_are_seen_through_is_no_face():
    behind = np.column_stack([np.random.default_rng(0).uniform(-0.3, 0.3, (8, 2)), np.full(8, 4.0)])
    frame = [(x, y, 3.0) for x in (-0.6, 0, 0.6) for y in (-0.6, 0.02, 0.6) if (x, y) != (0, 0.02)]
    poses = looking([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)])
    seen_through = cut(RIG, poses, np.concatenate([frame, behind]), WIDE_FACES)
    alone = cut(RIG, poses, np.array(frame), WIDE_FACES)
    middle = np.array([0.05, 0.05, 3.0])

    def covers(xyz, faces):
        a, b, c = (xyz[faces][:, k, :2] - middle[:2] for k in range(3))
        turns = [p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((a, b), (b, c), (c, a))]
        return ((np.sign(turns) == np.sign(turns[0])).all(axis=0) & (xyz[faces][:, :, 2] < 3.5).all(axis=1)).any()

    assert covers(np.array(frame), alone)
    assert not covers(np.concatenate([frame, behind]), seen_through)


@pytest.mark.parametrize(("behind", "stays"), [(0, True), (1, True), (2, False), (5, False)])
def test_a_face_goes_that_two_landmarks_are_seen_through(behind, stays):
    front = np.array([[-0.5, -0.5, 3], [0.5, -0.4, 3], [0, 0.6, 3]])
    xyz = np.concatenate([front, np.linspace((-0.1, -0.1, 4), (0.1, 0.1, 4), behind)])
    poses = looking([(0, 0, 0), (0.1, 0, 0)])
    assert is_seen(poses, xyz, [[0, 2, 1]]).tolist() == [stays]


@pytest.mark.parametrize("size", [1.0, 0.1, 0.01, 1e-3, 1e-5])
def test_a_face_stays_however_small_if_it_is_seen_from_the_front(size):
    xyz = size * np.array([[-0.5, -0.5, 0], [0.5, -0.4, 0], [0.1, 0.6, 0]]) + (0.013, 0.017, 3)
    poses = looking([(0, 0, 0), (0.1, 0, 0)])
    assert is_seen(poses, xyz, [[0, 2, 1]]).tolist() == [True]
    assert is_seen(poses, xyz, [[0, 1, 2]]).tolist() == [False]  # its back


def test_a_face_behind_another_goes_however_small():
    shield = np.array([[-0.9, -0.9, 2.0], [0.9, -0.8, 2], [0, 1.1, 2]])
    poses = looking([(0, 0, 0), (0.1, 0, 0)])
    for size in (0.1, 0.001):
        hidden = size * np.array([[-0.5, -0.5, 0], [0.5, -0.4, 0], [0.1, 0.6, 0]]) + (0.013, 0.017, 3)
        seen = sightings(RIG, poses, shield)
        assert is_seen(poses, np.concatenate([shield, hidden]), [[0, 2, 1], [3, 5, 4]], seen).tolist() == [True, False]


def is_seen(poses, xyz, faces, seen=None):
    """Which faces `cut_surface` keeps, of given ones."""
    seen = sightings(RIG, poses, xyz) if seen is None else seen
    seen = seen.take(np.lexsort((seen.keyframe, seen.landmark)))
    rays = make_rays(poses, Landmarks(np.arange(len(xyz)), xyz, seen), np.tile(1e-4 * np.eye(3), (len(xyz), 1, 1)))
    return _is_seen(RIG, poses, xyz, np.array(faces, np.int32), rays, SurfaceSettings(seen_through=2), ViewSettings())


def test_rays_are_the_observations():
    world = wall(60)
    xyz, poses, seen = world.snapshot.xyz, world.snapshot.T_world_camera, world.known()
    seen = seen.take(np.lexsort((seen.keyframe, seen.landmark)))
    covariance = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (60, 1, 1))
    rays = make_rays(poses, Landmarks(np.arange(60), xyz, seen), covariance)
    assert np.array_equal(rays.vertex, seen.landmark)
    for i, k, origin, sigma, depth in zip(*rays, strict=True):
        way = xyz[i] - poses[k, :3, 3]
        assert np.array_equal(origin, poses[k, :3, 3])
        assert depth == pytest.approx(way @ poses[k, :3, 2])
        assert sigma**2 == pytest.approx(way @ covariance[0] @ way / (way @ way))


LINE = np.linspace((-1, -0.5, 4), (1, 0.3, 4.2), 30)


@pytest.mark.parametrize("xyz", [LINE, np.tile([0.1, 0, 4.0], (30, 1)), LINE[:2], LINE[:1]],
                         ids=["line", "point", "two", "one"])  # fmt: skip
def test_landmarks_on_a_line_span_no_surface(xyz):
    with pytest.raises(GeometryError, match=r"^map: \d+ landmarks span no surface, expected .*$"):
        cut(RIG, wall().snapshot.T_world_camera, xyz)


def test_three_landmarks_are_a_face():
    xyz = np.array([[-0.5, 0, 4.0], [0.5, 0.1, 4.1], [0, 0.6, 3.9]])
    assert np.sort(cut(RIG, wall().snapshot.T_world_camera, xyz)).tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("flat", [False, True])
def test_lattices_are_a_surface(flat):
    x, y, z = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-0.8, 0.8, 7), [4.0] if flat else [4.0, 4.25, 4.5])
    xyz = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    faces = cut(RIG, wall().snapshot.T_world_camera, xyz)
    assert np.array_equal(make_manifold(faces, xyz), faces)
    if flat:
        assert build_complex(faces, len(xyz)).euler == 1
    assert len(np.unique(faces)) > 0.5 * len(xyz)
