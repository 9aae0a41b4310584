"""Steps of a join: killed in any of them, in any process, the same call goes on and ends with the same bytes."""

import contextlib
import os
import pickle
import signal
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from tspslam import OutputError, load_run
from tspslam.scale.cluster import Workers
from tspslam.scale.job import Outcome
from tspslam.scale.maps import assembling, joining, steps
from tspslam.scale.maps.joining import join_runs
from tspslam.scale.maps.runs import find_runs
from tspslam.vision.slam.back_end.map_joining import join_maps
from tspslam.vision.slam.odometry import StereoOdometry

from .walks import content, kill_at_pictures, spied

KINDS = "state", "candidates", "shared", "frames", "map", "adjustment"
NAMES = "start", "middle"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("kind", KINDS)
def test_killed_in_a_step_the_same_call_does_what_is_left(runs, both, tmp_path, monkeypatch, kind):
    folders, out = [runs[0] / name for name in NAMES], tmp_path / "map"
    child = os.fork()
    if not child:
        monkeypatch.setitem(steps._MAKERS, kind, lambda *_: os.kill(os.getpid(), signal.SIGKILL))
        join_runs(folders, out)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    left = {path.name.split("-")[0] for path in (tmp_path / "map-steps").glob("*-*.*")}
    done: list[str] = []
    spied(monkeypatch, done)
    join_runs(folders, out)
    assert kind in done
    assert not (set(done) - {kind}) & left
    assert content(out) == content(both)
    assert [path.name for path in tmp_path.iterdir()] == ["map"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_while_the_run_is_written_no_step_is_done_again(runs, both, tmp_path, monkeypatch):
    folders, out = [runs[0] / name for name in NAMES], tmp_path / "map"
    kill_at_pictures(folders, out)
    done: list[str] = []
    spied(monkeypatch, done)
    join_runs(folders, out)
    assert done == []
    assert content(out) == content(both)
    assert [path.name for path in tmp_path.iterdir()] == ["map"]


def test_in_any_order_and_with_any_split_the_bytes_are_the_same(runs, both, tmp_path, monkeypatch):
    monkeypatch.setattr(joining, "_here", lambda given: ((step, steps.run_step(step)) for step in reversed(given)))
    for name in ("KEYFRAMES", "FRAMES"):
        monkeypatch.setattr(steps, name, 2)
    monkeypatch.setattr(joining, "FRAMES", 2)
    join_runs([runs[0] / name for name in NAMES], tmp_path / "map")
    assert content(tmp_path / "map") == content(both)


def test_places_that_do_not_agree_with_others_are_named_in_the_run_and_on_its_page(runs, tmp_path, monkeypatch):
    def join(*given):
        found = join_maps(*given)
        return replace(found, refused=found.shared)

    monkeypatch.setattr(assembling, "join_maps", join)
    folders = [runs[0] / name for name in NAMES]
    result = join_runs(folders, tmp_path / "map")
    (said,) = [one["message"] for one in result.run.run["warnings"] if one["code"] == "join_refused"]
    assert said.startswith("middle: ")
    assert "places of start that are not where other places have them" in said
    assert result.run.run["status"] == "complete"
    assert said in (tmp_path / "map" / "report.html").read_text("utf-8")
    before = content(tmp_path / "map")
    join_runs(folders, tmp_path / "map")  # the steps that said so are gone
    assert content(tmp_path / "map") == before
    join_runs([tmp_path / "map", runs[0] / "end"], tmp_path / "more")
    assert said in [one["message"] for one in load_run(tmp_path / "more").record["warnings"]]


def test_a_run_that_is_added_leaves_what_was_made_of_the_others(runs, tmp_path, monkeypatch):
    """What two runs share, and frames that keep their numbers, are made once, though the join is another one."""
    folders, done = [runs[0] / name for name in (*NAMES, "end")], list[tuple[str, tuple[int, ...]]]()
    with monkeypatch.context() as patch:
        patch.setitem(steps._MAKERS, "map", _no_room)
        with pytest.raises(OutputError, match="no room"):
            join_runs(folders[:2], tmp_path / "map")
    for kind in ("state", "shared", "frames"):
        make = steps._MAKERS[kind]

        def noted(plan, target, *which, kind=kind, make=make):
            done.append((kind, which))
            make(plan, target, *which)

        monkeypatch.setitem(steps._MAKERS, kind, noted)
    join_runs(folders, tmp_path / "map")
    assert [which for kind, which in done if kind == "state"] == [(2,)]
    assert {which[:2] for kind, which in done if kind == "shared"} == {(0, 2), (1, 2)}
    assert {which[0] for kind, which in done if kind == "frames"} == {2}
    assert load_run(tmp_path / "map").record["status"] == "complete"
    done.clear()
    join_runs(folders, tmp_path / "at once")
    assert {which[:2] for kind, which in done if kind == "shared"} == {(0, 1), (0, 2), (1, 2)}
    assert content(tmp_path / "map") == content(tmp_path / "at once")


def _no_room(plan, target, *which):
    raise OutputError("no room")


def test_steps_are_named_by_what_they_depend_on_and_by_nothing_else(runs, tmp_path):
    start, middle, end = (find_runs([runs[0] / name])[0][0] for name in (*NAMES, "end"))
    plan, more = (steps.Plan(given, str(tmp_path)) for given in ((start, middle), (start, middle, end)))
    mended, later = (steps.Plan(given, str(tmp_path)) for given in ((end, middle), (start, end, middle)))
    places = np.array([[1, 2], [3, 4]])
    for each in (plan, more, mended):
        vars(each)["candidates"] = {(0, 1): [places, places + 1]}
    vars(later)["candidates"] = {(0, 2): [places + 1]}
    assert plan.file("shared", 0, 1, 0) == more.file("shared", 0, 1, 0) != mended.file("shared", 0, 1, 0)
    assert plan.file("shared", 0, 1, 1) == later.file("shared", 0, 2, 0) != plan.file("shared", 0, 1, 0)
    assert plan.file("frames", 1, 0) == more.file("frames", 1, 0) != more.file("frames", 1, 1)
    assert plan.file("frames", 1, 0) != later.file("frames", 2, 0)  # it has other numbers there
    assert plan.frame(start.pairs) == more.frame(start.pairs) != mended.frame(end.pairs)
    for kind in ("candidates", "map", "adjustment"):
        assert len({each.file(kind) for each in (plan, more, mended, later)}) == 4
    assert "candidates" not in vars(pickle.loads(pickle.dumps(plan)))


@pytest.mark.parametrize("count", [0, 1, 49, 50, 51, 400, 401, 100_000])
def test_tasks_are_cut_into_few_parts_of_all(count):
    parts = [list(range(count))[part] for part in steps.cut(count, 50)]
    assert [k for part in parts for k in part] == list(range(count))
    assert len(parts) <= steps.PARTS
    assert all(parts)
    assert all(len(part) >= 50 for part in parts[:-1])


@pytest.mark.parametrize(
    ("outcome", "error", "said"),
    [
        (Outcome("not written", "no room"), OutputError, "no room"),
        (Outcome("failed", "internal error"), joining.TspSlamError, "internal error"),
        (Outcome("poisoned", "its worker died"), joining.InputError, "its worker died"),
    ],
)
def test_what_a_step_cannot_do_is_said(runs, tmp_path, monkeypatch, outcome, error, said):
    monkeypatch.setattr(joining, "_here", lambda given: ((step, outcome) for step in given))
    with pytest.raises(error, match=said):
        join_runs([runs[0] / name for name in NAMES], tmp_path / "map")
    assert not (tmp_path / "map").exists()


class TestWorkers:
    """On processes of Dask."""

    @pytest.fixture(autouse=True)
    def _with_dask(self):
        pytest.importorskip("distributed", reason="Dask is in the extra scale")

    def test_workers_give_the_same_bytes(self, runs, both, tmp_path):
        said: list[str] = []
        join_runs([runs[0] / name for name in NAMES], tmp_path / "map", workers=Workers(2), on_note=said.append)
        assert content(tmp_path / "map") == content(both)
        assert said[0].startswith("2 workers")

    def test_a_killed_worker_takes_no_step_with_it(self, runs, both, tmp_path):
        psutil, killed = pytest.importorskip("psutil"), []

        def kill():
            """Kill each worker that has begun a step, once; a process that ends while it is looked at is none."""
            while not killed and not (tmp_path / "map").exists():
                for process in psutil.Process().children(recursive=True):
                    begun = list(tmp_path.glob("map-steps/ticket-*/candidates*"))
                    with contextlib.suppress(psutil.Error):
                        if begun and "spawn_main" in " ".join(process.cmdline()) and not process.children():
                            process.kill()
                            killed.append(process.pid)
                time.sleep(0.01)

        watch = threading.Thread(target=kill)
        try:
            said: list[str] = []
            watch.start()
            join_runs([runs[0] / name for name in NAMES], tmp_path / "map", workers=Workers(2), on_note=said.append)
        finally:
            (tmp_path / "map").mkdir(exist_ok=True)
            watch.join()
        assert killed
        assert content(tmp_path / "map") == content(both)


def test_a_joined_map_is_adjusted_by_its_step_alone(runs, both, tmp_path, monkeypatch):
    """Once a run at the end of its own path, once all together; what writes the joined run only judges the offset."""
    adjusted, adjust = [], StereoOdometry.adjust
    monkeypatch.setattr(StereoOdometry, "adjust", lambda odometry: [adjusted.append(odometry), adjust(odometry)])
    join_runs([runs[0] / "start", runs[0] / "middle"], tmp_path / "map")
    assert len(adjusted) == 3
    assert content(tmp_path / "map") == content(both)
