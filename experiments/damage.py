"""Damaged meshes (flipped edges, deleted faces, jittered keypoints), and how far responses move by them."""

from __future__ import annotations

import numpy as np

import tspslam

from .common import degrees_between


def flip(faces: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Turn the diagonal of a share of the edges with two faces; no face is touched twice, no edge made twice.

    Where the share is more than can be turned so, fewer are turned: `share_flipped` tells how many.
    """
    complex_ = tspslam.build_complex(faces, int(faces.max()) + 1)
    sides = complex_.face_edges.ravel()
    order, count = np.argsort(sides, kind="stable"), np.bincount(sides)
    first = np.cumsum(count) - count
    inner = np.flatnonzero(count == 2)
    known, touched, flipped = {*map(tuple, complex_.edges.tolist())}, set(), complex_.faces.copy()
    wanted = round(share * len(inner))
    for edge in rng.permutation(inner):
        f, g = (order[first[edge] + k] // 3 for k in (0, 1))
        i, j = complex_.edges[edge]
        a, b = (int(complex_.faces[face].sum() - i - j) for face in (f, g))
        if wanted == 0 or {f, g} & touched or (min(a, b), max(a, b)) in known:
            continue
        flipped[f], flipped[g] = (a, b, i), (a, b, j)
        touched |= {f, g}
        known.add((min(a, b), max(a, b)))
        wanted -= 1
    return flipped


def share_flipped(faces: np.ndarray, flipped: np.ndarray) -> float:
    """Share of the edges with two faces that `flip` has turned: each turned edge has changed two faces."""
    complex_ = tspslam.build_complex(faces, int(faces.max()) + 1)
    changed = (np.sort(complex_.faces, axis=1) != np.sort(flipped, axis=1)).any(axis=1).sum()
    return changed / 2 / (np.bincount(complex_.face_edges.ravel()) == 2).sum()


def damaged(frame, kind: str, amount: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Faces and keypoints after the damage."""
    faces, uv = frame.surface.faces, frame.cloud.uv
    if kind == "flip":
        return flip(faces, amount, rng), uv
    if kind == "delete":
        return faces[np.sort(rng.permutation(len(faces))[round(amount * len(faces)) :])], uv
    return faces, np.clip(uv + rng.normal(0, amount, uv.shape), 0, (frame.rig.width - 1, frame.rig.height - 1))


def moved(before: tspslam.Response | None, after: tspslam.Response | None) -> tuple[float, float]:
    """Median |r' - r| over the median |r|, and median change of phase, degrees."""
    if before is None or after is None:
        return np.nan, np.nan
    both = before.defined & after.defined
    a, b = after.z[both], before.z[both]
    return np.median(np.abs(a - b)) / np.median(np.abs(b)), np.median(degrees_between(a, b))
