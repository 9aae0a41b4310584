"""STL, OFF and glTF: the mesh that was written reads back, and each fault is one line."""

import base64
import json
import struct
from collections import Counter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam import InputError
from tspslam.io import _gltf_data, read_mesh
from tspslam.io.glb import Drawn, write_glb

XYZ = np.array([[0, 0, 5], [1, 0, 5], [1, 1, 5], [0, 1, 6]], float)
FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def stl(head=b"solid in the head", count=2):
    facets = np.zeros(2, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    facets["corners"] = XYZ[FACES]
    return head.ljust(80, b"\0") + struct.pack("<I", count) + facets.tobytes()


def stl_text():
    lines = ["solid a name"]
    for face in FACES:
        lines += ["facet normal 0 0 1", " outer loop", *(f"  vertex {x} {y} {z}" for x, y, z in XYZ[face])]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid a name", ""]).encode()


OFF = b"OFF # said\n4 2 5\n# places\n0 0 5\n1 0 5\n1 1 5\n0 1 6\n\n3 0 1 2\n3 0 2 3 255 0 0\n"


def gltf(**changes):
    """A tree with one mesh of two triangles, in a buffer that is embedded."""
    data = XYZ.astype("<f4").tobytes() + FACES.astype("<u2").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "buffers": [{"byteLength": 60, "uri": uri}],
    }
    return tree | changes


def glb(tree, data=b""):
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if data:
        chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


FILES = {
    "binary.stl": stl(),
    "text.STL": stl_text(),
    "a.off": OFF,
    "counts.off": OFF.replace(b"OFF # said\n4 2 5", b"OFF4 2 5"),  # as some collections have it
    "colours.coff": OFF.replace(b"OFF", b"COFF").replace(b" 5\n1 0", b" 5 9 9 9 255\n1 0"),
    "cr.off": OFF.replace(b"\n", b"\r"),
    "a.gltf": json.dumps(gltf()).encode(),
}
FLIPPED = XYZ * (1, -1, -1)


def saved(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    return tmp_path / name


def faults(path):
    """The error that a file is refused with; empty for a sound mesh."""
    try:
        xyz, faces = read_mesh(path)
    except InputError as error:
        return str(error)
    assert np.isfinite(xyz).all()
    assert 0 <= faces.min() <= faces.max() < len(xyz)
    return ""


@pytest.mark.parametrize("name", FILES)
def test_each_format_gives_the_mesh_that_it_holds(tmp_path, name):
    xyz, faces = read_mesh(saved(tmp_path, name, FILES[name]))
    np.testing.assert_array_equal(xyz, FLIPPED if name == "a.gltf" else XYZ)
    assert faces.tolist() == FACES.tolist()
    assert faces.dtype == np.int32


def test_what_write_glb_writes_is_read_where_it_was(tmp_path):
    grey = np.full((4, 3), 90, np.uint8)
    write_glb(tmp_path / "a.glb", [Drawn("mesh", "triangles", XYZ, grey, FACES), Drawn("dots", "points", XYZ, grey)])
    xyz, faces = read_mesh(tmp_path / "a.glb")
    np.testing.assert_array_equal(xyz, XYZ)
    assert faces.tolist() == FACES.tolist()


@pytest.mark.parametrize("form", ["stl", "stl_ascii", "off", "glb", "gltf", "obj", "ply"])
def test_what_trimesh_writes_is_read(tmp_path, form):
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(2)
    path = tmp_path / f"ball.{form.removesuffix('_ascii')}"
    if form == "gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(ball)).items():
            (tmp_path / name).write_bytes(data)
        path = tmp_path / "model.gltf"
    else:
        ball.export(path, file_type=form)
    xyz, faces = read_mesh(path)
    turned = (1, -1, -1) if form in ("glb", "gltf") else (1, 1, 1)
    np.testing.assert_allclose((xyz * turned)[faces], ball.vertices[ball.faces], atol=1e-6)
    assert len(xyz) == len(ball.vertices)


def test_nodes_place_their_meshes_and_a_mirror_turns_the_winding(tmp_path):
    half = np.sqrt(0.5)
    nodes = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 2, 2]},  # a quarter about z
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 1, 1]},
        {"mesh": 0},  # not in the scene
    ]
    xyz, faces = read_mesh(saved(tmp_path, "a.gltf", json.dumps(gltf(nodes=nodes)).encode()))
    x, y, z = XYZ.T
    turned = np.stack([10 - 2 * y, 2 * x, 2 * z], axis=1) * (1, -1, -1)
    mirrored = np.stack([10 - x, y, z + 1], axis=1) * (1, -1, -1)
    np.testing.assert_allclose(xyz, [*turned, *mirrored], atol=1e-12)
    assert faces.tolist() == [*FACES.tolist(), *(FACES[:, ::-1] + 4).tolist()]
    everywhere = gltf(nodes=nodes)
    del everywhere["scenes"]
    assert len(read_mesh(saved(tmp_path, "b.gltf", json.dumps(everywhere).encode()))[0]) == 12


@pytest.mark.parametrize(("mode", "found"), [(5, [[0, 1, 2], [1, 3, 2]]), (6, [[1, 2, 0], [2, 3, 0]])])
def test_strips_and_fans_are_triangles(tmp_path, mode, found):
    tree = gltf(meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "mode": mode}]}])
    assert read_mesh(saved(tmp_path, "a.gltf", json.dumps(tree).encode()))[1].tolist() == found


def test_a_buffer_may_lie_in_the_binary_chunk_or_in_a_file_below(tmp_path):
    data = XYZ.astype("<f4").tobytes() + FACES.astype("<u2").tobytes()
    xyz, _ = read_mesh(saved(tmp_path, "a.glb", glb(gltf(buffers=[{"byteLength": 60}]), data)))
    np.testing.assert_array_equal(xyz, FLIPPED)
    (tmp_path / "in side").mkdir()
    saved(tmp_path, "in side/a.bin", data)
    tree = gltf(buffers=[{"byteLength": 60, "uri": "in%20side/a.bin"}])
    np.testing.assert_array_equal(read_mesh(saved(tmp_path, "a.gltf", json.dumps(tree).encode()))[0], FLIPPED)


@pytest.mark.parametrize("uri", ["../a.bin", "/etc/hostname", "http://a/b", "sub/../../a.bin", "link", "c:\\a", "a\nb"])
def test_a_buffer_elsewhere_is_refused(tmp_path, uri):
    inner = tmp_path / "inner"
    inner.mkdir()
    saved(tmp_path, "a.bin", bytes(60))
    (inner / "link").symlink_to(tmp_path / "a.bin")
    path = saved(inner, "a.gltf", json.dumps(gltf(buffers=[{"byteLength": 60, "uri": uri}])).encode())
    assert "where a file beside it or below goes" in faults(path)


def accessor(**changes):
    return [gltf()["accessors"][0] | changes, gltf()["accessors"][1]]


def primitive(**changes):
    return [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1} | changes]}]


GLTF_FAULTS = {
    "version '1.0'": gltf(asset={"version": "1.0"}),
    "needs the extension KHR_draco": gltf(extensionsRequired=["KHR_materials_unlit", "KHR_draco_mesh_compression"]),
    "compressed by KHR_draco": gltf(meshes=primitive(extensions={"KHR_draco_mesh_compression": {}})),
    "ends behind its buffer": gltf(accessors=accessor(count=5)),
    "ends behind": gltf(accessors=accessor(count=1 << 31)),
    "of component type 5123": gltf(accessors=accessor(componentType=5123)),
    "sparse": gltf(accessors=accessor(sparse={})),
    "of -1": gltf(accessors=accessor(bufferView=9)),
    "count True": gltf(accessors=accessor(count=True)),
    "count 1.5": gltf(accessors=accessor(count=1.5)),
    "has no POSITION": gltf(meshes=primitive(attributes={})),
    "mode 7": gltf(meshes=primitive(mode=7)),
    "node 0 in two places": gltf(nodes=[{"mesh": 0, "children": [0]}]),
    "refers to nodes 9": gltf(scenes=[{"nodes": [9]}]),
    "skin": gltf(nodes=[{"mesh": 0, "skin": 0}]),
    "rotation of length 2": gltf(nodes=[{"mesh": 0, "rotation": [0, 0, 0, 2]}]),
    "last row": gltf(nodes=[{"mesh": 0, "matrix": [1] * 16}]),
    "scale that is not 3": gltf(nodes=[{"mesh": 0, "scale": [1, 2]}]),
    "not finite": gltf(nodes=[{"children": [1], "scale": [1e200] * 3}, {"mesh": 0, "scale": [1e200] * 3}]),
    "buffer 0 without bytes": gltf(buffers=[{"byteLength": 60}]),
    "where 61 are claimed": gltf(buffers=[gltf()["buffers"][0] | {"byteLength": 61}]),
    "damaged base64": gltf(buffers=[{"byteLength": 60, "uri": "data:application/octet-stream;base64,?"}]),
    "in base64 goes": gltf(buffers=[{"byteLength": 60, "uri": "data:text/plain,abc"}]),
    "scale that is not 3 finite": gltf(nodes=[{"mesh": 0, "scale": [10**400, 1, 1]}]),
    "translation that is not 3": gltf(nodes=[{"mesh": 0, "translation": [True, 1, 1]}]),
    "with weights and targets": gltf(meshes=[primitive(targets=[{}])[0] | {"weights": [0, 0.5]}]),
    "where a file beside it": gltf(buffers=[{"byteLength": 60, "uri": "a%00b"}]),
    "where a file beside it or below": gltf(buffers=[{"byteLength": 60, "uri": "a\ud800"}]),
    "no faces": gltf(nodes=[{}]),
    "3 for each triangle": gltf(accessors=[gltf()["accessors"][0], gltf()["accessors"][1] | {"count": 5}]),
    "no list of objects": gltf(nodes=3),
    "no list of whole": gltf(nodes=[{"mesh": 0, "children": "12"}]),
    "where 12 to 252 go": gltf(bufferViews=[gltf()["bufferViews"][0] | {"byteStride": 4}, gltf()["bufferViews"][1]]),
}
GLTF_FAULTS["refers to bufferViews 9 of 2"] = GLTF_FAULTS.pop("of -1")


@pytest.mark.parametrize("said", GLTF_FAULTS)
def test_each_fault_of_a_gltf_is_named(tmp_path, said):
    assert said in faults(saved(tmp_path, "a.gltf", json.dumps(GLTF_FAULTS[said]).encode()))


def test_weights_of_nought_leave_a_mesh_as_it_is(tmp_path):
    tree = gltf(meshes=[primitive(targets=[{}])[0] | {"weights": [0, 0.0]}])
    assert not faults(saved(tmp_path, "a.gltf", json.dumps(tree).encode()))


@pytest.mark.parametrize("is_chain", [True, False])
def test_each_list_is_checked_once_however_many_nodes_there_are(tmp_path, monkeypatch, is_chain):
    count, checked = 3000, Counter()
    links = [{"children": [k + 1]} for k in range(count - 1)] if is_chain else [{} for _ in range(count - 1)]
    tree = gltf(nodes=[*links, {"mesh": 0}], scenes=[{"nodes": [0] if is_chain else list(range(count))}])
    nodes_of = _gltf_data.nodes_of

    def counted(tree, key):
        checked[key] += 1
        return nodes_of(tree, key)

    monkeypatch.setattr(_gltf_data, "nodes_of", counted)
    assert not faults(saved(tmp_path, "a.gltf", json.dumps(tree).encode()))
    assert set(checked.values()) == {1}


def test_primitives_without_triangles_count_wherever_they_are_placed(tmp_path):
    dots = [{"mode": 0, "attributes": {}}] * 2000
    nodes = [{"mesh": 0}] * 2000
    tree = gltf(meshes=[{"primitives": dots}], nodes=nodes, scenes=[{"nodes": list(range(2000))}])
    assert "where a file of this size may take" in faults(saved(tmp_path, "a.gltf", json.dumps(tree).encode()))


def test_meshes_that_many_nodes_share_have_one_budget(tmp_path):
    nodes = [{"mesh": 0} for _ in range(2000)]
    data = bytes(12 * 60_000)
    accessors = [{"bufferView": 0, "componentType": 5126, "count": 60_000, "type": "VEC3"}]
    tree = gltf(nodes=nodes, accessors=accessors, meshes=[{"primitives": [{"attributes": {"POSITION": 0}}]}])
    tree |= {"scenes": [{"nodes": list(range(2000))}], "bufferViews": [{"buffer": 0, "byteLength": len(data)}]}
    path = saved(tmp_path, "a.glb", glb(tree | {"buffers": [{"byteLength": len(data)}]}, data))
    assert "where a file of this size may take" in faults(path)


FAULTS = [
    ("a.stl", b"short", "has no head of 84 bytes, has 5 bytes"),
    ("a.stl", stl(b"x", 3), "claims 3 triangles, which are 234 bytes, has 184 bytes"),
    ("a.stl", stl(b"x")[:-1], "claims 2 triangles"),
    ("a.stl", stl(b"x", 1 << 31), "claims 2147483648 triangles"),
    ("a.stl", stl().replace(struct.pack("<f", 6), struct.pack("<f", np.nan)), "triangle 1 has a coordinate"),
    ("a.stl", stl_text().replace(b"6.0", b"inf"), "triangle 1 has a coordinate"),
    ("a.stl", stl_text().replace(b"6.0", b"x"), "line 13 holds a word that is no number"),
    ("a.stl", stl_text().replace(b" 6.0", b""), "line 13 has 2 coordinates"),
    ("a.stl", stl_text().replace(b" endloop\n", b"", 1), "line 7 is 'endfacet', where endloop goes"),
    ("a.stl", stl_text()[:-33], "ends within a solid"),
    ("a.stl", b"solid a\n" * 12, "line 2 is 'solid a', where facet or endsolid goes"),
    ("a.stl", b"solid a\nendsolid a\n" * 9, "has 0 vertices and no faces"),
    ("a.off", b"4 2 5\n0 0 0\n", "line 1 begins with '4 2 5', where OFF or COFF goes"),
    ("a.off", b"OFF BINARY\n", "begins with 'OFF BINARY'"),
    ("a.off", b"4OFF\n1 1 1\n", "another dimension than 3"),
    ("a.off", b"OFF\n4 x\n", "where the numbers of vertices and faces go"),
    ("a.off", b"OFF\n0 0 0\n", "has no vertices"),
    ("a.off", OFF.replace(b"4 2 5", b"4 3 5"), "ends after 4 of 4 vertices and 2 of 3 faces"),
    ("a.off", OFF.replace(b"4 2 5", b"4000000000 2 5"), "ends after 6 of 4000000000 vertices"),
    ("a.off", OFF.replace(b"4 2 5", b"4 1 5"), "line 10 stands behind the last of 1 faces"),
    ("a.off", OFF.replace(b"0 1 6", b"0 1 nan"), "line 7 has no three finite"),
    ("a.off", OFF.replace(b"3 0 1 2\n", b"3 0 1\n"), "line 9 is no face"),
    ("a.off", OFF.replace(b"3 0 1 2\n", b"3 0 1 9\n"), "face 0 has corners [0, 1, 9], where 0 to 3 go"),
    ("a.glb", glb(gltf())[:-4], "claims"),
    ("a.glb", b"glTF\1\0\0\0\x10\0\0\0\0\0\0\0", "GLB of version 1"),
    ("a.glb", struct.pack("<4sIII4s", b"glTF", 2, 20, 0, b"BIN\0"), "no JSON in its first chunk"),
    ("a.glb", struct.pack("<4sIII4s", b"glTF", 2, 20, 8, b"JSON"), "ends behind the file"),
    ("a.gltf", b"[" * 100_000, "is not JSON"),
    ("a.gltf", b"[1]", "no object"),
    ("a.gltf", b'{"asset": NaN}', "is not JSON"),
]


@pytest.mark.parametrize(("name", "data", "said"), FAULTS)
def test_each_fault_is_named_in_one_line(tmp_path, name, data, said):
    found = faults(saved(tmp_path, name, data))
    assert said in found
    assert "\n" not in found


@pytest.mark.parametrize("name", ["binary.stl", "text.STL", "a.off", "a.gltf"])
def test_every_truncation_is_seen(tmp_path, name):
    whole = FILES[name]
    for end in range(0, len(whole) - 20, max(len(whole) // 60, 1)):  # behind are colours and a name
        assert faults(saved(tmp_path, name, whole[:end]))


@FUZZ
@given(data=st.data(), name=st.sampled_from(["binary.stl", "text.STL", "a.off", "a.gltf", "a.glb"]))
def test_a_damaged_file_is_a_mesh_or_an_input_error(tmp_path, data, name):
    damaged = bytearray(FILES.get(name) or glb(gltf()))
    for _ in range(data.draw(st.integers(1, 5))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    assert "\n" not in faults(saved(tmp_path, name, bytes(damaged)))


PLAIN = st.none() | st.booleans() | st.integers(-2, 1 << 33) | st.floats() | st.text(max_size=4)
ANY = st.recursive(
    PLAIN, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=2)
)


@FUZZ
@given(data=st.data())
def test_a_gltf_with_another_value_anywhere_is_a_mesh_or_an_input_error(tmp_path, data):
    tree = gltf()
    node = tree
    while True:
        key = data.draw(st.sampled_from(sorted(node) if isinstance(node, dict) else list(range(len(node)))))
        inner = node[key]
        if not isinstance(inner, dict | list) or not inner or data.draw(st.booleans()):
            node[key] = data.draw(ANY)
            break
        node = inner
    assert "\n" not in faults(saved(tmp_path, "a.gltf", json.dumps(tree).encode()))
