"""A batch beside the best loop by hand: 16 short synthetic recordings, two processes, the same in the same measure.

    python -m benchmarks.batch [--rounds N] [--recordings N]

The loops are ``xargs -P 2 tspslam run``, with one thread a run and with the default. All kernels are compiled before
the first round. Wall seconds say how long one waits; on a machine that does other things too, those of the processor
are the ones to compare.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.sequences import write_sequence
from tspslam import Rig
from tspslam.datasets import synthetic

PROCESSES = 2
CLI = [sys.executable, "-m", "tspslam"]


def write_recordings(folder: Path, count: int) -> list[Path]:
    """Walks through corridors, 256 x 192 px, of 12 to 27 frames."""
    rig = synthetic.PAPER_RIG
    small = Rig(
        *(value / 2 for value in (rig.fx, rig.fy, rig.cx, rig.cy)), rig.baseline, rig.width // 2, rig.height // 2
    )
    return [write_walk(folder / f"walk{k:02d}", small, 6.0 + k % 16 / 2) for k in range(count)]


def write_walk(folder: Path, rig: Rig, length: float) -> Path:
    walk = synthetic.SyntheticSequence(synthetic.corridor(length), rig, synthetic.Faults(noise=0.01))
    return write_sequence(folder, walk)


def by_hand(recordings: list[Path], out: Path, *options: str) -> None:
    """The longest first, as someone who knows them would have it."""
    lines = "".join(f"{path}\n" for path in reversed(recordings))
    command = " ".join([*CLI, "run", "{}", "--out", f"{out}/$(basename {{}})", *options])
    words = ["xargs", "-P", str(PROCESSES), "-I", "{}", "sh", "-c", command]
    subprocess.run(words, input=lines, text=True, check=True, capture_output=True)


def by_batch(recordings: list[Path], out: Path) -> None:
    words = [*CLI, "batch", str(recordings[0].parent), "--out", str(out), "--workers", str(PROCESSES), "--threads", "2"]
    subprocess.run(words, check=True, capture_output=True)


def spent(function, *given) -> tuple[float, float]:
    """Seconds on the wall, and of the processor by all processes that were begun and have ended."""
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    function(*given)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - start, used


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--recordings", type=int, default=16)
    given = parser.parse_args(arguments)
    ways = {
        "batch": lambda recordings, out: by_batch(recordings, out),
        "loop, 1 thread": lambda recordings, out: by_hand(recordings, out, "--threads", "1"),
        "loop, default": lambda recordings, out: by_hand(recordings, out),
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    with tempfile.TemporaryDirectory() as folder:
        recordings = write_recordings(Path(folder, "walks"), given.recordings)
        out = Path(folder, "runs")
        by_batch(recordings[:1], out)
        for _ in range(given.rounds):
            for name, way in ways.items():
                shutil.rmtree(out, ignore_errors=True)
                out.mkdir()
                times[name].append(spent(way, recordings, out))
    report(times)


def report(times: dict[str, list[tuple[float, float]]]) -> None:
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    for name, rounds in times.items():
        walls, processor = ([round(each, 1) for each in column] for column in zip(*rounds, strict=True))
        print(f"{name:<16} wall {walls}  processor {processor}")
    for place, what in enumerate(("wall", "processor")):
        best = [
            min(rounds[k][place] for name, rounds in times.items() if name != "batch")
            for k in range(len(times["batch"]))
        ]
        ratios = [mine[place] / loop for mine, loop in zip(times["batch"], best, strict=True)]
        shown = [round(each, 3) for each in ratios]
        print(f"batch over the best loop, {what}: median {statistics.median(ratios):.3f} of {shown}")


if __name__ == "__main__":
    main(sys.argv[1:])
