"""A run folder is followed from outside, and a viewer beside a run changes nothing of it."""

import dataclasses
import hashlib
import http.client
import importlib.util
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tspslam import InputError, load_run
from tspslam.cli import BAD_INPUT, exit_code
from tspslam.io import RunFolder, write_frame
from tspslam.run import viewing as viewing_module
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.run.viewing import Shots, _packed, serve, viewing
from tspslam.run.watch import RunWatch

from ..patience import PATIENCE
from ..sequences import SETTINGS, corridor
from ..serving import served

needs_viser = pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="no viser")
needs_signals = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture(scope="module")
def sequence():
    return corridor(2.5)


@pytest.fixture(scope="module")
def finished(sequence, tmp_path_factory):
    """A finished run: only to be read."""
    folder = tmp_path_factory.mktemp("runs") / "corridor"
    run(sequence, folder, resolve(assignments=SETTINGS))
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    """A copy of it, to be spoilt."""
    return Path(shutil.copytree(finished, tmp_path / "run"))


class StopError(Exception):
    pass


def stopped_run(sequence, folder, after):
    """A run that ends after so many frames."""
    seen = []

    def on_frame(frame):
        seen.append(frame)
        if len(seen) == after:
            raise StopError

    with pytest.raises(StopError):
        run(sequence, folder, resolve(assignments=SETTINGS), on_frame=on_frame)


def look(folder):
    watch = RunWatch(folder)
    world = watch.look()
    while (more := watch.look()) is not None:
        world = more
    return watch, world


def test_a_finished_run_is_shown_as_it_was_refined(finished):
    (_, world), stored = look(finished), load_run(finished)
    assert not world.missing
    assert not world.is_live
    assert world.said.startswith("complete: ")
    assert world.map_ is not None
    assert world.stored == stored.stored
    assert len(world.stations) == len(stored)
    for each in world.stations:
        np.testing.assert_array_equal(each.T_world_camera, stored.pose(each.number))
        assert (each.state == "keyframe") == (each.number in stored.keyframes)


def test_nothing_new_is_no_news(finished):
    watch, _ = look(finished)
    assert watch.look() is None


def test_a_run_that_was_stopped_is_shown_as_far_as_it_came(sequence, tmp_path):
    stopped_run(sequence, tmp_path / "run", 3)
    watch, world = look(tmp_path / "run")
    assert not world.missing
    assert world.map_ is None
    assert world.said.startswith("not finished: ")
    assert world.stored
    for each in world.stations:
        np.testing.assert_array_equal(each.T_world_camera, watch.frame(each.number).T_world_camera)


def test_frames_are_seen_while_a_run_goes_on(sequence, tmp_path):
    counts, watch = [], RunWatch(tmp_path / "run")
    assert watch.look().said.startswith("no run here yet")

    def on_frame(frame):
        world = watch.look()
        if world is not None:
            counts.append((len(world.stored), world.is_live))

    run(sequence, tmp_path / "run", resolve(assignments=SETTINGS), on_frame=on_frame)
    assert all(is_live for _, is_live in counts)
    assert [n for n, _ in counts] == sorted(n for n, _ in counts)
    assert counts[-1][0] > 0
    world = watch.look()
    assert (world.is_live, world.map_ is not None) == (False, True)


def test_a_folder_in_which_a_run_begins_is_no_strangers(tmp_path):
    (tmp_path / ".lock").write_text("1\n")
    (_, world) = look(tmp_path)
    assert not world.missing


def test_a_run_that_holds_its_folder_is_live(folder):
    with RunFolder.create(folder, RunFolder.open(folder).config):
        _, world = look(folder)
        assert world.is_live
        assert world.said.startswith("live: ")
    assert not look(folder)[1].is_live


def test_a_lock_of_a_process_that_is_gone_is_none(folder):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    (folder / ".lock").write_text(f"{gone.pid}\n")
    assert not look(folder)[1].is_live


def spoil(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)


def test_a_corrupt_frame_is_named_and_the_rest_is_shown(folder):
    number = load_run(folder).stored[1]
    spoil(folder / "frames" / f"{number:06d}.npz")
    watch, world = look(folder)
    assert world.map_ is not None
    assert len(world.stations) == len(load_run(folder))
    with pytest.raises(InputError, match=rf"{number:06d}\.npz: was changed since the run"):
        watch.frame(number)


def test_a_frame_that_is_made_anew_is_read_anew(folder):
    watch, _ = look(folder)
    number = load_run(folder).stored[1]
    first = watch.frame(number)
    with RunFolder.create(folder, RunFolder.open(folder).config) as opened:
        moved = dataclasses.replace(first, T_world_camera=np.eye(4))
        write_frame(opened.frame_path(number), moved)
        opened.record(opened.frame_path(number), input_hash="another")
    while watch.look() is not None:
        pass
    np.testing.assert_array_equal(watch.frame(number).T_world_camera, np.eye(4))


def test_a_corrupt_map_is_named_and_the_frames_are_shown(folder):
    spoil(folder / "map.npz")
    _, world = look(folder)
    assert world.map_ is None
    assert any("map.npz: was changed since the run" in line for line in world.missing)
    assert world.stations


def test_a_corrupt_path_is_named_and_the_frames_have_their_own(folder):
    (folder / "trajectory.tum").write_text("nonsense\n")
    _, world = look(folder)
    assert any("trajectory.tum" in line for line in world.missing)
    assert {each.number for each in world.stations} == set(world.stored)


@pytest.mark.parametrize("name", ["run.json", "manifest.jsonl", "config.yaml"])
def test_a_damaged_book_is_named_and_the_frames_are_shown(folder, name):
    (folder / name).write_bytes(b"\xff{nonsense\nmore\n")
    _, world = look(folder)
    assert any(name in line for line in world.missing)
    assert world.stations
    assert world.stored


def test_a_run_of_another_version_is_named_and_what_can_be_read_is_shown(folder):
    text = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text(text.replace("format 3", "format 2", 1))
    _, world = look(folder)
    assert any("another version" in line for line in world.missing)
    assert world.stored
    assert world.map_ is not None


def test_what_cannot_be_shown_at_all_is_one_line(tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="is no folder"):
        RunWatch(tmp_path / "file")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("x")
    with pytest.raises(InputError, match=r"holds no config\.yaml of a run"):
        serve(tmp_path / "other")


@pytest.mark.skipif(not hasattr(os, "symlink") or os.name != "posix", reason="links of POSIX")
def test_no_link_is_followed(folder, tmp_path):
    shutil.move(folder / "map.npz", tmp_path / "elsewhere.npz")
    (folder / "map.npz").symlink_to(tmp_path / "elsewhere.npz")
    with pytest.raises(InputError, match=r"map\.npz: is a link"):
        RunWatch(folder)


def test_a_frame_that_is_not_stored_is_refused(finished):
    with pytest.raises(InputError, match=r"has no stored frame 99, expected one of \[0, "):
        serve(finished, frame=99)


def test_without_viser_one_line_says_what_to_install(finished, monkeypatch, capsys):
    monkeypatch.setattr(viewing_module.importlib.util, "find_spec", lambda name: None)
    assert exit_code(["view", str(finished)]) == BAD_INPUT
    said = capsys.readouterr().err
    assert "pip install 'tspslam[viewer]'" in said
    assert said.count("\n") == 1
    with pytest.raises(InputError, match=r"tspslam\[viewer\]"):
        viewing(finished)


def test_without_a_viewer_a_run_calls_nobody(finished):
    frame = next(load_run(finished).frames)
    with viewing(None) as on_frame:
        assert on_frame(frame) is None
        on_frame.stay()


def all_shots(data):
    shots = Shots(Pipe(data))
    for _ in range(1000):
        if shots.is_over:
            return shots.newest()
        time.sleep(0.01)
    raise AssertionError("it does not end")


class Pipe(io.RawIOBase):
    """Bytes that come a few at a time, as from a pipe."""

    def __init__(self, data):
        self._data = data

    def read(self, size=-1):
        block, self._data = self._data[: min(size, 1000)], self._data[min(size, 1000) :]
        return block


def test_frames_survive_their_way_to_the_viewer(finished):
    frames = list(load_run(finished).frames)
    shot = all_shots(b"".join(_packed(frame) for frame in frames))
    last = frames[-1]
    assert (shot.number, shot.rig) == (last.index, last.rig)
    np.testing.assert_array_equal(shot.T_world_camera, last.T_world_camera)
    assert shot.jpeg[:2] == b"\xff\xd8"


def test_what_is_no_message_ends_the_following(finished):
    whole = _packed(next(load_run(finished).frames))
    assert all_shots(whole + b"\xff" * 100).number == 0
    assert all_shots(whole + whole[:50]).number == 0
    assert all_shots(b"") is None


def contents(folder):
    """Hash of each file that a repetition must leave the same."""
    names = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != "timings.json")
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in names}


@needs_viser
@needs_signals
@pytest.mark.parametrize("kill", ["SIGSTOP", "SIGKILL"])
def test_a_run_ends_the_same_when_its_viewer_hangs_or_dies(kill, sequence, finished, tmp_path):
    with viewing(tmp_path / "run", port=0) as on_frame:
        process = on_frame._process

        def spoilt(frame):
            on_frame(frame)
            if frame.index == 1:
                process.send_signal(getattr(signal, kill))
            on_frame._last = 0.0  # each frame is handed on

        run(sequence, tmp_path / "run", resolve(assignments=SETTINGS), on_frame=spoilt)
    assert process.poll() is not None
    assert contents(tmp_path / "run") == contents(finished)


def page_of(lines):
    host, _, port = lines[-1].split("//")[1].split("/")[0].strip().partition(":")
    connection = http.client.HTTPConnection("127.0.0.1" if host != "127.0.0.1" else host, int(port), timeout=PATIENCE)
    connection.request("GET", "/")
    answer = connection.getresponse()
    found = answer.status, answer.read()
    connection.close()
    return found


@needs_viser
@needs_signals
@pytest.mark.parametrize("ending", ["SIGINT", "SIGTERM"])
def test_an_interrupt_ends_the_viewer_cleanly(finished, ending):
    with served(finished, "--port", 0) as (process, lines):
        assert page_of(lines)[0] == 200
        os.killpg(process.pid, getattr(signal, ending))
        out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out, err) == (0, "", "")
    assert len(lines) == 1
    with pytest.raises(ProcessLookupError):
        os.killpg(process.pid, 0)


@needs_viser
@needs_signals
def test_the_next_free_port_serves_where_one_is_busy(finished):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        busy = taken.getsockname()[1]
        with served(finished, "--port", busy) as (process, lines):
            process.terminate()
            process.communicate(timeout=PATIENCE)
    port = int(lines[-1].rsplit(":", 1)[1])
    assert lines[0] == f"port {busy} is in use: {port} serves\n"
    assert port > busy


@needs_viser
@needs_signals
def test_other_machines_need_the_token(finished):
    with served(finished, "--port", 0, "--host", "0.0.0.0") as (process, lines):
        assert lines[0].startswith("warning: other machines can reach 0.0.0.0")
        assert "/?token=" in lines[-1]
        status, body = page_of(lines)
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=PATIENCE)
    assert status == 403
    assert b"<html" not in body
    assert process.returncode == 0


@needs_viser
@needs_signals
def test_an_interrupt_ends_a_run_and_its_viewer(tmp_path):
    """With ctrl-C, the terminal tells both; nobody is left, and nothing is traced back."""
    script = tmp_path / "script.py"
    script.write_text(
        "import sys, time\n"
        "from tspslam.run.viewing import viewing\n"
        "with viewing(sys.argv[1], port=0) as on_frame:\n"
        "    print(on_frame._process.pid, flush=True)\n"
        "    try:\n"
        "        time.sleep(100)\n"
        "    except KeyboardInterrupt:\n"
        "        pass\n"
    )
    command = [sys.executable, str(script), str(tmp_path / "run")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as process:
        viewer = int(process.stdout.readline())
        assert process.stderr.readline().startswith("viewer: http://127.0.0.1:")
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out, err) == (0, "", "")
    with pytest.raises(ProcessLookupError):
        os.kill(viewer, 0)


@needs_viser
@needs_signals
def test_a_viewer_ends_with_the_process_of_its_run(tmp_path):
    code = "import os, sys\nfrom tspslam.run.viewing import viewing\nsession = viewing(sys.argv[1], port=0)\n"
    code += "print(session.__enter__()._process.pid, flush=True)\nsys.stdin.read()\nos._exit(9)\n"
    command = [sys.executable, "-c", code, str(tmp_path / "run")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        process.stdout.readline()
        assert process.stderr.readline().startswith("viewer: ")
        process.stdin.close()
        assert process.wait(PATIENCE) == 9
        assert process.stderr.read() == ""  # its other end is closed: the viewer has ended too


@needs_viser
@needs_signals
@pytest.mark.parametrize("has_terminal", [True, False])
def test_only_on_a_terminal_a_finished_run_stays_until_an_interrupt(has_terminal, tmp_path):
    """A person who is there can press ctrl-C; a script would wait for ever."""
    code = "import sys\nfrom tspslam.run.viewing import viewing\nwith viewing(sys.argv[1], port=0) as on_frame:\n"
    code += "    sys.stdin.read(1)\n    print('over', flush=True)\n    on_frame.stay()\nprint('end', flush=True)\n"
    command = [sys.executable, "-c", code, str(tmp_path / "run")]
    ours, theirs = os.openpty() if has_terminal else (None, subprocess.PIPE)
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdin=theirs, stdout=pipe, stderr=theirs if has_terminal else pipe, text=True, start_new_session=True
    ) as process:
        if not has_terminal:
            process.stderr.readline()
            process.stdin.write("x")
            process.stdin.flush()
            assert process.stdout.read() == "over\nend\n"
            return
        os.close(theirs)
        seen = b""
        while b"viewer: " not in seen:  # a terminal gives what is written in pieces
            seen += os.read(ours, 1000)
        os.write(ours, b"x\n")
        assert process.stdout.readline() == "over\n"
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(1)
        os.killpg(process.pid, signal.SIGINT)
        assert process.stdout.read() == "end\n"
        assert process.wait(PATIENCE) == 0
        os.close(ours)


@needs_viser
def test_without_a_terminal_nobody_is_waited_for(monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "stdin", None)  # as where it is closed
    with viewing(tmp_path / "run", port=0) as on_frame:
        on_frame.stay()
