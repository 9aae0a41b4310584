from __future__ import annotations

import math
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.types import LENSES, Camera, RawRig, Rig
from tspslam.vision.calibration.formats import Calibration, read_calibration
from tspslam.vision.calibration.rectify import rectification

from . import formats_samples
from .formats_samples import BACK, CAM0, CAM1, EXTRINSICS, INTRINSICS, OWN, RAW, RECTIFIED, TURNED, Sample
from .formats_samples_lenses import FURTHER, SIZELESS

SAMPLES = formats_samples.SAMPLES | FURTHER

DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[4] / "shared" / "data"))
EVERY = pytest.mark.parametrize("name", SAMPLES)


def read(folder: Path, sample: Sample) -> Calibration:
    return read_calibration(sample.write(folder), sample.size)


def changed(sample: Sample, old: str, new: str) -> Sample:
    """The sample with one text replaced wherever it stands in its files."""
    assert any(old in text for text in sample.files.values()), old
    return replace(sample, files={name: text.replace(old, new) for name, text in sample.files.items()})


def single(folder: Path, text: str | bytes, size: tuple[int, int] | None = None) -> Calibration:
    path = folder / "calibration"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_calibration(path, size)


def same(cameras: Rig | RawRig, expected: Rig | RawRig) -> bool:
    """Equal; of a pose that was computed, to rounding."""
    if isinstance(cameras, RawRig) and isinstance(expected, RawRig):
        close = np.allclose(cameras.matrix, expected.matrix, rtol=0, atol=1e-15)
        return close and (cameras.left, cameras.right) == (expected.left, expected.right)
    return cameras == expected


@EVERY
def test_a_sample_gives_its_cameras(tmp_path: Path, name: str) -> None:
    found = read(tmp_path, SAMPLES[name])
    assert same(found.cameras, SAMPLES[name].cameras)
    assert found.format == SAMPLES[name].format


@pytest.mark.parametrize("name", ["recorded", "kalibr", "opencv"])
def test_a_pose_that_the_file_holds_is_taken_as_it_is(tmp_path: Path, name: str) -> None:
    cameras = read(tmp_path, SAMPLES[name]).cameras
    assert isinstance(cameras, RawRig)
    assert cameras.T_right_left == TURNED


@EVERY
def test_every_value_that_is_not_zero_has_an_origin(tmp_path: Path, name: str) -> None:
    found = read(tmp_path, SAMPLES[name])
    values = {"": found.cameras}
    if isinstance(found.cameras, RawRig):
        assert found.origin["T_right_left"]
        values = {"left.": found.cameras.left, "right.": found.cameras.right}
    for side, camera in values.items():
        for key, value in vars(camera).items():
            if key not in ("distortion", "lens"):
                assert value == 0 or found.origin[side + key]
        if isinstance(camera, Camera):
            named = zip(LENSES[camera.lens], camera.distortion, strict=True)
            assert all(found.origin[side + key] for key, value in named if value != 0)
            assert camera.lens == "brown" or found.origin[f"{side}lens"]


@pytest.mark.parametrize(
    ("name", "value", "key"),
    [
        ("odometry", "baseline", "P1[0,3] / -P1[0,0]"),
        ("odometry", "width", "given size"),
        ("rectified", "width", "S_rect_00[0]"),
        ("rectified", "doffs", "P_rect_01[0,2] - P_rect_00[0,2]"),
        ("recorded", "left.k1", "D_00[0]"),
        ("recorded", "T_right_left", "R_01, T_01"),
        ("euroc", "right.fx", "cam1.intrinsics[0]"),
        ("kalibr", "T_right_left", "cam1.T_cn_cnm1"),
        ("opencv", "right.cy", "M2[1,2]"),
        ("projections", "height", "image_height"),
        ("orbslam2", "baseline", "Camera.bf / Camera.fx"),
        ("orbslam3", "right.p2", "Camera2.p2"),
        ("prerectified", "left.fx", "LEFT.K[0,0]"),
        ("own", "cx", "cx"),
        ("kalibr-omni", "left.xi", "cam0.intrinsics[0]"),
        ("kalibr-omni", "left.lens", "cam0.camera_model"),
        ("kalibr-equi", "right.lens", "cam1.distortion_model"),
        ("kalibr-imu", "T_right_left", "cam1.T_cam_imu, inverse of cam0.T_cam_imu"),
        ("opencv-8", "left.k6", "D1[7]"),
        ("opencv-8", "left.lens", "8 of D1"),
        ("opencv-fisheye", "right.lens", "fisheye"),
        ("orbslam-kb8", "right.k4", "Camera2.k4"),
        ("orbslam-tlr", "T_right_left", "inverse of Tlr"),
        ("stella", "left.fx", "StereoRectifier.K_left[0,0]"),
        ("stella-rectified", "baseline", "Camera.focal_x_baseline / Camera.fx"),
        ("basalt-ds", "right.alpha", "value0.intrinsics[1].intrinsics.alpha"),
        ("basalt-ucm", "left.beta", "1 of ucm"),
        ("ros", "left.k1", "left.distortion_coefficients[0]"),
        ("rtabmap", "T_right_left", "rotation_matrix, translation_matrix"),
        ("zed", "right.k2", "RIGHT_CAM_HD.k2"),
        ("middlebury", "baseline", "baseline / 1000"),
        ("colmap", "left.cx", "camera 1 OPENCV[2] - 0.5"),
    ],
)
def test_origins_name_the_keys_of_the_file(tmp_path: Path, name: str, value: str, key: str) -> None:
    assert read(tmp_path, SAMPLES[name]).origin[value] == key


WRONG = [
    ("odometry", "P1:", "Q1:", "lacks P1, expected 12 numbers \\(3 x 4\\)"),
    ("odometry", "P1:", "P0:", "the key P0 is there twice"),
    ("odometry", "P1: 7.185000000000e+02", "P1: 7.175000000000e+02", "P0\\[0,0\\] is 718.5, P1\\[0,0\\] is 717.5"),
    ("odometry", "-3.592500000000e+02", "3.592500000000e+02", "is -0.5, expected a baseline, .*look swapped"),
    ("odometry", "-3.592500000000e+02", "0", "is -?0, expected a baseline"),
    ("odometry", "-3.592500000000e+02", "", "P1 has 11 numbers, expected 12"),
    ("odometry", "-3.592500000000e+02", "nan", "P1\\[0,3\\] is 'nan', expected a number"),
    ("odometry", "-3.592500000000e+02", "1e999", "P1\\[0,3\\] is inf, expected a finite number"),
    ("odometry", "P0: 7.185000000000e+02", "P0: -7.185000000000e+02", "P0\\[0,0\\] is -718.5, expected a focal"),
    ("odometry", "P0: 7.185000000000e+02 0.0", "P0: 7.185000000000e+02 x", "P0\\[0,1\\] is 'x00000000000e\\+00', expected"),
    ("odometry", "P2:", "some words", "holds the line 'some words"),
    ("recorded", "R_01: 9.6", "R_01: 9.7", "R_01 holds no rotation \\(R Rᵀ - I has 0.019\\), expected one"),
    ("recorded", "R_01: 9.600000e-01", "R_01: -9.600000e-01", "R_01 holds no rotation"),
    ("recorded", "T_01: -1.25", "T_01: 1.25", "by R_01, T_01 the right camera is at .*look swapped"),
    ("recorded", "T_01: -1.250000e-01 2.000000e-03 4.000000e-03", "T_01: 0 0 0", "the cameras are not side by side"),
    ("recorded", "K_01: 5.037500e+02", "K_01: 0", "K_01\\[0,0\\] is 0, expected a focal length"),
    ("recorded", "S_01: 6.4", "S_01: 6.5", "image width: S_00\\[0\\] is 640, S_01\\[0\\] is 650, expected the same"),
    ("recorded", "D_00: -3.125000e-01", "D_00:", "D_00 has 4 numbers, expected 5 numbers"),
    ("recorded", "R_00: 1.000000e+00", "R_00: 0.5", "R_00 is .*expected no motion"),
    ("rectified", "S_rect_00: 6.000000e+02", "S_rect_00: 6.005000e+02", "S_rect_00\\[0\\] is 600.5, expected a whole"),
    ("rectified", "S_rect_01: 6.000000e+02", "S_rect_01: 6.01e+02", "S_rect_01 is 601 x 400 px, expected the same"),
    ("rectified", "S_rect_00: 6.000000e+02", "S_rect_00: 0", "S_rect_00\\[0\\] is 0, expected a whole number"),
    ("euroc", "0.96, 0.0, -0.28", "0.96, 0.0, 0.28", "cam1.T_BS holds no rotation"),
    ("euroc", "  rows: 4", "  rows: 3", "cam0.T_BS has rows 3, cols 4 and 16 numbers in data"),
    ("euroc", "0.0, 0.0, 0.0, 1.0", "0.0, 0.0, 1.0, 1.0", "T_BS is .*expected 0 0 0 1 in the last row"),
    ("euroc", "camera_model: pinhole", "camera_model: omni", "cam0.camera_model is 'omni', expected a pinhole camera"),
    ("euroc", "radial-tangential", "fov", "distortion_model is 'fov', expected a pinhole camera, radial-tangential .* or equi"),
    ("euroc", "sensor_type: camera", "sensor_type: imu", "sensor_type is 'imu', expected camera"),
    ("euroc", "[503.75, ", "[wide, ", "cam1/sensor.yaml: cam1.intrinsics\\[0\\] is 'wide', expected a number"),
    ("euroc", "[640, 480]", "[640]", "resolution has 1 numbers, expected 2"),
    ("euroc", "rate_hz: 20", "rate_hz: *a", "is not plain YAML: anchors and aliases are not allowed"),
    ("kalibr", "camera_model: pinhole", "camera_model: eucm", "cam0.distortion_model is 'radtan', expected one of .*eucm-none .eucm-radtan is not"),
    ("kalibr", "camera_model: pinhole", "camera_model: ocam", "cam0.camera_model is 'ocam', expected one of pinhole-radtan"),
    ("kalibr", "radtan", "fov", "cam0.distortion_model is 'fov', expected one of .*pinhole-equi.* .pinhole-fov is not supported"),
    ("kalibr", "radtan", "3", "cam0.distortion_model is 3, expected radtan"),
    ("kalibr", "T_cn_cnm1", "T_imu_cam", "lacks cam1.T_cn_cnm1, expected 16 numbers"),
    ("kalibr", "-0.125]", "0.125]", "by cam1.T_cn_cnm1 the right camera is at .*look swapped"),
    ("kalibr", "-0.125]", "]", "cam1.T_cn_cnm1 is .*expected 16 numbers \\(4 x 4\\), rows of one"),
    ("kalibr", "-0.125]", "-1.25e7]", "raw rig: distance of the cameras, m, is .*expected a number from 1e-06"),
    ("kalibr", "[0.0, 1.0, 0.0, 0.002]", "[0.0, -1.0, 0.0, 0.002]", "cam1.T_cn_cnm1 holds no rotation .*mirrors"),
    ("kalibr", "[-0.3125, ", "[", "cam0.distortion_coeffs has 3 numbers, expected 4 numbers"),
    ("kalibr", "[-0.3125, ", "[-31250, ", "cam0.distortion_coeffs\\[0\\] is -31250, expected a distortion coeff"),
    ("kalibr", "cam1:", "cam2:", "lacks cam1, expected a mapping"),
    ("kalibr", "[501.25,", "[.nan,", "cam0.intrinsics\\[0\\] is nan, expected a finite number"),
    ("kalibr", "[501.25,", "[-.inf,", "cam0.intrinsics\\[0\\] is -inf, expected a finite number"),
    ("kalibr", "[501.25,", "[true,", "cam0.intrinsics\\[0\\] is True, expected a number"),
    ("kalibr", "[640, 480]", "[640, 1e9]", "resolution\\[1\\] is 1000000000, expected a whole number"),
    ("opencv", "M1:", "N1:", "lacks M1, expected 9 numbers"),
    ("opencv", "T:", "U:", "lacks T, expected 3 numbers"),
    ("opencv", "0., 0., 1. ]\nD1", "0., 0., 2. ]\nD1", "M1\\[2,2\\] is 2.0, expected 1 of a camera matrix"),
    ("opencv", "-2.5000000000000001e-04, 0.,", "-2.5000000000000001e-04, 0., 0.5,", "D1 has rows 1, cols 14 and 15"),
    ("opencv", "0., 0. ]\nM2", "0., 0.5 ]\nM2", "D1\\[13\\] \\(ty\\) is 0.5, expected 0: a tilted sensor is not"),
    ("opencv", "   cols: 14", "   cols: 14000000", "D1 has rows 1, cols 14000000 and 14 numbers"),
    ("opencv", "   dt: d", "   dt: 2d", "M1.dt is '2d', expected one of"),
    ("opencv", "R: !!opencv-matrix", "R: !!python/tuple", "extrinsics.yml: is not plain YAML: the tag"),
    ("opencv", "[ -1.25", "[ 1.25", "by R, T the right camera is at .*look swapped"),
    ("opencv", "M1: !!", "fisheye_model: 1\nM1: !!", "D1 has 1 x 14 numbers, expected 4 numbers"),
    ("projections", "image_height: 376", "image_height: -376", "image_height is -376, expected a whole number"),
    ("projections", "-359.25, 0., 718.5", "-359.25, 3., 718.5", "P2\\[1,0\\] is 3.0, expected 0 of a camera matrix"),
    ("projections", "185.5, 0., 0., 0., 1.,\n", "185.5, -90., 0., 0., 1.,\n", "P2\\[1,3\\] is -90.0, expected 0"),
    ("projections", "[ 718.5, 0., 607.25, 0.,", "[ 718.5, 0., 607.25, 9.,", "P1\\[0,3\\] is 9.0, expected 0"),
    ("projections", "P1:", "P3:", "lacks P1"),
    ("orbslam2", "Camera.fx: 718.5", "Camera.fx: -718.5", "Camera.fx is -718.5, expected a focal length"),
    ("orbslam2", "Camera.fx: 718.5", "Camera.fx: wide", "Camera.fx is 'wide', expected a number"),
    ("orbslam2", "Camera.bf: 359.25", "Camera.bf: -359.25", "Camera.bf / Camera.fx is -0.5, expected .*look swapped"),
    ("orbslam2", "Camera.RGB: 1", "Camera.type: ds", "Camera.type is 'ds', expected PinHole, Rectified or KannalaBrandt8"),
    ("orbslam2", "Camera.bf:", "Camera.b:", "lacks Camera.bf"),
    ("orbslam2", "Camera.k1: 0.0", "Camera.k1: -0.3", "Camera.k1 is -0.3, expected k1 0 of a rectified pair"),
    ("orbslam2", "Camera.width: 1241", "Camera.width: 0", "Camera.width is 0, expected a whole number"),
    ("orbslam2", "Camera.fy:", "Camera.fx:", "the key Camera.fx is there twice in line"),
    ("orbslam3", "PinHole", "KannalaBrandt8", "lacks Camera1.k3"),
    ("orbslam3", "PinHole", "EUCM", "Camera.type is 'EUCM', expected PinHole, Rectified or"),
    ("orbslam3", "PinHole", "Rectified", "Camera1.k1 is -0.3125, expected k1 0 of a rectified pair"),
    ("orbslam3", "Stereo.T_c1_c2", "Stereo.T_c2_c1", "lacks Stereo.T_c1_c2"),
    ("orbslam3", "0.12112", "-0.12112", "by inverse of Stereo.T_c1_c2 the right camera is at .*look swapped"),
    ("orbslam3", "Camera2.k2", "Camera2.k4", "Camera2.k4 is 0.109375, expected 0"),
    ("orbslam3", "Camera2.k2", "Camera2.kk", "lacks Camera2.k2"),
    ("prerectified", "-45.05", "45.05", "RIGHT.P\\[0,3\\] / -RIGHT.P\\[0,0\\] is -0.1, expected .*look swapped"),
    ("prerectified", "RIGHT.R:", "RIGHT.Rf:", "lacks RIGHT.R"),
    ("prerectified", "RIGHT.width: 640", "RIGHT.width: 641", "LEFT.width is 640, RIGHT.width is 641"),
    ("own", "fx: 718.5", "fx: -1", "fx is -1"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "old", "new", "message"), WRONG)
def test_a_wrong_value_is_named_in_one_line(tmp_path: Path, name: str, old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read(tmp_path, changed(SAMPLES[name], old, new))
    said = str(caught.value)
    assert str(tmp_path) in said
    assert "expected" in said
    assert "\n" not in said
    assert len(said) < 600


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected a calibration of tspslam, KITTI"),
        ("# nothing\n", "is blank; expected a calibration"),
        ("- 1\n- 2\n", "is a list, not a mapping"),
        ("a: 1\nb: 2\n", "holds no calibration that is known \\(its keys: a, b\\)"),
        ("{}", "holds no calibration that is known"),
        ("<?xml version='1.0'?>\n<opencv_storage/>\n", "holds no calibration that is known \\(its keys: \\)"),
        ("%YAML:1.0\n---\nM1: [1\n", "is not plain YAML"),
        ("%YAML:1.0\n---\nM1: &x !!opencv-matrix {rows: 1}\n", "anchors and aliases"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix 3\n", "the tag .* is not allowed"),
        ("%YAML:1.0\n---\nM1: !<opencv-matrix> {rows: 1}\n", "the tag"),
        ("%YAML:1.0\n---\nM1: " + "{a: " * 50, "too many levels"),
        ("a: 1\n---\nb: 2\n", "is not plain YAML"),
        (b"\xff\xfe\x00", "is no text"),
        ("x" * ((1 << 20) + 1), "has 1048577 bytes"),
        ("M1: 1" + "0" * 4000 + "\nM2: 1\nR: 1\nT: 1\nD1: 1\n", "M1 is 10+..., expected 9 numbers"),
        ("M1: {rows: 0, cols: 0, data: []}\nR: 1\n", "M1 has 0 x 0 numbers, expected 9"),
        ("M1: {rows: -3, cols: -3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\nR: 1\n", "M1 has rows -3"),
        ("M1: {rows: 9, cols: 1, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\nR: 1\n", "M1 has 9 x 1 numbers"),
        ("M1: {rows: a, cols: 1, data: 3}\nR: 1\n", "M1 is .*expected a matrix with rows, cols and a list data"),
        ("M1: {rows: 1, cols: 1}\nR: 1\n", "M1 is .*expected a matrix"),
        ("M1: [[1, 2], [3]]\nR: 1\n", "M1 is .*rows of one length"),
        ("P0: 1 2\nP1: 3\n", "P0 has 2 numbers, expected 12"),
        ("cam0: 3\ncam1: {}\n", "cam0 is 3, expected a mapping"),
        ("M1: \x00\n", "is not plain YAML: unacceptable character"),
        ("M1: 1" + "0" * 5000 + "\n", "is not plain YAML"),
        ("%YAML:1.0\nM1:[ 1, 2 ]\nR: 1\n", "M1 has 2 numbers, expected 9"),
    ],
)  # fmt: skip
def test_files_of_no_known_kind_are_refused(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        single(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        read_calibration(tmp_path / "none.yaml")
    with pytest.raises(InputError, match=r"is a folder without a known calibration; expected .* mav0/cam0/sensor.yaml"):
        read_calibration(tmp_path)
    with pytest.raises(InputError, match="cannot be opened"):
        read_calibration("a\0b")


@pytest.mark.parametrize("size", [(0, 480), (640,), (640, 480.5), "ab", (640, True), 3, (640, 1_000_001)])
def test_a_size_that_is_none_is_refused(tmp_path: Path, size: object) -> None:
    with pytest.raises(InputError, match=r"image size is .*expected width and height"):
        read_calibration(SAMPLES["odometry"].write(tmp_path), size)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", SIZELESS)
def test_a_file_without_image_size_asks_for_it(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="holds no image size; expected width and height from"):
        read_calibration(SAMPLES[name].write(tmp_path))


@EVERY
def test_a_size_that_the_file_contradicts_is_refused(tmp_path: Path, name: str) -> None:
    path = SAMPLES[name].write(tmp_path)
    if name in SIZELESS:
        assert read_calibration(path, (9, 7)).origin
        return
    with pytest.raises(InputError, match=r"is for images of .*9 x 7 px are given, expected"):
        read_calibration(path, (9, 7))


@EVERY
def test_the_size_of_the_file_may_be_given(tmp_path: Path, name: str) -> None:
    cameras = SAMPLES[name].cameras
    camera = cameras.left if isinstance(cameras, RawRig) else cameras
    given = np.int64(camera.width), np.int64(camera.height)
    assert same(read_calibration(SAMPLES[name].write(tmp_path), given).cameras, cameras)  # type: ignore[arg-type]


def test_without_a_size_a_raw_drive_gives_the_rectified_pair_and_says_so(tmp_path: Path) -> None:
    assert any("rectified" in remark for remark in read(tmp_path, SAMPLES["rectified"]).remarks)
    assert not read(tmp_path, SAMPLES["recorded"]).remarks


def test_a_raw_drive_without_rectified_values_gives_the_recorded_pair(tmp_path: Path) -> None:
    text = SAMPLES["recorded"].files["calib_cam_to_cam.txt"]
    kept = "".join(line for line in text.splitlines(keepends=True) if "_rect_" not in line)
    assert same(single(tmp_path, kept).cameras, RAW)


def test_nameless_lines_of_twelve_numbers_are_p0_and_p1(tmp_path: Path) -> None:
    lines = SAMPLES["odometry"].files["calib.txt"].splitlines()[:2]
    found = single(tmp_path, "\n".join(line.partition(":")[2] for line in lines), (1241, 376))
    assert found.cameras == RECTIFIED
    assert any("no names" in remark for remark in found.remarks)


def test_skew_and_doffs_are_kept(tmp_path: Path) -> None:
    P0, P1 = "500 1.5 320 0 0 499 240 0 0 0 1 0", "500 1.5 330 -50 0 499 240 0 0 0 1 0"
    cameras = single(tmp_path, f"P0: {P0}\nP1: {P1}\n", (640, 480)).cameras
    assert cameras == Rig(500, 499, 320, 240, 0.1, 640, 480, skew=1.5, doffs=10)
    skewed = changed(SAMPLES["recorded"], "K_01: 5.037500e+02 0.000000e+00", "K_01: 5.037500e+02 -2.5e-01")
    raw = read(tmp_path, skewed).cameras
    assert isinstance(raw, RawRig)
    assert (raw.left.skew, raw.right.skew) == (0, -0.25)


@pytest.mark.parametrize("place", ["", "mav0", "mav0/cam0/sensor.yaml"])
def test_a_recording_is_found_by_its_folder(tmp_path: Path, place: str) -> None:
    SAMPLES["euroc"].write(tmp_path)
    assert same(read_calibration(tmp_path / place).cameras, RAW)


@pytest.mark.parametrize("place", ["", "cam0_sensor.yaml"])
def test_sensor_files_may_stand_side_by_side(tmp_path: Path, place: str) -> None:
    Sample({"cam0_sensor.yaml": CAM0, "cam1_sensor.yaml": "%YAML:1.0\n" + CAM1}, RAW, "").write(tmp_path)
    assert same(read_calibration(tmp_path / place).cameras, RAW)


def test_a_sensor_file_may_be_named_from_within_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(SAMPLES["euroc"].write(tmp_path).parent)
    assert same(read_calibration("sensor.yaml").cameras, RAW)


def test_one_sensor_file_is_no_pair(tmp_path: Path) -> None:
    path = SAMPLES["euroc"].write(tmp_path)
    with pytest.raises(InputError, match=r"not the left camera's by its name; expected cam0/sensor.yaml"):
        read_calibration(tmp_path / "mav0/cam1/sensor.yaml")
    (tmp_path / "mav0/cam1/sensor.yaml").unlink()
    with pytest.raises(InputError, match=r"cam1/sensor.yaml: cannot be opened .*sensor.yaml of the right camera"):
        read_calibration(path)


def test_the_pose_of_a_recording_carries_the_left_camera_to_the_right_one(tmp_path: Path) -> None:
    cameras = read(tmp_path, SAMPLES["euroc"]).cameras
    assert isinstance(cameras, RawRig)
    T_body_left, T_body_right = (
        np.reshape(yaml.safe_load(text)["T_BS"]["data"], (4, 4)) for text in SAMPLES["euroc"].files.values()
    )
    np.testing.assert_allclose(T_body_right @ cameras.matrix, T_body_left, atol=1e-15)


def test_either_half_of_an_opencv_calibration_finds_the_other(tmp_path: Path) -> None:
    SAMPLES["opencv"].write(tmp_path)
    for name in ("intrinsics.yml", "extrinsics.yml"):
        assert same(read_calibration(tmp_path / name, (640, 480)).cameras, RAW)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("extrinsics.yml", EXTRINSICS, "lacks M1, D1, M2, D2, expected them in it or in intrinsics.yml"),
        ("intrinsics.yml", INTRINSICS, "lacks R, T, expected them in it or in extrinsics.yml"),
        ("stereo.yml", INTRINSICS, "lacks R, T, expected them in it or in extrinsics.yml beside intrinsics.yml"),
    ],
)
def test_half_an_opencv_calibration_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_calibration(Sample({name: text}, RAW, "").write(tmp_path), (640, 480))


@pytest.mark.parametrize("names", [("K1", "K2", "D1", "D2"), ("cameraMatrix1", "cameraMatrix2", "distCoeffs1", "distCoeffs2")])  # fmt: skip
@pytest.mark.parametrize("size", ["imageSize: [ 640, 480 ]\n", "image_width: 640\nimage_height: 480\n"])
def test_the_names_of_opencv_files_may_differ(tmp_path: Path, names: tuple[str, ...], size: str) -> None:
    text = INTRINSICS + EXTRINSICS.partition("---\n")[2] + size
    for old, new in zip(("M1:", "M2:", "D1:", "D2:"), names, strict=True):
        text = text.replace(old, f"{new}:")
    assert same(single(tmp_path, text).cameras, RAW)


def test_a_baseline_that_looks_like_millimetres_is_remarked(tmp_path: Path) -> None:
    found = read(tmp_path, changed(SAMPLES["opencv"], "-1.2500000000000000e-01,", "-1.25e+02,"))
    assert any("looks like mm" in remark for remark in found.remarks)
    assert not any("mm" in remark for remark in read(tmp_path, SAMPLES["opencv"]).remarks)


def test_what_opencv_writes_is_read_as_opencv_reads_it(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    R = cv2.Rodrigues(random.normal(0, 0.1, 3))[0]
    T = R @ np.array([[-0.1], [0.01], [0.02]])
    values = {"R": R, "T": T}
    for side in "12":
        fx, fy, cx, cy = random.uniform(200, 300, 4)
        values[f"M{side}"] = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        values[f"D{side}"] = np.append(random.normal(0, 0.1, (5, 1)), np.zeros((9, 1)), axis=0)
    path = tmp_path / "stereo.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        storage.write(key, value)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.release()
    cameras = read_calibration(path).cameras
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert isinstance(cameras, RawRig)
    assert (cameras.matrix[:3] == np.hstack([storage.getNode("R").mat(), storage.getNode("T").mat()])).all()
    for side, camera in (("1", cameras.left), ("2", cameras.right)):
        K, D = storage.getNode(f"M{side}").mat(), storage.getNode(f"D{side}").mat().ravel()
        assert [camera.fx, camera.fy, camera.cx, camera.cy] == [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        assert camera.distortion == tuple(D[:5])


def test_camera_2_of_orb_slam_is_seen_from_camera_1(tmp_path: Path) -> None:
    cameras = read(tmp_path, SAMPLES["orbslam3"]).cameras
    assert isinstance(cameras, RawRig)
    np.testing.assert_allclose(cameras.matrix @ np.array(BACK), np.eye(4), atol=1e-15)


def test_rotations_that_rectify_give_back_the_pose(tmp_path: Path) -> None:
    """OpenCV rectifies cameras; from its R and P alone the reader finds their pose."""
    K, D = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.zeros(5)
    R = cv2.Rodrigues(np.array([0.02, -0.05, 0.01]))[0]
    T = R @ np.array([-0.1, 0.003, 0.002])
    R1, R2, P1, P2 = cv2.stereoRectify(K, D, K, D, (640, 480), R, T, alpha=0)[:4]
    matrices = {"LEFT.K": K, "LEFT.D": D, "LEFT.R": R1, "LEFT.P": P1, "RIGHT.K": K, "RIGHT.D": D, "RIGHT.R": R2}
    text = "".join(f"{key}: {value.tolist()}\n" for key, value in {**matrices, "RIGHT.P": P2}.items())
    cameras = single(tmp_path, "Camera.width: 640\nCamera.height: 480\n" + text).cameras
    assert isinstance(cameras, RawRig)
    np.testing.assert_allclose(cameras.matrix[:3], np.column_stack([R, T]), atol=1e-12)


def test_rectified_settings_of_orb_slam3_have_their_baseline(tmp_path: Path) -> None:
    text = 'Camera.type: "Rectified"\nCamera1.fx: 718.5\nCamera1.fy: 718.5\nCamera1.cx: 607.25\nCamera1.cy: 185.5\n'
    text += "Camera.width: 1241\nCamera.height: 376\nCamera.newWidth: 600\n"
    found = single(tmp_path, text + "Stereo.b: 0.5\n")
    assert found.cameras == RECTIFIED
    assert found.origin["baseline"] == "Stereo.b"
    assert any("newWidth" in remark for remark in found.remarks)
    with pytest.raises(InputError, match=r"lacks Stereo\.b, expected a number"):
        single(tmp_path, text)


def test_a_kalibr_lens_without_distortion_has_none(tmp_path: Path) -> None:
    cameras = read(tmp_path, changed(SAMPLES["kalibr"], "radtan", "none")).cameras
    assert isinstance(cameras, RawRig)
    assert cameras.left.distortion == (0, 0, 0, 0, 0)


def test_cameras_after_the_second_are_left_out_with_a_remark(tmp_path: Path) -> None:
    chain = SAMPLES["kalibr"].files["camchain.yaml"]
    found = single(tmp_path, chain + "cam2: {camera_model: omni}\n")
    assert same(found.cameras, RAW)
    assert any("cam2" in remark for remark in found.remarks)
    assert any("P2 and P3" in remark for remark in read(tmp_path, SAMPLES["odometry"]).remarks)


def test_our_raw_files_keep_their_origins(tmp_path: Path) -> None:
    text = "fx: 501.25\nfy: 499.5\ncx: 321.5\ncy: 238.75\nwidth: 640\nheight: 480\n"
    text += "left: {distortion: [-0.3125, 0.125, 0.0005, -0.00025]}\n"
    text += (
        "right: {fx: 503.75, fy: 502.5, cx: 318.25, cy: 241.5, distortion: [-0.296875, 0.109375, -0.00075, 0.001]}\n"
    )
    found = single(tmp_path, text + f"T_right_left: {[list(row) for row in TURNED]}\n")
    assert found.cameras == RAW
    assert found.origin["left.fx"] == "fx"
    assert found.origin["right.k1"] == "right.distortion[0]"
    assert found.origin["right.width"] == "width"


def real(*names: str) -> Path:
    path = DATA.joinpath(*names)
    if not path.exists():
        pytest.skip(f"{'/'.join(names)} is not in the data folder (TSPSLAM_DATA)")
    return path


def close(camera: Rig | Camera, known: dict[str, float]) -> bool:
    return all(math.isclose(getattr(camera, key), known[key], rel_tol=1e-9) for key in ("fx", "fy", "cx", "cy", "width", "height"))  # fmt: skip


def distance(cameras: Rig | RawRig) -> float:
    assert isinstance(cameras, RawRig)
    return float(np.linalg.norm(cameras.matrix[:3, 3]))


def agrees_with_raw(cameras: Rig | RawRig, known: dict) -> None:
    assert isinstance(cameras, RawRig)
    size = {key: known[key] for key in ("width", "height")}
    for camera, values in ((cameras.left, known), (cameras.right, size | known["right"])):
        assert close(camera, values)
        assert np.allclose(camera.distortion[: len(values["distortion"])], values["distortion"], rtol=1e-9, atol=0)
    assert distance(cameras) == pytest.approx(known["baseline_m"], abs=1e-5)


def test_the_real_raw_drive_is_read() -> None:
    path = real("kitti_raw_0926", "calib_cam_to_cam.txt")
    known = yaml.safe_load((path.parent / "calib.yaml").read_text())
    agrees_with_raw(read_calibration(path, (known["width"], known["height"])).cameras, known)
    cameras, rectified = read_calibration(path).cameras, known["rectified_result"]
    assert isinstance(cameras, Rig)
    assert close(cameras, rectified)
    assert cameras.baseline == pytest.approx(rectified["baseline_m"], abs=1e-5)


def test_the_real_odometry_file_is_read() -> None:
    path = real("kitti_seq1", "calib.txt")
    known = yaml.safe_load((path.parent / "calib.yaml").read_text())
    cameras = read_calibration(path, (known["width"], known["height"])).cameras
    assert isinstance(cameras, Rig)
    assert close(cameras, known)
    assert cameras.baseline == pytest.approx(known["baseline_m"], rel=1e-12)


def test_the_real_recording_is_read_and_rectifies_as_known() -> None:
    path = real("euroc_v101_keyframes", "cam0_sensor.yaml")
    known = yaml.safe_load((path.parent / "calib.yaml").read_text())
    cameras = read_calibration(path).cameras
    agrees_with_raw(cameras, known)
    assert isinstance(cameras, RawRig)
    rig, check = rectification(cameras).rig, known["rectified_check"]
    assert (rig.fx, rig.cx, rig.cy) == pytest.approx((check["f"], check["cx"], check["cy"]), abs=1e-3)


WORDS = ["0", "-1", "1e308", "1e-308", "-1e9999", "nan", ".nan", ".inf", "true", "null", "[]", "{}", "[[]]", "[1,2]"]
WORDS += ["!!opencv-matrix", "!!int", "&a", "*a", ":", "|", ">", "'", '"', "#", "\t"]
WORDS += ["\x00", "\u2028", "9" * 400, "P0:", "S_00:", "cam0:", "T_BS:", "Camera.fx:", "LEFT.K:", "%YAML:1.0"]
WORDS += [
    "[LEFT_CAM_HD]",
    "cam0=[",
    "<M1>",
    "<!DOCTYPE a>",
    "&amp;",
    "1 2 CAMERA 1",
    "{",
    "}",
    ",",
    '{"value0":',
    "1e-400",
]


@st.composite
def mutations(draw: st.DrawFn, text: str) -> bytes:
    """The text with a few of its lines or words dropped, doubled, exchanged or replaced, or bytes overwritten."""
    if draw(st.booleans()):
        data = bytearray(text.encode())
        for _ in range(draw(st.integers(1, 4))):
            data[draw(st.integers(0, len(data) - 1))] = draw(st.integers(0, 255))
        return bytes(data)
    separator = draw(st.sampled_from(["\n", " "]))
    parts = text.split(separator)
    for _ in range(draw(st.integers(1, 3))):
        at, other = (draw(st.integers(0, len(parts) - 1)) for _ in range(2))
        new = draw(st.sampled_from([[], [parts[at]] * 2, [parts[other]], [draw(st.sampled_from(WORDS))]]))
        parts[at : at + 1] = new
        parts = parts or [""]
    return separator.join(parts).encode()


@EVERY
@given(st.data())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
def test_a_damaged_file_gives_cameras_or_an_input_error(name: str, data: st.DataObject) -> None:
    sample = SAMPLES[name]
    damaged = data.draw(st.sampled_from(sorted(sample.files)))
    content = data.draw(mutations(sample.files[damaged]))
    with tempfile.TemporaryDirectory() as folder:
        path = sample.write(Path(folder))
        Path(folder, damaged).write_bytes(content)
        try:
            found = read_calibration(path, data.draw(st.sampled_from([sample.size, None, (640, 480)])))
        except InputError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert len(str(error)) < 800  # noqa: PT017
            return
    cameras = found.cameras
    values = [cameras.left, cameras.right] if isinstance(cameras, RawRig) else [cameras]
    fields = [value for each in values for name, value in vars(each).items() if name != "lens"]
    numbers = [number for each in fields for number in np.hstack([each])]
    assert np.isfinite(numbers).all()
    assert not isinstance(cameras, RawRig) or np.isfinite(cameras.matrix).all()
    assert all(len(remark.splitlines()) == 1 for remark in found.remarks)


def test_our_own_file_is_told_from_the_others(tmp_path: Path) -> None:
    assert single(tmp_path, OWN).cameras == RECTIFIED
    with pytest.raises(InputError, match="unknown key 'basline'; did you mean baseline"):
        single(tmp_path, OWN.replace("baseline", "basline"))


@pytest.mark.parametrize("name", [name for name, each in SAMPLES.items() if each.takes_comments])
@pytest.mark.parametrize("above", ["# mine\n", "\n\n", "  # one\n\n# two\n"])
def test_comments_and_blank_lines_may_stand_above_the_header(tmp_path: Path, name: str, above: str) -> None:
    sample = SAMPLES[name]
    found = read(tmp_path, replace(sample, files={key: above + text for key, text in sample.files.items()}))
    assert same(found.cameras, sample.cameras)


def test_four_coefficients_without_a_lens_model_are_remarked_on(tmp_path: Path) -> None:
    sample = SAMPLES["opencv"]
    text = sample.files["intrinsics.yml"]
    four = text.replace("cols: 14", "cols: 4").replace(", 0., 0., 0., 0.,\n       0., 0., 0., 0., 0., 0. ]", " ]")
    found = read(tmp_path, replace(sample, files=sample.files | {"intrinsics.yml": four}))
    assert same(found.cameras, sample.cameras)
    assert any("4 coefficients and no lens model is named" in line for line in found.remarks)
    assert not any("4 coefficients" in line for line in read(tmp_path, sample).remarks)
