"""Joined maps beside one run of the same frames: ``python -m benchmarks.joins [--docs docs] [--small]``.

A synthetic corridor is walked once; the walk is cut into pieces that overlap, each is run by itself, and the runs are
joined in one process. The same frames are run as one recording, and as several in one run (``tspslam run A B``). Errors
are those of the path (ATE); times are of the processor, by step, with kernels compiled before. Then the first 4, the
first 8 and all of 16 pieces of a long corridor are joined: what that costs a run, beside what it costs of 4.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tspslam import Rig, StereoPair, Trajectory, evaluate_trajectory
from tspslam.datasets import JoinedSequence, synthetic
from tspslam.io import read_trajectory
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.scale.maps import matching, steps
from tspslam.scale.maps.joining import join_runs

from .measure import cpu_seconds, table

PAPER = synthetic.PAPER_RIG
RIG = Rig(PAPER.fx / 2, PAPER.fy / 2, PAPER.cx / 2, PAPER.cy / 2, PAPER.baseline, PAPER.width // 2, PAPER.height // 2)
LENGTHS = {"corridor, 2 pieces": (15.0, 2), "corridor, 3 pieces": (15.0, 3)}  # m, and pieces
OVERLAP = 0.3  # of a piece, that it has in common with the next
HEAD = ("walk", "frames", "ATE of one run, m", "of all pieces in one run", "of joined runs")
KINDS = "state", "candidates", "shared", "frames", "map", "adjustment"
STEPS = ("walk", "tracking the pieces, s", *KINDS, "writing the run")
MANY, MANY_LENGTH = (4, 8, 16), 60.0  # runs of a long corridor, m
GROWTH = (
    "runs", "keyframes", "pairs of runs", "of them compared", "candidates", "ATE, m", "steps a run, over that of 4",
    *(f"of it {kind}, %" for kind in KINDS),
)  # fmt: skip


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


@contextmanager
def timed() -> Iterator[dict[str, float]]:
    """CPU time of the steps that are done meanwhile, s, by their kinds."""
    kinds, before = dict.fromkeys(KINDS, 0.0), dict(steps._MAKERS)

    def noted(kind: str, make: Callable[..., None]) -> Callable[..., None]:
        def timing(*given: object) -> None:
            kinds[kind] += cpu_seconds(lambda: make(*given))

        return timing

    steps._MAKERS.update({kind: noted(kind, make) for kind, make in before.items()})
    try:
        yield kinds
    finally:
        steps._MAKERS.update(before)


def walked(length: float) -> synthetic.SyntheticSequence:
    return synthetic.SyntheticSequence(synthetic.corridor(length), RIG, synthetic.Faults(noise=0.01))


def measure(name: str, length: float, count: int) -> tuple[list[str], list[str]]:
    """Rows of the first two tables."""
    walk, settings = walked(length), resolve()
    pairs = list(walk)
    places = cut(len(pairs), count)
    pieces = [Piece([pairs[k] for k in frames], f"piece{n}") for n, frames in enumerate(places)]
    truth = walk.truth[[k for frames in places for k in frames]]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        run(Piece(pairs, "whole"), folder / "one", settings)
        run(JoinedSequence(pieces), folder / "all", settings)
        tracking = cpu_seconds(lambda: [run(piece, folder / piece.name, settings) for piece in pieces])
        with timed() as kinds:
            total = cpu_seconds(lambda: join_runs([folder / piece.name for piece in pieces], folder / "joined"))
        errors = ate(folder / "one", walk.truth), ate(folder / "all", truth), ate(folder / "joined", truth)
    row = [name, f"{len(pairs)}", *(f"{error:.4f}" for error in errors)]
    return row, [
        name,
        f"{tracking:.1f}",
        *(f"{kinds[kind]:.2f}" for kind in KINDS),
        f"{total - sum(kinds.values()):.1f}",
    ]


def grow(counts: Sequence[int], length: float) -> list[list[str]]:
    """Rows of the table of many runs: the steps of a join alone, as the rest is that of any run."""
    walk = walked(length)
    pairs, rows, first = list(walk), list[list[str]](), 0.0
    places = cut(len(pairs), counts[-1])
    with tempfile.TemporaryDirectory() as temporary:
        folders = [Path(temporary) / f"piece{n}" for n in range(len(places))]
        for frames, folder in zip(places, folders, strict=True):
            run(Piece([pairs[k] for k in frames], folder.name), folder, resolve())
        for count in counts:
            out, told = Path(temporary) / f"joined{count}", list[np.ndarray]()
            with timed() as kinds, seen(told):
                record = join_runs(folders[:count], out).run.run
            compared, each = len(np.unique(told[0][:, [0, 2]], axis=0)), sum(kinds.values()) / count
            first = first or each
            truth = walk.truth[[k for frames in places[:count] for k in frames]]
            row = [count, record["keyframes"], count * (count - 1) // 2, compared, len(told[0])]
            shares = (f"{100 * kinds[kind] / sum(kinds.values()):.0f}" for kind in KINDS)
            rows.append([*map(str, row), f"{ate(out, truth):.4f}", f"{each / first:.2f}", *shares])
    return rows


@contextmanager
def seen(told: list[np.ndarray]) -> Iterator[None]:
    """Note the candidates that are found meanwhile."""
    find = matching.find_candidates

    def noted(*given: Any) -> np.ndarray:
        told.append(find(*given))
        return told[-1]

    matching.find_candidates = noted
    try:
        yield
    finally:
        matching.find_candidates = find


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, help="folder of the pages: writes joins_numbers.inc")
    parser.add_argument("--small", action="store_true", help="a walk of 9 m")
    options = parser.parse_args()
    wanted = {"corridor, 2 pieces": (9.0, 2)} if options.small else LENGTHS
    measure("warm", 5.0, 2)  # compiles
    rows = [measure(name, *given) for name, given in wanted.items()]
    many = grow((2, 3), 9.0) if options.small else grow(MANY, MANY_LENGTH)
    text = "\n".join(
        [table(HEAD, [row for row, _ in rows]), table(STEPS, [row for _, row in rows]), table(GROWTH, many)]
    )
    print(text)
    if options.docs:
        (options.docs / "joins_numbers.inc").write_text(text)


if __name__ == "__main__":
    main()
