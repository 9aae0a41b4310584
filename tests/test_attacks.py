"""Odd inputs, over all commands and the API, that once gave a wrong or silent result: each kind in one test."""

import json
import os
import subprocess
import sys
import threading
import warnings

import numpy as np
import pytest
from PIL import Image

from tspslam import (
    GeometryError,
    InputError,
    Session,
    StereoPair,
    build_complex,
    edge_flow,
    load_run,
    read_pair,
    reconstruct,
)
from tspslam.datasets import StereoFolder
from tspslam.io import read_trajectory, write_tum
from tspslam.session import Settings
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.features.orb import OrbDetector

from .datasets import standard
from .test_cli import complain, run_pair, type_in


@pytest.mark.parametrize("words", [
    ["run", ""], ["run", "a", "b", "--calib", ""], ["run", "a", "--out="], ["export", ""], ["eval", "", "--truth", "x"],
    ["filter", "a.ply", "--image", "", "--calib", "c"], ["calib", "show", ""], ["config", "show", "--config", ""], [""],
])  # fmt: skip
def test_an_unset_variable_of_the_shell_is_not_the_folder_one_is_in(capsys, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    code, line = complain(capsys, *words)
    assert (code, "is a variable of the shell unset?" in line) == (2, True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("read", [load_run, read_trajectory, StereoFolder, lambda path: read_pair(path, "b", "c")])
def test_an_empty_path_names_nothing(read):
    with pytest.raises(InputError, match="is empty, expected the path of a file"):
        read("")


def test_values_that_end_in_an_equals_sign_are_values(capsys):
    assert type_in(capsys, "config", "show", "--set", "detector.kind=onnx", "--set=detector.path=")[0] == 0


@pytest.mark.skipif(os.name == "nt", reason="a folder in use cannot be deleted there")
@pytest.mark.parametrize("words", [
    ["calib", "convert", "{}/calib.yaml", "out.yaml"], ["export", "run"], ["export", "{}/none", "--output", "o.vtu"],
    ["eval", "{0}/a.tum", "--truth", "{0}/a.tum", "--plot", "a.png"],
])  # fmt: skip
def test_a_deleted_working_folder_is_no_internal_error(capsys, tmp_path, monkeypatch, small_pair, words):
    save_cameras(small_pair[2], tmp_path / "calib.yaml")
    write_tum(tmp_path / "a.tum", np.arange(5), standard.poses(5))
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert complain(capsys, *(word.format(tmp_path) for word in words))[0] in (3, 5)


@pytest.mark.parametrize("backend", ["qt4agg", "module://no_such_module", ""])
def test_pictures_need_no_window_whatever_backend_the_environment_names(tmp_path, backend):
    write_tum(tmp_path / "a.tum", np.arange(5), standard.poses(5))
    path = str(tmp_path / "a.tum")
    command = [sys.executable, "-m", "tspslam", "eval", path, "--truth", path, "--plot", str(tmp_path / "a.png")]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"MPLBACKEND": backend})
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "a.png").stat().st_size > 0


def test_numbers_of_frames_and_sizes_are_plain(capsys, sequence, tmp_path):
    for text in ("1_0:", "\u0661:\u0662", ":\uff12"):
        code, line = complain(capsys, "run", sequence, "--frames", text, "--out", tmp_path / "out")
        assert (code, "expected A:B with integers" in line) == (2, True)
    assert complain(capsys, "calib", "show", sequence / "calib.yaml", "--size", "\u0663x\u0662")[0] == 2
    assert not (tmp_path / "out").exists()


def write_dark(folder, factor):
    for side in ("left", "right"):
        grey = np.asarray(Image.open(folder / f"{side}.png").convert("L")).astype(np.uint16)
        Image.fromarray(grey * factor).save(folder / f"{side}.png")


def test_images_too_dark_for_a_keypoint_lead_to_bits(capsys, pair_files):
    write_dark(pair_files, 4)  # 8 bits moved up by two: aligned to the left of 14 bits, or in 10 of them
    code, line = complain(capsys, *run_words(pair_files))
    assert (code, "1020 of 65535; do they use fewer bits (--bits)?" in line) == (3, True)
    code, line = complain(capsys, *run_words(pair_files), "--bits", "8")
    assert (code, line.endswith("expected bits=10 to be given (--bits 10)")) == (3, True)
    assert run_pair(capsys, pair_files, "--bits", "10")[0] == 0


def test_a_black_image_is_not_asked_for_bits(small_pair):
    rig = small_pair[2]
    black = np.zeros((rig.height, rig.width), np.uint16)
    with pytest.raises(GeometryError, match=r"too little texture$"):
        reconstruct(StereoPair(black, black, rig))


def run_words(folder):
    files = folder / "left.png", folder / "right.png"
    return "run", *files, "--calib", folder / "calib.yaml", "--out", folder / "out"


def test_the_bits_of_a_sequence_are_said_though_it_begins_with_8_bit_images(capsys, sequence, tmp_path):
    for side in ("left", "right"):
        file = sequence / side / "002.png"
        grey = np.asarray(Image.open(file).convert("L")).astype(np.uint16)
        Image.fromarray(grey * 4 + 1).save(file)
    code, _, err = type_in(capsys, "run", sequence, "--out", tmp_path / "out")
    assert (code, "16-bit pixels use 10 bits" in err) == (0, True)


def test_a_mesh_without_any_response_is_degraded(capsys, pair_files):
    (pair_files / "one.obj").write_text("v -.3 -.3 3\nv .3 -.3 3\nv 0 .3 3\nf 1 2 3\n")  # one corner is in the image
    words = "--image", pair_files / "left.png", "--calib", pair_files / "calib.yaml", "--out", pair_files / "out"
    code, out, err = type_in(capsys, "filter", pair_files / "one.obj", *words)
    assert (code, out.startswith("degraded: ")) == (4, True)
    assert "warning: no vertex has a response" in err


def test_an_unknown_value_in_metres_is_not_taken_for_none(capsys, pair_files):
    depth = np.full((200, 300), 2000, np.uint16) + np.arange(300, dtype=np.uint16)
    depth[:, :90] = 65535
    Image.fromarray(depth).save(pair_files / "z.png")
    words = ["run", pair_files / "left.png", "--depth", pair_files / "z.png", "--calib", pair_files / "calib.yaml"]
    words += ["--unit", "0.001", "--out", pair_files / "out"]
    code, line = complain(capsys, *words, "--unknown", "65.535")
    assert (code, line.endswith("not in the map; expected its own step, 65535")) == (3, True)
    assert complain(capsys, *words, "--unknown", "65.535", "--unit", "1e-9")[0] == 3
    assert type_in(capsys, *words, "--unknown", "65535")[0] == 0


@pytest.fixture(scope="module")
def pairs(small_pair):
    left, right, rig = small_pair
    return [StereoPair(left, right, rig, name=str(k), index=k, stamp=float(k)) for k in range(4)]


def test_two_threads_in_one_session_leave_an_ordered_path(pairs):
    refused, stages = [], Settings(detector=OrbDetector(count=300))

    def go(pair):
        try:
            session.process(pair)
        except InputError as error:
            refused.append(str(error))

    with Session(pairs[0].rig, stages) as session:
        threads = [threading.Thread(target=go, args=(pair,)) for pair in pairs]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        path = session.finish()
        assert len(session.odometry.map.keyframes) == 1
    assert (np.diff(path.stamp) > 0).all()
    assert len(path) + len(refused) == len(pairs)
    assert all("or later" in line for line in refused)


def test_a_session_is_closed_between_two_frames_not_within_one(pairs):
    entered, go_on, done = threading.Event(), threading.Event(), []
    detect = OrbDetector(count=300)

    def slow(image):
        entered.set()
        assert go_on.wait(60)
        return detect(image)

    session = Session(pairs[0].rig, Settings(detector=slow))
    worker = threading.Thread(target=lambda: done.append(session.process(pairs[0])))
    worker.start()
    assert entered.wait(60)
    closer = threading.Thread(target=session.close)
    closer.start()
    go_on.set()
    worker.join()
    closer.join()
    assert len(done[0].response) == len(done[0].cloud)
    with pytest.raises(InputError, match="is closed"):
        session.process(pairs[1])


@pytest.mark.parametrize("field", [[[np.inf] * 3] * 3, [[np.inf] * 3, [-np.inf] * 3, [0] * 3], [[1e300] * 3] * 3])
def test_fields_beyond_numbers_are_one_error_and_no_warning(field):
    xyz = np.array([[0, 0, 0], [1e200, 0, 0], [0, 1e200, 0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=r"at edge \[0, 1\], or their product is too large"):
            edge_flow(build_complex([[0, 1, 2]]), xyz, np.array(field))


def test_a_run_whose_path_or_record_was_changed_is_not_read(capsys, pair_files):
    assert run_pair(capsys, pair_files)[0] == 0
    out = pair_files / "out"
    path, record = (out / "trajectory.tum").read_bytes(), (out / "run.json").read_bytes()
    (out / "trajectory.tum").write_bytes(path + b"5.0 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"trajectory.tum: is missing or was changed since the run"):
        load_run(out).trajectory  # noqa: B018
    (out / "trajectory.tum").write_bytes(path)
    (out / "run.json").write_text(json.dumps(json.loads(record) | {"frames": 7}))
    with pytest.raises(InputError, match=r"run.json: is missing or was changed since the run"):
        load_run(out)
    (out / "run.json").write_bytes(record)
    assert len(load_run(out).trajectory) == 1
