"""How a batch and a cloud in tiles go on 1 to 1 000 workers, by simulation: ``python -m benchmarks.fleet``.

Costs are measured here first (some minutes) and kept in ``docs/fleet_costs.json``; ``--again`` takes those of the file.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..measure import table
from .costs import Model, Sample, fit_costs
from .measure import taken
from .simulate import Cluster, Outcome, Task, simulate

FLEETS = (1, 10, 100, 1000)
RECORDINGS, MEDIAN_FRAMES, SPREAD, MEGAPIXELS = 400, 1500, 0.8, 1.226 * 0.37  # lognormal lengths, KITTI's size
TILE = 100.0  # thousand vertices
CLOUDS = (1e8, 1e10)
GIVEN = Cluster(1, bandwidth=1e9, link=1.25e9, lifetime=7 * 86400.0, checkpoint_seconds=60.0)
"""What no measurement here tells: one storage of 1 GB/s, links of 10 Gbit/s, each worker dies once a week."""

DAY, HOUR, MINUTE = 86400.0, 3600.0, 60.0


def drives(model: Model) -> list[Task]:
    """A lab's recordings, the longest first."""
    frames = MEDIAN_FRAMES * np.random.default_rng(0).lognormal(0.0, SPREAD, RECORDINGS)
    return [model.task(count, count * MEGAPIXELS) for count in sorted(frames, reverse=True)]


def tile(model: Model) -> Task:
    """One tile of a worker that has begun: without what a process takes at its start."""
    whole, none = model.task(TILE), model.task(0.0)
    return Task(whole.seconds - none.seconds, whole.reads, whole.writes)


def tiles(model: Model, vertices: float) -> list[Task]:
    """A cloud, tile by tile."""
    return [tile(model)] * round(vertices / (1e3 * TILE))


def workloads(models: dict[str, Model]) -> Iterator[tuple[str, list[Task]]]:
    yield f"{RECORDINGS} recordings", drives(models["recordings"])
    for vertices in CLOUDS:
        yield f"10^{np.log10(vertices):.0f} vertices in tiles", tiles(models["tiles"], vertices)


def said(seconds: float) -> str:
    """A time as people say it."""
    for unit, name in ((DAY, "days"), (HOUR, "h"), (MINUTE, "min")):
        if seconds >= unit:
            return f"{seconds / unit:.3g} {name}"
    return f"{seconds:.2g} s"


def row(name: str, tasks: list[Task], cluster: Cluster) -> list[str]:
    outcome: Outcome = simulate(tasks, cluster)
    shares = (outcome.computing, outcome.scheduler, outcome.storage, outcome.last)
    return [
        name,
        f"{cluster.workers:,}".replace(",", " "),
        said(outcome.makespan),
        *(f"{100 * share:.0f}" for share in shares),
        outcome.limit,
    ]


HEAD = ["work", "workers", "takes", "computing, %", "scheduler busy, %", "storage holds back, %", "tail, %", "limit"]


def breaking(name: str, tasks: list[Task], cluster: Cluster) -> list[str]:
    """How many workers there may be before under half of their time is computing, and what holds them back then."""
    count = 1
    while (outcome := simulate(tasks, replace(cluster, workers=count))).computing > 0.5:
        count *= 2
    return [name, str(count), outcome.limit]


def described(models: dict[str, Model], costs: dict[str, Any]) -> str:
    """Fitted costs in words."""
    one, cloud = models["recordings"], models["tiles"]
    drive, piece = one.task(1000, 1000 * MEGAPIXELS), tile(cloud)
    worst = 100 * max(one.worst, cloud.worst)
    return (
        f"Fitted: a recording of 1 000 pairs of 1226 x 370 px takes {said(drive.seconds)} of one processor and "
        f"{mb(one.memory(1000, 1000 * MEGAPIXELS))}, reads {mb(drive.reads)} and writes {mb(drive.writes)}; "
        f"a tile of {1e3 * TILE:.0f} vertices {said(piece.seconds)} and {mb(cloud.memory(TILE))}, "
        f"reads {mb(piece.reads)} "
        f"and writes {mb(piece.writes)}. No measured time is further off than {worst:.0f} %. "
        f"A message costs the scheduler {1e3 * costs['scheduler_seconds']:.2f} ms, "
        f"a worker {said(costs['start_seconds'])} to start.\n"
    )


def mb(size: float) -> str:
    return f"{size / 1e6:.3g} MB"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, default=Path(__file__).parents[2] / "docs", help="where the numbers are")
    parser.add_argument("--again", action="store_true", help="simulate with the costs of the file")
    given = parser.parse_args(arguments)
    kept = given.docs / "fleet_costs.json"
    if not given.again:
        kept.write_text(json.dumps(taken(), default=asdict, indent=1) + "\n", encoding="utf-8")
    costs = json.loads(kept.read_text(encoding="utf-8"))
    models = {
        name: fit_costs([Sample(**{**each, "size": tuple(each["size"])}) for each in costs[name]])
        for name in ("recordings", "tiles")
    }
    cluster = replace(GIVEN, scheduler_seconds=costs["scheduler_seconds"], start_seconds=costs["start_seconds"])
    work = list(workloads(models))
    rows = [row(name, tasks, replace(cluster, workers=count)) for name, tasks in work for count in FLEETS]
    broken = [breaking(name, tasks, cluster) for name, tasks in work]
    text = "\n".join(
        [
            described(models, costs),
            table(HEAD, rows),
            table(["work", "under half of the time computing from so many workers on", "what holds back then"], broken),
        ]
    )
    (given.docs / "fleet_numbers.inc").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main(sys.argv[1:])
