"""transforms.json: its cameras see the map where ours do, and where COLMAP's do."""

import json
from dataclasses import replace

import numpy as np
import pytest
from seen_maps import files, grey_of, seen_map

from tests.view.view_maps import ODD_MAPS
from tspslam import InputError
from tspslam.io import read_image, read_ply
from tspslam.io.colmap import write_colmap
from tspslam.io.nerfstudio import write_nerfstudio
from tspslam.vision.rig import project
from tspslam.vision.se3 import inverse


@pytest.fixture
def exported(tmp_path):
    def write(map_):
        write_nerfstudio(tmp_path / "out", map_, grey_of(map_))

        def refuse(word):
            raise AssertionError(word)

        return tmp_path / "out", json.loads((tmp_path / "out" / "transforms.json").read_text(), parse_constant=refuse)

    return write


def pixels_of(meta, frame, xyz):
    """Where a camera of transforms.json sees points of its world: OpenGL, pixels from the corner of the first."""
    x, y, z = ((np.column_stack([xyz, np.ones(len(xyz))])) @ np.linalg.inv(frame["transform_matrix"]).T)[:, :3].T
    return np.column_stack([meta["cx"] + meta["fl_x"] * x / -z, meta["cy"] - meta["fl_y"] * y / -z])


def test_each_camera_sees_the_cloud_where_ours_sees_the_map(exported):
    map_ = seen_map()
    folder, meta = exported(map_)
    cloud = read_ply(folder / meta["ply_file_path"])
    assert len(meta["frames"]) == len(map_.keyframes)
    for k, frame in enumerate(meta["frames"]):
        T = inverse(map_.T_world_camera[k])
        ours = project(map_.rig, map_.xyz @ T[:3, :3].T + T[:3, 3])
        assert np.abs(pixels_of(meta, frame, cloud.xyz) - 0.5 - ours).max() < 1e-9


def test_the_world_is_ours_with_z_up(exported):
    map_ = seen_map()
    folder, meta = exported(map_)
    xyz = read_ply(folder / meta["ply_file_path"]).xyz
    assert np.array_equal(xyz, np.column_stack([map_.xyz[:, 0], map_.xyz[:, 2], -map_.xyz[:, 1]]))
    first = np.array(meta["frames"][0]["transform_matrix"])  # at the start, level: looks along +y, its top is +z
    assert np.array_equal(first[:3, 2], [0, -1, 0])
    assert np.array_equal(first[:3, 1], [0, 0, 1])


def test_it_agrees_with_the_colmap_export(exported, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    map_ = seen_map()
    folder, meta = exported(map_)
    write_colmap(tmp_path / "colmap", map_, grey_of(map_))
    model = pycolmap.Reconstruction(tmp_path / "colmap" / "sparse" / "0")
    assert [meta[name] for name in ("fl_x", "fl_y", "cx", "cy")] == model.cameras[1].params.tolist()
    xyz = read_ply(folder / meta["ply_file_path"]).xyz
    for k, frame in enumerate(meta["frames"]):
        image = model.images[k + 1]
        assert frame["file_path"] == f"images/{image.name}"
        theirs = np.array([image.project_point(model.points3D[i + 1].xyz) for i in range(len(xyz))])
        assert np.abs(pixels_of(meta, frame, xyz) - theirs).max() < 1e-9
    assert {k: v for k, v in files(folder).items() if "images" in k}.items() <= files(tmp_path / "colmap").items()


def test_every_image_is_there_with_the_size_that_is_said(exported):
    map_ = seen_map()
    folder, meta = exported(map_)
    for row, frame in enumerate(meta["frames"]):
        image = read_image(folder / frame["file_path"])
        assert image.shape == (meta["h"], meta["w"], 3)
        assert np.array_equal(image[..., 1], grey_of(map_)(row))


def test_the_cloud_has_the_colours_that_colmap_s_points_have(exported, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    map_ = seen_map()
    folder, meta = exported(map_)
    write_colmap(tmp_path / "colmap", map_, grey_of(map_))
    model = pycolmap.Reconstruction(tmp_path / "colmap" / "sparse" / "0")
    cloud = read_ply(folder / meta["ply_file_path"])
    theirs = np.array([model.points3D[i + 1].color for i in range(len(map_))])
    for k, name in enumerate(("red", "green", "blue")):
        assert cloud.vertex[name].dtype == np.uint8
        assert np.array_equal(cloud.vertex[name], theirs[:, k])


def test_the_same_map_gives_the_same_bytes(tmp_path):
    for name in "ab":
        map_ = seen_map()
        write_nerfstudio(tmp_path / name, map_, grey_of(map_))
    assert files(tmp_path / "a") == files(tmp_path / "b")


@pytest.mark.parametrize("name", ODD_MAPS)
def test_odd_maps_are_written(name, exported):
    map_ = ODD_MAPS[name]()
    folder, meta = exported(map_)
    assert len(read_ply(folder / meta["ply_file_path"]).xyz) == len(map_)
    assert np.isfinite([frame["transform_matrix"] for frame in meta["frames"]]).all()


def test_a_camera_with_skew_is_refused(tmp_path):
    map_ = seen_map()
    with pytest.raises(InputError, match="nerfstudio: the camera has a skew"):
        write_nerfstudio(tmp_path / "out", replace(map_, rig=replace(map_.rig, skew=1.0)), grey_of(map_))
    assert not list(tmp_path.iterdir())
