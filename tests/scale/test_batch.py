"""A batch on two real workers: the bytes of single runs, rows for all, and what one that fails does to the others."""

import json
import os

import pytest

from tspslam import cli
from tspslam.errors import InputError
from tspslam.io.lock import FolderLock
from tspslam.run.pipeline import run_path
from tspslam.scale.batch import run_batch
from tspslam.scale.cluster import Workers

from .recordings import content, write_truth, write_walk

pytest.importorskip("distributed", reason="Dask is in the extra scale")


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Two walks, a folder that is no recording, a list of them, and true poses of one walk."""
    folder = tmp_path_factory.mktemp("batch")
    for name, length in (("short", 2.0), ("long", 4.0)):
        truth = write_walk(folder / "walks" / name, length)
    (folder / "truths").mkdir()
    write_truth(folder / "truths" / "long.txt", truth)
    (folder / "broken").mkdir()
    (folder / "list.txt").write_text("broken\nwalks/short\nwalks/long\n")
    return folder


@pytest.fixture(scope="module")
def batch(place):
    """The result, and the events on the way."""
    events = []
    result = run_batch(
        [place / "list.txt"], place / "runs", workers=Workers(2, threads=2), truths=place / "truths",
        on_event=events.append,
    )  # fmt: skip
    return result, events


def test_run_folders_have_the_bytes_of_single_runs(place, batch, monkeypatch):
    monkeypatch.setattr("tspslam.view._style.DPI", 140)  # as workers have it, which no test has touched
    for name in ("short", "long"):
        run_path(place / "walks" / name, place / "alone" / name)
        assert content(place / "runs" / name) == content(place / "alone" / name)


def test_each_recording_has_a_row_and_one_that_is_broken_stops_no_other(place, batch):
    rows = {row.name: row for row in batch[0].rows}
    assert list(rows) == ["broken", "short", "long"]
    assert {name: row.state for name, row in rows.items()} == {
        "broken": "refused", "short": "complete", "long": "complete",
    }  # fmt: skip
    assert "has none of the known layouts" in rows["broken"].error
    assert (rows["long"].frames, rows["long"].tracked, rows["long"].attempts, rows["long"].how) == (9, 9, 1, "new")
    assert rows["long"].evaluation["ate_rmse_m"] < 0.2
    assert rows["short"].evaluation is None
    assert (place / "runs" / rows["long"].picture).is_file()
    told = json.loads((place / "runs" / "batch.json").read_text())
    assert told == batch[0].described
    assert told["states"] == {"complete": 2, "refused": 1}
    assert (place / "runs" / "batch.html").read_text(encoding="utf-8").count("<tr><td>") == 3


def test_nothing_is_left_but_runs_and_the_summary(place, batch):
    assert sorted(os.listdir(place / "runs")) == ["batch.html", "batch.json", "long", "short"]


def test_what_happens_is_told_as_it_goes(batch):
    kinds = [event.kind for event in batch[1]]
    assert kinds[:3] == ["begin", "row", "note"]
    assert batch[1][2].text.startswith("2 workers of 1 thread, each ended beyond ")
    assert {event.values["name"] for event in batch[1] if event.kind == "step"} == {"short", "long"}
    assert next(event.row.name for event in batch[1] if event.row is not None) == "broken"


def test_the_same_command_finds_all_of_it_there(capsys, place, batch, monkeypatch):
    """And begins no worker."""
    monkeypatch.setattr("tspslam.scale.batch.connected", None)
    before = content(place / "runs" / "long")
    words = ["batch", str(place / "list.txt"), "--out", str(place / "runs"), "--eval", str(place / "truths")]
    assert cli.exit_code(words) == cli.DEGRADED
    out, err = capsys.readouterr()
    assert out.startswith("3 recordings: 2 complete, 1 refused\n")
    assert "9 of 9" in out
    assert "2 finished already" in err
    assert content(place / "runs" / "long") == before


def test_true_poses_that_cannot_be_compared_degrade_the_batch_and_those_that_are_missing_are_said(
    capsys, place, batch, monkeypatch, tmp_path
):
    monkeypatch.setattr("tspslam.scale.batch.connected", None)
    (tmp_path / "list.txt").write_text("long gone.txt\n")
    words = ["batch", str(place / "walks"), "--out", str(place / "runs"), "--eval", str(tmp_path / "list.txt")]
    assert cli.exit_code(words) == cli.DEGRADED
    out, err = capsys.readouterr()
    assert out.startswith("2 recordings: 2 complete\n")
    assert "warning: long: the path is not compared with the true one" in err
    assert "no true poses are given of short" in err


def test_a_finished_run_that_was_changed_is_not_taken_for_finished(place, batch, monkeypatch):
    class Begun(Exception):  # noqa: N818 - the batch would go on from here
        pass

    def begin(_, count, paths):
        raise Begun(count)

    monkeypatch.setattr("tspslam.scale.batch.connected", begin)
    moved = place / "runs" / "long" / "map.ply"
    moved.rename(place / "map.ply")
    with pytest.raises(Begun, match="1"):
        run_batch([place / "walks"], place / "runs")
    (place / "map.ply").rename(moved)
    with pytest.raises(Begun, match="2"):
        run_batch([place / "walks"], place / "elsewhere")
    assert not (place / "elsewhere").exists()
    run_batch([place / "walks"], place / "runs")  # all is there again
    held = [(place / "walks" / "long" / side / "008.png") for side in ("left", "right")]
    for image in held:
        image.rename(image.with_suffix(".held"))
    with pytest.raises(Begun, match="1"):  # its recording has other frames than it
        run_batch([place / "walks"], place / "runs")
    for image in held:
        image.with_suffix(".held").rename(image)


def test_two_batches_in_one_folder_are_one_line(capsys, place, batch):
    lock = FolderLock(place / "runs")
    try:
        assert cli.exit_code(["batch", str(place / "walks"), "--out", str(place / "runs")]) == cli.BAD_INPUT
    finally:
        lock.release()
    assert f"is in use by process {os.getpid()}" in capsys.readouterr().err


@pytest.mark.parametrize("out", ["walks/long", "walks", "runs/long", "walks/long/left"])
def test_a_folder_that_is_an_input_or_a_run_is_refused(place, batch, out):
    with pytest.raises(InputError, match=r"is the input|holds the input|is a run folder|lies in the"):
        run_batch([place / "walks"], place / out)
    assert not (place / out / "batch.json").exists()


def test_bad_input_alone_is_bad_input(capsys, place, tmp_path):
    assert cli.exit_code(["batch", str(place / "broken"), "--out", str(tmp_path / "runs"), "--json"]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert json.loads(out)["states"] == {"refused": 1}
    assert json.loads(out)["names"] == {}  # its name is free again
    assert [json.loads(line).get("state") for line in err.splitlines()] == [None, "refused"]


def test_a_worker_that_dies_takes_one_recording_with_it_twice_at_most(place, batch):
    """One worker. It is killed once in the longer walk, which is done then, and twice in the shorter, which is given up."""
    import psutil

    left, order = {"long": 1, "short": 2}, []

    def kill(event):
        name = (event.values or {}).get("name") if event.kind == "step" else None
        if name is not None and name not in order:
            order.append(name)
        if left.get(name, 0):
            left[name] -= 1
            workers = [p for p in psutil.Process().children() if "spawn_main" in " ".join(p.cmdline())]
            for process in workers:
                process.kill()

    result = run_batch([place / "walks"], place / "killed", workers=Workers(1, threads=2), on_event=kill)
    rows = {row.name: row for row in result.rows}
    assert order == ["long", "short"]
    assert (rows["long"].state, rows["long"].attempts) == ("complete", 2)
    assert (rows["short"].state, rows["short"].attempts) == ("poisoned", 2)
    assert "its worker died 2 times" in rows["short"].error
    assert content(place / "killed" / "long") == content(place / "runs" / "long")
    assert sorted(os.listdir(place / "killed"))[:2] == ["batch.html", "batch.json"]
