"""A run as a recording of rerun: map, path, cameras with their images and what was tracked, on a timeline."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from .._files import PathLike, bad_input, reason_of
from ..errors import InputError
from ..topological_map import TopologicalMap
from ..types import FloatArray, Trajectory
from ._views import TO_CORNER, ImageOf, check_views, png_of, view_of
from .trajectory import quaternions

Rgb = NDArray[np.uint8]
MISSING = "the library rerun: pip install 'tspslam[rerun]'"
_LAST = 9e9  # s: rerun counts nanoseconds in 64 bits
_CALENDAR = 1e8  # s: later stamps count from 1970, earlier ones from the start of a recording
_FRUSTUM = 2.0  # baselines: as deep as a camera is drawn
_ARROW = 0.5  # of the median edge: length of a direction
_POINT = -2.0  # px: rerun takes a negative radius for one on the screen
_WORLD, _CAMERA, _KEYFRAME, _SEEN = "world", "world/camera", "world/keyframe", "landmarks_seen"


@dataclass(frozen=True, repr=False)
class RecordedRun(Brief):
    """What a recording shows.

    Attributes
    ----------
    name : str
        What the run is called.
    map_ : TopologicalMap
        The map.
    index : (T,) int64
        Numbers of the frames that have a pose.
    trajectory : Trajectory
        Their poses.
    landmarks_seen : (T,) float64
        How many landmarks each tracks; NaN where that is not known.
    face_rgb, edge_rgb, vertex_rgb : (n, 3) uint8
        Colours of the map's elements.
    image_of : callable, (int) -> (H, W) or (H, W, 3) uint8, uint16 or float array
        Gives the left image of a keyframe, by its row in ``map_.keyframes``.
    """

    name: str
    map_: TopologicalMap
    index: NDArray[np.int64]
    trajectory: Trajectory
    landmarks_seen: FloatArray
    face_rgb: Rgb
    edge_rgb: Rgb
    vertex_rgb: Rgb
    image_of: ImageOf


def write_rrd(path: PathLike, run: RecordedRun) -> None:
    """Write a run as a recording of rerun. A run is exported by a process of its own, which does so.

    Faces (each with its own three vertices, so that its colour is flat), edges, vertices, directions of the response
    and the path are there at any time; ``world/camera`` moves with every frame, ``world/keyframe`` with the keyframes,
    and has their images and observed vertices. Timelines are ``frame``, the frames' numbers, and ``stamp``, their
    times. The world is ours (x right, y down, z forward; m), in 32-bit floats, as rerun has them.

    Parameters
    ----------
    path : str or path
        The file to write, from its beginning.
    run : RecordedRun
        What it shows.

    Raises
    ------
    InputError
        If rerun is not installed, or the map cannot be shown.

    Notes
    -----
    Rerun does not say when the disk is full: the file is to be looked at afterwards. It stamps rows and views with the
    time and with random numbers, so that the bytes differ from time to time; the recording's id is that of the data.
    """
    check_views(run.map_, "rerun")
    stamp = run.trajectory.stamp
    if not (np.abs(stamp) < _LAST).all():
        raise InputError(f"rerun: stamps are {stamp.min():g} to {stamp.max():g} s, expected less than {_LAST:g} s")
    rr = _rerun(path)
    stream = rr.RecordingStream("tspslam", recording_id=_id_of(run), default_enabled=True)
    stream.save(path, default_blueprint=_blueprint())
    stream.send_recording_name(run.name)
    _log_map(rr, stream, run)
    _log_path(rr, stream, run)
    _log_keyframes(rr, stream, run)
    stream.flush()
    stream.disconnect()


def _rerun(path: PathLike) -> ModuleType:
    try:
        import rerun
    except ImportError as error:
        raise bad_input(path, f"cannot be written ({reason_of(error)})", MISSING) from error
    return rerun


def _id_of(run: RecordedRun) -> str:
    """Name a recording by what is in it: rerun would join two of one name."""
    made = hashlib.sha256(run.name.encode("utf-8", "backslashreplace"))
    for values in (run.map_.xyz, run.map_.T_world_camera, run.index, run.trajectory.T_world_camera):
        made.update(np.ascontiguousarray(values).tobytes())
    return made.hexdigest()[:32]


def _log_map(rr: Any, stream: Any, run: RecordedRun) -> None:
    map_, xyz = run.map_, run.map_.xyz.astype(np.float32)
    stream.log(_WORLD, rr.ViewCoordinates.RDF, static=True)
    if len(xyz):
        points = rr.Points3D(xyz, colors=run.vertex_rgb, radii=_POINT)
        stream.log(f"{_WORLD}/map/vertices", points, static=True)
    if not len(map_.surface.faces):
        return
    corners = map_.surface.faces.reshape(-1)
    mesh = rr.Mesh3D(
        vertex_positions=xyz[corners],
        triangle_indices=np.arange(len(corners), dtype=np.uint32).reshape(-1, 3),
        vertex_colors=np.repeat(run.face_rgb, 3, axis=0),
    )
    stream.log(f"{_WORLD}/map/faces", mesh, static=True)
    ends = xyz[map_.complex_.edges]
    stream.log(f"{_WORLD}/map/edges", rr.LineStrips3D(ends, colors=run.edge_rgb, radii=_POINT / 4), static=True)
    length = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
    rows = np.flatnonzero(map_.defined)
    arrows = rr.Arrows3D(
        origins=xyz[rows], vectors=_ARROW * length * map_.direction[rows], colors=run.vertex_rgb[rows], radii=_POINT / 2
    )
    stream.log(f"{_WORLD}/map/directions", arrows, static=True)


def _log_path(rr: Any, stream: Any, run: RecordedRun) -> None:
    T, times = run.trajectory.T_world_camera, _times(rr, run.index, run.trajectory.stamp)
    if len(T) > 1:
        strip = rr.LineStrips3D([T[:, :3, 3].astype(np.float32)], colors=[[230, 159, 0]], radii=_POINT / 2)
        stream.log(f"{_WORLD}/path", strip, static=True)
    _log_camera(rr, stream, run, _CAMERA, T, times)
    known = np.flatnonzero(np.isfinite(run.landmarks_seen))
    if len(known):
        times = _times(rr, run.index[known], run.trajectory.stamp[known])
        stream.send_columns(_SEEN, times, rr.Scalars.columns(scalars=run.landmarks_seen[known]))


def _log_keyframes(rr: Any, stream: Any, run: RecordedRun) -> None:
    map_, seen, place = run.map_, run.map_.observations, f"{_KEYFRAME}/image"
    stamp = dict(zip(run.index.tolist(), run.trajectory.stamp.tolist(), strict=True))
    times = [_times(rr, [k], [stamp[k]]) if k in stamp else _times(rr, [k], None) for k in map_.keyframes.tolist()]
    for row, when in enumerate(times):
        _log_camera(rr, stream, run, _KEYFRAME, map_.T_world_camera[row : row + 1], when)
        pixels = view_of(map_, row, run.image_of)
        png = png_of(pixels[..., 0] if (pixels == pixels[..., :1]).all() else pixels)
        stream.send_columns(place, when, rr.EncodedImage.columns(blob=[png], media_type=["image/png"]))
        rows = np.flatnonzero((seen.keyframe == row) & np.isfinite(seen.uv).all(axis=1))
        points = rr.Points2D.columns(
            positions=seen.uv[rows] + TO_CORNER, colors=run.vertex_rgb[seen.vertex[rows]], radii=np.full(len(rows), 2.0)
        )
        stream.send_columns(f"{place}/observed", when, points.partition([len(rows)]))


def _log_camera(rr: Any, stream: Any, run: RecordedRun, place: str, T: FloatArray, times: list[Any]) -> None:
    rig = run.map_.rig
    turned = [rr.Quaternion(xyzw=q) for q in quaternions(T[:, :3, :3])]
    stream.send_columns(place, times, rr.Transform3D.columns(translation=T[:, :3, 3], quaternion=turned))
    K = [[rig.fx, 0, rig.cx + TO_CORNER], [0, rig.fy, rig.cy + TO_CORNER], [0, 0, 1]]
    pinhole = rr.Pinhole(
        image_from_camera=K,
        resolution=[rig.width, rig.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_FRUSTUM * (rig.baseline or 0.1),
    )
    stream.log(f"{place}/image", pinhole, static=True)


def _times(rr: Any, index: Any, stamp: Any) -> list[Any]:
    """Places on the two timelines; on one where a frame has no stamp."""
    found = [rr.TimeColumn("frame", sequence=index)]
    if stamp is not None:
        is_calendar = len(stamp) > 0 and stamp[0] >= _CALENDAR
        found.append(rr.TimeColumn("stamp", **{"timestamp" if is_calendar else "duration": stamp}))
    return found


def _blueprint() -> Any:
    """The map beside the keyframe's image and the number of landmarks."""
    import rerun.blueprint as rrb

    image = rrb.Spatial2DView(origin=f"{_KEYFRAME}/image", name="Keyframe and observed vertices")
    seen = rrb.TimeSeriesView(origin=_SEEN, name="Landmarks tracked")
    views = rrb.Horizontal(
        rrb.Spatial3DView(origin=_WORLD, name="Map and path"), rrb.Vertical(image, seen), column_shares=[2, 1]
    )
    return rrb.Blueprint(views, collapse_panels=True)
