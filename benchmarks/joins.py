"""Joined maps beside one run of the same frames: ``python -m benchmarks.joins [--docs docs] [--small]``.

A synthetic corridor is walked once; the walk is cut into pieces that overlap, each is run by itself, and the runs are
joined in one process. The same frames are run as one recording, and as several in one run (``tspslam run A B``). Errors
are those of the path (ATE); times are of the processor, by step, with kernels compiled before.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tspslam import Rig, StereoPair, Trajectory, evaluate_trajectory
from tspslam.datasets import JoinedSequence, synthetic
from tspslam.io import read_trajectory
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.scale.maps import steps
from tspslam.scale.maps.joining import join_runs

from .measure import cpu_seconds, table

PAPER = synthetic.PAPER_RIG
RIG = Rig(PAPER.fx / 2, PAPER.fy / 2, PAPER.cx / 2, PAPER.cy / 2, PAPER.baseline, PAPER.width // 2, PAPER.height // 2)
LENGTHS = {"corridor, 2 pieces": (15.0, 2), "corridor, 3 pieces": (15.0, 3)}  # m, and pieces
OVERLAP = 0.3  # of a piece, that it has in common with the next
HEAD = ("walk", "frames", "ATE of one run, m", "of all pieces in one run", "of joined runs")
STEPS = ("walk", "tracking the pieces, s", "state", "candidates", "shared", "frames", "map", "writing the run")


@dataclass(frozen=True)
class Piece:
    """Some pairs of a walk, as a recording of its own."""

    pairs: list[StereoPair]
    name: str
    rig: Rig = RIG

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> StereoPair:
        return replace(self.pairs[index], index=index, stamp=0.1 * index, name=f"{index:04d}")


def cut(count: int, pieces: int) -> list[range]:
    """Frames of each piece."""
    length = count / (pieces - OVERLAP * (pieces - 1))
    starts = [round(k * length * (1 - OVERLAP)) for k in range(pieces)]
    return [range(start, min(count, round(start + length))) for start in starts]


def ate(folder: Path, truth: np.ndarray) -> float:
    found = read_trajectory(folder / "trajectory.tum")
    if len(found.stamp) < len(truth):
        return float("nan")  # a piece was not found in the others
    return float(evaluate_trajectory(found, Trajectory(found.stamp, truth)).ate_rmse_m)


def timed(kinds: dict[str, float], kind: str, make: Callable[..., None]) -> Callable[..., None]:
    """A maker of steps whose CPU time is noted."""

    def noted(*given: object) -> None:
        kinds[kind] += cpu_seconds(lambda: make(*given))

    return noted


def measure(name: str, length: float, count: int) -> tuple[list[str], list[str]]:
    """Rows of both tables."""
    walk, settings = (
        synthetic.SyntheticSequence(synthetic.corridor(length), RIG, synthetic.Faults(noise=0.01)),
        resolve(),
    )
    pairs = list(walk)
    places = cut(len(pairs), count)
    pieces = [Piece([pairs[k] for k in frames], f"piece{n}") for n, frames in enumerate(places)]
    truth = walk.truth[[k for frames in places for k in frames]]
    kinds: dict[str, float] = defaultdict(float)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run(Piece(pairs, "whole"), folder / "one", settings)
        run(JoinedSequence(pieces), folder / "all", settings)
        tracking = cpu_seconds(lambda: [run(piece, folder / piece.name, settings) for piece in pieces])
        before = dict(steps._MAKERS)
        steps._MAKERS.update({kind: timed(kinds, kind, make) for kind, make in before.items()})
        started = time.process_time()
        join_runs([folder / piece.name for piece in pieces], folder / "joined")
        total = time.process_time() - started
        steps._MAKERS.update(before)
        errors = ate(folder / "one", walk.truth), ate(folder / "all", truth), ate(folder / "joined", truth)
    shown = [f"{kinds[kind]:.2f}" for kind in STEPS[2:-1]]
    row = [name, f"{len(pairs)}", *(f"{error:.4f}" for error in errors)]
    return row, [name, f"{tracking:.1f}", *shown, f"{total - sum(kinds.values()):.1f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, help="folder of the pages: writes joins_numbers.inc")
    parser.add_argument("--small", action="store_true", help="a walk of 9 m")
    options = parser.parse_args()
    wanted = {"corridor, 2 pieces": (9.0, 2)} if options.small else LENGTHS
    measure("warm", 5.0, 2)  # compiles
    rows = [measure(name, *given) for name, given in wanted.items()]
    text = "\n".join([table(HEAD, [row for row, _ in rows]), table(STEPS, [row for _, row in rows])])
    print(text)
    if options.docs:
        (options.docs / "joins_numbers.inc").write_text(text)


if __name__ == "__main__":
    main()
