"""Stereo videos: the same bytes in any order, times, layouts, turns; and what is wrong with bad ones."""

import subprocess
import sys

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import videos
from tests.patience import PATIENCE
from tspslam.datasets import VideoImages, VideoSequence, open_sequence
from tspslam.datasets._video import VideoFile
from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.calibration.formats.own import save_cameras

COUNT = 150  # beyond what is decoded rather than sought
RIG = Rig(fx=60.0, fy=60.0, cx=31.5, cy=23.5, baseline=0.1, width=64, height=48)
CODECS = {"ffv1.avi": "FFV1", "ffv1.mkv": "FFV1", "mjpg.avi": "MJPG", "mpeg4.mp4": "mp4v", "vp8.webm": "VP80"}


@pytest.fixture(scope="module")
def films(tmp_path_factory):
    folder, frames = tmp_path_factory.mktemp("films"), videos.moving_frames(COUNT)
    return {name: videos.write_video(folder / name, frames, codec) for name, codec in CODECS.items()}


@pytest.fixture(scope="module")
def sides():
    return videos.moving_frames(6, seed=1), videos.moving_frames(6, seed=2)


def beside(sides):
    return [np.hstack(pair) for pair in zip(*sides, strict=True)]


class Watched:
    """A capture that counts what is asked of it, and may show something else after a search."""

    def __init__(self, capture, shift=0):
        self.capture, self.shift, self.grabbed, self.sought, self.is_off = capture, shift, 0, 0, False

    def grab(self):
        self.grabbed += 1
        return self.capture.grab()

    def set(self, what, value):
        self.sought += 1
        self.is_off = True
        return self.capture.set(what, value)

    def retrieve(self):
        there, pixels = self.capture.retrieve()
        return there, pixels + np.uint8(self.shift * self.is_off)

    def get(self, what):
        return self.capture.get(what)


@pytest.mark.parametrize("colour", [True, False])
@pytest.mark.parametrize("name", ["a.avi", "a.mkv"])
def test_a_lossless_video_gives_the_very_pixels_back(tmp_path, name, colour):
    frames = videos.moving_frames(8, colour=colour)
    file = VideoFile(videos.write_video(tmp_path / name, frames))
    assert len(file) == 8
    assert all(np.array_equal(file[k], frame) for k, frame in enumerate(frames))


@pytest.mark.parametrize("name", CODECS)
def test_a_frame_is_the_same_bytes_read_forward_backward_and_at_random(films, name):
    file = VideoFile(films[name])
    forward = [file[k].tobytes() for k in range(len(file))]
    assert len(set(forward)) == len(forward) == COUNT
    order = [*range(COUNT - 1, -1, -37), *np.random.default_rng(0).permutation(COUNT)[:12].tolist()]
    assert all(file[k].tobytes() == forward[k] for k in order)
    fresh = VideoFile(films[name])
    assert fresh[100].tobytes() == forward[100]


def test_reading_on_decodes_each_frame_once_and_seeks_none(films):
    file = VideoFile(films["mpeg4.mp4"])
    first = file[0]
    file._capture = Watched(file._capture)
    for k in range(1, COUNT):
        file[k]
    assert (file._capture.grabbed, file._capture.sought) == (COUNT - 1, 0)
    assert np.array_equal(file[0], first)


def test_a_frame_far_ahead_is_sought_not_decoded_to(films):
    file = VideoFile(films["mjpg.avi"])
    file[0]
    file._capture = Watched(file._capture)
    wanted = file[140]
    assert file._capture.sought == 1
    assert np.array_equal(wanted, VideoFile(films["mjpg.avi"])[140])


def test_a_search_that_ends_in_other_pixels_is_found_out(films):
    file = VideoFile(films["mpeg4.mp4"])
    forward = [file[k].tobytes() for k in range(COUNT)]
    file[0]
    file._capture = Watched(file._capture, shift=3)
    assert file[140].tobytes() == forward[140]


def test_a_file_that_changes_while_it_is_open_is_found_out(tmp_path):
    path = videos.write_video(tmp_path / "a.avi", videos.moving_frames(5))
    file = VideoFile(path)
    assert len(file) == 5
    videos.write_video(path, videos.moving_frames(5, seed=9))
    file._anew(0)
    with pytest.raises(InputError, match=r"a\.avi: frame 2 is not what it was"):
        file[2]


def test_times_are_those_of_the_container_at_a_rate_that_varies(tmp_path, sides):
    path = videos.write_video(tmp_path / "a.mp4", beside(sides), "mp4v", fps=20)
    assert VideoImages(path, "side-by-side").stamps == pytest.approx(np.arange(6) / 20)
    clock = 10240  # units a second, of FFmpeg's MP4 at 20 frames a second
    videos.retime(path, [512, 1024, 256, 256, 512, 512])
    seen = np.cumsum([0, 512, 1024, 256, 256, 512]) / clock
    assert VideoImages(path, "side-by-side").stamps == pytest.approx(seen, rel=1e-6)


def test_times_that_stand_still_are_said_and_a_rate_helps(tmp_path, sides):
    path = videos.write_video(tmp_path / "a.mp4", beside(sides), "mp4v")
    videos.retime(path, [512, 512, 0, 512, 512, 512])
    with pytest.raises(InputError, match=r"a\.mp4: frame \d is at .*expected times that increase, or .* --fps"):
        VideoImages(path, "side-by-side")
    found = VideoImages(path, "side-by-side", fps=10)
    assert found.stamps == pytest.approx(np.arange(6) / 10)
    whole = [frame.tobytes() for k in range(6) for frame in found.images(k)]
    assert [frame.tobytes() for k in (5, 2) for frame in found.images(k)] == [whole[10], whole[11], whole[4], whole[5]]
    for fps in (0, -1, float("nan"), True, "10"):
        with pytest.raises(InputError, match=r"fps is .*expected frames a second"):
            VideoImages(path, "side-by-side", fps=fps)


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_turn_that_a_phone_notes_is_applied_before_the_frame_is_divided_and_said(tmp_path, degrees):
    path = videos.write_video(tmp_path / "a.mp4", videos.moving_frames(3, 96, 64), "mp4v")
    plain = VideoFile(path)[1]
    videos.turn(path, degrees)
    found = VideoImages(path, "side-by-side")
    turned = np.rot90(plain, -degrees // 90)
    left, right = found.images(1)
    assert np.array_equal(np.hstack([left, right]), turned)
    assert found.size == (turned.shape[1] // 2, turned.shape[0])
    (warning,) = found.warnings
    assert warning["code"] == "video_turned"
    assert f"turned by {degrees} degrees" in warning["message"]


def test_every_layout_holds_the_same_pairs(tmp_path, sides):
    both = list(zip(*sides, strict=True))
    videos.write_video(tmp_path / "beside.avi", beside(sides))
    videos.write_video(tmp_path / "over.mkv", [np.vstack(pair) for pair in both])
    videos.write_video(tmp_path / "alternate.avi", [frame for pair in both for frame in pair], fps=40)
    for side, frames in zip(("left", "right"), sides, strict=True):
        videos.write_video(tmp_path / f"{side}.avi", frames)
    found = [
        VideoSequence(tmp_path / "beside.avi", "side-by-side", calib=RIG),
        VideoSequence(tmp_path / "over.mkv", "over-under", calib=RIG),
        VideoSequence(tmp_path / "alternate.avi", "alternate", calib=RIG),
        VideoSequence((tmp_path / "left.avi", tmp_path / "right.avi"), calib=RIG),
    ]
    for sequence in found:
        assert len(sequence) == 6
        assert sequence.unpaired == []
        assert sequence.warnings == []
        assert sequence.stamps == pytest.approx(np.arange(6) / 20)
        for k, pair in enumerate(sequence):
            assert np.array_equal(pair.left, sides[0][k])
            assert np.array_equal(pair.right, sides[1][k])
            assert (pair.index, pair.stamp, pair.rig) == (k, sequence.stamps[k], RIG)
        with pytest.raises(IndexError):
            sequence[6]
    assert [found[k].name for k in range(4)] == ["beside", "over", "alternate", "left"]
    assert repr(found[0]) == "VideoSequence('beside', 6 pairs)"
    assert [pair.name for pair in found[2]] == [f"{k:06d}" for k in range(0, 12, 2)]


def test_a_last_frame_without_its_partner_is_said(tmp_path, sides):
    path = videos.write_video(tmp_path / "a.avi", sides[0][:5])
    found = VideoImages(path, "alternate")
    assert len(found) == 2
    assert found.unpaired == ["a.avi/4"]
    with pytest.raises(InputError, match=r"b\.avi: has a single frame"):
        VideoImages(videos.write_video(tmp_path / "b.avi", sides[0][:1]), "alternate")


def test_two_videos_are_paired_by_their_times_and_the_rest_is_said(tmp_path):
    left = videos.write_video(tmp_path / "left.mkv", videos.moving_frames(10), fps=20)
    right = videos.write_video(tmp_path / "right.mkv", videos.moving_frames(4, seed=1), fps=10)
    found = VideoImages((left, right))
    assert found.names == ["000000", "000002", "000004", "000006"]
    assert found.unpaired == [f"left.mkv/{k}" for k in (1, 3, 5, 7, 8, 9)]
    assert np.array_equal(list(found.images(2))[1], VideoFile(right)[2])
    small = videos.write_video(tmp_path / "small.mkv", videos.moving_frames(4, 32, 48), fps=10)
    with pytest.raises(InputError, match=r"small\.mkv: has 32 x 48 px, left\.mkv 64 x 48 px; expected videos of one"):
        VideoImages((left, small))


def test_an_unknown_layout_is_asked_for_and_the_likely_one_is_named(tmp_path, sides):
    save_cameras(RIG, tmp_path / "c.yaml")
    shapes = {"beside": beside(sides), "over": [np.vstack(pair) for pair in zip(*sides, strict=True)], "one": sides[0]}
    likely = {"beside": "(side-by-side is likely, by its shape)", "over": "(over-under is likely", "one": "not told;"}
    for name, frames in shapes.items():
        path = videos.write_video(tmp_path / f"{name}.avi", frames)
        for calib in (tmp_path / "c.yaml", None):
            with pytest.raises(InputError, match="side-by-side or over-under or alternate, or two videos") as error:
                open_sequence(path, calib=calib)
            assert likely[name] in str(error.value)
    with pytest.raises(InputError, match="layout is 'left-right', expected side-by-side or"):
        VideoImages(tmp_path / "beside.avi", "left-right")
    with pytest.raises(InputError, match="beside two videos, expected none"):
        VideoImages((tmp_path / "one.avi", tmp_path / "one.avi"), "alternate")
    with pytest.raises(InputError, match="paths has 3 videos"):
        VideoImages([tmp_path / "one.avi"] * 3)


def test_open_sequence_opens_a_video(tmp_path, sides):
    path = videos.write_video(tmp_path / "a.avi", beside(sides))
    save_cameras(RIG, tmp_path / "c.yaml")
    found = open_sequence(path, calib=tmp_path / "c.yaml", layout="side-by-side", fps=5)
    assert isinstance(found, VideoSequence)
    assert found.stamps[1] == pytest.approx(0.2)
    with pytest.raises(InputError, match="without a calibration"):
        open_sequence(path, layout="side-by-side")
    with pytest.raises(InputError, match="is no bag"):
        open_sequence(path, layout="side-by-side", topics=("a", "b"))
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
    with pytest.raises(InputError, match="is no video, expected one with both images in it, alternate"):
        open_sequence(tmp_path, layout="alternate")


def test_sizes_that_do_not_fit_are_said_before_the_file_is_gone_through(tmp_path, sides):
    odd = videos.write_jpegs(tmp_path / "odd.mjpeg", videos.moving_frames(3, 63, 47))
    with pytest.raises(InputError, match=r"odd\.mjpeg: has the width 63 px, which is odd"):
        VideoImages(odd, "side-by-side")
    with pytest.raises(InputError, match="has the height 47 px, which is odd"):
        VideoImages(odd, "over-under")
    path = videos.write_video(tmp_path / "a.avi", beside(sides))
    save_cameras(RIG, tmp_path / "c.yaml")
    said = r"c\.yaml: is of images of 64 x 48 px, those that are given have 128 x 24 px; .*another layout \(--layout\)"
    with pytest.raises(InputError, match=said):
        VideoSequence(path, "over-under", calib=tmp_path / "c.yaml")
    with pytest.raises(InputError, match="calib is None"):
        VideoSequence(path, "side-by-side", calib=None)


def bad_files(folder, frames):
    """Files that hold no video that can be read, and what is said of each."""
    whole = videos.write_video(folder / "whole.mp4", frames, "mp4v").read_bytes()
    jpegs = videos.write_video(folder / "whole.avi", frames, "MJPG").read_bytes()
    empty = videos.write_video(folder / "none.mkv", frames).read_bytes()
    sizes = videos.write_jpegs(folder / "sizes.mjpeg", [*frames, frames[0][:32, :48]]).read_bytes()
    return {
        "zero.mp4": (b"", "is empty"),
        "noise.mp4": (bytes(range(256)), "is not a video, or its header is damaged"),
        "text.mkv": (b"hello\n" * 9, "is not a video"),
        "cut.mp4": (whole[: len(whole) // 2], r"was cut off: its index \(moov\), which comes last, is missing"),
        "sound.mp4": (whole.replace(b"vide", b"soun"), "has sound alone, no video"),
        "codec.avi": (jpegs.replace(b"MJPG", b"ZZZZ"), "has the codec 'ZZZZ', which is not read"),
        "head.mkv": (empty[: empty.index(b"\x1f\x43\xb6\x75")], "has no frame that can be decoded|is not a video"),
        "sizes.mjpeg": (sizes, "has frames of 48 x 32 and 64 x 48 px; expected frames of one size"),
    }


BAD = ("zero.mp4", "noise.mp4", "text.mkv", "cut.mp4", "sound.mp4", "codec.avi", "head.mkv", "sizes.mjpeg")


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_whole_video_is_one_line(tmp_path, sides, name):
    data, said = bad_files(tmp_path, sides[0])[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=said) as error:
        VideoImages(tmp_path / name, "side-by-side")
    assert str(error.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="is a directory"):
        VideoFile(tmp_path)


@pytest.mark.parametrize(("name", "codec"), [("a.mkv", "FFV1"), ("a.avi", "MJPG")])
def test_a_video_that_was_cut_off_gives_the_frames_that_it_has_and_says_so(tmp_path, name, codec):
    frames = videos.moving_frames(40)
    path = videos.write_video(tmp_path / name, frames, codec)
    whole = VideoFile(path)
    kept = [whole[k].tobytes() for k in range(40)]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = VideoImages(path, "side-by-side")
    assert 10 < len(found) < 30
    assert VideoFile(path)[len(found) - 2].tobytes() == kept[len(found) - 2]
    (warning,) = found.warnings
    assert warning["code"] == "video_cut"
    assert f"{len(found)} of 40 frames can be decoded" in warning["message"]


@pytest.fixture(scope="module")
def short_films(tmp_path_factory):
    folder, frames = tmp_path_factory.mktemp("short"), videos.moving_frames(4, 32, 16)
    names = {"a.avi": "MJPG", "b.mkv": "FFV1", "c.mp4": "mp4v"}
    return {name: videos.write_video(folder / name, frames, codec).read_bytes() for name, codec in names.items()}


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_gives_frames_or_one_line(short_films, tmp_path, data):
    name = data.draw(st.sampled_from(sorted(short_films)))
    content = bytearray(short_films[name])
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content)))]
    for _ in range(data.draw(st.integers(0, 4))):
        if content:
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / name
    path.write_bytes(content)
    try:
        found = VideoImages(path, "side-by-side", fps=10)
        images = [list(found.images(k)) for k in range(len(found))]
        assert all(image.shape[:2] == found.size[::-1] for pair in images for image in pair)
        assert np.array_equal(next(found.images(0)), images[0][0])
    except InputError as error:
        said = str(error)
    else:
        said = ""
    assert "\n" not in said


def test_what_ffmpeg_meets_in_a_file_is_not_written_on_stderr(tmp_path):
    path = videos.write_video(tmp_path / "a.avi", videos.moving_frames(20), "MJPG")
    content = bytearray(path.read_bytes())
    content[len(content) // 2 : len(content) // 2 + 3000] = bytes(3000)
    path.write_bytes(content)
    (tmp_path / "b.mp4").write_bytes(bytes(1000))
    code = (
        "import sys\nfrom tspslam.datasets import VideoImages\nfrom tspslam.errors import InputError\n"
        "for path in sys.argv[1:]:\n    try:\n        VideoImages(path, 'side-by-side', fps=10)\n"
        "    except InputError as error:\n        print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, path, tmp_path / "b.mp4"], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.stderr == ""
    assert done.stdout.count("\n") <= 2
    assert getattr(cv2.utils, "logging", cv2).getLogLevel() > 0
