"""A frame's mesh in space, seen from the side: perspective, painter's algorithm, light shading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .._brief import Brief
from ..frame import Frame
from ..types import BoolArray, FloatArray
from . import _style as style
from ._frame import in_view

YAW, PITCH = -28.0, 20.0  # degrees: where the viewer stands, to the left of the camera and above it
NEAR = 0.05  # of the viewer's distance: nearer things are not drawn
LIGHT = np.array([-0.45, -0.75, -0.48])  # from above left, behind the viewer, in the camera's frame
PANEL = 0.58  # height over width
Rows = NDArray[np.int64]

BACKDROP, FLOOR, BARE = "#f3f5f7", "#d3dae0", "#c3cad1"


@dataclass(frozen=True, repr=False)
class Viewer(Brief):
    """Where a picture in space is seen from.

    Attributes
    ----------
    eye : (3,) float64
        Position in the camera's frame, m.
    axes : (3, 3) float64
        Rows: the viewer's right, down and forward.
    near : float
        Smallest depth that is drawn, m.
    """

    eye: FloatArray
    axes: FloatArray
    near: float

    def project(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Perspective projection of (n, 3) points: (n, 2) on the picture plane, y down, and (n,) depth, m."""
        seen = (xyz - self.eye) @ self.axes.T
        return seen[:, :2] / np.maximum(seen[:, 2:], self.near), seen[:, 2]


def viewer_of(xyz: FloatArray) -> Viewer:
    """Stand to the side of (n, 3) points, n >= 1, above and far enough to see them all."""
    target = np.median(xyz, axis=0)
    radius = float(np.percentile(np.linalg.norm(xyz - target, axis=1), 90))
    distance = max(1.7 * radius, 0.9 * float(np.linalg.norm(target)), 1e-6)
    yaw, pitch = np.deg2rad([YAW, PITCH])
    forward = np.array([-np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    return Viewer(target - distance * forward, np.stack([right, np.cross(forward, right), forward]), NEAR * distance)


def solid_page(
    frame: Frame,
    title: str,
    caption: str,
    *,
    face_rgb: FloatArray,
    face_ok: BoolArray,
    vertex_rgb: FloatArray,
    side: bool,
) -> tuple[Figure, Axes]:
    """Draw the mesh in space: faces in their colours, those without in pale grey; without faces, points."""
    used, faces = in_space(frame)
    figure, axes = style.page(PANEL, title, frame.name, caption, side=side)
    axes.set_facecolor(BACKDROP)
    if not len(used):
        style.text(axes, 0.5, 0.5, "nothing to show", size=13, colour=style.QUIET, ha="center")
        return figure, axes
    xyz = frame.cloud.xyz
    viewer = viewer_of(xyz[used])
    _frame_view(axes, viewer.project(xyz[used])[0])
    _floor(axes, viewer, xyz[used])
    if len(faces):
        colours = np.where(face_ok[faces, None], face_rgb[faces], _rgb(BARE))
        _paint(axes, viewer, xyz[frame.complex_.faces[faces]], colours)
    else:
        _dots(axes, viewer, xyz[used], vertex_rgb[used])
    return figure, axes


def in_space(frame: Frame) -> tuple[Rows, Rows]:
    """Find the vertices and the faces that a view in space shows; without faces, every vertex in view."""
    keep = in_view(frame)
    faces = np.flatnonzero(keep[frame.complex_.faces].all(axis=1))
    used = np.unique(frame.complex_.faces[faces]).astype(np.int64) if len(faces) else np.flatnonzero(keep)
    return used, faces


def _rgb(colour: str) -> FloatArray:
    return np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])


def _frame_view(axes: Axes, plane: FloatArray) -> None:
    low, high = np.percentile(plane, [0.5, 99.5], axis=0)
    slack = 0.2 * (high - low)  # for the ends of a scene, not for a point that passes close to the viewer
    low, high = np.maximum(plane.min(axis=0), low - slack), np.minimum(plane.max(axis=0), high + slack)
    centre, size = (low + high) / 2, np.maximum(high - low, 1e-6) * 1.14
    width = max(size[0], size[1] / PANEL)
    axes.set_xlim(centre[0] - width / 2, centre[0] + width / 2)
    axes.set_ylim(centre[1] + width * PANEL / 2, centre[1] - width * PANEL / 2)


def _paint(axes: Axes, viewer: Viewer, corners: FloatArray, rgb: FloatArray) -> None:
    """Draw (F, 3, 3) triangles from the farthest to the nearest, lit from above left."""
    plane, depth = viewer.project(corners.reshape(-1, 3))
    depth = depth.reshape(-1, 3)
    order = np.argsort(-depth.mean(axis=1), kind="stable")
    order = order[depth[order].min(axis=1) > viewer.near]
    lit = np.clip(rgb * _shade(corners)[:, None], 0, 1)[order]
    triangles = PolyCollection(plane.reshape(-1, 3, 2)[order], closed=True)
    triangles.set(facecolors=lit, edgecolors=0.82 * lit, linewidths=0.35, joinstyle="round", zorder=2)
    axes.add_collection(triangles, autolim=False)


def _shade(corners: FloatArray) -> FloatArray:
    """Brightness of each triangle in [0.7, 1]: a quarter of it depends on how it stands to the light."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    towards = np.abs(normal @ (LIGHT / np.linalg.norm(LIGHT))) / np.where(length > 0, length, 1.0)
    return 0.7 + 0.3 * towards


def _dots(axes: Axes, viewer: Viewer, xyz: FloatArray, rgb: FloatArray) -> None:
    plane, depth = viewer.project(xyz)
    order = np.argsort(-depth, kind="stable")
    size = float(np.clip(9000 / len(xyz), 5, 60))
    x, y = plane[order].T
    axes.scatter(x, y, s=size, c=np.clip(rgb[order], 0, 1), edgecolors=style.INK, linewidths=0.3, zorder=2)


def grid_step(extent: float) -> float:
    """Choose a round length, 1, 2 or 5 times a power of ten, of which `extent` holds at most eight.

    Examples
    --------
    >>> grid_step(7.0), grid_step(0.31)
    (1.0, 0.05)
    """
    rough = max(extent, 1e-6) / 8
    power = 10.0 ** np.floor(np.log10(rough))
    return float(power * next(m for m in (1, 2, 5, 10) if rough <= m * power * (1 + 1e-9)))


def _floor(axes: Axes, viewer: Viewer, xyz: FloatArray) -> None:
    """Draw a square grid just under the scene, for scale."""
    low, high = xyz.min(axis=0), xyz.max(axis=0)
    extent = max(high[0] - low[0], high[2] - low[2])
    if extent <= 1e-3:
        return
    step = grid_step(extent)
    x = step * np.arange(np.floor(low[0] / step), np.ceil(high[0] / step) + 1)
    z = step * np.arange(np.floor(low[2] / step), np.ceil(high[2] / step) + 1)
    ground = np.percentile(xyz[:, 1], 99)
    lines = [_on_floor(viewer, np.full(2, a), z[[0, -1]], ground) for a in x]
    lines += [_on_floor(viewer, x[[0, -1]], np.full(2, b), ground) for b in z]
    axes.add_collection(LineCollection(lines, colors=FLOOR, linewidths=0.8, zorder=1), autolim=False)
    words = f"grid {step:g} m"
    style.text(axes, 0.985, 0.03, words, size=8.5, colour=style.QUIET, ha="right").set_transform(axes.transAxes)


def _on_floor(viewer: Viewer, x: FloatArray, z: FloatArray, ground: float) -> FloatArray:
    share = np.linspace(0, 1, 65)
    points = np.stack([x[0] + share * (x[1] - x[0]), np.full(65, ground), z[0] + share * (z[1] - z[0])], axis=1)
    plane, depth = viewer.project(points)
    return plane[depth > 2 * viewer.near]
