from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam._yaml import LARGEST_FILE
from tspslam.errors import InputError, OutputError
from tspslam.types import LENSES, Camera, RawRig, Rig
from tspslam.vision.calibration.formats import read_calibration
from tspslam.vision.calibration.formats.own import load_cameras, load_rig, save_cameras
from tspslam.vision.calibration.show import described, unit_of

GOOD = {"fx": "500.0", "fy": "500", "cx": "320", "cy": "240", "baseline": "0.1", "width": "640", "height": "480"}


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "calib.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def lines(**changes: str | None) -> str:
    return "".join(f"{key}: {value}\n" for key, value in {**GOOD, **changes}.items() if value is not None)


def raw(**changes: str | None) -> str:
    parts: dict[str, str | None] = {
        "left": "{distortion: [-0.3, 0.1, 0, 0]}",
        "right": "{fx: 501, fy: 502, cx: 321, cy: 239, distortion: [-0.2, 0.1, 0.001, 0, 0.01]}",
        "T_right_left": "[[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
    }
    return lines(**(parts | changes))


def test_raw_cameras_are_read(tmp_path: Path) -> None:
    cameras = load_cameras(write(tmp_path, raw()))
    assert isinstance(cameras, RawRig)
    assert cameras.left == Camera(500, 500, 320, 240, 640, 480, (-0.3, 0.1, 0, 0, 0))
    assert cameras.right == Camera(501, 502, 321, 239, 640, 480, (-0.2, 0.1, 0.001, 0, 0.01))
    assert cameras.T_right_left[0] == (1, 0, 0, -0.1)
    assert load_cameras(write(tmp_path, raw(baseline=None))) == cameras
    with pytest.raises(InputError, match=r"describes raw cameras .*, expected a rectified pair"):
        load_rig(write(tmp_path, raw()))


def test_loading_inverts_saving_of_raw_cameras(tmp_path: Path) -> None:
    left = Camera(500.25, 499.0, 320.0, 240.0, 640, 480, (-0.3, 1e-5, 0.0, 0.0, 0.0), skew=0.5)
    turn = np.array([[0.8, -0.6, 0, -0.1], [0.6, 0.8, 0, 0.01], [0, 0, 1, 0], [0, 0, 0, 1]])
    cameras = RawRig(left, replace(left, cx=np.float64(330.5)), tuple(map(tuple, turn.tolist())))
    save_cameras(cameras, tmp_path / "c.yaml")
    assert load_cameras(tmp_path / "c.yaml") == cameras


COEFFICIENTS = {"double_sphere": (-0.2, 0.59), "eucm": (0.6, 1.1), "mei": (1.2, -0.2, 0.05, 0.001, -0.001)}


@pytest.mark.parametrize("lens", sorted(LENSES))
def test_every_lens_is_read_as_it_was_written(tmp_path: Path, lens: str) -> None:
    distortion = COEFFICIENTS.get(lens, tuple(0.001 * k for k in range(len(LENSES[lens]))))
    left = Camera(200.0, 201.0, 320.0, 240.0, 640, 480, distortion, lens=lens)
    T = load_cameras(write(tmp_path, raw())).T_right_left
    for right, field_of_view in ((left, 100.0), (Camera(200.0, 201.0, 320.0, 240.0, 640, 480), None)):
        cameras = RawRig(left, right, T, field_of_view)
        save_cameras(cameras, tmp_path / "calib.yaml")
        assert load_cameras(tmp_path / "calib.yaml") == cameras
        assert ("field_of_view" in (tmp_path / "calib.yaml").read_text()) == (field_of_view is not None)
        assert read_calibration(tmp_path / "calib.yaml").cameras == cameras


def test_a_lens_is_shown_with_its_coefficients_and_fields_of_view(tmp_path: Path) -> None:
    lens = "{lens: equidistant, distortion: [0.01, 0, 0, 0], fx: 200, fy: 200, cx: 320, cy: 240}"
    shown = described(write(tmp_path, raw(left=lens, right=lens, field_of_view="100")))["values"]
    assert shown["left.lens"] == {"value": "equidistant", "origin": "left.lens"}
    assert shown["right.k1"] == {"value": 0.01, "origin": "right.distortion[0]"}
    assert shown["field_of_view"] == {"value": 100.0, "origin": "field_of_view"}
    assert 160 < shown["left.field_of_view"]["value"] < 183
    assert shown["rectified.field_of_view"]["value"] == pytest.approx(100, abs=0.2)  # between centres of pixels
    assert unit_of("rectified.field_of_view") == "°"
    assert "left.p1" not in shown
    plain = described(write(tmp_path, raw()))["values"]
    assert plain["left.lens"] == {"value": "brown", "origin": "by default"}
    assert "field_of_view" not in plain


def test_plain_numbers_are_read(tmp_path: Path) -> None:
    rig = load_rig(write(tmp_path, lines(skew="-0.5", doffs="1.0e+1")))
    assert rig == Rig(500, 500, 320, 240, 0.1, 640, 480, -0.5, 10)
    assert load_rig(write(tmp_path, lines(doffs="1e1"))).doffs == 10
    assert load_rig(str(write(tmp_path, lines()))).doffs == 0


finite = st.floats(-1e7, 1e7)
positive = st.floats(1e-3, 1e6)
size = st.integers(1, 1_000_000)


@given(
    st.builds(
        Rig, fx=positive, fy=positive, cx=finite, cy=finite, baseline=positive, width=size, height=size, skew=finite,
        doffs=finite,
    )
)  # fmt: skip
@settings(max_examples=50, deadline=None)
def test_loading_inverts_saving(rig: Rig) -> None:
    with tempfile.TemporaryDirectory() as folder:
        save_cameras(rig, Path(folder, "c.yaml"))
        assert load_rig(Path(folder, "c.yaml")) == rig


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected a calibration file"),
        ("# nothing\n", "is blank, expected a mapping"),
        ("- 1\n", "is a list"),
        ("fx: [1\n", "is not plain YAML"),
        (b"\xff\xfe\x00", "is no text"),
        ("a: &x 1\nb: *x\n", "anchors and aliases .* line 1"),
        ("b: *x\n", "anchors and aliases"),
        ("fx: !!float 1\n", "the tag .* is not allowed"),
        ("fx: !!python/name:os.system 1\n", "the tag"),
        (lines() + "fx: 3\n", "the key fx is there twice"),
        ("? [1, 2]\n: 3\n", "is not plain YAML"),
        (lines(focal="3"), "unknown key 'focal'; expected"),
        (lines(basline="3"), "unknown key 'basline'; did you mean baseline"),
        (lines(**{"1": "3"}), "unknown key '1'"),
        (lines(left="{distortion: [1]}"), "lacks right, T_right_left"),
        (lines(T_right_left="[1]"), "lacks left, right"),
        (raw(left="3"), "left is 3, expected a mapping"),
        (raw(left="{distortion: [1, 2]}"), r"left.distortion is \[1, 2\], expected \[k1, k2, p1, p2, k3\]"),
        (raw(left="{distortion: [1, 2, 3, x, 5]}"), "left.distortion is 'x', expected a number"),
        (raw(left="{distortion: [1e9, 0, 0, 0, 0]}"), "left camera: k1 is 1000000000.0, expected a number from"),
        (raw(left="{k1: 3}"), "left: unknown key 'k1'"),
        (raw(right="{fx: 500}"), "right: lacks fy, cx, cy"),
        (raw(right="{fx: -1, fy: 500, cx: 1, cy: 1}"), "right camera: fx is -1.0, expected a number from 0.001"),
        (raw(T_right_left="[[1, 0, 0, 0]]"), "T_right_left is .* expected four rows of four numbers"),
        (raw(T_right_left="[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"), "distance of the cameras"),
        (raw(T_right_left="[[2, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"), "no rotation"),
        (raw(T_right_left="[[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]"), "last row 0 0 0 1"),
        (raw(baseline="0.2"), "baseline is 0.2 m, but T_right_left moves by 0.1 m"),
        (raw(doffs="3"), "unknown key 'doffs'"),
        (lines(fx=None, cy=None), "lacks fx, cy"),
        (lines(fx="'500'"), "fx is '500', expected a number without quotes"),
        (lines(fx="wide"), "fx is 'wide', expected a number"),
        (lines(cx="true"), "cx is True, expected a number"),
        (lines(cx="null"), "cx is None"),
        (lines(cx="[1, 2]"), "cx is"),
        (lines(cx="2020-01-01"), "cx is '2020-01-01', expected a number"),
        (lines(width="640.5"), "width is 640.5, expected a whole number"),
        (lines(width="0"), "width is 0"),
        (lines(height="-3"), "height is -3"),
        (lines(height="9999999999"), "height is 9999999999, expected a whole number from 1 to 1000000"),
        (lines(fx=".nan"), "fx is nan, expected a number from 0.001 to 10000000"),
        (lines(cx="-.inf"), "cx is -inf"),
        (lines(fx="1.0e+299"), "fx is 1e\\+299, expected"),
        (lines(baseline="1e290"), "baseline is 1e\\+290"),
        (lines(doffs="1e200"), "doffs is 1e\\+200"),
        (lines(fx="1e-300"), "fx is 1e-300"),
        (
            raw(left="{lens: fisheye}"),
            "left.lens is 'fisheye', expected one of brown, rational, thin_prism, equidistant",
        ),
        (raw(left="{lens: [mei]}"), r"left.lens is \['mei'\], expected one of brown"),
        (raw(left="{lens: eucm}"), r"left.distortion is missing, expected \[alpha, beta\]"),
        (raw(left="{lens: mei, distortion: [1, 2]}"), r"left.distortion is .*, expected \[xi, k1, k2, p1, p2\]"),
        (raw(left="{lens: eucm, distortion: [2, 1]}"), "left camera: alpha is 2.0, expected a number from 0 to 1"),
        (raw(field_of_view="180"), "field_of_view, degrees, is 180.0, expected a number from 1 to 170"),
        (raw(field_of_view="wide"), "field_of_view is 'wide', expected a number"),
        (lines(field_of_view="90"), "unknown key 'field_of_view'"),
        (lines(cx="16:34"), "cx is '16:34', expected a number"),
        (lines(cx="0x1F"), "cx is '0x1F', expected a number"),
        ("<<: {fx: 1}\n", "unknown key '<<'"),
        (lines(fx="0"), "fx is 0"),
        (lines(baseline="-0.1"), "baseline is -0.1"),
        (lines(cx="1" + "0" * 400), "cx is"),
        ("a: " + "[" * 5000, "is not plain YAML"),
        ("x" * (LARGEST_FILE + 1), "has 1048577 bytes; expected a calibration file of at most 1048576"),
    ],
)
def test_bad_files_are_refused_with_their_name(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        load_rig(write(tmp_path, text))
    assert "calib.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600


def test_missing_files_and_folders_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path, Path("a\0b")):
        with pytest.raises(InputError, match=r"cannot be opened|is a directory"):
            load_rig(path)


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "calib.yaml")
    with pytest.raises(InputError, match="not a regular file"):
        load_rig(tmp_path / "calib.yaml")


def test_saving_into_nowhere_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        save_cameras(Rig(1, 1, 1, 1, 1, 1, 1), tmp_path / "none" / "calib.yaml")


WORDS = """skew left : - 1 640 . e5 !!int &a *a { } [ ] ' " 0x1F 1:30 << ? | > .inf .nan = ~ \u2028 \x00"""
pieces = st.sampled_from([*GOOD, *WORDS.split(), " ", "\n", "\t", ": ", "- ", "\u2028", "%YAML 1.1\n---\n"])


@given(st.lists(pieces, max_size=30).map("".join) | st.binary(max_size=60).map(lambda b: b.decode("latin-1")))
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_file_gives_a_rig_or_an_input_error(text: str) -> None:
    for content in (text, lines() + text):
        with tempfile.TemporaryDirectory() as folder:
            try:
                assert isinstance(load_rig(write(Path(folder), content)), Rig)
            except InputError as error:
                assert "\n" not in str(error)  # noqa: PT017
