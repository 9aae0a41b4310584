"""A node of ROS 2: rectified stereo images in; odometry, and points and mesh of each keyframe out, all in odom.

python examples/ros2_node.py --ros-args -r left:=/stereo/left/image_rect (and right, left_info, right_info)
"""

import array
import importlib

import numpy as np
from scipy.spatial.transform import Rotation

import tspslam
from tspslam.io.bag import T_LINK_OPTICAL, link_poses

WORLD, LINK = "odom", "camera_link"  # both x forward, y left, z up (REP 103); our camera: x right, y down, z forward
FLOAT32, TRIANGLES, ADD = 7, 11, 0  # of sensor_msgs/PointField and visualization_msgs/Marker
GEOMETRY, SENSOR = "geometry_msgs/msg/", "sensor_msgs/msg/"
IN = {"left": "Image", "right": "Image", "left_info": "CameraInfo", "right_info": "CameraInfo"}
OUT = {"odometry": "nav_msgs/msg/Odometry", "cloud": SENSOR + "PointCloud2", "mesh": "visualization_msgs/msg/Marker"}


def make(kind, **fields):
    """A message of ROS, such as make("std_msgs/msg/Header"); bytes of an array are handed over as they are."""
    package, _, name = kind.split("/")
    as_bytes = {each: array.array("B", of.tobytes()) for each, of in fields.items() if isinstance(of, np.ndarray)}
    return getattr(importlib.import_module(f"{package}.msg"), name)(**(fields | as_bytes))


def vector(make, xyz, kind="Vector3"):
    """Three numbers as a Vector3 or a Point."""
    return make(GEOMETRY + kind, **dict(zip("xyz", map(float, xyz), strict=True)))


def odometry(make, header, frame, before=None):
    """Pose of camera_link in odom, and its velocity since the frame before in its own axes."""
    T, last = link_poses(np.stack([frame.T_world_camera, (before or frame).T_world_camera]))
    rate, back = (
        1 / (frame.stamp - before.stamp) if before and before.stamp < frame.stamp else 0.0,
        np.linalg.inv(T) @ last,
    )
    turning = -rate * Rotation.from_matrix(back[:3, :3]).as_rotvec()
    turn = make(GEOMETRY + "Quaternion", **dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat(), strict=True)))
    pose = make(GEOMETRY + "Pose", position=vector(make, T[:3, 3], "Point"), orientation=turn)
    pose = make(GEOMETRY + "PoseWithCovariance", pose=pose)
    twist = make(GEOMETRY + "Twist", linear=vector(make, -rate * back[:3, 3]), angular=vector(make, turning))
    twist = make(GEOMETRY + "TwistWithCovariance", twist=twist)
    return make(OUT["odometry"], header=header, child_frame_id=LINK, pose=pose, twist=twist)


def in_odom(frame):
    """Points of a frame in odom, (N, 3)."""
    T = T_LINK_OPTICAL @ frame.T_world_camera
    return frame.cloud.xyz @ T[:3, :3].T + T[:3, 3]


def cloud(make, header, frame):
    """Points of a keyframe."""
    xyz = in_odom(frame).astype("<f4")
    of = [{"name": name, "offset": 4 * k, "datatype": FLOAT32, "count": 1} for k, name in enumerate("xyz")]
    fields = [make(SENSOR + "PointField", **each) for each in of]
    said = {"width": len(xyz), "point_step": 12, "row_step": xyz.nbytes, "data": xyz.view(np.uint8).ravel()}
    return make(OUT["cloud"], header=header, height=1, fields=fields, is_dense=True, **said)


def mesh(make, header, frame):
    """Triangles of a keyframe, each corner with its luminance; those of other keyframes stay."""
    corners, how = frame.surface.faces.ravel(), {"type": TRIANGLES, "action": ADD, "scale": vector(make, (1, 1, 1))}
    grey = np.nan_to_num(frame.signals.vertex)[corners].clip(0, 1).tolist()
    how["colors"] = [make("std_msgs/msg/ColorRGBA", r=each, g=each, b=each, a=1.0) for each in grey]
    how["points"] = [vector(make, xyz, "Point") for xyz in in_odom(frame)[corners]]
    return make(OUT["mesh"], header=header, ns="tspslam", id=frame.index, **how)


def rig_of(left, right):
    """The cameras of two CameraInfo messages, of rectified images."""
    P, Q = (np.asarray(info.p, float).reshape(3, 4) for info in (left, right))
    fx, cx, size = P[0, 0], P[0, 2], {"width": left.width, "height": left.height}
    return tspslam.Rig(fx=fx, fy=P[1, 1], cx=cx, cy=P[1, 2], baseline=-Q[0, 3] / fx, doffs=Q[0, 2] - cx, **size)


def main():
    """Listen until ctrl-C; pairs that come while one is worked on are dropped."""
    from cv_bridge import CvBridge
    from message_filters import ApproximateTimeSynchronizer, Subscriber
    from rclpy import create_node, init, spin
    from rclpy.qos import qos_profile_sensor_data

    init()
    node, state = create_node("tspslam"), {"session": None, "before": None, "count": 0}
    out = {name: node.create_publisher(type(make(kind)), name, 1) for name, kind in OUT.items()}

    def on_pair(left, right, *infos):
        session = state["session"] or tspslam.Session(rig_of(*infos))
        images, time = (CvBridge().imgmsg_to_cv2(each, "mono8") for each in (left, right)), left.header.stamp
        pair = tspslam.StereoPair(*images, session.rig, time.sec + 1e-9 * time.nanosec, state["count"])
        frame = session.process(pair)
        header = make("std_msgs/msg/Header", stamp=time, frame_id=WORLD)
        if frame.is_lost:
            node.get_logger().warning(f"lost at frame {frame.index}")
        else:
            out["odometry"].publish(odometry(make, header, frame, state["before"]))
        for name, build in (("cloud", cloud), ("mesh", mesh)) if frame.is_keyframe else ():
            out[name].publish(build(make, header, frame))
        state.update(session=session, before=None if frame.is_lost else frame, count=frame.index + 1)

    how = {"qos_profile": qos_profile_sensor_data}
    heard = [Subscriber(node, type(make(SENSOR + kind)), name, **how) for name, kind in IN.items()]
    ApproximateTimeSynchronizer(heard, 2, slop=0.005).registerCallback(on_pair)
    node.get_logger().info(f"waiting for {', '.join(IN)}; kernels are compiled once, which takes a minute")
    spin(node)


if __name__ == "__main__":
    main()
