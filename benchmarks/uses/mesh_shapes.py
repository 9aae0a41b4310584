"""Shapes made in code, for choosing the constants of `denoise_mesh`: CAD-like ones with creases, and smooth ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

Mesh = tuple[np.ndarray, np.ndarray]


def polycube(solid: np.ndarray) -> Mesh:
    """The border of a set of unit cubes, two triangles a square, turned outwards."""
    padded = np.pad(solid, 1)
    corners = []
    for axis in range(3):
        for sign in (1, -1):
            cells = np.argwhere(padded & ~np.roll(padded, -sign, axis))
            one, two = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            base = cells + (np.eye(3, dtype=int)[axis] if sign > 0 else 0)
            ring = (0 * one, one, one + two, two)[::sign]
            corners.append(np.stack([base + step for step in ring], axis=1))
    quads = np.concatenate(corners)
    xyz, index = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    quads = index.reshape(-1, 4)
    return xyz.astype(float), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def irregular(mesh: Mesh, amount: float, seed: int) -> Mesh:
    """A polycube with vertices moved within their planes and creases, and diagonals turned at random."""
    xyz, faces = mesh
    rng = np.random.default_rng(seed)
    half = len(faces) // 2
    a, b, c, d = faces[:half, 0], faces[:half, 1], faces[:half, 2], faces[half:, 2]
    turn = rng.random(half) < 0.5
    first = np.where(turn[:, None], np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    second = np.where(turn[:, None], np.stack([b, c, d], 1), np.stack([a, c, d], 1))
    blocked = np.zeros(xyz.shape, bool)  # polycubes: normals lie along the axes
    normals = np.abs(np.cross(xyz[b] - xyz[a], xyz[c] - xyz[a])) > 0.5
    for corner in (a, b, c, d):
        np.logical_or.at(blocked, corner, normals)
    moved = xyz + np.where(blocked, 0, rng.uniform(-amount, amount, xyz.shape))
    return moved, np.concatenate([first, second])


def solid(name: str, n: int) -> np.ndarray:
    """Sets of cubes: a plate with a hole, stairs, an L with a slot, a cross, a plain block."""
    x, y, z = np.indices((n, n, n)) / n
    return {
        "block": z < 0.5,
        "hole": (z < 0.5) & ~((abs(x - 0.5) < 0.2) & (abs(y - 0.5) < 0.25)),
        "stairs": z < 1 - np.floor(4 * x) / 4,
        "slot": ((x < 0.4) | (z < 0.35)) & ~((abs(y - 0.5) < 0.12) & (z > 0.2)),
        "cross": (abs(x - 0.5) < 0.2) | (abs(y - 0.5) < 0.2) & (z < 0.7),
    }[name]


def as_disc(p: np.ndarray) -> np.ndarray:
    """Squares become discs: blocks turn into cylinders."""
    x, y, z = (2 * p - 1).T
    return np.column_stack([x * np.sqrt(1 - y * y / 2), y * np.sqrt(1 - x * x / 2), z])


def as_arch(p: np.ndarray) -> np.ndarray:
    """Bend along x by 100°."""
    return np.column_stack([(1 + p[:, 1]) * np.cos(1.75 * p[:, 0]), (1 + p[:, 1]) * np.sin(1.75 * p[:, 0]), p[:, 2]])


def as_wedge(p: np.ndarray) -> np.ndarray:
    """Taper and shear: angles from 60° to 120°."""
    s = 1 - 0.45 * p[:, 2]
    return np.column_stack([(p[:, 0] - 0.5) * s + 0.3 * p[:, 1], (p[:, 1] - 0.5) * s, p[:, 2]])


def as_twisted(p: np.ndarray) -> np.ndarray:
    """Turn by 70° along z."""
    a, q = 1.2 * p[:, 2], p - 0.5
    return np.column_stack(
        [np.cos(a) * q[:, 0] - np.sin(a) * q[:, 1], np.sin(a) * q[:, 0] + np.cos(a) * q[:, 1], p[:, 2]]
    )


def as_dome(p: np.ndarray) -> np.ndarray:
    """Flat and curved faces: the top bulges, creases turn obtuse."""
    q = p - 0.5
    return np.column_stack(
        [p[:, 0], p[:, 1] * (1 + 0.3 * p[:, 0]), p[:, 2] * (1 - 0.8 * q[:, 0] ** 2 - 0.8 * q[:, 1] ** 2)]
    )


def block_mesh(name: str, warp: Callable | None, n: int, amount: float, seed: int) -> Mesh:
    """A polycube, made irregular and bent."""
    xyz, faces = irregular(polycube(solid(name, n)), amount, seed)
    unit = (xyz - 1) / n
    return (warp(unit) if warp else unit), faces


def crowded(p: np.ndarray) -> np.ndarray:
    """Unit coordinates drawn together in places: spacing from a fifth to nearly twice the mean."""
    return p + 0.8 * np.sin(2 * np.pi * p) / (2 * np.pi)


def sphere(n: int, radius: Callable | None, seed: int, spread: float = 0.3, flat: float = 1.0) -> Mesh:
    """A sphere of spread-out points, their hull's triangles, each point moved out to ``radius(direction)``.

    `flat` below 1 crowds points at the equator.
    """
    rng = np.random.default_rng(seed)
    i = np.arange(n) + 0.5
    z, a = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
    p = np.column_stack([np.sqrt(1 - z * z) * np.cos(a), np.sqrt(1 - z * z) * np.sin(a), z])
    p += rng.uniform(-1, 1, p.shape) * spread * np.sqrt(4 * np.pi / n)
    p *= (1, 1, flat)
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    faces = ConvexHull(p).simplices
    inward = (
        np.einsum(
            "ij,ij->i", np.cross(p[faces[:, 1]] - p[faces[:, 0]], p[faces[:, 2]] - p[faces[:, 0]]), p[faces[:, 0]]
        )
        < 0
    )
    faces[inward] = faces[inward][:, ::-1]
    return (p if radius is None else p * radius(p)[:, None]), faces


def bumpy(p: np.ndarray) -> np.ndarray:
    """Smooth bumps."""
    return 1 + 0.1 * np.sin(4 * p[:, 0]) * np.sin(5 * p[:, 1] + 1) + 0.07 * np.cos(6 * p[:, 2])


def grooved(p: np.ndarray) -> np.ndarray:
    """Sharp grooves along three circles."""
    depth = [
        np.clip(0.12 - abs(p @ a - c), 0, None)
        for a, c in ((np.array([0, 0, 1.0]), 0), (np.array([0.8, 0, 0.6]), 0.3), (np.array([0, 1.0, 0]), -0.4))
    ]
    return 1 - 1.2 * np.maximum.reduce(depth)


def shallow(p: np.ndarray) -> np.ndarray:
    """Shallow grooves along four circles."""
    circles = (((0, 0, 1), 0), ((0.8, 0, 0.6), 0.3), ((0, 1, 0), -0.4), ((0.6, 0.8, 0), 0.2))
    return 1 - 0.7 * np.maximum.reduce([np.clip(0.12 - abs(p @ np.array(a) - c), 0, None) for a, c in circles])


def facetted(p: np.ndarray) -> np.ndarray:
    """A dodecahedron-like solid: the hull of planes at 12 directions; its creases run across the triangles."""
    g = (1 + 5**0.5) / 2
    a = np.array([(0, s, t * g) for s in (1, -1) for t in (1, -1)])
    normals = np.concatenate([a, np.roll(a, 1, 1), np.roll(a, 2, 1)]) / np.sqrt(1 + g * g)
    return 1 / (p @ normals.T).max(axis=1)


def grid(rows: int, columns: int) -> np.ndarray:
    """Triangles of a grid that closes both ways."""
    i, j = np.divmod(np.arange(rows * columns), columns)
    right, down = i * columns + (j + 1) % columns, (i + 1) % rows * columns + j
    both = (i + 1) % rows * columns + (j + 1) % columns
    here = np.arange(rows * columns)
    return np.concatenate([np.column_stack([here, right, both]), np.column_stack([here, both, down])])


def torus(rows: int, columns: int, large: float = 1.0, small: float = 0.4) -> Mesh:
    """The torus on a grid of its angles."""
    i, j = np.divmod(np.arange(rows * columns), columns)
    a, b = 2 * np.pi * j / columns, 2 * np.pi * i / rows
    ring = large + small * np.cos(b)
    return np.column_stack([ring * np.cos(a), ring * np.sin(a), small * np.sin(b)]), grid(rows, columns)


def sheet(n: int, height: Callable, seed: int) -> Mesh:
    """An open graph over random points of the unit square."""
    rng = np.random.default_rng(seed)
    side = int(n**0.5)
    uv = (
        np.stack(np.meshgrid(*2 * [np.arange(side)]), -1).reshape(-1, 2) + rng.uniform(0.1, 0.9, (side * side, 2))
    ) / side
    return np.column_stack([uv, height(uv[:, 0], uv[:, 1])]), without_slivers(uv, Delaunay(uv).simplices)


def without_slivers(uv: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces with no angle under 10°: the hull's flat triangles go."""
    sides = uv[np.roll(faces, 1, axis=1)] - uv[faces]
    before = -np.roll(sides, 1, axis=1)
    cosine = (sides * before).sum(2) / np.linalg.norm(sides, axis=2) / np.linalg.norm(before, axis=2)
    return faces[(cosine < np.cos(np.radians(10))).all(axis=1)]


def development(seed: int = 100) -> dict[str, Mesh]:
    """All shapes for development, 2 000 to 9 000 vertices."""
    knot, faces = torus(60, 90, 1, 0.5)
    return {
        "hole": block_mesh("hole", None, 26, 0.25, seed),
        "hole regular": block_mesh("hole", None, 22, 0.0, seed),
        "stairs wedge": block_mesh("stairs", as_wedge, 28, 0.3, seed),
        "slot arch": block_mesh("slot", as_arch, 26, 0.25, seed),
        "cylinder": block_mesh("block", as_disc, 34, 0.25, seed),
        "ring": block_mesh("hole", as_disc, 36, 0.2, seed),
        "cross twisted": block_mesh("cross", as_twisted, 28, 0.3, seed),
        "slot dome": block_mesh("slot", as_dome, 30, 0.3, seed),
        "facetted": sphere(5000, facetted, seed),
        "grooved": sphere(8000, grooved, seed),
        "shallow grooves": sphere(8000, shallow, seed),
        "grooved uneven": sphere(9000, grooved, seed, 0.3, 0.25),
        "slot uneven": block_mesh("slot", crowded, 26, 0.15, seed),
        "bumpy": sphere(6000, bumpy, seed),
        "sphere": sphere(4000, None, seed, 0.6),
        "saddle": sheet(5000, lambda x, y: 0.8 * (x - 0.5) ** 2 - 0.8 * (y - 0.5) ** 2 + 0.1 * np.sin(6 * x), seed),
        "ridge": sheet(5000, lambda x, y: 0.3 * abs(x + 0.3 * y - 0.6) + 0.1 * y * y, seed),
        "torus stretched": (knot * [1, 1.4, 0.8], faces),
    }


def with_noise(mesh: Mesh, level: float, kind: str, seed: int) -> np.ndarray:
    """Normal noise of `level` mean edges: along vertex normals, or on each axis."""
    xyz, faces = mesh
    rng = np.random.default_rng(seed)
    sigma = level * mean_edge(xyz, faces)
    if kind == "axes":
        return xyz + rng.normal(0, sigma, xyz.shape)
    around = np.zeros(xyz.shape)
    for corner in range(3):
        np.add.at(around, faces[:, corner], areas_and_normals(xyz, faces))
    length = np.linalg.norm(around, axis=1, keepdims=True)
    return xyz + rng.normal(0, sigma, (len(xyz), 1)) * around / np.maximum(length, 1e-300)


def areas_and_normals(xyz: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals as long as twice the area."""
    return np.cross(xyz[faces[:, 1]] - xyz[faces[:, 0]], xyz[faces[:, 2]] - xyz[faces[:, 0]])


def mean_edge(xyz: np.ndarray, faces: np.ndarray) -> float:
    """Mean length of the distinct edges."""
    pairs = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    return float(np.linalg.norm(xyz[pairs[:, 0]] - xyz[pairs[:, 1]], axis=1).mean())


def normal_error(xyz: np.ndarray, truth: np.ndarray, faces: np.ndarray) -> float:
    """Mean angle between normals of corresponding faces, degrees."""
    a, b = areas_and_normals(xyz, faces), areas_and_normals(truth, faces)
    sine, cosine = np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ij,ij->i", a, b)
    return float(np.degrees(np.arctan2(sine, cosine)).mean())


def snr(estimate: np.ndarray, truth: np.ndarray) -> float:
    """Signal-to-noise ratio, dB."""
    return float(10 * np.log10(((truth - truth.mean(0)) ** 2).sum() / ((estimate - truth) ** 2).sum()))
