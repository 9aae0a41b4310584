import errno
import os
import subprocess
import sys
import textwrap

import pytest

from tspslam.errors import OutputError
from tspslam.io import atomic_write, write_bytes


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_what_is_written_is_there_and_alone(tmp_path):
    write_bytes(tmp_path / "a", b"one")
    write_bytes(tmp_path / "a", b"two")
    assert (tmp_path / "a").read_bytes() == b"two"
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, ValueError, SystemExit])
def test_an_interruption_leaves_the_old_file_and_nothing_else(tmp_path, interruption):
    write_bytes(tmp_path / "a", b"old")

    def interrupted():
        with atomic_write(tmp_path / "a") as handle:
            handle.write(b"new")
            raise interruption

    with pytest.raises(interruption):
        interrupted()
    assert (tmp_path / "a").read_bytes() == b"old"
    assert names(tmp_path) == ["a"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO])
def test_a_system_that_refuses_is_an_output_error_of_one_line(tmp_path, monkeypatch, call, code):
    def refuse(*_):
        raise OSError(code, os.strerror(code))

    write_bytes(tmp_path / "a", b"old")
    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(OutputError, match=os.strerror(code)) as caught:
        write_bytes(tmp_path / "a", b"new")
    assert "\n" not in str(caught.value)
    assert (tmp_path / "a").read_bytes() == b"old"
    assert names(tmp_path) == ["a"]


def test_a_folder_that_cannot_be_synced_is_no_error(tmp_path, monkeypatch):
    synced = os.fsync
    calls = []

    def sync(descriptor):
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(errno.EINVAL, "no sync for folders")
        synced(descriptor)

    monkeypatch.setattr(os, "fsync", sync)
    write_bytes(tmp_path / "a", b"new")
    assert len(calls) == 2
    assert (tmp_path / "a").read_bytes() == b"new"


def test_a_folder_whose_sync_fails_for_good_is_an_output_error(tmp_path, monkeypatch):
    calls = []

    def sync(descriptor):
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(errno.EIO, "disk is dying")

    monkeypatch.setattr(os, "fsync", sync)
    with pytest.raises(OutputError, match="disk is dying"):
        write_bytes(tmp_path / "a", b"new")


def test_where_folders_have_no_descriptor_none_is_synced(tmp_path, monkeypatch):
    monkeypatch.delattr(os, "O_DIRECTORY")
    write_bytes(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"new"


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit there")
def test_a_full_disk_is_an_output_error_and_leaves_nothing(tmp_path):
    code = textwrap.dedent(f"""
        import resource, signal
        from tspslam.io import write_bytes
        from tspslam.errors import OutputError
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, resource.RLIM_INFINITY))
        try:
            write_bytes({str(tmp_path / "a")!r}, bytes(100_000))
        except OutputError as error:
            print("refused:", error)
    """)
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("refused:")
    assert names(tmp_path) == []


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="permissions do not bind root")
def test_a_read_only_folder_is_an_output_error(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match="ermission denied"):
        write_bytes(tmp_path / "a", b"")


@pytest.mark.parametrize("name", ["file/below", "missing/below", "nul\0l", "x" * 300 + "/a"])
def test_a_place_that_cannot_be_is_an_output_error(tmp_path, name):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError) as caught:
        write_bytes(tmp_path / name, b"")
    assert "\n" not in str(caught.value)


def test_only_regular_files_are_replaced(tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="not a regular file"):
        write_bytes(tmp_path / "folder", b"")
    with pytest.raises(OutputError, match="not a regular file"):
        write_bytes(os.devnull, b"")


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege there")
def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "target").write_bytes(b"old")
    (tmp_path / "link").symlink_to("target")
    write_bytes(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_bytes() == b"new"


@pytest.mark.skipif(sys.platform == "win32", reason="modes differ there")
def test_files_have_the_mode_that_the_user_mask_gives(tmp_path):
    write_bytes(tmp_path / "a", b"")
    (tmp_path / "b").write_bytes(b"")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode
