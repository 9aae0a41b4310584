"""What other values of a setting do to the cloud of Motorcycle and to paths: the figures that sources of defaults name.

``python -m benchmarks.settings`` halves and doubles every number of the detectors and matchers, then every number of
the tracking; ``python -m benchmarks.settings detector.count=500 tracking.window=3`` tries what is given, each by
itself. Paths are those of synthetic scenes, and of recordings that ``--data FOLDER`` names (``FOLDER:3`` takes every
third frame).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import tspslam
from tspslam.datasets import open_sequence, synthetic
from tspslam.run.config import resolve
from tspslam.settings import KINDS


def score(pair: tspslam.StereoPair, truth: np.ndarray, assignments: list[str]) -> str:
    """Points, and how many of those with a true disparity have it to 1 px."""
    try:
        settings = resolve(assignments=assignments).settings
        cloud = tspslam.reconstruct(pair, detector=settings.detector, matcher=settings.matcher)
    except tspslam.TspSlamError as error:
        return str(error)
    column, row = np.floor(cloud.uv + 0.5).astype(int).T
    error_px = np.abs(cloud.disparity - truth[row, column])
    error_px = error_px[np.isfinite(error_px)]
    return f"{len(cloud):5} points, {(error_px <= 1).mean():6.1%} right to 1 px, median {np.median(error_px):.3f} px"


class Walk(NamedTuple):
    """Pairs in memory, and the true path."""

    name: str
    pairs: list[tspslam.StereoPair]
    truth: np.ndarray


def synthetic_walks() -> list[Walk]:
    """A corridor walked to and fro, and a street with 2 m from frame to frame."""
    faults = synthetic.Faults(noise=0.01, blur=0.4)
    corridor = synthetic.SyntheticSequence(synthetic.corridor(16.0), faults=faults)
    pairs = list(corridor)
    order = [*range(len(pairs)), *range(len(pairs) - 1, -1, -1)]
    street = synthetic.SyntheticSequence(
        synthetic.street(40.0, step=2.0), faults=synthetic.Faults(noise=0.01, blur=0.5)
    )
    return [
        Walk("corridor to and fro", [pairs[k] for k in order], corridor.truth[order]),
        Walk("fast street", list(street), street.truth),
    ]


def recorded_walk(given: str) -> Walk:
    """A recording with a true path, or every n-th frame of one."""
    folder, _, step = given.partition(":")
    sequence = open_sequence(folder)
    kept = range(0, len(sequence), int(step or 1))
    return Walk(given.rstrip("/").split("/")[-1], [sequence[k] for k in kept], np.asarray(sequence.truth)[list(kept)])


def score_path(walk: Walk, assignments: list[str]) -> str:
    """Absolute trajectory error, frames lost, keyframes and landmarks."""
    try:
        settings = resolve(assignments=assignments).settings
        with tspslam.Session(walk.pairs[0].rig, settings) as session:
            tracked = [session.odometry.process(replace(p, stamp=float(k))) for k, p in enumerate(walk.pairs)]
            path = session.finish()
    except tspslam.TspSlamError as error:
        return str(error)
    errors = tspslam.evaluate_trajectory(path, tspslam.Trajectory(path.stamp, walk.truth))
    world = session.odometry.map
    lost, sizes = sum(one.is_lost for one in tracked), f"{len(world.keyframes)} keyframes, {len(world.xyz)} landmarks"
    return f"{walk.name}: {1e3 * errors.ate_rmse_m:.1f} mm, {lost} lost, {sizes}"


def path_trials() -> Iterator[list[str]]:
    """Each number of the tracking halved and doubled, within its range."""
    for row in tspslam.list_settings():
        if row.name.startswith("tracking.") and type(row.default) in (int, float):
            for value in (row.default / 2, row.default * 2):
                value = min(max(value, row.low), row.high)
                value = max(1, round(value)) if isinstance(row.default, int) else value
                if value != row.default:
                    yield [f"{row.name}={value}"]


def trials() -> Iterator[list[str]]:
    """Each kind of detector and matcher as it is, then with each of its numbers halved and doubled."""
    for row in tspslam.list_settings():
        stage = row.name.split(".")[0]
        if stage not in ("detector", "matcher") or row.kind == "onnx":
            continue
        if not row.kind:
            yield from ([f"{stage}.kind={kind}"] for kind in KINDS[stage] if kind != "onnx")
        elif isinstance(row.default, int | float):
            for value in (type(row.default)(row.default / 2), type(row.default)(row.default * 2)):
                yield [f"{stage}.kind={row.kind}", f"{row.name}={value}"]


def main() -> None:
    words, data = [], []
    for before, word in zip(["", *sys.argv[1:]], sys.argv[1:], strict=False):
        (data if before == "--data" else words).append([word])
    given = [word for word in words if word != ["--data"]]
    is_path = [one[0].startswith("tracking.") for one in given]
    clouds = [one for one, path in zip(given, is_path, strict=True) if not path] if given else [[], *trials()]
    paths = [one for one, path in zip(given, is_path, strict=True) if path] if given else [[], *path_trials()]
    pair, truth = tspslam.datasets.motorcycle(), tspslam.datasets.motorcycle_truth()
    for assignments in clouds:
        print(f"{' '.join(assignments) or 'defaults':<60}  {score(pair, truth, assignments)}", flush=True)
    walks = [*synthetic_walks(), *(recorded_walk(one[0]) for one in data)] if paths else []
    for assignments in paths:
        for walk in walks:
            print(f"{' '.join(assignments) or 'defaults':<44}  {score_path(walk, assignments)}", flush=True)


if __name__ == "__main__":
    main()
