"""What a face hides from the camera of an image has no signal in tiles either: the same bits as of the whole."""

import numpy as np
import pytest

import tspslam
from tspslam import Rig
from tspslam.cli.entry import exit_code
from tspslam.scale import ImageReference, open_store, write_store
from tspslam.scale.stores import tiled_filter
from tspslam.scale.stores.hidden import draw_depths
from tspslam.scale.stores.sources import of_arrays

from .meshes import picture, same_bits, tangled, two_images

RIG = Rig(fx=60, fy=61, cx=30, cy=25, width=60, height=50)


def turned(angle, place):
    T = np.eye(4)
    T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    T[:3, 3] = place
    return T


def two_walls(folder, seed=41, chunk=24):
    """A wall with another one, half as wide, before a part of it; cameras: two before both, one that looks away."""
    back, faces, _ = tangled(seed, 260)
    front, more, _ = tangled(seed + 1, 120)
    xyz = np.concatenate([back + np.array([0, 0, 3]), front * (0.5, 0.5, 1) + np.array([1.5, 1, 0])])
    faces = np.concatenate([faces, more + len(back)])
    order = np.random.default_rng(seed).permutation(len(xyz))
    xyz, faces = xyz[np.argsort(order)], order[faces]
    poses = [turned(0, (3, 2.5, 0)), turned(0.3, (1, 2.4, 0.5)), turned(3.1, (3, 2.5, 0))]
    pixels = [picture(k, folder / f"{k}.png") for k in range(3)]
    references = [ImageReference(folder / f"{k}.png", RIG, pose) for k, pose in enumerate(poses)]
    image = np.random.default_rng(seed).integers(-1, 3, len(xyz))
    store = write_store(folder / "a.zarr", of_arrays(xyz, faces, image=image, images=references), chunk=chunk)
    return store, xyz, faces, image, references, pixels


def whole(xyz, faces, image, references, pixels, tolerance):
    complex_ = tspslam.build_complex(faces, len(xyz))
    z, defined = np.zeros(len(xyz), complex), np.zeros(len(xyz), bool)
    for k, (reference, plane) in enumerate(zip(references, pixels, strict=True)):
        seen = tspslam.visible_uv(RIG, reference.in_camera(xyz), faces, tolerance=tolerance)
        response = tspslam.tmahf(complex_, seen, tspslam.sample_signals(plane, seen, complex_))
        z[image == k], defined[image == k] = response.z[image == k], response.defined[image == k]
    return z, defined


@pytest.mark.parametrize("tolerance", [0.0, 0.05, 0.5])
def test_with_occlusion_tiles_are_the_whole(tmp_path, tolerance):
    store, *mesh = two_walls(tmp_path)
    z, defined = whole(*mesh, tolerance)
    for tile in (17, 300):
        response = store.filter(occlusion=tolerance, tile=tile).read()
        assert same_bits(response, z, defined)
        store = write_store(tmp_path / f"{tile}.zarr", of_arrays(*mesh[:2], image=mesh[2], images=mesh[3]), chunk=50)
    assert 0 < defined.sum() < store.filter().read().defined.sum()


def test_only_chunks_that_may_be_in_the_image_are_drawn_and_the_buffer_is_that_of_all(tmp_path, monkeypatch):
    from tspslam.scale.stores import hidden

    v, u = np.mgrid[:30, :30].reshape(2, -1)
    a = (np.arange(29)[:, None] * 30 + np.arange(29)).ravel()
    faces = np.concatenate([np.stack([a, a + 30, a + 1], 1), np.stack([a + 1, a + 30, a + 31], 1)])
    picture(0, tmp_path / "0.png")
    poses = [turned(0, (3, 4, 0)), turned(0.5, (20, 15, 0)), turned(np.pi, (15, 15, 0))]
    references = [ImageReference(tmp_path / "0.png", RIG, pose) for pose in poses]
    wall = of_arrays(np.stack([u, v, 8 + 0.1 * u], axis=1), faces, images=references)
    mesh = write_store(tmp_path / "a.zarr", wall, chunk=16).mesh
    hidden._boxes(mesh)
    drawn, load = [], hidden._load
    monkeypatch.setattr(hidden, "_load", lambda store, chunk: drawn.append(chunk) or load(store, chunk))
    for k in range(3):
        drawn.clear()
        some, count = draw_depths(mesh, k), len(drawn)
        with monkeypatch.context() as patch:
            patch.setattr(hidden, "_may_be_in", lambda _, boxes: np.ones(len(boxes), bool))
            assert np.array_equal(some, draw_depths(mesh, k))
        assert count < len(mesh.face_end) == len(drawn) - count
        assert (some.any(), count > 0) == (k < 2, k < 2)


def test_with_and_without_occlusion_are_two_responses_and_open_again(tmp_path):
    store, *_ = two_walls(tmp_path)
    store.filter(), store.filter(occlusion=0.05)
    assert open_store(store.path).responses == ("tmahf-1-harmonic", "tmahf-1-harmonic-seen-0.05")
    assert store.response("tmahf-1-harmonic-seen-0.05").options.occlusion == 0.05
    assert store.response("tmahf-1-harmonic").options.occlusion is None


@pytest.mark.parametrize("share", [-0.1, 1.0, np.nan, True, "much"])
def test_a_share_that_is_none_is_refused(tmp_path, share):
    store, *_ = two_walls(tmp_path)
    with pytest.raises(tspslam.InputError, match=r"occlusion is .*, expected 0 to 1"):
        store.filter(occlusion=share)


def test_no_share_has_one_name():
    names = {tiled_filter.Options.checked(1, None, None, share).name for share in (0, 0.0, -0.0)}
    assert names == {"tmahf-1-harmonic-seen-0.0"}


def test_occlusion_without_a_camera_is_refused_in_a_line(tmp_path, capsys):
    xyz, faces, uv = tangled(42, 60)
    references, _ = two_images(tmp_path)
    write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, uv=uv, images=references))
    assert exit_code(["filter", str(tmp_path / "a.zarr"), "--occlusion", "0.05"]) == 3
    assert "has no image with a camera" in " ".join(capsys.readouterr().err.split())


def test_occlusion_is_typed_for_a_store_alone(tmp_path, capsys):
    store, *_ = two_walls(tmp_path)
    assert exit_code(["filter", str(store.path), "--occlusion", "0.05"]) == 0
    assert "tmahf-1-harmonic-seen-0.05" in capsys.readouterr().out
    assert exit_code(["filter", "a.ply", "--image", "a.png", "--calib", "c", "--occlusion", "0.05"]) == 2
    assert "goes with a store" in capsys.readouterr().err
