"""Signals of edges (squares) and faces (circles) at the barycentres of their pixels, over the image, as in Figure 6.

The marks have the luminance of their element, the image is shown paler; the middle of the frame, so that they can be
told apart. As the paper says, they have the brightness of the places they fall on: the numbers give the correlation
with the image at the barycentre.
"""

import numpy as np
from scipy.ndimage import map_coordinates

from .common import Result, Source
from .look import luminance, over_image, panels

TITLE = "Figure 6: signals of edges and faces"


def run(source: Source) -> Result:
    frame = source.frames(1)[0]
    signals, image = frame.signals, luminance(frame.image)
    figure, axes = panels(1, 2, 4.2)
    numbers, table = {}, {"level": [], "u_px": [], "v_px": [], "signal": [], "pixels": []}
    for ax, level, marker in zip(axes[0], ("edge", "face"), ("s", "o"), strict=True):
        ok = getattr(signals, f"{level}_ok")
        at, values = getattr(signals, f"{level}_uv")[ok], getattr(signals, level)[ok]
        over_image(ax, frame.image, f"{len(values)} {level}s")
        dots = ax.scatter(
            *at.T, c=values, marker=marker, s=26, cmap="gray", vmin=0, vmax=1, edgecolors="#e69f00", lw=0.4
        )
        width, height = frame.rig.width, frame.rig.height
        ax.set(xlim=(0.3 * width, 0.7 * width), ylim=(0.7 * height, 0.3 * height))
        under = map_coordinates(image, at.T[::-1], order=1)
        numbers[f"{level}s"] = len(values)
        numbers[f"{level}s: correlation with the image at the barycentre"] = np.corrcoef(under, values)[0, 1]
        pixels = getattr(signals, f"{level}_pixels")[ok]
        numbers[f"{level}s: pixels, median"] = np.median(pixels)
        for key, column in zip(table, ([level] * len(values), *at.T, values, pixels), strict=True):
            table[key].extend(column)
    figure.colorbar(dots, ax=axes, shrink=0.8, label="luminance")
    return Result(figure, table, numbers)
