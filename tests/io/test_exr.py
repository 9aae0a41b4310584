"""OpenEXR images: what was written comes back, and what is damaged or of another kind is one line."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.patience import PATIENCE
from tspslam.datasets import StereoFolder
from tspslam.errors import InputError
from tspslam.io.images import image_size, read_image, read_numbers
from tspslam.types import Rig
from tspslam.vision.calibration.formats.own import save_cameras

NONE, RLE, ZIPS, ZIP, PIZ = range(5)
LINES = {NONE: 1, RLE: 1, ZIPS: 1, ZIP: 16, PIZ: 32}
RNG = np.random.default_rng(0)
DEPTHS = np.round(RNG.uniform(0.5, 20, (37, 23)) * 8).astype(np.float32) / 8


def runs(data: bytes) -> bytes:
    """Equal neighbours as runs, others one by one."""
    out, at = b"", 0
    while at < len(data):
        stop = at
        while stop + 1 < len(data) and data[stop + 1] == data[at] and stop - at < 127:
            stop += 1
        out += struct.pack("b", stop - at) + data[at : at + 1] if stop > at else b"\xff" + data[at : at + 1]
        at = stop + 1
    return out


def packed(plain: bytes, compression: int) -> bytes:
    if compression == NONE:
        return plain
    halves = np.frombuffer(plain[0::2] + plain[1::2], np.uint8)
    steps = halves.copy()
    steps[1:] = halves[1:] - halves[:-1] + np.uint8(128)
    made = runs(steps.tobytes()) if compression == RLE else zlib.compress(steps.tobytes())
    return made if len(made) < len(plain) else plain


def attribute(name: str, kind: str, data: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(data)) + data


def exr(planes: dict[str, NDArray[np.floating]], compression: int = ZIP, top: int = 0, *, flags: int = 0, kind: int | None = None) -> bytes:  # fmt: skip
    """An OpenEXR file of the planes, by the format's own description; the chunks lie from the last to the first."""
    height, width = next(iter(planes.values())).shape
    names = sorted(planes)
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iIii", 1 if planes[name].dtype == np.float16 else 2, 0, 1, 1)
        for name in names
    )
    box = struct.pack("<4i", 5, top, 5 + width - 1, top + height - 1)
    head = b"v/1\x01" + struct.pack("<I", 2 | flags) + attribute("channels", "chlist", listed + b"\0")
    head += attribute("compression", "compression", bytes([compression if kind is None else kind]))
    head += attribute("dataWindow", "box2i", box) + attribute("lineOrder", "lineOrder", b"\0") + b"\0"
    chunks = []
    for y in range(0, height, LINES[compression]):
        rows = range(y, min(y + LINES[compression], height))
        plain = b"".join(
            planes[name][row].astype(planes[name].dtype.newbyteorder("<")).tobytes() for row in rows for name in names
        )
        stored = packed(plain, compression)
        chunks.append(struct.pack("<ii", top + y, len(stored)) + stored)
    at, table = len(head) + 8 * len(chunks), []
    for chunk in chunks[::-1]:
        table.append(at)
        at += len(chunk)
    return head + struct.pack(f"<{len(table)}Q", *table[::-1]) + b"".join(chunks[::-1])


def saved(folder: Path, data: bytes) -> Path:
    (folder / "a.exr").write_bytes(data)
    return folder / "a.exr"


@pytest.mark.parametrize("compression", [NONE, RLE, ZIPS, ZIP])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_depths_come_back_exactly(tmp_path: Path, compression: int, dtype: type) -> None:
    steps = np.repeat(DEPTHS[:, :1], 23, axis=1).astype(dtype)
    for values in (DEPTHS.astype(dtype), steps):
        path = saved(tmp_path, exr({"Z": values}, compression, top=-7))
        assert image_size(path) == (23, 37)
        back = read_numbers(path, "a map")
        assert back.dtype == np.float32
        np.testing.assert_array_equal(back, values.astype(np.float32))


def test_colour_is_rgb_without_alpha(tmp_path: Path) -> None:
    planes = {name: RNG.random((20, 30)).astype(np.float32) for name in "RGBA"}
    for layer in ("", "view.left."):
        back = read_image(saved(tmp_path, exr({layer + name: plane for name, plane in planes.items()})))
        np.testing.assert_array_equal(back, np.stack([planes[name] for name in "RGB"], axis=2))


@pytest.mark.parametrize("kind", ["FLOAT", "HALF"])
def test_what_opencv_writes_is_read(tmp_path: Path, kind: str) -> None:
    grey, colour = (tmp_path / f"{name}.exr" for name in ("grey", "colour"))
    script = (
        "import cv2, numpy as np; rng = np.random.default_rng(3); "
        "made = [rng.integers(0, 256, shape).astype(np.float32) / 256 for shape in ((40, 30), (40, 30, 3))]; "
        f"kind = [cv2.IMWRITE_EXR_TYPE, cv2.IMWRITE_EXR_TYPE_{kind}]; "
        f"print([cv2.imwrite(name, image, kind) for name, image in zip(({str(grey)!r}, {str(colour)!r}), made)])"
    )
    environment = os.environ | {"OPENCV_IO_ENABLE_OPENEXR": "1"}
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=PATIENCE
    )
    if done.stdout.strip() != "[True, True]":
        pytest.skip("this OpenCV does not write OpenEXR")
    rng = np.random.default_rng(3)
    np.testing.assert_array_equal(read_image(grey), rng.integers(0, 256, (40, 30)) / 256)
    np.testing.assert_array_equal(read_image(colour), rng.integers(0, 256, (40, 30, 3))[..., ::-1] / 256)


WRONG = {
    "tiles": (exr({"Y": DEPTHS}, flags=0x200), "of tiles, which are not read"),
    "parts": (exr({"Y": DEPTHS}, flags=0x1000), "of several parts"),
    "deep": (exr({"Y": DEPTHS}, flags=0x800), "of deep pixels"),
    "PIZ": (exr({"Y": DEPTHS}, kind=4), "of a compression that is not read, PIZ: exrheader tells"),
    "unknown": (exr({"Y": DEPTHS}, kind=77), "of a compression that is not read, 77"),
    "channels": (exr({"X": DEPTHS, "Y": DEPTHS}), "with the channels X, Y, where one, or R, G and B are read"),
    "version": (exr({"Y": DEPTHS}, flags=1), "of version 3, where 2 is read"),
    "short": (b"v/1\x01\x02\0\0\0", "truncated or damaged"),
    "depths": (exr({"Y": DEPTHS}), "holds floating-point pixels from"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_not_read_is_named(tmp_path: Path, name: str) -> None:
    data, message = WRONG[name]
    with pytest.raises(InputError, match=message):
        read_image(saved(tmp_path, data))


def test_a_size_that_no_image_has_is_refused_by_the_header(tmp_path: Path) -> None:
    data = exr({"Y": DEPTHS}).replace(struct.pack("<4i", 5, 0, 27, 36), struct.pack("<4i", 0, 0, 10**6, 10**6))
    for read in (image_size, read_image):
        with pytest.raises(InputError, match="1000001 x 1000001 px"):
            read(saved(tmp_path, data))


@pytest.mark.parametrize("compression", [NONE, RLE, ZIPS, ZIP])
def test_a_damaged_one_is_an_image_or_an_input_error(tmp_path: Path, compression: int) -> None:
    data, rng = exr({"Z": DEPTHS}, compression), np.random.default_rng(compression)
    refused = 0
    for turn in range(150):
        broken = bytearray(data)
        for at in rng.integers(0, 200 if turn % 2 else len(data), rng.integers(1, 4)):
            broken[at] ^= 1 << int(rng.integers(8))
        kept = int(rng.integers(len(data))) if turn % 5 == 0 else len(data)
        try:
            assert read_numbers(saved(tmp_path, bytes(broken[:kept])), "a map").ndim == 2
        except InputError:
            refused += 1
    assert refused > 30


def test_compressed_pixels_that_are_damaged_are_seen(tmp_path: Path) -> None:
    """ZIP has a sum of each chunk."""
    data = exr({"Z": np.repeat(DEPTHS[:, :1], 23, axis=1)})
    for at in range(len(data) - 40, len(data), 3):
        with pytest.raises(InputError):
            read_numbers(saved(tmp_path, data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]), "a map")


def test_a_folder_of_them_is_a_sequence(tmp_path: Path) -> None:
    save_cameras(Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10), tmp_path / "calib.yaml")
    for side, value in (("left", 0.25), ("right", 0.5)):
        (tmp_path / side).mkdir()
        (tmp_path / side / "0.exr").write_bytes(exr({name: np.full((10, 20), value, np.float16) for name in "RGB"}))
    pair = StereoFolder(tmp_path)[0]
    assert (pair.left.dtype, pair.left.shape) == (np.float32, (10, 20, 3))
    assert (float(pair.left.min()), float(pair.right.max())) == (0.25, 0.5)
