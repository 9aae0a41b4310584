"""The one look of all pictures: page, title, caption, image panel, colour bar, phase wheel; no global state."""

from __future__ import annotations

import io
import textwrap
from functools import cache
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from ..types import FloatArray, Image
from ._frame import grey, log_steps, phase_colours

FONT = "DejaVu Sans"
WIDTH, DPI = 10.0, 140  # inches, dots per inch: 1400 px
INK, QUIET, RULE, PAPER = "#1b2430", "#64707d", "#c9d0d6", "#ffffff"
LEFT, RIGHT, TOP, BOTTOM, BAR = 0.3, 0.3, 0.62, 0.24, 1.15
CAPTION_LINE, CAPTION_WIDTH = 0.2, 140
TALLEST, LOWEST = 9.0, 1.4


def image_page(image: Image, title: str, name: str, caption: str, *, side: bool, tone: str) -> tuple[Figure, Axes]:
    """Lay out a page with the image in grey on it; `side` leaves room for a colour bar, `tone`: plain, dark, light."""
    height, width = image.shape[:2]
    figure, axes = page(height / width, title, name, caption, side=side)
    levels = {"plain": (0.0, 1.0), "dark": (0.05, 0.42), "light": (0.5, 0.5)}[tone]
    pixels = np.rint(255 * (levels[0] + levels[1] * grey(image))).astype(np.uint8)
    axes.imshow(pixels, cmap="gray", vmin=0, vmax=255, interpolation="antialiased", aspect="equal")
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)
    return figure, axes


def page(aspect: float, title: str, name: str, caption: str, *, side: bool) -> tuple[Figure, Axes]:
    """Lay out a page 1400 px wide with one framed panel, `aspect` = height / width, between title and caption."""
    lines = textwrap.wrap(caption, CAPTION_WIDTH)
    below = BOTTOM + CAPTION_LINE * len(lines)
    panel_width = WIDTH - LEFT - (BAR if side else RIGHT)
    panel_height = min(max(panel_width * aspect, LOWEST), TALLEST)
    height = round(DPI * (TOP + panel_height + below)) / DPI
    figure = Figure(figsize=(WIDTH, height), dpi=DPI, facecolor=PAPER, edgecolor=PAPER)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((LEFT / WIDTH, below / height, panel_width / WIDTH, panel_height / height))
    frame_only(axes)
    text(figure, LEFT / WIDTH, 1 - 0.2 / height, title, size=14.5, weight="bold", va="top")
    text(
        figure,
        1 - RIGHT / WIDTH,
        1 - 0.25 / height,
        " ".join(name.split())[:60],
        size=9.5,
        colour=QUIET,
        ha="right",
        va="top",
    )
    start = (below - 0.1) / height
    text(figure, LEFT / WIDTH, start, "\n".join(lines), size=9, colour=QUIET, va="top", linespacing=1.5)
    return figure, axes


def frame_only(axes: Axes) -> None:
    """Leave nothing of the axes but a thin frame."""
    axes.set_facecolor(PAPER)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(color=RULE, linewidth=0.8)


def text(
    parent: Figure | Axes,
    x: float,
    y: float,
    words: str,
    *,
    size: float,
    colour: str = INK,
    weight: str = "normal",
    ha: str = "left",
    va: str = "center",
    linespacing: float = 1.2,
) -> Any:
    """Write plain text in the one font: a dollar sign is a dollar sign, a character that it lacks a question mark."""
    font = FontProperties(family=FONT, size=size, weight=weight)
    artist = parent.text(
        x, y, drawable(words), fontproperties=font, color=colour, ha=ha, va=va, linespacing=linespacing
    )
    artist.set_parse_math(False)
    return artist


def drawable(words: str) -> str:
    """Replace each character that the font cannot draw by a question mark.

    Examples
    --------
    >>> drawable("ψ ≥ 0 漢")
    'ψ ≥ 0 ?'
    """
    return "".join(c if c == "\n" or (c.isprintable() and ord(c) in _charmap()) else "?" for c in words)


@cache
def _charmap() -> frozenset[int]:
    return frozenset(get_font(findfont(FontProperties(family=FONT))).get_charmap())


def colour_bar(figure: Figure, axes: Axes, norm: Normalize, cmap: Colormap | str, label: str, *, extend: str) -> None:
    """Draw a slim colour bar to the right of the panel; `label` carries the unit."""
    box = drawn_box(axes)
    bar = figure.add_axes((box.x1 + 0.16 / WIDTH, box.y0, 0.16 / WIDTH, box.height))
    colours = figure.colorbar(ScalarMappable(norm, cmap), cax=bar, extend=extend, extendfrac=0.03)
    colours.outline.set(linewidth=0)
    if isinstance(norm, LogNorm):
        ticks = log_steps(float(norm.vmin or 1), float(norm.vmax or 1))
        colours.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        colours.minorticks_off()
    bar.tick_params(labelsize=9, labelcolor=INK, labelfontfamily=FONT, color=RULE, length=3, width=0.8)
    bar.set_ylabel(label, fontproperties=FontProperties(family=FONT, size=9.5), color=INK, labelpad=7)


def extends(values: FloatArray, low: float, high: float) -> str:
    """Tell which ends of a colour bar stand for values beyond it."""
    below, above = values.min() < low, values.max() > high
    return "both" if below and above else "min" if below else "max" if above else "neither"


def drawn_box(axes: Axes) -> Any:
    """Find where the panel really is on the page, after its aspect is applied, in fractions of the page."""
    axes.apply_aspect()
    return axes.get_position()


def colours(values: FloatArray, norm: Normalize, cmap: Colormap | str) -> FloatArray:
    """Map values to (n, 3) sRGB in [0, 1]."""
    table = matplotlib.colormaps[cmap] if isinstance(cmap, str) else cmap
    return np.asarray(table(norm(values)))[:, :3]


def phase_map() -> ListedColormap:
    """Make the cyclic colour map of phase, from -π to π."""
    return ListedColormap(phase_colours(512), name="phase")


def phase_wheel(figure: Figure, axes: Axes) -> None:
    """Draw the legend of a phase picture: a ring whose colour at each direction is that direction's phase, v down."""
    box = drawn_box(axes)
    height = figure.get_size_inches()[1]
    side = 0.62
    ring = figure.add_axes((box.x1 + 0.27 / WIDTH, (box.y0 + box.y1 - side / height) / 2, side / WIDTH, side / height))
    ring.axis("off")
    across = np.linspace(-1, 1, 256)
    v, u = np.meshgrid(across, across, indexing="ij")
    pixels = phase_map()(Normalize(-np.pi, np.pi)(np.arctan2(v, u)))
    radius = np.hypot(u, v)
    pixels[..., 3] = np.clip((1 - radius) * 60, 0, 1) * np.clip((radius - 0.55) * 60, 0, 1)
    ring.imshow(pixels, extent=(-1, 1, 1, -1), interpolation="antialiased")
    for u0, v0, label in ((1.3, 0, "0"), (0, 1.38, "π/2"), (-1.28, 0, "π"), (0, -1.38, "-π/2")):
        text(ring, u0, v0, label.replace("-", "\N{MINUS SIGN}"), size=8.5, ha="center")
    text(ring, 0, 0, "rad", size=7.5, colour=QUIET, ha="center")


def png(figure: Figure) -> bytes:
    """Encode a page as PNG; one set of versions gives the same page the same bytes."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": "tspslam"})
    return buffer.getvalue()
