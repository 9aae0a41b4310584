"""Recordings in the ASL layout, as EuRoC's."""

from __future__ import annotations

import os
from functools import cached_property
from pathlib import Path

import numpy as np

from .._files import PathLike, bad_input, one_line
from ..types import FloatArray
from ..vision.calibration.formats import read_calibration
from ..vision.calibration.formats._opencv_yaml import read_mapping
from ..vision.calibration.formats._source import Source
from ..vision.calibration.formats._values import inverse, pose
from ._pairing import (
    Paired,
    Recording,
    check_stamps,
    images_in,
    motion,
    motions,
    name_of,
    numbers,
    pair_by_stamp,
    path_of,
    poses_at,
    seconds,
    size_of_first,
    some,
    some_known,
    table,
    whole,
)

_CAMERAS = ("cam0", "cam1")
_TRUTHS = ("state_groundtruth_estimate0", "vicon0")
_LISTED = "a line for each image: its stamp in nanoseconds, a comma, its file name"
_POSES = "lines of a stamp in nanoseconds, a position (m) and a quaternion with w first, separated by commas"
_RECORDING = "a recording in the ASL layout"
_UNIT = 1e-2  # of a quaternion's norm


class EurocSequence(Recording):
    """A recording in the ASL layout: two cameras below `mav0/`, with stamps; raw pairs are rectified.

    Left and right images are paired by stamp: the same one, else the nearest to each other within a quarter of the
    median interval of the list (`data.csv`) that has the shorter. Lists are paired first: the partner of an image that
    is listed but not there is left out, and goes to no other. A file that differs from its name in the list by the
    suffix only is taken for it (a list of ``.png`` and a folder of ``.jpg``).

    Parameters
    ----------
    path : str or path
        The folder with `mav0/`, or `mav0` itself. Of `cam0` and `cam1` it needs `data/`, `data.csv` and
        `sensor.yaml`.
    bits : int, optional
        How many bits 16-bit pixels use, as in `StereoFolder`.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    stamps : (n,) float64
        Times of the left images, s.
    unpaired : list of str
        Images without a partner, a stamp or a file, as ``cam0/name.png``.

    Raises
    ------
    InputError
        If a part is missing or cannot be read, stamps do not increase or are no nanoseconds, or no pair is found.

    Examples
    --------
    >>> EurocSequence("no-such-folder")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: lacks the folder mav0/cam0; expected a recording in the ASL layout
    """

    def __init__(self, path: PathLike, *, bits: int | None = None) -> None:
        self.path = path_of(path)
        self._root = self.path / "mav0" if os.path.isdir(self.path / "mav0") else self.path
        if not os.path.isdir(self._root / "cam0"):
            raise bad_input(self.path, "lacks the folder mav0/cam0", _RECORDING)
        (left, lost), (right, its_lost) = (_listed(self._root / camera) for camera in _CAMERAS)
        paired = some(pair_by_stamp(left, right, _CAMERAS), self._root, "cam0 and cam1 with images of the same stamps")
        paired = Paired(paired.files, paired.stamps, paired.unpaired + lost + its_lost)
        calibration = read_calibration(self._root / "cam0" / "sensor.yaml", size_of_first(paired.files))
        self._open(paired, calibration.cameras, bits)

    @property
    def name(self) -> str:
        """Name of the recording's folder, the one with `mav0` in it."""
        root = self._root.resolve()
        return name_of(root.parent if root.name == "mav0" else root)

    @cached_property
    def truth(self) -> FloatArray | None:
        """True poses ``T_world_camera`` of the rectified left camera, (n, 4, 4) float64; None if there are none.

        From `state_groundtruth_estimate0` or else `vicon0`. Both give the pose ``T_RS`` of a sensor whose own
        `sensor.yaml` has its place ``T_BS`` in the body; it must be there for the markers of `vicon0`, and without
        one the estimate is the body's. So ``T_world_camera = T_RS T_BS⁻¹ T_BS(cam0) R_leftᵀ``. Between two
        measurements the position is interpolated linearly and the rotation along the shortest arc; rows are NaN
        where there are none at most 0.1 s before and after. InputError if a file is bad or that is so for all.
        """
        folder = next((self._root / name for name in _TRUTHS if os.path.exists(self._root / name / "data.csv")), None)
        if folder is None:
            return None
        stamps, T_world_sensor = _measured(folder / "data.csv")
        T_body_camera = _place(self._root / "cam0") @ motion(self._frames.R_left.T)
        optional = folder.name == _TRUTHS[0] and not os.path.exists(folder / "sensor.yaml")
        T_sensor_camera = T_body_camera if optional else inverse(_place(folder)) @ T_body_camera
        known, wanted = poses_at(self.stamps, stamps, T_world_sensor), "poses at most 0.1 s before and after one"
        return some_known(known, folder / "data.csv", wanted) @ T_sensor_camera


def _listed(camera: Path) -> tuple[dict[int, Path | None], list[str]]:
    """Images of a camera by stamp (ns), None for those that are lost; and those that only list or folder have."""
    path, files = camera / "data.csv", images_in(camera / "data")
    rows = table(path, _LISTED, ",", (2,))
    stamps = [whole(path, row, row[1][0], _LISTED) for row in rows]
    check_stamps(path, seconds(stamps), "nanoseconds", [line for line, _ in rows])
    named = dict(zip([row[1][1] for row in rows], stamps, strict=True))
    if len(named) < len(rows):
        raise bad_input(path, "has a file name twice", _LISTED)
    found = _found(path, list(named), files)
    taken = {file.name for file in found.values() if file}
    lone = [name for name, file in found.items() if not file] + [name for name in files if name not in taken]
    return {stamp: found[name] for name, stamp in named.items()}, [one_line(f"{camera.name}/{name}") for name in lone]


def _found(path: Path, names: list[str], files: dict[str, Path]) -> dict[str, Path | None]:
    """File of each name of a list: that of this name, else the one that differs from it in the suffix only."""
    others: dict[str, list[Path]] = {}
    for name in files.keys() - set(names):
        others.setdefault(files[name].stem, []).append(files[name])
    found: dict[str, Path | None] = {}
    for name in names:
        there = [files[name]] if name in files else others.pop(Path(name).stem, [])
        if len(there) > 1:
            said = " and ".join(sorted(file.name for file in there)[:2])
            raise bad_input(path, f"lists {name[:80]}, and data/ has {said}", "one file for it")
        found[name] = there[0] if there else None
    if files and not any(found.values()):
        raise bad_input(
            path, f"lists files such as {names[0][:80]}, none of which is in data/", f"{next(iter(files))}, ..."
        )
    return found


def _measured(path: Path) -> tuple[FloatArray, FloatArray]:
    """Stamps (s) and poses (n, 4, 4) of a sensor."""
    from scipy.spatial.transform import Rotation

    rows = table(path, _POSES, ",")
    short = next((row for row in rows if len(row[1]) < 8), None)
    if short:
        raise bad_input(path, f"line {short[0]} has {len(short[1])} values", _POSES)
    rows = [row for row in rows if any(word.lower() != "nan" for word in row[1][1:8])] or rows  # the others are lost
    stamps = seconds([whole(path, row, row[1][0], _POSES) for row in rows])
    check_stamps(path, stamps, "nanoseconds", [line for line, _ in rows])
    values = np.array([numbers(path, row, row[1][1:8], _POSES) for row in rows])
    norm = np.linalg.norm(values[:, 3:], axis=1)
    if (bad := np.flatnonzero(np.abs(norm - 1) > _UNIT)).size:
        raise bad_input(path, f"the quaternion of pose {bad[0] + 1} has norm {norm[bad[0]]:.4g}", "1")
    R = Rotation.from_quat(values[:, [4, 5, 6, 3]]).as_matrix()
    return stamps, motions(R, values[:, :3])


def _place(sensor: Path) -> FloatArray:
    """Place of a sensor in the body's frame, (4, 4)."""
    path = sensor / "sensor.yaml"
    return pose(Source(path, read_mapping(path, "a sensor.yaml with T_BS")), "T_BS")
