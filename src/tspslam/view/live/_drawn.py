"""A frame or a map as it stands in the world: places, edges, faces, layers; in tiles; and what a ray meets first."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ...frame import Frame
from ...topological_map import TopologicalMap
from ...types import BoolArray, FloatArray
from .._layers import Layer, colours_of, layers_of_frame, layers_of_map
from .._space import in_reach
from .._viewpoints import is_overhead

TILE = 20_000  # faces that are sent at a time: half a megabyte a frame at 60 frames a second would be too much
CEILING_SHARE = 0.05  # of the faces look down: else it is no room, and all is shown at once
PALE = 205  # sRGB grey of a surface under coloured edges, before its shading
_LIGHT = np.array([0.36, -0.80, -0.48])
_STEPS = 1 << 10  # of the grid along which tiles are cut
_LEAST = 1e-12  # determinant, m^3, below which a ray runs along a face
NEAR = 0.02  # rad off a ray within which a point without a surface is meant


@dataclass(frozen=True, repr=False)
class Drawn(Brief):
    """What is drawn of a frame or a map.

    Attributes
    ----------
    source : Frame or TopologicalMap
        What it is of.
    xyz : (N, 3) float64
        Vertices in the world, m; finite.
    edges, faces : (E, 2), (F, 3) int32
        Their vertices.
    layers : list of Layer
        What they can be coloured by.
    is_in_reach : (N,) bool
        Not far off the rest: others are not drawn.
    is_ceiling : (F,) bool
        What looks down in a room.
    """

    source: Frame | TopologicalMap
    xyz: FloatArray
    edges: NDArray[np.int32]
    faces: NDArray[np.int32]
    layers: list[Layer]
    is_in_reach: BoolArray
    is_ceiling: BoolArray

    def rows(self, *, has_ceiling: bool) -> NDArray[np.int64]:
        """Faces that are shown, those that are near each other one after the other."""
        shown = self._face_in_reach if has_ceiling else self._face_in_reach & ~self.is_ceiling
        return self._along_curve[shown[self._along_curve]]

    def edge_rows(self, *, has_ceiling: bool) -> NDArray[np.int64]:
        """Edges that are shown: those whose ends are."""
        return np.flatnonzero(self._vertex_shown(has_ceiling)[self.edges].all(axis=1))

    def vertex_rows(self, *, has_ceiling: bool) -> NDArray[np.int64]:
        """Vertices that are shown: all in reach, but not those of a hidden ceiling alone."""
        return np.flatnonzero(self._vertex_shown(has_ceiling))

    def _vertex_shown(self, has_ceiling: bool) -> BoolArray:
        if has_ceiling or not self.is_ceiling.any():
            return self.is_in_reach
        is_used = np.zeros(len(self.xyz), np.bool_)
        is_used[self.faces[self.rows(has_ceiling=False)]] = True
        return is_used

    @cached_property
    def _face_in_reach(self) -> BoolArray:
        return np.asarray(self.is_in_reach[self.faces].all(axis=1), np.bool_)

    @cached_property
    def _along_curve(self) -> NDArray[np.int64]:
        """Faces along a Morton curve, so that tiles are places."""
        centres = self.xyz[self.faces].mean(axis=1)
        known = centres[self._face_in_reach] if self._face_in_reach.any() else np.zeros((1, 3))
        low, span = known.min(axis=0), np.maximum(np.ptp(known, axis=0), 1e-9)
        cells = np.clip((centres - low) / span * _STEPS, 0, _STEPS - 1).astype(np.int64)
        code = np.zeros(len(cells), np.int64)
        for bit in range(_STEPS.bit_length() - 1):
            for axis in range(3):
                code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
        return np.argsort(code, kind="stable")

    @cached_property
    def _sides(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """First corner and two sides of each face, (3, F) each."""
        a, b, c = (np.ascontiguousarray(self.xyz[self.faces[:, i]].T) for i in range(3))
        return a, b - a, c - a

    def layer(self, name: str | None) -> Layer | None:
        """The layer of a name, if there is one."""
        return next((each for each in self.layers if each.name == name), None)

    def corner_colours(self, layer: Layer | None, rows: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Colours of the corners of faces, (3 n, 3): theirs or their vertices'; pale for edges' and none."""
        if layer is None or layer.level == "edge":
            return np.repeat(self._pale[rows], 3, axis=0)
        colours = colours_of(layer)
        return (
            np.repeat(colours[rows], 3, axis=0) if layer.level == "face" else colours[self.faces[rows]].reshape(-1, 3)
        )

    @cached_property
    def _pale(self) -> NDArray[np.uint8]:
        """Shaded grey of each face, (F, 3): its shape, and no value."""
        _, b, c = self._sides
        across = np.cross(b.T, c.T)
        length = np.maximum(np.linalg.norm(across, axis=1), 1e-30)
        shade = PALE * (0.72 + 0.28 * np.abs(across @ _LIGHT) / length)
        return np.repeat(np.rint(shade).astype(np.uint8)[:, None], 3, axis=1)

    def hit(self, origin: FloatArray, along: FloatArray, *, has_ceiling: bool) -> tuple[int, FloatArray] | None:
        """The face that a ray meets first, and where; None if it meets none (Möller and Trumbore, 1997)."""
        a, b, c = self._sides
        if not a.shape[1]:
            return None
        p = _cross(along[:, None], c)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            determinant = (b * p).sum(axis=0)
            s = origin[:, None] - a
            u = (s * p).sum(axis=0) / determinant
            q = _cross(s, b)
            v = (along[:, None] * q).sum(axis=0) / determinant
            t = (c * q).sum(axis=0) / determinant
            good = (np.abs(determinant) > _LEAST) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        good &= self._face_in_reach if has_ceiling else self._face_in_reach & ~self.is_ceiling
        if not good.any():
            return None
        face = int(np.argmin(np.where(good, t, np.inf)))
        return face, origin + t[face] * along

    def nearest_vertex(self, origin: FloatArray, along: FloatArray) -> int | None:
        """The vertex that a ray passes closest by, in angle; None if all are further off than `NEAR`."""
        to = self.xyz - origin
        ahead = to @ along
        aside = np.linalg.norm(to - ahead[:, None] * along, axis=1)
        angle = np.where((ahead > 0) & self.is_in_reach, aside / np.maximum(ahead, 1e-9), np.inf)
        return int(angle.argmin()) if len(angle) and angle.min() < NEAR else None


def draw_map(map_: TopologicalMap) -> Drawn:
    """Place a map, which is in the world already."""
    faces, ceiling = map_.surface.faces, is_overhead(map_)
    share = ceiling.mean() if len(ceiling) else 0.0
    is_ceiling = ceiling if CEILING_SHARE < share < 1 else np.zeros(len(faces), np.bool_)
    return _drawn(map_, map_.xyz, map_.complex_.edges, faces, layers_of_map(map_), is_ceiling)


def draw_frame(frame: Frame, T_world_camera: FloatArray) -> Drawn:
    """Place a frame in the world by its pose."""
    xyz = frame.cloud.xyz @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    faces = frame.surface.faces
    return _drawn(frame, xyz, frame.complex_.edges, faces, layers_of_frame(frame), np.zeros(len(faces), np.bool_))


def _drawn(
    source: Frame | TopologicalMap, xyz: FloatArray, edges: NDArray[np.int32], faces: NDArray[np.int32],
    layers: list[Layer], is_ceiling: BoolArray,
) -> Drawn:  # fmt: skip
    is_finite: BoolArray = np.asarray(np.isfinite(xyz).all(axis=1), np.bool_)
    places = np.where(is_finite[:, None], xyz, 0.0)
    return Drawn(source, places, edges, faces, layers, is_finite & in_reach(places, is_finite), is_ceiling)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of columns, (3, n)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
