"""Runs that cannot be joined are left out, and say why; the others are joined as without them."""

import shutil

import numpy as np
import pytest

from tests.run.test_joining import of_another_version, with_another_state, without_record
from tspslam import InputError
from tspslam.io import RunFolder
from tspslam.run._checkpoint import unpack, write_checkpoint
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.run.sequence import MADE_BY
from tspslam.scale.maps.joining import join_runs

from ...sequences import RIG, SETTINGS, corridor
from .walks import PIECES, Piece, content, walk


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
    folder, notes = runs[0], []
    shutil.copytree(folder / "end", tmp_path / "broken")
    spoil(tmp_path / "broken")
    result = join_runs(
        [folder / "start", tmp_path / "broken", folder / "middle"], tmp_path / "map", on_note=notes.append
    )
    assert list(result.left_out) == [str(tmp_path / "broken")]
    assert said in result.left_out[str(tmp_path / "broken")]
    assert result.is_degraded
    assert sum("is left out" in note for note in notes) == 1
    assert content(tmp_path / "map") == content(both)


def test_a_run_of_another_kind_is_left_out_and_the_first_that_can_be_used_leads(runs, tmp_path):
    folder = runs[0]
    other = Piece(walk(), PIECES["end"], "end")
    run(other, tmp_path / "few", resolve(assignments=["detector.count=700"]))
    run(corridor(1.5, RIG), tmp_path / "large", resolve(assignments=SETTINGS))
    names = [tmp_path / "gone", folder / "start", tmp_path / "few", tmp_path / "large", folder / "start"]
    with pytest.raises(InputError, match="1 of 5 runs can be joined"):
        join_runs(names, tmp_path / "map")
    from tspslam.scale.maps.runs import find_runs

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
