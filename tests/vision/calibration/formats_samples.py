"""Calibration files laid out as other programs write them, with numbers of our own, and the cameras they describe."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tspslam.types import Camera, RawRig, Rig


@dataclass(frozen=True)
class Sample:
    files: dict[str, str]
    cameras: Rig | RawRig
    format: str
    size: tuple[int, int] | None = None

    @property
    def takes_comments(self) -> bool:
        """Whether lines with # may stand above the first: not in JSON and XML."""
        return not next(iter(self.files)).endswith((".json", ".xml"))

    def write(self, folder: Path) -> Path:
        """Write the files, and return the one to read: the first."""
        for name, text in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text)
        return folder / next(iter(self.files))


TURNED = ((0.96, 0.0, 0.28, -0.125), (0.0, 1.0, 0.0, 0.002), (-0.28, 0.0, 0.96, 0.004), (0.0, 0.0, 0.0, 1.0))
BACK = ((0.96, 0.0, -0.28, 0.12112), (0.0, 1.0, 0.0, -0.002), (0.28, 0.0, 0.96, 0.03116), (0.0, 0.0, 0.0, 1.0))
LEFT = Camera(501.25, 499.5, 321.5, 238.75, 640, 480, (-0.3125, 0.125, 0.0005, -0.00025, 0.0))
RIGHT = Camera(503.75, 502.5, 318.25, 241.5, 640, 480, (-0.296875, 0.109375, -0.00075, 0.001, 0.0))
RAW = RawRig(LEFT, RIGHT, TURNED)
RECTIFIED = Rig(718.5, 718.5, 607.25, 185.5, 0.5, 1241, 376)

ODOMETRY = """\
P0: 7.185000000000e+02 0.000000000000e+00 6.072500000000e+02 0.000000000000e+00 0.000000000000e+00 7.185000000000e+02 1.855000000000e+02 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 0.000000000000e+00
P1: 7.185000000000e+02 0.000000000000e+00 6.072500000000e+02 -3.592500000000e+02 0.000000000000e+00 7.185000000000e+02 1.855000000000e+02 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 0.000000000000e+00
P2: 7.185000000000e+02 0.000000000000e+00 6.072500000000e+02 4.500000000000e+01 0.000000000000e+00 7.185000000000e+02 1.855000000000e+02 -1.500000000000e-01 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 5.000000000000e-03
P3: 7.185000000000e+02 0.000000000000e+00 6.072500000000e+02 -3.375000000000e+02 0.000000000000e+00 7.185000000000e+02 1.855000000000e+02 2.250000000000e+00 0.000000000000e+00 0.000000000000e+00 1.000000000000e+00 3.000000000000e-03
Tr: 0.000000000000e+00 -1.000000000000e+00 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 0.000000000000e+00 -1.000000000000e+00 -7.500000000000e-02 1.000000000000e+00 0.000000000000e+00 0.000000000000e+00 -2.750000000000e-01
"""

KITTI_RAW = """\
calib_time: 01-Feb-2003 04:05:06
corner_dist: 9.500000e-02
S_00: 6.400000e+02 4.800000e+02
K_00: 5.012500e+02 0.000000e+00 3.215000e+02 0.000000e+00 4.995000e+02 2.387500e+02 0.000000e+00 0.000000e+00 1.000000e+00
D_00: -3.125000e-01 1.250000e-01 5.000000e-04 -2.500000e-04 0.000000e+00
R_00: 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00
T_00: 1.500000e-16 -2.500000e-16 3.500000e-16
S_rect_00: 6.000000e+02 4.000000e+02
R_rect_00: 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00
P_rect_00: 4.800000e+02 0.000000e+00 3.015000e+02 0.000000e+00 0.000000e+00 4.800000e+02 1.985000e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
S_01: 6.400000e+02 4.800000e+02
K_01: 5.037500e+02 0.000000e+00 3.182500e+02 0.000000e+00 5.025000e+02 2.415000e+02 0.000000e+00 0.000000e+00 1.000000e+00
D_01: -2.968750e-01 1.093750e-01 -7.500000e-04 1.000000e-03 0.000000e+00
R_01: 9.600000e-01 0.000000e+00 2.800000e-01 0.000000e+00 1.000000e+00 0.000000e+00 -2.800000e-01 0.000000e+00 9.600000e-01
T_01: -1.250000e-01 2.000000e-03 4.000000e-03
S_rect_01: 6.000000e+02 4.000000e+02
R_rect_01: 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00
P_rect_01: 4.800000e+02 0.000000e+00 3.017500e+02 -6.000000e+01 0.000000e+00 4.800000e+02 1.985000e+02 0.000000e+00 0.000000e+00 0.000000e+00 1.000000e+00 0.000000e+00
"""

EUROC = """\
# General sensor definitions.
sensor_type: camera
comment: VI-Sensor {name} (MT9M034)

# Sensor extrinsics wrt. the body-frame.
T_BS:
  cols: 4
  rows: 4
  data: [{T}
         0.0, 0.0, 0.0, 1.0]

# Camera specific definitions.
rate_hz: 20
resolution: [640, 480]
camera_model: pinhole
intrinsics: [{K}] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [{D}]

"""
LEFT_K, LEFT_D = "501.25, 499.5, 321.5, 238.75", "-0.3125, 0.125, 0.0005, -0.00025"
RIGHT_K, RIGHT_D = "503.75, 502.5, 318.25, 241.5", "-0.296875,  0.109375, -7.5e-04, 1.00000000e-03"
CAM0 = EUROC.format(
    name="cam0", K=LEFT_K, D=LEFT_D,
    T="0.0, -1.0, 0.0, -0.02,\n         1.0, 0.0, 0.0, -0.06,\n         0.0, 0.0, 1.0, 0.01,",
)  # fmt: skip
CAM1 = EUROC.format(
    name="cam1", K=RIGHT_K, D=RIGHT_D,
    T="0.0, -1.0, 0.0, -0.018,\n         0.96, 0.0, -0.28, 0.06112,\n         0.28, 0.0, 0.96, 0.04116,",
)  # fmt: skip

CAMCHAIN = f"""\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [{LEFT_D}]
  distortion_model: radtan
  intrinsics: [{LEFT_K}]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.96, 0.0, 0.28, -0.125]
  - [0.0, 1.0, 0.0, 0.002]
  - [-0.28, 0.0, 0.96, 0.004]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [{RIGHT_D}]
  distortion_model: radtan
  intrinsics: [{RIGHT_K}]
  resolution: [640, 480]
  rostopic: /cam1/image_raw
"""

INTRINSICS = """\
%YAML:1.0
---
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.0125000000000000e+02, 0., 3.2150000000000000e+02, 0.,
       4.9950000000000000e+02, 2.3875000000000000e+02, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 14
   dt: d
   data: [ -3.1250000000000000e-01, 1.2500000000000000e-01,
       5.0000000000000001e-04, -2.5000000000000001e-04, 0., 0., 0., 0.,
       0., 0., 0., 0., 0., 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.0375000000000000e+02, 0., 3.1825000000000000e+02, 0.,
       5.0250000000000000e+02, 2.4150000000000000e+02, 0., 0., 1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 14
   dt: d
   data: [ -2.9687500000000000e-01, 1.0937500000000000e-01,
       -7.5000000000000002e-04, 1.0000000000000000e-03, 0., 0., 0., 0.,
       0., 0., 0., 0., 0., 0. ]
"""
EXTRINSICS = """\
%YAML:1.0
---
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 9.5999999999999996e-01, 0., 2.8000000000000003e-01, 0., 1.,
       0., -2.8000000000000003e-01, 0., 9.5999999999999996e-01 ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -1.2500000000000000e-01, 2.0000000000000000e-03,
       4.0000000000000001e-03 ]
R1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]
"""
PROJECTIONS = """\
%YAML:1.0
---
calibration_time: "Sat 01 Feb 2003 04:05:06"
image_width: 1241
image_height: 376
P1: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [ 718.5, 0., 607.25, 0., 0., 718.5, 185.5, 0., 0., 0., 1., 0. ]
P2: !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [ 718.5, 0., 607.25, -359.25, 0., 718.5, 185.5, 0., 0., 0., 1.,
       0. ]
"""

ORBSLAM2 = """\
%YAML:1.0

#--------------------------------------------------------------------------------------------
# Camera Parameters. Adjust them!
#--------------------------------------------------------------------------------------------

# Camera calibration and distortion parameters (OpenCV)
Camera.fx: 718.5
Camera.fy: 718.5
Camera.cx: 607.25
Camera.cy: 185.5

Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0

Camera.width: 1241
Camera.height: 376

# Camera frames per second
Camera.fps: 10.0

# stereo baseline times fx
Camera.bf: 359.25

# Color order of the images (0: BGR, 1: RGB. It is ignored if images are grayscale)
Camera.RGB: 1

# Close/Far threshold. Baseline times.
ThDepth: 35

ORBextractor.nFeatures: 2000
"""
ORBSLAM3 = """\
%YAML:1.0

File.version: "1.0"

Camera.type: "PinHole"

# Camera calibration and distortion parameters (OpenCV)
Camera1.fx: 501.25
Camera1.fy: 499.5
Camera1.cx: 321.5
Camera1.cy: 238.75

Camera1.k1: -0.3125
Camera1.k2: 0.125
Camera1.p1: 0.0005
Camera1.p2: -0.00025

Camera2.fx: 503.75
Camera2.fy: 502.5
Camera2.cx: 318.25
Camera2.cy: 241.5

Camera2.k1: -0.296875
Camera2.k2: 0.109375
Camera2.p1: -0.00075
Camera2.p2: 0.001

Camera.width: 640
Camera.height: 480

Camera.fps: 20
Camera.RGB: 1

Stereo.ThDepth: 60.0
Stereo.T_c1_c2: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [0.96, 0, -0.28, 0.12112,
         0, 1.0, 0, -0.002,
         0.28, 0, 0.96, 0.03116,
         0, 0, 0, 1.000000000000000]
"""
SIDE = """\
{side}.height: 480
{side}.width: 640
{side}.D: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data:[{D}, 0.0]
{side}.K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [{K}]
{side}.R:  !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [{R}]
{side}.P:  !!opencv-matrix
   rows: 3
   cols: 4
   dt: d
   data: [450.5, 0.0, 330.25, {t},  0.0, 450.5, 244.5, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
PRERECTIFIED = (
    """\
%YAML:1.0

Camera.fx: 450.5
Camera.fy: 450.5
Camera.cx: 330.25
Camera.cy: 244.5

Camera.k1: 0.0
Camera.k2: 0.0
Camera.p1: 0.0
Camera.p2: 0.0

Camera.width: 640
Camera.height: 480
Camera.fps: 20.0
Camera.bf: 45.05
Camera.RGB: 1
ThDepth: 35

# Stereo Rectification. Only if you need to pre-rectify the images.
"""
    + SIDE.format(
        side="LEFT", D=LEFT_D, t="0.0", K="501.25, 0.0, 321.5, 0.0, 499.5, 238.75, 0.0, 0.0, 1.0",
        R="1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0",
    )
    + SIDE.format(
        side="RIGHT", D=RIGHT_D, t="-45.05", K="503.75, 0.0, 318.25, 0.0, 502.5, 241.5, 0.0, 0.0, 1",
        R="0.96, 0.0, -0.28, 0.0, 1.0, 0.0, 0.28, 0.0, 0.96",
    )
)  # fmt: skip
PARALLEL = ((0.96, 0.0, 0.28, -0.096), (0.0, 1.0, 0.0, 0.0), (-0.28, 0.0, 0.96, 0.028), (0.0, 0.0, 0.0, 1.0))
OWN = "fx: 718.5\nfy: 718.5\ncx: 607.25\ncy: 185.5\nbaseline: 0.5\nwidth: 1241\nheight: 376\n"

SAMPLES = {
    "odometry": Sample({"calib.txt": ODOMETRY}, RECTIFIED, "KITTI odometry calib.txt", (1241, 376)),
    "recorded": Sample({"calib_cam_to_cam.txt": KITTI_RAW}, RAW, "KITTI raw calib_cam_to_cam.txt", (640, 480)),
    "rectified": Sample(
        {"calib_cam_to_cam.txt": KITTI_RAW}, Rig(480, 480, 301.5, 198.5, 0.125, 600, 400, doffs=0.25),
        "KITTI raw calib_cam_to_cam.txt",
    ),
    "euroc": Sample({"mav0/cam0/sensor.yaml": CAM0, "mav0/cam1/sensor.yaml": CAM1}, RAW, "EuRoC sensor.yaml"),
    "kalibr": Sample({"camchain.yaml": CAMCHAIN}, RAW, "Kalibr camchain"),
    "opencv": Sample(
        {"intrinsics.yml": INTRINSICS, "extrinsics.yml": EXTRINSICS}, RAW, "OpenCV FileStorage", (640, 480)
    ),
    "projections": Sample({"stereo.yml": PROJECTIONS}, RECTIFIED, "OpenCV FileStorage"),
    "orbslam2": Sample({"KITTI00-02.yaml": ORBSLAM2}, RECTIFIED, "ORB-SLAM settings"),
    "orbslam3": Sample({"EuRoC.yaml": ORBSLAM3}, RAW, "ORB-SLAM settings"),
    "prerectified": Sample({"EuRoC.yaml": PRERECTIFIED}, RawRig(LEFT, RIGHT, PARALLEL), "ORB-SLAM settings"),
    "own": Sample({"calib.yaml": OWN}, RECTIFIED, "tspslam calibration file"),
}  # fmt: skip
