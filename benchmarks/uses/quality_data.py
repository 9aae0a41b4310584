"""What quality is measured on: textured complexes, and eight distortions of them at seven levels.

Levels, written before the first score was: seven amounts of each distortion in equal steps of the logarithm of its
natural unit, from one that is hardly seen to one that is gross. `LEVELS` holds both ends. Each level draws its noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

import tspslam
from tspslam.datasets import synthetic
from tspslam.topology.complex import Complex
from tspslam.topology.texture import luminance
from tspslam.types import Cloud, Rig, Signals

STEPS = 7
LEVELS = {
    "position noise": (0.01, 0.64),  # standard deviation on each axis, in mean lengths of the edges at the vertex
    "quantisation": (0.035, 2.2),  # step of the grid, in median edge lengths: the same errors as the noise (step / √12)
    "decimation": (0.9, 0.05),  # share of the vertices that stays
    "blur": (0.5, 8.0),  # standard deviation of the normal kernel, px
    "JPEG": (20, 1000),  # scale of the quantisation tables, %: qualities 90 to 5 of the libjpeg scale
    "texture noise": (0.01, 0.32),  # standard deviation, luminance in [0, 1]; clipped
    "misregistration": (0.5, 16.0),  # shift of the image against the points, px, at 30° to its rows
    "exposure": (0.06, 2.0),  # stops darker
}
POSITIONS = ("position noise", "quantisation")


class Side(NamedTuple):
    """What is compared."""

    xyz: NDArray[np.float64]
    complex_: Complex
    signals: Signals


@dataclass(frozen=True)
class Item:
    """A textured complex and the image that it got its texture from, luminance in [0, 1]."""

    name: str
    image: NDArray[np.float64]
    rig: Rig
    xyz: NDArray[np.float64]
    uv: NDArray[np.float64]
    faces: NDArray[np.int32]
    seed: int

    @property
    def side(self) -> Side:
        complex_ = tspslam.build_complex(self.faces, len(self.xyz))
        return Side(self.xyz, complex_, tspslam.sample_signals(self.image, self.uv, complex_))


def amounts(kind: str) -> NDArray[np.float64]:
    return np.geomspace(*LEVELS[kind], STEPS)


def distorted(item: Item, kind: str, level: int) -> Item:
    """The item at one level of a distortion, 0 to 6."""
    amount = float(amounts(kind)[level])
    rng = np.random.default_rng([item.seed, list(LEVELS).index(kind), level])
    if kind == "position noise":
        return replace(item, xyz=item.xyz + amount * edge_at(item)[:, None] * rng.normal(size=item.xyz.shape))
    if kind == "quantisation":
        step = amount * float(np.median(edge_lengths(item)[1]))
        return replace(item, xyz=np.round(item.xyz / step) * step)
    if kind == "decimation":
        return decimated(item, amount, rng)
    return replace(item, image=np.clip(spoiled(item.image, kind, amount, rng), 0, 1))


def spoiled(image: NDArray[np.float64], kind: str, amount: float, rng: np.random.Generator) -> NDArray[np.float64]:
    if kind == "blur":
        return cv2.GaussianBlur(image, (0, 0), amount, borderType=cv2.BORDER_REPLICATE)
    if kind == "JPEG":
        quality = round(5000 / amount if amount >= 100 else 100 - amount / 2)
        _, code = cv2.imencode(".jpg", np.round(255 * image).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])
        return cv2.imdecode(code, cv2.IMREAD_GRAYSCALE) / 255
    if kind == "texture noise":
        return image + amount * rng.normal(size=image.shape)
    if kind == "misregistration":
        move = np.array([[1, 0, amount * np.cos(np.pi / 6)], [0, 1, amount * np.sin(np.pi / 6)]])
        return cv2.warpAffine(image, move, image.shape[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return image * 2.0**-amount


def decimated(item: Item, share: float, rng: np.random.Generator) -> Item:
    """Some vertices stay; each other one becomes the nearest of them along the edges, and faces that collapse go."""
    edges, lengths = edge_lengths(item)
    n = len(item.xyz)
    stays = np.zeros(n, bool)
    stays[rng.permutation(n)[: max(round(share * n), 4)]] = True
    graph = csr_array(coo_array((np.tile(np.maximum(lengths, 1e-12), 2), np.hstack([edges.T, edges.T[::-1]])), (n, n)))
    _, _, nearest = dijkstra(graph, indices=np.flatnonzero(stays), min_only=True, return_predecessors=True)
    nearest = np.where(nearest < 0, np.arange(n), nearest)
    number = np.cumsum(stays) - 1
    faces = number[nearest[item.faces]]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1) & stays[nearest[item.faces]].all(axis=1)
    return replace(item, xyz=item.xyz[stays], uv=item.uv[stays], faces=faces[whole].astype(np.int32))


def edge_lengths(item: Item) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    edges = tspslam.build_complex(item.faces, len(item.xyz)).edges
    return edges, np.linalg.norm(item.xyz[edges[:, 0]] - item.xyz[edges[:, 1]], axis=1)


def edge_at(item: Item) -> NDArray[np.float64]:
    """Mean length of the edges at each vertex, m."""
    edges, lengths = edge_lengths(item)
    n = len(item.xyz)
    count = np.bincount(edges.ravel(), minlength=n)
    return np.bincount(edges.ravel(), np.repeat(lengths, 2), n) / np.maximum(count, 1)


def development() -> list[Item]:
    box = synthetic.box(1.2, 1.0, 0.8, texture=synthetic.Texture(seed=100)).at(0, 0, 3, turn=(0.5, 0.6, 0))
    ball = synthetic.sphere(0.8, texture=synthetic.Texture(seed=101)).at(0, 0, 3)
    return [from_view("box", box, 2000, 100), from_view("sphere", ball, 2000, 101), motorcycle(2000, 102)]


def scored() -> list[Item]:
    ring = synthetic.torus(1.0, 0.4, texture=synthetic.Texture(seed=0)).at(0, 0, 4, turn=(np.pi / 4, 0, 0))
    worlds = (synthetic.room, synthetic.corridor, synthetic.street)
    frames = [from_scene(make.__name__, make(seed=0), 40, 4000, 0) for make in worlds]
    return [motorcycle(4000, 0), *frames, from_view("torus", ring, 4000, 0)]


def from_view(name: str, shape: synthetic.Shape, n: int, seed: int) -> Item:
    """What the paper's left camera sees of a shape on a grey ground."""
    return from_scene(name, synthetic.Scene((shape,), background=0.0, name=name), 0, n, seed)


def from_scene(name: str, scene: synthetic.Scene, frame: int, n: int, seed: int) -> Item:
    sequence = synthetic.SyntheticSequence(scene)
    pair, truth = sequence[frame], sequence.geometry(frame)
    return from_depth(name, luminance(pair.left), sequence.rig, truth.depth, n, seed)


def motorcycle(n: int, seed: int) -> Item:
    pair = tspslam.datasets.motorcycle()
    depth = pair.rig.fx * pair.rig.baseline / (tspslam.datasets.motorcycle_truth() + pair.rig.doffs)
    return from_depth("motorcycle", luminance(pair.left), pair.rig, depth, n, seed)


def from_depth(name: str, image: NDArray, rig: Rig, depth: NDArray, n: int, seed: int) -> Item:
    """Random pixels of known depth, triangulated in the image and cut at steps; vertices without a face go."""
    rows, columns = np.nonzero(np.isfinite(depth))
    chosen = np.random.default_rng(seed).choice(len(rows), n, replace=False)
    v, u = rows[chosen], columns[chosen]
    z = depth[v, u]
    uv = np.column_stack([u, v]).astype(np.float64)
    xyz = np.column_stack([(u - rig.cx) * z / rig.fx, (v - rig.cy) * z / rig.fy, z])
    faces = tspslam.delaunay_surface(Cloud(xyz, uv, rig.fx * max(rig.baseline, 0.1) / z)).faces
    used = np.unique(faces)
    number = np.zeros(n, np.int32)
    number[used] = np.arange(len(used))
    return Item(name, image, rig, xyz[used], uv[used], number[faces], seed)
