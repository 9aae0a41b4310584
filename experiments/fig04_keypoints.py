"""Keypoints that both cameras see, coloured by depth as in the paper.

The four classes are the paper's: nearer than 8 m, to 30 m, to 60 m, beyond. Its blue, green, yellow and red are
replaced by colours that differ for every reader. Motorcycle is a garage, all of it nearer than 8 m; the street has
every class. Keypoints are spread evenly, as in the paper: a cell of the image without one has no texture.
"""

import numpy as np

from .common import Result, Source
from .look import WONG, over_image, panels

TITLE = "Figure 4: keypoints by depth"
LIMITS, NAMES = (0, 8, 30, 60, np.inf), ("z < 8 m", "8 to 30 m", "30 to 60 m", "60 m and beyond")


def run(source: Source) -> Result:
    figure, axes = panels(1, 2, 4.4)
    table, numbers = {key: [] for key in ("frame", "u_px", "v_px", "z_m")}, {}
    for ax, frame in zip(axes[0], source.frames(2), strict=True):
        uv, z, name = frame.cloud.uv, frame.cloud.xyz[:, 2], frame.name
        kind = np.digitize(z, LIMITS) - 1
        over_image(ax, frame.image, f"{name}: {len(z)} keypoints")
        for k, (what, colour) in enumerate(zip(NAMES, (WONG[0], WONG[2], WONG[1], WONG[5]), strict=True)):
            ax.scatter(*uv[kind == k].T, s=9, color=colour, label=f"{what}: {(kind == k).sum()}")
        ax.legend(loc="lower right", fontsize=8, markerscale=1.5)
        cells = np.histogram2d(*uv.T, bins=(8, 6), range=((0, frame.rig.width), (0, frame.rig.height)))[0]
        numbers |= {f"{name}: keypoints": len(z), f"{name}: nearest, m": z.min(), f"{name}: farthest, m": z.max()}
        numbers[f"{name}: of 8 x 6 cells, with a keypoint"] = int((cells > 0).sum())
        for key, column in zip(table, ([name] * len(z), *uv.T, z), strict=True):
            table[key].extend(column)
    return Result(figure, table, numbers)
