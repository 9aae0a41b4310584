"""A run folder of the last version is refused in one line that says what to do; nothing in it is touched or taken over."""

import json

import numpy as np
import pytest

from tspslam import InputError, load_run
from tspslam.io import RunFolder, read_frame, write_ply
from tspslam.io.manifest import sha256_file
from tspslam.run.config import resolve
from tspslam.run.pipeline import OnePair, run

from ..test_cli import complain, content

NEW = ("T_world_camera", "is_keyframe", "is_lost", "landmark")
SAID = "is a run folder of format 1, as another version of tspslam makes them; expected format 3: make the run anew"


@pytest.fixture(scope="module")
def made(motorcycle, tmp_path_factory):
    """A run of today."""
    out = tmp_path_factory.mktemp("made") / "run"
    run(OnePair(motorcycle), out, resolve())
    return out


def aged(run, out, *, first_line="# tspslam run", with_units=True):
    """What the last version left: its first line, frames of version 1, a checkpoint with its mark, in the manifest."""
    out.mkdir()
    (out / "frames").mkdir()
    (out / "pictures").mkdir()
    config = (run / "config.yaml").read_text(encoding="ascii").partition("\n")[2]
    (out / "config.yaml").write_text(f"{first_line}\n{config}", encoding="ascii")
    if not with_units:
        return out
    for name in ("run.json", "map.ply", "trajectory.tum", "frames/000000.json"):
        (out / name).write_bytes((run / name).read_bytes())
    with np.load(run / "frames" / "000000.npz") as arrays:
        old = {name: arrays[name] for name in arrays.files if name not in NEW} | {"version": np.int64(1)}
    np.savez(out / "frames" / "000000.npz", **old)
    with np.load(run / "state.npz") as arrays:
        mark = np.frombuffer(b"tspslam 0.1.0, state 3", np.uint8)
        np.savez(out / "state.npz", **(dict(arrays) | {"made_by": mark}))
    units = [json.loads(line) for line in (run / "manifest.jsonl").read_text(encoding="ascii").splitlines()]
    kept = [unit for unit in units if (out / unit["name"]).is_file()]
    for unit in kept:
        unit |= {"sha256": sha256_file(out / unit["name"]), "bytes": (out / unit["name"]).stat().st_size}
    lines = "".join(json.dumps(unit, sort_keys=True) + "\n" for unit in kept)
    (out / "manifest.jsonl").write_text(lines, encoding="ascii")
    return out


def everything(folder):
    return content(folder) | {path.as_posix(): path.stat().st_mtime_ns for path in folder.rglob("*")}


@pytest.mark.parametrize("with_units", [True, False])
def test_a_folder_of_the_last_version_is_neither_gone_on_with_nor_read(made, motorcycle, tmp_path, with_units):
    old = aged(made, tmp_path / "old", with_units=with_units)
    before = everything(tmp_path)
    for way in (
        lambda: run(OnePair(motorcycle), old, resolve()),
        lambda: RunFolder.create(old, {}),
        lambda: RunFolder.open(old),
        lambda: load_run(old),
    ):
        with pytest.raises(InputError, match=SAID) as caught:
            way()
        assert "\n" not in str(caught.value)
        assert "--out" in str(caught.value)
    assert everything(tmp_path) == before


def test_every_command_that_opens_a_run_says_so(capsys, made, tmp_path, sequence):
    old = aged(made, tmp_path / "old")
    before = everything(old)
    for words in (
        ["run", "--out", old],
        ["run", sequence, "--out", old],
        ["filter", made / "map.ply", "--image", sequence / "left/000.png", "--calib", sequence / "calib.yaml",
         "--out", old],
        ["export", old],
        ["eval", old, "--truth", old / "trajectory.tum"],
    ):  # fmt: skip
        code, line = complain(capsys, *words)
        assert (code, SAID in line) == (3, True), line
    assert everything(old) == before


def test_its_files_are_no_output_all_the_same(capsys, made, tmp_path):
    old = aged(made, tmp_path / "old")
    write_ply(old / "map.ply", np.eye(3), [[0, 1, 2]])
    before = everything(old)
    words = ["export", made, "--to", "ply", "--output", old / "map.ply", "--force"]
    code, line = complain(capsys, *words)
    assert (code, f"is a file of the run in {old}" in line) == (3, True)
    assert everything(old) == before


def test_a_folder_of_a_version_to_come_is_refused_too(made, tmp_path):
    later = aged(made, tmp_path / "later", first_line="# tspslam run, format 4")
    with pytest.raises(InputError, match="is a run folder of format 4, as another version of tspslam makes them"):
        load_run(later)


def test_a_frame_of_the_last_version_says_so(made, tmp_path):
    old = aged(made, tmp_path / "old")
    with pytest.raises(
        InputError, match="has the format version 1 of a former tspslam, and the run is to be made anew"
    ):
        read_frame(old / "frames" / "000000.npz")
