"""Faces of more than three corners: cut so that they cover what they covered, or refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam import InputError, build_cells
from tspslam.io import read_mesh, read_ply, read_polygons, read_textured, read_vtu, triangulate_polygons
from tspslam.io._polygons import polygons_of, strip_triangles

PLACES = np.array(
    [[0, 0, 5], [2, 0, 5], [2, 1, 5], [0, 1, 5], [0.5, 0.3, 5], [1, 0, 5], [2, 2, 5], [1, 2, 5], [1, 1, 5]], float
)


def cut(*faces, xyz=PLACES):
    return triangulate_polygons(xyz, polygons_of([len(face) for face in faces], np.concatenate(faces), len(xyz)))


def area(xyz, faces):
    a, b, c = (xyz[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)[:, 2] / 2


@pytest.mark.parametrize(
    ("face", "found"),
    [
        ([0, 1, 2, 3], [[0, 1, 2], [0, 2, 3]]),  # equal diagonals: from the first corner
        ([1, 8, 3, 0], [[8, 3, 0], [8, 0, 1]]),  # the shorter one
        ([1, 4, 3, 0], [[4, 3, 0], [4, 0, 1]]),  # the one that lies inside
        ([0, 5, 1, 2, 3], [[5, 1, 2], [5, 2, 3], [5, 3, 0]]),  # a corner on a side: no flat triangle
        ([0, 1, 6, 7, 8, 3], [[1, 6, 7], [1, 7, 8], [1, 8, 3], [1, 3, 0]]),  # an L
    ],
)
def test_a_face_is_cut_into_a_fan_that_covers_it(face, found):
    assert cut(face).tolist() == found
    assert (np.sign(area(PLACES, cut(face))) == np.sign(area(PLACES, cut(face)).sum())).all()


@settings(max_examples=60, deadline=None)
@given(k=st.integers(4, 40), seed=st.integers(0, 1000))
def test_a_star_is_covered_once_and_keeps_its_winding(k, seed):
    """Corners around a place: the triangles' areas add up to the face's, none is turned over."""
    rng = np.random.default_rng(seed)
    angle, out = 2 * np.pi * np.arange(k) / k, rng.uniform(0.98, 1.02, k)
    xyz = np.stack([out * np.cos(angle), out * np.sin(angle), np.full(k, 5.0)], axis=1)
    x, y = xyz[:, 0], xyz[:, 1]
    whole = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    try:
        faces = cut(np.arange(k), xyz=xyz)
    except InputError:  # a ragged one
        return
    assert len(faces) == k - 2
    assert area(xyz, faces).min() > -1e-9
    assert area(xyz, faces).sum() == pytest.approx(whole)


@pytest.mark.parametrize(
    ("face", "said"),
    [
        ([0, 1, 2, 0], "face 1 has a vertex twice"),
        ([0, 1], "face 1 has 2 corners, where 3 or more go"),
        ([0, 1, 9], r"face 1 has corners \[0, 1, 9\], where 0 to 8 go"),
        ([0, 3, 1, 2], "face 1 has 4 corners, and no area"),  # a bow-tie of two equal halves
        ([0, 6, 3, 2, 5, 4, 7, 1], "face 1 has 8 corners, and no fan"),
    ],
)
def test_a_face_that_is_none_is_named(face, said):
    with pytest.raises(InputError, match=said):
        cut([0, 1, 2], face)


def test_quads_in_one_line_are_refused():
    line = np.outer(np.arange(5.0, 9.0), (1, 2, 3))
    with pytest.raises(InputError, match="face 0 has 4 corners, and no area: they are in one line"):
        cut([0, 1, 2, 3], xyz=line)


def test_places_as_far_away_as_numbers_go_are_cut_or_refused():
    far = np.where(PLACES > 0, 1.7e308, -1.7e308)
    with pytest.raises(InputError, match="no fan"):
        cut([0, 1, 2, 3], xyz=far)
    assert len(cut([0, 1, 2, 3], xyz=PLACES * 0)) == 2  # all in one place: as a triangle may be


def test_a_strip_is_wound_alike_and_corners_twice_join_parts():
    assert strip_triangles(np.array([0, 1, 2, 3, 4])).tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    assert strip_triangles(np.array([0, 1, 2, 2, 5, 5, 6, 7])).tolist() == [[0, 1, 2], [5, 7, 6]]
    assert strip_triangles(np.array([0, 1])).shape == (0, 3)


HEAD = "ply\nformat {}\nelement vertex 9\nproperty double x\nproperty double y\nproperty double z\n"
FACES = "element face 3\nproperty uchar label\nproperty list uchar int vertex_indices\nproperty float luminance\n"


def ply(form="ascii 1.0", faces=([0, 1, 2, 3], [0, 1, 2], [0, 5, 1, 2, 3])):
    head = (HEAD.format(form) + FACES.replace("3", str(len(faces)), 1) + "end_header\n").encode()
    if form.startswith("ascii"):
        rows = [" ".join(map(str, row)) for row in PLACES]
        rows += [f"{k} {len(face)} {' '.join(map(str, face))} 0.{k}" for k, face in enumerate(faces)]
        return head + "\n".join(rows).encode() + b"\n"
    order = "<" if "little" in form else ">"
    body = PLACES.astype(order + "f8").tobytes()
    for k, face in enumerate(faces):
        body += bytes([k, len(face)]) + np.array(face, order + "i4").tobytes()
        body += np.array([k / 10], order + "f4").tobytes()
    return head + body


@pytest.mark.parametrize("form", ["ascii 1.0", "binary_little_endian 1.0", "binary_big_endian 1.0"])
def test_triangles_of_a_ply_have_the_scalars_of_the_face_that_they_are_of(tmp_path, form):
    (tmp_path / "a.ply").write_bytes(ply(form))
    found = read_ply(tmp_path / "a.ply")
    assert found.faces.tolist() == cut([0, 1, 2, 3], [0, 1, 2], [0, 5, 1, 2, 3]).tolist()
    assert found.face["label"].tolist() == [0, 0, 1, 2, 2, 2]
    np.testing.assert_allclose(found.face["luminance"], [0, 0, 0.1, 0.2, 0.2, 0.2])
    (tmp_path / "b.ply").write_bytes(ply(form, faces=([0, 1, 2, 3], [3, 2, 6, 7])))  # all alike: read in one go
    assert read_ply(tmp_path / "b.ply").face["label"].tolist() == [0, 0, 1, 1]
    shown = read_textured(tmp_path / "b.ply")
    np.testing.assert_allclose(shown.signals.face, [0, 0, 0.1, 0.1])


def test_faces_are_given_as_they_stand_for_a_cell_complex(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply(faces=([0, 5, 1, 2, 3], [3, 2, 6, 7])))
    xyz, polygons = read_polygons(tmp_path / "a.ply")
    cells = build_cells(polygons, len(xyz))
    assert [len(face) for face in cells.faces] == [5, 4]
    assert abs(cells.B1 @ cells.B2).max() == 0


def test_strips_of_a_ply_are_its_faces(tmp_path):
    strips = "element tristrips 2\nproperty list int int vertex_indices\nend_header\n"
    rows = "\n".join(" ".join(map(str, row)) for row in PLACES)
    (tmp_path / "a.ply").write_text(HEAD.format("ascii 1.0") + strips + rows + "\n8 0 1 3 2 -1 6 7 8\n3 4 5 6\n")
    assert read_mesh(tmp_path / "a.ply")[1].tolist() == [[0, 1, 3], [1, 2, 3], [6, 7, 8], [4, 5, 6]]


GRID = """<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="9" NumberOfCells="{n}"><Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">
{xyz}</DataArray></Points><Cells><DataArray type="Int64" Name="connectivity" format="ascii">{corners}</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">{ends}</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">{types}</DataArray></Cells><CellData>
<DataArray type="Float64" Name="a" format="ascii">{a}</DataArray></CellData></Piece></UnstructuredGrid></VTKFile>"""


def grid(corners, ends, types):
    words = {"corners": corners, "ends": ends, "types": types, "a": list(range(len(types)))}
    said = {name: " ".join(map(str, values)) for name, values in words.items()}
    return GRID.format(n=len(types), xyz=" ".join(map(str, PLACES.ravel())), **said)


def test_quads_pixels_and_polygons_of_a_grid_are_cut(tmp_path):
    corners = [0, 1, 2, 3, 4, 8, 0, 1, 3, 2, 0, 5, 1, 2, 3, 0, 1, 2]
    (tmp_path / "a.vtu").write_text(grid(corners, [4, 6, 10, 15, 18], [9, 3, 8, 7, 5]))
    found = read_vtu(tmp_path / "a.vtu")
    assert found.edges.tolist() == [[4, 8]]
    assert found.faces.tolist() == cut([0, 1, 2, 3], [0, 1, 2, 3], [0, 5, 1, 2, 3], [0, 1, 2]).tolist()
    assert found.cell_data["a"].tolist() == [1, 0, 0, 2, 2, 3, 3, 3, 4]


@pytest.mark.parametrize(
    ("ends", "types"), [([3], [9]), ([-4], [7]), ([1 << 62], [7]), ([4, 3], [7, 7]), ([1], [7]), ([2], [7])]
)
def test_offsets_of_a_grid_that_fit_no_cell_are_refused(tmp_path, ends, types):
    (tmp_path / "a.vtu").write_text(grid([0, 1, 2, 3], ends, types))
    with pytest.raises(InputError, match=r"offsets that do not fit|2 corners, where 3 or more go|where .* claimed"):
        read_vtu(tmp_path / "a.vtu")


@pytest.mark.parametrize("name", ["vtkLZ4DataCompressor", "vtkMyCompressor"])
def test_other_compressors_are_refused_by_name(tmp_path, name):
    text = grid([0, 1, 2], [3], [5]).replace("byte_order", f'compressor="{name}" byte_order')
    (tmp_path / "a.vtu").write_text(text)
    with pytest.raises(InputError, match=f"compressed by {name}, where zlib and LZMA are read"):
        read_vtu(tmp_path / "a.vtu")


def test_the_filter_says_how_many_faces_it_cut(tmp_path):
    from tspslam.run.mesh import _triangles

    (tmp_path / "a.ply").write_bytes(ply(faces=([0, 1, 2, 3], [0, 1, 2], [0, 5, 1, 2, 3])))
    _, triangles, face_of = _triangles(tmp_path / "a.ply")
    assert (len(triangles), face_of.tolist()) == (6, [0, 0, 1, 2, 2, 2])
    (tmp_path / "b.ply").write_bytes(ply(faces=([0, 1, 2, 0],)))
    with pytest.raises(InputError, match=r"b\.ply: .*has a vertex twice"):
        _triangles(tmp_path / "b.ply")
