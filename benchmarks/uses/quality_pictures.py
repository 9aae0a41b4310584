"""Pictures of the quality page: curves of the scores, and what the Motorcycle looks like at one level of each kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from . import quality_data as data
from .quality_rivals import render

CURVES = {
    "ours": "ours: score",
    "rendered views, SSIM": "rendered views: 1 - SSIM",
    "luminance, PSNR": "vertex luminance: -PSNR, dB",
    "point to plane": "point to plane: RMS distance, m",
}
SHOWN = 4  # level, from 0


def draw(folder: Path, several: dict[str, dict[str, NDArray[np.float64]]]) -> None:
    from matplotlib import pyplot as plt

    plt.switch_backend("agg")
    scores = several["motorcycle"]
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.3), layout="constrained")
    for ax, (method, title) in zip(axes, CURVES.items(), strict=True):
        for kind, row, mark in zip(data.LEVELS, scores[method], "osDv^<>*", strict=True):
            seen = row > (-119 if method == "luminance, PSNR" else 0)
            ax.plot(np.arange(1, data.STEPS + 1)[seen], row[seen], marker=mark, ms=4, lw=1, label=kind)
        unseen = [kind for kind, row in zip(data.LEVELS, scores[method], strict=True) if np.ptp(row) == 0]
        ax.set(title=title, xlabel="level")
        if unseen:
            ax.text(0.03, 0.97, "not seen: " + ", ".join(unseen[:3]) + (" ..." if len(unseen) > 3 else ""),
                    transform=ax.transAxes, va="top", fontsize=7)  # fmt: skip
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=8, frameon=False)
    figure.savefig(folder / "uses_quality.png", dpi=110)
    plt.close(figure)
    _views(folder, scores["ours"])


def _views(folder: Path, ours: NDArray[np.float64]) -> None:
    from matplotlib import pyplot as plt

    item = data.motorcycle(4000, 0)
    middle = np.median(item.xyz, axis=0)
    figure, axes = plt.subplots(3, 3, figsize=(11, 8), layout="constrained")
    shown = [("original", item, 0.0)] + [
        (kind, data.distorted(item, kind, SHOWN), ours[row, SHOWN]) for row, kind in enumerate(data.LEVELS)
    ]
    for ax, (name, other, score) in zip(axes.flat, shown, strict=True):
        ax.imshow(render(other, np.radians(8), middle), cmap="gray", vmin=0, vmax=1)
        ax.set(title=f"{name}: {score:.2f}", xticks=[], yticks=[])
    figure.savefig(folder / "uses_quality_views.png", dpi=80)
    plt.close(figure)
