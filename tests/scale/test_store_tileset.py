"""3D Tiles of a store, held against the specification, version 1.1, and against the store itself."""

import json

import numpy as np
import pytest
from scipy.spatial import KDTree

import tspslam
from tspslam.cli.entry import exit_code
from tspslam.scale import write_store
from tspslam.scale.stores.sources import of_arrays
from tspslam.scale.stores.tile_files import write_tiles

from .meshes import tangled

FAR = np.array([4.3e5, 5.4e6, 300.0])  # m, as in a national grid: float32 has steps of 0.5 m there
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # what 3D Tiles do to glTF, y up: section 6.5.1.1


def stored(folder, n=300, shift=FAR, chunk=16, seed=31):
    xyz, faces, uv = tangled(seed, n)
    xyz = xyz + shift
    store = write_store(folder / "a.zarr", of_arrays(xyz, faces, uv=uv, luminance=uv[:, 0] / 60), chunk=chunk)
    return store.filter(), xyz, faces, uv


def tree_of(folder):
    return json.loads((folder / "tileset.json").read_bytes())


def tiles_of(tile, above=()):
    yield tile, above
    for child in tile.get("children", ()):
        yield from tiles_of(child, (*above, tile))


def drawn(folder, tile):
    """What stands in a tile's file, in trimesh's eyes: places with z up, faces, and the numbers of the vertices."""
    import trimesh

    scene = trimesh.load_scene(folder / tile["content"]["uri"], process=False)
    (name,) = scene.graph.nodes_geometry
    T, geometry = scene.graph[name]
    shape = scene.geometry[geometry]
    xyz = (np.asarray(shape.vertices) @ T[:3, :3].T + T[:3, 3]) @ Z_UP.T
    return xyz, getattr(shape, "faces", None), shape


def corners(tile):
    middle, half = (
        np.array(tile["boundingVolume"]["box"][:3]),
        np.array(tile["boundingVolume"]["box"][3:]).reshape(3, 3),
    )
    assert np.array_equal(half, np.diag(np.diag(half)))
    assert (np.diag(half) > 0).all()
    return middle - np.diag(half), middle + np.diag(half)


def assert_within(low, high, tile):
    box, slack = corners(tile), 4 * np.spacing(np.abs(FAR))
    assert (low >= box[0] - slack).all()
    assert (high <= box[1] + slack).all()


def test_leaves_have_every_face_once_at_its_place_and_with_its_response(tmp_path):
    response, xyz, faces, uv = stored(tmp_path)
    count = write_tiles(response, tmp_path / "tiles", "3dtiles")
    whole, near, found, leaves = response.read(), KDTree(xyz), [], 0
    for tile, _ in tiles_of(tree_of(tmp_path / "tiles")["root"]):
        if "children" in tile:
            continue
        leaves += 1
        places, triangles, shape = drawn(tmp_path / "tiles", tile)
        off, row = near.query(places)
        assert off.max() <= np.sqrt(3) * (np.ptp(xyz, axis=0).max() * 2.0**-25 + 2 * np.spacing(FAR.max()))
        found += np.sort(row[triangles], axis=1).tolist()
        numbers = {name: values.ravel() for name, values in shape.vertex_attributes.items()}
        assert np.array_equal(numbers["_MAGNITUDE"], np.abs(whole.z[row]).astype(np.float32))
        assert np.array_equal(numbers["_PHASE"], np.angle(whole.z[row]).astype(np.float32))
        assert np.array_equal(numbers["_DEFINED"], whole.defined[row].astype(np.float32))
        assert np.array_equal(numbers["_LUMINANCE"], (uv[row, 0] / 60).astype(np.float32))
    assert count == leaves > 10
    assert sorted(found) == sorted(np.sort(faces, axis=1).tolist())


def test_triangles_keep_the_side_that_they_show(tmp_path):
    """A mesh seen from above shows there the side that it shows in the store: no axis is mirrored."""
    xyz = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, [[0, 1, 2], [1, 3, 2]], luminance=[0, 1, 2, 3]))
    write_tiles(store.filter(), tmp_path / "tiles", "3dtiles")
    places, triangles, _ = drawn(tmp_path / "tiles", tree_of(tmp_path / "tiles")["root"])
    a, b, c = places[triangles].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_boxes_hold_what_is_in_them_and_below(tmp_path):
    response, *_ = stored(tmp_path)
    write_tiles(response, tmp_path / "tiles", "3dtiles")
    for tile, above in tiles_of(tree_of(tmp_path / "tiles")["root"]):
        places, _, _ = drawn(tmp_path / "tiles", tile)
        for each in (tile, *above):
            assert_within(places.min(axis=0), places.max(axis=0), each)
        assert len(tile.get("children", [0] * 4)) <= 4


def test_an_error_is_as_far_as_a_vertex_may_be_from_what_is_drawn(tmp_path):
    response, *_ = stored(tmp_path)
    write_tiles(response, tmp_path / "tiles", "3dtiles")
    tileset = tree_of(tmp_path / "tiles")
    assert tileset["geometricError"] >= tileset["root"]["geometricError"] > 0
    below = [(above, drawn(tmp_path / "tiles", tile)[0]) for tile, above in tiles_of(tileset["root"])]
    for tile, above in tiles_of(tileset["root"]):
        error = tile["geometricError"]
        assert all(error <= each["geometricError"] for each in above)
        if "children" not in tile:
            assert error == 0
            continue
        points = drawn(tmp_path / "tiles", tile)[0]
        off = [KDTree(points).query(places)[0].max() for path, places in below if tile in path]
        assert 0 < max(off) <= error + 1e-6


def test_tiles_above_have_no_more_points_than_one_below_and_all_colours(tmp_path):
    response, *_ = stored(tmp_path)
    write_tiles(response, tmp_path / "tiles", "3dtiles")
    tileset = tree_of(tmp_path / "tiles")
    for tile, _ in tiles_of(tileset["root"]):
        if "children" in tile:
            counts = [len(drawn(tmp_path / "tiles", each)[0]) for each in (tile, *tile["children"])]
            assert counts[0] <= max(counts[1:])
    assert (tileset["asset"]["version"], tileset["root"]["refine"]) == ("1.1", "REPLACE")
    low, high = tileset["asset"]["extras"]["span"]
    assert low < high


def test_the_same_responses_give_the_same_bytes(tmp_path):
    response, *_ = stored(tmp_path)
    for name in ("one", "other"):
        write_tiles(response, tmp_path / name, "3dtiles")
    one, other = ({path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ("one", "other"))
    assert one == other


def test_a_flat_mesh_has_a_box_with_a_volume(tmp_path):
    xyz, faces, uv = tangled(32, 40)
    xyz[:, 2] = 7
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=16)
    write_tiles(store.filter(), tmp_path / "tiles", "3dtiles")
    for tile, _ in tiles_of(tree_of(tmp_path / "tiles")["root"]):
        low, high = corners(tile)
        assert low[2] < 7 < high[2]


def test_boxes_hold_those_below_also_of_flat_tiles(tmp_path):
    """Stairs: each chunk is flat, and the lowest and highest step stand at the borders of the whole."""
    v, u = np.mgrid[:16, :16].reshape(2, -1)
    a = (np.arange(15)[:, None] * 16 + np.arange(15)).ravel()
    faces = np.concatenate([np.stack([a, a + 16, a + 1], 1), np.stack([a + 1, a + 16, a + 17], 1)])
    xyz = np.stack([u, v, v // 4 * 1.0], axis=1)
    is_flat = np.ptp(xyz[faces, 2], axis=1) == 0
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces[is_flat], luminance=u), chunk=16)
    write_tiles(store.filter(), tmp_path / "tiles", "3dtiles")
    flat = 0
    for tile, above in tiles_of(tree_of(tmp_path / "tiles")["root"]):
        (low, high), slack = corners(tile), 4 * np.spacing(16.0)
        flat += high[2] - low[2] < 0.01
        for each in above:
            assert (low >= corners(each)[0] - slack).all()
            assert (high <= corners(each)[1] + slack).all()
    assert flat > 4


def test_a_tileset_is_written_from_the_command_line_and_never_over_something(tmp_path, capsys):
    stored(tmp_path)
    words = ["filter", str(tmp_path / "a.zarr"), "--to", "3dtiles", "--out", str(tmp_path / "tiles")]
    assert exit_code(words) == 0
    assert str(tmp_path / "tiles" / "tileset.json") in capsys.readouterr().out
    assert exit_code(words) == 3
    assert "is there" in capsys.readouterr().err


def test_a_damaged_chunk_leaves_nothing(tmp_path):
    response, *_ = stored(tmp_path)
    path = tmp_path / "a.zarr" / "xyz" / "c.7.0"
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(tspslam.InputError, match="is damaged: its checksum is another"):
        write_tiles(response, tmp_path / "tiles", "3dtiles")
    assert [each.name for each in tmp_path.iterdir()] == ["a.zarr"]
