"""A map as an interactive scene: the surface in its luminance, with the camera's path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from ..topological_map import TopologicalMap
from ..types import BoolArray, FloatArray
from ._frame import CLIP_MARGIN, Shown, limits
from ._map import luminance
from ._scene import GREYS, HOVER, Mesh, Trace, bare, colour_bar, figure_of, geometry, upright
from ._viewpoints import KEPT_PERCENT, is_overhead

MOST_FACES = 60_000  # beyond these the page grows over 6 MB, four fifths of which are plotly's
CEILING_SHARE = 0.05  # of the faces look down: else it is no room, and all is shown at once
PATH_COLOUR = "#e8590c"  # legible on a light and on a dark page
EYE = np.array([-0.85, -1.15, 1.3])  # behind the start, to its left, high above, in radii of the scene


class MapScene(NamedTuple):
    """A figure; which of its traces each button shows: label, first, count; how many vertices lie too far off."""

    figure: go.Figure
    buttons: list[tuple[str, int, int]]
    hidden: int


def map_scene(map_: TopologicalMap, regions: FloatArray | None = None) -> MapScene | None:
    """Build the scene of a map; None if it has no face to show.

    With colours of its faces, (F, 3) in [0, 1], the scene begins with these, and luminance is a button.
    """
    keep = _in_reach(map_)
    is_kept = np.asarray(keep[map_.surface.faces].all(axis=1), np.bool_)
    if not is_kept.any():
        return None
    shown = luminance(map_)
    span = limits(shown.values[shown.ok & is_kept])
    is_ceiling = is_overhead(map_) & is_kept
    hidden = int((~keep).sum())
    if regions is not None:
        painted = [_painted(map_, is_kept, regions), *_path(map_)]
        traces = [*painted, *_surface(map_, is_kept, shown, span), *_path(map_)]
        buttons = [("Regions", 0, len(painted)), ("Luminance", len(painted), len(traces) - len(painted))]
        return MapScene(figure_of(traces, len(painted), EYE), buttons, hidden)
    if is_ceiling.sum() <= CEILING_SHARE * is_kept.sum() or is_ceiling.sum() == is_kept.sum():
        traces = [*_surface(map_, is_kept, shown, span), *_path(map_)]
        return MapScene(figure_of(traces, len(traces), EYE), [], hidden)
    rest = [*_surface(map_, is_kept & ~is_ceiling, shown, span), *_path(map_)]
    above = _surface(map_, is_ceiling, shown, span)
    count = len(rest), len(rest) + len(above)
    buttons = [("Without ceiling", 0, count[0]), ("Whole surface", 0, count[1])]
    return MapScene(figure_of([*rest, *above], count[0], EYE), buttons, hidden)


def _in_reach(map_: TopologicalMap) -> BoolArray:
    """Mark the vertices, (N,), that are not far off the rest: nearly all, and a quarter of their range more."""
    if not len(map_):
        return np.zeros(0, bool)
    low, high = np.percentile(map_.xyz, KEPT_PERCENT, axis=0)
    margin = CLIP_MARGIN * (high - low) + 1e-9
    return np.asarray(((map_.xyz >= low - margin) & (map_.xyz <= high + margin)).all(axis=1))


def _surface(map_: TopologicalMap, which: BoolArray, shown: Shown, span: tuple[float, float]) -> list[Trace]:
    """Faces in their luminance, those that no keyframe sees in plain grey."""
    traces = []
    if (seen := np.flatnonzero(which & shown.ok)).size:
        mesh = _mesh(map_, seen)
        low, high = span
        traces.append(
            go.Mesh3d(
                **geometry(mesh, mesh.faces), intensity=shown.values[seen].astype(np.float32), intensitymode="cell",
                colorscale=GREYS, cmin=low, cmax=high, colorbar=colour_bar("mean luminance", low, high),
                hovertemplate=HOVER,
            )
        )  # fmt: skip
    if (unseen := np.flatnonzero(which & ~shown.ok)).size:
        mesh = _mesh(map_, unseen)
        traces.append(bare(mesh, mesh.faces))
    return traces


def _painted(map_: TopologicalMap, which: BoolArray, rgb: FloatArray) -> Trace:
    """Faces in given colours."""
    rows = np.flatnonzero(which)
    mesh = _mesh(map_, rows)
    colours = [f"rgb({r},{g},{b})" for r, g, b in np.rint(255 * rgb[rows]).astype(int).tolist()]
    return go.Mesh3d(**geometry(mesh, mesh.faces), facecolor=colours, hoverinfo="skip")


def _mesh(map_: TopologicalMap, rows: NDArray[np.int64]) -> Mesh:
    faces = map_.surface.faces[rows]
    vertices = np.unique(faces).astype(np.int64)
    kind = np.uint16 if len(vertices) <= 1 << 16 else np.int32  # half of the page's bytes
    return Mesh(upright(map_.xyz[vertices]), vertices, np.searchsorted(vertices, faces).astype(kind), rows)


def _path(map_: TopologicalMap) -> list[Trace]:
    x, y, z = (np.ascontiguousarray(c) for c in upright(map_.T_world_camera[:, :3, 3]).T)
    line, marker = {"color": PATH_COLOUR, "width": 5}, {"color": PATH_COLOUR, "size": 2.5}
    words = [f"frame {k}" for k in map_.keyframes.tolist()]
    return [
        go.Scatter3d(
            x=x, y=y, z=z, mode="lines+markers", line=line, marker=marker, text=words,
            hovertemplate="%{text}<extra></extra>",
        )
    ]  # fmt: skip
