"""The published filter on two frames: log magnitude and phase; insets where the phase follows a visible edge.

As in the paper, `centering="none"`. The phase is plotted as it is, on a cyclic map (the paper's caption says logarithmic).
An inset shows the place of the frame with the strongest response among those where a dozen neighbours have one; its arrows
point along the phase: towards the brighter side, for a strong response.
"""

import numpy as np
from scipy.spatial import cKDTree

import tspslam

from .common import (
    PHASE,
    Result,
    Source,
    degrees_between,
    luminance,
    over_image,
    panels,
    reference_gradient,
    show_response,
    strongest,
)

TITLE = "Figures 9 and 10: magnitude and phase on two frames"


def run(source: Source) -> Result:
    frames = source.frames(2)
    figure, axes = panels(2, 3, 7.2)
    numbers, table = {}, {key: [] for key in ("frame", "u_px", "v_px", "magnitude", "phase_rad")}
    for row, frame in zip(axes, frames, strict=True):
        uv, name = frame.cloud.uv, frame.pair.name
        response = tspslam.tmahf(frame.complex_, uv, frame.signals, centering="none")
        for ax, title in zip(row, (f"{name}: magnitude", "phase", "inset"), strict=True):
            over_image(ax, frame.pair.left, title)
        show_response(figure, row, uv, response)
        inset(row[2], uv, response, 0.09 * frame.rig.width)
        top = strongest(response.magnitude, response.defined)
        gradient, _ = reference_gradient(luminance(frame.pair.left), uv, frame.complex_)
        error = degrees_between(response.z, gradient)
        numbers[f"{name}: points with a response"] = int(response.defined.sum())
        numbers[f"{name}: phase off the image's gradient, degrees, all"] = np.median(error[response.defined])
        numbers[f"{name}: the same, strongest fifth"] = np.median(error[top])
        shown = response.defined
        columns = ([name] * shown.sum(), *uv[shown].T, response.magnitude[shown], response.phase[shown])
        for key, column in zip(table, columns, strict=True):
            table[key].extend(column)
    return Result(figure, table, numbers)


def inset(ax, uv: np.ndarray, response: tspslam.Response, half: float) -> None:
    """Zoom to the place whose dozen nearest points respond most, with arrows along the phase."""
    at, strength = uv[response.defined], response.magnitude[response.defined]
    near = cKDTree(at).query(at, k=min(12, len(at)))[1]
    u, v = at[strength[near].mean(axis=1).argmax()]
    phase = response.phase[response.defined]
    ax.quiver(
        *at.T, np.cos(phase), np.sin(phase), phase, cmap=PHASE, clim=(-np.pi, np.pi), angles="xy", scale=14, width=0.012,
        edgecolors="k", lw=0.4,
    )  # fmt: skip
    ax.set(xlim=(u - half, u + half), ylim=(v + 0.75 * half, v - 0.75 * half))
