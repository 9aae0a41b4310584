"""A mesh keeps the signals of its file."""

import numpy as np
import pytest

from tspslam import InputError, build_complex, sample_signals
from tspslam.io import write_ply, write_vtu
from tspslam.io.maps import write_map_ply, write_map_vtu
from tspslam.io.textured import TexturedMesh, read_textured

UV = np.array([[1.0, 1], [14, 2], [3, 12], [13, 13]])
XYZ = np.column_stack([UV / 10, [4.0, 5, 6, 7]])
FACES = np.array([[2, 1, 0], [1, 2, 3]], np.int32)
IMAGE = np.random.default_rng(3).random((16, 16))


@pytest.fixture
def mesh():
    complex_ = build_complex(FACES, 4)
    return TexturedMesh(XYZ, FACES, complex_, sample_signals(IMAGE, UV, complex_))


def same(a, b):
    levels = ("vertex", "edge", "face", "vertex_ok", "edge_ok", "face_ok", "edge_pixels", "face_pixels")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in levels)


def test_what_was_written_as_vtu_is_read_again(mesh, tmp_path):
    write_map_vtu(tmp_path / "a.vtu", mesh, face={"region": np.array([3, 4])})
    again = read_textured(tmp_path / "a.vtu")
    assert np.array_equal(again.xyz, XYZ)
    assert np.array_equal(again.faces, FACES)
    assert same(again.signals, mesh.signals)


def test_vtu_lines_may_stand_in_any_order(mesh, tmp_path):
    order, E = np.array([4, 2, 0, 1, 3]), mesh.complex_.edges
    odd = build_complex(FACES, 4)
    object.__setattr__(odd, "edges", E[order][:, ::-1].copy())
    s = mesh.signals
    write_vtu(tmp_path / "a.vtu", odd, XYZ, edge={"luminance": s.edge[order]}, face={"luminance": s.face})
    again = read_textured(tmp_path / "a.vtu")
    assert np.array_equal(again.complex_.edges, E)
    assert np.array_equal(again.signals.edge, s.edge)
    assert not again.signals.vertex_ok.any()


def test_what_was_written_as_ply_is_read_again_with_means_on_edges(mesh, tmp_path):
    write_map_ply(tmp_path / "a.ply", mesh)
    again = read_textured(tmp_path / "a.ply")
    assert np.array_equal(again.signals.vertex, mesh.signals.vertex)
    assert np.array_equal(again.signals.face, mesh.signals.face)
    i, j = again.complex_.edges.T
    assert np.allclose(again.signals.edge, (mesh.signals.vertex[i] + mesh.signals.vertex[j]) / 2)


def test_colours_of_a_ply_are_luminance(tmp_path):
    red = np.array([255, 0, 0, 0], np.uint8)
    write_ply(tmp_path / "a.ply", XYZ, FACES, vertex={"red": red, "green": red * 0, "blue": red * 0})
    assert np.allclose(read_textured(tmp_path / "a.ply").signals.vertex, [0.299, 0, 0, 0])


def test_a_mesh_without_luminance_has_no_signals_and_is_written_without(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n")
    bare = read_textured(tmp_path / "a.obj")
    marks = (bare.signals.vertex_ok, bare.signals.edge_ok, bare.signals.face_ok)
    assert not any(ok.any() for ok in marks)
    write_map_ply(tmp_path / "a.ply", bare)
    write_map_vtu(tmp_path / "a.vtu", bare)
    assert b"luminance" not in (tmp_path / "a.ply").read_bytes() + (tmp_path / "a.vtu").read_bytes()


def test_marked_elements_stay_marked(mesh, tmp_path):
    ok = np.array([1, 0, 1, 1], np.uint8)
    write_ply(tmp_path / "a.ply", XYZ, FACES, vertex={"luminance": [0.5, 0.9, 0.5, 0.5], "ok": ok})
    signals = read_textured(tmp_path / "a.ply").signals
    assert signals.vertex_ok.tolist() == [True, False, True, True]
    assert signals.vertex[1] == 0
    assert not signals.face_ok.any()  # both faces hang on that vertex


def test_a_triangle_twice_is_refused(tmp_path):
    write_ply(tmp_path / "a.ply", XYZ, np.vstack([FACES, FACES[:1]]), vertex={"luminance": np.ones(4)})
    with pytest.raises(InputError, match=r"a\.ply: has 1 triangles that are there already; expected each"):
        read_textured(tmp_path / "a.ply")


def test_a_file_of_points_is_refused(tmp_path):
    write_ply(tmp_path / "a.ply", XYZ, np.zeros((0, 3), int), vertex={"luminance": np.ones(4)})
    with pytest.raises(InputError, match=r"a\.ply: has 4 vertices and no faces"):
        read_textured(tmp_path / "a.ply")
