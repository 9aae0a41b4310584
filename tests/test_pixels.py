"""What a run says of its pixels and maps: their bits, their unknown values, clouds that are almost empty, one picture."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from tspslam.io import write_ply, write_png
from tspslam.run.config import resolve
from tspslam.run.pipeline import run

from .run.test_pipeline import Pairs
from .sequences import SETTINGS, corridor, write_sequence
from .test_cli import complain, content, run_pair, small_depth, type_in


def written_with(folder, small_pair, bits):
    """The small pair in grey of some bits in 16."""
    for side, image in zip(("left", "right"), small_pair[:2], strict=True):
        grey = cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2GRAY)
        write_png(folder / f"{side}.png", np.rint(grey * ((1 << bits) - 1)).astype(np.uint16))


def codes(result):
    """Codes of the warnings."""
    return [each["code"] for each in result["warnings"]]


@pytest.fixture
def points_at_16_bits(capsys, pair_files, small_pair):
    written_with(pair_files, small_pair, 16)
    result = json.loads(run_pair(capsys, pair_files, "--json")[1])
    assert codes(result) == []
    assert result["calibration"]["bits"] == 16
    (pair_files / "out").rename(pair_files / "whole")
    return result["complex"]["n"]


@pytest.mark.parametrize("bits", [10, 12])
def test_pixels_of_few_bits_give_as_many_points_and_it_is_said(capsys, pair_files, small_pair, points_at_16_bits, bits):
    written_with(pair_files, small_pair, bits)
    code, out, err = run_pair(capsys, pair_files, "--json")
    result = json.loads(out)
    assert (code, codes(result), result["calibration"]["bits"]) == (0, ["bits"], bits)
    assert f"16-bit pixels use {bits} bits: taken {1 << (16 - bits)} times as bright (--bits for another" in err
    assert result["complex"]["n"] == pytest.approx(points_at_16_bits, rel=0.1)  # keypoints at the edge of a threshold
    first = content(pair_files / "out")
    assert run_pair(capsys, pair_files)[0] == 0
    assert content(pair_files / "out") == first


def test_an_almost_empty_cloud_is_a_warning(capsys, pair_files, small_pair):
    written_with(pair_files, small_pair, 12)
    code, out, err = run_pair(capsys, pair_files, "--json", "--bits", "16")
    result = json.loads(out)
    assert (code, codes(result)) == (0, ["few_points"])
    assert result["complex"]["n"] < 0.08 * 1200
    assert "1 of 1 clouds are almost empty, first frame 0: " in err
    assert "where 1200 are usual" in err


def test_an_almost_empty_frame_of_a_sequence_is_a_warning(tmp_path):
    sequence = corridor(2.0)
    pairs = [sequence[k] for k in range(4)]
    pairs[2] = replace(pairs[2], left=pairs[2].left // 10, right=pairs[2].right // 10)
    settings = resolve(assignments=[*SETTINGS, "tracking.every_frame=true"])
    result = run(Pairs(sequence.rig, pairs), tmp_path / "out", settings).run
    said = next(each["message"] for each in result["warnings"] if each["code"] == "few_points")
    assert "1 of 4 clouds are almost empty, first frame 2: " in said


def test_a_sequence_says_its_bits(capsys, tmp_path):
    folder = write_sequence(tmp_path / "drive", corridor(2.0))
    for path in folder.rglob("*.png"):
        write_png(path, np.asarray(Image.open(path)).astype(np.uint16) * 4 + 3)
    words = "run", folder, "--out", tmp_path / "out", "--json", "--set", SETTINGS[0], "--frames", "0:3"
    code, out, _ = type_in(capsys, *words)
    result = json.loads(out)
    assert (code, codes(result), result["calibration"]["bits"]) == (0, ["bits"], 10)
    assert not any("bits" in row for row in result["per_frame"])
    code, _, err = type_in(capsys, *words, "--bits", "9")
    assert code == 3
    assert "of the pixels are above 511, the most that 9 bits hold, expected bits=10" in err.splitlines()[-1]


def test_the_image_of_a_filter_fills_its_range(capsys, tmp_path, pair_files, small_pair):
    written_with(pair_files, small_pair, 12)
    x = middle_at_5_m(small_pair[2])
    corners = np.array([[x - 0.1, -0.1, 5], [x + 0.1, -0.1, 5], [x, 0.1, 5]])
    write_ply(tmp_path / "mesh.ply", corners, np.array([[0, 1, 2]], np.int32))
    words = ["filter", tmp_path / "mesh.ply", "--image", pair_files / "left.png", "--calib", pair_files / "calib.yaml"]
    for given, bits in (((), 12), (("--bits", "14"), 14)):
        code, out, _ = type_in(capsys, *words, "--out", tmp_path / f"out{bits}", "--json", *given)
        result = json.loads(out)
        assert (code, result["bits"], "bits" in codes(result)) == (0, bits, True)


def middle_at_5_m(rig):
    """x, m, of the middle of the image at 5 m."""
    return 5 * ((rig.width - 1) / 2 - rig.cx) / rig.fx


def test_unknown_values_of_a_map_are_said_or_given(capsys, pair_files, motorcycle_truth_piece):
    depth = small_depth(pair_files, motorcycle_truth_piece)
    depth[depth == 0] = 65_535
    Image.fromarray(depth).save(pair_files / "z.png")
    words = ["run", pair_files / "left.png", "--calib", pair_files / "calib.yaml", "--json", "--unit", "0.001"]
    code, out, err = type_in(capsys, *words, "--depth", pair_files / "z.png", "--out", pair_files / "found")
    found = json.loads(out)
    assert (code, codes(found)) == (0, ["unknown"])
    assert "65535 in the map stands for 'not known', by how common it is (--unknown for another value)" in err
    _, out, _ = type_in(
        capsys, *words, "--depth", pair_files / "z.png", "--out", pair_files / "given", "--unknown", "65535"
    )
    given = json.loads(out)
    assert codes(given) == []
    assert given["complex"] == found["complex"]


def test_unknown_and_bits_go_with_what_has_them(capsys):
    assert complain(capsys, "run", "a.png", "b.png", "--calib", "c.yaml", "--unknown", "0")[0] == 2
    assert complain(capsys, "run", "--bits", "12")[0] == 2
    assert complain(capsys, "run", "a.png", "b.png", "--calib", "c.yaml", "--bits", "17")[0] == 2


def test_one_picture_twice_is_no_pair(capsys, pair_files):
    words = ["run", pair_files / "left.png", pair_files / "left.png", "--calib", pair_files / "calib.yaml"]
    code, line = complain(capsys, *words, "--out", pair_files / "out")
    assert code == 3
    assert line == "tspslam: left: left and right show the same picture, expected two views of one scene"


def test_a_frame_of_one_picture_twice_is_skipped_and_a_sequence_of_them_refused(capsys, tmp_path):
    folder = write_sequence(tmp_path / "drive", corridor(2.0))
    (folder / "right/002.png").write_bytes((folder / "left/002.png").read_bytes())
    code, out, _ = type_in(capsys, "run", folder, "--out", tmp_path / "out", "--json", "--set", SETTINGS[0])
    result = json.loads(out)
    assert (code, codes(result)[0]) == (4, "frame_skipped")
    assert "frame 2: 002: left and right show the same picture" in result["warnings"][0]["message"]
    for path in (folder / "left").iterdir():
        (folder / "right" / path.name).write_bytes(path.read_bytes())
    code, _, err = type_in(capsys, "run", folder, "--out", tmp_path / "none", "--set", SETTINGS[0])
    assert code == 3
    assert "can be used; the last: " in err
    assert "left and right show the same picture" in err.splitlines()[-1]
