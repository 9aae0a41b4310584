"""A map as COLMAP's model: read by pycolmap, it is the same map, seen by the same cameras."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from seen_maps import files, grey_of, observed, seen_map

from tests.view.view_maps import ODD_MAPS
from tspslam import InputError
from tspslam.interop import from_colmap
from tspslam.io.colmap import write_colmap
from tspslam.topological_map import Observations
from tspslam.vision.se3 import inverse


@pytest.fixture
def exported(tmp_path):
    def write(map_):
        write_colmap(tmp_path / "out", map_, grey_of(map_))
        return tmp_path / "out"

    return write


@pytest.fixture
def read(exported):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    return lambda map_: pycolmap.Reconstruction(exported(map_) / "sparse" / "0")


def test_pycolmap_reads_the_same_camera_poses_and_points(read):
    map_ = seen_map()
    model = read(map_)
    rig, camera = map_.rig, model.cameras[1]
    assert (camera.model.name, camera.width, camera.height) == ("PINHOLE", rig.width, rig.height)
    assert camera.params.tolist() == [rig.fx, rig.fy, rig.cx + 0.5, rig.cy + 0.5]
    assert sorted(model.images) == [1, 2, 3, 4]
    for k, T_world_camera in enumerate(map_.T_world_camera):
        image = model.images[k + 1]
        assert image.name == f"{map_.keyframes[k]:06d}.png"
        assert np.abs(image.cam_from_world().matrix() - inverse(T_world_camera)[:3]).max() < 1e-12
    assert sorted(model.points3D) == list(range(1, len(map_) + 1))
    for i, point in model.points3D.items():
        assert np.array_equal(point.xyz, map_.xyz[i - 1])


def test_points_have_the_mean_colour_of_the_pixels_that_observe_them(read):
    map_ = seen_map(noise=0.3)
    model, seen = read(map_), map_.observations
    images = [grey_of(map_)(row) for row in range(4)]
    for i, point in model.points3D.items():
        rows = range(seen.start[i - 1], seen.start[i])
        places = [np.clip(np.rint(seen.uv[row]), 0, (89, 59)).astype(int) for row in rows]
        grey = np.mean([images[seen.keyframe[row]][v, u] for row, (u, v) in zip(rows, places, strict=True)])
        assert np.array_equal(point.color, [np.rint(grey)] * 3)


def test_each_track_is_the_observations_of_its_vertex(read):
    map_ = seen_map(noise=0.3)
    model, seen = read(map_), map_.observations
    assert model.is_valid() if hasattr(model, "is_valid") else True
    assert model.compute_num_observations() == len(seen)
    for i, point in model.points3D.items():
        rows = slice(seen.start[i - 1], seen.start[i])
        elements = point.track.elements
        assert [each.image_id - 1 for each in elements] == seen.keyframe[rows].tolist()
        found = [model.images[each.image_id].points2D[each.point2D_idx] for each in elements]
        assert all(each.point3D_id == i for each in found)
        assert np.abs([each.xy - 0.5 for each in found] - seen.uv[rows]).max() < 1e-12


def test_the_stated_error_is_the_distance_of_observations_from_where_a_point_projects(read):
    model = read(seen_map(noise=0.3))
    stated = {i: point.error for i, point in model.points3D.items()}
    for i, point in model.points3D.items():
        ends = [(model.images[each.image_id], each.point2D_idx) for each in point.track.elements]
        off = [np.linalg.norm(image.project_point(point.xyz) - image.points2D[k].xy) for image, k in ends]
        assert abs(np.mean(off) - stated[i]) < 1e-9
    model.update_point_3d_errors()
    assert max(abs(point.error - stated[i]) for i, point in model.points3D.items()) < 1e-9
    assert 0.1 < np.mean(list(stated.values())) < 0.6


def test_without_noise_points_project_onto_their_observations(read):
    assert max(point.error for point in read(seen_map()).points3D.values()) < 1e-9


def test_images_are_the_keyframes_pixel_for_pixel(exported):
    map_ = seen_map()
    folder = exported(map_)
    for row, number in enumerate(map_.keyframes):
        with Image.open(folder / "images" / f"{number:06d}.png") as image:
            grey = grey_of(map_)(row)
            assert np.array_equal(np.asarray(image), np.stack([grey] * 3, axis=2))


@pytest.mark.parametrize(
    ("image", "expected"),
    [
        (np.full((60, 90, 3), (3, 2, 1), np.uint8), (3, 2, 1)),
        (np.full((60, 90), 65535, np.uint16), (255, 255, 255)),
        (np.full((60, 90, 3), 0.2, np.float32), (51, 51, 51)),
    ],
    ids=["colour", "16 bits", "floats"],
)
def test_other_pixels_are_written_as_8_bits(tmp_path, image, expected):
    write_colmap(tmp_path / "out", seen_map(1), lambda row: image)
    with Image.open(tmp_path / "out" / "images" / "000000.png") as written:
        assert written.getpixel((7, 8)) == expected


def test_the_same_map_gives_the_same_bytes(tmp_path):
    for name in "ab":
        map_ = seen_map()
        write_colmap(tmp_path / name, map_, grey_of(map_))
    assert files(tmp_path / "a") == files(tmp_path / "b")


def test_what_colmap_writes_as_text_is_read_back_as_a_frame_of_the_map(read, tmp_path):
    map_ = seen_map()
    model = read(map_)
    (tmp_path / "text").mkdir()
    model.write_text(tmp_path / "text")
    frame = from_colmap(tmp_path / "text", "000010.png", grey_of(map_)(2))
    assert np.abs(frame.T_world_camera - map_.T_world_camera[2]).max() < 1e-9
    assert frame.rig.cx == map_.rig.cx
    assert frame.rig.cy == map_.rig.cy
    xyz = frame.cloud.xyz @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
    assert np.abs(xyz - map_.xyz[frame.landmark - 1]).max() < 1e-9


def test_what_colmap_cannot_hold_is_left_out(read):
    """A vertex behind its cameras, and one whose observation has no pixel; ids of the others stay."""
    map_ = observed(seen_map())
    xyz, uv = map_.xyz.copy(), map_.observations.uv.copy()
    xyz[3, 2] = -50.0
    uv[map_.observations.vertex == 5] = np.nan
    seen = replace(map_.observations, uv=uv)
    with np.errstate(all="raise"):
        model = read(replace(map_, xyz=xyz, observations=seen))
    assert set(range(1, len(map_) + 1)) - set(model.points3D) == {4, 6}


@pytest.mark.parametrize("name", ODD_MAPS)
def test_odd_maps_are_read(name, read):
    map_ = ODD_MAPS[name]()
    model = read(map_)
    assert len(model.images) == len(map_.keyframes)
    assert all(np.isfinite(point.xyz).all() and np.isfinite(point.error) for point in model.points3D.values())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda map_: None, "map_ is NoneType, expected a TopologicalMap"),
        (lambda map_: replace(map_, rig=replace(map_.rig, skew=0.5)), "COLMAP: the camera has a skew of 0.5 px"),
        (lambda map_: replace(map_, T_world_camera=2 * map_.T_world_camera), "holds no rigid motion"),
        (lambda map_: replace(map_, keyframes=map_.keyframes[:0]), "the map has no keyframe"),
    ],
)
def test_a_map_that_cannot_be_exported_is_refused(tmp_path, change, said):
    map_ = seen_map()
    with pytest.raises(InputError, match=said):
        write_colmap(tmp_path / "out", change(map_), grey_of(map_))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((10, 90), np.uint8), "image of frame 0 is 90 x 10 px, expected 90 x 60 px as the camera"),
        (np.zeros((60, 90), np.int32), "image of frame 0 is int32"),
        (None, "image of frame 0 is NoneType"),
    ],
)
def test_an_image_that_does_not_fit_is_refused_and_nothing_is_left(tmp_path, image, said):
    with pytest.raises(InputError, match=said):
        write_colmap(tmp_path / "out", seen_map(), lambda row: image)
    assert not list(tmp_path.iterdir())


def test_a_map_without_an_observation_has_images_alone(read):
    nothing = np.zeros(0)
    map_ = seen_map()
    none = Observations(
        np.zeros(len(map_) + 1, np.int64), nothing.astype(np.int64), nothing.reshape(0, 2), nothing, nothing
    )
    model = read(replace(map_, observations=none))
    assert (len(model.images), len(model.points3D)) == (4, 0)
