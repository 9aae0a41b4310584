"""Binary glTF: what is drawn reads back, in trimesh and by the letter of the specification."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tspslam import InputError, Rig
from tspslam.io.glb import Drawn, write_glb

RIG = Rig(fx=80, fy=70, cx=45, cy=30, baseline=0.3, width=90, height=60)
SIZES = {5121: 1, 5123: 2, 5125: 4, 5126: 4}
DTYPES = {5123: "<u2", 5125: "<u4", 5126: "<f4"}
COMPONENTS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
rng = np.random.default_rng(5)
XYZ, RGB = rng.normal(size=(6, 3)) * 100, rng.integers(0, 256, (6, 3)).astype(np.uint8)
ROWS = np.array([[0, 1, 2], [0, 2, 3], [5, 4, 0]], np.int32)
ALL = [
    Drawn("shared", "triangles", XYZ, RGB, ROWS), Drawn("apart", "triangles", XYZ, RGB), Drawn("lines", "lines", XYZ, RGB),
    Drawn("points", "points", XYZ, RGB), Drawn("some", "points", XYZ, RGB, np.array([1, 4])),
]  # fmt: skip


def pose(seed=0):
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = 1, -2, 3
    return T


def parsed(path):
    """The JSON tree and the binary chunk, after the container was held against the specification, section 4.4."""
    data = Path(path).read_bytes()
    assert struct.unpack("<4sII", data[:12]) == (b"glTF", 2, len(data))
    assert len(data) % 4 == 0
    chunks, at = [], 12
    while at < len(data):
        length, kind = struct.unpack("<I4s", data[at : at + 8])
        assert length % 4 == 0
        chunks.append((kind, data[at + 8 : at + 8 + length]))
        at += 8 + length
    assert [kind for kind, _ in chunks] in ([b"JSON"], [b"JSON", b"BIN\0"])
    return json.loads(chunks[0][1].decode("utf-8")), chunks[1][1] if len(chunks) > 1 else b""


def values_of(tree, binary, number):
    accessor = tree["accessors"][number]
    view = tree["bufferViews"][accessor["bufferView"]]
    data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    return np.frombuffer(data, DTYPES[accessor["componentType"]]).reshape(
        accessor["count"], COMPONENTS[accessor["type"]]
    )


def assert_sound(tree, binary):
    """What glTF 2.0 asks of the lists: none is empty, what is named is there, arrays fit, are aligned and in their limits."""
    assert tree["asset"]["version"] == "2.0"
    assert all(value for value in tree.values() if isinstance(value, list))
    assert set(tree.get("extensionsUsed", ())) <= {"KHR_materials_unlit"}
    if tree.get("buffers"):
        assert 0 <= len(binary) - tree["buffers"][0]["byteLength"] < 4
    at = 0
    for view in tree.get("bufferViews", ()):
        assert (view["byteOffset"], view["byteOffset"] % 4, view["buffer"]) == (at, 0, 0)
        at += view["byteLength"]
    for number, accessor in enumerate(tree.get("accessors", ())):
        values, view = values_of(tree, binary, number), tree["bufferViews"][accessor["bufferView"]]
        size = SIZES[accessor["componentType"]] * COMPONENTS[accessor["type"]]
        assert (size % 4, accessor["count"] > 0, view["byteLength"]) == (0, True, size * accessor["count"])
        if "min" in accessor:
            assert np.array_equal(np.float32(accessor["min"]), values.min(axis=0))
            assert np.array_equal(np.float32(accessor["max"]), values.max(axis=0))
    for mesh in tree.get("meshes", ()):
        assert_sound_primitive(tree, binary, mesh["primitives"][0])
    roots = tree["scenes"][tree["scene"]].get("nodes", [])
    assert roots == list(range(len(tree.get("nodes", []))))
    for node in tree.get("nodes", ()):
        assert node.get("mesh", 0) < len(tree.get("meshes", [0]))
        if "rotation" in node:
            assert np.linalg.norm(node["rotation"]) == pytest.approx(1, abs=1e-12)
            assert "perspective" in tree["cameras"][node["camera"]]


def assert_sound_primitive(tree, binary, primitive):
    position, colour = (tree["accessors"][primitive["attributes"][name]] for name in ("POSITION", "COLOR_0"))
    assert position["count"] == colour["count"]
    assert {"min", "max"} <= position.keys()
    assert (colour["normalized"], colour["componentType"], colour["type"]) == (True, 5123, "VEC4")
    assert tree["materials"][primitive["material"]]["extensions"] == {"KHR_materials_unlit": {}}
    count = position["count"]
    if "indices" in primitive:
        rows = values_of(tree, binary, primitive["indices"])
        assert (tree["accessors"][primitive["indices"]]["type"], rows.max() < count) == ("SCALAR", True)
        count = len(rows)
    assert count % {0: 1, 1: 2, 4: 3}[primitive["mode"]] == 0


def to_bytes(light):
    """Linear light, 16 bits, as sRGB bytes."""
    x = light / 65535
    return np.rint(255 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)).astype(np.uint8)


def test_a_file_is_what_the_specification_asks(tmp_path):
    write_glb(tmp_path / "a.glb", ALL, RIG, {"keyframe 000007": pose(), "Straße": pose(1)}, extras={"layer": "x"})
    tree, binary = parsed(tmp_path / "a.glb")
    assert_sound(tree, binary)
    assert [node["name"] for node in tree["nodes"]] == [*(each.name for each in ALL), "keyframe 000007", "Straße"]
    assert tree["asset"]["extras"] == {"layer": "x"}


def test_places_are_turned_half_around_x_and_colours_read_back_exactly(tmp_path):
    write_glb(tmp_path / "a.glb", ALL)
    tree, binary = parsed(tmp_path / "a.glb")
    for mesh, each in zip(tree["meshes"], ALL, strict=True):
        made = mesh["primitives"][0]
        xyz, light = (values_of(tree, binary, made["attributes"][name]) for name in ("POSITION", "COLOR_0"))
        assert np.array_equal(xyz, (each.xyz * (1, -1, -1)).astype(np.float32))
        assert np.array_equal(to_bytes(light[:, :3]), each.rgb)
        assert (light[:, 3] == 65535).all()


def test_numbers_of_vertices_become_attributes_and_a_node_stands_where_it_is_told(tmp_path):
    size, at = np.linspace(0, 3, 6), np.array([4.3e5, -5.4e6, 7.0])
    write_glb(tmp_path / "a.glb", [Drawn("one", "triangles", XYZ, RGB, ROWS, values={"size": size}, at=at)])
    tree, binary = parsed(tmp_path / "a.glb")
    assert_sound(tree, binary)
    found = values_of(tree, binary, tree["meshes"][0]["primitives"][0]["attributes"]["_SIZE"])
    assert np.array_equal(found.ravel(), size.astype(np.float32))
    assert tree["nodes"][0]["translation"] == [4.3e5, 5.4e6, -7.0]


def test_every_byte_of_srgb_survives_as_linear_light(tmp_path):
    grey = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
    write_glb(tmp_path / "a.glb", [Drawn("all", "points", np.zeros((256, 3)), grey)])
    tree, binary = parsed(tmp_path / "a.glb")
    light = values_of(tree, binary, 1)[:, :3]
    assert (to_bytes(light) == grey).all()
    assert (np.diff(light[:, 0].astype(int)) > 0).all()
    assert light[188, 0] / 65535 == pytest.approx(0.5029, abs=1e-4)  # half of the light looks three quarters bright


def test_trimesh_reads_the_same_geometry_and_colours(tmp_path):
    import trimesh

    write_glb(tmp_path / "a.glb", ALL, RIG, {"first": np.eye(4), "second": pose()})  # one of them gets the lens' name
    scene = trimesh.load_scene(tmp_path / "a.glb", process=False)
    turned = (XYZ * (1, -1, -1)).astype(np.float32)
    shared, apart = scene.geometry["shared"], scene.geometry["apart"]
    assert np.array_equal(shared.vertices, turned)
    assert np.array_equal(shared.faces, ROWS)
    assert np.array_equal(to_bytes(shared.visual.vertex_attributes["color"][:, :3]), RGB)
    assert np.array_equal(apart.vertices[apart.faces.ravel()], turned)
    assert np.array_equal(scene.geometry["points"].vertices, turned)
    assert np.array_equal(scene.geometry["lines"].vertices, turned)
    turn = np.diag([1.0, -1, -1, 1])
    found = [scene.graph[name][0] for name in ("first", "second", "left camera") if name in scene.graph.nodes]
    assert len(found) == 2
    assert any(np.allclose(T, turn @ pose() @ turn, rtol=0, atol=1e-12) for T in found)


def test_a_camera_sees_what_the_keyframe_saw(tmp_path):
    """A point projects to the same share of the image by the file's camera as by the rig with its centre in the middle."""
    write_glb(tmp_path / "a.glb", ALL[:1], RIG, {"one": pose()})
    tree, _ = parsed(tmp_path / "a.glb")
    node, lens = tree["nodes"][-1], tree["cameras"][0]["perspective"]
    from scipy.spatial.transform import Rotation

    point = pose()[:3, :3] @ (0.4, -0.3, 2.0) + pose()[:3, 3]  # in the world; in the keyframe right, up, forward
    seen = Rotation.from_quat(node["rotation"]).inv().apply(point * (1, -1, -1) - node["translation"])
    half = np.tan(lens["yfov"] / 2)
    x, y = seen[0] / -seen[2] / (half * lens["aspectRatio"]), seen[1] / -seen[2] / half
    assert x == pytest.approx(0.4 / 2 * RIG.fx / (RIG.width / 2))
    assert y == pytest.approx(0.3 / 2 * RIG.fy / (RIG.height / 2))


def test_equal_things_give_equal_bytes(tmp_path):
    for name in ("a", "b"):
        write_glb(tmp_path / f"{name}.glb", ALL, RIG, {"one": pose()})
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


@pytest.mark.parametrize("drawn", [[], [Drawn("none", "triangles", np.zeros((0, 3)), np.zeros((0, 3), np.uint8))],
                                   [Drawn("no row", "triangles", XYZ, RGB, ROWS[:0])]])  # fmt: skip
@pytest.mark.parametrize("cameras", [{}, {"one": np.eye(4)}])
def test_what_has_no_element_is_left_out_and_the_file_is_sound(tmp_path, drawn, cameras):
    write_glb(tmp_path / "a.glb", drawn, RIG, cameras)
    tree, binary = parsed(tmp_path / "a.glb")
    assert_sound(tree, binary)
    assert (binary, len(tree.get("nodes", []))) == (b"", len(cameras))
    assert not {"meshes", "buffers", "materials", "extensionsUsed"} & tree.keys()


BAD = {
    "places that are no triples": ([Drawn("x", "points", XYZ[:, :2], RGB)], "x has places"),
    "colours of another type": ([Drawn("x", "points", XYZ, RGB / 255)], "uint8"),
    "fewer colours": ([Drawn("x", "points", XYZ, RGB[1:])], "colours uint8"),
    "two thirds of a triangle": ([Drawn("x", "triangles", XYZ[:5], RGB[:5])], "5 vertices; expected 3 for each"),
    "pairs for triangles": ([Drawn("x", "triangles", XYZ, RGB, ROWS[:, :2])], r"shape \(3, 2\)"),
    "numbers for triangles": ([Drawn("x", "triangles", XYZ, RGB, ROWS.ravel())], r"shape \(9,\)"),
    "a row beyond": ([Drawn("x", "triangles", XYZ, RGB, ROWS + 1)], "rows 1 to 6; expected 0 to 5"),
    "NaN": ([Drawn("x", "points", XYZ * np.nan, RGB)], "not finite"),
    "fewer numbers": (
        [Drawn("x", "points", XYZ, RGB, values={"a": np.zeros(5)})],
        r"a of shape \(5,\); expected \(6,\)",
    ),
    "numbers that are none": ([Drawn("x", "points", XYZ, RGB, values={"a": np.full(6, np.nan)})], "finite as float32"),
    "numbers beyond float32": ([Drawn("x", "points", XYZ, RGB, values={"a": np.full(6, 1e39)})], "finite as float32"),
    "nowhere": ([Drawn("x", "points", XYZ, RGB, at=np.full(3, np.inf))], "x stands at"),
    "beyond float32": ([Drawn("x", "points", XYZ * 1e60, RGB)], "not finite or too large"),
}


@pytest.mark.parametrize(("drawn", "said"), BAD.values(), ids=BAD)
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_what_does_not_fit_is_refused_in_a_line(tmp_path, drawn, said):
    with pytest.raises(InputError, match=said):
        write_glb(tmp_path / "a.glb", drawn)
    assert not list(tmp_path.iterdir())


def test_a_pose_that_is_no_motion_and_cameras_without_a_rig_are_refused(tmp_path):
    for T in (2 * np.eye(4), np.full((4, 4), np.nan), np.eye(3)):
        with pytest.raises(InputError, match="pose of one is no rigid motion"):
            write_glb(tmp_path / "a.glb", [], RIG, {"one": T})
    with pytest.raises(InputError, match="cameras without a rig"):
        write_glb(tmp_path / "a.glb", [], None, {"one": np.eye(4)})


def test_a_file_beyond_what_the_format_counts_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("tspslam.io.glb._LARGEST", 1000)
    with pytest.raises(InputError, match="at most 1000"):
        write_glb(tmp_path / "a.glb", ALL)


VALIDATE = """
const validator = require("gltf-validator");
const data = new Uint8Array(require("fs").readFileSync(process.argv[1]));
validator.validateBytes(data).then((found) => console.log(JSON.stringify(found.issues)));
"""


def has_validator():
    return (
        shutil.which("node")
        and not subprocess.run(["node", "-e", "require('gltf-validator')"], capture_output=True).returncode
    )


def test_the_validator_of_khronos_finds_nothing(tmp_path):
    if not has_validator():
        pytest.skip(
            "node with the module gltf-validator is not installed: npm install gltf-validator, NODE_PATH=its place"
        )
    more = Drawn("far", "points", XYZ, RGB, values={"size": XYZ[:, 0]}, at=np.full(3, 1e6))
    cameras = {"keyframe 000007": pose(), "one": np.eye(4)}
    write_glb(tmp_path / "a.glb", [*ALL, more], RIG, cameras, extras={"span": [0.0, 1.0]})
    write_glb(tmp_path / "b.glb", [])
    for name in ("a.glb", "b.glb"):
        words = ["node", "-e", VALIDATE, str(tmp_path / name)]
        found = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
        assert [found[key] for key in ("numErrors", "numWarnings", "numInfos", "numHints")] == [0, 0, 0, 0], found
