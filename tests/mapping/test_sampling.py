"""What keyframes see of the map, beside SPEC 5 taken literally; phases turned into tangents."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam import Response, Rig, build_complex, sample_signals
from tspslam.mapping.averaging import average, estimate_gains
from tspslam.mapping.sampling import frame_shape, lift_phases, sample_views, see_vertices, viewing_cosines
from tspslam.mapping.settings import ViewSettings
from tspslam.mapping.views import View, to_camera
from tspslam.mapping.visibility import face_normals
from tspslam.topology.harmonic import Tmahf, tmahf
from tspslam.vision.rig import project

from .worlds import RIG, looking, wall

SETTINGS = ViewSettings()
LEAST = np.cos(np.radians(75))


def shape_of(xyz, faces, sigma=0.01):
    covariance = np.tile(sigma**2 * np.eye(3), (len(xyz), 1, 1))
    return frame_shape(build_complex(faces, len(xyz)), np.asarray(faces, np.int32), xyz, covariance)


def small_wall(count=30):
    """Views of the wall, and a complex over few of its points."""
    from scipy.spatial import Delaunay

    world = wall()
    xyz = world.snapshot.xyz[:count]
    faces = Delaunay(xyz[:, :2]).simplices
    away = face_normals(xyz, faces)[:, 2] > 0
    faces[away] = faces[away][:, ::-1]
    return world.views, shape_of(xyz, faces)


def exposures(views):
    gains = 2.0 ** np.linspace(-0.4, 0.4, len(views))
    return [replace(view, given=gain * view.image / 512.0) for view, gain in zip(views, gains, strict=True)], 1 / gains


def literal(shape, views, k):
    """Signals, their weights and the response in one keyframe, nothing being hidden: SPEC 3 to 5."""
    T = views[k].T_world_camera
    uv = project(RIG, to_camera(shape.xyz, T))
    is_out = ~((uv >= 0) & (uv <= (RIG.width - 1, RIG.height - 1))).all(axis=1)
    signals = sample_signals(views[k].image, np.where(is_out[:, None], np.nan, uv), shape.complex_)
    sizes = np.ones(len(uv)), signals.edge_pixels, signals.face_pixels
    levels = []
    for values, ok, centres, normals, pixels in zip(
        (signals.vertex, signals.edge, signals.face), (signals.vertex_ok, signals.edge_ok, signals.face_ok),
        shape.centres, shape.normals, sizes, strict=True,
    ):  # fmt: skip
        cosine = np.array(
            [n @ (T[:3, 3] - c) / np.linalg.norm(T[:3, 3] - c) for n, c in zip(normals, centres, strict=True)]
        )
        levels.append((values, np.where(ok & (cosine >= LEAST), cosine * np.maximum(pixels, 1), 0)))
    return levels, tmahf(shape.complex_, np.where(is_out[:, None], np.nan, uv), signals), is_out


def test_signals_are_the_weighted_means_of_spec_5():
    views, shape = small_wall()
    views, true_gain = exposures(views)
    samples = sample_views(views, np.arange(len(views)), RIG, shape, Tmahf(), SETTINGS)
    gain = estimate_gains(samples.face, len(views), SETTINGS)
    assert np.log2(gain) == pytest.approx(np.log2(true_gain), abs=0.01)
    every = [literal(shape, views, k)[0] for k in range(len(views))]
    for level, sample in enumerate((samples.vertex, samples.edge, samples.face)):
        count = len(shape.centres[level])
        mean = average(sample, gain, count)
        for i in range(count):
            seen = [(w[i], gain[k] * s[i]) for k, (s, w) in enumerate(levels[level] for levels in every) if w[i] > 0]
            total = sum(w for w, _ in seen)
            value = sum(w * s for w, s in seen) / total
            assert mean.views[i] == len(seen)
            assert mean.value[i] == pytest.approx(value, abs=1e-9)
            assert mean.variance[i] == pytest.approx(sum(w * (s - value) ** 2 for w, s in seen) / total, abs=1e-9)


def test_answers_are_the_filter_s_where_the_whole_star_is_inside():
    views, shape = small_wall(60)
    answer = sample_views(views, np.arange(len(views)), RIG, shape, Tmahf(), SETTINGS).answer
    for k in range(len(views)):
        _, response, is_out = literal(shape, views, k)
        is_cut = np.zeros(len(is_out), bool)
        is_cut[shape.complex_.faces[is_out[shape.complex_.faces].any(axis=1)]] = True
        mine = answer.vertex[answer.keyframe == k]
        assert np.array_equal(mine, np.flatnonzero(response.defined & ~is_cut))
        assert answer.z[answer.keyframe == k] == pytest.approx(response.z[mine], abs=1e-9)


def behind_a_shield():
    """A patch 1 m before a wall: the wall's first corners are hidden from a camera straight before it."""
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 13), np.linspace(-0.9, 0.9, 10))
    wall_xyz = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 4.0)])
    row, column = np.indices((9, 12)).reshape(2, -1)
    a = row * 13 + column
    faces = np.concatenate([np.stack([a, a + 14, a + 1], 1), np.stack([a, a + 13, a + 14], 1)])
    shield = np.array([[-0.33, -0.33, 3.0], [0.33, -0.33, 3], [0.33, 0.33, 3], [-0.33, 0.33, 3]])
    n = len(wall_xyz)
    return shape_of(np.concatenate([wall_xyz, shield]), np.concatenate([faces, [[n, n + 2, n + 1], [n, n + 3, n + 2]]]))


def test_vertices_behind_a_face_are_hidden_and_others_are_seen():
    shape = behind_a_shield()
    uv, is_seen = see_vertices(RIG, np.eye(4), shape, SETTINGS)
    assert uv == pytest.approx(project(RIG, shape.xyz))
    x, y, z = shape.xyz.T
    off = np.maximum(np.abs(x), np.abs(y)) - 0.33 * 4 / 3  # of the shield's shadow
    edge = 2.0 * 4 / RIG.fx  # outlines are as coarse as the buffer
    assert not is_seen[(z == 4) & (off < -edge)].any()
    assert is_seen[((z == 4) & (off > edge)) | (z == 3)].all()
    assert ((z == 4) & (off < -edge)).sum() >= 9


def test_a_face_nearer_by_less_than_three_deviations_hides_nothing():
    shape = behind_a_shield()
    unsure = replace(shape, covariance=shape.covariance * (0.34 / 0.01) ** 2)
    assert see_vertices(RIG, np.eye(4), unsure, SETTINGS)[1].all()


def test_what_no_keyframe_sees_is_zero_and_has_no_view():
    shape = behind_a_shield()
    image = np.random.default_rng(0).integers(0, 255, (RIG.height, RIG.width)).astype(np.uint8)
    samples = sample_views([View(0, np.eye(4), image)], np.arange(1), RIG, shape, Tmahf(), SETTINGS)
    is_seen = see_vertices(RIG, np.eye(4), shape, SETTINGS)[1]
    rows = None, shape.complex_.edges, shape.complex_.faces
    for sample, corners, centres in zip((samples.vertex, samples.edge, samples.face), rows, shape.centres, strict=True):
        whole = is_seen if corners is None else is_seen[corners].all(axis=1)
        mean = average(sample, np.ones(1), len(centres))
        assert np.array_equal(mean.views > 0, whole)
        assert not mean.value[~whole].any()
        assert 0 < whole.sum() < len(whole)
    assert np.array_equal(samples.seen, np.flatnonzero(is_seen))
    cut = shape.complex_.faces[~is_seen[shape.complex_.faces].all(axis=1)]
    assert not set(samples.answer.vertex) & set(cut.ravel().tolist())  # whose star is hidden in part
    assert 40 < len(samples.answer.vertex) < is_seen.sum()


@pytest.mark.parametrize(("degrees", "counts"), [(0, True), (60, True), (74, True), (76, False), (100, False)])
def test_views_beyond_75_degrees_from_the_normal_do_not_count(degrees, counts):
    turn = np.radians(degrees)
    corners = 0.05 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0.1, 0, 0]])
    at = np.column_stack([corners[:, 0] * np.cos(turn), corners[:, 1], 4 + corners[:, 0] * np.sin(turn)])
    faces = [[4, 1, 0], [4, 2, 1], [4, 3, 2], [4, 0, 3]]
    image = np.random.default_rng(0).integers(0, 255, (RIG.height, RIG.width)).astype(np.uint8)
    samples = sample_views([View(0, np.eye(4), image)], np.arange(1), RIG, shape_of(at, faces), Tmahf(), SETTINGS)
    for sample in samples[:3]:
        assert (len(sample.element) > 0) == counts
    assert set(samples.answer.vertex) <= ({0, 1, 2, 3, 4} if counts else set())
    assert len(samples.seen) == 5  # seen, whatever the angle


def test_normals_are_area_weighted_and_cosines_those_of_the_angle():
    xyz = np.array([[0, 0, 4.0], [1, 0, 4], [0, 2, 4], [0, 0, 7]])
    faces = np.array([[0, 2, 1], [0, 3, 2]])
    shape = shape_of(xyz, faces)
    assert shape.normals[2] == pytest.approx(np.array([[0, 0, -1], [-1, 0, 0]]))
    together = np.array([-6, 0, -2]) / np.sqrt(40)
    assert shape.normals[0][[0, 2]] == pytest.approx(np.array([together, together]))
    edge = shape.complex_.edges.tolist().index([0, 2])
    assert shape.normals[1][edge] == pytest.approx(together)
    assert viewing_cosines(xyz[:1], np.array([[0, 0, -1.0]]), np.array([0, 3, 0])) == pytest.approx([0.8])


def tilted(count=40, seed=0):
    """Points before three cameras, unit normals towards these, and phases."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-0.8, -0.6, 3), (0.8, 0.6, 5), (count, 3))
    normals = rng.normal(size=(count, 3)) * 0.5 - (0, 0, 1)
    return xyz, normals / np.linalg.norm(normals, axis=1, keepdims=True), rng.uniform(-np.pi, np.pi, count)


SKEW = replace(RIG, skew=9.0, fy=80)


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("camera", range(3))
def test_the_projection_of_a_tangent_points_along_the_phase(camera, order):
    xyz, normals, theta = tilted()
    T = looking([(0.4, 0.1, -0.2), (-0.5, 0.3, 0), (0, -0.6, 0.5)])[camera]
    response = Response(0.2 * np.exp(1j * theta), order, np.ones(len(theta), bool))
    tangent = lift_phases(SKEW, T, xyz, normals, response, "projection")
    assert np.linalg.norm(tangent, axis=1) == pytest.approx(1)
    assert np.einsum("ni,ni->n", tangent, normals) == pytest.approx(0, abs=1e-12)
    step = 1e-6 * tangent
    moved = project(SKEW, to_camera(xyz + step, T)) - project(SKEW, to_camera(xyz - step, T))
    off = np.angle(np.exp(1j * (np.arctan2(moved[:, 1], moved[:, 0]) - theta / order)))
    assert off == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("camera", range(3))
def test_a_gradient_s_tangent_is_the_steepest_way_up_in_the_plane(camera):
    xyz, normals, theta = tilted(12)
    T = looking([(0.4, 0.1, -0.2), (-0.5, 0.3, 0), (0, -0.6, 0.5)])[camera]
    tangent = lift_phases(SKEW, T, xyz, normals, Response(np.exp(1j * theta), 1, np.ones(12, bool)), "gradient")
    assert np.linalg.norm(tangent, axis=1) == pytest.approx(1)
    assert np.einsum("ni,ni->n", tangent, normals) == pytest.approx(0, abs=1e-12)
    one = np.cross(normals, (0.0, 1, 0))
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two, slope = np.cross(normals, one), np.column_stack([np.cos(theta), np.sin(theta)])

    def rise(way):
        """Luminance cos θ u + sin θ v, along a way of the plane."""
        ends = [project(SKEW, to_camera(xyz + sign * 1e-6 * way, T)) for sign in (1, -1)]
        return np.einsum("ni,ni->n", ends[0] - ends[1], slope)

    steepest = rise(one)[:, None] * one + rise(two)[:, None] * two
    steepest /= np.linalg.norm(steepest, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", tangent, steepest) == pytest.approx(1, abs=1e-8)


@pytest.mark.parametrize("tangent", ["projection", "gradient"])
def test_no_response_has_no_direction(tangent):
    xyz, normals, _ = tilted(3)
    nothing = Response(np.array([0, 1e-15, 0.1]), 1, np.ones(3, bool))
    assert (lift_phases(RIG, np.eye(4), xyz, normals, nothing, tangent) != 0).any(axis=1).tolist() == [
        False,
        False,
        True,
    ]


def test_both_tangents_agree_on_a_plane_that_faces_the_camera():
    rig = Rig(fx=100, fy=100, cx=50, cy=50, baseline=0.1, width=100, height=100)
    theta = np.linspace(-3, 3, 9)
    xyz, normals = np.tile([0, 0, 3.0], (9, 1)), np.tile([0, 0, -1.0], (9, 1))
    response = Response(np.exp(1j * theta), 1, np.ones(9, bool))
    for tangent in ("projection", "gradient"):
        lifted = lift_phases(rig, np.eye(4), xyz, normals, response, tangent)
        assert lifted == pytest.approx(np.column_stack([np.cos(theta), np.sin(theta), 0 * theta]), abs=1e-12)
