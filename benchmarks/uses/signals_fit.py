"""Fits the constants of `tspslam.apps.signals` on development photographs: ``python -m benchmarks.uses.signals_fit``.

Pieces of the photographs with about 1 500 vertices, as dense as 4 000 and 20 000 in the whole, noise of 0.01 to 0.2.
What is raised: mean PSNR, vertices 1, edges and faces 1/4 each, less 2 for each dB that vertices fall below the noisy
ones. Then the same for the rival on vertices alone (``--vertices``: only this).
"""

from __future__ import annotations

import sys
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay
from skimage import data

import tspslam
from tspslam.apps import signals as ours
from tspslam.topology.texture import luminance

from . import signals_rivals as rivals
from .signals_rivals import psnr

PHOTOGRAPHS = ("chelsea", "coins", "rocket", "brick")
NOISES = (0.01, 0.05, 0.1, 0.2)
VERTICES = 1500


def pieces():
    """Rows: graph, true and noisy signals of all its elements, where levels begin."""
    for seed, (name, whole) in enumerate([(name, n) for name in PHOTOGRAPHS for n in (4_000, 20_000)] * 2, 100):
        rng = np.random.default_rng(seed)
        image = luminance(getattr(data, name)())
        side = np.minimum(np.sqrt(VERTICES / whole * image.size), min(image.shape)).astype(int)
        corner = [rng.integers(size - side + 1) for size in image.shape]
        clean = np.ascontiguousarray(image[corner[0] : corner[0] + side, corner[1] : corner[1] + side])
        uv = rng.random((round(whole * clean.size / image.size), 2)) * (side - 1)
        complex_ = tspslam.build_complex(Delaunay(uv).simplices, len(uv))
        noise = rng.normal(size=clean.shape)
        for sigma in NOISES:
            both = np.stack([clean, clean + sigma * noise], axis=-1)
            signals = tspslam.sample_signals(both, uv, complex_, channels="all")
            graph = ours.build_graph(complex_, signals, uv)
            true, noisy = graph.pack(signals)
            yield graph, true, noisy, np.cumsum([0, graph.n, len(graph.edges), len(graph.faces)])


def score(items, constants) -> float:
    """Of all levels jointly."""
    total = 0.0
    for graph, true, noisy, start in items:
        x = ours.denoise(graph, noisy, None, None, constants)
        gains = [psnr(x[a:b], true[a:b]) for a, b in pairwise(start)]
        lost = psnr(noisy[: graph.n], true[: graph.n]) - gains[0]
        total += gains[0] + 0.25 * (gains[1] + gains[2]) - 2 * max(lost, 0.0)
    return total / len(items)


def vertex_score(items, constants) -> float:
    """Of the rival on vertices alone."""
    total = 0.0
    for graph, true, noisy, _ in items:
        x = rivals.ours_on_vertices(graph, noisy, ours.estimate_variance(graph, noisy), constants)
        gain = psnr(x, true[: graph.n])
        total += gain - 2 * max(psnr(noisy[: graph.n], true[: graph.n]) - gain, 0.0)
    return total / len(items)


def packed(c) -> np.ndarray:
    return np.concatenate([np.log(c.kind[1:]), c.even, c.weight, c.least, c.slant])


def unpacked(values):
    even, weight, least, slant = np.reshape(values[3:], (4, -1))
    kind = np.exp(np.concatenate([[0], values[:3]]))
    return ours.CONSTANTS._replace(kind=kind, even=even, weight=weight, least=least, slant=slant)


def vertex_constants(values):
    return rivals.VertexConstants(ours.CONSTANTS.ratio, *np.reshape(values, (4, -1)))


def climb(function, x, tries: int):
    """Steps along one axis or all at a time, longer after a success, shorter after a failure."""
    rng = np.random.default_rng(100)
    best, step = function(x), np.full(len(x), 0.4)
    for k in range(tries):
        axis = rng.integers(len(x) + 3)
        move = step * (np.arange(len(x)) == axis) if axis < len(x) else 0.4 * step * rng.normal(size=len(x))
        found = max(((function(x + sign * move), sign) for sign in (1, -1)), key=lambda pair: pair[0])
        if axis < len(x):
            step[axis] *= 1.3 if found[0] > best else 0.6
        if found[0] > best:
            best, x = found[0], x + found[1] * move
        if k % 20 == 0:
            print(k, round(best, 4), file=sys.stderr, flush=True)
    return x


def show(constants) -> None:
    for name, values in zip(constants._fields, constants, strict=True):
        print(f"{name}=np.array({np.round(values, 2).tolist()}),", flush=True)


def main() -> None:
    items = list(pieces())
    if "--vertices" not in sys.argv:
        show(unpacked(climb(lambda x: score(items, unpacked(x)), packed(ours.CONSTANTS), 300)))
    start = np.concatenate(rivals.VERTEX_CONSTANTS[1:])
    show(vertex_constants(climb(lambda x: vertex_score(items, vertex_constants(x)), start, 200)))


if __name__ == "__main__":
    main()
