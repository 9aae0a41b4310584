"""Images of a synthetic town along a path, rendered once into KITTI's layout and kept for further runs."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tspslam import Rig
from tspslam._threads import set_threads
from tspslam.datasets import synthetic
from tspslam.datasets.kitti import KittiSequence
from tspslam.errors import InputError

KITTI = Rig(fx=707.0, fy=707.0, cx=602.0, cy=183.0, baseline=0.54, width=1226, height=370)
RATE = 10.0  # frames a second, as KITTI's
NOISE = synthetic.Faults(noise=0.01, blur=0.5)
_PROCESSES, _AT_ONCE = 2, 8  # frames of one task


def rig_of(size: tuple[int, int]) -> Rig:
    """KITTI's cameras with images of another size, the same view."""
    share = size[0] / KITTI.width
    return replace(
        KITTI,
        fx=KITTI.fx * share,
        fy=KITTI.fy * share,
        cx=(KITTI.cx + 0.5) * share - 0.5,
        cy=(KITTI.cy + 0.5) * share - 0.5,
        width=size[0],
        height=size[1],
    )


def read_path(path: Path | None) -> NDArray[np.float64]:
    """Poses of a file in KITTI's form; three laps of the made path without one."""
    if path is None:
        return synthetic.town_path(3)
    rows = np.loadtxt(path, ndmin=2)
    if rows.ndim != 2 or rows.shape[1] != 12:
        raise InputError(f"{path}: rows hold {rows.shape[1]} numbers, expected 12: three rows of a pose")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    return poses


@dataclass(frozen=True)
class Town:
    """What is rendered."""

    path: Path | None
    size: tuple[int, int]
    seed: int

    def sequence(self) -> synthetic.SyntheticSequence:
        return _sequence(self)

    def folder(self) -> Path:
        """Where its images are, named by all that they depend on."""
        sequence = self.sequence()
        parts = [repr(sequence.rig), repr(NOISE), sequence.scene.path.tobytes()]
        for shape in sequence.scene.shapes:
            parts += [shape.world_vertices().tobytes(), shape.texture.look(1.0).tobytes()]
        found = sha256()
        for part in parts:
            found.update(part if isinstance(part, bytes) else part.encode())
        return Path(tempfile.gettempdir()) / f"tspslam-town-{found.hexdigest()[:12]}"


@lru_cache(maxsize=1)
def _sequence(town: Town) -> synthetic.SyntheticSequence:
    scene = synthetic.town(read_path(town.path), seed=town.seed)
    return synthetic.SyntheticSequence(scene, rig_of(town.size), NOISE, seed=town.seed, rate=RATE)


def render(town: Town, wanted: slice) -> Path:
    """Render the frames that are not there yet; returns their folder."""
    folder, count = town.folder(), len(town.sequence())
    _describe(town, folder)
    names = [k for k in range(count)[wanted] if not (folder / "image_1" / f"{k:06d}.png").exists()]
    tasks = [names[k : k + _AT_ONCE] for k in range(0, len(names), _AT_ONCE)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(_PROCESSES, context, set_threads, (1,)) as pool:
        waiting = [pool.submit(_render, town, folder, task) for task in tasks]
        for done, each in enumerate(waiting):
            each.result()
            if done % 25 == 0:
                print(f"rendered {min((done + 1) * _AT_ONCE, len(names))} of {len(names)} frames", flush=True)
    return folder


def opened(town: Town, folder: Path, wanted: slice) -> tuple[KittiSequence, range]:
    """The rendered sequence, and the places of the wanted frames in it."""
    sequence = KittiSequence(folder)
    numbers = range(len(town.sequence()))[wanted]
    found = np.flatnonzero(np.isin(np.rint(sequence.stamps * RATE).astype(int), numbers))
    if len(found) != len(numbers) or found[-1] - found[0] != len(found) - 1:
        raise InputError(f"{folder}: holds {len(found)} of the frames, expected {len(numbers)}: remove it")
    return sequence, range(int(found[0]), int(found[-1]) + 1)


def _describe(town: Town, folder: Path) -> None:
    """Write the calibration, the times and the true poses."""
    sequence = town.sequence()
    for name in ("image_0", "image_1"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    rig = sequence.rig
    rows = [(rig.fx, 0, rig.cx, x, 0, rig.fy, rig.cy, 0, 0, 0, 1, 0) for x in (0.0, -rig.fx * rig.baseline)]
    lines = [f"P{k}: " + " ".join(repr(float(value)) for value in row) for k, row in enumerate(rows)]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "times.txt").write_text("".join(f"{stamp:.9f}\n" for stamp in sequence.stamps), encoding="utf-8")
    np.savetxt(folder / "poses.txt", sequence.truth[:, :3].reshape(-1, 12))


def _render(town: Town, folder: Path, numbers: list[int]) -> None:
    """Render frames, the right image last: where it is, both are whole."""
    for number in numbers:
        pair = town.sequence()[number]
        for name, image in (("image_0", pair.left), ("image_1", pair.right)):
            path = folder / name / f"{number:06d}.png"
            beside = path.with_suffix(".tmp")
            Image.fromarray(image).save(beside, "png", compress_level=1)
            os.replace(beside, path)
