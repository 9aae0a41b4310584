"""What a writer wrote, the reader reads: every format and every lens that it holds."""

from __future__ import annotations

import itertools
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.types import LENSES, Camera, RawRig, Rig
from tspslam.vision.calibration.formats import Calibration, read_calibration
from tspslam.vision.calibration.formats.writers import TARGETS, calibration_files
from tspslam.vision.calibration.formats.writers._numbers import as_raw, said
from tspslam.vision.calibration.rectify import rectification

from .formats_samples import RAW, RECTIFIED
from .formats_samples_lenses import EUCM, FISHEYES, MEI, PRISM, RATIONAL, SPHERES

RIGS = {
    "brown": RAW,
    "equidistant": FISHEYES,
    "double_sphere": SPHERES,
    "eucm": EUCM,
    "mei": MEI,
    "rational": RATIONAL,
    "thin_prism": PRISM,
}
HELD = [(to, lens) for to, target in TARGETS.items() for lens in target.lenses]
_ULP = 4.5e-16  # two units in the last place of 1


def read_back(cameras: Rig | RawRig, to: str) -> Calibration:
    files = calibration_files(cameras, to)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in files.items():
            Path(folder, name).write_text(text)
        return read_calibration(folder if TARGETS[to].is_folder else Path(folder, next(iter(files))))


def rectifies(cameras: RawRig) -> bool:
    try:
        rectification(cameras)
    except (InputError, ValueError, IndexError):
        return False
    return True


def check_same(found: Rig | RawRig, cameras: RawRig, to: str) -> None:
    """Equal; of ROS's poses and COLMAP's poses and principal points, to rounding."""
    assert isinstance(found, RawRig)
    if to in ("kalibr", "opencv"):
        assert found == cameras
        return
    np.testing.assert_allclose(found.matrix, cameras.matrix, rtol=0, atol=8 * _ULP * np.abs(cameras.matrix).max())
    for camera, expected in ((found.left, cameras.left), (found.right, cameras.right)):
        moved = dict.fromkeys(("cx", "cy"), 0.0) if to == "colmap" else {}
        assert replace(camera, **moved) == replace(expected, **moved)
        np.testing.assert_allclose((camera.cx, camera.cy), (expected.cx, expected.cy), rtol=_ULP, atol=1e-13)


@pytest.mark.parametrize(("to", "lens"), HELD)
def test_reading_inverts_writing(to: str, lens: str) -> None:
    if to == "ros" and not rectifies(RIGS[lens]):
        pytest.skip(f"a {lens} lens is not rectified, which ROS's files need")
    check_same(read_back(RIGS[lens], to).cameras, RIGS[lens], to)


number = st.floats(-0.5, 0.5).filter(lambda value: value != 0)
pixels = st.floats(1e-3, 1e6)


@st.composite
def rigs(draw: st.DrawFn) -> RawRig:
    lens = draw(st.sampled_from(sorted(LENSES)))
    cameras = []
    for _ in range(2):
        values = {name: draw(number) for name in LENSES[lens]}
        values |= {name: abs(values[name]) for name in ("alpha", "beta") if name in values}
        values |= {"beta": max(values["beta"], 1e-6)} if "beta" in values else {}
        values |= {"xi": abs(values["xi"])} if lens == "mei" else {}
        K = [draw(pixels) for _ in range(4)]
        cameras.append(Camera(*K, 640, 480, tuple(values.values()), lens=lens))
    R, t = cv2.Rodrigues(np.array([draw(number) for _ in range(3)]))[0], np.array([draw(number) for _ in range(3)])
    t = R @ (-abs(t[0]) - 0.01, *(abs(t[0]) * 0.5 * t[1:]))  # beside
    rows = [*map(tuple, np.column_stack([R, t]).tolist()), (0.0, 0.0, 0.0, 1.0)]
    return RawRig(cameras[0], cameras[1], tuple(rows))


@pytest.mark.parametrize("to", ["kalibr", "opencv", "colmap"])
@given(rigs())
@settings(max_examples=60, deadline=None)
def test_reading_inverts_writing_of_any_numbers(to: str, cameras: RawRig) -> None:
    if to == "kalibr" and cameras.left.lens == "brown":
        cameras = replace(cameras, left=_without_k3(cameras.left), right=_without_k3(cameras.right))
    if cameras.left.lens not in TARGETS[to].lenses:
        with pytest.raises(InputError, match=f"cannot be written for {to}, expected --to ours"):
            calibration_files(cameras, to)
        return
    check_same(read_back(cameras, to).cameras, cameras, to)


def _without_k3(camera: Camera) -> Camera:
    return replace(camera, distortion=(*camera.distortion[:4], 0.0))


@given(
    st.builds(
        Rig, fx=pixels, fy=pixels, cx=st.floats(0, 1e4), cy=st.floats(0, 1e4), baseline=st.floats(1e-3, 1e2),
        width=st.integers(1, 9999), height=st.integers(1, 9999), doffs=st.floats(-100, 100),
    )
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_a_rectified_pair_stays_one_in_opencv_and_ros(rig: Rig) -> None:
    for to in ("opencv", "ros"):
        found = read_back(rig, to).cameras
        assert isinstance(found, Rig)
        moved = {"baseline": 1.0, "doffs": 0.0}
        assert replace(found, **moved) == replace(rig, **moved)
        np.testing.assert_allclose(found.baseline, rig.baseline, rtol=_ULP)
        np.testing.assert_allclose(found.doffs, rig.doffs, rtol=0, atol=1e-11)


@pytest.mark.parametrize("to", ["kalibr", "colmap"])
def test_a_rectified_pair_becomes_two_cameras_without_distortion(to: str) -> None:
    check_same(read_back(RECTIFIED, to).cameras, as_raw(RECTIFIED), to)


def test_a_skew_is_kept_where_there_is_a_camera_matrix() -> None:
    skewed = replace(RAW, right=replace(RAW.right, skew=-0.25))
    assert read_back(skewed, "opencv").cameras == skewed
    found = read_back(skewed, "ros").cameras
    assert isinstance(found, RawRig)
    assert (found.left, found.right) == (skewed.left, skewed.right)
    for to in ("kalibr", "colmap"):
        with pytest.raises(InputError, match=rf"right camera's skew of -0\.25 px cannot be written for {to}"):
            calibration_files(skewed, to)


def test_a_lens_that_a_format_has_not_is_refused_with_those_that_have_it() -> None:
    for to, (lens, rig) in itertools.product(TARGETS, RIGS.items()):
        if (to, lens) not in HELD:
            able = " or ".join(["ours", *(name for name, target in TARGETS.items() if lens in target.lenses)])
            with pytest.raises(InputError, match=f"the left lens, {lens} .*for {to}, expected --to {able}$"):
                calibration_files(rig, to)


def test_what_a_format_has_no_place_for_is_refused() -> None:
    with_k3 = replace(RAW, left=replace(RAW.left, distortion=(0.1, 0.0, 0.0, 0.0, 0.02)))
    with pytest.raises(InputError, match=r"left lens has k3 0\.02, which kalibr's radtan has not, expected 0, or --to"):
        calibration_files(with_k3, "kalibr")
    check_same(read_back(with_k3, "colmap").cameras, with_k3, "colmap")
    mixed = replace(RAW, right=FISHEYES.right)
    with pytest.raises(InputError, match="one lens is brown, the other equidistant: opencv has one model for both"):
        calibration_files(mixed, "opencv")
    check_same(read_back(mixed, "kalibr").cameras, mixed, "kalibr")
    with pytest.raises(InputError, match="a single camera cannot be written for ros"):
        calibration_files(Rig(500, 500, 320, 240, width=640, height=480), "ros")
    with pytest.raises(InputError, match="format is 'euroc', expected one of kalibr, opencv, ros, colmap"):
        calibration_files(RAW, "euroc")


@pytest.mark.parametrize("lens", TARGETS["opencv"].lenses)
def test_opencv_reads_what_is_written_for_it(tmp_path: Path, lens: str) -> None:
    path = tmp_path / "stereo.yml"
    path.write_text(calibration_files(RIGS[lens], "opencv")["stereo.yml"])
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    T = np.hstack([storage.getNode("R").mat(), storage.getNode("T").mat()])
    np.testing.assert_array_equal(T, RIGS[lens].matrix[:3])
    assert tuple(storage.getNode("D2").mat().ravel()) == RIGS[lens].right.distortion
    assert storage.getNode("M1").mat()[0, 2] == RIGS[lens].left.cx
    assert storage.getNode("image_height").real() == 480


def test_numbers_are_numbers_to_yaml_1_1_too() -> None:
    """As in Kalibr and ROS: there, 1e-05 is a text."""
    tiny = replace(RAW, left=replace(RAW.left, distortion=(1e-05, -1e-300, 0.0, 5e-324, 0.0), cx=1e-9))
    chain = yaml.safe_load(calibration_files(tiny, "kalibr")["camchain.yaml"])
    assert chain["cam0"]["distortion_coeffs"] == [1e-05, -1e-300, 0.0, 5e-324]
    assert chain["cam0"]["intrinsics"][2] == 1e-9
    left = yaml.safe_load(calibration_files(replace(RAW, T_right_left=RAW.T_right_left), "ros")["left.yaml"])
    assert all(isinstance(value, float) for value in left["projection_matrix"]["data"])


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_is_written_with_all_its_digits(value: float) -> None:
    assert float(said(value)) == value
    assert isinstance(yaml.safe_load(f"- {said(value)}")[0], float)
