"""Runs that cannot be joined are left out, and say why; the others are joined as without them."""

import os
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.run.test_joining import of_another_version, with_another_state, without_record
from tspslam import InputError, load_run
from tspslam.io import RunFolder
from tspslam.run._checkpoint import unpack, write_checkpoint
from tspslam.run.config import resolve
from tspslam.run.continuing import run_into
from tspslam.run.pipeline import run
from tspslam.run.sequence import MADE_BY
from tspslam.scale.maps.joining import join_runs
from tspslam.scale.maps.runs import find_runs
from tspslam.scale.maps.states import _weighed, read_step

from ...sequences import RIG, SETTINGS, corridor
from .walks import PIECES, Piece, content, kill_at_pictures, spied, walk, without_warnings


def without_a_frame(folder):
    max((folder / "frames").glob("*.npz")).unlink()


def with_a_state_that_cannot_be(folder):
    """A checkpoint with its hash in the manifest, whose landmarks are nowhere."""
    with RunFolder.create(folder, RunFolder.open(folder).config) as inner:
        rows, state = unpack((folder / "state.npz").read_bytes(), MADE_BY)
        write_checkpoint(folder / "state.npz", MADE_BY, rows, state | {"xyz": np.zeros_like(state["xyz"])})
        inner.record(folder / "state.npz", input_hash=inner.units["state.npz"].input)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (without_record, "has no run.json yet"),
        (with_another_state, "was changed since the run"),
        (of_another_version, "another version made it"),
        (without_a_frame, "is missing or was changed"),
        (with_a_state_that_cannot_be, "the state does not hold together"),
    ],
)
def test_a_broken_run_does_not_stop_the_others(runs, both, tmp_path, spoil, said):
    folder = runs[0]
    shutil.copytree(folder / "end", tmp_path / "broken")
    spoil(tmp_path / "broken")
    given = [folder / "start", tmp_path / "broken", folder / "middle"]
    for _ in range(2):
        notes: list[str] = []
        result = join_runs(given, tmp_path / "map", on_note=notes.append)
        assert list(result.left_out) == [str(tmp_path / "broken")]
        assert said in result.left_out[str(tmp_path / "broken")]
        assert result.is_degraded
        assert sum("is left out" in note for note in notes) == 1
        assert without_warnings(tmp_path / "map") == without_warnings(both)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["broken", "map"]
        record = load_run(tmp_path / "map").record
        assert record["status"] == "degraded"
        (warning,) = [one["message"] for one in record["warnings"] if one["code"] == "join_left_out"]
        assert said in warning
        page = (tmp_path / "map" / "report.html").read_text("utf-8")
        assert "Not complete:</b> runs that were to be joined were left out" in page


def test_a_map_that_lacks_a_run_does_not_become_complete_by_what_is_added(runs, tmp_path):
    folder, out = runs[0], tmp_path / "map"
    join_runs([folder / "start", tmp_path / "none", folder / "middle"], out)
    join_runs([out, folder / "end"], tmp_path / "more")
    run_into(out, [Piece(walk(), PIECES["end"], "end")])
    for place in (out, tmp_path / "more"):
        record = load_run(place).record
        assert [one["code"] for one in record["warnings"]].count("join_left_out") == 1
        assert [one["relative_to"] for one in record["recordings"]] == ["start"] * 3
        assert record["status"] == "degraded"
        page = (place / "report.html").read_text("utf-8")
        assert "Not complete:</b> runs that were to be joined were left out" in page


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_while_the_run_is_written_a_join_without_a_broken_run_goes_on(runs, both, tmp_path, monkeypatch):
    folder, out, kinds = runs[0], tmp_path / "map", []
    shutil.copytree(folder / "end", tmp_path / "broken")
    with_a_state_that_cannot_be(tmp_path / "broken")
    given = [folder / "start", tmp_path / "broken", folder / "middle"]
    kill_at_pictures(given, out)
    spied(monkeypatch, kinds)
    result = join_runs(given, out)
    assert kinds == ["state"]  # of the broken one, again
    assert list(result.left_out) == [str(tmp_path / "broken")]
    assert without_warnings(out) == without_warnings(both)


@dataclass(frozen=True)
class Moved(Piece):
    """A recording of another calibration: the right images are some pixels off."""

    px: int = 0

    def __getitem__(self, index):
        pair = super().__getitem__(index)
        return replace(pair, right=np.roll(pair.right, self.px, axis=1))


def test_a_run_whose_disparities_have_another_offset_is_left_out_by_name(runs, both, tmp_path):
    folder, moved, notes = runs[0], tmp_path / "moved", []
    run(Moved(walk(), PIECES["end"], "end", px=-3), moved, resolve(assignments=SETTINGS))
    given = [folder / "start", moved, folder / "middle"]
    for _ in range(2):
        result = join_runs(given, tmp_path / "map", on_note=notes.append)
        assert list(result.left_out) == [str(moved)]
        assert without_warnings(tmp_path / "map") == without_warnings(both)
    assert sum(f"{moved}: its disparities are off by +" in note for note in notes) == 2
    assert "expected one calibration: at most 0.5 px" in result.left_out[str(moved)]
    with pytest.raises(InputError, match=r"1 of 2 runs can be joined.* its disparities are off by -"):
        join_runs([moved, folder / "start"], tmp_path / "less")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map", "moved"]


def test_where_no_run_is_left_a_line_says_why_and_nothing_is_left(runs, tmp_path):
    for name in ("start", "middle"):
        shutil.copytree(runs[0] / name, tmp_path / name)
        with_a_state_that_cannot_be(tmp_path / name)
    with pytest.raises(InputError, match=r"0 of 2 runs can be joined.* the state does not hold together"):
        join_runs([tmp_path / "start", tmp_path / "middle"], tmp_path / "map")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["middle", "start"]


def test_what_runs_know_of_the_offset_is_weighed_and_what_was_known_before_counts_once():
    before, own = 0.3, [0.2, 0.1]  # px, the latter without the former
    information = [before**-2 + each**-2 for each in own]
    biases = [np.array([each**-2 * 0.4 / all_, all_]) for each, all_ in zip(own, information, strict=True)]
    value, total = _weighed(biases, before)
    np.testing.assert_allclose(total, before**-2 + sum(each**-2 for each in own))
    np.testing.assert_allclose(value * total, 0.4 * sum(each**-2 for each in own))
    np.testing.assert_allclose(_weighed([np.array([0.0, before**-2])] * 3, before), [0, before**-2])


def test_a_run_that_is_given_twice_counts_once(runs):
    folder = runs[0]
    found, left_out = find_runs([folder / "start", f"{folder}/./start", folder / "middle"])
    assert [one.path for one in found] == [str(folder / name) for name in ("start", "middle")]
    assert left_out == {}


def test_a_run_of_another_kind_is_left_out_and_the_first_that_can_be_used_leads(runs, tmp_path):
    folder = runs[0]
    other = Piece(walk(), PIECES["end"], "end")
    run(other, tmp_path / "few", resolve(assignments=["detector.count=700"]))
    run(corridor(1.5, RIG), tmp_path / "large", resolve(assignments=SETTINGS))
    names = [tmp_path / "gone", folder / "start", tmp_path / "few", tmp_path / "large", folder / "start"]
    with pytest.raises(InputError, match="1 of 4 runs can be joined"):
        join_runs(names, tmp_path / "map")
    found, left_out = find_runs(names)
    assert [one.path for one in found] == [str(folder / "start")]
    said = list(left_out.values())
    assert "detector.count is 700 and was 800" in said[1]
    assert "expected recordings of one rig" in said[2]
    assert not (tmp_path / "map").exists()
    assert not (tmp_path / "map-steps").exists()


def test_without_dask_a_line_says_how_to_get_it(runs, tmp_path, monkeypatch):
    from tspslam.scale.cluster import Workers

    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="Dask is not installed"):
        join_runs([runs[0] / "start", runs[0] / "middle"], tmp_path / "map", workers=Workers(2))


def test_a_place_that_cannot_be_the_run_folder_is_refused_before_anything_is_done(runs, tmp_path):
    (tmp_path / "file").write_text("mine")
    given = [runs[0] / name for name in ("start", "middle")]
    before = content(given[0])
    (tmp_path / "link").symlink_to(tmp_path / "nothing")
    refused = {
        tmp_path / "file": "is a file",
        tmp_path / "link": "a link to nothing",
        given[0] / "sub": "is in the run",
    }
    for out, said in refused.items():
        with pytest.raises(InputError, match=said):
            join_runs(given, out)
        assert not out.with_name(f"{out.name}-steps").exists()
    assert (tmp_path / "file").read_text() == "mine"
    assert content(given[0]) == before


def test_a_damaged_file_of_a_step_is_named(tmp_path):
    (tmp_path / "step.npz").write_bytes(b"half")
    with pytest.raises(InputError, match=r"step\.npz: is not a sound npz.*without that file the same command"):
        read_step(tmp_path / "step.npz")
