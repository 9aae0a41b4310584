"""Is the hop indicator a good stand-in for heat? The indicator and a fitted g(d), each beside MAHF.

On vertices alone, so that only the weights differ, the indicator's phase is 27° off the graph MAHF's in the median,
18° for the strongest fifth, and magnitudes rank alike at 0.45. The fitted g over several rings comes nearer (22°, 16°,
0.56), as it does on a street of KITTI; in a room of EuRoC only its phase over all vertices is farther off (last table).
It is a rough stand-in. The conformal MAHF's weights follow the shapes of the faces: over all vertices the indicator is
farther from it (36°, 0.40), and here g is worse than the indicator (43°, 0.37). With edges and faces the sum is of
other things: phases are 1° to 3° farther from the graph MAHF's, the indicator's ranks over all vertices stay.
"""

from dataclasses import replace

import numpy as np
from scipy.stats import spearmanr

import tspslam

from .common import Result, Source, columns, degrees_between, strongest
from .fig07_heat_and_hops import fit, pairs
from .look import bars, panels

TITLE = "Answer c: is the hop indicator a good stand-in for heat?"
KERNELS = ("graph", "conformal", "robust")


def decaying(b: float):
    """g(d) = exp(-b d), cut off where it falls below 1e-3."""
    return lambda d: np.where(b * np.asarray(d) > np.log(1e3), 0.0, np.exp(-b * np.asarray(d, float)))


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
        series = {
            f"MAHF {kernel}, {who}": [rows[kernel, name][what.format(who)] for name in names]
            for kernel in dict.fromkeys(kernel for kernel, _ in rows)
            for who in ("all", "strongest fifth")
        }
        bars(ax, [name.replace(", ", "\n") for name in names], series)
        ax.set_ylabel(label)
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    table = columns(("MAHF", "T-MAHF", *rows["graph", names[0]]), [(*key, *row.values()) for key, row in rows.items()])
    beside = {("graph", name): name for name in names}
    beside |= {("conformal", name): f"{name}, conformal MAHF" for name in names[:2]}
    told = {f"{n}: {what}": value for key, n in beside.items() for what, value in rows.get(key, {}).items()}
    return Result(figure, table, {"b": b, "R² of the fit": R2} | told)
