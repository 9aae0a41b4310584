from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam.errors import GeometryError, InputError
from tspslam.types import LENSES, Camera, RawRig
from tspslam.vision.calibration.lenses import field_of_view, jacobian, project, unproject
from tspslam.vision.calibration.rectify import camera_matrix, rectification

TYPICAL: dict[str, tuple[float, ...]] = {
    "brown": (-0.283, 0.0739, 0.00019, 1.76e-05, 0.0),
    "rational": (0.3, -0.1, 0.001, -0.002, 0.01, 0.6, 0.02, 0.03),
    "thin_prism": (0.3, -0.1, 0.001, -0.002, 0.01, 0.6, 0.02, 0.03, 0.001, -0.002, 0.003, 0.001),
    "equidistant": (-0.01, 0.02, -0.015, 0.003),
    "double_sphere": (-0.2, 0.59),
    "eucm": (0.6, 1.1),
    "mei": (1.2, -0.2, 0.05, 0.001, -0.001),
}
REALISTIC: dict[str, tuple[float, float]] = {  # ranges of calibrated cameras, with a margin
    "k1": (-0.5, 0.5), "k2": (-0.2, 0.2), "k3": (-0.1, 0.1), "p1": (-0.005, 0.005), "p2": (-0.005, 0.005),
    "k4": (-0.3, 0.8), "k5": (-0.1, 0.2), "k6": (-0.05, 0.1), "s1": (-0.005, 0.005), "s2": (-0.002, 0.002),
    "s3": (-0.005, 0.005), "s4": (-0.002, 0.002), "alpha": (0.0, 1.0), "beta": (0.3, 3.0), "xi": (-0.9, 0.9),
    "mei.xi": (0.0, 3.0),
}  # fmt: skip
EXTREME: dict[str, tuple[float, float]] = {"alpha": (0, 1), "beta": (1e-6, 1e4), "xi": (-1, 1e4), "mei.xi": (0, 1e4)}


def camera(lens: str, distortion: tuple[float, ...] | None = None, **more: Any) -> Camera:
    given = TYPICAL[lens] if distortion is None else distortion
    return replace(Camera(200.0, 210.0, 322.0, 243.0, 640, 480, given, 0.5, lens), **more)


@st.composite
def cameras(draw: st.DrawFn, ranges: dict[str, tuple[float, float]] = REALISTIC) -> Camera:
    lens = draw(st.sampled_from(sorted(LENSES)))
    limits = [ranges.get(f"{lens}.{name}", ranges.get(name, (-1e4, 1e4))) for name in LENSES[lens]]
    skew = draw(st.floats(-3, 3))
    focal = draw(st.floats(80, 900))
    return camera(lens, tuple(draw(st.floats(*limit)) for limit in limits), fx=focal, skew=skew)


def pixels(count: int = 300, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform((-100, -100), (740, 580), (count, 2))


def rays(count: int = 300, seed: int = 0) -> np.ndarray:
    found = np.random.default_rng(seed).normal(size=(count, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1)[:, None])


@settings(max_examples=60, deadline=None)
@given(cameras())
def test_a_pixel_is_where_its_ray_is_seen(lens: Camera) -> None:
    uv = pixels()
    seen = unproject(lens, uv)
    known = np.isfinite(seen[:, 0])
    assert np.array_equal(known, np.isfinite(seen).all(axis=1))
    assert np.abs(np.linalg.norm(seen[known], axis=1) - 1).max(initial=0) < 1e-12
    assert np.abs(project(lens, seen[known]) - uv[known]).max(initial=0) < 1e-9


@settings(max_examples=60, deadline=None)
@given(cameras())
def test_a_ray_with_a_pixel_in_the_image_is_that_pixels_ray(lens: Camera) -> None:
    xyz = rays()
    uv = project(lens, xyz)
    inside = ((uv >= 0) & (uv <= (639, 479))).all(axis=1)
    again = unproject(lens, uv[inside])
    assert np.isfinite(again).all()
    gain = np.linalg.svd(jacobian(lens, xyz[inside]), compute_uv=False)[:, 1]  # px a radian where it is least
    assert (np.linalg.norm(again - xyz[inside], axis=1) * gain).max(initial=0) < 1e-6


@settings(max_examples=60, deadline=None)
@given(cameras(EXTREME), st.integers(0, 3))
def test_any_lens_that_a_camera_may_have_gives_rays_that_it_sees_or_none(lens: Camera, seed: int) -> None:
    uv = pixels(50, seed)
    seen = unproject(lens, uv)
    known = np.isfinite(seen).all(axis=1)
    assert np.array_equal(known, ~np.isnan(seen).all(axis=1))
    assert np.isfinite(project(lens, seen[known])).all()
    assert jacobian(lens, rays(50, seed)).shape == (50, 2, 3)


@pytest.mark.parametrize("lens", sorted(LENSES))
def test_jacobians_are_those_of_differences(lens: str) -> None:
    one, xyz, step = camera(lens), rays() * 3.0, 1e-6
    central = np.stack(
        [(project(one, xyz + h) - project(one, xyz - h)) / (2 * step) for h in step * np.eye(3)], axis=-1
    )
    exact = jacobian(one, xyz)
    tame = np.isfinite(central).all(axis=(1, 2)) & (np.abs(exact).max(axis=(1, 2)) < 1e4)
    assert tame.sum() > 30
    assert np.abs(central - exact)[tame].max() < 1e-5 * np.abs(exact[tame]).max()
    assert np.array_equal(np.isnan(exact).any(axis=(1, 2)), np.isnan(project(one, xyz)).any(axis=1))


@pytest.mark.parametrize("lens", ["brown", "rational", "thin_prism"])
def test_browns_family_is_that_of_opencv(lens: str) -> None:
    one = replace(camera(lens), skew=0.0)
    xyz = unproject(one, pixels()) * 4.0
    xyz = xyz[np.isfinite(xyz[:, 0])]
    theirs, _ = cv2.projectPoints(xyz, np.zeros(3), np.zeros(3), camera_matrix(one), np.array(one.distortion))
    assert len(xyz) > 30
    assert np.abs(theirs[:, 0] - project(one, xyz)).max() < 1e-9


def test_the_equidistant_lens_is_opencvs_fisheye() -> None:
    one = replace(camera("equidistant"), skew=0.0)
    xyz = rays() * (1.0, 1.0, 1.0)
    xyz = xyz[xyz[:, 2] > 0.05]
    theirs, _ = cv2.fisheye.projectPoints(
        xyz[:, None], np.zeros(3), np.zeros(3), camera_matrix(one), np.array(one.distortion)
    )
    assert np.abs(theirs[:, 0] - project(one, xyz)).max() < 1e-9


@pytest.mark.parametrize(("lens", "distortion", "expected"), [
    # of an independent implementation: tests of projection functions of reprojection_calibration
    ("double_sphere", (0.1, 0.2), [(46.087794035716172, 240), (673.91220596428388, 240), (360, 26.040025446950779)]),
    ("mei", (0.1, 0.0, 0.0, 0.0, 0.0), [(37.598189013469323, 240), (682.40181098653068, 240), (360, 23.33548267325537)]),
])  # fmt: skip
def test_values_of_another_implementation(lens: str, distortion: tuple[float, ...], expected: list[float]) -> None:
    one = Camera(600, 600, 360, 240, 720, 480, distortion, lens=lens)
    assert np.abs(project(one, [(-360, 0, 600), (360, 0, 600), (0, -240, 600)]) - expected).max() < 1e-9


@pytest.mark.parametrize(("lens", "distortion"), [
    ("rational", (0.0,) * 8), ("thin_prism", (0.0,) * 12), ("double_sphere", (0.0, 0.0)), ("eucm", (0.0, 1.0)),
    ("mei", (0.0,) * 5),
])  # fmt: skip
def test_a_model_without_distortion_is_a_pinhole(lens: str, distortion: tuple[float, ...]) -> None:
    pinhole = camera("brown", (0.0,) * 5)
    assert np.array_equal(
        np.nan_to_num(project(camera(lens, distortion), rays())), np.nan_to_num(project(pinhole, rays()))
    )


@pytest.mark.parametrize("xi", [0.0, 0.3, 0.9, 1.0, 1.7])
def test_one_sphere_is_that_of_every_model_that_has_it(xi: float) -> None:
    """Mei's xi, alpha / (1 - alpha) of the extended unified and of the double sphere model: one camera."""
    alpha, scale = xi / (1 + xi), 1 + xi
    mei = camera("mei", (xi, 0.0, 0.0, 0.0, 0.0), fx=200.0 * scale, fy=210.0 * scale, skew=0.5 * scale)
    for lens, distortion in (("eucm", (alpha, 1.0)), ("double_sphere", (0.0, alpha))):
        theirs, ours = project(camera(lens, distortion), rays()), project(mei, rays())
        assert np.allclose(theirs, ours, rtol=1e-12, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize(("lens", "distortion", "last"), [
    ("brown", (0.0,) * 5, 90.0),
    ("brown", (-0.3, 0.0, 0.0, 0.0, 0.0), np.degrees(np.arctan(np.sqrt(1 / 0.9)))),  # 1 + 3 k1 r² = 0
    ("rational", (0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0), np.degrees(np.arctan(2.0))),  # the pole
    ("equidistant", (0.0,) * 4, 180.0),
    ("equidistant", (-0.1, 0.0, 0.0, 0.0), np.degrees(np.sqrt(1 / 0.3))),
    ("mei", (0.5, 0.0, 0.0, 0.0, 0.0), 120.0), ("mei", (2.0, 0.0, 0.0, 0.0, 0.0), 120.0),
    ("eucm", (0.5, 1.0), 180.0), ("eucm", (1 / 3, 1.0), 120.0), ("eucm", (2 / 3, 1.0), 120.0),
    ("double_sphere", (0.0, 1 / 3), 120.0), ("double_sphere", (0.0, 2 / 3), 120.0),
])  # fmt: skip
def test_a_lens_sees_up_to_its_last_angle(lens: str, distortion: tuple[float, ...], last: float) -> None:
    for angle, is_seen in ((last - 0.01, True), (last + 0.01, last == 180.0)):
        theta = np.radians(min(angle, 179.99))
        found = project(
            camera(lens, distortion), [(np.sin(theta), 0.0, np.cos(theta)), (0, np.sin(theta), np.cos(theta))]
        )
        assert bool(np.isfinite(found).all()) == is_seen


def test_points_that_are_none_have_no_pixel() -> None:
    for lens in LENSES:
        xyz = [(0, 0, 0), (np.nan, 0, 1), (np.inf, 0, 1), (0, 0, 1), (1e-320, 0, 1e-310), (1e300, 0, 1e308)]
        assert np.isfinite(project(camera(lens), xyz)).all(axis=1).tolist() == [False] * 3 + [True] * 3
        assert np.isnan(unproject(camera(lens), [(np.nan, 3.0), (np.inf, 1.0)])).all()
        assert project(camera(lens), np.zeros((0, 3))).shape == (0, 2)
        assert unproject(camera(lens), np.zeros((0, 2))).shape == (0, 3)


def test_fields_of_view_are_those_of_closed_forms() -> None:
    pinhole = Camera(300, 300, 300, 200, 601, 401)
    expected = [2 * np.degrees(np.arctan(each / 300)) for each in (300, 200, np.hypot(300, 200))]
    assert field_of_view(pinhole) == pytest.approx(expected, abs=1e-9)
    fisheye = Camera(200, 200, 300, 200, 601, 401, (0.0,) * 4, lens="equidistant")
    expected = [2 * np.degrees(each / 200) for each in (300, 200, np.hypot(300, 200))]
    assert field_of_view(fisheye) == pytest.approx(expected, abs=1e-9)
    circle = Camera(90, 90, 300, 200, 601, 401, (0.0,) * 4, lens="equidistant")  # radius of 180°: 282.7 px
    assert field_of_view(circle)[0] == pytest.approx(2 * np.degrees(282 / 90), abs=1e-9)
    assert field_of_view(replace(pinhole, cx=-900.0))[0] == pytest.approx(
        np.degrees(np.arctan(5.0) - np.arctan(3.0)), abs=1e-9
    )


@pytest.mark.parametrize("call", [project, jacobian, unproject])
def test_other_shapes_and_cameras_are_refused(call: Any) -> None:
    with pytest.raises(InputError, match=r"lens: .* has shape \(4,\), expected \(N, "):
        call(camera("eucm"), np.zeros(4))
    with pytest.raises(InputError, match="lens: camera is"):
        call("fisheye", np.zeros((1, 3)))


def test_intrinsics_in_millimetres_are_no_picture():
    T = ((1.0, 0, 0, -0.1), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    for lens, distortion in (("equidistant", (0.0,) * 4), ("mei", (1e4, 0.0, 0.0, 0.0, 0.0))):
        camera = Camera(2.1, 2.1, 319.5, 239.5, 640, 480, distortion=distortion, lens=lens)
        for degrees in (None, 100.0):
            with pytest.raises(GeometryError, match=r"expected intrinsics in px|no field of view"):
                rectification(RawRig(camera, camera, T, degrees))


def test_a_lens_with_a_pole_warns_of_nothing(recwarn):
    camera = Camera(500, 500, 320, 240, 640, 480, distortion=(0.0, 0, 0, 0, 0, 0, 0, -5.0), lens="rational")
    project(camera, np.array([[5 ** (-1 / 6), 0.0, 1.0], [0.1, 0.1, 1.0]]))
    assert not recwarn.list


@pytest.mark.parametrize("given", [{"distortion": None}, {"distortion": [0.0] * 5}, {"distortion": 5}])
def test_coefficients_are_a_tuple(given):
    with pytest.raises(InputError, match="expected a tuple of numbers"):
        Camera(500, 500, 320, 240, 640, 480, **given)


def test_a_raw_rig_is_of_cameras_and_a_matrix():
    camera, T = Camera(500, 500, 320, 240, 640, 480), np.eye(4).tolist()
    with pytest.raises(InputError, match="expected a Camera"):
        RawRig(1, 2, T)
    for wrong in ("x", [[1, 2], [3]], [["a"] * 4] * 4):
        with pytest.raises(InputError, match="expected 4 x 4 numbers"):
            RawRig(camera, camera, wrong)
