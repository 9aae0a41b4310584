"""Error of the first step of a run, and share of right starts.

``python -m benchmarks.first_steps [--data FOLDER]... [--every N]``: streets at 0 to 3 m and 0 to 15 degrees a frame;
recordings started at every tenth frame, with 1 of 1, 2 and 3 frames. A start is right if it is not lost and ends within
3 % of the step, or 0.02 m, of the reference: the truth of a street; of a recording the adjusted path of the whole run,
as its truth has errors of its own a step. What the truth says is told beside.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tspslam import StereoOdometry, StereoPair
from tspslam.datasets import open_sequence, synthetic
from tspslam.datasets.synthetic import shapes
from tspslam.types import FloatArray
from tspslam.vision.se3 import inverse, rotation_angle

NOISE = synthetic.Faults(noise=0.01, blur=0.5)
STEPS, TURNS, PLACES = (
    (0.0, 0.5, 1.0, 2.0, 3.0),
    (0.0, 5.0, 10.0, 15.0),
    ((0, 10), (1, 40), (2, 25)),
)  # m, degrees, (seed, frame)
SHARE, LEAST = 0.03, 0.02  # of the step, and m: below it a step is nothing that a share can be of


@dataclass(frozen=True)
class Step:
    """A first step: its true length, its errors, and whether it was lost."""

    length: float
    metres: float
    degrees: float
    is_lost: bool

    @property
    def is_right(self) -> bool:
        return not self.is_lost and self.metres <= max(SHARE * self.length, LEAST)


def measure_step(pairs: Sequence[StereoPair], references: Sequence[FloatArray]) -> list[Step]:
    """Measure the first step of a run over two pairs, against each of some references (2, 4, 4)."""
    odometry = StereoOdometry(pairs[0].rig)
    first, second = (odometry.process(pair) for pair in pairs)
    odometry.close()
    found, steps = inverse(first.T_world_camera) @ second.T_world_camera, []
    for T in references:
        true = inverse(T[0]) @ T[1]
        error = inverse(true) @ found
        metres, length = (float(np.linalg.norm(one[:3, 3])) for one in (error, true))
        steps.append(Step(length, metres, float(np.degrees(rotation_angle(error[:3, :3]))), second.is_lost))
    return steps


def street_steps(step: float, turn: float) -> Iterator[Step]:
    """First steps of streets that the camera drives along while it turns."""
    for seed, frame in PLACES:
        scene = synthetic.street(60.0, seed=seed)
        half = shapes.pose_at((0, 0, 0), (0, np.radians(turn / 2), 0))
        first = scene.path[frame] @ inverse(half)
        path = np.stack([first, first @ half @ shapes.pose_at((0, 0, step), (0, 0, 0)) @ half])
        sequence = synthetic.SyntheticSequence(replace(scene, path=path), faults=NOISE)
        yield measure_step(list(sequence), [sequence.truth])[0]


def open_with_truth(folder: str) -> Any:
    """A recording that has true poses."""
    sequence = open_sequence(folder)
    if getattr(sequence, "truth", None) is None:
        raise SystemExit(f"{folder}: has no true poses, expected a recording with them (KITTI, EuRoC, UTIAS)")
    return sequence


def recorded_steps(folder: str, every: int) -> Iterator[tuple[str, list[Step], list[Step]]]:
    """First steps of a recording with 1 of 1, 2 and 3 frames: against the path of the whole run, and the truth."""
    sequence = open_with_truth(folder)
    odometry = StereoOdometry(sequence.rig)
    for k in range(len(sequence)):
        odometry.process(sequence[k])
    odometry.finish()
    path = odometry.trajectory.T_world_camera
    for gap in (1, 2, 3):
        starts = range(0, len(sequence) - gap, every)
        rows = [[k, k + gap] for k in starts]
        found = [measure_step([sequence[k] for k in row], [path[row], sequence.truth[row]]) for row in rows]
        yield f"{sequence.name}, 1 of {gap}", [one[0] for one in found], [one[1] for one in found]


def told(steps: Sequence[Step]) -> str:
    """One line of figures."""
    errors = np.array([one.metres for one in steps])
    shares = [100 * one.metres / one.length for one in steps if one.length > LEAST / SHARE]
    return (
        f"right {sum(one.is_right for one in steps)} of {len(steps)}, lost {sum(one.is_lost for one in steps)}; error "
        f"median {np.median(errors):.3f}, largest {errors.max():.3f} m, {max(shares, default=0.0):.1f} % of a step, "
        f"{max(one.degrees for one in steps):.2f} degrees"
    )


def parsed(arguments: list[str], description: str | None) -> argparse.Namespace:
    """Recordings that are started at some of their frames, as they are typed."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--data", action="append", default=[], help="a recording with true poses")
    parser.add_argument("--every", type=int, default=10, help="frames from one start to the next")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> None:
    given = parsed(arguments, __doc__)
    for folder in given.data:
        open_with_truth(folder)
    for step in STEPS:
        for turn in TURNS:
            print(f"street, {step:g} m and {turn:g} degrees: {told(list(street_steps(step, turn)))}", flush=True)
    for folder in given.data:
        for name, against_run, against_truth in recorded_steps(folder, given.every):
            print(f"{name}: {told(against_run)}; by the truth {told(against_truth)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
