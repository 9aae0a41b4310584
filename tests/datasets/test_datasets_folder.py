from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tspslam.datasets import StereoFolder, pair_from_files
from tspslam.errors import InputError
from tspslam.io.images import write_png
from tspslam.types import RawRig, Rig, StereoPair
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.calibration.rectify import rectification

RIG = Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)


def fill(folder: Path, left: list[str], right: list[str]) -> Path:
    for side, names in (("left", left), ("right", right)):
        (folder / side).mkdir()
        for value, name in enumerate(names):
            write_png(folder / side / name, np.full((10, 20), value, np.uint8))
    save_cameras(RIG, folder / "calib.yaml")
    return folder


def test_files_pair_by_name_in_natural_order(tmp_path: Path) -> None:
    left, right = ["f10.png", "f2.png", "a.png", "only.png"], ["a.png", "f2.png", "f10.png", "other.png"]
    folder = StereoFolder(fill(tmp_path, left, right))
    assert folder.names == ["a", "f2", "f10"]
    assert folder.unpaired == ["left/only.png", "right/other.png"]
    assert folder.rig == RIG
    assert len(folder) == 3
    pair = folder[1]
    assert (pair.index, pair.name, pair.left[0, 0], pair.right[0, 0]) == (1, "f2", 1, 1)
    assert [pair.left[0, 0] for pair in folder] == [2, 1, 0]
    assert folder[-1].index == 2
    with pytest.raises(IndexError):
        folder[3]


def test_other_files_are_passed_over(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["a.png"])
    (tmp_path / "left" / "notes.txt").write_text("x")
    (tmp_path / "left" / ".hidden.png").write_text("x")
    folder = StereoFolder(str(tmp_path))
    assert (len(folder), folder.unpaired) == (1, [])


def test_pair_from_files_is_the_same_pair(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["b.png"])
    pair = pair_from_files(tmp_path / "left" / "a.png", str(tmp_path / "right" / "b.png"), tmp_path / "calib.yaml")
    assert (pair.name, pair.rig, pair.left.shape) == ("a", RIG, (10, 20))


def test_a_pair_knows_the_range_of_disparities_that_its_calibration_tells(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["b.png"])
    files = tmp_path / "left" / "a.png", tmp_path / "right" / "b.png"
    matrix = "[50 0 10; 0 50 5; 0 0 1]"
    text = f"cam0={matrix}\ncam1={matrix}\nbaseline=100\nwidth=20\nheight=10\nndisp=6\n"
    for more, expected in (("", (0, 6)), ("vmin=2\nvmax=5\n", (2, 5))):
        (tmp_path / "calib.txt").write_text(text + more)
        assert pair_from_files(*files, tmp_path / "calib.txt").disparity_range == expected
    for calib in (tmp_path / "calib.yaml", RIG):
        assert pair_from_files(*files, calib).disparity_range is None


def test_images_that_do_not_fit_the_calibration_are_refused(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["a.png"])
    write_png(tmp_path / "right" / "a.png", np.zeros((10, 21), np.uint8))
    with pytest.raises(InputError, match="right 21 x 10 px"):
        StereoFolder(tmp_path)[0]
    (tmp_path / "right" / "a.png").write_bytes(b"not an image")
    with pytest.raises(InputError, match=r"a\.png"):
        StereoFolder(tmp_path)[0]


def test_digits_that_are_not_ascii_are_letters(sequence: Path) -> None:
    for side in ("left", "right"):
        (sequence / side / "000.png").rename(sequence / side / "²1.png")
    assert StereoFolder(sequence).names == ["001", "002", "²1"]


def test_incomplete_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lacks the folder left"):
        StereoFolder(tmp_path)
    (tmp_path / "left").mkdir()
    with pytest.raises(InputError, match="lacks the folder right"):
        StereoFolder(tmp_path)
    (tmp_path / "right").mkdir()
    with pytest.raises(InputError, match="0 files in left/ and 0 in right/ have no name in common"):
        StereoFolder(tmp_path)


def test_the_calibration_of_another_program_is_found_in_the_folder_or_given(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["a.png"])
    (tmp_path / "calib.yaml").rename(tmp_path / "ours.yaml")
    (tmp_path / "calib.txt").write_text("P0: 50 0 10 0 0 50 5 0 0 0 1 0\nP1: 50 0 10 -5 0 50 5 0 0 0 1 0\n")
    assert StereoFolder(tmp_path).rig == RIG
    (tmp_path / "calib.txt").unlink()
    assert StereoFolder(tmp_path, tmp_path / "ours.yaml")[0].rig == RIG


def test_raw_pairs_are_rectified_as_they_are_read(tmp_path: Path, raw_pair: tuple[StereoPair, RawRig]) -> None:
    pair, raw = raw_pair
    for side, image in (("left", pair.left), ("right", pair.right)):
        (tmp_path / side).mkdir()
        write_png(tmp_path / side / "a.png", image)
    save_cameras(raw, tmp_path / "calib.yaml")
    made = rectification(raw)
    expected = made(pair.left, pair.right)
    folder = StereoFolder(tmp_path)
    one = pair_from_files(tmp_path / "left/a.png", tmp_path / "right/a.png", tmp_path / "calib.yaml")
    for read in (folder[0], one):
        assert read.rig == folder.rig == made.rig
        np.testing.assert_array_equal(read.left, expected[0])
        np.testing.assert_array_equal(read.right, expected[1])
    write_png(tmp_path / "right" / "a.png", pair.right[:-2])
    with pytest.raises(InputError, match="a: right image is 741 x 498 px, but its camera has 741 x 500 px"):
        folder[0]


def test_a_folder_without_a_calibration_says_where_one_may_be(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["a.png"])
    elsewhere = (tmp_path / "calib.yaml").rename(tmp_path / "elsewhere.yaml")
    with pytest.raises(InputError, match=r"holds no calibration, expected calib\.yaml, .* or a file by --calib"):
        StereoFolder(tmp_path)
    assert StereoFolder(tmp_path, elsewhere).names == ["a"]


def test_two_files_of_one_name_are_refused(tmp_path: Path) -> None:
    fill(tmp_path, ["a.png"], ["a.png"])
    (tmp_path / "left" / "a.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"a\.jpg and a\.png in left/ share a name"):
        StereoFolder(tmp_path)


def test_a_pair_of_floats_stays_within_0_and_1_when_it_is_rectified(
    tmp_path: Path, raw_pair: tuple[StereoPair, RawRig]
) -> None:
    pair, raw = raw_pair
    for side, image in (("left", pair.left), ("right", pair.right)):
        (tmp_path / side).mkdir()
        grey = np.asarray(image if image.ndim == 2 else image[..., 1])
        values = (grey > np.median(grey)).astype("<f4")  # edges from 0 to 1
        (tmp_path / side / "a.pfm").write_bytes(b"Pf\n%d %d\n-1.0\n" % values.shape[::-1] + values[::-1].tobytes())
    save_cameras(raw, tmp_path / "calib.yaml")
    read = StereoFolder(tmp_path)[0]
    assert read.left.dtype == np.float32
    assert (read.left.min(), read.left.max()) == (0, 1)
