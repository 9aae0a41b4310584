"""Bags of ROS 1 and ROS 2, written with the writers of rosbags: pairs, stamps, rigs, and what is wrong with bad ones."""

import gc
import io
import os
import shutil
import sqlite3
import struct
import sys
import tempfile
import threading
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("rosbags")
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from tspslam import datasets
from tspslam.datasets import RosbagSequence, _encodings, _ros, open_sequence, synthetic
from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.calibration.rectify import rectification

RIG = Rig(fx=60.0, fy=61.0, cx=31.0, cy=23.5, baseline=0.125, width=64, height=48, doffs=1.5)
START, STEP, COUNT = 1_700_000_000_123_456_789, 50_000_000, 3
LEFT, RIGHT = "/stereo/left/image_rect", "/stereo/right/image_rect"
RAW = "/stereo/left/image_raw", "/stereo/right/image_raw"
PLUMB = (-0.1, 0.02, 0.001, -0.0005, 0.0)


@pytest.fixture(scope="module")
def pairs():
    wall = synthetic.Scene((synthetic.plane(8, 6, texture=synthetic.Texture(1, 0.1)).at(0, 0, 4),))
    scene = replace(wall, path=np.repeat(wall.path, COUNT, axis=0))
    return list(synthetic.SyntheticSequence(scene, RIG, synthetic.Faults(noise=0.02), seed=3))


class Ros1:
    name, store = "drive.bag", get_typestore(Stores.ROS1_NOETIC)

    def open(self, path):
        return Writer1(path)

    def bytes_of(self, message):
        return self.store.serialize_ros1(message, message.__msgtype__)

    def header(self, stamp, **more):
        time = self.store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
        return self.store.types["std_msgs/msg/Header"](seq=7, stamp=time, frame_id="camera")

    def info(self, header, width, height, model, D, K, R, P):
        roi = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        return self.store.types["sensor_msgs/msg/CameraInfo"](header, height, width, model, D, K, R, P, 0, 0, roi)


class Ros2(Ros1):
    name, store, plugin = "drive", get_typestore(Stores.ROS2_HUMBLE), StoragePlugin.SQLITE3

    def open(self, path):
        return Writer2(path, version=9, storage_plugin=self.plugin)

    def bytes_of(self, message):
        return self.store.serialize_cdr(message, message.__msgtype__)

    def header(self, stamp):
        time = self.store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
        return self.store.types["std_msgs/msg/Header"](stamp=time, frame_id="camera")


class Packed1(Ros1):
    def open(self, path):
        writer = Writer1(path)
        writer.set_compression(writer.CompressionFormat.LZ4)
        return writer


class Packed1Bz2(Ros1):
    def open(self, path):
        writer = Writer1(path)
        writer.set_compression(writer.CompressionFormat.BZ2)
        return writer


class Mcap(Ros2):
    plugin = StoragePlugin.MCAP


class Packed2(Ros2):
    mode = CompressionMode.FILE

    def open(self, path):
        writer = super().open(path)
        writer.set_compression(self.mode, CompressionFormat.ZSTD)
        return writer


class PackedMessages(Packed2):
    mode = CompressionMode.MESSAGE


class PackedMcap(Packed2):
    mode, plugin = CompressionMode.STORAGE, StoragePlugin.MCAP


KINDS = {
    "ros1": Ros1(),
    "ros1-lz4": Packed1(),
    "ros1-bz2": Packed1Bz2(),
    "sqlite3": Ros2(),
    "mcap": Mcap(),
    "mcap-zstd": PackedMcap(),
    "sqlite3-zstd": Packed2(),
    "sqlite3-message": PackedMessages(),
}


def raw_image(ros, stamp, pixels, encoding=None, *, step=None, big=False, **more):
    """An Image; rows are padded with 7s up to `step`."""
    given = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
    rows = np.frombuffer(given.tobytes(), np.uint8).reshape(len(pixels), -1)
    rows = np.pad(rows, ((0, 0), (0, (step or rows.shape[1]) - rows.shape[1])), constant_values=7)
    encoding = encoding or {1: "mono8", 2: "mono16"}[pixels.itemsize]
    said = {"height": pixels.shape[0], "width": pixels.shape[1], "step": rows.shape[1], "data": rows.ravel()} | more
    kind = ros.store.types["sensor_msgs/msg/Image"]
    return kind(header=ros.header(stamp), encoding=encoding, is_bigendian=int(big), **said)


def packed_image(ros, stamp, pixels, suffix="png", said=None):
    held = io.BytesIO()
    Image.fromarray(pixels).save(held, suffix)
    return of_bytes(ros, stamp, held.getvalue(), said or suffix)


def of_bytes(ros, stamp, data, said="png"):
    kind = ros.store.types["sensor_msgs/msg/CompressedImage"]
    return kind(ros.header(stamp), said, np.frombuffer(data, np.uint8))


def info(ros, right, *, D=(), R=None, K=None, model="plumb_bob", size=(64, 48), **P):
    """CameraInfo of a side of RIG; `P` replaces numbers of the projection matrix, as P3=-1."""
    project = np.array([[RIG.fx, 0, RIG.cx, 0], [0, RIG.fy, RIG.cy, 0], [0, 0, 1, 0]], float)
    if right:
        project[0, 2:] = RIG.cx + RIG.doffs, -RIG.fx * RIG.baseline
    for at, value in P.items():
        project.ravel()[int(at[1:])] = value
    K = project[:, :3] if K is None else np.asarray(K, float)
    R = np.eye(3) if R is None else np.asarray(R, float)
    return ros.info(ros.header(START), *size, model, np.array(D, float), K.ravel(), R.ravel(), project.ravel())


def write(path, ros, topics):
    """Write messages by topic, each a message or (time of recording, message)."""
    with ros.open(path) as writer:
        for topic, messages in topics.items():
            given = [each if isinstance(each, tuple) else (START + k * STEP, each) for k, each in enumerate(messages)]
            link = writer.add_connection(topic, given[0][1].__msgtype__, typestore=ros.store)
            for time, message in given:
                writer.write(link, time, ros.bytes_of(message))
    return path


def drive(ros, pairs, topics=(LEFT, RIGHT), late=0, make=raw_image, **more):
    """Topics of a rectified drive."""
    stamps = [START + k * STEP for k in range(len(pairs))]
    beside = [f"{topic.removesuffix('/compressed').rpartition('/')[0]}/camera_info" for topic in topics]
    return {
        topics[0]: [make(ros, t, pair.left) for t, pair in zip(stamps, pairs, strict=True)],
        topics[1]: [make(ros, t + late, pair.right) for t, pair in zip(stamps, pairs, strict=True)],
        beside[0]: [info(ros, False, **more)],
        beside[1]: [info(ros, True, **more)],
    }


def one_line_error(call, said):
    with pytest.raises(InputError) as error:
        call()
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_is_a_sequence_of_pairs(tmp_path, pairs, kind):
    ros = KINDS[kind]
    sequence = open_sequence(write(tmp_path / ros.name, ros, drive(ros, pairs)))
    assert type(sequence) is RosbagSequence
    assert sequence.topics == (LEFT, RIGHT)
    assert (sequence.name, len(sequence), sequence.unpaired) == ("drive", COUNT, [])
    assert sequence.rig == RIG
    assert sequence.stamps.tolist() == [(START + k * STEP) / 10**9 for k in range(COUNT)]
    for k in (2, 0, 1, -1):
        pair = sequence[k]
        assert (pair.index, pair.stamp) == (k % COUNT, sequence.stamps[k])
        assert pair.name == str(START + k % COUNT * STEP)
        assert pair.left.tobytes() == pairs[k].left.tobytes()
        assert pair.right.tobytes() == pairs[k].right.tobytes()
    assert [pair.index for pair in sequence] == [0, 1, 2]
    with pytest.raises(IndexError):
        sequence[COUNT]
    one_line_error(lambda: sequence["0"], "expected a whole number from -3 to 2")


@pytest.mark.parametrize("make", ["raw_image", "packed_image"])
@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_the_bits_of_a_bag_s_pixels_are_found_or_taken(tmp_path, pairs, kind, make):
    ros, to_16 = KINDS[kind], lambda image: image.astype(np.uint16) * 16 + 1  # a camera of 12 bits
    given = [replace(pair, left=to_16(pair.left), right=to_16(pair.right)) for pair in pairs]
    topics = (LEFT, RIGHT) if make == "raw_image" else (f"{LEFT}/compressed", f"{RIGHT}/compressed")
    path = write(tmp_path / ros.name, ros, drive(ros, given, topics, make=globals()[make]))
    for bits, scale in ((None, 16), (14, 4)):
        pair = open_sequence(path, bits=bits)[1]
        assert pair.bits == (bits or 12)
        np.testing.assert_array_equal(pair.left, given[1].left * scale)


@pytest.mark.parametrize(("kind", "suffix"), [("sqlite3", ".db3"), ("mcap", ".mcap")])
def test_a_bare_file_of_a_ros_2_bag_is_read(tmp_path, pairs, kind, suffix):
    write(tmp_path / "drive", KINDS[kind], drive(KINDS[kind], pairs))
    sequence = open_sequence((tmp_path / "drive" / "drive").with_suffix(suffix))
    assert (sequence.name, len(sequence), sequence.rig) == ("drive", COUNT, RIG)
    assert sequence[1].right.tobytes() == pairs[1].right.tobytes()


def test_a_bag_without_definitions_of_its_messages_is_read(tmp_path, pairs):
    ros = KINDS["sqlite3"]
    path = write(tmp_path / "drive", ros, drive(ros, pairs))
    with sqlite3.connect(path / "drive.db3") as base:
        base.execute("DELETE FROM message_definitions")
    base.close()
    assert RosbagSequence(path)[0].left.tobytes() == pairs[0].left.tobytes()


ENCODINGS = {
    "mono8": ((), np.uint8, slice(None)),
    "8UC1": ((), np.uint8, slice(None)),
    "mono16": ((), np.uint16, slice(None)),
    "16UC1": ((), np.uint16, slice(None)),
    "rgb8": ((3,), np.uint8, (..., [0, 1, 2])),
    "bgr8": ((3,), np.uint8, (..., [2, 1, 0])),
    "rgba8": ((4,), np.uint8, (..., [0, 1, 2])),
    "bgra8": ((4,), np.uint8, (..., [2, 1, 0])),
}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("pad", [0, 5])
def test_every_encoding_gives_its_pixels(encoding, big, pad):
    shape, dtype, wanted = ENCODINGS[encoding]
    pixels = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (5, 7, *shape), dtype, endpoint=True)
    step = pixels[0].nbytes + pad
    read = _encodings.image_of(raw_image(KINDS["ros1"], START, pixels, encoding, big=big, step=step), _ros.IMAGE)
    assert read.dtype == dtype
    assert read.dtype.isnative
    np.testing.assert_array_equal(read, pixels[wanted])


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_bayer_mosaic_becomes_colour(order):
    colour = np.array([200, 90, 20], np.uint8)
    mosaic = np.zeros((8, 10), np.uint8)
    for k, letter in enumerate(order):
        mosaic[k // 2 :: 2, k % 2 :: 2] = colour["rgb".index(letter)]
    read = _encodings.image_of(raw_image(KINDS["ros1"], START, mosaic, f"bayer_{order}8", step=13), _ros.IMAGE)
    np.testing.assert_array_equal(read, np.broadcast_to(colour, (8, 10, 3)))


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_compressed_images_are_decoded(tmp_path, pairs, kind):
    ros = KINDS[kind]
    topics = f"{LEFT}/compressed", f"{RIGHT}/compressed"
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, drive(ros, pairs, topics, make=packed_image)))
    assert sequence.topics == topics
    assert sequence[1].left.tobytes() == pairs[1].left.tobytes()
    colour = np.full((48, 64, 3), (200, 100, 20), np.uint8)
    read = _encodings.image_of(packed_image(ros, START, colour, "jpeg", "bgr8; jpeg compressed bgr8"), _ros.COMPRESSED)
    assert np.abs(read.astype(int) - colour).max() < 6


def damaged(data):
    return data[:60] + bytes([data[60] ^ 255]) + data[61:]


def encoded(suffix, **more):
    held = io.BytesIO()
    Image.fromarray(np.random.default_rng(2).integers(0, 255, (64, 64), np.uint8)).save(held, suffix, **more)
    return held.getvalue()


def coloured(suffix):
    held = io.BytesIO()
    Image.new("RGB", (8, 8), (200, 10, 10)).save(held, suffix)
    return held.getvalue()


def huge_png(width, height):
    data = encoded("png")
    header = b"IHDR" + struct.pack(">II", width, height) + data[24:29]
    return data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:]


def said(**more):
    """An Image of 6 x 4 zeros as a damaged bag could have it."""
    right = {"width": 6, "height": 4, "step": 6, "data": np.zeros(24, np.uint8), "encoding": "mono8", "is_bigendian": 0}
    return SimpleNamespace(**(right | more))


def held(data, said="jpeg"):
    return SimpleNamespace(data=np.frombuffer(data, np.uint8), format=said)


BAD_IMAGES = {
    "has the encoding 'bayer_rgbw8'": said(encoding="bayer_rgbw8"),
    "has the encoding '32FC1', not one of": said(encoding="32FC1"),
    "no luminance": said(encoding="32FC1"),
    "is 5 x 4 px of yuv422, where colour that pixels share": said(
        encoding="yuv422", width=5, step=10, data=np.zeros(40, np.uint8)
    ),
    "is 6 x 3 px of nv12": said(encoding="nv12", height=3),
    "24 bytes of data and a step of 6, where 6 x 4 px of nv21 go with": said(encoding="nv21"),
    "is a Bayer mosaic of 6 x 2 px": said(encoding="bayer_rggb8", height=2, data=np.zeros(12, np.uint8)),
    "has the encoding ''": said(encoding=""),
    "is 0 x 4 px": said(width=0),
    "is 40000 x 4 px": said(width=40_000, step=40_000),
    "is 9000 x 9000 px": said(width=9000, height=9000, step=9000),
    "24 bytes of data and a step of 5": said(step=5),
    "24 bytes of data and a step of 6, where 6 x 5": said(height=5),
    "24 bytes of data and a step of 4294967295": said(step=2**32 - 1),
    "23 bytes of data": said(data=np.zeros(23, np.uint8)),
    "a step of 12 or somewhat more": said(encoding="mono16"),
    "98308 bytes of data and a step of 24577": said(step=24_577, data=np.zeros(4 * 24_577, np.uint8)),
    "is a BMP": held(encoded("bmp")),
    "is not an image": held(b"no image at all"),
    "is truncated": held(encoded("png")[:-20]),
    "has a wrong checksum": held(damaged(encoded("png"))),
    "is 7000 x 9999 px": held(huge_png(7000, 9999)),
    "has more than 64000000 px": held(huge_png(2**31 - 1, 2**31 - 1)),
    "cannot be decoded": held(encoded("jpeg")[:-40]),
    "has the format 'bayer_rgbw8; jpeg compressed': another order of colours": held(
        encoded("jpeg"), "bayer_rgbw8; jpeg compressed"
    ),
    "an image in colour, not a grey mosaic": held(coloured("jpeg"), "bayer_rggb8; jpeg compressed"),
}


@pytest.mark.parametrize("wanted", BAD_IMAGES)
def test_a_bad_image_is_refused_before_its_memory_is_taken(wanted):
    message = BAD_IMAGES[wanted]
    kind = _ros.COMPRESSED if hasattr(message, "format") else _ros.IMAGE
    one_line_error(lambda: _encodings.image_of(message, kind), wanted)


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_bad_image_spoils_its_pair_alone_and_is_named(tmp_path, pairs, kind):
    ros = KINDS[kind]
    topics = drive(ros, pairs)
    topics[RIGHT][1].encoding = "yuv411"
    topics[LEFT][2] = raw_image(ros, START + 2 * STEP, pairs[2].left[:, :60])
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, topics))
    assert sequence[0].index == 0
    line = one_line_error(lambda: sequence[1], "has the encoding 'yuv411'")
    assert line.startswith(f"{tmp_path / ros.name}: the image on {RIGHT} at {START + STEP} ns")
    line = one_line_error(lambda: sequence[2], "left image is 60 x 48 px, right 64 x 48 px")
    assert line.startswith(f"{tmp_path / ros.name}: {START + 2 * STEP}: ")


def test_pairs_are_found_by_stamps_of_headers_never_by_position(tmp_path, pairs):
    ros = KINDS["ros1"]
    topics = drive(ros, pairs, late=STEP // 5)
    del topics[RIGHT][1]
    topics[LEFT] = [(START + 9 * STEP + k, each) for k, each in enumerate(topics[LEFT])]  # recorded after all others
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, topics))
    assert sequence.unpaired == [f"{LEFT}/{START + STEP}"]
    assert [pair.name for pair in sequence] == [str(START), str(START + 2 * STEP)]
    for k, pair in zip((0, 2), sequence, strict=True):
        assert pair.left.tobytes() == pairs[k].left.tobytes()
        assert pair.right.tobytes() == pairs[k].right.tobytes()


def test_stamps_too_far_apart_are_no_pairs(tmp_path, pairs):
    path = write(tmp_path / "a.bag", KINDS["ros1"], drive(KINDS["ros1"], pairs, late=STEP // 3))
    one_line_error(lambda: RosbagSequence(path), "has no pair of images (6 without partner or stamp)")


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize("topic", [LEFT, RIGHT])
def test_stamps_that_go_back_or_lie_too_far_apart_are_refused(tmp_path, pairs, kind, topic):
    ros = KINDS[kind]
    topics = drive(ros, pairs)
    topics[topic] = [topics[topic][k] for k in (1, 0, 2)]
    path = write(tmp_path / ros.name, ros, topics)
    line = one_line_error(lambda: RosbagSequence(path), "expected stamps in nanoseconds that increase")
    assert line.startswith(f"{path}: {topic}: stamp 2 is 1700000000.123456717 s, that before it 1700000000.173456")
    topics[topic] = [raw_image(ros, START + k * 61 * 10**9, pair.left) for k, pair in enumerate(pairs)]
    one_line_error(lambda: RosbagSequence(write(tmp_path / f"far{ros.name}", ros, topics)), "61 s apart in the median")


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_a_stamp_that_comes_again_is_reported(tmp_path, pairs, kind):
    ros = KINDS[kind]
    topics = drive(ros, pairs)
    topics[LEFT].append(raw_image(ros, START, pairs[0].right))
    topics[RIGHT] = [(START, each) for each in topics[RIGHT]]  # all recorded at one time
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, topics))
    assert sequence.unpaired == [f"{LEFT}/{START}"]
    assert sequence[0].left.tobytes() == pairs[0].left.tobytes()
    assert [pair.right.tobytes() for pair in sequence] == [pair.right.tobytes() for pair in pairs]


def test_stamps_of_zero_or_none_are_refused(tmp_path, pairs):
    ros = KINDS["sqlite3"]
    topics = drive(ros, pairs)
    zeros = topics | {RIGHT: [raw_image(ros, 0, pair.right) for pair in pairs]}
    one_line_error(lambda: RosbagSequence(write(tmp_path / "zero", ros, zeros)), f"all stamps on {RIGHT} are 0")
    for stamp, wanted in ((-5 * 10**9, "the stamp -5 s 0 ns"), (START, "the stamp 1700000000 s 4000000000 ns")):
        topics[LEFT][0] = raw_image(ros, stamp, pairs[0].left)
        if stamp > 0:
            topics[LEFT][0].header.stamp.nanosec = 4 * 10**9
        path = tmp_path / f"{stamp}"
        one_line_error(lambda path=path: RosbagSequence(write(path, ros, topics)), wanted)


NAMES = {
    ("/cam0/image_raw", "/cam1/image_raw"): ("/cam0/image_raw", "/cam1/image_raw"),
    ("/d/infra1/image_rect_raw", "/d/infra2/image_rect_raw"): ("/d/infra1/image_rect_raw", "/d/infra2/image_rect_raw"),
    ("/kitti/image_0", "/kitti/image_1", "/kitti/image_2"): ("/kitti/image_0", "/kitti/image_1"),
    ("/camera_left/image_left", "/camera_right/image_right"): ("/camera_left/image_left", "/camera_right/image_right"),
    (*RAW, LEFT, RIGHT): (LEFT, RIGHT),
    (LEFT, RIGHT, f"{LEFT}/compressed", f"{RIGHT}/compressed"): (LEFT, RIGHT),
    (*RAW, f"{LEFT}/compressed", f"{RIGHT}/compressed"): (f"{LEFT}/compressed", f"{RIGHT}/compressed"),
    ("/camera0/image", "/camera1/image", "/camera2/image"): ("/camera0/image", "/camera1/image"),
    ("/kitti/image_00", "/kitti/image_01"): ("/kitti/image_00", "/kitti/image_01"),
    ("/direct/left", "/direct/right", "/unrect/left", "/rect/right"): ("/direct/left", "/direct/right"),
}


def typed(topics):
    return {topic: _ros.COMPRESSED if topic.endswith("/compressed") else _ros.IMAGE for topic in topics}


@pytest.mark.parametrize("topics", NAMES)
def test_topics_are_found_by_their_names(tmp_path, topics):
    assert _ros.sides(tmp_path, typed(topics), None, None) == NAMES[topics]


def test_topics_with_camera_infos_go_before_those_without(tmp_path, pairs):
    ros = KINDS["ros1"]
    bare = "/debug/left/image_rect", "/debug/right/image_rect"
    extra = {topic: [raw_image(ros, START, pairs[0].left)] for topic in bare}
    path = write(tmp_path / "a.bag", ros, drive(ros, pairs, RAW) | extra)
    assert RosbagSequence(path).topics == RAW
    places = "/debug/left/camera_info or /debug/left/image_rect/camera_info"
    one_line_error(
        lambda: RosbagSequence(path, left=bare[0]), f"has no CameraInfo of {bare[0]}; expected one on {places}"
    )


def test_topics_that_cannot_be_told_are_listed(tmp_path, pairs):
    ros = KINDS["ros1"]
    colour = "/stereo/left/image_rect_color", "/stereo/right/image_rect_color"
    topics = drive(ros, pairs) | drive(ros, pairs, colour)
    path = write(tmp_path / "a.bag", ros, topics)
    line = one_line_error(lambda: RosbagSequence(path), "has 2 pairs of topics")
    assert f"two to be given (--topics LEFT RIGHT), of {LEFT}, {colour[0]}, {RIGHT}, {colour[1]}" in line
    assert RosbagSequence(path, left=colour[0]).topics == colour
    assert RosbagSequence(path, right=RIGHT).topics == (LEFT, RIGHT)
    assert RosbagSequence(path, left=LEFT, right=colour[1]).topics == (LEFT, colour[1])
    one_line_error(lambda: RosbagSequence(path, left="/other"), f"has no images on /other; expected one of {LEFT}")
    one_line_error(lambda: RosbagSequence(path, left=["a"]), "has no images on ['a']")
    one_line_error(lambda: RosbagSequence(path, left=LEFT, right=LEFT), f"left and right are both {LEFT}")
    one_line_error(lambda: _ros.sides(path, typed(["/front/image", "/left/image"]), None, None), "has no pairs of")
    one_line_error(lambda: _ros.sides(path, {}, None, None), "has no topic with images; expected")
    many = typed(f"/camera{k:02d}/image" for k in range(25))
    assert one_line_error(lambda: _ros.sides(path, many, None, None), "and 5 more").count("/image") == 20


def test_topics_without_messages_and_depth_are_passed_over(tmp_path, pairs):
    ros = KINDS["ros1"]
    depth = "/stereo/left/image_rect/compressedDepth", "/stereo/right/image_rect/compressedDepth"
    packed = {topic: [packed_image(ros, START, pairs[0].left)] for topic in depth}
    with ros.open(tmp_path / "a.bag") as writer:
        for topic, messages in (drive(ros, pairs) | packed).items():
            link = writer.add_connection(topic, messages[0].__msgtype__, typestore=ros.store)
            for message in messages:
                writer.write(link, START, ros.bytes_of(message))
        for topic in ("/stereo/left/image_rect_color", "/stereo/right/image_rect_color"):
            writer.add_connection(topic, _ros.IMAGE, typestore=ros.store)
    assert RosbagSequence(tmp_path / "a.bag").topics == (LEFT, RIGHT)


def test_raw_images_of_cameras_with_nothing_to_rectify_stay(tmp_path, pairs):
    ros = KINDS["mcap"]
    sequence = RosbagSequence(write(tmp_path / "a", ros, drive(ros, pairs, RAW, D=[0.0] * 5)))
    assert sequence.rig == RIG
    assert sequence[0].left.tobytes() == pairs[0].left.tobytes()


def test_rectified_images_are_of_p_whatever_the_lens(tmp_path, pairs):
    ros = KINDS["mcap"]
    lens = {"D": (0.1, 0.2, 0.3, 0.4), "model": "equidistant", "K": np.diag([50, 50, 1])}
    assert RosbagSequence(write(tmp_path / "a", ros, drive(ros, pairs, **lens))).rig == RIG


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


@pytest.mark.parametrize("kind", ["ros1", "sqlite3"])
def test_raw_images_are_rectified(tmp_path, pairs, kind):
    ros = KINDS[kind]
    topics = drive(ros, pairs, RAW, D=PLUMB)
    R = turn(0.02), turn(-0.03)
    K = [[70, 0, 32], [0, 71, 24], [0, 0, 1]]
    for side, (name, R_side) in enumerate(zip(("left", "right"), R, strict=True)):
        topics[f"/stereo/{name}/camera_info"] = [info(ros, bool(side), D=PLUMB, R=R_side, K=K)]
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, topics))
    x = np.array([0.3, -0.2, 4.0])  # in the left camera's frame
    beside = R[1].T @ (R[0] @ x - (RIG.baseline, 0, 0))
    raw = sequence._reader.rectify.raw
    np.testing.assert_allclose(raw.matrix @ (*x, 1), (*beside, 1), atol=1e-12)
    assert (raw.left.fx, raw.left.fy, raw.left.cx, raw.left.distortion) == (70, 71, 32, PLUMB)
    made = rectification(raw)
    assert sequence.rig == made.rig
    assert sequence.rig.baseline == pytest.approx(RIG.baseline)
    expected = made(pairs[1].left, pairs[1].right)
    assert [sequence[1].left.tobytes(), sequence[1].right.tobytes()] == [each.tobytes() for each in expected]


@pytest.mark.parametrize("lens", [{"R": turn(0.02)}, {"K": [[62, 0, 31], [0, 61, 23.5], [0, 0, 1]]}])
def test_a_turn_or_another_k_alone_is_rectified_too(tmp_path, pairs, lens):
    sequence = RosbagSequence(write(tmp_path / "a.bag", KINDS["ros1"], drive(KINDS["ros1"], pairs, RAW, **lens)))
    assert sequence._reader.rectify is not None


BAD_CAMERAS = {
    "distortion_model is 'ocam', expected one of plumb_bob": {"model": "ocam", "D": [0.0] * 4},
    "camera_info.D[12] (tx) is 0.1, expected 0": {"model": "rational_polynomial", "D": [0.0] * 12 + [0.1, 0]},
    "camera_info.D has 3 numbers": {"D": [0.1] * 3},
    "camera_info.D[1] is nan": {"D": [0.1, np.nan, 0, 0, 0]},
    "camera_info.R holds no rotation": {"R": np.zeros((3, 3))},
    "camera_info.K[0,0] is 0, expected a focal length": {"K": np.diag([0, 60, 1])},
    "camera_info.P[0,0] is 0, expected a focal length": {"P0": 0},
    "camera_info.P[0,3] is -5": {"P3": -5},
    "camera_info.P[1,3] is 1": {"P7": 1},
    "camera_info.width is 0": {"size": (0, 48)},
    "folds its image": {"D": (-9.0, 0, 0, 0, 0)},
}


@pytest.mark.parametrize("wanted", BAD_CAMERAS)
def test_bad_cameras_are_refused_with_their_topic(tmp_path, pairs, wanted):
    path = write(tmp_path / "a.bag", KINDS["ros1"], drive(KINDS["ros1"], pairs, RAW, **BAD_CAMERAS[wanted]))
    line = one_line_error(lambda: RosbagSequence(path), wanted)
    assert line.startswith(f"{path}: ")
    assert line.count(str(path)) == 1


def test_swapped_missing_and_differing_cameras_are_refused(tmp_path, pairs):
    ros = KINDS["ros1"]
    topics = drive(ros, pairs)
    path = write(tmp_path / "a.bag", ros, topics)
    one_line_error(lambda: RosbagSequence(path, left=RIGHT, right=LEFT), "/stereo/right/camera_info.P[0,3] is -7.5")
    topics["/stereo/right/camera_info"] = [info(ros, True, P3=7.5)]
    swapped = write(tmp_path / "b.bag", ros, topics)
    one_line_error(lambda: RosbagSequence(swapped), "left and right look swapped")
    topics["/stereo/right/camera_info"] = [info(ros, True, P5=70)]
    other = write(tmp_path / "c.bag", ros, topics)
    one_line_error(lambda: RosbagSequence(other), "is 61, /stereo/right/camera_info.P[1,1] is 70, expected the same")
    del topics["/stereo/right/camera_info"]
    lone = write(tmp_path / "d.bag", ros, topics)
    places = "/stereo/right/camera_info or /stereo/right/image_rect/camera_info"
    one_line_error(lambda: RosbagSequence(lone), f"has no CameraInfo of {RIGHT}; expected one on {places}")
    topics["/stereo/right/image_rect/camera_info"] = [info(ros, True)]
    assert RosbagSequence(write(tmp_path / "e.bag", ros, topics)).rig == RIG


@pytest.mark.parametrize("kind", ["ros1", "ros1-lz4", "sqlite3", "mcap"])
def test_a_damaged_bag_never_gives_a_traceback(tmp_path, pairs, kind):
    ros = KINDS[kind]
    path = write(tmp_path / ros.name, ros, drive(ros, pairs))
    file = path if path.is_file() else next(each for each in path.iterdir() if each.suffix in (".db3", ".mcap"))
    whole, rng = file.read_bytes(), np.random.default_rng(5)
    cuts = [whole[: int(part * len(whole))] for part in (0, 0.001, 0.01, 0.3, 0.7, 0.99, 0.9999)]
    for _ in range(60):
        flipped = np.frombuffer(whole, np.uint8).copy()
        flipped[rng.integers(0, len(whole), 20)] ^= rng.integers(1, 255, 20, np.uint8)
        cuts.append(flipped.tobytes())
    refused = []
    for data in cuts:
        file.write_bytes(data)
        try:
            _ = list(RosbagSequence(path))
        except InputError as error:
            refused.append(str(error))
    assert len(refused) >= 5
    assert all(line.startswith((f"{path}: ", f"{file}: ")) and "\n" not in line for line in refused)


def test_other_faults_of_bags_get_one_line(tmp_path, pairs):
    ros = KINDS["sqlite3"]
    path = write(tmp_path / "drive", ros, drive(ros, pairs))
    metadata = (path / "metadata.yaml").read_text()
    listed = "rosbag2_bagfile_information: {relative_file_paths: [a.db3, %s], compression_mode: %s}"
    for text, wanted in (
        ("", "is empty"),
        ("a: [", "metadata.yaml: "),
        ("7", "is a int, not a mapping"),
        ("rosbag2_bagfile_information: {version: 99}", "lists no files"),
        (listed % ("b/a.db3", "none"), "lists a file twice"),
        (listed % ("b.db3", "file"), "says that file is packed by None; expected file or message, by zstd"),
        (listed % ("b.txt", "none"), "a.db3: cannot be opened"),
    ):
        (path / "metadata.yaml").write_text(text)
        assert "metadata.yaml" in one_line_error(lambda: RosbagSequence(path), wanted) or "a.db3" in wanted
    (path / "metadata.yaml").write_text(metadata)
    with sqlite3.connect(path / "drive.db3") as base:
        base.execute("UPDATE messages SET data = x'00010000'")
    base.close()
    one_line_error(lambda: RosbagSequence(path), "cannot be read (")
    with sqlite3.connect(path / "drive.db3") as base:
        base.execute("DELETE FROM messages")
    base.close()
    one_line_error(
        lambda: RosbagSequence(path), "has no topic with images; its topics are /stereo/left/camera_info (no message)"
    )
    (path / "drive.db3").unlink()
    one_line_error(lambda: RosbagSequence(path), "drive.db3: cannot be opened (No such file")
    one_line_error(lambda: RosbagSequence(tmp_path), "metadata.yaml: cannot be opened")


def test_messages_too_short_for_a_stamp_or_gone_are_refused(tmp_path, pairs):
    ros = KINDS["sqlite3"]
    path = write(tmp_path / "drive", ros, drive(ros, pairs))
    sequence = RosbagSequence(path)
    sequence._stored._times[0] = dict.fromkeys(sequence._stored._times[0], START + 9 * STEP)
    one_line_error(lambda: sequence[0], f"the image on {LEFT} at {START} ns is gone")
    with sqlite3.connect(path / "drive.db3") as base:
        topic = base.execute("SELECT id FROM topics WHERE name = ?", (RIGHT,)).fetchone()[0]
        base.execute("UPDATE messages SET data = x'00010000' WHERE topic_id = ?", (topic,))
    base.close()
    one_line_error(lambda: RosbagSequence(path), f"a message on {RIGHT} has 4 bytes")


@pytest.mark.parametrize("path", [None, 7, "a\nb.bag", "a\x00b.bag", "a" * 5000, "no-such.bag"])
def test_a_path_that_can_be_no_bag_gets_one_line(path):
    one_line_error(lambda: RosbagSequence(path), "expected")


def test_files_that_are_no_bags_get_one_line(tmp_path):
    for name in ("a.bag", "a.mcap", "a.db3", "a.txt"):
        (tmp_path / name).write_bytes(b"")
        one_line_error(lambda name=name: RosbagSequence(tmp_path / name), "is empty")
        (tmp_path / name).write_bytes(b"no bag\n" * 99)
        one_line_error(lambda name=name: RosbagSequence(tmp_path / name), "cannot be read (")


def test_without_the_library_the_error_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    monkeypatch.setitem(sys.modules, "rosbags", None)
    one_line_error(lambda: RosbagSequence(tmp_path / "a.bag"), "pip install tspslam[ros]")


def test_the_layout_is_told_from_the_name_or_the_folder(tmp_path, pairs):
    ros = KINDS["mcap"]
    path = write(tmp_path / "drive", ros, drive(ros, pairs))
    assert type(open_sequence(str(path))) is RosbagSequence
    one_line_error(lambda: open_sequence(path, calib="no-such.yaml"), "no-such.yaml: cannot be opened")
    one_line_error(lambda: open_sequence(tmp_path / "gone.mcap"), "cannot be opened")
    shutil.move(path / "metadata.yaml", tmp_path / "metadata.yaml")
    one_line_error(lambda: open_sequence(path), "has none of the known layouts")
    one_line_error(lambda: open_sequence(tmp_path), "has none of the known layouts")
    assert "RosbagSequence" in datasets.__all__


def opened(folder):
    """Files of a folder that this process has open."""
    links = [link for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
    return [file for file in (os.path.realpath(link) for link in links) if file.startswith(str(folder.resolve()))]


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_is_closed_with_its_sequence(tmp_path, pairs, kind, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # of what rosbags unpacks
    ros = KINDS[kind]
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, drive(ros, pairs)))
    pair, before = sequence[0], sorted(tmp_path.rglob("*"))
    del sequence
    gc.collect()
    assert pair.left.tobytes() == pairs[0].left.tobytes()
    assert len(before) - len(list(tmp_path.rglob("*"))) == (2 if kind == "sqlite3-zstd" else 0)
    if Path("/proc/self/fd").is_dir():
        assert opened(tmp_path) == []


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="open files are counted in /proc")
@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_a_bag_that_is_refused_is_closed(tmp_path, pairs, kind):
    ros = KINDS[kind]
    topics = drive(ros, pairs)
    del topics["/stereo/right/camera_info"]
    path = write(tmp_path / ros.name, ros, topics)
    one_line_error(lambda: RosbagSequence(path), "has no CameraInfo")
    gc.collect()
    assert opened(tmp_path) == []


@pytest.mark.parametrize("kind", ["ros1-lz4", "sqlite3", "mcap"])
def test_threads_read_one_sequence(tmp_path, pairs, kind):
    ros = KINDS[kind]
    sequence = RosbagSequence(write(tmp_path / ros.name, ros, drive(ros, pairs)))
    right = []

    def read(seed):
        for k in np.random.default_rng(seed).integers(0, COUNT, 20):
            right.append(sequence[k].left.tobytes() == pairs[k].left.tobytes())

    threads = [threading.Thread(target=read, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert right == [True] * 80
