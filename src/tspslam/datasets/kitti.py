"""KITTI: sequences of the odometry benchmark, and drives of the raw data."""

from __future__ import annotations

import os
import re
from datetime import datetime
from functools import cached_property
from pathlib import Path

import numpy as np

from .._files import PathLike, bad_input
from .._text import read_text
from ..errors import InputError
from ..types import FloatArray, RawRig, Rig
from ..vision.calibration.formats._source import Source
from ..vision.calibration.formats.readers.kitti import parse_kitti, read_kitti
from ._pairing import (
    LAST_STAMP,
    NANOSECONDS,
    Paired,
    Recording,
    check_stamps,
    motion,
    numbered,
    numbers,
    pair_by_number,
    pair_by_stamp,
    path_of,
    rigid,
    rows_by_number,
    seconds,
    size_of_first,
    some,
)

_DATE = re.compile(r"([0-9]{4}-[0-9]{2}-[0-9]{2}) ([0-9]{2}:[0-9]{2}:[0-9]{2})\.([0-9]{1,9})")
_DATES = "a time for each image, such as 2011-09-26 14:05:35.500923136, from 1970 to 2261"
_TIMES = "a time in seconds for each image"
_POSES = "lines of 12 numbers: the upper three rows of a pose, row by row"
_CALIBRATION, _SEQUENCE = "a calibration of KITTI", "a sequence of KITTI"
_LARGEST_CALIBRATION = 1 << 20  # bytes
_BESIDE = 1e-2  # of the baseline: how far camera 3 may be off the x axis of camera 2
_FARTHEST = 1e6  # m, of a camera from camera 0
_GREY = re.compile(r"\b(P|[A-Z]_(?:rect_)?0)([01])\b")  # a key of cameras 0 and 1
_OF_A_CAMERA = ("S", "K", "D", "R", "T", "S_rect", "R_rect", "P_rect")


class KittiSequence(Recording):
    """A sequence of KITTI's odometry benchmark, or a drive of its raw data, synchronised and rectified or as recorded.

    An odometry sequence has `image_0/` and `image_1/`, `calib.txt` and `times.txt` (s); line k, from 0, is for the
    image of number k, and images are paired by number. A raw drive has `image_00/` and `image_01/`, each with `data/`
    and `timestamps.txt` in the same way, and `calib_cam_to_cam.txt` in its folder or the one above; images are paired
    by stamp, as those of `EurocSequence`. A blank line stands for an image that was lost: the lines behind it keep
    their numbers, and an image that is there all the same has no stamp. It is left out and listed in `unpaired`;
    no stamp is made up for it. The size of its images tells recorded ones, which are rectified here, from rectified
    ones.

    Parameters
    ----------
    path : str or path
        The folder of the sequence or drive.
    colour : bool
        Read the colour cameras (`image_2` and `image_3`, or `image_02` and `image_03`). Of the right one's place
        only the distance along the rows is used; it is 3 mm off the row.
    poses : str or path, optional
        True poses in KITTI's form, for each left image or for each number from 0; by default `poses.txt` in the
        folder or `../../poses/NN.txt`, if there is one. A blank line, or one of 12 NaN, is a pose that is not known.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    stamps : (n,) float64
        Times of the left images, s; of a raw drive since 1970, its clock taken for UTC.
    unpaired : list of str
        Images without a partner or a stamp, as ``image_0/000012.png``.

    Raises
    ------
    InputError
        If a part is missing or cannot be read, stamps do not increase or are in another unit, no pair is found, or
        the poses that are given are bad.

    Examples
    --------
    >>> KittiSequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: lacks the folder image_0 or image_00; expected a sequence of KITTI
    """

    def __init__(
        self, path: PathLike, *, colour: bool = False, poses: PathLike | None = None, bits: int | None = None
    ) -> None:
        self.path = path_of(path)
        self._cameras = ("2", "3") if colour else ("0", "1")
        self._is_raw = _is_raw(self.path, self._cameras[0])
        if self._is_raw:
            self._cameras = (f"0{self._cameras[0]}", f"0{self._cameras[1]}")
        paired = self._paired()
        self._source = _calibration(self.path, self._is_raw)
        named = _as_grey(self._source, self._is_raw) if colour else self._source
        self._open(paired, _cameras_of(named, size_of_first(paired.files), self._source), bits)
        self._poses = _poses_of(self.path) if poses is None else path_of(poses)
        if poses is not None:
            _ = self.truth

    @cached_property
    def truth(self) -> FloatArray | None:
        """True poses ``T_world_camera`` of the rectified left camera, (n, 4, 4) float64; None if there are none.

        KITTI's poses are those of the rectified camera 0. They are carried over to the left camera of the pairs:
        camera 2, or the frame into which recorded images are turned here. Rows are NaN for blank lines and numbers
        behind the last line. InputError if the file is bad.
        """
        if self._poses is None:
            return None
        T = _read_poses(self._poses)
        files = list(self._left)
        lines = {n: k for k, n in enumerate(files)} if len(T) == len(files) else {n: n for n in range(len(T))}
        at = [lines.get(int(left.stem)) for left, _ in self._frames.files]
        if all(line is None for line in at):
            wanted = f"one for each of the {len(files)} left images, or for numbers to {files[-1]}"
            raise bad_input(self._poses, f"has {len(T)} poses, none of an image", wanted)
        T_world_zero = np.stack([np.full((4, 4), np.nan) if line is None else T[line] for line in at])
        return T_world_zero @ self._T_zero_camera()

    def _paired(self) -> Paired:
        labels = (f"image_{self._cameras[0]}", f"image_{self._cameras[1]}")
        folders = [self.path / label for label in labels]
        left, right = (numbered(folder / "data" if self._is_raw else folder) for folder in folders)
        self._left = left
        if not self._is_raw:
            times = _read_times(self.path / "times.txt")
            return some(pair_by_number(left, right, times, labels), self.path, f"{labels[0]} and {labels[1]} alike")
        one, other = (_stamped(folder, side) for folder, side in zip(folders, (left, right), strict=True))
        paired = pair_by_stamp(one[0], other[0], labels)
        lone = Paired(paired.files, paired.stamps, paired.unpaired + one[1] + other[1])
        return some(lone, self.path, f"{labels[0]} and {labels[1]} with images of the same stamps")

    def _T_zero_camera(self) -> FloatArray:
        """Place of the pairs' left camera in the rectified camera 0's frame, (4, 4)."""
        camera = self._cameras[0]
        place = motion(np.eye(3), -_shift(self._source, f"P_rect_{camera}" if self._is_raw else f"P{camera}"))
        if not self._frames.is_turned:
            return place
        return place @ motion(self._source.matrix(f"R_rect_{camera}", 3, 3) @ self._frames.R_left.T)


def _is_raw(path: Path, camera: str) -> bool:
    for prefix in ("", "0"):
        if os.path.isdir(path / f"image_{prefix}{camera}"):
            return prefix == "0"
    there = any(os.path.isdir(path / f"image_{k}") for k in ("0", "2", "00", "02"))
    hint = f" (or colour={camera == '0'}, whose images are there)" if there else ""
    raise bad_input(path, f"lacks the folder image_{camera} or image_0{camera}", f"{_SEQUENCE}{hint}")


def _read_times(path: Path) -> dict[int, float]:
    """Times (s) by the number of the image."""
    rows = rows_by_number(path, _TIMES, None, (1,))
    times = {number: numbers(path, row, row[1], _TIMES)[0] for number, row in rows.items()}
    check_stamps(path, np.array(list(times.values())), "seconds", [line for line, _ in rows.values()])
    return times


def _stamped(folder: Path, images: dict[int, Path]) -> tuple[dict[int, Path | None], list[str]]:
    """Images of a raw camera by stamp (ns), None for those that are lost; and the names of those without a stamp."""
    path = folder / "timestamps.txt"
    rows = rows_by_number(path, _DATES)
    stamps = {number: _nanoseconds(path, line, " ".join(words)) for number, (line, words) in rows.items()}
    check_stamps(path, seconds(list(stamps.values())), "dates and times", [line for line, _ in rows.values()])
    lone = [f"{folder.name}/{file.name}" for number, file in images.items() if number not in stamps]
    return {stamp: images.get(number) for number, stamp in stamps.items()}, lone


def _nanoseconds(path: Path, line: int, text: str) -> int:
    said = _DATE.fullmatch(text)
    try:
        day, time, part = said.groups() if said else ("", "", "")
        whole = int(datetime.fromisoformat(f"{day}T{time}+00:00").timestamp())
    except ValueError:
        whole = -1
    stamp = whole * NANOSECONDS + int(part.ljust(9, "0"))
    if not 0 <= stamp <= LAST_STAMP:
        raise bad_input(path, f"line {line} has {text[:40]!r}", _DATES)
    return stamp


def _calibration(path: Path, is_raw: bool) -> Source:
    """Values of the calibration file."""
    place = path / "calib.txt"
    if is_raw:
        name = "calib_cam_to_cam.txt"
        place = next((at for at in (path / name, path.resolve().parent / name) if os.path.exists(at)), path / name)
    return parse_kitti(read_text(place, _CALIBRATION, _LARGEST_CALIBRATION), place)


def _cameras_of(named: Source, size: tuple[int, int], source: Source) -> Rig | RawRig:
    """Cameras of a source; if it names the colour cameras of another one as grey ones, an error has their own names."""
    try:
        return read_kitti(named, size).cameras
    except InputError as error:
        if named is source:
            raise
        said = _GREY.sub(lambda key: f"{key[1]}{int(key[2]) + 2}", str(error).removeprefix(": "))
        raise source.error(said) from error


def _as_grey(source: Source, is_raw: bool) -> Source:
    """Values of the colour cameras 2 and 3 under the names of 0 and 1, measured from camera 2; without a path."""
    names = ("P_rect_02", "P_rect_03") if is_raw else ("P2", "P3")
    left, right = (source.matrix(name, 3, 4) for name in names)
    x, y, z = _shift(source, names[1]) - _shift(source, names[0])
    if max(abs(y), abs(z)) > _BESIDE * abs(x):
        raise source.error(
            f"{names[1]} is {y:.3g} and {z:.3g} m off {names[0]} in y and z, expected less than 1 % of x"
        )
    left[:, 3], right[:, 3] = 0, (right[0, 0] * x, 0, 0)
    if not is_raw:
        return Source("", {"P0": left.tolist(), "P1": right.tolist()})
    values = {
        f"{name}_{new}": source.value(f"{name}_{old}", "the values of the colour cameras")
        for name in _OF_A_CAMERA
        for old, new in (("02", "00"), ("03", "01"))
    }
    R_02, R_03 = (source.matrix(key, 3, 3) for key in ("R_02", "R_03"))
    R = R_03 @ R_02.T
    t = np.array(source.vector("T_03", 3)) - R @ source.vector("T_02", 3)
    values |= {"R_00": np.eye(3).tolist(), "T_00": [0.0, 0.0, 0.0], "R_01": R.tolist(), "T_01": t.tolist()}
    return Source("", values | {"P_rect_00": left.tolist(), "P_rect_01": right.tolist()})


def _shift(source: Source, name: str) -> FloatArray:
    """Return t of ``P = K [I | t]``, m: a point of camera 0's frame is at ``x + t`` in this camera's."""
    P = source.matrix(name, 3, 4)
    try:
        t = np.linalg.solve(P[:, :3], P[:, 3]).astype(np.float64)
    except np.linalg.LinAlgError:
        t = np.full(3, np.nan)
    if not (np.abs(t) <= _FARTHEST).all():
        raise source.wrong(name, P.tolist(), "a projection K [I | t] with |t| at most 1e6 m")
    return t


def _poses_of(path: Path) -> Path | None:
    """File of true poses in the place that KITTI has for it."""
    own = path.resolve()
    places = (path / "poses.txt", own.parent.parent / "poses" / f"{own.name}.txt")
    return next((place for place in places if os.path.exists(place)), None)


def _read_poses(path: Path) -> FloatArray:
    """Poses (n, 4, 4) of a file in KITTI's form, by the number of the line from 0; NaN where there is none."""
    rows = rows_by_number(path, _POSES, None, (12,))
    known = {k: row for k, row in rows.items() if any(word.lower() != "nan" for word in row[1])}
    if not known:
        raise bad_input(path, "has no pose that is known", _POSES)
    T = np.full((max(rows) + 1, 4, 4), np.nan)
    values = np.array([numbers(path, row, row[1], _POSES) for row in known.values()]).reshape(-1, 3, 4)
    T[list(known)] = rigid(path, values)
    return T
