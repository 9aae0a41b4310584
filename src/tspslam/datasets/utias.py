"""Runs of the UTIAS Long-Term Localization and Mapping Dataset (VT&R 2020: In The Dark, Multiseason)."""

from __future__ import annotations

import os
import re
from collections import deque
from functools import cached_property
from pathlib import Path

import numpy as np

from .._files import PathLike, bad_input
from ..types import FloatArray, RawRig, Rig
from ..vision.calibration.formats import read_calibration
from ._pairing import (
    Recording,
    Row,
    check_stamps,
    motion,
    name_of,
    numbered,
    numbers,
    pair_by_number,
    path_of,
    rigid,
    rows_by_number,
    seconds,
    size_of_first,
    some,
    some_known,
    table,
    whole,
)

_RIG = Rig(fx=387.777, fy=387.777, cx=257.446, cy=197.718, baseline=0.239965, width=512, height=384)
# Where the camera is on the robot, as published programs on this data set have it: camera from vehicle.
_T_CAMERA_VEHICLE = np.array(
    [
        [0.000796327, -1.0, 0.0, 0.119873],
        [-0.330472, -0.000263164, -0.943816, 1.49473],
        [0.943815, 0.000751586, -0.330472, 0.354804],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
_STAMPS = "timestamps_images.txt"
_TEMPORAL, _SPATIAL = "transforms_temporal.txt", "transforms_spatial.txt"
_STAMPED = "lines of a pose's number, a comma and its stamp in nanoseconds"
_ROWS = "lines of run, pose, neighbour's run and pose, and a 3 x 4 or 4 x 4 transform, separated by commas"
_RUN = re.compile(r"run_([0-9]{1,9})")
_APART = 1e-2  # of two transforms between the same poses, m, and of their rotations' entries
_Pose = tuple[int, int]  # run and pose
_Edge = tuple[_Pose, _Pose, FloatArray]  # pose, neighbour, T_neighbour_pose


class UtiasRun(Recording):
    """A run `run_NNNNNN/` of the UTIAS VT&R data set: `images/left`, `images/right`, `timestamps_images.txt`.

    Images are named by the number of their pose and paired by it. Where the lines of stamps do not name their pose,
    line k, from 0, is for pose k, and a blank one leaves it without a stamp; images without one are left out and listed
    in `unpaired`.

    Parameters
    ----------
    path : str or path
        The folder of the run.
    calib : str or path, optional
        Calibration, as `tspslam.read_calibration` reads it; by default `calib.yaml` or `calib.txt` in the run or in
        the folder it is in. No run ships one: else it is the rig that the data set's authors give, rectified,
        512 x 384 px, ``fx = fy = 387.777``, ``cx = 257.446``, ``cy = 197.718`` px, baseline 0.239965 m.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    stamps : (n,) float64
        Times of the frames, s.
    unpaired : list of str
        Images without a partner or a stamp, as ``left/000012.png``.

    Raises
    ------
    InputError
        If a part is missing or cannot be read, stamps do not increase with the poses or are no nanoseconds, images
        have not the size of the calibration, or no pair is found.

    Examples
    --------
    >>> UtiasRun("no-such-run")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-run/images/left: is missing; expected a folder of images
    """

    def __init__(self, path: PathLike, calib: PathLike | None = None, *, bits: int | None = None) -> None:
        self.path = path_of(path)
        left, right = (numbered(self.path / "images" / side) for side in ("left", "right"))
        paired = pair_by_number(left, right, _stamps(self.path / _STAMPS), ("left", "right"))
        some(paired, self.path, f"images/left and images/right of one number with a stamp in {_STAMPS}")
        self._open(paired, _cameras(self.path, calib, size_of_first(paired.files)), bits)

    @cached_property
    def truth(self) -> FloatArray | None:
        """Poses ``T_world_camera`` of the rectified left camera, (n, 4, 4) float64; None if there are none.

        A row `run, pose, neighbour's run, neighbour's pose, T` of a file of transforms has ``T_neighbour_pose``: it
        maps a point of the pose's frame to the neighbour's. These frames are the robot's (x forward, y left, z up);
        the place of the camera on it is that which the authors of the data set give. The transforms of
        `transforms_temporal.txt` are chained, and the world is the camera's frame at the first pose of that file. A
        repeated run without this file is placed by its `transforms_spatial.txt` against the run that was taught, if
        its folder is beside this one; then the world is the camera's frame at that run's first pose. Rows are NaN for
        poses that the chain does not reach. These are estimates of visual odometry and localisation, good from one
        pose to the next. InputError if a file is bad, is of another run than the folder's name says, has two rows
        that contradict each other, or places no image.
        """
        found = _edges_of(self.path)
        if found is None:
            return None
        run, edges = found
        placed = _chained(edges)
        T_vehicle_camera = np.linalg.inv(_mount()) @ motion(self._frames.R_left.T)
        truth = np.full((len(self), 4, 4), np.nan)
        for k, (left, _) in enumerate(self._frames.files):
            if (run, int(left.stem)) in placed:
                truth[k] = _mount() @ placed[run, int(left.stem)] @ T_vehicle_camera
        return some_known(truth, self.path, f"transforms of run {run} to the poses that images are named by")


def _stamps(path: Path) -> dict[int, float]:
    """Stamps (s) by the number of the pose; of lines with a stamp only, the first is for pose 0, even a blank one."""
    by_line = rows_by_number(path, _STAMPED, ",", (1, 2))
    rows = list(by_line.values())
    if len({len(words) for _, words in rows}) > 1:
        raise bad_input(path, "has lines of one and of two values", _STAMPED)
    is_named = len(rows[0][1]) == 2
    poses = [whole(path, row, row[1][0], _STAMPED) if is_named else number for number, row in by_line.items()]
    for k, (line, _) in enumerate(rows[1:], 1):
        if poses[k] <= poses[k - 1]:
            raise bad_input(path, f"line {line} has pose {poses[k]} behind {poses[k - 1]}", "numbers that increase")
    times = seconds([whole(path, row, row[1][-1], _STAMPED) for row in rows])
    check_stamps(path, times, "nanoseconds", [line for line, _ in rows])
    return dict(zip(poses, times.tolist(), strict=True))


def _cameras(run: Path, calib: PathLike | None, size: tuple[int, int]) -> Rig | RawRig:
    places = [folder / name for folder in (run, run.resolve().parent) for name in ("calib.yaml", "calib.txt")]
    path = next((place for place in places if os.path.exists(place)), None) if calib is None else path_of(calib)
    if path is not None:
        return read_calibration(path, size).cameras
    if size != (_RIG.width, _RIG.height):
        wanted = f"{_RIG.width} x {_RIG.height} px, or a calibration (calib=)"
        raise bad_input(run, f"images are {size[0]} x {size[1]} px and there is no calib.yaml", wanted)
    return _RIG


def _mount() -> FloatArray:
    """``T_camera_vehicle`` with an exact rotation, (4, 4)."""
    return rigid(Path("mount"), _T_CAMERA_VEHICLE[None])[0]


def _edges_of(run: Path) -> tuple[int, list[_Edge]] | None:
    """Number of the run and the transforms that place its poses; None if there are no such files."""
    file = next((run / name for name in (_TEMPORAL, _SPATIAL) if os.path.exists(run / name)), None)
    if file is None:
        return None
    edges = _edges(file)
    (own, _), (taught, _), _ = edges[0]
    named = _RUN.fullmatch(name_of(run))
    if named and int(named[1]) != own:
        raise bad_input(file, f"is of run {own}", f"transforms of run {int(named[1])}, as the folder's name says")
    if file.name == _TEMPORAL:
        return own, edges
    path = run.resolve().parent / f"run_{taught:06d}" / _TEMPORAL
    return (own, _edges(path) + edges) if os.path.exists(path) else None


def _edges(path: Path) -> list[_Edge]:
    rows = table(path, _ROWS, ",", (16, 20))
    names = [[_number(path, row, word) for word in row[1][:4]] for row in rows]
    values = [numbers(path, row, row[1][4:], _ROWS) for row in rows]
    for (line, _), tail in zip(rows, values, strict=True):
        if len(tail) == 16 and tail[12:] != [0, 0, 0, 1]:
            raise bad_input(
                path, f"line {line} ends with {tail[12:]}", "a 4 x 4 transform with the last row 0, 0, 0, 1"
            )
    T = rigid(path, np.array([tail[:12] for tail in values]).reshape(-1, 3, 4))
    edges = [((a, b), (c, d), each) for (a, b, c, d), each in zip(names, T, strict=True)]
    _check_agreement(path, rows, edges)
    return edges


def _check_agreement(path: Path, rows: list[Row], edges: list[_Edge]) -> None:
    """Refuse two transforms between the same poses that are not the same, in either direction."""
    known: dict[tuple[_Pose, _Pose], FloatArray] = {}
    for (line, _), (one, other, T) in zip(rows, edges, strict=True):
        before = np.eye(4) if one == other else known.get((one, other))
        if before is not None and np.abs(T - before).max() > _APART:
            said = f"line {line} contradicts what is known of poses {one[1]} and {other[1]}"
            raise bad_input(path, said, "one transform between two poses")
        known[one, other], known[other, one] = T, np.linalg.inv(T).astype(np.float64)


def _number(path: Path, row: Row, word: str) -> int:
    """A whole number that may be written as 1.2e+01."""
    (value,) = numbers(path, row, [word], _ROWS)
    if not (value.is_integer() and 0 <= value < 1e9):
        raise bad_input(path, f"line {row[0]} has {word[:40]!r}", _ROWS)
    return int(value)


def _chained(edges: list[_Edge]) -> dict[_Pose, FloatArray]:
    """Poses that transforms lead to from the first one, each by the fewest, in the frame of the first."""
    links: dict[_Pose, list[tuple[_Pose, FloatArray]]] = {}
    for one, other, T_other_one in edges:
        links.setdefault(one, []).append((other, np.linalg.inv(T_other_one).astype(np.float64)))
        links.setdefault(other, []).append((one, T_other_one))
    placed = {edges[0][0]: np.eye(4)}
    ahead = deque(placed)
    while ahead:
        here = ahead.popleft()
        for there, T_here_there in links[here]:
            if there not in placed:
                placed[there] = placed[here] @ T_here_there
                ahead.append(there)
    return placed
