"""The example's messages survive the wire, and mean the same in the axes of ROS; ROS itself is not needed."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import tspslam
from tspslam.frame import Frame

STORE = get_typestore(Stores.ROS2_HUMBLE)
STAMP = 1_700_000_000, 123_456_789
# Right, down and forward of our camera, in the axes of ROS: forward, left, up.
AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


@pytest.fixture(scope="module")
def node() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ros2_node", Path(__file__).parents[1] / "examples" / "ros2_node.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def frame() -> Frame:
    return tspslam.Session(tspslam.datasets.motorcycle().rig).process(tspslam.datasets.motorcycle())


def make(kind: str, **fields: Any) -> Any:
    """A message as ROS makes one: what is not given is zero, but for w of a quaternion."""
    known = dict(STORE.fielddefs[kind][1])
    unknown = fields.keys() - known
    assert not unknown, f"{kind} has no {unknown}"
    if kind == "geometry_msgs/msg/Quaternion":
        fields = {"w": 1.0} | fields
    return STORE.types[kind](**({name: zero(*said) for name, said in known.items()} | fields))


def zero(node: Nodetype, said: Any) -> Any:
    if node == Nodetype.NAME:
        return make(said)
    if node == Nodetype.BASE:
        return {"string": "", "bool": False}.get(said[0], 0.0 if said[0].startswith("float") else 0)
    (inner, kind), count = said
    if inner == Nodetype.BASE and kind[0] != "string":
        return np.zeros(count if node == Nodetype.ARRAY else 0, kind[0].replace("octet", "uint8"))
    return []


def over_the_wire(message: Any) -> Any:
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, message.__msgtype__), message.__msgtype__)


def header() -> Any:
    return make(
        "std_msgs/msg/Header",
        stamp=make("builtin_interfaces/msg/Time", sec=STAMP[0], nanosec=STAMP[1]),
        frame_id="odom",
    )


def xyz_of(point: Any) -> list[float]:
    return [point.x, point.y, point.z]


def pose(right: float = 0.0, down: float = 0.0, forward: float = 0.0, yaw: float = 0.0) -> Any:
    """A place in our world, and a turn to the right about the axis that points down."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec((0, yaw, 0)).as_matrix(), (right, down, forward)
    return T


def test_the_way_forward_right_and_down_is_x_minus_y_and_minus_z(node: ModuleType, frame: Frame) -> None:
    said = over_the_wire(node.odometry(make, header(), replace(frame, T_world_camera=pose(1, 2, 3))))
    assert (said.header.frame_id, said.child_frame_id) == ("odom", "camera_link")
    assert (said.header.stamp.sec, said.header.stamp.nanosec) == STAMP
    assert xyz_of(said.pose.pose.position) == pytest.approx([3, -1, -2])
    turn = said.pose.pose.orientation
    assert [turn.x, turn.y, turn.z, turn.w] == pytest.approx([0, 0, 0, 1])
    assert [*xyz_of(said.twist.twist.linear), *xyz_of(said.twist.twist.angular)] == [0] * 6


def test_a_turn_to_the_right_is_one_about_minus_z(node: ModuleType, frame: Frame) -> None:
    said = over_the_wire(node.odometry(make, header(), replace(frame, T_world_camera=pose(yaw=0.3))))
    turn = said.pose.pose.orientation
    assert Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_rotvec() == pytest.approx([0, 0, -0.3])


def test_velocity_is_in_the_axes_of_the_camera(node: ModuleType, frame: Frame) -> None:
    """Turned to the right by 90 degrees, 1 m on in 0.5 s to where it looks now."""
    before = replace(frame, stamp=10.0, T_world_camera=pose(yaw=np.pi / 2 - 0.1))
    after = replace(frame, stamp=10.5, T_world_camera=pose(right=1, yaw=np.pi / 2))
    twist = over_the_wire(node.odometry(make, header(), after, before)).twist.twist
    assert xyz_of(twist.linear) == pytest.approx([2, 0, 0], abs=1e-12)
    assert xyz_of(twist.angular) == pytest.approx([0, 0, -0.2], abs=1e-12)


def in_odom(frame: Frame) -> Any:
    T = frame.T_world_camera
    world = frame.cloud.xyz @ T[:3, :3].T + T[:3, 3]
    return world @ AXES


def test_a_cloud_has_the_points_in_odom(node: ModuleType, frame: Frame) -> None:
    moved = replace(frame, T_world_camera=pose(1, 2, 3, 0.4))
    said = over_the_wire(node.cloud(make, header(), moved))
    assert (said.width, said.height, said.point_step) == (len(frame.cloud), 1, 12)
    assert [(each.name, each.offset, each.datatype) for each in said.fields] == [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
    assert said.row_step == said.data.nbytes
    np.testing.assert_allclose(said.data.view("<f4").reshape(-1, 3), in_odom(moved), atol=1e-4)


def test_a_mesh_has_its_triangles_in_odom_with_their_luminance(node: ModuleType, frame: Frame) -> None:
    moved = replace(frame, index=7, T_world_camera=pose(1, 2, 3, 0.4))
    said = over_the_wire(node.mesh(make, header(), moved))
    corners = frame.surface.faces.ravel()
    assert (said.ns, said.id, said.type, said.action) == ("tspslam", 7, 11, 0)
    assert (xyz_of(said.scale), said.pose.orientation.w) == ([1, 1, 1], 1)
    np.testing.assert_allclose([xyz_of(each) for each in said.points], in_odom(moved)[corners], atol=1e-9)
    grey = tspslam.types.one_channel(frame.signals.vertex)[corners]
    np.testing.assert_allclose([each.g for each in said.colors], np.nan_to_num(grey).clip(0, 1), atol=1e-6)
    assert {each.a for each in said.colors} == {1.0}


def test_cameras_are_those_of_two_camera_infos(node: ModuleType) -> None:
    left = SimpleNamespace(p=[60, 0, 31, 0, 0, 61, 23.5, 0, 0, 0, 1, 0], width=64, height=48)
    right = SimpleNamespace(p=[60, 0, 32.5, -7.5, 0, 61, 23.5, 0, 0, 0, 1, 0], width=64, height=48)
    expected = tspslam.Rig(fx=60, fy=61, cx=31, cy=23.5, baseline=0.125, width=64, height=48, doffs=1.5)
    assert node.rig_of(left, right) == expected
