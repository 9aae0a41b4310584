"""Folders that are whole or not there."""

import errno
import os
import subprocess
import sys
import textwrap

import pytest

from tspslam.errors import InputError, OutputError
from tspslam.io import write_bytes
from tspslam.io._folders import new_folder


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_made_is_there_and_alone(tmp_path):
    (tmp_path / "a").mkdir()  # an empty one is as good as none
    with new_folder(tmp_path / "a") as folder:
        (folder / "deep").mkdir()
        (folder / "deep" / "b").write_bytes(b"whole")
        assert names(tmp_path / "a") == []
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a" / "deep" / "b").read_bytes() == b"whole"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, ValueError, SystemExit])
def test_an_interruption_leaves_nothing(tmp_path, interruption):
    def interrupted():
        with new_folder(tmp_path / "a") as folder:
            (folder / "b").write_bytes(b"half")
            raise interruption

    with pytest.raises(interruption):
        interrupted()
    assert names(tmp_path) == []


@pytest.mark.parametrize("what", ["file", "full", "link"])
def test_what_is_there_is_not_touched(tmp_path, what):
    if what == "file":
        (tmp_path / "a").write_bytes(b"mine")
    elif what == "link":
        (tmp_path / "a").symlink_to(tmp_path / "elsewhere")
    else:
        (tmp_path / "a").mkdir()
        (tmp_path / "a" / "b").write_bytes(b"mine")
    with pytest.raises(InputError, match="is there already"), new_folder(tmp_path / "a"):
        pass
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("call", ["fsync", "rename"])
def test_a_system_that_refuses_is_an_output_error_and_leaves_nothing(tmp_path, monkeypatch, call):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(OutputError, match="No space left") as caught, new_folder(tmp_path / "a") as folder:
        (folder / "b").write_bytes(b"half")
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == []


def test_an_error_of_a_file_in_it_names_the_folder_that_was_asked_for(tmp_path):
    with pytest.raises(OutputError) as caught, new_folder(tmp_path / "a") as folder:
        write_bytes(folder / "missing" / "b", b"")
    assert str(caught.value).startswith(f"{tmp_path}/a/missing/b: cannot be written")


@pytest.mark.parametrize("name", ["file/below", "missing/below", "nul\0l", "x" * 300])
def test_a_place_that_cannot_be_is_an_output_error(tmp_path, name):
    (tmp_path / "file").write_bytes(b"mine")
    with pytest.raises(OutputError, match="cannot be written"), new_folder(f"{tmp_path}/{name}"):
        pass
    assert names(tmp_path) == ["file"]


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit there")
@pytest.mark.parametrize(
    ("export", "given"),
    [("colmap", "map_, grey_of(map_)"), ("nerfstudio", "map_, grey_of(map_)"), ("bag", "path_of(map_), map_")],
)
def test_a_full_disk_is_an_output_error_and_leaves_no_export(tmp_path, export, given):
    if export == "bag":
        pytest.importorskip("rosbags", reason="the extra ros is not installed")
    code = textwrap.dedent(f"""
        import resource, signal
        from tests.io.seen_maps import grey_of, path_of, seen_map
        from tspslam.errors import OutputError
        from tspslam.io.{export} import write_{export}
        map_ = seen_map()
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
        try:
            write_{export}({str(tmp_path / "a")!r}, {given})
        except OutputError as error:
            print("refused:", error)
    """)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.startswith(f"refused: {tmp_path}/a")
    assert names(tmp_path) == []


def test_what_comes_into_the_folder_meanwhile_stays(tmp_path):
    target = tmp_path / "out"

    def write():
        with new_folder(target) as folder:
            (folder / "a").write_text("made")
            target.mkdir()
            (target / "thesis.txt").write_text("the only copy")

    with pytest.raises(InputError, match=r"out: is there already"):
        write()
    assert (target / "thesis.txt").read_text() == "the only copy"
    assert [each.name for each in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(os.name != "posix", reason="modes are POSIX'")
def test_an_empty_folder_keeps_who_may_look_into_it(tmp_path):
    target = tmp_path / "out"
    target.mkdir(mode=0o700)
    with new_folder(target) as folder:
        (folder / "a").write_text("made")
    assert target.stat().st_mode & 0o777 == 0o700
    assert (target / "a").read_text() == "made"


@pytest.mark.skipif(os.name != "posix", reason="others do not let a folder go that somebody is in")
def test_a_folder_that_is_gone_is_one_line(tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(OutputError, match="cannot be written"), new_folder("out"):
        pass
