from dataclasses import replace

import numpy as np
import pytest

from tspslam import InputError, Rig, delaunay_surface
from tspslam.apps import _cloud
from tspslam.apps.cloud import denoise_cloud
from tspslam.topology.complex import build_complex
from tspslam.types import Cloud, Surface
from tspslam.vision.rig import back_project, covariance, project

RIG = Rig(fx=400, fy=410, cx=120, cy=90, baseline=0.2, width=240, height=180, skew=3.0, doffs=4.0)
GREY = np.full((180, 240), 0.5)


def places(n=900, seed=0):
    return np.random.default_rng(seed).uniform(0, 1, (n, 2)) * (239, 179)


def cloud_at(uv, disparity, sigma=0.5):
    return Cloud(back_project(RIG, uv, disparity), uv, disparity, covariance(RIG, uv, disparity, sigma))


def plane(uv):
    return 20 + 0.05 * uv[:, 0] - 0.02 * uv[:, 1]


def step(uv):
    """Disparities of two planes, one before the other from column 120 on."""
    return plane(uv) + 12.0 * (uv[:, 0] > 120)


def roof(uv):
    return 30 - 0.12 * np.abs(uv[:, 0] - 120)


def whole(uv):
    """All triangles, also those over steps."""
    return delaunay_surface(cloud_at(uv, np.full(len(uv), 20.0)))


def noisy(truth, seed=1, sigma=0.3):
    return truth + np.random.default_rng(seed).normal(0, sigma, len(truth))


def error(got, truth):
    return float(np.sqrt(np.mean((got - truth) ** 2)))


def halves():
    image = np.full((180, 240), 0.2)
    image[:, 121:] = 0.8
    return image


@pytest.mark.parametrize("shape", [plane, step, roof])
def test_exact_planes_stay_as_they_are(shape):
    uv = places()
    uv = uv[np.abs(uv[:, 0] - 120) > 0.5]
    cloud = cloud_at(uv, shape(uv))
    flat = denoise_cloud(cloud, whole(uv), GREY)
    assert np.allclose(flat.xyz, cloud.xyz, rtol=1e-9)
    assert np.allclose(flat.disparity, cloud.disparity, atol=1e-9)


def test_a_noisy_plane_becomes_flatter():
    uv = places()
    raw = noisy(plane(uv))
    flat = denoise_cloud(cloud_at(uv, raw), whole(uv), GREY)
    assert error(flat.disparity, plane(uv)) < 0.45 * error(raw, plane(uv))


@pytest.mark.parametrize("image", [GREY, halves()], ids=["grey", "edge"])
def test_a_noisy_step_stays_a_step(image):
    uv = places()
    truth, raw = step(uv), noisy(step(uv))
    flat = denoise_cloud(cloud_at(uv, raw), whole(uv), image).disparity
    near = np.abs(uv[:, 0] - 120) < 10
    assert np.abs(flat - truth)[near].max() < 1.5  # of 12 px; noise alone reaches 0.9
    assert error(flat, truth) < 0.55 * error(raw, truth)


def test_an_edge_in_the_image_keeps_a_low_step_sharper():
    uv = places(2500)
    truth = plane(uv) + 4 * (uv[:, 0] > 120.5)
    cloud = cloud_at(uv, noisy(truth))
    near = np.abs(uv[:, 0] - 120.5) < 8
    plain, seen = (denoise_cloud(cloud, whole(uv), image).disparity for image in (GREY, halves()))
    assert error(seen[near], truth[near]) < 0.6 * error(plain[near], truth[near])
    assert error(seen[near], truth[near]) < 0.9 * error(cloud.disparity[near], truth[near])


def test_an_outlier_does_not_pull_its_neighbours():
    uv = places()
    raw = noisy(plane(uv))
    inner = int(np.argmin(((uv - (120, 90)) ** 2).sum(axis=1)))
    wrong = raw.copy()
    wrong[inner] += 15
    surface = whole(uv)
    good, spoilt = (denoise_cloud(cloud_at(uv, d), surface, GREY).disparity for d in (raw, wrong))
    others = np.arange(len(uv)) != inner
    assert np.abs(good - spoilt)[others].max() < 0.3  # one noise level, of 15 px
    assert abs(spoilt[inner] - plane(uv)[inner]) <= abs(wrong[inner] - plane(uv)[inner])


def test_a_certain_point_moves_less():
    uv = places()
    raw = noisy(plane(uv))
    sure = np.arange(len(uv)) % 10 == 0
    cloud = cloud_at(uv, raw, np.where(sure, 0.005, 0.5))
    with_own, alike = (denoise_cloud(each, whole(uv), GREY) for each in (cloud, replace(cloud, covariance=None)))
    moved = [np.abs(flat.disparity - raw)[sure].mean() for flat in (with_own, alike)]
    assert moved[0] < 0.6 * moved[1]


def test_points_move_along_their_rays_as_their_disparities_say():
    uv = places()
    cloud = cloud_at(uv, noisy(plane(uv)))
    flat = denoise_cloud(cloud, whole(uv), GREY)
    assert np.abs(project(RIG, flat.xyz) - uv).max() < 1e-9
    assert np.allclose(back_project(RIG, uv, flat.disparity), flat.xyz, rtol=1e-9)
    assert flat.uv is cloud.uv
    assert flat.covariance is cloud.covariance
    with_rig = denoise_cloud(cloud, whole(uv), GREY, rig=RIG)
    assert np.allclose(with_rig.disparity, flat.disparity, atol=1e-7)
    assert np.array_equal(with_rig.xyz, flat.xyz)


def test_a_wider_baseline_scales_the_points():
    uv = places()
    cloud = cloud_at(uv, noisy(plane(uv)))
    larger = Cloud(7 * cloud.xyz, uv, cloud.disparity, 49 * cloud.covariance)
    flat, scaled = (denoise_cloud(each, whole(uv), GREY) for each in (cloud, larger))
    assert np.allclose(scaled.xyz, 7 * flat.xyz, rtol=1e-7)


def test_renumbering_renumbers():
    uv = places()
    cloud, surface = cloud_at(uv, noisy(step(uv))), whole(uv)
    order = np.random.default_rng(5).permutation(len(uv))
    rank = np.argsort(order)
    moved = Cloud(cloud.xyz[order], uv[order], cloud.disparity[order], cloud.covariance[order])
    faces = rank[surface.faces][::-1, [2, 0, 1]].astype(np.int32)
    expected = denoise_cloud(cloud, surface, halves()).disparity[order]
    assert np.abs(denoise_cloud(moved, Surface(faces), halves()).disparity - expected).max() < 1e-6


def test_same_input_same_bytes():
    uv = places()
    cloud, surface = cloud_at(uv, noisy(step(uv))), whole(uv)
    first, second = (denoise_cloud(cloud, surface, halves()) for _ in range(2))
    assert first.xyz.tobytes() == second.xyz.tobytes()


def test_points_without_faces_stay():
    uv = places()
    cloud = cloud_at(uv, noisy(plane(uv)))
    faces = whole(uv).faces
    part = faces[(uv[faces, 0] < 100).all(axis=1)]
    flat = denoise_cloud(cloud, Surface(part), GREY)
    lone = np.setdiff1d(np.arange(len(uv)), part)
    assert np.array_equal(flat.xyz[lone], cloud.xyz[lone])
    assert np.array_equal(flat.disparity[lone], cloud.disparity[lone])
    assert not np.array_equal(flat.xyz, cloud.xyz)


@pytest.mark.parametrize("count", [0, 1, 10])
def test_too_few_faces_to_tell_the_noise_move_nothing(count):
    uv = places()
    cloud = cloud_at(uv, noisy(plane(uv)))
    assert np.array_equal(denoise_cloud(cloud, Surface(whole(uv).faces[:count]), GREY).xyz, cloud.xyz)


def test_no_flatness_and_no_limit_move_nothing():
    uv = places()
    cloud = cloud_at(uv, noisy(plane(uv)))
    for asked in ({"flatness": 0}, {"limit": 0}):
        assert np.array_equal(denoise_cloud(cloud, whole(uv), GREY, **asked).xyz, cloud.xyz)


def test_pure_noise_stays_finite_and_before_the_camera():
    uv = places()
    raw = np.random.default_rng(2).uniform(-3.9, 200, len(uv))
    flat = denoise_cloud(cloud_at(uv, raw), whole(uv), GREY)
    assert np.isfinite(flat.xyz).all()
    assert np.isfinite(flat.disparity).all()
    assert (flat.xyz[:, 2] > 0).all()
    assert (flat.xyz[:, 2] <= 2.0001 * cloud_at(uv, raw).xyz[:, 2]).all()


def test_an_empty_cloud_stays_empty():
    empty = Cloud(np.empty((0, 3)), np.empty((0, 2)), np.empty(0))
    assert len(denoise_cloud(empty, Surface(np.empty((0, 3), np.int32)), GREY)) == 0


def test_colour_counts_by_its_luminance():
    uv = places()
    cloud = cloud_at(uv, noisy(step(uv)))
    grey, colour = (denoise_cloud(cloud, whole(uv), image) for image in (halves(), np.dstack([halves()] * 3)))
    assert np.allclose(grey.xyz, colour.xyz, rtol=1e-9)


def test_folds_are_what_least_squares_planes_leave():
    uv = places(60)
    complex_ = build_complex(whole(uv).faces, 60)
    corners, pair = _cloud.find_hinges(complex_.edges, complex_.faces, complex_.face_edges)
    coefficient, spread = np.empty(corners.shape), np.linspace(0.5, 2, 60)
    assert _cloud.fold_coefficients(uv, corners, spread, coefficient).all()
    q = np.random.default_rng(0).normal(size=60)
    for row, c, sides, got in zip(corners, coefficient, pair, _cloud.fold(corners, coefficient, q), strict=True):
        assert {*complex_.faces[sides[0]], *complex_.faces[sides[1]]} == {*row.tolist()}
        A, D = np.column_stack([np.ones(4), uv[row]]), np.diag(spread[row.astype(int)])
        fit, *_ = np.linalg.lstsq(np.linalg.inv(D) @ A, np.linalg.inv(D) @ q[row], rcond=None)
        rest = np.linalg.inv(D) @ (q[row] - A @ fit)
        assert np.isclose(abs(got), np.linalg.norm(rest))
        assert np.isclose(np.linalg.norm(D @ c), 1)


def test_moves_solve_the_least_squares_problem():
    uv = places(60)
    complex_ = build_complex(whole(uv).faces, 60)
    corners, _ = _cloud.find_hinges(complex_.edges, complex_.faces, complex_.face_edges)
    coefficient, spread = np.empty(corners.shape), np.linspace(0.5, 2, 60)
    _cloud.fold_coefficients(uv, corners, spread, coefficient)
    C = np.zeros((len(corners), 60))
    np.put_along_axis(C, corners.astype(int), coefficient, axis=1)
    q = np.random.default_rng(0).normal(size=60)
    far = np.full(len(corners), 1e9)  # every fold is noise, and no point lies out
    got = _cloud.flatten(corners, coefficient, C @ q, far, spread, 100.0, np.ones(1), 1e9, 300)
    expected = np.linalg.solve(np.diag(spread**-2) + 100 * C.T @ C, -100 * C.T @ (C @ q))
    assert np.allclose(got, expected, atol=1e-9)


def test_edges_of_three_faces_and_corners_on_a_line_make_no_hinge():
    fins = build_complex([[0, 1, 2], [0, 1, 3], [0, 1, 4]], 5)
    assert len(_cloud.find_hinges(fins.edges, fins.faces, fins.face_edges)[0]) == 0
    line = np.column_stack([np.arange(4.0), np.arange(4.0)])
    coefficient = np.empty((1, 4))
    assert not _cloud.fold_coefficients(line, np.array([[0, 1, 2, 3]], np.uint32), np.ones(4), coefficient).any()
    assert np.array_equal(coefficient, np.zeros((1, 4)))


def _with(name, value):
    uv = places(50)
    cloud = cloud_at(uv, plane(uv))
    return replace(cloud, **{name: value(getattr(cloud, name))})


def _set(row, value):
    def change(values):
        values = values.copy()
        values[row] = value
        return values

    return change


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("xyz", _set(3, np.nan), "xyz is not finite at point 3"),
        ("uv", _set(4, np.inf), "uv is not finite at point 4"),
        ("disparity", _set(5, np.nan), "disparity is not finite at point 5"),
        ("covariance", _set(6, np.nan), "covariance is not finite at point 6"),
        ("xyz", _set((7, 2), -1), "z is not positive at point 7"),
        ("uv", _set(8, 240.0), "uv is outside the image of 240 x 180 px at point 8"),
        ("disparity", _set(9, 90.0), "point 9 has disparity 90 px"),
        ("disparity", np.negative, "expected z"),
        ("uv", lambda uv: uv[:-1], r"uv has shape \(49, 2\), expected \(50, 2\)"),
        ("disparity", lambda d: d[:, None], r"disparity has shape \(50, 1\)"),
        ("covariance", lambda c: c[:, 0], r"covariance has shape \(50, 3\)"),
        ("xyz", lambda xyz: xyz.ravel(), r"xyz has shape \(150,\)"),
    ],
)
def test_a_cloud_that_cannot_be_is_refused(name, change, said):
    with pytest.raises(InputError, match=said):
        denoise_cloud(_with(name, change), Surface(np.array([[0, 1, 2]], np.int32)), GREY)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"cloud": 3}, "expected a Cloud"),
        ({"surface": 3}, "expected a Surface"),
        ({"surface": Surface(np.array([[0, 1, 50]], np.int32))}, "face 0 is"),
        ({"image": "left.png"}, "read_image"),
        ({"image": np.full((180, 240), 2.0)}, "expected 0 to 1"),
        ({"image": GREY[:100]}, "outside the image of 240 x 100 px"),
        ({"rig": 3}, "expected a Rig"),
        ({"rig": replace(RIG, baseline=0.3)}, "those of the rig"),
        ({"flatness": -1}, "flatness is -1, expected"),
        ({"flatness": True}, "flatness is True"),
        ({"limit": np.nan}, "limit is nan"),
    ],
)
def test_other_input_that_cannot_be_is_refused(change, said):
    uv = places(50)
    given = {"cloud": cloud_at(uv, plane(uv)), "surface": whole(uv), "image": GREY} | change
    with pytest.raises(InputError, match=said):
        denoise_cloud(**given)


def test_points_at_one_depth_have_no_offset_to_fit():
    uv = places()
    cloud = cloud_at(uv, np.full(len(uv), 20.0))
    assert np.array_equal(denoise_cloud(cloud, whole(uv), GREY).xyz, cloud.xyz)


@pytest.mark.parametrize("points", [np.zeros((900, 3, 3)), None])
def test_without_uncertainty_all_points_are_alike(points):
    uv = places()
    cloud = cloud_at(uv, noisy(plane(uv)))
    got, expected = (denoise_cloud(replace(cloud, covariance=c), whole(uv), GREY).xyz for c in (points, None))
    assert np.array_equal(got, expected)
