"""``calib.txt`` of Middlebury's stereo benchmark: a rectified pair in px and mm, and its range of disparities."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from ....._files import PathLike
from ....._text import is_comment
from .._calibration import Calibration, rectified
from .._lines import key_and_value
from .._source import Source, plain_value
from .._values import Found, Size, agreed_size, checked, from_camera_matrix, size_from_keys

KIND = "Middlebury calib.txt"
_LINE = re.compile(r"^[ \t]*cam0[ \t]*=[ \t]*\[", re.MULTILINE)
_MILLIMETRE = 1e-3  # m
_SAME = 1e-3  # px, between cameras
_ROUNDED = 2e-3  # px, of doffs, where each number has three decimals


def is_middlebury(text: str) -> bool:
    """Tell whether a text has the line of the left camera.

    Parameters
    ----------
    text : str
        Of a file.

    Returns
    -------
    bool
    """
    return _LINE.search(text) is not None


def parse_middlebury(text: str, path: PathLike) -> Source:
    """Return the lines ``key=number`` and ``key=[rows; of numbers]`` of a file.

    Parameters
    ----------
    text : str
        Of the file.
    path : str or path
        Its name, for errors.

    Returns
    -------
    Source
    """
    values: dict[Any, Any] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if not line.strip() or is_comment(line):
            continue
        key, rest = key_and_value(path, (number, line), values)
        is_matrix = rest.startswith("[") and rest.endswith("]")
        values[key] = [_words(row) for row in rest[1:-1].split(";")] if is_matrix else plain_value(rest)
    return Source(path, values)


def read_middlebury(source: Source, size: Size | None = None) -> Calibration:
    r"""Read the pair; the range of its disparities is that of ``vmin`` and ``vmax``, else 0 to ``ndisp``.

    Parameters
    ----------
    source : Source
        The lines of the file.
    size : (width, height), optional
        Of the images, px; it must be the file's.

    Returns
    -------
    Calibration
        With `disparity_range`.

    Raises
    ------
    InputError
        If a value is missing, out of range or does not fit the others.

    Examples
    --------
    >>> text = "cam0=[700 0 300; 0 700 200; 0 0 1]\ncam1=[700 0 310; 0 700 200; 0 0 1]\ndoffs=10\nbaseline=200\n"
    >>> found = read_middlebury(parse_middlebury(text + "width=640\nheight=480\nndisp=64\n", "calib.txt"))
    >>> found.cameras.baseline, found.disparity_range
    (0.2, (0.0, 64.0))
    """
    found, other = (from_camera_matrix(source, key) for key in ("cam0", "cam1"))
    for name in ("fx", "fy", "cy", "skew"):
        (value, key), (second, its_key) = found[name], other[name]
        if abs(value - second) > _SAME:
            raise source.error(f"{key} is {value:.8g}, {its_key} is {second:.8g}, expected the same (a rectified pair)")
    found |= _offset(source, found, other)
    baseline = source.number("baseline") * _MILLIMETRE, "baseline / 1000"
    found |= checked(source, {"baseline": baseline})
    found |= agreed_size(source, size_from_keys(source, "width", "height"), size)
    low, high, keys = _range(source)
    if keys is None:
        return rectified(found, KIND)
    said = f"a pair is searched for disparities from {low:g} to {high:g} px ({keys}), unless the matcher has limits"
    return replace(rectified(found, KIND, (said,)), disparity_range=(low, high))


def _offset(source: Source, left: Found, right: Found) -> Found:
    value = right["cx"][0] - left["cx"][0]
    if "doffs" in source and abs(source.number("doffs") - value) > _ROUNDED:
        said = f"doffs is {source.number('doffs'):.8g}, but the cameras' cx differ by {value:.8g}"
        raise source.error(f"{said}, expected the same")
    return {"doffs": (value, "cam1[0,2] - cam0[0,2]")}


def _range(source: Source) -> tuple[float, float, str | None]:
    """Smallest and largest disparity, px, and their keys; None where the file says nothing."""
    if "vmin" in source and "vmax" in source:
        low, high, keys = source.number("vmin"), source.number("vmax"), "vmin, vmax"
    elif "ndisp" in source:
        low, high, keys = 0.0, source.number("ndisp"), "ndisp"
    else:
        return 0.0, 0.0, None
    if not -1e5 <= low < high <= 1e5:
        raise source.error(f"{keys} is {low:g} to {high:g}, expected a range of disparities, px")
    return low, high, keys


def _words(row: str) -> list[float | str]:
    return [plain_value(word) for word in row.replace(",", " ").split()]
