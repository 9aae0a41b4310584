"""Left and right images are found in the ways people name them, and each goes with its own partner."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam import cli
from tspslam.cli import jobs
from tspslam.datasets import EurocSequence, KittiSequence, StereoFolder, open_sequence
from tspslam.datasets._folder_images import FolderImages
from tspslam.datasets._sides import find_sides
from tspslam.errors import InputError
from tspslam.io.images import write_png
from tspslam.types import Rig
from tspslam.vision.calibration.formats.own import save_cameras

from . import standard

T = TypeVar("T")
RIG = Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)


def fill(folder: Path, left: list[str], right: list[str]) -> Path:
    """Images whose pixels tell their place in the lists: k on the left, 100 + k on the right."""
    for first, names in ((0, left), (100, right)):
        for k, name in enumerate(names):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_png(folder / name, np.full((10, 20), first + k, np.uint8))
    save_cameras(RIG, folder / "calib.yaml")
    return folder


def partners(folder: StereoFolder) -> list[tuple[int, int]]:
    return [(int(pair.left[0, 0]), int(pair.right[0, 0]) - 100) for pair in folder]


def value_or_line(call: Callable[[], T]) -> tuple[T | None, str]:
    """What a call gives, or the line of its InputError."""
    try:
        return call(), ""
    except InputError as error:
        return None, str(error)


WAYS = {
    "left01 right01": ("left{:02d}.png", "right{:02d}.png"),
    "left_000 right_000": ("left_{:03d}.png", "right_{:03d}.png"),
    "000_left 000_right": ("{:03d}_left.png", "{:03d}_right.png"),
    "Left Right": ("frameLeft{}.png", "frameRight{}.png"),
    "img_0_L img_0_R": ("img_{}_L.png", "img_{}_R.png"),
    "L0000 R0000": ("L{:04d}.png", "R{:04d}.png"),
    "bright": ("bright_left_{}.png", "bright_right_{}.png"),
    "cam0 cam1": ("cam0_{}.png", "cam1_{}.png"),
    "im0 im1": ("{}_im0.png", "{}_im1.png"),
    "folders": ("left/{}.png", "right/{}.png"),
    "capitals": ("Left/{}.png", "Right/{}.png"),
    "image_left": ("image_left/{}.png", "image_right/{}.png"),
    "tartanair": ("image_left/{:06d}_left.png", "image_right/{:06d}_right.png"),
    "image_l": ("image_l/{}.png", "image_r/{}.png"),
    "cameras": ("cam0/{}.png", "cam1/{}.png"),
    "camera_0": ("camera_0/{}.png", "camera_1/{}.png"),
    "infra": ("infra1/{}.png", "infra2/{}.png"),
    "names of their own": ("left/left{:02d}.jpg.png", "right/right{:02d}.jpg.png"),
    "only numbers alike": ("left/a_{:03d}.png", "right/frame{}.png"),
}


@pytest.mark.parametrize("way", WAYS)
def test_pairs_are_found_as_people_name_them(tmp_path: Path, way: str) -> None:
    left, right = ([name.format(k) for k in (0, 2, 10)] for name in WAYS[way])
    sequence = open_sequence(fill(tmp_path, left, right))
    assert type(sequence) is StereoFolder
    assert partners(sequence) == [(0, 0), (1, 1), (2, 2)]
    assert sequence.unpaired == []
    assert sequence.names == [pair.name for pair in sequence] == [Path(name).stem for name in left]


def test_a_lone_image_beside_others_is_reported(tmp_path: Path) -> None:
    sequence = open_sequence(
        fill(tmp_path, ["left1.png", "left2.png", "left9.png"], ["right2.png", "right1.png", "right7.png"])
    )
    assert partners(sequence) == [(0, 1), (1, 0)]
    assert sorted(sequence.unpaired) == ["left9.png", "right7.png"]


def test_images_go_before_depths_and_labels(tmp_path: Path) -> None:
    fill(tmp_path, ["image_left/0.png", "depth_left/0.png"], ["image_right/0.png", "depth_right/0.png"])
    assert partners(open_sequence(tmp_path)) == [(0, 0)]
    fill(tmp_path / "b", ["a_left/0.png", "b_left/0.png"], ["a_right/0.png", "b_right/0.png"])
    with pytest.raises(
        InputError, match="holds 2 pairs of folders with images: a_left and a_right, b_left and b_right; exp"
    ):
        open_sequence(tmp_path / "b")


def test_one_side_alone_is_no_layout(tmp_path: Path) -> None:
    for names in (["left1.png", "left2.png"], ["L/1.png"], ["bright_1.png", "bleft_1.png"], ["a.png", "b.png"]):
        folder = fill(tmp_path / names[0][:4], names, [])
        assert find_sides(folder) is None
        with pytest.raises(InputError, match="none of the known layouts"):
            open_sequence(folder)


@pytest.mark.parametrize("late", [0, 700, 12_000_000])
@pytest.mark.parametrize("unit", [1, 1000])
def test_stamps_that_nearly_agree_are_pairs_and_it_is_said(tmp_path: Path, late: int, unit: int) -> None:
    start, step = 1_403_715_273_262_142_976, 50_000_000
    left = [f"left/{(start + k * step) // unit}.png" for k in range(5)]
    right = [f"right/{(start + k * step + late) // unit}.png" for k in range(5) if k != 2]
    sequence = open_sequence(fill(tmp_path, left, right))
    assert partners(sequence) == [(0, 0), (1, 1), (3, 2), (4, 3)]
    assert sequence.unpaired == [left[2]]
    np.testing.assert_allclose(np.diff(sequence.stamps), [0.05, 0.1, 0.05], atol=1e-6)
    assert any("nearest stamps" in said for said in sequence.remarks) == ((start + late) // unit != start // unit)


@pytest.mark.parametrize("late", [13_000_000, 20_000_000, -24_000_000])
def test_a_side_that_is_steadily_late_by_less_than_half_a_frame_is_paired_and_it_is_said(
    tmp_path: Path, late: int
) -> None:
    start, step, rng = 10**18, 50_000_000, np.random.default_rng(0)
    left = [f"left/{start + k * step}.png" for k in range(9)]
    right = [f"right/{start + k * step + late + int(rng.integers(-4e5, 4e5))}.png" for k in range(9) if k not in (0, 4)]
    sequence = open_sequence(fill(tmp_path, left, right))
    assert partners(sequence) == [(k, k - (1 if k < 4 else 2)) for k in range(9) if k not in (0, 4)]
    assert any("over a quarter of a frame: where the camera moves" in said for said in sequence.remarks)


@pytest.mark.parametrize("late", [[25_000_000] * 6, [20_000_000, -20_000_000] * 3, [-24_000_000, 24_000_000] * 3])
def test_stamps_whose_partners_are_not_certain_are_no_pairs(tmp_path: Path, late: list[int]) -> None:
    """Half a frame apart, or now before and now after: the partner may be of the next frame."""
    left = [f"left/{10**18 + k * 50_000_000}.png" for k in range(len(late))]
    right = [f"right/{10**18 + k * 50_000_000 + each}.png" for k, each in enumerate(late)]
    with pytest.raises(InputError, match="6 files in left/ and 6 in right/ have no name in common"):
        open_sequence(fill(tmp_path, left, right))


def test_two_folders_are_a_sequence(tmp_path: Path) -> None:
    fill(tmp_path / "drive", ["a/0.png", "a/1.png"], ["b/0.png", "b/1.png"])
    sequence = open_sequence([tmp_path / "drive/a", tmp_path / "drive/b"])
    assert (sequence.name, partners(sequence)) == ("drive", [(0, 0), (1, 1)])
    fill(tmp_path / "x/same", ["0.png"], [])
    fill(tmp_path / "y/same", [], ["0.png", "5.png"])
    with pytest.raises(InputError, match="holds no calibration"):
        open_sequence([tmp_path / "drive/a", tmp_path / "y/same"])
    sequence = open_sequence((tmp_path / "x/same", tmp_path / "y/same"), calib=tmp_path / "drive/calib.yaml")
    assert (partners(sequence), sequence.unpaired) == ([(0, 0)], [f"{tmp_path}/y/same/5.png"])
    with pytest.raises(InputError, match="holds 3 folders"):
        StereoFolder([tmp_path] * 3)
    with pytest.raises(InputError, match="path is int"):
        StereoFolder([tmp_path, 7])  # type: ignore[list-item]


def test_the_command_line_takes_two_folders_and_a_rate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path, ["a/0.png", "a/1.png"], ["b/0.png", "b/1.png"])
    words = ["run", str(tmp_path / "a"), str(tmp_path / "b"), "--calib", str(tmp_path / "calib.yaml")]
    assert cli.exit_code([*words, "--fps", "20", "--frames", "5:6"]) == cli.BAD_INPUT
    assert capsys.readouterr().err.strip().endswith("--frames 5:6: selects none of the 2 frames")
    assert cli.exit_code([*words, "--topics", "/a", "/b"]) == cli.BAD_INPUT
    assert "is no bag" in capsys.readouterr().err
    assert cli.exit_code(["run", "--fps", "20"]) == cli.USAGE
    assert cli.exit_code(["run", "l.png", "r.png", "--calib", "c.yaml", "--fps", "20"]) == cli.USAGE


def test_what_stamps_are_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(tmp_path, ["left/0.png", "left/1.png"], ["right/0.png", "right/1.png"])
    for as_json, start in ((False, "note: stamps are numbers"), (True, '{"note": "stamps are numbers')):
        jobs._say_remarks(StereoFolder(tmp_path), as_json)
        assert capsys.readouterr().err.startswith(start)
    jobs._say_remarks(StereoFolder(tmp_path, fps=20), False)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("kind", [EurocSequence, KittiSequence])
def test_layouts_with_their_own_times_stay_what_they_are(tmp_path: Path, kind: type) -> None:
    folder = standard.euroc(tmp_path) if kind is EurocSequence else standard.odometry(tmp_path)
    for _ in range(2):
        assert type(open_sequence(folder)) is kind
        standard.write_images(folder, ["left1.png", "right1.png"])  # beside it
    with pytest.raises(InputError, match="has times of its own, expected no frames a second"):
        open_sequence(folder, fps=20)


def test_a_recording_of_asl_without_mav0_stays_one(tmp_path: Path) -> None:
    sequence = EurocSequence(standard.euroc(tmp_path))
    assert type(open_sequence(tmp_path / "mav0")) is EurocSequence
    np.testing.assert_array_equal(open_sequence(tmp_path / "mav0").stamps, sequence.stamps)


def test_shared_drive_of_kitti_is_a_plain_folder_too() -> None:
    folder = standard.shared("kitti_seq1")
    images = FolderImages(folder)
    assert (len(images), images.unpaired) == (len(list((folder / "image_l").iterdir())), [])


NAME = st.from_regex(r"(left|right|L|R|cam0|cam1|[a-z0-9_.-]{0,6}){1,3}[0-9]{0,20}\.png", fullmatch=True)


@settings(max_examples=80, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(names=st.lists(NAME, min_size=1, max_size=8, unique=True), inside=st.booleans(), seed=st.integers(0, 2**31))
def test_any_names_give_pairs_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, names: list[str], inside: bool, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("names")
    side = np.random.default_rng(seed).integers(0, 2, len(names))
    for k, name in enumerate(names):
        place = folder / ("left", "right")[side[k]] if inside else folder
        place.mkdir(exist_ok=True)
        (place / name).write_bytes(b"x")
    images, line = value_or_line(lambda: FolderImages(folder))
    assert "\n" not in line
    if images is None:
        return
    used = [file for pair in images.files for file in pair]
    assert len(set(used)) == len(used) == 2 * len(images)
    assert len(images.stamps) == len(images)
    assert np.isfinite(images.stamps).all()
    assert (np.diff(images.stamps) > 0).all()
