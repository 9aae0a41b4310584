"""Folders of exports are whole or not there, and nothing of anybody else's is in them or lost with them."""

import errno
import json
import os

import pytest

from tspslam import InputError, OutputError
from tspslam.io._export_folder import MARK, check_free, fill_folder


def write(path, content=b"one", name="inner/a", meanwhile=lambda: None, **options):
    with fill_folder(path, "pvd", **options) as folder:
        (folder / "inner").mkdir()
        (folder / name).write_bytes(content)
        meanwhile()


def content(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_folder_is_there_with_a_list_of_its_files(tmp_path):
    write(tmp_path / "out")
    assert content(tmp_path / "out").keys() == {"inner/a", MARK}
    assert json.loads((tmp_path / "out" / MARK).read_text()) == {
        "export": "pvd", "files": ["inner/a", MARK], "of": "tspslam",
    }  # fmt: skip
    assert os.listdir(tmp_path) == ["out"]


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "out").mkdir()
    write(tmp_path / "out")
    assert (tmp_path / "out/inner/a").read_bytes() == b"one"


def test_an_earlier_export_is_replaced_by_force_alone(tmp_path):
    write(tmp_path / "out", name="old")
    before = content(tmp_path / "out")
    with pytest.raises(InputError, match="out: is there; expected a free name, or --force"):
        write(tmp_path / "out")
    assert content(tmp_path / "out") == before
    write(tmp_path / "out", b"two", is_forced=True)
    assert content(tmp_path / "out").keys() == {"inner/a", MARK}
    assert os.listdir(tmp_path) == ["out"]


def a_file(out):
    out.write_bytes(b"mine")


def a_link(out):
    (out.parent / "elsewhere").mkdir()
    out.symlink_to("elsewhere")


def a_file_among_ours(out):
    write(out)
    (out / "inner/mine.txt").write_bytes(b"mine")


def a_folder_of_mine(out):
    out.mkdir()
    (out / "mine.txt").write_bytes(b"mine")


def a_link_among_ours(out):
    write(out)
    (out / "mine").symlink_to(out.parent)


def another_export(out):
    with fill_folder(out, "colmap") as folder:
        (folder / "a").write_bytes(b"mine")


def a_broken_list(out):
    a_folder_of_mine(out)
    (out / MARK).write_bytes(b"[" * 100_000)


def a_list_of_something_else(out):
    a_folder_of_mine(out)
    (out / MARK).write_text('{"export": "pvd", "of": "tspslam", "files": 3}')


@pytest.mark.parametrize("spoil", [
    a_file, a_link, a_file_among_ours, a_folder_of_mine, a_link_among_ours, another_export, a_broken_list, a_list_of_something_else,
])  # fmt: skip
def test_what_somebody_else_put_there_is_never_touched(tmp_path, spoil):
    out = tmp_path / "out"
    spoil(out)
    before = content(tmp_path), sorted(os.listdir(tmp_path))
    for is_forced in (False, True):
        with pytest.raises(InputError, match="a free name, an empty folder, or with --force an earlier export"):
            write(out, is_forced=is_forced)
    assert (content(tmp_path), sorted(os.listdir(tmp_path))) == before


def test_a_folder_that_is_free_is_found_free(tmp_path):
    check_free(tmp_path / "new", "pvd")
    check_free(tmp_path, "pvd")


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, ValueError, SystemExit])
def test_an_interruption_leaves_what_was_there_and_nothing_else(tmp_path, interruption):
    write(tmp_path / "out")
    before = content(tmp_path)

    def interrupted():
        with fill_folder(tmp_path / "out", "pvd", is_forced=True) as folder:
            (folder / "half").write_bytes(b"half")
            raise interruption

    with pytest.raises(interruption):
        interrupted()
    assert content(tmp_path) == before
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize(("call", "nth"), [("fsync", 1), ("fsync", 2), ("fsync", 3), ("rename", 1), ("rename", 2)])
def test_a_system_that_refuses_is_an_output_error_and_leaves_what_was_there(tmp_path, monkeypatch, call, nth):
    write(tmp_path / "out")
    before, works, calls = content(tmp_path), getattr(os, call), []

    def refuse(*given):
        calls.append(given)
        if len(calls) == nth:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return works(*given)

    monkeypatch.setattr(os, call, refuse)
    with pytest.raises(OutputError, match=r"out.*No space left") as caught:
        write(tmp_path / "out", b"new", is_forced=True)
    assert ".tmp" not in str(caught.value)
    assert content(tmp_path) == before
    assert os.listdir(tmp_path) == ["out"]


def test_a_place_that_cannot_be_is_an_output_error(tmp_path):
    for name in ("missing/out", "x" * 300, "nul\0l"):
        with pytest.raises(OutputError) as caught:
            write(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_a_file_that_comes_into_an_earlier_export_meanwhile_stays(tmp_path):
    target = tmp_path / "out"
    with fill_folder(target, "pvd") as folder:
        (folder / "a").write_text("first")
    with pytest.raises(InputError, match=r"thesis\.txt, which no export wrote"):
        write(target, name="a", is_forced=True, meanwhile=lambda: (target / "thesis.txt").write_text("the only copy"))
    assert (target / "thesis.txt").read_text() == "the only copy"
    assert (target / "a").read_text() == "first"
