import re
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError, OutputError
from tspslam.io import read_mesh, read_ply, write_ply
from tspslam.io.ply import read_faces

FUZZ = settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
XYZ = np.random.default_rng(0).normal(size=(5, 3))
FACES = np.array([[0, 2, 1], [0, 2, 3], [3, 1, 4]])
VERTEX = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\n"
POINTS = "0 0 0\n1 0 0\n0 1 0\n"


def text(header=VERTEX + FACE, body=POINTS + "3 0 1 2\n", form="ascii 1.0"):
    return f"ply\nformat {form}\ncomment a test\n{header}end_header\n{body}".encode("latin-1")


def saved(tmp_path, data, name="mesh.ply"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def sample(tmp_path):
    path = tmp_path / "sample.ply"
    rng = np.random.default_rng(1)
    vertex = {name: rng.integers(0, 256, 5, np.uint8) for name in ("red", "green", "blue")}
    vertex |= {"luminance": rng.normal(size=5), "scale": np.ones(5, np.float32), "ok": np.array([True] * 4 + [False])}
    face = {"mean": rng.normal(size=3), "label": np.arange(3), "length": np.arange(3, dtype=np.uint16)}
    write_ply(path, XYZ, FACES, vertex=vertex, face=face, edges=[[0, 1], [1, 2]])
    return path, vertex, face


def test_what_is_written_reads_back_exactly(tmp_path):
    path, vertex, face = sample(tmp_path)
    back = read_ply(path)
    np.testing.assert_array_equal(back.xyz, XYZ)
    np.testing.assert_array_equal(back.faces, FACES)
    assert back.faces.dtype == np.int32
    assert list(back.vertex) == list(vertex)
    assert list(back.face) == list(face)
    for name, values in (vertex | face).items():
        np.testing.assert_array_equal((back.vertex | back.face)[name], values)
    assert back.vertex["red"].dtype == np.uint8
    assert back.vertex["luminance"].dtype == np.float64


def test_same_mesh_same_bytes(tmp_path):
    first = sample(tmp_path)[0].read_bytes()
    assert sample(tmp_path)[0].read_bytes() == first


@pytest.mark.parametrize("n", [0, 3])
def test_a_cloud_without_faces_is_written_and_read(tmp_path, n):
    write_ply(tmp_path / "a.ply", np.ones((n, 3)), np.empty((0, 3), int))
    back = read_ply(tmp_path / "a.ply")
    assert (back.xyz.shape, back.faces.shape) == ((n, 3), (0, 3))


def test_trimesh_reads_what_is_written(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    path, vertex, _ = sample(tmp_path)
    mesh = trimesh.load(path, process=False)
    np.testing.assert_array_equal(mesh.vertices, XYZ)
    np.testing.assert_array_equal(mesh.faces, FACES)
    np.testing.assert_array_equal(mesh.visual.vertex_colors[:, 0], vertex["red"])


def test_meshio_reads_what_is_written(tmp_path):
    meshio = pytest.importorskip("meshio")
    write_ply(tmp_path / "a.ply", XYZ, FACES, vertex={"quality": XYZ[:, 0]})
    mesh = meshio.read(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.points, XYZ)
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], FACES)
    np.testing.assert_array_equal(mesh.point_data["quality"], XYZ[:, 0])


@pytest.mark.parametrize("binary", [True, False])
def test_what_meshio_and_trimesh_write_is_read(tmp_path, binary):
    meshio, trimesh = pytest.importorskip("meshio"), pytest.importorskip("trimesh")
    meshio.ply.write(tmp_path / "a.ply", meshio.Mesh(XYZ, [("triangle", FACES.astype(np.int32))]), binary=binary)
    encoding = "binary" if binary else "ascii"
    trimesh.Trimesh(XYZ, FACES, process=False).export(tmp_path / "b.ply", encoding=encoding)
    for name in ("a.ply", "b.ply"):
        back = read_ply(tmp_path / name)
        np.testing.assert_allclose(back.xyz, XYZ, atol=1e-6)
        np.testing.assert_array_equal(back.faces, FACES)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("lists", [False, True])
def test_every_form_gives_the_same_mesh_and_other_lists_are_skipped(tmp_path, form, lists):
    more = "property list ushort float texcoord\nproperty short label\n" if lists else "property short label\n"
    track = "element track 2\nproperty list uchar float seen\nelement nothing 9\n"
    header = VERTEX + track + FACE.replace("int", "uint", 1).replace("uint vertex", "int vertex") + more
    coordinates = [0, 0, 0, 1, 0, 0, 0, 1, 0]
    if form == "ascii":
        body = f"{POINTS}2 0.5 0.5\n0\n3 2 1 0 {'2 0.5 0.5' if lists else ''} -7\n".encode()
    else:
        order = "<" if form == "binary_little_endian" else ">"
        body = struct.pack(f"{order}9f B2f B", *coordinates, 2, 0.5, 0.5, 0) + struct.pack(f"{order}B3i", 3, 2, 1, 0)
        body += (struct.pack(f"{order}H2f", 2, 0.5, 0.5) if lists else b"") + struct.pack(f"{order}h", -7)
    back = read_ply(saved(tmp_path, text(header, "", f"{form} 1.0") + body))
    np.testing.assert_array_equal(back.xyz.ravel(), coordinates)
    assert back.faces.tolist() == [[2, 1, 0]]
    assert {name: values.tolist() for name, values in back.face.items()} == {"label": [-7]}


def test_windows_line_ends_and_lists_on_vertices_are_read(tmp_path):
    header = VERTEX.replace("z\n", "z\nproperty list uchar int seen\n") + "obj_info x\n" + FACE
    data = text(header, "0 0 0 1 9\n1 0 0 0\n0 1 0 2 8 9\n3 0 1 2\n").replace(b"\n", b"\r\n")
    back = read_ply(saved(tmp_path, data))
    assert back.faces.tolist() == [[0, 1, 2]]
    assert back.vertex == {}


BINARY = "binary_little_endian 1.0"
TRIANGLE = struct.pack("<9fB3i", *[0, 0, 0, 1, 0, 0, 0, 1, 0], 3, 0, 1, 2).decode("latin-1")
QUAD = struct.pack("<9fB4i", *[0, 0, 0, 1, 0, 0, 0, 1, 0], 4, 0, 1, 2, 0).decode("latin-1")
TWO_FACES = VERTEX + FACE.replace("face 1", "face 2")
LISTS = VERTEX + FACE + "property list char float more\n"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "empty"),
        (b"plywood", "no PLY header"),
        (b"ply\n" + b"comment\n" * 10_000 + b"end_header\n", "header of at most"),
        (b"ply\nend_header\n", "format line"),
        (text(form="ascii 2.0"), "format"),
        (text(form="morse 1.0"), "morse"),
        (text("property float x\n"), "header line"),
        (text("nonsense\n"), "nonsense"),
        (text("element vertex\n"), "header line"),
        (text("element vertex -1\n"), "header line"),
        (text("element vertex ²\n"), "header line"),
        (text("element vertex 1\nelement vertex 1\n"), "two elements"),
        (text(VERTEX + "property float x\n"), "two properties"),
        (text(VERTEX + "property float\n"), "header line"),
        (text(VERTEX + "property quad w\n"), "unknown type 'quad'"),
        (text(VERTEX + "property list float int a\n"), "no integer"),
        (text("element vertex 1\nproperty float x\n", "1"), "no vertices with x, y and z"),
        (text("", ""), "no vertices"),
        (text(VERTEX + "element face 1\nproperty int label\n", POINTS + "1"), "without vertex_indices"),
        (text(VERTEX.replace("3", "999999999999"), POINTS), "claims 999999999999"),
        (text(VERTEX, "0 0 0 1 0 0 0 1"), "ends within its 3 rows"),
        (text(body="0 0 0 1 0 0 0 nan 0 3 0 1 2"), "vertex 2"),
        (text(body="0 0 0 1 0 0 0 1e999 0 3 0 1 2"), "vertex 2"),
        (text(body="0 0 0 1 0 0 0 x 0 3 0 1 2"), "no number"),
        (text(body=POINTS + "3 0 1 3"), "face 0 has corners .0, 1, 3."),
        (text(body=POINTS + "3 0 1 -1"), "face 0 has corners"),
        (text(body=POINTS + "3 0 1 1.5"), "integer type"),
        (text(body=POINTS + "4 0 1 2 0"), "face 0 has a vertex twice"),
        (text(TWO_FACES, POINTS + "3 0 1 2 4 0 1 2 0"), "face 1 has a vertex twice"),
        (text(TWO_FACES, POINTS + "3 0 1 2 3 0"), "ends within face 1"),
        (text(LISTS, POINTS + "4 0 1 2 0 0"), "face 0 has a vertex twice"),
        (text(body=POINTS + "2 0 1"), "face 0 has 2 corners"),
        (text(LISTS, POINTS + "3 0 1 2 -1"), "list more of -1"),
        (text(LISTS, POINTS + "3 0 1 2 9 1"), "ends within face 0"),
        (text(VERTEX + FACE.replace("int v", "float v")), "no integers"),
        (text(body=QUAD, form=BINARY), "face 0 has a vertex twice"),
        (text(TWO_FACES, TRIANGLE + QUAD[36:], form=BINARY), "face 1 has a vertex twice"),
        (text(TWO_FACES, TRIANGLE + "\3", form=BINARY), "ends within face 1"),
        (text(TWO_FACES, TRIANGLE, form=BINARY), "ends within face 1"),
        (text(VERTEX.replace("3", "999999999999"), TRIANGLE, form=BINARY), "claims 999999999999"),
        (text(LISTS, TRIANGLE + "\xff", form=BINARY), "list more of -1"),
        (text(LISTS, TRIANGLE + "\7", form=BINARY), "ends within face 0"),
    ],
)
def test_each_fault_is_named_in_one_line(tmp_path, data, said):
    with pytest.raises(InputError, match=said) as caught:
        read_ply(saved(tmp_path, data))
    assert "\n" not in str(caught.value)


def test_memory_that_runs_out_is_an_input_error(tmp_path, monkeypatch):
    def too_much(*_):
        raise MemoryError

    monkeypatch.setattr("tspslam.io.ply.read_elements", too_much)
    with pytest.raises(InputError, match="memory"):
        read_ply(saved(tmp_path, text()))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"xyz": XYZ[:, :2]}, "xyz"),
        ({"xyz": np.full((5, 3), np.nan)}, "xyz"),
        ({"faces": [[0, 1, 5]]}, "0 to 4"),
        ({"faces": [[0, 1, -1]]}, "0 to 4"),
        ({"faces": [[0, 1]]}, "shape"),
        ({"faces": [[0.0, 1.0, 2.0]]}, "float64"),
        ({"edges": [[0, 9]]}, "edges"),
        ({"vertex": {"a": np.zeros(4)}}, r"\(5,\)"),
        ({"vertex": {"a b": np.zeros(5)}}, "ASCII word"),
        ({"vertex": {"é": np.zeros(5)}}, "ASCII word"),
        ({"vertex": {"": np.zeros(5)}}, "ASCII word"),
        ({"vertex": {"x": np.zeros(5)}}, "another name"),
        ({"face": {"vertex_indices": np.zeros(3)}}, "another name"),
        ({"vertex": {"a": np.full(5, np.nan)}}, "finite"),
        ({"vertex": {"a": np.zeros(5, complex)}}, "complex128"),
        ({"vertex": {"a": np.full(5, 1 << 40)}}, "32 bits"),
    ],
)
def test_an_array_that_does_not_fit_is_refused(tmp_path, arguments, said):
    with pytest.raises(InputError, match=said):
        write_ply(tmp_path / "a.ply", **({"xyz": XYZ, "faces": FACES} | arguments))
    assert not (tmp_path / "a.ply").exists()


def test_a_place_below_a_file_is_an_output_error(tmp_path):
    saved(tmp_path, b"", "file")
    with pytest.raises(OutputError):
        write_ply(tmp_path / "file" / "a.ply", XYZ, FACES)


def test_every_truncation_of_a_binary_file_is_seen(tmp_path):
    write_ply(tmp_path / "a.ply", XYZ, FACES)
    data = (tmp_path / "a.ply").read_bytes()
    for size in range(len(data)):
        with pytest.raises(InputError):
            read_ply(saved(tmp_path, data[:size]))


NUMBER = re.compile(rb"\b\d+\b")


@FUZZ
@given(data=st.data())
def test_a_damaged_mesh_is_a_mesh_or_an_input_error(tmp_path, data):
    source = data.draw(
        st.sampled_from([sample(tmp_path)[0].read_bytes(), text(), text(LISTS, TRIANGLE + "\0", BINARY)])
    )
    damaged = bytearray(source)
    if data.draw(st.booleans()):
        number = data.draw(st.sampled_from(list(NUMBER.finditer(source))))
        value = data.draw(st.sampled_from([b"0", b"-1", b"99", b"4294967295", b"999999999999999999", b"1e3", b"nan"]))
        damaged[number.start() : number.end()] = value
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    said = ""
    try:
        back = read_ply(saved(tmp_path, bytes(damaged)))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    if not said:
        assert np.isfinite(back.xyz).all()
        assert back.faces.size == 0 or 0 <= back.faces.min() <= back.faces.max() < len(back.xyz)
        assert all(values.shape == (len(back.xyz),) for values in back.vertex.values())
        assert all(values.shape == (len(back.faces),) for values in back.face.values())


def test_read_mesh_tells_ply_by_its_suffix(tmp_path):
    write_ply(tmp_path / "a.PLY", XYZ, FACES)
    xyz, faces = read_mesh(tmp_path / "a.PLY")
    np.testing.assert_array_equal(xyz, XYZ)
    np.testing.assert_array_equal(faces, FACES)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("lists", ["corners", "corners and others"])
@pytest.mark.parametrize("length", ["uchar", "ushort", "int"])
def test_faces_of_different_lengths_are_read_with_their_scalars(tmp_path, form, lists, length):
    rng = np.random.default_rng(4)
    faces = [np.roll(np.arange(k), k // 2) for k in rng.integers(3, 9, 400)]
    shades, others = rng.integers(0, 256, 400), [rng.normal(size=k).astype(np.float32) for k in rng.integers(0, 4, 400)]
    names = f"property uchar shade\nproperty list {length} int vertex_indices\nproperty short last\n"
    names += f"property list {length} float uv\n" if lists != "corners" else ""
    angle = np.arange(9) * 0.7
    points = np.stack([np.cos(angle), np.sin(angle), np.zeros(9)], axis=1)
    head = f"ply\nformat {form} 1.0\nelement vertex 9\nproperty double x\nproperty double y\nproperty double z\n"
    head += f"element face 400\n{names}end_header\n"
    order = "<" if "little" in form else ">"
    code = {"uchar": "B", "ushort": "H", "int": "i"}[length]
    body = b"" if form == "ascii" else points.astype(f"{order}f8").tobytes()
    lines = [" ".join(map(repr, point)) for point in points.tolist()]
    for face, shade, other in zip(faces, shades.tolist(), others, strict=True):
        row = [shade, len(face), *face.tolist(), -shade]
        row_code = f"{order}B{code}{len(face)}ih"
        if lists != "corners":
            row += [len(other), *other.tolist()]
            row_code += f"{code}{len(other)}f"
        lines.append(" ".join(map(repr, row)))
        body += b"" if form == "ascii" else struct.pack(row_code, *row)
    data = head.encode() + ("\n".join(lines).encode() + b"\n" if form == "ascii" else body)
    mesh, polygons = read_faces(saved(tmp_path, data))
    assert [face.tolist() for face in polygons] == [face.tolist() for face in faces]
    of = np.repeat(np.arange(400), [len(face) - 2 for face in faces])
    np.testing.assert_array_equal(mesh.face["shade"], shades[of])
    np.testing.assert_array_equal(mesh.face["last"], -shades[of])
    for end in (len(data) // 3,) if form == "ascii" else (1, 9, len(data) // 3):
        with pytest.raises(InputError, match=r"truncated|ends within|can hold"):
            read_faces(saved(tmp_path, data[:-end]))
