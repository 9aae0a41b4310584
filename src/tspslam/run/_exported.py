"""What is exported of a run, and how its map, its frames, its layers and its path become files of other programs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._brief import Brief
from .._files import bad_input
from ..frame import Frame
from ..io.glb import Drawn, write_glb
from ..io.las import write_las
from ..io.pvd import write_pvd
from ..io.runs import StoredRun, load_run
from ..io.tensors import write_tensors
from ..topological_map import TopologicalMap
from ..types import FloatArray, Response, one_channel

if TYPE_CHECKING:
    from ..view._layers import Layer

_PATH = np.array([230, 115, 0], np.uint8)  # sRGB: no colour of a layer's scale
_DISTINCT = 1e-9  # m: two poses this near make no line


@dataclass(frozen=True, repr=False)
class Exported(Brief):
    """What is exported: the map of a run, or one of its frames.

    Attributes
    ----------
    path : Path
        The run folder.
    shown : Frame or TopologicalMap
        What was chosen of it.
    layer : str or None
        Name of the layer that gives the colours; the format's own choice by default.
    """

    path: Path
    shown: Frame | TopologicalMap
    layer: str | None = None

    @cached_property
    def run(self) -> StoredRun:
        """The finished run."""
        return load_run(self.path)

    @property
    def xyz(self) -> FloatArray:
        """Vertices, (N, 3), m: of a frame in the camera's frame."""
        return self.shown.cloud.xyz if isinstance(self.shown, Frame) else self.shown.xyz

    def chosen_layer(self) -> Layer | None:
        """Look the layer up; the first where none was named, None where there is none."""
        from ..view._layers import layers_of_frame, layers_of_map

        shown = self.shown
        found = layers_of_frame(shown) if isinstance(shown, Frame) else layers_of_map(shown)
        if self.layer is None:
            return found[0] if found else None
        named = {layer.name: layer for layer in found}
        if self.layer not in named:
            raise bad_input(
                self.path,
                f"has no layer {self.layer!r}",
                f"one of {', '.join(named)}" if named else "no layer: it has none",
            )
        return named[self.layer]


def write_scene(given: Exported, target: Path) -> None:
    """Write a scene as binary glTF: faces, or the edges of an edge's layer, in a layer's colours, path and cameras."""
    layer, shown = given.chosen_layer(), given.shown
    drawn = [*_drawn(given, layer), *_drawn_path(given)]
    if isinstance(shown, Frame):
        cameras = {f"frame {shown.index:06d}": np.eye(4)}
    else:
        poses = zip(shown.keyframes.tolist(), shown.T_world_camera, strict=True)
        cameras = {f"keyframe {number:06d}": pose for number, pose in poses}
    write_glb(target, drawn, shown.rig, cameras, extras=_legend(layer))


def write_cloud(given: Exported, target: Path) -> None:
    """Write the vertices as LAS or LAZ: luminance as intensity, colours where there are some, and further numbers."""
    shown = given.shown
    signals, response = shown.signals, shown.response
    z = Response(one_channel(response.z), response.order, response.defined)
    luminance = one_channel(signals.vertex)
    columns: dict[str, Any] = {
        "luminance": luminance.astype(np.float32),
        "has_luminance": signals.vertex_ok.astype(np.uint8),
        "magnitude": z.magnitude.astype(np.float32),
        "phase": z.phase.astype(np.float32),
        "has_response": response.defined.astype(np.uint8),
    }
    if isinstance(shown, TopologicalMap):
        columns |= {"views": shown.view_count.vertex, "landmark_id": shown.landmark_id}
    elif shown.landmark is not None:
        columns |= {"landmark_id": shown.landmark.astype(np.int64)}
    write_las(target, given.xyz, luminance, rgb=_colours_of_points(given), columns=columns)


def write_numbers(given: Exported, target: Path) -> None:
    """Write all arrays for PyTorch Geometric and TopoX."""
    write_tensors(target, given.shown)


def write_series(given: Exported, target: Path) -> None:
    """Write the whole run for ParaView."""
    write_pvd(target, given.run, given.shown)


def _drawn(given: Exported, layer: Layer | None) -> list[Drawn]:
    """Faces in one colour each, or in those of their corners; edges of a layer of edges; vertices without a face."""
    from ..view._layers import BARE, colours_of

    shown, xyz = given.shown, given.xyz
    faces, edges = shown.surface.faces, shown.complex_.edges
    level = "face" if layer is None else layer.level
    rgb = np.tile(BARE, (len(faces), 1)) if layer is None else colours_of(layer)
    if level == "edge":
        return [Drawn("edges", "lines", xyz[edges].reshape(-1, 3), np.repeat(rgb, 2, axis=0))]
    if level == "face":
        return [Drawn("faces", "triangles", xyz[faces].reshape(-1, 3), np.repeat(rgb, 3, axis=0))]
    loose = np.setdiff1d(np.arange(len(xyz)), faces)
    return [
        Drawn("faces", "triangles", xyz, rgb, faces),
        Drawn("vertices without a face", "points", xyz[loose], rgb[loose]),
    ]


def _drawn_path(given: Exported) -> list[Drawn]:
    """The path of a run, as a line from pose to pose; none of a single frame."""
    if isinstance(given.shown, Frame):
        return []
    places = given.run.trajectory.T_world_camera[:, :3, 3]
    ends = np.stack([places[:-1], places[1:]], axis=1)
    ends = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > _DISTINCT].reshape(-1, 3)
    return [Drawn("path", "lines", ends, np.tile(_PATH, (len(ends), 1)))]


def _legend(layer: Layer | None) -> dict[str, Any]:
    """What the colours mean, as plain values."""
    said: dict[str, Any] = {"axes": "x right, y up, z back", "unit": "m"}
    if layer is None:
        return said
    scale = {} if layer.scale == "rgb" else {"scale": layer.scale, "span": [float(each) for each in layer.span]}
    logs = {"is_log10": True} if layer.is_log else {}
    return said | {"layer": layer.name, "level": layer.level, "of": layer.unit or layer.label, **scale, **logs}


def _colours_of_points(given: Exported) -> Any:
    """Colours of the layer that was named, else of a signal that has colours, (N, 3) uint8; None where neither is."""
    from ..view._layers import colours_of

    if given.layer is None:
        vertex = given.shown.signals.vertex
        is_colour = vertex.ndim == 2 and vertex.shape[1] == 3
        return np.rint(255 * np.clip(vertex, 0, 1)).astype(np.uint8) if is_colour else None
    layer = given.chosen_layer()
    if layer is None or layer.level != "vertex":
        raise bad_input(given.path, f"layer {given.layer!r} is not of vertices", "a layer of vertices for a cloud")
    return colours_of(layer)
