"""Where others take hold of a run: a function called with each frame, and one call that a worker process can make."""

import multiprocessing
import threading
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from tspslam import Frame, InputError, Settings, load_run
from tspslam.datasets import open_sequence
from tspslam.io import RunFolder
from tspslam.run import sequence as sequence_run
from tspslam.run.config import resolve
from tspslam.run.pipeline import run, run_path
from tspslam.vision.slam.odometry import Tracking

from ..sequences import DETECTOR, SMALL_RIG, corridor, write_sequence

STAGES = Settings(detector=DETECTOR, tracking=Tracking(keyframe_share=0.9))
CHOSEN = resolve(assignments=["detector.count=800", "tracking.keyframe_share=0.9"])


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("walk") / "walk", corridor(4.0, SMALL_RIG))


@pytest.fixture(scope="module")
def whole(walk, tmp_path_factory):
    """A run, and what its function was given: frame and thread."""
    out, seen = tmp_path_factory.mktemp("whole") / "run", []
    run(open_sequence(walk), out, CHOSEN, on_frame=lambda frame: seen.append((frame, threading.current_thread())))
    return out, seen


def content(folder):
    names = (p for p in folder.rglob("*") if p.is_file() and p.name not in ("timings.json", "manifest.jsonl"))
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in names}


def test_each_frame_is_handed_out_in_order_in_the_thread_that_called(walk, whole):
    frames = [frame for frame, _ in whole[1]]
    assert [frame.index for frame in frames] == list(range(len(open_sequence(walk))))
    assert {type(frame) for frame in frames} == {Frame}
    assert {thread for _, thread in whole[1]} == {threading.current_thread()}
    assert tuple(frame.index for frame in frames if frame.is_keyframe) == load_run(whole[0]).keyframes


def test_a_stored_frame_is_the_one_handed_out_with_its_pose_as_tracked(whole):
    handed = {frame.index: frame for frame, _ in whole[1]}
    for frame in load_run(whole[0]).frames:
        same = handed[frame.index]
        np.testing.assert_array_equal(frame.T_world_camera, same.T_world_camera)
        np.testing.assert_array_equal(frame.response.z, same.response.z)
        assert (frame.is_keyframe, frame.is_lost) == (same.is_keyframe, same.is_lost)


@pytest.mark.parametrize("error", [KeyError("of the user's own"), KeyboardInterrupt()])
def test_what_the_function_raises_ends_the_run_which_then_goes_on(walk, whole, tmp_path, monkeypatch, error):
    monkeypatch.setattr(sequence_run, "_EVERY", 2)
    seen = []

    def fail(frame):
        seen.append(frame.index)
        if frame.index == 5:
            raise error

    with pytest.raises(type(error)):
        run(open_sequence(walk), tmp_path / "run", CHOSEN, on_frame=fail)
    assert seen == [0, 1, 2, 3, 4, 5]
    rest = []
    run(open_sequence(walk), tmp_path / "run", CHOSEN, on_frame=lambda frame: rest.append(frame.index))
    assert rest == list(range(rest[0], len(open_sequence(walk))))
    assert 0 < rest[0] <= 5  # the frame that failed comes again
    assert content(tmp_path / "run") == content(whole[0])


def test_a_worker_process_makes_the_same_run_from_plain_arguments(walk, whole, tmp_path):
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=fresh) as pool:
        result = pool.submit(run_path, str(walk), str(tmp_path / "run"), STAGES).result()
    assert result.folder == tmp_path / "run"
    assert result.run == load_run(tmp_path / "run").record
    mine, theirs = (
        {name: data for name, data in content(folder).items() if not name.startswith(("pictures/", "report"))}
        for folder in (whole[0], tmp_path / "run")
    )  # pictures of tests are coarser here than there
    assert mine == theirs


def test_some_frames_of_a_path_are_run_and_progress_is_told(walk, tmp_path):
    told, seen = [], []
    run_path(walk, tmp_path / "run", frames=range(1, 3), progress=lambda *said: told.append(said), on_frame=seen.append)
    assert told == [(1, 2, "frame 1"), (2, 2, "frame 2")]
    assert [frame.index for frame in seen] == [1, 2]
    with RunFolder.create(tmp_path / "run", resolve().nested | {"source": {"name": "walk", "frames": [1, 3, 1]}}):
        pass  # the settings are the defaults


@pytest.mark.parametrize(("given", "said"), [
    ({"on_frame": "print"}, "on_frame is 'print', expected a callable, such as print"),
    ({"settings": "detector.count=800"}, "settings is the path 'detector.count=800'"),
])  # fmt: skip
def test_what_cannot_be_called_or_is_no_setting_is_named_before_anything_is_made(walk, tmp_path, given, said):
    with pytest.raises(InputError, match=said):
        run_path(walk, tmp_path / "run", **given)
    assert not (tmp_path / "run").exists()


def test_pairs_that_do_not_say_where_they_stand_are_numbered_by_their_place(walk, whole, tmp_path):
    """As all made by hand are: `StereoPair` counts from 0 by default."""

    class Unnumbered:
        def __init__(self, pairs):
            self._pairs, self.name, self.rig = pairs, pairs.name, pairs.rig

        def __len__(self):
            return len(self._pairs)

        def __getitem__(self, index):
            return replace(self._pairs[index], index=0)

    run(Unnumbered(open_sequence(walk)), tmp_path, CHOSEN)
    assert len(list((tmp_path / "frames").glob("*.npz"))) > 1
    for path in (whole[0] / "frames").iterdir():
        assert (tmp_path / "frames" / path.name).read_bytes() == path.read_bytes()
