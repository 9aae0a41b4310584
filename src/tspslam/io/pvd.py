"""A run as a folder for ParaView: the map, the path, a series of its keyframes in the world, and a state to open."""

from __future__ import annotations

from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from .._atomic import make_folder, write_bytes
from .._files import bad_input
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..topology.complex import build_complex
from ..types import FloatArray, Trajectory
from ._paraview import state_of
from .maps import write_map_vtu
from .runs import StoredRun
from .vtu import write_vtu

_FARTHEST = 1e12  # m: beyond it no view of float32 numbers can be set


def write_pvd(folder: Path, run: StoredRun, shown: Frame | TopologicalMap) -> None:
    """Write a run into a folder that is there and empty; equal runs give equal bytes.

    Parameters
    ----------
    folder : path
        The folder: ``map.vtu``, ``path.vtu`` (a point a pose: ``frame``, ``stamp``, ``is_keyframe``, ``forward``),
        ``frames/000012.vtu`` for each keyframe, in the world where the whole run has put it, ``series.pvd`` (these
        by seconds since the first pose), and ``state.py``, which opens them.
    run : StoredRun
        The run.
    shown : Frame or TopologicalMap
        Its map, or its only frame.

    Raises
    ------
    InputError
        If a file of the run is missing or was changed.
    OutputError
        If a file cannot be written.
    """
    numbers = run.keyframes or run.stored
    path = _path_of(run, numbers)
    places = path.T_world_camera[:, :3, 3]
    if not (np.abs(places) < _FARTHEST).all():
        raise bad_input(run.path / "trajectory.tum", "has places that are too far away", f"less than {_FARTHEST:g} m")
    start = float(path.stamp[0]) if len(path) else 0.0
    make_folder(folder / "frames")
    sets = []
    for number in numbers:
        frame, name = run.frame(number), f"frames/{number:06d}.vtu"
        write_map_vtu(folder / name, frame, T_world_camera=_pose(run, frame))
        sets.append((frame.stamp - start, name))
    write_map_vtu(folder / "map.vtu", shown, T_world_camera=_pose(run, shown) if isinstance(shown, Frame) else None)
    _write_path(folder / "path.vtu", run, path)
    write_bytes(folder / "series.pvd", _series(sets).encode())
    eye, look_at = _viewpoint(path, shown)
    write_bytes(folder / "state.py", state_of(eye, look_at).encode())


def _path_of(run: StoredRun, numbers: tuple[int, ...]) -> Trajectory:
    """The path; of a mesh that was filtered, which has none, where it was seen from."""
    if run.record.get("per_frame") or not numbers:
        return run.trajectory
    frame = run.frame(numbers[0])
    return Trajectory(np.array([frame.stamp]), np.asarray(frame.T_world_camera, np.float64)[None])


def _pose(run: StoredRun, frame: Frame) -> FloatArray:
    return run.pose(frame.index) if run.record.get("per_frame") else np.asarray(frame.T_world_camera, np.float64)


def _write_path(file: Path, run: StoredRun, path: Trajectory) -> None:
    """A line from pose to pose; numbers of frames are those of their stamps, the first of several alike."""
    rows = run.record.get("per_frame") or [{"stamp": path.stamp[0], "index": 0}]
    frame = {row["stamp"]: row["index"] for row in reversed(rows)}
    number = np.array([frame.get(stamp, -1) for stamp in path.stamp.tolist()], np.int64)
    steps = np.arange(len(path) - 1)
    line = build_complex(np.empty((0, 3), np.int32), len(path), np.stack([steps, steps + 1], axis=1))
    columns = {
        "frame": number, "stamp": path.stamp, "is_keyframe": np.isin(number, run.keyframes or (0,)),
        "forward": np.ascontiguousarray(path.T_world_camera[:, :3, 2]),
    }  # fmt: skip
    write_vtu(file, line, path.T_world_camera[:, :3, 3], vertex=columns)


def _series(sets: list[tuple[float, str]]) -> str:
    lines = [f'<DataSet timestep="{time!r}" part="0" file={quoteattr(name)}/>' for time, name in sets]
    head = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="1.0" byte_order="LittleEndian">']
    return "\n".join([*head, "<Collection>", *lines, "</Collection>", "</VTKFile>", ""])


def _viewpoint(path: Trajectory, shown: Frame | TopologicalMap) -> tuple[list[float], list[float]]:
    """From behind and above the start of the path, toward the middle of what is seen."""
    T = path.T_world_camera[0]
    xyz = shown.xyz if isinstance(shown, TopologicalMap) else shown.cloud.xyz @ T[:3, :3].T + T[:3, 3]
    middle = np.median(xyz, axis=0) if len(xyz) else T[:3, 3] + T[:3, 2]
    spread = np.percentile(np.linalg.norm(xyz - middle, axis=1), 75) if len(xyz) else 0.0
    away = float(max(np.linalg.norm(middle - T[:3, 3]), spread)) or 1.0
    eye = T[:3, 3] - 0.35 * away * T[:3, 2] - 0.35 * away * T[:3, 1]
    return [float(f"{each:.4g}") for each in eye], [float(f"{each:.4g}") for each in middle]
