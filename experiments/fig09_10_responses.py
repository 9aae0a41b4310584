"""The filter on two frames: log magnitude and phase as published, and an inset at a strong edge.

Magnitude and phase are of the published sum, `centering="none"`; the phase is plotted as it is, on a cyclic map (the
paper's caption says logarithmic). The inset is where responses are strongest, and the stronger ones have arrows:
coloured ones are the phase with `centering="harmonic"`, grey ones the published phase. The former point across the
visible edges to the brighter side; the latter often point to where neighbours are many, edge or no edge: answer a
measures both.
"""

import numpy as np
from scipy.spatial import cKDTree

import tspslam

from .common import Result, Source, degrees_between, reference_gradient, strongest
from .look import PHASE, luminance, over_image, panels, show_response

TITLE = "Figures 9 and 10: magnitude and phase on two frames"


def run(source: Source) -> Result:
    frames = source.frames(2)
    figure, axes = panels(3, 2, 11)
    numbers, table = {}, {key: [] for key in ("frame", "u_px", "v_px", "magnitude", "phase_rad")}
    for column, frame in zip(axes.T, frames, strict=True):
        uv, name = frame.cloud.uv, frame.name
        response, centred = (
            tspslam.tmahf(frame.complex_, uv, frame.signals, centering=c) for c in ("none", "harmonic")
        )
        for ax, title in zip(column, (f"{name}: magnitude", "phase", "inset"), strict=True):
            over_image(ax, frame.image, title)
        show_response(figure, column, uv, response)
        inset(column[2], uv, response, centred, 0.09 * frame.rig.width)
        gradient, _ = reference_gradient(luminance(frame.image), uv, frame.complex_)
        for what, one in (("published", response), ("harmonic", centred)):
            error, top = degrees_between(one.z, gradient), strongest(one.magnitude, one.defined)
            numbers[f"{name}, {what}: phase off the image's gradient, degrees, all"] = np.median(error[one.defined])
            numbers[f"{name}, {what}: the same, strongest fifth"] = np.median(error[top])
        shown = response.defined
        rows = ([name] * shown.sum(), *uv[shown].T, response.magnitude[shown], response.phase[shown])
        for key, values in zip(table, rows, strict=True):
            table[key].extend(values)
    return Result(figure, table, numbers)


def inset(ax, uv: np.ndarray, response: tspslam.Response, centred: tspslam.Response, half: float) -> None:
    """Zoom to the place whose nearest points respond most, with arrows along both phases."""
    ok = response.defined & strongest(centred.magnitude, centred.defined, 0.4)
    near = cKDTree(uv[ok]).query(uv[ok], k=min(8, ok.sum()))[1]
    u, v = uv[ok][centred.magnitude[ok][near].mean(axis=1).argmax()]
    look = {"angles": "xy", "scale": 14, "width": 0.009, "edgecolors": "k", "lw": 0.4}
    for one, colours in ((response, {"color": "0.75"}), (centred, {"cmap": PHASE, "clim": (-np.pi, np.pi)})):
        phase = one.phase[ok]
        ax.quiver(*uv[ok].T, np.cos(phase), np.sin(phase), *([phase] if one is centred else []), **colours, **look)
    ax.set(xlim=(u - half, u + half), ylim=(v + 0.75 * half, v - 0.75 * half))
