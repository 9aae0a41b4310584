"""Any bytes are an object or an `InputError`, by every reader, and soon: those that have no test of the kind of their own.

Clouds, text calibrations, STL, OFF, glTF, PLY and OpenEXR are damaged in their own tests.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from tests import videos
from tests.datasets import standard
from tspslam import build_complex
from tspslam.datasets import VideoSequence, open_sequence
from tspslam.datasets.maps import read_map
from tspslam.errors import InputError
from tspslam.io import (
    read_frame,
    read_image,
    read_mesh,
    read_trajectory,
    write_frame,
    write_kitti,
    write_tum,
    write_vtu,
)
from tspslam.io.topological import read_map as read_whole_map
from tspslam.io.topological import write_map
from tspslam.mapping.build import map_of_frame
from tspslam.types import Rig
from tspslam.vision.calibration.extrinsics import read_extrinsics

DAMAGES = 24  # of each file
RIG = Rig(fx=50, fy=50, cx=32, cy=24, baseline=0.1, width=64, height=48)
MOST = 50  # times the calls that the whole file takes
GRACE = 20_000  # calls, of what is done the first time


class Reader(NamedTuple):
    """A file, or one in a folder, and what reads it; `at` is the part that is damaged, from its begin, bytes."""

    make: Callable[[Path], Path]
    read: Callable[[Path], Any]
    at: int = 1 << 30


def picture(kind: str, **options: Any) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        grey = (np.add.outer(np.arange(40), 3 * np.arange(60)) % 256).astype(np.uint8)
        buffer = io.BytesIO()
        Image.fromarray(grey).save(buffer, format=kind, **options)
        (folder / "image").write_bytes(buffer.getvalue())
        return folder / "image"

    return make


def text(name: str, content: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_text(content)
        return folder / name

    return make


def pfm(folder: Path) -> Path:
    (folder / "a.pfm").write_bytes(b"Pf\n20 10\n-1.0\n" + np.linspace(0, 1, 200).astype("<f4").tobytes())
    return folder / "a.pfm"


def npy(folder: Path) -> Path:
    np.save(folder / "a.npy", np.linspace(1, 9, 200).reshape(10, 20))
    return folder / "a.npy"


def vtu(folder: Path) -> Path:
    write_vtu(folder / "a.vtu", build_complex([[0, 1, 2]], 3), np.eye(3))
    return folder / "a.vtu"


def path_of(kind: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        poses, stamps = standard.poses(8), np.arange(8) / 10
        if kind == "kitti":
            write_kitti(folder / "a.txt", poses)
        elif kind == "tum":
            write_tum(folder / "a.txt", stamps, poses)
        else:
            standard.euroc_truth(folder, poses, list(range(10**18, 10**18 + 8 * 10**8, 10**8)))
            return folder / "mav0/state_groundtruth_estimate0/data.csv"
        return folder / "a.txt"

    return make


def frame(folder: Path) -> Path:
    from tspslam.interop.meshes import from_arrays

    grid = np.stack([*np.meshgrid(np.arange(5.0), np.arange(4.0)), np.full((4, 5), 9.0)], axis=2).reshape(-1, 3) - (
        2,
        2,
        0,
    )
    here = (np.arange(3)[:, None] * 5 + np.arange(4)).ravel()
    faces = np.concatenate([np.stack([here, here + 1, here + 5], 1), np.stack([here + 1, here + 6, here + 5], 1)])
    write_frame(folder / "a.npz", from_arrays(grid, faces, np.full((48, 64), 0.5), RIG))
    return folder / "a.npz"


def whole_map(folder: Path) -> Path:
    write_map(folder / "a.npz", map_of_frame(read_frame(frame(folder)), RIG, np.eye(4)))
    return folder / "a.npz"


def video(codec: str, name: str) -> Callable[[Path], Path]:
    return lambda folder: videos.write_video(folder / name, videos.moving_frames(6), codec)


def sequence(path: Path) -> Any:
    """All that is told of a recording, and its first pair."""
    found = open_sequence(next(above for above in path.parents if (above / "recording").exists()))
    return found[0], getattr(found, "truth", None)


def recording(write: Callable[[Path], object], part: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        write(folder)
        (folder / "recording").mkdir()
        return folder / part

    return make


def bag(kind: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        rosbags = pytest.importorskip("rosbags")
        from tests.datasets import test_rosbag as bags

        assert rosbags
        ros = bags.KINDS[kind]
        rng = np.random.default_rng(0)
        images = [rng.integers(0, 256, (2, 48, 64), np.uint8) for _ in range(2)]
        topics = {
            bags.LEFT: [bags.raw_image(ros, bags.START + k * bags.STEP, left) for k, (left, _) in enumerate(images)],
            bags.RIGHT: [bags.raw_image(ros, bags.START + k * bags.STEP, right) for k, (_, right) in enumerate(images)],
            "/stereo/left/camera_info": [bags.info(ros, False)],
            "/stereo/right/camera_info": [bags.info(ros, True)],
        }
        made = bags.write(folder / ros.name, ros, topics)
        return made if made.is_file() else next(file for file in made.iterdir() if file.suffix in (".db3", ".mcap"))

    return make


def read_bag(path: Path) -> Any:
    return open_sequence(path)[0]


def read_video(path: Path) -> Any:
    return VideoSequence(
        path, "side-by-side", calib=Rig(fx=50, fy=50, cx=16, cy=24, baseline=0.1, width=32, height=48)
    )[0]


EXTRINSICS = "P0: 700 0 600 0 0 700 180 0 0 0 1 0\nTr: 0 -1 0 0.01 0 0 -1 -0.06 1 0 0 -0.27\n"
READERS = {
    "PNG": Reader(picture("PNG"), read_image),
    "JPEG": Reader(picture("JPEG"), read_image),
    "WebP": Reader(picture("WEBP", lossless=True), read_image),
    "BMP": Reader(picture("BMP"), read_image, at=120),
    "PGM": Reader(picture("PPM"), read_image, at=20),
    "TIFF by deflate": Reader(picture("TIFF", compression="tiff_adobe_deflate"), read_image),
    "TIFF by LZW": Reader(picture("TIFF", compression="tiff_lzw"), read_image),
    "PFM": Reader(pfm, read_image),
    "map": Reader(npy, read_map, at=140),
    "extrinsics": Reader(text("calib.txt", EXTRINSICS), read_extrinsics),
    "4 x 4": Reader(text("a.txt", "0 -1 0 0\n0 0 -1 0\n1 0 0 0\n0 0 0 1\n"), read_extrinsics),
    "OBJ": Reader(text("a.obj", "v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 1 2 3 4\nf 1/1 -3/2 -1\n"), read_mesh),
    "VTU": Reader(vtu, read_mesh),
    "frame": Reader(frame, read_frame),
    "map of a run": Reader(whole_map, read_whole_map),
    "TUM path": Reader(path_of("tum"), read_trajectory),
    "KITTI path": Reader(path_of("kitti"), read_trajectory),
    "EuRoC path": Reader(path_of("euroc"), read_trajectory),
    "lossless video": Reader(video("FFV1", "a.avi"), read_video),
    "MPEG-4 video": Reader(video("mp4v", "a.mp4"), read_video),
    **{f"bag {kind}": Reader(bag(kind), read_bag) for kind in ("ros1", "ros1-lz4", "sqlite3", "mcap", "mcap-zstd")},
    **{f"odometry {part}": Reader(recording(standard.odometry, part), sequence) for part in ("calib.txt", "times.txt")},
    **{
        f"EuRoC {part}": Reader(recording(standard.euroc, f"mav0/{part}"), sequence)
        for part in ("cam0/sensor.yaml", "cam1/sensor.yaml", "cam0/data.csv")
    },
}  # fmt: skip


def damaged(content: bytes, most: int, seed: int) -> Iterator[bytes]:
    """The same each time: flipped bits, other bytes, pieces that are lost or there twice, and ends."""
    rng = np.random.default_rng(seed)
    reach = min(len(content), most)
    for turn in range(DAMAGES):
        broken = bytearray(content)
        places = rng.integers(0, reach if turn % 2 else min(reach, 256), rng.integers(1, 5)).tolist()
        if turn % 4 == 3:
            yield bytes(broken[: places[0]])
            continue
        if turn % 4 == 2:
            first, last = sorted(rng.integers(0, reach, 2).tolist())
            yield bytes(broken[:first] + broken[last:]) if turn % 8 == 2 else bytes(broken[:last] + broken[first:])
            continue
        for at in places:
            broken[at] = broken[at] ^ (1 << int(rng.integers(8))) if turn % 4 == 0 else int(rng.integers(256))
        yield bytes(broken)


def work(read: Callable[[Path], Any], path: Path) -> int:
    """Calls that a read makes, which gives something, or the one line of an `InputError`."""
    found, said, calls = None, "", 0

    def count(*_: Any) -> None:
        nonlocal calls
        calls += 1

    sys.setprofile(count)
    try:
        found = read(path)
    except InputError as error:
        said = str(error)
    finally:
        sys.setprofile(None)
    assert (found is None) == bool(said)
    assert "\n" not in said
    assert len(said) < 1000
    return calls


@pytest.mark.parametrize("name", READERS)
def test_any_bytes_are_an_object_or_an_input_error_soon(tmp_path: Path, name: str) -> None:
    reader = READERS[name]
    path = reader.make(tmp_path)
    reader.read(path)
    whole = work(reader.read, path)
    content, most = path.read_bytes(), 0
    path.write_bytes(b"?" * 40)
    work(reader.read, path)  # what is imported to look at a strange file counts for none
    for broken in damaged(content, reader.at, len(name)):
        path.write_bytes(broken)
        most = max(most, work(reader.read, path))
    assert most < MOST * whole + GRACE


def test_the_damages_are_the_same_each_time_and_are_damages() -> None:
    content = bytes(range(256)) * 4
    made = list(damaged(content, 1 << 30, 1))
    assert made == list(damaged(content, 1 << 30, 1))
    assert len(made) == DAMAGES
    assert sum(each != content for each in made) > DAMAGES - 3
