"""What stands in the scene, as viser's nodes: surface in tiles, edges, points, path, cameras, what was clicked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...frame import Frame
from ...types import FloatArray, Rig
from .._frame import limits
from .._layers import Layer, colours_of
from ._drawn import TILE, Drawn
from ._element import Element
from ._glb import LINES, glb_of
from ._images import Pixels
from .world import Station

PATH_RGB, LOST_RGB, NOW_RGB, LOOP_RGB, PICK_RGB = (
    (232, 89, 12),
    (120, 120, 120),
    (25, 113, 194),
    (156, 54, 181),
    (255, 0, 128),
)
INK, POINT_RGB = (60, 66, 74), (12, 133, 153)
SWITCHES = ("surface", "edges", "points", "path", "cameras", "pictures", "loops")
THICK_EDGES = 60_000  # more are drawn as lines of one pixel, which the browser draws faster
CLOUD_POINTS, CLOUDS = 1000, 200  # of a keyframe while there is no map; keyframes whose points are shown
TINT = (219, 228, 239)  # neither end of a grey scale, as behind the scenes of pages
CAMERA = 0.025  # depth of a keyframe's frustum, in the reach of the scene
_UP, _FORWARD = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_CORNERS = np.array([[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1]])


class Stage:
    """The scene of a server."""

    def __init__(self, server: Any) -> None:
        self._server, self._scene = server, server.scene
        self._scene.set_up_direction("-y")
        self._scene.set_background_image(np.full((1, 1, 3), TINT, np.uint8), format="png")
        self._tops = {name: self._scene.add_frame(f"/{name}", show_axes=False) for name in SWITCHES}
        self._tiles: list[Any] = []
        self._nodes: dict[str, Any] = {}
        self._clouds: dict[int, Any] = {}
        self._first = np.zeros(3), _FORWARD
        self.reach = 1.0  # m: how large the scene is, about

    def switch(self, name: str, is_on: bool) -> None:
        """Show or hide one of `SWITCHES`."""
        if self._tops[name].visible != is_on:
            self._tops[name].visible = is_on

    def draw_surface(self, drawn: Drawn, layer: Layer | None, *, has_ceiling: bool) -> None:
        """Send the faces in tiles of `TILE`, each where the last one of its number was."""
        rows = drawn.rows(has_ceiling=has_ceiling)
        for k, start in enumerate(range(0, len(rows), TILE)):
            tile = rows[start : start + TILE]
            data = glb_of(drawn.xyz[drawn.faces[tile]].reshape(-1, 3), drawn.corner_colours(layer, tile))
            node = self._scene.add_glb(f"/surface/{k}", data, cast_shadow=False, receive_shadow=False)
            self._tiles[k : k + 1] = [node]
            self._server.flush()
        for node in self._tiles[-(-len(rows) // TILE) :]:
            node.remove()
        del self._tiles[-(-len(rows) // TILE) :]

    def draw_edges(self, drawn: Drawn, layer: Layer | None, *, has_ceiling: bool) -> None:
        """Edges as lines, in the colours of an edge layer; plain where it is none."""
        rows = drawn.edge_rows(has_ceiling=has_ceiling)
        if not len(rows):
            self._remove("edges")
            return
        ends = drawn.xyz[drawn.edges[rows]]
        is_theirs = layer is not None and layer.level == "edge"
        rgb = colours_of(layer)[rows] if layer is not None and is_theirs else np.full((len(rows), 3), INK, np.uint8)
        if len(rows) > THICK_EDGES:
            data = glb_of(ends.reshape(-1, 3), np.repeat(rgb, 2, axis=0), LINES)
            self._put("edges", self._scene.add_glb("/edges/all", data, cast_shadow=False, receive_shadow=False))
        else:
            self._put(
                "edges", self._lines("/edges/all", ends, np.repeat(rgb[:, None], 2, axis=1), 2.0 if is_theirs else 1.0)
            )

    def draw_points(self, drawn: Drawn, layer: Layer | None, *, has_ceiling: bool) -> None:
        """Vertices, in the colours of a vertex layer."""
        is_theirs = layer is not None and layer.level == "vertex"
        rgb = (
            colours_of(layer) if layer is not None and is_theirs else np.full((len(drawn.xyz), 3), POINT_RGB, np.uint8)
        )
        rows = drawn.vertex_rows(has_ceiling=has_ceiling)
        self._put("points", self._cloud("/points/all", drawn.xyz[rows], rgb[rows], 5.0))

    def add_cloud(self, frame: Frame, T_world_camera: FloatArray) -> None:
        """Some points of a keyframe, in their luminance, while there is no map."""
        near = np.flatnonzero(np.isfinite(frame.cloud.xyz).all(axis=1) & (frame.cloud.xyz[:, 2] > 0))
        near = near[frame.cloud.xyz[near, 2] <= _far(frame.cloud.xyz[near, 2])]
        some = near[:: max(1, -(-len(near) // CLOUD_POINTS))]
        xyz = frame.cloud.xyz[some] @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        signal = frame.signals.vertex[some]
        grey = np.rint(255 * np.clip(signal if signal.ndim == 1 else signal.mean(axis=1), 0, 1)).astype(np.uint8)
        self._clouds[frame.index] = self._cloud(f"/points/{frame.index}", xyz, np.repeat(grey[:, None], 3, axis=1), 3.0)
        for number in sorted(self._clouds)[:-CLOUDS]:
            self._clouds.pop(number).remove()

    def remove_clouds(self) -> None:
        """The map takes their place."""
        for number in sorted(self._clouds):
            self._clouds.pop(number).remove()

    def draw_path(self, stations: Sequence[Station]) -> None:
        """Where the cameras were, grey where the path was lost."""
        places = np.array([each.T_world_camera[:3, 3] for each in stations]).reshape(-1, 3)
        if len(places) < 2:
            self._remove("path")
            return
        ends = np.stack([places[:-1], places[1:]], axis=1)
        colours = np.array([LOST_RGB if each.state == "lost" else PATH_RGB for each in stations[1:]], np.uint8)
        self._put("path", self._lines("/path/all", ends, np.repeat(colours[:, None], 2, axis=1), 3.0))

    def draw_cameras(self, stations: Sequence[Station], rig: Rig) -> None:
        """A frustum at each keyframe."""
        poses = np.array([each.T_world_camera for each in stations if each.state == "keyframe"]).reshape(-1, 4, 4)
        if len(poses):
            ends = frustums(poses, rig, CAMERA * self.reach)
            self._put("cameras", self._lines("/cameras/all", ends, PATH_RGB, 1.0))

    def add_picture(self, number: int, T_world_camera: FloatArray, rig: Rig, pixels: Pixels) -> Any:
        """A keyframe's image in its frustum."""
        return self._frustum(f"/pictures/{number}", T_world_camera, rig, CAMERA, PATH_RGB, 1.0, pixels)

    def draw_now(self, T_world_camera: FloatArray, rig: Rig, pixels: Pixels | None) -> None:
        """The camera of the frame that the slider is on."""
        self._put("now", self._frustum("/cameras/now", T_world_camera, rig, 2 * CAMERA, NOW_RGB, 3.0, pixels))

    def draw_loops(self, loops: Sequence[tuple[int, int]], stations: Sequence[Station]) -> None:
        """A line between the two frames of each loop."""
        places = {each.number: each.T_world_camera[:3, 3] for each in stations}
        ends = [(places[a], places[b]) for a, b in loops if a in places and b in places]
        if ends:
            self._put("loops", self._lines("/loops/all", np.array(ends), LOOP_RGB, 2.0))

    def mark(self, drawn: Drawn, element: Element | None) -> None:
        """Outline what was clicked."""
        if element is None:
            self._remove("picked")
        elif element.level == "vertex":
            self._put("picked", self._cloud("/picked", element.place[None], np.array([PICK_RGB], np.uint8), 9.0))
        else:
            corners = drawn.xyz[element.vertices]
            ends = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
            self._put("picked", self._lines("/picked", ends, PICK_RGB, 5.0))

    def look_from_behind(self, stations: Sequence[Station], xyz: FloatArray) -> None:
        """Where a page begins, and its "reset view": behind the start of the path, high above."""
        first = stations[0].T_world_camera
        places = np.array([each.T_world_camera[:3, 3] for each in stations])
        self.reach = _size(places, xyz, first)
        ahead = places.mean(axis=0) - first[:3, 3]
        if np.linalg.norm(ahead) < 0.1 * self.reach:
            ahead = first[:3, 2]
        ahead = ahead - (ahead @ _UP) * _UP
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
        camera = self._server.initial_camera
        camera.position = first[:3, 3] + self.reach * (-0.45 * ahead + 0.5 * _UP)
        camera.look_at = first[:3, 3] + 0.4 * self.reach * ahead
        camera.up = _UP
        self._first = camera.position, camera.look_at
        camera.near, camera.far = 1e-3 * self.reach, 100 * self.reach

    def look_as_first(self) -> None:
        """Bring every page back to where it began."""
        self._look(*self._first)

    def look_from_above(self, stations: Sequence[Station]) -> None:
        """Show every page the path from high above."""
        places = np.array([each.T_world_camera[:3, 3] for each in stations]).reshape(-1, 3)
        middle = (places.min(axis=0) + places.max(axis=0)) / 2 if len(places) else np.zeros(3)
        self._look(middle + self.reach * (1.3 * _UP - 0.01 * _FORWARD), middle)

    def look_along(self, T_world_camera: FloatArray) -> None:
        """Show every page what a camera sees, from behind and above it."""
        place, forward = T_world_camera[:3, 3], T_world_camera[:3, 2]
        self._look(place + 0.06 * self.reach * (0.5 * _UP - forward), place + 0.2 * self.reach * forward)

    def _look(self, position: FloatArray, target: FloatArray) -> None:
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.position, client.camera.look_at = position, target

    def _lines(self, name: str, ends: FloatArray, rgb: Any, width: float) -> Any:
        return self._scene.add_line_segments(name, ends, rgb, thickness=width, thickness_units="screen")

    def _cloud(self, name: str, xyz: FloatArray, rgb: Pixels, size: float) -> Any:
        unit = 1e-3 * self.reach
        shape = {"point_shape": "circle", "point_shading": "flat", "precision": "float32"}
        return self._scene.add_point_cloud(name, xyz, rgb, point_size=size * unit, **shape)

    def _frustum(
        self, name: str, T: FloatArray, rig: Rig, size: float, rgb: Any, width: float, pixels: Pixels | None
    ) -> Any:
        y, aspect = rig.height / (2 * rig.fy), rig.width / rig.height
        angle = 2 * float(np.arctan(y))
        volume = float(np.cbrt(y * y * aspect / 3))  # of the pyramid of depth 1, by which viser makes all look as large
        return self._scene.add_camera_frustum(
            name, angle, aspect, scale=size * self.reach * volume, color=rgb, thickness=width, thickness_units="screen",
            image=pixels, format="jpeg", wxyz=quaternion(T[:3, :3]), position=T[:3, 3], cast_shadow=False,
            receive_shadow=False,
        )  # fmt: skip

    def _put(self, name: str, node: Any) -> None:
        self._nodes[name] = node

    def _remove(self, name: str) -> None:
        if name in self._nodes:
            self._nodes.pop(name).remove()


def frustums(poses: FloatArray, rig: Rig, size: float) -> FloatArray:
    """Lines of frustums, (8 n, 2, 3), m."""
    x = np.array([-0.5, rig.width - 0.5, rig.width - 0.5, -0.5])
    y = np.array([-0.5, -0.5, rig.height - 0.5, rig.height - 0.5])
    far = np.stack([(x - rig.cx) / rig.fx, (y - rig.cy) / rig.fy, np.ones(4)], axis=1)
    corners = np.vstack([np.zeros((1, 3)), far * size])
    placed = np.einsum("nij,cj->nci", poses[:, :3, :3], corners) + poses[:, None, :3, 3]
    return np.asarray(placed[:, _CORNERS].reshape(-1, 2, 3))


def quaternion(R: FloatArray) -> FloatArray:
    """A rotation as (w, x, y, z), with w >= 0: from its largest component, so that none is divided by zero."""
    m = np.array([
        [R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
        [0, R[0, 0] - R[1, 1] - R[2, 2], R[1, 0] + R[0, 1], R[2, 0] + R[0, 2]],
        [0, 0, R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]],
        [0, 0, 0, R[2, 2] - R[0, 0] - R[1, 1]],
    ])  # fmt: skip
    _, vectors = np.linalg.eigh(m, UPLO="U")
    found: FloatArray = vectors[:, -1]
    return -found if found[0] < 0 else found


def _far(z: FloatArray) -> float:
    return limits(z, 0.0, 90.0)[1]


def _size(places: FloatArray, xyz: FloatArray, first: FloatArray) -> float:
    """How large the scene is, m: the path, or where that is short what lies before the first camera."""
    path = float(np.linalg.norm(np.ptp(places, axis=0)))
    depth = (xyz - first[:3, 3]) @ first[:3, 2] if len(xyz) else np.ones(1)
    ahead = depth[depth > 0]
    return max(path, float(np.median(ahead)) if len(ahead) else 1.0, 1e-3)
