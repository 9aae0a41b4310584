"""Joins where the disk is full in any step, runs are tiny, lie in another's folder, or must not be touched."""

import errno
import os
import shutil

import numpy as np
import pytest

from tspslam import InputError, OutputError, load_run
from tspslam.io import read_trajectory
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.run.record import hash_of
from tspslam.scale.maps import steps
from tspslam.scale.maps.joining import join_runs
from tspslam.scale.maps.runs import find_runs
from tspslam.vision.se3 import inverse

from ...sequences import SETTINGS
from .test_steps import KINDS, NAMES
from .walks import Piece, content, spied, walk

FULL = r"cannot be written \(.*[Nn]o space left on device.*\)"


def refuse(_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_disk_is_full_in_a_step_a_line_says_so_and_the_same_call_goes_on(
    runs, both, tmp_path, monkeypatch, kind
):
    folders, make = [runs[0] / name for name in NAMES], steps._MAKERS[kind]

    def full(*given):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", refuse)
            make(*given)

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(steps._MAKERS, kind, full)
        with pytest.raises(OutputError, match=FULL):
            join_runs(folders, tmp_path / "map")
    assert not (tmp_path / "map").exists()
    assert not list((tmp_path / "map-steps").rglob("*.tmp"))
    done: list[str] = []
    spied(monkeypatch, done)
    join_runs(folders, tmp_path / "map")
    assert done[0] == kind
    assert content(tmp_path / "map") == content(both)
    assert [path.name for path in tmp_path.iterdir()] == ["map"]


def test_where_the_disk_is_full_while_the_run_is_written_no_step_is_done_again(runs, both, tmp_path, monkeypatch):
    folders, done = [runs[0] / name for name in NAMES], []
    with pytest.MonkeyPatch.context() as patch, pytest.raises(OutputError, match=FULL):
        join_runs(folders, tmp_path / "map", on_step=lambda step: patch.setattr(os, "fsync", refuse))
    spied(monkeypatch, done)
    join_runs(folders, tmp_path / "map")
    assert done == []
    assert content(tmp_path / "map") == content(both)


@pytest.mark.parametrize("count", [2, 3])
def test_a_run_of_few_frames_is_joined(runs, tmp_path, count):
    folder, truth = runs
    frames = range(3, 3 + count)
    run(Piece(walk(), frames, "few"), tmp_path / "few", resolve(assignments=SETTINGS))
    join_runs([folder / "start", tmp_path / "few"], tmp_path / "map")
    record = load_run(tmp_path / "map").record
    assert [one["relative_to"] for one in record["recordings"]] == ["start", "start"]
    true = truth[[*range(7), *frames]]
    found = read_trajectory(tmp_path / "map" / "trajectory.tum").T_world_camera
    assert np.linalg.norm((inverse(true[0]) @ true - found)[:, :3, 3], axis=1).max() < 0.03  # m, as all joins


def listed(folder):
    """What a folder and its files look like to others: links to a file from elsewhere are none of these."""
    paths = [folder, *sorted(folder.rglob("*"))]
    return [(path, path.stat().st_mtime_ns, path.stat().st_mode, path.stat().st_size) for path in paths]


def test_runs_are_read_and_never_written(runs, both, tmp_path):
    for name in NAMES:
        shutil.copytree(runs[0] / name, tmp_path / name)
        for path in [*(tmp_path / name).rglob("*"), tmp_path / name]:
            path.chmod(0o555 if path.is_dir() else 0o444)
    before = [listed(tmp_path / name) for name in NAMES]
    try:
        join_runs([tmp_path / name for name in NAMES], tmp_path / "map")
        assert [listed(tmp_path / name) for name in NAMES] == before
        assert content(tmp_path / "map") == content(both)
    finally:
        for path in [tmp_path / name for name in NAMES]:
            for each in (path, *(inner for inner in path.rglob("*") if inner.is_dir())):
                each.chmod(0o755)


def test_a_run_in_the_folder_of_another_is_a_run_of_its_own(runs, both, tmp_path):
    outer = shutil.copytree(runs[0] / "start", tmp_path / "start")
    inner = shutil.copytree(runs[0] / "middle", outer / "middle")
    join_runs([outer, inner], tmp_path / "map")
    assert content(tmp_path / "map") == content(both)
    with pytest.raises(InputError, match="is in the run"):
        join_runs([outer, inner], inner / "map")


def test_a_copy_of_a_run_is_of_the_same_recording(runs, tmp_path):
    copy = shutil.copytree(runs[0] / "start", tmp_path / "copy")
    found, left_out = find_runs([runs[0] / "start", copy])
    assert [one.path for one in found] == [str(runs[0] / "start")]
    assert "is of a recording that" in left_out[str(copy)]


def test_a_folder_of_an_older_join_is_made_anew(runs, both, tmp_path, monkeypatch):
    """Its state was not adjusted: what counts is what it was made from."""
    folders, done = [runs[0] / name for name in NAMES], []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps.Plan, "digest", property(lambda plan: hash_of(["joined", plan._of_all()])))
        join_runs(folders, tmp_path / "map")
    spied(monkeypatch, done)
    join_runs(folders, tmp_path / "map")
    assert done[-1] == "adjustment"
    assert content(tmp_path / "map") == content(both)


def test_a_run_whose_record_is_gone_is_written_anew(runs, both, tmp_path):
    folders = [runs[0] / name for name in NAMES]
    join_runs(folders, tmp_path / "map")
    (tmp_path / "map" / "run.json").unlink()
    join_runs(folders, tmp_path / "map")
    assert content(tmp_path / "map") == content(both)
