"""Where the pictures of a map are seen from: above, and from a keyframe in the middle of its path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from ..topological_map import TopologicalMap
from ..types import BoolArray, FloatArray
from . import _style as style
from ._raster import Owners, cut_near, find_owners

FINER = 2  # pixels of the buffer along one of the picture: edges are smooth
KEPT_PERCENT = (0.5, 99.5)  # of the vertices along each axis of the picture from above
MARGIN = 0.04  # of its larger side
LOWEST, TALLEST = 0.3, 0.8  # height over width of the picture from above
PATH_ASPECT = 0.45  # of the picture from the path
HALF_WIDTH = 0.85  # of the picture from the path at depth 1: 81 degrees
CEILING = 0.5  # of a unit normal's part along down: such faces would hide a room from above
CLEAR_PERCENT = 5  # of the depths in view: what lies nearer to a keyframe is little
BACK, RAISED = 0.5, 0.2  # of that depth: where the viewer stands, behind the keyframe and above
NEAREST = 0.05  # of the same: nearer faces are cut off
STEEP = 0.3  # of a unit normal's part along down: faces that stand up would be hair lines from above
BAND = 1.5  # half the width of their lines, px of the buffer


@dataclass(frozen=True, repr=False)
class Outlook(Brief):
    """A map as one picture shows it.

    Attributes
    ----------
    axes : (3, 3) float64
        Rows: the viewer's right, down and forward, in the world.
    eye : (3,) float64
        Where the viewer stands, m; from above, any point.
    is_above : bool
        Orthographic from above, or in perspective from the path.
    corner : (2,) float64
        Left and top of the picture: m from above, else at depth 1.
    scale : float
        px for 1 of these.
    size : (int, int)
        Height and width, px.
    near : float
        Smallest depth that is drawn, m.
    keyframe : int
        Row of the map's keyframes near which the viewer stands.
    faces : int
        How many the map has.
    owner : (FINER H, FINER W) int32
        Which face is seen; -1 where none is.
    """

    axes: FloatArray
    eye: FloatArray
    is_above: bool
    corner: FloatArray
    scale: float
    size: tuple[int, int]
    near: float
    keyframe: int
    faces: int
    owner: Owners

    def place(self, xyz: FloatArray) -> FloatArray:
        """Find points, (n, 3), m, on the picture: (n, 2), px; NaN behind the viewer."""
        seen = (xyz - self.eye) @ self.axes.T
        if not self.is_above:
            ahead = np.where(seen[:, 2] > self.near, seen[:, 2], np.nan)
            seen = seen / ahead[:, None]
        return (seen[:, :2] - self.corner) * self.scale

    def paint(self, rgb: FloatArray, backdrop: FloatArray) -> NDArray[np.uint8]:
        """Paint each face in its colour, (F, 3) in [0, 1], before a backdrop: (H, W, 3) uint8."""
        palette = np.zeros((self.faces + 1, 4), np.uint8)
        palette[:, :3] = np.rint(255 * np.clip(np.vstack([rgb, backdrop[None]]), 0, 1))
        pixels = palette.view(np.uint32)[:, 0][self.owner].view(np.uint8).reshape(*self.owner.shape, 4)[..., :3]
        total = sum(pixels[i::FINER, j::FINER].astype(np.uint16) for i in range(FINER) for j in range(FINER))
        return np.asarray((total + FINER * FINER // 2) // (FINER * FINER)).astype(np.uint8)

    @cached_property
    def pixels(self) -> NDArray[np.int64]:
        """How many pixels of the buffer show each face, (F,)."""
        return np.bincount(self.owner.ravel() + 1, minlength=self.faces + 1)[1:]


def panel_width() -> int:
    """Width of a panel beside a colour bar, px."""
    return round((style.WIDTH - style.LEFT - style.BAR) * style.DPI)


def normals(map_: TopologicalMap) -> FloatArray:
    """Unit normals of the faces, (F, 3), toward the cameras that saw them; 0 where a face has no area."""
    corners = map_.xyz[map_.surface.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    return np.divide(across, length, out=np.zeros_like(across), where=length > 0)


def downward(map_: TopologicalMap) -> FloatArray:
    """Find what is down, (3,): the mean of the cameras' y axes, or the world's where they cancel."""
    mean = map_.T_world_camera[:, :3, 1].mean(axis=0)
    length = float(np.linalg.norm(mean))
    return np.array([0.0, 1.0, 0.0]) if length < 0.1 else mean / length


def is_overhead(map_: TopologicalMap) -> BoolArray:
    """Mark the faces that look down, (F,): ceilings, bridges."""
    return normals(map_) @ downward(map_) > CEILING


def from_above(map_: TopologicalMap) -> Outlook:
    """Look down on a map, its longer side across; what looks down itself is left out."""
    down = downward(map_)
    ahead = map_.T_world_camera[0, :3, 2] - down * (map_.T_world_camera[0, :3, 2] @ down)
    if np.linalg.norm(ahead) < 1e-6:  # the first camera looks down
        ahead = np.cross(map_.T_world_camera[0, :3, 0], down)
    ahead /= np.linalg.norm(ahead)
    axes = np.stack([np.cross(down, ahead), -ahead, down])
    low, high = _extent(map_, axes)
    if high[1] - low[1] > high[0] - low[0]:
        axes = np.stack([ahead, axes[0], down])
        low, high = _extent(map_, axes)
    middle, size = (low + high) / 2, np.maximum(high - low, 1e-6) * (1 + 2 * MARGIN)
    aspect = float(np.clip(size[1] / size[0], LOWEST, TALLEST))
    width = max(size[0], size[1] / aspect)
    pixels = panel_width()
    shape = round(pixels * aspect), pixels
    corner = middle - width * np.array([1.0, shape[0] / pixels]) / 2
    rows = np.flatnonzero(~is_overhead(map_))
    return _outlook(map_, rows, axes, np.zeros(3), True, corner, pixels / width, shape, 0.0, 0)


def _extent(map_: TopologicalMap, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners of what the picture from above shows: nearly all vertices, and the path."""
    path = map_.T_world_camera[:, :3, 3] @ axes[:2].T
    low, high = path.min(axis=0), path.max(axis=0)
    if len(map_):
        near, far = np.percentile(map_.xyz @ axes[:2].T, KEPT_PERCENT, axis=0)
        low, high = np.minimum(low, near), np.maximum(high, far)
    return low, high


def from_path(map_: TopologicalMap) -> Outlook:
    """Look along the view of a keyframe in the middle of the path, from a little behind and above it.

    Faces are seen from the side that the cameras saw.
    """
    keyframe = middle_keyframe(map_)
    T = map_.T_world_camera[keyframe]
    clear, depth = _depths(map_, T)
    down, ahead = downward(map_), T[:3, 2]
    eye = T[:3, 3] - clear * (BACK * ahead + RAISED * down)
    forward = T[:3, 3] + depth * ahead - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(down, forward)
    if np.linalg.norm(right) < 0.2:  # it looks up or down
        right = T[:3, 0] - forward * (T[:3, 0] @ forward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])
    facing = np.einsum("fi,fi->f", normals(map_), eye - map_.xyz[map_.surface.faces[:, 0]]) > 0
    pixels = panel_width()
    shape = round(pixels * PATH_ASPECT), pixels
    corner = -HALF_WIDTH * np.array([1.0, shape[0] / pixels])
    scale = pixels / (2 * HALF_WIDTH)
    return _outlook(map_, np.flatnonzero(facing), axes, eye, False, corner, scale, shape, NEAREST * clear, keyframe)


def middle_keyframe(map_: TopologicalMap) -> int:
    """Choose the keyframe of the middle third of the path that sees most vertices; a row of `keyframes`."""
    K = len(map_.keyframes)
    seen = np.bincount(map_.observations.keyframe[map_.observations.weight > 0], minlength=K)
    first, last = K // 3, max(K // 3 + 1, K - K // 3)
    return first + int(np.argmax(seen[first:last]))


def _depths(map_: TopologicalMap, T: FloatArray) -> tuple[float, float]:
    """Depth of the nearest of the vertices that the camera has in its picture, but for a few, and their median, m."""
    seen = (map_.xyz - T[:3, 3]) @ T[:3, :3]
    is_in = (seen[:, 2] > 0) & (np.abs(seen[:, 0]) < HALF_WIDTH * seen[:, 2])
    if not is_in.any():
        return 1.0, 1.0
    clear, median = np.percentile(seen[is_in, 2], (CLEAR_PERCENT, 50))
    return float(clear), float(median)


def _outlook(
    map_: TopologicalMap, rows: NDArray[np.int64], axes: FloatArray, eye: FloatArray, is_above: bool,
    corner: FloatArray, scale: float, size: tuple[int, int], near: float, keyframe: int,
) -> Outlook:  # fmt: skip
    """Find what each pixel shows of the faces `rows`."""
    corners = (map_.xyz[map_.surface.faces[rows]] - eye) @ axes.T
    if is_above:
        nearness, part = -corners[..., 2:], np.arange(len(rows))
    else:
        corners, part = cut_near(corners, near)
        nearness = 1 / corners[..., 2:]
        corners = corners * nearness
    plane = ((corners[..., :2] - corner) * scale + 0.5) * FINER - 0.5
    triangles, part = np.concatenate([plane, nearness], axis=2), rows[part]
    if is_above:
        is_steep = np.abs(normals(map_)[rows] @ axes[2]) < STEEP
        triangles = np.concatenate([triangles, _bands(plane[is_steep], nearness[is_steep])])
        part = np.concatenate([part, rows[is_steep], rows[is_steep]])
    owner = find_owners(triangles, part, (FINER * size[0], FINER * size[1]))
    return Outlook(axes, eye, is_above, corner, scale, size, near, keyframe, len(map_.surface.faces), owner)


def _bands(plane: FloatArray, nearness: FloatArray) -> FloatArray:
    """Bands along the longest sides of (F, 3, 2) triangles, two triangles each, (2 F, 3, 3): a wall is a line."""
    at = np.arange(len(plane))
    sides = np.roll(plane, -1, axis=1) - plane
    length = np.linalg.norm(sides, axis=2)
    longest = length.argmax(axis=1)
    start, side = plane[at, longest], sides[at, longest]
    across = np.stack([-side[:, 1], side[:, 0]], axis=1) * BAND / np.maximum(length[at, longest], 1e-12)[:, None]
    ends = [start - across, start + side - across, start + side + across, start + across]
    near = np.broadcast_to(nearness.max(axis=1)[:, None], (len(plane), 3, 1))
    halves = [np.stack([ends[k] for k in rows], axis=1) for rows in ((0, 1, 2), (0, 2, 3))]
    return np.concatenate([np.concatenate([half, near], axis=2) for half in halves])
