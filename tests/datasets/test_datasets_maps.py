from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from PIL import Image

from tspslam.datasets import pair_from_map, read_map
from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.calibration.formats.own import save_cameras

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


def save(path: Path, values: np.ndarray) -> Path:
    """A map in the format of its suffix."""
    if path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".pfm":
        path.write_bytes(b"Pf\n20 10\n-1.0\n" + values[::-1].astype("<f4").tobytes())
    else:
        Image.fromarray(values).save(path)
    return path


@pytest.mark.parametrize("name", ["map.tif", "map.pfm", "map.npy"])
@pytest.mark.parametrize("kind", ["depth", "disparity"])
def test_maps_of_floats_are_read_without_a_unit(folder: Path, name: str, kind: Literal["depth", "disparity"]) -> None:
    values = np.linspace(1, 4, 200, dtype=np.float32).reshape(10, 20)
    values[2, 3] = np.inf
    pair = pair_from_map(*files(folder, save(folder / name, values).name), kind=kind)
    wanted = 5 / values.astype(float) if kind == "depth" else values.astype(float)
    wanted[2, 3] = np.nan
    assert pair.disparity is not None
    np.testing.assert_allclose(pair.disparity, wanted)
    assert pair.unknown == ()


def test_a_map_in_a_pgm_has_the_numbers_of_the_file(folder: Path) -> None:
    values = np.linspace(500, 9000, 200).astype(np.uint16).reshape(10, 20)
    for most in (9000, 65_535):
        (folder / "map.pgm").write_bytes(b"P5\n20 10\n%d\n" % most + values.astype(">u2").tobytes())
        np.testing.assert_array_equal(read_map(folder / "map.pgm"), values)


def test_a_map_of_signed_numbers_is_read_from_a_tiff(folder: Path) -> None:
    values = np.arange(-16, 184, dtype=np.int32).reshape(10, 20)
    Image.fromarray(values).save(folder / "map.tif")
    np.testing.assert_array_equal(read_map(folder / "map.tif"), values)


def varied(low: float, high: float, dtype: type = np.float32) -> np.ndarray:
    return np.linspace(low, high, 200).astype(dtype).reshape(10, 20)


def marked(values: np.ndarray, marker: float) -> np.ndarray:
    values = values.copy()
    values[4:6] = marker
    return values


MARKERS = {
    "OpenCV's, in sixteenths": ("disparity", marked(varied(16, 320, np.int16), -16), 1 / 16, (-16.0,)),
    "OpenCV's, in px": ("disparity", marked(varied(1, 20), -1.0), None, (-1.0,)),
    "OpenCV's, on a wall and a box": ("disparity", marked(np.full((10, 20), 320, np.int16), -16), 1 / 16, (-16.0,)),
    "OpenCV's, of disparities from 16 px": ("disparity", marked(varied(256, 320, np.int16), 240), 1 / 16, (240.0,)),
    "0 px in floats": ("disparity", marked(varied(1, 20), 0.0), None, (0.0,)),
    "the largest of 16 bits": ("depth", marked(varied(900, 4000, np.uint16), 65_535), 0.001, (65_535.0,)),
    "the largest of 16 bits, once": ("depth", np.where(varied(0, 1) == 1, 65_535, 1000).astype(np.uint16), 0.001,
                                     (65_535.0,)),
    "the largest of 8 bits": ("disparity", marked(varied(3, 19, np.uint8), 255), 1.0, (255.0,)),
    "nines": ("depth", marked(varied(0.9, 4), 9999.0), None, (9999.0,)),
    "the end of a sensor's reach": ("depth", marked(varied(0.9, 4), 4.0), None, (4.0,)),
}  # fmt: skip


@pytest.mark.parametrize("name", MARKERS)
def test_a_value_at_an_end_that_is_too_common_is_unknown_and_said(folder: Path, name: str) -> None:
    kind, values, unit, unknown = MARKERS[name]
    save_cameras(replace(RIG, doffs=20.0), folder / "calib.yaml")  # so that -1 px has a depth
    np.save(folder / "map.npy", values)
    pair = pair_from_map(*files(folder, "map.npy"), kind=kind, unit=unit)
    assert pair.unknown == unknown
    assert pair.disparity is not None
    np.testing.assert_array_equal(np.isnan(pair.disparity), np.isin(values, unknown))


SURFACE = {
    "true negative disparities": varied(-12, 20),
    "one of them at the end": marked(varied(-12, 20), -12.0)[:, :1].repeat(20, 1),
    "a wall": np.full((10, 20), -1.0, np.float32),
    "a wall and a box": marked(np.full((10, 20), 5.0, np.float32), 12.0),
    "whole px": np.rint(varied(1, 9)),
}


@pytest.mark.parametrize("name", SURFACE)
def test_what_is_not_too_common_is_surface(folder: Path, name: str) -> None:
    save_cameras(replace(RIG, doffs=20.0), folder / "calib.yaml")
    np.save(folder / "map.npy", SURFACE[name])
    pair = pair_from_map(*files(folder, "map.npy"), kind="disparity")
    assert pair.unknown == ()
    np.testing.assert_array_equal(pair.disparity, SURFACE[name])


@pytest.mark.parametrize(("unknown", "gone"), [(7.0, 7.0), (float("nan"), None)])
def test_the_unknown_value_that_is_given_is_the_only_one(folder: Path, unknown: float, gone: float | None) -> None:
    values = marked(varied(1, 20), 0.0)
    values[0, :3] = 7.0
    save_cameras(replace(RIG, doffs=20.0), folder / "calib.yaml")
    np.save(folder / "map.npy", values)
    pair = pair_from_map(*files(folder, "map.npy"), kind="disparity", unknown=unknown)
    assert pair.disparity is not None
    assert pair.unknown == ()
    np.testing.assert_array_equal(np.isnan(pair.disparity), values == gone)


def test_the_image_of_a_map_fills_its_range_too(folder: Path) -> None:
    stored = np.linspace(0, 4095, 200).astype(np.uint16).reshape(10, 20)
    Image.fromarray(stored).save(folder / "left.png")
    np.save(folder / "map.npy", varied(1, 4))
    for bits, scale in ((None, 16), (14, 4)):
        pair = pair_from_map(*files(folder, "map.npy"), bits=bits)
        assert pair.bits == (bits or 12)
        np.testing.assert_array_equal(pair.left, stored * scale)
