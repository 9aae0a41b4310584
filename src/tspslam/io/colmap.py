"""A map as COLMAP's model: camera, keyframes with what they observe, points with their tracks, and the images."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._files import PathLike
from ..topological_map import TopologicalMap
from ..types import FloatArray, Rig
from ..vision.rig import project
from ..vision.se3 import inverse
from ._folders import new_folder
from ._views import TO_CORNER, ImageOf, check_views, image_name, write_images
from .trajectory import quaternions

_PINHOLE = 1  # of COLMAP's models: fx, fy, cx, cy
_CAMERA = 1  # the number of the only one
_POINT_2D = np.dtype([("uv", "<f8", 2), ("point", "<u8")])
_POINT = np.dtype([("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("length", "<u8")])
_TRACK = np.dtype([("image", "<u4"), ("place", "<u4")])


@dataclass(frozen=True)
class _Seen:
    """Observations that COLMAP can take, by vertex and then by keyframe.

    `place` is the row of each among those of its keyframe; `error` its distance from where the vertex projects, px.
    """

    vertex: NDArray[np.int64]
    view: NDArray[np.int64]
    uv: FloatArray
    place: NDArray[np.int64]
    error: FloatArray


def write_colmap(path: PathLike, map_: TopologicalMap, image_of: ImageOf) -> None:
    """Write a map as a COLMAP model with its images: a folder, whole or not at all; the same map gives the same bytes.

    ``sparse/0`` has ``cameras.bin``, ``images.bin`` and ``points3D.bin``, as every version of COLMAP reads them;
    ``images`` the left images of the keyframes, rectified, named by the numbers of their frames. Image k + 1 is
    keyframe k, point i + 1 is vertex i; the world is that of the map. Pixels are moved by half of one: COLMAP's first
    pixel has its centre at (0.5, 0.5).

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
    The format is that of https://colmap.github.io/format.html. Left out are observations without a pixel or behind
    their camera, and points that nothing else observes. A point's error is the mean distance, in px, of its
    observations from where it projects; its colour the mean of their pixels.
    """
    check_views(map_, "COLMAP")
    seen = _observations(map_)
    with new_folder(path) as folder:
        model = folder / "sparse" / "0"
        model.mkdir(parents=True)
        write_bytes(model / "cameras.bin", _cameras(map_.rig))
        write_bytes(model / "images.bin", _images(map_, seen))
        rgb = write_images(folder, map_, image_of)
        write_bytes(model / "points3D.bin", _points(map_, seen, rgb))


def _observations(map_: TopologicalMap) -> _Seen:
    given = map_.observations
    T = inverse(map_.T_world_camera)[given.keyframe]
    xyz = np.einsum("oij,oj->oi", T[:, :3, :3], map_.xyz[given.vertex]) + T[:, :3, 3]
    error = np.linalg.norm(project(map_.rig, xyz) - given.uv, axis=1)
    ok = np.isfinite(error)
    vertex, view = given.vertex[ok], given.keyframe[ok]
    order = np.argsort(view, kind="stable")
    first = np.searchsorted(view[order], np.arange(len(map_.keyframes)))
    place = np.empty(len(view), np.int64)
    place[order] = np.arange(len(view)) - first[view[order]]
    return _Seen(vertex, view, given.uv[ok], place, error[ok])


def _cameras(rig: Rig) -> bytes:
    head = struct.pack("<QIiQQ", 1, _CAMERA, _PINHOLE, rig.width, rig.height)
    return head + struct.pack("<4d", rig.fx, rig.fy, rig.cx + TO_CORNER, rig.cy + TO_CORNER)


def _images(map_: TopologicalMap, seen: _Seen) -> bytes:
    T_camera_world = inverse(map_.T_world_camera)
    q = quaternions(T_camera_world[:, :3, :3])[:, [3, 0, 1, 2]]
    table = np.empty(len(seen.view), _POINT_2D)
    table["uv"], table["point"] = seen.uv + TO_CORNER, seen.vertex + 1
    order = np.argsort(seen.view, kind="stable")
    bounds = np.searchsorted(seen.view[order], np.arange(len(q) + 1))
    parts = [struct.pack("<Q", len(q))]
    for k, (start, stop) in enumerate(pairwise(bounds)):
        pose = *q[k].tolist(), *T_camera_world[k, :3, 3].tolist()
        parts.append(struct.pack("<I7dI", k + 1, *pose, _CAMERA))
        parts.append(image_name(map_, k).encode("ascii") + b"\0")
        parts.append(struct.pack("<Q", stop - start) + table[order[start:stop]].tobytes())
    return b"".join(parts)


def _points(map_: TopologicalMap, seen: _Seen, rgb: NDArray[np.uint8]) -> bytes:
    count = np.bincount(seen.vertex, minlength=len(map_))
    table = np.empty(len(map_), _POINT)
    table["id"], table["xyz"], table["rgb"] = np.arange(len(map_)) + 1, map_.xyz, rgb
    table["error"] = np.bincount(seen.vertex, seen.error, minlength=len(map_)) / np.maximum(count, 1)
    table["length"] = count
    tracks = np.empty(len(seen.vertex), _TRACK)
    tracks["image"], tracks["place"] = seen.view + 1, seen.place
    stop = np.cumsum(count)
    kept = np.flatnonzero(count)
    parts = [struct.pack("<Q", len(kept))]
    parts += [table[i].tobytes() + tracks[stop[i] - count[i] : stop[i]].tobytes() for i in kept]
    return b"".join(parts)
