"""Stereo points denoised, beside the truth: ``python -m benchmarks.uses.cloud [--docs FOLDER] [--development]``.

Scored: Motorcycle's measured disparities; 5 frames each of street, corridor and room, seeds 0 to 2, with the faults of
``benchmarks.mapping``. Constants were chosen on seeds 100 and 101 of these, 3 frames each, and on heaps of round and
square things: ``--development``. Recordings, where TSPSLAM_DATA has them, have no truth here: of those the flatness of
the road is told.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.spatial import cKDTree

from benchmarks.mapping import FAULTS, KITTI, list_table
from tspslam import OrbDetector, datasets, delaunay_surface, reconstruct
from tspslam.apps import _cloud
from tspslam.apps.cloud import denoise_cloud
from tspslam.datasets import synthetic
from tspslam.errors import InputError
from tspslam.io import read_image
from tspslam.topology.complex import build_complex
from tspslam.topology.texture import luminance
from tspslam.types import Cloud, StereoPair, Surface
from tspslam.vision.rig import back_project, covariance
from tspslam.vision.stereo.dense import sample_map
from tspslam.vision.stereo.sgbm import SgbmMatcher

SCENES = {
    "street": (lambda seed: synthetic.street(60.0, step=0.75, seed=seed), KITTI),
    "corridor": (lambda seed: synthetic.corridor(40.0, step=0.5, seed=seed), synthetic.PAPER_RIG),
    "room": (lambda seed: synthetic.room(laps=1.2, frames=160, seed=seed), synthetic.PAPER_RIG),
}  # the worlds of benchmarks.mapping
MATCHERS = {
    "default": {},
    "8000 keypoints": {"detector": OrbDetector(count=8000)},
    "paper": {"preset": "paper"},
    "sgbm": {"matcher": SgbmMatcher()},
    "sgbm, 20 000 keypoints": {"detector": OrbDetector(count=20_000), "matcher": SgbmMatcher()},
}
RECORDED = {
    "kitti_seq1": ("image_l/000000.png", "image_r/000000.png"),
    "kitti_05": ("image_0/000000.png", "image_1/000000.png"),
}  # left and right image of one pair each
NEAR_STEP = 3  # px around a point in which the true disparity jumps
STEP = 2.0  # px of disparity
CAP = 3.0  # px: larger errors count as this in the mean


@dataclass(frozen=True)
class Item:
    """A pair with true disparities at the points of its cloud (NaN where not known), and which are near steps."""

    name: str
    pair: StereoPair
    cloud: Cloud
    surface: Surface
    truth: np.ndarray
    near_step: np.ndarray


Method = Callable[[Item], np.ndarray]


def items(matcher: str, development: bool) -> Iterator[Item]:
    seeds, count = ((100, 101), 3) if development else ((0, 1, 2), 5)
    if not development:
        yield _item("Motorcycle", datasets.motorcycle(), datasets.samples.motorcycle_truth(), matcher)
    for name, (make, rig) in (SCENES | (HEAPS if development else {})).items():
        for seed in seeds:
            sequence = synthetic.SyntheticSequence(make(seed), rig, FAULTS)
            for frame in (np.linspace(0.1, 0.9, count) * len(sequence)).astype(int).tolist():
                truth = np.asarray(sequence.geometry(frame).disparity, np.float64)
                yield _item(name, sequence[frame], truth, matcher)


def heap(things: int, seed: int) -> synthetic.Scene:
    """Balls, rings and boxes of 3 to 60 cm at 1.6 to 4 m, before a wall and over a floor."""
    rng = np.random.default_rng((17, seed))

    def look() -> synthetic.Texture:
        return synthetic.Texture(int(rng.integers(1 << 31)), 0.004, rng.uniform(0.3, 0.7), rng.uniform(0.4, 0.9))

    wall, floor = (synthetic.plane(12, 8, texture=look()) for _ in range(2))
    shapes = [wall.at(0, 0, 4.5), floor.at(0, 1.1, 2.5, turn=(np.pi / 2, 0, 0))]
    for k in range(things):
        z = rng.uniform(1.6, 4.0)
        x, y, turn = rng.uniform(-0.6, 0.6) * z, rng.uniform(-0.45, 0.3) * z, rng.uniform(-1.5, 1.5, 3)
        if k % 3 == 0:
            shape = synthetic.sphere(rng.uniform(0.05, 0.3), rows=24, texture=look())
        elif k % 3 == 1:
            major = rng.uniform(0.1, 0.4)
            shape = synthetic.torus(major, major * rng.uniform(0.1, 0.4), rows=20, columns=60, texture=look())
        else:
            shape = synthetic.box(*rng.uniform(0.03, 0.5, 3), texture=look())
        shapes.append(shape.at(x, y, z, turn=turn))
    path = np.eye(4)[None].repeat(3, axis=0)
    path[:, 0, 3] = (-0.5, 0.0, 0.5)
    return synthetic.Scene(tuple(shapes), path, leaves=seed, name="heap")


HEAPS = {
    "heap of 30": (lambda seed: heap(30, seed), synthetic.PAPER_RIG),
    "heap of 150": (lambda seed: heap(150, seed), synthetic.PAPER_RIG),
}


def _item(name: str, pair: StereoPair, truth: np.ndarray, matcher: str) -> Item:
    cloud = reconstruct(pair, **MATCHERS[matcher])
    known = np.where(np.isfinite(truth), truth, 0.0)
    size = 2 * NEAR_STEP + 1
    jumps = maximum_filter(known, size) - minimum_filter(known, size) > STEP
    row, column = np.floor(cloud.uv[:, ::-1] + 0.5).astype(int).T
    return Item(name, pair, cloud, delaunay_surface(cloud), sample_map(truth, cloud.uv), jumps[row, column])


def ours(item: Item) -> np.ndarray:
    return denoise_cloud(item.cloud, item.surface, item.pair.left).disparity


def ours_without_image(item: Item) -> np.ndarray:
    """On a grey image: every fold has the wide tolerance."""
    grey = np.full(item.pair.left.shape[:2], 0.5)
    return denoise_cloud(item.cloud, item.surface, grey).disparity


def vertices_only(item: Item, weight: float = 0.1, crease: float = 1.0) -> np.ndarray:
    """The same robust least squares on differences along edges: no faces. Constants of its own, development data."""
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import spsolve

    d = item.cloud.disparity
    B = build_complex(item.surface.faces, len(d)).B1.T.astype(float) / np.sqrt(2)
    noise = 1.4826 * np.median(np.abs(B @ d))
    moved = d.copy()
    for _ in range(8):
        w = weight / (1 + (B @ moved / (crease * noise)) ** 2) ** 2
        pull = 1 / (1 + ((moved - d) / (2 * noise)) ** 2)
        moved = spsolve((diags_array(pull) + B.T @ diags_array(w) @ B).tocsc(), pull * d)
    return d + np.clip(moved - d, -3 * noise, 3 * noise)


def sgbm(item: Item) -> np.ndarray:
    """OpenCV's semi-global matching at the same points; the point's own disparity where it knows none."""
    d = item.cloud.disparity
    found = sample_map(SgbmMatcher().disparity_map(item.pair, d.min() - 5, d.max() + 5), item.cloud.uv)
    return np.where(np.isfinite(found), found, d)


def medians(item: Item) -> Iterator[np.ndarray]:
    for count in (4, 8, 16, 32):
        yield np.median(item.cloud.disparity[_near(item, count)], axis=1)


def bilateral_means(item: Item) -> Iterator[np.ndarray]:
    """Means over 32 neighbours, by distance in the image, luminance and disparity; widths of a grid."""
    rows = _near(item, 32)
    uv, d = item.cloud.uv, item.cloud.disparity
    u, v = np.floor(uv.T + 0.5).astype(int)
    grey = luminance(item.pair.left)[v, u]
    apart = ((uv[rows] - uv[:, None]) ** 2).sum(axis=2)
    for place in (4.0, 8.0, 16.0, 32.0):  # px
        for shade in (0.02, 0.05, 0.15, np.inf):
            for depth in (0.25, 0.5, 1.0, 2.0, np.inf):  # px
                x = (
                    apart / place**2
                    + ((grey[rows] - grey[:, None]) / shade) ** 2
                    + ((d[rows] - d[:, None]) / depth) ** 2
                )
                weight = np.exp(-x / 2)
                yield (weight * d[rows]).sum(axis=1) / weight.sum(axis=1)


def _near(item: Item, count: int) -> np.ndarray:
    """Each point and its nearest ones in the image."""
    return cKDTree(item.cloud.uv).query(item.cloud.uv, min(count + 1, len(item.cloud)))[1]


def oracle(every: Callable[[Item], Iterator[np.ndarray]]) -> Method:
    """Of all results the one with the least median error: it looks at the truth."""

    def best(item: Item) -> np.ndarray:
        return min(every(item), key=lambda d: np.nanmedian(np.abs(d - item.truth)))

    return best


def bound(item: Item) -> np.ndarray:
    """About what flatness can do at most: least squares that know the noise and the size of every true fold."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import spsolve

    complex_ = build_complex(item.surface.faces, len(item.cloud))
    corners, _ = _cloud.find_hinges(complex_.edges, complex_.faces, complex_.face_edges)
    c = np.empty(corners.shape)
    _cloud.fold_coefficients(item.cloud.uv, corners, np.ones(len(item.cloud)), c)
    rows = np.repeat(np.arange(len(c)), 4)
    C = csr_array((c.ravel(), (rows, corners.ravel().astype(np.int64))), shape=(len(c), len(item.cloud)))
    d = item.cloud.disparity
    noise = 1.4826 * np.nanmedian(np.abs(d - item.truth))
    folds = np.nan_to_num(np.abs(C @ item.truth) / noise, nan=1e6)
    moved, fixed = d.copy(), C.T @ diags_array(1 / np.maximum(folds, 0.1) ** 2) @ C
    for _ in range(5):
        pull = 1 / (1 + ((moved - d) / (2 * noise)) ** 2)
        moved = spsolve((diags_array(pull) + fixed).tocsc(), pull * d)
    return moved


METHODS: dict[str, Method] = {
    "raw": lambda item: item.cloud.disparity,
    "ours": ours,
    "ours, image left out": ours_without_image,
    "ours on vertices only": vertices_only,
    "median of neighbours, best": oracle(medians),
    "bilateral mean, best": oracle(bilateral_means),
    "OpenCV's SGBM there": sgbm,
    "true folds known (a bound)": bound,
}


def measured(item: Item, d: np.ndarray) -> np.ndarray:
    """Median error, px; share within 1 px; mean of capped errors, px; the latter of points near steps."""
    known = np.isfinite(item.truth)
    error = np.abs(d - item.truth)[known]
    near = error[item.near_step[known]]
    capped = np.minimum(error, CAP)
    return np.array([np.median(error), np.mean(error <= 1), capped.mean(), np.minimum(near, CAP).mean()])


def measure(matcher: str, development: bool, methods: list[str]) -> dict[str, dict[str, np.ndarray]]:
    """For each kind of item and method: figures of all items, (K, 4)."""
    found: dict[str, dict[str, list[np.ndarray]]] = {}
    points: dict[str, list[int]] = {}
    for item in items(matcher, development):
        row = found.setdefault(item.name, {method: [] for method in methods})
        points.setdefault(item.name, []).append(len(item.cloud))
        for method in methods:
            row[method].append(measured(item, METHODS[method](item)))
    print(f"{matcher}: points { ({name: round(np.mean(count)) for name, count in points.items()}) }")
    return {name: {method: np.array(rows) for method, rows in row.items()} for name, row in found.items()}


def compared(rows: np.ndarray, raw: np.ndarray) -> list[str]:
    """Cells of the table: median; its ratio (worst); share; its change (worst); ratios of means, all and at steps."""
    ratio, gain = rows[:, 0] / raw[:, 0], 100 * (rows[:, 1] - raw[:, 1])
    return [
        f"{rows[:, 0].mean():.3f}",
        f"{ratio.mean():.2f} ({ratio.max():.2f})",
        f"{100 * rows[:, 1].mean():.2f}",
        f"{gain.mean():+.2f} ({gain.min():+.2f})",
        f"{(rows[:, 2] / raw[:, 2]).mean():.2f}",
        f"{(rows[:, 3] / raw[:, 3]).mean():.2f}",
    ]


def table(found: dict[str, dict[str, np.ndarray]]) -> list[list[str]]:
    return [[name, method, *compared(rows, row["raw"])] for name, row in found.items() for method, rows in row.items()]


def pages(found: dict[str, dict[str, dict[str, np.ndarray]]]) -> str:
    """Two tables: all methods on the points of `reconstruct`, and ours on those of other matchers."""
    first = found["default"]
    methods = [[method, *(_cell(row, method) for row in first.values())] for method in METHODS]
    others = [[name, *(f"{_cell(row, 'raw')}: {_cell(row, 'ours')}" for row in each.values())]
              for name, each in found.items()]  # fmt: skip
    return f"{list_table(['', *first], methods)}\n{list_table(['points of', *first], others)}"


def _cell(row: dict[str, np.ndarray], method: str) -> str:
    median, _, share, gain, *_ = compared(row[method], row["raw"])
    if method == "raw":
        return f"{median} px; {share} %"
    return f"{compared(row[method], row['raw'])[1]}; {gain.split()[0]}"


def random_points(n: int, seed: int = 0) -> tuple[StereoPair, Cloud]:
    """Points of Motorcycle at random places with their measured disparities and noise of 0.3 px."""
    pair, rng = datasets.motorcycle(), np.random.default_rng(seed)
    uv = rng.uniform(0, 1, (2 * n, 2)) * (pair.rig.width - 1, pair.rig.height - 1)
    true = sample_map(datasets.samples.motorcycle_truth(), uv)
    uv, true = uv[np.isfinite(true)][:n], true[np.isfinite(true)][:n]
    d = true + rng.normal(0, 0.3, n)
    return pair, Cloud(back_project(pair.rig, uv, d), uv, d, covariance(pair.rig, uv, d, 0.5))


def seconds(run: Callable[[], object], count: int = 7) -> float:
    run()
    taken = []
    for _ in range(count):
        started = time.perf_counter()
        run()
        taken.append(time.perf_counter() - started)
    return float(np.median(taken))


def timed(n: int = 20_000) -> str:
    """Time of ours beside one implicit smoothing of the same disparities, SciPy's sparse solver."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import spsolve

    pair, cloud = random_points(n)
    surface = delaunay_surface(cloud)
    L0 = build_complex(surface.faces, n).L0
    own = seconds(lambda: denoise_cloud(cloud, surface, pair.left))
    other = seconds(lambda: spsolve((eye_array(n) + L0).tocsc(), cloud.disparity))
    return f"{n} points: {1000 * own:.0f} ms; (1 + L0)^-1 by SciPy's solver: {1000 * other:.0f} ms"


def recorded(folder: Path) -> Iterator[str]:
    """Of recordings, how far points of the road are off one plane before and after, and how many points move far."""
    for name, (left, right) in RECORDED.items():
        try:
            left_image, right_image = (read_image(folder / name / side) for side in (left, right))
            height, width = left_image.shape[:2]
            pair = StereoPair(left_image, right_image, replace(KITTI, width=width, height=height), name=name)
        except InputError as error:
            yield f"{name}: left out: {error}"
            continue
        cloud = reconstruct(pair, detector=OrbDetector(count=8000))
        flat = denoise_cloud(cloud, delaunay_surface(cloud), pair.left)
        before, after = off_road(pair, cloud.uv, cloud.disparity, flat.disparity)
        far = 100 * np.mean(np.abs(flat.disparity - cloud.disparity) > 1)
        yield f"{name}: road off its plane {before:.3f} -> {after:.3f} px; {far:.2f} % of points move over 1 px"


def off_road(pair: StereoPair, uv: np.ndarray, *disparities: np.ndarray) -> list[float]:
    """Mean distance from one plane of the points in the lower middle of the image that are within 1 px of it, px."""
    u, v = uv[:, 0] / pair.rig.width, uv[:, 1] / pair.rig.height
    road = (np.abs(u - 0.5) < 0.1 + 0.4 * (v - 0.6)) & (v > 0.6)
    A = np.column_stack([np.ones(road.sum()), uv[road]])
    near = np.ones(len(A), bool)
    found = []
    for d in disparities:  # the points of the first one's road
        off = _off_plane(A[near], d[road][near])
        if not found:
            near = off < 1
        found.append(float(_off_plane(A[near], d[road][near]).mean()))
    return found


def _off_plane(A: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Distances from a plane that far points do not turn."""
    off, weight = np.zeros(len(d)), np.ones(len(d))
    for _ in range(30):
        off = np.abs(A @ np.linalg.lstsq(A * weight[:, None], d * weight, rcond=None)[0] - d)
        weight = 1 / (1 + (off / 0.3) ** 2)
    return off


def draw(folder: Path) -> None:
    """Faces lit by their slopes: raw, ours, truth; of Motorcycle and of a room."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    chosen = [next(items("default", False)), next(item for item in items("default", True) if item.name == "room")]
    for item, name in zip(chosen, ("uses_cloud.png", "uses_cloud_room.png"), strict=True):
        figure, axes = plt.subplots(1, 3, figsize=(12, 3), layout="constrained")
        known = np.isfinite(item.truth)
        faces = item.surface.faces[known[item.surface.faces].all(axis=1)]
        shown = {"measured": item.cloud.disparity, "denoised": ours(item), "true": item.truth}
        for axis, (title, d) in zip(axes, shown.items(), strict=True):
            lit = _lit(item.cloud.uv, d, faces)
            axis.tripcolor(*item.cloud.uv.T, faces, facecolors=lit, cmap="gray", vmin=0, vmax=1)
            axis.set(title=title, aspect="equal", xlim=(0, item.pair.rig.width), ylim=(item.pair.rig.height, 0))
            axis.axis("off")
        figure.savefig(folder / name, dpi=80)
        plt.close(figure)


def _lit(uv: np.ndarray, d: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Light on the faces of the surface of disparities over the image, 10 px of height for each, from upper left."""
    corners = np.column_stack([uv, 10 * np.where(np.isfinite(d), d, 0)])[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.abs(normal @ (np.array([-1, -1, 1.2]) / np.linalg.norm([-1, -1, 1.2])))


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--development", action="store_true", help="seeds 100 and 101, no Motorcycle")
    parser.add_argument("--docs", type=Path, help="write the table and the pictures there")
    given = parser.parse_args(arguments)
    found = {}
    for matcher in MATCHERS:
        methods = list(METHODS) if matcher == "default" else ["raw", "ours"]
        found[matcher] = measure(matcher, given.development, methods)
        for row in table(found[matcher]):
            print(matcher, *row, sep=" | ", flush=True)
    print(timed())
    data = os.environ.get("TSPSLAM_DATA")
    for line in recorded(Path(data)) if data and not given.development else ():
        print(line, flush=True)
    if given.docs:
        (given.docs / "uses_cloud.inc").write_text(pages(found), encoding="utf-8")
        draw(given.docs / "images")


if __name__ == "__main__":
    main(sys.argv[1:])
