"""Runs of videos and of live cameras, from the command line too: the path of a video is that of its images."""

import json
import os
import signal
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests import videos
from tests.datasets.test_live import Film
from tspslam import Session, cli, evaluate_trajectory
from tspslam.cli._sources import Given, open_source
from tspslam.datasets import LiveSequence, VideoSequence, live, synthetic
from tspslam.datasets.views import open_views
from tspslam.errors import InputError
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.types import Trajectory
from tspslam.vision.calibration.formats.own import save_cameras

from ..sequences import SETTINGS, SMALL_RIG, Kept

COUNT, RATE = 16, 20.0
SMALL = ["detector.count=300"]


@pytest.fixture(scope="module")
def street():
    sequence = Kept(synthetic.street(COUNT / 2, step=0.5), SMALL_RIG, synthetic.Faults(noise=0.01))
    return sequence, [replace(sequence[k], stamp=k / RATE) for k in range(COUNT)]


@pytest.fixture(scope="module")
def frames(street):
    return [np.hstack([pair.left, pair.right]) for pair in street[1]]


@pytest.fixture(scope="module")
def film(tmp_path_factory, frames):
    folder = tmp_path_factory.mktemp("street")
    save_cameras(SMALL_RIG, folder / "calib.yaml")
    return videos.write_video(folder / "street.avi", frames, fps=RATE)


def path_of(pairs):
    with Session(SMALL_RIG, resolve(assignments=SETTINGS).settings, keep=False) as session:
        for pair in pairs:
            session.process(pair)
        session.finish()
        return session.trajectory


def error_of(path, truth):
    return evaluate_trajectory(path, Trajectory(path.stamp, truth)).ate_rmse_m


def test_a_lossless_video_gives_the_path_of_its_images(street, film):
    found = path_of(VideoSequence(film, "side-by-side", calib=SMALL_RIG))
    images = path_of(street[1])
    assert np.array_equal(found.stamp, images.stamp)
    assert np.abs(found.T_world_camera - images.T_world_camera).max() < 1e-9


@pytest.mark.parametrize("kind", ["mpeg4.mp4", "jpegs.mjpeg"])
def test_a_lossy_video_of_high_quality_has_about_the_error_of_its_images(tmp_path, street, frames, kind):
    write = videos.write_jpegs if kind.endswith("mjpeg") else lambda *given: videos.write_video(*given, "mp4v")
    found = VideoSequence(write(tmp_path / kind, frames), "side-by-side", calib=SMALL_RIG, fps=RATE)
    truth = np.asarray(street[0].truth)[:COUNT]
    assert error_of(path_of(found), truth) < 1.5 * error_of(path_of(street[1]), truth) + 0.01


def test_a_stopped_run_of_a_video_goes_on_to_the_same_bytes(tmp_path, frames, monkeypatch):
    monkeypatch.setattr("tspslam.run.sequence._EVERY", 2)
    film = videos.write_video(tmp_path / "street.mp4", frames, "mp4v", fps=RATE)
    seen = []

    def filled(name, on_frame=seen.append):
        source = VideoSequence(film, "side-by-side", calib=SMALL_RIG)
        run(source, tmp_path / name, resolve(assignments=SMALL), frames=range(6), on_frame=on_frame)
        return (tmp_path / name / "run.json").read_bytes()

    def stop(frame):
        if frame.index == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        filled("stopped", stop)
    stopped = filled("stopped")
    assert [frame.index for frame in seen] in ([4, 5], [3, 4, 5], [2, 3, 4, 5])  # from a checkpoint on
    assert stopped == filled("whole")


def test_a_video_is_run_from_the_command_line(tmp_path, film, capsys):
    calib = str(film.with_name("calib.yaml"))
    command = ["run", str(film), "--calib", calib, "--out", str(tmp_path / "run"), "--frames", "0:2"]
    assert cli.exit_code(command) == cli.BAD_INPUT
    assert "likely, by its shape); expected layout (--layout) side-by-side or over-under" in capsys.readouterr().err
    assert cli.exit_code([*command, "--layout", "side-by-side", "--set", *SMALL, "--json"]) == cli.COMPLETE
    found = json.loads(capsys.readouterr().out)
    assert (found["source"], found["frames"]) == ("street", 2)
    for extra, said in (
        (["--layout", "beside"], "layout is 'beside'"),
        (["--layout", "over-under", "--topics", "a", "b"], "is no bag"),
    ):
        assert cli.exit_code([*command, *extra]) == cli.BAD_INPUT
        assert said in capsys.readouterr().err


def test_how_far_a_video_has_been_gone_through_is_told(tmp_path, film, frames):
    left = videos.write_video(tmp_path / "left.avi", [each[:, : each.shape[1] // 2] for each in frames])
    right = videos.write_video(tmp_path / "right.avi", [each[:, each.shape[1] // 2 :] for each in frames])
    calib, steps, places = film.parent / "calib.yaml", [], []
    open_source(Given([film], calib, layout="side-by-side"), steps.append)
    assert [(step.stage, step.done, step.total) for step in steps] == [
        ("indexing", k, COUNT) for k in range(1, COUNT + 1)
    ]
    VideoSequence((left, right), calib=calib, on_index=lambda *place: places.append(place))
    assert places == [(k, 2 * COUNT) for k in range(1, 2 * COUNT + 1)]
    steps.clear()
    with pytest.raises(InputError):
        open_source(Given([tmp_path], calib), steps.append)
    assert steps == []
    said = open_views([left, right], on_index=lambda *place: places.append(place))
    assert (len(said), len(places)) == (COUNT, 4 * COUNT)


def test_options_of_videos_and_cameras_go_with_them_alone(tmp_path, film, capsys):
    image = tmp_path / "a.png"
    image.write_bytes(b"x")
    for words, said in (
        (["--layout", "alternate", str(image), str(image)], "--layout"),
        (["--fps", "10", str(image), str(image)], "--fps"),
        ([str(film), str(film)], "two videos need a calibration file"),
        (["--camera", "0", "--layout", "side-by-side"], "a camera needs a calibration file"),
        (["--camera", "0", "--calib", "c.yaml"], "expected one with --layout"),
        (["--camera", "0", "--camera", "1", "--calib", "c.yaml", str(film)], "does not go with --camera"),
        (["--camera", "0", "--camera", "1", "--calib", "c.yaml", "--frames", "0:1"], "does not go with --camera"),
    ):
        assert cli.exit_code(["run", *words]) == cli.USAGE
        assert said in capsys.readouterr().err


def test_a_video_that_was_cut_off_is_said_in_the_run(tmp_path, frames):
    path = videos.write_video(tmp_path / "cut.mkv", frames * 3)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 8])
    source = VideoSequence(path, "side-by-side", calib=SMALL_RIG)
    found = run(source, tmp_path / "run", resolve(assignments=SMALL)).run
    assert found["frames"] == len(source) < COUNT
    assert [each["code"] for each in found["warnings"]].count("video_cut") == 1


def live_source(film, folder, **options):
    return LiveSequence(
        0, "side-by-side", calib=SMALL_RIG, recording=folder, open_capture=lambda camera, size: Film(film, **options)
    )


def test_a_run_takes_pairs_as_they_come_and_an_unplugged_camera_degrades_it(tmp_path, film):
    source = live_source(film, tmp_path / "recording", interval=0.05)
    done = []
    found = run(source, tmp_path / "run", resolve(assignments=SMALL), progress=lambda *said: done.append(said))
    source.close()
    assert found.run["frames"] == len(source) == len(done) > 0
    assert len(source) + source.dropped == source.recorded == COUNT - 1
    assert found.run["status"] == "degraded"
    assert found.run["warnings"][-1 - bool(source.dropped)]["code"] == "camera_lost"
    assert (tmp_path / "run" / "report.html").exists()
    assert (tmp_path / "recording" / "calib.yaml").exists()


def test_a_live_source_takes_no_range_of_frames_and_needs_a_pair(tmp_path, film):
    source = live_source(film, tmp_path / "recording")
    with pytest.raises(InputError, match="expected none: they are taken as they come"):
        run(source, tmp_path / "run", resolve(), frames=range(3))
    source.stop()
    with pytest.raises(InputError, match="camera-0: ended before it gave a pair"):
        run(source, tmp_path / "run", resolve())
    source.close()


def test_ctrl_c_ends_a_live_run_with_all_results(tmp_path, film, monkeypatch, capsys):
    class Endless(Film):
        def grab(self):
            there = super().grab()
            if not there:  # from the beginning again
                self.capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
            return there or self.capture.grab()

    monkeypatch.setattr(live, "open_camera", lambda camera, size: Endless(film, 0.05))
    before = signal.getsignal(signal.SIGINT)

    def interrupt():
        while not (tmp_path / "run-recording" / "left" / "000004.png").exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    command = ["run", "--camera", "0", "--layout", "side-by-side", "--calib", str(film.with_name("calib.yaml"))]
    command += ["--out", str(tmp_path / "run"), "--set", *SMALL]
    code = cli.exit_code(command)
    thread.join(60)
    said = capsys.readouterr()
    assert code == cli.COMPLETE, said.err
    assert signal.getsignal(signal.SIGINT) == before
    assert f"recording into {tmp_path / 'run-recording'}; ctrl-C ends it" in said.err
    found = json.loads((tmp_path / "run" / "run.json").read_text())
    assert found["status"] == "complete"
    assert found["frames"] >= 1
    assert (tmp_path / "run" / "report.html").exists()
    assert cli.exit_code(command) == cli.BAD_INPUT
    assert "run: is there already; expected a new folder for the run of a camera" in capsys.readouterr().err
