"""Signals and directions of a map beside the truth of a ramp on a slanted wall."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import mapping
from benchmarks import mapping_signals as signals
from benchmarks.mapping_measures import lens_of, to_camera
from tspslam import Rig, build_complex
from tspslam.datasets import synthetic

RIG = Rig(fx=120, fy=110, cx=60, cy=50, baseline=0.2, width=121, height=101, skew=2.0)
WALL = np.array([[1.0, 0, 0.7], [0, 1, 0.2]])  # its axes; it passes through (0, 0, 4)
SLOPE = np.array([0.03, 0.05])  # luminance along them, per unit
NORMAL = np.cross(*WALL) / np.linalg.norm(np.cross(*WALL))


def poses():
    T = np.eye(4)[None].repeat(3, axis=0)
    T[1, :3, 3], T[2, :3, 3] = (0.4, 0.1, 0.3), (-0.3, -0.2, 0.5)
    return T


def taken(T):
    """Images of the ramp on the wall, which fills them."""
    v, u = np.mgrid[: RIG.height, : RIG.width]
    y = (v - RIG.cy) / RIG.fy
    ray = np.stack([(u - RIG.cx - RIG.skew * y) / RIG.fx, y, np.ones_like(y)], axis=-1)
    images = []
    for pose in T:
        far = (np.array([0, 0, 4.0]) - pose[:3, 3]) @ NORMAL / (ray @ NORMAL)
        at = ray * far[..., None] + pose[:3, 3] - (0, 0, 4)
        images.append(0.5 + at[..., 0] * SLOPE[0] + at[..., 1] * SLOPE[1])
    return np.stack(images)


def fan():
    """Seven vertices of the wall, the first amid the others."""
    turn = 2 * np.pi * np.arange(6) / 6
    at = np.concatenate([[[0, 0]], 0.6 * np.stack([np.cos(turn), np.sin(turn)], axis=1)])
    return (0, 0, 4) + at @ WALL, np.array([[0, k + 1, (k + 1) % 6 + 1] for k in range(6)])


def gradient():
    """Of luminance over the wall: G with G·w_k = slope_k, in its plane."""
    G = np.linalg.lstsq(WALL, SLOPE, rcond=None)[0]
    return G / np.linalg.norm(G)


def test_a_face_has_the_mean_of_the_ramp_in_its_best_view():
    xyz, faces = fan()
    views = signals.face_views(xyz, faces, RIG, poses(), taken(poses()))
    value, ok = signals.best_face_values(views, 6)
    centre = xyz[faces].mean(axis=1) - (0, 0, 4)
    assert ok.all()
    assert value == pytest.approx(0.5 + centre[:, :2] @ SLOPE, abs=1e-3)
    assert len(views.face) == 18


def test_best_views_have_most_pixels_and_chance_takes_all():
    xyz, faces = fan()
    T = poses()
    T[2, 2, 3] = 1.5  # nearest
    images = np.arange(3.0)[:, None, None] / 4 + np.zeros((3, RIG.height, RIG.width))
    views = signals.face_views(xyz, faces, RIG, T, images)
    assert set(signals.best_face_values(views, 6)[0]) == {0.5}
    taken_by_chance = [signals.one_view_values(views, 6, seed)[0][0] for seed in range(20)]
    assert set(taken_by_chance) == {0, 0.25, 0.5}


def test_channels_are_taken_at_once():
    xyz, faces = fan()
    images = np.stack([taken(poses()), 1 - taken(poses())], axis=-1)
    both = signals.face_views(xyz, faces, RIG, poses(), images).value
    assert both.sum(axis=1) == pytest.approx(1)


def test_hidden_faces_and_faces_seen_from_aside_do_not_count():
    xyz, faces = fan()
    front = (0, 0, 4) + 0.5 * (xyz - (0, 0, 4)) - (0, 0, 1)
    hidden = signals.face_views(np.concatenate([xyz, front]), np.concatenate([faces, faces + 7]), RIG, poses()[:1],
                                taken(poses()[:1]))  # fmt: skip
    assert set(hidden.face) == set(range(6, 12))
    aside = np.stack([xyz[:, 0], np.full(7, 0.3), 4 + 2 * xyz[:, 1]], axis=1)  # a floor 0.3 m below the camera
    assert not len(signals.face_views(aside, faces, RIG, poses()[:1], taken(poses()[:1])).face)


def test_one_gain_for_all_is_no_error():
    true, ok = np.array([0.2, 0.4, 0.6, 0.5]), np.array([True, True, True, False])
    assert signals.luminance_error(0.9 * true, ~ok | ok, true, ok) == pytest.approx(0)
    assert signals.luminance_error(true + np.array([0.1, 0, 0, 0.3]), ok, true, ok) == pytest.approx(0)
    assert signals.luminance_error(true * np.array([1.0, 1.1, 1.2, 9]), ok, true, ok) > 0.01


@pytest.mark.parametrize("k", range(3))
def test_the_true_direction_is_the_gradient_in_the_surface(k):
    T, (xyz, faces) = poses()[k : k + 1], fan()
    found = signals.true_directions(xyz, faces, RIG, T, taken(T))
    assert found.ok[0]
    assert found.direction[0] @ gradient() > np.cos(np.deg2rad(1))
    assert abs(found.normal[0] @ NORMAL) == pytest.approx(1)


@pytest.mark.parametrize("seed", range(3))
def test_a_plane_fit_lifted_as_a_gradient_agrees_from_every_camera(seed):
    xyz, faces = fan()
    T = poses()
    one, magnitude = signals.one_view_directions(xyz, faces, RIG, T, taken(T), seed, "plane")
    true = signals.true_directions(xyz, faces, RIG, T, taken(T))
    ok = one.ok & (np.arange(7) == 0)
    assert signals.direction_errors(one.direction, magnitude, ok, true).max() < 2
    assert ok[0]


def test_without_a_seed_the_nearest_view_is_taken():
    xyz, faces = fan()
    T, images = poses(), taken(poses())
    T[2, 2, 3] = 1.0
    images = np.stack([images[0], images[1], 1 - images[0]])  # luminance of the last falls where the others' grows
    one, _ = signals.one_view_directions(xyz, faces, RIG, T, images, None, "plane")
    true = signals.true_directions(xyz, faces, RIG, T, images)
    assert one.direction[0] @ gradient() < -0.9
    assert true.direction[0] @ gradient() < -0.9


def test_a_tangent_that_projects_along_a_slope_does():
    T, (xyz, _) = poses()[1], fan()
    points, slope = to_camera(xyz, T), np.array([[0.6, 0.8]]).repeat(7, axis=0)
    tangent, ok = signals.lift(slope, NORMAL[None].repeat(7, axis=0), points, T, RIG, "projection")
    moved = signals.pixels(to_camera(xyz + 1e-6 * tangent, T), lens_of(RIG)) - signals.pixels(points, lens_of(RIG))
    assert ok.all()
    assert moved / np.linalg.norm(moved, axis=1, keepdims=True) == pytest.approx(slope, abs=1e-4)


def test_all_ways_agree_on_a_wall_that_faces_the_camera():
    rig = Rig(fx=100, fy=100, cx=60, cy=50, baseline=0.2, width=121, height=101)
    normal, point, slope = np.array([[0, 0, -1.0]]), np.array([[0, 0, 3.0]]), np.array([[0.3, -0.4]])
    for how in ("gradient", "projection", "turned"):
        tangent, _ = signals.lift(slope, normal, point, np.eye(4), rig, how)
        assert tangent[0] == pytest.approx([0.6, -0.8, 0])


def test_errors_are_angles_in_the_tangent_plane_of_the_strongest_half():
    x, normal = np.array([[1.0, 0, 0]]).repeat(4, axis=0), np.array([[0, 0, 1.0]]).repeat(4, axis=0)
    true = signals.Directions(x, normal, np.array([True, True, True, False]))
    given = np.array([[0, 1, 0], [np.sqrt(0.75), -0.5, 3], [-1, 0, 0], [0, 1, 0]])
    errors = signals.direction_errors(given, [1, 2, 3, 4], np.ones(4, bool), true)
    assert errors == pytest.approx([30, 180])


def test_every_figure_of_a_map_is_found():
    wall = synthetic.Scene((synthetic.plane(9, 9).at(0, 0, 4, turn=(0, 0.3, 0)),), poses())
    rig = Rig(fx=120, fy=110, cx=60, cy=50, baseline=0.2, width=121, height=101)
    noisy, clean = (synthetic.SyntheticSequence(wall, rig, faults) for faults in (mapping.FAULTS, mapping.CLEAN))
    at, faces = fan()
    xyz = np.column_stack([at[:, :2], 4 - np.tan(0.3) * at[:, 0]])
    views = signals.face_views(xyz, faces, rig, poses(), np.stack([clean[k].left for k in range(3)]))
    face, ok = signals.best_face_values(views, 6)
    true = signals.true_directions(xyz, faces, rig, poses(), np.stack([clean[k].left for k in range(3)]))
    made = SimpleNamespace(
        xyz=xyz, complex_=build_complex(faces, 7), keyframes=np.arange(3), T_world_camera=poses(), defined=true.ok,
        observations=SimpleNamespace(start=3 * np.arange(8), keyframe=np.tile(np.arange(3), 7)),
        signals=SimpleNamespace(face=face, face_ok=ok), response=SimpleNamespace(magnitude=np.ones(7)),
        direction=true.direction,
    )  # fmt: skip
    found = mapping.figures(made, mapping.World("wall", noisy, clean))
    assert (found["faces"], found["three sightings"], found["double"], found["blocked"]) == (6, 100, 0, 0)
    assert found["off 95th"] < 1e-3
    assert 0 < found["covered"] < 100
    assert (found["grey / one"], found["turned / one"]) == pytest.approx((0, 0), abs=1e-9)
    assert np.isfinite(list(found.values())).all()
