from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tspslam.datasets.kitti import KittiSequence
from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.calibration.formats import read_calibration
from tspslam.vision.calibration.rectify import rectification

DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
ODOMETRY = "P0: 60 0 32 0 0 60 24 0 0 0 1 0\nP1: 60 0 32 -30 0 60 24 0 0 0 1 0\n"
COLOUR = "P2: 60 0 32 3 0 60 24 0.3 0 0 1 0.01\nP3: 60 0 32 -27 0 60 24 0.36 0 0 1 0.011\n"
RAW = """calib_time: 09-Jan-2012 13:57:47
S_00: 64 48
K_00: 60 0 32 0 60 24 0 0 1
D_00: -0.1 0.01 0 0 0
R_00: 1 0 0 0 1 0 0 0 1
T_00: 0 0 0
S_rect_00: 60 40
R_rect_00: 0.8 0 0.6 0 1 0 -0.6 0 0.8
P_rect_00: 50 0 30 0 0 50 20 0 0 0 1 0
S_01: 64 48
K_01: 60 0 32 0 60 24 0 0 1
D_01: -0.1 0.01 0 0 0
R_01: 1 0 0 0 1 0 0 0 1
T_01: -0.5 0 0
S_rect_01: 60 40
R_rect_01: 1 0 0 0 1 0 0 0 1
P_rect_01: 50 0 30 -25 0 50 20 0 0 0 1 0
S_02: 64 48
K_02: 62 0 32 0 62 24 0 0 1
D_02: 0 0 0 0 0
R_02: 0 -1 0 1 0 0 0 0 1
T_02: 0.1 0.2 0
S_rect_02: 60 40
R_rect_02: 1 0 0 0 1 0 0 0 1
P_rect_02: 50 0 30 5 0 50 20 0 0 0 1 0
S_03: 64 48
K_03: 62 0 32 0 62 24 0 0 1
D_03: 0 0 0 0 0
R_03: 0 -1 0 1 0 0 0 0 1
T_03: -0.4 0.2 0
S_rect_03: 60 40
R_rect_03: 1 0 0 0 1 0 0 0 1
P_rect_03: 50 0 30 -20 0 50 20 0 0 0 1 0
"""


def images(folder: Path, names: list[str], size: tuple[int, int] = (64, 48)) -> None:
    folder.mkdir(parents=True)
    for value, name in enumerate(names):
        Image.fromarray(np.full(size[::-1], value, np.uint8)).save(folder / name)


def odometry(folder: Path, left: list[str], right: list[str], cameras: str = "01", count: int = 3) -> Path:
    for camera, names in zip(cameras, (left, right), strict=True):
        images(folder / f"image_{camera}", names)
    (folder / "calib.txt").write_text(ODOMETRY + COLOUR)
    (folder / "times.txt").write_text("".join(f"{0.1 * k:e}\n" for k in range(count)))
    return folder


def dates(times: list[float]) -> str:
    return "".join(f"2011-09-26 14:05:{time:012.9f}\n" for time in times)


def drive(folder: Path, numbers: list[int], size: tuple[int, int] = (64, 48), cameras: str = "01") -> Path:
    for camera in cameras:
        images(folder / f"image_0{camera}" / "data", [f"{k:010d}.png" for k in numbers], size)
        (folder / f"image_0{camera}" / "timestamps.txt").write_text(dates([35 + 0.1 * k for k in range(5)]))
    (folder / "calib_cam_to_cam.txt").write_text(RAW)
    return folder


def poses(path: Path, xs: list[float]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in xs))
    return path


NAMES = ["000000.png", "000001.png", "000002.png"]


def test_images_pair_by_number_and_have_the_stamp_of_their_line(tmp_path: Path) -> None:
    left, right = ["0.png", "10.png", "2.png", "4.png"], ["000002.png", "000010.png", "000000.png", "000003.png"]
    sequence = KittiSequence(odometry(tmp_path / "00", left, right, count=11))
    assert [pair.name for pair in sequence] == ["0", "2", "10"]
    np.testing.assert_allclose(sequence.stamps, [0, 0.2, 1.0])
    assert sequence.stamps.dtype == np.float64
    assert sequence.unpaired == ["image_0/4.png", "image_1/000003.png"]
    assert sequence.rig == Rig(fx=60, fy=60, cx=32, cy=24, baseline=0.5, width=64, height=48)
    assert (sequence.name, len(sequence), sequence.truth) == ("00", 3, None)
    pair = sequence[-1]
    assert (pair.index, pair.stamp, pair.left[0, 0], pair.right[0, 0]) == (2, pytest.approx(1.0), 1, 1)
    with pytest.raises(IndexError):
        sequence[3]


def test_images_without_a_time_are_unpaired(tmp_path: Path) -> None:
    sequence = KittiSequence(odometry(tmp_path, NAMES, NAMES, count=2))
    assert (len(sequence), sequence.unpaired) == (2, ["image_0/000002.png", "image_1/000002.png"])


def test_images_are_read_only_when_they_are_asked_for(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "image_1" / "000001.png").write_bytes(b"no image")
    sequence = KittiSequence(tmp_path)
    assert sequence[0].name == "000000"
    with pytest.raises(InputError, match=r"000001\.png"):
        sequence[1]


def test_an_image_without_a_header_does_not_hide_the_size(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "image_0" / "000000.png").write_bytes(b"no image")
    assert KittiSequence(tmp_path).rig.width == 64
    for name in NAMES:
        (tmp_path / "image_0" / name).write_bytes(b"no image")
    with pytest.raises(InputError, match=r"000000\.png: is not an image"):
        KittiSequence(tmp_path)


def test_colour_cameras_give_their_own_baseline_and_place(tmp_path: Path) -> None:
    odometry(tmp_path / "sequences" / "07", NAMES, NAMES, "23")
    poses(tmp_path / "poses" / "07.txt", [0, 1, 2])
    sequence = KittiSequence(tmp_path / "sequences" / "07", colour=True)
    shift = (3 - 32 * 0.01) / 60
    assert sequence.rig.baseline == pytest.approx(shift - (-27 - 32 * 0.011) / 60)
    assert (sequence.rig.cx, sequence.rig.doffs) == (32, 0)
    truth = sequence.truth
    assert truth is not None
    np.testing.assert_allclose(truth[:, 0, 3], np.arange(3) - shift)
    np.testing.assert_allclose(truth[:, 1:3, 3], np.tile([-(0.3 - 24 * 0.01) / 60, -0.01], (3, 1)))


def test_a_colour_camera_far_off_the_row_is_refused(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES, "23")
    (tmp_path / "calib.txt").write_text(ODOMETRY + COLOUR.replace("24 0.36", "24 9.0"))
    with pytest.raises(InputError, match=r"P3 is .* m off P2 in y and z"):
        KittiSequence(tmp_path, colour=True)
    (tmp_path / "calib.txt").write_text(ODOMETRY)
    with pytest.raises(InputError, match="lacks P2"):
        KittiSequence(tmp_path, colour=True)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("P2: 60", "P2: 0", r"P2 is .* expected a projection K \[I \| t\]"),
        ("P2: 60 0 32 3", "P2: 60 0 32 3e12", r"P2 is .*\|t\| at most 1e6 m"),
        ("P3: 60", "P3: -60", r"P3\[0,0\] is -60, expected a focal length"),
        ("P3: 60", "P3: 61", r"P2\[0,0\] is 60, P3\[0,0\] is 61, expected the same"),
        ("-27", "33", r"P3\[0,3\] / -P3\[0,0\] is -0.499.*left and right look swapped"),
    ],
)
def test_errors_of_colour_cameras_name_their_own_keys(tmp_path: Path, old: str, new: str, said: str) -> None:
    odometry(tmp_path / "P0 P1", NAMES, NAMES, "23")
    (tmp_path / "P0 P1" / "calib.txt").write_text(ODOMETRY + COLOUR.replace(old, new))
    with pytest.raises(InputError, match=rf"^{tmp_path}/P0 P1/calib\.txt: {said}"):
        KittiSequence(tmp_path / "P0 P1", colour=True)


def test_errors_of_the_colour_cameras_of_a_drive_name_their_own_keys(tmp_path: Path) -> None:
    folder = drive(tmp_path, [0], (60, 40), "23")
    (folder / "calib_cam_to_cam.txt").write_text(RAW.replace("S_rect_03: 60", "S_rect_03: 61"))
    with pytest.raises(InputError, match="S_rect_02 is 60 x 40 px, S_rect_03 is 61 x 40 px"):
        KittiSequence(folder, colour=True)


def test_a_projection_that_recorded_images_do_not_need_is_checked_with_the_truth(tmp_path: Path) -> None:
    folder = drive(tmp_path, [0])
    (folder / "calib_cam_to_cam.txt").write_text(RAW.replace("P_rect_00: 50", "P_rect_00: 0"))
    poses(folder / "poses.txt", [0])
    with pytest.raises(InputError, match=r"P_rect_00 is .* expected a projection"):
        _ = KittiSequence(folder).truth


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "calib.txt").write_text(ODOMETRY, "utf-8-sig")
    assert KittiSequence(tmp_path).rig.baseline == 0.5


def test_poses_are_found_beside_the_images_or_given(tmp_path: Path) -> None:
    folder = odometry(tmp_path / "00", NAMES, NAMES)
    poses(folder / "poses.txt", [0, 1, 3])
    given = poses(tmp_path / "given.txt", [0, 5])
    found = KittiSequence(folder).truth
    assert found is not None
    assert found.shape == (3, 4, 4)
    np.testing.assert_array_equal(found[:, 0, 3], [0, 1, 3])
    np.testing.assert_array_equal(found[:, 3], np.tile([0, 0, 0, 1], (3, 1)))
    truth = KittiSequence(folder, poses=given).truth
    assert truth is not None
    np.testing.assert_array_equal(truth[:2, 0, 3], [0, 5])
    assert np.isnan(truth[2]).all()


def test_as_many_poses_as_left_images_are_theirs_in_order(tmp_path: Path) -> None:
    folder = odometry(tmp_path, ["7.png", "8.png", "9.png"], ["7.png", "9.png"], count=10)
    truth = KittiSequence(folder, poses=poses(tmp_path / "three.txt", [0, 1, 2])).truth
    assert truth is not None
    np.testing.assert_array_equal(truth[:, 0, 3], [0, 2])
    with pytest.raises(InputError, match="has 2 poses, none of an image; expected one for each of the 3 left images"):
        KittiSequence(folder, poses=poses(tmp_path / "two.txt", [0, 1]))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("\n\n", "has no line of values"),
        ("1 2 3\n", "line 1 has 3 values"),
        ("1 0 0 x 0 1 0 0 0 0 1 0\n", "line 1 has '1 0 0 x"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0\n", "not finite"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n", "pose 2 holds no rotation"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "pose 1 holds no rotation"),
    ],
)
def test_bad_poses_are_refused(tmp_path: Path, text: str, said: str) -> None:
    folder = odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        KittiSequence(folder, poses=tmp_path / "poses.txt")
    assert "\n" not in str(caught.value)
    assert "poses.txt" in str(caught.value)
    sequence = KittiSequence(folder)
    with pytest.raises(InputError, match=said):
        _ = sequence.truth


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0\n0.1\n0.1\n", r"stamp 3 \(line 3\) is 0.1.* expected stamps in seconds that increase"),
        ("0\n100000000\n200000000\n", r"read as seconds, are 1e\+08 s apart in the median; expected seconds"),
        ("0\n1e-7\n2e-7\n", "read as seconds, are 1e-07 s apart"),
        ("0 1\n", "line 1 has 2 values"),
        ("noon\n", "line 1 has 'noon'"),
    ],
)
def test_bad_times_are_refused(tmp_path: Path, text: str, said: str) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "times.txt").write_text(text)
    with pytest.raises(InputError, match=rf"times\.txt: {said}|times\.txt: stamps, {said}") as caught:
        KittiSequence(tmp_path)
    assert "\n" not in str(caught.value)


def test_text_that_is_none_is_refused(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "times.txt").write_bytes(b"\xff\xfe0")
    with pytest.raises(InputError, match=r"times\.txt: is no text"):
        KittiSequence(tmp_path)


@pytest.mark.parametrize("part", ["image_0", "image_1", "calib.txt", "times.txt"])
def test_a_missing_part_of_a_sequence_is_named(tmp_path: Path, part: str) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / part).rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=part) as caught:
        KittiSequence(tmp_path)
    assert "\n" not in str(caught.value)


def test_the_other_cameras_are_pointed_out(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    with pytest.raises(InputError, match=r"lacks the folder image_2 or image_02; .*colour=False"):
        KittiSequence(tmp_path, colour=True)


def test_names_that_are_no_numbers_are_refused(tmp_path: Path) -> None:
    odometry(tmp_path, [*NAMES, "a.png"], NAMES)
    with pytest.raises(InputError, match=r"image_0/a\.png: has a name that is no number"):
        KittiSequence(tmp_path)
    (tmp_path / "image_0" / "a.png").rename(tmp_path / "image_0" / "1.png")
    with pytest.raises(InputError, match=r"1\.png: has the number of 0*1\.png"):
        KittiSequence(tmp_path)


def test_no_pair_is_an_error(tmp_path: Path) -> None:
    odometry(tmp_path, ["0.png"], ["1.png"])
    with pytest.raises(InputError, match=r"has no pair of images \(2 without partner"):
        KittiSequence(tmp_path)


def test_other_files_are_passed_over(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "image_0" / ".000009.png").write_bytes(b"")
    (tmp_path / "image_0" / "notes.txt").write_text("x")
    assert KittiSequence(tmp_path).unpaired == []


def test_a_drive_pairs_by_stamp_and_its_size_tells_that_it_is_rectified(tmp_path: Path) -> None:
    folder = drive(tmp_path / "drive", [1, 2, 3], (60, 40))
    (folder / "image_01" / "timestamps.txt").write_text(dates([35, 35.11, 35.24, 35.31, 35.4]))
    sequence = KittiSequence(folder)
    assert sequence.rig == Rig(fx=50, fy=50, cx=30, cy=20, baseline=0.5, width=60, height=40)
    assert [(pair.left[0, 0], pair.right[0, 0]) for pair in sequence] == [(0, 0), (2, 2)]
    np.testing.assert_allclose(np.diff(sequence.stamps), [0.2], atol=1e-6)
    assert sequence.stamps[0] == pytest.approx(1317045935.1, abs=1e-6)
    assert sequence.unpaired == ["image_00/0000000002.png", "image_01/0000000002.png"]


def test_a_drive_of_recorded_images_is_rectified(tmp_path: Path) -> None:
    folder = drive(tmp_path / "day" / "drive", [0, 1], cameras="01")
    (folder / "calib_cam_to_cam.txt").rename(tmp_path / "day" / "calib_cam_to_cam.txt")
    sequence = KittiSequence(folder, poses=poses(tmp_path / "poses.txt", [0, 1]))
    made = rectification(read_calibration(tmp_path / "day" / "calib_cam_to_cam.txt", (64, 48)).cameras)
    assert sequence.rig == made.rig
    assert sequence[1].left.shape == (48, 64)
    truth = sequence.truth
    assert truth is not None
    np.testing.assert_allclose(truth[0, :3, :3], [[0.8, 0, 0.6], [0, 1, 0], [-0.6, 0, 0.8]] @ made.R_left.T, atol=1e-9)
    np.testing.assert_allclose(truth[:, :3, 3], [[0, 0, 0], [1, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("size", [(64, 48), (60, 40)])
def test_the_colour_cameras_of_a_drive_are_measured_from_camera_2(tmp_path: Path, size: tuple[int, int]) -> None:
    folder = drive(tmp_path, [0, 1], size, "23")
    sequence = KittiSequence(folder, colour=True, poses=poses(tmp_path / "poses.txt", [0, 1]))
    assert sequence.rig.baseline == pytest.approx(0.5)
    assert sequence.rig.fx == pytest.approx(62 if size == (64, 48) else 50)
    truth = sequence.truth
    assert truth is not None
    np.testing.assert_allclose(truth[:, :3, 3], [[-0.1, 0, 0], [0.9, 0, 0]], atol=1e-12)


def test_images_of_a_drive_without_a_stamp_are_unpaired(tmp_path: Path) -> None:
    assert KittiSequence(drive(tmp_path, [4, 5])).unpaired == ["image_00/0000000005.png", "image_01/0000000005.png"]


@pytest.mark.parametrize("part", ["image_00/data", "image_01/data", "image_01/timestamps.txt", "calib_cam_to_cam.txt"])
def test_a_missing_part_of_a_drive_is_named(tmp_path: Path, part: str) -> None:
    folder = drive(tmp_path / "drive", [0, 1])
    (folder / part).rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=part):
        KittiSequence(folder)


@pytest.mark.parametrize(
    "text",
    [
        "12.5",
        "2011-13-26 14:05:35.5",
        "2011-09-26 14:05:35",
        "2011-09-26T14:05:35.5",
        "0001-01-01 00:00:00.5",
        "1969-12-31 23:59:59.5",
        "9999-12-31 23:59:59.5",
    ],
)
def test_times_of_a_drive_that_are_no_dates_are_refused(tmp_path: Path, text: str) -> None:
    drive(tmp_path, [0, 1])
    (tmp_path / "image_00" / "timestamps.txt").write_text(text + "\n")
    with pytest.raises(InputError, match=r"timestamps\.txt: line 1 has .*such as 2011-09-26"):
        KittiSequence(tmp_path)


def test_a_drive_without_a_common_stamp_is_refused(tmp_path: Path) -> None:
    drive(tmp_path, [0, 1])
    (tmp_path / "image_01" / "timestamps.txt").write_text(dates([50, 51]))
    with pytest.raises(InputError, match=r"has no pair of images \(4 without"):
        KittiSequence(tmp_path)


def test_a_folder_that_is_another_is_refused(tmp_path: Path) -> None:
    odometry(tmp_path, NAMES, NAMES)
    (tmp_path / "calib.txt").write_text("fx: 500\n")
    with pytest.raises(InputError, match="lacks P0"):
        KittiSequence(tmp_path)


def real(*names: str) -> Path:
    path = DATA.joinpath(*names)
    if not path.exists():
        pytest.skip(f"{'/'.join(names)} is not in the data folder (TSPSLAM_DATA)")
    return path


def length(truth: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum())


def test_the_real_sequence_is_as_long_as_known(tmp_path: Path) -> None:
    source, folder = real("kitti_seq1"), tmp_path / "00"
    folder.mkdir()
    for name, other in (("image_0", "image_l"), ("image_1", "image_r"), ("calib.txt",) * 2, ("poses.txt",) * 2):
        (folder / name).symlink_to((source / other).resolve())
    (folder / "times.txt").write_text("".join(f"{k / 10:e}\n" for k in range(51)))
    sequence = KittiSequence(folder)
    assert (len(sequence), sequence.unpaired, sequence[50].left.shape[:2]) == (51, [], (370, 1226))
    assert sequence.rig.baseline == pytest.approx(0.53715, abs=1e-5)
    truth = sequence.truth
    assert truth is not None
    assert length(truth) == pytest.approx(59.9, abs=0.1)
    assert truth[-1, 2, 3] > 59


def test_the_real_drive_is_as_long_as_known(tmp_path: Path) -> None:
    source, folder = real("kitti_raw_0926"), tmp_path / "2011_09_26" / "2011_09_26_drive_extract"
    for camera in ("image_00", "image_01"):
        (folder / camera).mkdir(parents=True)
        (folder / camera / "data").symlink_to((source / camera).resolve())
        (folder / camera / "timestamps.txt").symlink_to((source / f"{camera}_timestamps_all401.txt").resolve())
    (folder.parent / "calib_cam_to_cam.txt").symlink_to((source / "calib_cam_to_cam.txt").resolve())
    sequence = KittiSequence(folder, poses=source / "poses.txt")
    assert (len(sequence), sequence.unpaired, sequence[0].name) == (100, [], "0000000190")
    assert np.median(np.diff(sequence.stamps)) == pytest.approx(0.1034, abs=1e-3)
    assert (sequence.rig.width, sequence.rig.height) == (1392, 512)
    truth = sequence.truth
    assert truth is not None
    assert length(truth) == pytest.approx(75, abs=1)
    steps = np.linalg.inv(truth[:-1]) @ truth[1:]
    assert np.median(steps[:, 2, 3]) > 5 * np.abs(np.median(steps[:, :2, 3], axis=0)).max()
