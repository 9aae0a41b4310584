"""Speed of the topology wing."""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import csr_array, hstack

import tspslam

from .measure import median_seconds, paired, seconds
from .scenes import Scene, random_scene, stage

Figures = dict[str, float]


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


def growth_figures(small: int = 20_000, large: int = 1_000_000) -> Figures:
    """Exponent of the stage's time in the number of vertices, random order, the same pixels a vertex."""
    few, many = random_scene(small), random_scene(large, scale=7)
    stage(many)
    times = [(median_seconds(lambda: stage(few), 7), seconds(lambda: stage(many))) for _ in range(3)]
    a, b = (float(np.median(column)) for column in zip(*times, strict=True))
    return {
        "us_per_vertex_20k": a / small * 1e6,
        "us_per_vertex_1m": b / large * 1e6,
        "exponent": math.log(b / a) / math.log(large / small),
    }


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
