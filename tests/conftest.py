"""Shared by the tests: the real pair, and a small real pair on disk."""

import numpy as np
import pytest
from PIL import Image

from tspslam import datasets
from tspslam.vision.rig import save_cameras


@pytest.fixture(scope="session")
def motorcycle():
    return datasets.motorcycle()


@pytest.fixture(scope="session")
def small_pair(motorcycle):
    """A piece of the Motorcycle pair, 300x200 px, with its rig: (left, right, rig)."""
    from dataclasses import replace

    rows, columns = slice(200, 400), slice(300, 600)
    rig = replace(motorcycle.rig, cx=motorcycle.rig.cx - 300, cy=motorcycle.rig.cy - 200, width=300, height=200)
    return (
        np.ascontiguousarray(motorcycle.left[rows, columns]),
        np.ascontiguousarray(motorcycle.right[rows, columns]),
        rig,
    )


@pytest.fixture
def pair_files(tmp_path, small_pair):
    """left.png, right.png, calib.yaml in a fresh folder."""
    left, right, rig = small_pair
    Image.fromarray(left).save(tmp_path / "left.png")
    Image.fromarray(right).save(tmp_path / "right.png")
    save_cameras(rig, tmp_path / "calib.yaml")
    return tmp_path


@pytest.fixture
def sequence(tmp_path, small_pair):
    """A folder left/ right/ calib.yaml with three pairs."""
    left, right, rig = small_pair
    for side, image in (("left", left), ("right", right)):
        (tmp_path / "drive" / side).mkdir(parents=True)
        for k in range(3):
            Image.fromarray(np.roll(image, 0)).save(tmp_path / "drive" / side / f"{k:03d}.png")
    save_cameras(rig, tmp_path / "drive" / "calib.yaml")
    return tmp_path / "drive"
