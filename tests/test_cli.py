"""What a person types: results, exit codes, one line for every error."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.patience import PATIENCE
from tspslam import build_complex, cli, merge_cells, merge_signals, read_calibration, rectification, tmahf
from tspslam.io import read_frame, read_ply, read_vtu, write_ply
from tspslam.run.config import resolve
from tspslam.settings import KINDS, PRESETS
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.features.sift_brisk import SiftDetector


def type_in(capsys, *words):
    """Run the command line in this process: (exit code, stdout, stderr)."""
    code = cli.exit_code([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def complain(capsys, *words):
    """Exit code and the one line on stderr of a command that must fail."""
    code, out, err = type_in(capsys, *words)
    assert out == ""
    lines = [
        line for line in err.splitlines() if not line.startswith(("compiling", "{"))
    ]  # with --json, { begins progress
    assert len(lines) == 1, err
    return code, lines[0]


def run_pair(capsys, folder, *more):
    files = folder / "left.png", folder / "right.png"
    return type_in(capsys, "run", *files, "--calib", folder / "calib.yaml", "--out", folder / "out", *more)


def content(folder):
    """Bytes of every file of a run but what may vary."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in folder.rglob("*") if p.is_file() and p.stem != "timings"
    }  # fmt: skip


def test_a_pair_fills_the_run_folder(capsys, pair_files):
    code, out, _ = run_pair(capsys, pair_files, "--json")
    result = json.loads(out)
    folder = pair_files / "out"
    assert (code, result["status"], result["frames"]) == (0, "complete", 1)
    names = set(content(folder)) | {"timings.json"}
    assert names >= {"run.json", "timings.json", "config.yaml", "trajectory.tum", "trajectory.kitti.txt", "map.vtu",
                     "map.ply", "report.html", "manifest.jsonl", "frames/000000.npz", "pictures/phase.png"}  # fmt: skip
    assert not any(".tmp" in name for name in names)
    stored = read_frame(folder / "frames/000000.npz")
    assert len(stored.cloud) == result["complex"]["n"] > 50
    assert json.loads((folder / "run.json").read_text())["complex"] == result["complex"]
    mesh = read_vtu(folder / "map.vtu")
    assert len(mesh.faces) == result["complex"]["faces"]
    assert np.array_equal(np.unique(mesh.cell_data["dim"]), [1, 2])


def test_a_pair_reads_its_calibration_once(monkeypatch, pair_files):
    from tspslam.cli._sources import Given, open_source
    from tspslam.vision.calibration import formats

    opened, read_text = [], formats.read_text
    monkeypatch.setattr(formats, "read_text", lambda path, *rest: opened.append(path) or read_text(path, *rest))
    pairs = open_source(Given([pair_files / "left.png", pair_files / "right.png"], pair_files / "calib.yaml"))
    assert (len(pairs), len(opened)) == (1, 1)


@pytest.mark.parametrize("rows", [0, 1, -2])
def test_rows_that_differ_are_warned_of(capsys, pair_files, rows):
    right = np.roll(np.asarray(Image.open(pair_files / "right.png")), rows, axis=0)
    Image.fromarray(right).save(pair_files / "right.png")
    code, out, _ = run_pair(capsys, pair_files, "--json")
    said = [each["message"] for each in json.loads(out)["warnings"] if each["code"] == "vertical_offset"]
    assert (code, len(said)) == (0, int(rows != 0))
    if rows:
        found = re.match(r"rows of the right image are off by ([-+][0-9.]+) ±", said[0])
        assert abs(float(found[1]) - rows) < 0.2


def test_a_pair_is_searched_for_the_disparities_that_its_calibration_tells(capsys, pair_files):
    rig = read_calibration(pair_files / "calib.yaml").cameras
    right = f"[{rig.fx} 0 {rig.cx + rig.doffs}; 0 {rig.fy} {rig.cy}; 0 0 1]"
    text = f"cam0=[{rig.fx} 0 {rig.cx}; 0 {rig.fy} {rig.cy}; 0 0 1]\ncam1={right}\nbaseline={1000 * rig.baseline}\n"
    text += f"width={rig.width}\nheight={rig.height}\nvmin=12\nvmax=42\nndisp=70\n"
    (pair_files / "calib.yaml").write_text(text)
    code, out, err = run_pair(capsys, pair_files, "--json")
    assert code == 0
    assert json.loads(out)["calibration"]["disparity_range_px"] == [12, 42]
    assert "a pair is searched for disparities from 12 to 42 px (vmin, vmax)" in err
    disparity = read_frame(pair_files / "out/frames/000000.npz").cloud.disparity
    assert len(disparity) > 15
    assert 12 <= disparity.min() < disparity.max() <= 42
    (pair_files / "calib.yaml").write_text(text.replace("vmax=42", "vmax=60"))
    assert run_pair(capsys, pair_files)[0] == 0
    assert read_frame(pair_files / "out/frames/000000.npz").cloud.disparity.max() > 42


def test_the_same_command_again_keeps_every_byte_and_two_runs_agree(capsys, pair_files):
    run_pair(capsys, pair_files)
    first = content(pair_files / "out")
    os.utime(pair_files / "out/frames/000000.npz", (1, 1))
    assert run_pair(capsys, pair_files)[0] == 0
    assert content(pair_files / "out") == first
    assert (pair_files / "out/frames/000000.npz").stat().st_mtime == 1
    shutil.rmtree(pair_files / "out")
    run_pair(capsys, pair_files)
    assert content(pair_files / "out") == first


def test_one_and_two_threads_give_the_same_bytes(capsys, pair_files):
    import cv2

    before, threads = {}, cv2.getNumThreads()
    try:
        for count in (1, 2):
            cv2.setNumThreads(count)
            run_pair(capsys, pair_files)
            before[count] = content(pair_files / "out")
            shutil.rmtree(pair_files / "out")
    finally:
        cv2.setNumThreads(threads)
    assert before[1] == before[2]


def test_a_raw_pair_is_rectified_and_run(capsys, tmp_path, raw_pair):
    pair, raw = raw_pair
    Image.fromarray(pair.left).save(tmp_path / "left.png")
    Image.fromarray(pair.right).save(tmp_path / "right.png")
    save_cameras(raw, tmp_path / "calib.yaml")
    code, out, _ = run_pair(capsys, tmp_path, "--json")
    result = json.loads(out)
    assert code == 0
    assert result["complex"]["n"] > 1000
    assert abs(result["calibration"]["vertical_offset_px"]) < 0.3
    code, line = complain(capsys, "filter", tmp_path / "out/map.ply", "--image", tmp_path / "left.png",
                          "--calib", tmp_path / "calib.yaml", "--out", tmp_path / "again")  # fmt: skip
    assert (code, "describes raw cameras, expected a rectified one" in line) == (3, True)


def test_an_image_with_a_map_is_run(capsys, pair_files, motorcycle_truth_piece):
    np.save(pair_files / "map.npy", motorcycle_truth_piece)
    words = [
        "run",
        pair_files / "left.png",
        "--calib",
        pair_files / "calib.yaml",
        "--out",
        pair_files / "out",
        "--json",
    ]
    code, out, _ = type_in(capsys, *words, "--disparity", pair_files / "map.npy", "--detector", "grid")
    assert (code, json.loads(out)["complex"]["n"] > 150) == (0, True)
    z = small_depth(pair_files, motorcycle_truth_piece)
    Image.fromarray(z).save(pair_files / "z.png")
    words[5] = pair_files / "other"
    code, out, _ = type_in(capsys, *words, "--depth", pair_files / "z.png", "--unit", "0.001")
    assert (code, json.loads(out)["complex"]["n"] > 150) == (0, True)
    assert complain(capsys, *words, "--depth", pair_files / "z.png")[0] == 3


def small_depth(folder, disparity):
    rig = read_calibration(folder / "calib.yaml").cameras
    z = rig.fx * rig.baseline / (disparity + rig.doffs)
    return np.where(np.isfinite(z), np.rint(1000 * z), 0).astype(np.uint16)


def test_a_surface_that_fails_is_said(capsys, pair_files):
    _, out, err = run_pair(capsys, pair_files, "--set", "surface.kind=crust", "--json")
    assert "for an open cloud use delaunay_surface" in err
    assert [each["code"] for each in json.loads(out)["warnings"]] == ["surface"]


def test_a_baseline_in_millimetres_is_doubted(capsys, pair_files):
    text = (pair_files / "calib.yaml").read_text()
    (pair_files / "calib.yaml").write_text(text.replace("baseline: 0.193001", "baseline: 193.001"))
    _, out, err = run_pair(capsys, pair_files, "--json")
    assert "is it in millimetres?" in err
    assert json.loads(out)["warnings"][0]["code"] == "calibration"


def test_calib_show_says_what_was_understood(capsys, tmp_path, raw_pair):
    (tmp_path / "calib.txt").write_text("P0: 50 0 10 0 0 50 5 0 0 0 1 0\nP1: 50 0 10 -500 0 50 5 0 0 0 1 0\n")
    code, out, _ = type_in(capsys, "calib", "show", tmp_path / "calib.txt", "--size", "20x10", "--json")
    found = json.loads(out)
    assert (code, found["kind"]) == (0, "a rectified pair")
    assert found["values"]["baseline"] == {"value": 10.0, "origin": "P1[0,3] / -P1[0,0]"}
    assert any("millimetres" in remark for remark in found["remarks"])
    assert (
        "note: the baseline is 10 m" in type_in(capsys, "calib", "show", tmp_path / "calib.txt", "--size", "20x10")[1]
    )
    save_cameras(raw_pair[1], tmp_path / "raw.yaml")
    out = type_in(capsys, "calib", "show", tmp_path / "raw.yaml")[1]
    assert "two raw cameras" in out
    assert "left.k1" in out
    assert "rectified.fx" in out
    assert re.search(r"^left\.width +\d+ px +\S", out, re.MULTILINE)
    assert re.search(r"^rectified\.baseline +[\d.]+ m +computed$", out, re.MULTILINE)
    assert out.count("T_right_left") >= 4
    code, line = complain(capsys, "calib", "show", tmp_path / "calib.txt")
    assert (code, "holds no image size" in line) == (3, True)


def test_calib_convert_writes_our_format(capsys, tmp_path, raw_pair):
    raw = raw_pair[1]
    save_cameras(raw, tmp_path / "raw.yaml")
    for more, expected in (([], raw), (["--rectify"], rectification(raw).rig)):
        words = ["calib", "convert", tmp_path / "raw.yaml", tmp_path / "ours.yaml", *more]
        assert type_in(capsys, *words)[1] == f"wrote {tmp_path / 'ours.yaml'}\n"
        assert read_calibration(tmp_path / "ours.yaml").cameras == expected
    assert complain(capsys, "calib", "convert", tmp_path / "raw.yaml", tmp_path / "no" / "x.yaml")[0] == 5
    left = replace(raw.left, distortion=(-3.0, 0, 0, 0, 0))
    save_cameras(replace(raw, left=left), tmp_path / "folded.yaml")
    code, line = complain(capsys, "calib", "show", tmp_path / "folded.yaml")
    assert (code, "folded.yaml: raw rig: the distortion of the left camera" in line) == (3, True)


@pytest.mark.parametrize("every", [False, True])
def test_a_part_of_a_folder_is_tracked(capsys, sequence, every):
    words = ["run", sequence, "--out", sequence / "out", "--frames", "1:3", "--json"]
    code, out, _ = type_in(capsys, *words, "--set", f"tracking.every_frame={every}")
    result = json.loads(out)
    assert (code, result["frames"], result["tracked"], result["keyframes"]) == (0, 2, 2, 1)
    stored = [p.name for p in (sequence / "out/frames").glob("*.npz")]
    assert sorted(stored) == ["000001.npz", "000002.npz"][: 1 + every]
    assert len((sequence / "out/trajectory.tum").read_text().splitlines()) == 2


def test_a_frame_that_cannot_be_used_is_skipped_and_said(capsys, sequence):
    (sequence / "right/001.png").write_bytes(b"")
    code, out, err = type_in(capsys, "run", sequence, "--out", sequence / "out", "--json")
    result = json.loads(out)
    assert (code, result["status"], result["frames"], result["tracked"]) == (4, "degraded", 3, 2)
    assert "frame 1: " in err
    assert "001.png" in err


def test_a_folder_in_which_nothing_can_be_used_is_bad_input(capsys, sequence):
    for image in sequence.glob("left/*.png"):
        image.write_bytes(b"no image")
    code, out, err = type_in(capsys, "run", sequence, "--out", sequence / "out")
    assert (code, out) == (3, "")
    assert "none of 3 pairs can be used" in err


INTERRUPTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the tests run in the background
from tspslam.run import sequence
from tspslam.__main__ import main
process = sequence.SequenceRun._process
def interrupted(self, index, *pair):
    if index == 2:
        signal.raise_signal(signal.SIGINT)
    return process(self, index, *pair)
sequence.SequenceRun._process = interrupted
main()
"""


def test_an_interrupted_run_says_how_to_resume_and_resumes(capsys, sequence):
    """The interrupt comes before the third of three pairs: never too early, never too late."""
    words = ["run", str(sequence), "--out", str(sequence / "out")]
    done = subprocess.run([sys.executable, "-c", INTERRUPTED, *words], capture_output=True, text=True)
    assert done.returncode == 130
    assert "interrupted; the same command goes on" in done.stderr
    assert "Traceback" not in done.stderr
    assert type_in(capsys, *words)[0] == 0
    resumed = content(sequence / "out")
    shutil.rmtree(sequence / "out")
    assert type_in(capsys, *words)[0] == 0
    assert resumed == content(sequence / "out")


LOST = """
import ctypes, signal, threading
from tspslam.cli import entry
signal.signal(signal.SIGINT, signal.default_int_handler)
called_back = ctypes.CFUNCTYPE(None)(lambda: [signal.raise_signal(signal.SIGINT), *range(1000)] and None)
def run(_):
    called_back()  # what is raised in it is dropped
    {then}
entry._run = run
entry.main()
"""


@pytest.mark.parametrize("then", ["signal.pause()", "raise RuntimeError('no compiled object yet')"])
def test_an_interrupt_in_a_callback_of_a_compiler_is_not_lost(then):
    done = subprocess.run([sys.executable, "-c", LOST.format(then=then), "run"], capture_output=True, text=True)
    said = "tspslam: interrupted; the same command goes on where this one stopped\n"
    assert (done.returncode, done.stderr) == (130, said)


def test_a_thread_that_does_not_end_keeps_no_interrupted_command():
    script = (
        "import threading\n"
        "from tspslam.cli import entry\n"
        "def run(_):\n"
        "    threading.Thread(target=threading.Event().wait).start()\n"
        "    raise KeyboardInterrupt\n"
        "entry._run, entry._LAST = run, 0.1\n"
        "entry.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script, "run"], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 130


def test_an_interrupt_at_the_door_of_a_compiled_loop_is_one(capsys, monkeypatch):
    def run(_):
        try:
            raise SystemError("returned a result with an exception set") from KeyboardInterrupt()
        except SystemError as error:
            raise SystemError("returned a result with an exception set") from error

    monkeypatch.setattr(cli.entry, "_run", run)
    code, _, err = type_in(capsys, "run", "anything")
    assert code == 130
    assert "interrupted; the same command goes on" in err


EVERY = ("--set", "tracking.every_frame=true")


def frames_of(folder):
    return sorted(p.name for p in (folder / "out/frames").iterdir())


def test_a_frame_that_has_become_unusable_leaves_the_folder(capsys, sequence):
    assert type_in(capsys, "run", sequence, "--out", sequence / "out", *EVERY)[0] == 0
    (sequence / "left/001.png").write_bytes(b"no image")
    assert type_in(capsys, "run", sequence, "--out", sequence / "out", *EVERY)[0] == 4
    assert frames_of(sequence) == ["000000.json", "000000.npz", "000002.json", "000002.npz"]
    resumed = content(sequence / "out")
    shutil.rmtree(sequence / "out")
    type_in(capsys, "run", sequence, "--out", sequence / "out", *EVERY)
    fresh = content(sequence / "out")
    assert [name for name in fresh.keys() | resumed.keys() if fresh.get(name) != resumed.get(name)] == []
    code, line = complain(capsys, "export", sequence / "out", "--frame", "1")
    assert (code, "has no finished frame 1; expected one of its 2 frames" in line) == (3, True)


def test_a_frame_of_another_name_is_another_frame(capsys, sequence):
    type_in(capsys, "run", sequence, "--out", sequence / "out", *EVERY)
    for side in ("left", "right"):
        (sequence / side / "001.png").rename(sequence / side / "1b.png")
    type_in(capsys, "run", sequence, "--out", sequence / "out", *EVERY)
    assert read_frame(sequence / "out/frames/000001.npz").name == "1b"


def test_another_source_or_part_of_it_wants_another_folder(capsys, sequence):
    type_in(capsys, "run", sequence, "--out", sequence / "out")
    code, line = complain(capsys, "run", "--out", sequence / "out")
    assert code == 3
    assert 'source.name was "drive" and is now "motorcycle"' in line
    code, line = complain(capsys, "run", sequence, "--out", sequence / "out", "--frames", "0:2")
    assert code == 3
    assert "source.frames was null and is now [0, 2, 1]" in line


def test_bad_input_does_not_bind_the_folder_to_its_settings(capsys, pair_files):
    good = (pair_files / "left.png").read_bytes()
    (pair_files / "left.png").write_bytes(good[:5000])
    assert run_pair(capsys, pair_files)[0] == 3
    (pair_files / "left.png").write_bytes(good)
    assert run_pair(capsys, pair_files, "--set", "filter.order=2")[0] == 0


def test_the_settings_of_a_run_are_settings_for_another(capsys, pair_files):
    run_pair(capsys, pair_files, "--set", "filter.order=2")
    rows = json.loads(type_in(capsys, "config", "show", "--config", pair_files / "out/config.yaml", "--json")[1])
    assert rows["filter.order"]["value"] == 2


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are Unicode elsewhere")
@pytest.mark.parametrize("more", [{}, {"LC_ALL": "POSIX", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}])
def test_names_that_are_no_text_are_escaped(pair_files, more):
    for side in ("left", "right"):
        os.rename(pair_files / f"{side}.png", os.fsencode(pair_files) + f"/{side}".encode() + b"\xff\xc3\xa9.png")
    words = [b"run", b"left\xff\xc3\xa9.png", b"right\xff\xc3\xa9.png", b"--calib", b"calib.yaml", b"--out", b"out\xff"]
    command = [os.fsencode(sys.executable), b"-m", b"tspslam", *words]
    done = subprocess.run(command, cwd=pair_files, env=os.environ | more, capture_output=True)
    assert done.returncode == 0, done.stderr
    out = os.fsdecode(os.fsencode(pair_files) + b"/out\xff")
    assert json.loads(Path(out, "run.json").read_text())["source"].startswith("left\\udcff")
    assert os.path.getsize(f"{out}/report.html") > 100_000


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize(("streams", "code", "said"), [
    (">&-", 5, "standard output: is closed"), ("2>&-", 0, None), ("2>/dev/full", 0, None), ("| true", 0, ""),
    (">/dev/full", 5, "standard output: cannot be written"),
])  # fmt: skip
def test_closed_and_full_streams_lose_no_result(capsys, pair_files, streams, code, said):
    run_pair(capsys, pair_files)
    (pair_files / "out/run.json").unlink()  # to be made anew
    line = f"{sys.executable} -m tspslam run left.png right.png --calib calib.yaml --out out {streams}"
    script = line + ("; exit ${PIPESTATUS[0]}" if "|" in streams else "")
    done = subprocess.run(["bash", "-c", script], cwd=pair_files, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr
    assert said is None or said in done.stderr
    is_run = (pair_files / "out/run.json").exists()  # a closed stdout is seen before the work
    assert is_run == (streams != ">&-")
    assert not is_run or json.loads((pair_files / "out/run.json").read_text())["status"] == "complete"


def test_an_interruption_while_it_loads_is_one_line():
    script = (
        "import sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'tspslam.cli': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from tspslam.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "tspslam: interrupted\n")


def test_an_interruption_while_it_ends_is_too_late(pair_files):
    script = (
        "import atexit, os, signal, sys\n"
        "from tspslam.__main__ import main\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
        "sys.argv = ['tspslam', '--version']\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_changed_settings_are_refused_by_name(capsys, pair_files):
    run_pair(capsys, pair_files)
    code, line = complain(
        capsys, "run", pair_files / "left.png", pair_files / "right.png", "--calib", pair_files / "calib.yaml",
        "--out", pair_files / "out", "--set", "filter.order=2",
    )  # fmt: skip
    assert code == 3
    assert "filter.order" in line


def test_a_folder_that_is_not_ours_is_refused(capsys, pair_files):
    code, line = complain(
        capsys, "run", pair_files / "left.png", pair_files / "right.png", "--calib", pair_files / "calib.yaml",
        "--out", pair_files,
    )  # fmt: skip
    assert code == 3
    assert "run folder of ours" in line


def test_an_output_that_cannot_be_written_is_code_5(capsys, pair_files):
    code, line = complain(
        capsys, "run", pair_files / "left.png", pair_files / "right.png", "--calib", pair_files / "calib.yaml",
        "--out", pair_files / "left.png" / "out",
    )  # fmt: skip
    assert code == 5
    assert "left.png" in line


def test_a_full_disk_is_code_5_and_leaves_no_half_file(pair_files):
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000));"
        "import signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "from tspslam import cli; sys.exit(cli.exit_code(sys.argv[1:]))"
    )
    words = ["run", "left.png", "right.png", "--calib", "calib.yaml", "--out", "out"]
    done = subprocess.run([sys.executable, "-c", script, *words], cwd=pair_files, capture_output=True, text=True)
    assert done.returncode == 5, done.stderr
    assert "Traceback" not in done.stderr
    left = [p.name for p in (pair_files / "out").rglob("*") if p.is_file()]
    assert not any("tmp" in name or name.endswith(".npz") for name in left)
    assert len([line for line in done.stderr.splitlines() if not line.startswith(("compiling", "OPENCV"))]) == 1


def one_row(folder):
    for seed, side in enumerate(("left", "right")):  # not the same picture twice
        Image.fromarray(np.random.default_rng(seed).integers(0, 256, (1, 300), np.uint8)).save(folder / f"{side}.png")
    text = (folder / "calib.yaml").read_text()
    (folder / "calib.yaml").write_text(text.replace("height: 200", "height: 1"))


def one_spot(folder):
    for side, u in (("left", 150), ("right", 140)):
        image = np.zeros((200, 300), np.uint8)
        image[100, u] = 255
        Image.fromarray(image).save(folder / f"{side}.png")


@pytest.mark.parametrize(("spoil", "message"), [
    (lambda p: (p / "left.png").unlink(), "left.png"),
    (lambda p: (p / "left.png").write_bytes(b""), "empty"),
    (lambda p: (p / "left.png").write_bytes((p / "left.png").read_bytes()[:5000]), "left.png"),
    (lambda p: (p / "left.png").write_text("not an image"), "left.png"),
    (lambda p: Image.new("RGB", (100, 50)).save(p / "right.png"), "100"),
    (lambda p: Image.new("I;16", (300, 200)).save(p / "right.png"), "in colour, right"),
    (lambda p: [Image.new("L", (300, 200), 99).save(p / f"{s}.png") for s in ("left", "right")], "keypoint"),
    (lambda p: (p / "calib.yaml").write_text("fx: 500\n"), "calib.yaml"),
    (lambda p: one_row(p), "keypoint"),
    (lambda p: one_spot(p), "keypoint"),
])  # fmt: skip
def test_bad_input_is_one_line_and_code_3(capsys, pair_files, spoil, message):
    spoil(pair_files)
    code, line = complain(
        capsys, "run", pair_files / "left.png", pair_files / "right.png", "--calib", pair_files / "calib.yaml",
        "--out", pair_files / "out",
    )  # fmt: skip
    assert code == 3
    assert message in line


@pytest.mark.parametrize(("words", "message"), [
    (["nonsense"], "nonsense"),
    (["run", "--frobnicate"], "--frobnicate"),
    (["run", "a.png", "b.png"], "--calib"),
    (["run", "a", "b", "c"], "3 paths"),
    (["run", "--calib", "x.yaml"], "--calib"),
    (["run", "--detector", "surf"], "'surf', expected one of orb, sift, brisk, grid, onnx"),
    (["run", "--frames", "seven"], "'seven', expected A:B"),
    (["run", "--frames", "1:x"], "expected A:B"),
    (["filter", "a.obj", "--image", "a.png", "--calib", "c.yaml", "--polygons", "quads"], "'quads', expected fan or cells"),
    (["filter", "--cloud", "a.bin", "--image", "a.png", "--calib", "c.yaml", "--polygons", "cells"], "goes with a mesh"),
    (["run", "a.png", "--depth", "z.png"], "a map goes with one image, --calib"),
    (["run", "a.png", "--calib", "c.yaml", "--depth", "z.png", "--disparity", "d.png"], "either --depth or --disparity"),
    (["run", "a.png", "b.png", "--calib", "c.yaml", "--unit", "2"], "goes with depths: one folder, --depth or --disparity"),
    (["calib", "show", "x", "--size", "wide"], "'wide', expected WIDTHxHEIGHT"),
    (["export", "somewhere", "--to", "stl"], "expected one of vtu, ply, npz"),
    (["export", "somewhere", "--frame", "-1"], "--frame"),
])  # fmt: skip
def test_a_wrong_command_is_code_2(capsys, words, message):
    code, line = complain(capsys, *words)
    assert code == 2
    assert message in line


@pytest.mark.parametrize(("words", "message"), [
    (["run", "--frames", "5:9"], "selects none of the 1 frames"),
    (["run", "--set", "detector.cuont=3"], "did you mean detector.count?"),
    (["run", "--set", "detector.count=many"], "'many', expected an integer"),
    (["run", "--set", "count"], "expected key=value"),
    (["run", "--set", "filter.order=2020-01-01"], "'2020-01-01', expected an integer"),
    (["run", "--set", "filter.order=" + "9" * 5000], "not plain YAML"),
    (["run", "--set", "filter.order=" + "9" * 30], "a number too large, expected an integer"),
    (["run", "--set", "surface.min_angle=" + "9" * 400], "a number too large, expected a number"),
    (["run", "--set", "filter.order=" + "[" * 3000], "too many levels"),
    (["run", "--set", "filter.order=2000000"], "--set: filter.order is 2000000, expected 0 to 1000"),
    (["run", "--set", "surface.min_angle=90"], "--set: surface.min_angle is 90.0, expected 0 to 60"),
    (["run", "--set", "surface.significance=.nan"], "significance is nan"),
    (["run", "--set", "matcher.max_disparity=-50"], "max_disparity is -50 px, expected more than -31.086"),
    (["run", "--config", "/dev/zero"], "not a regular file"),
    (["run", "--set", "detector.kind=surf"], "detector.kind is 'surf', expected one of orb, sift, brisk"),
    (["run", "--set", "detector.kind=[1]"], "detector.kind is [1], expected one of"),
    (["run", "--detector", "sift", "--set", "detector.levels=3"], "detector.levels belongs to kind orb; detector.kind is sift"),
    (["run", "--preset", "best"], "expected one of default, paper"),
    (["run", "--config", "missing.yaml"], "missing.yaml"),
    (["run", "no-such-folder"], "no-such-folder"),
    (["export", "no-such-run"], "no-such-run"),
])  # fmt: skip
def test_a_wrong_value_is_code_3(capsys, words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # the default folder is below it
    code, line = complain(capsys, *words)
    assert code == 3
    assert message in line


def test_an_internal_error_is_one_line_and_code_1_and_debug_shows_it(capsys, monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("of ours")

    monkeypatch.setattr("tspslam.run.config.resolve", fail)
    code, line = complain(capsys, "config", "show")
    assert (code, line) == (1, "tspslam: internal error: ZeroDivisionError: of ours (--debug shows where)")
    with pytest.raises(ZeroDivisionError):
        cli.exit_code(["--debug", "config", "show"])


def test_config_show_says_where_each_value_came_from(capsys, tmp_path):
    (tmp_path / "my.yaml").write_text("filter: {order: 2}\nsurface: {min_angle: 5}\n")
    words = ["config", "show", "--preset", "paper", "--config", tmp_path / "my.yaml", "--set", "surface.min_angle=1"]
    rows = json.loads(type_in(capsys, *words, "--json")[1])
    found = {name: (row["value"], row["origin"]) for name, row in rows.items()}
    assert found["filter.order"] == (2, str(tmp_path / "my.yaml"))
    assert found["surface.min_angle"] == (1.0, "--set")
    assert found["filter.centering"] == ("none", "preset paper")
    assert found["detector.count"] == (2000, "default")
    lines = {line.split()[0]: line.split()[1:] for line in type_in(capsys, *words)[1].splitlines()}
    assert lines["surface.min_angle"] == ["1.0", "degrees", "0", "to", "60", "--set"]
    assert lines["filter.centering"][-2:] == ["preset", "paper"]


def test_config_show_of_a_name_says_what_it_means_and_why_it_is_so(capsys):
    text = type_in(capsys, "config", "show", "matcher.patches", "surface.min_angle")[1]
    names = [line.split()[0] for line in text.splitlines()[1:] if line[0] != " "]
    assert names == ["matcher.patches.radius", "matcher.patches.contrast", "surface.min_angle"]
    assert "slivers" in text
    assert "Default 3.0: by hand; Motorcycle" in text
    row = json.loads(type_in(capsys, "config", "show", "surface.min_angle", "--json")[1])["surface.min_angle"]
    assert (row["low"], row["high"], row["unit"], row["range"]) == (0, 60, "degrees", "0 to 60")
    assert set(row) == {"value", "origin", "default", "unit", "low", "high", "range", "source", "meaning"}
    code, line = complain(capsys, "config", "show", "surface.min_angel")
    assert code == 3
    assert "unknown setting 'surface.min_angel'; did you mean surface.min_angle?" in line


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("stage", "kind"), [(stage, kind) for stage, kinds in KINDS.items() for kind in kinds])
def test_config_show_is_a_table_of_120_columns(capsys, preset, stage, kind):
    lines = type_in(capsys, "config", "show", "--preset", preset, "--set", f"{stage}.kind={kind}")[1].splitlines()
    assert max(map(len, lines)) <= 120
    assert lines[0].split() == ["setting", "value", "unit", "range", "from"]
    origin = lines[0].index("from")
    assert {line[origin - 2 : origin] for line in lines} == {"  "}
    assert {line[origin:] for line in lines[1:]} <= {"default", f"preset {preset}", "--set"}


@pytest.mark.parametrize(("text", "message"), [
    ("a: &x 1\nb: *x\n", "anchors and aliases"), ("a: &x 1\n", "anchors and aliases"),
    ("filter: {order: 1, order: 2}\n", "the key order is there twice"), ("- 1\n", "mapping of stages"), ("a: [", "not plain YAML"),
    ("filter: 3\n", "unknown setting 'filter'"), ("filter: {order: true}\n", "True, expected an integer"),
])  # fmt: skip
def test_a_settings_file_that_is_wrong_is_named(capsys, tmp_path, text, message):
    (tmp_path / "my.yaml").write_text(text)
    code, line = complain(capsys, "config", "show", "--config", tmp_path / "my.yaml")
    assert code == 3
    assert "my.yaml" in line
    assert message in line


def test_values_that_depend_on_each_other_are_set_together(capsys):
    words = ["--set", "matcher.min_disparity=50", "--set", "matcher.max_disparity=100"]
    rows = json.loads(type_in(capsys, "config", "show", "--preset", "paper", *words, "--json")[1])
    assert (rows["matcher.min_disparity"]["value"], rows["matcher.max_disparity"]["value"]) == (50, 100)


def test_every_kind_of_stage_can_be_chosen_and_set():
    for stage, kinds in KINDS.items():
        for name, kind in kinds.items():
            resolved = resolve(assignments=[f"{stage}.kind={name}"])
            assert type(getattr(resolved.settings, stage)) is kind
            assert resolved.nested[stage]["kind"] == name
    resolved = resolve("paper", assignments=["detector.kind=sift", "detector.layers=4"])
    assert resolved.settings.detector == SiftDetector(layers=4)
    assert resolved.origin["matcher.kind"] == "preset paper"


@pytest.mark.parametrize("detector", ["sift", "brisk"])
def test_other_detectors_run_and_bind_the_folder(capsys, pair_files, detector):
    assert run_pair(capsys, pair_files, "--detector", detector)[0] == 0
    code, _, err = run_pair(capsys, pair_files)
    assert code == 3
    assert f'detector.kind was "{detector}" and is now "orb"' in err


def test_whole_and_broken_numbers_are_the_same_setting():
    assert repr(resolve(assignments=["matcher.max_disparity=64"])) == repr(
        resolve(assignments=["matcher.max_disparity=64.0"])
    )


def test_export_writes_a_frame_in_each_format(capsys, pair_files):
    run_pair(capsys, pair_files)
    out = pair_files / "out"
    for to in ("vtu", "ply", "npz"):
        code, said, _ = type_in(capsys, "export", out, "--to", to, "--output", pair_files / f"copy.{to}")
        assert (code, said) == (0, f"wrote {pair_files / f'copy.{to}'}\n")
    assert (pair_files / "copy.vtu").read_bytes() == (out / "map.vtu").read_bytes()
    assert (pair_files / "copy.npz").read_bytes() == (out / "frames/000000.npz").read_bytes()
    assert len(read_ply(pair_files / "copy.ply").xyz) == len(read_frame(out / "frames/000000.npz").cloud)
    assert complain(capsys, "export", out, "--frame", "7")[0] == 3


def plane_mesh(folder, rig, depth=3.0):
    v, u = np.mgrid[20:180:20, 20:280:20].astype(float)
    xyz = np.stack([(u - rig.cx) * depth / rig.fx, (v - rig.cy) * depth / rig.fy, np.full(u.shape, depth)], -1)
    here = (np.arange(7)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.concatenate([np.stack([here, here + 1, here + 13], 1), np.stack([here + 1, here + 14, here + 13], 1)])
    points = np.concatenate([xyz.reshape(-1, 3), [[0, 0, -1.0], [90.0, 0, 1.0]]])
    write_ply(folder / "plane.ply", points, faces, vertex={}, face={})
    return points, faces


def test_filter_answers_on_a_mesh_and_a_posed_image(capsys, pair_files, small_pair):
    points, faces = plane_mesh(pair_files, small_pair[2])
    words = [
        "filter",
        pair_files / "plane.ply",
        "--image",
        pair_files / "left.png",
        "--calib",
        pair_files / "calib.yaml",
    ]
    code, out, err = type_in(capsys, *words, "--out", pair_files / "out", "--centering", "plane", "--json")
    result = json.loads(out)
    assert code == 0
    assert result["complex"] == {"n": len(points), "edges": 271, "faces": len(faces), "euler": 3}
    assert result["defined"] == len(points) - 2
    assert "2 of 106 vertices are hidden, outside the image or behind" in err
    stored = read_frame(pair_files / "out/frames/000000.npz").cloud
    assert np.isnan([*stored.uv[104], stored.disparity[104]]).all()
    assert stored.uv[105, 0] > 1000  # outside the image, where it is
    assert read_vtu(pair_files / "out/map.vtu").point_data["ok"].tolist() == [1] * 104 + [0, 0]
    assert (pair_files / "out/report.html").exists()
    before = content(pair_files / "out")
    assert type_in(capsys, *words, "--out", pair_files / "out", "--centering", "plane")[0] == 0
    assert content(pair_files / "out") == before


def test_a_vertex_in_the_lens_has_no_disparity(capsys, pair_files):
    points = [[0, 0, 1e-310], [0.1, 0, 2], [0, 0.1, 2], [-0.1, 0, 2]]
    write_ply(pair_files / "near.ply", points, [[0, 1, 2], [1, 2, 3]], vertex={}, face={})
    words = ["--image", pair_files / "left.png", "--calib", pair_files / "calib.yaml", "--out", pair_files / "out"]
    assert type_in(capsys, "filter", pair_files / "near.ply", *words)[0] == 0
    assert np.isnan(read_frame(pair_files / "out/frames/000000.npz").cloud.disparity).tolist() == [True] + 3 * [False]


def test_filter_names_what_does_not_fit(capsys, pair_files, small_pair):
    plane_mesh(pair_files, small_pair[2], depth=-3.0)
    words = ["filter", pair_files / "plane.ply", "--calib", pair_files / "calib.yaml", "--out", pair_files / "out"]
    write_ply(pair_files / "plane.ply", np.eye(3) * -5, [[0, 1, 2]], vertex={}, face={})
    code, line = complain(capsys, *words, "--image", pair_files / "left.png")
    assert (code, "none of 3 vertices falls into the image" in line) == (3, True)
    Image.new("L", (30, 20)).save(pair_files / "small.png")
    code, line = complain(capsys, *words, "--image", pair_files / "small.png")
    assert (code, "300 x 200 px" in line) == (3, True)
    write_ply(pair_files / "plane.ply", [[0, 0, 1], [1, 0, 1], [0, 1, 1e300]], [[0, 1, 2]], vertex={}, face={})
    code, line = complain(capsys, *words, "--image", pair_files / "left.png")
    assert (code, "vertex 2 is at [0.0, 1.0, 1e+300], expected metres, at most 1e+09" in line) == (3, True)
    code, line = complain(capsys, *words, "--image", pair_files / "left.png", "--order", "-1")
    assert (code, "order is -1" in line) == (3, True)


def filtered(capsys, folder, name, points, faces, *more):
    """Exit code, record and warnings of `filter` on a mesh that is written here."""
    write_ply(folder / f"{name}.ply", points, faces, vertex={}, face={})
    words = [
        "--image",
        folder / "left.png",
        "--calib",
        folder / "calib.yaml",
        "--out",
        folder / f"out{len(more)}-{name}",
    ]
    code, out, err = type_in(capsys, "filter", folder / f"{name}.ply", *words, "--json", *more)
    told = [json.loads(line) if line.startswith("{") else {"error": line} for line in err.splitlines()]
    said = [said for each in told for kind, said in each.items() if kind in ("warning", "error")]
    return code, json.loads(out) if out else {}, said


def test_a_triangle_soup_is_degraded_and_its_merged_corners_are_the_mesh(capsys, pair_files, small_pair):
    points, faces = plane_mesh(pair_files, small_pair[2])
    soup, corners = points[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    code, record, said = filtered(capsys, pair_files, "soup", soup, corners)
    assert (code, record["status"], record["complex"]["edges"]) == (4, "degraded", 3 * len(faces))
    assert said == [f"no edge is shared by two of the {len(faces)} faces: merge corners with --merge-corners"]
    code, record, said = filtered(capsys, pair_files, "soup", soup, corners, "--merge-corners")
    assert (code, record["complex"]["edges"], record["warnings"], said) == (0, 271, [], [])


def quads(folder, name, rig, *, is_soup=False):
    """A plane of 7 x 12 quads as an OBJ; of a soup each has corners of its own."""
    points, _ = plane_mesh(folder, rig)
    here = (np.arange(7)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.stack([here, here + 1, here + 14, here + 13], 1)
    points = points[faces.ravel()] if is_soup else points[:104]
    faces = np.arange(faces.size).reshape(-1, 4) if is_soup else faces
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()] + [f"f {' '.join(map(str, f))}" for f in faces + 1]
    (folder / name).write_text("\n".join(lines))
    return folder / name


def test_faces_of_four_corners_are_cells_by_choice(capsys, pair_files, small_pair):
    words = ["--image", pair_files / "left.png", "--calib", pair_files / "calib.yaml", "--json"]
    found = {}
    for name, is_soup, more in (
        ("fan", False, []),
        ("cells", False, ["--polygons", "cells"]),
        ("merged", True, ["--polygons", "cells", "--merge-corners"]),
        ("soup", True, ["--polygons", "cells"]),
    ):
        mesh = quads(pair_files, f"{name}.obj", small_pair[2], is_soup=is_soup)
        code, out, err = type_in(capsys, "filter", mesh, *words, *more, "--out", pair_files / name)
        assert code == (4 if name == "soup" else 0)
        assert "84 faces of the mesh have more than three corners: they are c" in err
        found[name] = json.loads(out)["complex"], read_frame(pair_files / name / "frames/000000.npz")
    assert found["fan"][0] == {"n": 104, "edges": 271, "faces": 168, "euler": 1}
    assert found["cells"][0] == found["merged"][0] == {"n": 104, "edges": 187, "faces": 84, "euler": 1}
    assert found["soup"][0] == {"n": 336, "edges": 336, "faces": 84, "euler": 84}
    fan, cells, merged = (found[name][1] for name in ("fan", "cells", "merged"))
    assert len(cells.surface.faces) == 168
    triangles = build_complex(cells.surface.faces, 104)
    joined = merge_cells(triangles, np.arange(168) // 2)
    signals = merge_signals(triangles, np.arange(168) // 2, cells.signals)
    np.testing.assert_array_equal(cells.response.z, tmahf(joined, cells.cloud.uv, signals).z)
    assert np.abs(cells.response.z - fan.response.z).max() > 1e-3 * np.abs(fan.response.z).max()
    np.testing.assert_allclose(np.sort(np.abs(merged.response.z)), np.sort(np.abs(cells.response.z)), atol=1e-12)


def test_a_mesh_that_is_cut_along_a_seam_and_in_mm_is_said_to_be(capsys, pair_files, small_pair):
    points, faces = plane_mesh(pair_files, small_pair[2])
    cut = np.where(np.arange(len(faces))[:, None] < 80, faces, faces + len(points))
    code, record, said = filtered(capsys, pair_files, "seam", 1000 * np.concatenate([points, points]), cut)
    assert (code, record["status"]) == (0, "complete")
    assert "corners of faces are where another is: edges there are not shared; merge corners with" in said[-2]
    assert "the mesh is 3000 m away in the median, a disparity of 0.064 px: is it in millimetres?" in said[-1]


def test_a_mesh_that_cannot_be_filtered_is_one_line(capsys, pair_files, small_pair):
    points, faces = plane_mesh(pair_files, small_pair[2])
    for name, given, said in (
        ("flat", ([[0, 0, 3]] * 3, [[0, 1, 2]], "--merge-corners"), "has no face whose corners are at three places"),
        ("behind", (points[:-2] * [1, 1, -1], faces), "none of 104 vertices falls into the image (all are behind the"),
        ("cloud", (points, np.empty((0, 3), int)), "has 106 vertices and no faces"),
    ):
        code, _, lines = filtered(capsys, pair_files, name, *given)
        assert (code, len(lines), said in lines[0]) == (3, 1, True)


def test_the_version_is_printed(capsys):
    assert type_in(capsys, "--version")[:2] == (0, "0.1.0\n")
