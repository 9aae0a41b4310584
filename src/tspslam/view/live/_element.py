"""What is known of one vertex, edge or face: its number, place, values with units, and the keyframes that see it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief, brief
from ...frame import Frame
from ...topological_map import TopologicalMap
from ...types import FloatArray
from .._layers import COUNTED, Layer, Level
from ._drawn import Drawn

_LEVELS = ("vertex", "edge", "face")


class Sighting(NamedTuple):
    """Number of a frame that sees an element, where in its left image, px, and the cosine of the viewing angle."""

    number: int
    uv: FloatArray
    weight: float

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, repr=False)
class Element(Brief):
    """One vertex, edge or face.

    Attributes
    ----------
    level : {"vertex", "edge", "face"}
        What it is.
    number : int
        Its place in its complex.
    vertices : (k,) int
        Its vertices.
    place : (3,) float64
        Their mean in the world, m.
    facts : list of (str, str)
        What is known of it, with units.
    sightings : list of Sighting
        Frames that see it, the best view first.
    """

    level: Level
    number: int
    vertices: NDArray[np.int64]
    place: FloatArray
    facts: list[tuple[str, str]]
    sightings: list[Sighting]


def element_at(drawn: Drawn, face: int, point: FloatArray, level: Level) -> Element:
    """The face that was hit, or its side or corner next to the point."""
    corners = drawn.faces[face]
    if level == "face":
        return element_of(drawn, "face", face)
    if level == "vertex":
        return element_of(drawn, "vertex", int(corners[np.linalg.norm(drawn.xyz[corners] - point, axis=1).argmin()]))
    sides = np.stack([corners, np.roll(corners, -1)], axis=1)
    side = np.sort(sides[int(np.argmin([_distance(point, *drawn.xyz[each]) for each in sides]))])
    return element_of(drawn, "edge", int(np.flatnonzero((np.sort(drawn.edges, axis=1) == side).all(axis=1))[0]))


def element_of(drawn: Drawn, level: Level, number: int) -> Element:
    """What is known of one element."""
    cells = {"vertex": None, "edge": drawn.edges, "face": drawn.faces}[level]
    vertices = np.array([number]) if cells is None else cells[number].astype(np.int64)
    place = drawn.xyz[vertices].mean(axis=0)
    facts = [("place", ", ".join(f"{x:.3f}" for x in place) + " m (right, down, ahead)")]
    facts += [(each.label, value_of(each, number)) for each in drawn.layers if each.level == level]
    source = drawn.source
    if isinstance(source, Frame):
        uv = source.cloud.uv[vertices].mean(axis=0)
        return Element(level, number, vertices, place, facts, [Sighting(source.index, uv, 1.0)])
    facts += _of_map(source, level, number)
    return Element(level, number, vertices, place, facts, _sightings(source, vertices, place))


def value_of(layer: Layer, number: int) -> str:
    """The value of one element with its unit, or why there is none."""
    if not layer.ok[number]:
        return "none"
    if layer.scale == "rgb":
        return ", ".join(f"{x:.2f}" for x in layer.values[number])
    value = 10.0 ** layer.values[number] if layer.is_log else layer.values[number]
    if layer.unit == COUNTED:
        return f"{value:.0f} {layer.unit}"
    unit = {"|r|": "", "arg r [rad]": " rad", "luminance": ""}.get(layer.unit, f" {layer.unit}")
    return f"{value:.3g}{unit}"


def _of_map(map_: TopologicalMap, level: Level, number: int) -> list[tuple[str, str]]:
    """Besides the layers: landmark and how well it is placed, and the best view."""
    facts = []
    if level == "vertex":
        facts = [("landmark", str(map_.landmark_id[number]))]
        spread = float(np.sqrt(max(np.linalg.eigvalsh(map_.covariance[number])[-1], 0.0)))
        facts.append(("standard deviation", f"{100 * spread:.2g} cm along its worst axis"))
    view = int(map_.best_view[_LEVELS.index(level)][number])
    return [*facts, ("best view", f"frame {map_.keyframes[view]}" if view >= 0 else "none")]


def _sightings(map_: TopologicalMap, vertices: NDArray[np.int64], place: FloatArray) -> list[Sighting]:
    """Keyframes in which all its vertices were matched, by the weight of the least."""
    seen = map_.observations
    weights: dict[int, list[float]] = {}
    for vertex in vertices.tolist():
        for row in range(seen.start[vertex], seen.start[vertex + 1]):
            weights.setdefault(int(seen.keyframe[row]), []).append(float(seen.weight[row]))
    full = {k: min(each) for k, each in weights.items() if len(each) == len(vertices)}
    found = []
    for k in sorted(full, key=lambda k: (-full[k], k)):
        uv = _projected(map_, k, place)
        if uv is not None:
            found.append(Sighting(int(map_.keyframes[k]), uv, full[k]))
    return found


def _projected(map_: TopologicalMap, keyframe: int, place: FloatArray) -> FloatArray | None:
    """Where a keyframe's left image has a place, px; None outside of it."""
    rig, T = map_.rig, map_.T_world_camera[keyframe]
    x, y, z = (place - T[:3, 3]) @ T[:3, :3]
    if z <= 0:
        return None
    uv = np.array([(rig.fx * x + rig.skew * y) / z + rig.cx, rig.fy * y / z + rig.cy])
    is_inside = -0.5 <= uv[0] <= rig.width - 0.5 and -0.5 <= uv[1] <= rig.height - 0.5
    return uv if is_inside else None


def _distance(point: FloatArray, a: FloatArray, b: FloatArray) -> float:
    """From a point to the line segment between two others, m."""
    along = b - a
    share = np.clip((point - a) @ along / max(float(along @ along), 1e-30), 0, 1)
    return float(np.linalg.norm(point - a - share * along))
