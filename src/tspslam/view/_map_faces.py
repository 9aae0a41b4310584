"""Faces of a map on a page: in their luminance, with light, legend, scale, and the words that go with them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..topological_map import TopologicalMap
from ..types import FloatArray
from . import _map_page as page
from . import _style as style
from ._frame import Shown, is_colour, limits
from ._map import luminance, rgb_of
from ._viewpoints import Outlook, is_overhead, normals

SIDE_LIGHT = 0.3  # share of a face's brightness that depends on how it stands
LIGHT = np.array([-0.45, -0.75, -0.48])  # as in the views of a frame: from above left, behind the viewer
LEAST_PIXELS = 12  # of the buffer: a face that takes fewer is not counted as shown
Pair = tuple[Outlook, Outlook]  # from above, and from the path


def show_luminance(figure: Figure, axes: Axes, map_: TopologicalMap, outlook: Outlook) -> None:
    """Faces in their luminance, with the path and all that explains them."""
    shown = luminance(map_)
    norm = Normalize(*limits(shown.values[shown.ok]))
    rgb = rgb_of(map_) if is_colour(map_.signals.face) else style.colours(shown.values, norm, "gray")
    page.show_faces(axes, outlook, rgb * light(map_)[:, None], shown.ok)
    explain(map_, axes, outlook, tint_words(outlook, shown, "seen by no keyframe, or too slanted"), with_path=True)
    style.colour_bar(figure, axes, norm, "gray", "luminance", extend=ends(shown, norm))


def explain(map_: TopologicalMap, axes: Axes, outlook: Outlook, pale: str, *, with_path: bool = False) -> None:
    """Legend, and from above the path and a scale."""
    path = page.draw_path(axes, map_, outlook) if outlook.is_above or with_path else []
    taken = page.draw_legend(axes, outlook, path, pale)
    if outlook.is_above:
        page.draw_scale(axes, outlook, taken)


def fuller(map_: TopologicalMap, views: Pair, shown: Shown) -> Outlook:
    """The picture that shows more faces with a value; of equal ones that from above."""
    return max(views, key=lambda view: int((view.pixels[shown.ok] >= LEAST_PIXELS).sum()))


def light(map_: TopologicalMap, side: float = SIDE_LIGHT) -> FloatArray:
    """Brightness of the faces, (F,) in [1 - side, 1], by how they stand."""
    towards = np.abs(normals(map_) @ (LIGHT / np.linalg.norm(LIGHT)))
    return np.asarray(1 - side + side * towards)


def tint_words(outlook: Outlook, shown: Shown, why: str) -> str:
    """Words for the pale tint, if the picture has any."""
    bare = (outlook.pixels > 0) & ~shown.ok
    return why if bare.any() else ""


def left_out(map_: TopologicalMap, outlook: Outlook | None = None) -> str:
    """Words for the faces that a picture leaves out."""
    count = 0 if outlook is not None and not outlook.is_above else int(is_overhead(map_).sum())
    return f" Left out: {count} faces that look down, such as a ceiling's." if count else ""


def whence(outlook: Outlook) -> str:
    """Where a picture is taken from."""
    return "From above" if outlook.is_above else "From the middle of the path"


def ends(shown: Shown, norm: Normalize) -> str:
    """Which ends of a colour bar values go beyond."""
    if not shown.ok.any():
        return "neither"
    return style.extends(shown.values[shown.ok], float(norm.vmin or 0), float(norm.vmax or 0))
