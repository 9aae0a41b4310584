"""Live cameras, by a film that is shown at a camera's pace: all is recorded, what is left out is counted.

There is no camera where these tests run: `Film` has the interface of OpenCV's capture and is handed to the source.
"""

import threading
import time

import cv2
import numpy as np
import pytest

from tests import videos
from tests.patience import PATIENCE
from tspslam.datasets import LiveSequence, StereoFolder, live
from tspslam.errors import InputError, OutputError
from tspslam.types import Rig

RIG = Rig(fx=60.0, fy=60.0, cx=31.5, cy=23.5, baseline=0.1, width=64, height=48)
BESIDE = (2 * RIG.width, RIG.height)


class Film:
    """A camera that shows a film: an image each interval, as a driver does, then none or black ones for ever."""

    def __init__(self, path, interval=0.0, *, is_endless=False, pace=None):
        self.capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        self.interval, self.is_endless, self.pace = interval, is_endless, pace
        self.is_released = False

    def grab(self):
        if self.pace is not None:
            assert self.pace.acquire(timeout=PATIENCE)
        time.sleep(self.interval)
        return self.capture.grab() or self.is_endless

    def retrieve(self):
        there, image = self.capture.retrieve()
        return (
            (True, np.zeros((BESIDE[1], BESIDE[0], 3), np.uint8)) if self.is_endless and not there else (there, image)
        )

    def release(self):
        self.is_released = True
        self.capture.release()


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    return videos.write_video(tmp_path_factory.mktemp("film") / "a.avi", videos.moving_frames(30, *BESIDE))


def opened(film, folder, **options):
    """A source that shows a film, and the cameras that were asked for."""
    asked = []

    def open_capture(camera, size):
        asked.append((camera, size, Film(film, **options)))
        return asked[-1][2]

    return LiveSequence(0, "side-by-side", calib=RIG, recording=folder, open_capture=open_capture), asked


def test_every_pair_is_recorded_without_loss_and_the_recording_gives_it_back(tmp_path, film):
    source, asked = opened(film, tmp_path / "drive", interval=0.01)
    seen = []
    while source.wait_for(len(seen)):
        seen.append(source[len(seen)])
    source.close()
    frames = videos.moving_frames(30, *BESIDE)[1:]  # the first tells the size
    assert asked[0][:2] == (0, BESIDE)
    assert asked[0][2].is_released
    assert source.recorded == len(frames)
    recorded = StereoFolder(tmp_path / "drive")
    assert recorded.rig == source.rig == RIG
    for pair, frame in zip(recorded, frames, strict=True):
        assert np.array_equal(np.hstack([pair.left, pair.right]), frame)
    times = np.loadtxt(tmp_path / "drive" / "times.txt", usecols=1)
    assert len(times) == len(frames)
    assert (np.diff(times) > 0).all()
    for k, pair in enumerate(seen):
        number = int(pair.name)
        assert np.array_equal(pair.left, recorded[number].left)
        assert pair.stamp == times[number] == source.stamps[k]
    assert np.array_equal(source[0].right, seen[0].right)  # an earlier one, from the recording


def test_pairs_that_nobody_is_ready_for_are_left_out_counted_and_recorded(tmp_path, film):
    source, _ = opened(film, tmp_path / "drive")
    assert source.wait_for(0)
    while not source._is_over:
        time.sleep(0.01)
    numbers = [int(source[0].name)]
    while source.wait_for(len(numbers)):
        numbers.append(int(source[len(numbers)].name))
    source.close()
    assert source.recorded + source.missed == 29
    assert source.dropped == source.recorded - len(numbers)
    assert source.dropped >= 29 - 1 - live._AHEAD - source.missed - 1
    assert numbers[-live._AHEAD :] == list(range(source.recorded - live._AHEAD, source.recorded))
    (said,) = [each["message"] for each in source.warnings if each["code"] == "frames_dropped"]
    assert said.startswith(f"{source.dropped} of {source.recorded} recorded pairs were not tracked: tspslam run")


def test_a_camera_that_stops_giving_images_ends_the_source_and_that_is_said(tmp_path, film):
    source, _ = opened(film, tmp_path / "drive")
    while source.wait_for(len(source)):
        pass
    source.close()
    assert source.ended_early
    assert source.warnings[0] == {
        "code": "camera_lost",
        "message": f"camera-0: gave no more images after {source.recorded} pairs",
    }


def test_a_source_that_is_stopped_hands_on_what_waits_and_has_not_ended_early(tmp_path, film):
    source, _ = opened(film, tmp_path / "drive", interval=0.01, is_endless=True)
    assert source.wait_for(3)
    source.stop()
    while source.wait_for(len(source)):
        pass
    source.close()
    assert not source.ended_early
    assert len(source) + source.dropped == source.recorded == len(StereoFolder(tmp_path / "drive"))
    with pytest.raises(IndexError):
        source[len(source)]


def test_two_cameras_give_a_side_each(tmp_path):
    sides = [videos.moving_frames(8, seed=seed) for seed in (1, 2)]
    films = [videos.write_video(tmp_path / f"{k}.avi", frames) for k, frames in enumerate(sides)]
    source = LiveSequence(
        ["0", "/dev/video2"], calib=RIG, recording=tmp_path / "drive",
        open_capture=lambda camera, size: Film(films[0 if camera == 0 else 1], 0.01),
    )  # fmt: skip
    assert source.name == "camera-0-video2"
    while source.wait_for(len(source)):
        pair = source[len(source) - 1]
        number = int(pair.name) + 1
        assert np.array_equal(pair.left, sides[0][number])
        assert np.array_equal(pair.right, sides[1][number])
    source.close()
    assert source.recorded == 7


def test_a_recording_that_cannot_be_written_ends_the_source(tmp_path, film):
    source, _ = opened(film, tmp_path / "drive", interval=0.01, is_endless=True)
    (tmp_path / "drive" / "times.txt").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"times\.txt: cannot be written"):
        source.wait_for(50)
    source.close()


def test_what_does_not_fit_is_one_line_and_lets_go_of_the_camera(tmp_path, film):
    asked = []

    def open_film(camera, size):
        asked.append(Film(film))
        return asked[-1]

    def made(cameras=0, layout="side-by-side", calib=RIG, folder="drive"):
        return LiveSequence(cameras, layout, calib=calib, recording=tmp_path / folder, open_capture=open_film)

    with pytest.raises(InputError, match=r"is of images of 64 x 48 px, those that are given have 128 x 24 px"):
        made(layout="over-under")
    assert asked[-1].is_released
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("x")
    with pytest.raises(InputError, match="full: is there already; expected a new folder"):
        made(folder="full")
    assert asked[-1].is_released
    for cameras, layout, said in (
        ((0, 2), "side-by-side", "layout is 'side-by-side' beside two cameras"),
        (0, None, "layout is None, expected 'side-by-side' or 'over-under' of one camera"),
        (0, "alternate", "layout is 'alternate', expected 'side-by-side'"),
        ((0, "0"), None, "cameras are 0 and 0, expected two"),
        ((0, 1, 2), None, "cameras has 3"),
    ):
        with pytest.raises(InputError, match=said):
            made(cameras, layout)
    film_of_none = Film(film)
    film_of_none.capture.release()
    with pytest.raises(InputError, match="camera-0: gives no image"):
        LiveSequence(
            0, "side-by-side", calib=RIG, recording=tmp_path / "d", open_capture=lambda camera, size: film_of_none
        )
    assert film_of_none.is_released


def test_a_camera_that_is_not_there_is_one_line(tmp_path):
    with pytest.raises(InputError, match="camera 63: cannot be opened as a camera; expected a number"):
        LiveSequence(63, "side-by-side", calib=RIG, recording=tmp_path / "drive")
    assert not (tmp_path / "drive").exists()


def test_waiting_for_a_pair_ends_when_the_source_is_stopped(tmp_path, film):
    pace = threading.Semaphore(3)  # the first tells the size, two are recorded, then the camera keeps one waiting
    source, _ = opened(film, tmp_path / "drive", pace=pace)
    assert source.wait_for(1)
    threading.Timer(0.3, lambda: (source.stop(), pace.release(3))).start()
    while source.wait_for(len(source)):
        pass
    source.close()
    assert 2 <= source.recorded <= 3
