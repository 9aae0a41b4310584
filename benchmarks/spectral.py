"""The spectral tools, Hodge, MAHF, banks and cells beside their rivals: the same mesh, the same run, one core."""

from __future__ import annotations

import csv
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import cg, expm_multiply, splu

import tspslam
from tspslam.topology.mahf import conformal_laplacian

from .measure import median_seconds, paired, seconds
from .scenes import random_scene, stage

Figures = dict[str, float]
TABLE = Path(__file__).parents[1] / "docs" / "topology_rivals.csv"
SIZES = {"torus, 20 000": (125, 160), "torus, 200 000": (400, 500)}
MESHES = (*SIZES, "Motorcycle surface")


@lru_cache(maxsize=2)
def mesh(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces and vertices: the torus of Figures 11 and 12 before the camera, or the surface of the real pair."""
    if name not in SIZES:
        cloud = tspslam.reconstruct(tspslam.datasets.motorcycle())
        return tspslam.delaunay_surface(cloud).faces, cloud.xyz
    rows, columns = SIZES[name]
    i, j = np.divmod(np.arange(rows * columns), columns)
    right, down = i * columns + (j + 1) % columns, (i + 1) % rows * columns + j
    across, here = (i + 1) % rows * columns + (j + 1) % columns, i * columns + j
    faces = np.concatenate([np.stack([here, right, across], 1), np.stack([here, across, down], 1)])
    a, b = 2 * np.pi * i / rows, 2 * np.pi * j / columns
    ring, low = 1 + 0.4 * np.cos(a), 0.4 * np.sin(a)
    x, y, tilt = ring * np.cos(b), ring * np.sin(b), np.sqrt(0.5)
    return faces, np.column_stack([x, tilt * (y - low), tilt * (y + low) + 4])


def fresh(name: str) -> tspslam.Complex:
    faces, xyz = mesh(name)
    complex_ = tspslam.build_complex(faces, len(xyz))
    complex_.B1, complex_.B2, complex_.L0, complex_.L2  # noqa: B018 - not what is timed
    return complex_


def heat_figures(name: str, t: float) -> Figures:
    """Heat on the vertices beside PyGSP (its bound of the spectrum not counted) and expm_multiply."""
    from pygsp import filters, graphs

    L = fresh(name).L0
    n, signal = L.shape[0], np.random.default_rng(0).normal(size=L.shape[0])
    graph = graphs.Graph(-(L - csc_array((L.diagonal(), (np.arange(n), np.arange(n))), shape=L.shape)))
    graph._lmax, graph._lmax_method = 2 * L.diagonal().max(), "bounds"  # what we take for it
    heat = filters.Heat(graph, scale=t * graph.lmax)
    order = 30 if t <= 1 else 60
    ours, theirs, _ = paired(lambda: tspslam.heat_filter(L, signal, t), lambda: heat.filter(signal, order=order), 7)
    reference = median_seconds(lambda: expm_multiply(-t * L, signal), 3)
    error = np.linalg.norm(tspslam.heat_filter(L, signal, t) - expm_multiply(-t * L, signal)) / np.linalg.norm(signal)
    unit = 1e6 / n
    return {"us": ours * unit, "pygsp_us": theirs * unit, "expm_multiply_us": reference * unit, "error": error}


def hodge_figures(name: str) -> Figures:
    """The first decomposition and a later one, beside SciPy's conjugate gradients and a factor of L0 and of L2."""
    first, signal = [], np.random.default_rng(0).normal(size=len(fresh(name).edges))
    for _ in range(3):
        complex_ = fresh(name)
        first.append(seconds(lambda c=complex_: tspslam.hodge_decompose(c, signal)))
    later = median_seconds(lambda: tspslam.hodge_decompose(complex_, signal), 7)
    parts = tspslam.hodge_decompose(complex_, signal)
    energy = signal @ signal
    laws = max(
        abs(parts.gradient @ parts.curl), abs(parts.gradient @ parts.harmonic), abs(parts.curl @ parts.harmonic)
    )  # fmt: skip
    unit = 1e6 / complex_.n
    return {
        "first_us": float(np.median(first)) * unit, "later_us": later * unit, "laws": laws / energy,
        "scipy_cg_us": seconds(lambda: _by_cg(complex_, signal)) * unit,
        "scipy_factors_us": seconds(lambda: _by_factors(complex_, signal)) * unit,
    }  # fmt: skip


def _by_cg(complex_: tspslam.Complex, signal: np.ndarray) -> None:
    for matrix, boundary in ((complex_.L0, complex_.B1), (complex_.L2, complex_.B2.T)):
        cg(matrix, boundary @ signal, rtol=1e-8)


def _by_factors(complex_: tspslam.Complex, signal: np.ndarray) -> None:
    for matrix, boundary in ((complex_.L0, complex_.B1), (complex_.L2, complex_.B2.T)):
        grounded = csc_array(matrix + 1e-10 * eye_array(matrix.shape[0]))  # several components
        splu(grounded, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0).solve(
            boundary @ signal
        )


def mahf_figures(name: str, laplacian: str) -> Figures:
    """MAHF on a whole cloud at t = 1: time, error against the exact kernel (200 rows of it)."""
    faces, xyz = mesh(name)
    signal = np.random.default_rng(0).random(len(xyz))
    run = lambda: tspslam.mahf(faces, xyz, signal, laplacian=laplacian)  # noqa: E731
    taken = median_seconds(run, 3)
    response, exact = run(), _exact_rows(faces, xyz, signal, laplacian)
    error = np.abs(response.z[: len(exact)] - exact) / np.abs(exact)
    return {"us": 1e6 * taken / len(xyz), "seconds": taken, "median_error": float(np.median(error))}


def _dense(name: str, laplacian: str) -> str:
    """What a dense kernel of this mesh takes, in time where it fits."""
    faces, xyz = mesh(name)
    if len(xyz) > 4000:
        return f"a dense kernel: {8 * len(xyz) ** 2 / 1e9:.1f} GB"
    signal = np.random.default_rng(0).random(len(xyz))
    run = lambda: tspslam.mahf(faces, xyz, signal, method="exact", laplacian=laplacian)  # noqa: E731
    return f"a dense kernel by eigenvectors {1e6 * median_seconds(run, 3) / len(xyz):.0f}"


def _exact_rows(faces: np.ndarray, xyz: np.ndarray, signal: np.ndarray, laplacian: str, rows: int = 200) -> np.ndarray:
    """The first responses by SciPy's exponential of impulses."""
    from tspslam.topology.mahf import tangent_axes

    L = conformal_laplacian(faces, xyz) if laplacian == "conformal" else tspslam.build_complex(faces, len(xyz)).L0
    heat = expm_multiply(-L, np.eye(len(xyz), rows))
    axes, z = tangent_axes(xyz, np.asarray(faces, np.int32)), np.empty(rows, complex)
    for i in range(rows):
        d = xyz - xyz[i]
        phi = np.arctan2(d @ axes[i, 3:], d @ axes[i, :3])
        z[i] = np.delete(heat[:, i] * np.exp(1j * phi) * signal, i).sum()
    return z


def stage_figures(n: int) -> Figures:
    """T-MAHF's whole stage beside MAHF's, from triangles to responses; the paper: 40 % less."""
    scene = random_scene(n)
    xyz = np.column_stack([scene.uv / 500 - 1, np.full(n, 2.0)])
    signal = np.random.default_rng(0).random(n)
    topological, graph, ratio = paired(
        lambda: stage(scene), lambda: tspslam.mahf(scene.faces, xyz, signal, laplacian="graph"), 5
    )
    return {"tmahf_us": 1e6 * topological / n, "mahf_us": 1e6 * graph / n, "ratio": ratio}


def bank_figures(n: int = 20_000) -> Figures:
    """Four T-MAHF responses at once beside one; the ratio is for each of them."""
    scene = random_scene(n)
    complex_ = tspslam.build_complex(scene.faces, n)
    signals = tspslam.sample_signals(scene.image, scene.uv, complex_)
    orders = (1, 2, 3, 4)
    bank, one, ratio = paired(
        lambda: tspslam.tmahf_bank(complex_, scene.uv, signals, orders),
        lambda: tspslam.tmahf(complex_, scene.uv, signals),
        15,
    )
    return {"bank_us": 1e6 * bank / n, "one_us": 1e6 * one / n, "ratio": ratio / len(orders)}


def cell_figures(n: int = 20_000) -> Figures:
    """40 000 faces merged into about 4 000 cells, their signals and the filter on them."""
    scene = random_scene(n)
    complex_ = tspslam.build_complex(scene.faces, n)
    signals = tspslam.sample_signals(scene.image, scene.uv, complex_)
    labels = tspslam.grow_labels(complex_, 16)

    def merged() -> object:
        cells = tspslam.merge_cells(complex_, labels)
        return tspslam.tmahf(cells, scene.uv, tspslam.merge_signals(complex_, labels, signals))

    return {"faces": len(complex_.faces), "cells": int(labels.max()) + 1, "ms": 1e3 * median_seconds(merged, 9)}


def write_table() -> None:
    """The page's table: one row for each task and mesh."""
    rows: list[tuple[str, str, str, str]] = []
    for name in MESHES:
        for t in (1.0, 10.0):
            f = heat_figures(name, t)
            rivals = f"PyGSP {f['pygsp_us']:.2f}, SciPy expm_multiply {f['expm_multiply_us']:.2f}"
            rows.append((f"heat, t = {t:g}", name, f"{f['us']:.2f}", rivals))
        f = hodge_figures(name)
        rivals = f"SciPy: CG {f['scipy_cg_us']:.1f} each time, two factors {f['scipy_factors_us']:.1f}"
        rows.append(("Hodge, first / later", name, f"{f['first_us']:.1f} / {f['later_us']:.2f}", rivals))
        for laplacian in ("graph", "conformal"):
            rows.append(
                (f"MAHF, {laplacian}", name, f"{mahf_figures(name, laplacian)['us']:.0f}", _dense(name, laplacian))
            )
    with TABLE.open("w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(["task", "mesh", "ours, µs a vertex", "others, µs a vertex"])
        writer.writerows(rows)


FIGURES: dict[str, Callable[[], Figures]] = {
    **{
        f"heat, t = {t:g}, {name}": lambda name=name, t=t: heat_figures(name, t) for name in MESHES for t in (1.0, 10.0)
    },
    **{f"Hodge, {name}": lambda name=name: hodge_figures(name) for name in MESHES},
    **{
        f"MAHF {kind}, {name}": lambda name=name, kind=kind: mahf_figures(name, kind)
        for name in ("torus, 20 000", "Motorcycle surface")
        for kind in ("graph", "conformal")
    },
    "T-MAHF beside MAHF, 1 000": lambda: stage_figures(1_000),
    "T-MAHF beside MAHF, 20 000": lambda: stage_figures(20_000),
    "bank of four": bank_figures,
    "cells": cell_figures,
}
