"""A calibration board on a page, at its true size, with a ruler to check the printer by."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from .._atomic import write_bytes
from .._files import bad_input
from ..errors import InputError
from ..types import FloatArray
from . import _style as style
from .paths import _METADATA

PAGES = ((210, 297), (297, 420), (420, 594), (594, 841), (841, 1189))
"""A4 to A0 (ISO 216), mm."""
_MARGIN, _BELOW = 10.0, 14.0  # mm: what printers leave blank; below the board, for the ruler
_RULER, _STEP = 100.0, 10.0  # mm
_INCH = 25.4  # mm
_FINE, _COARSE, _FINE_AREA = 300, 150, 125_000  # dots per inch of PNG pages; A3 is the largest fine one, mm²


def write_sheet_file(black: FloatArray, name: str, path: str | Path) -> tuple[float, float]:
    """Draw black rectangles on the smallest page, A4 to A0, that they fit, upright or across.

    Parameters
    ----------
    black : (n, 4) float64
        Rectangles (x0, y0, x1, y1), y down, m.
    name : str
        What to write beside the ruler: how the board is described to `tspslam calib board`.
    path : str or path
        The file to write: PDF, SVG or PNG, as its suffix says.

    Returns
    -------
    tuple of 2 float
        Width and height of the page, mm.

    Raises
    ------
    InputError
        If the suffix is another, or no page is large enough.
    OutputError
        If it cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _METADATA:
        raise bad_input(path, f"has the suffix {suffix!r}", " or ".join(_METADATA))
    boxes = 1000 * np.asarray(black, np.float64)
    boxes = boxes - np.tile(boxes[:, :2].min(axis=0), 2)
    width, height = page_for(*boxes[:, 2:].max(axis=0))
    figure = Figure(figsize=(width / _INCH, height / _INCH), facecolor="white")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
    axes.axis("off")
    size = boxes[:, 2:].max(axis=0)
    corner = np.array([(width - size[0]) / 2, (height - _BELOW - size[1]) / 2])
    axes.add_patch(PathPatch(_outline(boxes + np.tile(corner, 2)), facecolor="black", linewidth=0))
    _draw_ruler(axes, height, name)
    buffer = io.BytesIO()
    dots = _FINE if width * height <= _FINE_AREA else _COARSE
    with matplotlib.rc_context({"svg.hashsalt": "tspslam", "svg.fonttype": "path"}):
        figure.savefig(buffer, format=suffix[1:], dpi=dots, metadata=_METADATA[suffix])
    write_bytes(path, buffer.getvalue())
    return float(width), float(height)


def page_for(width: float, height: float) -> tuple[float, float]:
    """Find the smallest page for a board, upright or across.

    Parameters
    ----------
    width, height : float
        Of what is printed, mm.

    Returns
    -------
    tuple of 2 float
        Of the page, mm.

    Raises
    ------
    InputError
        If the board is larger than A0.

    Examples
    --------
    >>> page_for(250, 175), page_for(175, 250)
    ((297, 210), (210, 297))
    """
    needed = (width + 2 * _MARGIN, height + 2 * _MARGIN + _BELOW)
    for short, long in PAGES:
        for page in ((short, long), (long, short)):
            if needed[0] <= page[0] and needed[1] <= page[1]:
                return page
    raise InputError(f"board: is {width:.0f} x {height:.0f} mm, expected one that fits A0; is --square in metres?")


def _outline(boxes: FloatArray) -> Outline:
    """All rectangles as one outline: drawn one by one, hairlines would be between those that touch."""
    x0, y0, x1, y1 = boxes.T
    points = np.stack([x0, y0, x1, y0, x1, y1, x0, y1, x0, y0], axis=1).reshape(-1, 2)
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY]
    return Outline(points, codes * len(boxes))


def _draw_ruler(axes: Any, height: float, name: str) -> None:
    y = height - _MARGIN - 4
    axes.plot([_MARGIN, _MARGIN + _RULER], [y, y], color="black", linewidth=0.6)
    for at in np.arange(0, _RULER + 1, _STEP):
        long = 3.0 if at in (0, _RULER) else 1.5
        axes.plot([_MARGIN + at] * 2, [y - long, y + long], color="black", linewidth=0.6)
    style.text(axes, _MARGIN + _RULER + 4, y - 2, name, size=6)
    style.text(axes, _MARGIN + _RULER + 4, y + 2, "The ruler is 100 mm long if the page is printed at 100 %.", size=6)
