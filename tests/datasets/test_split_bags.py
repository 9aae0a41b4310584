"""A recording that was split into several files is one sequence in the order of time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from tspslam import cli
from tspslam.datasets import RosbagSequence, open_sequence
from tspslam.datasets._bag_images import BagImages
from tspslam.vision.calibration.formats.own import save_cameras

from .test_bag_cameras import bare
from .test_rosbag import (  # noqa: F401
    COUNT,
    KINDS,
    LEFT,
    RIG,
    RIGHT,
    START,
    STEP,
    drive,
    one_line_error,
    pairs,
    raw_image,
    write,
)

ROS = KINDS["ros1"]


def pieces(folder: Path, topics, name="drive_{}.bag", ros=ROS, first=0) -> list[Path]:
    """A file for each pair of a drive, with the camera infos in the first one."""
    folder.mkdir(exist_ok=True)
    files = []
    for k in range(COUNT):
        held = {topic: [(START + k * STEP, each[k])] for topic, each in topics.items() if topic in (LEFT, RIGHT)}
        held |= {topic: each for topic, each in topics.items() if k == 0 and topic not in (LEFT, RIGHT)}
        files.append(write(folder / name.format(k + first), ros, held))
    return files


def same(sequence: RosbagSequence, given) -> None:
    assert (len(sequence), sequence.unpaired, sequence.rig) == (len(given), [], RIG)
    assert sequence.stamps.tolist() == [(START + k * STEP) / 10**9 for k in range(len(given))]
    for pair, wanted in zip(sequence, given, strict=True):
        assert pair.left.tobytes() == wanted.left.tobytes()
        assert pair.right.tobytes() == wanted.right.tobytes()


@pytest.mark.parametrize("name", ["drive_{}.bag", "2026-01-02-03-04-0{0}_{0}.bag", "a_1{}.BAG"])
def test_a_folder_of_pieces_is_one_sequence(tmp_path, pairs, name):  # noqa: F811
    pieces(tmp_path / "drive", drive(ROS, pairs), name)
    sequence = open_sequence(tmp_path / "drive")
    assert sequence.name == "drive"
    same(sequence, pairs)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_pieces_that_are_given_come_in_the_order_of_time(tmp_path, pairs, order):  # noqa: F811
    files = pieces(tmp_path / "drive", drive(ROS, pairs))
    same(open_sequence([files[k] for k in order]), pairs)


def test_a_folder_with_one_bag_is_that_bag(tmp_path, pairs):  # noqa: F811
    (tmp_path / "drive").mkdir()
    write(tmp_path / "drive" / "whatever.bag", ROS, drive(ROS, pairs))
    same(open_sequence(tmp_path / "drive"), pairs)


def test_pieces_that_overlap_are_merged_by_time(tmp_path, pairs):  # noqa: F811
    topics = drive(ROS, pairs)
    files = [
        write(tmp_path / f"{side}.bag", ROS, {topic: each for topic, each in topics.items() if f"/{side}/" in topic})
        for side in ("left", "right")
    ]
    same(open_sequence(files), pairs)


def test_an_image_that_two_pieces_have_is_there_once(tmp_path, pairs):  # noqa: F811
    files = pieces(tmp_path / "drive", drive(ROS, pairs))
    again = write(tmp_path / "again.bag", ROS, {LEFT: [(START + STEP, raw_image(ROS, START + STEP, pairs[1].left))]})
    sequence = open_sequence([*files, again])
    assert (len(sequence), sequence.unpaired) == (COUNT, [f"{LEFT}/{START + STEP}"])


def test_bags_that_are_no_pieces_of_one_recording_are_refused(tmp_path, pairs):  # noqa: F811
    topics, here = drive(ROS, pairs), tmp_path / "drive"
    files = pieces(here, topics)
    files[1].rename(here / "other.bag")
    said = "holds 3 bags that are not the pieces of one recording, such as drive_0.bag; expected NAME_0.bag NAME_1.bag"
    one_line_error(lambda: open_sequence(here), said)
    (here / "other.bag").rename(here / "drive_7.bag")
    one_line_error(lambda: open_sequence(here), said)
    later = write(tmp_path / "later.bag", ROS, {LEFT: [(START + 100 * 10**9, raw_image(ROS, START, pairs[0].left))]})
    said = "its pieces have a gap of 99.9 s; expected pieces of one recording, at most 60 s apart"
    one_line_error(lambda: open_sequence([files[0], here / "drive_7.bag", files[2], later]), said)
    other = write(tmp_path / "x", KINDS["mcap"], drive(KINDS["mcap"], pairs))
    one_line_error(lambda: open_sequence([files[0], other / "x.mcap"]), "with files of other kinds (.bag, .mcap)")
    one_line_error(lambda: open_sequence([files[0], files[0]]), "hold a file twice")
    one_line_error(lambda: RosbagSequence([files[0], here]), f"{here}: is a folder beside files of a bag")
    one_line_error(lambda: RosbagSequence([]), "no file of a bag is given")


def test_a_damaged_piece_is_named(tmp_path, pairs):  # noqa: F811
    files = pieces(tmp_path / "drive", drive(ROS, pairs))
    files[1].write_bytes(files[1].read_bytes()[:-300])
    assert one_line_error(lambda: open_sequence(tmp_path / "drive"), "cannot be read").startswith(f"{files[1]}: ")
    files[1].write_bytes(b"")
    assert one_line_error(lambda: open_sequence(files), "is empty").startswith(f"{files[1]}: ")


def test_images_of_a_bag_are_had_without_a_calibration(tmp_path, pairs):  # noqa: F811
    names = "/front/image", "/back/picture"
    path = write(tmp_path / "a.bag", ROS, bare(ROS, pairs, names))
    stored = BagImages(path, names)
    assert (stored.name, len(stored), stored.unpaired, stored.size()) == ("a", COUNT, [], (64, 48))
    assert stored.names == [str(START + k * STEP) for k in range(COUNT)]
    assert stored.stamps.tolist() == [(START + k * STEP) / 10**9 for k in range(COUNT)]
    left, right = stored.images(2)
    np.testing.assert_array_equal(left, pairs[2].left)
    np.testing.assert_array_equal(right, pairs[2].right)


def test_a_bag_of_another_robot_lists_its_topics_with_types(tmp_path, pairs):  # noqa: F811
    topics = {"/front/image": [raw_image(ROS, START, pairs[0].left)], "/odom": [ROS.header(1)]}
    said = "its topics are /front/image (sensor_msgs/msg/Image), /odom (std_msgs/msg/Header); expected two to be given"
    one_line_error(lambda: open_sequence(write(tmp_path / "a.bag", ROS, topics)), said)


def test_the_command_line_takes_pieces(tmp_path, pairs, capsys):  # noqa: F811
    files = pieces(tmp_path / "drive", bare(ROS, pairs, (LEFT, RIGHT)))
    save_cameras(RIG, tmp_path / "calib.yaml")
    words = ["run", *map(str, files[:2]), "--out", str(tmp_path / "run")]
    assert cli.exit_code([*words, "--calib", str(tmp_path / "calib.yaml"), "--frames", "5:9"]) == cli.BAD_INPUT
    assert "selects none of the 2 frames" in capsys.readouterr().err
    assert cli.exit_code(words) == cli.BAD_INPUT
    assert "has no CameraInfo" in capsys.readouterr().err
