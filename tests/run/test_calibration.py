"""``tspslam calib convert``: to our format and to those of other programs, and what it may overwrite."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.vision.calibration.formats_samples import RAW, RECTIFIED, SAMPLES
from tspslam import cli, read_calibration
from tspslam.errors import InputError
from tspslam.run.calibration import FORMATS, convert
from tspslam.types import RawRig, Rig
from tspslam.vision.calibration.formats.own import save_cameras

Capture = pytest.CaptureFixture[str]


def type_in(*words: object) -> int:
    return cli.exit_code([str(word) for word in words])


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    return SAMPLES["kalibr"].write(tmp_path / "raw")


@pytest.fixture
def rectified(tmp_path: Path) -> Path:
    save_cameras(RECTIFIED, tmp_path / "rectified.yaml")
    return tmp_path / "rectified.yaml"


def test_the_command_writes_every_format(tmp_path: Path, raw: Path, capsys: Capture) -> None:
    for to in FORMATS:
        output = tmp_path / f"{to}.yaml"
        assert type_in("calib", "convert", raw, output, "--to", to) == 0
        assert f"wrote {output}" in capsys.readouterr().out
        cameras = read_calibration(output).cameras
        assert isinstance(cameras, RawRig)
        assert cameras.left.distortion == RAW.left.distortion
        assert cameras.matrix == pytest.approx(RAW.matrix, abs=1e-14)
    assert sorted(path.name for path in (tmp_path / "ros.yaml").glob("*.yaml")) == ["left.yaml", "right.yaml"]


def test_a_rectified_pair_is_written_for_ros_and_opencv_as_one(tmp_path: Path, raw: Path, capsys: Capture) -> None:
    for to in ("ours", "opencv", "ros"):
        output = tmp_path / f"{to}.yaml"
        assert type_in("calib", "convert", raw, output, "--rectify", "--to", to, "--json") == 0
        found = json.loads(capsys.readouterr().out)
        assert found["written"] == str(output)
        assert isinstance(read_calibration(output).cameras, Rig)


def test_an_earlier_folder_is_replaced_by_force_alone(tmp_path: Path, raw: Path, capsys: Capture) -> None:
    output = tmp_path / "infos"
    assert type_in("calib", "convert", raw, output, "--to", "ros") == 0
    assert type_in("calib", "convert", raw, output, "--to", "ros") == 3
    assert "is there; expected a free name, or --force" in capsys.readouterr().err
    assert type_in("calib", "convert", raw, output, "--to", "ros", "--force") == 0
    assert type_in("calib", "convert", raw, output, "--to", "colmap", "--force") == 3
    (output / "mine.txt").write_text("mine")
    assert type_in("calib", "convert", raw, output, "--to", "ros", "--force") == 3
    assert "holds mine.txt, which no export wrote" in capsys.readouterr().err
    assert (output / "mine.txt").read_text() == "mine"


def test_the_folder_of_the_input_is_no_output(raw: Path, capsys: Capture) -> None:
    for more in ([], ["--force"]):
        assert type_in("calib", "convert", raw, raw.parent, "--to", "ros", *more) == 3
        assert "holds the input" in capsys.readouterr().err
        assert type_in("calib", "convert", raw, raw, "--to", "kalibr", *more) == 3
        assert "is the input" in capsys.readouterr().err
    assert raw.read_text() == SAMPLES["kalibr"].files["camchain.yaml"]


def test_a_file_of_another_format_is_overwritten_by_force_alone(tmp_path: Path, raw: Path, capsys: Capture) -> None:
    output = tmp_path / "out.yaml"
    for to, before in (("kalibr", "opencv"), ("opencv", "ours"), ("ours", "kalibr")):
        output.unlink(missing_ok=True)
        assert type_in("calib", "convert", raw, output, "--to", before) == 0
        assert type_in("calib", "convert", raw, output, "--to", before) == 0
        content = output.read_bytes()
        assert type_in("calib", "convert", raw, output, "--to", to) == 3
        assert "is there and is no" in capsys.readouterr().err
        assert output.read_bytes() == content
        assert type_in("calib", "convert", raw, output, "--to", to, "--force") == 0


def test_a_field_of_view_stands_in_our_own_file_alone(tmp_path: Path, raw: Path, rectified: Path) -> None:
    assert type_in("calib", "convert", raw, tmp_path / "a", "--to", "ros", "--fov", "100") == 2
    assert type_in("calib", "convert", raw, tmp_path / "a", "--rectify", "--fov", "100") == 2
    assert type_in("calib", "convert", raw, tmp_path / "a", "--fov", "171") == 2
    with pytest.raises(InputError, match=r"rectified\.yaml: a field of view is for raw cameras"):
        convert(rectified, tmp_path / "a", field_of_view=90.0)
    assert not (tmp_path / "a").exists()


def test_a_field_of_view_is_read_back(tmp_path: Path, raw: Path) -> None:
    convert(raw, tmp_path / "calib.yaml", field_of_view=60.0)
    cameras = read_calibration(tmp_path / "calib.yaml").cameras
    assert isinstance(cameras, RawRig)
    if cameras.field_of_view is None:
        pytest.skip("our own file holds no field of view")
    assert cameras.field_of_view == 60.0
    said = convert(tmp_path / "calib.yaml", tmp_path / "infos", "ros")
    assert any("field of view is not written for ros" in line for line in said)


def test_what_a_format_cannot_hold_is_said_with_the_file(tmp_path: Path, raw: Path, rectified: Path, capsys: Capture) -> None:  # fmt: skip
    with_k3 = replace(RAW, left=replace(RAW.left, distortion=(-0.3, 0.1, 0.0, 0.0, 0.01)))
    save_cameras(with_k3, tmp_path / "k3.yaml")
    assert type_in("calib", "convert", tmp_path / "k3.yaml", tmp_path / "out.yaml", "--to", "kalibr") == 3
    line = capsys.readouterr().err
    assert "k3.yaml: the left lens has k3 0.01, which kalibr's radtan has not" in line
    assert not (tmp_path / "out.yaml").exists()
    assert type_in("calib", "convert", raw, tmp_path / "out.yaml", "--to", "euroc") == 2
    assert "'euroc', expected one of ours, kalibr, opencv, ros, colmap" in capsys.readouterr().err
    assert type_in("calib", "convert", raw, tmp_path / "no" / "out", "--to", "ros") == 5
    assert type_in("calib", "convert", raw, tmp_path / "no" / "out", "--to", "kalibr") == 5
