"""A map's keyframes as nerfstudio takes them: ``transforms.json``, the images, and the vertices as a cloud."""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._files import PathLike
from ..topological_map import TopologicalMap
from ..types import FloatArray
from ._folders import new_folder
from ._views import IMAGES, TO_CORNER, ImageOf, check_views, image_name, write_images
from .ply import write_ply

CLOUD = "sparse_pc.ply"
T_UP_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns our world (x right, y down, z forward) to nerfstudio's (x right, y forward, z up)."""
_T_CAMERA_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])  # x right, y up, z back


def write_nerfstudio(path: PathLike, map_: TopologicalMap, image_of: ImageOf) -> None:
    """Write a map's keyframes for nerfstudio: a folder, whole or not at all; the same map gives the same bytes.

    ``transforms.json`` has one camera, ``OPENCV`` without distortion, and the pose of each keyframe, whose left image,
    rectified, is in ``images``, named by the number of its frame; ``sparse_pc.ply`` has the map's vertices with the
    mean colour of their observations, from which splats start. Cameras look along -z with y up (OpenGL), the world has
    z up: it is ours, turned by `T_UP_WORLD`; m.

    Parameters
    ----------
    path : str or path
        The folder to make; not there yet, or empty.
    map_ : TopologicalMap
        As `tspslam.build_map` gives it.
    image_of : callable, (int) -> (H, W) or (H, W, 3) uint8, uint16 or float array
        Gives the left image of a keyframe, by its row in ``map_.keyframes``. Written with three channels of 8 bits.

    Raises
    ------
    InputError
        If something is there already, the camera has a skew, or an image has not the size that the camera says.
    OutputError
        If a file cannot be written.

    Notes
    -----
    The format is that of https://docs.nerf.studio/quickstart/data_conventions.html. There is no ``applied_transform``:
    versions of nerfstudio differ in whether they apply it to the cloud too, so that poses and cloud are in one world.
    Pixels are moved by half of one: nerfstudio's first pixel has its centre at (0.5, 0.5).
    """
    check_views(map_, "nerfstudio")
    with new_folder(path) as folder:
        text = json.dumps(_transforms(map_), indent=1, allow_nan=False) + "\n"
        write_bytes(folder / "transforms.json", text.encode("ascii"))
        _write_cloud(folder / CLOUD, map_, write_images(folder, map_, image_of))


def _transforms(map_: TopologicalMap) -> dict[str, object]:
    rig = map_.rig
    poses: FloatArray = T_UP_WORLD @ map_.T_world_camera @ _T_CAMERA_OPENGL
    frames = [
        {"file_path": f"{IMAGES}/{image_name(map_, k)}", "transform_matrix": (pose + 0.0).tolist()}
        for k, pose in enumerate(poses)
    ]
    return {
        "camera_model": "OPENCV",
        "fl_x": float(rig.fx), "fl_y": float(rig.fy),
        "cx": float(rig.cx + TO_CORNER), "cy": float(rig.cy + TO_CORNER),
        "w": int(rig.width), "h": int(rig.height),
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
        "ply_file_path": CLOUD,
        "frames": frames,
    }  # fmt: skip


def _write_cloud(path: PathLike, map_: TopologicalMap, rgb: NDArray[np.uint8]) -> None:
    xyz = map_.xyz @ T_UP_WORLD[:3, :3].T
    colours = {name: rgb[:, k] for k, name in enumerate(("red", "green", "blue"))}
    write_ply(path, xyz, np.empty((0, 3), np.int32), vertex=colours)
