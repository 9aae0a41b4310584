"""Ratios of times that must not grow: ``python -m benchmarks.limits`` prints each by its limit, and fails above one.

Times hang on what else a machine does, so the best of three attempts counts, and no test of the gate measures any: what
must stay fast is guarded there by counting work (`tests/test_work.py`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tests.vision.slam.test_cholesky import equations
from tests.vision.slam.test_pose import RIG, SIGMA, as_observations, observations
from tspslam.vision.slam.least_squares._kernels import solve_positive
from tspslam.vision.slam.least_squares.bundle import adjust
from tspslam.vision.slam.pose import fit_pose

from . import slam, spectral, topology
from .measure import median_seconds, process_seconds


class Limit(NamedTuple):
    """A ratio, the most that it may be, and what was measured when the limit was set."""

    name: str
    most: float
    ratio: Callable[[], float]


def _heat() -> float:
    figures = spectral.heat_figures("torus, 20 000", 10.0)
    return figures["us"] / figures["expm_multiply_us"]


def _hodge(which: str) -> float:
    figures = spectral.hodge_figures("torus, 20 000")
    return figures[which] / figures["scipy_factors_us"]


def _street() -> float:
    source = slam.held("street", slam.street(12.0))
    return slam.ours(source)[1] / slam.naive(source)[1]


def _pose() -> float:
    _, xyz, seen = observations(points=500)
    other = as_observations(seen)
    ours = median_seconds(lambda: fit_pose(RIG, np.eye(4), xyz, seen, SIGMA), 9)
    return ours / median_seconds(
        lambda: adjust(RIG, np.eye(4)[None], xyz, other, move_points=False, max_steps=10), 9
    )  # fmt: skip


def _cholesky() -> float:
    S, b = equations(1801, 60)
    ours = median_seconds(lambda: solve_positive(S.copy(), b.copy()), 5)
    return ours / median_seconds(lambda: cho_solve(cho_factor(S.copy(), lower=True), b.copy()), 5)


def _beyond_bare(*words: str) -> float:
    """Seconds of a command beyond those of an interpreter that does nothing."""
    return process_seconds(*words, rounds=5) - process_seconds("-c", "pass", rounds=5)


LIMITS = (
    Limit("T-MAHF, beside a sparse product", 2.5, lambda: topology.filter_figures("none")["ratio"]),
    Limit("T-MAHF with the harmonic's fit, beside a sparse product", 4.0,
          lambda: topology.filter_figures("harmonic")["ratio"]),
    Limit("stage of 2 000 vertices, beside a sparse product", 30, lambda: topology.stage_figures(2_000)["ratio"]),
    Limit("stage of 20 000 vertices, beside a sparse product", 30, lambda: topology.stage_figures(20_000)["ratio"]),
    Limit("complex of 1 000 000 vertices in random order, CPU a vertex beside 20 000 (1.2; before buckets 2.5)", 1.8,
          topology.complex_growth),
    Limit("16 times the pixels, beside the plain image", 6, lambda: topology.resolution_figures()["ratio"]),
    Limit("construction, beside one object a simplex", 1 / 80,
          lambda: 1 / topology.construction_figures()["times_faster"]),
    Limit("heat, beside SciPy's exponential (0.05 to 0.17)", 0.4, _heat),
    Limit("first Hodge, beside factors of both Laplacians (0.5)", 0.9, lambda: _hodge("first_us")),
    Limit("later Hodge, beside factors of both Laplacians (0.02)", 0.06, lambda: _hodge("later_us")),
    Limit("each of four responses at once, beside one alone", 0.62, lambda: spectral.bank_figures()["ratio"]),
    Limit("T-MAHF, beside our MAHF (0.01 to 0.03; the paper: 0.6)", 0.2,
          lambda: spectral.stage_figures(1_000)["ratio"]),
    Limit("a street with maps and files, beside OpenCV's parts from frame to frame (0.7)", 1.0, _street),
    Limit("pose, beside bundle adjustment of it", 0.7, _pose),
    Limit("equations of 300 cameras, beside LAPACK (0.04)", 0.8, _cholesky),
    Limit("import tspslam, s beyond a bare interpreter", 0.1, lambda: _beyond_bare("-c", "import tspslam")),
    Limit("tspslam --help, s beyond a bare interpreter", 0.3, lambda: _beyond_bare("-m", "tspslam", "--help")),
)  # fmt: skip


def main(attempts: int = 3) -> int:
    above = 0
    for limit in LIMITS:
        best = min(limit.ratio() for _ in range(attempts))
        above += best > limit.most
        print(f"{limit.name:<84} {best:8.3f}   at most {limit.most:.3g}{'   ABOVE' * (best > limit.most)}", flush=True)
    return int(above > 0)


if __name__ == "__main__":
    sys.exit(main())
