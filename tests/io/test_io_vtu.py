import base64
import contextlib
import re
import tracemalloc
import warnings
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam._files import unpacked_limit
from tspslam.errors import InputError, OutputError
from tspslam.io import read_ply, read_vtu, write_vtu
from tspslam.topology.complex import build_complex

FUZZ = settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
DISC = build_complex(np.array([[0, 1, 2], [0, 2, 3]]), 5, edges=np.array([[3, 4]]))
XYZ = np.random.default_rng(0).normal(size=(5, 3))


def grid(cells="", points="0 0 0 1 0 0 0 1 0", n=3, n_cells=1, head="", attributes="", point_data="", tail=""):
    """A small grid as text; `cells` replaces its one triangle."""
    cells = cells or (
        '<DataArray type="Int32" Name="connectivity" format="ascii">0 1 2</DataArray>'
        '<DataArray type="Int32" Name="offsets" format="ascii">3</DataArray>'
        '<DataArray type="UInt8" Name="types" format="ascii">5</DataArray>'
    )
    return (
        f'{head}<VTKFile type="UnstructuredGrid" version="1.0" {attributes}><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{n}" NumberOfCells="{n_cells}">'
        f'<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">{points}</DataArray></Points>'
        f"<Cells>{cells}</Cells><PointData>{point_data}</PointData>"
        f"</Piece></UnstructuredGrid>{tail}</VTKFile>"
    ).encode()


def saved(tmp_path, data, name="grid.vtu"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def sample(tmp_path):
    rng = np.random.default_rng(1)
    path = tmp_path / "sample.vtu"
    vertex = {"luminance": rng.normal(size=5), "colour": rng.integers(0, 256, (5, 3), np.uint8)}
    edge = {"mean": rng.normal(size=6), "ok": np.array([True, False] * 3)}
    face = {"mean": rng.normal(size=2), "area": np.array([3, 4], np.int64)}
    write_vtu(path, DISC, XYZ, vertex=vertex, edge=edge, face=face)
    return path, vertex, edge, face


def test_what_is_written_reads_back_exactly(tmp_path):
    path, vertex, edge, face = sample(tmp_path)
    back = read_vtu(path)
    np.testing.assert_array_equal(back.xyz, XYZ)
    np.testing.assert_array_equal(back.edges, DISC.edges)
    np.testing.assert_array_equal(back.faces, DISC.faces)
    for name, values in vertex.items():
        np.testing.assert_array_equal(back.point_data[name], values)
        assert back.point_data[name].dtype == values.dtype
    np.testing.assert_array_equal(back.cell_data["dim"], [1] * 6 + [2] * 2)
    np.testing.assert_array_equal(back.cell_data["mean"], [*edge["mean"], *face["mean"]])


def test_cells_of_the_level_that_is_not_given_are_zero(tmp_path):
    path, _, edge, _ = sample(tmp_path)
    back = read_vtu(path)
    np.testing.assert_array_equal(back.cell_data["ok"], [*edge["ok"], 0, 0])
    np.testing.assert_array_equal(back.cell_data["area"], [0] * 6 + [3, 4])


def test_same_complex_same_bytes(tmp_path):
    first = sample(tmp_path)[0].read_bytes()
    assert sample(tmp_path)[0].read_bytes() == first


@pytest.mark.parametrize("n", [0, 4])
def test_a_complex_without_edges_is_written_and_read(tmp_path, n):
    empty = build_complex(np.empty((0, 3), int), n)
    write_vtu(tmp_path / "a.vtu", empty, np.ones((n, 3)), vertex={"a": np.zeros(n)})
    back = read_vtu(tmp_path / "a.vtu")
    assert (back.xyz.shape, back.edges.shape, back.faces.shape) == ((n, 3), (0, 2), (0, 3))
    assert back.cell_data["dim"].shape == (0,)


def test_arrays_over_many_blocks_read_back_exactly(tmp_path):
    n = 9000
    xyz = np.random.default_rng(2).normal(size=(n, 3))
    strip = build_complex(np.arange(n - 2)[:, None] + np.arange(3), n)
    write_vtu(tmp_path / "a.vtu", strip, xyz)
    back = read_vtu(tmp_path / "a.vtu")
    np.testing.assert_array_equal(back.xyz, xyz)
    np.testing.assert_array_equal(back.faces, strip.faces)


def test_meshio_reads_what_is_written(tmp_path):
    meshio = pytest.importorskip("meshio")
    path, vertex, edge, face = sample(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mesh = meshio.read(path)
    np.testing.assert_array_equal(mesh.points, XYZ)
    np.testing.assert_array_equal(mesh.cells_dict["line"], DISC.edges)
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], DISC.faces)
    np.testing.assert_array_equal(mesh.point_data["colour"], vertex["colour"])
    np.testing.assert_array_equal(mesh.cell_data_dict["mean"]["line"], edge["mean"])
    np.testing.assert_array_equal(mesh.cell_data_dict["mean"]["triangle"], face["mean"])


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("compression", ["zlib", "lzma", None])
@pytest.mark.parametrize("header_type", ["UInt32", "UInt64"])
def test_what_meshio_writes_is_read(tmp_path, binary, compression, header_type):
    meshio = pytest.importorskip("meshio")
    # Triangles come first here: cell data must follow when lines are put before them.
    cells = [("triangle", DISC.faces), ("line", DISC.edges)]
    mesh = meshio.Mesh(XYZ, cells, {"a": XYZ[:, 0]}, {"b": [np.array([7.0, 8.0]), np.arange(6.0)]})
    meshio.vtu.write(tmp_path / "a.vtu", mesh, binary, compression, header_type)
    back = read_vtu(tmp_path / "a.vtu")
    np.testing.assert_allclose(back.xyz, XYZ, rtol=0 if binary else 1e-9)
    np.testing.assert_array_equal(back.faces, DISC.faces)
    np.testing.assert_array_equal(back.edges, DISC.edges)
    np.testing.assert_array_equal(back.cell_data["b"], [*range(6), 7, 8])


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("apart", [True, False])
def test_plain_base64_of_both_byte_orders_is_read_with_its_size_apart_or_not(tmp_path, order, apart):
    data = np.array([1.5, -2.0, 3.25], order + "f8").tobytes()
    size = np.array([24], order + "u4").tobytes()
    text = base64.b64encode(size) + base64.b64encode(data) if apart else base64.b64encode(size + data)
    array = f'<DataArray type="Float64" Name="a" format="binary">\n {text.decode()}\n</DataArray>'
    name = {"<": "LittleEndian", ">": "BigEndian"}[order]
    back = read_vtu(saved(tmp_path, grid(point_data=array, attributes=f'byte_order="{name}"')))
    np.testing.assert_array_equal(back.point_data["a"], [1.5, -2.0, 3.25])


@pytest.mark.parametrize("raw", [True, False])
@pytest.mark.parametrize("compressed", [True, False])
def test_appended_arrays_are_read(tmp_path, raw, compressed):
    values = np.array([1.5, -2.0, 3.25]).tobytes()
    packed = zlib.compress(values)
    if compressed:
        parts = [np.array([1, 24, 0, len(packed)], "<u4").tobytes(), packed]
    else:
        parts = [np.array([24], "<u4").tobytes() + values]
    stored = b"".join(part if raw else base64.b64encode(part) for part in parts)
    other = b"<&_>" if raw else b"AAAA"
    encoding = b"raw" if raw else b"base64"
    tail = b'<AppendedData encoding="%s">\n _%s%s\n</AppendedData></VTKFile>' % (encoding, other, stored)
    array = '<DataArray type="Float64" Name="a" format="appended" offset="4"/>'
    attributes = 'compressor="vtkZLibDataCompressor"' if compressed else ""
    data = grid(point_data=array, attributes=attributes).replace(b"</VTKFile>", tail)
    np.testing.assert_array_equal(read_vtu(saved(tmp_path, data)).point_data["a"], [1.5, -2.0, 3.25])


def bomb():
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10}">' for i in range(1, 10))
    return grid(head=f'<!DOCTYPE x [<!ENTITY e0 "ha">{entities}]>', points="&e9;")


CONNECTIVITY = '<DataArray type="Int32" Name="connectivity" format="ascii">{}</DataArray>'
OFFSETS = '<DataArray type="Int32" Name="offsets" format="ascii">{}</DataArray>'
TYPES = '<DataArray type="UInt8" Name="types" format="ascii">{}</DataArray>'
ARRAY = '<DataArray type="{}" Name="a" NumberOfComponents="{}" format="{}">{}</DataArray>'


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (bomb(), "document type"),
        (b"<a" * 5, "well-formed"),
        (b"<a/>", "is a a"),
        (b"<VTKFile type='PolyData'/>", "PolyData"),
        (b"<VTKFile type='UnstructuredGrid'/>", "0 pieces"),
        (grid(attributes='compressor="vtkLZ4DataCompressor"'), "LZ4DataCompressor"),
        (grid(attributes='byte_order="Middle"'), "byte order"),
        (grid(tail="<a/>" * 10_001), "elements"),
        (grid(n=-1), "NumberOfPoints"),
        (grid(n=10**18), "NumberOfPoints"),
        (grid(n=10**9), "rows"),
        (grid(n=4), "9 numbers where 12"),
        (grid(points="0 1 2").replace(b'NumberOfComponents="3"', b""), "no 3 points with 3 coordinates"),
        (grid(points="0 0 0 1 0 0 0 nan 0"), "vertex 2"),
        (grid(points="0 0 0 1 0 0 0 x 0"), "no number"),
        (grid(cells=CONNECTIVITY.format("0 1 2")), "without connectivity"),
        (grid(cells=CONNECTIVITY.format("0 1 3") + OFFSETS.format(3) + TYPES.format(5)), "outside 0 to 2"),
        (grid(cells=CONNECTIVITY.format("0 1 2") + OFFSETS.format(4) + TYPES.format(5)), "offsets"),
        (grid(cells=CONNECTIVITY.format("0 1 2") + OFFSETS.format(3) + TYPES.format(10)), "VTK type 10"),
        (grid(cells=CONNECTIVITY.format("0 1 2") + OFFSETS.format(3) + TYPES.format(300)), "no number of its type"),
        (grid(cells=(CONNECTIVITY + OFFSETS + TYPES).format("0 1 2", 3, 5).replace("Int32", "Float32")), "integers"),
        (grid(point_data=ARRAY.format("String", 1, "ascii", "1 2 3")), "String"),
        (grid(point_data=ARRAY.format("Int8", 0, "ascii", "1 2 3")), "components"),
        (grid(point_data=ARRAY.format("Int8", 1, "morse", "1 2 3")), "morse"),
        (grid(point_data=ARRAY.format("Int8", 1, "ascii", "1 2 3") * 2), "two arrays called a"),
        (grid(point_data=ARRAY.format("Int8", 1, "binary", "?")), "base64"),
        (grid(point_data=ARRAY.format("Int8", 1, "binary", "")), "truncated"),
        (grid(point_data=ARRAY.format("Int8", 1, "binary", "BAAAAAAAAA==")), "4 bytes where 3"),
        (grid(point_data=ARRAY.format("Int8", 60_000, "binary", "AAAA")), "can hold"),
        (grid(point_data='<DataArray type="Int8" Name="a" format="appended" offset="x"/>'), "offset"),
        (grid(tail='<AppendedData encoding="raw">nothing'), "appended section"),
        (grid(points="").replace(b'NumberOfPoints="3"', b'NumberOfPoints="0"'), "no 0 points|outside 0 to -1"),
    ],
)
def test_each_fault_is_named_in_one_line(tmp_path, data, said):
    path = saved(tmp_path, data)
    tracemalloc.start()
    with pytest.raises(InputError, match=said) as caught:
        read_vtu(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "\n" not in str(caught.value)
    assert most < 5e6  # what a file claims is not taken before it is checked


def compressed(header, blocks):
    text = base64.b64encode(np.array(header, "<u4").tobytes()) + base64.b64encode(b"".join(blocks))
    array = ARRAY.format("UInt8", 1, "binary", text.decode())
    return grid(point_data=array, attributes='compressor="vtkZLibDataCompressor"')


@pytest.mark.parametrize(
    ("header", "block", "said"),
    [
        ([1, 3, 0, 11], zlib.compress(b"abc"), None),
        ([1, 8, 3, 11], zlib.compress(b"abc"), None),
        ([4_000_000_000, 3, 0, 11], zlib.compress(b"abc"), "claims 4000000000 blocks"),
        ([1, 4_000_000_000, 0, 11], zlib.compress(b"abc"), "blocks of"),
        ([1, 3, 0, 4_000_000_000], zlib.compress(b"abc"), "truncated"),
        ([1, 3, 0, 11], zlib.compress(b"abcd"), "does not give 3 bytes|damaged"),
        ([1, 3, 0, 1000], zlib.compress(bytes(10**6)), "does not give 3 bytes"),
        ([1, 3, 0, 8], b"not zlib", "damaged block"),
        ([0, 0, 0], b"", "blocks of"),
    ],
)
def test_blocks_that_lie_about_their_size_are_refused(tmp_path, header, block, said):
    data = compressed(
        header, [block.ljust(header[3], b"\0")[:2000] if len(header) > 3 and header[3] == 1000 else block]
    )
    if said is None:
        assert read_vtu(saved(tmp_path, data)).point_data["a"].tobytes() == b"abc"
    else:
        with pytest.raises(InputError, match=said):
            read_vtu(saved(tmp_path, data))


def sharing(count, n=1_000_000):
    """A grid of `count` arrays that all point at one packed block of n zeros."""
    blocks = [np.array([1, size, 0, len(body)], "<u4").tobytes() + body for size in (n, 3 * n) for body in [zlib.compress(bytes(size), 9)]]  # fmt: skip
    array = '<DataArray type="UInt8" Name="a{}" format="appended" offset="0"/>'
    shared = "".join(array.format(i) for i in range(count))
    points = f'<DataArray type="UInt8" NumberOfComponents="3" format="appended" offset="{len(blocks[0])}"/>'
    head = (
        '<VTKFile type="UnstructuredGrid" compressor="vtkZLibDataCompressor"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{n}" NumberOfCells="0"><Points>{points}</Points><PointData>{shared}</PointData>'
        '</Piece></UnstructuredGrid><AppendedData encoding="raw">_'
    )
    return head.encode() + b"".join(blocks) + b"</AppendedData></VTKFile>"


def test_arrays_that_share_their_bytes_have_one_budget(tmp_path):
    data = sharing(200)
    limit = unpacked_limit(len(data))
    assert limit < 300e6
    with pytest.raises(InputError, match=rf"array a\d+ brings all arrays to \d+ bytes, where .* may take {limit}"):
        read_vtu(saved(tmp_path, data))
    assert len(read_vtu(saved(tmp_path, sharing(3))).point_data) == 3


def peak_of(read, path):
    """Bytes taken at most while a file is read, in multiples of its size."""
    tracemalloc.start()
    with contextlib.suppress(InputError):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / path.stat().st_size


def test_text_takes_no_object_for_each_of_its_words(tmp_path):
    n = 200_000
    path = saved(tmp_path, grid(points="10 " * 3 * n, n=n))
    assert peak_of(read_vtu, path) < 16  # 27 for a list of the words
    body = "ply\nformat ascii 1.0\nelement vertex {}\nproperty char x\nproperty char y\nproperty char z\nend_header\n"
    path = saved(tmp_path, (body.format(n) + "10 10 10\n" * n).encode(), "a.ply")
    assert peak_of(read_ply, path) < 16
    assert len(read_ply(path).xyz) == n


def test_attributes_are_counted(tmp_path):
    many = " ".join(f'a{i}=""' for i in range(200_001))
    with pytest.raises(InputError, match="more than 200000 attributes"):
        read_vtu(saved(tmp_path, grid(attributes=many)))


@pytest.mark.parametrize(
    ("signals", "said"),
    [
        ({"vertex": {"a": np.zeros(4)}}, r"\(5,\)"),
        ({"vertex": {"a": np.zeros((5, 1, 1))}}, "shape"),
        ({"vertex": {"a": np.zeros((5, 0))}}, "shape"),
        ({"vertex": {"a": np.full(5, np.nan)}}, "finite"),
        ({"vertex": {"a": np.zeros(5, complex)}}, "complex128"),
        ({"vertex": {"a": ["x"] * 5}}, "dtype"),
        ({"vertex": {"": np.zeros(5)}}, "printable"),
        ({"vertex": {"a\0": np.zeros(5)}}, "printable"),
        ({"edge": {"dim": np.zeros(6)}}, "dim"),
        ({"face": {"dim": np.zeros(2)}}, "dim"),
        ({"edge": {"a": np.zeros(6)}, "face": {"a": np.zeros((2, 3))}}, "channels"),
    ],
)
def test_a_signal_that_does_not_fit_is_refused(tmp_path, signals, said):
    with pytest.raises(InputError, match=said):
        write_vtu(tmp_path / "a.vtu", DISC, XYZ, **signals)
    assert not (tmp_path / "a.vtu").exists()


@pytest.mark.parametrize("xyz", [XYZ[:4], XYZ[:, :2], np.full((5, 3), np.inf)])
def test_positions_that_do_not_fit_are_refused(tmp_path, xyz):
    with pytest.raises(InputError, match="xyz"):
        write_vtu(tmp_path / "a.vtu", DISC, xyz)


def test_names_are_escaped(tmp_path):
    name = """a <b> & "c" 'd' é"""
    write_vtu(tmp_path / "a.vtu", DISC, XYZ, vertex={name: np.arange(5)})
    assert read_vtu(tmp_path / "a.vtu").point_data[name].tolist() == [0, 1, 2, 3, 4]


def test_a_place_below_a_file_is_an_output_error(tmp_path):
    saved(tmp_path, b"", "file")
    with pytest.raises(OutputError):
        write_vtu(tmp_path / "file" / "a.vtu", DISC, XYZ)


def test_every_truncation_is_seen(tmp_path):
    data = sample(tmp_path)[0].read_bytes().rstrip()
    for size in range(1, len(data), 7):
        with pytest.raises(InputError):
            read_vtu(saved(tmp_path, data[:size]))


NUMBER = re.compile(rb"\d+")


@FUZZ
@given(data=st.data())
def test_a_damaged_grid_is_a_grid_or_an_input_error(tmp_path, data):
    source = sample(tmp_path)[0].read_bytes() if data.draw(st.booleans()) else grid()
    damaged = bytearray(source)
    if data.draw(st.booleans()):
        number = data.draw(st.sampled_from(list(NUMBER.finditer(source))))
        value = data.draw(st.sampled_from([b"0", b"-1", b"99", b"4294967295", b"18446744073709551615", b"1e3", b"nan"]))
        damaged[number.start() : number.end()] = value
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    said = ""
    try:
        back = read_vtu(saved(tmp_path, bytes(damaged)))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    if not said:
        assert np.isfinite(back.xyz).all()
        for corners in (back.edges, back.faces):
            assert corners.size == 0 or 0 <= corners.min() <= corners.max() < len(back.xyz)
        assert all(len(values) == len(back.xyz) for values in back.point_data.values())
        assert all(len(values) == len(back.edges) + len(back.faces) for values in back.cell_data.values())
