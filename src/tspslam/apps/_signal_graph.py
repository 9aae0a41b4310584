"""A complex as its signals' denoising sees it, and what its signals tell of their noise."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import brief
from ..errors import InputError
from ..topology.complex import Complex
from ..types import BoolArray, FloatArray, Signals, real_array

BILINEAR = 4 / 9  # mean of the sum of squared weights of a bilinear sample, over all places in a pixel
FLATTEST = 0.1  # share of the vertices that tell the noise: few, so that they are flat, enough for a mean
CHANCE = 0.21  # of pure noise: variance of the edges around those vertices over the mean of all vertices
TEXTURE = 0.45  # of what edges show more than vertices: how much is texture in the vertices; development photographs
WHITE = 1.65  # pixels of an edge that share the noise of a vertex at its end; measured, as the next three
WIDE = (1.4, 0.1, 2.2)  # pixels that share its texture: a constant, growth with the edge's pixels, most
LONG, CHOSEN = (5.0, 9.0), (12.0, 14.0)  # px, mean lengths of edges between which that tells, and between which of all
LEAST_WHITE, DOUBT = 0.003, 0.05  # least share; taken off it, as too much noise does harm and too little does not
LEAST = 0.15  # share of what vertices show that is taken for noise even where all is texture


class Graph(NamedTuple):
    """A complex as the kernels see it: which elements are paired, where they are, and how many pixels they are worth.

    Attributes
    ----------
    order : (F,) uint32
        Faces by their first vertex, as edges are: what is near in one array is near in the others.
    edges, faces, face_edges : (E, 2), (F, 3), (F, 3) uint32
        Of the complex, faces in that order.
    pairs, opposite : (P, 2) uint32
        Faces that share an edge, and their vertices off it.
    places : (n + E + F, 2) float64
        Where the elements are, px.
    own : (n + E + F,) float64
        Noise's variance in a pixel over that in the element; 0 without a signal.
    """

    order: NDArray[np.uint32]
    edges: NDArray[np.uint32]
    faces: NDArray[np.uint32]
    face_edges: NDArray[np.uint32]
    pairs: NDArray[np.uint32]
    opposite: NDArray[np.uint32]
    places: FloatArray
    own: FloatArray

    @property
    def n(self) -> int:
        """Number of vertices."""
        return len(self.own) - len(self.edges) - len(self.faces)

    def pack(self, signals: Signals) -> FloatArray:
        """Return the signals of all elements, (C, n + E + F) float64; 0 where there is none."""
        values = np.concatenate([signals.vertex, signals.edge, signals.face[self.order]]).astype(np.float64)
        columns = values.reshape(len(values), -1)
        return np.ascontiguousarray(np.where(self.own[:, None] > 0, columns, 0.0).T)

    def unpack(self, values: FloatArray, signals: Signals) -> Signals:
        """Return `signals` with other values."""
        vertex, edge, ordered = np.split(values.T, [self.n, self.n + len(self.edges)])
        face = np.empty_like(ordered)
        face[self.order] = ordered
        parts = {"vertex": vertex, "edge": edge, "face": face}
        shaped: dict[str, Any] = {
            level: np.ascontiguousarray(part).reshape(getattr(signals, level).shape) for level, part in parts.items()
        }
        return replace(signals, **shaped)

    def __repr__(self) -> str:
        return brief(self)


def build_graph(complex_: Complex, signals: Signals, uv: ArrayLike | None = None) -> Graph:
    """Pair the elements of a complex, place them, and count what their signals are worth.

    Parameters
    ----------
    complex_ : Complex
        Of triangles.
    signals : Signals
        Its signals.
    uv : (n, 2) float array, optional
        Where vertices are, px.

    Returns
    -------
    Graph
    """
    from ..topology._locality import order_by_cell
    from . import _signals

    order = order_by_cell(np.arange(complex_.n), complex_.n, complex_.faces[:, 0])
    edges, faces, face_edges = (
        np.ascontiguousarray(part, np.int32).view(np.uint32)
        for part in (complex_.edges, complex_.faces[order], complex_.face_edges[order])
    )
    pairs, opposite = _signals.join_faces(faces, face_edges, len(edges))
    points = np.zeros((complex_.n, 2))
    if uv is None:
        _signals.place_vertices(edges, faces, face_edges, signals.edge_uv, signals.edge_ok, points)
    else:
        points = _checked_uv(uv, complex_.n, signals.vertex_ok)
    own = [
        np.full(complex_.n, 1 / BILINEAR) if uv is None else 1 / _noise_at(points),
        _worth(signals.edge_pixels, signals.edge_uv, 1),
        _worth(signals.face_pixels[order], signals.face_uv[order], 0),
    ]
    ok = np.concatenate([signals.vertex_ok, signals.edge_ok, signals.face_ok[order]])
    places = np.concatenate([points, signals.edge_uv, signals.face_uv[order]])
    return Graph(order, edges, faces, face_edges, pairs, opposite, places, np.where(ok, np.concatenate(own), 0.0))


def _worth(pixels: NDArray[np.int32], uv: FloatArray, most: int) -> FloatArray:
    """How many pixels elements average over; those of at most `most` pixels hold a bilinear sample."""
    worth = pixels.astype(np.float64)
    sampled = np.flatnonzero(pixels <= most)
    worth[sampled] = 1 / _noise_at(uv[sampled])
    return worth


def _noise_at(uv: FloatArray) -> FloatArray:
    """Sum of the squared weights of bilinear samples, which is what variance noise keeps in them."""
    part = uv - np.floor(uv)
    squares = part * part + (1 - part) ** 2
    return squares[:, 0] * squares[:, 1]


def _checked_uv(uv: ArrayLike, n: int, ok: BoolArray) -> FloatArray:
    points = real_array(uv, "uv", f"({n}, 2)").astype(np.float64)
    if points.shape != (n, 2):
        raise InputError(f"uv has shape {points.shape}, expected ({n}, 2): one projection for each vertex")
    if not np.isfinite(points[ok]).all():
        raise InputError("uv is NaN or infinite at a vertex with a signal, expected its place in the image")
    return np.where(ok[:, None], points, 0.0)


def estimate_variance(graph: Graph, y: FloatArray) -> float:
    """Variance of the noise of a pixel: how far vertices are off the edges around them, where those are most alike.

    Parameters
    ----------
    graph : Graph
        The complex.
    y : (n + E + F,) float64
        Noisy signals.

    Returns
    -------
    float
        0 where nothing tells.
    """
    from . import _signals

    off, spread, gain, expected, count = _signals.compare_links(y, graph.own, graph.n, graph.faces, graph.face_edges)
    rows = np.flatnonzero(count >= 3)  # fewer are alike by chance
    if not len(rows):
        rows = np.flatnonzero(count)
        return float((off[rows] ** 2).sum() / gain[rows].sum()) if len(rows) else 0.0
    kept = max(1, round(FLATTEST * len(rows)))
    rows = rows[spread[rows] <= np.partition(spread[rows], kept - 1)[kept - 1]]
    by_vertex = float((off[rows] ** 2).sum() / gain[rows].sum())
    by_edges = float(spread[rows].sum() / (CHANCE * expected[rows].sum()))
    texture = min(TEXTURE * max(by_edges - by_vertex, 0.0), (1 - LEAST) * by_vertex)
    return min(by_vertex - texture, by_vertex * _white_share(graph, y, off, rows))


def _white_share(graph: Graph, y: FloatArray, off: FloatArray, rows: NDArray[np.int64]) -> float:
    """Share of vertices' differences that is white, from how far along the edges that end there it is seen.

    Where edges are short it is 1: they are all end. Where they are long, vertices mostly are what a detector chose,
    corners, and all have to be white, not only those in flat surroundings.
    """
    flat, length = _seen_along(graph, y, off, rows)
    whole, _ = _seen_along(graph, y, off, np.flatnonzero(off))
    seen = flat + _rise(length, CHOSEN) * max(whole - flat, 0.0)
    wide = min(WIDE[0] + WIDE[1] * length, WIDE[2])
    share = (wide - seen) / (wide - WHITE) - DOUBT if wide > WHITE else 1.0
    return float(1 - _rise(length, LONG) * (1 - np.clip(share, LEAST_WHITE, 1.0)))


def _seen_along(graph: Graph, y: FloatArray, off: FloatArray, rows: NDArray[np.int64]) -> tuple[float, float]:
    """Pixels of an edge that share what sets vertices off, and the mean length of the edges, px."""
    from . import _signals

    chosen = np.zeros(graph.n, bool)
    chosen[rows] = True
    shared, square, pixels, count = _signals.compare_ends(y, graph.own, graph.edges, off, chosen)
    return (shared / square, pixels / count) if square > 0 else (WHITE, 0.0)


def _rise(value: float, span: tuple[float, float]) -> float:
    """From 0 at the begin of a span to 1 at its end."""
    return min(max((value - span[0]) / (span[1] - span[0]), 0.0), 1.0)


def estimate_contrast(graph: Graph, y: FloatArray, variance: float) -> float:
    """Mean squared step between vertices on both sides of an edge, less what noise makes of it.

    Parameters
    ----------
    graph : Graph
        The complex.
    y : (n + E + F,) float64
        Noisy signals.
    variance : float
        Of the noise in a pixel.

    Returns
    -------
    float
        Of the ends of edges where no two faces share one; may be negative by chance.
    """
    from . import _signals

    for rows in (graph.opposite, graph.edges):
        total, gain, count = _signals.difference(y, graph.own, rows[:, 0], rows[:, 1])
        if count:
            return (total - variance * gain) / count
    return 0.0
