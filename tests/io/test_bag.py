"""A path as a bag of ROS 2: read by rosbags, it is the same path in ROS's axes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from seen_maps import files, seen_map, turned_poses

from tests.view.view_maps import ODD_MAPS
from tspslam import InputError, OutputError, Trajectory
from tspslam.io.bag import T_LINK_OPTICAL, write_bag

rosbags = pytest.importorskip("rosbags", reason="the extra ros is not installed")
START = 1_403_715_273.262143


def path_of(count=5, start=START):
    return Trajectory(start + 0.1 * np.arange(count), turned_poses(count))


@pytest.fixture
def read(tmp_path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    def messages(trajectory, map_=None):
        write_bag(tmp_path / "bag", trajectory, map_)
        found = {}
        with AnyReader([tmp_path / "bag"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for link, time, data in reader.messages():
                found.setdefault(link.topic, []).append((time, reader.deserialize(data, link.msgtype)))
        return found

    return messages


def seconds(header):
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


def matrix(place, turn):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    T[:3, 3] = place.x, place.y, place.z
    return T


def test_tf_leads_from_the_map_to_the_camera_of_each_frame(read):
    """The tree map -> camera_link -> camera_optical, in ROS's axes; undone, it is the path."""
    path = path_of()
    found = read(path)
    (_, still), *more = found["/tf_static"]
    (link_optical,) = still.transforms
    assert not more
    assert (link_optical.header.frame_id, link_optical.child_frame_id) == ("camera_link", "camera_optical")
    T_link_optical = matrix(link_optical.transform.translation, link_optical.transform.rotation)
    assert np.abs(T_link_optical - T_LINK_OPTICAL).max() < 1e-12
    assert len(found["/tf"]) == len(path)
    for (time, message), stamp, T_world_camera in zip(found["/tf"], path.stamp, path.T_world_camera, strict=True):
        (moved,) = message.transforms
        assert (moved.header.frame_id, moved.child_frame_id) == ("map", "camera_link")
        assert abs(seconds(moved.header) - stamp) < 1e-6
        assert abs(time * 1e-9 - stamp) < 1e-6
        T_map_optical = matrix(moved.transform.translation, moved.transform.rotation) @ T_link_optical
        assert np.abs(np.linalg.inv(T_LINK_OPTICAL) @ T_map_optical - T_world_camera).max() < 1e-9


def test_pose_and_path_are_tf(read):
    found = read(path_of())
    (first, path), *more = found["/path"]
    assert not more
    assert first == found["/tf"][0][0]
    assert path.header.frame_id == "map"
    for (time, pose), (_, moved), of_path in zip(found["/pose"], found["/tf"], path.poses, strict=True):
        motion = moved.transforms[0].transform
        for each in (pose, of_path):
            assert each.header.frame_id == "map"
            assert each.header.stamp == moved.transforms[0].header.stamp
            assert np.array_equal(
                matrix(each.pose.position, each.pose.orientation), matrix(motion.translation, motion.rotation)
            )
        assert time == pose.header.stamp.sec * 10**9 + pose.header.stamp.nanosec


def test_a_camera_that_goes_ahead_and_turns_right_does_so_in_ros_s_axes(read):
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, :3, 3] = 0, 0, 3  # ahead
    T[1, :3, :3] = Rotation.from_rotvec([0, 0.5, 0]).as_matrix()  # about y, which points down: to the right
    (_, first), (_, second) = read(Trajectory(np.array([0.0, 1.0]), T))["/pose"]
    assert np.allclose(matrix(first.pose.position, first.pose.orientation), np.eye(4))
    T_map_link = matrix(second.pose.position, second.pose.orientation)
    assert np.allclose(T_map_link[:3, 3], [3, 0, 0])
    assert np.allclose(T_map_link[:3, 0], [np.cos(0.5), -np.sin(0.5), 0])


def test_the_cloud_is_the_map(read):
    map_ = seen_map()
    ok = map_.signals.vertex_ok.copy()
    ok[3] = False
    map_ = replace(map_, signals=replace(map_.signals, vertex_ok=ok))
    ((time, cloud),) = read(path_of(), map_)["/map_points"]
    assert time == round(START * 1e9)
    assert (cloud.header.frame_id, cloud.width, cloud.height) == ("map", len(map_), 1)
    table = {each.name: cloud.data.view("<f4").reshape(len(map_), -1)[:, each.offset // 4] for each in cloud.fields}
    assert list(table) == ["x", "y", "z", "rgb", "intensity", "magnitude"]
    xyz = np.stack([table[axis] for axis in "xyz"], axis=1)
    assert np.array_equal(xyz, np.float32(np.stack([map_.xyz[:, 2], -map_.xyz[:, 0], -map_.xyz[:, 1]], axis=1)))
    assert np.array_equal(table["intensity"], np.float32(np.where(ok, map_.signals.vertex, 0)))
    assert np.array_equal(table["magnitude"], np.float32(map_.response.magnitude))
    grey = np.where(ok, np.rint(255 * map_.signals.vertex), 0).astype(np.uint32)
    assert np.array_equal(np.ascontiguousarray(table["rgb"]).view(np.uint32), grey * 0x010101)


def test_path_and_cloud_are_kept_for_who_comes_late(tmp_path):
    from rosbags.interfaces import QosDurability
    from rosbags.rosbag2 import Reader

    write_bag(tmp_path / "bag", path_of(), seen_map())
    with Reader(tmp_path / "bag") as reader:
        kept = {each.topic for each in reader.connections for qos in each.ext.offered_qos_profiles
                if qos.durability == QosDurability.TRANSIENT_LOCAL}  # fmt: skip
    assert kept == {"/tf_static", "/path", "/map_points"}


@pytest.mark.parametrize("name", ["plain", "a#b?c%20d é"])
def test_the_same_path_gives_the_same_bytes(tmp_path, name):
    for folder in ("one", name):
        write_bag(tmp_path / folder, path_of(), seen_map())
    assert files(tmp_path / "one") == files(tmp_path / name)
    assert sorted(files(tmp_path / "one")) == ["bag.db3", "metadata.yaml"]
    assert sorted(each.name for each in tmp_path.iterdir()) == sorted(["one", name])


@pytest.mark.parametrize("name", ODD_MAPS)
def test_odd_maps_are_written(name, read):
    map_ = ODD_MAPS[name]()
    ((_, cloud),) = read(path_of(1), map_)["/map_points"]
    assert cloud.width == len(map_)
    floats = cloud.data.view("<f4").reshape(len(map_), 6)
    assert np.isfinite(np.delete(floats, 3, axis=1)).all()


def test_without_a_map_there_is_a_path_alone(read):
    assert sorted(read(path_of())) == ["/path", "/pose", "/tf", "/tf_static"]


@pytest.mark.parametrize(
    ("stamp", "T", "said"),
    [
        ([-1.0, 0.0], turned_poses(2), "stamps are -1 to 0 s, expected 0 to 2147483647 s"),
        ([0.0, 1e12], turned_poses(2), "stamps are 0 to 1e\\+12 s"),
        ([0.0, np.nan], turned_poses(2), "stamps are nan"),
        ([0.0, 1.0], 2 * turned_poses(2), "holds no rigid motion"),
        ([], turned_poses(1)[:0], "has no pose, expected at least one"),
    ],
)
def test_a_path_that_ros_cannot_hold_is_refused(tmp_path, stamp, T, said):
    with pytest.raises(InputError, match=said):
        write_bag(tmp_path / "bag", Trajectory(np.array(stamp), T))
    assert not list(tmp_path.iterdir())


def test_without_rosbags_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    with pytest.raises(InputError, match=r"pip install 'tspslam\[ros\]'"):
        write_bag(tmp_path / "bag", path_of())
    assert not list(tmp_path.iterdir())


def test_a_database_that_cannot_be_written_is_an_output_error(tmp_path, monkeypatch):
    import sqlite3

    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

    def full(*_):
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(Sqlite3Writer, "write", full)
    with pytest.raises(OutputError, match="database or disk is full"):
        write_bag(tmp_path / "bag", path_of())
    assert not list(tmp_path.iterdir())
