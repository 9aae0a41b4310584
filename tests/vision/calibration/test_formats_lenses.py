"""Files of further programs and lenses: which file is which, what stands beside it, what is refused."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.types import RawRig, Rig
from tspslam.vision.calibration.formats import read_calibration

from .formats_samples import EXTRINSICS, INTRINSICS, OWN, PARALLEL, RAW, RECTIFIED, SAMPLES, Sample
from .formats_samples_lenses import (
    COLMAP_CAMERAS,
    COLMAP_RIGS,
    EQUI,
    FISHEYES,
    FURTHER,
    KB8,
    PINHOLES,
    PRISM,
    RATIONAL,
    RIG_CONFIG,
    XML,
    ZED,
    bare,
    basalt,
    camchain,
    infos,
    opencv,
    ros,
    stella,
)
from .test_formats import changed, read, same, single


def said(folder: Path, sample: Sample) -> str:
    with pytest.raises(InputError) as caught:
        read(folder, sample)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)
    assert len(str(caught.value)) < 600
    return str(caught.value)


WRONG = [
    ("kalibr-omni", "camera_model: omni", "camera_model: ocam", "cam0.camera_model is 'ocam', expected one of"),
    ("kalibr-omni", "radtan", "equidistant", "omni-equidistant is not supported"),
    ("kalibr-omni", "[1.25, ", "[-1.25, ", "cam0.intrinsics[0] is -1.25, expected xi of a lens from -1 to 10000"),
    ("kalibr-omni", "[1.25, ", "[-0.25, ", "xi is -0.25, expected a number from 0 to 10000"),
    ("kalibr-omni", "[1.25, ", "[", "cam0.intrinsics has 4 numbers, expected 5"),
    ("kalibr-ds", "0.5625", "1.5", "cam0.intrinsics[1] is 1.5, expected alpha of a lens from 0 to 1"),
    ("kalibr-eucm", "1.0625", "0", "cam0.intrinsics[1] is 0, expected beta of a lens from 1e-06"),
    ("kalibr-equi", "[0.03125, ", "[", "cam0.distortion_coeffs has 3 numbers, expected 4"),
    ("kalibr-imu", "T_cam_imu", "T_imu", "lacks cam1.T_cn_cnm1"),
    ("opencv-8", "0.375 ]", "0.375, 1 ]", "D1 has rows 1, cols 8 and 9 numbers in data"),
    ("opencv-fisheye", "fisheye: 1", "model: ocam", "an omnidirectional model is not read from such a file"),
    ("opencv-fisheye", "fisheye: 1", "model: thin_prism_fisheye", "the thin prism fisheye model is not read"),
    ("opencv-fisheye", "fisheye: 1", "model: double sphere", "the double sphere model is not read"),
    ("opencv-fisheye", "fisheye: 1", "lens: {projection: equirectangular}", "lens.projection is 'equirectangular'"),
    ("opencv-xml", "<opencv_storage>", "<!DOCTYPE a>\n<opencv_storage>", "a document type and entities are not allowed"),
    ("opencv-xml", "<opencv_storage>", '<!DOCTYPE a [<!ENTITY b "c">]>\n<opencv_storage>', "are not allowed"),
    ("opencv-xml", "<opencv_storage>", '<!DOCTYPE a SYSTEM "file:///etc/passwd">\n<opencv_storage>', "are not allowed"),
    ("opencv-xml", "640 480", "&b; 480", "is no XML of OpenCV: undefined entity"),
    ("opencv-xml", "opencv_storage", "storage", "is no XML of OpenCV: its root is <storage>, not <opencv_storage>"),
    ("opencv-xml", "<M1", "<M2", "mismatched tag"),
    ("opencv-xml", "</opencv_storage>", "", "is no XML of OpenCV: no element found"),
    ("opencv-xml", "calibration_time", "T", "<T> is there twice"),
    ("opencv-xml", "5.0125e+02", "wide", "M1[0,0] is 'wide', expected a number"),
    ("opencv-xml", "640 480", "640", "imageSize is 640, expected 2 numbers"),
    ("orbslam-kb8", "Camera2.k4: -0.00175", "Camera2.k4: wide", "Camera2.k4 is 'wide', expected a number"),
    ("orbslam-kb8", "Stereo.T_c1_c2", "Stereo.b", "lacks Stereo.T_c1_c2"),
    ("orbslam-tlr", "0.96, 0.0, -0.28", "0.96, 0.0, 0.28", "Tlr holds no rotation"),
    ("stella", 'setup: "stereo"', 'setup: "monocular"', "Camera.setup is 'monocular', expected stereo"),
    ("stella", "rows: 480", "rows: 0", "Camera.rows is 0, expected a whole number"),
    ("stella", 'model: "perspective"\n  K', 'model: "equirectangular"\n  K', "StereoRectifier.model is 'equirectangular', expected perspective or fisheye"),
    ("stella", "focal_x_baseline: 45.05", "focal_x_baseline: 0", "is 0, expected a baseline"),
    ("stella-rectified", '"perspective"', '"fisheye"', "Camera.model is 'fisheye', expected perspective of a rectified pair, or a StereoRectifier"),
    ("stella-rectified", "Camera.k1: 0.0", "Camera.k1: 0.1", "Camera.k1 is 0.1, expected 0 of a rectified pair, or a"),
    ("basalt-ds", '"ds"', '"fov"', "value0.intrinsics[0].camera_type is 'fov', expected one of pinhole, pinhole-radtan8"),
    ("basalt-ds", '"alpha"', '"beta"', "lacks value0.intrinsics[0].intrinsics.alpha, expected a number"),
    ("basalt-ds", '"qw": 1.0', '"qw": 0.5', "is a quaternion of length 0.5, expected 1"),
    ("basalt-ds", '"px": -0.0625', '"px": 1.0', "left and right look swapped"),
    ("basalt-ds", '"resolution"', '"size"', "lacks value0.resolution, expected a list of two cameras"),
    ("basalt-ds", "}", "", "is no whole JSON"),
    ("basalt-ds", "-0.1875", "NaN", "is no whole JSON (it holds NaN)"),
    ("t265", "kannalabrandt4", "fisheye", "cameras[0].distortion.type is 'fisheye', expected kannalabrandt4 or undistorted"),
    ("t265", '"W"', '"R"', "cameras[0].extrinsics.R may be by rows or by columns, expected a rotation vector W"),
    ("t265", "3.141592653589793", "31.4", "cameras[0].extrinsics.W is [31.4, 0.0, 0.0], expected a rotation vector"),
    ("t265", "-0.0625", "1.0", "left and right look swapped"),
    ("t265", "0.03125,", "", "cameras[0].distortion.k has 3 numbers, expected 4"),
    ("t265", '"extrinsics"', '"pose"', "lacks cameras[0].extrinsics, expected a mapping"),
    ("t265", '"size_px"', '"size"', "holds no image size"),
    ("ros", "plumb_bob", "ocam", "left.distortion_model is 'ocam', expected one of plumb_bob, rational_polynomial, equidistant"),
    ("ros", "-45.05", "0.0", "is -0, expected a baseline, m,"),
    ("ros", "projection_matrix", "projection", "lacks left.projection_matrix"),
    ("ros", "image_width: 640", "image_width: wide", "left.image_width is 'wide', expected a number"),
    ("ros-equidistant", "0.03125, ", "", "left.distortion_coefficients has rows 1, cols 4 and 3 numbers"),
    ("rtabmap", "translation_matrix", "translation", "stereo_pose.yaml: lacks translation_matrix"),
    ("rtabmap", "plumb_bob", "fov", "left.distortion_model is 'fov', expected one of"),
    ("zed", "fx=501.25", "fx=501,25", "LEFT_CAM_HD.fx is '501,25', expected a number"),
    ("zed", "Baseline=125", "Baseline=-125", "STEREO.Baseline / 1000 is -0.125, expected a baseline"),
    ("zed", "CV_HD=0.25", "CV_HD=4", "turn by 4, expected radians up to pi"),
    ("zed", "RZ_HD=0\n", "", "lacks STEREO.RZ_HD"),
    ("zed", "RX_HD=0", "RX_HD", "line 45 holds the line 'RX_HD'"),
    ("zed", "[RIGHT_CAM_HD]", "", "holds the key 'LEFT_CAM_HD.fx' twice"),
    ("middlebury", "baseline=193", "baseline=0", "baseline / 1000 is 0, expected a baseline"),
    ("middlebury", "doffs=131.125", "doffs=13.1", "doffs is 13.1, but the cameras' cx differ by 131.125"),
    ("middlebury", "cam1=[3997.5", "cam1=[3990", "cam0[0,0] is 3997.5, cam1[0,0] is 3990, expected the same"),
    ("middlebury", "vmin=31", "vmin=310", "vmin, vmax is 310 to 257, expected a range of disparities"),
    ("middlebury", "isint=0", "isint", "line 8 holds the line 'isint'"),
    ("middlebury", "; 0 0 1]", "]", "cam0 has 2 x 3 numbers, expected 9 numbers"),
    ("colmap", "OPENCV 640", "FOV 640", "camera 1 is of the model 'FOV', expected one of SIMPLE_PINHOLE, PINHOLE"),
    ("colmap", "OPENCV 640", "THIN_PRISM_FISHEYE 640", "is of the model 'THIN_PRISM_FISHEYE', expected one of"),
    ("colmap", "0.125 0.0005", "0.125", "camera 1 OPENCV has 7 numbers, expected 8 numbers"),
    ("colmap", "640 480 501.25", "640 0 501.25", "is 0, expected a whole number of px"),
    ("colmap", "CAMERA 2 1 1 0", "CAMERA 9 1 1 0", "names camera 9, expected one of cameras.txt or cameras.bin"),
    ("colmap", "CAMERA 2 1 1 0 0 0 -0.125 0 0", "CAMERA 2 0", "has no rig of two cameras with a pose"),
    ("colmap", "1 1 0 0 0 -0.125 0 0", "1 2 0 0 0 -0.125 0 0", "pose of camera 2 is a quaternion of length 2"),
    ("colmap", "-0.125 0 0", "-0.125 0", "line 5 ends within a pose"),
    ("colmap-config", '"ref_sensor"', '"ref"', "cameras has none with ref_sensor true"),
    ("colmap-config", '"camera_params"', '"params"', "lacks cameras[0].camera_params, expected a list of numbers"),
    ("colmap-config", '"cam_from_rig_translation"', '"t"', "lacks cameras[1].cam_from_rig_translation"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "old", "new", "message"), WRONG)
def test_a_wrong_value_is_named(tmp_path: Path, name: str, old: str, new: str, message: str) -> None:
    assert message in said(tmp_path, changed(FURTHER[name], old, new))


FISHEYE = ["model: fisheye", "calibration_model: KANNALA_BRANDT", "is_fisheye: true", "distortion_model: equidistant", "lens: {projection: fish-eye}", "camera_type: kb4"]  # fmt: skip


@pytest.mark.parametrize("line", FISHEYE)
def test_four_coefficients_of_a_named_fisheye_are_its_own(tmp_path: Path, line: str) -> None:
    found = single(tmp_path, opencv(*EQUI, f"{line}\n"))
    assert found.cameras == FISHEYES
    assert not any("4 coefficients" in remark for remark in found.remarks)


def test_either_half_of_an_opencv_calibration_may_name_the_lens(tmp_path: Path) -> None:
    whole = opencv(*EQUI)
    lenses, pose = whole.partition("R: !!")[::2]
    for more in (("", "fisheye: 1\n"), ("fisheye: 1\n", "")):
        files = {"intrinsics.yml": lenses + more[0], "extrinsics.yml": f"%YAML:1.0\n---\nR: !!{pose}{more[1]}"}
        assert read(tmp_path, Sample(files, FISHEYES, "")).cameras == FISHEYES


def test_four_coefficients_without_a_name_are_brown_s_and_remarked_on(tmp_path: Path) -> None:
    found = single(tmp_path, opencv(*EQUI, "fisheye: 0\nmodel: pinhole\n"))
    assert isinstance(found.cameras, RawRig)
    assert found.cameras.left.lens == "brown"
    assert any("4 coefficients and no lens model is named" in remark for remark in found.remarks)


def test_coefficients_that_are_0_make_the_simpler_lens(tmp_path: Path) -> None:
    for count, lens in ((8, "rational"), (12, "thin_prism"), (14, "thin_prism")):
        values = (*PRISM.left.distortion, 0.0, 0.0)[:count]
        text = ", ".join(map(repr, values))
        cameras = single(tmp_path, opencv(text, text)).cameras
        assert isinstance(cameras, RawRig)
        assert cameras.left.lens == lens
    bent = ", ".join(map(repr, (*RATIONAL.left.distortion, 0.0, 0.0, 0.0, 0.0)))
    assert same(single(tmp_path, opencv(bent, bent)).cameras, replace(RATIONAL, right=replace(RATIONAL.right, distortion=RATIONAL.left.distortion)))  # fmt: skip


def test_xml_of_opencv_is_read_as_its_yaml(tmp_path: Path) -> None:
    read_as = []
    for name in ("stereo.xml", "stereo.yml"):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for side, camera in (("1", PRISM.left), ("2", PRISM.right)):
            storage.write(f"M{side}", np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]))
            storage.write(f"D{side}", np.array([camera.distortion]))
        storage.write("R", PRISM.matrix[:3, :3])
        storage.write("T", PRISM.matrix[:3, 3:])
        storage.write("note", "a < b & c")
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        storage.release()
        read_as.append(read_calibration(tmp_path / name))
    assert read_as[0].cameras == PRISM
    assert read_as[0] == read_as[1]


def test_xml_has_few_levels_and_one_root(tmp_path: Path) -> None:
    for text, message in (
        ("<opencv_storage>" + "<a>" * 50 + "</a>" * 50 + "</opencv_storage>", "too many levels"),
        (XML + XML.partition("\n")[2], "junk after document element"),
        ("<" + "a" * 9000, "is no XML of OpenCV"),
        ("<opencv_storage><b/></opencv_storage>", "holds no calibration that is known"),
    ):
        with pytest.raises(InputError, match=message) as caught:
            single(tmp_path, text)
        assert len(str(caught.value)) < 600


@pytest.mark.parametrize(
    ("names"),
    [("left.yaml", "right.yaml"), ("cam0.yaml", "cam1.yaml"), ("my_left_hd.yml", "my_right_hd.yml"),
     ("left/calib.yaml", "right/calib.yaml"), ("camera0/info.yaml", "camera1/info.yaml")],
)  # fmt: skip
def test_either_camera_info_finds_the_other(tmp_path: Path, names: tuple[str, str]) -> None:
    texts = ros("equidistant", FISHEYES).values()
    Sample(dict(zip(names, texts, strict=True)), FISHEYES, "").write(tmp_path)
    for name in names:
        assert same(read_calibration(tmp_path / name).cameras, replace(FISHEYES, T_right_left=PARALLEL))


def test_a_camera_info_is_found_by_a_relative_name_and_by_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    FURTHER["ros"].write(tmp_path)
    monkeypatch.chdir(tmp_path)
    for path in ("left.yaml", "./right.yaml", "."):
        assert same(read_calibration(path).cameras, replace(RAW, T_right_left=PARALLEL))


def test_one_camera_info_is_no_pair(tmp_path: Path) -> None:
    left = infos("plumb_bob", RAW)[0]
    message = said(tmp_path, Sample({"left.yaml": left}, RAW, ""))
    assert "right.yaml: cannot be opened" in message
    assert "expected the camera_info of the right camera" in message
    assert "its name does not tell which, expected a name with left or right" in said(
        tmp_path, Sample({"ost.yaml": left}, RAW, "")
    )


def test_a_camera_info_may_leave_out_rotation_and_distortion(tmp_path: Path) -> None:
    text = FURTHER["ros-rectified"].files["cam0.yaml"]
    kept = [line for line in text.splitlines() if not line.startswith(("rectification", "distortion"))]
    files = {
        "left.yaml": "\n".join(kept),
        "right.yaml": "\n".join(kept).replace("607.25, 0, 0, 718.5", "607.25, -359.25, 0, 718.5"),
    }
    assert read(tmp_path, Sample(files, RECTIFIED, "")).cameras == RECTIFIED


def test_a_pose_beside_camera_infos_gives_way_to_their_baseline(tmp_path: Path) -> None:
    texts = zip(("stereo_left.yaml", "stereo_right.yaml"), infos("plumb_bob", RAW), strict=True)
    files = {**dict(texts), "stereo_pose.yaml": FURTHER["rtabmap"].files["stereo_pose.yaml"]}
    found = read(tmp_path, Sample(files, RAW, ""))
    assert same(found.cameras, replace(RAW, T_right_left=PARALLEL))
    assert found.format == "RTAB-Map calibration"


def test_the_size_of_the_images_chooses_the_resolution_of_a_zed(tmp_path: Path) -> None:
    assert "is for images of HD (1280 x 720), VGA (672 x 376), expected the size of one" in said(
        tmp_path, replace(FURTHER["zed"], size=None)
    )
    cameras = single(tmp_path, ZED, (672, 376)).cameras
    assert isinstance(cameras, RawRig)
    assert (cameras.left.fx, cameras.right.width, cameras.left.distortion[:2]) == (250, 672, (-0.17, 0.02))
    alone = ZED.replace("_VGA", "_OWN")
    found = single(tmp_path, alone)
    assert same(found.cameras, FURTHER["zed"].cameras)
    assert found.origin["left.width"] == "the size of HD"


def test_a_zed_with_six_radial_coefficients_is_rational(tmp_path: Path) -> None:
    text = ZED.replace("k3=0\n", "k3=0.5\nk4=0.25\nk5=-0.5\nk6=0.125\n")
    cameras = single(tmp_path, text, (1280, 720)).cameras
    assert isinstance(cameras, RawRig)
    assert (cameras.left.lens, cameras.left.distortion[4:]) == ("rational", (0.5, 0.25, -0.5, 0.125))


def test_the_right_camera_of_a_zed_is_where_its_own_program_puts_it(tmp_path: Path) -> None:
    """OpenCV's rectification of (RX, CV, RZ) and -(Baseline, TY, TZ) has the baseline in its P2."""
    text = ZED.replace("RX_HD=0", "RX_HD=0.01").replace("RZ_HD=0", "RZ_HD=-0.02").replace("TZ=0", "TZ=3")
    cameras = single(tmp_path, text, (1280, 720)).cameras
    assert isinstance(cameras, RawRig)
    np.testing.assert_allclose(cv2.Rodrigues(cameras.matrix[:3, :3])[0].ravel(), (0.01, 0.25, -0.02), atol=1e-12)
    np.testing.assert_allclose(cameras.matrix[:3, 3], (-0.125, 0.002, -0.003), atol=1e-15)


def test_middlebury_s_range_of_disparities_is_kept(tmp_path: Path) -> None:
    sample = FURTHER["middlebury"]
    found = read(tmp_path, sample)
    assert found.disparity_range == (31, 257)
    assert any("31 to 257 px (vmin, vmax)" in remark for remark in found.remarks)
    assert read(tmp_path, changed(sample, "vmin=31\n", "")).disparity_range == (0, 280)
    bare_ = "".join(line for line in sample.files["calib.txt"].splitlines(True) if not line.startswith(("v", "ndisp")))
    assert single(tmp_path, bare_).disparity_range is None
    assert read(tmp_path, SAMPLES["kalibr"]).disparity_range is None


def binary(order: tuple[int, int] = (1, 2), x: float = -0.125) -> dict[str, bytes]:
    """The sample of COLMAP as its binary files."""
    rows = [line.split() for line in COLMAP_CAMERAS.splitlines() if not line.startswith("#")]
    models = {"OPENCV": 4, "PINHOLE": 1}
    cameras = struct.pack("<Q", len(rows))
    for number, model, width, height, *values in rows:
        cameras += struct.pack("<IiQQ", int(number), models[model], int(width), int(height))
        cameras += struct.pack(f"<{len(values)}d", *map(float, values))
    lone = struct.pack("<IIiI", 1, 1, 0, 7)
    rig = struct.pack("<IIiIiIB7d", 2, 2, 0, order[0], 0, order[1], 1, 1.0, 0.0, 0.0, 0.0, x, 0.0, 0.0)
    return {"cameras.bin": cameras, "rigs.bin": struct.pack("<Q", 2) + lone + rig}


def write(folder: Path, files: dict[str, bytes]) -> None:
    for name, data in files.items():
        (folder / name).write_bytes(data)


def test_a_binary_model_of_colmap_is_read_as_its_text(tmp_path: Path) -> None:
    write(tmp_path, binary())
    for path in (tmp_path, tmp_path / "cameras.bin", tmp_path / "rigs.bin"):
        assert same(read_calibration(path).cameras, bare(RAW))


def test_either_text_of_colmap_finds_the_other(tmp_path: Path) -> None:
    FURTHER["colmap"].write(tmp_path)
    for path in (tmp_path, tmp_path / "cameras.txt"):
        assert same(read_calibration(path).cameras, bare(RAW))
    (tmp_path / "cameras.txt").unlink()
    with pytest.raises(InputError, match=r"cameras\.txt: cannot be opened"):
        read_calibration(tmp_path)


def test_which_camera_of_a_rig_is_left_its_place_tells(tmp_path: Path) -> None:
    """COLMAP has no word for it: the reference may be the right one."""
    write(tmp_path, binary((2, 1), 0.125))
    found = read_calibration(tmp_path)
    assert same(found.cameras, bare(RAW))
    assert found.origin["T_right_left"] == "inverse of the pose of camera 1"


def test_the_reference_of_a_rig_may_be_an_imu(tmp_path: Path) -> None:
    rigs = "3 3 IMU 1 CAMERA 1 1 1 0 0 0 0.5 0 0 CAMERA 2 1 1 0 0 0 0.375 0 0\n"
    found = read(tmp_path, Sample({"rigs.txt": rigs, "cameras.txt": COLMAP_CAMERAS}, RAW, ""))
    assert same(found.cameras, bare(RAW))


@pytest.mark.parametrize(
    ("line", "lens", "distortion"),
    [
        ("SIMPLE_PINHOLE 640 480 500 320.5 240.5", "brown", (0, 0, 0, 0, 0)),
        ("PINHOLE 640 480 500 500 320.5 240.5", "brown", (0, 0, 0, 0, 0)),
        ("SIMPLE_RADIAL 640 480 500 320.5 240.5 0.25", "brown", (0.25, 0, 0, 0, 0)),
        ("RADIAL 640 480 500 320.5 240.5 0.25 -0.5", "brown", (0.25, -0.5, 0, 0, 0)),
        ("OPENCV 640 480 500 500 320.5 240.5 1 2 3 4", "brown", (1, 2, 3, 4, 0)),
        ("FULL_OPENCV 640 480 500 500 320.5 240.5 1 2 3 4 5 6 7 8", "rational", (1, 2, 3, 4, 5, 6, 7, 8)),
        ("FULL_OPENCV 640 480 500 500 320.5 240.5 1 2 3 4 5 0 0 0", "brown", (1, 2, 3, 4, 5)),
        ("OPENCV_FISHEYE 640 480 500 500 320.5 240.5 1 2 3 4", "equidistant", (1, 2, 3, 4)),
        ("SIMPLE_RADIAL_FISHEYE 640 480 500 320.5 240.5 0.25", "equidistant", (0.25, 0, 0, 0)),
        ("RADIAL_FISHEYE 640 480 500 320.5 240.5 0.25 -0.5", "equidistant", (0.25, -0.5, 0, 0)),
    ],
)
def test_each_model_of_colmap_is_a_lens(tmp_path: Path, line: str, lens: str, distortion: tuple[float, ...]) -> None:
    files = {"rigs.txt": COLMAP_RIGS, "cameras.txt": f"1 {line}\n2 {line}\n"}
    cameras = read(tmp_path, Sample(files, RAW, "")).cameras
    assert isinstance(cameras, RawRig)
    camera = cameras.left
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (500, 500, 320, 240)
    assert (camera.lens, camera.distortion) == (lens, distortion)


def test_cameras_that_are_not_read_are_remarked_on(tmp_path: Path) -> None:
    three = json.loads(RIG_CONFIG)
    three[0]["cameras"].append(three[0]["cameras"][0])
    assert any("first two cameras" in remark for remark in single(tmp_path, json.dumps(three), (640, 480)).remarks)
    file = json.loads(FURTHER["basalt-kb4"].files["c.json"])
    file["value0"]["intrinsics"] *= 2
    assert any("after the second" in remark for remark in single(tmp_path, json.dumps(file)).remarks)
    text = FURTHER["basalt-8"].files["c.json"].replace('"k6"', '"rpmax": 2.5, "k6"')
    assert any("rpmax" in remark for remark in single(tmp_path, text).remarks)


@pytest.mark.parametrize("name", ["cameras.bin", "rigs.bin"])
def test_a_binary_model_that_ends_early_is_refused(tmp_path: Path, name: str) -> None:
    files = binary()
    for end in range(1, len(files[name])):
        write(tmp_path, files | {name: files[name][:end]})
        with pytest.raises(InputError, match=rf"{name}: ends at byte {end}, within a record"):
            read_calibration(tmp_path / name)


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_a_damaged_binary_model_gives_cameras_or_an_input_error(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:  # fmt: skip
    folder = tmp_path_factory.mktemp("model")
    files = {name: bytearray(content) for name, content in binary().items()}
    for content in files.values():
        for _ in range(data.draw(st.integers(0, 3))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    write(folder, {name: bytes(content) for name, content in files.items()})
    try:
        cameras = read_calibration(folder).cameras
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    assert isinstance(cameras, RawRig)
    assert np.isfinite(cameras.matrix).all()


def test_the_content_tells_the_kind_not_the_name(tmp_path: Path) -> None:
    for name in (
        "kalibr-ds",
        "opencv-xml",
        "orbslam-kb8",
        "stella",
        "basalt-eucm",
        "zed",
        "middlebury",
        "colmap-config",
    ):
        sample = FURTHER[name]
        found = single(tmp_path, next(iter(sample.files.values())), sample.size)
        assert (found.format, same(found.cameras, sample.cameras)) == (sample.format, True)


def test_our_own_file_may_be_json(tmp_path: Path) -> None:
    pairs = (line.split(": ") for line in OWN.splitlines())
    text = json.dumps({key: float(value) if "." in value else int(value) for key, value in pairs})
    assert isinstance(single(tmp_path, text).cameras, Rig)


def test_kalibr_without_distortion_coefficients_is_refused(tmp_path: Path) -> None:
    text = camchain("pinhole", PINHOLES, "equidistant", EQUI).replace("distortion_coeffs", "coeffs")
    with pytest.raises(InputError, match=r"lacks cam0\.distortion_coeffs, expected 4 numbers"):
        single(tmp_path, text)


def test_a_file_of_a_camera_alone_of_another_program_is_of_no_known_kind(tmp_path: Path) -> None:
    text = "%YAML:1.0\n---\nmodel_type: KANNALA_BRANDT\ncamera_name: left\nprojection_parameters: {k2: 0.1, mu: 400}\n"
    with pytest.raises(InputError, match=r"no calibration that is known \(its keys: model_type, camera_name"):
        single(tmp_path, text)


def test_intrinsics_and_extrinsics_may_be_xml_and_yaml(tmp_path: Path) -> None:
    """The halves are found by their names; each says what it is."""
    lenses = XML.partition("<R ")[0] + "</opencv_storage>\n"
    (tmp_path / "intrinsics.yml").write_text(lenses)
    (tmp_path / "extrinsics.yml").write_text(EXTRINSICS)
    assert same(read_calibration(tmp_path / "intrinsics.yml").cameras, RAW)
    assert "M1:" in INTRINSICS


def test_a_fisheye_of_orb_slam_needs_all_four(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"lacks Camera1\.k4, expected a number"):
        single(tmp_path, KB8.replace("Camera1.k4", "Camera1.k5"))


def test_stella_s_older_keys_are_read_as_its_newer_ones(tmp_path: Path) -> None:
    nested = stella("fisheye", *EQUI)
    flat, part = [], ""
    for line in nested.splitlines():
        part = line.rstrip(":") if line.endswith(":") and not line.startswith(" ") else part
        if line.startswith("  ") and ":" in line:
            flat.append(f"{part}.{line.strip()}")
    assert read_calibration_of(tmp_path, "\n".join(flat)) == read_calibration_of(tmp_path, nested)


def read_calibration_of(folder: Path, text: str) -> object:
    return single(folder, text).cameras


def test_the_cameras_of_a_t265_are_placed_by_their_poses_in_the_body(tmp_path: Path) -> None:
    file = json.loads(FURTHER["t265"].files["c.json"])
    angle = 2 * np.arctan2(0.14142135623730953, 0.98994949366116658)  # of the rotation (0.96, 0.28) about y
    file["cameras"][0]["extrinsics"] |= {"T": [1.0, 2.0, 3.0], "W": [0.0, 0.0, 0.0]}
    file["cameras"][1]["extrinsics"] |= {"T": [1.5, 2.0, 3.0], "W": [0.0, angle, 0.0]}
    cameras = single(tmp_path, json.dumps(file)).cameras
    assert isinstance(cameras, RawRig)
    turned = np.array([[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]]).T
    np.testing.assert_allclose(cameras.matrix[:3, :3], turned, atol=1e-12)
    np.testing.assert_allclose(cameras.matrix[:3, 3], turned @ (-0.5, 0, 0), atol=1e-12)


def test_a_t265_without_sizes_takes_that_of_the_images(tmp_path: Path) -> None:
    text = FURTHER["t265"].files["c.json"].replace("size_px", "note")
    (tmp_path / "c.json").write_text(text)
    assert read_calibration(tmp_path / "c.json", (640, 480)).origin["left.width"] == "given size"


def test_the_cameras_of_basalt_are_placed_by_their_poses_in_the_body(tmp_path: Path) -> None:
    file = json.loads(basalt("ucm", {"alpha": 0.5}, {"alpha": 0.5}))
    half = {"qx": 0.6, "qy": 0.0, "qz": 0.0, "qw": 0.8}
    file["value0"]["T_imu_cam"] = [pose | half for pose in file["value0"]["T_imu_cam"]]
    cameras = single(tmp_path, json.dumps(file)).cameras
    assert isinstance(cameras, RawRig)
    np.testing.assert_allclose(cameras.matrix[:3, 3], (-0.125, 0, 0), atol=1e-15)
    np.testing.assert_allclose(cameras.matrix[:3, :3], np.eye(3), atol=1e-15)
