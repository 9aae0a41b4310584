"""What the denoising of signals is held against: filters of vertices, of each level, of the image, each at its best.

A rival with a parameter gives its results one after another; `best` picks on the truth.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import cg
from skimage.restoration import denoise_nl_means, denoise_tv_chambolle

import tspslam
from tspslam.apps import signals as ours
from tspslam.topology.laplacian import unsigned_laplacian

TIMES = np.geomspace(0.02, 20, 20)
ERROR = 1e-5  # of polynomials, as a share of the signal: a ten-thousandth of the noise


def psnr(estimate, truth) -> float:
    return float(-10 * np.log10(np.mean((estimate - truth) ** 2)))


def best(results, truth) -> float:
    """Largest PSNR of results in the order of their parameter; ends where it has fallen three times in a row."""
    top, falls = -np.inf, 0
    for result in results:
        value = psnr(result, truth)
        top, falls = (value, 0) if value > top else (top, falls + 1)
        if falls == 3:
            break
    return top


def heat(L, signal):
    return (tspslam.heat_filter(L, signal, t, error=ERROR) for t in TIMES)


def tikhonov(L, signal):
    return (tspslam.tikhonov_filter(L, signal, t) for t in TIMES)


def smoothed_levels(complex_, signals, truth) -> tuple[float, float]:
    """`smooth_signals` of edges and of faces, its t picked for each."""
    return tuple(
        best(heat(unsigned_laplacian(complex_, level), getattr(signals, level)), getattr(truth, level))
        for level in ("edge", "face")
    )


def total_variation(complex_, signal, noise):
    """Least ``|x - s|²/2 + w Σ |x_i - x_j|`` over the edges, by pyunlocbox's primal-dual method."""
    from pyunlocbox import functions, solvers

    logging.getLogger("pyunlocbox").setLevel(logging.ERROR)
    D = complex_.B1.T.tocsr().astype(float)
    step = 0.9 / (1 + np.sqrt(2 * np.bincount(complex_.edges.ravel()).max()))
    for weight in noise * np.geomspace(0.05, 0.8, 7):
        solver = solvers.mlfbf(L=D.dot, Lt=D.T.tocsr().dot, d0=np.zeros(D.shape[0]), step=step)
        terms = [functions.dummy(), functions.norm_l1(lambda_=weight), functions.norm_l2(y=signal, lambda_=0.5)]
        yield solvers.solve(terms, signal.copy(), solver, maxit=150, rtol=1e-5, verbosity="NONE")["sol"]


def bilateral(complex_, signal, noise):
    """Means over neighbours, weighed by ``exp(-d²/2h²)`` of their difference, once to three times."""
    ends = complex_.edges[:, [0, 1, 1, 0]].reshape(-1, 2).T
    for width in noise * np.geomspace(0.5, 8, 8):
        x = signal
        top = []
        for _ in range(3):
            weight = np.exp(-((x[ends[0]] - x[ends[1]]) ** 2) / (2 * width**2))
            total = x + np.bincount(ends[0], weight * x[ends[1]], minlength=len(x))
            x = total / (1 + np.bincount(ends[0], weight, minlength=len(x)))
            top.append(x)
        yield from top


def regression(complex_, signal):
    """PyGSP's Tikhonov regression with every vertex measured."""
    from pygsp import graphs, learning

    adjacency = -complex_.L0.tocsr()
    graph = graphs.Graph(diags_array(complex_.L0.diagonal()) + adjacency)
    known = np.ones(complex_.n, bool)
    return (learning.regression_tikhonov(graph, signal, known, tau=t) for t in TIMES[::2])


def images_by_means(image, noise):
    """Non-local means, sigma known, of three strengths."""
    for strength in (0.5, 0.7, 0.9):
        yield denoise_nl_means(image, 5, 6, strength * noise, fast_mode=True, sigma=noise)


def images_by_variation(image, noise):
    """Total variation of the image (Chambolle), seven weights about the noise."""
    for weight in noise * np.geomspace(0.3, 3, 7):
        yield denoise_tv_chambolle(image, weight, max_num_iter=100)


class VertexConstants(NamedTuple):
    """As `ours.CONSTANTS`, for the pairs of neighbouring vertices alone; fitted with it."""

    ratio: np.ndarray
    even: np.ndarray
    weight: np.ndarray
    least: np.ndarray
    slant: np.ndarray


VERTEX_CONSTANTS = VertexConstants(
    ratio=ours.CONSTANTS.ratio,
    even=np.array([-2.06, -0.32, -0.34, -0.2, 0.87]),
    weight=np.array([-0.18, -0.6, -0.18, -0.02, -1.98]),
    least=np.array([-4.83, -6.66, -4.46, -16.9, 1.26]),
    slant=np.array([-0.63, -0.14, 0.73, 2.75, 3.21]),
)


def ours_on_vertices(graph, signal, variance, constants=VERTEX_CONSTANTS):
    """Our method with all left out that stands on edges and faces: ties between neighbours, slopes of vertices."""
    i, j = graph.edges.astype(int).T
    n, own, places = graph.n, graph.own[: graph.n], graph.places
    y = signal[:n]
    contrast = max(ours.estimate_contrast(graph, signal, variance), ours.FLOOR * variance)
    ratio = 0.5 * np.log(variance / contrast)
    even, weight, least, slant = np.exp([np.interp(ratio, constants.ratio, values) for values in constants[1:]])
    offset = places[j] - places[i]

    def solve(w, x):
        W = coo_array((np.r_[w, w], (np.r_[i, j], np.r_[j, i])), shape=(n, n)).tocsr()
        diagonal = own + W.sum(axis=1)
        return cg(diags_array(diagonal) - W, own * y, x, rtol=1e-3, maxiter=30, M=diags_array(1 / diagonal))[0]

    x = solve(np.full(len(i), even * variance / contrast), y)
    for _ in range(ours.ROUNDS):
        T = vertex_tensors(i, j, offset, x, n)
        T = 0.5 * (T[i] + T[j])
        u, v = offset.T
        step = (x[i] - x[j]) ** 2 + slant * (T[:, 0] * u * u + 2 * T[:, 1] * u * v + T[:, 2] * v * v)
        x = solve(weight * variance / (least * contrast + step), x)
    return x


def vertex_tensors(i, j, offset, x, n):
    """Products of slopes of planes through the neighbours, averaged over these and the vertex."""
    at, u, v, d = np.r_[i, j], *np.r_[offset, -offset].T, np.r_[x[j] - x[i], x[i] - x[j]]
    total = lambda values: np.bincount(at, values, minlength=n)  # noqa: E731
    count = np.maximum(total(np.ones(len(at))), 1)
    mean = lambda values: total(values) / count  # noqa: E731
    mu, mv, md = mean(u), mean(v), mean(d)
    uu, uv, vv = mean(u * u) - mu * mu, mean(u * v) - mu * mv, mean(v * v) - mv * mv
    ud, vd = mean(u * d) - mu * md, mean(v * d) - mv * md
    more = 0.02 * (uu + vv) + 1e-9
    uu, vv = uu + more, vv + more
    g, h = (np.array([vv * ud - uv * vd, uu * vd - uv * ud])) / (uu * vv - uv * uv)
    T = np.stack([g * g, g * h, h * h], axis=1)
    ring = np.stack([total(T[np.r_[j, i], k]) for k in range(3)], axis=1)
    return (T + ring) / (1 + count[:, None])
