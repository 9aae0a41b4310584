"""Calibration files of further programs and lenses, laid out as these write them, with numbers of our own."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from tspslam.types import Camera, RawRig, Rig

from .formats_samples import (
    BACK,
    CAM0,
    CAM1,
    EXTRINSICS,
    INTRINSICS,
    LEFT,
    ORBSLAM3,
    PARALLEL,
    RAW,
    RECTIFIED,
    RIGHT,
    TURNED,
    Sample,
)

BARE = ((1.0, 0.0, 0.0, -0.125), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
Coefficients = tuple[float, ...]


def pair(lens: str, left: Coefficients, right: Coefficients, pose: tuple[tuple[float, ...], ...] = TURNED) -> RawRig:
    """The cameras of the other samples with other lenses."""
    one, other = (replace(c, lens=lens, distortion=d) for c, d in ((LEFT, left), (RIGHT, right)))
    return RawRig(one, other, pose)  # type: ignore[arg-type]


FISHEYES = pair("equidistant", (0.03125, -0.0125, 0.0075, -0.002), (0.0285, -0.011, 0.0065, -0.00175))
IDEAL = pair("brown", (0.0,) * 5, (0.0,) * 5)
SPHERES = pair("double_sphere", (-0.1875, 0.5625), (-0.171875, 0.578125))
EUCM = pair("eucm", (0.625, 1.0625), (0.609375, 1.078125))
MEI = pair("mei", (1.25, -0.3125, 0.125, 0.0005, -0.00025), (1.1875, -0.296875, 0.109375, -0.00075, 0.001))
RATIONAL = pair(
    "rational",
    (5.25, 2.125, 0.0005, -0.00025, 0.0625, 5.5, 3.75, 0.375),
    (5.125, 2.0, -0.00075, 0.001, 0.03125, 5.375, 3.5, 0.25),
)
PRISM = pair(
    "thin_prism",
    (0.25, -0.125, 0.0005, -0.00025, 0.0625, 0.5, 0.0, 0.375, 0.001, -0.002, 0.0005, 0.00075),
    (0.125, -0.25, -0.00075, 0.001, 0.03125, 0.375, 0.5, 0.25, 0.002, 0.0, -0.001, 0.0),
)
UCM = pair("eucm", (0.625, 1.0), (0.609375, 1.0))


def camchain(model: str, intrinsics: tuple[str, str], warp: str, coefficients: tuple[str, str], pose: str = "") -> str:
    rows = "".join(f"  - {list(row)}\n" for row in TURNED)
    parts = []
    for k in (0, 1):
        parts.append(
            f"cam{k}:\n  camera_model: {model}\n  distortion_coeffs: [{coefficients[k]}]\n  distortion_model: {warp}\n"
            f"  intrinsics: [{intrinsics[k]}]\n  resolution: [640, 480]\n  rostopic: /cam{k}/image_raw\n"
        )
        parts.append((pose or f"  T_cn_cnm1:\n{rows}") if k else pose and OWN_POSE)
    return "".join(parts)


OWN_POSE = "  T_cam_imu:\n  - [0.0, 1.0, 0.0, 0.06]\n  - [-1.0, 0.0, 0.0, -0.02]\n  - [0.0, 0.0, 1.0, -0.01]\n  - [0, 0, 0, 1]\n"  # fmt: skip
NEXT_POSE = "  T_cam_imu:\n  - [0.0, 0.96, 0.28, -0.0702]\n  - [-1.0, 0.0, 0.0, -0.018]\n  - [0.0, -0.28, 0.96, -0.0224]\n  - [0, 0, 0, 1]\n"  # fmt: skip
PINHOLES = "501.25, 499.5, 321.5, 238.75", "503.75, 502.5, 318.25, 241.5"
EQUI = "0.03125, -0.0125, 0.0075, -0.002", "0.0285, -0.011, 0.0065, -0.00175"
OMNI = tuple(f"{xi}, {rest}" for xi, rest in zip(("1.25", "1.1875"), PINHOLES, strict=True))
RADTAN = "-0.3125, 0.125, 0.0005, -0.00025", "-0.296875, 0.109375, -0.00075, 0.001"
DS = tuple(f"{own}, {rest}" for own, rest in zip(("-0.1875, 0.5625", "-0.171875, 0.578125"), PINHOLES, strict=True))
EU = tuple(f"{own}, {rest}" for own, rest in zip(("0.625, 1.0625", "0.609375, 1.078125"), PINHOLES, strict=True))


def opencv(left: str, right: str, more: str = "") -> str:
    """One file with lenses, pose and size."""
    body = INTRINSICS + EXTRINSICS.partition("---\n")[2]
    old = (
        "[ -3.1250000000000000e-01, 1.2500000000000000e-01,\n       5.0000000000000001e-04, -2.5000000000000001e-04, ",
        "[ -2.9687500000000000e-01, 1.0937500000000000e-01,\n       -7.5000000000000002e-04, 1.0000000000000000e-03, ",
    )
    zeros = "0., 0., 0., 0.,\n       0., 0., 0., 0., 0., 0. ]"
    for each, new in zip(old, (left, right), strict=True):
        assert each + zeros in body
        count = new.count(",") + 1
        body = body.replace(each + zeros, f"[ {new} ]").replace("cols: 14", f"cols: {count}")
    return f"{body}image_width: 640\nimage_height: 480\n{more}"


def listed(camera: Camera) -> str:
    return ", ".join(map(repr, camera.distortion))


XML = """\
<?xml version="1.0"?>
<opencv_storage>
<!-- of two cameras -->
<calibration_time>"Sat 01 Feb 2003 04:05:06"</calibration_time>
<imageSize>
  640 480</imageSize>
<M1 type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    5.0125e+02 0. 3.215e+02 0. 4.995e+02 2.3875e+02 0. 0. 1.</data></M1>
<D1 type_id="opencv-matrix">
  <rows>1</rows>
  <cols>5</cols>
  <dt>d</dt>
  <data>
    -0.3125 0.125 0.0005 -0.00025 0.</data></D1>
<M2 type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    503.75 0. 318.25 0. 502.5 241.5 0. 0. 1.</data></M2>
<D2 type_id="opencv-matrix">
  <rows>1</rows>
  <cols>5</cols>
  <dt>d</dt>
  <data>
    -0.296875 0.109375 -0.00075 0.001 0.</data></D2>
<R type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    0.96 0. 0.28 0. 1. 0. -0.28 0. 0.96</data></R>
<T type_id="opencv-matrix">
  <rows>3</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    -0.125 0.002 0.004</data></T>
<nothing></nothing>
<views><_>left_01.png</_><_>left_02.png</_></views>
</opencv_storage>
"""

KB8 = ORBSLAM3.replace('"PinHole"', '"KannalaBrandt8"')
for _old, _new in (
    ("k1: -0.3125", "k1: 0.03125"), ("k2: 0.125", "k2: -0.0125"), ("p1: 0.0005", "k3: 0.0075"),
    ("p2: -0.00025", "k4: -0.002"), ("k1: -0.296875", "k1: 0.0285"), ("k2: 0.109375", "k2: -0.011"),
    ("p1: -0.00075", "k3: 0.0065"), ("p2: 0.001", "k4: -0.00175"),
):  # fmt: skip
    assert _old in KB8
    KB8 = KB8.replace(_old, _new)
TLR = (
    KB8.partition("Stereo.T_c1_c2")[0].replace("Camera1.", "Camera.")
    + "Tlr: !!opencv-matrix\n  rows: 3\n  cols: 4\n  dt: f\n"
    + f"  data: [{', '.join(str(value) for row in BACK[:3] for value in row)}]\n"
)

STELLA = """\
# EuRoC-like stereo model
Camera:
  name: "a stereo rig"
  setup: "stereo"
  model: "perspective"

  # after stereo rectification
  fx: 450.5
  fy: 450.5
  cx: 330.25
  cy: 244.5

  k1: 0.0
  k2: 0.0
  p1: 0.0
  p2: 0.0
  k3: 0.0

  fps: 20.0
  cols: 640
  rows: 480
  focal_x_baseline: 45.05
  color_order: "Gray"

Preprocessing:
  min_size: 800

StereoRectifier:
  model: "MODEL"
  K_left: [501.25, 0.0, 321.5, 0.0, 499.5, 238.75, 0.0, 0.0, 1.0]
  D_left: [LEFT]
  R_left: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
  K_right: [503.75, 0.0, 318.25, 0.0, 502.5, 241.5, 0.0, 0.0, 1.0]
  D_right: [RIGHT]
  R_right: [0.96, 0.0, -0.28, 0.0, 1.0, 0.0, 0.28, 0.0, 0.96]
"""
STELLA_RECTIFIED = """\
Camera.name: "KITTI-like"
Camera.setup: "stereo"
Camera.model: "perspective"
Camera.fx: 718.5
Camera.fy: 718.5
Camera.cx: 607.25
Camera.cy: 185.5
Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0
Camera.k3: 0.0
Camera.fps: 10.0
Camera.cols: 1241
Camera.rows: 376
Camera.focal_x_baseline: 359.25
Camera.color_order: "Gray"
Feature.max_num_keypoints: 2000
"""


def stella(model: str, left: str, right: str) -> str:
    return STELLA.replace("MODEL", model).replace("LEFT", left).replace("RIGHT", right)


def basalt(kind: str, left: dict[str, float], right: dict[str, float]) -> str:
    """T_imu_cam of the left camera: no rotation at (-0.0625, 0, 0); of the right one: BARE from there."""
    cameras = [
        {"camera_type": kind, "intrinsics": {"fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy} | more}
        for c, more in ((LEFT, left), (RIGHT, right))
    ]
    poses = [{"px": x, "py": 0.0, "pz": 0.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0} for x in (-0.0625, 0.0625)]
    inner = {"T_imu_cam": poses, "intrinsics": cameras, "resolution": [[640, 480], [640, 480]], "vignette": []}
    return json.dumps({"value0": inner | {"imu_update_rate": 200.0, "cam_time_offset_ns": 0}}, indent=4)


def t265(lens: str, rig: RawRig) -> str:
    """Cameras turned by half about x in the body's frame (W is pi about x), where x of both is the body's own."""
    cameras = [
        {
            "size_px": [640, 480],
            "center_px": [c.cx, c.cy],
            "focal_length_px": [c.fx, c.fy],
            "distortion": {"type": lens, "k": list(c.distortion)} if c.lens != "brown" else {"type": lens},
            "extrinsics": {
                "T": [x, 0.0, 0.0],
                "T_variance": [1e-6] * 3,
                "W": [np.pi, 0.0, 0.0],
                "W_variance": [1e-6] * 3,
            },
        }
        for c, x in ((rig.left, -0.0625), (rig.right, 0.0625))
    ]
    head = {"device_id": "1234", "device_type": "T265", "calibration_version": 10}
    return json.dumps(head | {"cameras": cameras, "depths": [], "imus": [{"accelerometer": {}}]}, indent=4)


def named(rig: RawRig, names: str) -> tuple[dict[str, float], dict[str, float]]:
    left, right = (dict(zip(names.split(), c.distortion, strict=True)) for c in (rig.left, rig.right))
    return left, right


def bare(rig: RawRig) -> RawRig:
    return replace(rig, T_right_left=BARE)  # type: ignore[arg-type]


INFO = """\
image_width: 640
image_height: 480
camera_name: narrow_stereo/{side}
camera_matrix:
  rows: 3
  cols: 3
  data: [{K}]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: [{D}]
rectification_matrix:
  rows: 3
  cols: 3
  data: [{R}]
projection_matrix:
  rows: 3
  cols: 4
  data: [450.5, 0., 330.25, {x}, 0., 450.5, 244.5, 0., 0., 0., 1., 0.]
"""
_K = "501.25, 0., 321.5, 0., 499.5, 238.75, 0., 0., 1.", "503.75, 0., 318.25, 0., 502.5, 241.5, 0., 0., 1."
_R = "1., 0., 0., 0., 1., 0., 0., 0., 1.", "0.96, 0., -0.28, 0., 1., 0., 0.28, 0., 0.96"


def infos(model: str, rig: RawRig, x: str = "-45.05") -> tuple[str, str]:
    """camera_info files of the left and of the right camera."""
    sides = zip(("left", "right"), _K, (rig.left, rig.right), _R, ("0.", x), strict=True)
    one, other = (
        INFO.format(side=side, K=K, model=model, count=len(c.distortion), D=listed(c), R=R, x=at)
        for side, K, c, R, at in sides
    )
    return one, other


def ros(model: str, rig: RawRig) -> dict[str, str]:
    left, right = infos(model, rig)
    return {"left.yaml": left, "right.yaml": right}


def rtabmap(rig: RawRig) -> dict[str, str]:
    """The three files of a stereo calibration; its projection matrices hold no baseline yet."""
    left, right = infos("plumb_bob", rig, "0.")
    rows = [list(map(str, row)) for row in TURNED[:3]]
    R, t = ", ".join(", ".join(row[:3]) for row in rows), ", ".join(row[3] for row in rows)
    local = "local_transform:\n   rows: 3\n   cols: 4\n   data: [ 0., 0., 1., 0., -1., 0., 0., 0., 0., -1., 0., 0. ]\n"
    pose = f"rotation_matrix:\n   rows: 3\n   cols: 3\n   data: [ {R} ]\ntranslation_matrix:\n   rows: 3\n   cols: 1\n   data: [ {t} ]\n"  # fmt: skip
    head = "%YAML:1.0\n---\n"
    return {
        "stereo_left.yaml": f"{head}{left}{local}",
        "stereo_right.yaml": f"{head}{right}{local}",
        "stereo_pose.yaml": f"{head}camera_name: stereo\n{pose}",
    }


RECTIFIED_INFO = """\
image_width: 1241
image_height: 376
camera_name: {side}
camera_matrix: {{rows: 3, cols: 3, data: [718.5, 0, 607.25, 0, 718.5, 185.5, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [718.5, 0, 607.25, {x}, 0, 718.5, 185.5, 0, 0, 0, 1, 0]}}
"""

_ZED_CAMERA = "fx=501.25\nfy=499.5\ncx=321.5\ncy=238.75\nk1=-0.3125\nk2=0.125\np1=0.0005\np2=-0.00025\nk3=0\n"
_ZED_OTHER = "fx=503.75\nfy=502.5\ncx=318.25\ncy=241.5\nk1=-0.296875\nk2=0.109375\np1=-0.00075\np2=0.001\nk3=0\n"
ZED = f"""\
[LEFT_CAM_HD]
{_ZED_CAMERA}
[RIGHT_CAM_HD]
{_ZED_OTHER}
[LEFT_CAM_VGA]
fx=250
fy=250
cx=160
cy=120
k1=-0.17
k2=0.02

[RIGHT_CAM_VGA]
fx=251
fy=251
cx=161
cy=121
k1=-0.17
k2=0.02

[STEREO]
Baseline=125
TY=-2
TZ=0
CV_HD=0.25
CV_VGA=0.25
RX_HD=0
RX_VGA=0
RZ_HD=0
RZ_VGA=0

[MISC]
Sensor_ID=0
"""
_C, _S = 0.9689124217106447, 0.24740395925452294  # cosine and sine of 0.25
BY_ZED = RawRig(
    replace(LEFT, width=1280, height=720), replace(RIGHT, width=1280, height=720),
    ((_C, 0.0, _S, -0.125), (0.0, 1.0, 0.0, 0.002), (-_S, 0.0, _C, 0.0), (0.0, 0.0, 0.0, 1.0)),
)  # fmt: skip

MIDDLEBURY = """\
cam0=[3997.5 0 1176.75; 0 3997.5 1011.75; 0 0 1]
cam1=[3997.5 0 1307.875; 0 3997.5 1011.75; 0 0 1]
doffs=131.125
baseline=193
width=2964
height=1988
ndisp=280
isint=0
vmin=31
vmax=257
dyavg=0.918
dymax=1.516
"""

COLMAP_CAMERAS = """\
# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 3
1 OPENCV 640 480 501.25 499.5 322 239.25 -0.3125 0.125 0.0005 -0.00025
2 OPENCV 640 480 503.75 502.5 318.75 242 -0.296875 0.109375 -0.00075 0.001
7 PINHOLE 640 480 500 500 320 240
"""
COLMAP_RIGS = """\
# Rig calib list with one line of data per calib:
#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])
# Number of rigs: 2
1 1 CAMERA 7
2 2 CAMERA 1 CAMERA 2 1 1 0 0 0 -0.125 0 0
"""
RIG_CONFIG = json.dumps(
    [
        {
            "cameras": [
                {
                    "image_prefix": "rig1/right/",
                    "camera_model_name": "OPENCV_FISHEYE",
                    "camera_params": [503.75, 502.5, 318.75, 242, *FISHEYES.right.distortion],
                    "cam_from_rig_rotation": [1, 0, 0, 0],
                    "cam_from_rig_translation": [-0.125, 0, 0],
                },
                {
                    "image_prefix": "rig1/left/",
                    "ref_sensor": True,
                    "camera_model_name": "OPENCV_FISHEYE",
                    "camera_params": [501.25, 499.5, 322, 239.25, *FISHEYES.left.distortion],
                },
            ]
        }
    ],
    indent=2,
)

_KB8 = RawRig(FISHEYES.left, FISHEYES.right, TURNED)
FURTHER = {
    "kalibr-equi": Sample({"camchain.yaml": camchain("pinhole", PINHOLES, "equidistant", EQUI)}, FISHEYES, "Kalibr camchain"),
    "kalibr-imu": Sample({"c.yaml": camchain("pinhole", PINHOLES, "equi", EQUI, NEXT_POSE)}, FISHEYES, "Kalibr camchain"),
    "kalibr-omni": Sample({"camchain.yaml": camchain("omni", OMNI, "radtan", RADTAN)}, MEI, "Kalibr camchain"),  # type: ignore[arg-type]
    "kalibr-ds": Sample({"camchain.yaml": camchain("ds", DS, "none", ("", ""))}, SPHERES, "Kalibr camchain"),  # type: ignore[arg-type]
    "kalibr-eucm": Sample({"camchain.yaml": camchain("eucm", EU, "none", ("", ""))}, EUCM, "Kalibr camchain"),  # type: ignore[arg-type]
    "euroc-equi": Sample(
        {
            "mav0/cam0/sensor.yaml": CAM0.replace("radial-tangential", "equidistant").replace(RADTAN[0], EQUI[0]),
            "mav0/cam1/sensor.yaml": CAM1.replace("radial-tangential", "equidistant").replace(
                "-0.296875,  0.109375, -7.5e-04, 1.00000000e-03", EQUI[1]),
        }, FISHEYES, "EuRoC sensor.yaml"),
    "opencv-xml": Sample({"stereo.xml": XML}, RAW, "OpenCV FileStorage"),
    "opencv-8": Sample({"s.yml": opencv(listed(RATIONAL.left), listed(RATIONAL.right))}, RATIONAL, "OpenCV FileStorage"),
    "opencv-12": Sample({"s.yml": opencv(listed(PRISM.left), listed(PRISM.right))}, PRISM, "OpenCV FileStorage"),
    "opencv-fisheye": Sample({"s.yml": opencv(*EQUI, "fisheye: 1\n")}, FISHEYES, "OpenCV FileStorage"),
    "orbslam-kb8": Sample({"TUM-VI.yaml": KB8}, FISHEYES, "ORB-SLAM settings"),
    "orbslam-tlr": Sample({"TUM_512.yaml": TLR}, FISHEYES, "ORB-SLAM settings"),
    "stella": Sample({"s.yaml": stella("perspective", listed(LEFT), listed(RIGHT))},
                     RawRig(LEFT, RIGHT, PARALLEL), "stella_vslam settings"),
    "stella-fisheye": Sample({"s.yaml": stella("fisheye", *EQUI)}, replace(FISHEYES, T_right_left=PARALLEL), "stella_vslam settings"),
    "stella-rectified": Sample({"s.yaml": STELLA_RECTIFIED}, RECTIFIED, "stella_vslam settings"),
    "basalt-kb4": Sample({"c.json": basalt("kb4", *named(FISHEYES, "k1 k2 k3 k4"))}, bare(FISHEYES), "Basalt calibration"),
    "basalt-ds": Sample({"c.json": basalt("ds", *named(SPHERES, "xi alpha"))}, bare(SPHERES), "Basalt calibration"),
    "basalt-eucm": Sample({"c.json": basalt("eucm", *named(EUCM, "alpha beta"))}, bare(EUCM), "Basalt calibration"),
    "basalt-ucm": Sample({"c.json": basalt("ucm", {"alpha": 0.625}, {"alpha": 0.609375})}, bare(UCM), "Basalt calibration"),
    "basalt-8": Sample({"c.json": basalt("pinhole-radtan8", *named(RATIONAL, "k1 k2 p1 p2 k3 k4 k5 k6"))},
                       bare(RATIONAL), "Basalt calibration"),
    "t265": Sample({"c.json": t265("kannalabrandt4", FISHEYES)}, bare(FISHEYES), "RealSense T265 calibration"),
    "t265-pinhole": Sample({"c.json": t265("undistorted", IDEAL)}, bare(IDEAL), "RealSense T265 calibration"),
    "ros": Sample(ros("plumb_bob", RAW), replace(RAW, T_right_left=PARALLEL), "ROS camera_info"),
    "ros-rational": Sample(ros("rational_polynomial", RATIONAL), replace(RATIONAL, T_right_left=PARALLEL), "ROS camera_info"),
    "ros-equidistant": Sample(ros("equidistant", FISHEYES), replace(FISHEYES, T_right_left=PARALLEL), "ROS camera_info"),
    "ros-rectified": Sample(
        {"cam0.yaml": RECTIFIED_INFO.format(side="l", x="0"), "cam1.yaml": RECTIFIED_INFO.format(side="r", x="-359.25")},
        RECTIFIED, "ROS camera_info"),
    "rtabmap": Sample(rtabmap(RAW), RAW, "RTAB-Map calibration"),
    "zed": Sample({"SN1.conf": ZED}, BY_ZED, "ZED calibration (HD)", (1280, 720)),
    "middlebury": Sample({"calib.txt": MIDDLEBURY}, Rig(3997.5, 3997.5, 1176.75, 1011.75, 0.193, 2964, 1988, doffs=131.125),
                         "Middlebury calib.txt"),
    "colmap": Sample({"rigs.txt": COLMAP_RIGS, "cameras.txt": COLMAP_CAMERAS}, bare(RAW), "COLMAP rig"),
    "colmap-config": Sample({"rig_config.json": RIG_CONFIG}, bare(FISHEYES), "COLMAP rig_config.json", (640, 480)),
}  # fmt: skip
SIZELESS = ("odometry", "opencv", "colmap-config")
"""Samples of files without a size, which take any."""
