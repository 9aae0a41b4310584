"""A mesh and a posed image, from arrays, trimesh or files, to a complex with signals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._checks import check_pixels, require
from .._files import PathLike
from ..datasets.maps import read_levelled
from ..errors import InputError
from ..io import read_mesh
from ..topology.complex import Complex, build_complex
from ..topology.texture import sample_signals
from ..types import Cloud, FloatArray, Image, Rig, Signals, Surface, real_array
from ..vision.calibration.formats import read_rectified
from ..vision.visibility import visible_uv

_FARTHEST, _NEAREST = 1e9, 1e-9  # m
_MIN_DISPARITY = 0.25  # px: what a good stereo matcher still measures; depths beyond are hardly metres
_USUAL_BASELINE = 0.1  # m, of stereo cameras held in the hand: stands in for that of a single camera


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
        The camera; a single one needs no baseline.

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
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, width=40, height=30)
    >>> textured = from_arrays([[0, 0, 5], [1, 0, 5], [0, 1, 5.0]], [[0, 1, 2]], np.full((30, 40), 0.5), camera)
    >>> textured.signals.face.tolist()
    [0.5]
    """
    require(rig, Rig, "rig")
    check_pixels("image", image)
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
        behind = " (all are behind the camera: z points forward)" if (points[:, 2] <= 0).all() else ""
        raise InputError(
            f"none of {len(points)} vertices falls into the image{behind}, expected the camera's frame, metres"
        )
    depth = np.where(np.isnan(uv[:, 0]) | (points[:, 2] < _NEAREST), np.nan, points[:, 2])
    disparity = rig.fx * rig.baseline / depth - rig.doffs if rig.baseline else np.full(len(points), np.nan)
    cloud = Cloud(points, uv, disparity)
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
    >>> camera = Rig(fx=50, fy=50, cx=20, cy=15, width=40, height=30)
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
        A calibration file of a rectified pair, or of our own of a single camera, which needs no baseline.
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


def doubts_of_mesh(textured: Textured, rig: Rig) -> list[str]:
    """What looks wrong with a mesh before a camera though it can be computed with: a line each.

    Parameters
    ----------
    textured : Textured
        As `from_arrays` makes it.
    rig : Rig
        The camera.

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
    >>> doubts_of_mesh(from_arrays(mm, [[0, 1, 2]], np.zeros((30, 40)), camera), camera)
    ['the mesh is 5000 m away in the median, a disparity of 0.001 px: is it in millimetres? Expected metres']
    """
    z = textured.cloud.xyz[:, 2]
    found = []
    behind = int((z[np.unique(textured.complex_.faces)] <= 0).sum())
    if behind:
        found.append(
            f"{behind} of the mesh's vertices are behind the camera (z <= 0), {int((z > 0).sum())} before it: a mesh "
            "around the camera, or in another frame than its own (x right, y down, z forward); faces across it hide "
            "nothing"
        )
    depth = float(np.median(z[textured.signals.vertex_ok]))
    disparity = rig.fx * (rig.baseline or _USUAL_BASELINE) / depth
    away = f"the mesh is {depth:.6g} m away in the median"
    if rig.baseline:
        away += f", a disparity of {disparity:.3g} px"
    if disparity < _MIN_DISPARITY:
        found.append(f"{away}: is it in millimetres? Expected metres")
    elif rig.baseline and disparity > rig.width:
        found.append(f"{away}, more than the image is wide: is it in another unit? Expected metres")
    return found


def _check_distance(xyz: FloatArray) -> None:
    far = np.flatnonzero(~(np.abs(xyz).max(axis=1, initial=0) <= _FARTHEST))
    if len(far):
        raise InputError(f"vertex {far[0]} is at {xyz[far[0]].tolist()}, expected metres, at most {_FARTHEST:g}")
