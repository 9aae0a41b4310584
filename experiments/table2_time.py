"""Time per point of T-MAHF and of MAHF, by task, on the same frames in the same run.

Our MAHF computes K, φ and the sum patch by patch, in one; a dense eigendecomposition, the paper's way, is the last
column. The paper's machine was another one (i7-1065G7, 4 cores), so compare ratios, not milliseconds. The paper finds
that T-MAHF takes 59 % of MAHF's time; here it takes 0.3 to 5 %, by frame (the last rows; above them the ratio of
the means). On Motorcycle the time of s(p) is that of turning colours into luminance.
"""

import statistics
import time

import numpy as np

import tspslam
from tspslam.topology.mahf import conformal_laplacian

from .common import Result, Source, columns
from .look import bars, panels

TITLE = "Table 2: time per point"
KEYS = ("A", "s(p)", "s(e)", "s(f)", "filter", "T-MAHF", "L", "K, φ and sum", "MAHF", "MAHF, dense")
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
    """Milliseconds a point of each task on one frame."""
    faces, uv, image, xyz = frame.surface.faces, frame.cloud.uv, frame.image, frame.cloud.xyz
    complex_, n = frame.complex_, len(frame.cloud)
    bare = tspslam.build_complex(np.empty((0, 3), np.int32), n, edges=complex_.edges)
    dots = tspslam.build_complex(np.empty((0, 3), np.int32), n)
    sampling = [seconds(lambda c=c: tspslam.sample_signals(image, uv, c), rounds) for c in (dots, bare, complex_)]
    whole = seconds(lambda: tspslam.mahf(frame.surface, xyz, frame.signals.vertex, laplacian="conformal"), rounds)
    dense = {"method": "exact", "laplacian": "conformal"}
    parts = {
        "A": seconds(lambda: tspslam.build_complex(faces, n).neighbours(), rounds),
        "s(f)": sampling[2] - sampling[1], "s(e)": sampling[1] - sampling[0], "s(p)": sampling[0],
        "filter": seconds(lambda: tspslam.tmahf(complex_, uv, frame.signals, centering="none"), rounds),
        "L": seconds(lambda: conformal_laplacian(frame.surface, xyz), rounds), "MAHF": whole,
        "MAHF, dense": seconds(lambda: tspslam.mahf(frame.surface, xyz, frame.signals.vertex, **dense), 1),
    }  # fmt: skip
    parts["K, φ and sum"] = whole - parts["L"]
    parts["T-MAHF"] = sum(parts[key] for key in ("A", "s(f)", "s(e)", "s(p)", "filter"))
    return {key: 1e3 * parts[key] / n for key in KEYS}


def run(source: Source) -> Result:
    frames = source.frames(4)
    rows = [measure(frame, 3 if source.small else 15) for frame in frames]
    mean = {key: float(np.mean([row[key] for row in rows])) for key in KEYS}
    figure, axes = panels(height=4.0)
    names = [f"{frame.name}, N = {len(frame.cloud)}" for frame in frames]
    bars(axes[0, 0], KEYS, {name: row.values() for name, row in zip(names, rows, strict=True)})
    known = [(place + 0.3, PAPER[key]) for place, key in enumerate(KEYS) if key in PAPER]
    axes[0, 0].plot(*zip(*known, strict=True), "k_", ms=18, mew=2, label="paper, mean")
    axes[0, 0].set(yscale="log", ylabel="ms per point")
    axes[0, 0].legend(fontsize=8)
    numbers = {f"{key}, ms a point": mean[key] for key in KEYS}
    numbers |= {f"T-MAHF in % of {key}": 100 * mean["T-MAHF"] / mean[key] for key in ("MAHF, dense", "MAHF")}
    shares = [100 * row["T-MAHF"] / row["MAHF"] for row in rows]
    numbers |= {"the same, the frame with least, %": min(shares), "the same, the frame with most, %": max(shares)}
    paper = {f"{key}, ms a point": value for key, value in PAPER.items()} | {"T-MAHF in % of MAHF": 59.3}
    table = columns(("frame", *KEYS), [(name, *row.values()) for name, row in zip(names, rows, strict=True)])
    return Result(figure, table, numbers, paper)
