"""A mesh and a posed image, from arrays, trimesh or files, to a complex with signals."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_pixels, require, told
from .._files import PathLike, one_line
from ..datasets.maps import read_levelled
from ..errors import InputError
from ..frame import Frame, Once
from ..io import read_mesh
from ..topology.complex import build_complex
from ..topology.harmonic import Tmahf
from ..topology.texture import sample_signals
from ..types import Cloud, FloatArray, Image, Rig, Surface, real_array
from ..vision.calibration.formats import read_rectified
from ..vision.se3 import normalised
from ..vision.visibility import visible_uv

_FARTHEST, _NEAREST = 1e9, 1e-9  # m
_MIN_DISPARITY = 0.25  # px: what a good stereo matcher still measures; depths beyond are hardly metres
_ROTATION = 1e-3  # what rotations in calibration files may be off by, too
_ROUNDING = 1e-9
_USUAL_BASELINE = 0.1  # m, of stereo cameras held in the hand: stands in for that of a single camera


def from_arrays(
    xyz: ArrayLike, faces: ArrayLike, image: Image, rig: Rig,
    *, name: str = "mesh", T_world_camera: ArrayLike | None = None,
) -> Frame:  # fmt: skip
    """Put the texture of an image on a mesh.

    Parameters
    ----------
    xyz : (N, 3) float array
        Vertices, m, in the world of `T_world_camera`; without one, in the frame of the left camera (x right, y down,
        z forward).
    faces : (F, 3) integers
        Triangles.
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        What the left camera saw; floats in [0, 1].
    rig : Rig
        The camera; a single one needs no baseline.
    name : str
        What the frame is called.
    T_world_camera : (4, 4) float array, optional
        Where the photo was taken: maps points of the camera's frame to the world, m.

    Returns
    -------
    Frame
        With its pose; its cloud is in the camera's frame. Vertices behind faces have no signal; the response is that of
        the default filter, `tspslam.tmahf`. Without a pose the world is the camera.

    Raises
    ------
    InputError
        If an array is not as described, the pose is no rigid motion, or the camera sees no vertex.

    Examples
    --------
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, width=40, height=30)
    >>> frame = from_arrays([[0, 0, 5], [1, 0, 5], [0, 1, 5.0]], [[0, 1, 2]], np.full((30, 40), 0.5), camera)
    >>> frame.signals.face.tolist()
    [0.5]

    >>> T_world_camera = np.eye(4)
    >>> T_world_camera[:3, 3] = 0, 0, -2  # m: it stood two metres farther back
    >>> there = from_arrays(frame.cloud.xyz, [[0, 1, 2]], frame.image, camera, T_world_camera=T_world_camera)
    >>> there.cloud.xyz[0].tolist()
    [0.0, 0.0, 7.0]
    """
    require(rig, Rig, "rig")
    check_pixels("image", image)
    if np.shape(image)[:2] != (rig.height, rig.width):
        raise InputError(f"image has shape {np.shape(image)}, expected the camera's {rig.height} x {rig.width}")
    T, points = np.eye(4), _positions(xyz)
    if T_world_camera is not None:
        T = _pose(T_world_camera)
        points = (points - T[:3, 3]) @ T[:3, :3]
    complex_ = build_complex(faces, len(points))
    triangles = np.asarray(faces)
    uv = visible_uv(rig, points, triangles if len(triangles) else None)
    signals = sample_signals(image, uv, complex_)
    if not signals.vertex_ok.any():
        behind = " (all are behind the camera: z points forward)" if (points[:, 2] <= 0).all() else ""
        where = "the camera's frame" if T_world_camera is None else "the world's frame and the photo's pose in it"
        raise InputError(f"none of {len(points)} vertices falls into the image{behind}, expected {where}, metres")
    is_same = len(triangles) == len(complex_.faces)
    kept = triangles.reshape(-1, 3).astype(np.int32) if is_same else complex_.faces
    cloud = Cloud(points, uv, _disparity(rig, points, uv))
    response = Once(lambda: Tmahf()(complex_, cloud.uv, signals))
    return Frame(0, 0.0, name, rig, cloud, Surface(kept), complex_, signals, response, image=image, T_world_camera=T)


def _pose(T: ArrayLike) -> FloatArray:
    pose = real_array(T, "T_world_camera", "(4, 4)").astype(np.float64)
    if pose.shape != (4, 4) or not np.isfinite(pose).all() or np.abs(pose[3] - (0, 0, 0, 1)).max() > _ROUNDING:
        raise InputError(f"T_world_camera is {told(pose)}, expected (4, 4) finite numbers with last row 0 0 0 1")
    if np.abs(pose).max() > _FARTHEST:
        raise InputError(f"T_world_camera is at {pose[:3, 3].tolist()}, expected metres, at most {_FARTHEST:g}")
    off = float(np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max())
    if off > _ROTATION or np.linalg.det(pose[:3, :3]) < 0:
        raise InputError(f"T_world_camera holds no rotation (R Rᵀ - I has {off:.2g}), expected one to {_ROTATION:g}")
    return normalised(pose)


def _positions(xyz: ArrayLike) -> FloatArray:
    points = np.ascontiguousarray(real_array(xyz, "xyz", "(N, 3)"), np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"xyz has shape {points.shape}, expected (N, 3)")
    far = np.flatnonzero(~(np.abs(points).max(axis=1, initial=0) <= _FARTHEST))
    if len(far):
        raise InputError(f"vertex {far[0]} is at {points[far[0]].tolist()}, expected metres, at most {_FARTHEST:g}")
    return points


def _disparity(rig: Rig, points: FloatArray, uv: FloatArray) -> FloatArray:
    """What the rig's baseline makes of depths, px; NaN for a single camera, and where a vertex is not seen."""
    if not rig.baseline:
        return np.full(len(points), np.nan)
    depth = np.where(np.isnan(uv[:, 0]) | (points[:, 2] < _NEAREST), np.nan, points[:, 2])
    return rig.fx * rig.baseline / depth - rig.doffs


def from_trimesh(mesh: Any, image: Image, rig: Rig, *, T_world_camera: ArrayLike | None = None) -> Frame:
    """Put the texture of an image on a trimesh mesh, or anything else with ``vertices`` and ``faces``.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Vertices as those of `from_arrays`, m.
    image, rig, T_world_camera
        As `from_arrays`.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        As `from_arrays`, or if there are no vertices and faces.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> mesh = SimpleNamespace(vertices=[[0, 0, 5], [1, 0, 5], [0, 1, 5.0]], faces=[[0, 1, 2]])
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, width=40, height=30)
    >>> from_trimesh(mesh, np.zeros((30, 40)), camera).complex_.euler
    1
    """
    if not hasattr(mesh, "vertices") or not hasattr(mesh, "faces"):
        raise InputError(f"mesh is {type(mesh).__name__}, expected something with vertices and faces, as of trimesh")
    xyz, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    return from_arrays(xyz, faces, image, rig, T_world_camera=T_world_camera)


def from_file(
    mesh: PathLike, image: PathLike, calibration: PathLike,
    *, bits: int | None = None, T_world_camera: ArrayLike | None = None,
) -> Frame:  # fmt: skip
    """Put the texture of an image on a mesh, both from files.

    Parameters
    ----------
    mesh : path
        What `tspslam.io.read_mesh` takes; vertices as those of `from_arrays`, m.
    image : path
        What the left camera saw.
    calibration : path
        A calibration file of a rectified pair, or of our own of a single camera, which needs no baseline.
    bits : int, optional
        How many bits the image's pixels use if they have 16; found by default.
    T_world_camera
        As `from_arrays`.

    Returns
    -------
    Frame

    Raises
    ------
    InputError
        If a file cannot be used, or the camera sees no vertex.
    """
    pixels, _ = read_levelled(image, bits)
    rig = read_rectified(calibration, (pixels.shape[1], pixels.shape[0]))
    xyz, faces = read_mesh(mesh)
    try:
        return from_arrays(xyz, faces, pixels, rig, name=one_line(Path(mesh).stem), T_world_camera=T_world_camera)
    except InputError as error:
        raise InputError(f"{mesh}: {error}") from error


def doubts_of_mesh(frame: Frame) -> list[str]:
    """What looks wrong with a mesh before a camera though it can be computed with: a line each.

    Parameters
    ----------
    frame : Frame
        As `from_arrays` makes it.

    Returns
    -------
    list of str
        Of vertices on both sides of the camera; of depths at which what is seen would have a disparity of under 0.25 px
        in the median, or of more than the image's width, for the rig's baseline. A single camera is taken as one of a
        baseline of 0.1 m, for the former only: a close-up is nothing odd for it.

    Examples
    --------
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, baseline=0.1, width=40, height=30)
    >>> mm = 1000 * np.array([[0, 0, 5], [1, 0, 5], [0, 1, 5.0]])
    >>> doubts_of_mesh(from_arrays(mm, [[0, 1, 2]], np.zeros((30, 40)), camera))
    ['the mesh is 5000 m away in the median, a disparity of 0.001 px: is it in millimetres? Expected metres']
    """
    rig, z = frame.rig, frame.cloud.xyz[:, 2]
    found = []
    behind = int((z[np.unique(frame.complex_.faces)] <= 0).sum())
    if behind:
        found.append(
            f"{behind} of the mesh's vertices are behind the camera (z <= 0), {int((z > 0).sum())} before it: a mesh "
            "around the camera, or in another frame than its own (x right, y down, z forward); faces across it hide "
            "nothing"
        )
    depth = float(np.median(z[frame.signals.vertex_ok]))
    disparity = rig.fx * (rig.baseline or _USUAL_BASELINE) / depth
    away = f"the mesh is {depth:.6g} m away in the median"
    if rig.baseline:
        away += f", a disparity of {disparity:.3g} px"
    if disparity < _MIN_DISPARITY:
        found.append(f"{away}: is it in millimetres? Expected metres")
    elif rig.baseline and disparity > rig.width:
        found.append(f"{away}, more than the image is wide: is it in another unit? Expected metres")
    return found
