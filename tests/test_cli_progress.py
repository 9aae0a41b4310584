"""How far a run is, is told to eyes on one line, to programs as JSON, and to a file hardly at all; then comes a table."""

import contextlib
import json
import os
import re
import shlex
import subprocess
import sys
import threading
from collections import Counter

import pytest

from tests.test_cli import INTERRUPTED, type_in
from tests.test_printing import Terminal, shown_on_a_terminal
from tspslam import cli
from tspslam.cli import _progress
from tspslam.cli._progress import Pace, Teller, describe, line_of
from tspslam.datasets import open_sequence
from tspslam.errors import InputError
from tspslam.run.config import resolve
from tspslam.run.pipeline import Step, run

needs_terminal = pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are a matter of POSIX")
STAGES = ["tracking", "adjustment", "map", "pictures", "report"]
KEYS = {"stage", "done", "total", "frames_per_s", "left_s", "keyframes", "lost", "loops"}


def paced(*told):
    """A `Pace` that was told steps at times, s."""
    times = iter([0.0, *(at for at, _ in told)])
    last = told[-1][0]
    pace = Pace(lambda: next(times, last))
    for _, step in told:
        pace.note(step)
    return pace


def tracking(done, total=100, **counts):
    return Step("tracking", done, total, **counts)


def test_the_pace_is_that_of_the_last_frames_and_does_not_count_the_wait_for_the_first():
    pace = paced((40.0, tracking(0)), (80.0, tracking(1)), (81.0, tracking(2)), (82.0, tracking(5)))
    assert pace.rate == pytest.approx(2.0)
    assert pace.left == pytest.approx(95 / 2)
    slow = [(float(k), tracking(k, 1000)) for k in range(200)]
    fast = [(200 + (k - 200) / 10, tracking(k, 1000)) for k in range(200, 300)]
    assert paced(*slow, *fast).rate == pytest.approx(10.0)


@pytest.mark.parametrize("told", [
    [(0.0, tracking(0))],
    [(0.0, tracking(0)), (1.0, tracking(1))],
    [(1.0, tracking(0)), (1.0, tracking(1)), (1.0, tracking(2))],  # a coarse clock
    [(1.0, tracking(100)), (2.0, Step("map"))],
])  # fmt: skip
def test_what_is_not_known_is_null_and_no_number_is_made_of_it(told):
    said = describe(paced(*told))
    assert said["frames_per_s"] is said["left_s"] is None
    json.dumps(said, allow_nan=False)


@pytest.mark.parametrize("width", [1, 20, 59, 60, 79, 119, 300])
@pytest.mark.parametrize("total", [1, 100, 1_000_000])
def test_the_line_is_never_wider_than_its_place(width, total):
    counts = {"keyframes": total, "lost": total // 3, "loops": 2}
    for told in (
        [(0.0, tracking(0, total))],
        [(0.0, tracking(0, total)), (1.0, tracking(1, total)), (4000.0, tracking(total, total, **counts))],
        [(0.0, tracking(total, total)), (1.0, Step("adjustment", **counts)), (9000.0, Step("adjustment", **counts))],
    ):
        assert 0 < len(line_of(paced(*told), width)) <= width


def test_the_line_has_all_that_is_asked_for_also_in_60_columns():
    counts = {"keyframes": 35, "lost": 2, "loops": 1}
    pace = paced((0.0, tracking(0, 1000)), (1.0, tracking(1, 1000)), (20.0, tracking(412, 1000, **counts)))
    assert line_of(pace, 200) == (
        "tracking  [########............]  412/1000  21.6 frames/s  0:27 left  35 keyframes  2 lost  1 loop"
    )
    assert line_of(pace, 59) == "tracking 412/1000 21.6/s 0:27 left 35 kf 2 lost 1 loop"
    later = paced((0.0, tracking(1)), (1.0, Step("map", **counts)), (13.0, Step("map", **counts)))
    assert line_of(later, 59) == "map  0:12  35 keyframes  2 lost  1 loop"


def test_long_stages_are_told_again_and_again_until_the_end():
    told, thrice = [], threading.Event()

    def tell(pace, event):
        told.append((pace.step.stage, event))
        if Counter(told)["map", "tick"] == 3:
            thrice.set()

    with Teller(tell, 0.001) as teller:
        teller(tracking(1, 1))
        teller(Step("map"))
        assert thrice.wait(60)
    assert [each for each in told if each[1] != "tick"] == [
        ("tracking", "begin"), ("tracking", "end"), ("map", "begin"), ("map", "end"), ("map", "done"),
    ]  # fmt: skip
    assert told[-2:] == [("map", "end"), ("map", "done")]


def test_a_run_that_fails_ends_its_line_and_says_no_more_of_it():
    told = []
    with contextlib.suppress(KeyError), Teller(lambda pace, event: told.append(event), 60) as teller:
        teller(tracking(3))
        raise KeyError
    assert told == ["begin", "stopped"]


def test_each_stage_of_a_run_is_told_where_it_begins_and_each_pair_when_it_is_done(sequence, tmp_path):
    told = []
    result = run(open_sequence(sequence), tmp_path / "out", resolve(), on_step=told.append)
    assert list(dict.fromkeys(step.stage for step in told)) == STAGES
    assert [(step.done, step.total) for step in told] == [(0, 3), (1, 3), (2, 3), (3, 3), *4 * [(0, 1)]]
    assert told[-1] == Step("report", 0, 1, result.run["keyframes"], 0, result.run["loops"])
    assert list(result.times["stages_s"]) == STAGES
    told.clear()
    again = run(open_sequence(sequence), tmp_path / "out", resolve(), on_step=told.append)
    assert told[0] == Step("tracking", 3, 3, result.run["keyframes"], 0, 0)
    assert again.times["frames_per_s"] is None
    assert again.run == result.run


def test_what_cannot_be_called_with_a_step_is_refused(sequence, tmp_path):
    with pytest.raises(InputError, match="on_step is bool, expected a callable, such as print"):
        run(open_sequence(sequence), tmp_path / "out", resolve(), on_step=True)
    assert not (tmp_path / "out").exists()


def test_for_programs_stdout_is_one_document_and_each_line_of_stderr_an_object(capsys, sequence):
    (sequence / "right/001.png").write_bytes(b"")
    code, out, err = type_in(capsys, "run", sequence, "--out", sequence / "out", "--json")
    assert (code, json.loads(out)["status"]) == (4, "degraded")
    lines = [json.loads(line) for line in err.splitlines()]
    steps = [line for line in lines if "stage" in line]
    assert all(line.keys() == KEYS for line in steps)
    assert list(dict.fromkeys(line["stage"] for line in steps)) == STAGES
    last = {line["stage"]: (line["done"], line["total"]) for line in steps}
    assert last == {"tracking": (3, 3)} | dict.fromkeys(STAGES[1:], (1, 1))
    assert next(line for line in lines if "warning" in line)["warning"].startswith("frame 1: ")
    assert any(line["note"].startswith("stamps are numbers of frames") for line in lines if "note" in line)
    assert all(line.keys() <= KEYS or len(line) == 1 for line in lines)


def test_into_a_file_nothing_is_said_but_now_and_then_a_sign_of_life(capsys, sequence, monkeypatch):
    said, real = threading.Event(), _progress.write_sign

    def seen(pace, event):
        real(pace, event)
        if event == "tick":
            said.set()

    def hold(step):
        if step.stage == "report":
            assert said.wait(60)

    monkeypatch.setattr(_progress, "LOG", 0.001)
    monkeypatch.setattr(_progress, "write_sign", seen)
    with _progress.progress(as_json=False) as tell:
        run(open_sequence(sequence), sequence / "other", resolve(), on_step=lambda step: (tell(step), hold(step)))
    lines = capsys.readouterr().err.splitlines()
    assert lines
    assert all(line.startswith(tuple(STAGES)) and len(line) <= 80 for line in lines)


def typed_on_a_terminal(*words, columns=100, script=None):
    """Exit code and all that a terminal of a size got, where a command was typed."""
    import fcntl
    import pty
    import struct
    import termios

    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    start = ["-c", script] if script else ["-m", "tspslam"]
    env = {name: value for name, value in os.environ.items() if name != "COLUMNS"} | {"TERM": "xterm"}
    command = [sys.executable, *start, *map(str, words)]
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.DEVNULL, stderr=theirs, env=env) as process:
        os.close(theirs)
        said = b""
        with contextlib.suppress(OSError):  # Linux's way to say that the other end is closed
            while piece := os.read(ours, 65536):
                said += piece
    os.close(ours)
    return process.returncode, said.decode()


@needs_terminal
def test_on_a_terminal_one_line_is_renewed_and_never_wraps(sequence):
    code, said = typed_on_a_terminal("run", sequence, "--out", sequence / "out", columns=40)
    assert code == 0
    assert "\x1b" not in said
    renewed = [part for line in said.replace("\r\n", "\n").split("\n") for part in line.split("\r")[1:]]
    assert len(renewed) > 5
    assert max(map(len, renewed)) < 40
    assert all(any(part.startswith(stage) for part in renewed) for stage in STAGES)
    shown = [
        line for line in shown_on_a_terminal(said) if not line.startswith(("warning", "compiling", "note: stamps"))
    ]
    assert [bool(re.match("done in ", line)) for line in shown] == [True, False]
    assert (said[-1], shown[-1]) == ("\n", "")


def test_a_terminal_that_cannot_go_back_is_spared(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())
    for term, is_spared in (("xterm", False), ("dumb", True)):
        monkeypatch.setenv("TERM", term)
        with _progress.progress(as_json=False) as tell:
            tell(tracking(3))
        assert (sys.stderr.getvalue() == "") == is_spared
        sys.stderr.seek(0)
        sys.stderr.truncate()


@needs_terminal
def test_an_interrupt_leaves_the_terminal_as_it_was(sequence):
    code, said = typed_on_a_terminal("run", sequence, "--out", sequence / "out", script=INTERRUPTED)
    assert code == 130
    assert "\x1b" not in said
    shown = [line for line in shown_on_a_terminal(said) if not line.startswith("compiling")]
    assert shown[0].startswith("tracking  [")
    assert shown[1:] == ["tspslam: interrupted; the same command goes on where this one stopped", ""]


def test_the_table_is_plain_narrow_and_names_commands_that_run(capsys, sequence, monkeypatch):
    monkeypatch.chdir(sequence.parent)
    (sequence / "right/001.png").write_bytes(b"")
    code, out, err = type_in(capsys, "run", "drive", "--out", "a run")
    assert not [line for line in err.splitlines() if not line.startswith(("warning: ", "compiling ", "note: stamps"))]
    lines = out.splitlines()
    assert (code, lines[0]) == (4, "degraded: 3 frames of drive")
    assert max(map(len, lines)) <= 80
    rows = {line.split()[0]: line[13:] for line in lines[1 : lines.index("")]}
    assert rows["frames"] == "2 tracked, 0 lost, 1 skipped"
    assert re.fullmatch(r"1, loops closed: 0", rows["keyframes"])
    assert re.fullmatch(r"\d+", rows["landmarks"])
    assert re.fullmatch(r"\d+ vertices, \d+ edges, \d+ faces", rows["complex"])
    assert re.fullmatch(r"at \d+ vertices", rows["response"])
    assert re.fullmatch(r"[\d.]+ s(, [\d.e+]+ frames/s)?", rows["time"])
    spent = re.fullmatch(r"\w+ ([\d.]+) s, \w+ ([\d.]+) s, \w+ ([\d.]+) s, others [\d.]+ s", rows["spent"])
    assert sorted(map(float, spent.groups()), reverse=True) == [*map(float, spent.groups())]
    files = [line.split(":", 1)[1].strip() for line in lines if line.startswith(("pictures:", "report:", "map:"))]
    assert len(files) == 3
    assert all(os.path.exists(each) for each in files)
    commands = [shlex.split(line.partition("tspslam ")[2]) for line in lines if "tspslam " in line]
    assert [words[:2] for words in commands] == [[name, "a run"] for name in ("view", "eval", "report", "export")]
    assert [cli.exit_code(words) for words in commands[2:]] == [0, 0]
    capsys.readouterr()
    again = type_in(capsys, "run", "drive", "--out", "a run")[1].splitlines()
    time, spent = [line for line in again if line not in lines]
    assert re.fullmatch(r"  time       [\d.]+ s, none of the frames anew", time)
    assert spent.startswith("  spent on   ")
