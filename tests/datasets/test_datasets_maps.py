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


def npy(header: bytes, data: bytes = b"", version: int = 1) -> bytes:
    """A .npy file of that header."""
    size = len(header).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + size + header + data


PLAIN = b"{'descr': '<f4', 'fortran_order': False, 'shape': (2, 3), }\n"


@pytest.mark.parametrize(("content", "message"), [
    (npy(b"[" * 9000), "no plain type, order and shape"),
    (npy(b"{'descr': " + b"(" * 9000), "no plain type"),
    (npy(PLAIN.replace(b"(2, 3)", b"(" * 4000 + b"2, 3" + b")" * 4000)), "no plain type"),
    (npy(PLAIN.replace(b"(2, 3)", b"(" + b"9" * 5000 + b",)")), "no plain type"),
    (npy(PLAIN.replace(b"(2, 3)", b"(9999999999, 9999999999)"), bytes(24)), r"float32 of shape \(9999999999, 9999999999\)"),
    (npy(PLAIN.replace(b"(2, 3)", b"(" + b"2, " * 30 + b")"), bytes(24)), "float32 of shape"),
    (npy(PLAIN.replace(b"(2, 3)", b"(-2, 3)"), bytes(24)), "no plain type"),
    (npy(PLAIN.replace(b"(2, 3)", b"(True, 3)"), bytes(24)), "no plain type"),
    (npy(PLAIN.replace(b"'<f4'", b"'|O'"), b"cos\nsystem\n(S'true'\ntR."), "holds object of shape"),
    (npy(PLAIN.replace(b"'<f4'", b"[('x', '<f4'), ('y', '<f4')]"), bytes(48)), "no plain type"),
    (npy(PLAIN.replace(b"'<f4'", b"'<f3'"), bytes(48)), "unknown type '<f3'"),
    (npy(PLAIN.replace(b"'<f4'", b"'|S0'"), bytes(48)), r"holds \|S0 of shape"),
    (npy(PLAIN.replace(b"'<f4'", b"'<M8'"), bytes(48)), "holds datetime64 of shape"),
    (npy(PLAIN, bytes(23)), r"float32 of shape \(2, 3\) in 23 bytes"),
    (npy(PLAIN, bytes(24), 4), "version 1, 2 or 3"),
    (npy(PLAIN, bytes(24), 2)[:8] + b"\xff\xff\xff\xff" + PLAIN, "header of 4294967295 bytes"),
    (npy(b"\x1b[2J" * 100), "no plain type"),
])  # fmt: skip
def test_each_trick_of_a_header_is_one_line(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "map.npy").write_bytes(content)
    with pytest.raises(InputError, match=message) as caught:
        read_map(tmp_path / "map.npy")
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("version", [1, 2, 3])
@pytest.mark.parametrize("code", ["<f4", ">f8", "|u1", "<i2", "<f2"])
def test_every_version_order_and_type_of_numbers_is_read(tmp_path: Path, version: int, code: str) -> None:
    values = np.arange(6).reshape(2, 3)
    for number, array in enumerate((values.astype(code), np.asfortranarray(values.astype(code)))):
        path = tmp_path / f"{number}.npy"
        with path.open("wb") as handle:
            np.lib.format.write_array(handle, array, version=(version, 0))
        found = read_map(path)
        np.testing.assert_array_equal(found, values)
        assert found.dtype == np.dtype(code).newbyteorder("=")
    other = npy(b"{'shape': (2L, 3L), 'fortran_order': False, 'descr': '<f4'}", np.zeros(6, "<f4").tobytes(), version)
    (tmp_path / "old.npy").write_bytes(other)
    assert read_map(tmp_path / "old.npy").shape == (2, 3)


def test_raw_cameras_have_no_map(folder: Path) -> None:
    text = (folder / "calib.yaml").read_text().replace("baseline: 0.1", "").replace("doffs: 0.0", "")
    eye = "[[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    lens = "{fx: 50, fy: 50, cx: 10, cy: 5}"
    (folder / "calib.yaml").write_text(text + f"left: {{}}\nright: {lens}\nT_right_left: {eye}\n")
    np.save(folder / "map.npy", np.ones((10, 20)))
    with pytest.raises(InputError, match="describes raw cameras"):
        pair_from_map(*files(folder, "map.npy"))
