"""What a page shows in space, to turn: the mesh of a frame, or a map with the path; drawn by the scripts in `_web`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from ..frame import Frame
from ..topological_map import TopologicalMap
from ..types import FloatArray
from ._html import text
from ._layers import layers_of_map
from ._space import Others, Packed, Station, pack, space_of_frame, space_of_map

SCRIPTS = ("tools", "model", "graphics", "camera", "drawing", "picking", "legend", "scene")  # in this order
LEVELS = (("face", "Faces"), ("edge", "Edges"), ("vertex", "Vertices"))
HOW = "Drag to turn, shift and drag to move, scroll or pinch to zoom. Keys: arrows, + and −, 0 for the first view."
NO_GRAPHICS = "This browser has no WebGL 2, with which this page shows it in space; all else is here."
NO_SCRIPT = "This page shows it in space by a script of its own, and scripts are switched off."


def frame_to_turn(frame: Frame) -> str:
    """Make the section with the interactive scene of a frame, or say why there is none."""
    space = space_of_frame(frame)
    if space is None:
        return '<section><h2>The mesh in space</h2><p class="quiet">This frame has no points to show.</p></section>'
    return f'<section class="scene"><h2 id="space">The {space.what} in space</h2>{_scene(pack(space), HOW)}</section>'


def map_to_turn(
    map_: TopologicalMap, regions: FloatArray | None = None, *, before: TopologicalMap | None = None,
    stations: Sequence[Station] = (), others: Others = (),
) -> str:  # fmt: skip
    """Make the interactive scene of a map, its faces first in colours if any are given; or say why there is none.

    Parameters
    ----------
    map_ : TopologicalMap
        The map.
    regions : (F, 3) float64, optional
        Colours of the faces, in [0, 1].
    before : TopologicalMap, optional
        What a denoised map was.
    stations : sequence of Station
        The frames of the path, in order; else the map's keyframes.
    others : sequence of (words, (T, 3) float64)
        Other paths, such as the true one, m.
    """
    space = space_of_map(map_, layers_of_map(map_, regions, before), stations, others)
    if space is None:
        return '<p class="quiet">This map has no face to show.</p>'
    return _scene(pack(space), HOW)


def _scene(packed: Packed, how: str) -> str:
    """The scene with its switches; several may be on one page."""
    plot = (
        '<div class="plot"><canvas tabindex="0" role="application" aria-label="In space"></canvas>'
        '<span class="ruler"></span></div>'
    )
    place = "path" if len(packed.space.stations) > 1 else "camera"
    views = "".join(
        f'<button type="button" data-view="{name}">{words}</button>'
        for name, words in (("above", "From above"), ("path", f"From the {place}"), ("first", "Reset the view"))
    )
    return (
        f'<div class="space"><p class="quiet idle">{NO_SCRIPT}</p>'
        f'<p class="quiet without" hidden>{NO_GRAPHICS}</p><form hidden autocomplete="off">{_layers(packed)}'
        f'{plot}<div class="legend"></div>{_time(packed)}<div class="below"><div class="views">{views}</div>'
        f'{_switches(packed)}</div><output class="said"></output><p class="quiet">{text(how + _left_out(packed))}</p>'
        f'</form><script type="application/json">{packed.json()}</script></div><script>{_script()}</script>'
    )


@cache
def _script() -> str:
    """The files of the script as one function, which leaves no name behind."""
    folder = files("tspslam.view").joinpath("_web")
    parts = [folder.joinpath(f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS]
    return f'(() => {{\n"use strict";\n{"".join(parts)}}})();'


def _layers(packed: Packed) -> str:
    """One radio button a layer, by level; the first of the level that is drawn as a whole is chosen."""
    layers = packed.space.layers
    first = "vertex" if packed.space.what == "points" else "face"
    chosen = next((k for k, layer in enumerate(layers) if layer.level == first), 0)
    groups = []
    for level, words in LEVELS:
        buttons = "".join(
            f'<label><input type="radio" name="layer" value="{k}"{" checked" if k == chosen else ""}>'
            f"<span>{text(layer.label)}</span></label>"
            for k, layer in enumerate(layers)
            if layer.level == level
        )
        if buttons:
            groups.append(f"<fieldset><legend>{words}</legend>{buttons}</fieldset>")
    return f'<div class="layers">{"".join(groups)}</div>'


def _switches(packed: Packed) -> str:
    """A box for each thing that is there."""
    space, left = packed.space, packed.kept
    has_faces, is_path = len(left.faces) > 0, len(space.stations) > 1
    boxes = [
        ("surface", "Surface", has_faces, has_faces),
        ("ceiling", "Ceiling", packed.meta["ceiling"] is not None, False),
        ("edges", "Edges", len(left.edges) > 0, False),
        ("points", "Points", True, not has_faces),
        ("strokes", "Directions", any(layer.name == "direction" for layer in space.layers), False),
        ("path", "Path", is_path or bool(space.others), True),
        ("frustums", "Keyframes" if is_path else "Camera", len(space.stations) > 0, True),
    ]
    shown = "".join(
        f'<label><input type="checkbox" name="{name}"{" checked" if is_on else ""}> {words}</label>'
        for name, words, is_there, is_on in boxes
        if is_there
    )
    return f'<fieldset class="shown"><legend>Shown</legend>{shown}</fieldset>'


def _time(packed: Packed) -> str:
    """A slider over the path."""
    last = len(packed.space.stations) - 1
    if last < 1:
        return ""
    return (
        '<div class="time"><button type="button" class="play">Play</button><label>Along the path '
        f'<input type="range" min="0" max="{last}" value="0" step="1"></label><output></output></div>'
    )


def _left_out(packed: Packed) -> str:
    """Words for what the scene leaves out; empty if nothing."""
    space, left = packed.space, packed.kept
    far = len(space.keep) - int(space.keep.sum())
    why = "far off" if space.what == "map" else "far off or unseen"
    words = f" Vertices not shown, {why}: {far}." if far else ""
    if left.cell:
        was = len(space.faces), "faces", len(left.faces)
        count = was if was[0] else (len(space.xyz), "points", len(left.vertices))
        words += (
            f" Thinned for this page from {count[0]} {count[1]} to {count[2]}: vertices in one cell of "
            f"{left.cell:.2g} m are one."
        )
    return words
