"""A camera's path, and the map it was found with, as a bag of ROS 2."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._atomic import bad_output
from .._checks import is_rigid, require
from .._files import PathLike, bad_input, reason_of
from ..errors import InputError
from ..topological_map import TopologicalMap
from ..types import FloatArray, Trajectory, one_channel
from ._folders import new_folder
from .trajectory import quaternions

MAP, LINK, OPTICAL = "map", "camera_link", "camera_optical"
T_LINK_OPTICAL = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns our axes (x right, y down, z forward) to those of ROS (x forward, y left, z up; REP 103)."""
_MISSING = "the library rosbags: pip install 'tspslam[ros]'"
_VERSION = 8  # of rosbag2's layout: Humble and later read it, Jazzy and later write 9
_LAST = 2**31 - 1  # s: ROS counts seconds in 32 bits with a sign
_CLOUD = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4"), ("intensity", "<f4"), ("magnitude", "<f4")]
)
_FLOAT32 = 7  # of sensor_msgs/PointField: all of them; rgb is 0x00rrggbb in the bits of one, as PCL has it


def write_bag(path: PathLike, trajectory: Trajectory, map_: TopologicalMap | None = None) -> None:
    """Write a path as a ROS 2 bag (SQLite), whole or not at all; the same path and map give the same bytes.

    ``/tf`` moves ``camera_link`` (x forward, y left, z up) in ``map``, which is where it was at the start of the
    world; ``/tf_static`` says how ``camera_optical``, the left camera's own frame (x right, y down, z forward), sits in
    ``camera_link``. ``/pose`` is each pose (geometry_msgs/PoseStamped), ``/path`` all of them (nav_msgs/Path), and
    ``/map_points`` the map's vertices (sensor_msgs/PointCloud2) in ``map``, with rgb, intensity (luminance) and
    magnitude (of the response, 0 where it is not defined); the last two are there from the first stamp on, latched.

    Parameters
    ----------
    path : str or path
        The folder to make; not there yet, or empty.
    trajectory : Trajectory
        Poses, at least one; their stamps become ROS's times, to the nanosecond.
    map_ : TopologicalMap, optional
        The map; without it there is no ``/map_points``.

    Raises
    ------
    InputError
        If rosbags is not installed, something is there already, a pose is no rigid motion, or a stamp lies outside of
        0 to 2³¹ - 1 s.
    OutputError
        If a file cannot be written.
    """
    require(trajectory, Trajectory, "trajectory")
    _check(trajectory)
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise bad_input(path, f"cannot be written ({reason_of(error)})", _MISSING) from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    # Rosbags takes # and ? in the name of a folder for parts of an address: it writes where there are none.
    with new_folder(path) as folder, tempfile.TemporaryDirectory() as elsewhere:
        inner = Path(elsewhere) / "bag"
        try:
            with Writer(inner, version=_VERSION, storage_plugin=StoragePlugin.SQLITE3) as writer:
                _Messages(store, writer).write(trajectory, map_)
        except sqlite3.Error as error:
            raise bad_output(path, error) from error
        for file in ("bag.db3", "metadata.yaml"):
            shutil.copyfile(inner / file, folder / file)


def _check(trajectory: Trajectory) -> None:
    stamps, T = trajectory.stamp, trajectory.T_world_camera
    if not len(stamps):
        raise InputError("trajectory has no pose, expected at least one")
    if not is_rigid(T):
        raise InputError("trajectory: T_world_camera holds no rigid motion")
    if not (np.isfinite(stamps).all() and stamps.min() >= 0 and stamps.max() < _LAST):
        raise InputError(f"trajectory: stamps are {stamps.min():g} to {stamps.max():g} s, expected 0 to {_LAST} s")


def link_poses(T_world_camera: FloatArray) -> FloatArray:
    """Turn poses of the camera in our world to poses of ``camera_link`` in ``map``.

    Parameters
    ----------
    T_world_camera : (T, 4, 4) float64
        Poses, m.

    Returns
    -------
    (T, 4, 4) float64

    Examples
    --------
    >>> T = np.eye(4)[None].copy()
    >>> T[0, :3, 3] = 1, 2, 3
    >>> link_poses(T)[0, :3, 3].tolist()
    [3.0, -1.0, -2.0]
    """
    return T_LINK_OPTICAL @ T_world_camera @ T_LINK_OPTICAL.T


class _Messages:
    """Messages of the types that a bag has, made and written one by one."""

    def __init__(self, store: Any, writer: Any) -> None:
        self._store, self._writer = store, writer
        self._topics: dict[str, Any] = {}

    def write(self, trajectory: Trajectory, map_: TopologicalMap | None) -> None:
        """Write all, in the order of time."""
        T = link_poses(trajectory.T_world_camera)
        times = np.rint(trajectory.stamp * 1e9).astype(np.int64).tolist()
        places, turns = T[:, :3, 3].tolist(), quaternions(T[:, :3, :3]).tolist()
        poses = [
            self._made("geometry_msgs/msg/PoseStamped", header=self._header(time, MAP), pose=self._pose(place, turn))
            for time, place, turn in zip(times, places, turns, strict=True)
        ]
        still = quaternions(T_LINK_OPTICAL[None, :3, :3])[0].tolist()
        self._put("/tf_static", times[0], self._tf(times[0], LINK, OPTICAL, [0.0, 0.0, 0.0], still), is_latched=True)
        path = self._made("nav_msgs/msg/Path", header=self._header(times[0], MAP), poses=poses)
        self._put("/path", times[0], path, is_latched=True)
        if map_ is not None:
            self._put("/map_points", times[0], self._cloud(times[0], map_), is_latched=True)
        for time, place, turn, pose in zip(times, places, turns, poses, strict=True):
            self._put("/tf", time, self._tf(time, MAP, LINK, place, turn))
            self._put("/pose", time, pose)

    def _made(self, kind: str, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _put(self, topic: str, time: int, message: Any, *, is_latched: bool = False) -> None:
        kind = message.__msgtype__
        if topic not in self._topics:
            qos = [_latched()] if is_latched else []
            self._topics[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store, offered_qos_profiles=qos
            )
        self._writer.write(self._topics[topic], time, self._store.serialize_cdr(message, kind))

    def _header(self, time: int, frame: str) -> Any:
        stamp = self._made("builtin_interfaces/msg/Time", sec=time // 10**9, nanosec=time % 10**9)
        return self._made("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _pose(self, place: list[float], turn: list[float]) -> Any:
        point = self._made("geometry_msgs/msg/Point", **dict(zip("xyz", place, strict=True)))
        return self._made("geometry_msgs/msg/Pose", position=point, orientation=self._quaternion(turn))

    def _quaternion(self, turn: list[float]) -> Any:
        return self._made("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn, strict=True)))

    def _tf(self, time: int, above: str, below: str, place: list[float], turn: list[float]) -> Any:
        motion = self._made(
            "geometry_msgs/msg/Transform",
            translation=self._made("geometry_msgs/msg/Vector3", **dict(zip("xyz", place, strict=True))),
            rotation=self._quaternion(turn),
        )
        header = self._header(time, above)
        one = self._made("geometry_msgs/msg/TransformStamped", header=header, child_frame_id=below, transform=motion)
        return self._made("tf2_msgs/msg/TFMessage", transforms=[one])

    def _cloud(self, time: int, map_: TopologicalMap) -> Any:
        table = _cloud_of(map_)
        fields = [
            self._made("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=_FLOAT32, count=1)
            for k, name in enumerate(_CLOUD.names or ())
        ]
        return self._made(
            "sensor_msgs/msg/PointCloud2",
            header=self._header(time, MAP), height=1, width=len(table), fields=fields, is_bigendian=False,
            point_step=_CLOUD.itemsize, row_step=table.nbytes, data=table.view(np.uint8).reshape(-1), is_dense=True,
        )  # fmt: skip


def _latched() -> Any:
    """What is offered to who comes later too: all fields as ROS has them for such topics."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
        never, never, QosLiveliness.AUTOMATIC, never, False,
    )  # fmt: skip


def _cloud_of(map_: TopologicalMap) -> NDArray[Any]:
    """Vertices in ``map``."""
    signal, ok = map_.signals.vertex, map_.signals.vertex_ok
    is_colour = signal.ndim == 2 and signal.shape[1] == 3
    channels = signal if is_colour else np.repeat(one_channel(signal)[:, None], 3, axis=1)
    rgb = np.where(ok[:, None], np.rint(255 * np.clip(channels, 0, 1)), 0).astype(np.uint32)
    table = np.zeros(len(map_), _CLOUD)
    for name, values in zip("xyz", (map_.xyz @ T_LINK_OPTICAL[:3, :3].T).T, strict=True):
        table[name] = values
    table["rgb"] = rgb[:, 0] << 16 | rgb[:, 1] << 8 | rgb[:, 2]
    table["intensity"] = np.where(ok, one_channel(signal), 0.0)
    table["magnitude"] = np.where(map_.defined, one_channel(map_.response.magnitude), 0.0)
    return table
