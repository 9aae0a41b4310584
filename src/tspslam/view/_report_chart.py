"""One curve over one axis, as SVG that takes the page's width and colours; its numbers stand around it as text."""

from __future__ import annotations

import numpy as np

from ..types import FloatArray
from ._html import text

WIDTH, HEIGHT = 1000, 200  # of the curve's own units: it is stretched to the page
HIGHEST = 0.86  # of the height: above it stands the largest value
MOST_POINTS = 800  # of a curve; of more, each point is the largest of some in a row


def chart(x: FloatArray, y: FloatArray, title: str, unit: str, along: str, *, level: float | None = None) -> str:
    """Draw y ≥ 0 over ascending x.

    Parameters
    ----------
    x, y : (n,) float64
        At least two points, finite.
    title : str
        What y is.
    unit : str
        Of y.
    along : str
        What x is, with its unit.
    level : float, optional
        A value of y that is marked by a dashed line.
    """
    top = max(float(y.max()), 1e-12)
    x0, span = float(x[0]), max(float(x[-1] - x[0]), 1e-12)
    u, v = coarse((x - x0) / span * WIDTH, HEIGHT * (1 - HIGHEST * y / top))
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(u, v, strict=True))
    line = "" if level is None else HEIGHT * (1 - HIGHEST * level / top)
    mark = "" if level is None else f'<path class="level" d="M0 {line:.1f}H{WIDTH}"/>'
    worst = int(np.argmax(y))
    said = f"{title}: largest {top:.3g} {unit} at {x[worst]:.3g} {along}"
    return (
        f'<figure class="chart"><figcaption><b>{text(title)}</b>, {text(unit)}</figcaption>'
        f'<div class="frame"><span class="top">{top:.3g}</span><svg role="img" aria-label="{text(said)}" '
        f'viewBox="0 0 {WIDTH} {HEIGHT}" preserveAspectRatio="none"><title>{text(said)}</title>'
        f'{mark}<polyline class="curve" points="{points}"/></svg></div>'
        f'<p class="ends"><span>{x[0]:.3g}</span><span>{text(along)}</span><span>{x[-1]:.4g}</span></p></figure>'
    )


def coarse(x: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Thin a curve to what a page shows: of several points in a row the highest stays (the least `height`)."""
    each = -(-len(x) // MOST_POINTS)
    starts = np.arange(0, len(x), each)
    if each == 1:
        return x, height
    chosen = [start + int(np.argmin(height[start : start + each])) for start in starts]
    return x[chosen], height[chosen]
