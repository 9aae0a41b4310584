"""What quality is measured with elsewhere. Every score grows with the distortion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree
from skimage.metrics import structural_similarity

from tspslam._jit import kernel
from tspslam.types import Rig

from .quality_data import Item

ASIDE = np.radians([0, 20, -20])  # of the three views: turned about the middle of the reference
NEIGHBOURS = 20  # of a quadric, and of a neighbourhood of features


def psnr(reference: Item, other: Item) -> float:
    """Minus the peak signal-to-noise ratio of vertex luminance, dB: nearest vertices, the worse of both ways."""
    a, b = reference.side.signals.vertex, other.side.signals.vertex
    there, back = cKDTree(other.xyz).query(reference.xyz)[1], cKDTree(reference.xyz).query(other.xyz)[1]
    if len(a) == len(b):  # elements of the same number correspond
        there = back = np.arange(len(a))
    worst = max(np.mean((a - b[there]) ** 2), np.mean((b - a[back]) ** 2))
    return 10 * math.log10(max(worst, 1e-12))


def point_to_plane(reference: Item, other: Item) -> float:
    """Root mean square distance of vertices to the plane at the nearest vertex, m: the larger of both ways."""
    return max(_to_plane(reference, other), _to_plane(other, reference))


def _to_plane(one: Item, other: Item) -> float:
    nearest = cKDTree(other.xyz).query(one.xyz)[1]
    gap = ((one.xyz - other.xyz[nearest]) * normals(other)[nearest]).sum(axis=1)
    return float(np.sqrt(np.mean(gap**2)))


def normals(item: Item) -> NDArray[np.float64]:
    """Of the vertices, weighted by area: the faces are wound alike as the camera sees them."""
    corner = item.xyz[item.faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    rows, columns = item.faces.ravel(), np.repeat(np.arange(len(item.faces)), 3)
    total = csr_array(coo_array((np.ones(len(rows)), (rows, columns)), (len(item.xyz), len(item.faces)))) @ across
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300)


def rendered_ssim(reference: Item, other: Item) -> float:
    """One minus the mean structural similarity of three rendered views."""
    middle = np.median(reference.xyz, axis=0)
    pairs = [[render(item, angle, middle) for item in (reference, other)] for angle in ASIDE]
    return 1 - float(np.mean([structural_similarity(a, b, data_range=1.0) for a, b in pairs]))


def render(item: Item, angle: float, middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a camera sees that was turned about `middle`: vertex luminance, linear over each face; grey elsewhere."""
    c, s = np.cos(angle), np.sin(angle)
    xyz = (item.xyz - middle) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) + middle
    rig: Rig = item.rig
    image, inverse = np.full((rig.height, rig.width), 0.5), np.zeros((rig.height, rig.width))
    z = np.maximum(xyz[:, 2], 1e-9)
    uvw = np.column_stack([rig.fx * xyz[:, 0] / z + rig.cx, rig.fy * xyz[:, 1] / z + rig.cy, 1 / z])
    faces = item.faces[(xyz[item.faces, 2] > 0.05).all(axis=1)]
    _draw(uvw, item.side.signals.vertex, faces, image, inverse)
    return image


@kernel
def _draw(uvw, value, faces, image, inverse):  # type: ignore[no-untyped-def]
    """Fill triangles into a buffer of inverse depth, both linear on the screen."""
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, bx, by, cx, cy = uvw[i, 0], uvw[i, 1], uvw[j, 0], uvw[j, 1], uvw[k, 0], uvw[k, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        top, bottom = max(math.ceil(min(ay, by, cy)), 0), min(math.floor(max(ay, by, cy)), image.shape[0] - 1)
        left, right = max(math.ceil(min(ax, bx, cx)), 0), min(math.floor(max(ax, bx, cx)), image.shape[1] - 1)
        for v in range(top, bottom + 1):
            for u in range(left, right + 1):
                b = ((u - ax) * (cy - ay) - (cx - ax) * (v - ay)) / area
                c = ((bx - ax) * (v - ay) - (u - ax) * (by - ay)) / area
                a = 1.0 - b - c
                near = a * uvw[i, 2] + b * uvw[j, 2] + c * uvw[k, 2]
                if a >= -1e-9 and b >= -1e-9 and c >= -1e-9 and near > inverse[v, u]:
                    inverse[v, u] = near
                    image[v, u] = a * value[i] + b * value[j] + c * value[k]


def features(reference: Item, other: Item) -> float:
    """In the manner of PCQM (Meynet 2020), grey, equal weights: curvature and luminance over neighbourhoods.

    Comparison, contrast and structure of both, between the vertices of the reference and the nearest of the other.
    """
    nearest = cKDTree(other.xyz).query(reference.xyz)[1]
    around = cKDTree(reference.xyz).query(reference.xyz, k=NEIGHBOURS)[1]
    size = float(np.median(np.linalg.norm(reference.xyz - reference.xyz[around[:, 5]], axis=1)))
    curvature = [curvatures(reference.xyz) * size, curvatures(other.xyz)[nearest] * size]
    light = [reference.side.signals.vertex, other.side.signals.vertex[nearest]]
    return float(np.mean([_compared(*pair, around) for pair in (curvature, light)]))


def _compared(x: NDArray[np.float64], y: NDArray[np.float64], around: NDArray[np.int64], k: float = 0.01) -> float:
    a, b = x[around], y[around]
    mean, contrast = (a.mean(axis=1), b.mean(axis=1)), (a.std(axis=1), b.std(axis=1))
    together = ((a - mean[0][:, None]) * (b - mean[1][:, None])).mean(axis=1)
    level = np.abs(mean[0] - mean[1]) / (np.maximum(*np.abs(mean)) + k)
    spread = np.abs(contrast[0] - contrast[1]) / (np.maximum(*contrast) + k)
    product = contrast[0] * contrast[1]
    structure = np.abs(product - together) / (product + k**2)
    return float(np.mean([level.mean(), spread.mean(), structure.mean()]))


def curvatures(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean curvature at each vertex, 1/m, unsigned: quadric over the nearest vertices' plane."""
    around = cKDTree(xyz).query(xyz, k=min(NEIGHBOURS, len(xyz)))[1]
    d = xyz[around] - xyz[around].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nkx,nky->nxy", d, d))
    h, u, v = np.moveaxis(np.einsum("nkx,nxa->nka", d, axes), 2, 0)
    size = np.sqrt((u**2 + v**2).mean(axis=1, keepdims=True)) + 1e-12
    u, v, h = u / size, v / size, h / size
    design = np.stack([u**2, u * v, v**2, u, v, np.ones_like(u)], axis=2)
    square = np.einsum("nki,nkj->nij", design, design) + 1e-6 * np.eye(6)
    a, b, c, p, q, _ = np.linalg.solve(square, np.einsum("nki,nk->ni", design, h)[..., None])[..., 0].T
    bend = ((1 + q**2) * a - p * q * b + (1 + p**2) * c) / (1 + p**2 + q**2) ** 1.5
    return np.abs(bend) / size[:, 0]
