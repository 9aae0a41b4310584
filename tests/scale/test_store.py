"""Making a store and opening it: the mesh comes back, from every source; what is damaged is refused in one line."""

import json
import shutil
import subprocess
import sys

import numpy as np
import pytest

from tspslam.errors import InputError, OutputError
from tspslam.io import write_ply
from tspslam.io.las import write_las
from tspslam.scale import ImageReference, open_store, write_store
from tspslam.scale.stores import _spill, sources
from tspslam.scale.stores.sources import Source, Vertices, of_arrays, of_file

from .meshes import tangled, two_images


def read_back(store):
    """Vertices and faces in the order of the source."""
    number = store.read("id", 0, store.n)
    assert np.array_equal(np.sort(number), np.arange(store.n))
    xyz = np.empty((store.n, 3))
    xyz[number] = store.read("xyz", 0, store.n)
    copies = store.mesh.arrays["face_id"].shape[0]
    named, rows = store.read("face_id", 0, copies), store.read("face_rows", 0, copies)
    _, first = np.unique(named, return_index=True)
    return xyz, number[rows[first]]


@pytest.mark.parametrize("chunk", [1, 7, 64, 1000])
def test_a_mesh_comes_back_as_it_went_in(tmp_path, chunk, monkeypatch):
    monkeypatch.setattr(sources, "BLOCK", 11)  # several blocks
    xyz, faces, uv = tangled(0, 100)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv), chunk=chunk)
    got = read_back(store)
    assert np.array_equal(got[0], xyz)
    assert np.array_equal(got[1], faces)
    assert np.array_equal(store.read("uv", 0, store.n), uv[store.read("id", 0, store.n)])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr"]
    assert not (store.path / "unsorted").exists()


def test_each_chunk_has_every_face_that_touches_it_in_the_source_s_order(tmp_path):
    xyz, faces, _ = tangled(1, 100)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces), chunk=9)
    number, begin = store.read("id", 0, store.n), 0
    for chunk, end in enumerate(store.mesh.face_end.tolist()):
        own = number[9 * chunk : 9 * chunk + 9]
        assert store.read("face_id", begin, end).tolist() == np.flatnonzero(np.isin(faces, own).any(axis=1)).tolist()
        begin = end


def test_what_is_near_stands_near(tmp_path):
    """The vertices of a chunk of a square terrain lie in a compact part of it."""
    k = 64
    xyz = np.stack([*map(np.ravel, np.meshgrid(np.arange(k), np.arange(k))), np.zeros(k * k)], axis=1)
    np.random.default_rng(0).shuffle(xyz)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, []), chunk=256)
    sides = [np.ptp(store.read("xyz", first, first + 256), axis=0)[:2].max() for first in range(0, k * k, 256)]
    assert max(sides) <= 2 * 16


def test_equal_sources_give_equal_bytes(tmp_path):
    xyz, faces, uv = tangled(2, 60)
    for name in "ab":
        write_store(tmp_path / name, of_arrays(xyz, faces, uv=uv), chunk=16)
    files = [sorted(p.relative_to(tmp_path / n) for p in (tmp_path / n).rglob("*") if p.is_file()) for n in "ab"]
    assert files[0] == files[1]
    assert all((tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes() for name in files[0])


def test_vertices_stand_by_image_and_each_takes_the_one_it_lies_deepest_in(tmp_path):
    xyz, faces, uv = tangled(3, 100)
    references, _ = two_images(tmp_path)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, images=references), chunk=16)
    number, start = store.read("id", 0, store.n), store.mesh.image_start
    inside = []
    for k in range(2):
        u, v = (uv - [25 * k, 0]).T
        inside.append(np.minimum.reduce([u, 35 - u, v, 49 - v]))
    best = np.where(np.max(inside, axis=0) >= 0, np.argmax(inside, axis=0), -1)
    assert set(number[: start[0]].tolist()) == set(np.flatnonzero(best == -1).tolist())
    assert set(number[start[1] : start[2]].tolist()) == set(np.flatnonzero(best == 1).tolist())


def test_a_text_ply_keeps_the_places_in_the_images(tmp_path):
    rows = [(0, 0, 5, 1, 2), (1, 0, 5, 3, 4), (0, 1, 5, 5, 6.5)]
    names = "".join(f"property double {name}\n" for name in "xyzuv")
    head = f"ply\nformat ascii 1.0\nelement vertex 3\n{names}element face 1\n"
    body = "\n".join(" ".join(map(str, row)) for row in rows)
    (tmp_path / "a.ply").write_text(f"{head}property list uchar int vertex_indices\nend_header\n{body}\n3 0 1 2\n")
    store = write_store(tmp_path / "a.zarr", of_file(tmp_path / "a.ply"))
    number = store.read("id", 0, 3)
    assert store.read("uv", 0, 3)[np.argsort(number)].tolist() == [[1, 2], [3, 4], [5, 6.5]]


def test_a_ply_file_is_read_block_by_block_and_gives_what_arrays_give(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "BLOCK", 11)
    xyz, faces, uv = tangled(4, 100)
    write_ply(tmp_path / "a.ply", xyz, faces, vertex={"luminance": uv[:, 0]})
    monkeypatch.setattr(sources, "read_textured", lambda _: pytest.fail("read as a whole"))
    store = write_store(tmp_path / "a.zarr", of_file(tmp_path / "a.ply"), chunk=16)
    assert all(np.array_equal(*pair) for pair in zip(read_back(store), (xyz, faces), strict=True))
    assert np.array_equal(store.read("luminance", 0, 100), uv[store.read("id", 0, 100), 0])


def test_polygons_of_a_text_file_are_cut_into_triangles(tmp_path):
    text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    text += (
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"
    )
    (tmp_path / "a.ply").write_text(text)
    assert write_store(tmp_path / "a.zarr", of_file(tmp_path / "a.ply")).n_faces == 2


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_a_las_file_is_read_block_by_block(tmp_path, monkeypatch, suffix):
    pytest.importorskip("laspy", reason="laspy (extra las) is not installed")
    monkeypatch.setattr(sources, "BLOCK", 11)
    xyz, faces, uv = tangled(5, 100)
    write_las(tmp_path / f"a.{suffix}", xyz, uv[:, 0] / 60)
    np.save(tmp_path / "f.npy", faces)
    store = write_store(tmp_path / "a.zarr", of_file(tmp_path / f"a.{suffix}", faces=tmp_path / "f.npy"), chunk=16)
    got, triangles = read_back(store)
    assert np.abs(got - (xyz * (1, -1, 1))[:, [0, 2, 1]]).max() < 1e-4
    assert np.array_equal(triangles, faces)
    assert np.abs(store.read("luminance", 0, 100) - uv[store.read("id", 0, 100), 0] / 60).max() < 1e-5
    assert store.filter().summary["defined"] > 50


def spoil_version(folder):
    edit(folder, lambda attributes: attributes.update(version=2))


def spoil_sizes(folder):
    edit(folder, lambda attributes: attributes.update(vertices=attributes["vertices"] + 1))


def spoil_starts(folder):
    edit(folder, lambda attributes: attributes.update(image_start=[5]))


def spoil_format(folder):
    edit(folder, lambda attributes: attributes.clear())


def edit(folder, change):
    values = json.loads((folder / "zarr.json").read_text())
    change(values["attributes"])
    (folder / "zarr.json").write_text(json.dumps(values))


def pack(folder):
    import zarr

    group = zarr.open_group(str(folder), mode="r+")
    values = group["id"][:]
    del group["id"]
    group.create_array("id", data=values, chunks=(16,))


def claim_much(folder, n=10**15):
    edit(folder, lambda attributes: attributes.update(vertices=n, image_start=[n]))
    for name in ("xyz", "id"):
        path = folder / name / "zarr.json"
        values = json.loads(path.read_text())
        values["shape"][0] = n
        path.write_text(json.dumps(values))


def replace_numbers(folder, name, change):
    """Other numbers, with a checksum that fits."""
    import zarr

    array = zarr.open_array(str(folder / name), mode="r+")
    values = array[:]
    change(values.reshape(-1))
    array[:] = values


def cut_chunk(folder):
    path = folder / "xyz" / "c.1.0"
    path.write_bytes(path.read_bytes()[:-1])


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (spoil_version, "is a store of version 2; expected version 1"),
        (spoil_sizes, "attributes that do not fit each other"),
        (spoil_starts, "attributes that do not fit each other"),
        (spoil_format, "or a store that was not finished"),
        (cut_chunk, r"c\.1\.0: has 387 bytes where 388 go"),
        (lambda folder: (folder / "id" / "c.2").unlink(), r"c\.2: is missing"),
        (lambda folder: shutil.rmtree(folder / "face_rows"), "has no array face_rows"),
        (lambda folder: (folder / "zarr.json").unlink(), "is no Zarr group of version 3"),
        (lambda folder: (folder / "zarr.json").write_text("{"), "is no Zarr group of version 3"),
        (lambda folder: (folder / "id" / "zarr.json").write_text("{"), "id: is no Zarr array of version 3"),
        (lambda folder: (folder / "id" / "zarr.json").write_text("[]"), "id: is no Zarr array of version 3"),
        (lambda folder: edit(folder, lambda told: told.update(chunk=8)), "in chunks of 16 rows; expected float64"),
        (claim_much, r"c\.3\.0: is missing"),
        (pack, r"has the codecs \['bytes', 'zstd'\]; expected plain bytes with CRC-32C"),
    ],
)
def test_a_store_that_is_not_whole_is_refused(tmp_path, spoil, said):
    xyz, faces, _ = tangled(7)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces), chunk=16)
    spoil(store.path)
    with pytest.raises(InputError, match=said):
        open_store(store.path)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("face_rows", -1, r"face_rows: holds -1 to \d+; expected 0 to 39"),
        ("face_rows", 41, r"face_rows: holds \d to 41; expected 0 to 39"),
        ("face_id", 10**9, r"face_id: holds 0 to 1000000000; expected 0 to"),
        ("face_end", 1, "face_end: has ends of chunks that do not rise"),
        ("face_end", 10**9, "face_end: has ends of chunks that do not rise"),
        ("id", -2, r"id: holds -2 to \d+; expected 0 to 39"),
    ],
)
def test_numbers_that_lead_out_of_the_mesh_are_refused(tmp_path, name, value, said):
    xyz, faces, uv = tangled(7)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=64)
    replace_numbers(store.path, name, lambda values: values.__setitem__(-1, value))
    with pytest.raises(InputError, match=said):
        open_store(store.path).filter().read()


@pytest.mark.parametrize(
    "change",
    [
        {"path": 7}, {"relative": None}, {"path": "a\0b"}, {"origin": [1]}, {"origin": 3}, {"origin": ["x", 0]},
        {"rig": 5}, {"rig": {"fx": 1}}, {"T_world_camera": [[1]], "rig": None}, {"origin": [float("nan"), 0]},
    ],
)  # fmt: skip
def test_images_that_are_damaged_in_the_attributes_are_refused(tmp_path, change):
    xyz, faces, uv = tangled(8)
    references, _ = two_images(tmp_path)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, images=references), chunk=64)
    edit(store.path, lambda attributes: attributes["images"][1].update(change))
    with pytest.raises(InputError, match=r"a\.zarr: has an image 1 that is damaged"):
        open_store(store.path)
    edit(store.path, lambda attributes: attributes.update(images=["x", 3]))
    with pytest.raises(InputError, match=r"a\.zarr: has an image 0 that is damaged"):
        open_store(store.path)


def test_a_byte_that_was_changed_is_seen(tmp_path):
    xyz, faces, uv = tangled(7)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=16)
    path = store.path / "xyz" / "c.1.0"
    data = bytearray(path.read_bytes())
    data[7] ^= 1
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"xyz.c\.1\.0: is damaged: its checksum is another; expected a store"):
        open_store(store.path).filter()


def test_a_moved_store_finds_images_that_moved_along_or_are_named(tmp_path):
    xyz, faces, uv = tangled(8)
    (tmp_path / "here" / "i").mkdir(parents=True)
    references, _ = two_images(tmp_path / "here" / "i")
    write_store(tmp_path / "here" / "a.zarr", of_arrays(xyz, faces, uv=uv, images=references), chunk=16)
    (tmp_path / "here").rename(tmp_path / "there")
    store = open_store(tmp_path / "there" / "a.zarr")
    assert all(path.exists() for path in store.mesh.image_paths)
    (tmp_path / "there" / "a.zarr").rename(tmp_path / "a.zarr")
    with pytest.raises(InputError, match="none of its 2 images is there"):
        open_store(tmp_path / "a.zarr").filter()
    moved = open_store(tmp_path / "a.zarr", images=tmp_path / "there" / "i")
    assert moved.filter().summary["missing"] == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"faces": [[0, 1, 1]]}, r"arrays: face 0 is \[0, 1, 1\], expected three vertices from 0 to 39"),
        ({"faces": [[0, 1, 2], [0, 1, 40]]}, r"face 1 is \[0, 1, 40\]"),
        ({"faces": [[-1, 1, 2]]}, r"face 0 is \[-1, 1, 2\]"),
        ({"faces": [[0.0, 1, 2]]}, r"faces are float64 of shape \(1, 3\), expected \(F, 3\) integers"),
        ({"xyz": np.full((40, 3), np.nan)}, r"vertex 0: xyz is \[nan, nan, nan\], expected numbers up to 1e\+09"),
        ({"xyz": np.empty((0, 3)), "uv": None, "luminance": None}, "has no vertices, expected one or more"),
        ({"uv": np.full((40, 2), np.inf)}, "vertex 0: uv is"),
        ({"luminance": np.full(40, 1e10)}, "vertex 0: luminance is 10000000000"),
        ({"image": np.full(40, 3)}, "vertex 0: image is 3, expected -1 to -1"),
    ],
)
def test_a_source_that_is_wrong_is_refused_and_nothing_is_left(tmp_path, change, said):
    xyz, faces, uv = tangled(9)
    given = {"xyz": xyz, "faces": faces, "uv": uv, "luminance": uv[:, 0]} | change
    source = of_arrays(given.pop("xyz"), given.pop("faces"), **given)
    with pytest.raises(InputError, match=said):
        write_store(tmp_path / "a.zarr", source)
    assert not list(tmp_path.iterdir())


def test_arguments_that_are_wrong_are_refused(tmp_path):
    xyz, faces, uv = tangled(9)
    for given, said in (({"uv": uv[:5]}, "uv has shape"), ({"image": [0]}, "image has shape")):
        with pytest.raises(InputError, match=said):
            of_arrays(xyz, faces, **given)
    for chunk in (0, True, 1 << 25, "x"):
        with pytest.raises(InputError, match="chunk is"):
            write_store(tmp_path / "a.zarr", of_arrays(xyz, faces), chunk=chunk)
    blocks = [Vertices(xyz), Vertices(xyz, uv=uv)]
    with pytest.raises(InputError, match="mixed: vertex 40: a block of vertices has other columns"):
        write_store(tmp_path / "a.zarr", Source(blocks, [], name="mixed"))
    (tmp_path / "i").mkdir()
    seen = of_arrays(xyz, faces, images=two_images(tmp_path / "i")[0])
    with pytest.raises(InputError, match="has no camera, and the vertices no uv"):
        write_store(tmp_path / "a.zarr", seen)
    for values, said in (
        ({"T_world_camera": np.eye(4)}, "a pose and no camera"),
        ({"origin": (np.nan, 0)}, "expected \\(u, v\\), finite"),
    ):
        with pytest.raises(InputError, match=said):
            ImageReference("a.png", **values)
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine.txt").write_text("kept")
    with pytest.raises(InputError, match="is there already"):
        write_store(tmp_path / "taken", of_arrays(xyz, faces))
    assert (tmp_path / "taken" / "mine.txt").read_text() == "kept"


def test_a_full_disk_leaves_nothing(tmp_path, monkeypatch):
    def full(path, rows):
        raise OutputError(f"{path}: cannot be written (No space left on device)")

    monkeypatch.setattr(_spill, "append_rows", full)
    xyz, faces, _ = tangled(9)
    with pytest.raises(OutputError, match="No space left"):
        write_store(tmp_path / "a.zarr", of_arrays(xyz, faces))
    assert not list(tmp_path.iterdir())


def test_damaged_files_are_refused(tmp_path):
    xyz, faces, _ = tangled(9)
    write_ply(tmp_path / "a.ply", xyz, faces)
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(data[:-700])
    (tmp_path / "b.las").write_bytes(b"LASF" + bytes(400))
    (tmp_path / "f.npy").write_bytes(b"x")
    np.save(tmp_path / "g.npy", np.zeros((2, 2)))
    for given, said in (
        ({"path": "a.ply"}, r"a\.ply"),
        ({"path": "b.las"}, r"b\.las: "),
        ({"path": "b.las", "faces": tmp_path / "f.npy"}, r"f\.npy: cannot be read"),
        ({"path": "b.las", "faces": tmp_path / "g.npy"}, r"g\.npy: holds float64 of shape \(2, 2\)"),
        ({"path": "a.ply", "faces": tmp_path / "g.npy"}, "has faces of its own"),
        ({"path": "c.xyz"}, "suffix '.xyz'"),
    ):
        with pytest.raises(InputError, match=said):
            write_store(tmp_path / "s.zarr", of_file(tmp_path / given.pop("path"), **given))
        assert not (tmp_path / "s.zarr").exists()


def test_without_zarr_one_line_says_how_to_come_by_it():
    code = "import sys; sys.modules['zarr'] = None; from tspslam.scale import open_store; open_store('a')"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stderr.splitlines()[-1].endswith("expected an installation of it: pip install 'tspslam[scale]'")
