"""How does it scale? Time and memory of the topology stage from 1 000 to 1 000 000 torus points.

Memory is linear. Time is not quite: at the two ends the slope is near one, between them, at some hundred thousand
points, it is steeper; we take the caches of the machine for the cause, and have not measured that. A million points
take a second or two.
"""

import statistics
import time
import tracemalloc

import numpy as np

import tspslam
from tspslam.datasets import synthetic
from tspslam.vision.rig import project

from .common import Result, Source
from .look import WONG, panels

TITLE = "Answer e: how does it scale?"
SIZES = ((20, 50), (40, 80), (80, 125), (125, 256), (200, 500), (400, 800), (800, 1250))
STAGES = ("complex", "neighbourhoods", "signals", "filter")


def once(faces: np.ndarray, uv: np.ndarray, image: np.ndarray) -> list[float]:
    """Seconds of each stage."""
    marks = [time.perf_counter()]
    complex_ = tspslam.build_complex(faces, len(uv))
    marks.append(time.perf_counter())
    complex_.neighbours()
    marks.append(time.perf_counter())
    signals = tspslam.sample_signals(image, uv, complex_)
    marks.append(time.perf_counter())
    tspslam.tmahf(complex_, uv, signals)
    marks.append(time.perf_counter())
    return np.diff(marks).tolist()


def measure(shape: tuple[int, int], image: np.ndarray) -> dict[str, float]:
    ring = synthetic.torus(1.0, 0.4, rows=shape[0], columns=shape[1]).at(0, 0, 4, turn=(np.pi / 4, 0, 0))
    faces, uv = ring.faces.astype(np.int32), project(synthetic.PAPER_RIG, ring.world_vertices())
    runs = [once(faces, uv, image) for _ in range(1 if len(uv) > 300_000 else 3)]
    tracemalloc.start()
    once(faces, uv, image)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    row = {stage: statistics.median(run[k] for run in runs) for k, stage in enumerate(STAGES)}
    return {"N": len(uv), **row, "seconds": sum(row.values()), "megabytes": peak / 1e6}


def exponent(n: np.ndarray, values: np.ndarray) -> float:
    """Slope in log-log, from 10 000 points on (from the third size of a small run)."""
    far = n >= min(10_000, np.sort(n)[-2])
    return float(np.polyfit(np.log(n[far]), np.log(values[far]), 1)[0])


def run(source: Source) -> Result:
    fine = synthetic.torus(1.0, 0.4).at(0, 0, 4, turn=(np.pi / 4, 0, 0))
    image = synthetic.SyntheticSequence(synthetic.Scene((fine,), background=0.0))[0].left
    measure(SIZES[0], image)  # compiles the kernels
    rows = [measure(shape, image) for shape in (SIZES[:3] if source.small else SIZES)]
    columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    n = columns["N"]
    figure, axes = panels(1, 2, 4.2)
    for colour, stage, marker in zip(WONG, STAGES, "osv^", strict=False):
        axes[0, 0].loglog(n, columns[stage], marker=marker, ms=4, color=colour, label=stage)
    slopes = {key: exponent(n, columns[key]) for key in (*STAGES, "seconds", "megabytes")}
    axes[0, 0].loglog(n, columns["seconds"], "k-", lw=2, label=f"all, N^{slopes['seconds']:.2f}")
    axes[0, 1].loglog(n, columns["megabytes"], "k-o", lw=2, label=f"N^{slopes['megabytes']:.2f}")
    axes[0, 0].set(xlabel="points N", ylabel="time, s")
    axes[0, 1].set(xlabel="points N", ylabel="largest memory of the stage, MB")
    for ax in axes[0]:
        ax.legend()
        ax.grid(alpha=0.3)
    numbers = {f"exponent of {key}": value for key, value in slopes.items()}
    numbers |= {f"N = {n[k]}: time, s": columns["seconds"][k] for k in (2, -1)}
    numbers |= {f"N = {n[k]}: memory, MB": columns["megabytes"][k] for k in (2, -1)}
    return Result(figure, columns, numbers)
