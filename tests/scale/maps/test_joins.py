"""Finished runs of one place become one map, as good as that of one run; what is of another place stays apart."""

import json

import numpy as np
import pytest

from tests.test_cli import complain, type_in
from tspslam import InputError, build_map, load_map, load_run
from tspslam.datasets import JoinedSequence
from tspslam.io import read_trajectory
from tspslam.io.lock import FolderLock
from tspslam.run.config import resolve
from tspslam.run.export import export
from tspslam.run.pipeline import run
from tspslam.scale.maps.joining import join_runs
from tspslam.vision.se3 import inverse

from ...sequences import SETTINGS
from .walks import PIECES, Piece, content, error_of, walk, without_warnings

TRUE = 0.03  # m over 9 m of way: runs of all pieces have 0.013 to 0.016, joins 0.010 to 0.014


def test_two_runs_are_as_good_as_one_run_of_both(runs, both, tmp_path):
    whole, truth = walk(), runs[1]
    pieces = [Piece(whole, PIECES[name], name) for name in ("start", "middle")]
    run(JoinedSequence(pieces), tmp_path / "run", resolve(assignments=SETTINGS))
    errors = [error_of(out, truth, "start", "middle") for out in (both, tmp_path / "run")]
    assert max(errors) < TRUE


def test_a_chain_is_in_the_frame_of_the_first_and_another_place_is_said_to_be_apart(runs, chain):
    out, result = chain
    record = load_run(out).record
    first, other, end, middle = record["recordings"]
    assert [one["relative_to"] for one in (first, other, end, middle)] == ["start", "other", "start", "start"]
    assert first["joined_by"] is None
    assert middle["joined_by"]["recording"] == "start"
    assert end["joined_by"]["recording"] == "middle"
    assert other["joined_by"] is None
    assert other["loops_to_others"] == 0
    assert record["status"] == "degraded"
    assert result.is_degraded
    assert not result.left_out
    assert [each["code"] for each in record["warnings"] if "other was" in each["message"]] == ["not_joined"]
    assert error_of(out, runs[1], "start", "end", "middle") < TRUE
    assert (np.diff(read_trajectory(out / "trajectory.tum").stamp) > 0).all()
    for name in ("other", "end"):
        own = [
            read_trajectory(place).stamp
            for place in (out / f"trajectory_{name}.tum", runs[0] / name / "trajectory.tum")
        ]
        np.testing.assert_allclose(*own, atol=1e-9)


def test_landmarks_that_both_saw_are_one(runs, both):
    folder, _ = runs
    apart = [load_run(folder / name).record["landmarks"] for name in ("start", "middle")]
    record = load_run(both).record
    assert record["landmarks"] < sum(apart) - 100
    assert record["keyframes"] == sum(load_run(folder / name).record["keyframes"] for name in ("start", "middle"))
    seen = load_map(both).observations
    frames = np.split(load_map(both).keyframes[seen.keyframe], seen.start[1:-1])
    assert sum(bool((one < 7).any() and (one >= 7).any()) for one in frames) > 100


def test_a_joined_run_is_read_as_any_run(runs, both, tmp_path, capsys):
    stored = load_run(both)
    assert len(stored) == 15
    assert stored.frame(stored.stored[-1]).name.startswith("middle/")
    assert len(build_map(both)) == len(load_map(both))
    assert export(both, "colmap", tmp_path / "colmap").is_dir()
    true = tmp_path / "truth.txt"
    np.savetxt(true, runs[1][PIECES["start"]][:, :3].reshape(-1, 12))
    code, _, _ = type_in(capsys, "eval", both, "--truth", true, "--truth", true, "--json")
    assert code in (0, 4)


def test_a_joined_run_is_joined_again(runs, both, tmp_path):
    folder, truth = runs
    join_runs([both, folder / "end"], tmp_path / "map")
    record = load_run(tmp_path / "map").record
    assert [one["relative_to"] for one in record["recordings"]] == ["start"] * 3
    assert error_of(tmp_path / "map", truth, "start", "middle", "end") < TRUE
    for name in ("start", "middle"):
        with pytest.raises(InputError, match=r"1 of 2 runs can be joined.* is of a recording that .*map has"):
            join_runs([both, folder / name], tmp_path / "twice")


def test_pieces_of_one_recording_are_joined_and_numbered_from_0_on(tmp_path):
    whole, pieces = walk(), {"one": range(2, 9), "two": range(6, 13)}
    for name, frames in pieces.items():
        run(whole, tmp_path / name, resolve(assignments=SETTINGS), frames=frames)
    join_runs([tmp_path / name for name in pieces], tmp_path / "map")
    stored = load_run(tmp_path / "map")
    assert [row["index"] for row in stored.record["per_frame"]] == list(range(14))
    assert all(stored.frame(k).index == k for k in stored.stored)
    true = whole.truth[[k for frames in pieces.values() for k in frames]]
    found = read_trajectory(tmp_path / "map" / "trajectory.tum").T_world_camera
    assert np.linalg.norm((inverse(true[0]) @ true - found)[:, :3, 3], axis=1).max() < TRUE


def test_the_same_again_does_no_step_and_leaves_the_same_bytes(runs, both):
    before, said = content(both), []
    join_runs([runs[0] / "start", runs[0] / "middle"], both, on_note=said.append)
    assert content(both) == before
    assert said == []
    assert [path.name for path in both.parent.iterdir()] == ["map"]


def test_a_folder_that_is_there_is_not_touched(runs, both, tmp_path):
    folder, before = runs[0], content(both)
    with pytest.raises(InputError, match=r"source\.joined_from"):
        join_runs([folder / "start", folder / "end"], both)
    with pytest.raises(InputError, match=r"source\.joined_from"):
        join_runs([folder / "start", folder / "middle", folder / "end"], both)
    assert content(both) == before
    assert [path.name for path in both.parent.iterdir()] == ["map"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("kept")
    with pytest.raises(InputError, match=r"holds 'letter\.txt'"):
        join_runs([folder / "start", folder / "middle"], tmp_path / "mine")
    with pytest.raises(InputError, match="is the input itself"):
        join_runs([folder / "start", folder / "middle"], folder / "start")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine"]
    (tmp_path / "new-steps").mkdir()
    (tmp_path / "new-steps" / "letter.txt").write_text("kept")
    with pytest.raises(InputError, match="a free name, for the steps of the join"):
        join_runs([folder / "start", folder / "middle"], tmp_path / "new")


def test_two_joins_into_one_folder_are_one_too_many(runs, tmp_path):
    (tmp_path / "map-steps").mkdir()
    lock = FolderLock(tmp_path / "map-steps")
    try:
        with pytest.raises(InputError, match="map-steps: is in use by process"):
            join_runs([runs[0] / "start", runs[0] / "middle"], tmp_path / "map")
    finally:
        lock.release()
    assert not (tmp_path / "map").exists()


def test_runs_are_typed_one_after_another(runs, both, tmp_path, capsys):
    folder = runs[0]
    code, out, err = type_in(capsys, "join", folder / "start", folder / "middle", "--out", tmp_path / "map")
    assert code == 0
    assert "joined to start" in out
    assert content(tmp_path / "map") == content(both)
    words = "join", folder / "start", tmp_path / "none", folder / "middle", "--out", tmp_path / "less", "--json"
    code, out, err = type_in(capsys, *words)
    assert code == 4
    assert [one["name"] for one in json.loads(out)["recordings"]] == ["start", "middle"]
    assert "none is left out" in err
    assert without_warnings(tmp_path / "less") == without_warnings(both)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["one"], 3, "0 of 1 runs can be joined, expected 2 or more; one: holds no config.yaml"),
        (["one", "--workers", "2000"], 2, "less than or equal to 1024"),
        (["one", "--memory", "4GB"], 2, "there are none"),
        (["one", "--scheduler", "tcp://x:1", "--workers", "2"], 2, "workers of its own"),
    ],
)
def test_what_is_typed_wrong_is_said_in_one_line(tmp_path, monkeypatch, capsys, words, code, said):
    monkeypatch.chdir(tmp_path)
    found, line = complain(capsys, "join", *words, "--out", "map")
    assert found == code
    assert said in line
    assert list(tmp_path.iterdir()) == []
