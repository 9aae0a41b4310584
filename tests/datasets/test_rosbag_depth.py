"""Colour and depth in bags: encodings of depths, cameras, clocks, and what is wrong with bad ones."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("rosbags")

from tspslam.datasets import RgbdBag, open_sequence
from tspslam.datasets._depth_image import depth_of
from tspslam.errors import InputError
from tspslam.types import Camera, FloatArray, RawRig
from tspslam.vision.calibration.formats.own import save_cameras

from .rgbd_folders import CAMERA, room
from .test_rosbag import KINDS, START, STEP, of_bytes, one_line_error, raw_image, write

COLOUR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
COUNT = 3


def png(values: np.ndarray) -> bytes:
    held = io.BytesIO()
    Image.fromarray(values).save(held, "png")
    return held.getvalue()


def millimetres(depth: FloatArray) -> np.ndarray:
    return np.where(depth < 10, np.rint(depth * 1000), 0).astype(np.uint16)


def info(ros: Any, D: tuple[float, ...] = (), model: str = "plumb_bob", fx: float = CAMERA.fx) -> Any:
    K = np.array([fx, 0, CAMERA.cx, 0, CAMERA.fy, CAMERA.cy, 0, 0, 1.0])
    P = np.array([fx, 0, CAMERA.cx, 0, 0, CAMERA.fy, CAMERA.cy, 0, 0, 0, 1.0, 0])
    return ros.info(ros.header(START), CAMERA.width, CAMERA.height, model, np.array(D), K, np.eye(3).ravel(), P)


def recording(
    ros: Any, encoding: str = "16UC1", depth: str = DEPTH, late: int = 0, change: Any = None, **infos: Any
) -> dict[str, list[Any]]:
    """Topics of a RealSense in a room."""
    walk = room(COUNT)
    make = {
        "16UC1": lambda t, z: raw_image(ros, t, millimetres(z), "16UC1"),
        "32FC1": lambda t, z: raw_image(ros, t, np.where(z < 10, z, np.nan).astype(np.float32), "32FC1"),
        "compressed": lambda t, z: of_bytes(
            ros, t, struct.pack("<i2f", 0, 0, 0) + png(millimetres(z)), "16UC1; compressedDepth"
        ),
    }[encoding]
    stamps = [START + k * STEP for k in range(COUNT)]
    topic = f"{depth}/compressedDepth" if encoding == "compressed" else depth
    return {
        COLOUR: [raw_image(ros, t, image, "mono8") for t, image in zip(stamps, walk.images, strict=True)],
        topic: [make(t + late, change(z) if change else z) for t, z in zip(stamps, walk.depths, strict=True)],
        "/camera/color/camera_info": [info(ros, **infos)],
    }


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
@pytest.mark.parametrize("encoding", ["16UC1", "32FC1", "compressed"])
def test_depths_of_a_bag_are_those_of_the_room(tmp_path: Path, kind: str, encoding: str) -> None:
    ros = KINDS[kind]
    sequence = open_sequence(write(tmp_path / ros.name, ros, recording(ros, encoding)))
    assert isinstance(sequence, RgbdBag)
    assert len(sequence) == COUNT
    assert (sequence.rig.fx, sequence.rig.cy) == (CAMERA.fx, CAMERA.cy)
    pair, rig = sequence[1], sequence.rig
    np.testing.assert_array_equal(pair.left, room(COUNT).images[1])
    assert pair.disparity is not None
    z, true = rig.fx * rig.baseline / pair.disparity, room(COUNT).depths[1]
    known = np.isfinite(z)
    assert known.mean() > 0.7
    np.testing.assert_allclose(z[known], true[known], atol=0.000501)
    assert sequence.describe()["calibration"] == "/camera/color/camera_info"


def test_floats_that_were_quantised_come_back() -> None:
    depth = np.array([[0.5, 1.0, 4.0, np.nan]])
    a, b = 100.0 * 101.0, -100.0
    values = np.where(np.isnan(depth), 0, np.rint(a / depth + b)).astype(np.uint16)
    data = np.frombuffer(struct.pack("<i2f", 0, a, b) + png(values), np.uint8)
    found = depth_of(SimpleNamespace(format="32FC1; compressedDepth", data=data), is_compressed=True)
    np.testing.assert_allclose(found, depth, rtol=3e-4)


@pytest.mark.parametrize(("said", "data", "message"), [
    ("16UC1; compressedDepth rvl", b"x" * 40, "RVL, not PNG"),
    ("16UC1; compressedDepth", b"x" * 12, "has 12 bytes, where a header of 12 goes before a PNG"),
    ("16UC1; compressedDepth", b"x" * 90, "is not an image, or its header is damaged"),
    ("16UC1; compressedDepth", b"x" * 12 + png(np.zeros((4, 4), np.uint8)), "holds uint8 of shape"),
    ("16UC1; compressedDepth", b"x" * 12 + png(np.ones((64, 64), np.uint16))[:-30], "is truncated"),
    ("8UC1; compressedDepth", b"\0" * 12 + png(np.ones((4, 4), np.uint16)), "where 16UC1 or 32FC1 go"),
    ("32FC1; compressedDepth", b"\0" * 12 + png(np.ones((4, 4), np.uint16)), "where 16UC1 or 32FC1 go"),
])  # fmt: skip
def test_packed_depths_that_are_none_are_refused(said: str, data: bytes, message: str) -> None:
    with pytest.raises(InputError, match=message):
        depth_of(SimpleNamespace(format=said, data=np.frombuffer(data, np.uint8)), is_compressed=True)


@pytest.mark.parametrize(("change", "message"), [
    ({"encoding": "rgb8"}, "has the encoding 'rgb8', where depths have one of 16UC1"),
    ({"step": 7}, "and a step of 7, where 4 x 3 px of 16UC1 go with a step of 8 or more"),
    ({"width": 10**9}, "px"),
])  # fmt: skip
def test_raw_depths_that_are_none_are_refused(change: dict[str, Any], message: str) -> None:
    given = {"encoding": "16UC1", "width": 4, "height": 3, "step": 8, "is_bigendian": 0, "data": np.zeros(24, np.uint8)}
    with pytest.raises(InputError, match=message):
        depth_of(SimpleNamespace(**given | change), is_compressed=False)


def test_depths_of_another_camera_need_a_calibration_of_both(tmp_path: Path) -> None:
    ros, topic = KINDS["ros1"], "/camera/depth/image_rect_raw"
    topics = recording(ros, depth=topic) | {"/camera/depth/camera_info": [info(ros, fx=200.0)]}
    path = write(tmp_path / ros.name, ros, topics)
    one_line_error(lambda: open_sequence(path), f"depths on {topic} are of another camera than images on {COLOUR}")
    camera = Camera(200.0, 200.0, CAMERA.cx, CAMERA.cy, CAMERA.width, CAMERA.height)
    aside = ((1.0, 0.0, 0.0, -0.02), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    save_cameras(RawRig(camera, camera, aside), tmp_path / "both.yaml")
    sequence = open_sequence(path, calib=tmp_path / "both.yaml")
    assert isinstance(sequence, RgbdBag)
    assert sequence.describe()["is_registered_here"] is True


def test_depths_of_the_same_camera_need_no_word_in_the_topic(tmp_path: Path) -> None:
    ros, topic = KINDS["ros1"], "/camera/depth/image_rect_raw"
    topics = recording(ros, depth=topic) | {"/camera/depth/camera_info": [info(ros)]}
    assert len(open_sequence(write(tmp_path / ros.name, ros, topics), topics=(COLOUR, topic))) == COUNT


@pytest.mark.parametrize(("given", "message"), [
    ({"change": lambda z: 0 * z}, "no depth is known in 3 maps"),
    ({"change": lambda z: z / 200}, "expected 0.3 to 10 m: is the unit right"),
    ({"late": 10**12}, "expected images with stamps in common"),
    ({"model": "mei"}, "distortion_model is 'mei', expected one of plumb_bob"),
    ({"D": (0.1,) * 7}, "camera_info.D has 7 numbers, expected 4 or 5 or 8"),
])  # fmt: skip
def test_bad_bags_are_refused_in_one_line(tmp_path: Path, given: dict[str, Any], message: str) -> None:
    ros = KINDS["ros1"]
    path = write(tmp_path / ros.name, ros, recording(ros, **given))
    one_line_error(lambda: open_sequence(path), message)


def test_topics_that_cannot_be_told_are_to_be_given(tmp_path: Path) -> None:
    ros = KINDS["ros1"]
    topics = recording(ros)
    topics["/other/rgb/image_raw"] = topics[COLOUR]
    path = write(tmp_path / ros.name, ros, topics)
    one_line_error(lambda: open_sequence(path), "has 2 topics of colour images; expected topics to be given (--topics")
    one_line_error(lambda: RgbdBag(path, colour="/none"), "has no images on /none")
    assert len(open_sequence(path, topics=(COLOUR, DEPTH))) == COUNT
