import errno
import io

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.io import merge_corners, read_mesh, write_vtu
from tspslam.io.mesh import repeated_corners
from tspslam.topology.complex import build_complex

FUZZ = settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
OBJ = b"# a test\nmtllib x\nv 0 0 1\nv 1 0 1 0.5 0.5 0.5\nv 0 1 1\nvt 0 0\nvn 0 0 1\ns off\nf 1/1/1 2//1 -1 # last\n"


def saved(tmp_path, data, name="mesh.obj"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def test_obj_triangles_are_read_with_indices_from_both_ends(tmp_path):
    xyz, faces = read_mesh(saved(tmp_path, OBJ.replace(b"\n", b"\r\n"), "a.OBJ"))
    assert xyz.tolist() == [[0, 0, 1], [1, 0, 1], [0, 1, 1]]
    assert faces.tolist() == [[0, 1, 2]]
    assert faces.dtype == np.int32


def test_vtu_triangles_are_read(tmp_path):
    write_vtu(tmp_path / "a.vtu", build_complex(np.array([[0, 1, 2]]), 3), np.eye(3))
    xyz, faces = read_mesh(tmp_path / "a.vtu")
    np.testing.assert_array_equal(xyz, np.eye(3))
    assert faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"nothing", "no vertices"),
        (b"v 0 0\n", "line 1 has no three finite"),
        (b"v 0 0 nan\n", "line 1 has no three finite"),
        (b"v 0 0 x\n", "line 1 holds a word"),
        (OBJ + b"f 1 2\n", "line 10 has a face of 2 corners"),
        (OBJ + b"f 1 2 3 1\n", "face 1 has a vertex twice"),
        (OBJ + b"f 1 2 \\\n", "line 10 goes on behind the last line"),
        (OBJ + b"f 1 2 x\n", "line 10 holds a word"),
        (OBJ + b"f 1 2 0\n", "line 10 has a corner"),
        (OBJ + b"f 1 2 99999999999999999999\n", "line 10 has a corner"),
        (OBJ + b"f 1 2 4\n", "face 1 has corners"),
        (OBJ + b"f 1 2 -4\n", "face 1 has corners"),
        (OBJ + b"f 1 2 " + b"9" * 5000 + b"\n", "line 10 holds a word"),
    ],
)
def test_each_fault_of_an_obj_is_named_in_one_line(tmp_path, data, said):
    with pytest.raises(InputError, match=said) as caught:
        read_mesh(saved(tmp_path, data))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.stp", "a", "a.gz"])
def test_another_suffix_is_an_input_error_that_lists_ours(tmp_path, name):
    with pytest.raises(InputError, match=r"\.ply, \.vtu, \.obj"):
        read_mesh(saved(tmp_path, b"x", name))


def test_a_disk_that_fails_while_reading_is_an_input_error(tmp_path, monkeypatch):
    class Failing(io.BytesIO):
        def read(self, *_):
            raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("tspslam._files.open_input", lambda *_: Failing())
    with pytest.raises(InputError, match="Input/output error"):
        read_mesh(tmp_path / "a.obj")


@FUZZ
@given(data=st.data())
def test_a_damaged_obj_is_a_mesh_or_an_input_error(tmp_path, data):
    damaged = bytearray(OBJ)
    for _ in range(data.draw(st.integers(1, 5))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    said = ""
    try:
        xyz, faces = read_mesh(saved(tmp_path, bytes(damaged)))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    if not said:
        assert np.isfinite(xyz).all()
        assert faces.size == 0 or 0 <= faces.min() <= faces.max() < len(xyz)


@FUZZ
@given(
    data=st.binary(min_size=1, max_size=200),
    suffix=st.sampled_from([".ply", ".vtu", ".obj", ".npz", ".off", ".stl", ".gltf", ".glb"]),
)
def test_noise_is_an_input_error(tmp_path, data, suffix):
    with pytest.raises(InputError):
        read_mesh(saved(tmp_path, data, f"noise{suffix}"))


STRIPS = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element tristrips 1
property list int int vertex_indices
end_header
0 0 1
1 0 1
0 1 1
3 0 1 2
"""


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.obj", b"v 0 0 1\nv 1 0 1\n", "has 2 vertices and no faces; expected a mesh with faces"),
        ("a.ply", STRIPS.replace(b"strips 1", b"strips 0"), "has 3 vertices and no faces; expected"),
    ],
)
def test_a_file_without_faces_is_no_mesh(tmp_path, name, data, said):
    with pytest.raises(InputError, match=said):
        read_mesh(saved(tmp_path, data, name))


def test_a_grid_of_lines_is_no_mesh(tmp_path):
    write_vtu(tmp_path / "a.vtu", build_complex([], 3, edges=[[0, 1]]), np.eye(3))
    with pytest.raises(InputError, match="has 3 vertices and no faces"):
        read_mesh(tmp_path / "a.vtu")


def test_merged_corners_give_the_mesh_that_the_soup_was_cut_from():
    rng = np.random.default_rng(2)
    xyz = rng.normal(size=(40, 3)).round(3)
    faces = np.array([rng.choice(40, 3, replace=False) for _ in range(60)], np.int32)
    soup = xyz[faces].reshape(-1, 3)
    merged, found = merge_corners(soup, np.arange(180, dtype=np.int32).reshape(-1, 3))
    assert len(merged) == len(np.unique(faces)) == 180 - repeated_corners(soup)
    np.testing.assert_array_equal(merged[found], xyz[faces])
    first = [np.flatnonzero((soup == point).all(axis=1))[0] for point in merged]
    assert first == sorted(first)  # in the order of the file
    again, same = merge_corners(merged, found)
    np.testing.assert_array_equal(again, merged)
    np.testing.assert_array_equal(same, found)


def test_minus_zero_is_zero_and_faces_that_vanish_go():
    xyz = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [-0.0, 0, 1], [0.0, -0.0, 1]])
    merged, faces = merge_corners(xyz, np.array([[3, 1, 2], [0, 3, 1]], np.int32))
    assert len(merged) == 3
    assert faces.tolist() == [[0, 1, 2]]


@pytest.mark.parametrize("word", ["1_0", "\u0661", "\u00b9"])
def test_numbers_of_an_obj_are_plain_digits(tmp_path, word):
    for line in (f"v 0 0 {word}\n", f"f 1 2 {word}\n"):
        with pytest.raises(InputError, match="line 10 holds a word that is no number"):
            read_mesh(saved(tmp_path, OBJ + line.encode()))
