"""What goes wrong in videos and before cameras without a word of FFmpeg's or the driver's: it is said here."""

import threading

import numpy as np
import pytest

from tests import videos
from tests.datasets.test_live import RIG, opened
from tspslam.datasets import LiveSequence, VideoImages, live
from tspslam.errors import InputError


def test_a_frame_that_alternate_images_lack_is_refused_as_sides_would_change_places(tmp_path):
    path = videos.write_video(tmp_path / "a.mp4", videos.moving_frames(8, 64, 48), "mp4v")
    assert len(VideoImages(path, "alternate")) == 4
    videos.retime(path, [448, 448, 960, 448, 448, 448, 448, 448])
    with pytest.raises(InputError, match=r"frames 2 and 3 are 0\.0938 s apart, others 0\.0438 s: one is lost"):
        VideoImages(path, "alternate")
    cut = videos.write_video(tmp_path / "b.avi", videos.moving_frames(8, 64, 48), "MJPG")
    cut.write_bytes(cut.read_bytes()[: 2 * cut.stat().st_size // 3])
    with pytest.raises(InputError, match="of 8 frames that can be decoded"):
        VideoImages(cut, "alternate")


def test_frames_that_stand_still_are_said(tmp_path):
    frames = videos.moving_frames(8, 128, 48)
    still = [*frames[:5], frames[4], frames[4], frames[7]]
    moving = videos.write_video(tmp_path / "a.avi", frames)
    stuck = videos.write_video(tmp_path / "b.avi", still)
    assert VideoImages(moving, "side-by-side").warnings == []
    (said,) = VideoImages(stuck, "side-by-side").warnings
    assert said["code"] == "video_frozen"
    assert said["message"].startswith("b.avi: 2 of 8 frames are the one before them again")


def test_one_rate_for_two_videos_of_two_rates_is_refused(tmp_path):
    paths = [
        videos.write_video(tmp_path / f"{rate}.avi", videos.moving_frames(count, 64, 48), fps=rate)
        for rate, count in ((20, 8), (10, 4))
    ]
    with pytest.raises(InputError, match=r"has 10 frames a second, 20\.avi 20; expected no one rate"):
        VideoImages(paths, fps=20)


class Broken:
    """A camera that gives some images and then fails in some way."""

    def __init__(self, count, fails):
        self.count, self.fails, self.is_released = count, fails, False

    def grab(self):
        self.count -= 1
        return self.fails() if self.count < 0 else True

    def retrieve(self):
        return True, np.full((RIG.height, 2 * RIG.width, 3), self.count % 200, np.uint8)

    def release(self):
        self.is_released = True


def raised():
    raise OSError(19, "no such device")


def test_a_camera_that_raises_is_lost(tmp_path):
    camera = Broken(4, raised)
    source = LiveSequence(0, "side-by-side", calib=RIG, recording=tmp_path / "r", open_capture=lambda *_: camera)
    while source.wait_for(len(source)):
        pass
    source.close()
    assert source.ended_early
    assert camera.is_released
    assert [each["code"] for each in source.warnings] == ["camera_lost"]


def test_a_camera_that_hangs_is_lost_and_can_be_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(live, "_PATIENCE", 1.0)
    woken = threading.Event()
    camera = Broken(4, lambda: woken.wait(60))
    source = LiveSequence(0, "side-by-side", calib=RIG, recording=tmp_path / "r", open_capture=lambda *_: camera)
    while source.wait_for(len(source)):
        pass
    source.close()
    assert source.ended_early
    assert len(source) == 3  # the first tells the size
    woken.set()
    source._threads[0].join(60)


def test_what_is_no_image_ends_a_source(tmp_path):
    camera = Broken(4, lambda: True)
    whole = camera.retrieve
    camera.retrieve = lambda: whole() if camera.count >= 0 else (True, None)
    source = LiveSequence(0, "side-by-side", calib=RIG, recording=tmp_path / "r", open_capture=lambda *_: camera)
    while source.wait_for(len(source)):
        pass
    source.close()
    assert source.ended_early


def test_a_source_that_is_never_asked_leaves_no_folder(tmp_path):
    film = videos.write_video(tmp_path / "a.avi", videos.moving_frames(3, 2 * RIG.width, RIG.height))
    source, _ = opened(film, tmp_path / "r")
    source.close()
    assert not (tmp_path / "r").exists()
