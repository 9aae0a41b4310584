"""The look of the pictures: panels, marks over an image, bars and curves that every reader can tell apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import ListedColormap

import tspslam
from tspslam.topology.texture import luminance

MAGNITUDE, PHASE = "viridis", ListedColormap(tspslam.view.phase_colours(256))
WONG = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00")
MARKERS = "osv^D"


def panels(rows: int = 1, columns: int = 1, height: float = 4.0) -> tuple[plt.Figure, np.ndarray]:
    """A figure 11 inches wide with a grid of axes."""
    return plt.subplots(rows, columns, figsize=(11, height), layout="constrained", squeeze=False)


def over_image(ax: plt.Axes, image: np.ndarray, title: str) -> None:
    """Show an image in pale grey, for marks to be drawn on, in px."""
    ax.imshow(luminance(image), cmap="gray", vmin=-0.6, vmax=1.4)
    ax.set(title=title, xlabel="u, px", ylabel="v, px")


def show_response(figure: plt.Figure, axes: Sequence[plt.Axes], uv: np.ndarray, response, size: float = 9) -> None:
    """Dots over two images: log10 magnitude and phase, where the response is defined."""
    shown = response.defined & (response.magnitude > 0)
    strength = np.log10(response.magnitude[shown])
    low, high = np.percentile(strength, [2, 98])
    for ax, values, look in (
        (axes[0], strength, {"cmap": MAGNITUDE, "vmin": low, "vmax": high}),
        (axes[1], response.phase[shown], {"cmap": PHASE, "vmin": -np.pi, "vmax": np.pi}),
    ):
        dots = ax.scatter(*uv[shown].T, c=values, s=size, **look)
        label = "log₁₀ |r|, luminance" if ax is axes[0] else "arg r, rad, clockwise from u"
        figure.colorbar(dots, ax=ax, shrink=0.85, label=label)


def bars(ax: plt.Axes, names: Sequence[str], series: Mapping[str, Sequence[float]]) -> None:
    """Bars side by side at each name, one colour for each of the series."""
    width = 0.8 / len(series)
    for k, (label, values) in enumerate(series.items()):
        ax.bar(np.arange(len(names)) + k * width, values, 0.94 * width, color=WONG[k], label=label)
    ax.set_xticks(np.arange(len(names)) + 0.4 - width / 2, names)


def curves(ax: plt.Axes, x: Sequence[float], series: Mapping[str, np.ndarray]) -> None:
    """Curves with their range: each of the series is rows of median, least and largest."""
    for k, (label, values) in enumerate(series.items()):
        middle, low, high = np.transpose(values)
        ax.plot(x, middle, marker=MARKERS[k], ms=5, color=WONG[k], label=label)
        ax.fill_between(x, low, high, color=WONG[k], alpha=0.2)
