from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tspslam.datasets import pair_from_map, read_map
from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.calibration import save_cameras

RIG = Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    Image.fromarray(np.random.default_rng(0).integers(0, 256, (10, 20, 3), np.uint8)).save(tmp_path / "left.png")
    save_cameras(RIG, tmp_path / "calib.yaml")
    return tmp_path


def files(folder: Path, name: str) -> tuple[Path, Path, Path]:
    return folder / "left.png", folder / name, folder / "calib.yaml"


def test_depths_and_disparities_in_any_file_give_the_same_pair(folder: Path) -> None:
    np.save(folder / "depth.npy", np.full((10, 20), 2.0, np.float32))
    Image.fromarray(np.full((10, 20), 2000, np.uint16)).save(folder / "depth.png")
    np.save(folder / "disparity.npy", np.full((10, 20), 2.5))
    Image.fromarray(np.full((10, 20), 640, np.uint16)).save(folder / "disparity.png")
    pairs = [
        pair_from_map(*files(folder, "depth.npy")),
        pair_from_map(*files(folder, "depth.png"), unit=0.001),
        pair_from_map(*files(folder, "disparity.npy"), kind="disparity"),
        pair_from_map(*files(folder, "disparity.png"), kind="disparity", unit=1 / 256),
    ]
    for pair in pairs:
        assert pair.rig == RIG
        assert pair.name == "left"
        np.testing.assert_allclose(pair.disparity, 2.5)


def test_zero_is_unknown_in_maps_of_whole_numbers(folder: Path) -> None:
    values = np.full((10, 20), 640, np.uint16)
    values[3] = 0
    Image.fromarray(values).save(folder / "map.png")
    for kind, unit in (("disparity", 1 / 256), ("depth", 0.001)):
        disparity = pair_from_map(*files(folder, "map.png"), kind=kind, unit=unit).disparity  # type: ignore[arg-type]
        assert disparity is not None
        assert np.flatnonzero(np.isnan(disparity).all(axis=1)).tolist() == [3]


@pytest.mark.parametrize(("values", "unit", "message"), [
    (np.full((10, 20), 2000, np.uint16), None, "map.npy: depth map is uint16 without a unit"),
    (np.full((10, 20), 2000.0), None, "median of 2000 m, expected metres"),
    (np.full((10, 21), 2.0), None, "map.npy: depth map is 21 x 10, expected 20 x 10 px"),
    (np.zeros((10, 20, 3)), None, r"float64 of shape \(10, 20, 3\); expected a map"),
    (np.zeros((10, 20), complex), None, "complex128 of shape"),
    (np.array([[None]]), None, "is no .npy file|holds object"),
])  # fmt: skip
def test_maps_that_cannot_be_used_are_named(folder: Path, values: np.ndarray, unit: float, message: str) -> None:
    np.save(folder / "map.npy", values, allow_pickle=True)
    with pytest.raises(InputError, match=message):
        pair_from_map(*files(folder, "map.npy"), unit=unit)


def test_a_disparity_map_of_whole_numbers_needs_a_unit(folder: Path) -> None:
    np.save(folder / "map.npy", np.ones((10, 20), np.uint16))
    for unit, said in ((None, "disparity map is uint16 without a unit"), (0.0, "unit is 0.0"), (np.nan, "unit is nan")):
        with pytest.raises(InputError, match=said):
            pair_from_map(*files(folder, "map.npy"), kind="disparity", unit=unit)


@pytest.mark.parametrize("content", [b"", b"\x93NUMPY\x01\x00", b"no map", b"\x93NUMPY\x09\x00" + b"\0" * 50])
def test_damaged_files_are_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "map.npy").write_bytes(content)
    with pytest.raises(InputError, match=r"map\.npy"):
        read_map(tmp_path / "map.npy")


def test_a_claim_of_gigabytes_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000, 1000000), }"
    padded = header + b" " * (117 - len(header)) + b"\n"
    (tmp_path / "map.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded)
    with pytest.raises(InputError, match=r"shape \(1000000, 1000000\)"):
        read_map(tmp_path / "map.npy")


def test_raw_cameras_have_no_map(folder: Path) -> None:
    text = (folder / "calib.yaml").read_text().replace("baseline: 0.1", "").replace("doffs: 0.0", "")
    eye = "[[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    lens = "{fx: 50, fy: 50, cx: 10, cy: 5}"
    (folder / "calib.yaml").write_text(text + f"left: {{}}\nright: {lens}\nT_right_left: {eye}\n")
    np.save(folder / "map.npy", np.ones((10, 20)))
    with pytest.raises(InputError, match="describes raw cameras"):
        pair_from_map(*files(folder, "map.npy"))
