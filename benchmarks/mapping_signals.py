"""How true the signals and the directions of a map are: arrays in, figures out.

``xyz`` (N, 3) vertices, m; ``faces`` (F, 3); ``rig``; ``T`` (K, 4, 4), estimated ``T_world_camera`` of the keyframes;
``images`` (K, H, W) what they took, luminance in [0, 1]. The truth is what noise-free images show, taken at the true
poses and laid on the faces at the estimated ones, so that drift does not count.

An element counts in a keyframe if it projects inside the image, at most 75° from its normal, and not more than a tenth
of its pixels are behind other faces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tspslam import build_complex, sample_signals, tmahf
from tspslam.types import Rig

from .mapping_measures import lens_of, pixels, to_camera, two_layers

LEAST_COSINE = np.cos(np.deg2rad(75))
HIDDEN = 0.1  # share of an element's pixels
STAR_PIXELS = 12  # a plane is fitted to
STAR_SPREAD = 1.0  # px², least variance of their places in any direction


class FaceViews(NamedTuple):
    """Rows: which face in which keyframe; its pixels, cosine of the viewing angle and mean luminance (M,) or (M, C)."""

    face: np.ndarray
    keyframe: np.ndarray
    pixels: np.ndarray
    cosine: np.ndarray
    value: np.ndarray


def face_views(xyz, faces, rig: Rig, T, images) -> FaceViews:
    """Mean luminance of each face in each keyframe where it counts; images (K, H, W), or (K, H, W, C) for C at once."""
    parts = []
    for k, view in enumerate(_views(xyz, faces, rig, T)):
        chosen = np.flatnonzero(view.counts)
        channels = np.moveaxis(np.reshape(images[k], (rig.height * rig.width, -1)), 1, 0)
        sums = np.stack([view.sums(channel)[chosen] for channel in channels], axis=1)
        mean = sums / view.pixels[chosen, None]
        parts.append((chosen, np.full(len(chosen), k), view.pixels[chosen], view.cosine[chosen], mean))
    found = FaceViews(*map(np.concatenate, zip(*parts, strict=True)))
    return found if np.ndim(images) == 4 else found._replace(value=found.value[:, 0])


def best_face_values(views: FaceViews, n_faces: int):
    """Each face's value in the keyframe where it has most pixels times cosine, and (F,) bool: whether there is one."""
    return _last_of_each(views, n_faces, np.lexsort((views.pixels * views.cosine, views.face)))


def one_view_values(views: FaceViews, n_faces: int, seed: int = 0):
    """Each face's value in one keyframe by chance, as a single frame gives it, and whether there is one."""
    return _last_of_each(views, n_faces, np.lexsort((np.random.default_rng(seed).random(len(views.face)), views.face)))


def _last_of_each(views: FaceViews, n_faces: int, order):
    value, ok = np.zeros((n_faces, *views.value.shape[1:])), np.zeros(n_faces, bool)
    face = views.face[order]
    last = np.flatnonzero(np.append(face[1:] != face[:-1], True)) if len(face) else order
    value[face[last]], ok[face[last]] = views.value[order[last]], True
    return value, ok


def luminance_error(value, ok, true, true_ok) -> float:
    """Median absolute error of faces' luminance, after one gain for all: a map's exposure has no zero of its own.

    The gain is the median ratio of truth to value. Compare two ways of taking values over the same `ok`.
    """
    chosen = np.asarray(ok, bool) & true_ok
    value, true = np.asarray(value)[chosen], np.asarray(true)[chosen]
    lit = value > 1e-6
    gain = np.median(true[lit] / value[lit]) if lit.any() else 1.0
    return float(np.median(np.abs(gain * value - true))) if len(value) else float("nan")


class Directions(NamedTuple):
    """Per vertex: unit ``direction`` (N, 3) in which luminance grows in the surface, ``normal`` (N, 3), ``ok`` (N,)."""

    direction: np.ndarray
    normal: np.ndarray
    ok: np.ndarray


def true_directions(xyz, faces, rig: Rig, T, clean) -> Directions:
    """Gradient in the surface of noise-free luminance over each vertex' star, in the keyframe that has most of it.

    A plane is fitted to the luminance of the star's pixels by least squares; its slope g in the image becomes
    ``Eᵀ Jᵀ g`` in the tangent plane, with E its axes and J the projection's derivative at the vertex: the gradient of
    luminance over the surface, whatever camera saw it. The normal is the area-weighted one.
    """
    n, best = len(xyz), np.zeros(len(xyz))
    found = Directions(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, bool))
    for k, view in enumerate(_views(xyz, faces, rig, T)):
        slope, fits = _star_slopes(view, n, np.ravel(clean[k]), rig)
        normal, score = view.vertex_normals(n), view.star(view.pixels * view.cosine, n)
        direction, steep = lift(slope, normal, view.points, T[k], rig)
        better = fits & steep & view.star_counts(n) & (score > best)
        best[better] = score[better]
        found.direction[better], found.normal[better], found.ok[better] = direction[better], normal[better], True
    return found


def one_view_directions(
    xyz, faces, rig: Rig, T, images, seed: int | None = 0, centering: str | None = None, how: str = "gradient"
) -> tuple[Directions, np.ndarray]:
    """T-MAHF of each vertex in one keyframe in which its whole star counts: its direction, and its magnitude (N,).

    The keyframe is one by chance, as a single frame gives it; without a seed that which has most of the star. So with
    noise-free images and no seed it is what the filter itself says of the surface, free of noise. `how` as in `lift`.
    """
    complex_, n = build_complex(faces, len(xyz)), len(xyz)
    rng, best, magnitude = np.random.default_rng(seed), np.full(n, -1.0), np.zeros(n)
    found = Directions(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, bool))
    for k, view in enumerate(_views(xyz, faces, rig, T)):
        uv, normal = _seen_pixels(view.points, rig), view.vertex_normals(n)
        response = tmahf(complex_, uv, sample_signals(images[k], uv, complex_), centering=centering)
        slope = np.stack([response.z.real, response.z.imag], axis=1)
        direction, steep = lift(slope, normal, view.points, T[k], rig, how)
        score = view.star(view.pixels * view.cosine, n) if seed is None else rng.random(n)
        better = response.defined & steep & view.star_counts(n) & (score > best)
        best[better], magnitude[better] = score[better], response.magnitude[better]
        found.direction[better], found.normal[better], found.ok[better] = direction[better], normal[better], True
    return found, magnitude


def direction_errors(direction, magnitude, ok, true: Directions):
    """Angles between directions and the true ones in the tangent plane, degrees, over the strongest half by magnitude.

    Of vertices that have both. Compare two ways of finding directions over the same `ok`.
    """
    chosen = np.asarray(ok, bool) & true.ok
    given, magnitude = np.asarray(direction, np.float64)[chosen], np.asarray(magnitude)[chosen]
    normal, right = true.normal[chosen], true.direction[chosen]
    strong = magnitude >= np.median(magnitude) if len(magnitude) else np.zeros(0, bool)
    given = given - (given * normal).sum(axis=1, keepdims=True) * normal
    across = (np.cross(right, given) * normal).sum(axis=1)
    return np.rad2deg(np.abs(np.arctan2(across, (given * right).sum(axis=1))))[strong]


def lift(slope, normal, points, pose, rig: Rig, how: str = "gradient"):
    """Unit tangents (N, 3) in the world of directions (N, 2) in the image of one camera, and where there is one.

    `points` and the plane of `normal` are at the vertices, `points` in the camera's frame, `normal` in the world's.
    "gradient": the slope is one of luminance, and its tangent the same for every camera, ``E Eᵀ Jᵀ g``. "projection":
    the tangent that projects along the slope, ``E (J E)⁻¹ g``. "turned": as little turned between the two planes as can
    be, ``E Q g`` with Q the nearest rotation to ``(J E)ᵀ``.
    """
    axes = _axes(normal)  # (N, 2, 3)
    seen = axes @ pose[:3, :3]
    x, y, z = points.T
    with np.errstate(all="ignore"):
        zero = np.zeros_like(z)
        J = np.stack([
            np.stack([rig.fx / z, rig.skew / z, -(rig.fx * x + rig.skew * y) / z**2], axis=-1),
            np.stack([zero, rig.fy / z, -rig.fy * y / z**2], axis=-1),
        ], axis=1)  # fmt: skip
        JE = np.einsum("nij,nkj->nik", J, seen)
        along = np.einsum("nik,ni->nk", _matrix(JE, how), slope)
        size = np.linalg.norm(along, axis=1)
        ok = (z > 0) & np.isfinite(size) & (size > 0)
        along = np.where(ok[:, None], along / size[:, None], 0)
    return np.einsum("nk,nkj->nj", along, axes), ok


def _matrix(JE, how: str):
    """(N, 2, 2) M: a slope g in the image becomes ``Mᵀ g`` in the tangent plane."""
    if how == "gradient":
        return JE
    a, b, c, d = JE[:, 0, 0], JE[:, 0, 1], JE[:, 1, 0], JE[:, 1, 1]
    cofactors = np.stack([np.stack([d, -c], axis=-1), np.stack([-b, a], axis=-1)], axis=1)
    sign = np.sign(a * d - b * c)[:, None, None]
    if how == "projection":
        return sign * cofactors
    if how == "turned":
        return JE + sign * cofactors  # along the nearest rotation, or reflection, to a 2 x 2 matrix
    raise ValueError(f"how is {how!r}, expected 'gradient', 'projection' or 'turned'")


def _axes(normal):
    """(N, 2, 3) two axes across each normal."""
    other = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, other)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    return np.stack([first, np.cross(normal, first)], axis=1)


class _View(NamedTuple):
    """One keyframe's view of all faces: which own its pixels, and how each of them stands there."""

    faces: np.ndarray
    points: np.ndarray
    owner: np.ndarray
    pixels: np.ndarray
    cosine: np.ndarray
    counts: np.ndarray
    normal: np.ndarray

    def sums(self, values):
        """(F,) of a value (H·W,) over the pixels of each face."""
        owned = self.owner >= 0
        return np.bincount(self.owner[owned], values[owned], minlength=len(self.faces))

    def star(self, values, n: int):
        """(N,) of a value (F,) over the faces of each vertex."""
        return np.bincount(self.faces.ravel(), np.repeat(values, 3), minlength=n)

    def star_counts(self, n: int):
        """(N,) bool: which vertices have faces, all of which count or are too small for a pixel."""
        bad = ~self.counts & ~((self.pixels == 0) & (self.cosine >= LEAST_COSINE))
        return (self.star(bad, n) == 0) & (self.star(np.ones(len(self.faces)), n) > 0)

    def vertex_normals(self, n: int):
        """(N, 3) area-weighted unit normals, towards the camera."""
        normal = np.stack([self.star(self.normal[:, d], n) for d in range(3)], axis=1)
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


def _views(xyz, faces, rig: Rig, T):
    faces, xyz = np.asarray(faces, np.int64), np.asarray(xyz, np.float64)
    a, b, c = (xyz[faces[:, k]] for k in range(3))
    normal, centre = np.cross(b - a, c - a), (a + b + c) / 3
    for pose, (_, owner) in zip(T, two_layers(xyz, faces, rig, T, step=1), strict=True):
        front, back = (owner[..., k].ravel() for k in (0, 1))
        owned, hidden = (np.bincount(layer[layer >= 0], minlength=len(faces)) for layer in (front, back))
        sight = pose[:3, 3] - centre
        across = (normal * sight).sum(axis=1)
        size = np.linalg.norm(normal, axis=1) * np.linalg.norm(sight, axis=1)
        cosine = np.abs(across) / np.maximum(size, 1e-300)
        points = to_camera(xyz, pose)
        inside = np.isfinite(_seen_pixels(points, rig)[:, 0])[faces].all(axis=1)
        counts = inside & (owned > 0) & (hidden <= HIDDEN * (owned + hidden)) & (cosine >= LEAST_COSINE)
        # a hidden face without a pixel of its own is not too small for one
        cosine = np.where(inside & ((owned > 0) | (hidden == 0)), cosine, 0)
        towards = normal * np.where(across < 0, -1.0, 1.0)[:, None]
        yield _View(faces, points, front, owned, cosine, counts, towards)


def _seen_pixels(points, rig: Rig):
    """(N, 2) where points project, NaN outside the image."""
    before = points[:, 2] > 0
    uv = pixels(np.where(before[:, None], points, 1.0), lens_of(rig))
    inside = before & (uv >= 0).all(axis=1) & (uv <= (rig.width - 1, rig.height - 1)).all(axis=1)
    return np.where(inside[:, None], uv, np.nan)


def _star_slopes(view: _View, n: int, image, rig: Rig):
    """(N, 2) slope of the plane through the luminance of each star's pixels, per px, and where it is well founded."""
    v, u = (np.ravel(each).astype(np.float64) for each in np.mgrid[: rig.height, : rig.width])
    one, image = np.ones_like(u), np.asarray(image, np.float64)
    products = (one, u, v, image, u * u, u * v, v * v, u * image, v * image)
    count, *sums = (view.star(view.sums(each), n) for each in products)
    with np.errstate(all="ignore"):
        u, v, s, uu, uv, vv, us, vs = (each / count for each in sums)
        uu, uv, vv, us, vs = uu - u * u, uv - u * v, vv - v * v, us - u * s, vs - v * s
        det = uu * vv - uv * uv
        least = (uu + vv) / 2 - np.sqrt(((uu - vv) / 2) ** 2 + uv * uv)
        slope = np.stack([vv * us - uv * vs, uu * vs - uv * us], axis=1) / det[:, None]
        return np.nan_to_num(slope), (count >= STAR_PIXELS) & (least >= STAR_SPREAD)
