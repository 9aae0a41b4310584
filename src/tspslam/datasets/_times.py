"""Times of images: in their names, or in a file beside them, and in which unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np

from .._files import bad_input, one_line
from .._text import is_plain, read_lines
from ..errors import InputError
from ..types import FloatArray
from ._pairing import LAST_STAMP, check_stamps, seconds

FILES = ("times.txt", "timestamps.txt", "stamps.txt")
"""In a folder of images, or in that of its left ones."""
_LISTED = "a line for each left image: its time, or its name and its time; in seconds with decimals, or in ns, us or ms"
_UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}  # ns
_FIRST, _LAST = 946_684_800 * 10**9, 4_102_444_800 * 10**9  # ns since 1970, the years 2000 and 2100: at most one unit
_SHORTEST, _LONGEST = 5 * 10**6, 2 * 10**9  # ns between frames of 200 to 0.5 a second: at most one unit
_NUMBER = re.compile(r"(?<![0-9])(?:[0-9]{1,11}\.[0-9]{1,9}|[0-9]{1,19})(?![0-9])")
_ZEROS = re.compile(r"(?<![0-9.])0+(?=[0-9])")
_VALUE = re.compile(r"[-+]?[0-9]{1,19}(?:\.[0-9]{0,30})?(?:[eE][-+]?[0-9]{1,2})?")
_MOST = 10**10  # s
_FASTEST = 1e5  # frames a second


@dataclass(frozen=True)
class Nanoseconds:
    """Whole nanoseconds of each image, and the unit that they were written in."""

    values: list[int]
    unit: str


def nanoseconds_of(names: Sequence[str], units: Sequence[str] = ("ns", "us")) -> Nanoseconds | None:
    """Return the times that names hold in their longest numbers, if they do: they increase as those of frames do.

    Times since 1970 tell their unit by their size. Others tell it by their steps, if it is one of `units`: steps of
    frames 10, 20, 30 must not be taken for milliseconds.
    """
    found = [max(_NUMBER.findall(_ZEROS.sub("", name)), key=len, default="") for name in names]
    if not found or not all(found):
        return None
    values = [Decimal(each) for each in found]
    known = ("s",) if any("." in each for each in found) else tuple(_UNITS)
    since = [
        unit for unit in known if all(_FIRST <= value * _UNITS[unit] <= _LAST for value in (values[0], values[-1]))
    ]
    unit = since[0] if since else _by_steps(values, [each for each in known if each in units])
    times = [int(value * _UNITS[unit]) for value in values] if unit else []
    return Nanoseconds(times, str(unit)) if times and _are_of_frames(times) else None


def _by_steps(values: Sequence[Decimal], units: Sequence[str]) -> str | None:
    """Unit in which the median step is one between frames."""
    if len(values) < 2:
        return None
    step = sorted(b - a for a, b in pairwise(values))[(len(values) - 1) // 2]
    return next((unit for unit in units if _SHORTEST <= step * _UNITS[unit] <= _LONGEST), None)


def _are_of_frames(times: Sequence[int]) -> bool:
    if max(times) > LAST_STAMP or any(a >= b for a, b in pairwise(times)):
        return False
    try:
        check_stamps(Path(), seconds(times), "s")
    except InputError:
        return False
    return True


def file_of_times(folders: Sequence[Path]) -> Path | None:
    """Return the file with times in one of the folders, if there is one."""
    return next((folder / name for folder in folders for name in FILES if (folder / name).is_file()), None)


def read_times(path: Path, files: Sequence[Path]) -> tuple[FloatArray, str]:
    """Return the time (s) of each left image, and the unit in which the file has them.

    Lines with one value are in the order of the images, as many as there are; lines with two name the image first or
    last.
    """
    rows = [(number, re.split(r"[,;\s]+", text)) for number, text in read_lines(path, _LISTED) if text]
    if len(rows) > 1 and len(rows[-1][1]) == 1 and len(rows[-2][1]) == 2:
        rows.pop()  # a recording that ended in the middle of a line
    counts = {len(words) for _, words in rows}
    if len(counts) != 1 or not counts <= {1, 2}:
        raise bad_input(path, f"has lines of {' and '.join(map(str, sorted(counts))) or 'no'} values", _LISTED)
    if counts == {2}:
        rows = _named_rows(path, rows, files)
    elif len(rows) != len(files):
        raise bad_input(path, f"has {len(rows)} times of {len(files)} left images", _LISTED)
    words = [words[0] for _, words in rows]
    wrong = next((row for row in rows if not _VALUE.fullmatch(row[1][0]) or abs(float(row[1][0])) > 1e20), None)
    if wrong:
        raise bad_input(path, f"line {wrong[0]} has {wrong[1][0][:40]!r}", _LISTED)
    return _in_seconds(path, words, [number for number, _ in rows])


def _in_seconds(path: Path, words: Sequence[str], lines: Sequence[int]) -> tuple[FloatArray, str]:
    if all(word.isdecimal() for word in words):
        found = nanoseconds_of(words, tuple(_UNITS)[:3])
        if found is None:
            said = f"has whole numbers such as {words[0]} and {words[-1]}, which are no times in any unit"
            raise bad_input(path, said, _LISTED)
        return seconds(found.values), found.unit
    times = np.array([float(word) for word in words])
    if np.abs(times).max() > _MOST:
        raise bad_input(path, f"has {np.abs(times).max():g} s", f"decimals that are seconds, at most {_MOST:g}")
    check_stamps(path, times, "seconds", lines)
    return times, "s"


def _named_rows(path: Path, rows: list[tuple[int, list[str]]], files: Sequence[Path]) -> list[tuple[int, list[str]]]:
    """The time of each file, from lines that name one."""
    for place in (0, 1):
        times: dict[str, tuple[int, list[str]]] = {}
        for number, words in rows:
            before = times.setdefault(_called(words[place]), (number, [words[1 - place]]))
            if before[1] != [words[1 - place]]:
                raise bad_input(path, f"lines {before[0]} and {number} name {words[place][:40]}", "one time an image")
        found = [times.get(_called(file.name)) for file in files]
        if any(found):
            lost = next((file for file, row in zip(files, found, strict=True) if row is None), None)
            if lost:
                raise bad_input(path, f"has no time of {lost.name}", _LISTED)
            return [row for row in found if row]
    raise bad_input(path, f"names none of the left images, such as {files[0].name}", _LISTED)


def _called(name: str) -> str:
    """A file's name without folder and suffix, a number without its zeros in front."""
    stem = Path(name.replace("\\", "/")).name
    stem = re.sub(r"\.[A-Za-z]{2,5}$", "", stem)
    return (stem.lstrip("0") or "0") if is_plain(stem) and stem.isdecimal() else stem


def at_rate(places: Sequence[int] | FloatArray, fps: float) -> FloatArray:
    """Return the times (s) of frames by their places, so many a second."""
    if not (isinstance(fps, int | float) and not isinstance(fps, bool) and 0.01 <= fps <= _FASTEST):
        raise InputError(one_line(f"fps is {repr(fps)[:40]}, expected frames a second, 0.01 to {_FASTEST:g}"))
    return np.asarray(places, np.float64) / fps
