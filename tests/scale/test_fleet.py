"""How far a batch is: all runs on one line, each recording that is through on its own, objects for programs."""

import itertools
import json

import pytest

from tspslam import cli
from tspslam.cli import _fleet
from tspslam.cli._fleet import Fleet, FleetTeller, line_of_row
from tspslam.cli._workers import _bytes
from tspslam.cli.scale import _code_of
from tspslam.scale.batch import Event
from tspslam.scale.summary import Row


def step(name, stage="tracking", done=0, total=40):
    values = {"name": name, "stage": stage, "done": done, "total": total, "keyframes": 0, "lost": 0, "loops": 0}
    return Event("step", values=values)


def told(*events, done=1, refused=0):
    fleet = Fleet()
    for event in (Event("begin", values={"total": 5, "done": done, "refused": refused}), *events):
        fleet.take(event)
    return fleet


def test_the_line_has_the_runs_that_there_is_room_for():
    fleet = told(step("b", done=12), step("a", "map", 0, 1), Event("row", row=Row("c", "/c", "poisoned")))
    line = fleet.line(100)
    assert line.startswith("[######..........] 2/5 done, 1 failed  0:0")
    assert line.endswith("  a map  b 12/40")
    assert fleet.line(50).endswith("  a map")
    assert all(len(fleet.line(width)) <= width for width in range(1, 120))


def test_a_recording_that_is_through_does_not_run_and_counts_once():
    fleet = told(step("a"), Event("row", row=Row("a", "/a", "complete")), done=2, refused=1)
    assert fleet.describe() == {"done": 2, "total": 5, "failed": 0, "running": []}
    fleet.take(Event("row", row=Row("r", "/r", "refused")))
    assert (fleet.done, fleet.failed) == (3, 1)


@pytest.mark.parametrize(("row", "said"), [
    (Row("a", "/a", "complete", frames=9, tracked=8, seconds=3.21), "[1/2] a: complete: 8 of 9 frames in 3.2 s"),
    (Row("a", "/a", "degraded", frames=9, tracked=8, attempts=2), "[1/2] a: degraded: 8 of 9 frames, begun 2 times"),
    (Row("a", "/a", "refused", error="holds none"), "[1/2] a: refused: holds none"),
])  # fmt: skip
def test_a_row_is_a_line(row, said):
    assert line_of_row(row, 1, 2) == said


@pytest.mark.parametrize("as_json", [False, True])
def test_a_log_gets_a_line_a_recording_and_a_program_objects(capsys, monkeypatch, as_json):
    monkeypatch.setattr(_fleet, "JSON", 0.01)
    monkeypatch.setattr(_fleet, "LOG", 0.01)
    with _fleet.fleet_progress(as_json) as teller:
        for event in (
            Event("begin", "2 recordings", {"total": 2, "done": 0, "refused": 0}),
            step("a", done=3),
            Event("row", row=Row("b", "/b", "refused", error="why")),
        ):
            teller(event)
        seen = ""
        while seen.count("running" if as_json else "3/40") < 2:
            seen += capsys.readouterr().err
    lines = seen.splitlines()
    if as_json:
        objects = [json.loads(line) for line in lines]
        assert {"note": "2 recordings"} in objects
        assert any(each.get("recording") == "b" and each["state"] == "refused" for each in objects)
        assert objects[-1]["running"][0]["done"] == 3
    else:
        assert lines[0] == "2 recordings"
        assert "[1/2] b: refused: why" in lines


def test_a_teller_that_was_told_nothing_says_nothing(capsys):
    with FleetTeller(as_json=False):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("text", "size"), [("4GB", 4 * 10**9), ("1.5 gib", 3 << 29), ("1000MB", 10**9), (None, None)])
def test_sizes_are_read_as_people_write_them(text, size):
    assert _bytes(text) == size


@pytest.mark.parametrize("text", ["4", "4 apples", "GB", "-4GB", "0.1GB", "nan", "1e9GB", "٤GB"])
def test_a_size_that_is_none_or_too_small_is_usage(capsys, text):
    assert cli.exit_code(["batch", "x", "--out", "y", f"--memory={text}"]) == cli.USAGE
    assert "expected a size of" in capsys.readouterr().err


def test_a_scheduler_goes_with_no_workers(capsys):
    words = ["batch", "x", "--out", "y", "--scheduler", "tcp://127.0.0.1:8786", "--workers", "2"]
    assert cli.exit_code(words) == cli.USAGE
    assert "a scheduler has workers of its own" in capsys.readouterr().err


@pytest.mark.parametrize(("states", "code"), [
    (["complete"], cli.COMPLETE), (["degraded"], cli.DEGRADED), (["complete", "failed"], cli.DEGRADED),
    (["refused"], cli.BAD_INPUT), (["refused", "complete"], cli.DEGRADED), (["poisoned"], cli.DEGRADED),
    (["failed"], cli.INTERNAL), (["not written", "complete"], cli.NOT_WRITTEN), (["unfinished"], cli.DEGRADED),
])  # fmt: skip
def test_the_exit_code_says_what_needs_a_hand(states, code):
    for order in itertools.permutations(states):
        assert _code_of([Row(str(k), "/", state) for k, state in enumerate(order)]) == code
