"""What do edges and faces add? The filter on vertices, with edges, with faces, under noise from 0 to 40 dB."""

from dataclasses import replace

import numpy as np

import tspslam

from .common import (
    SEEDS,
    WONG,
    Result,
    Source,
    degrees_between,
    luminance,
    median_and_range,
    panels,
    reference_gradient,
    strongest,
)

TITLE = "Answer d: what do edges and faces add?"
DECIBELS = (0, 10, 20, 30, 40, np.inf)
LEVELS = {"vertices": (False, False), "+ edges": (True, False), "+ faces": (True, True)}


def respond(image: np.ndarray, uv: np.ndarray, complex_: tspslam.Complex) -> dict[str, tspslam.Response]:
    """The harmonic fit on each choice of levels."""
    signals, found = tspslam.sample_signals(image, uv, complex_), {}
    for name, (edges, faces) in LEVELS.items():
        kept = replace(signals, edge_ok=signals.edge_ok & edges, face_ok=signals.face_ok & faces)
        found[name] = tspslam.tmahf(complex_, uv, kept, centering="harmonic")
    return found


def noisy(image: np.ndarray, decibels: float, rng: np.random.Generator) -> np.ndarray:
    return image + rng.normal(0, image.std() * 10 ** (-decibels / 20), image.shape)


def measure(frame, decibels: float, seed: int) -> dict[str, tuple[float, float, float]]:
    """Of each choice: phase error, repeatability, and that of the strongest fifth; degrees."""
    uv, rng = frame.cloud.uv, np.random.default_rng((seed, 5))
    there = uv - np.column_stack([frame.cloud.disparity, np.zeros(len(uv))])
    images = [luminance(image) for image in (frame.pair.left, frame.pair.right)]
    gradient, _ = reference_gradient(images[0], uv, frame.complex_)
    left, right = (
        respond(noisy(image, decibels, rng), at, frame.complex_) for image, at in zip(images, (uv, there), strict=True)
    )
    ok = np.logical_and.reduce([response.defined for side in (left, right) for response in side.values()])
    found = {}
    for name in LEVELS:
        change, top = degrees_between(left[name].z, right[name].z), strongest(left[name].magnitude, ok)
        error = degrees_between(left[name].z, gradient)
        found[name] = (np.median(error[ok]), np.median(change[ok]), np.median(change[top]))
    return found


def run(source: Source) -> Result:
    frame, seeds = source.frames(1)[0], SEEDS[:2] if source.small else SEEDS
    measures = ("phase error", "left to right, all", "left to right, strongest fifth")
    table = {key: [] for key in ("snr_db", "levels", "measure", "median_deg", "low_deg", "high_deg")}
    for decibels in DECIBELS:
        found = [measure(frame, decibels, seed) for seed in seeds]
        for name in LEVELS:
            for k, what in enumerate(measures):
                row = (decibels, name, what, *median_and_range([one[name][k] for one in found]))
                for key, value in zip(table, row, strict=True):
                    table[key].append(value)
    columns = {key: np.array(column) for key, column in table.items()}
    figure, axes = panels(1, 3, 3.8)
    for ax, what in zip(axes[0], measures, strict=True):
        for colour, name, marker in zip(WONG, LEVELS, "osv", strict=False):
            of = (columns["levels"] == name) & (columns["measure"] == what)
            ax.plot(range(6), columns["median_deg"][of], marker=marker, color=colour, label=name)
            ax.fill_between(range(6), columns["low_deg"][of], columns["high_deg"][of], color=colour, alpha=0.2)
        ax.set(
            title=what, xlabel="signal-to-noise ratio, dB", ylabel="median, degrees", xticks=range(6), ylim=(0, None)
        )
        ax.set_xticklabels([*map(str, DECIBELS[:-1]), "none"])
    axes[0, 0].legend()
    rows = zip(table["snr_db"], table["levels"], table["measure"], table["median_deg"], strict=True)
    numbers = {
        f"{snr} dB, {name}: {what}, degrees": value for snr, name, what, value in rows if snr in (10, 30, np.inf)
    }
    return Result(figure, table, numbers)
