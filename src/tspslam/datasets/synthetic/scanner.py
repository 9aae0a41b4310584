"""What a turning LiDAR sees of a scene, and which shape each point is of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._brief import Brief
from ..._settings import Checked, setting
from ...types import FloatArray
from ._checks import instance, number, rigid, whole
from .shapes import Scene

AXES = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""``T_camera_scan`` of a scanner in the camera's place: x ahead, y to the left, z up."""

_ROUND = 1e-6  # rad, of a cone's half angle


@dataclass(frozen=True)
class Scanner(Checked, what="scanner"):
    """A turning scanner whose beams meet in one point; by default much like an HDL-64E.

    Attributes
    ----------
    beams, columns : int
        Rings, and how many points one has if all come back.
    lowest, highest : float
        Elevations of the first and the last beam.
    farthest : float
        What is farther off sends nothing back.
    noise : float
        Standard deviation of a range.

    Raises
    ------
    InputError
        If a value is out of its range.

    Examples
    --------
    >>> Scanner(beams=16).columns
    1875
    """

    beams: int = setting(64, 1, 1024, unit="rings", source="HDL-64E")
    columns: int = setting(1875, 3, 100_000, unit="points", source="120 000 points in all")
    lowest: float = setting(-24.8, -89.0, 89.0, unit="degrees", source="HDL-64E")
    highest: float = setting(2.0, -89.0, 89.0, unit="degrees", source="HDL-64E")
    farthest: float = setting(120.0, 1e-3, 1e6, unit="m", source="HDL-64E")
    noise: float = setting(0.0, 0.0, 1e3, unit="m", source="none")


@dataclass(frozen=True, repr=False)
class Echoes(Brief):
    """Points that came back, ring by ring from the highest beam down, as KITTI's files have them.

    Attributes
    ----------
    xyz : (N, 3) float64
        Places in the scanner's frame, m, with the noise.
    ring : (N,) int64
        Beam of each, 0 being the highest.
    label : (N,) int32
        Number of the shape that was hit, from 1.
    """

    xyz: FloatArray
    ring: NDArray[np.int64]
    label: NDArray[np.int32]


def scan(
    scene: Scene, T_world_scan: ArrayLike, scanner: Scanner | None = None, *, stamp: float = 0.0, seed: int = 0
) -> Echoes:
    """Scan a scene from one place, all beams at one moment.

    Parameters
    ----------
    scene : Scene
        The world.
    T_world_scan : (4, 4) float array
        Pose of the scanner, m; its axis is z.
    scanner : Scanner, optional
        An HDL-64E without noise by default.
    stamp : float
        Time, s.
    seed : int
        Of the noise.

    Returns
    -------
    Echoes

    Raises
    ------
    InputError
        If the pose is no rigid motion, or the scene or the scanner is none.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> wall = synthetic.Scene((synthetic.plane(8, 6).at(0, 0, 4),))
    >>> echoes = scan(wall, AXES, Scanner(beams=4, columns=360, lowest=-3, highest=3))
    >>> float(echoes.xyz[:, 0].min().round(9)), len(np.unique(echoes.ring))
    (4.0, 4)
    """
    from ._beams import cast_beams

    instance(Scene, scene, "scan: scene")
    device = Scanner() if scanner is None else instance(Scanner, scanner, "scan: scanner")
    pose = rigid(T_world_scan, "scan: T_world_scan")
    rng = np.random.default_rng(whole(seed, "scan: seed", 0))
    corners = _corners(scene, pose, number(stamp, "scan: stamp", -1e12, 1e12, "s"))
    elevation = np.radians(np.linspace(device.highest, device.lowest, device.beams))
    beams = _beams(elevation, device.columns)
    nearest, owner = np.full(beams.shape[:2], device.farthest), np.full(beams.shape[:2], -1, np.int32)
    cast_beams(corners, beams, _boxes(corners, elevation, device.columns), nearest, owner)
    back = owner >= 0
    distance = nearest + rng.normal(0.0, device.noise, nearest.shape) if device.noise else nearest
    shape = np.repeat(np.arange(len(scene.shapes), dtype=np.int32), [len(each.faces) for each in scene.shapes])
    return Echoes(distance[back, None] * beams[back], np.nonzero(back)[0], shape[owner[back]] + 1)


def _corners(scene: Scene, pose: FloatArray, stamp: float) -> FloatArray:
    """Corners of all triangles in the scanner's frame, (F, 3, 3)."""
    R, t = pose[:3, :3], pose[:3, 3]
    return np.concatenate([((shape.world_vertices(stamp) - t) @ R)[shape.faces] for shape in scene.shapes])


def _beams(elevation: FloatArray, columns: int) -> FloatArray:
    """Unit directions of rings (R,) at azimuths that rise from 0, (R, columns, 3)."""
    up, azimuth = elevation[:, None], (np.arange(columns) * (2 * np.pi / columns))[None]
    parts = np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up) + 0 * azimuth
    return np.stack(parts, axis=-1)


def _boxes(corners: FloatArray, elevation: FloatArray, columns: int) -> NDArray[np.int64]:
    """Rows and columns of beams that may meet each triangle, (F, 4): those of a cone around it."""
    rays = corners / np.maximum(np.linalg.norm(corners, axis=2, keepdims=True), 1e-12)
    middle = rays.sum(axis=1)
    length = np.linalg.norm(middle, axis=1)
    middle /= np.maximum(length, 1e-12)[:, None]
    least = np.einsum("fki,fi->fk", rays, middle).min(axis=1)
    half = np.arccos(np.clip(least, -1, 1)) + _ROUND
    up, azimuth = np.arcsin(np.clip(middle[:, 2], -1, 1)), np.arctan2(middle[:, 1], middle[:, 0])
    is_whole = (np.abs(up) + half >= np.pi / 2) | (least <= 0)  # around the axis, or a half-space: all columns
    wide = np.arcsin(np.where(is_whole, 0.0, np.clip(np.sin(half) / np.maximum(np.cos(up), 1e-12), 0, 1))) + _ROUND
    per_rad = columns / (2 * np.pi)
    first = np.where(is_whole, 0, np.ceil((azimuth - wide) * per_rad)).astype(np.int64)
    last = np.where(is_whole, columns, np.floor((azimuth + wide) * per_rad) + 1).astype(np.int64)
    falling = -elevation
    top = np.where(least <= 0, 0, np.searchsorted(falling, -(up + half)))
    bottom = np.where(least <= 0, len(elevation), np.searchsorted(falling, -(up - half), side="right"))
    return np.stack([top, bottom, first, last], axis=1)
