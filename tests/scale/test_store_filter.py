"""The law of the store: filtered in tiles it is the whole, to the last bit."""

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tspslam
from tspslam.errors import InputError
from tspslam.scale import ImageReference, write_store
from tspslam.scale.stores.filtering import filter_run
from tspslam.scale.stores.halo import load_piece
from tspslam.scale.stores.sources import of_arrays
from tspslam.scale.stores.stored_response import begin
from tspslam.scale.stores.tiled_filter import Options, filter_rows
from tspslam.types import Rig

from .meshes import picture, same_bits, tangled, two_images, whole

WEIGHTS = [None, lambda d: (1, 0.6, 0.25, 0)[d], lambda d: float(d == 0)]
FILTERS = st.sampled_from(
    [
        {"order": 1},
        {"order": 0},
        {"order": 3, "centering": "mean"},
        {"order": 2, "centering": "none"},
        {"order": 1, "centering": "plane"},
    ]
)


@settings(max_examples=8, deadline=None)
@given(
    st.integers(0, 99), st.integers(1, 41), st.lists(st.integers(1, 41), min_size=1, max_size=3), FILTERS,
    st.sampled_from(WEIGHTS), st.randoms(use_true_random=False),
)  # fmt: skip
def test_tiles_of_any_size_in_any_order_are_the_whole(seed, chunk, tiles, options, weight, random):
    xyz, faces, uv = tangled(seed)
    image = np.random.default_rng(seed).integers(-1, 2, len(xyz))
    with tempfile.TemporaryDirectory() as folder:
        references, pixels = two_images(Path(folder))
        store = write_store(
            f"{folder}/a.zarr", of_arrays(xyz, faces, uv=uv, image=image, images=references), chunk=chunk
        )
        truth = whole(xyz, faces, uv, image, references, pixels, weight=weight, **options)
        chosen = Options.checked(options["order"], options.get("centering"), weight)
        for tile in tiles:
            starts = list(range(0, store.n, tile))
            random.shuffle(starts)
            z, defined = np.zeros(store.n, complex), np.zeros(store.n, bool)
            for first in starts:
                last = min(first + tile, store.n)
                answer = filter_rows(store.mesh, chosen, first, last, tile)
                number = store.read("id", first, last)
                z[number], defined[number] = answer.z, answer.defined
            assert z.tobytes() == truth[0].tobytes()
            assert np.array_equal(defined, truth[1])


@pytest.mark.parametrize("shape", [(50, 60), (50, 60, 3)])
def test_a_posed_camera_sees_in_tiles_what_it_sees_of_the_whole(tmp_path, shape):
    xyz, faces, _ = tangled(5, 300)
    rig = Rig(fx=80, fy=81, cx=30, cy=25, width=60, height=50)
    turned = np.eye(4)
    turned[:3, :3] = [[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]]
    turned[:3, 3] = 3.1, 2.3, -1.7
    pixels = picture(3, tmp_path / "a.png", shape)
    references = [ImageReference(tmp_path / "a.png", rig, turned)]
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, images=references), chunk=37)
    image = np.full(len(xyz), -1)
    image[store.read("id", int(store.mesh.image_start[0]), store.n)] = 0
    u, v = references[0].places(xyz, None).T
    assert np.array_equal(image == 0, (u >= 0) & (u <= 59) & (v >= 0) & (v <= 49))
    response = store.filter(tile=50).read()
    assert same_bits(response, *whole(xyz, faces, None, image, references, [pixels]))
    assert response.defined.sum() > 50


def test_values_of_the_vertices_alone_in_tiles_are_the_whole(tmp_path):
    xyz, faces, uv = tangled(1, 200)
    own = np.random.default_rng(0).random(200)
    own[::17] = np.nan
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, luminance=own), chunk=31)
    one = store.filter(tile=9).read()
    again = write_store(tmp_path / "b.zarr", of_arrays(xyz, faces, uv=uv, luminance=own), chunk=1000)
    assert same_bits(one, *vars_of(again.filter().read()))
    ramp = of_arrays(xyz, faces, uv=uv, luminance=0.01 * uv[:, 1])
    response = write_store(tmp_path / "c.zarr", ramp, chunk=31).filter(centering="plane").read()
    assert np.allclose(response.z[response.defined], 0.01j)


def vars_of(response):
    return response.z, response.defined


def test_a_piece_keeps_the_order_of_the_whole(tmp_path):
    xyz, faces, uv = tangled(2, 120)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, luminance=uv[:, 0]), chunk=10)
    for rings in (1, 2, 3):
        piece = load_piece(store.mesh, 35, 50, rings, ("xyz",))
        own = store.read("id", 35, 50)
        assert (np.diff(piece.number) > 0).all()
        assert np.array_equal(piece.number[piece.own], own)
        assert np.array_equal(piece.xyz, xyz[piece.number])
        complex_ = tspslam.build_complex(faces, len(xyz))
        near = np.isin(np.arange(len(xyz)), own)
        for _ in range(rings - 1):
            near = near | np.isin(np.arange(len(xyz)), complex_.edges[near[complex_.edges].any(axis=1)])
        kept = complex_.faces[near[complex_.faces].any(axis=1)]
        assert np.array_equal(piece.number[piece.complex_.faces], kept)
        assert set(piece.number.tolist()) == set(kept.ravel().tolist()) | set(own.tolist())


def test_a_filter_goes_on_where_it_was_ended_and_does_no_tile_twice(tmp_path):
    xyz, faces, uv = tangled(3, 100)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, luminance=uv[:, 0]), chunk=20)
    options = Options.checked(1, None, None)
    begin(store.mesh, options)
    filter_run(store.mesh, vars(options), 40, 60, 20)
    folder = store.path / "responses" / options.name
    with pytest.raises(InputError, match=r"was not finished; expected .* the same filter again"):
        store.response(options.name)
    (folder / "z" / "c.4.abc.partial").write_bytes(b"torn")
    before = (folder / "z" / "c.2").stat().st_mtime_ns
    steps = []
    response = store.filter(tile=20, on_tile=lambda *counts: steps.append(counts))
    assert steps == [(40, 100), (60, 100), (80, 100), (100, 100)]
    assert (folder / "z" / "c.2").stat().st_mtime_ns == before
    assert not list(folder.rglob("*.partial"))
    fresh = write_store(tmp_path / "b.zarr", of_arrays(xyz, faces, uv=uv, luminance=uv[:, 0]), chunk=20)
    assert same_bits(response.read(), *vars_of(fresh.filter().read()))
    store.filter(tile=7, on_tile=lambda *_: pytest.fail("it is done"))
    (folder / "z" / "c.3").unlink()
    with pytest.raises(InputError, match=r"c\.3: is missing"):
        store.response(options.name)
    steps.clear()
    assert same_bits(store.filter(on_tile=lambda *counts: steps.append(counts)).read(), *vars_of(response.read()))
    assert steps == [(100, 100)]
    assert store.responses == (options.name,)


def test_vertices_of_a_missing_image_have_no_response_until_it_is_there(tmp_path):
    xyz, faces, uv = tangled(4, 80)
    references, pixels = two_images(tmp_path)
    image = (uv[:, 0] > 30).astype(int)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, image=image, images=references), chunk=16)
    truth = whole(xyz, faces, uv, image, references, pixels)
    (tmp_path / "1.png").rename(tmp_path / "away.png")
    response = store.filter()
    assert response.summary["missing"] == [1]
    assert not response.read().defined[image == 1].any()
    assert np.array_equal(response.read().z[image == 0], truth[0][image == 0])
    (tmp_path / "away.png").rename(tmp_path / "1.png")
    assert same_bits(store.filter().read(), *truth)


@pytest.mark.parametrize("file", ["complete.json", "done/0-40.json"])
@pytest.mark.parametrize(
    "content",
    ["{", "{}", "[]", '{"options": 3, "missing": [7]}', "[" * 100_000]
    + [
        f'{{"options": {{"order": {order}, "centering": "harmonic", "weights": null}}, "summary": {{"defined": {defined},'
        f' "missing": {missing}, "peak_bytes": 0, "tiles": 1, "split": 0}}}}'
        for order, defined, missing in [
            ("1", "1", "[7]"),
            ("1", "1", '["a"]'),
            ("1", "1", "3"),
            ("1", "1e999", "[]"),
            ("1", "-1", "[]"),
            ("2", "1", "[]"),
            ("1e999", "1", "[]"),
        ]
    ],
)
def test_what_is_kept_about_a_response_and_was_damaged_is_made_anew(tmp_path, file, content):
    xyz, faces, uv = tangled(5)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]), chunk=64)
    response = store.filter()
    before, summary = response.read().z.tobytes(), response.summary
    (store.path / "responses" / response.name / file).write_text(content)
    again = store.filter()
    assert (again.read().z.tobytes(), again.options) == (before, response.options)
    assert again.summary | {"peak_bytes": 0} == summary | {"peak_bytes": 0}


def test_vertices_of_an_image_that_was_changed_are_filtered_anew(tmp_path):
    xyz, faces, uv = tangled(4, 80)
    references, pixels = two_images(tmp_path)
    image = (uv[:, 0] > 30).astype(int)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, image=image, images=references), chunk=16)
    store.filter(tile=16)
    pixels[1] = picture(5, tmp_path / "1.png", pixels[1].shape)
    os.utime(tmp_path / "1.png", (1, 1))
    steps = []
    again = store.filter(tile=16, on_tile=lambda *counts: steps.append(counts))
    assert same_bits(again.read(), *whole(xyz, faces, uv, image, references, pixels))
    assert 0 < len(steps) < 5  # those of the other image alone are there


def test_what_cannot_be_filtered_is_refused_in_a_line(tmp_path):
    xyz, faces, uv = tangled(6)
    bare = write_store(tmp_path / "bare.zarr", of_arrays(xyz, faces))
    with pytest.raises(InputError, match="neither images nor luminance"):
        bare.filter()
    points = write_store(tmp_path / "points.zarr", of_arrays(xyz, [], luminance=uv[:, 0]))
    with pytest.raises(InputError, match="has no faces, so that no vertex has neighbours; expected a mesh"):
        points.filter()
    lit = write_store(tmp_path / "lit.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]))
    for options, said in (
        ({"memory": "lots"}, "memory is 'lots', expected bytes or a number with"),
        ({"memory": "9" * 400}, "memory is '9999999"),
        ({"memory": "9" * 305 + " GB"}, "memory is '9999999"),
        ({"memory": "100 MB"}, "memory is 0.1 GB, expected 0.5"),
        ({"tile": 0}, "tile is 0, expected 1 to"),
        ({"workers": -1}, "workers are -1, expected 0 to"),
        ({"order": 0, "centering": "mean"}, "with order 0, expected 'none'"),
        ({"weight": lambda _: 1.0}, "expected 0 there or before: a halo is as wide"),
    ):
        with pytest.raises(InputError, match=said):
            lit.filter(**options)
    references, _ = two_images(tmp_path)
    seen = write_store(tmp_path / "seen.zarr", of_arrays(xyz, faces, uv=uv, images=references))
    picture(0, tmp_path / "0.png", (50, 36))
    (tmp_path / "0.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"0\.png"):
        seen.filter()
    for k in range(2):
        (tmp_path / f"{k}.png").unlink()
    with pytest.raises(InputError, match=r"none of its 2 images is there, such as .*0\.png"):
        seen.filter()
