"""Meshes that a store must keep whole, and what a filter over them gives in memory."""

import numpy as np
from scipy.spatial import Delaunay

import tspslam
from tspslam.io import write_png
from tspslam.scale import ImageReference

FAR, BENT = 0.35, 0.2


def tangled(seed, n=40):
    """Points in random order with triangles in random order: a few twice, some across the whole, vertices without any.

    Returns xyz (N, 3), faces (F, 3), uv (N, 2) within 60 x 50 px.
    """
    rng = np.random.default_rng(seed)
    uv = rng.random((n, 2)) * [59, 49]
    faces = Delaunay(uv[: n - 2]).simplices
    across = np.array([rng.choice(n - 2, 3, replace=False) for _ in range(6)])  # edges from one end to the other
    faces = np.concatenate([faces, across, faces[:3, [1, 2, 0]]])
    rng.shuffle(faces)
    return np.column_stack([uv / 10, 5 + rng.random(n)]), faces, uv


def picture(seed, path, shape=(50, 60)):
    image = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
    write_png(path, image)
    return image


def two_images(folder):
    """Two overlapping tiles of one plane, and their pixels."""
    references = [ImageReference(str(folder / f"{k}.png"), origin=(25.0 * k, 0.0)) for k in range(2)]
    return references, [picture(k, folder / f"{k}.png", (50, 36)) for k in range(2)]


def whole(xyz, faces, uv, image, references, pixels, **options):
    """Responses of the whole mesh in memory, for each image by itself."""
    complex_ = tspslam.build_complex(faces, len(xyz))
    z, defined = np.zeros(len(xyz), complex), np.zeros(len(xyz), bool)
    for k, (reference, plane) in enumerate(zip(references, pixels, strict=True)):
        places = reference.places(xyz, uv)
        response = tspslam.tmahf(complex_, places, tspslam.sample_signals(plane, places, complex_), **options)
        z[image == k], defined[image == k] = response.z[image == k], response.defined[image == k]
    return z, defined


def same_bits(response, z, defined):
    return response.z.tobytes() == z.tobytes() and np.array_equal(response.defined, defined)
