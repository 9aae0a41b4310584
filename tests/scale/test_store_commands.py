"""What a person types: a store made, filtered, and written as a file a tile."""

import json
import re
import subprocess
import sys

import numpy as np
import pytest

import tspslam
from tspslam import datasets
from tspslam.cli.entry import exit_code
from tspslam.io import read_ply, read_vtu, write_ply
from tspslam.run import config, pipeline
from tspslam.scale import open_store, write_store
from tspslam.scale.stores import filtering
from tspslam.scale.stores.image_lists import read_images
from tspslam.scale.stores.sources import of_arrays, of_file
from tspslam.scale.stores.tile_files import write_tiles

from .meshes import picture, tangled, two_images


def typed(capsys, *words):
    code = exit_code([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def made(folder):
    """A mesh with places in a plane, two images, and their list."""
    xyz, faces, uv = tangled(21, 200)
    write_ply(folder / "a.ply", xyz, faces, vertex={"u": uv[:, 0], "v": uv[:, 1]})
    pixels = two_images(folder)[1]
    (folder / "images.txt").write_text("# tiles\n0.png 0 0\n1.png 25 0\n")
    return xyz, faces, uv, pixels


def test_a_store_is_made_filtered_and_handed_on_from_the_command_line(tmp_path, capsys):
    xyz, faces, _, _ = made(tmp_path)
    store = tmp_path / "a.zarr"
    words = ["store", tmp_path / "a.ply", "--images", tmp_path / "images.txt", "--out", store, "--chunk", 32]
    code, out, _ = typed(capsys, *words)
    assert (code, "200 vertices" in out) == (0, True)
    code, out, _ = typed(capsys, "filter", store, "--to", "vtu", "--out", tmp_path / "tiles", "--json")
    told = json.loads(out)
    assert (code, told["vertices"], told["missing"]) == (0, 200, [])
    response = open_store(store).response("tmahf-1-harmonic").read()
    assert told["defined"] == response.defined.sum() > 100
    code, out, err = typed(capsys, "filter", store, "--workers", 1, "--to", "vtu", "--out", tmp_path / "again")
    assert str(tmp_path / "again" / "tiles.pvd") in out
    assert "Scheduler" not in err  # what Dask logs, in capitals
    assert "127.0.0.1" not in err
    assert (code, f"response at {told['defined']} of 200 vertices" in out) == (0, True)
    found, triangles = {}, []
    for name in re.findall('file="([^"]+)"', (tmp_path / "tiles" / "tiles.pvd").read_text()):
        mesh = read_vtu(tmp_path / "tiles" / name)
        number = mesh.point_data["number"]
        triangles += np.sort(number[mesh.faces], axis=1).tolist()
        found |= dict(zip(number.tolist(), mesh.point_data["real"] + 1j * mesh.point_data["imaginary"], strict=True))
        assert np.array_equal(mesh.xyz, xyz[number])
    assert sorted(triangles) == sorted(np.sort(faces, axis=1).tolist())
    assert all(value == response.z[k] for k, value in found.items())


def test_a_store_that_cannot_be_filtered_says_what_is_missing(tmp_path, capsys):
    xyz, faces, _ = tangled(23, 40)
    write_ply(tmp_path / "a.ply", xyz, faces)
    code, out, _ = typed(capsys, "store", tmp_path / "a.ply", "--out", tmp_path / "a.zarr")
    assert code == 0
    assert out.splitlines()[-1] == "to filter it, make it with images (--images) or luminance"
    assert typed(capsys, "filter", tmp_path / "a.zarr")[0] == 3


def test_tiles_as_ply_have_every_face_once(tmp_path):
    xyz, faces, uv = tangled(22, 100)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=16)
    count = write_tiles(store.filter(), tmp_path / "tiles", "ply")
    meshes = [read_ply(path) for path in (tmp_path / "tiles").glob("*.ply")]
    assert len(meshes) == count
    assert sum(len(mesh.faces) for mesh in meshes) == len(faces)
    assert set(meshes[0].vertex) == {"real", "imaginary", "magnitude", "phase", "defined", "luminance"}
    with pytest.raises(tspslam.InputError, match="kind is 'obj', expected one of vtu, ply, 3dtiles"):
        write_tiles(store.filter(), tmp_path / "more", "obj")


def test_a_missing_image_is_said_and_the_run_is_degraded(tmp_path, capsys):
    made(tmp_path)
    typed(capsys, "store", tmp_path / "a.ply", "--images", tmp_path / "images.txt", "--out", tmp_path / "a.zarr")
    (tmp_path / "1.png").unlink()
    code, _, err = typed(capsys, "filter", tmp_path / "a.zarr")
    assert (code, "warning: 1 of 2 images are not there, such as" in err) == (4, True)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["filter", "STORE", "--image", "a.png"], 2, "goes with a mesh or a scan"),
        (["filter", "STORE", "--merge-corners"], 2, "goes with a mesh or a scan"),
        (["filter", "STORE", "--surface", "crust"], 2, "goes with a mesh or a scan"),
        (["filter", "STORE", "--polygons", "cells"], 2, "goes with a mesh or a scan"),
        (["filter", "gone.zarr"], 3, "gone.zarr: is not there; expected a mesh, or a store"),
        (["filter", "a.ply", "--image", "a.png", "--calib", "c", "--workers", "2"], 2, "goes with a store"),
        (["filter", "a.ply"], 2, "goes with a mesh or a scan"),
        (["filter", "STORE", "--to", "vtu"], 2, "goes with --out"),
        (["filter", "STORE", "--out", "x"], 2, "goes with --out"),
        (["filter", "STORE", "--force"], 2, "goes with --out"),
        (["filter", "a.ply", "--image", "a.png", "--calib", "c", "--force"], 2, "goes with a store"),
        (["filter", "STORE", "--to", "obj", "--out", "x"], 2, "expected one of vtu, ply, 3dtiles"),
        (["filter", "STORE", "--to", "ply", "--out", "STORE/x"], 3, "lies in the store"),
        (["filter", "STORE", "--memory", "2 bananas"], 3, "memory is '2 bananas'"),
        (["filter", "STORE", "--scheduler", "nowhere"], 3, "nowhere: is no address of a scheduler"),
        (["filter", "."], 3, "is no Zarr group of version 3"),
        (["store", "gone.ply", "--out", "x.zarr"], 3, "gone.ply"),
        (
            ["store", "a.ply", "--out", "x.zarr", "--images", "bad.txt"],
            3,
            "bad.txt: line 1 has 2 values; expected lines",
        ),
        (["store", "a.ply", "--out", "x.zarr", "--images", "pose.txt"], 3, "line 1: has no rotation to 0.001"),
        (["store", "a.ply", "--out", "x.zarr", "--images", "none.txt"], 3, "names no image"),
    ],
)
def test_what_does_not_fit_is_one_line(tmp_path, capsys, monkeypatch, words, code, said):
    monkeypatch.chdir(tmp_path)
    xyz, faces, uv, _ = made(tmp_path)
    (tmp_path / "bad.txt").write_text("0.png 1\n")
    (tmp_path / "c.yaml").write_text("fx: 9\nfy: 9\ncx: 1\ncy: 1\nbaseline: 0.1\nwidth: 36\nheight: 50\n")
    (tmp_path / "pose.txt").write_text("0.png c.yaml 2 0 0 0 0 1 0 0 0 0 1 0\n")
    (tmp_path / "none.txt").write_text("# nothing\n")
    if "STORE" in words:
        write_store(tmp_path / "s.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]))
    got, out, err = typed(capsys, *[word.replace("STORE", "s.zarr") for word in words])
    assert (got, out) == (code, "")
    assert said in err.replace("\n", " ")
    assert not (tmp_path / "x.zarr").exists()


def test_a_folder_that_is_taken_is_refused_before_the_store_is_filtered(tmp_path, capsys):
    xyz, faces, uv = tangled(26, 60)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    for out in (tmp_path / "mine", tmp_path / "mine" / "notes.txt", tmp_path, store.path):
        code, said, err = typed(capsys, "filter", store.path, "--to", "3dtiles", "--out", out)
        assert (code, said, err.count("tspslam: ")) == (3, "", 1)
    assert open_store(store.path).responses == ()
    assert (tmp_path / "mine" / "notes.txt").read_text() == "mine"


def test_an_earlier_export_is_replaced_only_with_force_and_nothing_else_is(tmp_path, capsys):
    xyz, faces, uv = tangled(27, 60)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]))
    words = ["filter", store.path, "--to", "3dtiles", "--out", tmp_path / "tiles"]
    assert typed(capsys, *words)[0] == 0
    first = (tmp_path / "tiles" / "tileset.json").read_bytes()
    code, _, err = typed(capsys, *words, "--order", 2)
    assert (code, "or --force to write it anew" in err) == (3, True)
    assert (tmp_path / "tiles" / "tileset.json").read_bytes() == first
    assert typed(capsys, *words, "--order", 2, "--force")[0] == 0
    assert b"tmahf-2-" in (tmp_path / "tiles" / "tileset.json").read_bytes()
    (tmp_path / "tiles" / "notes.txt").write_text("mine")
    code, _, err = typed(capsys, *words, "--force")
    assert (code, "holds notes.txt, which no export wrote" in err) == (3, True)
    assert (tmp_path / "tiles" / "notes.txt").read_text() == "mine"


def test_who_interrupts_a_filter_is_told_that_it_goes_on(tmp_path, capsys, monkeypatch):
    xyz, faces, uv = tangled(23, 100)
    write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=16)
    whole = filtering.filter_run

    def interrupt(store, options, first, last, tile):
        if first >= 48:
            raise KeyboardInterrupt
        return whole(store, options, first, last, tile)

    monkeypatch.setattr(filtering, "filter_run", interrupt)
    monkeypatch.setattr(filtering, "tile_for", lambda *_: 16)
    code, out, err = typed(capsys, "filter", tmp_path / "a.zarr")
    assert (code, out) == (130, "")
    assert "interrupted; the same command goes on where this one stopped" in err
    again = []
    monkeypatch.setattr(filtering, "filter_run", lambda *given: again.append(given[2]) or whole(*given))
    assert typed(capsys, "filter", tmp_path / "a.zarr")[0] == 0
    assert again == [48, 64, 80, 96]


def test_a_posed_photo_of_a_list_is_seen_where_it_was_taken(tmp_path):
    xyz = made(tmp_path)[0]
    picture(9, tmp_path / "p.png", (50, 60))
    (tmp_path / "c.yaml").write_text("fx: 80\nfy: 80\ncx: 30\ncy: 25\nbaseline: 0.1\nwidth: 60\nheight: 50\n")
    (tmp_path / "images.txt").write_text("p.png c.yaml 1 0 0 3 0 1 0 2.5 0 0 1 -2\n")
    image = read_images(tmp_path / "images.txt")[0]
    x, y, z = (xyz - [3, 2.5, -2]).T
    assert np.allclose(image.places(xyz, None), np.stack([30 + 80 * x / z, 25 + 80 * y / z], axis=1))
    store = write_store(tmp_path / "a.zarr", of_file(tmp_path / "a.ply", images=[image]), chunk=32)
    assert store.filter().summary["defined"] > 50


def test_a_run_s_map_is_filtered_in_its_keyframes(tmp_path):
    run = tmp_path / "run"
    pipeline.run(pipeline.OnePair(datasets.motorcycle()), run, config.resolve())
    store = write_store(tmp_path / "a.zarr", of_file(run), chunk=500)
    map_, response = tspslam.load_map(run), store.filter().read()
    both = response.defined & map_.response.defined
    assert both.sum() > 0.9 * map_.response.defined.sum()
    off = np.abs(response.z - map_.response.z)[both]
    assert np.median(off) < 1e-9  # a vertex that comes back by 1e-13 px beside the middle of a pixel has other lines


def test_processes_say_nothing_of_their_own(tmp_path):
    xyz, faces, uv = tangled(3)
    write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=16)
    words = [sys.executable, "-m", "tspslam", "filter", str(tmp_path / "a.zarr"), "--workers", "1"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode, [line for line in done.stderr.splitlines() if "anny" in line or "cheduler" in line]) == (
        0,
        [],
    )
