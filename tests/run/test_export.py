"""Exports of a run: other programs' own readers find in them what the run holds, and nothing else is touched."""

import ast
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.io.test_glb import assert_sound, parsed, to_bytes, values_of
from tests.io.test_io_frames import frame
from tests.test_cli import complain, content, type_in
from tests.view.view_maps import ODD_MAPS
from tspslam import InputError, StereoPair, cli, load_map, load_run
from tspslam.io import RunFolder, read_vtu, write_frame, write_map
from tspslam.io.tensors import read_tensors, tensors_of
from tspslam.run.config import resolve
from tspslam.run.export import FORMATS, export
from tspslam.run.pipeline import OnePair, run
from tspslam.topological_map import Levels
from tspslam.view._layers import BARE, colours_of, layers_of_frame, layers_of_map

from ..patience import PATIENCE
from ..sequences import SETTINGS, SMALL_RIG, corridor

NEEDS = {"las": "laspy", "laz": "lazrs"}
TURN = np.array([1, -1, -1])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "walk"
    run(corridor(4.0, SMALL_RIG), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture(scope="module")
def pair_folder(tmp_path_factory, small_pair):
    out = tmp_path_factory.mktemp("pair") / "pair"
    run(OnePair(StereoPair(*small_pair)), out, resolve())
    return out


def made(run, to, folder, **options):
    """Export, if the packages for it are there; the path."""
    if to in NEEDS:
        pytest.importorskip(NEEDS[to], reason=f"{NEEDS[to]} is not installed: pip install 'tspslam[las]'")
    return export(run, to, folder / f"out{FORMATS[to].suffix}", **options)


def geometry(path):
    """Vertices in our axes, and colours as bytes, of each mesh of a glTF file by name."""
    tree, binary = parsed(path)
    assert_sound(tree, binary)
    found = {}
    for mesh in tree.get("meshes", ()):
        primitive = mesh["primitives"][0]
        xyz, light = (values_of(tree, binary, primitive["attributes"][name]) for name in ("POSITION", "COLOR_0"))
        rows = values_of(tree, binary, primitive["indices"]) if "indices" in primitive else None
        found[mesh["name"]] = xyz * TURN, to_bytes(light[:, :3]), rows
    return tree, found


@pytest.mark.parametrize("to", [to for to in FORMATS if to != "rrd"])  # rerun stamps its rows
def test_equal_runs_give_equal_bytes_and_the_run_is_as_it_was(folder, tmp_path, to):
    before = content(folder)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        made(folder, to, tmp_path / name)
    assert content(tmp_path / "a") == content(tmp_path / "b") != {}
    assert content(folder) == before


def test_a_scene_has_each_face_in_its_colour_the_path_and_the_keyframes(folder, tmp_path):
    tree, found = geometry(made(folder, "glb", tmp_path))
    map_, walk = load_map(folder), load_run(folder)
    xyz, rgb, rows = found["faces"]
    assert rows is None
    np.testing.assert_array_equal(xyz.reshape(-1, 3, 3), map_.xyz[map_.surface.faces].astype(np.float32))
    np.testing.assert_array_equal(rgb, np.repeat(colours_of(layers_of_map(map_)[0]), 3, axis=0))
    ends = found["path"][0].reshape(-1, 2, 3)
    places = walk.trajectory.T_world_camera[:, :3, 3].astype(np.float32)
    assert len(ends) == len(places) - 1
    np.testing.assert_array_equal(ends[0, 0], places[0])
    np.testing.assert_array_equal(ends[-1, 1], places[-1])
    named = [node for node in tree["nodes"] if "camera" in node]
    assert [node["name"] for node in named] == [f"keyframe {k:06d}" for k in walk.keyframes]
    np.testing.assert_allclose([node["translation"] for node in named], map_.T_world_camera[:, :3, 3] * TURN)
    assert (
        tree["asset"]["extras"] | {"layer": "face_signal", "level": "face", "axes": "x right, y up, z back"}
        == (tree["asset"]["extras"])
    )


def test_faces_look_at_the_cameras_in_a_scene_too(folder, tmp_path):
    _, found = geometry(made(folder, "glb", tmp_path))
    corners = (found["faces"][0] * TURN).reshape(-1, 3, 3)  # as they stand in the file
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    map_ = load_map(folder)
    view = np.maximum(map_.best_view.face, 0)
    eyes = map_.T_world_camera[view, :3, 3] * TURN
    facing = ((eyes - corners.mean(axis=1)) * normals).sum(axis=1) > 0
    assert facing[map_.best_view.face >= 0].all()


def test_every_layer_of_a_map_and_of_a_frame_gives_its_colours(folder, tmp_path):
    shown = load_map(folder), load_run(folder).frame(0)
    for number, layers in ((None, layers_of_map(shown[0])), (0, layers_of_frame(shown[1]))):
        for layer in layers:
            path = made(folder, "glb", tmp_path, frame=number, layer=layer.name)
            tree, found = geometry(path)
            assert tree["asset"]["extras"]["layer"] == layer.name
            rgb, one = colours_of(layer), shown[0] if number is None else shown[1]
            if layer.level == "edge":
                ends = found["edges"][0].reshape(-1, 2, 3)
                xyz = one.xyz if number is None else one.cloud.xyz
                np.testing.assert_array_equal(ends, xyz[one.complex_.edges].astype(np.float32))
                np.testing.assert_array_equal(found["edges"][1], np.repeat(rgb, 2, axis=0))
                assert "faces" not in found
            elif layer.level == "vertex":
                np.testing.assert_array_equal(found["faces"][1], rgb)
                np.testing.assert_array_equal(found["faces"][2].reshape(-1, 3), one.surface.faces)
                loose = np.setdiff1d(np.arange(len(rgb)), one.surface.faces)
                assert len(found.get("vertices without a face", [loose])[0]) == len(loose)
            else:
                np.testing.assert_array_equal(found["faces"][1], np.repeat(rgb, 3, axis=0))


def grid(path):
    """What our reader and meshio find in a VTU file, held against each other."""
    import meshio

    ours = read_vtu(path)
    if not len(ours.edges):  # meshio knows no array without a block
        return ours
    theirs = meshio.read(path)
    np.testing.assert_array_equal(theirs.points, ours.xyz)
    cells = {block.type: block.data for block in theirs.cells}
    np.testing.assert_array_equal(cells.get("line", np.empty((0, 2))), ours.edges)
    np.testing.assert_array_equal(cells.get("triangle", np.empty((0, 3))), ours.faces)
    for name, values in ours.point_data.items():
        np.testing.assert_array_equal(theirs.point_data[name], values)
    return ours


def test_a_series_holds_each_keyframe_in_the_world_at_its_time(folder, tmp_path):
    out, walk = made(folder, "pvd", tmp_path), load_run(folder)
    sets = ET.parse(out / "series.pvd").getroot().findall("Collection/DataSet")
    assert [each.get("file") for each in sets] == [f"frames/{k:06d}.vtu" for k in walk.keyframes]
    for each, number in zip(sets, walk.keyframes, strict=True):
        one, T = walk.frame(number), walk.pose(number)
        assert float(each.get("timestep")) == one.stamp - walk.trajectory.stamp[0]
        found = grid(out / each.get("file"))
        np.testing.assert_allclose(found.xyz, one.cloud.xyz @ T[:3, :3].T + T[:3, 3], atol=1e-12)
        np.testing.assert_array_equal(found.point_data["depth"], one.cloud.xyz[:, 2])
        np.testing.assert_array_equal(found.point_data["response_real"], one.response.z.real)
        np.testing.assert_array_equal(found.cell_data["luminance"], np.append(one.signals.edge, one.signals.face))


def test_a_series_has_the_map_and_the_path_beside_it(folder, tmp_path):
    out, walk = made(folder, "pvd", tmp_path), load_run(folder)
    np.testing.assert_array_equal(grid(out / "map.vtu").xyz, load_map(folder).xyz)
    path = grid(out / "path.vtu")
    T = walk.trajectory.T_world_camera
    np.testing.assert_array_equal(path.xyz, T[:, :3, 3])
    np.testing.assert_array_equal(path.edges, np.stack([np.arange(len(T) - 1), np.arange(1, len(T))], axis=1))
    np.testing.assert_array_equal(path.point_data["forward"], T[:, :3, 2])
    np.testing.assert_array_equal(path.point_data["stamp"], walk.trajectory.stamp)
    np.testing.assert_array_equal(path.point_data["frame"], np.arange(len(T)))
    assert np.flatnonzero(path.point_data["is_keyframe"]).tolist() == list(walk.keyframes)


def test_a_run_without_a_map_shows_its_first_frame_in_its_place(folder, tmp_path):
    bare = shutil.copytree(folder, tmp_path / "bare")
    (bare / "map.npz").unlink()
    lines = (bare / "manifest.jsonl").read_text().splitlines(keepends=True)
    (bare / "manifest.jsonl").write_text("".join(line for line in lines if '"map.npz"' not in line))
    out, walk = made(bare, "pvd", tmp_path), load_run(folder)
    np.testing.assert_array_equal(grid(out / "map.vtu").xyz, walk.frame(0).cloud.xyz)
    assert len(list((out / "frames").iterdir())) == len(walk.keyframes)
    with pytest.raises(InputError, match="has no map of its keyframes; expected --frame"):
        export(bare, "glb", tmp_path / "a.glb")


def test_a_mesh_that_was_filtered_is_exported_though_it_has_no_path(pair_folder, pair_files, tmp_path):
    mesh = export(pair_folder, "ply", tmp_path / "mesh.ply")
    words = ["filter", mesh, "--image", pair_files / "left.png", "--calib", pair_files / "calib.yaml"]
    assert cli.exit_code([str(word) for word in [*words, "--out", tmp_path / "filtered"]]) == 0
    out = export(tmp_path / "filtered", "pvd", tmp_path / "out")
    assert len(grid(out / "path.vtu").xyz) == len(list((out / "frames").iterdir())) == 1
    assert len(grid(out / "map.vtu").faces) > 100
    assert list(geometry(export(tmp_path / "filtered", "glb", tmp_path / "a.glb"))[1]) == ["faces"]


def test_the_state_is_a_program_that_names_files_beside_it_and_columns_in_them(folder, tmp_path):
    out = made(folder, "pvd", tmp_path)
    text = (out / "state.py").read_text(encoding="utf-8")
    words = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
    files = {word for word in words if isinstance(word, str) and re.fullmatch(r"\S+\.(vtu|pvd)", word)}
    assert files == {"map.vtu", "path.vtu", "series.pvd"}
    assert all((out / name).is_file() for name in files)
    assert str(tmp_path) not in text
    assert {"dim", "luminance", "ok"} <= set(read_vtu(out / "map.vtu").cell_data)


def test_paraview_opens_the_state(folder, tmp_path):
    if not shutil.which("pvbatch") or not (os.environ.get("DISPLAY") or shutil.which("xvfb-run")):
        pytest.skip("ParaView's pvbatch, or a display for it, is not there: apt-get install paraview xvfb")
    out = made(folder, "pvd", tmp_path)
    words = ["pvbatch", str(out / "state.py"), str(tmp_path / "seen.png")]
    words = words if os.environ.get("DISPLAY") else ["xvfb-run", "-a", *words]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    subprocess.run(words, check=True, capture_output=True, timeout=PATIENCE, env=environment, cwd="/")
    with Image.open(tmp_path / "seen.png") as picture:
        seen = np.asarray(picture.convert("RGB"), float)
    assert seen.std() > 10  # something is drawn


@pytest.mark.parametrize("to", ["las", "laz"])
def test_a_cloud_is_the_map_s_vertices_with_what_is_known_of_them(folder, tmp_path, to):
    path = made(folder, to, tmp_path)
    import laspy

    found, map_ = laspy.read(path), load_map(folder)
    xyz = np.stack([np.asarray(found.x), -np.asarray(found.z), np.asarray(found.y)], axis=1)
    assert np.abs(xyz - map_.xyz).max() <= 0.5e-4 * (1 + 1e-6)
    assert np.array_equal(found.intensity, np.rint(65535 * np.clip(map_.signals.vertex, 0, 1)))
    for name, values in {
        "magnitude": map_.response.magnitude, "phase": map_.response.phase, "views": map_.view_count.vertex,
        "landmark_id": map_.landmark_id, "has_response": map_.defined, "has_luminance": map_.signals.vertex_ok,
        "luminance": map_.signals.vertex,
    }.items():  # fmt: skip
        np.testing.assert_allclose(found[name], values, rtol=1e-6, err_msg=name)
    assert "red" not in found.point_format.dimension_names


def test_a_cloud_has_the_colours_of_the_layer_that_was_named(folder, tmp_path, capsys):
    path = made(folder, "las", tmp_path, layer="magnitude", frame=0)
    import laspy

    found, one = laspy.read(path), load_run(folder).frame(0)
    rgb = next(colours_of(layer) for layer in layers_of_frame(one) if layer.name == "magnitude")
    assert np.array_equal(np.stack([found.red, found.green, found.blue], axis=1), rgb.astype(int) * 257)
    assert np.array_equal(found.landmark_id, one.landmark)
    words = ["export", folder, "--to", "las", "--output", tmp_path / "b.las", "--layer"]
    code, line = complain(capsys, *words, "face_signal")
    assert (code, "is not of vertices" in line) == (3, True)
    code, line = complain(capsys, *words, "colour")
    assert (code, "has no layer 'colour'; expected one of face_signal, edge_signal" in line) == (3, True)


def test_tensors_are_those_of_the_map_and_of_a_frame(folder, tmp_path):
    for number in (None, 0):
        found = read_tensors(made(folder, "tensors", tmp_path, frame=number))
        shown = load_map(folder) if number is None else load_run(folder).frame(0)
        expected = tensors_of(shown)
        assert found.keys() == expected.keys()
        assert all(np.array_equal(found[name], values) for name, values in expected.items())


@pytest.mark.parametrize("to", FORMATS)
def test_a_run_of_one_pair_is_exported_too(pair_folder, tmp_path, to):
    path = made(pair_folder, to, tmp_path)
    assert path.exists()
    if to == "pvd":
        assert len(grid(path / "map.vtu").faces) == len(grid(path / "frames/000000.vtu").faces) > 100
        assert len(grid(path / "path.vtu").xyz) == 1
    if to == "glb":
        tree, found = geometry(path)
        assert (list(found), tree["nodes"][-1]["name"]) == (["faces"], "frame 000000")


def stored(folder, map_, one=None):
    """A finished run with that map."""
    with RunFolder.create(folder, {}) as made:
        write_frame(made.frame_path(12), one or frame())
        write_map(made.map_npz_path, map_)
        row = {"index": 12, "stamp": 0.1, "is_keyframe": True}
        T = map_.T_world_camera[0]
        record = {"status": "complete", "frames": 1, "per_frame": [row]}
        for path in (
            made.frame_path(12),
            made.map_npz_path,
            *made.write_trajectory([0.1], T[None]),
            made.write_run(record),
        ):
            made.record(path, input_hash="")
    return folder


@pytest.mark.parametrize("name", [name for name in ODD_MAPS if name not in ("colours", "one keyframe")])
@pytest.mark.parametrize("to", ["glb", "las", "tensors", "pvd"])
@pytest.mark.filterwarnings("error")
def test_odd_maps_are_exported(tmp_path, name, to):
    map_ = ODD_MAPS[name]()
    path = made(stored(tmp_path / "run", map_), to, tmp_path)
    if to == "glb":
        tree, found = geometry(path)
        assert ("faces" in found) == (len(map_.surface.faces) > 0)
        assert len([node for node in tree["nodes"] if "camera" in node]) == len(map_.keyframes)
    elif to == "pvd":
        assert len(grid(path / "map.vtu").faces) == len(map_.surface.faces)


def test_a_map_without_a_layer_is_drawn_bare(tmp_path):
    map_ = ODD_MAPS["all marked"]()
    unseen = replace(map_, best_view=Levels(*(np.full_like(view, -1) for view in map_.best_view)))
    assert not layers_of_map(unseen)
    tree, found = geometry(export(stored(tmp_path / "run", unseen), "glb", tmp_path / "a.glb"))
    assert (found["faces"][1] == BARE).all()
    assert "layer" not in tree["asset"]["extras"]
    with pytest.raises(InputError, match="has no layer 'depth'; expected no layer: it has none"):
        export(tmp_path / "run", "glb", tmp_path / "a.glb", layer="depth")


@pytest.mark.parametrize("to", ["glb", "las", "tensors", "pvd"])
def test_a_frame_of_three_channels_keeps_its_colours(tmp_path, to):
    three = frame((3,))
    signals = replace(
        three.signals, **{x: np.clip(abs(getattr(three.signals, x)), 0, 1) for x in ("vertex", "edge", "face")}
    )
    run = stored(tmp_path / "run", ODD_MAPS["wall"](), replace(three, signals=signals))
    path = made(run, to, tmp_path, frame=None if to == "pvd" else 12)
    if to == "glb":
        rgb = np.rint(255 * signals.face).astype(np.uint8)
        rgb[~signals.face_ok] = BARE
        np.testing.assert_array_equal(geometry(path)[1]["faces"][1], np.repeat(rgb, 3, axis=0))
    if to == "las":
        import laspy

        assert np.array_equal(laspy.read(path).red, 257 * np.rint(255 * signals.vertex[:, 0]))


def test_a_folder_is_written_anew_by_force_alone_and_never_over_something_else(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["export", folder, "--to", "pvd"]
    assert type_in(capsys, *words)[:2] == (0, "wrote walk-pvd\n")
    code, line = complain(capsys, *words)
    assert (code, "walk-pvd: is there; expected a free name, or --force" in line) == (3, True)
    assert type_in(capsys, *words, "--force")[0] == 0
    Path("walk-pvd/mine.txt").write_text("mine")
    before = content(tmp_path)
    code, line = complain(capsys, *words, "--force")
    assert (code, "holds mine.txt, which no export wrote" in line) == (3, True)
    assert content(tmp_path) == before


def test_an_export_is_never_in_the_run_nor_around_it(folder, tmp_path, capsys):
    before = content(folder.parent)
    for output in (folder, folder / "pvd", folder / "frames" / "pvd", folder.parent):
        for more in ([], ["--force"]):
            assert complain(capsys, "export", folder, "--to", "pvd", "--output", output, *more)[0] == 3
    for to in ("glb", "las", "tensors"):
        output = folder / f"new{FORMATS[to].suffix}"
        assert complain(capsys, "export", folder, "--to", to, "--output", output, "--force")[0] == 3
    assert content(folder.parent) == before


@pytest.mark.parametrize("to", [name for name, each in FORMATS.items() if each.kind and name not in NEEDS])
def test_a_file_of_another_kind_is_overwritten_by_force_alone(folder, tmp_path, capsys, to):
    output = tmp_path / f"a{FORMATS[to].suffix}"
    output.write_bytes(b"mine")
    words = ["export", folder, "--to", to, "--output", output]
    assert complain(capsys, *words)[0] == 3
    assert output.read_bytes() == b"mine"
    for more in (["--force"], [], ["--force", "--json"]):
        code, said, _ = type_in(capsys, *words, *more)
        assert code == 0
    assert json.loads(said) == {"written": str(output)}


def test_default_names_tell_the_formats_apart(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = [str(export(folder, to)) for to in FORMATS if to not in NEEDS]
    of_maps = ["walk-map.vtu", "walk-map.ply", "walk-map.npz", "walk-map.glb", "walk-pvd", "walk-map-tensors.npz"]
    assert names == [*of_maps, "walk-colmap", "walk-nerfstudio", "walk.rrd", "walk-bag"]
    assert str(export(folder, "glb", frame=0)) == "walk-000000.glb"


@pytest.mark.parametrize(("words", "said"), [
    (["--to", "pvd", "--frame", "0"], "pvd is of the whole run"), (["--to", "ply", "--layer", "depth"], "for glb, las, laz"),
    (["--to", "glb", "--output", "a.gltf"], "expected .glb"), (["--to", "las", "--output", "a.laz"], "expected .las"),
])  # fmt: skip
def test_options_that_do_not_go_together_are_code_2(folder, capsys, words, said):
    code, line = complain(capsys, "export", folder, *words)
    assert (code, said in line) == (2, True)


def test_the_help_names_every_format(capsys):
    cli.exit_code(["export", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert not [name for name in FORMATS if not re.search(rf"\b{name}\b", said)]


def test_a_package_that_is_missing_is_code_3_and_says_what_to_install(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    code, line = complain(capsys, "export", folder, "--to", "las", "--output", tmp_path / "a.las")
    assert (code, line.strip().endswith("pip install 'tspslam[las]'")) == (3, True)


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit there")
@pytest.mark.parametrize("to", ["glb", "pvd"])
def test_a_full_disk_is_code_5_and_leaves_nothing(folder, tmp_path, to):
    script = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (5000, resource.RLIM_INFINITY));"
        "from tspslam import cli; sys.exit(cli.exit_code(sys.argv[1:]))"
    )
    words = ["export", str(folder), "--to", to, "--output", f"out{FORMATS[to].suffix}"]
    done = subprocess.run([sys.executable, "-c", script, *words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 5, done.stderr
    assert re.fullmatch(r"tspslam: out\S*: cannot be written \(.*\); expected .*\n", done.stderr)
    assert not list(tmp_path.iterdir())


def test_a_file_of_the_run_that_was_changed_is_named(folder, tmp_path, capsys):
    broken = tmp_path / "broken"
    shutil.copytree(folder, broken)
    number = load_run(folder).keyframes[1]
    (broken / f"frames/{number:06d}.npz").write_bytes(b"something else")
    code, line = complain(capsys, "export", broken, "--to", "pvd", "--output", tmp_path / "out")
    assert (code, f"{number:06d}.npz: is missing or was changed" in line) == (3, True)
    assert not (tmp_path / "out").exists()
    with pytest.raises(InputError):
        export(tmp_path / "none", "glb")


@pytest.mark.parametrize("to", list(FORMATS))
def test_a_map_that_the_run_had_and_that_is_gone_is_missed(folder, tmp_path, capsys, to):
    broken = shutil.copytree(folder, tmp_path / "broken", ignore=shutil.ignore_patterns("frames"))
    (broken / "map.npz").unlink()
    code, line = complain(capsys, "export", broken, "--to", to, "--output", tmp_path / f"out{FORMATS[to].suffix}")
    assert code == 3
    assert "map.npz: is missing or was changed since the run" in line


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX'")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_what_an_interruption_leaves_is_nothing(folder, tmp_path, name):
    command = [
        sys.executable,
        "-m",
        "tspslam",
        "export",
        str(folder),
        "--to",
        "colmap",
        "--output",
        str(tmp_path / "out"),
    ]
    going = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while not (going.poll() is not None or list(tmp_path.iterdir())):
        time.sleep(0.005)
    going.send_signal(getattr(signal, name))
    said = going.communicate()[1]
    assert (going.returncode, "the same command begins anew" in said) == (130, True) or (tmp_path / "out").is_dir()
    assert not [each for each in tmp_path.iterdir() if each.name != "out"]
