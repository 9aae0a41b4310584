"""Meshes and images that the laws are stated on."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from tspslam import Complex, build_complex


def noise(shape=(40, 60), seed=0, dtype=np.uint8):
    high = {np.dtype(np.uint8): 256, np.dtype(np.uint16): 65536}.get(np.dtype(dtype))
    rng = np.random.default_rng(seed)
    return rng.integers(0, high, shape).astype(dtype) if high else rng.random(shape).astype(dtype)


def scattered(n=40, size=(60, 40), seed=0, margin=0.0) -> tuple[np.ndarray, Complex]:
    """Random points in an image of `size` (width, height) px and their Delaunay complex."""
    rng = np.random.default_rng(seed)
    uv = margin + rng.random((n, 2)) * (np.array(size) - 1 - 2 * margin)
    return uv, build_complex(Delaunay(uv).simplices, n)


def torus_faces(rows=12, columns=16) -> np.ndarray:
    i, j = np.divmod(np.arange(rows * columns), columns)
    right, down = i * columns + (j + 1) % columns, (i + 1) % rows * columns + j
    across = (i + 1) % rows * columns + (j + 1) % columns
    here = i * columns + j
    return np.concatenate([np.stack([here, right, across], 1), np.stack([here, across, down], 1)])


def grid_faces(rows=5, columns=6) -> np.ndarray:
    here = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    return np.concatenate(
        [np.stack([here, here + 1, here + columns], 1), np.stack([here + 1, here + columns, here + columns + 1], 1)]
    )


OCTAHEDRON = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
FIGURE_2 = np.array([[1, 3, 4], [1, 2, 3], [2, 3, 5]]) - 1
