"""The readable truth: the same quantities in plain NumPy, one element at a time, straight from the equations."""

from __future__ import annotations

from collections import deque
from fractions import Fraction

import numpy as np

from tspslam import Complex, Response, Signals


def neighbour_sets(complex_: Complex, i: int) -> tuple[set[int], set[int], set[int]]:
    """η_p, η_e, η_f of vertex i, eqs (14)-(16)."""
    faces = {f for f, face in enumerate(complex_.faces) if i in face}
    edges = {int(e) for f in faces for e in complex_.face_edges[f]}
    vertices = {int(a + b - i) for a, b in complex_.edges if i in (a, b)}
    return vertices, edges, faces


def line_pixels(start: tuple[int, int], end: tuple[int, int]) -> list[tuple[int, int]]:
    """Pixels (u, v) of the integer Bresenham line, from the end with the smaller (v, u)."""
    (u0, v0), (u1, v1) = sorted((start, end), key=lambda p: (p[1], p[0]))
    du, dv = abs(u1 - u0), abs(v1 - v0)
    su, sv = (1 if u1 > u0 else -1), (1 if v1 > v0 else -1)
    long, short = max(du, dv), min(du, dv)
    pixels = []
    for step in range(long + 1):
        side = (2 * short * step + long) // (2 * long) if long else 0
        pixels.append((u0 + su * side, v0 + step * sv) if dv > du else (u0 + su * step, v0 + sv * side))
    return pixels


def triangle_pixels(corners: np.ndarray) -> list[tuple[int, int]]:
    """Pixels (u, v) whose centres lie in the closed triangle; corners rounded to 1/256 px, exact in fractions."""
    a, b, c = [tuple(Fraction(int(np.floor(x * 256 + 0.5)), 256) for x in corner) for corner in corners]
    low = [int(np.floor(min(float(p[k]) for p in (a, b, c)))) for k in (0, 1)]
    high = [int(np.ceil(max(float(p[k]) for p in (a, b, c)))) for k in (0, 1)]
    inside = []
    for v in range(low[1], high[1] + 1):
        for u in range(low[0], high[0] + 1):
            turns = [_turn(p, q, (u, v)) for p, q in ((a, b), (b, c), (c, a))]
            box = all(min(p[k] for p in (a, b, c)) <= (u, v)[k] <= max(p[k] for p in (a, b, c)) for k in (0, 1))
            if box and (all(t >= 0 for t in turns) or all(t <= 0 for t in turns)):
                inside.append((u, v))
    return inside


def _turn(p, q, r):
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])


def bilinear(image: np.ndarray, u: float, v: float) -> float:
    u0, v0 = min(int(u), image.shape[1] - 1), min(int(v), image.shape[0] - 1)
    u1, v1 = min(u0 + 1, image.shape[1] - 1), min(v0 + 1, image.shape[0] - 1)
    a, b = u - u0, v - v0
    return (1 - b) * ((1 - a) * image[v0, u0] + a * image[v0, u1]) + b * ((1 - a) * image[v1, u0] + a * image[v1, u1])


def to_luminance(image: np.ndarray) -> np.ndarray:
    scale = {"uint8": 255.0, "uint16": 65535.0}.get(image.dtype.name, 1.0)
    grey = image.astype(np.float64)
    return (grey @ [0.299, 0.587, 0.114] if image.ndim == 3 else grey) / scale


def _mean(image, pixels):
    places = np.array(pixels, float)
    return np.mean([image[v, u] for u, v in pixels]), places.mean(axis=0), len(pixels)


def _edge(image, p, q):
    pixels = line_pixels(*(tuple(int(np.floor(x + 0.5)) for x in end) for end in (p, q)))
    if len(pixels) == 1:
        return bilinear(image, *((p + q) / 2)), (p + q) / 2, 1
    return _mean(image, pixels)


def _face(image, corners):
    pixels = triangle_pixels(corners)
    if not pixels:
        return bilinear(image, *corners.mean(axis=0)), corners.mean(axis=0), 0
    return _mean(image, pixels)


def sample_signals(image: np.ndarray, uv: np.ndarray, complex_: Complex) -> Signals:
    """Signals of SPEC 3, element by element."""
    grey, uv = to_luminance(image), np.asarray(uv, float)
    height, width = grey.shape
    ok = (uv[:, 0] >= 0) & (uv[:, 0] <= width - 1) & (uv[:, 1] >= 0) & (uv[:, 1] <= height - 1)
    vertex = np.array([bilinear(grey, *p) if o else 0.0 for p, o in zip(uv, ok, strict=True)])
    levels = []
    for elements, sample in ((complex_.edges, lambda p: _edge(grey, *p)), (complex_.faces, lambda p: _face(grey, p))):
        element_ok = ok[elements].all(axis=1)
        rows = [sample(uv[e]) if o else (0.0, np.zeros(2), 0) for e, o in zip(elements, element_ok, strict=True)]
        values, places, counts = ([row[k] for row in rows] for k in range(3))
        levels.append((np.array(values), np.array(places).reshape(-1, 2), np.array(counts, np.int32), element_ok))
    (edge, edge_uv, edge_n, edge_ok), (face, face_uv, face_n, face_ok) = levels
    return Signals(vertex, edge, face, edge_uv, face_uv, edge_n, face_n, ok, edge_ok, face_ok)


def distances(complex_: Complex, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Topological distances of SPEC 2 from vertex i to all vertices, edges and faces."""
    linked = [[] for _ in range(complex_.n)]
    for a, b in complex_.edges:
        linked[a].append(b)
        linked[b].append(a)
    hops = np.full(complex_.n, np.inf)
    hops[i] = 0
    queue = deque([i])
    while queue:
        at = queue.popleft()
        for x in linked[at]:
            if hops[x] == np.inf:
                hops[x] = hops[at] + 1
                queue.append(x)
    face = 1 + hops[complex_.faces].min(axis=1) if len(complex_.faces) else np.zeros(0)
    edge = np.full(len(complex_.edges), np.inf)
    for f, edges in enumerate(complex_.face_edges):
        edge[edges] = np.minimum(edge[edges], face[f])
    return hops, edge, face


def tmahf(complex_, uv, signals, *, order=1, centering=None, weight=None) -> Response:
    """T-MAHF of SPEC 4, vertex by vertex, with trigonometric functions and a general eigenvalue solver."""
    centering = centering or ("harmonic" if order else "none")
    weight = weight or (lambda d: float(d <= 1))
    uv = np.asarray(uv, float)
    places = np.concatenate([uv, signals.edge_uv, signals.face_uv])
    values = np.concatenate([signals.vertex, signals.edge, signals.face])
    ok = np.concatenate([signals.vertex_ok, signals.edge_ok, signals.face_ok])
    z, defined = np.zeros(complex_.n, complex), np.zeros(complex_.n, bool)
    for i in np.flatnonzero(signals.vertex_ok):
        d = np.concatenate(distances(complex_, i))
        w = np.array([weight(int(x)) if np.isfinite(x) else 0.0 for x in d]) * ok
        around = (w > 0) & (np.arange(len(w)) != i)
        z[i], defined[i] = _respond(places[around] - uv[i], values[around], w[around], values[i], order, centering)
    return Response(z, order, defined)


def _respond(offset, s, w, own, order, centering):
    if order == 0:
        return own + np.sum(w * s), True
    far = np.hypot(*offset.T) > 1e-6
    psi = np.arctan2(offset[:, 1], offset[:, 0])
    h = np.where(far, np.exp(1j * order * psi), 0)
    if centering in ("none", "mean"):
        mean = np.sum(w * s) / np.sum(w) if centering == "mean" and len(w) else 0.0
        return np.sum(w * h * (s - mean)), bool(len(w))
    offset, s, w, h = offset[far], s[far], w[far], h[far]
    if not len(w):
        return 0, False
    scale = np.sqrt(np.sum(w * np.sum(offset**2, axis=1)) / w.sum()) if centering == "plane" else 1.0
    columns = offset / scale if centering == "plane" else np.stack([h.real, h.imag], axis=1)
    A = np.column_stack([np.ones(len(w)), columns])
    if np.linalg.eigvalsh(A.T * w @ A / w.sum())[0] < 1e-3:
        return 0, False
    root = np.sqrt(w)
    _, a, b = np.linalg.lstsq(A * root[:, None], s * root, rcond=None)[0]
    return (a + 1j * b) * (1 / scale if centering == "plane" else w.sum() / 2), True
