"""A calibration stands in for the camera infos of a bag, and topics are named where they cannot be told."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rosbags")

from tspslam import cli
from tspslam.datasets import RosbagSequence, _ros, open_sequence
from tspslam.types import Camera, RawRig
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.calibration.rectify import rectification

from .test_rosbag import KINDS, LEFT, RAW, RIG, RIGHT, drive, info, one_line_error, pairs, raw_image, write  # noqa: F401

BARE = "/cam0/image_raw", "/cam1/image_raw"
CAMERA = Camera(60, 61, 31, 23.5, 64, 48, distortion=(-0.1, 0.02, 0.001, -0.0005, 0.0))
LENSES = RawRig(CAMERA, CAMERA, ((1, 0, 0, -0.125), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))


def bare(ros, given, topics=BARE):
    """Topics of a drive without camera infos."""
    return {topic: each for topic, each in drive(ros, given, topics).items() if topic in topics}


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_rectified_calibration_stands_in_for_camera_infos(tmp_path, pairs, kind):  # noqa: F811
    ros = KINDS[kind]
    path = write(tmp_path / ros.name, ros, bare(ros, pairs))
    one_line_error(
        lambda: open_sequence(path), "has no CameraInfo of /cam0/image_raw; expected one on /cam0/camera_info or"
    )
    one_line_error(lambda: open_sequence(path), "or a calibration (--calib)")
    save_cameras(RIG, tmp_path / "calib.yaml")
    sequence = open_sequence(path, calib=tmp_path / "calib.yaml")
    assert (sequence.topics, sequence.rig) == (BARE, RIG)
    assert sequence[1].left.tobytes() == pairs[1].left.tobytes()


def test_a_raw_calibration_rectifies(tmp_path, pairs):  # noqa: F811
    path = write(tmp_path / "a.bag", KINDS["ros1"], bare(KINDS["ros1"], pairs))
    save_cameras(LENSES, tmp_path / "calib.yaml")
    made = rectification(LENSES)
    sequence = open_sequence(path, calib=tmp_path / "calib.yaml")
    assert sequence.rig == made.rig
    np.testing.assert_array_equal(sequence[0].left, made(pairs[0].left, pairs[0].right)[0])


def test_a_calibration_without_a_size_takes_that_of_the_images(tmp_path, pairs):  # noqa: F811
    ros = KINDS["ros1"]
    topics = bare(ros, pairs)
    topics[BARE[0]][0].encoding = "unknown"
    path = write(tmp_path / "a.bag", ros, topics)
    (tmp_path / "calib.txt").write_text("P0: 60 0 31 0 0 60 23 0 0 0 1 0\nP1: 60 0 31 -6 0 60 23 0 0 0 1 0\n")
    rig = RosbagSequence(path, calib=tmp_path / "calib.txt").rig
    assert (rig.width, rig.height, rig.baseline) == (64, 48, pytest.approx(0.1))


def test_a_calibration_goes_before_camera_infos(tmp_path, pairs):  # noqa: F811
    """A driver that was never calibrated publishes zeros."""
    ros = KINDS["ros1"]
    zeros = {"K": np.zeros((3, 3)), "P0": 0, "P5": 0, "D": [0.0] * 5}
    path = write(tmp_path / "a.bag", ros, drive(ros, pairs, RAW, **zeros))
    one_line_error(lambda: RosbagSequence(path), "expected a focal length")
    save_cameras(LENSES, tmp_path / "calib.yaml")
    assert RosbagSequence(path, calib=tmp_path / "calib.yaml")._reader.rectify is not None


@pytest.mark.parametrize("topics", [(LEFT, RIGHT), RAW])
def test_images_that_are_known_to_be_rectified_are_not_rectified_again(tmp_path, pairs, topics):  # noqa: F811
    path = write(tmp_path / "a.bag", KINDS["ros1"], drive(KINDS["ros1"], pairs, topics, D=[0.0] * 5))
    save_cameras(LENSES, tmp_path / "raw.yaml")
    save_cameras(RIG, tmp_path / "rectified.yaml")
    said = f"raw.yaml: is of raw cameras, but images on {topics[0]} and {topics[1]} are rectified already"
    one_line_error(lambda: RosbagSequence(path, calib=tmp_path / "raw.yaml"), said)
    assert RosbagSequence(path, calib=tmp_path / "rectified.yaml").rig == RIG
    assert RosbagSequence(path)._reader.rectify is None


def test_topics_are_named(tmp_path, pairs):  # noqa: F811
    names = "/front/image", "/back/picture"
    path = write(tmp_path / "a.bag", KINDS["ros1"], bare(KINDS["ros1"], pairs, names))
    save_cameras(RIG, tmp_path / "calib.yaml")
    said = "two to be given (--topics LEFT RIGHT), of /back/picture, /front/image"
    one_line_error(lambda: open_sequence(path, calib=tmp_path / "calib.yaml"), said)
    sequence = open_sequence(path, calib=tmp_path / "calib.yaml", topics=names)
    assert (sequence.topics, len(sequence)) == (names, 3)
    one_line_error(
        lambda: open_sequence(path, topics=("/a", "/b")), "has no images on /a; expected one of /back/picture"
    )


def test_topics_go_with_a_bag_alone(tmp_path, sequence):
    one_line_error(
        lambda: open_sequence(sequence, topics=("/a", "/b")), "is no bag, expected one with topics /a and /b"
    )


def test_a_bag_without_images_names_what_it_has(tmp_path):
    ros = KINDS["ros1"]
    path = write(tmp_path / "a.bag", ros, {"/left/disparity": [ros.header(1)], "/left/camera_info": [info(ros, False)]})
    said = "has no topic with images; its topics are /left/disparity (std_msgs/msg/Header); expected sensor_msgs/Image"
    one_line_error(lambda: open_sequence(path), said)


def test_the_command_line_passes_topics_and_calibration_on(tmp_path, pairs, capsys):  # noqa: F811
    names = "/front/image", "/back/picture"
    path = write(tmp_path / "a.bag", KINDS["ros1"], bare(KINDS["ros1"], pairs, names))
    save_cameras(RIG, tmp_path / "calib.yaml")
    words = ["run", str(path), "--out", str(tmp_path / "run"), "--calib", str(tmp_path / "calib.yaml")]
    assert cli.exit_code(words) == cli.BAD_INPUT
    assert "--topics LEFT RIGHT" in capsys.readouterr().err
    assert cli.exit_code([*words, "--topics", "/front/image", "/nowhere"]) == cli.BAD_INPUT
    assert "has no images on /nowhere; expected one of /back/picture, /front/image" in capsys.readouterr().err
    assert cli.exit_code(["run", "--topics", *names]) == cli.USAGE
    assert cli.exit_code(["run", "a.png", "--depth", "d.png", "--topics", *names]) == cli.USAGE
    assert capsys.readouterr().err.count("goes with a bag alone") == 2


def message(model, D, x=0.0):
    """A CameraInfo of a raw camera."""
    K, R = np.array([60.0, 0, 31, 0, 61, 23.5, 0, 0, 1]), np.eye(3).ravel()
    P = np.array([60.0, 0, 31, x, 0, 61, 23.5, 0, 0, 0, 1, 0])
    return SimpleNamespace(width=64, height=48, distortion_model=model, d=np.array(D), k=K, r=R, p=P)


@pytest.mark.parametrize(
    ("model", "D", "lens"),
    [
        ("plumb_bob", (-0.1, 0.02, 0.001, -0.0005, 0.0), "brown"),
        ("rational_polynomial", (0.5, 0.25, 0.001, -0.0005, 0.125, 0.5, 0.25, 0.0625), "rational"),
        ("equidistant", (0.03, -0.01, 0.005, -0.002), "equidistant"),
        ("equidistant", (0.0, 0.0, 0.0, 0.0), "equidistant"),
        ("fisheye", (0.03, -0.01, 0.005, -0.002, 0.0), "equidistant"),
    ],
)
def test_a_camera_info_names_its_lens(model, D, lens):
    infos = (_ros.Info(topic, message(model, D, x)) for topic, x in (("/left", 0.0), ("/right", -7.5)))
    found = _ros.cameras(Path("drive.bag"), *infos, False)
    assert isinstance(found, RawRig)
    assert (found.left.lens, found.right.lens) == (lens, lens)
    assert found.left.distortion == D[: 4 if lens == "equidistant" else len(D)]
    assert found.T_right_left[0] == (1, 0, 0, -0.125)


@pytest.mark.parametrize(
    ("model", "D", "said"),
    [
        (
            "ocam",
            (0.1,),
            "/left.distortion_model is 'ocam', expected one of plumb_bob, rational_polynomial, equidistant",
        ),
        ("equidistant", (0.1, 0.2), "/left.D has 2 numbers, expected 4 or 5 or 8 numbers"),
        ("equidistant", (0.1, 0.2, 0.0, 0.0, 0.3), "/left.D[4] is 0.3, expected 0 after k1, k2, k3, k4"),
    ],
)
def test_a_lens_that_no_camera_info_has_is_refused(model, D, said):
    infos = [_ros.Info(topic, message(model, D, x)) for topic, x in (("/left", 0.0), ("/right", -7.5))]
    one_line_error(lambda: _ros.cameras(Path("drive.bag"), *infos, False), said)
    assert _ros.cameras(Path("drive.bag"), *infos, True).baseline == 0.125
