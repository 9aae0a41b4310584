"""Killed at any moment, the same command goes on and ends with the same bytes."""

import contextlib
import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace

import numpy as np
import pytest

from tspslam import evaluate_trajectory
from tspslam.datasets import open_sequence
from tspslam.errors import InputError, OutputError
from tspslam.io import RunFolder, read_trajectory
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.run.sequence import STATE_NAME
from tspslam.types import Trajectory
from tspslam.view import _style
from tspslam.vision.slam.odometry import StereoOdometry

from ..sequences import SETTINGS, SMALL_RIG, corridor, write_sequence

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
KILLS = 20
LENGTH = 16.0  # m, two frames each: over the 25 frames between checkpoints

DARK = 3  # frames without light after the walk: the map begins anew, and the camera comes back to what it saw

# Imports and compiles once, then forks a run for each line that it is given: a start of a run costs no seconds.
SERVER = textwrap.dedent("""
    import os, sys
    from pathlib import Path
    from tspslam.run.config import resolve
    from tspslam.datasets import open_sequence
    from tspslam.run.pipeline import run
    import cv2, matplotlib.figure, tspslam.view.report, tspslam.view.pictures, tspslam.view.paths
    cv2.setNumThreads(1)
    tspslam.view._style.DPI = float(os.environ["DPI"])
    source, out = Path(sys.argv[1]), Path(sys.argv[2])
    for line in sys.stdin:
        child = os.fork()
        if not child:
            run(open_sequence(source), out, resolve(assignments=sys.argv[3:]))
            os._exit(0)
        print(child, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
""")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_sequence(tmp_path_factory.mktemp("sequence") / "walk", corridor(LENGTH, SMALL_RIG))


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "run"
    run(open_sequence(folder), out, resolve(assignments=SETTINGS))
    return out


def content(folder):
    names = (p for p in folder.rglob("*") if p.is_file() and p.name not in ("timings.json", "manifest.jsonl"))
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in names}


def test_the_path_is_the_true_one(whole):
    path, truth = read_trajectory(whole / "trajectory.tum"), corridor(LENGTH, SMALL_RIG)
    errors = evaluate_trajectory(path, Trajectory(np.arange(float(len(truth))), truth.truth))
    assert errors.matched == len(truth)
    assert errors.ate_rmse_m < 0.003 * LENGTH


def test_two_runs_give_the_same_bytes(folder, whole, tmp_path):
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))
    assert content(tmp_path / "run") == content(whole)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "run").rglob("*") if p.stem != "timings"}
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))  # nothing is left to do
    kept = {p: p.stat().st_mtime_ns for p in before if p.is_file() and p.name != "manifest.jsonl"}
    assert kept == {p: before[p] for p in kept}


def test_killed_at_twenty_moments_it_ends_with_the_same_bytes(folder, whole, tmp_path):
    """A run that ends before its kill was too fast for it: the next ones are given less time."""
    rng, out, expected, ends = random.Random(7), tmp_path / "run", content(whole), []
    command = [sys.executable, "-c", SERVER, str(folder), str(out), *SETTINGS]
    given = os.environ | {"DPI": str(_style.DPI)}
    with subprocess.Popen(command, stdin=-1, stdout=-1, text=True, bufsize=1, env=given) as server:

        def attempt(patience):
            server.stdin.write("go\n")
            child = int(server.stdout.readline())
            if patience:
                time.sleep(patience)
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            return int(server.stdout.readline())

        started = time.perf_counter()
        assert attempt(None) == 0
        seconds = 0.5 * (time.perf_counter() - started)
        shutil.rmtree(out)
        while ends.count(-signal.SIGKILL) < KILLS and len(ends) < 3 * KILLS:
            ends.append(attempt(rng.uniform(0, seconds)))
            if ends[-1] == 0:
                assert content(out) == expected
                shutil.rmtree(out)
                seconds *= 0.8
        assert attempt(None) == 0
        server.stdin.close()
    assert ends.count(-signal.SIGKILL) == KILLS
    assert content(out) == expected


def test_a_kill_loses_what_came_after_the_last_checkpoint(folder, whole, tmp_path):
    out, anew = tmp_path / "run", []

    def kill(arrived):
        if arrived.index == 30:
            for _ in range(6000):  # what writes the checkpoint after 25 frames does so beside the run
                if STATE_NAME in RunFolder.open(out).units:
                    break
                time.sleep(0.01)
            os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if not child:
        run(open_sequence(folder), out, resolve(assignments=SETTINGS), on_frame=kill)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    run(open_sequence(folder), out, resolve(assignments=SETTINGS), on_frame=lambda frame: anew.append(frame.index))
    assert anew == list(range(25, len(corridor(LENGTH, SMALL_RIG))))
    assert content(out) == content(whole)


def test_a_checkpoint_of_other_images_does_not_count(folder, whole, tmp_path):
    shutil.copytree(folder, tmp_path / "walk")
    first = tmp_path / "walk/left/003.png"
    shutil.copytree(whole, tmp_path / "run")
    first.write_bytes((tmp_path / "walk/left/004.png").read_bytes())
    run(open_sequence(tmp_path / "walk"), tmp_path / "run", resolve(assignments=SETTINGS))
    run(open_sequence(tmp_path / "walk"), tmp_path / "fresh", resolve(assignments=SETTINGS))
    assert content(tmp_path / "run") == content(tmp_path / "fresh") != content(whole)


def test_a_damaged_checkpoint_does_not_count(folder, whole, tmp_path):
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run" / STATE_NAME).write_bytes(b"no state")
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))
    assert content(tmp_path / "run") == content(whole)


def no_rows(state):
    del state["rows"]


def not_a_number(state):
    state["poses"] = state["poses"] * np.nan


def too_few_landmarks(state):
    state["xyz"] = state["xyz"][:10]


def too_few_rows(state):
    state["rows"] = np.frombuffer(b"[]", np.uint8)


@pytest.mark.parametrize("change", [no_rows, not_a_number, too_few_landmarks, too_few_rows, None])
def test_a_checkpoint_that_was_changed_with_its_hash_does_not_count(folder, whole, tmp_path, change):
    shutil.copytree(whole, tmp_path / "run")
    config = resolve(assignments=SETTINGS)
    path = tmp_path / "run" / STATE_NAME
    if change is None:
        path.write_bytes(path.read_bytes()[:-100])
    else:
        state = dict(np.load(path))
        change(state)
        np.savez(path, **state)
    with RunFolder.create(tmp_path / "run", config.nested | {"source": {"name": "walk", "frames": None}}) as held:
        held.record(path, input_hash=held.units[STATE_NAME].input)
    run(open_sequence(folder), tmp_path / "run", config)
    assert content(tmp_path / "run") == content(whole)


def test_numbers_of_a_frame_that_are_gone_come_back(folder, whole, tmp_path):
    shutil.copytree(whole, tmp_path / "run")
    gone, *_ = sorted((tmp_path / "run/frames").glob("*.json"))
    gone.unlink()
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))
    assert content(tmp_path / "run") == content(whole)


def test_a_checkpoint_of_another_version_does_not_count(folder, whole, tmp_path, monkeypatch):
    shutil.copytree(whole, tmp_path / "run")
    monkeypatch.setattr("tspslam.run.sequence.MADE_BY", b"another")
    seen = []
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS), progress=lambda *a: seen.append(a))
    assert len(seen) == len(open_sequence(folder))


def test_a_second_run_in_the_same_folder_is_refused(folder, tmp_path):
    config = resolve(assignments=SETTINGS)
    settings = config.nested | {"source": {"name": "walk", "frames": None}}
    with RunFolder.create(tmp_path / "run", settings), pytest.raises(InputError, match="run"):
        run(open_sequence(folder), tmp_path / "run", config)


def test_a_full_disk_ends_the_run_and_room_lets_it_go_on(folder, whole, tmp_path, monkeypatch):
    sync, left = os.fsync, [15]

    def narrow(handle):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        sync(handle)

    monkeypatch.setattr(os, "fsync", narrow)
    with pytest.raises(OutputError, match="No space left"):
        run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))
    monkeypatch.undo()
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))
    assert content(tmp_path / "run") == content(whole)


def test_a_checkpoint_that_finds_no_room_ends_the_run_and_room_lets_it_go_on(folder, whole, tmp_path):
    """Files may become as large as a frame, but not as a checkpoint: writing fails in the middle of one."""
    frames = max(path.stat().st_size for path in (whole / "frames").iterdir())
    most = (frames + (whole / STATE_NAME).stat().st_size) // 2
    assert frames < 0.9 * most
    child = os.fork()
    if not child:
        end_with_files_of(most, folder, tmp_path / "run")
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == FULL
    assert not list((tmp_path / "run").glob("*.tmp*"))
    run(open_sequence(folder), tmp_path / "run", resolve(assignments=SETTINGS))
    assert content(tmp_path / "run") == content(whole)


FULL = 42


def end_with_files_of(most, folder, out):
    """Run where no file may be larger than that, and end with `FULL` if that is said."""
    import resource

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    code = 1
    try:
        run(open_sequence(folder), out, resolve(assignments=SETTINGS))
    except OutputError as error:
        code = FULL if STATE_NAME in str(error) else 2
    finally:
        os._exit(code)


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    """A walk, a dark stretch, and most of the walk again: a loop is closed in the second half."""
    walk = corridor(13.0, SMALL_RIG)
    pairs = [walk[k] for k in range(26)]
    dark = [replace(pairs[0], left=0 * pairs[0].left, right=0 * pairs[0].right)] * DARK
    order = [*pairs, *dark, *pairs[5:20]]
    return [replace(pair, index=k, stamp=float(k), name=f"{k:03d}") for k, pair in enumerate(order)]


class Loop:
    """The pairs of a loop as a source."""

    name, rig = "loop", SMALL_RIG

    def __init__(self, pairs):
        self.pairs = pairs

    def __len__(self):
        return len(self.pairs)

    def __getitem__(self, index):
        return self.pairs[index]


def run_loop(pairs, out, **options):
    """Run over a loop, with a checkpoint at each frame."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tspslam.run.sequence._EVERY", 1)
        patch.setattr("tspslam.run.sequence._SHARE", 0.0)
        return run(Loop(pairs), out, resolve(assignments=SETTINGS), **options)


@pytest.fixture(scope="module")
def closed(loop, tmp_path_factory):
    """A run that closed a loop."""
    return run_loop(loop, tmp_path_factory.mktemp("loop") / "run")


def test_no_checkpoint_waits_until_a_loop_is_closed(loop, closed, tmp_path, monkeypatch):
    """There is one after each frame but those at which it would; the last frame's is taken whatever is under way."""
    asked, state = [], StereoOdometry.state

    def watched(odometry):
        asked.append((len(odometry.path), odometry.mapper.is_correcting))
        return state(odometry)

    monkeypatch.setattr(StereoOdometry, "state", watched)
    run_loop(loop, tmp_path / "run")
    found = closed.run["loop_closures"][0][0] + 1  # frames by then
    frames = [count for count, _ in asked]
    assert set(range(2, found)) <= set(frames)
    assert set(range(found, len(loop))) - set(frames)
    assert not any(is_correcting for _, is_correcting in asked[:-1])


@pytest.mark.parametrize("is_there", [False, True])
def test_killed_where_a_checkpoint_takes_its_place_it_goes_on_from_one(is_there, loop, closed, tmp_path):
    """It is noted before it is there: in between the folder has the one before, which counts, too."""
    replace_file, done = os.replace, []

    def kill(source, target):
        done.append(os.path.basename(target))
        if is_there:
            replace_file(source, target)
        if done.count(STATE_NAME) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        if not is_there:
            replace_file(source, target)

    child = os.fork()
    if not child:
        os.replace = kill
        run_loop(loop, tmp_path / "run")
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    seen = []
    run_loop(loop, tmp_path / "run", progress=lambda *given: seen.append(given))
    assert 0 < len(seen) < len(loop)
    assert content(tmp_path / "run") == content(closed.folder)


@pytest.mark.parametrize("later", [0, 1, 2])  # frames after the one that closes the loop
def test_killed_while_a_loop_closes_it_ends_with_the_same_bytes(loop, closed, tmp_path, later):
    assert closed.run["loops"] > 0
    stop = closed.run["loop_closures"][0][0] + 1 + later
    assert stop < len(loop)

    def kill(step):
        if step.stage == "tracking" and step.done == stop:
            os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if not child:
        run_loop(loop, tmp_path / "run", on_step=kill)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    seen = []
    run_loop(loop, tmp_path / "run", progress=lambda *given: seen.append(given))
    assert 0 < len(seen) < len(loop)  # it went on from a checkpoint
    assert content(tmp_path / "run") == content(closed.folder)
