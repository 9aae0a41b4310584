"""Known pixels, written in each encoding that cameras of ROS have, come back: exactly, or to the rounding of BT.601."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags")

from tspslam.datasets._encodings import _ENCODINGS, COMPRESSED, image_of
from tspslam.datasets._ros import IMAGE

from .test_rosbag import KINDS, START, packed_image, raw_image

ROS = KINDS["ros1"]
DEEP = {"8UC3": 3, "8UC4": 4, "rgb16": 3, "bgr16": 3, "16UC3": 3, "rgba16": 4, "bgra16": 4}


@pytest.mark.parametrize("encoding", DEEP)
@pytest.mark.parametrize("big", [False, True])
def test_colour_of_8_and_16_bits_gives_its_pixels(encoding: str, big: bool) -> None:
    dtype = np.uint8 if encoding.startswith("8") else np.uint16
    pixels = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (5, 7, DEEP[encoding]), dtype, endpoint=True)
    read = image_of(raw_image(ROS, START, pixels, encoding, big=big, step=pixels[0].nbytes + 6), IMAGE)
    assert read.dtype == dtype
    assert read.dtype.isnative
    np.testing.assert_array_equal(read, pixels[..., :3] if encoding.startswith("rgb") else pixels[..., 2::-1])


def of_bt601(y: float, u: float, v: float) -> list[float]:
    """R, G, B of luma from 16 to 235 and of chroma about 128."""
    luma = 255 / 219 * (y - 16)
    return [luma + 1.596 * (v - 128), luma - 0.813 * (v - 128) - 0.391 * (u - 128), luma + 2.018 * (u - 128)]


COLOURS = [(16, 128, 128), (235, 128, 128), (126, 128, 128), (100, 150, 110), (150, 100, 140)]
ORDERS = {"yuv422": "uyvy", "uyvy": "uyvy", "yuv422_yuy2": "yuyv", "yuyv": "yuyv"}


def close(read: np.ndarray, colour: tuple[int, int, int], shape: tuple[int, int]) -> None:
    assert read.shape == (*shape, 3)
    np.testing.assert_allclose(read, np.broadcast_to(np.clip(of_bt601(*colour), 0, 255), read.shape), atol=1.5)


@pytest.mark.parametrize("encoding", ORDERS)
@pytest.mark.parametrize("colour", COLOURS)
def test_two_pixels_that_share_their_colour_become_rgb_by_bt601(encoding: str, colour: tuple[int, int, int]) -> None:
    values = dict(zip("yuv", colour, strict=True))
    four = np.array([values[letter] for letter in ORDERS[encoding]], np.uint8)
    pixels = np.tile(four, (4, 3))  # 6 pixels a row
    close(image_of(raw_image(ROS, START, pixels, encoding, step=15, width=6), IMAGE), colour, (4, 6))


@pytest.mark.parametrize("encoding", ["nv12", "nv21"])
@pytest.mark.parametrize("colour", COLOURS)
def test_colour_in_a_plane_of_half_the_size_becomes_rgb_by_bt601(encoding: str, colour: tuple[int, int, int]) -> None:
    y, u, v = colour
    pixels = np.full((6, 6), y, np.uint8)  # 4 rows of luma, 2 of colour
    pixels[4:, 0::2], pixels[4:, 1::2] = (u, v) if encoding == "nv12" else (v, u)
    close(image_of(raw_image(ROS, START, pixels, encoding, step=8, width=6, height=4), IMAGE), colour, (4, 6))


@pytest.mark.parametrize("encoding", ["yuv422", "yuyv", "nv12", "nv21"])
def test_luma_stays_where_it_was(encoding: str) -> None:
    """A ramp without colour: a mix-up of bytes or rows would break it."""
    luma = np.random.default_rng(2).integers(16, 236, (4, 6)).astype(np.uint8)
    if encoding.startswith("nv"):
        pixels = np.concatenate([luma, np.full((2, 6), 128, np.uint8)])
    else:
        pairs = (np.full_like(luma, 128), luma) if encoding == "yuv422" else (luma, np.full_like(luma, 128))
        pixels = np.stack(pairs, axis=-1).reshape(4, 12)
    read = image_of(raw_image(ROS, START, pixels, encoding, width=6, height=4), IMAGE)
    expected = 255 / 219 * (luma.astype(float) - 16)
    np.testing.assert_allclose(read, np.repeat(expected[..., None], 3, axis=-1), atol=1.5)


def mosaic_of(order: str, colour: np.ndarray) -> np.ndarray:
    mosaic = np.zeros((8, 10), colour.dtype)
    for k, letter in enumerate(order):
        mosaic[k // 2 :: 2, k % 2 :: 2] = colour["rgb".index(letter)]
    return mosaic


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("big", [False, True])
def test_a_mosaic_of_16_bits_becomes_colour(order: str, big: bool) -> None:
    colour = np.array([51_200, 23_041, 5_122], np.uint16)
    message = raw_image(ROS, START, mosaic_of(order, colour), f"bayer_{order}16", big=big, step=23)
    np.testing.assert_array_equal(image_of(message, IMAGE), np.broadcast_to(colour, (8, 10, 3)))


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize(
    "said", ["bayer_{}; png compressed", "bgr8; png compressed bayer_{}", "bayer_{}; png compressed "]
)
@pytest.mark.parametrize("bits", [8, 16])
def test_a_compressed_mosaic_becomes_colour(order: str, said: str, bits: int) -> None:
    colour = np.array([200, 90, 20], np.uint8 if bits == 8 else np.uint16)
    message = packed_image(ROS, START, mosaic_of(order, colour), "png", said.format(f"{order}{bits}"))
    np.testing.assert_array_equal(image_of(message, COMPRESSED), np.broadcast_to(colour, (8, 10, 3)))


def test_a_mosaic_in_a_jpeg_becomes_colour() -> None:
    colour = np.array([130, 128, 126], np.uint8)
    message = packed_image(ROS, START, mosaic_of("rggb", colour), "jpeg", "bayer_rggb8; jpeg compressed")
    np.testing.assert_allclose(image_of(message, COMPRESSED), np.broadcast_to(colour, (8, 10, 3)), atol=8)


def test_a_mosaic_that_was_made_colour_before_it_was_compressed_stays() -> None:
    pixels = np.random.default_rng(3).integers(0, 255, (8, 10, 3), np.uint8)
    message = packed_image(ROS, START, pixels, "png", "bayer_rggb8; png compressed bgr8")
    np.testing.assert_array_equal(image_of(message, COMPRESSED), pixels)


def test_every_encoding_has_its_law_here_or_beside() -> None:
    beside = {"mono8", "8UC1", "mono16", "16UC1", "rgb8", "bgr8", "rgba8", "bgra8"}
    here = {*DEEP, *ORDERS, "nv12", "nv21"}
    mosaics = {f"bayer_{order}{bits}" for order in ("rggb", "bggr", "gbrg", "grbg") for bits in (8, 16)}
    assert set(_ENCODINGS) == here | beside | mosaics
