"""An interruption after any call to the system leaves what was there, or what was made, and nothing else."""

from __future__ import annotations

import builtins
import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tspslam.io import write_bytes
from tspslam.io._export_folder import fill_folder
from tspslam.io._folders import new_file, new_folder

CALLS = ("mkdir", "rename", "replace", "unlink", "rmdir", "fsync")


class Interrupter:
    """Raises KeyboardInterrupt once, when the n-th call to the system has been made."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, nth: int) -> None:
        self.left = nth
        for name in CALLS:
            monkeypatch.setattr(os, name, self._counted(getattr(os, name)))
        monkeypatch.setattr(builtins, "open", self._counted(builtins.open))

    def _counted(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*given: Any, **named: Any) -> Any:
            done = call(*given, **named)
            self.left -= 1
            if self.left == 0:
                raise KeyboardInterrupt
            return done

        return called


def folder(place: Path) -> None:
    with new_folder(place) as made:
        (made / "a").mkdir()
        write_bytes(made / "a" / "b", b"new")


def export(place: Path) -> None:
    with fill_folder(place, "test", is_forced=True) as made:
        write_bytes(made / "b", b"new")


def file(place: Path) -> None:
    with new_file(place) as made:
        made.write_bytes(b"new")


def plain(place: Path) -> None:
    write_bytes(place, b"new")


def content(place: Path) -> dict[str, bytes]:
    return {path.relative_to(place).as_posix(): path.read_bytes() for path in place.rglob("*") if path.is_file()}


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("write", [folder, export, file, plain])
def test_an_interruption_at_any_moment_leaves_the_old_or_the_new(tmp_path: Path, write: Callable[[Path], None]) -> None:
    seen = set()
    for nth in range(1, 100):
        here = tmp_path / str(nth)
        here.mkdir()
        if write is not folder:
            write(here / "made")
            path = here / "made" / "b" if write is export else here / "made"
            if write is not export:
                path.write_bytes(b"old")
        before = content(here)
        with pytest.MonkeyPatch.context() as patch:
            interrupter = Interrupter(patch, nth)
            with contextlib.suppress(KeyboardInterrupt):
                write(here / "made")
            is_over = interrupter.left > 0
        after = content(here)
        assert {path.name for path in here.iterdir()} <= {"made"}
        assert (here / "made").exists() or write is folder
        seen.add("old" if after == before else "new")
        if is_over:
            break
    assert is_over
    assert nth > 4
    assert seen == ({"old"} if write is export else {"old", "new"})
