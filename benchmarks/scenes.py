"""What is measured: Delaunay meshes of random points over the real Motorcycle image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

import tspslam


@dataclass(frozen=True)
class Scene:
    """An image, points in it, and their triangles."""

    image: NDArray[np.uint8]
    uv: NDArray[np.float64]
    faces: NDArray[np.int32]


def grey_motorcycle(scale: int = 1) -> NDArray[np.uint8]:
    """Green channel of the left image, each pixel repeated `scale` times in both directions."""
    green = np.ascontiguousarray(tspslam.datasets.motorcycle().left[:, :, 1])
    return np.kron(green, np.ones((scale, scale), np.uint8))


def random_scene(n: int, scale: int = 1) -> Scene:
    """`n` points in random order, uniform over the image."""
    image = grey_motorcycle(scale)
    uv = np.random.default_rng(0).random((n, 2)) * (np.array(image.shape[::-1]) - 1)
    return Scene(image, uv, Delaunay(uv).simplices.astype(np.int32))


def in_scan_order(scene: Scene) -> Scene:
    """The same mesh, its vertices numbered along the rows of the image, its faces by their first vertices."""
    order = np.lexsort((scene.uv[:, 0], np.floor(scene.uv[:, 1])))
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order), dtype=np.int32)
    faces = number[scene.faces]
    return Scene(scene.image, scene.uv[order], faces[np.argsort(faces.min(axis=1), kind="stable")])


def stage(scene: Scene) -> tspslam.Response:
    """The topology stage: complex, neighbourhoods, signals, T-MAHF; triangulation not counted."""
    complex_ = tspslam.build_complex(scene.faces, len(scene.uv))
    complex_.neighbours()
    signals = tspslam.sample_signals(scene.image, scene.uv, complex_)
    return tspslam.tmahf(complex_, scene.uv, signals)
