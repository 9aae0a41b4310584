"""Speed of the topology wing."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_array, hstack

import tspslam

from .measure import cpu_seconds, median_seconds, paired, seconds
from .scenes import Scene, in_scan_order, random_scene, stage

Figures = dict[str, float]
SIZES = (20_000, 50_000, 100_000, 200_000, 500_000, 1_000_000)


def csr_product(complex_: tspslam.Complex):
    """The reference: one complex128 CSR product with as many non-zeros as the neighbourhoods hold."""
    matrix = csr_array(hstack(complex_.neighbours()).astype(np.complex128))
    x = np.ones(matrix.shape[1], np.complex128)
    return lambda: matrix @ x


def stage_figures(n: int) -> Figures:
    scene = random_scene(n)
    complex_ = tspslam.build_complex(scene.faces, n)
    ours, reference, ratio = paired(lambda: stage(scene), csr_product(complex_), rounds=31)
    return {"us_per_vertex": ours / n * 1e6, "csr_us_per_vertex": reference / n * 1e6, "ratio": ratio}


def filter_figures(centering: str, n: int = 20_000) -> Figures:
    scene = random_scene(n)
    complex_ = tspslam.build_complex(scene.faces, n)
    signals = tspslam.sample_signals(scene.image, scene.uv, complex_)
    filter_ = lambda: tspslam.tmahf(complex_, scene.uv, signals, centering=centering)  # noqa: E731
    ours, _, ratio = paired(filter_, csr_product(complex_), rounds=31)
    return {"us_per_vertex": ours / n * 1e6, "ratio": ratio}


def growth_figures(sizes: tuple[int, ...] = SIZES, rounds: int = 5) -> Figures:
    """CPU seconds of the stage on one thread, and the exponent fitted to them, the same pixels a vertex.

    Sizes and orders of the vertices take turns; medians. CPU time counts the waits for memory, but not for a core.
    """
    tspslam.set_threads(1)
    scenes = {n: random_scene(n, scale=round(math.sqrt(n / SIZES[0]))) for n in sizes}
    figures: Figures = {}
    for order, change in (("random", lambda scene: scene), ("scan", in_scan_order)):
        ordered = {n: change(scene) for n, scene in scenes.items()}
        for scene in ordered.values():
            stage(scene)
        rows = [[cpu_seconds(lambda s=ordered[n]: stage(s), max(1, SIZES[2] // n)) for n in sizes]
                for _ in range(rounds)]  # fmt: skip
        times = np.median(rows, axis=0)
        figures |= {f"us_per_vertex_{order}_{n}": time / n * 1e6 for n, time in zip(sizes, times, strict=True)}
        figures[f"exponent_{order}"] = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
    tspslam.set_threads(None)
    return figures


def complex_growth(small: int = 20_000, large: int = 1_000_000, rounds: int = 5) -> float:
    """CPU time a vertex of complex and neighbourhoods of a large mesh in random order, beside that of a small one."""
    scenes = random_scene(small), random_scene(large)
    build = lambda scene: tspslam.build_complex(scene.faces, len(scene.uv)).neighbours()  # noqa: E731
    times = [[cpu_seconds(lambda s=scene: build(s), large // len(scene.uv)) for scene in scenes] for _ in range(rounds)]
    return float(np.median([many / few for few, many in times])) * small / large


def thread_figures(n: int = 1_000_000, rounds: int = 7) -> Figures:
    """Seconds of the stage of a large mesh on one thread and on two: the best, as others use the machine too."""
    scene = random_scene(n, scale=round(math.sqrt(n / SIZES[0])))
    best = {}
    for count in (1, 2) * rounds:
        tspslam.set_threads(count)
        best[count] = min(best.get(count, math.inf), seconds(lambda: stage(scene)))
    tspslam.set_threads(None)
    return {"one_s": best[1], "two_s": best[2]}


def resolution_figures(n: int = 20_000) -> Figures:
    """Time of the signals on an image with 16 times the pixels against the plain one."""
    small = random_scene(n)
    large = Scene(np.kron(small.image, np.ones((4, 4), np.uint8)), small.uv * 4, small.faces)
    complex_ = tspslam.build_complex(small.faces, n)
    sample = lambda s: lambda: tspslam.sample_signals(s.image, s.uv, complex_)  # noqa: E731
    ours, reference, ratio = paired(sample(large), sample(small), rounds=21)
    return {"large_ms": ours * 1e3, "small_ms": reference * 1e3, "ratio": ratio}


def construction_figures(n: int = 20_000) -> Figures:
    """B1, B2, L0 and L1 against TopoNetX, the same mesh."""
    scene = random_scene(n)

    def ours() -> object:
        complex_ = tspslam.build_complex(scene.faces, n)
        return complex_.B1, complex_.B2, complex_.L0, complex_.L1

    def theirs() -> object:
        from toponetx.classes import SimplicialComplex

        complex_ = SimplicialComplex(scene.faces.tolist())
        return (
            complex_.incidence_matrix(1), complex_.incidence_matrix(2),
            complex_.hodge_laplacian_matrix(0), complex_.hodge_laplacian_matrix(1),
        )  # fmt: skip

    mine, other = median_seconds(ours), seconds(theirs)
    return {"ms": mine * 1e3, "toponetx_ms": other * 1e3, "times_faster": other / mine}
