"""What commands may write to: no input, no file of a run, no file of another kind unless forced; pictures as they say."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.datasets import standard
from tests.io.test_topological import map_
from tests.test_cli import complain, content, type_in
from tspslam import Frame, InputError, Rig
from tspslam.io import RunFolder, read_frame, read_map, read_ply, read_vtu, write_frame, write_map, write_ply, write_tum
from tspslam.topology.complex import build_complex
from tspslam.types import Cloud, Response, Signals, Surface
from tspslam.view import write_path_picture
from tspslam.vision.calibration.formats.own import load_rig, save_cameras

RIG = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
KITTI = "P0: 50 0 10 0 0 50 5 0 0 0 1 0\nP1: 50 0 10 -5 0 50 5 0 0 0 1 0\n"


@pytest.fixture
def calib(tmp_path):
    (tmp_path / "c.txt").write_text(KITTI)
    return tmp_path / "c.txt"


def convert(capsys, source, output, *more):
    return type_in(capsys, "calib", "convert", source, output, "--size", "20x10", *more)


def frame():
    complex_, three, yes = build_complex([[0, 1, 2]], 3), np.zeros(3), np.ones(3, bool)
    signals = Signals(three, three, np.zeros(1), np.zeros((3, 2)), np.zeros((1, 2)), np.zeros(3, int), np.zeros(1, int),
                      yes, yes, yes[:1])  # fmt: skip
    cloud, response = Cloud(np.eye(3), np.zeros((3, 2)), three), Response(three.astype(complex), 1, yes)
    return Frame(0, 0.0, "first", RIG, cloud, Surface(complex_.faces), complex_, signals, response)


@pytest.fixture
def run(tmp_path):
    """A run folder with one finished frame and a path."""
    with RunFolder.create(tmp_path / "run", {}) as folder:
        write_frame(folder.frame_path(0), frame())
        write_ply(folder.map_ply_path, np.eye(3), [[0, 1, 2]])
        paths = folder.write_trajectory(np.arange(20) / 10, standard.poses(20))
        written = folder.write_run({"per_frame": [{"stamp": k / 10, "index": k} for k in range(20)]})
        for path in (folder.frame_path(0), folder.map_ply_path, *paths, written):
            folder.record(path, input_hash="")
    return tmp_path / "run"


def same(path):
    return path


def linked(path):
    (path.parent / "link.yaml").symlink_to(path.name)
    return path.parent / "link.yaml"


def hard_linked(path):
    os.link(path, path.parent / "hard.yaml")
    return path.parent / "hard.yaml"


def roundabout(path):
    return path.parent / ".." / path.parent.name / path.name


def of_another_case(path):
    return path.with_name(path.name.upper())


@pytest.mark.parametrize("named", [same, linked, hard_linked, roundabout, of_another_case])
def test_an_input_is_never_the_output(capsys, calib, named):
    output = named(calib)
    if not output.exists():
        pytest.skip("names of another case are other files here")
    for more in ([], ["--force"]):
        code, line = complain(capsys, "calib", "convert", calib, output, "--size", "20x10", *more)
        assert (code, "is the input" in line) == (3, True)
    assert calib.read_text() == KITTI


def test_a_relative_name_of_the_input_is_the_input(capsys, calib, monkeypatch):
    monkeypatch.chdir(calib.parent)
    assert complain(capsys, "calib", "convert", calib, "./c.txt", "--size", "20x10")[0] == 3
    assert calib.read_text() == KITTI


OTHERS = {
    "poses.txt": b"0 0 0 0 0 0 0 1\n",
    "photo.png": b"\x89PNG\r\n\x1a\n...",
    "settings.yaml": b"filter: {order: 2}\n",  # the suffix alone does not tell
    "ours.txt": b"baseline: 0.1\n",  # nor do the first bytes
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_file_of_another_kind_is_overwritten_only_by_force(capsys, calib, name):
    output = calib.with_name(name)
    output.write_bytes(OTHERS[name])
    code, line = complain(capsys, "calib", "convert", calib, output, "--size", "20x10")
    assert code == 3
    assert "is there and is no calibration of ours; expected a free name, or --force" in line
    assert output.read_bytes() == OTHERS[name]
    assert convert(capsys, calib, output, "--force")[0] == 0
    assert load_rig(output).baseline == pytest.approx(0.1)


def test_a_free_name_an_empty_file_and_one_of_the_same_kind_are_written(capsys, calib):
    output = calib.with_name("ours.yaml")
    output.touch()
    for _ in range(2):
        assert convert(capsys, calib, output)[0] == 0
        save_cameras(RIG, output)
    assert convert(capsys, calib, calib.with_name("free.txt"))[0] == 0


def test_a_file_of_a_run_is_no_output(capsys, run, calib):
    (run.parent / "t.tum").write_bytes((run / "trajectory.tum").read_bytes())
    before = content(run)
    path = run.parent / "t.tum"
    for output in (run / "map.ply", run / "frames/000000.npz", run / "new.ply", run / "frames/../new.vtu"):
        for more in ([], ["--force"]):
            code, line = complain(
                capsys, "export", run, "--output", output, "--to", output.suffix[1:], *more
            )  # whatever is there
            assert (code, "run folder" in line) == (3, True)
    other = shutil.copytree(run, run.parent / "other")
    for command in (
        ["export", other, "--to", "ply", "--output", run / "map.ply"],
        ["calib", "convert", calib, run / "config.yaml", "--size", "20x10"],
        ["eval", path, "--truth", path, "--plot", run / "pictures" / "path.png"],
    ):
        code, line = complain(capsys, *command, "--force")
        assert (code, f"is a file of the run in {run}" in line) == (3, True)
    assert content(run) == before


def test_an_export_goes_over_maps_of_its_kind_alone(capsys, run, monkeypatch):
    monkeypatch.chdir(run.parent)
    for to in ("vtu", "ply", "npz"):
        for _ in range(2):
            assert type_in(capsys, "export", run, "--to", to)[:2] == (0, f"wrote run-000000.{to}\n")
    np.savez("data.npz", a=1)
    write_map("map.npz", map_())
    Path("mesh.ply").write_text("plywood\n")
    Path("grid.vtu").write_text("<?xml version='1.0'?>\n<svg/>")
    for name in ("data.npz", "map.npz", "mesh.ply", "grid.vtu"):
        before = Path(name).read_bytes()
        words = ["export", run, "--to", name[-3:], "--output", name]
        assert (complain(capsys, *words)[0], Path(name).read_bytes()) == (3, before)
        assert type_in(capsys, *words, "--force")[0] == 0
    assert len(read_vtu("grid.vtu").faces) == 1


def test_an_export_of_a_run_with_a_map_is_the_map_unless_a_frame_is_named(capsys, run, monkeypatch):
    monkeypatch.chdir(run.parent)
    with RunFolder.create(run, {}) as folder:
        write_map(folder.map_npz_path, map_())
        folder.record(folder.map_npz_path, input_hash="")
    assert type_in(capsys, "export", run)[:2] == (0, "wrote run-map.vtu\n")
    assert type_in(capsys, "export", run, "--to", "ply")[:2] == (0, "wrote run-map.ply\n")
    assert np.array_equal(read_vtu("run-map.vtu").xyz, map_().xyz)
    assert np.array_equal(read_ply("run-map.ply").faces, map_().surface.faces)
    assert type_in(capsys, "export", run, "--to", "npz")[:2] == (0, "wrote run-map.npz\n")
    assert np.array_equal(read_map("run-map.npz").xyz, map_().xyz)
    for more in (["--frame", "0"], ["--frame", "0", "--to", "npz"], ["--to", "npz"]):
        assert type_in(capsys, "export", run, *more)[0] == 0
    assert np.array_equal(read_vtu("run-000000.vtu").xyz, frame().cloud.xyz)
    assert np.array_equal(read_frame("run-000000.npz").cloud.xyz, frame().cloud.xyz)
    (run / "map.npz").write_bytes(b"something else")
    code, line = complain(capsys, "export", run)
    assert (code, "map.npz: is missing or was changed since the run" in line) == (3, True)


def test_a_suffix_that_says_something_else_is_refused(capsys, run, tmp_path):
    words = ["export", run, "--to", "ply", "--output", tmp_path / "a.vtu"]
    code, line = complain(capsys, *words)
    assert (code, "has the suffix '.vtu', expected .ply" in line) == (2, True)
    write_tum(tmp_path / "t.tum", np.arange(20) / 10, standard.poses(20))
    for name in ("p.jpg", "p", "png"):
        code, line = complain(
            capsys, "eval", tmp_path / "t.tum", "--truth", tmp_path / "t.tum", "--plot", tmp_path / name
        )
        assert (code, "expected .png or .pdf or .svg" in line) == (2, True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run", "t.tum"]


def test_a_plot_never_takes_the_place_of_poses_or_images(capsys, run, tmp_path):
    write_tum(tmp_path / "poses.txt", np.arange(20) / 10, standard.poses(20))
    (tmp_path / "poses.png").symlink_to("poses.txt")
    folder = standard.odometry(tmp_path / "drive")
    (folder / "poses.txt").write_text(standard.rows_of(standard.poses(4)))
    image = next(folder.rglob("*.png"))
    before = content(tmp_path)
    for truth, plot, code in (
        (tmp_path / "poses.txt", tmp_path / "poses.txt", 2),
        (tmp_path / "poses.txt", tmp_path / "poses.png", 3),
        (folder, image, 3),
        (folder, folder / "poses.txt", 2),
    ):
        assert complain(capsys, "eval", run, "--truth", truth, "--plot", plot)[0] == code
    assert content(tmp_path) == before
    for plot in (run / "eval.png", folder / "eval.svg"):
        assert type_in(capsys, "eval", run, "--truth", tmp_path / "poses.txt", "--plot", plot)[0] == 0


PLOTS = {"p.png": b"\x89PNG", "p.PDF": b"%PDF-", "p.svg": b"<?xml"}


def test_a_plot_is_what_its_suffix_says_and_the_same_each_time(capsys, tmp_path):
    write_tum(tmp_path / "t.tum", np.arange(20) / 10, standard.poses(20))
    words = ["eval", str(tmp_path / "t.tum"), "--truth", str(tmp_path / "t.tum"), "--plot"]
    first = {}
    for name, mark in PLOTS.items():
        assert type_in(capsys, *words, tmp_path / name)[0] == 0
        first[name] = (tmp_path / name).read_bytes()
        assert first[name].startswith(mark)
    script = f"from tspslam import cli\nfor name in {list(PLOTS)}: assert cli.exit_code([*{words!r}, name]) == 0"
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, cwd=tmp_path)
    assert {name: (tmp_path / name).read_bytes() for name in PLOTS} == first


def test_the_function_refuses_other_suffixes_too(tmp_path):
    with pytest.raises(InputError, match=r"has the suffix '\.jpg'; expected \.png or \.pdf or \.svg"):
        write_path_picture(None, tmp_path / "p.jpg")


def test_a_run_folder_is_no_input_and_holds_none(capsys, run, sequence, pair_files):
    mark = (run / "config.yaml").read_bytes()
    (sequence / "config.yaml").write_bytes(mark)  # a stranger's sequence that looks like a run folder
    (sequence.parent / "config.yaml").write_bytes(mark)
    (pair_files / "config.yaml").write_bytes(mark)
    (sequence.parent / "link").symlink_to(sequence)
    left, right, calib = (pair_files / name for name in ("left.png", "right.png", "calib.yaml"))
    shutil.copy(calib, run / "calib.yaml")
    np.save(pair_files / "z.npy", np.full((200, 300), 2.0))
    before = content(pair_files)
    for words, out in (
        (["run", sequence], sequence),
        (["run", sequence], sequence.parent / "link"),
        (["run", sequence], sequence.parent),
        (["run", left, right, "--calib", calib], pair_files),
        (["run", left, "--depth", pair_files / "z.npy", "--calib", run / "calib.yaml"], run),
        (["filter", run / "map.ply", "--image", left, "--calib", calib], run),
    ):
        code, line = complain(capsys, *words, "--out", out)
        assert code == 3
        assert "the input" in line
        assert "run folder of ours" in line
    assert content(pair_files) == before


def test_a_sequence_in_the_default_place_is_not_filled(capsys, sequence, monkeypatch):
    monkeypatch.chdir(sequence.parent)
    os.mkdir("runs")
    sequence.rename("runs/drive")
    code, line = complain(capsys, "run", "runs/drive")
    assert (code, "is the input itself" in line) == (3, True)
