"""What lies in folders of colour images and depths: TUM's, ICL-NUIM's, ScanNet's, and plain ones."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._brief import Brief
from .._files import PathLike, bad_input, one_line, reason_of
from ..io.images import image_size
from ..io.trajectory import read_trajectory
from ..types import Camera, FloatArray
from ..vision.calibration.formats import read_calibration
from ..vision.se3 import inverse
from ._depth_reader import DepthCameras, depth_cameras
from ._pairing import (
    NANOSECONDS,
    check_stamps,
    images_in,
    numbers,
    pair_by_stamp,
    poses_at,
    rigid,
    seconds,
    some_known,
    table,
)

_LISTED = "a line for each image: its stamp in seconds, its file"
_ASSOCIATED = "a line for each pair: stamp and file of the one, stamp and file of the other"
_MATRIX = "4 x 4 numbers"
_RATE = 30.0  # images a second of ICL-NUIM and ScanNet, which number them
_TUM_UNIT, _MILLIMETRES = 1 / 5000, 1e-3
_APART = 0.6  # of the interval between images: TUM's own tools allow 0.02 s at 30 images a second
_COLOURS = ("rgb", "color", "colour", "image", "images")
_CALIBRATIONS = ("calib.yaml", "calib.yml", "calib.txt", "camera.yaml")
_ASSOCIATIONS = ("associations.txt", "association.txt", "associate.txt", "associated.txt")
_TUM = "published for TUM's RGB-D benchmark (vision.in.tum.de/data/datasets/rgbd-dataset/file_formats)"
PUBLISHED = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": (535.4, 539.2, 320.1, 247.6, (0.0, 0.0, 0.0, 0.0, 0.0)),
}
"""fx, fy, cx, cy and Brown's coefficients of the colour cameras of TUM's benchmark, 640 x 480 px, as published."""
_ICL = (481.2, 480.0, 319.5, 239.5)  # its fy is negative: y is up


@dataclass(frozen=True, repr=False)
class RgbdFiles(Brief):
    """What a folder holds.

    Attributes
    ----------
    kind : str
        Name of the layout.
    colour, depth : list of Path
        Files of the pairs.
    stamps : (n,) float64
        Of the images, s.
    apart : (n,) float64
        Stamps of the depths less those of the images, s.
    unpaired : list of str
        Files of the one without the other.
    unit : float or None
        Metres in one step of whole numbers; None where the layout does not tell.
    cameras : callable
        Reads the cameras of images of a size (width, height).
    truth : callable
        Reads true poses of the images, (n, 4, 4), NaN where there is none; None where there are none at all.
    """

    kind: str
    colour: list[Path]
    depth: list[Path]
    stamps: FloatArray
    apart: FloatArray
    unpaired: list[str]
    unit: float | None
    cameras: Callable[[tuple[int, int]], DepthCameras]
    truth: Callable[[], FloatArray | None]


def is_rgbd(folder: Path) -> bool:
    """Whether a folder looks like one of colour images and depths."""
    if all((folder / name).is_file() for name in ("rgb.txt", "depth.txt")):
        return True
    return (folder / "depth").is_dir() and _colour_of(folder) is not None


def find_files(folder: Path, calib: PathLike | None) -> RgbdFiles:
    """Find what a folder holds; `calib` stands in for its own calibration."""
    given = calib or next((folder / name for name in _CALIBRATIONS if (folder / name).is_file()), None)
    if all((folder / name).is_file() for name in ("rgb.txt", "depth.txt")):
        return _tum(folder, given)
    name = _colour_of(folder)
    if name is None or not (folder / "depth").is_dir():
        wanted = "rgb.txt and depth.txt, or rgb/ (or color/) and depth/"
        raise bad_input(folder, "is no folder of colour images and depths", wanted)
    listed = next((folder / name for name in _ASSOCIATIONS if (folder / name).is_file()), None)
    if listed:
        return _associated(folder, listed, given)
    return _by_name(folder, name, given)


def _colour_of(folder: Path) -> str | None:
    return next((name for name in _COLOURS if (folder / name).is_dir()), None)


def _tum(folder: Path, calib: PathLike | None) -> RgbdFiles:
    """Images and depths with stamps of their own, paired by the nearest."""
    sides = [_stamped(folder / f"{name}.txt") for name in ("rgb", "depth")]
    paired = pair_by_stamp(sides[0], sides[1], ("rgb", "depth"), apart=_APART)
    if 2 * len(paired.files) < min(map(len, sides)):
        times = [np.sort(np.array(list(side))) / NANOSECONDS for side in sides]
        after = np.searchsorted(times[1], times[0])
        around = times[1][np.clip([after - 1, after], 0, len(times[1]) - 1)]
        nearest = np.abs(around - times[0]).min(axis=0)
        said = f"pairs {len(paired.files)} of {len(sides[0])} images with one of {len(sides[1])} depth maps"
        far = f"the nearest depth map is {np.median(nearest):.4g} s from an image in the median"
        raise bad_input(folder, f"{said}: {far}", "stamps of one clock")
    at = {path: stamp for stamp, path in sides[1].items()}
    colour, depth = [one for one, _ in paired.files], [other for _, other in paired.files]
    apart = seconds([at[other] for other in depth]) - paired.stamps
    truth = folder / "groundtruth.txt"
    return RgbdFiles(
        "TUM", colour, depth, paired.stamps, apart, paired.unpaired, _TUM_UNIT, _read_cameras(folder, calib),
        lambda: _poses_of(truth, paired.stamps),
    )  # fmt: skip


def _stamped(path: Path) -> dict[int, Path | None]:
    """Files of a list by their stamp, ns; None for those that are not there."""
    rows = table(path, _LISTED, counts=(2,))
    stamps = [_nanoseconds(path, row, row[1][0]) for row in rows]
    check_stamps(path, seconds(stamps), "seconds", [line for line, _ in rows])
    files = [_inside(path, row[1][1]) for row in rows]
    if not any(file.is_file() for file in files):
        raise bad_input(path, f"lists files such as {rows[0][1][1][:80]}, none of which is there", _LISTED)
    return {stamp: file if file.is_file() else None for stamp, file in zip(stamps, files, strict=True)}


def _nanoseconds(path: Path, row: tuple[int, list[str]], word: str) -> int:
    (value,) = numbers(path, row, [word], _LISTED)
    if value < 0:
        raise bad_input(path, f"line {row[0]} has the stamp {word[:40]}", _LISTED)
    return round(value * 1e6) * 1000  # a double of a stamp since 1970 has a quarter of a microsecond


def _inside(path: Path, name: str) -> Path:
    """A file of a list, which may not lie outside of the list's folder."""
    parts = Path(name).parts
    if Path(name).is_absolute() or ".." in parts:
        raise bad_input(path, f"lists {name[:80]}", "files below its own folder")
    file = path.parent / name
    try:
        file.is_file()
    except (OSError, ValueError) as error:  # as of a name that is too long, or of a folder that may not be read
        raise bad_input(path, f"lists {name[:80]} ({reason_of(error)})", "files below its own folder") from error
    return file


def _associated(folder: Path, path: Path, calib: PathLike | None) -> RgbdFiles:
    """Pairs that a list tells, as of ICL-NUIM, whose stamps are numbers of images."""
    rows = table(path, _ASSOCIATED, counts=(4,))
    first = 0 if "depth" not in rows[0][1][1] else 2
    colour, depth = ([_inside(path, row[1][at + 1]) for row in rows] for at in (first, 2 - first))
    times = [np.array([numbers(path, row, [row[1][at]], _ASSOCIATED)[0] for row in rows]) for at in (first, 2 - first)]
    are_numbers = all(np.array_equal(each, np.rint(each)) for each in times)
    scale = _RATE if are_numbers else 1.0
    stamps, apart = times[0] / scale, (times[1] - times[0]) / scale
    check_stamps(path, stamps, "seconds", [line for line, _ in rows])
    there = [k for k in range(len(rows)) if colour[k].is_file() and depth[k].is_file()]
    if not there:
        raise bad_input(path, f"lists files such as {rows[0][1][1][:80]}, none of which is there", _ASSOCIATED)
    lone = [one_line(f"{file.parent.name}/{file.name}") for k in set(range(len(rows))) - set(there)
            for file in (colour[k], depth[k]) if file.is_file()]  # fmt: skip
    icl = next(iter(sorted(folder.glob("*.gt.freiburg"))), None)
    truth = icl or folder / "groundtruth.txt"
    return RgbdFiles(
        "ICL-NUIM" if icl else "TUM", [colour[k] for k in there], [depth[k] for k in there], stamps[there],
        apart[there], sorted(lone), _TUM_UNIT, _read_cameras(folder, calib, is_icl=icl is not None),
        lambda: _poses_of(truth, stamps[there], scale=scale, is_mirrored=icl is not None),
    )  # fmt: skip


def _by_name(folder: Path, name: str, calib: PathLike | None) -> RgbdFiles:
    """Images and depths of one name; ScanNet's with cameras and poses as text."""
    colour, depth = ({file.stem: file for file in _files(folder / side)} for side in (name, "depth"))
    both = [stem for stem in colour if stem in depth]
    lone = [f"{name}/{file.name}" for stem, file in colour.items() if stem not in depth]
    lone += [f"depth/{file.name}" for stem, file in depth.items() if stem not in colour]
    if not both:
        raise bad_input(folder, f"{len(colour)} files in {name}/ and {len(depth)} in depth/ share no name", "some")
    is_scannet = (folder / "intrinsic").is_dir()
    is_numbered = all(re.fullmatch("[0-9]{1,9}", stem) for stem in both)
    places = np.array([int(stem) if is_numbered else k for k, stem in enumerate(both)], np.float64)
    if (np.diff(places) <= 0).any():
        raise bad_input(folder / name, "has two images of one number", "one each")
    return RgbdFiles(
        "ScanNet" if is_scannet else "plain", [colour[stem] for stem in both], [depth[stem] for stem in both],
        places / (_RATE if is_scannet else 1.0), np.zeros(len(both)), [one_line(each) for each in lone],
        _MILLIMETRES if is_scannet else None,
        _scannet_cameras(folder, calib) if is_scannet else _read_cameras(folder, calib),
        lambda: _scannet_poses(folder / "pose", both),
    )  # fmt: skip


def _files(folder: Path) -> list[Path]:
    """Images, or arrays of depths, of a folder."""
    arrays = sorted(folder.glob("*.npy"))
    return arrays or list(images_in(folder).values())


def _read_cameras(
    folder: Path, calib: PathLike | None, *, is_icl: bool = False
) -> Callable[[tuple[int, int]], DepthCameras]:
    """Cameras of a calibration file, else those that are published for the benchmark that the folder is of."""

    def read(size: tuple[int, int]) -> DepthCameras:
        if calib is not None:
            return depth_cameras(read_calibration(calib, size).cameras, Path(calib).name)
        known = next((name for name in PUBLISHED if name in folder.resolve().name.lower()), None)
        if size == (640, 480) and known:
            fx, fy, cx, cy, lens = PUBLISHED[known]
            return DepthCameras(Camera(fx, fy, cx, cy, *size, distortion=lens), origin=f"{known}: {_TUM}")
        if size == (640, 480) and is_icl:
            return DepthCameras(Camera(*_ICL, *size), origin="published for ICL-NUIM, with y turned down")
        wanted = (
            f"{', '.join(_CALIBRATIONS)} in it, a file by --calib (calib=), or the name of one of TUM's (freiburg1)"
        )
        raise bad_input(folder, "holds no calibration", wanted)

    return read


def _scannet_cameras(folder: Path, calib: PathLike | None) -> Callable[[tuple[int, int]], DepthCameras]:
    """Cameras of ``intrinsic/``: each extrinsic maps its camera's points to a frame that both share."""

    def read(size: tuple[int, int]) -> DepthCameras:
        if calib is not None:
            return _read_cameras(folder, calib)(size)
        at = folder / "intrinsic"
        K = _matrix(at / "intrinsic_color.txt")
        colour = Camera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], *size, skew=K[0, 1])
        first = next(iter(images_in(folder / "depth").values()))
        D, own = _matrix(at / "intrinsic_depth.txt"), image_size(first)
        places = [at / f"extrinsic_{side}.txt" for side in ("color", "depth")]
        E = [rigid(path, _matrix(path)[None])[0] if path.exists() else np.eye(4) for path in places]
        T = inverse(E[0]) @ E[1]
        if own == size and np.array_equal(K, D) and np.array_equal(T, np.eye(4)):
            return DepthCameras(colour, origin="intrinsic/intrinsic_color.txt")
        camera = Camera(D[0, 0], D[1, 1], D[0, 2], D[1, 2], *own, skew=D[0, 1])
        return DepthCameras(colour, camera, T, "intrinsic/")

    return read


def _matrix(path: Path) -> FloatArray:
    rows = table(path, _MATRIX, counts=(4,))
    if len(rows) != 4:
        raise bad_input(path, f"has {len(rows)} lines of numbers", _MATRIX)
    return np.array([numbers(path, row, row[1], _MATRIX) for row in rows])


def _scannet_poses(folder: Path, names: Sequence[str]) -> FloatArray | None:
    """Poses of the images; those that are not finite, or have no file, are not known."""
    if not folder.is_dir():
        return None
    T = np.full((len(names), 4, 4), np.nan)
    for k, name in enumerate(names):
        path = folder / f"{name}.txt"
        if path.exists() and not _is_lost(path):
            T[k] = rigid(path, _matrix(path)[None])[0]
    return some_known(T, folder, "4 x 4 numbers in a file for each image")


def _is_lost(path: Path) -> bool:
    """Whether a pose is written as infinite or as no number."""
    return any(word.lower().lstrip("+-") in ("inf", "nan") for _, words in table(path, _MATRIX) for word in words)


def _poses_of(path: Path, stamps: FloatArray, *, scale: float = 1.0, is_mirrored: bool = False) -> FloatArray | None:
    """Poses at the images' stamps from those of a file of TUM's form; y of camera and world turned where mirrored."""
    if not os.path.exists(path):
        return None
    found = read_trajectory(path)
    known = np.isfinite(found.T_world_camera[:, 0, 0])
    times, T = found.stamp[known] / scale, found.T_world_camera[known]
    if is_mirrored:
        turn = np.diag([1.0, -1.0, 1.0, 1.0])
        T = turn @ T @ turn
    return some_known(poses_at(stamps, times, T), path, "poses at most 0.1 s before and after an image")
