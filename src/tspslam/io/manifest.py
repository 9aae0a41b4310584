"""The list of finished units of a run: one JSON line each, appended and synced."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from io import BufferedReader
from pathlib import Path
from typing import cast

from .._atomic import bad_output, write_bytes
from .._files import PathLike, bad_input, open_input, open_own, read_bytes, reason_of
from ._places import is_result

_EXPECTED = "a manifest of finished units"
_HASH = re.compile("[0-9a-f]{64}")
_LARGEST = 1 << 30  # bytes: some two million frames


@dataclass(frozen=True)
class Unit:
    """A finished unit of work: one file of the run folder.

    Attributes
    ----------
    name : str
        The file, relative to the run folder, with ``/``.
    sha256 : str
        Hash of its bytes, 64 hexadecimal digits.
    bytes : int
        Its size.
    input : str
        Hash of what it was made from.
    config : str
        Hash of the settings it was made with.
    """

    name: str
    sha256: str
    bytes: int
    input: str
    config: str


def sha256_file(path: PathLike) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits.

    Parameters
    ----------
    path : str or path
        A regular, non-empty file.

    Returns
    -------
    str
        The hash.

    Raises
    ------
    InputError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "a").write_bytes(b"abc")
    ...     sha256_file(f"{folder}/a")[:8]
    'ba7816bf'
    """
    with open_input(path, "a file to hash") as handle:
        try:
            return hashlib.file_digest(cast(BufferedReader, handle), "sha256").hexdigest()
        except OSError as error:
            raise bad_input(path, f"cannot be read ({reason_of(error)})", "a file to hash") from error


def read_manifest(path: PathLike) -> tuple[dict[str, Unit], int]:
    """Read a manifest; a last line that an interruption tore is left out.

    Parameters
    ----------
    path : str or path
        The manifest; a missing or empty one has no units.

    Returns
    -------
    units : dict
        The units by name; of two with one name the later.
    size : int
        Bytes of the file that are whole lines.

    Raises
    ------
    InputError
        If a line other than the last is damaged, or one names a file that no run makes.

    Examples
    --------
    >>> read_manifest("no such manifest.jsonl")
    ({}, 0)
    """
    target = Path(path)
    if not target.exists() or (target.is_file() and target.stat().st_size == 0):
        return {}, 0
    units: dict[str, Unit] = {}
    lines = read_bytes(path, _EXPECTED, _LARGEST).splitlines(keepends=True)
    size = 0
    for number, line in enumerate(lines, start=1):
        unit = _unit(line)
        if unit is None and number == len(lines):
            break
        if unit is None or not is_result(unit.name):
            raise bad_input(path, f"line {number} is damaged", _EXPECTED)
        units[unit.name] = unit
        size += len(line)
    return units, size


def recorded_hashes(path: PathLike, name: str) -> set[str]:
    """Find the hashes that a file of a run was ever noted with: one that is written anew is noted before it is there.

    Parameters
    ----------
    path : str or path
        The manifest.
    name : str
        The file, relative to the run folder.

    Returns
    -------
    set of str
        SHA-256, 64 hexadecimal digits each.

    Raises
    ------
    InputError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for digit in "01":
    ...         append_unit(f"{folder}/manifest.jsonl", Unit("state.npz", 64 * digit, 3, "", ""))
    ...     len(recorded_hashes(f"{folder}/manifest.jsonl", "state.npz"))
    2
    """
    lines = read_bytes(path, _EXPECTED, _LARGEST).splitlines(keepends=True)
    return {unit.sha256 for unit in map(_unit, lines) if unit is not None and unit.name == name}


def write_manifest(path: PathLike, units: Iterable[Unit]) -> None:
    """Write a manifest of just these units, by name; whole or not at all, as `write_bytes`.

    Parameters
    ----------
    path : str or path
        The manifest.
    units : iterable of Unit
        In any order.
    """
    write_bytes(path, b"".join(_line(unit) for unit in sorted(units, key=lambda unit: unit.name)))


def append_unit(path: PathLike, unit: Unit) -> None:
    """Append one line to a manifest and sync it; on failure the file is cut back to what it was.

    Parameters
    ----------
    path : str or path
        The manifest; made when missing.
    unit : Unit
        What is finished.

    Raises
    ------
    OutputError
        If the system refuses.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     append_unit(f"{folder}/manifest.jsonl", Unit("map.ply", 64 * "0", 3, "", ""))
    ...     units, size = read_manifest(f"{folder}/manifest.jsonl")
    >>> units["map.ply"].bytes
    3
    """
    line = _line(unit)
    try:
        with open(path, "ab", buffering=0, opener=open_own) as handle:
            before = handle.seek(0, os.SEEK_END)
            try:
                written = handle.write(line)
                if written != len(line):
                    raise OSError(f"only {written} of {len(line)} bytes went through")
                os.fsync(handle.fileno())
            except OSError:
                with contextlib.suppress(OSError):
                    handle.truncate(before)
                raise
    except (OSError, ValueError) as error:
        raise bad_output(path, error) from error


def _line(unit: Unit) -> bytes:
    return json.dumps(asdict(unit), sort_keys=True, allow_nan=False).encode("ascii") + b"\n"


def _unit(line: bytes) -> Unit | None:
    if not line.endswith(b"\n"):
        return None
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        return None
    kinds = {field.name: int if field.name == "bytes" else str for field in fields(Unit)}
    if not isinstance(values, dict) or values.keys() != kinds.keys():
        return None
    if any(type(values[name]) is not kind for name, kind in kinds.items()) or not _HASH.fullmatch(values["sha256"]):
        return None
    return Unit(**values)
