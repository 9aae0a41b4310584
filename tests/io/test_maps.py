"""A map as VTU and PLY: what viewers are shown is what the map holds."""

import dataclasses

import numpy as np
import pytest

from tests.io.test_io_frames import FACES, frame
from tests.io.test_topological import map_
from tspslam import Signals, build_complex
from tspslam.io import read_mesh, read_ply, read_vtu
from tspslam.io.maps import write_maps


@pytest.fixture
def files(tmp_path):
    write_maps(tmp_path / "map.vtu", tmp_path / "map.ply", map_())
    return tmp_path / "map.vtu", tmp_path / "map.ply"


def test_a_grid_shows_all_that_the_map_says_of_its_vertices(files):
    shown, made = read_vtu(files[0]).point_data, map_()
    z = made.response.z
    expected = {
        "luminance": made.signals.vertex, "ok": made.signals.vertex_ok, "views": made.view_count.vertex,
        "variance": made.view_variance.vertex, "landmark_id": made.landmark_id, "response_real": z.real,
        "response_imaginary": z.imag, "magnitude": abs(z), "phase": np.angle(z), "defined": made.defined,
        "direction": made.direction, "direction_spread": made.direction_spread,
    }  # fmt: skip
    assert shown.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_allclose(shown[name], values, rtol=1e-12, err_msg=name)
    assert shown["landmark_id"].dtype == np.int64


def test_its_cells_are_edges_then_faces_wound_as_the_surface(files):
    grid, made = read_vtu(files[0]), map_()
    np.testing.assert_array_equal(grid.edges, made.complex_.edges)
    np.testing.assert_array_equal(grid.faces, made.surface.faces)
    assert grid.cell_data.keys() == {"dim", "luminance", "ok", "pixels", "views", "variance"}
    np.testing.assert_array_equal(grid.cell_data["luminance"], np.append(made.signals.edge, made.signals.face))
    np.testing.assert_array_equal(grid.cell_data["views"], np.append(made.view_count.edge, made.view_count.face))
    np.testing.assert_array_equal(grid.cell_data["variance"][6:], made.view_variance.face)


def test_a_polygon_file_has_grey_normals_and_the_signals(files):
    mesh, made = read_ply(files[1]), map_()
    np.testing.assert_array_equal(mesh.faces, made.surface.faces)
    np.testing.assert_array_equal(mesh.xyz, made.xyz)
    grey = np.round(255 * made.signals.vertex)
    assert all(np.array_equal(mesh.vertex[colour], grey) for colour in ("red", "green", "blue"))
    scalars = {"luminance", "ok", "views", "variance", "magnitude", "phase", "defined", "direction_spread"}
    assert scalars <= mesh.vertex.keys()
    assert mesh.face.keys() == {"luminance", "ok", "views", "variance"}
    np.testing.assert_array_equal(mesh.face["luminance"], made.signals.face)


def test_normals_look_at_whom_the_corners_turn_counter_clockwise(tmp_path):
    xyz = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [1, -1, 0], [0, 0, 1]])  # faces turn clockwise, seen from +z
    write_maps(tmp_path / "a.vtu", tmp_path / "a.ply", map_(xyz=xyz))
    vertex = read_ply(tmp_path / "a.ply").vertex
    normals = np.column_stack([vertex[name] for name in ("nx", "ny", "nz")])
    corners = xyz[FACES]
    turn = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(normals[1], turn[0] / np.linalg.norm(turn[0]), atol=1e-12)
    np.testing.assert_allclose(normals[3], turn[1] / np.linalg.norm(turn[1]), atol=1e-12)
    assert not normals[4].any()  # no face of its own


def test_another_library_reads_the_grid(files):
    meshio = pytest.importorskip("meshio")
    grid = meshio.read(files[0])
    np.testing.assert_array_equal(grid.point_data["direction"], map_().direction)
    assert {block.type: len(block.data) for block in grid.cells} == {"line": 6, "triangle": 2}


def test_a_map_without_faces_is_written_too(tmp_path):
    none = np.zeros(0)
    bare = map_()
    signals = dataclasses.replace(bare.signals, edge=none, face=none, edge_pixels=none, face_pixels=none,
                                  edge_ok=none > 0, face_ok=none > 0)  # fmt: skip
    assert isinstance(signals, Signals)
    complex_ = build_complex(np.empty((0, 3), int), 5)
    levels = {name: getattr(bare, name)._replace(edge=none, face=none) for name in ("view_count", "view_variance")}
    surface = dataclasses.replace(bare.surface, faces=complex_.faces)
    write_maps(
        tmp_path / "a.vtu", tmp_path / "a.ply", map_(complex_=complex_, surface=surface, signals=signals, **levels)
    )
    assert len(read_vtu(tmp_path / "a.vtu").xyz) == len(read_ply(tmp_path / "a.ply").xyz) == 5


def test_a_frame_is_shown_with_its_depth_and_its_faces_as_before(tmp_path):
    write_maps(tmp_path / "a.vtu", tmp_path / "a.ply", frame())
    grid = read_vtu(tmp_path / "a.vtu")
    np.testing.assert_array_equal(grid.point_data["depth"], frame().cloud.xyz[:, 2])
    assert grid.cell_data.keys() == {"dim", "luminance", "ok", "pixels"}
    assert list(read_ply(tmp_path / "a.ply").face) == ["luminance", "ok"]
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.ply")[1], FACES)
