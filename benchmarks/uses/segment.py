"""Regions of surfaces beside named baselines: python -m benchmarks.uses.segment [--docs docs] [--development].

Rooms, corridors and streets with a known truth (docs/uses_protocol.rst, "Segmentation"); with recordings (TSPSLAM_DATA)
a labelled room of points and a frame of NYU with normals.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import Delaunay
from skimage.segmentation import felzenszwalb, slic

import tspslam
from benchmarks.uses import segment_measures as measures
from tspslam.apps import _segment as kernels
from tspslam.apps import segment as apps
from tspslam.datasets import synthetic
from tspslam.types import FloatArray, IntArray, Signals

KINDS = ("room", "corridor", "street")
SCALES = np.geomspace(0.05, 20, 14)
VERTEX_SCALES = np.geomspace(0.01, 20, 18)
VERTEX_LUMINANCE, VERTEX_STEP = 0.025, 0.08  # chosen by --development
FELZENSZWALB = (30, 100, 200, 300, 500, 1000, 3000)
SLIC = (5, 10, 20, 40, 80, 160)
KMEANS = (2, 4, 6, 8, 12, 20, 40)


@dataclass
class Item:
    """A complex with what it shows and the truth about it."""

    kind: str
    name: str
    image: Any
    uv: FloatArray
    xyz: FloatArray | None
    covariance: FloatArray | None
    normals: FloatArray | None
    complex_: Any
    signals: Signals
    truth: IntArray
    weight: FloatArray

    def __post_init__(self) -> None:
        self.pairs, self.edge = kernels.pairs_at_edges(self.complex_.face_edges, len(self.complex_.edges))
        if self.image is not None:
            self.cover = measures.covered(self.complex_.faces, self.uv, self.image.shape[:2])
            self.border = self.borders(self.truth)

    def borders(self, labels: IntArray) -> Any:
        """Pixels of the edges between labels."""
        ends = self.uv[self.complex_.edges[self.edge]]
        return measures.borders(labels, self.pairs, ends, self.image.shape[:2])

    def score(self, labels: IntArray) -> tuple[float, float, float, float]:
        """Adjusted Rand index, boundary F, under-segmentation error, number of regions."""
        rand = measures.adjusted_rand(self.truth, labels, self.weight)
        f = measures.boundary_f(self.border, self.borders(labels)) if self.image is not None else np.nan
        return rand, f, measures.under_segmentation(self.truth, labels, self.weight), float(len(np.unique(labels)))


def world(kind: str, seed: int, share: float) -> Item:
    """A frame of a world, as a user has it: matched, triangulated, sampled."""
    sequence = synthetic.SyntheticSequence(
        getattr(synthetic, kind)(seed=seed), faults=synthetic.Faults(noise=0.01), seed=seed
    )
    place = int(share * len(sequence))
    pair, cloud = sequence[place], tspslam.reconstruct(sequence[place])
    complex_ = tspslam.build_complex(tspslam.delaunay_surface(cloud).faces, len(cloud.xyz))
    signals = tspslam.sample_signals(pair.left, cloud.uv, complex_)
    label = sequence.geometry(place).label
    truth = measures.carried(label, measures.covered(complex_.faces, cloud.uv, label.shape), len(complex_.faces))
    return Item(
        kind, f"{kind} {seed} at {share:g}", pair.left, cloud.uv, cloud.xyz, cloud.covariance, None, complex_, signals,
        truth, signals.face_pixels.astype(float),
    )  # fmt: skip


def worlds(seeds: range) -> list[Item]:
    """Two frames of each world of each seed."""
    return [world(kind, seed, share) for kind in KINDS for seed in seeds for share in (0.25, 0.75)]


def ours(item: Item) -> Callable[[float], IntArray]:
    """The public function, at any scale; one tree serves all."""
    points = apps._positions(item.complex_, item.xyz, item.covariance)
    sums, weight, floor = apps._gathered(item.complex_, item.signals, None, item.normals, points)
    tree = kernels.merge_tree(sums, item.pairs, apps._length(item.signals, item.pairs, item.edge), weight, floor)
    return lambda scale: kernels.cut_tree(*tree, len(item.truth), apps.MERGE * scale)


def on_vertices(item: Item, luminance: float, step: float) -> Callable[[float], IntArray]:
    """The same energies and merges on vertices, joined by bare edges; faces take the majority of their corners."""
    complex_, signals = item.complex_, item.signals
    sums = np.zeros((complex_.n, kernels.GEOMETRY + 3))
    points = apps._positions(complex_, item.xyz, item.covariance)
    for v in range(complex_.n if points is not None else 0):
        kernels.add_point(points.xyz[v], points.covariance[v], float(points.known[v]), sums[v])
    if item.normals is not None:
        sums[:, kernels.NORMALS : kernels.GEOMETRY] = np.column_stack([np.ones(complex_.n), item.normals])
    value, ok = signals.vertex, signals.vertex_ok
    sums[:, kernels.GEOMETRY :] = ok[:, None] * np.stack([np.ones(complex_.n), value, value**2], axis=1)
    pairs = complex_.edges.astype(np.int64)
    change = value[pairs[:, 0]] - value[pairs[:, 1]]
    length = apps.JOINS + (1 - apps.JOINS) * np.exp(-((change / step) ** 2))
    tree = kernels.merge_tree(sums, pairs, length, np.array([luminance]), np.array([apps.DARKEST]))

    def cut(scale: float) -> IntArray:
        corner = kernels.cut_tree(*tree, complex_.n, apps.MERGE * scale)[complex_.faces]
        return np.where(corner[:, 1] == corner[:, 2], corner[:, 1], corner[:, 0])

    return cut


def felzenszwalb_carried(item: Item) -> Callable[[float], IntArray]:
    """Felzenszwalb and Huttenlocher's regions of the image, the majority in each face."""
    return lambda scale: measures.carried(
        felzenszwalb(item.image, scale=scale, sigma=0.8, min_size=50), item.cover, len(item.truth)
    )


def slic_carried(item: Item) -> Callable[[float], IntArray]:
    """SLIC's superpixels of the image, the majority in each face."""
    axis = None if item.image.ndim == 2 else -1
    return lambda scale: measures.carried(
        slic(item.image, n_segments=int(scale), compactness=0.1 if axis is None else 10.0, channel_axis=axis),
        item.cover, len(item.truth),
    )  # fmt: skip


def kmeans(item: Item) -> Callable[[float], IntArray]:
    """k-means of luminance, position and normal of faces, each of unit variance."""
    faces = item.complex_.faces
    columns = [item.signals.face[:, None]]
    if item.xyz is not None:
        corners = item.xyz[faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal *= np.sign((normal * corners[:, 0]).sum(axis=1, keepdims=True))  # away from the camera
        columns += [corners.mean(axis=1), normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)]
    elif item.normals is not None:
        columns += [item.uv[faces].mean(axis=1), item.normals[faces].mean(axis=1)]
    features = np.concatenate(columns, axis=1)
    features = (features - features.mean(axis=0)) / np.maximum(features.std(axis=0), 1e-12)
    return lambda scale: kmeans2(features, int(scale), minit="++", rng=0, iter=30)[1]


METHODS: dict[str, tuple[Callable[[Item], Callable[[float], IntArray]], Any]] = {
    "ours": (ours, SCALES),
    "ours at scale 1": (ours, (1.0,)),
    "on vertices only": (lambda item: on_vertices(item, VERTEX_LUMINANCE, VERTEX_STEP), VERTEX_SCALES),
    "Felzenszwalb": (felzenszwalb_carried, FELZENSZWALB),
    "SLIC": (slic_carried, SLIC),
    "k-means": (kmeans, KMEANS),
}


def best(items: list[Item], method: Callable[[Item], Callable[[float], IntArray]], scales: Any) -> tuple[Any, float]:
    """Scores (items, 4) at the one scale whose mean of Rand index and F is largest over the items, and that scale."""
    table = []
    for item in items:
        at = method(item)
        table.append([item.score(at(scale)) for scale in scales])
    scores = np.array(table)
    k = int(np.argmax(np.nanmean(scores[:, :, :2], axis=(0, 2))))
    return scores[:, k], float(scales[k])


def rows_of(items: list[Item], methods: Any) -> list[list[str]]:
    """A row for each kind and method: means, worst Rand index, regions, scale; kinds together in the end."""
    rows, kinds = [], dict.fromkeys(item.kind for item in items)
    everything: dict[str, list[Any]] = {name: [] for name in methods}
    for kind in kinds:
        for name, (method, scales) in methods.items():
            scores, scale = best([item for item in items if item.kind == kind], method, scales)
            everything[name].append(scores)
            rows.append(row(kind, name, scores, f"{scale:.3g}"))
            print("  ".join(rows[-1]), flush=True)
    for name in methods if len(kinds) > 1 else ():
        rows.append(row("all", name, np.concatenate(everything[name]), ""))
        print("  ".join(rows[-1]), flush=True)
    return rows


def row(kind: str, name: str, scores: Any, scale: str) -> list[str]:
    rand, f, leak, count = scores.mean(axis=0)
    return [kind, name, f"{rand:.3f}", f"{scores[:, 0].min():.3f}", "" if np.isnan(f) else f"{f:.3f}", f"{leak:.3f}",
            f"{count:.0f}", scale]  # fmt: skip


def unmarked(complex_: Any) -> Signals:
    """Signals of which none is known."""
    n, e, f = complex_.n, len(complex_.edges), len(complex_.faces)
    return Signals(
        np.zeros(n), np.zeros(e), np.zeros(f), np.zeros((e, 2)), np.zeros((f, 2)), np.zeros(e, np.int32),
        np.zeros(f, np.int32), np.zeros(n, bool), np.zeros(e, bool), np.zeros(f, bool),
    )  # fmt: skip


def labelled_room(folder: Path) -> Item:
    """Points of a room thinned to 5 cm, their crust, no image; a face has the label of most of its corners."""
    data = (folder / "room1_gt_fine.pcd").read_bytes()
    kind = np.dtype([("xyz", "<f4", 3), ("label", "<u4")])
    points = np.frombuffer(data[data.index(b"DATA binary\n") + 12 :], kind, 237907)
    points = points[np.isfinite(points["xyz"]).all(axis=1)]
    _, first = np.unique(np.floor(points["xyz"] / 0.05).astype(np.int64), axis=0, return_index=True)
    xyz, label = points["xyz"][np.sort(first)].astype(float), points["label"][np.sort(first)].astype(np.int64)
    complex_ = tspslam.build_complex(tspslam.crust_surface(xyz).faces, len(xyz))
    corner = label[complex_.faces]
    truth = np.where(corner[:, 1] == corner[:, 2], corner[:, 1], corner[:, 0])
    signals = unmarked(complex_)
    return Item(
        "labelled room", "room1", None, xyz[:, :2], xyz, None, None, complex_, signals, truth, np.ones(len(truth))
    )


def nyu_frame(folder: Path) -> Item:
    """Colours, normals and 13 classes at 4 000 random places; its depth is a coloured picture, without a scale."""
    from PIL import Image

    picture, label = (np.asarray(Image.open(folder / f"{name}.png").convert("RGB")) for name in ("image", "semantic13"))
    height, width = picture.shape[:2]
    coded = Image.open(folder / "normal.png").convert("RGB").resize((width, height), Image.Resampling.NEAREST)
    uv = np.random.default_rng(0).uniform((10, 10), (width - 11, height - 11), (4000, 2))
    column, line = np.floor(uv + 0.5).astype(int).T
    normals = np.asarray(coded)[line, column] / 127.5 - 1
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    complex_ = tspslam.build_complex(Delaunay(uv).simplices.astype(np.int32), len(uv))
    signals = tspslam.sample_signals(picture, uv, complex_)
    colours = label.astype(np.int64) @ (1, 256, 65536)
    truth = measures.carried(colours, measures.covered(complex_.faces, uv, (height, width)), len(complex_.faces))
    weight = np.where(truth == 0, 0.0, signals.face_pixels)  # black is not labelled
    return Item("NYU frame", "nyu", picture, uv, None, None, normals, complex_, signals, truth, weight)


def timed(n: int = 20_000) -> list[list[str]]:
    """Milliseconds for two noisy planes of n vertices, beside Felzenszwalb on the image that they show."""
    rng = np.random.default_rng(0)
    uv = rng.uniform(0, 1000, (n, 2))
    image = np.where(np.arange(1001) < 500, 0.3, 0.6) + rng.normal(0, 0.05, (1001, 1001))
    image = np.clip(image, 0, 1)
    xyz = np.column_stack([uv, np.abs(uv[:, 0] - 500) + rng.normal(0, 1, n)]) / 100
    complex_ = tspslam.build_complex(Delaunay(uv).simplices.astype(np.int32), n)
    signals = tspslam.sample_signals(image, uv, complex_)
    rows = []
    for name, work in (
        (f"ours, {n} vertices, {len(complex_.faces)} faces", lambda: apps.segment(complex_, signals, xyz=xyz)),
        ("Felzenszwalb, image of 1001 × 1001", lambda: felzenszwalb(image, scale=300, sigma=0.8, min_size=50)),
    ):
        work()
        took = []
        for _ in range(9):
            start = time.process_time()
            work()
            took.append(time.process_time() - start)
        rows.append([name, f"{1e3 * np.median(took):.0f}"])
        print("  ".join(rows[-1]), "ms", flush=True)
    return rows


def choose_for_vertices(items: list[Item]) -> None:
    """Print what the method on vertices reaches on development data with each pair of its constants."""
    for luminance in (0.0, 0.025, 0.05, 0.1):
        for step in (0.08, 0.15, 0.3, 1e3):
            at = {"on vertices only": (lambda item, a=luminance, b=step: on_vertices(item, a, b), VERTEX_SCALES)}
            found = [best([i for i in items if i.kind == kind], *at["on vertices only"])[0] for kind in KINDS]
            print(luminance, step, np.concatenate(found).mean(axis=0).round(3).tolist(), flush=True)


def csv_table(title: str, head: str, rows: list[list[str]]) -> str:
    lines = [f".. csv-table:: {title}", f"   :header: {head}", ""]
    return "\n".join([*lines, *("   " + ", ".join(f'"{cell}"' for cell in cells) for cells in rows)]) + "\n\n"


def draw(path: Path, items: list[Item]) -> None:
    """The left image, the truth and our regions at scale 1 of one frame of each world."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, 3, figsize=(12, 9.2), layout="constrained")
    for axis, kind in zip(axes, KINDS, strict=True):
        item = next(item for item in items if item.kind == kind)
        axis[0].imshow(item.image, cmap="gray")
        for place, labels in zip(axis[1:], (item.truth, ours(item)(1.0)), strict=True):
            names = np.unique(labels, return_inverse=True)[1]
            tint = np.random.default_rng(3).permutation(names.max() + 1)[names].astype(float)
            place.tripcolor(item.uv[:, 0], item.uv[:, 1], item.complex_.faces, facecolors=tint, cmap="nipy_spectral")
            place.set(xlim=axis[0].get_xlim(), ylim=axis[0].get_ylim(), aspect=1)
        for place, title in zip(axis, (f"{kind}, left image", "objects", "regions at scale 1"), strict=True):
            place.set_title(title)
            place.set_axis_off()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=70)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", type=Path, help="folder of pages: write the tables and the picture there")
    parser.add_argument("--development", action="store_true", help="seeds 100 to 104 instead of 0 to 4, and no more")
    options = parser.parse_args()
    items = worlds(range(100, 105) if options.development else range(5))
    if options.development:
        choose_for_vertices(items)
        rows_of(items, METHODS)
        return
    head = "of, method, Rand index, worst, boundary F, leaks, regions, scale"
    text = csv_table("Worlds of seeds 0 to 4, two frames each", head, rows_of(items, METHODS))
    text += recordings(head)
    text += csv_table("Processor time, ms, one core, median of 9", "what, ms", timed())
    if options.docs:
        (options.docs / "uses_segment.inc").write_text(text)
        draw(options.docs / "images" / "uses_segment.png", items)


def recordings(head: str) -> str:
    """Tables of the recordings that are there."""
    folder, text = Path(os.environ.get("TSPSLAM_DATA", "")), ""
    if (folder / "labelled_room").is_dir():
        geometric = {name: METHODS[name] for name in ("ours", "ours at scale 1", "on vertices only", "k-means")}
        rows = rows_of([labelled_room(folder / "labelled_room")], geometric)
        text += csv_table("Labelled room: points alone, thinned to 5 cm", head, rows)
    if (folder / "nyu_frame").is_dir():
        rows = rows_of([nyu_frame(folder / "nyu_frame")], METHODS)
        text += csv_table("Frame of NYU: colour and normals, classes as objects", head, rows)
    return text


if __name__ == "__main__":
    main()
