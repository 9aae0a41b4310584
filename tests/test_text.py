"""Every format reads text the same way: encodings, ends of lines, comments, separators, plain numbers."""

import codecs

import numpy as np
import pytest
from PIL import Image

from tests.datasets import standard
from tests.interop.test_interop import IMAGE, RIG, tiny, write_model
from tspslam import InputError
from tspslam._text import numbers, read_lines, read_text, split
from tspslam.datasets import KittiSequence
from tspslam.interop import from_colmap
from tspslam.io import read_mesh, read_ply, read_trajectory, write_tum
from tspslam.run.config import resolve
from tspslam.vision.calibration.formats import read_calibration
from tspslam.vision.calibration.formats.own import load_cameras, save_cameras

WRITTEN = {  # how one text may lie in a file
    "utf-8": lambda text: text.encode(),
    "utf-8 with a mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "utf-16": lambda text: text.encode("utf-16"),
    "utf-16-be": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
    "utf-32": lambda text: text.encode("utf-32"),
    "cr lf": lambda text: text.replace("\n", "\r\n").encode(),
    "cr": lambda text: text.replace("\n", "\r").encode(),
    "no last end": lambda text: text.rstrip("\n").encode(),
}
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 1
1 0 1
0 1 1
3 0 1 2
"""
EVERY = pytest.mark.parametrize("form", WRITTEN)


def rewritten(path, form):
    path.write_bytes(WRITTEN[form](path.read_bytes().decode()))
    return path


@EVERY
def test_a_trajectory_is_the_same_however_it_is_written(tmp_path, form):
    write_tum(tmp_path / "a.tum", np.arange(4) / 10, standard.poses(4))
    expected = read_trajectory(tmp_path / "a.tum")
    text = (tmp_path / "a.tum").read_text()
    (tmp_path / "a.tum").write_text("  # stamp tx ty\n% more\n\n" + text.replace("\n", " # said\n", 1))
    found = read_trajectory(rewritten(tmp_path / "a.tum", form))
    np.testing.assert_array_equal(found.stamp, expected.stamp)
    np.testing.assert_array_equal(found.T_world_camera, expected.T_world_camera)


@EVERY
@pytest.mark.parametrize(
    ("name", "text"), [("a.obj", "v 0 0 1\nv 1 0 1 9 9 9\n  # said\nv 0 1 1\nf 1/1/1 -2 3//1\n"), ("a.ply", PLY)]
)
def test_a_mesh_keeps_its_first_vertex_however_it_is_written(tmp_path, form, name, text):
    (tmp_path / name).write_bytes(text.encode())
    xyz, faces = read_mesh(rewritten(tmp_path / name, form))
    assert xyz.tolist() == [[0, 0, 1], [1, 0, 1], [0, 1, 1]]
    assert faces.tolist() == [[0, 1, 2]]


def test_a_mark_before_binary_ply_is_passed_over(tmp_path):
    from tspslam.io import write_ply

    write_ply(tmp_path / "a.ply", np.eye(3) + 0.1, [[0, 1, 2]])
    (tmp_path / "b.ply").write_bytes(codecs.BOM_UTF8 + (tmp_path / "a.ply").read_bytes())
    np.testing.assert_array_equal(read_ply(tmp_path / "b.ply").xyz, np.eye(3) + 0.1)


@EVERY
def test_a_calibration_is_the_same_however_it_is_written(tmp_path, form):
    save_cameras(RIG, tmp_path / "ours.yaml")
    assert load_cameras(rewritten(tmp_path / "ours.yaml", form)) == RIG
    kitti = tmp_path / "calib.txt"
    kitti.write_text("# KITTI\nP0: 50 0 32 0 0 50 24 0 0 0 1 0\n\nP1: 50 0 32 -25 0 50 24 0 0 0 1 0\n")
    assert read_calibration(rewritten(kitti, form), (64, 48)).cameras.baseline == 0.5
    opencv = "# mine\n\n%YAML:1.0\n---\nP1: [50, 0, 32, 0, 0, 50, 24, 0, 0, 0, 1, 0]\n"
    opencv += "P2: [50, 0, 32, -25, 0, 50, 24, 0, 0, 0, 1, 0]\nimageSize: [64, 48]\n"
    (tmp_path / "rig.yml").write_text(opencv)
    assert read_calibration(rewritten(tmp_path / "rig.yml", form)).cameras.baseline == 0.5


@EVERY
def test_settings_and_tables_of_recordings_are_the_same_however_they_are_written(tmp_path, form):
    (tmp_path / "my.yaml").write_text("filter: {order: 2}\n")
    assert resolve("default", rewritten(tmp_path / "my.yaml", form), []).values["filter.order"] == 2
    drive = standard.odometry(tmp_path / "drive")
    for name in ("times.txt", "calib.txt"):
        rewritten(drive / name, form)
    np.testing.assert_allclose(KittiSequence(drive).stamps, np.arange(4) / 10)


@EVERY
def test_a_model_of_colmap_is_the_same_however_it_is_written(tmp_path, form):
    model = write_model(tmp_path, tiny())
    for name in ("images.txt", "cameras.txt", "points3D.txt"):
        rewritten(model / name, form)
    np.testing.assert_allclose(from_colmap(model, "my image.png", IMAGE).cloud.uv, tiny().uv)


@pytest.mark.parametrize("name", ["a.tum", "calib.txt", "a.yaml", "a.obj"])
def test_utf_16_without_a_mark_is_named(tmp_path, name):
    path = tmp_path / name
    path.write_bytes("P0: 1 2 3 4 5 6 7 8\n".encode("utf-16-le"))
    read = {".tum": read_trajectory, ".obj": read_mesh}.get(path.suffix, read_calibration)
    with pytest.raises(InputError, match=r"is UTF-16 without a byte-order mark; expected .*in UTF-8"):
        read(path)


def test_bytes_that_are_no_text_are_named_by_line(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"one\n\xf6ne\n")
    with pytest.raises(InputError, match="is no text in UTF-8: line 2 has the byte 0xf6"):
        read_text(path, "words")
    assert [number for number, _ in read_lines(path, "words")] == [1, 2]
    path.write_bytes(b"# H\xf6he\n0 0 0 0 0 0 0 1\n")  # of a comment they do not matter
    assert len(read_trajectory(path)) == 1
    path.write_bytes(b"1 2\0\n")
    with pytest.raises(InputError, match="is no text: line 1 holds a zero byte"):
        list(read_lines(path, "words"))
    path.write_bytes(codecs.BOM_UTF16_LE + b"1")
    for read in (read_text, lambda *given: list(read_lines(*given))):
        with pytest.raises(InputError, match="is no text"):
            read(path, "words")


def test_lines_are_numbered_as_an_editor_numbers_them(tmp_path):
    (tmp_path / "a.txt").write_bytes("a\x0cb\n\n# c\r\nd\u2028e\rf".encode())
    assert list(read_lines(tmp_path / "a.txt", "words")) == [(1, "a\x0cb"), (2, ""), (4, "d\u2028e"), (5, "f")]


SEPARATED = {
    "1,2,3": "has 1 value, separated by commas",
    "1;2;3": "has 1 value, separated by semicolons",
    "0,5;1,0;2,0": "has 1 value, separated by semicolons",
    "1, 2, 3": "holds a word that is no number: '1,', separated by commas",
    "0,5 1,0 2,0": "holds a word that is no number: '0,5', with decimal commas",
    "1 2": "has 2 values; expected",
    "1 2 3_0": "holds a word that is no number: '3_0'; expected",
    "1 2 \u0663": "holds a word that is no number: '\u0663'; expected",
    "1 2 \u00b2": "holds a word that is no number: '\u00b2'; expected",
    "1 2 0x3": "holds a word that is no number: '0x3'; expected",
}


@pytest.mark.parametrize("text", SEPARATED)
def test_what_separates_the_values_is_named(text):
    line = 7, text
    with pytest.raises(InputError) as caught:
        numbers("a.txt", line, split("a.txt", line, "three", (3,)), "three")
    assert f"a.txt: line 7 {SEPARATED[text]}" in str(caught.value)


@pytest.mark.parametrize("text", ["P0: 50,0,32\n", "P0: 50;0;32\n", "P0: 50,0 0,0 32,0\n"])
def test_separators_of_a_kitti_calibration_are_named(tmp_path, text):
    (tmp_path / "calib.txt").write_text("P1: 1 2 3\n" + text)
    with pytest.raises(InputError, match=r"line 2: P0 has values(, separated by|, with decimal)"):
        read_calibration(tmp_path / "calib.txt", (64, 48))


def test_numbers_are_read_as_python_reads_them():
    words = ["1", "-2.5", "+.5e-3", "nan", "-Inf", "1.", "1E5"]
    np.testing.assert_array_equal(numbers("a", (1, " ".join(words)), words, "some"), [float(word) for word in words])


@pytest.mark.parametrize("name", ["images.txt", "points3D.txt"])
def test_ids_of_colmap_are_plain_digits(tmp_path, name):
    model = write_model(tmp_path, tiny())
    text = (model / name).read_text()
    (model / name).write_text(text.replace(" 10 ", " \u00b910 ") if name == "images.txt" else "\u00b21 0 0 1\n" + text)
    Image.fromarray(IMAGE).save(tmp_path / "image.png")
    with pytest.raises(InputError, match=r"line 1 begins with '²1'|line 5 holds a word that is no number: '¹10'"):
        from_colmap(model, "my image.png", IMAGE)


def test_a_point_of_colmap_has_a_whole_number(tmp_path):
    model = write_model(tmp_path, tiny())
    (model / "images.txt").write_text((model / "images.txt").read_text().replace(" 10 ", " 10.5 "))
    with pytest.raises(InputError, match=r"names the point 10\.5; expected a whole number"):
        from_colmap(model, "my image.png", IMAGE)
