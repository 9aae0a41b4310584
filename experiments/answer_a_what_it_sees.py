"""What does the filter see? Four centrings on a constant image, on ramps, and on a real image beside its gradient.

The published sum answers to a constant image as strongly as to the real one: its magnitude is mostly that of an uneven
neighbourhood. On a ramp its phase is as good as drawn by lot (the median of a random phase is 90°), also for the
strongest fifth. Beside the image's own gradient its phase is off by some 54°, and magnitudes hardly rank alike. With
any centring the constant gives 0, the phase error over all vertices is 26° to 33° (41° to 54° on a street of KITTI, the
published sum's 70°), and magnitudes rank alike at 0.62 to 0.63, in the strongest fifth at 0.10 to 0.29. `plane` is
exact on ramps and no better on images. Over all vertices `harmonic`, our default, has the smallest phase error; in the
strongest fifth `mean` has it here, on KITTI and EuRoC `harmonic`. The errors depend on the reference too (answer d).
"""

import numpy as np
from scipy.stats import spearmanr

import tspslam

from .common import Result, Source, degrees_between, reference_gradient, strongest
from .look import WONG, luminance, panels

TITLE = "Answer a: what does the filter see?"
CENTRINGS = ("none", "mean", "harmonic", "plane")


def respond(frame, image: np.ndarray, centering: str) -> tspslam.Response:
    signals = tspslam.sample_signals(image, frame.cloud.uv, frame.complex_)
    return tspslam.tmahf(frame.complex_, frame.cloud.uv, signals, centering=centering)


def ramp(width: int, height: int, angle: float) -> np.ndarray:
    v, u = np.mgrid[:height, :width]
    return 0.5 + 0.3 * (np.cos(angle) * (u - u.mean()) + np.sin(angle) * (v - v.mean())) / width


def ramp_errors(frame, centering: str, directions: int) -> tuple[np.ndarray, np.ndarray]:
    """Phase errors, degrees, over all directions: of all vertices, and of the strongest fifth."""
    every, top = [], []
    for angle in 2 * np.pi * np.arange(directions) / directions:
        response = respond(frame, ramp(frame.rig.width, frame.rig.height, angle), centering)
        error = degrees_between(response.z, np.exp(1j * angle))
        every.append(error[response.defined])
        top.append(error[strongest(response.magnitude, response.defined)])
    return np.concatenate(every), np.concatenate(top)


def measure(frame, centering: str, directions: int) -> dict[str, float]:
    image = luminance(frame.image)
    real, flat = respond(frame, image, centering), respond(frame, np.full_like(image, 0.5), centering)
    gradient, sigma = reference_gradient(image, frame.cloud.uv, frame.complex_)
    slope = np.abs(gradient) * (1 if centering == "plane" else sigma)
    error, ok = degrees_between(real.z, gradient), real.defined
    row = {"constant / real": np.median(flat.magnitude[ok]) / np.median(real.magnitude[ok])}
    ramps = ramp_errors(frame, centering, directions)
    for who, on_ramps, which in (("all", ramps[0], ok), ("strongest fifth", ramps[1], strongest(real.magnitude, ok))):
        row[f"ramps, {who}: median, degrees"] = np.median(on_ramps)
        row[f"ramps, {who}: 95 %, degrees"] = np.percentile(on_ramps, 95)
        row[f"image, {who}: median, degrees"] = np.median(error[which])
        row[f"image, {who}: rank correlation"] = spearmanr(real.magnitude[which], slope[which]).statistic
    return row


def run(source: Source) -> Result:
    frame = source.frames(1)[0]
    rows = {c: measure(frame, c, 8 if source.small else 36) for c in CENTRINGS}
    figure, axes = panels(1, 4, 3.6)
    shown = {
        "constant / real": "|r| of a constant / of the image",
        "ramps, {}: median, degrees": "phase error on ramps, degrees",
        "image, {}: median, degrees": "phase off the gradient, degrees",
        "image, {}: rank correlation": "rank correlation of |r|",
    }
    for ax, (key, label) in zip(axes[0], shown.items(), strict=True):
        for k, who in enumerate(("all", "strongest fifth") if "{}" in key else ("all",)):
            place = np.arange(4) + 0.4 * k
            ax.bar(place, [rows[c][key.format(who)] for c in CENTRINGS], 0.38, color=WONG[k], label=who)
        ax.set(ylabel=label, xticks=np.arange(4) + 0.2)
        ax.set_xticklabels(CENTRINGS, rotation=30)
    axes[0, 1].legend()
    table = {"centering": list(rows), **{key: [row[key] for row in rows.values()] for key in rows["none"]}}
    return Result(figure, table, {f"{c}: {key}": value for c, row in rows.items() for key, value in row.items()})
