"""Whether covariances are those of the errors: of runs begun anywhere, of paths that come back, behind vehicles.

``python -m benchmarks.honest_paths [--data FOLDER]... [--every N]``. A normalised error is the squared error in
covariances for each of six degrees of freedom: 1 is honest.

- Recordings (``--data``): a run begun at every tenth frame, its pose after ten frames against the same two frames of
  the adjusted path of the whole run, in twice the covariance of its own.
- Synthetic paths of 20 frames or so without a loop, of many worlds each: each frame against the keyframe before it, and
  the last third from the start. One path's error is one draw: 0.1 to 2 from the start where the mean is 0.9.
- Synthetic walks that come back: the last third of two rooms and two corridors, from the start of the path.
- 40 starts behind a vehicle of 0.54 to 0.73 of the first image, and six drives that catch up with one: how many are
  right, how many are wrong without a doubt, and the normalised errors.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tspslam import StereoOdometry, StereoPair
from tspslam.datasets import synthetic
from tspslam.types import FloatArray
from tspslam.vision.se3 import inverse

from .first_steps import NOISE, open_with_truth, parsed

LENGTH = 10  # frames
WORLDS = 20  # of each kind
AHEAD, SPEEDS = (3.2, 3.0, 2.8, 2.6), (0.9, 1.0, 1.1, 1.3, 1.5)  # m, m a frame; the camera has 1 m a frame
CAUGHT = ((5.0, 0.7, 11), (4.0, 0.85, 13), (3.4, 0.95, 14))  # m ahead, m a frame, frames
WIDTH, HEIGHT, DEPTH = 2.5, 3.0, 3.0  # of the vehicle, m
EYE = 1.65  # m above the road
RIGHT = 0.05  # m of a step of 1 m


@dataclass(frozen=True)
class Drive:
    """How far steps of a drive end from where they should, m, whether it was doubted, and its normalised errors."""

    steps: FloatArray
    is_doubted: bool
    squares: FloatArray

    @property
    def is_right(self) -> bool:
        return bool(self.steps.max() < RIGHT)


def normalised(odometry: StereoOdometry, reference: FloatArray, frame: int, times: float = 1.0) -> float:
    """Squared error of a frame against the first one in so many covariances, for each degree of freedom."""
    T = inverse(inverse(reference[0]) @ reference[frame]) @ odometry.trajectory.T_world_camera[frame]
    return squared(T, times * odometry.covariance_from_start(frame))


def squared(T: FloatArray, covariance: FloatArray) -> float:
    """Squared length of a motion that should be none, in covariances, for each degree of freedom."""
    off = np.append(Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3])
    return float(off @ np.linalg.solve(covariance, off) / 6)


def driven(pairs: Sequence[StereoPair]) -> StereoOdometry:
    """An odometry that has seen some pairs."""
    odometry = StereoOdometry(pairs[0].rig)
    for pair in pairs:
        odometry.process(pair)
    return odometry


def begun_anywhere(folder: str, every: int) -> list[float]:
    """Normalised errors of runs begun at every n-th frame, against the adjusted path of the whole recording."""
    sequence = open_with_truth(folder)
    pairs = [sequence[k] for k in range(len(sequence))]
    whole = driven(pairs)
    whole.finish()
    path = whole.trajectory.T_world_camera
    starts = range(0, len(pairs) - LENGTH, every)
    parts = [slice(start, start + LENGTH + 1) for start in starts]
    return [normalised(driven(pairs[part]), path[part], LENGTH, 2.0) for part in parts]


def paths() -> dict[str, list[synthetic.Scene]]:
    """Worlds of each kind."""
    seeds = range(WORLDS)
    return {
        "streets, 20 m": [synthetic.street(20.0, seed=seed) for seed in seeds],
        "streets, 40 m, 2 m a frame": [synthetic.street(40.0, step=2.0, seed=seed) for seed in seeds],
        "corridors, 9 m": [synthetic.corridor(9.0, seed=seed) for seed in seeds],
        "rooms, a third of a lap": [synthetic.room(laps=0.35, frames=60, seed=seed) for seed in seeds],
    }


def one_way(scene: synthetic.Scene) -> tuple[FloatArray, FloatArray]:
    """Normalised errors of a path's frames against the keyframe of each, and of its last third from the start."""
    sequence = synthetic.SyntheticSequence(scene, faults=NOISE)
    odometry, truth, against = StereoOdometry(sequence.rig), sequence.truth, []
    for k, pair in enumerate(sequence):
        tracked = odometry.process(pair)
        held = int(odometry.path.links[k])
        if k and not tracked.is_lost:
            T_held = odometry.trajectory.T_world_camera[held]
            T = inverse(inverse(truth[held]) @ truth[k]) @ inverse(T_held) @ tracked.T_world_camera
            against.append(squared(T, tracked.covariance))
    odometry.close()
    return np.array(against), last_third(odometry, truth)


def last_third(odometry: StereoOdometry, truth: FloatArray) -> FloatArray:
    """Normalised errors of the last third of a path, from its start."""
    return np.array([normalised(odometry, truth, frame) for frame in range(2 * len(truth) // 3, len(truth))])


def walks() -> Iterator[tuple[str, list[StereoPair], FloatArray]]:
    """Two rooms walked around 1.4 times, and two corridors walked to and fro."""
    for seed in (3, 4):
        room = synthetic.SyntheticSequence(synthetic.room(laps=1.4, frames=130, seed=seed), faults=NOISE)
        yield f"room {seed}", list(room), room.truth
        corridor = synthetic.SyntheticSequence(synthetic.corridor(9.0, seed=seed), faults=NOISE)
        order = [*range(len(corridor)), *range(len(corridor) - 2, -1, -1)]
        seen = list(corridor)
        pairs = [replace(seen[k], index=n, stamp=n / 10) for n, k in enumerate(order)]
        yield f"corridor {seed}", pairs, corridor.truth[order]


def behind(seed: int, ahead: float, speed: float, frames: int) -> Drive:
    """A drive along a street behind a vehicle."""
    scene = synthetic.street(30.0, seed=seed)
    place = scene.path[0] @ (0.0, EYE - HEIGHT / 2, ahead + DEPTH / 2, 1.0)
    look = synthetic.Texture(7, 0.02, 0.5, 0.9)
    car = synthetic.box(WIDTH, HEIGHT, DEPTH, texture=look, name="car").at(*place[:3])
    car = replace(car, velocity=(0, 0, 10 * speed))
    scene = replace(scene, shapes=(*scene.shapes, car), path=scene.path[:frames])
    sequence = synthetic.SyntheticSequence(scene, synthetic.PAPER_RIG, NOISE)
    odometry, truth = driven(list(sequence)), sequence.truth
    path = odometry.trajectory.T_world_camera
    ours, true = (inverse(poses[:-1]) @ poses[1:] for poses in (path, truth))
    squares = [normalised(odometry, truth, frame) for frame in range(1, frames)]
    steps = np.linalg.norm((inverse(true) @ ours)[:, :3, 3], axis=1)
    return Drive(steps, bool(odometry.path.doubted), np.array(squares))


def told(drives: Sequence[Drive]) -> str:
    """One line of figures."""
    wrong = [one for one in drives if not one.is_right]
    unsaid = sum(not one.is_doubted for one in wrong)
    doubted = sum(one.is_doubted for one in drives)
    squares = np.concatenate([one.squares for one in drives])
    return (
        f"right {len(drives) - len(wrong)} of {len(drives)}, doubted {doubted}, wrong without a doubt {unsaid}; "
        f"normalised error median {np.median(squares):.2f}, mean {squares.mean():.2f}"
    )


def main(arguments: list[str]) -> None:
    given = parsed(arguments, __doc__)
    for folder in given.data:
        squares = begun_anywhere(folder, given.every)
        print(f"{folder}: mean {np.mean(squares):.2f} of {len(squares)}, largest {max(squares):.2f}", flush=True)
    for name, scenes in paths().items():
        against, start = zip(*map(one_way, scenes), strict=True)
        means = np.array([each.mean() for each in start])
        print(
            f"{len(scenes)} {name}: {np.concatenate(against).mean():.2f} against the keyframe before; from the start "
            f"{means.mean():.2f}, of single ones {means.min():.2f} to {means.max():.2f}",
            flush=True,
        )
    for name, pairs, truth in walks():
        odometry = driven(pairs)
        mean = last_third(odometry, truth).mean()
        print(f"{name}: {mean:.2f}, loops {odometry.loops}", flush=True)
    print("starts:", told([behind(seed, ahead, speed, 2) for seed in (0, 1) for ahead in AHEAD for speed in SPEEDS]))
    print("caught up with:", told([behind(seed, *each) for seed in (0, 1) for each in CAUGHT]))


if __name__ == "__main__":
    main(sys.argv[1:])
