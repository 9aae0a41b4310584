"""A picture of a calibration by a board: where both images have corners, how far each is off, and how far each view."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .._atomic import make_folder, write_bytes
from ..types import FloatArray, RawRig
from . import _style as style

_MAP = "viridis"
_ARROW = 0.04  # of the image's width: an error at the end of the colour scale
_MOST = 0.98  # quantile of errors at the end of the colour scale
_BARS = 1.5  # inches
_GAP = 0.35  # inches
_SHORT = 3  # characters of a name that is written level
_NAMED = 30  # views whose names are written
LEFT_BAR, RIGHT_BAR = "#2f6fed", "#d55e00"


class Residuals(Protocol):
    """What the picture needs of the corners."""

    @property
    def side(self) -> NDArray[np.int64]:
        """(N,) 0 left, 1 right."""

    @property
    def uv(self) -> FloatArray:
        """(N, 2) where they were found, px."""

    @property
    def error(self) -> FloatArray:
        """(N, 2) where they should be, less `uv`, px."""


class OneView(Protocol):
    """What the picture needs of a view."""

    @property
    def name(self) -> str:
        """What to call it."""

    @property
    def left(self) -> float:
        """Root mean square of its errors in the left image, px."""

    @property
    def right(self) -> float:
        """Root mean square of its errors in the right image, px."""


class Calibration(Protocol):
    """What the picture needs of a calibration: a `BoardCalibration` has it."""

    @property
    def rig(self) -> RawRig:
        """The cameras."""

    @property
    def views(self) -> Sequence[OneView]:
        """Those that were used."""

    @property
    def residuals(self) -> Residuals:
        """All corners."""

    @property
    def error(self) -> tuple[float, float]:
        """Root mean square of all errors, left and right, px."""

    @property
    def coverage(self) -> tuple[float, float]:
        """Share of cells with a corner, left and right."""

    @property
    def rows(self) -> float:
        """Root mean square of the differences of rows, px."""


def write_board_picture(found: Calibration, path: str | Path) -> Path:
    """Draw the corners of all views in both images, coloured by their error, with their errors enlarged; and each view.

    Parameters
    ----------
    found : BoardCalibration
        What `tspslam.vision.calibration.board.calibrate` gives.
    path : str or path
        PNG file.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    length = np.linalg.norm(found.residuals.error, axis=1)
    norm = Normalize(0, max(float(np.quantile(length, _MOST)), 1e-3))
    figure, panels, bars = _page(found, norm)
    for side, axes in enumerate(panels):
        _draw_side(axes, found, side, norm)
    style.colour_bar(figure, panels[1], norm, _MAP, "corner off by, px", extend="max")
    _draw_bars(bars, found)
    make_folder(Path(path).parent)
    write_bytes(path, style.png(figure))
    return Path(path)


def _page(found: Calibration, norm: Normalize) -> tuple[Figure, list[Axes], Axes]:
    """A page with two panels beside each other, and one below for the bars."""
    camera = found.rig.left
    width = (style.WIDTH - style.LEFT - style.BAR - _GAP) / 2
    tall = width * camera.height / camera.width
    below = 0.75 + _BARS
    height = round(style.DPI * (style.TOP + 0.25 + tall + 0.5 + below)) / style.DPI
    figure = Figure(figsize=(style.WIDTH, height), dpi=style.DPI, facecolor=style.PAPER, edgecolor=style.PAPER)
    FigureCanvasAgg(figure)
    panels = []
    for side in (0, 1):
        left = style.LEFT + side * (width + _GAP)
        box = (left / style.WIDTH, (below + 0.5) / height, width / style.WIDTH, tall / height)
        panels.append(figure.add_axes(box))
        style.frame_only(panels[-1])
        words = f"{('left', 'right')[side]}: {found.error[side]:.3f} px off, {found.coverage[side]:.0%} covered"
        style.text(figure, box[0], box[1] + box[3] + 0.14 / height, words, size=10.5)
    style.text(figure, style.LEFT / style.WIDTH, 1 - 0.2 / height, "Calibration", size=14.5, weight="bold", va="top")
    times = _ARROW * camera.width / norm.vmax if norm.vmax else 1.0
    lines = f"Corners of {len(found.views)} views. Lines: their errors, {times:.0f} times as long."
    lines += f" Rows differ by {found.rows:.3f} px after rectification."
    style.text(figure, style.LEFT / style.WIDTH, (below + 0.3) / height, lines, size=9, colour=style.QUIET)
    box = (0.75 / style.WIDTH, 0.62 / height, 1 - (0.75 + style.RIGHT) / style.WIDTH, _BARS / height)
    return figure, panels, figure.add_axes(box)


def _draw_side(axes: Axes, found: Calibration, side: int, norm: Normalize) -> None:
    camera = (found.rig.left, found.rig.right)[side]
    chosen = found.residuals.side == side
    uv, error = found.residuals.uv[chosen], found.residuals.error[chosen]
    colours: Any = style.colours(np.linalg.norm(error, axis=1), norm, _MAP)
    reach = _ARROW * camera.width / (norm.vmax or 1.0)
    axes.add_collection(
        LineCollection(list(np.stack([uv, uv + reach * error], axis=1)), colors=colours, linewidths=0.8)
    )
    axes.scatter(uv[:, 0], uv[:, 1], s=5, c=colours, linewidths=0, zorder=3)
    axes.set_xlim(-0.5, camera.width - 0.5)
    axes.set_ylim(camera.height - 0.5, -0.5)
    axes.set_aspect("equal")


def _draw_bars(axes: Axes, found: Calibration) -> None:
    """How far each view is off, left and right."""
    at = np.arange(len(found.views))
    for side, (colour, shift) in enumerate(((LEFT_BAR, -0.2), (RIGHT_BAR, 0.2))):
        errors = np.nan_to_num([(view.left, view.right)[side] for view in found.views])
        axes.bar(at + shift, errors, 0.38, color=colour, label=("left", "right")[side])
        axes.axhline(found.error[side], color=colour, linewidth=0.8, linestyle="--")
    names = [style.drawable(view.name)[-12:] for view in found.views] if len(at) <= _NAMED else []
    slant: Any = {"rotation": 30, "ha": "right"} if max(map(len, names), default=0) > _SHORT else {}
    ticks: Any = axes.set_xticks(at, labels=names, **slant) if names else axes.set_xticks([])
    for tick in ticks:
        tick.label1.set_parse_math(False)
    axes.set_xlim(-0.6, max(len(at) - 0.4, 0.6))
    axes.tick_params(labelsize=8, labelcolor=style.INK, labelfontfamily=style.FONT, color=style.RULE)
    axes.set_ylabel("view off by, px", family=style.FONT, size=9, color=style.INK)
    font = {"family": style.FONT, "size": 8}
    axes.legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, prop=font)
    for name, spine in axes.spines.items():
        spine.set(color=style.RULE, linewidth=0.8, visible=name in ("left", "bottom"))
