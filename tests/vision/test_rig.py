from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tspslam.errors import InputError
from tspslam.types import Rig, StereoPair
from tspslam.vision import rig as geometry
from tspslam.vision.rig import back_project, check_pair, covariance, project


def scene(rig: Rig, count: int = 50) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    uv = rng.uniform((0, 0), (rig.width - 1, rig.height - 1), (count, 2))
    return uv, rng.uniform(1, 60, count)


def test_projection_inverts_back_projection(rig: Rig) -> None:
    uv, disparity = scene(rig)
    xyz = back_project(rig, uv, disparity)
    np.testing.assert_allclose(project(rig, xyz), uv, atol=1e-9)
    np.testing.assert_allclose(xyz[:, 2], rig.fx * rig.baseline / (disparity + rig.doffs))


def test_right_camera_sees_the_point_at_its_disparity(rig: Rig) -> None:
    uv, disparity = scene(rig)
    right = replace(rig, cx=rig.cx + rig.doffs)
    seen = project(right, back_project(rig, uv, disparity) - (rig.baseline, 0, 0))
    np.testing.assert_allclose(seen, uv - np.column_stack([disparity, np.zeros_like(disparity)]), atol=1e-9)


def test_points_behind_the_camera_or_not_finite_have_no_projection(rig: Rig) -> None:
    xyz = [[0, 0, 0], [0, 0, -1], [np.nan, 0, 1], [0, np.inf, 1], [1e300, 1, 1e-300]]
    assert np.isnan(project(rig, xyz)).all()


def test_covariance_is_the_spread_of_disturbed_measurements(rig: Rig) -> None:
    uv, disparity = np.array([[100.0, 400.0]]), np.array([20.0])
    found = covariance(rig, uv, disparity, 1e-3)[0]
    noise = np.random.default_rng(2).normal(0, 1e-3, (200_000, 3))
    samples = back_project(rig, uv + noise[:, [0, 2]], disparity + noise[:, 0] - noise[:, 1])
    np.testing.assert_allclose(found, np.cov(samples.T), rtol=0.03, atol=1e-3 * found.max())


def test_covariance_is_symmetric_and_grows_with_the_square_of_sigma(rig: Rig) -> None:
    uv, disparity = scene(rig)
    one = covariance(rig, uv, disparity, 1.0)
    np.testing.assert_array_equal(one, one.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(one).min() > 0
    np.testing.assert_allclose(covariance(rig, uv, disparity, np.full(len(uv), 3.0)), 9 * one)


@pytest.mark.parametrize(
    ("uv", "disparity", "message"),
    [
        (np.zeros((2, 3)), np.ones(2), r"expected \(N, 2\)"),
        (np.zeros((2, 2)), np.ones(3), r"\(N,\)"),
        (np.full((1, 2), np.nan), np.ones(1), "finite"),
        (np.zeros((1, 2)), np.array([np.inf]), "finite"),
        (np.zeros((1, 2)), np.array([-2.0]), "positive"),
        (np.full((1, 2), 1e300), np.ones(1), "at most 1e\\+09"),
    ],
)
def test_back_projection_refuses_what_has_no_depth(
    rig: Rig, uv: np.ndarray, disparity: np.ndarray, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        back_project(rig, uv, disparity)


def test_a_point_beyond_all_measure_has_no_depth(plain_rig: Rig) -> None:
    with pytest.raises(InputError, match="1e-300 px, expected a positive number, at least 1e-9"):
        back_project(plain_rig, np.zeros((1, 2)), np.array([1e-300]))


@pytest.mark.parametrize(
    "wrong", [{"width": 1.5}, {"width": True}, {"fx": "wide"}, {"fx": np.nan}, {"cx": 10**400}, {"baseline": -0.1}]
)
def test_a_rig_of_other_values_is_refused_by_name(plain_rig: Rig, wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"rig: {next(iter(wrong))} is .*, expected a"):
        replace(plain_rig, **wrong)


@pytest.mark.parametrize("sigma", [-1.0, np.nan, np.ones(3)])
def test_covariance_refuses_bad_sigma(rig: Rig, sigma: np.ndarray) -> None:
    with pytest.raises(InputError, match="sigma"):
        covariance(rig, np.zeros((2, 2)), np.ones(2), sigma)


def test_projection_refuses_other_shapes(rig: Rig) -> None:
    with pytest.raises(InputError, match=r"\(N, 3\)"):
        project(rig, np.zeros((2, 2)))


def test_empty_input_gives_empty_output(rig: Rig) -> None:
    nothing = np.zeros((0, 2))
    assert back_project(rig, nothing, np.zeros(0)).shape == (0, 3)
    assert covariance(rig, nothing, np.zeros(0), 1.0).shape == (0, 3, 3)
    assert project(rig, np.zeros((0, 3))).shape == (0, 2)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(120, 160), (120, 160, 3)])
def test_supported_pairs_pass(plain_rig: Rig, dtype: type, shape: tuple[int, ...]) -> None:
    check_pair(StereoPair(np.zeros(shape, dtype), np.zeros(shape, dtype), plain_rig))


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        (np.zeros((120, 160), np.uint8), np.zeros((120, 150), np.uint8), "160 x 120 px, right 150 x 120 px"),
        (np.zeros((120, 160), np.uint8), np.zeros((120, 160, 3), np.uint8), "in colour"),
        (np.zeros((120, 160), np.uint8), np.zeros((120, 160), np.uint16), "left image is uint8, right uint16"),
        (
            np.zeros((60, 80), np.uint8),
            np.zeros((60, 80), np.uint8),
            "80 x 60 px, but the calibration is for 160 x 120",
        ),
        (np.zeros((120, 160), np.int32), np.zeros((120, 160), np.int32), "int32"),
        ([[1]], np.zeros((120, 160), np.uint8), "is list"),
        (np.zeros((120, 160, 4), np.uint8), np.zeros((120, 160, 4), np.uint8), r"\(120, 160, 4\)"),
        (np.zeros((0, 160), np.uint8), np.zeros((0, 160), np.uint8), "shape"),
        (np.full((120, 160), 1.5, np.float32), np.zeros((120, 160), np.float32), "1.5, expected 0 to 1"),
        (np.full((120, 160), np.nan, np.float32), np.zeros((120, 160), np.float32), "nan"),
        (np.full((120, 160), np.inf, np.float32), np.zeros((120, 160), np.float32), "inf"),
    ],
)
def test_unusable_pairs_are_refused(plain_rig: Rig, left: np.ndarray, right: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_pair(StereoPair(left, right, plain_rig, name="p"))


def test_huge_images_are_refused(plain_rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.zeros((120, 160), np.uint8)
    monkeypatch.setattr(geometry, "LARGEST_AREA", 100)
    with pytest.raises(InputError, match="at most"):
        check_pair(StereoPair(image, image, plain_rig))
    wide = np.zeros((1, geometry.LARGEST_SIDE + 1), np.uint8)
    monkeypatch.undo()
    with pytest.raises(InputError, match="at most"):
        check_pair(StereoPair(wide, wide, plain_rig))


def test_calibrations_in_other_units_are_doubted() -> None:
    metres = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.193, width=640, height=480)
    assert geometry.doubts(metres) == []
    assert geometry.doubts(replace(metres, fx=80.0, fy=80.0)) == []  # 152 degrees
    (mm,) = geometry.doubts(replace(metres, baseline=193.0))
    assert "the baseline is 193 m: is it in millimetres?" in mm
    for focal in (4.0, 0.78):  # mm on the sensor; a share of the width
        (line,) = geometry.doubts(replace(metres, fx=focal, fy=focal))
        assert f"fx is {focal:g} px, for 640 px of the image: is it in millimetres, or a share of them?" in line
