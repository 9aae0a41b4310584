from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tspslam.datasets import motorcycle_truth
from tspslam.errors import GeometryError, InputError
from tspslam.types import Camera, RawRig, StereoPair
from tspslam.vision.calibration import lenses
from tspslam.vision.calibration.rectify import camera_matrix, distort, rectification
from tspslam.vision.rig import project
from tspslam.vision.stereo.reconstruct import reconstruct_with_quality

CAMERA = Camera(458.654, 457.296, 367.215, 248.375, 752, 480, (-0.283, 0.0739, 0.00019, 1.76e-05, 0.0))


def pose(turn: tuple[float, float, float], t: tuple[float, float, float]) -> tuple[tuple[float, ...], ...]:
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array(turn, float))[0]
    T[:3, 3] = t
    return tuple(map(tuple, T.tolist()))


RAW = RawRig(CAMERA, replace(CAMERA, fx=457.587, cx=379.999, cy=255.238), pose((0.01, -0.02, 0.005), (-0.11, 0, 0.001)))


def sees(camera: Camera, xyz: np.ndarray) -> np.ndarray:
    return np.column_stack(distort(camera, *(xyz[:, :2] / xyz[:, 2:]).T))


def scene(count: int = 200) -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(2, 6, count)])


def test_intrinsics_are_those_of_opencv_with_alpha_0() -> None:
    values = cv2.stereoRectify(
        camera_matrix(RAW.left), np.array(RAW.left.distortion), camera_matrix(RAW.right), np.array(RAW.right.distortion),
        (752, 480), RAW.matrix[:3, :3].copy(), RAW.matrix[:3, 3:].copy(), alpha=0,
    )  # fmt: skip
    rig = rectification(RAW).rig
    assert abs(np.array([rig.fx, rig.fy, rig.cx, rig.cy]) - values[2][[0, 1, 0, 1], [0, 1, 2, 2]]).max() < 1e-6
    assert rig.baseline == pytest.approx(np.linalg.norm(RAW.matrix[:3, 3]), abs=1e-9)
    assert (rig.skew, rig.doffs) == (0, 0)


@pytest.mark.parametrize("skew", [0.0, 3.0])
def test_a_point_lies_where_the_maps_say_and_on_one_row(skew: float) -> None:
    raw = replace(RAW, left=replace(RAW.left, skew=skew))
    made, xyz = rectification(raw), scene()
    left = xyz @ made.R_left.T
    right = (xyz @ raw.matrix[:3, :3].T + raw.matrix[:3, 3]) @ made.R_right.T
    rig = made.rig
    uv_left, uv_right = ((p[:, :2] / p[:, 2:]) * rig.fx + (rig.cx, rig.cy) for p in (left, right))
    assert np.abs(uv_left[:, 1] - uv_right[:, 1]).max() < 1e-9
    assert np.abs(rig.fx * rig.baseline / (uv_left - uv_right)[:, 0] - left[:, 2]).max() < 1e-6
    pixel = np.rint(uv_left).astype(int)
    inside = ((pixel >= 0) & (pixel < (rig.width, rig.height))).all(axis=1)
    ray = np.column_stack([(pixel - (rig.cx, rig.cy)) / rig.fx, np.ones(len(pixel))])[inside] @ made.R_left
    u, v = (each[pixel[inside, 1], pixel[inside, 0]] for each in made._maps[0])
    assert inside.sum() > 100
    assert np.abs(np.column_stack([u, v]) - sees(raw.left, ray)).max() < 1e-4


def test_maps_are_those_of_opencv() -> None:
    made = rectification(RAW)
    K = camera_matrix(made.rig)
    u, v = cv2.initUndistortRectifyMap(
        camera_matrix(RAW.left), np.array(RAW.left.distortion), made.R_left, K, (752, 480), cv2.CV_32FC1
    )
    assert max(np.abs(u - made._maps[0][0]).max(), np.abs(v - made._maps[0][1]).max()) < 1e-3
    assert made.valid.mean() > 0.999


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(480, 752), (480, 752, 3)])
def test_every_kind_of_image_is_resampled_in_its_type_and_range(dtype: type, shape: tuple[int, ...]) -> None:
    levels = np.random.default_rng(0).integers(0, 2, shape)
    image = (levels * (np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 1)).astype(dtype)
    left, right = rectification(RAW)(image, image)
    assert left.dtype == right.dtype == dtype
    assert left.shape == right.shape == shape
    assert left.max() <= image.max()


def test_an_image_of_another_size_is_refused() -> None:
    good, bad = np.zeros((480, 752), np.uint8), np.zeros((375, 1242), np.uint8)
    with pytest.raises(InputError, match="right image is 1242 x 375 px, but its camera has 752 x 480 px"):
        rectification(RAW)(good, bad)


@pytest.mark.parametrize("lens", [(0, 0, 0, 0, 1e-310), (-1e-110, 0, 0, 0, 0), (1e-312, 1e-312, 0, 0, 0)])
def test_a_distortion_that_is_next_to_nothing_is_nothing(lens: tuple[float, ...]) -> None:
    tiny, none = (replace(RAW, left=replace(CAMERA, distortion=d)) for d in (lens, (0.0,) * 5))
    assert rectification(tiny).rig == rectification(none).rig


@pytest.mark.parametrize("image", [np.zeros((480, 752), np.int32), np.zeros((480, 752, 5), np.uint8), np.zeros(9)])
def test_what_is_no_image_is_refused(image: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"left image .* expected"):
        rectification(RAW)(image, image)


@pytest.mark.parametrize("size", [(300_000, 300_000), (20_000, 16_000), (32_767, 2)])
def test_cameras_of_unheard_size_are_refused_before_memory_is_taken(size: tuple[int, int]) -> None:
    large = replace(CAMERA, width=size[0], height=size[1])
    with pytest.raises(InputError, match=f"cameras have {size[0]} x {size[1]} px, expected at most 32766"):
        rectification(replace(RAW, left=large, right=large))


@pytest.mark.parametrize(("change", "message"), [
    ({"T_right_left": pose((0, 0, 0), (0.11, 0, 0))}, r"right camera is at \(-0.11, .*expected it to the right"),
    ({"T_right_left": pose((0, 0, 0), (0, -0.11, 0))}, "expected it to the right"),
    ({"T_right_left": pose((0, 0, np.pi / 2), (0, 0.11, 0))}, "right camera is turned by 90.0° against the left"),
    ({"right": replace(CAMERA, width=640)}, r"cameras have \(752, 480\) and \(640, 480\) px"),
    ({"left": replace(CAMERA, distortion=(-1.5, 0, 0, 0, 0))}, "distortion of the left camera .* folds its image"),
    ({"right": replace(CAMERA, distortion=(-0.28, 0.07, -0.2, 0, 0))}, "distortion of the right camera folds its image at"),
    ({"right": replace(CAMERA, distortion=(0, 0, 0.9, 0, 0))}, "would change the focal length from 458.7 to 8.865e"),
])  # fmt: skip
def test_what_cannot_be_rectified_is_named(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        rectification(replace(RAW, **change))


def test_depths_of_a_raw_pair_are_those_of_the_rectified_one(raw_pair: tuple[StereoPair, RawRig]) -> None:
    pair, raw = raw_pair
    made = rectification(raw)
    cloud, quality = reconstruct_with_quality(StereoPair(*made(pair.left, pair.right), made.rig))
    turn = cv2.Rodrigues(np.array((0.01, -0.01, 0.012)))[0]  # of the raw left camera
    uv = project(pair.rig, cloud.xyz @ made.R_left @ turn)
    truth, pixel = motorcycle_truth(), np.rint(uv).astype(int)
    inside = ((pixel >= 0) & (pixel < (741, 500))).all(axis=1)
    z = (cloud.xyz @ made.R_left @ turn)[inside, 2]
    error = pair.rig.fx * pair.rig.baseline / z - pair.rig.doffs - truth[pixel[inside, 1], pixel[inside, 0]]
    error = error[np.isfinite(error)]
    assert len(error) > 900
    assert (np.abs(error) < 1).mean() > 0.93
    assert abs(np.median(error)) < 0.1
    assert quality.vertical_offset_std_px < 0.3
    with pytest.raises(GeometryError, match=r"the rows differ by .* not rectified, or twice"):
        reconstruct_with_quality(StereoPair(pair.left, pair.right, pair.rig))
    turned = np.ascontiguousarray(np.rot90(pair.right, 2))
    with pytest.raises(GeometryError, match=r"most turn by -?180°, expected none: the right image is turned"):
        reconstruct_with_quality(StereoPair(pair.left, turned, pair.rig))


DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[4] / "shared" / "data")) / "euroc_v101_keyframes"


@pytest.mark.skipif(not DATA.is_dir(), reason="the EuRoC keyframes are not here")
def test_rows_of_a_real_raw_pair_agree() -> None:
    from tspslam.io import read_image
    from tspslam.vision.calibration.formats import read_calibration

    raw = read_calibration(DATA / "cam0_sensor.yaml").cameras
    made = rectification(raw)
    for name in sorted((DATA / "images").glob("*_0.jpg"))[::33]:
        left, right = made(read_image(name), read_image(name.with_name(name.name.replace("_0", "_1"))))
        cloud, quality = reconstruct_with_quality(StereoPair(left, right, made.rig))
        assert abs(quality.vertical_offset_px) < 0.3
        assert quality.vertical_offset_std_px < 0.3
        assert len(cloud) > 500


FISHEYE = Camera(190.9, 190.8, 254.9, 256.9, 512, 512, (0.0034, 0.0007, -0.0021, 0.0002), lens="equidistant")
SPHERE = Camera(158.3, 158.3, 254.9, 256.8, 512, 512, (-0.17, 0.59), lens="double_sphere")
OMNI = Camera(480.0, 480.0, 255.0, 257.0, 512, 512, (1.5, -0.1, 0.05, 0.001, -0.001), lens="mei")
WIDE = RawRig(FISHEYE, replace(FISHEYE, cx=252.6, cy=255.0), pose((0.01, -0.02, 0.005), (-0.101, 0.002, 0.001)))


@pytest.mark.parametrize("raw", [
    WIDE, replace(WIDE, field_of_view=90.0), replace(WIDE, right=SPHERE), replace(WIDE, left=OMNI, right=SPHERE),
    replace(RAW, field_of_view=60.0), replace(WIDE, field_of_view=150.0),
])  # fmt: skip
def test_a_point_lies_where_the_maps_of_any_lens_say_and_on_one_row(raw: RawRig) -> None:
    made, xyz = rectification(raw), scene(400)
    rig = made.rig
    left = xyz @ made.R_left.T
    right = (xyz @ raw.matrix[:3, :3].T + raw.matrix[:3, 3]) @ made.R_right.T
    assert np.abs(left - right - (rig.baseline, 0, 0)).max() < 1e-9
    for side, points, camera, R, maps in (
        ("left", left, raw.left, made.R_left, made._maps[0]), ("right", right, raw.right, made.R_right, made._maps[1])
    ):  # fmt: skip
        pixel = np.rint(project(rig, points)).astype(int)
        pixel = pixel[((pixel >= 0) & (pixel < (rig.width, rig.height))).all(axis=1)]
        ray = np.column_stack([(pixel - (rig.cx, rig.cy)) / rig.fx, np.ones(len(pixel))]) @ R
        u, v = (each[pixel[:, 1], pixel[:, 0]] for each in maps)
        assert len(pixel) > 100, side
        assert np.abs(np.column_stack([u, v]) - lenses.project(camera, ray)).max() < 1e-4


@pytest.mark.parametrize("raw", [RAW, WIDE])
def test_both_cameras_are_turned_as_by_opencv(raw: RawRig) -> None:
    made, K = rectification(replace(raw, field_of_view=80.0)), np.diag([400.0, 400.0, 1.0])
    values = cv2.stereoRectify(
        K, np.zeros(5), K, np.zeros(5), (640, 480), raw.matrix[:3, :3].copy(), raw.matrix[:3, 3:].copy()
    )
    assert np.abs(values[0] - made.R_left).max() < 1e-12
    assert np.abs(values[1] - made.R_right).max() < 1e-12


@pytest.mark.parametrize("degrees", [40.0, 90.0, 140.0])
def test_a_stated_field_of_view_is_that_of_the_rectified_width(degrees: float) -> None:
    rig = rectification(replace(WIDE, field_of_view=degrees)).rig
    assert 2 * np.degrees(np.arctan(rig.width / 2 / rig.fx)) == pytest.approx(degrees, abs=1e-9)
    assert (rig.cx, rig.cy, rig.width, rig.height, rig.fx) == (255.5, 255.5, 512, 512, rig.fy)


def test_without_one_it_is_the_largest_that_both_fill_up_to_a_limit() -> None:
    made = rectification(WIDE)
    assert 2 * np.degrees(np.arctan(256 / made.rig.fx)) == pytest.approx(110, abs=1e-9)
    assert made.valid.all()
    narrow = replace(WIDE, left=replace(FISHEYE, fx=330.0, fy=330.0), right=replace(FISHEYE, fx=340.0, fy=340.0))
    made = rectification(narrow)
    found = 2 * np.degrees(np.arctan(256 / made.rig.fx))
    assert 40 < found < 90
    assert made.valid.all()
    assert not rectification(replace(narrow, field_of_view=found + 1)).valid.all()


def test_what_no_camera_saw_is_marked_and_black() -> None:
    far = replace(FISHEYE, fx=330.0, fy=330.0)
    made = rectification(replace(WIDE, left=far, right=far, field_of_view=120.0))
    white = np.full((512, 512), 255, np.uint8)
    left, right = made(white, white)
    assert 0.2 < made.valid.mean() < 0.8
    assert made.valid[256, 256]
    assert not made.valid[0, 0]
    inner = cv2.erode(made.valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert (left[inner] == 255).all()
    assert (right[inner] == 255).all()
    seen = [(u > -2) & (u < 513) & (v > -2) & (v < 513) for u, v in made._maps]
    assert not left[~seen[0]].any()
    assert not right[~seen[1]].any()


def test_a_rational_lens_without_its_denominator_is_browns() -> None:
    as_rational, as_prism = (
        replace(RAW, **{
            side: replace(getattr(RAW, side), lens=lens, distortion=(*CAMERA.distortion, *(0.0,) * zeros))
            for side in ("left", "right")
        })
        for lens, zeros in (("rational", 3), ("thin_prism", 7))
    )  # fmt: skip
    for other in (as_rational, as_prism):
        assert rectification(other).rig == rectification(RAW).rig
        assert np.array_equal(rectification(other)._maps[0][0], rectification(RAW)._maps[0][0])


@pytest.mark.parametrize(("change", "message"), [
    ({"field_of_view": 150.0, "left": replace(FISHEYE, fx=900.0, fy=900.0)}, r"both cameras see .* % of the rectified image, expected at least 10 %"),
    ({"left": replace(FISHEYE, cx=5000.0)}, "no field of view is seen by both cameras as a whole"),
    ({"left": replace(FISHEYE, width=640)}, r"cameras have \(640, 512\) and \(512, 512\) px"),
    ({"T_right_left": pose((0, 0, 0), (0.11, 0, 0))}, "expected it to the right"),
])  # fmt: skip
def test_what_cannot_be_rectified_to_a_field_of_view_is_named(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        rectification(replace(WIDE, **change))
