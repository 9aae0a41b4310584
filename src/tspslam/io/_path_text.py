"""Camera paths as tables of numbers: which columns a text has, and its rows as TUM's or KITTI's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._files import PathLike, bad_input, open_input
from .._text import is_whole, numbers, read_lines, split, unmarked
from ..types import FloatArray

TUM, KITTI = 8, 12  # values in a line
FORMS = (
    "lines of 8 numbers (TUM: stamp tx ty tz qx qy qz qw), of 12 (KITTI: three rows of a pose), "
    "or EuRoC's data.csv (stamp in ns, place, quaternion with w first, more)"
)
_EUROC = 17  # values in a line: of a pose, and of velocity and biases
_LARGEST_TEXT = 1 << 28  # bytes
_HEAD = 1 << 12  # bytes in which a line that names the columns stands
_DIGITS = 16  # of a stamp in ns: in seconds, that would be 30 million years
_NS = 1e-9  # s


class _Form(NamedTuple):
    """How lines are to be read: their separator, the unit of stamps, s, and the order of quaternions."""

    separator: str | None
    unit: float
    order: str


def read_table(path: PathLike) -> tuple[list[int], FloatArray]:
    """Numbers of the lines of a path, and their values, (n, 8) or (n, 12): NaN all through where one is."""
    rows: list[list[float]] = []
    at: list[int] = []
    blank: list[int] = []
    form = _Form(None, 1.0, "xyzw")
    for line in read_lines(path, FORMS, _LARGEST_TEXT):
        if not line[1]:
            blank.append(line[0])
            continue
        if not rows and not at and _names_columns(line[1]):
            continue
        if not rows:
            form = _form_of(path, line[1])
        counts = (len(rows[0]),) if rows else (TUM, KITTI, *((_EUROC,) if form.separator else ()))
        rows.append(numbers(path, line, split(path, line, FORMS, counts, form.separator), FORMS))
        at.append(line[0])
    if not rows:
        raise bad_input(path, "has no line of values", FORMS)
    return _checked_table(path, at, _as_tum(np.array(rows), form), blank)


def read_stamps(path: PathLike) -> FloatArray:
    """Stamps of a file that has one in each line, s."""
    wanted = "a stamp in seconds a line"
    lines = [line for line in read_lines(path, wanted, _LARGEST_TEXT) if line[1]]
    stamps = [numbers(path, line, split(path, line, wanted, (1,)), wanted)[0] for line in lines]
    if not stamps or not np.isfinite(stamps).all():
        raise bad_input(path, "has a stamp that is not finite" if stamps else "has no stamps", wanted)
    check_rise(path, [line[0] for line in lines], np.array(stamps))
    return np.array(stamps)


def check_rise(path: PathLike, lines: list[int], stamps: FloatArray) -> None:
    """Refuse stamps that do not increase."""
    falls = np.diff(stamps) <= 0
    if falls.any():
        k = int(np.argmax(falls))
        said = f"line {lines[k + 1]}: stamp {k + 2} is {stamps[k + 1]:.9f}, that before it {stamps[k]:.9f}"
        raise bad_input(path, said, "a rise")


def _names_columns(text: str) -> bool:
    """Whether a line is a head of a table, such as ``timestamp,x,y``, that is no comment."""
    first = text.partition(",")[0]
    return "," in text and first[:1].isalpha() and first.lower() not in ("nan", "inf", "infinity")


def _form_of(path: PathLike, text: str) -> _Form:
    """How the lines of a file are to be read, by its first one and the names of its columns."""
    if "," not in text or any(len(piece.split()) > 1 for piece in text.split(",")):  # decimal commas, to be refused
        return _Form(None, 1.0, "xyzw")
    names = _names_of(path)
    is_ns = any("[ns]" in name for name in names) or (is_whole(text.partition(",")[0].strip(), 40) and _is_long(text))
    parts = "".join(name[-1] for name in _bare(names) if name.startswith("q") and name[-1] in "wxyz")
    is_euroc = is_ns or text.count(",") == _EUROC - 1
    return _Form(",", _NS if is_ns else 1.0, parts if parts in ("wxyz", "xyzw") else "wxyz" if is_euroc else "xyzw")


def _is_long(text: str) -> bool:
    return len(text.partition(",")[0].strip()) >= _DIGITS


def _bare(names: list[str]) -> list[str]:
    """Names of columns without their units."""
    return [name.partition("[")[0].strip().lower() for name in names if name.partition("[")[0].strip()]


def _names_of(path: PathLike) -> list[str]:
    """Names of the columns, if one of the first lines has them."""
    with open_input(path, FORMS, _LARGEST_TEXT) as handle:
        head = unmarked(handle.read(_HEAD)).decode("utf-8", "replace")
    for line in head.splitlines():
        text = line.strip().removeprefix("#").strip()
        if text[:1].isalpha() and "," in text:
            return [name.strip() for name in text.split(",")]
        if text and not line.strip().startswith("#"):
            break
    return []


def _as_tum(table: FloatArray, form: _Form) -> FloatArray:
    """Columns in the order and the units of TUM's; KITTI's as they are."""
    if table.shape[1] == KITTI:
        return table
    quaternion = [4 + form.order.index(part) for part in "xyzw"]
    table = table[:, [0, 1, 2, 3, *quaternion]]
    table[:, 0] *= form.unit
    return table


def _checked_table(
    path: PathLike, lines: list[int], table: FloatArray, blank: list[int]
) -> tuple[list[int], FloatArray]:
    """Refuse what is infinite or all unknown; in KITTI's form blank lines become rows."""
    has_stamp = table.shape[1] == TUM
    bad = np.flatnonzero(np.isinf(table).any(axis=1) | (np.isnan(table[:, 0]) & has_stamp))
    if bad.size:
        raise bad_input(path, f"line {lines[bad[0]]} has a value that is not finite", FORMS)
    unknown = np.isnan(table).any(axis=1)
    if unknown.all():
        raise bad_input(
            path, f"has no pose that is known: a value of each line is not finite ({len(table)} x NaN)", FORMS
        )
    table[unknown, int(has_stamp) :] = np.nan
    if has_stamp:
        return lines, table
    # Line k is for frame k: a blank one is a frame of which nothing is known, unless nothing follows it.
    inner = [number for number in blank if number < lines[-1]]
    order = np.argsort([*lines, *inner], kind="stable")
    whole = np.concatenate([table, np.full((len(inner), KITTI), np.nan)])
    return [[*lines, *inner][k] for k in order], whole[order]
