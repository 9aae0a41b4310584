"""Recognising places and things: ``python -m benchmarks.uses.recognise [--docs docs] [--development]``.

By docs/uses_protocol.rst. With --development the same measures on development data, for several weights beside words:
what was chosen by them is WEIGHTS and CENTRED. Recordings are used where TSPSLAM_DATA has them.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
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

from . import recognise_rivals as rivals
from .recognise_rivals import average_precision, recall_at_full_precision, recalled_keyframes

ORDERS, SCALES, LAYOUT = (1, 2), (1, 2, 3), (6, 3)
ASIDE, STOPS, NOISE, FRAMES = 0.3, 1.0, 0.01, 40  # m, of the second pass; luminance; frames of a pass
NEAR, TURNED = 1.0, 30.0  # m, degrees: the same place
FAR, AWAY = 2.0, 60.0  # m, degrees: another place; between the two a pair counts for nothing
TRY = (0.01, 0.02, 0.05, 0.1, 0.2)  # weights beside words
WEIGHTS = {"response": 0.05, "gist-like (Gabor)": 0.05}  # chosen with --development
CENTRED = {"response", "response, on vertices only", "response, no layout"}  # what is better less its mean, likewise
COLUMNS = ("pairs at precision 1", "keyframes at precision 1", "average precision")


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
    made = {"room": partial(synthetic.room, frames=2 * FRAMES), "corridor": partial(synthetic.corridor, FRAMES)}
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
        views.append(View(grey, uv, Delaunay(uv).simplices))
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
        rectify = rectify or tspslam.rectification(
            tspslam.read_calibration(folder, images[0].shape[1::-1]).cameras
        )
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
        views += [stereo_view(pair) for pair in synthetic.SyntheticSequence(scene, faults=faults, seed=seed)]
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


def similarities(views: list[View], methods: dict[str, Describer], centred: set[str]) -> Iterator[tuple[str, Any]]:
    """Name and similarity of all pairs, by each method."""
    for name, make in methods.items():
        rows = np.array([make(view) for view in views])
        yield name, compare_descriptors(rows, rows, mean=rows.mean(axis=0) if name in centred else None)


def measure(similarity: np.ndarray, places: Places) -> tuple[float, ...]:
    pair = (similarity, places.same, places.other)
    return recall_at_full_precision(*pair), recalled_keyframes(*pair), average_precision(*pair)


def scores_of(places: Places) -> dict[str, np.ndarray]:
    """Similarity of all pairs by each method, and by words plus some of them."""
    methods = OF_PLACES | (SHAPE if places.views[0].xyz is not None else {})
    words = rivals.votes([view.grey for view in places.views], places.same | places.other)
    found = {"binary words": words} | dict(similarities(places.views, methods, CENTRED))
    return found | {f"words + {name}": words + weight * found[name] for name, weight in WEIGHTS.items()}


def develop(places: Places) -> None:
    """Print what decides WEIGHTS and CENTRED."""
    words = rivals.votes([view.grey for view in places.views], places.same | places.other)
    print(f"{places.name}: words", *(f"{x:.3f}" for x in measure(words, places)))
    methods = OF_PLACES | SHAPE
    for centred in (set(methods), set[str]()):
        for name, found in similarities(places.views, methods, centred):
            beside = [measure(words + weight * found, places)[0] for weight in TRY]
            said = " ".join(f"{x:.3f}" for x in measure(found, places))
            print(f"  {'centred' if centred else 'plain':8}{name:28}{said}  + words", *(f"{x:.3f}" for x in beside), flush=True)


def recognise_things(seed: int) -> dict[str, tuple[float, float]]:
    """Accuracy of the nearest known view, and mean average precision, by each method."""
    views, kind = things(seed)
    is_known = np.arange(len(kind)) % 20 == 0
    alike = kind[:, None] == kind
    asks, answers = np.outer(~is_known, is_known), np.outer(is_known, ~is_known)
    found = dict(similarities(views, OF_THINGS, set()))
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
