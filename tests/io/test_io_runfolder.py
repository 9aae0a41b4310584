import errno
import json
import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError, OutputError
from tspslam.io import RunFolder
from tspslam.io._config import differences, dump, hash_of, load, plain
from tspslam.io._places import is_result
from tspslam.io.lock import FolderLock
from tspslam.io.manifest import Unit, append_unit, read_manifest, sha256_file

FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
CONFIG = {"detector": "orb", "limits": {"disparity": 48.5, "frames": None}, "levels": [1, 2]}


def create(tmp_path, config=CONFIG):
    return RunFolder.create(tmp_path / "run", config)


def finish(run, index=0, data=b"a frame", input_hash="pair"):
    run.frame_path(index).write_bytes(data)
    return run.record(run.frame_path(index), input_hash=input_hash)


def test_a_run_resumes_where_it_stopped(tmp_path):
    with create(tmp_path) as run:
        unit = finish(run)
        assert (unit.name, unit.bytes, unit.input) == ("frames/000000.npz", 7, "pair")
    with create(tmp_path) as run:
        assert run.units == {unit.name: unit}
        assert run.is_done(run.frame_path(0), input_hash="pair")
        assert not run.is_done(run.frame_path(0), input_hash="another pair")
        assert not run.is_done(run.frame_path(1), input_hash="pair")


@pytest.mark.parametrize("data", [b"A frame", b"longer frame", b"", None])
def test_a_unit_whose_file_changed_is_not_done(tmp_path, data):
    with create(tmp_path) as run:
        finish(run)
        run.frame_path(0).unlink()
        if data is not None:
            run.frame_path(0).write_bytes(data)
        assert not run.is_done(run.frame_path(0), input_hash="pair")


def test_a_unit_done_again_counts_as_its_last(tmp_path):
    with create(tmp_path) as run:
        finish(run)
        finish(run, data=b"better", input_hash="pair 2")
    with create(tmp_path) as run:
        assert run.is_done(run.frame_path(0), input_hash="pair 2")


def test_the_settings_stand_in_the_folder_as_plain_yaml_and_are_the_same_bytes_each_time(tmp_path):
    with create(tmp_path) as run:
        text = (run.path / "config.yaml").read_bytes()
        assert yaml.safe_load(text) == CONFIG
    assert dump(plain(dict(reversed(CONFIG.items())))) == text


def test_a_folder_without_a_finished_unit_takes_new_settings(tmp_path):
    create(tmp_path, {"detector": "sift"}).close()
    with create(tmp_path) as run:
        finish(run)
    assert load((tmp_path / "run" / "config.yaml").read_bytes()) == CONFIG


def test_only_units_that_are_kept_stay(tmp_path):
    with create(tmp_path) as run:
        for index in (2, 0, 1):
            finish(run, index)
        (run.path / "frames" / "notes.txt").write_text("of the user")
        run.keep(["frames/000002.npz", "frames/000000.npz"])
        assert sorted(p.name for p in (run.path / "frames").iterdir()) == ["000000.npz", "000002.npz", "notes.txt"]
        assert list(run.units) == ["frames/000000.npz", "frames/000002.npz"]
    assert list(RunFolder.open(tmp_path / "run").units) == ["frames/000000.npz", "frames/000002.npz"]


def test_only_a_finished_and_unchanged_frame_is_given_out(tmp_path):
    with create(tmp_path) as run:
        finish(run)
        run.frame_path(1).write_bytes(b"not finished")
    run = RunFolder.open(tmp_path / "run")
    assert run.finished_frame(0) == run.frame_path(0)
    with pytest.raises(InputError, match="has no finished frame 1; expected one of its 1 frames"):
        run.finished_frame(1)
    run.frame_path(0).write_bytes(b"changed")
    with pytest.raises(InputError, match=r"000000.npz: is missing or was changed since the run"):
        run.finished_frame(0)


def test_another_config_is_refused_and_the_key_is_named(tmp_path):
    with create(tmp_path) as run:
        finish(run)
    other = {"detector": "sift", "limits": {"disparity": 48.5}, "levels": [1, 2], "new": True}
    with pytest.raises(InputError) as caught:
        create(tmp_path, other)
    said = str(caught.value)
    assert 'detector was "orb" and is now "sift"' in said
    assert "limits.frames was null and is now absent" in said
    assert "new was absent and is now true" in said
    assert "disparity" not in said
    create(tmp_path).close()


def test_of_very_different_settings_some_are_named(tmp_path):
    with create(tmp_path, {"a": "x" * 10_000, **{f"key{k}": k for k in range(100)}}) as run:
        finish(run)
    with pytest.raises(InputError, match=r"a was \"xxx.*; and 91 more; expected") as caught:
        create(tmp_path, {})
    assert len(str(caught.value)) < 1500


def test_a_config_edited_in_form_only_is_the_same(tmp_path):
    create(tmp_path).close()
    path = tmp_path / "run" / "config.yaml"
    path.write_text(path.read_text() + "\n# a note\n")
    create(tmp_path).close()


def test_true_is_not_one():
    assert differences({"a": True}, {"a": 1}) == ["a was true and is now 1"]
    assert differences([1], {"a": 1}) == ['the whole was [1] and is now {"a": 1}']


@settings(max_examples=60, deadline=None)
@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(2**60), 2**60)
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=8,
    )
)
def test_settings_read_back_from_yaml_as_they_were(config):
    back = load(dump({"config": plain(config)}))
    assert differences(back, {"config": config}) == []
    assert hash_of(back) == hash_of({"config": config})


@pytest.mark.parametrize("value", [np.nan, np.inf, object(), b"bytes", {1: 2}, np.zeros(2), 1 << 63])
def test_settings_that_are_not_plain_are_refused(tmp_path, value):
    with pytest.raises(InputError, match=r"deep\.key"):
        create(tmp_path, {"deep": {"key": value}})
    assert not (tmp_path / "run").exists()


def test_settings_that_are_no_mapping_or_too_deep_are_refused(tmp_path):
    with pytest.raises(InputError, match="mapping"):
        create(tmp_path, ["a"])
    deep = {}
    for _ in range(50):
        deep = {"a": deep}
    with pytest.raises(InputError, match="config"):
        create(tmp_path, deep)


@pytest.mark.parametrize("name", ["precious.txt", "config.yaml", "manifest.jsonl"])
def test_a_folder_that_is_not_ours_is_refused_and_left_alone(tmp_path, name):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).write_text("mine")
    with pytest.raises(InputError, match=name):
        create(tmp_path)
    assert [path.name for path in (tmp_path / "run").iterdir()] == [name]
    assert (tmp_path / "run" / name).read_text() == "mine"


def test_an_empty_folder_and_one_of_an_interrupted_start_are_taken(tmp_path):
    (tmp_path / "run").mkdir()
    create(tmp_path).close()
    (tmp_path / "run" / "config.yaml").unlink()
    for part in ("frames", "pictures"):
        (tmp_path / "run" / part).rmdir()
    (tmp_path / "run" / ".lock").write_text("1\n")
    (tmp_path / "run" / ".tspslam-0.tmp").write_text("torn")
    create(tmp_path).close()
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["config.yaml", "frames", "pictures"]


def test_temporary_files_of_a_killed_run_are_swept(tmp_path):
    with create(tmp_path) as run:
        (run.path / "frames" / ".tspslam-abc.tmp").write_bytes(b"torn")
        (run.path / "frames" / "mine.tmp").write_bytes(b"kept")
    with create(tmp_path) as run:
        assert [path.name for path in (run.path / "frames").iterdir()] == ["mine.tmp"]


@pytest.mark.parametrize("torn", [b'{"name": "fra', b"\0\0\0\0", b'{"name": 1}\n', b"[" * 5000 + b"\n"])
def test_a_torn_last_line_of_the_manifest_is_dropped(tmp_path, torn):
    with create(tmp_path) as run:
        finish(run)
    with open(tmp_path / "run" / "manifest.jsonl", "ab") as handle:
        handle.write(torn)
    assert list(RunFolder.open(tmp_path / "run").units) == ["frames/000000.npz"]
    with create(tmp_path) as run:
        finish(run, 1)
    assert len(RunFolder.open(tmp_path / "run").units) == 2
    assert len((tmp_path / "run" / "manifest.jsonl").read_bytes().splitlines()) == 2


def test_a_damaged_line_within_the_manifest_is_an_input_error(tmp_path):
    with create(tmp_path) as run:
        finish(run, 0)
        finish(run, 1)
    path = tmp_path / "run" / "manifest.jsonl"
    path.write_bytes(b"{" + path.read_bytes())
    with pytest.raises(InputError, match="line 1 is damaged"):
        create(tmp_path)
    # The lock is free again.
    FolderLock(tmp_path / "run").release()


@FUZZ
@given(data=st.data())
def test_a_damaged_manifest_or_config_is_read_or_an_input_error(tmp_path, data):
    with RunFolder.create(tmp_path / "fuzz", CONFIG) as run:
        for index in (0, 1):
            if not run.is_done(run.frame_path(index), input_hash="pair"):
                finish(run, index)
    name = data.draw(st.sampled_from(["manifest.jsonl", "config.yaml"]))
    path = tmp_path / "fuzz" / name
    source = path.read_bytes()
    damaged = bytearray(source)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(damaged)
    said = ""
    try:
        units = RunFolder.open(tmp_path / "fuzz").units
    except InputError as error:
        said = str(error)
    path.write_bytes(source)
    assert "\n" not in said
    if not said:
        assert all(isinstance(unit, Unit) for unit in units.values())


HEAD = "# tspslam run, format 3\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "a: &x 1\nb: *x\n", "aliases are not allowed"),
        (HEAD + "a: !!python/object:os.system 1\n", "the tag .* is not allowed"),
        (HEAD + "a: 1\na: 2\n", "there twice"),
        (HEAD + "a: [1\n", "plain YAML"),
        (HEAD + "[" * 200_000, "levels"),
        (HEAD + "a: " + "x" * (1 << 18), "bytes"),
        (HEAD + "- 1\n", "no mapping"),
        (HEAD, "no mapping"),
        ("a: 1\n", "no config.yaml of a run"),
    ],
)
def test_a_damaged_config_is_an_input_error(tmp_path, text, said):
    create(tmp_path).close()
    (tmp_path / "run" / "config.yaml").write_text(text)
    with pytest.raises(InputError, match=said) as caught:
        RunFolder.open(tmp_path / "run")
    assert "\n" not in str(caught.value)


def test_no_folder_is_no_run(tmp_path):
    with pytest.raises(InputError, match=r"no config\.yaml"):
        RunFolder.open(tmp_path / "missing")


def test_results_are_sorted_plain_json_and_read_back(tmp_path):
    with create(tmp_path) as run:
        run.write_run({"status": "complete", "frames": 3, "name": "Straße \udcff"})
        run.write_timings({"seconds": 0.5})
        assert run.read_run()["name"] == "Straße \udcff"
        assert run.read_timings() == {"seconds": 0.5}
        assert list(json.loads((run.path / "run.json").read_text("utf-8"))) == ["frames", "name", "status"]
        for bad in ({"a": np.nan}, {"a": object()}):
            with pytest.raises(InputError, match="plain JSON"):
                run.write_run(bad)
        assert run.read_run()["frames"] == 3


@pytest.mark.parametrize("data", [b"{", b"[1]", b"[" * 10_000, b"\xff"])
def test_damaged_results_are_an_input_error(tmp_path, data):
    with create(tmp_path) as run:
        with pytest.raises(InputError, match="No such file"):
            run.read_run()
        (run.path / "run.json").write_bytes(data)
        with pytest.raises(InputError, match="JSON"):
            run.read_run()


def test_both_forms_of_the_trajectory_are_written(tmp_path):
    with create(tmp_path) as run:
        run.write_trajectory([0.0, 0.1], np.tile(np.eye(4), (2, 1, 1)))
        assert (run.path / "trajectory.tum").read_text().splitlines()[1] == "0.1 0.0 0.0 0.0 0.0 0.0 0.0 1.0"
        assert len((run.path / "trajectory.kitti.txt").read_text().splitlines()) == 2


def test_every_file_has_its_place(tmp_path):
    with create(tmp_path) as run:
        maps = [run.map_npz_path, run.landmarks_path, run.map_vtu_path, run.map_ply_path]
        places = [run.frame_path(7), run.picture_path("phase-1"), run.report_path, *maps]
        names = [place.relative_to(run.path).as_posix() for place in places]
        stems = ["map.npz", "landmarks.npz", "map.vtu", "map.ply"]
        assert names == ["frames/000007.npz", "pictures/phase-1.png", "report.html", *stems]
        assert all(map(is_result, names))
        for name in ("", "../a", "a.b", "a/b"):
            with pytest.raises(InputError, match="picture"):
                run.picture_path(name)


def test_two_runs_of_the_same_work_leave_the_same_bytes(tmp_path):
    def tree(name):
        with RunFolder.create(tmp_path / name, CONFIG) as run:
            finish(run)
            run.write_run({"frames": 1})
        return {path.name: path.read_bytes() for path in (tmp_path / name).rglob("*") if path.is_file()}

    assert tree("a") == tree("b")


def test_a_file_elsewhere_or_missing_is_not_recorded(tmp_path):
    (tmp_path / "other").write_bytes(b"x")
    with create(tmp_path) as run:
        with pytest.raises(InputError, match="not in this run folder"):
            run.record(tmp_path / "other", input_hash="")
        with pytest.raises(InputError, match="No such file"):
            run.record(run.frame_path(0), input_hash="")
    assert run.units == {}


def test_a_folder_open_for_reading_is_not_written(tmp_path):
    create(tmp_path).close()
    run = RunFolder.open(tmp_path / "run")
    run.frame_path(0).write_bytes(b"x")
    for write in (
        lambda: run.write_run({}),
        lambda: run.write_timings({}),
        lambda: run.write_trajectory([], np.empty((0, 4, 4))),
        lambda: run.record(run.frame_path(0), input_hash=""),
    ):
        with pytest.raises(OutputError, match="reading only"):
            write()


def test_two_runs_cannot_share_a_folder(tmp_path):
    with create(tmp_path) as run:
        with pytest.raises(InputError, match=f"in use by process {os.getpid()}"):
            create(tmp_path)
        RunFolder.open(tmp_path / "run")
        run.close()
        run.close()
        create(tmp_path).close()
    assert not (tmp_path / "run" / ".lock").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="signals differ there")
def test_the_lock_of_a_killed_run_is_taken_over(tmp_path):
    code = f"""
        import time
        from tspslam.io import RunFolder
        run = RunFolder.create({str(tmp_path / "run")!r}, {CONFIG!r})
        print("locked", flush=True)
        time.sleep(60)
    """
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True)
    with child:
        assert child.stdout.readline() == "locked\n"
        with pytest.raises(InputError, match=f"process {child.pid}"):
            create(tmp_path)
        child.send_signal(signal.SIGKILL)
    assert (tmp_path / "run" / ".lock").exists()
    create(tmp_path).close()


@pytest.mark.skipif(sys.platform == "win32", reason="open files cannot be removed there")
def test_a_lock_file_removed_while_it_was_taken_is_taken_anew(tmp_path, monkeypatch):
    from tspslam.io import lock

    seen = []
    same_file = lock._same_file

    def removed_once(descriptor, path):
        seen.append(path)
        if len(seen) == 1:
            path.unlink()
        return same_file(descriptor, path)

    monkeypatch.setattr(lock, "_same_file", removed_once)
    held = FolderLock(tmp_path)
    with pytest.raises(InputError, match="in use"):
        FolderLock(tmp_path)
    held.release()
    assert len(seen) == 2


def test_a_file_system_without_locks_is_an_output_error(tmp_path, monkeypatch):
    def refuse(_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("tspslam.io.lock._lock", refuse)
    with pytest.raises(OutputError, match="No locks"):
        FolderLock(tmp_path)


def refusing(code):
    def refuse(*_, **__):
        raise OSError(code, os.strerror(code))

    return refuse


def test_a_full_disk_is_an_output_error_and_the_manifest_stays_whole(tmp_path, monkeypatch):
    with create(tmp_path) as run:
        finish(run)
        before = (run.path / "manifest.jsonl").read_bytes()
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", refusing(errno.ENOSPC))
            with pytest.raises(OutputError, match="No space left"):
                finish(run, 1)
            with pytest.raises(OutputError, match="No space left"):
                run.write_run({})
        assert (run.path / "manifest.jsonl").read_bytes() == before
        assert list(run.units) == ["frames/000000.npz"]
        finish(run, 1)


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit there")
def test_a_line_that_only_half_fits_is_cut_off_again(tmp_path):
    path = tmp_path / "manifest.jsonl"
    append_unit(path, Unit("map.ply", 64 * "0", 1, "", ""))
    code = f"""
        import resource, signal
        from tspslam.errors import OutputError
        from tspslam.io.manifest import Unit, append_unit
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, ({path.stat().st_size + 20}, resource.RLIM_INFINITY))
        try:
            append_unit({str(path)!r}, Unit("map.vtu", 64 * "0", 1, "", ""))
        except OutputError as error:
            print("refused:", error)
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    assert "bytes went through" in run.stdout
    assert read_manifest(path)[1] == path.stat().st_size


@pytest.mark.parametrize(
    ("module", "name"), [("tspslam.io.runfolder.os", "listdir"), ("tspslam.io.runfolder.Path", "mkdir")]
)
def test_a_folder_that_the_system_refuses_is_an_output_error(tmp_path, monkeypatch, module, name):
    (tmp_path / "run").mkdir()
    monkeypatch.setattr(f"{module}.{name}", refusing(errno.EROFS))
    with pytest.raises(OutputError, match="Read-only file system"):
        create(tmp_path)


def test_a_read_only_run_folder_is_an_output_error(tmp_path, monkeypatch):
    create(tmp_path).close()
    monkeypatch.setattr(os, "open", refusing(errno.EROFS))
    with pytest.raises(OutputError, match="Read-only file system"):
        create(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not bind root")
def test_a_folder_without_permission_is_an_output_error(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="ermission denied"):
        create(tmp_path)


def test_a_place_below_a_file_is_an_output_error(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file" / "run", tmp_path / "file", tmp_path / "nul\0l"):
        with pytest.raises(OutputError):
            RunFolder.create(path, CONFIG)


def test_what_cannot_be_swept_or_cut_is_an_output_error(tmp_path, monkeypatch):
    with create(tmp_path) as run:
        finish(run)
    with open(tmp_path / "run" / "manifest.jsonl", "ab") as handle:
        handle.write(b"torn")
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refusing(errno.EIO))
        with pytest.raises(OutputError, match="manifest"):
            create(tmp_path)
    (tmp_path / "run" / ".tspslam-a.tmp").mkdir()
    with pytest.raises(OutputError, match="run"):
        create(tmp_path)


def test_a_file_that_cannot_be_read_to_its_end_is_an_input_error(tmp_path, monkeypatch):
    (tmp_path / "a").write_bytes(b"x")
    monkeypatch.setattr("hashlib.file_digest", refusing(errno.EIO))
    with pytest.raises(InputError, match="Input/output error"):
        sha256_file(tmp_path / "a")
