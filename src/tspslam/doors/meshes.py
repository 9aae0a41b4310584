"""A mesh and a posed image, from arrays, trimesh or files, to a complex with signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._files import PathLike
from ..datasets.maps import read_levelled
from ..errors import InputError
from ..io import read_mesh
from ..topology.complex import Complex, build_complex
from ..topology.texture import sample_signals
from ..types import Cloud, FloatArray, Image, Rig, Signals, Surface, real_array
from ..vision.formats import read_rectified
from ..vision.visibility import visible_uv

_FARTHEST, _NEAREST = 1e9, 1e-9  # m


@dataclass(frozen=True)
class Textured:
    """A surface with the texture of an image on every level.

    Attributes
    ----------
    cloud : Cloud
        Vertices in the camera's frame and their projections; NaN where the camera does not see one.
    surface : Surface
        Triangles.
    complex_ : Complex
        The complex of the triangles.
    signals : Signals
        Luminance on vertices, edges and faces; what the camera does not see is marked.
    """

    cloud: Cloud
    surface: Surface
    complex_: Complex
    signals: Signals


def from_arrays(xyz: ArrayLike, faces: ArrayLike, image: Image, rig: Rig) -> Textured:
    """Put the texture of an image on a mesh.

    Parameters
    ----------
    xyz : (N, 3) array
        Vertices in the frame of the left camera (x right, y down, z forward), m.
    faces : (F, 3) integers
        Triangles.
    image : (H, W) or (H, W, 3) array
        What the left camera saw: uint8, uint16, or float in [0, 1].
    rig : Rig
        The camera; of a single one the baseline is 1.

    Returns
    -------
    Textured
        Vertices behind faces have no signal.

    Raises
    ------
    InputError
        If an array is not as described, or the camera sees no vertex.

    Examples
    --------
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, baseline=1, width=40, height=30)
    >>> textured = from_arrays([[0, 0, 5], [1, 0, 5], [0, 1, 5.0]], [[0, 1, 2]], np.full((30, 40), 0.5), camera)
    >>> textured.signals.face.tolist()
    [0.5]
    """
    points = np.ascontiguousarray(real_array(xyz, "xyz", "(N, 3)"), np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"xyz has shape {points.shape}, expected (N, 3)")
    if np.shape(image)[:2] != (rig.height, rig.width):
        raise InputError(f"image has shape {np.shape(image)}, expected the camera's {rig.height} x {rig.width}")
    _check_distance(points)
    complex_ = build_complex(faces, len(points))
    triangles = np.asarray(faces)
    uv = visible_uv(rig, points, triangles if len(triangles) else None)
    signals = sample_signals(image, uv, complex_)
    if not signals.vertex_ok.any():
        raise InputError(f"none of {len(points)} vertices falls into the image, expected the camera's frame, metres")
    depth = np.where(np.isnan(uv[:, 0]) | (points[:, 2] < _NEAREST), np.nan, points[:, 2])
    cloud = Cloud(points, uv, rig.fx * rig.baseline / depth - rig.doffs)
    is_same = len(triangles) == len(complex_.faces)
    kept = triangles.reshape(-1, 3).astype(np.int32) if is_same else complex_.faces
    return Textured(cloud, Surface(kept), complex_, signals)


def from_trimesh(mesh: Any, image: Image, rig: Rig) -> Textured:
    """Put the texture of an image on a trimesh mesh, or anything else with ``vertices`` and ``faces``.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Vertices in the camera's frame, m.
    image, rig
        As `from_arrays`.

    Returns
    -------
    Textured

    Raises
    ------
    InputError
        As `from_arrays`, or if there are no vertices and faces.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> mesh = SimpleNamespace(vertices=[[0, 0, 5], [1, 0, 5], [0, 1, 5.0]], faces=[[0, 1, 2]])
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, baseline=1, width=40, height=30)
    >>> from_trimesh(mesh, np.zeros((30, 40)), camera).complex_.euler
    1
    """
    if not hasattr(mesh, "vertices") or not hasattr(mesh, "faces"):
        raise InputError(f"mesh is {type(mesh).__name__}, expected something with vertices and faces, as of trimesh")
    return from_arrays(np.asarray(mesh.vertices), np.asarray(mesh.faces), image, rig)


def from_file(mesh: PathLike, image: PathLike, calibration: PathLike, *, bits: int | None = None) -> Textured:
    """Put the texture of an image on a mesh, both from files.

    Parameters
    ----------
    mesh : path
        .ply, .vtu, .obj or a stored frame; vertices in the camera's frame, m.
    image : path
        What the left camera saw.
    calibration : path
        A calibration file of a rectified pair.
    bits : int, optional
        How many bits the image's pixels use if they have 16; found by default.

    Returns
    -------
    Textured

    Raises
    ------
    InputError
        If a file cannot be used, or the camera sees no vertex.
    """
    pixels, _ = read_levelled(image, bits)
    rig = read_rectified(calibration, (pixels.shape[1], pixels.shape[0]))
    xyz, faces = read_mesh(mesh)
    try:
        return from_arrays(xyz, faces, pixels, rig)
    except InputError as error:
        raise InputError(f"{mesh}: {error}") from error


def _check_distance(xyz: FloatArray) -> None:
    far = np.flatnonzero(~(np.abs(xyz).max(axis=1, initial=0) <= _FARTHEST))
    if len(far):
        raise InputError(f"vertex {far[0]} is at {xyz[far[0]].tolist()}, expected metres, at most {_FARTHEST:g}")
