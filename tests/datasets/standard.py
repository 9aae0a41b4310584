"""Tiny recordings in the standard layouts, written by the tests; and the shared real data laid out in them."""

import os
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
WIDTH, HEIGHT = 64, 48


def shared(name):
    """A folder of the shared real data; the test is skipped where it is absent."""
    if not (DATA / name).is_dir():
        pytest.skip(f"{DATA / name} is not here: set TSPSLAM_DATA")
    return DATA / name


def write_images(folder, names, size=(WIDTH, HEIGHT), seed=0):
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    for name in names:
        Image.fromarray(rng.integers(0, 255, size[::-1], np.uint8)).save(folder / name)


def poses(n, step=0.5):
    """A path that turns: (n, 4, 4)."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(np.arange(n), (0.02, 0.1, -0.01))).as_matrix()
    T[:, :3, 3] = np.outer(np.arange(n), (0.1, 0, step))
    return T


def rows_of(T):
    return "".join(" ".join(f"{x:.15g}" for x in pose[:3].ravel()) + "\n" for pose in T)


def odometry(folder, count=4, cameras="01", shift=0.0):
    """KITTI odometry, baseline 0.5 m; the colour cameras are `shift` m beside the grey ones."""
    for camera in cameras:
        write_images(folder / f"image_{camera}", [f"{k:06d}.png" for k in range(count)], seed=int(camera))
    lines = []
    for camera in range(4):
        x = shift * (camera > 1) + 0.5 * (camera % 2)
        lines.append(f"P{camera}: 50 0 32 {-50 * x} 0 50 24 0 0 0 1 0\n")
    (folder / "calib.txt").write_text("".join(lines))
    (folder / "times.txt").write_text("".join(f"{0.1 * k:.6e}\n" for k in range(count)))
    return folder


SENSOR = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [{data}]
rate_hz: 20
resolution: [64, 48]
camera_model: pinhole
intrinsics: [50, 50, 32, 24]
distortion_model: radial-tangential
distortion_coefficients: [0, 0, 0, 0]
"""


def euroc(folder, count=4, step=50_000_000, late=0):
    """A recording whose right camera is 0.1 m beside the left, and whose stamps are `late` ns behind it."""
    start = 1_403_715_273_262_142_976
    for camera in (0, 1):
        here = folder / "mav0" / f"cam{camera}"
        stamps = [start + step * k + camera * late for k in range(count)]
        write_images(here / "data", [f"{stamp}.png" for stamp in stamps], seed=camera)
        (here / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(f"{t},{t}.png\n" for t in stamps))
        T = np.eye(4)
        T[0, 3] = 0.1 * camera
        (here / "sensor.yaml").write_text(SENSOR.format(data=", ".join(map(str, T.ravel()))))
    return folder


def euroc_truth(folder, T, stamps):
    here = folder / "mav0" / "state_groundtruth_estimate0"
    here.mkdir(parents=True, exist_ok=True)
    lines = ["#timestamp, p_RS_R_x [m], ...\n"]
    for stamp, pose in zip(stamps, T, strict=True):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        lines.append(",".join(map(repr, [int(stamp), *map(float, (*pose[:3, 3], w, x, y, z))])) + "\n")
    (here / "data.csv").write_text("".join(lines))


def utias(folder, count=4, run=3):
    names = [f"{k:06d}.png" for k in range(count)]
    for seed, side in enumerate(("left", "right")):
        write_images(folder / "images" / side, names, (512, 384), seed)
    stamps = [1_600_000_000_000_000_000 + 100_000_000 * k for k in range(count)]
    (folder / "timestamps_images.txt").write_text("".join(f"{k}, {t}\n" for k, t in enumerate(stamps)))
    rows = []
    for k in range(count - 1):
        T = np.eye(4)
        T[0, 3] = 0.5  # the robot's x is forward; a point of pose k + 1 is 0.5 m farther in pose k
        rows.append(", ".join(map(str, [run, k + 1, run, k, *T[:3].ravel()])) + "\n")
    (folder / "transforms_temporal.txt").write_text("".join(rows))
    return folder


def kitti_seq1(folder):
    """The shared street in KITTI's odometry layout, by links."""
    data = shared("kitti_seq1")
    for name, there in (("image_0", "image_l"), ("image_1", "image_r")):
        (folder / name).symlink_to(data / there)
    lines = [line for line in (data / "calib.txt").read_text().splitlines() if line.strip()]
    (folder / "calib.txt").write_text("".join(f"P{k}: {line}\n" for k, line in enumerate(lines)))
    (folder / "times.txt").write_text("".join(f"{k / 10}\n" for k in range(51)))
    (folder / "poses.txt").symlink_to(data / "poses.txt")
    return folder


def kitti_raw(folder):
    """The shared raw drive in KITTI's raw layout, by links."""
    data = shared("kitti_raw_0926")
    for camera in ("00", "01"):
        (folder / f"image_{camera}").mkdir()
        (folder / f"image_{camera}" / "data").symlink_to(data / f"image_{camera}")
        (folder / f"image_{camera}" / "timestamps.txt").symlink_to(data / f"image_{camera}_timestamps_all401.txt")
    (folder / "calib_cam_to_cam.txt").symlink_to(data / "calib_cam_to_cam.txt")
    (folder / "poses.txt").symlink_to(data / "poses.txt")
    return folder


def euroc_v101(folder):
    """The shared room in the ASL layout, by links."""
    data = shared("euroc_v101_keyframes")
    for camera in (0, 1):
        here = folder / "mav0" / f"cam{camera}"
        (here / "data").mkdir(parents=True)
        names = sorted(path.name for path in (data / "images").glob(f"*_{camera}.jpg"))
        for name in names:
            (here / "data" / name).symlink_to(data / "images" / name)
        (here / "data.csv").write_text("#stamp,file\n" + "".join(f"{name.split('_')[0]},{name}\n" for name in names))
        (here / "sensor.yaml").symlink_to(data / f"cam{camera}_sensor.yaml")
    truth = folder / "mav0" / "state_groundtruth_estimate0"
    truth.mkdir()
    rows = [line.split() for line in (data / "stamped_groundtruth.txt").read_text().splitlines() if line[0] != "#"]
    said = (f"{int(Decimal(r[0]) * 10**9)},{r[1]},{r[2]},{r[3]},{r[7]},{r[4]},{r[5]},{r[6]}\n" for r in rows)
    (truth / "data.csv").write_text("#stamp,...\n" + "".join(said))
    return folder
