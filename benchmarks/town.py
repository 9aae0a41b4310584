"""The path through a synthetic town of kilometres, with loops: how good, how fast, in how much memory.

``python -m benchmarks.town [--path POSES] [--frames A:B] [--size 1226x370] [--seed 0] [--without-loops]``

`POSES` is a file of true poses in KITTI's form, such as that of odometry sequence 00; without one, three laps around
two blocks of houses. Images are rendered once, into the folder of temporary files.
"""

from __future__ import annotations

import argparse
import gc
import json
import multiprocessing
import resource
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tspslam import Trajectory, evaluate_trajectory
from tspslam.io import RunFolder
from tspslam.run.config import resolve
from tspslam.run.sequence import SequenceRun
from tspslam.session import Session
from tspslam.vision.se3 import inverse

from .town_images import Town, opened, render
from .town_measures import CLOSED, far_closures, motion_errors, revisits, runs, tied

WITHOUT_LOOPS = ("tracking.loops.candidates=0", "tracking.loops.lost_candidates=0")
KILOMETRE = 1000.0  # m
WARM = 40  # frames before it is timed: some keyframes
OFTEN = 100  # frames from one line of progress to the next
LONGEST = 10  # frames that are named
MB = 1024.0  # KB


@dataclass
class Times:
    """Seconds of each frame: by the clock, and of this process's processors; what of it was waiting."""

    clock: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    waited: list[float] = field(default_factory=list)


def follow(town: Town, folder: Path, wanted: slice, settings: tuple[str, ...]) -> dict[str, Any]:
    """Run over the frames, files and complexes of keyframes included, without drawing; and what came of it."""
    sequence, places = opened(town, folder, wanted)
    resolved, times = resolve(assignments=settings).settings, Times()
    with Session(sequence.rig, resolved, keep=False) as warm:  # compiles
        for place in places[:WARM]:
            warm.process(sequence[place])
    with tempfile.TemporaryDirectory() as out, RunFolder.create(f"{out}/run", {}) as kept:
        session = Session(sequence.rig, resolved, keep=False)
        run = SequenceRun(sequence, places, session, kept)
        before: list[tuple[float, Trajectory]] = []  # when the last frame was done, and the path as it was then
        clock, cpu = time.perf_counter(), time.process_time()
        for done, index in run.proceed(
            lambda frame: times.waited.append(frame.seconds.get("wait", 0.0)),
            lambda: before.append((time.perf_counter(), run.trajectory)),
        ):
            times.clock.append(time.perf_counter() - clock)
            times.cpu.append(time.process_time() - cpu)
            if done % OFTEN == 0:
                say(run, done, inverse(sequence.truth[places.start]) @ sequence.truth[index])
            clock, cpu = time.perf_counter(), time.process_time()
        finished, peak = time.perf_counter() - before[0][0], resident()  # what measures takes memory, too
        path = run.trajectory
        truth = Trajectory(sequence.stamps[places.start : places.stop], sequence.truth[places.start : places.stop])
        found = measure(path, truth, run.session.odometry)
        found["ATE before the last adjustment, m"] = evaluate_trajectory(before[0][1], truth).ate_rmse_m
        is_lost = np.flatnonzero([row.is_lost for row in run.tracked])
        found |= {"seconds of the last adjustment": finished, "frames lost": len(is_lost), "lost": runs(is_lost)}
        session.close()
    return (
        found
        | speeds(times, truth, np.array([row.is_keyframe for row in run.tracked]))
        | {"peak memory, MB": peak, "first frame": int(sequence.stamps[places.start] * 10 + 0.5)}
    )


def say(run: SequenceRun, done: int, true: NDArray[np.float64]) -> None:
    """How far a drive is, and how far off the camera is now, seen from its start."""
    odometry: Any = run.session.odometry
    off = np.linalg.norm((run.session.trajectory.T_world_camera[-1] - true)[:3, 3])
    counts = f"{run.keyframes} keyframes, {run.lost} lost, closures {odometry.mapper.closures}"
    print(f"{done} frames: {off:.3f} m off, {counts}, {resident():.0f} MB", flush=True)


def resident() -> float:
    """Largest resident memory of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MB


def measure(path: Trajectory, truth: Trajectory, odometry: Any) -> dict[str, Any]:
    """Errors of the path, and how many of the places that it comes back to it knew."""
    errors = evaluate_trajectory(path, truth)
    poses, stamps = truth.T_world_camera, truth.stamp
    again = revisits(stamps, poses)
    off = motion_errors(path.T_world_camera, poses, again)
    map_ = odometry.map.snapshot()
    known = tied(map_.keyframe, map_.start, map_.observed_id, stamps)
    anchors = odometry.path.anchors[again[:, 0]]
    back = np.isin(anchors, known) | (stamps[again[:, 0]] - stamps[anchors] > 30)
    closures = np.array(odometry.mapper.closures, np.int64).reshape(-1, 2)
    far = far_closures(closures, poses)
    wrong = far[motion_errors(path.T_world_camera, poses, far) > CLOSED]
    return {
        "frames": len(truth.stamp),
        "way, m": errors.kitti.travelled_m,
        "ATE, m": errors.ate_rmse_m,
        "largest error, m": float(errors.ate_m.max()),
        "t_rel over 100 m, %": errors.kitti.per_length.get(100.0, (0, None, None))[1],
        "t_rel over 100 to 800 m, %": errors.kitti.translation_percent if errors.kitti.per_length else None,
        "r_rel, deg/100 m": errors.kitti.rotation_deg_100m if errors.kitti.per_length else None,
        "scale": errors.scale,
        "revisits": len(again),
        "closed, %": _share(back & (off <= CLOSED)),
        "tied to a keyframe of over 30 s before, %": _share(back),
        "right to 0.5 m, %": _share(off <= CLOSED),
        "not closed": runs(again[~back | (off > CLOSED), 0]),
        "largest error of a revisit, m": float(off.max(initial=0)),
        "closures": closures.tolist(),
        "closures of places over 10 m away": far.tolist(),
        "false closures, also over 0.5 m off": wrong.tolist(),
        "keyframes": len(map_.keyframe),
        "landmarks": len(map_.xyz),
        "disparity offset, px": list(odometry.disparity_offset),
    }


def _share(found: NDArray[np.bool_]) -> float | None:
    """In per cent; None of nothing."""
    return 100 * float(found.mean()) if len(found) else None


def speeds(times: Times, truth: Trajectory, is_keyframe: NDArray[np.bool_]) -> dict[str, Any]:
    """Rates of the first and of the last kilometre, and the slowest frames.

    Keyframes come by the way, so that a frame costs more where the camera goes faster: a kilometre tells that apart.
    """
    steps: NDArray[np.float64] = np.linalg.norm(np.diff(truth.T_world_camera[:, :3, 3], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    clock, cpu, waited = (np.array(values) for values in (times.clock, times.cpu, times.waited))
    length = min(KILOMETRE, along[-1] / 2)
    first, last = along <= length, along >= along[-1] - length
    slow = np.argsort(-clock)[:LONGEST]
    return {
        "frames/s": float(1 / clock.mean()),
        "frames/s of the last kilometre over the first's": float(clock[first].mean() / clock[last].mean()),
        "the same by processor time": float(cpu[first].mean() / cpu[last].mean()),
        "keyframes a frame there over the first's": float(is_keyframe[last].mean() / is_keyframe[first].mean()),
        "processor time of the first kilometre over the last's": float(cpu[first].sum() / cpu[last].sum()),
        "longest frames, s": [[int(k), round(float(clock[k]), 3)] for k in slow],
        "longest waits, s": [[int(k), round(float(waited[k]), 3)] for k in np.argsort(-waited)[:LONGEST]],
        "median frame, s": float(np.median(clock)),
    }


def alone(*given: Any) -> dict[str, Any]:
    """Run in a process of its own, so that memory is of this run."""
    gc.collect()
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(follow, *given).result()


TOLD = [  # what the page tells
    "first frame", "frames", "way, m", "ATE, m", "t_rel over 100 m, %", "t_rel over 100 to 800 m, %",
    "r_rel, deg/100 m", "frames lost", "revisits", "closed, %", "right to 0.5 m, %", "closures",
    "false closures, also over 0.5 m off",
    "keyframes", "frames/s of the last kilometre over the first's", "the same by processor time",
    "keyframes a frame there over the first's", "processor time of the first kilometre over the last's",
    "longest waits, s", "peak memory, MB",
]  # fmt: skip


def table(town: Town, with_loops: dict[str, Any], without: dict[str, Any]) -> str:
    """What is told of a drive, with loops and without."""
    width, height = town.size
    name = "the made path" if town.path is None else f"sequence {town.path.stem}"
    lines = [f"Along {name}, images of {width} x {height} px, seed {town.seed}:", "", ".. list-table::"]
    lines += ["   :header-rows: 1", "", "   * - figure", "     - as it is", "     - without loops"]
    for key in TOLD:
        lines += [f"   * - {key}", *(f"     - {_short(key, found[key])}" for found in (with_loops, without))]
    return "\n".join(lines) + "\n"


def _short(key: str, value: Any) -> str:
    """A figure for the page: lists as how many, waits as the longest."""
    if key == "longest waits, s":
        return f"{value[0][1]:.2g}"
    if isinstance(value, list):
        return str(len(value))
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def tell(found: dict[str, Any]) -> None:
    for name, value in found.items():
        print(f"{name}: {json.dumps(value)}", flush=True)


def parsed(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--path", type=Path, help="true poses in KITTI's form")
    parser.add_argument("--frames", default=":", help="A:B, some of them")
    parser.add_argument("--size", default="1226x370", help="of the images, px")
    parser.add_argument("--seed", type=int, default=0, help="of the town")
    parser.add_argument("--without-loops", action="store_true", help="measure the drift: no loop is closed")
    parser.add_argument("--set", action="append", default=[], help="a setting, key=value")
    parser.add_argument("--render", action="store_true", help="only render")
    parser.add_argument("--docs", type=Path, help="drive with loops and without, and write the table there")
    return parser.parse_args(arguments)


def main(arguments: list[str]) -> None:
    given = parsed(arguments)
    wanted = slice(*(int(end) if end else None for end in given.frames.split(":")))
    width, height = (int(side) for side in given.size.split("x"))
    town, settings = Town(given.path, (width, height), given.seed), tuple(given.set)
    folder = render(town, wanted)
    print(folder, flush=True)
    if given.render:
        return
    first = alone(town, folder, wanted, (*(WITHOUT_LOOPS if given.without_loops else ()), *settings))
    tell(first)
    if given.docs:
        without = alone(town, folder, wanted, (*WITHOUT_LOOPS, *settings))
        tell(without)
        (given.docs / "town_numbers.inc").write_text(table(town, first, without), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
