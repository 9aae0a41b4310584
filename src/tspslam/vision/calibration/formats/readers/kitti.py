"""KITTI's text files: ``calib.txt`` of the odometry sequences and ``calib_cam_to_cam.txt`` of the raw drives."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ....._files import PathLike, bad_input
from ....._text import is_comment, separators_of
from .._calibration import Calibration, Remarks, raw, rectified
from .._source import Source
from .._values import (
    Found,
    Size,
    agreed_size,
    distortion,
    from_camera_matrix,
    from_projections,
    motion,
    rotation,
    size_from_list,
)

_ODOMETRY_LINE = re.compile(r"^[ \t]*P[0-3]:[ \t]*[-+.0-9]", re.MULTILINE)
_RAW_LINE = re.compile(r"^[ \t]*[SKDRTP]_(?:rect_)?0[0-9]:", re.MULTILINE)
_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_OTHERWISE_SEPARATED = re.compile(r"(?=.*[,;])[-+.0-9eE,;\s]+")
_IDENTITY = 1e-6


def is_kitti(text: str) -> bool:
    """Tell whether a text has lines of a KITTI calibration file.

    Parameters
    ----------
    text : str
        Of a file.

    Returns
    -------
    bool
    """
    return bool(_RAW_LINE.search(text) or _ODOMETRY_LINE.search(text)) or _is_nameless(text)


def parse_kitti(text: str, path: PathLike) -> Source:
    """Return the lines ``name: numbers`` of a file; nameless lines of twelve numbers are P0, P1 and so on.

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
    nameless = _is_nameless(text)
    for k, (number, line) in enumerate(_lines(text)):
        name, colon, rest = (f"P{k}", ":", line) if nameless else line.partition(":")
        wrong = _wrong(name.strip(), colon, rest, values)
        if wrong:
            raise bad_input(path, f"line {number}: {wrong}", "lines of a name, a colon and numbers, each name once")
        values[name.strip()] = [_number(word) for word in rest.split()]
    return Source(path, values | ({"nameless": True} if nameless else {}))


def _lines(text: str) -> list[tuple[int, str]]:
    """Lines that say something, with their numbers from 1."""
    said = ((number, line.strip()) for number, line in enumerate(text.split("\n"), 1))
    return [(number, line) for number, line in said if line and not is_comment(line)]


def _wrong(name: str, colon: str, rest: str, earlier: dict[Any, Any]) -> str:
    """What is wrong with a line, if anything is."""
    if not colon:
        return f"holds the line {name[:40]!r}"
    if name in earlier:
        return f"the key {name[:40]} is there twice"
    return f"{name[:40]} has values{separators_of(rest)}" if _OTHERWISE_SEPARATED.fullmatch(rest.strip()) else ""


def read_kitti(source: Source, size: Size | None = None) -> Calibration:
    """Read the values of a KITTI file.

    An odometry file has a rectified pair (P0, P1) without its image size. A raw drive's file has the pair both as it
    was recorded and rectified: the size of the images tells which is meant; without one it is
    the rectified pair.

    Parameters
    ----------
    source : Source
        The lines of the file.
    size : (width, height), optional
        Of the images, px.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a value is missing, out of range or does not fit the others, or no image size is known.

    Examples
    --------
    >>> left, right = ([700, 0, 600, x, 0, 700, 180, 0, 0, 0, 1, 0] for x in (0, -350))
    >>> read_kitti(Source("calib.txt", {"P0": left, "P1": right}), (1241, 376)).cameras.baseline
    0.5
    """
    if not any(_RAW_LINE.match(f"{key}:") for key in source.values):
        return _odometry(source, size)
    if "S_rect_00" not in source or ("S_00" in source and _is_recorded(source, size)):
        return _recorded(source, size)
    found = from_projections(source, "P_rect_00", "P_rect_01") | _both(source, "S_rect_00", "S_rect_01")
    if size is not None and "S_00" in source:
        _check_one_of(source, size)
    agreed_size(source, found, size)
    unsaid = "the rectified values are read: no image size was given that tells recorded images from rectified ones"
    return rectified(found, "KITTI raw calib_cam_to_cam.txt", () if size else (unsaid,))


def _odometry(source: Source, size: Size | None) -> Calibration:
    found = from_projections(source, "P0", "P1")
    found |= agreed_size(source, None, size)
    return rectified(found, "KITTI odometry calib.txt", _odometry_remarks(source))


def _odometry_remarks(source: Source) -> Remarks:
    remarks = ["the file holds no image size"]
    if "nameless" in source:
        remarks.append("its lines have no names: the first is taken for the left camera, the second for the right one")
    if "P2" in source:
        remarks.append("P0 and P1, the grey cameras, are read; P2 and P3, the colour cameras, are not")
    return tuple(remarks)


def _is_recorded(source: Source, size: Size | None) -> bool:
    recorded, made = (_pixels(size_from_list(source, key)) for key in ("S_00", "S_rect_00"))
    return size == recorded != made


def _check_one_of(source: Source, size: Size) -> None:
    recorded, made = (_pixels(size_from_list(source, key)) for key in ("S_00", "S_rect_00"))
    if size not in (recorded, made):
        sizes = f"{recorded[0]} x {recorded[1]} (S_00) or {made[0]} x {made[1]} px (S_rect_00)"
        raise source.error(f"is for images of {sizes}, but {size[0]} x {size[1]} px are given, expected one of them")


def _recorded(source: Source, size: Size | None) -> Calibration:
    _check_reference(source)
    agreed_size(source, size_from_list(source, "S_00"), size)
    sides = [
        from_camera_matrix(source, f"K_{k}") | distortion(source, f"D_{k}", 5) | size_from_list(source, f"S_{k}")
        for k in ("00", "01")
    ]
    T_right_left = motion(rotation(source, "R_01"), source.vector("T_01", 3))
    return raw(source, (sides[0], sides[1]), (T_right_left, "R_01, T_01"), "KITTI raw calib_cam_to_cam.txt")


def _check_reference(source: Source) -> None:
    """R_01 and T_01 are against camera 0 only if camera 0 is where the others are measured from."""
    for key, shape, wanted in (("R_00", (3, 3), np.eye(3)), ("T_00", (3, 1), np.zeros((3, 1)))):
        if key in source and np.abs(source.matrix(key, *shape) - wanted).max() > _IDENTITY:
            raise source.wrong(key, source.values[key], "no motion: camera 0 is the reference")


def _both(source: Source, left: str, right: str) -> Found:
    """The image size of the left camera, which must be that of the right one."""
    one, other = size_from_list(source, left), size_from_list(source, right)
    if _pixels(one) != _pixels(other):
        (width, height), (its_width, its_height) = _pixels(one), _pixels(other)
        said = f"{left} is {width} x {height} px, {right} is {its_width} x {its_height} px"
        raise source.error(f"{said}, expected the same size")
    return one


def _pixels(found: Found) -> tuple[float, float]:
    return found["width"][0], found["height"][0]


def _is_nameless(text: str) -> bool:
    lines = [line.split() for _, line in _lines(text[: 1 << 14])]
    return 2 <= len(lines) <= 4 and all(len(words) == 12 and all(map(_NUMBER.fullmatch, words)) for words in lines)


def _number(word: str) -> float | str:
    return float(word) if _NUMBER.fullmatch(word) else word
