"""A run folder that somebody else made writes, empties and removes nothing outside itself."""

import json
import os
import sys

import pytest

from tspslam import cli
from tspslam.errors import InputError, OutputError
from tspslam.io import RunFolder
from tspslam.io.lock import FolderLock
from tspslam.io.manifest import Unit, append_unit

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
CONFIG = {"detector": "orb"}
MARK = "# tspslam run, format 3\ndetector: orb\n"


@pytest.fixture
def run(tmp_path):
    """A run folder with two finished frames, beside a folder and a file of the user's."""
    with RunFolder.create(tmp_path / "run", CONFIG) as folder:
        for index in (0, 1):
            folder.frame_path(index).write_bytes(b"a frame")
            folder.record(folder.frame_path(index), input_hash="pair")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / ".tspslam-0.tmp").write_text("mine")
    (tmp_path / "victim.txt").write_text("victim")
    return tmp_path / "run"


def tree(folder):
    """All that is below a folder: links by their target, files by their content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        is_file = path.is_file() and not path.is_symlink()
        found[str(path)] = path.read_bytes() if is_file else os.readlink(path) if path.is_symlink() else None
    return found


def line(name):
    unit = {"name": name, "sha256": 64 * "0", "bytes": 6, "input": "", "config": ""}
    return json.dumps(unit).encode() + b"\n"


NAMES = [
    "../victim.txt", "frames/../../victim.txt", "./map.ply", "", ".", "..", "frames", "frames/", "mine", "a.txt",
    "config.yaml", "manifest.jsonl", "timings.json", ".lock", "frames/1.npz", "frames/000001.npz/../x",
    "frames/000001.npz\n", "frames\\000001.npz", "C:frames/000001.npz", "frames/٠٠٠٠٠١.npz", "pictures/../map.png",
    "pictures/a/b.png", "pictures/.png", "pictures/a.b.png", "map.ply\0",
]  # fmt: skip


def refuses_and_touches_nothing(run, said):
    """Neither a run nor a reader takes the folder; each says why in one line."""
    before = tree(run.parent)
    for way in (lambda: RunFolder.create(run, CONFIG), lambda: RunFolder.open(run)):
        with pytest.raises(InputError, match=said) as caught:
            way()
        assert "\n" not in str(caught.value)
    assert tree(run.parent) == before


@pytest.mark.parametrize("name", [*NAMES, "/ABSOLUTE/victim.txt"])
@pytest.mark.parametrize("is_last", [True, False])
def test_a_manifest_that_names_what_no_run_makes_is_damaged_and_nothing_is_touched(run, name, is_last):
    manifest = run / "manifest.jsonl"
    lines = manifest.read_bytes().splitlines(keepends=True)
    lines.insert(2 if is_last else 1, line(name.replace("/ABSOLUTE", str(run.parent))))
    manifest.write_bytes(b"".join(lines))
    refuses_and_touches_nothing(run, f"manifest.jsonl: line {2 + is_last} is damaged")


def test_a_run_lists_only_what_a_run_makes(run):
    with RunFolder.create(run, CONFIG) as folder:
        (run / "notes.txt").write_text("of the user")
        with pytest.raises(InputError, match="not in its place"):
            folder.record(run / "notes.txt", input_hash="")
        with pytest.raises(InputError, match="not in its place"):
            folder.record(run / "config.yaml", input_hash="")


PLACES = [
    "config.yaml", "manifest.jsonl", "timings.json", "run.json", "report.html", "map.vtu", "map.ply", "state.npz",
    "trajectory.tum", "trajectory.kitti.txt", ".lock", "frames", "pictures", "frames/000000.npz", "frames/000007.json",
    "pictures/phase.png",
]  # fmt: skip


def replaced(path, target):
    """Put a link in the place of a file or folder."""
    if path.is_dir():
        for entry in path.iterdir():
            entry.unlink()
        path.rmdir()
    path.unlink(missing_ok=True)
    path.symlink_to(target)


@pytest.mark.parametrize("target", ["victim.txt", "mine", "nowhere", "loop"])
@pytest.mark.parametrize("name", PLACES)
def test_a_link_in_a_place_of_ours_is_refused_before_anything_is_written_or_swept(run, name, target):
    replaced(run / name, run / name if target == "loop" else run.parent / target)
    refuses_and_touches_nothing(run, f"{name}: is a link; expected")


def test_a_link_to_a_run_folder_s_own_file_is_refused_too(run):
    replaced(run / "config.yaml", run / "kept.yaml")
    (run / "kept.yaml").write_text(MARK)
    with pytest.raises(InputError, match=r"config\.yaml: is a link"):
        RunFolder.create(run, CONFIG)


@pytest.mark.parametrize("name", [name for name in PLACES if name not in ("frames", "pictures")])
@pytest.mark.parametrize("make", ["mkdir", "mkfifo"])
def test_a_folder_or_a_pipe_in_the_place_of_a_file_is_refused_without_waiting(run, name, make):
    (run / name).unlink(missing_ok=True)
    getattr(os, make)(run / name)
    for way in (lambda: RunFolder.create(run, CONFIG), lambda: RunFolder.open(run)):
        with pytest.raises(InputError, match=f"{name}: is no regular file"):
            way()


def test_a_file_in_the_place_of_a_folder_is_refused(run):
    (run / "pictures").rmdir()
    (run / "pictures").write_text("")
    with pytest.raises(InputError, match="pictures: is no folder"):
        RunFolder.create(run, CONFIG)


def test_links_of_the_user_s_own_names_and_temporary_ones_lead_nowhere(run):
    (run / "notes").symlink_to(run.parent / "mine")
    (run / "frames" / "mine.npz").symlink_to(run.parent / "victim.txt")
    (run / "frames" / ".tspslam-0.tmp").symlink_to(run.parent / "victim.txt")
    with RunFolder.create(run, CONFIG) as folder:
        folder.keep([])
    assert sorted(os.listdir(run)) == ["config.yaml", "frames", "manifest.jsonl", "notes", "pictures"]
    assert os.listdir(run / "frames") == ["mine.npz"]
    assert (run.parent / "victim.txt").read_text() == "victim"
    assert (run.parent / "mine" / ".tspslam-0.tmp").read_text() == "mine"


@pytest.mark.parametrize("target", ["victim.txt", "mine", "nowhere"])
def test_a_lock_that_is_a_link_is_refused_and_its_target_stays(run, target):
    empty = run.parent / "empty"
    empty.mkdir()
    (empty / ".lock").symlink_to(run.parent / target)
    before = tree(run.parent)
    for way in (lambda: FolderLock(empty), lambda: RunFolder.create(empty, CONFIG)):
        with pytest.raises(InputError, match=r"\.lock: is a link"):
            way()
    assert tree(run.parent) == before


@pytest.mark.parametrize("content", ["", "12\n"])
def test_a_lock_with_a_second_name_is_refused_and_that_file_stays(run, content):
    victim = run.parent / "victim.txt"
    victim.write_text(content)
    os.link(victim, run / ".lock")
    with pytest.raises(InputError, match=r"\.lock: is a file that has a second name"):
        RunFolder.create(run, CONFIG)
    assert victim.read_text() == content
    assert (run / ".lock").samefile(victim)


@pytest.mark.parametrize("content", ["of another program", "12\n13\n", 40 * "1", "\n\n"])
def test_a_lock_of_something_else_is_refused_and_stays(tmp_path, content):
    (tmp_path / ".lock").write_text(content)
    with pytest.raises(InputError, match=r"\.lock: holds something else"):
        RunFolder.create(tmp_path, CONFIG)
    assert (tmp_path / ".lock").read_text() == content
    assert os.listdir(tmp_path) == [".lock"]


def test_a_link_that_comes_between_look_and_open_is_not_followed(run, monkeypatch):
    (run / ".lock").symlink_to(run.parent / "victim.txt")
    monkeypatch.setattr(FolderLock, "_refuse_foreign", lambda self: None)
    with pytest.raises(OutputError, match="cannot be written"):
        FolderLock(run)
    (run / "manifest.jsonl").unlink()
    (run / "manifest.jsonl").symlink_to(run.parent / "victim.txt")
    with pytest.raises(OutputError, match="cannot be written"):
        append_unit(run / "manifest.jsonl", Unit("map.ply", 64 * "0", 1, "", ""))
    assert (run.parent / "victim.txt").read_text() == "victim"


def test_a_manifest_with_a_second_name_is_written_anew_and_that_file_stays(run):
    os.link(run / "manifest.jsonl", run.parent / "backup")
    before = (run.parent / "backup").read_bytes()
    with pytest.raises(OutputError, match="second name"):
        append_unit(run / "manifest.jsonl", Unit("map.ply", 64 * "0", 1, "", ""))
    with RunFolder.create(run, CONFIG) as folder:
        folder.frame_path(2).write_bytes(b"a frame")
        folder.record(folder.frame_path(2), input_hash="pair")
    assert (run.parent / "backup").read_bytes() == before
    assert len(RunFolder.open(run).units) == 3


@pytest.mark.parametrize("name", ["map.ply", "run.json", "frames/000000.npz"])
def test_a_file_with_a_second_name_is_replaced_and_the_other_stays(run, name):
    (run / name).unlink(missing_ok=True)
    os.link(run.parent / "victim.txt", run / name)
    with RunFolder.create(run, CONFIG) as folder:
        folder.write_run({"frames": 1})
        folder.keep([])
    assert (run.parent / "victim.txt").read_text() == "victim"


def names(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@pytest.mark.parametrize("error", [InputError("no pair"), OutputError("no space"), KeyboardInterrupt()])
def test_a_run_that_ends_before_a_first_file_is_finished_leaves_nothing_that_it_made(tmp_path, error):
    (tmp_path / "empty").mkdir()
    for path in ("runs/deep/run", "empty"):
        with pytest.raises(type(error)), RunFolder.create(tmp_path / path, CONFIG):
            raise error
    assert names(tmp_path) == ["empty"]


def test_what_was_there_or_came_to_be_there_stays(run):
    with pytest.raises(InputError, match="no pair"), RunFolder.create(run, CONFIG):
        raise InputError("no pair")
    assert "frames/000000.npz" in names(run)
    other = run.parent / "other"

    def interrupted():
        with RunFolder.create(other, CONFIG) as folder:
            folder.frame_path(0).write_bytes(b"not noted yet")
            raise InputError("no pair")

    with pytest.raises(InputError, match="no pair"):
        interrupted()
    assert "frames/000000.npz" in names(other)
    RunFolder.create(other, CONFIG).close()


def test_a_command_that_is_refused_leaves_no_folder(tmp_path, monkeypatch, pair_files, capsys):
    from PIL import Image

    for side in ("left", "right"):
        Image.new("L", (300, 200), 128).save(pair_files / f"{side}.png")  # shows nothing
    command = ["run", str(pair_files / "left.png"), str(pair_files / "right.png"), "--calib"]
    monkeypatch.chdir(tmp_path)
    assert cli.exit_code([*command, str(pair_files / "calib.yaml")]) == cli.BAD_INPUT
    assert not (tmp_path / "runs").exists()
    assert "texture" in capsys.readouterr().err
