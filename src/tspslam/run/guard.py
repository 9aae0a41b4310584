"""What a command may write to: never an input or a file of a run, and another kind of file only if forced."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..io._export_folder import check_free
from ..io._places import is_of_a_run
from ..io._settling import is_run_folder

_FIRST = 1024  # bytes of a file that tell its kind
_XML = rb"(\xef\xbb\xbf)?(<\?xml[^>]*\?>\s*)?"


@dataclass(frozen=True)
class Kind:
    """A kind of file: what to call it, its suffixes, and how such files begin."""

    name: str
    suffixes: tuple[str, ...]
    beginning: bytes

    def fits(self, path: Path) -> bool:
        """Whether a file is of this kind, by its suffix and its first bytes.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        bool
        """
        with path.open("rb") as handle:
            first = handle.read(_FIRST)
        return path.suffix.lower() in self.suffixes and re.match(self.beginning, first, re.DOTALL) is not None


CALIBRATION = Kind("calibration of ours", (".yaml", ".yml"), rb"(T_right_left|baseline):\s")
MAPS = {
    "vtu": Kind("VTU", (".vtu",), _XML + rb"<VTKFile\b"),
    "ply": Kind("PLY", (".ply",), rb"ply\r?\n"),
    "map": Kind("map of ours", (".npz",), rb"PK\x03\x04.{26}magic\.npy.{,200}tspslam map"),
    "npz": Kind("frame of ours", (".npz",), rb"PK\x03\x04.{26}magic\.npy.{,200}tspslam frame"),
}
PICTURES = {
    "png": Kind("PNG", (".png",), rb"\x89PNG\r\n\x1a\n"),
    "pdf": Kind("PDF", (".pdf",), rb"%PDF-"),
    "svg": Kind("SVG", (".svg",), _XML + rb"(<!DOCTYPE svg[^>]*>\s*)?<svg\b"),
}
EXPORTS = {
    "glb": Kind("binary glTF", (".glb",), rb"glTF\x02\0\0\0"),
    "las": Kind("LAS", (".las",), rb"LASF"),
    "laz": Kind("LAZ", (".laz",), rb"LASF"),
    "rrd": Kind("recording of rerun", (".rrd",), rb"RRF"),
    "tensors": Kind("file of tensors of ours", (".npz",), rb"PK\x03\x04.{26}magic\.npy.{,200}tspslam tensors"),
}
PAGE = Kind("HTML", (".html",), rb"<!DOCTYPE html>")


def check_output(output: Path, kind: Kind, inputs: Iterable[Path], *, is_forced: bool = False) -> None:
    """Raise unless a file may be written: it is no input, no file of a run, and new, empty, or one of its kind.

    Parameters
    ----------
    output : path
        The file to write.
    kind : Kind
        What it will be.
    inputs : iterable of path
        Files and folders that the command reads; however they are named or linked.
    is_forced : bool
        Whether a file of another kind, or one in a folder of the input, may be overwritten.

    Raises
    ------
    InputError
    """
    given = list(inputs)
    for path in given:
        if _is_same(output, path):
            raise InputError(f"{output}: is the input {path} itself; expected another file")
    for folder in _above(output):
        inner = os.path.relpath(os.path.realpath(output), folder).replace(os.sep, "/")
        if is_of_a_run(inner) and is_run_folder(folder):
            raise InputError(f"{output}: is a file of the run in {folder}; expected a place outside")
    try:
        if is_forced or not output.is_file() or output.stat().st_size == 0:
            return
        fits = kind.fits(output)
    except (OSError, ValueError):
        return  # who writes it will say why that cannot be done
    for path in given:
        if path.is_dir() and not is_run_folder(path) and is_inside(output, path):
            raise InputError(f"{output}: is there and lies in the input {path}; expected a free name, or --force")
    if not fits:
        raise InputError(f"{output}: is there and is no {kind.name}; expected a free name, or --force to overwrite it")


def check_place(output: Path, kind: Kind, inputs: Iterable[Path], *, is_forced: bool = False) -> None:
    """Raise as `check_output`, and also if a file would lie in a run folder of the input.

    Parameters
    ----------
    output : path
        The file to write.
    kind : Kind
        What it will be.
    inputs : iterable of path
        What was read.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Raises
    ------
    InputError
    """
    given = list(inputs)
    for path in given:
        if path.is_dir() and is_inside(output, path):
            raise InputError(f"{output}: lies in the run folder {path}; expected a place outside")
    check_output(output, kind, given, is_forced=is_forced)


def check_new_folder(output: Path, kind: str, inputs: Iterable[Path], *, is_forced: bool = False) -> None:
    """Raise unless a folder may be written: it is outside the input, holds none, and is new, empty, or one to replace.

    Parameters
    ----------
    output : path
        The folder to write.
    kind : str
        What it will be, one word.
    inputs : iterable of path
        What was read.
    is_forced : bool
        Whether an earlier export of that kind may be replaced; a folder with anything else in it never is.

    Raises
    ------
    InputError
    """
    given = list(inputs)
    check_place(output, Kind(kind, (), b""), given, is_forced=True)
    for path in given:
        if is_inside(path, output):
            raise InputError(f"{output}: holds the input {path}; expected a new folder")
    check_free(output, kind, is_forced=is_forced)


def check_folder(out: Path, inputs: Iterable[Path]) -> None:
    """Raise `InputError` if a run folder would be an input, or hold one.

    Parameters
    ----------
    out : path
        The run folder.
    inputs : iterable of path
        Files and folders that the command reads.
    """
    for path in inputs:
        if _is_same(out, path):
            raise InputError(f"{out}: is the input itself; expected an empty or new folder, or a run folder of ours")
        if is_inside(path, out):
            raise InputError(f"{out}: holds the input {path}; expected an empty or new folder, or a run folder of ours")


def is_inside(path: Path, folder: Path) -> bool:
    """Whether a path lies in a folder or below it, however both are named.

    Parameters
    ----------
    path, folder : path
        The inner and the outer place.

    Returns
    -------
    bool
    """
    return any(_is_same(each, folder) for each in _above(path))


def _above(path: Path) -> Iterable[Path]:
    try:
        return Path(os.path.realpath(path)).parents
    except OSError:  # the folder one is in was deleted: who writes will say that this cannot be
        return ()


def _is_same(a: Path, b: Path) -> bool:
    """Whether both are there and one and the same: by another name, another case, or a link."""
    try:
        return os.path.samefile(a, b)
    except (OSError, ValueError):
        return False
