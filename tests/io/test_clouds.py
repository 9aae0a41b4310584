"""Scans from files: what was written comes back; damaged files are refused in a line."""

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam import InputError
from tspslam.io._lzf import unpack
from tspslam.io.clouds import read_scan
from tspslam.io.las import write_las
from tspslam.io.ply import write_ply

DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
RNG = np.random.default_rng(5)
XYZ = RNG.uniform(-40, 40, (50, 3)).astype(np.float32)
STRENGTH = RNG.uniform(0, 1, 50).astype(np.float32)
RING = RNG.integers(0, 16, 50)
FIELDS = {"x": "f4", "y": "f4", "z": "f4", "intensity": "f4", "ring": "u2"}
COLUMNS = dict(zip(FIELDS, (*XYZ.T, STRENGTH, RING), strict=True))


def header(data, fields=FIELDS, points=50):
    lines = {
        "VERSION": "0.7",
        "FIELDS": " ".join(fields),
        "SIZE": " ".join(code[1] for code in fields.values()),
        "TYPE": " ".join(code[0].upper() for code in fields.values()),
        "COUNT": " ".join("1" for _ in fields),
        "WIDTH": points,
        "HEIGHT": 1,
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": points,
        "DATA": data,
    }
    return ("# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in lines.items())).encode()


def pack(data):
    """LZF without any copy: true LZF, though it saves nothing."""
    return b"".join(bytes([len(part) - 1]) + part for part in (data[k : k + 32] for k in range(0, len(data), 32)))


def pcd(data, fields=FIELDS, columns=COLUMNS):
    if data == "ascii":
        rows = zip(*(columns[name] for name in fields), strict=True)
        return header(data, fields) + "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    if data == "binary":
        table = np.zeros(50, [(name, f"<{code}") for name, code in fields.items()])
        for name in fields:
            table[name] = columns[name]
        return header(data, fields) + table.tobytes()
    body = b"".join(columns[name].astype(f"<{code}").tobytes() for name, code in fields.items())
    packed = pack(body)
    return header(data, fields) + struct.pack("<II", len(packed), len(body)) + packed


def write_npy(path):
    np.save(path, np.column_stack([XYZ, STRENGTH]))


def write_cloud_ply(path):
    write_ply(path, XYZ, np.empty((0, 3), int), vertex={"intensity": STRENGTH, "ring": RING.astype(np.uint16)})


WRITERS = {
    "a.bin": lambda path: np.column_stack([XYZ, STRENGTH]).tofile(path),
    "a.pcd.bin": lambda path: np.column_stack([XYZ, STRENGTH, RING]).astype(np.float32).tofile(path),
    "ascii.pcd": lambda path: path.write_bytes(pcd("ascii")),
    "binary.pcd": lambda path: path.write_bytes(pcd("binary")),
    "packed.PCD": lambda path: path.write_bytes(pcd("binary_compressed")),
    "a.ply": write_cloud_ply,
    "a.npy": write_npy,
    "a.txt": lambda path: np.savetxt(path, np.column_stack([XYZ, STRENGTH]), fmt="%.9g"),
    "a.csv": lambda path: np.savetxt(path, np.column_stack([XYZ, STRENGTH]), fmt="%.9g", delimiter=","),
    "a.xyz": lambda path: np.savetxt(path, XYZ, fmt="%.9g", header="x y z"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_what_was_written_comes_back(tmp_path, name):
    WRITERS[name](tmp_path / name)
    scan = read_scan(tmp_path / name)
    np.testing.assert_array_equal(scan.xyz.astype(np.float32), XYZ)
    assert (scan.intensity is None) == (name == "a.xyz")
    if scan.intensity is not None:
        np.testing.assert_allclose(scan.intensity, STRENGTH, rtol=1e-6)
    has_ring = name.endswith((".pcd", ".PCD", ".pcd.bin", ".ply"))
    assert (scan.ring is not None) == has_ring
    if has_ring:
        np.testing.assert_array_equal(scan.ring, RING)
    assert (len(scan), scan.dropped) == (50, 0)


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
def test_las_comes_back_to_half_a_step(tmp_path, name):
    pytest.importorskip("lazrs")
    step = write_las(tmp_path / name, XYZ.astype(np.float64), STRENGTH.astype(np.float64))
    scan = read_scan(tmp_path / name)
    x, y, z = scan.xyz.T
    np.testing.assert_allclose(np.column_stack([x, -z, y]), XYZ, atol=0.51 * step)  # as write_las turns it
    np.testing.assert_allclose(scan.intensity, STRENGTH, atol=1e-5)


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_fields_stand_in_any_order_and_type(tmp_path, data):
    fields = {"label": "u4", "z": "f8", "x": "f8", "ring": "u1", "y": "f4"}
    columns = COLUMNS | {"label": np.arange(50)}
    (tmp_path / "a.pcd").write_bytes(pcd(data, fields, columns))
    scan = read_scan(tmp_path / "a.pcd")
    np.testing.assert_array_equal(scan.xyz.astype(np.float32), XYZ)
    np.testing.assert_array_equal(scan.ring, RING)


def test_rows_that_are_no_place_are_dropped_and_counted(tmp_path):
    rows = np.column_stack([XYZ, STRENGTH])
    rows[3, :3], rows[7, 0], rows[9, 2] = 0, np.nan, np.inf
    rows.tofile(tmp_path / "a.bin")
    scan = read_scan(tmp_path / "a.bin")
    np.testing.assert_array_equal(scan.xyz, np.delete(XYZ, [3, 7, 9], axis=0))
    assert (scan.dropped, len(scan.intensity)) == (3, 47)


def test_packed_bytes_may_copy_what_was_copied_just_now():
    out = np.empty(13, np.uint8)
    assert unpack(np.frombuffer(b"\x00a\xe0\x03\x00", np.uint8), out)  # a, then 12 bytes from one back
    assert out.tobytes() == b"a" * 13


@pytest.mark.parametrize(
    "packed", [b"\x05a", b"\x00a\x20", b"\x00a\xe0", b"\x00a\xe0\x03", b"\x00a\x20\x05", b"\x00a", b"\x00a\xe0\xff\x00"]
)
def test_damaged_packing_is_told(packed):
    assert not unpack(np.frombuffer(packed, np.uint8), np.empty(13, np.uint8))


PLAIN = pcd("binary")
BROKEN = {
    "suffix.obj": (b"v 0 0 1", "has the suffix '.obj'"),
    "odd.bin": (b"\0" * 20, "has 20 bytes, which are no rows of 4 float32"),
    "zeros.bin": (b"\0" * 32, "has no point that is a place among its 2 rows"),
    "far.bin": (np.float32([1e12, 0, 0, 0]).tobytes(), "has point 0 at"),
    "strength.bin": (np.float32([1, 0, 0, np.nan]).tobytes(), "has point 0 with a reflectance that is not finite"),
    "ring.pcd.bin": (np.float32([1, 0, 0, 0, 1.5]).tobytes(), "has the ring 1.5"),
    "words.txt": (b"1 2 3\n1 2 x\n", "line 2 holds a word that is no number"),
    "ragged.txt": (b"1 2 3\n1 2 3 4\n", "line 2 has 4 values"),
    "blank.txt": (b"# nothing\n", "has no line of values"),
    "two.txt": (b"1 2\n", "line 1 has 2 values"),
    "short.pcd": (PLAIN[:-1], "bytes of data, where 50 points of 18 bytes go"),
    "nodata.pcd": (b"FIELDS x y z\n", "has no PCD header with a line DATA"),
    "key.pcd": (b"COLOUR red\n" + PLAIN, "has the header line 'COLOUR red'"),
    "twice.pcd": (b"WIDTH 5\n" + PLAIN, "has the header line 'WIDTH 50'"),
    "lacks.pcd": (b"FIELDS x y z\nDATA ascii\n1 2 3", "has a header without SIZE, TYPE, WIDTH, HEIGHT"),
    "kind.pcd": (PLAIN.replace(b"DATA binary", b"DATA blobs"), "has the data 'blobs', where one of ascii"),
    "count.pcd": (PLAIN.replace(b"POINTS 50", b"POINTS 51"), "claims 51 points of 50 x 1"),
    "width.pcd": (PLAIN.replace(b"WIDTH 50", b"WIDTH -1"), "has the header line 'WIDTH -1'"),
    "sizes.pcd": (PLAIN.replace(b"SIZE 4", b"SIZE 4 4"), "has 5 FIELDS, 6 SIZE"),
    "types.pcd": (PLAIN.replace(b"TYPE F", b"TYPE Q"), "has the field x of type Q"),
    "values.pcd": (PLAIN.replace(b"COUNT 1", b"COUNT 0"), "has 0 values in the field x"),
    "names.pcd": (PLAIN.replace(b"FIELDS x y", b"FIELDS x x"), "has two fields of one name"),
    "noz.pcd": (PLAIN.replace(b"FIELDS x y z", b"FIELDS x y q"), "has no points with x, y and z"),
    "huge.pcd": (PLAIN.replace(b"50", b"4000000000"), "bytes of data, where 4000000000 points"),
    "text.pcd": (pcd("ascii").replace(b"WIDTH 50", b"WIDTH 49").replace(b"POINTS 50", b"POINTS 49"), "has 250 numbers"),
    "word.pcd": (pcd("ascii")[:-3] + b" x\n", "has a word in its data that is no number"),
    "many.pcd": (pcd("ascii").replace(b" 50\n", b" 999999999\n"), "more than the file can hold"),
    "bomb.pcd": (pcd("binary_compressed").replace(b" 50\n", b" 999999999\n"), "bytes that become"),
    "cut.pcd": (header("binary_compressed") + b"\0\0", "ends before the sizes"),
    "lzf.pcd": (pcd("binary_compressed")[:-40] + b"\xff" * 40, "has compressed data that are damaged"),
    "a.las": (b"LASF" + b"\0" * 300, "is LAS 0.0"),
    "b.las": (b"LASF", "has no LAS header"),
    "a.npy": (b"\x93NUMPY", "no .npy file"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_damaged_files_are_refused_in_one_line(tmp_path, name):
    data, said = BROKEN[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_scan(tmp_path / name)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_las_headers_are_held_against_the_file(tmp_path):
    pytest.importorskip("lazrs")
    for name in ("a.las", "a.laz"):
        write_las(tmp_path / name, XYZ.astype(np.float64), STRENGTH.astype(np.float64))
        data = bytearray((tmp_path / name).read_bytes())
        for at, layout, value, said in (
            (247, "<Q", 1 << 40, "claims 1099511627776 points"),
            (105, "<H", 3, "has points of format"),
            (104, "<B", 63, "has points of format 63"),
            (131, "<d", float("nan"), "scale or an offset that is not finite"),
        ):
            broken = data.copy()
            struct.pack_into(layout, broken, at, value)
            (tmp_path / name).write_bytes(broken)
            with pytest.raises(InputError, match=said):
                read_scan(tmp_path / name)


def test_las_records_and_offsets_are_held_against_the_file(tmp_path):
    pytest.importorskip("lazrs")
    for name in ("a.las", "a.laz"):
        write_las(tmp_path / name, XYZ.astype(np.float64), STRENGTH.astype(np.float64))
        data = bytearray((tmp_path / name).read_bytes())
        for at, layout, value, said in (
            (100, "<I", (1 << 32) - 1, "claims 4294967295 records before its points"),
            (235, "<QI", (len(data), 1 << 31), "claims 2147483648 records from byte"),
            (235, "<QI", (1 << 62, 1), "claims 1 records from byte"),
            (96, "<I", 300, "has a header of 375 bytes and points from byte 300"),
            (94, "<H", 20, "has a header of 20 bytes"),
        ):
            broken = data.copy()
            struct.pack_into(layout, broken, at, *np.atleast_1d(value).tolist())
            (tmp_path / name).write_bytes(broken)
            with pytest.raises(InputError, match=said):
                read_scan(tmp_path / name)


def test_packed_columns_that_become_far_more_than_their_file_are_refused(tmp_path):
    """Bytes that LZF packs 88 : 1, each a number of eight bytes once it is read."""
    points, names = 40_000_000, ("x", "y")
    packed = bytes(1 << 20)
    head = header("binary_compressed", dict.fromkeys(names, "u1"), points)
    (tmp_path / "a.pcd").write_bytes(head + struct.pack("<II", len(packed), 2 * points) + packed)
    with pytest.raises(InputError, match="brings all arrays to 720000000 bytes"):
        read_scan(tmp_path / "a.pcd")


SAMPLES = {name: write for name, write in WRITERS.items() if not name.endswith("csv")}


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans")
    for name, write in SAMPLES.items():
        write(folder / name)
    names = list(SAMPLES)
    try:
        for name in ("a.las", "a.laz"):
            write_las(folder / name, XYZ.astype(np.float64), STRENGTH.astype(np.float64))
            names.append(name)
    except InputError:
        pass
    return [(name, (folder / name).read_bytes()) for name in names]


@settings(max_examples=300, deadline=None)
@given(data=st.data())
def test_any_bytes_are_a_scan_or_an_input_error(samples, tmp_path_factory, data):
    name, content = data.draw(st.sampled_from(samples))
    broken = bytearray(content)
    for _ in range(data.draw(st.integers(0, 4))):
        broken[data.draw(st.integers(0, min(len(broken) - 1, 400)))] = data.draw(st.integers(0, 255))
    broken = broken[: data.draw(st.integers(0, len(broken)))] if data.draw(st.booleans()) else broken
    path = tmp_path_factory.getbasetemp() / f"fuzz-{name}"
    path.write_bytes(broken)
    try:
        scan = read_scan(path)
    except InputError:
        return
    assert len(scan)
    assert np.isfinite(scan.xyz).all()


def test_real_scans():
    folder, room = DATA / "kitti_raw_0926/velodyne", DATA / "labelled_room/room1_gt_fine.pcd"
    if not (folder.is_dir() and room.is_file()):
        pytest.skip("kitti_raw_0926 and labelled_room are not in the data folder (TSPSLAM_DATA)")
    assert len(read_scan(folder / "0000000203.txt")) == 118649
    assert len(read_scan(room)) == 237907
