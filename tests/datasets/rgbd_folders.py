"""Folders of RGB-D recordings, rendered from a room whose path and depths are known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

from tspslam.datasets import synthetic
from tspslam.io.trajectory import write_tum
from tspslam.types import FloatArray, Rig
from tspslam.vision.calibration.formats.own import save_cameras

CAMERA = Rig(fx=262.5, fy=262.5, cx=159.75, cy=119.75, width=320, height=240)
Noise = Literal["none", "structured_light", "time_of_flight"]
_KINECT = 0.075 * 580.0  # px m, of its own disparities, which have steps of 1/8 px
T0 = 1_300_000_000.0  # s


@dataclass(frozen=True)
class Walk:
    """Images, true depths (m) and poses of a camera, and its stamps (s)."""

    images: list[np.ndarray]
    depths: list[FloatArray]
    stamps: FloatArray
    truth: FloatArray


@cache
def room(frames: int, *, of: int = 240, seed: int = 0) -> Walk:
    """The first frames of a walk through a room, at 30 images a second."""
    rig = Rig(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 0.1, CAMERA.width, CAMERA.height)
    scene = synthetic.room(frames=of, laps=frames / of, seed=seed)
    faults = synthetic.Faults(noise=0.005, eight_bit=True)
    sequence = synthetic.SyntheticSequence(scene, rig, faults, seed=seed, rate=30.0)
    images = [sequence._take(k, 0) for k in range(len(sequence))]
    depths = [sequence.geometry(k).depth.astype(float) for k in range(len(sequence))]
    return Walk(images, depths, sequence.stamps, sequence.truth)


def spoiled(depth: FloatArray, noise: Noise, rng: np.random.Generator) -> FloatArray:
    """Depths as a sensor of a kind measures them, m; NaN where it does not."""
    if noise == "none":
        return depth
    if noise == "time_of_flight":
        return depth + rng.normal(size=depth.shape) * (1e-3 + 5e-4 * depth)
    spread = np.sqrt((_KINECT * 1.425e-3) ** 2 - 1 / 8**2 / 12)  # with the steps, 1.425e-3 z^2 in all
    raw = _KINECT / depth + rng.normal(size=depth.shape) * spread
    found = _KINECT / np.maximum(np.round(raw * 8) / 8, 1 / 8)
    step = np.zeros(depth.shape, bool)
    step[:, 1:] |= np.abs(np.diff(depth, axis=1)) > 0.2
    step[1:] |= np.abs(np.diff(depth, axis=0)) > 0.2
    wide = np.lib.stride_tricks.sliding_window_view(np.pad(step, 2), (5, 5)).any(axis=(2, 3))
    return np.where(wide | (depth > 10), np.nan, found)


def write_tum_folder(folder: Path, walk: Walk, noise: Noise = "none", *, late: float = 0.0, calib: bool = True) -> Path:
    """Write a recording in the layout of TUM's benchmark; depths have stamps `late` seconds after the images'."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    lines: dict[str, list[str]] = {"rgb": [], "depth": []}
    for k, (image, true) in enumerate(zip(walk.images, walk.depths, strict=True)):
        depth = spoiled(true, noise, np.random.default_rng((5, k)))
        stamps = {"rgb": T0 + walk.stamps[k], "depth": T0 + walk.stamps[k] + late}
        for name, pixels in (("rgb", image), ("depth", steps(depth, 5000))):
            file = f"{name}/{stamps[name]:.6f}.png"
            Image.fromarray(pixels).save(folder / file, compress_level=1)
            lines[name].append(f"{stamps[name]:.6f} {file}")
    for name, said in lines.items():
        (folder / f"{name}.txt").write_text("# stamp file\n" + "\n".join(said) + "\n")
    known = np.arange(-1, len(walk.stamps) + 1) / 30.0  # one before, and one after
    poses = walk.truth[np.clip(np.arange(-1, len(walk.stamps) + 1), 0, len(walk.stamps) - 1)]
    write_tum(folder / "groundtruth.txt", T0 + known, poses)
    if calib:
        save_cameras(CAMERA, folder / "calib.yaml")
    return folder


def steps(depth: FloatArray, per_metre: float) -> np.ndarray:
    """Depths as whole numbers; 0 where not known."""
    values = np.rint(np.nan_to_num(depth, posinf=0) * per_metre)
    return np.where(values < 65_535, values, 0).astype(np.uint16)
