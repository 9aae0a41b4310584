"""Recognising places and things: ``python -m benchmarks.uses.recognise [--docs docs] [--development]``.

By docs/uses_protocol.rst. With --development the same measures on development data, for several weights beside words:
WEIGHTS were chosen by them, and that the mean over a recording is taken out of all descriptors of places. Recordings
are used where TSPSLAM_DATA has them.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import Delaunay

import tspslam
from tspslam import OrbDetector, Signals, StereoPair, build_complex, reconstruct, sample_signals, tmahf_bank
from tspslam.apps.recognise import compare_descriptors, describe
from tspslam.datasets import synthetic
from tspslam.io import read_image
from tspslam.topology.texture import luminance

from ..measure import median_seconds, table
from . import recognise_rivals as rivals
from .recognise_rivals import average_precision, recall_at_full_precision, recalled_keyframes

ORDERS, SCALES, LAYOUT = (1, 2), (1, 2, 3), (6, 3)
ASIDE, STOPS, NOISE, FRAMES = 0.3, 1.0, 0.01, 40  # m, of the second pass; luminance; frames of a pass
NEAR, TURNED = 1.0, 30.0  # m, degrees: the same place
FAR, AWAY = 2.0, 60.0  # m, degrees: another place; between the two a pair counts for nothing
TRY = (0.01, 0.02, 0.05, 0.1, 0.2)  # weights tried
WEIGHTS = {"response": 0.05, "gist-like (Gabor)": 0.05}  # beside words, chosen with --development
COLUMNS = ("pairs recalled at precision 1", "keyframes recalled at precision 1", "average precision")


class View(NamedTuple):
    """What a keyframe shows: (H, W) uint8, vertices, faces, and their places in space where known."""

    grey: np.ndarray
    uv: np.ndarray
    faces: np.ndarray
    xyz: np.ndarray | None = None


class Places(NamedTuple):
    """Keyframes of a recording and which pairs, later one first, show the same place, and which others."""

    name: str
    views: list[View]
    same: np.ndarray
    other: np.ndarray


def rooms(kind: str, seed: int) -> Places:
    """Two passes through a world: the second half a step on, moved aside, a stop brighter."""
    made = {
        "room": partial(synthetic.room, frames=2 * FRAMES), "corridor": partial(synthetic.corridor, FRAMES),
        "street": partial(synthetic.street, FRAMES, step=0.5),
    }  # fmt: skip
    scene = made[kind](seed=seed)
    first, second = scene.path[0 : 2 * FRAMES : 2], scene.path[1 : 2 * FRAMES : 2]
    path = np.concatenate([first, second @ synthetic.shapes.pose_at((ASIDE, 0, 0))])
    faults = synthetic.Faults(noise=NOISE, exposure=(0.0,) * FRAMES + (STOPS,) * FRAMES)
    sequence = synthetic.SyntheticSequence(replace(scene, path=path), faults=faults, seed=seed)
    views = [stereo_view(pair) for pair in sequence]
    is_later = np.arange(2 * FRAMES) >= FRAMES
    return Places(f"{kind} {seed}", views, *truth_of(path, is_later[:, None] & ~is_later))


def truth_of(T: np.ndarray, may_match: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of poses at the same place, and at another."""
    away = np.linalg.norm(T[:, None, :3, 3] - T[None, :, :3, 3], axis=2)
    cosine = (np.einsum("aij,bij->ab", T[:, :3, :3], T[:, :3, :3]) - 1) / 2
    turned = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return may_match & (away < NEAR) & (turned < TURNED), may_match & ((away > FAR) | (turned > AWAY))


def samples(folder: Path) -> Places:
    """Images of two passes through rooms; complexes of the image plane."""
    views = []
    for k in range(1, 85):
        grey = np.uint8(255 * luminance(read_image(folder / f"{k}.jpg")) + 0.5)
        uv = OrbDetector()(grey).uv
        views.append(View(grey, uv, Delaunay(uv).simplices if len(uv) > 2 else np.zeros((0, 3), np.int32)))
    same = read_image(folder / "samples_GT.bmp") > 0
    later = np.subtract.outer(np.arange(84), np.arange(84))
    return Places("rtabmap_samples", views, same & (later >= 10), ~same & (later >= 10))


def flight(folder: Path) -> Places:
    """Keyframes of a flight through a room, rectified; the same place over 10 s apart."""
    from scipy.spatial.transform import Rotation

    truth = np.loadtxt(folder / "stamped_groundtruth.txt")
    views, stamps, poses = [], [], []
    rectify = None
    for left in sorted((folder / "images").glob("*_0.jpg")):
        stamp = int(left.name.split("_")[0]) / 1e9
        row = truth[np.abs(truth[:, 0] - stamp).argmin()]
        if abs(row[0] - stamp) > 0.1:
            continue
        images = read_image(left), read_image(str(left).replace("_0.jpg", "_1.jpg"))
        rectify = rectify or tspslam.rectification(tspslam.read_calibration(folder, images[0].shape[1::-1]).cameras)
        views.append(stereo_view(StereoPair(*rectify(*images), rectify.rig)))
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = Rotation.from_quat(row[4:8]).as_matrix(), row[1:4]
        stamps.append(stamp)
        poses.append(pose)
    later = np.subtract.outer(stamps, stamps) > 10
    return Places("euroc_v101_keyframes", views, *truth_of(np.array(poses), later))


def things(seed: int) -> tuple[list[View], np.ndarray]:
    """20 views of 8 shapes, each with its own texture; the first of each is the known one."""
    views = []
    for c in range(8):
        rng = np.random.default_rng((seed, c))
        look = synthetic.Texture(
            int(rng.integers(1 << 31)), rng.uniform(0.003, 0.006), rng.uniform(0.4, 0.6), rng.uniform(0.7, 1)
        )
        make = (
            partial(synthetic.box, 0.9, 0.9, 0.9), partial(synthetic.sphere, 0.6),
            partial(synthetic.torus, 0.5, 0.22), partial(synthetic.box, 1.2, 0.5, 0.6),
        )[c % 4]  # fmt: skip
        shape = make(texture=look).at(0, 0, 2.5, turn=rng.uniform(-0.5, 0.5, 3))
        turns, far = np.r_[0, rng.uniform(0, 2 * np.pi, 19)], np.r_[1, rng.uniform(0.7, 1.4, 19)]
        path = [synthetic.shapes.pose_at((0, 0, 2.5 - 2.5 * f), (0, 0, t)) for f, t in zip(far, turns, strict=True)]
        scene = synthetic.Scene((shape,), np.array(path), background=0.5, leaves=seed)
        faults = synthetic.Faults(noise=NOISE, exposure=(0.0, *rng.uniform(-1, 1, 19).tolist()))
        views += [stereo_view(pair) for pair in synthetic.SyntheticSequence(scene, faults=faults, seed=8 * seed + c)]
    return views, np.repeat(np.arange(8), 20)


def stereo_view(pair: StereoPair) -> View:
    cloud = reconstruct(pair)
    return View(pair.left, cloud.uv, tspslam.delaunay_surface(cloud).faces, cloud.xyz)


def respond(view: View, vertices_only: bool = False) -> tuple[Any, Signals, Any]:
    """Complex, signals and responses of a view."""
    complex_ = build_complex(view.faces, len(view.uv))
    signals = sample_signals(view.grey, view.uv, complex_)
    if vertices_only:
        off = {name: np.zeros_like(getattr(signals, name)) for name in ("edge", "face", "edge_ok", "face_ok")}
        signals = replace(signals, **off)
    return complex_, signals, tmahf_bank(complex_, view.uv, signals, orders=ORDERS, scales=SCALES)


def with_layout(view: View, vertices_only: bool = False) -> np.ndarray:
    size = view.grey.shape[::-1]
    return describe(*respond(view, vertices_only), layout=LAYOUT, uv=view.uv, size=size)


def without_layout(view: View, vertices_only: bool = False) -> np.ndarray:
    return describe(*respond(view, vertices_only))


Describer = Callable[[View], np.ndarray]
IMAGES: dict[str, Describer] = {
    "tiny image": lambda view: rivals.tiny_image(view.grey),
    "HOG": lambda view: rivals.gradients(view.grey),
    "gist-like (Gabor)": lambda view: rivals.gabor_energies(view.grey),
}
SHAPE: dict[str, Describer] = {"shape histogram (FPFH)": lambda view: rivals.shape_histogram(view.xyz, view.faces)}
OF_PLACES: dict[str, Describer] = {
    "response": with_layout,
    "response, on vertices only": partial(with_layout, vertices_only=True),
    "response, no layout": without_layout,
} | IMAGES
OF_THINGS: dict[str, Describer] = {
    "response": without_layout,
    "response, on vertices only": partial(without_layout, vertices_only=True),
} | IMAGES | SHAPE  # fmt: skip


def similarities(views: list[View], methods: dict[str, Describer], centred: bool) -> Iterator[tuple[str, np.ndarray]]:
    """Name and similarity of all pairs, by each method."""
    for name, make in methods.items():
        rows = np.array([make(view) for view in views])
        yield name, compare_descriptors(rows, rows, mean=rows.mean(axis=0) if centred else None)


def measure(similarity: np.ndarray, places: Places) -> tuple[float, ...]:
    pair = (similarity, places.same, places.other)
    return recall_at_full_precision(*pair), recalled_keyframes(*pair), average_precision(*pair)


def scores_of(places: Places) -> dict[str, np.ndarray]:
    """Similarity of all pairs by each method, and by words plus some of them."""
    methods = OF_PLACES | (SHAPE if places.views[0].xyz is not None else {})
    words = rivals.votes([view.grey for view in places.views], places.same | places.other)
    found = {"binary words": words} | dict(similarities(places.views, methods, centred=True))
    return found | {f"words + {name}": words + weight * found[name] for name, weight in WEIGHTS.items()}


def develop(places: Places) -> None:
    """Print what decides WEIGHTS, and whether to take out the mean."""
    words = rivals.votes([view.grey for view in places.views], places.same | places.other)
    print(f"{places.name}: words", *(f"{x:.3f}" for x in measure(words, places)))
    for centred in (True, False):
        for name, found in similarities(places.views, OF_PLACES | SHAPE, centred):
            beside = (measure(words + weight * found, places)[0] for weight in TRY)
            said = " ".join(f"{x:.3f}" for x in measure(found, places))
            print(f"  {'less mean' if centred else 'plain':10}{name:28}{said}; + words", *(f"{x:.3f}" for x in beside))


def recognise_things(seed: int) -> dict[str, tuple[float, float]]:
    """Accuracy of the nearest known view, and mean average precision, by each method."""
    views, kind = things(seed)
    is_known = np.arange(len(kind)) % 20 == 0
    alike = kind[:, None] == kind
    asks, answers = np.outer(~is_known, is_known), np.outer(is_known, ~is_known)
    found = dict(similarities(views, OF_THINGS, centred=False))
    words = rivals.votes([view.grey for view in views], asks)
    found["binary words"] = np.where(asks, words, words.T)
    made = {}
    for name, score in found.items():
        best = np.where(asks, score, -np.inf)[~is_known].argmax(axis=1)
        precision = [
            average_precision(score[[k]], alike[[k]] & answers[[k]], ~alike[[k]] & answers[[k]])
            for k in np.flatnonzero(is_known)
        ]
        made[name] = float((kind[best] == kind[~is_known]).mean()), float(np.mean(precision))
    return made


def times_of(view: View) -> dict[str, float]:
    """Milliseconds for what is kept of a keyframe, by each method; without finding the points and faces."""
    seen = respond(view)
    size = view.grey.shape[::-1]
    again = OF_PLACES | SHAPE | {
        "binary words": lambda view: OrbDetector()(view.grey).descriptor,
        "response, the descriptor alone": lambda view: describe(*seen, layout=LAYOUT, uv=view.uv, size=size),
        "response, no layout, the descriptor alone": lambda view: describe(*seen),
    }  # fmt: skip
    return {name: 1e3 * median_seconds(partial(make, view), 9) for name, make in again.items()}


def dense_view(count: int = 20_000) -> View:
    """A photograph at random vertices."""
    from skimage import data

    grey = data.camera()
    uv = np.random.default_rng(0).uniform(0, 511, (count, 2))
    return View(grey, uv, Delaunay(uv).simplices, np.column_stack([uv, np.full(count, 400.0)]))


def lengths(view: View) -> dict[str, int]:
    return {name: len(make(view)) for name, make in (OF_PLACES | SHAPE).items()}


def mean_and_worst(values: list[float]) -> str:
    return f"{np.mean(values):.2f} ({min(values):.2f})" if len(values) > 1 else f"{values[0]:.2f}"


def places_table(found: dict[str, list[tuple[float, ...]]]) -> str:
    rows = [
        [name, *(mean_and_worst([one[k] for one in figures]) for k in range(len(COLUMNS)))]
        for name, figures in found.items()
    ]
    return table(["", *COLUMNS], rows)


def draw(places: Places, found: dict[str, np.ndarray], path: Path) -> None:
    """A keyframe of the second pass and what is found for it; similarities by words, by the response, and the truth."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    half = len(places.views) // 2
    blocks = {
        "words": found["binary words"], "response": found["response"], "both": found["words + response"],
        "the same place": np.where(places.same, 1.0, np.where(places.other, 0.0, 0.3)),
    }  # fmt: skip
    figure, axes = plt.subplots(2, 4, figsize=(12, 5.6), layout="constrained")
    for axis, (name, block) in zip(axes[0], blocks.items(), strict=True):
        axis.imshow(block[half:, :half], cmap="viridis", aspect="equal")
        axis.set(title=name, xlabel="first pass", ylabel="second pass")
    response = found["response"][half:, :half]
    for column, query in enumerate((half // 8, half // 2)):
        best = int(response[query].argmax())
        for axis, k, said in ((2 * column, half + query, "second pass"), (2 * column + 1, best, "found, first pass")):
            axes[1, axis].imshow(places.views[k].grey, cmap="gray", vmin=0, vmax=255)
            axes[1, axis].set_title(f"{said}, {k % half}")
            axes[1, axis].axis("off")
    figure.savefig(path, dpi=80)
    plt.close(figure)


def recordings() -> Iterator[tuple[str, Places]]:
    data = Path(os.environ.get("TSPSLAM_DATA", "no-such-folder"))
    for name, read in (("rtabmap_samples", samples), ("euroc_v101_keyframes", flight)):
        if (data / name).is_dir():
            yield name, read(data / name)
        else:
            print(f"{name}: left out, not in {data}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, help="write the tables and the picture there")
    parser.add_argument("--development", action="store_true", help="measure on development data alone")
    given = parser.parse_args()
    if given.development:
        for kind, seed in ((kind, seed) for seed in (100, 101, 102, 103) for kind in ("room", "corridor")):
            develop(rooms(kind, seed))
        print(recognise_things(100))
        return
    found: dict[str, dict[str, list[tuple[float, ...]]]] = {}
    scored = (("rooms", rooms("room", seed)) for seed in range(4))
    for name, places in chain(scored, recordings()):
        scores = scores_of(places)
        print(f"{places.name}: {places.same.sum()} true pairs, {places.other.sum()} others", flush=True)
        for method, score in scores.items():
            figures = measure(score, places)
            found.setdefault(name, {}).setdefault(method, []).append(figures)
            print(f"  {method:28}", *(f"{x:.3f}" for x in figures), flush=True)
        if given.docs and places.name == "room 0":
            draw(places, scores, given.docs / "images" / "uses_recognise.png")
            keyframe = places.views[0]
    kinds = [recognise_things(seed) for seed in range(3)]
    for method in kinds[0]:
        print(f"  things: {method:28}", *(f"{x:.3f}" for one in kinds for x in one[method]))
    if given.docs:
        write_docs(given.docs, found, kinds, keyframe)


def write_docs(docs: Path, found: Any, kinds: list[dict[str, tuple[float, float]]], keyframe: View) -> None:
    few, many, size = times_of(keyframe), times_of(dense_view()), lengths(keyframe)
    things_rows = [
        [name, *(mean_and_worst([one[name][k] for one in kinds]) for k in range(2))] for name in kinds[0]
    ]  # fmt: skip
    time_rows = [[name, str(size.get(name, "-")), f"{few[name]:.1f}", f"{many[name]:.0f}"] for name in few]
    parts = []
    for name, rows in found.items():
        count = len(next(iter(rows.values())))
        parts += [f"Places, {name}{f': mean (worst) of {count}' if count > 1 else ''}.\n", places_table(rows)]
    parts += [
        "Things: 8 shapes, 20 views each, one known; mean (worst) of three sets.\n",
        table(["", "accuracy", "mean average precision"], things_rows),
        f"Time, one core, ms: for a keyframe of {len(keyframe.uv)} vertices, and for 20 000 vertices at 512 by 512 px."
        " Complex, signals and responses are part of it, unless said otherwise.\n",
        table(["", "numbers", "keyframe", "20 000 vertices"], time_rows),
    ]
    (docs / "uses_recognise.inc").write_text("\n".join(parts))


if __name__ == "__main__":
    main()
