"""Quality: does a score follow the level of eight distortions, each alone and all of them together?

``python -m benchmarks.uses.quality [--development] [--docs docs]``
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import rankdata

from tspslam.apps.quality import Quality, compare_features, compare_quality, quality_features

from .. import mapping
from . import quality_data as data
from . import quality_rivals as rivals
from .quality_data import Item, Side

Scores = dict[str, NDArray[np.float64]]  # of each method on one item: (kinds, levels)

OURS, PLAIN, ALONE, ON_VERTICES, REDUCED = (
    "ours", "positions and signals alone", "responses alone", "ours, vertices only", "ours, 256 features",
)  # fmt: skip
RIVALS: dict[str, Callable[[Item, Item], float]] = {
    "luminance, PSNR": rivals.psnr,
    "point to plane": rivals.point_to_plane,
    "rendered views, SSIM": rivals.rendered_ssim,
    "features as in PCQM": rivals.features,
}


def scores_of(item: Item) -> Scores:
    reference = item.side
    known, bare = quality_features(*reference), on_vertices(reference)
    found: Scores = {}
    for row, kind in enumerate(data.LEVELS):
        for level in range(data.STEPS):
            other = data.distorted(item, kind, level)
            side = other.side
            whole = compare_quality(reference, side)
            one = {OURS: whole.score, PLAIN: pooled(whole, "response", False), ALONE: pooled(whole, "response", True)}
            one[ON_VERTICES] = compare_quality(bare, on_vertices(side)).score
            one[REDUCED] = compare_features(known, quality_features(*side)).score
            one |= {name: rival(item, other) for name, rival in RIVALS.items()}
            for name, score in one.items():
                found.setdefault(name, np.zeros((len(data.LEVELS), data.STEPS)))[row, level] = score
    return found


def pooled(quality: Quality, word: str, has: bool) -> float:
    """The score of those parts alone whose name begins with a word, or of the others."""
    return float(np.sqrt(np.mean([part**2 for name, part in quality.parts.items() if name.startswith(word) == has])))


def on_vertices(side: Side) -> Side:
    """The side without what stands on edges and faces: none of our constants is there to be chosen again for it."""
    s = side.signals
    return side._replace(
        signals=replace(
            s, edge=0 * s.edge, face=0 * s.face, edge_ok=np.zeros_like(s.edge_ok), face_ok=np.zeros_like(s.face_ok)
        )
    )


def rank_correlation(scores: NDArray[np.float64], levels: NDArray[np.float64]) -> float:
    """Spearman's; 0 where all scores are the same."""
    a, b = rankdata(scores), rankdata(levels)
    return 0.0 if np.ptp(a) == 0 else float(np.corrcoef(a, b)[0, 1])


def figures(several: dict[str, Scores], method: str) -> dict[str, float]:
    """Measures of one method over the items."""
    level = np.arange(data.STEPS)
    by_kind = np.array([[rank_correlation(row, level) for row in scores[method]] for scores in several.values()])
    across = [rank_correlation(s[method].ravel(), np.tile(level, len(data.LEVELS))) for s in several.values()]
    rising = np.mean([(np.diff(row) > 0).all() for scores in several.values() for row in scores[method]])
    return {
        **dict(zip(data.LEVELS, by_kind.min(axis=0), strict=True)),
        "worst": by_kind.min(),
        "mean": by_kind.mean(),
        "monotone": rising,
        "across": float(np.mean(across)),
        "across, worst": min(across),
    }


def tables(several: dict[str, Scores]) -> str:
    methods = list(next(iter(several.values())))
    found = {method: figures(several, method) for method in methods}
    kinds = ["", *data.LEVELS]
    first = [[method, *(f"{found[method][kind]:.2f}" for kind in data.LEVELS)] for method in methods]
    head = ["", "worst", "mean", "monotone, %", "across kinds, mean", "across kinds, worst item"]
    keys = ("worst", "mean", "monotone", "across", "across, worst")
    second = [[method, *cells([found[method][key] for key in keys])] for method in methods]
    items = ["across kinds", *several]
    third = [[method, *(f"{figures({name: several[name]}, method)['across']:.2f}" for name in several)]
             for method in methods]  # fmt: skip
    return "\n".join(mapping.list_table(*table) for table in ((head, second), (kinds, first), (items, third)))


def cells(values: list[float]) -> list[str]:
    worst, mean, rising, *across = values
    return [f"{worst:.2f}", f"{mean:.3f}", f"{100 * rising:.0f}", *(f"{value:.2f}" for value in across)]


def times() -> str:
    """Milliseconds at 20 000 vertices, beside the search that comparing clouds point by point begins with."""
    item = data.motorcycle(21_000, 100)
    reference, moved, fewer = (
        x.side for x in (item, *(data.distorted(item, k, 3) for k in ("position noise", "decimation")))
    )
    jobs = {
        "same faces": lambda: compare_quality(reference, moved),
        "other faces": lambda: compare_quality(reference, fewer),
        "256 features": lambda: quality_features(*reference),
        "k-d trees of both and nearest vertices": lambda: [
            cKDTree(a).query(b) for a, b in ((reference.xyz, moved.xyz), (moved.xyz, reference.xyz))
        ],
    }
    rows = [[name, f"{1000 * median_seconds(job):.0f}"] for name, job in jobs.items()]
    return mapping.list_table([f"{len(item.xyz)} vertices, one core", "ms"], rows)


def median_seconds(job: Callable[[], object], rounds: int = 7) -> float:
    job()
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        job()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--development", action="store_true", help="the data that chose the method, instead")
    parser.add_argument("--docs", type=Path, help="write the tables and pictures there")
    given = parser.parse_args()
    several = {}
    for item in data.development() if given.development else data.scored():
        start = time.perf_counter()
        several[item.name] = scores_of(item)
        print(f"{item.name}: {len(item.xyz)} vertices, {time.perf_counter() - start:.0f} s", flush=True)
        print(np.round(several[item.name][OURS], 3), flush=True)
    text = tables(several) + "\n" + times()
    print(text)
    if given.docs:
        from .quality_pictures import draw

        (given.docs / "uses_quality.inc").write_text(text, encoding="utf-8")
        draw(given.docs / "images", several)


if __name__ == "__main__":
    main()
