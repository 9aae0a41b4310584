"""What is missing on one side, or in one line, never moves the rest: images, stamps and poses keep their partners."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tspslam.datasets import EurocSequence, KittiSequence, StereoFolder, UtiasRun
from tspslam.datasets._pairing import pair_by_stamp
from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.calibration.formats.own import save_cameras

from . import standard
from .test_kitti import RAW, dates

COUNT = 6


def drive(folder: Path) -> Path:
    """A raw drive of KITTI whose images hold their number."""
    for camera in ("image_00", "image_01"):
        (folder / camera / "data").mkdir(parents=True)
        for k in range(COUNT):
            Image.fromarray(np.full((40, 60), k, np.uint8)).save(folder / camera / "data" / f"{k:010d}.png")
        (folder / camera / "timestamps.txt").write_text(dates([35 + 0.1 * k for k in range(COUNT)]))
    (folder / "calib_cam_to_cam.txt").write_text(RAW)
    return folder


def blank(path: Path, *lines: int) -> None:
    """Make lines (from 0) of a file blank."""
    path.write_text("".join("\n" if k in lines else line for k, line in enumerate(path.read_text().splitlines(True))))


def numbers(sequence: KittiSequence) -> list[tuple[int, int, int]]:
    return [(int(pair.name), int(pair.left[0, 0]), int(pair.right[0, 0])) for pair in sequence]


def test_a_blank_line_stands_for_the_stamp_of_one_image_alone(tmp_path: Path) -> None:
    folder = drive(tmp_path)
    blank(folder / "image_00/timestamps.txt", 2)
    sequence = KittiSequence(folder)
    assert numbers(sequence) == [(k, k, k) for k in (0, 1, 3, 4, 5)]
    np.testing.assert_allclose(np.diff(sequence.stamps), [0.1, 0.2, 0.1, 0.1], atol=1e-6)
    assert sequence.unpaired == ["image_01/0000000002.png", "image_00/0000000002.png"]


@pytest.mark.parametrize(("line", "first"), [(0, 1), (COUNT - 1, 0)])
def test_a_blank_first_or_last_line_is_one_too(tmp_path: Path, line: int, first: int) -> None:
    folder = drive(tmp_path)
    blank(folder / "image_01/timestamps.txt", line)
    assert numbers(KittiSequence(folder)) == [(k, k, k) for k in range(first, first + COUNT - 1)]


def test_a_lost_image_keeps_its_partner_from_the_next_one(tmp_path: Path) -> None:
    folder = drive(tmp_path)
    (folder / "image_01/data/0000000003.png").unlink()
    blank(folder / "image_01/timestamps.txt", 3)
    sequence = KittiSequence(folder)
    assert numbers(sequence) == [(k, k, k) for k in (0, 1, 2, 4, 5)]
    assert sequence.unpaired == ["image_00/0000000003.png"]


def test_a_blank_line_of_times_leaves_its_number_alone(tmp_path: Path) -> None:
    folder = standard.odometry(tmp_path, count=COUNT)
    blank(folder / "times.txt", 0, 3)
    sequence = KittiSequence(folder)
    assert [int(pair.name) for pair in sequence] == [1, 2, 4, 5]
    np.testing.assert_allclose(sequence.stamps, [0.1, 0.2, 0.4, 0.5])
    assert sequence.unpaired == [f"image_{side}/{k:06d}.png" for side in (0, 1) for k in (0, 3)]


def test_a_heading_is_no_line_of_an_image(tmp_path: Path) -> None:
    folder = standard.odometry(tmp_path, count=COUNT)
    path = folder / "times.txt"
    text = path.read_text()
    path.write_text("# seconds\n# of camera 0\n" + text)
    np.testing.assert_allclose(KittiSequence(folder).stamps, np.arange(COUNT) / 10)
    lines = text.splitlines(True)
    path.write_text("".join([*lines[:2], "# " + lines[2], *lines[3:]]))
    with pytest.raises(InputError, match=r"times\.txt: line 3 begins with #; expected .* or a blank line"):
        KittiSequence(folder)


def test_what_does_not_increase_is_named_by_its_line(tmp_path: Path) -> None:
    folder = standard.odometry(tmp_path, count=COUNT)
    (folder / "times.txt").write_text("# s\n0\n\n0.2\n0.1\n")
    with pytest.raises(InputError, match=r"stamp 3 \(line 5\) is 0\.1"):
        KittiSequence(folder)


@pytest.mark.parametrize("gone", ["", " ".join(["nan"] * 12)])
def test_a_pose_that_is_not_known_moves_no_other(tmp_path: Path, gone: str) -> None:
    folder, T = standard.odometry(tmp_path, count=COUNT), standard.poses(COUNT)
    lines = standard.rows_of(T).splitlines()
    lines[2] = gone
    (folder / "poses.txt").write_text("\n".join(lines) + "\n")
    truth = KittiSequence(folder).truth
    assert truth is not None
    assert np.isnan(truth[2]).all()
    kept = [0, 1, 3, 4, 5]
    np.testing.assert_allclose(truth[kept], T[kept], atol=1e-9)
    (folder / "poses.txt").write_text(" ".join(["nan"] * 12))
    with pytest.raises(InputError, match="has no pose that is known"):
        _ = KittiSequence(folder).truth


def test_stamps_without_a_name_belong_to_the_pose_of_their_line(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 4)
    path, start = run / "timestamps_images.txt", 1_600_000_000_000_000_000
    path.write_text("".join(f"{start + 10**8 * k}\n" for k in range(4)))
    blank(path, 1)
    sequence = UtiasRun(run)
    assert [pair.name for pair in sequence] == ["000000", "000002", "000003"]
    np.testing.assert_array_equal(sequence.stamps, [(start + 10**8 * k) / 10**9 for k in (0, 2, 3)])
    assert sequence.unpaired == ["left/000001.png", "right/000001.png"]


def test_the_partner_of_a_listed_image_that_is_lost_goes_to_no_other(tmp_path: Path) -> None:
    """Few left images are there, and the right one of the second is lost: the next one is near in time."""
    folder = standard.euroc(tmp_path, count=9)
    for camera, kept in (("cam0", (0, 6)), ("cam1", (0, 7))):
        for k, file in enumerate(sorted((folder / "mav0" / camera / "data").iterdir())):
            if k not in kept:
                file.unlink()
    sequence = EurocSequence(folder)
    assert len(sequence) == 1
    whole = EurocSequence(standard.euroc(tmp_path / "whole", count=9))
    assert sequence[0].right.tobytes() == whole[0].right.tobytes()


def test_a_slow_side_does_not_widen_what_counts_as_one_moment() -> None:
    """One side has every fifth image: those of the other that are 20 ms off are no partners."""
    slow = {k * 250_000_000: Path(f"{k}.png") for k in range(4)}
    fast = {20_000_000 + k * 50_000_000: Path(f"{k}.png") for k in range(20)}
    assert pair_by_stamp(slow, fast, ("a", "b")).files == []
    assert pair_by_stamp(fast, slow, ("a", "b")).files == []
    assert len(pair_by_stamp(slow, {t - 10_000_000: file for t, file in fast.items()}, ("a", "b")).files) == 4


def test_measurements_of_nan_are_left_out(tmp_path: Path) -> None:
    folder, T = standard.euroc(tmp_path), standard.poses(4)
    stamps = [round(stamp * 1e9) for stamp in EurocSequence(folder).stamps]
    standard.euroc_truth(folder, T, stamps)
    path = folder / "mav0/state_groundtruth_estimate0/data.csv"
    lines = path.read_text().splitlines()
    lines[4] = ",".join([lines[4].split(",")[0], *["nan"] * 7])
    path.write_text("\n".join(lines))
    truth = EurocSequence(folder).truth
    assert truth is not None
    assert np.isfinite(truth[:, 0, 0]).tolist() == [True, True, True, False]


def test_a_folder_keeps_the_place_of_a_name_that_one_side_lacks(tmp_path: Path) -> None:
    for seed, side in enumerate(("left", "right")):
        standard.write_images(tmp_path / side, [f"{k}.png" for k in range(12)], seed=seed)
    save_cameras(Rig(fx=50, fy=50, cx=32, cy=24, baseline=0.1, width=64, height=48), tmp_path / "calib.yaml")
    (tmp_path / "left/2.png").unlink()
    (tmp_path / "right/10.png").unlink()
    folder = StereoFolder(tmp_path)
    assert folder.stamps.tolist() == [0, 1, 3, 4, 5, 6, 7, 8, 9, 11]
    assert [(pair.name, pair.stamp, pair.index) for pair in folder] == [
        (str(k), float(k), place) for place, k in enumerate((0, 1, 3, 4, 5, 6, 7, 8, 9, 11))
    ]
    assert folder.unpaired == ["right/2.png", "left/10.png"]
