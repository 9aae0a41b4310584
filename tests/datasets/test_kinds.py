"""What is no pair of images is called what it is, and the error says how to come to some."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tspslam import cli
from tspslam.datasets import EurocSequence, KittiSequence, StereoFolder, open_sequence, pair_from_files
from tspslam.errors import InputError
from tspslam.io.images import write_png
from tspslam.types import Rig
from tspslam.vision.calibration.formats.own import save_cameras

from . import standard

RIG = Rig(fx=50, fy=50, cx=32, cy=24, baseline=0.1, width=64, height=48)


def line_of(error: pytest.ExceptionInfo[InputError]) -> str:
    assert "\n" not in str(error.value)
    return str(error.value)


SOURCES = {
    "v.mp4": "is not a video, or its header is damaged; expected a video that FFmpeg reads",
    "my drive.AVI": "is not a video",
    "a.svo": "is a recording of a ZED camera",
    "a.svo2": "as ZED's own tools export them",
    "a.bag.active": "is a bag that was not closed; expected a whole bag: rosbag reindex a.bag.active",
    "a.zip": "is an archive; expected a folder: unpack it first",
    "a.tar.gz": "is an archive",
    "drive.db3.zstd": "is an archive",
    "left.png": "is one image; expected two images, left and right, with --calib",
    "left.gif": "is an image of a kind that is not read; expected images as .png",
    "mesh.ply": "tspslam filter takes a mesh",
    "calib.yaml": "a calibration goes with --calib",
    "a.xyz": "is no folder, expected one with left/ and right/, mav0/",
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_file_that_is_no_source_is_called_what_it_is(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InputError) as error:
        open_sequence(tmp_path / name)
    assert line_of(error).startswith(f"{tmp_path / name}: ")
    assert SOURCES[name] in str(error.value)


def test_what_is_not_there_is_no_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"v\.mp4: is no folder"):
        open_sequence(tmp_path / "v.mp4")


def test_a_folder_that_nothing_reads_is_told_by_what_it_holds(tmp_path: Path) -> None:
    for name in ("a.png", "b\nc.png", ".hidden"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(
        InputError, match=r"none of the known layouts \(it holds a\.png, b c\.png\), expected one"
    ) as error:
        open_sequence(tmp_path)
    line_of(error)
    (tmp_path / "drive_0.mcap").write_bytes(b"")
    with pytest.raises(InputError, match=r"drive_0\.mcap is of a bag of ROS 2 without metadata\.yaml: give it alone"):
        open_sequence(tmp_path)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("left.mp4", "is a video"),
        ("left.gif", r"expected images as .* magick left\.gif left\.png makes one"),
        ("left.zip", "is an archive"),
        ("left.png", "is not an image"),
        ("left.txt", "is a text"),
    ],
)
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_file_of_a_pair_that_is_no_image_is_called_what_it_is(
    tmp_path: Path, name: str, said: str, side: str
) -> None:
    save_cameras(RIG, tmp_path / "calib.yaml")
    standard.write_images(tmp_path, ["good.png"])
    (tmp_path / name).write_bytes(b"no image")
    files = (tmp_path / name, tmp_path / "good.png")
    with pytest.raises(InputError, match=said) as error:
        pair_from_files(*(files if side == "left" else files[::-1]), tmp_path / "calib.yaml")
    assert line_of(error).startswith(f"{tmp_path / name}: ")


def test_two_folders_are_no_pair(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder; expected two images, or one folder with left/ and right/ in it"):
        pair_from_files(tmp_path, tmp_path, tmp_path / "calib.yaml")


def test_an_image_that_pillow_reads_under_another_name_is_read(tmp_path: Path) -> None:
    standard.write_images(tmp_path, ["a.png"])
    (tmp_path / "a.png").rename(tmp_path / "a.raw")
    save_cameras(RIG, tmp_path / "calib.yaml")
    assert pair_from_files(tmp_path / "a.raw", tmp_path / "a.raw", tmp_path / "calib.yaml").left.shape == (48, 64)


@pytest.mark.parametrize(
    ("suffix", "said"),
    [
        (
            ".gif",
            r"holds 3 files of \.gif, a kind that is not read; .*: magick mogrify -format png \*\.gif makes some",
        ),
        (".npy", r"holds 3 files of \.npy, a kind that is not read; expected images as \.png, .* or \.webp$"),
        ("", "holds 3 files without a suffix"),
    ],
)
def test_a_folder_of_other_files_alone_names_their_kind(tmp_path: Path, suffix: str, said: str) -> None:
    for side in ("left", "right", "image_0", "image_1"):
        (tmp_path / side).mkdir()
        for k in range(3):
            (tmp_path / side / f"{k}{suffix}").write_bytes(b"x")
    for read, first in ((StereoFolder, "left"), (KittiSequence, "image_0")):
        with pytest.raises(InputError, match=said) as error:
            read(tmp_path)
        assert line_of(error).startswith(f"{tmp_path / first}: ")


def recording(folder: Path, suffix: str, cameras: tuple[int, ...] = (0, 1)) -> Path:
    """A recording of EuRoC whose files have another suffix than the lists say."""
    standard.euroc(folder)
    for camera in cameras:
        for file in (folder / f"mav0/cam{camera}/data").iterdir():
            Image.open(file).convert("L").save(file.with_suffix(suffix))
            file.unlink()
    return folder


@pytest.mark.parametrize("cameras", [(0,), (0, 1)])
def test_files_of_another_suffix_than_their_list_says_are_found(tmp_path: Path, cameras: tuple[int, ...]) -> None:
    whole = EurocSequence(standard.euroc(tmp_path / "whole"))
    sequence = EurocSequence(recording(tmp_path / "other", ".bmp", cameras))
    assert (len(sequence), sequence.unpaired) == (4, [])
    for pair, other in zip(sequence, whole, strict=True):
        assert (pair.name, pair.stamp) == (other.name, other.stamp)
        assert pair.right.tobytes() == other.right.tobytes()


def test_two_files_for_one_name_of_a_list_are_refused(tmp_path: Path) -> None:
    folder = recording(tmp_path, ".bmp")
    file = min((folder / "mav0/cam0/data").iterdir())
    Image.open(file).save(file.with_suffix(".jpg"))
    with pytest.raises(
        InputError, match=rf"lists {file.stem}\.png, and data/ has .*\.bmp and .*\.jpg; expected one file"
    ):
        EurocSequence(folder)
    Image.open(file).save(file.with_suffix(".png"))
    sequence = EurocSequence(folder)
    assert len(sequence) == 4
    assert len(sequence.unpaired) == 2


def test_a_list_of_no_file_that_is_there_is_refused(tmp_path: Path) -> None:
    folder = standard.euroc(tmp_path)
    for file in (folder / "mav0/cam1/data").iterdir():
        file.rename(file.with_name(f"frame{file.name[-6:]}"))
    with pytest.raises(
        InputError, match=r"cam1/data\.csv: lists files such as 1403.*\.png, none of which is in data/; exp"
    ):
        EurocSequence(folder)


@pytest.mark.parametrize(("side", "kinds"), [("left", "left image is in colour, right grey"), ("right", "left image is grey, right in colour")])  # fmt: skip
def test_a_grey_and_a_coloured_image_are_called_so(tmp_path: Path, side: str, kinds: str) -> None:
    standard.write_images(tmp_path, ["left.png", "right.png"])
    save_cameras(RIG, tmp_path / "calib.yaml")
    write_png(tmp_path / f"{side}.png", np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError, match=rf"^left: {kinds}, expected both alike \(magick") as error:
        pair_from_files(tmp_path / "left.png", tmp_path / "right.png", tmp_path / "calib.yaml")
    line_of(error)


def test_what_is_no_video_in_spite_of_its_name_is_refused_on_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "v.mp4").write_bytes(b"x")
    assert cli.exit_code(["run", str(tmp_path / "v.mp4"), "--out", str(tmp_path / "run")]) == cli.BAD_INPUT
    assert "v.mp4: is not a video, or its header is damaged" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
