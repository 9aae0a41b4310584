"""How good and how fast the path is, beside frame-to-frame odometry from OpenCV's parts on the same images.

``python -m benchmarks.slam [--data FOLDER]... [--docs docs] [--small]``; with ``--docs`` the table goes to the page.
"""

from __future__ import annotations

import argparse
import itertools
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tspslam import Rig, StereoPair, Trajectory, evaluate_trajectory
from tspslam.datasets import open_sequence, synthetic
from tspslam.io import RunFolder
from tspslam.run.config import resolve
from tspslam.run.sequence import SequenceRun
from tspslam.session import Session

from .measure import table
from .naive import Naive

WIDE = Rig(fx=707.0, fy=707.0, cx=602.0, cy=183.0, baseline=0.54, width=1226, height=370)
ROOM = Rig(fx=436.0, fy=436.0, cx=376.0, cy=240.0, baseline=0.11, width=752, height=480)
ROUNDS = 3  # of which medians are told
LONGEST = 10  # frames whose times are told
NOISE = synthetic.Faults(noise=0.01, blur=0.5)


@dataclass
class Held:
    """Pairs in memory, so that no time goes into rendering them."""

    name: str
    rig: Rig
    pairs: list[StereoPair]
    truth: Trajectory

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> StereoPair:
        return self.pairs[index]


def held(name: str, sequence: synthetic.SyntheticSequence) -> Held:
    pairs = [sequence[index] for index in range(len(sequence))]
    return Held(name, sequence.rig, pairs, Trajectory(sequence.stamps, sequence.truth))


def worlds(small: bool) -> Iterator[Held]:
    length = 30.0 if small else 300.0
    yield held(f"street, {length:g} m, 1226 x 370", street(length))
    yield held(f"corridor, {length:g} m, 512 x 384", corridor(length))
    laps = 0.1 if small else 1.0
    yield held(f"room, {laps:g} lap, 752 x 480", synthetic.SyntheticSequence(synthetic.room(laps=laps), ROOM, NOISE))
    yield held(
        "still camera, 512 x 384", synthetic.SyntheticSequence(synthetic.still(20 if small else 200), faults=NOISE)
    )


def street(length: float) -> synthetic.SyntheticSequence:
    return synthetic.SyntheticSequence(synthetic.street(length), WIDE, NOISE)


def corridor(length: float) -> synthetic.SyntheticSequence:
    return synthetic.SyntheticSequence(synthetic.corridor(length), synthetic.PAPER_RIG, NOISE)


def opened(folder: str) -> Held:
    sequence = open_sequence(folder)
    pairs = [sequence[index] for index in range(len(sequence))]
    stamps = np.array([pair.stamp for pair in pairs])
    return Held(sequence.name, sequence.rig, pairs, Trajectory(stamps, sequence.truth))


@dataclass
class Taken:
    """What one pass over a sequence took: seconds a frame, CPU seconds a frame, and of its longest frames."""

    wall: float
    cpu: float
    longest: list[float]


def timed(steps: Iterator[object], count: int) -> Taken:
    """Go through the steps of a pass, one a frame."""
    cpu, marks = time.process_time(), [time.perf_counter()]
    for _ in steps:
        marks.append(time.perf_counter())
    longest = sorted(np.diff(marks), reverse=True)[:LONGEST]
    return Taken((marks[-1] - marks[0]) / count, (time.process_time() - cpu) / count, longest)


def ours(source: Held) -> tuple[Trajectory, Taken, dict[str, object]]:
    """Path, time (frames with complexes written to disk, without drawing), and what was noted."""
    with tempfile.TemporaryDirectory() as out:
        with RunFolder.create(f"{out}/warm", {}) as folder:
            list(SequenceRun(source, range(3), Session(source.rig), folder).proceed())
        with RunFolder.create(f"{out}/run", {}) as folder:
            sequence = SequenceRun(source, range(len(source)), Session(source.rig, resolve().settings), folder)
            taken = timed(itertools.chain(sequence.proceed(), finishing(sequence.session)), len(source))
    offset, std = sequence.session.odometry.disparity_offset
    lost = sum(row.is_lost for row in sequence.tracked)
    keyframes = sum(row.is_keyframe for row in sequence.tracked)
    return sequence.trajectory, taken, {"keyframes": keyframes, "lost": lost, "offset": f"{offset:+.3f} ± {std:.3f}"}


def finishing(session: Session) -> Iterator[None]:
    """The last step of a pass: all keyframes are adjusted together."""
    session.finish()
    yield


def naive(source: Held) -> tuple[Trajectory, Taken]:
    """The same of the reference."""
    Naive(source.rig).process(source[0])
    reference, poses = Naive(source.rig), []
    taken = timed((poses.append(reference.process(pair)) for pair in source.pairs), len(source))
    return Trajectory(source.truth.stamp, np.array(poses)), taken


def paired(source: Held) -> list[tuple[Taken, Taken]]:
    """Times of ours and of the reference, one after the other, so that a busy machine slows both."""
    return [(ours(source)[1], naive(source)[1]) for _ in range(ROUNDS - 1)]


def row(source: Held) -> list[str]:
    path, taken, found = ours(source)
    other, other_taken = naive(source)
    both = [(taken, other_taken), *paired(source)]
    seconds, other_seconds = (float(np.median([each[k].wall for each in both])) for k in (0, 1))
    ratio = float(np.median([theirs.wall / mine.wall for mine, theirs in both]))
    cpu, other_cpu = (float(np.median([each[k].cpu for each in both])) for k in (0, 1))
    error, rival = (evaluate_trajectory(p, source.truth) for p in (path, other))
    length = float(np.linalg.norm(np.diff(source.truth.T_world_camera[:, :3, 3], axis=0), axis=1).sum())
    ten = error.per_distance[10.0]
    return [
        source.name, f"{length:.3g}", f"{error.ate_rmse_m:.4f}", f"{ten.translation_percent:.2f}" if ten.pairs else "-",
        f"{rival.ate_rmse_m:.4f}", f"{found['keyframes']} of {len(source)}", str(found["lost"]), str(found["offset"]),
        f"{1 / seconds:.0f}", f"{1 / other_seconds:.0f}", f"{ratio:.2f}", f"{1e3 * cpu:.0f}; {1e3 * other_cpu:.0f}",
        " ".join(f"{1e3 * each:.0f}" for each in taken.longest),
    ]  # fmt: skip


HEAD = [
    "sequence", "length, m", "ATE, m", "RPE over 10 m, %", "ATE of OpenCV's parts, m", "keyframes", "lost",
    "disparity offset, px", "frames/s", "frames/s of OpenCV's parts", "times as fast", "CPU ms a frame; OpenCV's parts",
    "longest frames, ms",
]  # fmt: skip


def memory(frames: int) -> list[float]:
    """Largest resident memory, MB, beyond what a first frame needs, after each quarter of a walk in circles."""
    sequence = synthetic.SyntheticSequence(synthetic.room(laps=frames / 240), synthetic.PAPER_RIG, NOISE)
    session, marks = Session(sequence.rig, keep=False), []
    session.process(sequence[0])
    start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(1, frames):
        session.process(sequence[k])
        if k % (frames // 4) == frames // 4 - 1:
            marks.append((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - start) / 1024)
    return marks


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", action="append", default=[], help="a recording with true poses")
    parser.add_argument("--docs", type=Path, help="write the table there")
    parser.add_argument("--small", action="store_true", help="short worlds")
    given = parser.parse_args(arguments)
    marks = memory(40 if given.small else 1000)
    rows = []
    for source in [*worlds(given.small), *map(opened, given.data)]:
        rows.append(row(source))
        print(dict(zip(HEAD, rows[-1], strict=True)), flush=True)
    said = ", ".join(f"{mark:.0f}" for mark in marks)
    text = table(HEAD, rows)
    text += f"\nMemory beyond the first frame, MB, after each quarter of {1000} frames in circles: {said}.\n"
    print(text)
    if given.docs and not given.small:
        (given.docs / "path_numbers.inc").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
