"""What a page shows in space, to turn: the mesh of a frame, or a map."""

from __future__ import annotations

from ..frame import Frame
from ..topological_map import TopologicalMap
from ..types import FloatArray
from ._html import scene, text


def frame_to_turn(frame: Frame) -> str:
    """Make the section with the interactive scene of a frame, or say why there is none."""
    from ._scene import scene_figure, scene_views, thinned

    views = scene_views(frame)
    if not views:
        return '<section><h2>The mesh in space</h2><p class="quiet">This frame has no points to show.</p></section>'
    buttons, start = [], 0
    for view in views:
        buttons.append((view.label, start, len(view.traces)))
        start += len(view.traces)
    what = "mesh" if len(frame.complex_.faces) else "points"
    note = f"Drag to turn, scroll to zoom. Grey: no value.{thinned(frame)}"
    plot = scene(scene_figure(views), buttons, note)
    return f'<section class="scene"><h2>The {what} in space</h2>{plot}</section>'


def map_to_turn(map_: TopologicalMap, regions: FloatArray | None = None) -> str:
    """Make the interactive scene of a map, its faces first in colours if any are given; or say why there is none."""
    from ._map_scene import MOST_FACES, map_scene

    if len(map_.surface.faces) > MOST_FACES:
        words = f"{len(map_.surface.faces)} faces are more than a page shows well; map.vtu holds all of them."
        return f'<p class="quiet">{text(words)}</p>'
    made = map_scene(map_, regions)
    if made is None:
        return '<p class="quiet">This map has no face to show.</p>'
    note = (
        "Drag to turn, scroll to zoom. Orange: the camera's path. Grey and clear: seen by no keyframe, or too slanted."
    )
    note += f" Vertices not shown, far off: {made.hidden}." if made.hidden else ""
    return scene(made.figure, made.buttons, note)
