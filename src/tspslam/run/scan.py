"""A LiDAR's scan and a posed image to a run folder: one complex over the scan, signals where the camera sees it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from .._checks import require, require_path
from .._files import PathLike, bad_input, one_line
from ..datasets.maps import read_levelled
from ..errors import InputError
from ..frame import Frame
from ..interop.meshes import from_arrays
from ..io.clouds import Scan, read_scan
from ..topology.crust import crust_surface
from ..topology.harmonic import Tmahf
from ..topology.scan_surface import RangeSurface, ScanSurface
from ..types import FloatArray, Rig, Surface
from ..vision.calibration.extrinsics import read_extrinsics
from ..vision.calibration.formats import read_rectified
from ..vision.rig import doubts, project
from .mesh import filter_record, write_filtered
from .pipeline import RunResult
from .record import array_hash, hash_of

FARTHEST, FAR_SHARE = 2e3, 0.01
"""m, and the share of points beyond from which a scan's unit is doubted: no scanner of a car or robot measures 1 km."""
SurfaceKind = Literal["range", "crust"]
LEAST_SHARE = 0.01
"""Share of a scan's points in the image below which its pose is doubted: of a full turn KITTI's cameras see 0.15."""


def filter_scan(
    scan: PathLike, image: PathLike, calibration: PathLike, out: PathLike, stage: Tmahf, *,
    extrinsics: PathLike | None = None, surface: SurfaceKind = "range", bits: int | None = None,
) -> RunResult:  # fmt: skip
    """Make one complex of a scan, and put the signals of a posed image and their response on what the camera sees.

    Parameters
    ----------
    scan : path
        A file that `read_scan` knows.
    image : path
        What the left camera saw when the scan was taken, rectified.
    calibration : path
        Its calibration file.
    out : path
        The run folder to fill.
    stage : Tmahf
        The filter.
    extrinsics : path, optional
        Where the scanner stands, see `read_extrinsics`; without, the scan is in the camera's frame already.
    surface : {"range", "crust"}
        `ScanSurface`, or the closed surface around the points, `Crust`.
    bits : int, optional
        How many bits the image's pixels use if they have 16; found by default.

    Returns
    -------
    RunResult
        Points that the camera does not see keep their place in the complex, and are marked in the signals.

    Raises
    ------
    InputError
        If an argument is of another kind, a file cannot be used, or no point of the scan is in the image.
    GeometryError
        If the points span no surface.
    OutputError
        If something cannot be written.
    """
    for path, what in ((scan, "scan"), (image, "image"), (calibration, "calibration"), (out, "out")):
        require_path(path, what)
    require(stage, Tmahf, "stage")
    if surface not in ("range", "crust"):
        raise InputError(f"surface is {surface!r:.40}, expected range or crust")
    pixels, used = read_levelled(image, bits)
    rig = read_rectified(calibration, (pixels.shape[1], pixels.shape[0]))
    T_camera_scan = np.eye(4) if extrinsics is None else read_extrinsics(extrinsics)
    echoes = read_scan(scan)
    points = echoes.xyz @ T_camera_scan[:3, :3].T + T_camera_scan[:3, 3]
    inside = _count_inside(scan, rig, points)
    try:
        made = connect_scan(echoes, surface)
        if not len(made.faces):
            raise InputError("no three neighbours of the scan are on one surface, expected a denser scan")
        seen = from_arrays(points, made.faces, pixels, rig, name=one_line(Path(scan).stem))
        frame = replace(seen, response=stage(seen.complex_, seen.cloud.uv, seen.signals))
    except InputError as error:
        raise InputError(f"{scan}: {error}") from error
    record = filter_record(frame, used, _warnings(frame, echoes, inside))
    record["scan"] = {"points": len(echoes), "dropped": echoes.dropped, "in_image": inside, "surface": surface}
    record["scan"] |= {"rings": made.rings, "merged": made.merged} if isinstance(made, RangeSurface) else {}
    given = [array_hash(values) for values in (pixels, points, made.faces)]
    settings = {"command": "filter", "filter": vars(stage), "input": hash_of([given, vars(rig)])}
    return write_filtered(out, settings, frame, record)


def connect_scan(scan: Scan, surface: SurfaceKind = "range") -> Surface:
    """Connect the points of a scan.

    Parameters
    ----------
    scan : Scan
        The scan.
    surface : {"range", "crust"}
        `ScanSurface`, or `Crust`.

    Returns
    -------
    Surface
    """
    return crust_surface(scan.xyz) if surface == "crust" else ScanSurface()(scan.xyz, scan.ring)


def far_points(scan: Scan) -> str:
    """Say how many points of a scan are farther than a scanner measures, where that makes its unit doubtful.

    Parameters
    ----------
    scan : Scan
        The scan.

    Returns
    -------
    str
        A line; empty where nothing is to be said.
    """
    distance = np.linalg.norm(scan.xyz, axis=1)
    far = int((distance > FARTHEST).sum())
    if far <= FAR_SHARE * len(scan):
        return ""
    said = f"{far} of {len(scan)} points are over {FARTHEST:g} m from the scanner"
    return f"{said}, in the median {np.median(distance):.4g} m: is it in another unit? Expected metres, in its frame"


def _count_inside(scan: PathLike, rig: Rig, points: FloatArray) -> int:
    """Points that fall into the image; none at all is an error."""
    u, v = project(rig, points).T
    inside = int(((u >= 0) & (u <= rig.width - 1) & (v >= 0) & (v <= rig.height - 1)).sum())
    if not inside:
        said = f"0 of {len(points)} points are in the image: is the scan in another frame?"
        raise bad_input(scan, said, "T_camera_scan (--extrinsics), metres")
    return inside


def _warnings(frame: Frame, scan: Scan, inside: int) -> Iterator[tuple[str, str]]:
    if inside < LEAST_SHARE * len(scan):
        said = f"{inside} of {len(scan)} points are in the image, fewer than {LEAST_SHARE:.0%}"
        yield "scan_outside", f"{said}: is the scan in another frame? Expected T_camera_scan (--extrinsics), metres"
    if said := far_points(scan):
        yield "scan_far", said
    rows = len(scan) + scan.dropped
    if scan.dropped > rows / 2:
        yield "scan_dropped", f"{scan.dropped} of {rows} rows of the scan are no place (0 0 0, or not finite): left out"
    for line in doubts(frame.rig):
        yield "calibration", line
