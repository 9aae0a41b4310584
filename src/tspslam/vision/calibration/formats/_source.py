"""What a calibration file says, key by key, with errors that name the file, the key and the value seen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...._files import PathLike, one_line
from ...._text import is_plain
from ....errors import InputError
from ....types import FloatArray

_LARGEST_NUMBER = 1e13  # keeps every product below far from overflow
_DTYPES = tuple("ucwsifd")  # of OpenCV's matrices: one channel


@dataclass(frozen=True)
class Source:
    """The values of one file or of one part of it.

    Attributes
    ----------
    path : str or path
        Whose name the errors carry.
    values : dict
        Numbers, text, lists, and mappings as YAML gives them.
    prefix : str
        What to put before a key of this part in errors and origins, such as ``"cam0."``.

    Examples
    --------
    >>> source = Source("calib.yml", {"K": {"rows": 1, "cols": 2, "dt": "d", "data": [3, 4.5]}})
    >>> source.matrix("K", 1, 2).tolist()
    [[3.0, 4.5]]
    """

    path: PathLike
    values: dict[Any, Any]
    prefix: str = ""

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def label(self, key: str) -> str:
        """Return the key with the part it is in."""
        return self.prefix + key

    def error(self, reason: str) -> InputError:
        """Return the one-line error of this file."""
        return InputError(one_line(f"{self.path}: {reason}"))

    def wrong(self, key: str, seen: object, expected: str) -> InputError:
        """Return the error for a value that is not as it should be."""
        return self.error(f"{self.label(key)} is {_shown(seen)}, expected {expected}")

    def value(self, key: str, expected: str) -> Any:
        """Return what the file says under a key that must be there."""
        if key not in self.values:
            raise self.error(f"lacks {self.label(key)}, expected {expected}")
        return self.values[key]

    def part(self, key: str) -> Source:
        """Return a mapping of the file as a source of its own."""
        value = self.value(key, "a mapping")
        if not isinstance(value, dict):
            raise self.wrong(key, value, "a mapping")
        return Source(self.path, value, f"{self.label(key)}.")

    def text(self, key: str, expected: str) -> str:
        """Return a text."""
        value = self.value(key, expected)
        if not isinstance(value, str):
            raise self.wrong(key, value, expected)
        return value

    def number(self, key: str) -> float:
        """Return a finite number."""
        return self._number(key, self.value(key, "a number"))

    def vector(self, key: str, *counts: int) -> list[float]:
        """Return as many numbers as one of `counts`: a list, or a matrix of one row or column."""
        expected = f"{' or '.join(map(str, counts))} numbers"
        shape, data = self._laid_out(key, expected)
        if len(data) not in counts or not (shape is None or 1 in shape):
            raise self._misshapen(key, shape, data, expected)
        return [self._number(f"{key}[{k}]", each) for k, each in enumerate(data)]

    def matrix(self, key: str, rows: int, columns: int) -> FloatArray:
        """Return a matrix: one of OpenCV's, a list of rows, or a list of all its numbers row by row."""
        expected = f"{rows * columns} numbers ({rows} x {columns})"
        shape, data = self._laid_out(key, expected)
        if len(data) != rows * columns or shape not in (None, (rows, columns)):
            raise self._misshapen(key, shape, data, expected)
        at = [f"{key}[{k // columns},{k % columns}]" for k in range(len(data))]
        values = [self._number(name, each) for name, each in zip(at, data, strict=True)]
        return np.array(values, np.float64).reshape(rows, columns)

    def _number(self, key: str, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong(key, value, "a number")
        if not abs(value) <= _LARGEST_NUMBER:  # NaN too
            raise self.wrong(key, value, f"a finite number, at most {_LARGEST_NUMBER:g} in size")
        return float(value)

    def _laid_out(self, key: str, expected: str) -> tuple[tuple[int, int] | None, list[Any]]:
        """Shape, where the file tells one, and the values row by row."""
        value = self.value(key, expected)
        if isinstance(value, dict):
            return self._opencv_matrix(key, value)
        if not isinstance(value, list):
            raise self.wrong(key, value, expected)
        if not (value and all(isinstance(row, list) for row in value)):
            return None, value
        if len({len(row) for row in value}) != 1:
            raise self.wrong(key, value, f"{expected}, rows of one length")
        return (len(value), len(value[0])), [each for row in value for each in row]

    def _opencv_matrix(self, key: str, value: dict[Any, Any]) -> tuple[tuple[int, int], list[Any]]:
        rows, columns, data = (value.get(name) for name in ("rows", "cols", "data"))
        if type(rows) is not int or type(columns) is not int or not isinstance(data, list):
            raise self.wrong(key, value, "a matrix with rows, cols and a list data")
        if len(data) != rows * columns or min(rows, columns) < 0:
            raise self.error(
                f"{self.label(key)} has rows {_shown(rows)}, cols {_shown(columns)} and {len(data)} numbers in data, "
                "expected rows * cols numbers"
            )
        if value.get("dt", "d") not in _DTYPES:
            raise self.wrong(f"{key}.dt", value["dt"], f"one of {', '.join(_DTYPES)} (one channel)")
        return (rows, columns), data

    def _misshapen(self, key: str, shape: tuple[int, int] | None, data: list[Any], expected: str) -> InputError:
        said = f"{len(data)} numbers" if shape is None else f"{shape[0]} x {shape[1]} numbers"
        return self.error(f"{self.label(key)} has {said}, expected {expected}")


def whole(value: float) -> float:
    """Return a number as an int if it is whole, so that a size reads 640 and not 640.0."""
    return int(value) if math.isfinite(value) and value == int(value) else value


def plain_value(word: str) -> float | str:
    """Return a word of a text file as the number that it is, else as it is, for the errors to show."""
    try:
        return float(word) if is_plain(word) else word
    except ValueError:
        return word


def _shown(value: object) -> str:
    said = repr(value)
    return one_line(said if len(said) <= 60 else f"{said[:57]}...")
