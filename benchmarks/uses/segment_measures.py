"""How well regions of faces agree with objects: adjusted Rand index, boundary F, under-segmentation error."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from skimage.draw import line, polygon

from tspslam.types import FloatArray, IntArray

LEAK = 0.05  # share of a region that may lie over an object's border for free, Achanta 2012


def overlaps(truth: IntArray, labels: IntArray, weight: FloatArray) -> FloatArray:
    """Weight that each object (row) and each region (column) share, (objects, regions)."""
    (names, rows), (regions, columns) = (np.unique(x, return_inverse=True) for x in (truth, labels))
    shape = (len(names), len(regions))
    return np.asarray(coo_array((np.asarray(weight, float), (rows, columns)), shape=shape).toarray())


def adjusted_rand(truth: IntArray, labels: IntArray, weight: FloatArray) -> float:
    """Agreement of pairs of pixels, in place of elements, over that of chance; 1 where both partitions are one."""
    shared = overlaps(truth, labels, weight)
    both, objects, regions, total = (
        float((x * (x - 1)).sum() / 2) for x in (shared, shared.sum(axis=1), shared.sum(axis=0), shared.sum())
    )
    chance = objects * regions / total if total else 0.0
    most = (objects + regions) / 2
    return 1.0 if most == chance else (both - chance) / (most - chance)


def under_segmentation(truth: IntArray, labels: IntArray, weight: FloatArray) -> float:
    """How much of the regions leaks out of the objects they touch, over all weight; 0 where none crosses a border."""
    shared = overlaps(truth, labels, weight)
    size = shared.sum(axis=0)
    touched = shared > LEAK * size
    return float(((touched * size).sum() - size.sum()) / size.sum())


def borders(labels: IntArray, pairs: IntArray, ends: FloatArray, shape: tuple[int, int]) -> np.ndarray:
    """Pixels (H, W) bool of the edges whose two faces have different labels.

    `pairs` (E, 2) are the faces of each edge, `ends` (E, 2, 2) where its vertices are, px.
    """
    drawn = np.zeros(shape, bool)
    places = np.clip(np.floor(ends + 0.5).astype(int), 0, (shape[1] - 1, shape[0] - 1))
    for (u0, v0), (u1, v1) in places[labels[pairs[:, 0]] != labels[pairs[:, 1]]]:
        drawn[line(v0, u0, v1, u1)] = True
    return drawn


def boundary_f(truth: np.ndarray, found: np.ndarray, tolerance: float = 3.0) -> float:
    """Harmonic mean of the share of found pixels near a true one, and of true ones near a found one."""
    if not truth.any() or not found.any():
        return float(truth.any() == found.any())
    precision = (distance_transform_edt(~truth)[found] <= tolerance).mean()
    recall = (distance_transform_edt(~found)[truth] <= tolerance).mean()
    return float(2 * precision * recall / max(precision + recall, 1e-12))


def covered(faces: IntArray, uv: FloatArray, shape: tuple[int, int]) -> tuple[IntArray, IntArray]:
    """Pixels in each face, as face numbers and places in the flat image; the middle's where it covers none."""
    owner, place = [], []
    for f, corners in enumerate(uv[faces]):
        rows, columns = polygon(corners[:, 1], corners[:, 0], shape)
        if len(rows) == 0:
            u, v = np.clip(np.floor(corners.mean(axis=0) + 0.5).astype(int), 0, (shape[1] - 1, shape[0] - 1))
            rows, columns = np.array([v]), np.array([u])
        owner.append(np.full(len(rows), f))
        place.append(rows * shape[1] + columns)
    return np.concatenate(owner), np.concatenate(place)


def carried(image: IntArray, cover: tuple[IntArray, IntArray], count: int) -> IntArray:
    """The label that most pixels of each face show; of several the smallest."""
    owner, place = cover
    names, values = np.unique(image.ravel()[place], return_inverse=True)
    keys, times = np.unique(owner * len(names) + values, return_counts=True)
    order = np.lexsort((keys, -times, keys // len(names)))
    first = np.searchsorted(keys[order] // len(names), np.arange(count))
    return np.asarray(names[keys[order][first] % len(names)])
