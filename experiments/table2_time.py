"""Time per point of T-MAHF and of MAHF, by task, on the same frames in the same run.

Our MAHF computes K, φ and the sum patch by patch, in one; the paper's way, a dense eigendecomposition, is the last column.
The paper's machine was another one (i7-1065G7), so compare ratios, not milliseconds. Medians of several rounds.
"""

import statistics
import time

import numpy as np

import tspslam
from tspslam.topology.mahf import conformal_laplacian

from .common import WONG, Result, Source, panels

TITLE = "Table 2: time per point"
PAPER = {  # ms a point, mean of the paper's four frames
    "A": 0.0651, "s(f)": 0.2964, "s(e)": 0.3349, "filter": 0.7209, "T-MAHF": 1.4173,
    "L": 0.7168, "K, φ and sum": 1.6727, "MAHF": 2.3894,
}  # fmt: skip


def seconds(work, rounds: int) -> float:
    work()
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def measure(frame, rounds: int) -> dict[str, float]:
    """Ms a point of each task on one frame."""
    faces, uv, image, xyz = frame.surface.faces, frame.cloud.uv, frame.pair.left, frame.cloud.xyz
    complex_, n = frame.complex_, len(frame.cloud)
    bare = tspslam.build_complex(np.empty((0, 3), np.int32), n, edges=complex_.edges)
    dots = tspslam.build_complex(np.empty((0, 3), np.int32), n)
    L = seconds(lambda: conformal_laplacian(frame.surface, xyz), rounds)
    sampling = [seconds(lambda c=c: tspslam.sample_signals(image, uv, c), rounds) for c in (dots, bare, complex_)]
    whole = seconds(lambda: tspslam.mahf(frame.surface, xyz, frame.signals.vertex, laplacian="conformal"), rounds)
    dense = {"method": "exact", "laplacian": "conformal"}
    parts = {
        "A": seconds(lambda: tspslam.build_complex(faces, n).neighbours(), rounds),
        "s(f)": max(sampling[2] - sampling[1], 0), "s(e)": max(sampling[1] - sampling[0], 0), "s(p)": sampling[0],
        "filter": seconds(lambda: tspslam.tmahf(complex_, uv, frame.signals, centering="none"), rounds),
        "L": L, "K, φ and sum": max(whole - L, 0), "MAHF": whole,
        "MAHF, dense": seconds(lambda: tspslam.mahf(frame.surface, xyz, frame.signals.vertex, **dense), 1),
    }  # fmt: skip
    parts["T-MAHF"] = sum(parts[key] for key in ("A", "s(f)", "s(e)", "s(p)", "filter"))
    return {key: 1e3 * value / n for key, value in parts.items()}


def run(source: Source) -> Result:
    frames = source.frames(4)
    rows = [measure(frame, 3 if source.small else 15) for frame in frames]
    keys = ["A", "s(p)", "s(e)", "s(f)", "filter", "T-MAHF", "L", "K, φ and sum", "MAHF", "MAHF, dense"]
    mean = {key: float(np.mean([row[key] for row in rows])) for key in keys}
    figure, axes = panels(height=4.0)
    place = np.arange(len(keys))
    for k, (row, frame) in enumerate(zip(rows, frames, strict=True)):
        axes[0, 0].bar(
            place + 0.16 * k,
            [row[key] for key in keys],
            0.15,
            color=WONG[k],
            label=f"{frame.pair.name}, N = {len(frame.cloud)}",
        )
    axes[0, 0].plot(
        [p + 0.24 for p, key in enumerate(keys) if key in PAPER],
        [PAPER[key] for key in keys if key in PAPER],
        "k_",
        ms=16,
        label="paper, mean",
    )
    axes[0, 0].set(yscale="log", ylabel="ms per point", xticks=place + 0.24, xticklabels=keys)
    axes[0, 0].legend(fontsize=8)
    numbers = {f"{key}, ms a point": mean[key] for key in keys}
    numbers |= {
        "T-MAHF in % of MAHF": 100 * mean["T-MAHF"] / mean["MAHF"],
        "T-MAHF in % of dense MAHF": 100 * mean["T-MAHF"] / mean["MAHF, dense"],
    }
    paper = {f"{key}, ms a point": value for key, value in PAPER.items()} | {
        "T-MAHF in % of MAHF": 59.3,
        "T-MAHF in % of dense MAHF": 59.3,
    }
    table = {
        "frame": [f.pair.name for f in frames],
        "points": [len(f.cloud) for f in frames],
        **{k: [r[k] for r in rows] for k in keys},
    }
    return Result(figure, table, numbers, paper)
