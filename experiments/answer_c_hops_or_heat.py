"""Is the hop indicator a good stand-in for heat? The indicator and a fitted g(d), each beside MAHF."""

from dataclasses import replace

import numpy as np
from scipy.stats import spearmanr

import tspslam

from .common import WONG, Result, Source, degrees_between, panels, strongest
from .fig07_heat_and_hops import fit, pairs

TITLE = "Answer c: is the hop indicator a good stand-in for heat?"
KERNELS = ("graph", "conformal", "robust")


def decaying(b: float):
    """g(d) = exp(-b d), cut off where it falls below 1e-3."""

    def g(d: np.ndarray) -> np.ndarray:
        value = np.exp(-b * np.asarray(d, float))
        return np.where(value < 1e-3, 0.0, value)

    return g


def variants(frame, b: float) -> dict[str, tspslam.Response]:
    """The published sum with two weights, on vertices alone and on all levels."""
    every, found = frame.signals, {}
    alone = replace(every, edge_ok=np.zeros_like(every.edge_ok), face_ok=np.zeros_like(every.face_ok))
    for levels, signals in (("vertices", alone), ("all levels", every)):
        for name, weight in (("indicator", None), ("g(d)", decaying(b))):
            response = tspslam.tmahf(frame.complex_, frame.cloud.uv, signals, centering="none", weight=weight)
            found[f"{name}, {levels}"] = response
    return found


def agreement(heat: tspslam.Response, other: tspslam.Response) -> dict[str, float]:
    both = heat.defined & other.defined & (heat.magnitude > 0)
    row = {}
    for who, which in (("all", both), ("strongest fifth", strongest(heat.magnitude, both))):
        row[f"rank correlation, {who}"] = spearmanr(heat.magnitude[which], other.magnitude[which]).statistic
        row[f"phase, {who}, degrees"] = np.median(degrees_between(heat.z, other.z)[which])
    return row


def run(source: Source) -> Result:
    frame = source.frames(1)[0]
    (_, b), _, R2 = fit(*pairs(frame.complex_))
    rows = {}
    for kernel in KERNELS:
        try:
            heat = tspslam.mahf(frame.surface, frame.cloud.xyz, frame.signals.vertex, laplacian=kernel)
        except tspslam.GeometryError:
            continue
        rows |= {(kernel, name): agreement(heat, response) for name, response in variants(frame, b).items()}
    figure, axes = panels(1, 2, 4.2)
    names = [name for kernel, name in rows if kernel == "graph"]
    for ax, what, label in (
        (axes[0, 0], "rank correlation, {}", "rank correlation with |MAHF|"),
        (axes[0, 1], "phase, {}, degrees", "median phase difference, degrees"),
    ):
        for k, (kernel, who) in enumerate(
            (kernel, who) for kernel in dict.fromkeys(k for k, _ in rows) for who in ("all", "strongest fifth")
        ):
            values = [rows[kernel, name][what.format(who)] for name in names]
            ax.bar(np.arange(len(names)) + 0.14 * k, values, 0.13, color=WONG[k], label=f"MAHF {kernel}, {who}")
        ax.set(ylabel=label, xticks=np.arange(len(names)) + 0.3)
        ax.set_xticklabels([name.replace(", ", "\n") for name in names])
    axes[0, 1].legend(fontsize=8)
    keys = list(next(iter(rows.values())))
    table = {
        "MAHF": [k for k, _ in rows],
        "T-MAHF": [name for _, name in rows],
        **{key: [row[key] for row in rows.values()] for key in keys},
    }
    numbers = {"b": b, "R² of the fit": R2} | {
        f"{kernel} / {name}: {key}": value for (kernel, name), row in rows.items() for key, value in row.items()
    }
    return Result(figure, table, numbers)
