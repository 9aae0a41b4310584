"""Scans of a LiDAR along a run, in its world, to one map with signals from its keyframes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .._brief import brief
from .._checks import require_path
from .._files import PathLike, bad_input
from .._text import is_whole, numbers, read_lines, split
from ..datasets._pairing import poses_at
from ..errors import InputError
from ..io.clouds import read_scan
from ..io.runfolder import RunFolder
from ..io.runs import StoredRun, load_run
from ..mapping.build import make_scan_map
from ..mapping.scans import PlacedScan, join_scans
from ..mapping.views import View
from ..topological_map import TopologicalMap
from ..topology.scan_surface import ScanSurface
from ..types import FloatArray
from ..vision.calibration.extrinsics import read_extrinsics
from .config import resolve
from .map import stored_keyframes
from .scan import far_points

VOXEL = 0.2
"""m: ten times the noise of a range, a fifth of what a car drives between two turns of the scanner."""
_STAMPS = "a number of seconds a line, one for each scan"
_FARTHEST_VOXEL = 1e3  # m


class ScanMap(NamedTuple):
    """What was made of scans.

    Attributes
    ----------
    map_ : TopologicalMap
        One complex, with signals where a keyframe sees it.
    points : int
        How many points all scans that were used have.
    unplaced : list of str
        Scans for whose time the run has no pose.
    doubts : list of str
        Of scans that look as if they were in another unit: file and why.
    """

    map_: TopologicalMap
    points: int
    unplaced: list[str]
    doubts: list[str]

    def __repr__(self) -> str:
        return brief(self)


def map_scans(
    run: PathLike, scans: Sequence[PathLike], extrinsics: PathLike, *,
    stamps: PathLike | None = None, voxel: float = VOXEL, surface: ScanSurface | None = None,
) -> ScanMap:  # fmt: skip
    """Place scans along the path of a run, join their surfaces, and put the signals of its keyframes on them.

    Parameters
    ----------
    run : path
        A finished run of a sequence.
    scans : sequence of path
        Files that `read_scan` knows; those that come first count where several have seen a place.
    extrinsics : path
        Where the scanner stands, see `read_extrinsics`.
    stamps : path, optional
        Times of the scans on the run's clock, s, a line each. Without, the name of each scan is the number of the frame
        that it was taken with, as in KITTI's folders.
    voxel : float
        A scan adds nothing in voxels, of so many m, that an earlier one's surface meets.
    surface : ScanSurface, optional
        How the points of a scan are connected.

    Returns
    -------
    ScanMap

    Raises
    ------
    InputError
        If a file cannot be used, a scan's name is no number and there are no stamps, no scan has a pose, or no
        keyframe sees any of their points.
    GeometryError
        If the scans have no surface.
    """
    require_path(run, "run")
    if not scans:
        raise InputError("scans: none is given, expected one or more")
    if not 0 < voxel <= _FARTHEST_VOXEL:  # NaN too
        raise InputError(f"scans: voxel is {voxel}, expected above 0, at most {_FARTHEST_VOXEL:g} m")
    stored, stage = load_run(run), surface or ScanSurface()
    T_camera_scan = read_extrinsics(extrinsics)
    poses = _poses_by_name(stored, scans) if stamps is None else _poses_by_stamp(stored, scans, stamps)
    known = np.isfinite(poses[:, 0, 0])
    if not known.any():
        raise bad_input(
            run, f"has no pose for any of {len(scans)} scans", "scans of its time, or --stamps on its clock"
        )
    doubts: list[str] = []
    placed = [
        _place(path, pose @ T_camera_scan, stage, doubts)
        for path, pose, is_known in zip(scans, poses, known, strict=True)
        if is_known
    ]
    joined = join_scans(placed, voxel)
    made = _sample(stored, joined, stage.range_sigma)
    if not made.signals.vertex_ok.any():
        said = f"no keyframe sees any of {len(joined.xyz)} points: are the scans in another frame?"
        raise bad_input(run, said, "T_camera_scan (--extrinsics), metres")
    points = sum(len(scan.xyz) for scan in placed)
    unplaced = [str(path) for path, is_known in zip(scans, known, strict=True) if not is_known]
    return ScanMap(made, points, unplaced, doubts)


def _place(path: PathLike, T_world_scan: FloatArray, stage: ScanSurface, doubts: list[str]) -> PlacedScan:
    scan = read_scan(path)
    doubts += [f"{path}: {said}" for said in (far_points(scan),) if said]
    try:
        faces = stage(scan.xyz, scan.ring).faces
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return PlacedScan(scan.xyz @ T_world_scan[:3, :3].T + T_world_scan[:3, 3], faces)


def _poses_by_name(run: StoredRun, scans: Sequence[PathLike]) -> FloatArray:
    """Pose of the frame whose number each scan's name is; NaN where the run has none."""
    at = {int(row["index"]): float(row["stamp"]) for row in run.record.get("per_frame", [])}
    rows = {float(stamp): k for k, stamp in enumerate(run.trajectory.stamp)}
    poses = np.full((len(scans), 4, 4), np.nan)
    for k, path in enumerate(scans):
        name = Path(path).name.partition(".")[0]
        if not is_whole(name, 12):
            raise bad_input(path, "has a name that is no number of a frame", "one such as 000012.bin, or --stamps")
        row = rows.get(at.get(int(name), np.nan))
        if row is not None:
            poses[k] = run.trajectory.T_world_camera[row]
    return poses


def _poses_by_stamp(run: StoredRun, scans: Sequence[PathLike], stamps: PathLike) -> FloatArray:
    """Poses between those of the frames; NaN where there is none within 0.1 s on both sides."""
    times: list[float] = []
    for line in read_lines(stamps, _STAMPS):
        if line[1]:
            times += numbers(stamps, line, split(stamps, line, _STAMPS, (1,)), _STAMPS)
    if len(times) != len(scans) or not np.isfinite(times).all():
        raise bad_input(stamps, f"has {len(times)} times for {len(scans)} scans, or one that is not finite", _STAMPS)
    path = run.trajectory
    known = np.isfinite(path.T_world_camera[:, 0, 0])
    return poses_at(np.array(times), path.stamp[known], path.T_world_camera[known])


def _sample(run: StoredRun, joined: PlacedScan, sigma: float) -> TopologicalMap:
    folder = RunFolder.open(run.path)
    settings = resolve(file=folder.path / "config.yaml").settings
    given = stored_keyframes(folder)
    snapshot = given.snapshot
    views = [
        View(given.index[number], T, partial(given.image_of, number))
        for number, T in zip(snapshot.keyframe.tolist(), snapshot.T_world_camera, strict=True)
        if number in given.index
    ]
    return make_scan_map(views, joined.xyz, joined.faces, sigma, given.rig, settings.filter, settings.mapping.views)
