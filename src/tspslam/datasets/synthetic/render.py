"""What a camera sees of a scene: luminance, and the truth behind each pixel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ...types import FloatArray, Rig
from ._frustum import Corners
from .shapes import Scene, Shape
from .texture import leaves, pyramid

_LIGHT = np.array([0.35, -0.8, -0.5]) / np.linalg.norm([0.35, -0.8, -0.5])  # towards the light, world
_AMBIENT = 0.75
_CENTRE = np.zeros((1, 2))
_INNER = np.array([[(i - 1.5) / 4, (j - 1.5) / 4] for j in range(4) for i in range(4)])  # px, of a pixel at an edge
_STEP = 1.2  # ratio of depths beside each other that is an edge


@dataclass(frozen=True, repr=False)
class Geometry(Brief):
    """What is behind the centre of each pixel of the left image.

    Attributes
    ----------
    depth : (H, W) float64
        z, m; NaN where there is background.
    normal : (H, W, 3) float64
        Unit normal in the camera's frame, towards the camera; NaN where there is background.
    label : (H, W) int32
        Number of the shape, from 1; 0 is background.
    disparity : (H, W) float64
        ``u_left - u_right``, px; NaN where there is background. Also where the right camera does not see the point.
    """

    depth: FloatArray
    normal: FloatArray
    label: NDArray[np.int32]
    disparity: FloatArray


@dataclass(frozen=True, repr=False)
class Triangles(Brief):
    """The triangles of all shapes of a scene: what does not change with the camera.

    `paint` is (F, 2): tile and look of each triangle; `part` numbers the sides of shapes that join smoothly.
    """

    shape: NDArray[np.int32]
    coordinates: FloatArray
    paint: NDArray[np.int32]
    part: NDArray[np.int32]
    looks: FloatArray
    texels: NDArray[np.float32]
    levels: NDArray[np.int64]


class Renderer:
    """Casts the rays of pinhole cameras at one scene."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._triangles = triangles(scene)
        self._corners = Corners(scene)

    def geometry(self, rig: Rig, pose: FloatArray, stamp: float) -> Geometry:
        """Truth for the left camera at a pose.

        Parameters
        ----------
        rig : Rig
            The cameras.
        pose : (4, 4) float64
            Of the left camera, world from camera, m.
        stamp : float
            Time, s.

        Returns
        -------
        Geometry
        """
        chosen, corners = self._corners.seen(rig, rig.cx, pose, stamp)
        owner, nearness, _ = _cast(corners, _lens(rig, rig.cx), np.zeros((rig.height, rig.width), bool))
        hit = owner >= 0
        depth = np.where(hit, 1 / np.where(hit, nearness, 1), np.nan)
        normal = np.full((*owner.shape, 3), np.nan)
        normal[hit] = _normals(corners)[owner[hit]]
        ray = _rays(rig)
        normal *= np.where((normal * ray).sum(axis=-1, keepdims=True) > 0, -1.0, 1.0)
        label = np.zeros(owner.shape, np.int32)
        label[hit] = self._triangles.shape[chosen[owner[hit]]] + 1
        return Geometry(depth, normal, label, rig.fx * rig.baseline / depth - rig.doffs)

    def image(self, rig: Rig, pose: FloatArray, stamp: float, cx: float) -> FloatArray:
        """Draw what a camera sees at a pose.

        Where pixels beside each other show different things, 16 rays are cast through each instead of one.

        Parameters
        ----------
        rig : Rig
            Its lens.
        pose : (4, 4) float64
            World from camera, m.
        stamp : float
            Time, s.
        cx : float
            Its principal column, px, in place of the rig's.

        Returns
        -------
        (H, W) float64
            Luminance in [0, 1].
        """
        from ._kernels import shade

        chosen, corners = self._corners.seen(rig, cx, pose, stamp)
        lens, parts = _lens(rig, cx), self._triangles
        owner, nearness, rays = _cast(corners, lens, np.zeros((rig.height, rig.width), bool))
        edges = _edges(np.append(parts.part[chosen], -1).astype(np.int32)[owner], nearness)  # -1: background
        paint = (parts.coordinates[chosen], parts.paint[chosen], parts.looks, parts.texels, parts.levels)
        image = np.full(owner.shape, self._scene.background)
        shade(*rays, owner.reshape(-1, 1), lens, corners, *paint, image.reshape(-1, 1))
        if edges.any():
            owner, _, rays = _cast(corners, lens, edges)
            values = np.full(owner.shape, self._scene.background)
            shade(*rays, owner, lens, corners, *paint, values)
            image[edges] = values.mean(axis=1)
        return image


@lru_cache(maxsize=4)
def _levels(seed: int) -> tuple[NDArray[np.float32], ...]:
    return tuple(pyramid(leaves(seed)))


def triangles(scene: Scene) -> Triangles:
    """Gather the triangles of a scene, with one look for each side of each shape.

    Parameters
    ----------
    scene : Scene
        The world.

    Returns
    -------
    Triangles
    """
    count = [len(shape.faces) for shape in scene.shapes]
    of = np.repeat(np.arange(len(count), dtype=np.int32), count)
    facing = [_facing(shape) for shape in scene.shapes]
    tiles = _Tiles(scene.leaves)
    tile = np.array([tiles.number(shape) for shape in scene.shapes], np.int32)[of]
    sides = np.concatenate([side for side, _ in facing]).astype(np.int32)
    part = 6 * of + sides
    looks = np.stack([shape.texture.look(_lit(shape, side)) for shape in scene.shapes for side in range(6)])
    coordinates = np.concatenate([coordinate for _, coordinate in facing])
    return Triangles(of, coordinates, np.stack([tile, part], axis=1), part, looks, *tiles.packed())


class _Tiles:
    """Tiles of a scene's textures with their coarser levels, in one array; equal ones are kept once."""

    def __init__(self, leaves_seed: int) -> None:
        self._seed = leaves_seed
        self._numbers: dict[bytes, int] = {}
        self._pyramids: list[tuple[NDArray[np.float32], ...]] = []

    def number(self, shape: Shape) -> int:
        image = shape.texture.image
        key = b"" if image is None else sha256(image.tobytes()).digest()
        if key not in self._numbers:
            self._numbers[key] = len(self._pyramids)
            tile = _levels(self._seed) if image is None else tuple(pyramid(shape.texture.tile(self._seed)))
            self._pyramids.append(tile)
        return self._numbers[key]

    def packed(self) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """All texels, and where each level of each tile begins; a tile's last level is repeated to equal depth."""
        sizes = [level.size for pyramid_ in self._pyramids for level in pyramid_]
        begins = iter(np.concatenate([[0], np.cumsum(sizes)[:-1]]).tolist())
        texels = np.concatenate([level.ravel() for pyramid_ in self._pyramids for level in pyramid_])
        starts = [[next(begins) for _ in pyramid_] for pyramid_ in self._pyramids]
        deepest = max(len(row) for row in starts)
        return texels, np.array([[len(row), *row, *[-1] * (deepest - len(row))] for row in starts], np.int64)


def _facing(shape: Shape) -> tuple[NDArray[np.int64], FloatArray]:
    """Which of six sides each triangle faces, and the (F, 3, 2) coordinates of its corners along that side, m."""
    corners = shape.vertices[shape.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normal).argmax(axis=1)
    along = np.array([[1, 2], [0, 2], [0, 1]])[axis]
    outward = np.take_along_axis(corners.mean(axis=1), axis[:, None], axis=1)[:, 0] > 0
    return 2 * axis + outward, np.take_along_axis(corners, along[:, None, :].repeat(3, axis=1), axis=2)


def _lit(shape: Shape, side: int) -> float:
    """How much light one of a shape's six sides gets."""
    normal = shape.pose[:3, side // 2] * (1 if side % 2 else -1)
    return float(_AMBIENT + (1 - _AMBIENT) * normal @ _LIGHT)


def _lens(rig: Rig, cx: float) -> FloatArray:
    return np.array([rig.fx, rig.fy, cx, rig.cy, rig.skew])


def _cast(
    corners: FloatArray, lens: FloatArray, edges: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], FloatArray, tuple[NDArray[np.int64], FloatArray, int]]:
    """Owner and nearness of one ray through each pixel, or, where there are edges, of 16 through each of those.

    Also the rays: numbers of the pixels, (K, 2) places in a pixel, and the width of a row.
    """
    from ._kernels import cast

    inner = bool(edges.any())
    offsets = _INNER if inner else _CENTRE
    chosen = np.flatnonzero(edges) if inner else np.arange(edges.size)
    slot = np.full(edges.shape, -1, np.int32)
    slot.reshape(-1)[chosen] = np.arange(len(chosen))
    nearness = np.zeros((len(chosen), len(offsets)))
    owner = np.full(nearness.shape, -1, np.int32)
    cast(corners, np.argsort(corners[..., 2].min(axis=1)), lens, slot, offsets, nearness, owner)
    rays = chosen, offsets, edges.shape[1]
    if inner:
        return owner, nearness, rays
    return owner.reshape(edges.shape), nearness.reshape(edges.shape), rays


def _edges(part: NDArray[np.int32], nearness: FloatArray) -> NDArray[np.bool_]:
    """Pixels beside one that shows another part, or the same part far before or behind."""
    found = np.zeros(part.shape, bool)
    for axis in (0, 1):
        a: tuple[slice, ...] = (slice(None, -1), slice(None))[:: 1 if axis == 0 else -1]
        b: tuple[slice, ...] = (slice(1, None), slice(None))[:: 1 if axis == 0 else -1]
        near, far = np.maximum(nearness[a], nearness[b]), np.minimum(nearness[a], nearness[b])
        differ = (part[a] != part[b]) | (near > _STEP * far)
        found[a] |= differ
        found[b] |= differ
    return found


def _normals(corners: FloatArray) -> FloatArray:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)


def _rays(rig: Rig) -> FloatArray:
    """(H, W, 3) directions of the pixels' centres."""
    v, u = np.mgrid[: rig.height, : rig.width].astype(np.float64)
    y = (v - rig.cy) / rig.fy
    return np.stack([(u - rig.cx - rig.skew * y) / rig.fx, y, np.ones_like(y)], axis=-1)
