"""Keypoints that both cameras see, coloured by depth as in the paper.

The four classes are the paper's: nearer than 8 m, to 30 m, to 60 m, beyond. The paper's blue, green, yellow and red are
replaced by colours that differ for every reader.
"""

import numpy as np

from .common import WONG, Result, Source, over_image, panels

TITLE = "Figure 4: keypoints by depth"
LIMITS, NAMES = (0, 8, 30, 60, np.inf), ("z < 8 m", "8 to 30 m", "30 to 60 m", "60 m and beyond")


def run(source: Source) -> Result:
    frame = source.frames(1)[0]
    uv, z = frame.cloud.uv, frame.cloud.xyz[:, 2]
    kind = np.digitize(z, LIMITS) - 1
    figure, axes = panels(height=6.4)
    over_image(axes[0, 0], frame.pair.left, f"{len(z)} keypoints of {frame.pair.name}")
    for k, (name, colour) in enumerate(zip(NAMES, (WONG[0], WONG[2], WONG[1], WONG[5]), strict=True)):
        axes[0, 0].scatter(*uv[kind == k].T, s=14, color=colour, label=f"{name} ({(kind == k).sum()})")
    axes[0, 0].legend(loc="lower right")
    cells = np.histogram2d(*uv.T, bins=(8, 6), range=((0, frame.rig.width), (0, frame.rig.height)))[0]
    numbers = {
        "keypoints": len(z),
        "nearest, m": z.min(),
        "farthest, m": z.max(),
        "cells of 8 x 6 with a point": int((cells > 0).sum()),
    }
    return Result(figure, {"u_px": uv[:, 0], "v_px": uv[:, 1], "z_m": z}, numbers)
