"""The page of a map's picture: its panels, the path over the surface, scale, legend, and the wheel of directions."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from ..topological_map import TopologicalMap
from ..types import BoolArray, FloatArray
from . import _style as style
from ._solid import grid_step
from ._viewpoints import Outlook

PATH_COLOUR, BACKDROP, PALE = "#d55e00", "#f4f6f8", "#c0d5e9"
GAP = 0.14  # inches between two panels
SCALE_SHARE = 0.3  # of the picture's width that a scale bar takes at most
CORNERS = {"lower left": (0, -1), "upper left": (0, 0), "upper right": (-1, 0), "lower right": (-1, -1)}


def map_page(map_: TopologicalMap, outlook: Outlook, title: str, caption: str) -> tuple[Figure, Axes]:
    """Lay out a page with one panel for a picture of a map, with room for a colour bar."""
    height, width = outlook.size
    figure, axes = style.page(height / width, title, name_of(map_), caption, side=True)
    return figure, axes


def double_page(map_: TopologicalMap, outlook: Outlook, title: str, caption: str) -> tuple[Figure, tuple[Axes, Axes]]:
    """Lay out a page with two panels, one above the other."""
    panel = style.WIDTH - style.LEFT - style.BAR
    aspect = 2 * outlook.size[0] / outlook.size[1] + GAP / panel
    figure, axes = style.page(aspect, title, name_of(map_), caption, side=True)
    box, gap = axes.get_position(), GAP / figure.get_size_inches()[1]
    axes.remove()
    height = (box.height - gap) / 2
    panels = tuple(figure.add_axes((box.x0, y, box.width, height)) for y in (box.y1 - height, box.y0))
    for panel_axes in panels:
        style.frame_only(panel_axes)
    return figure, (panels[0], panels[1])


def name_of(map_: TopologicalMap) -> str:
    """What the map is of, for the corner of a page."""
    first, last = int(map_.keyframes.min()), int(map_.keyframes.max())
    K = len(map_.keyframes)
    return f"frame {first}" if K == 1 else f"{K} keyframes, frames {first} to {last}"


def show_faces(axes: Axes, outlook: Outlook, rgb: FloatArray, ok: BoolArray) -> None:
    """Paint each face, (F,), in its colour, (F, 3); those that are not `ok` in the pale tint."""
    pixels = outlook.paint(np.where(ok[:, None], rgb, to_rgb(PALE)), np.array(to_rgb(BACKDROP)))
    height, width = outlook.size
    axes.imshow(pixels, interpolation="nearest", aspect="auto", extent=(-0.5, width - 0.5, height - 0.5, -0.5))
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    if not (outlook.owner >= 0).any():
        style.text(axes, width / 2, height / 2, "nothing to show", size=13, colour=style.QUIET, ha="center")


def draw_path(axes: Axes, map_: TopologicalMap, outlook: Outlook) -> list[Line2D]:
    """Draw the camera's path and its keyframes: whole from above, else what is ahead; with what its legend says."""
    T = map_.T_world_camera[:, :3, 3]
    uv = outlook.place(T if outlook.is_above else T[outlook.keyframe :])
    ahead = np.isfinite(uv).all(axis=1)
    u, v = uv[: len(uv) if ahead.all() else int(np.argmin(ahead))].T
    halo = [withStroke(linewidth=3.2, foreground="#ffffff")]
    keyframes: dict[str, Any] = {"marker": "o", "mfc": "#ffffff", "mec": PATH_COLOUR, "mew": 1.0, "color": PATH_COLOUR}
    start: dict[str, Any] = {"marker": "o", "ls": "", "color": PATH_COLOUR, "mec": "#ffffff", "mew": 1.0}
    end = start | {"marker": "s"}
    axes.plot(u, v, lw=1.6, ms=3.2, zorder=3, path_effects=halo, **keyframes)
    words = "camera's path and keyframes" if outlook.is_above else "camera's path ahead, keyframes"
    handles = [Line2D([], [], lw=1.6, ms=3.2, label=words, **keyframes)] if len(u) else []
    if outlook.is_above and len(u) > 1:
        axes.plot(u[:1], v[:1], ms=9.5, zorder=5, **start)
        axes.plot(u[-1:], v[-1:], ms=8, zorder=5, **end)
        handles += [Line2D([], [], ms=8, label="start", **start), Line2D([], [], ms=7, label="end", **end)]
    return handles


def draw_legend(axes: Axes, outlook: Outlook, path: list[Line2D], pale: str) -> str:
    """Name the path, and the pale tint (unless `pale` is empty), in the emptiest corner; which one."""
    tint = [Patch(facecolor=PALE, edgecolor=style.RULE, linewidth=0.5, label=pale)] if pale else []
    place = emptiest(outlook, list(CORNERS))
    if path or tint:
        legend = axes.legend(
            handles=[*path, *tint], loc=place, prop={"family": style.FONT, "size": 8.5}, fancybox=False,
            framealpha=0.92, edgecolor=style.RULE, facecolor=style.PAPER, labelcolor=style.INK, handlelength=1.4,
            borderaxespad=0.7,
        )  # fmt: skip
        legend.set_zorder(6)
    return place


def emptiest(outlook: Outlook, places: list[str]) -> str:
    """Choose the corner where the least of the surface is; of equal ones the first."""
    height, width = (side // 4 for side in outlook.owner.shape)
    free = []
    for place in places:
        right, low = CORNERS[place]
        part = outlook.owner[:height] if low == 0 else outlook.owner[-height:]
        part = part[:, :width] if right == 0 else part[:, -width:]
        free.append(float((part < 0).mean()))
    return places[int(np.argmax(free))]


def draw_scale(axes: Axes, outlook: Outlook, taken: str) -> None:
    """Draw a bar of a round length, m, in the lower corner that the legend leaves."""
    length = grid_step(8 * SCALE_SHARE * outlook.size[1] / outlook.scale) * 0.5
    left = emptiest(outlook, [place for place in ("lower left", "lower right") if place != taken]) == "lower left"
    height, width = outlook.size
    span = length * outlook.scale
    start = 24.0 if left else width - 24.0 - span
    halo = [withStroke(linewidth=3, foreground="#ffffff")]
    row = height - 22
    axes.plot(
        [start, start, start + span, start + span], [row - 6, row, row, row - 6], color=style.INK, lw=1.6,
        path_effects=halo, zorder=6, solid_joinstyle="miter",
    )  # fmt: skip
    words = style.text(axes, start + span / 2, row - 15, f"{length:g} m", size=9.5, ha="center", va="center")
    words.set_path_effects(halo)
    words.set_zorder(6)


def direction_colours(angle: FloatArray, length: FloatArray, brightness: FloatArray) -> FloatArray:
    """Colours (n, 3): hue of the angle on the picture, grey where the direction stands across it; brightness as given.

    Parameters
    ----------
    angle : (n,) float64
        Clockwise on the picture, rad.
    length, brightness : (n,) float64
        In [0, 1].
    """
    hue = style.colours(angle, Normalize(-np.pi, np.pi), style.phase_map())
    grey = np.full(3, 0.68)
    return np.clip(brightness[:, None], 0, 1) * (grey + length[:, None] * (hue - grey))


def direction_wheel(figure: Figure, axes: Axes, norm: Normalize, dimmest: float) -> None:
    """Draw the legend of directions beside the panel: a disc of hues, dim in the middle, with what they stand for."""
    box, height = style.drawn_box(axes), figure.get_size_inches()[1]
    side, left = 0.86, box.x1 + 0.15 / style.WIDTH
    middle = (box.y0 + box.y1) / 2
    disc = figure.add_axes((left, middle - side / height / 2, side / style.WIDTH, side / height))
    disc.axis("off")
    v, u = np.meshgrid(np.linspace(-1, 1, 256), np.linspace(-1, 1, 256), indexing="ij")
    radius = np.hypot(u, v)
    rgb = direction_colours(
        np.arctan2(v, u).ravel(), np.ones(u.size), (dimmest + (1 - dimmest) * np.minimum(radius, 1)).ravel()
    )
    alpha = np.clip((1 - radius) * 60, 0, 1)[..., None]
    disc.imshow(np.concatenate([rgb.reshape(*u.shape, 3), alpha], axis=2), extent=(-1, 1, 1, -1))
    for du, dv in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        disc.annotate(
            "", (0.85 * du, 0.85 * dv), (0.35 * du, 0.35 * dv), arrowprops={"arrowstyle": "-|>", "color": "#ffffff"}
        )
    low, high = f"{10 ** float(norm.vmin or 0):.2g}", f"{10 ** float(norm.vmax or 0):.2g}"
    centre = left + side / style.WIDTH / 2
    lines = ["hue: where", "luminance grows,", "on this picture"]
    for number, line in enumerate(reversed(lines)):
        at = middle + (side / 2 + 0.16 + 0.16 * number) / height
        style.text(figure, centre, at, line, size=7.5, ha="center")
    for number, line in enumerate((f"rim: |r| = {high}", f"middle: {low}")):
        style.text(figure, centre, middle - (side / 2 + 0.16 + 0.16 * number) / height, line, size=7.5, ha="center")
