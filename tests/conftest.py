"""Shared by the tests: the real pair, and a small real pair on disk; and what is tested first, so that all end together."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import settings
from PIL import Image

from tspslam import Camera, RawRig, StereoPair, datasets
from tspslam.vision.calibration.formats.own import save_cameras

settings.register_profile("gate", deadline=None, derandomize=True)  # the same examples everywhere, however slow
settings.load_profile("gate")

TOGETHER = "tests/scale/maps/"  # its files share runs and joins that take long to make: one worker does them all
LONGEST = (
    TOGETHER,
    "tests/test_docs.py",
    "tests/test_cli.py",
    "tests/run/test_resume.py",
    "tests/scale/test_hard_life.py",
    "tests/vision/test_faults.py",
    "tests/test_examples.py",
    "tests/run/test_health.py",
    "tests/scale/test_batch.py",
    "tests/run/test_joining.py",
    "tests/vision/slam/test_loop_closing.py",
    "tests/run/test_export.py",
    "tests/vision/calibration/test_board.py",
    "tests/test_experiments.py",
    "tests/run/test_report.py",
    "tests/vision/slam/test_first_step.py",
    "tests/run/test_scan.py",
    "tests/vision/slam/test_motion_faults.py",
    "tests/run/test_map.py",
    "tests/vision/slam/test_recordings.py",
)
"""Files, and a folder, that take over twenty seconds of a processor, the longest first."""


def pytest_collection_modifyitems(items):
    """Begin with what takes longest: a worker that comes to it at the end leaves the others idle."""

    def place(item):
        return next((k for k, name in enumerate(LONGEST) if item.nodeid.startswith(name)), len(LONGEST))

    items.sort(key=place)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Hand out whole files, as `--dist loadfile` does, and those of `TOGETHER` as one."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return TOGETHER if nodeid.startswith(TOGETHER) else super()._split_scope(nodeid)

    return Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.fixture(scope="session")
def motorcycle():
    return datasets.motorcycle()


@pytest.fixture(scope="session")
def small_pair(motorcycle):
    """A piece of the Motorcycle pair, 300x200 px, with its rig: (left, right, rig)."""
    rows, columns = slice(200, 400), slice(300, 600)
    rig = replace(motorcycle.rig, cx=motorcycle.rig.cx - 300, cy=motorcycle.rig.cy - 200, width=300, height=200)
    return (
        np.ascontiguousarray(motorcycle.left[rows, columns]),
        np.ascontiguousarray(motorcycle.right[rows, columns]),
        rig,
    )


@pytest.fixture(scope="session")
def motorcycle_truth_piece():
    """True disparities of the small pair's left image."""
    return datasets.motorcycle_truth()[200:400, 300:600]


@pytest.fixture(scope="session")
def raw_pair(motorcycle):
    """The Motorcycle pair as two turned cameras with distortion would have taken it: (pair, raw rig)."""
    rig = motorcycle.rig
    lens = (-0.12, 0.05, 0.001, -0.0005, 0.0)
    left = Camera(rig.fx, rig.fy, rig.cx, rig.cy, rig.width, rig.height, lens)
    right = replace(left, cx=rig.cx + rig.doffs, fy=rig.fy * 1.002)
    turns = [cv2.Rodrigues(np.array(turn))[0] for turn in ((0.01, -0.01, 0.012), (-0.006, 0.008, -0.01))]
    T_right_left = np.eye(4)
    T_right_left[:3, :3] = turns[1] @ turns[0].T
    T_right_left[:3, 3] = turns[1] @ (-rig.baseline, 0, 0)
    images = (
        _taken_by(left, turns[0], motorcycle.left, rig, rig.cx),
        _taken_by(right, turns[1], motorcycle.right, rig, rig.cx + rig.doffs),
    )
    return StereoPair(*images, rig, name="raw"), RawRig(left, right, tuple(map(tuple, T_right_left.tolist())))


def _taken_by(camera, turn, image, rig, cx):
    """An image of the rectified pair as a turned and distorted camera sees it."""
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    rays = cv2.undistortPoints(pixels, K, np.array(camera.distortion))[:, 0]
    x, y, z = turn.T @ np.column_stack([rays, np.ones(len(rays))]).T
    where = [(f * a / z + c).reshape(u.shape).astype(np.float32) for f, a, c in ((rig.fx, x, cx), (rig.fy, y, rig.cy))]
    return cv2.remap(image, *where, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@pytest.fixture
def pair_files(tmp_path, small_pair):
    """left.png, right.png, calib.yaml in a fresh folder."""
    left, right, rig = small_pair
    Image.fromarray(left).save(tmp_path / "left.png")
    Image.fromarray(right).save(tmp_path / "right.png")
    save_cameras(rig, tmp_path / "calib.yaml")
    return tmp_path


@pytest.fixture
def sequence(tmp_path, motorcycle, small_pair):
    """A folder left/ right/ calib.yaml with three pairs of a camera that turns by 3 px, a sixth of a degree, a frame."""
    for side in ("left", "right"):
        (tmp_path / "drive" / side).mkdir(parents=True)
        for k in range(3):
            seen = getattr(motorcycle, side)[200:400, 300 + 3 * k : 600 + 3 * k]
            Image.fromarray(seen).save(tmp_path / "drive" / side / f"{k:03d}.png")
    save_cameras(small_pair[2], tmp_path / "drive" / "calib.yaml")
    return tmp_path / "drive"
