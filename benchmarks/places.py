"""Keyframes known by their looks: ``python -m benchmarks.places [--docs docs] [--development] [--small]``.

How long a query of the index takes among many simulated keyframes, beside comparing everything; and how many places
seen twice are told from others by binary words, by the response, and by both. By docs/uses_protocol.rst: WEIGHT was
chosen with --development, on worlds that are not scored. Recordings are used where TSPSLAM_DATA has them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tspslam import OrbDetector
from tspslam.apps.recognise import compare_descriptors
from tspslam.vision.features._hamming import nearest_both_ways
from tspslam.vision.features.binary import binary_descriptors
from tspslam.vision.slam.places.index import PlaceIndex

from .measure import table
from .uses.recognise import Places, mean_and_worst, measure, recordings, rooms, with_layout

FLIPPED = (0.082, 0.113, 0.152, 0.191, 0.215)  # of ORB's bits, 1 to 2 m on in a synthetic street: five quantiles
COUNT, SHARED = 400, 60  # descriptors of a keyframe; of those, seen again from elsewhere
QUERIES = 50
TRY = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # weights tried
WEIGHT = 20.0  # words that a similarity of 1 of the responses counts; development: 50 much the same
WORLDS = ("street", "corridor")
INDEX = ("keyframes", "add one, ms", "query, ms", "compare everything, ms", "found first", "kB a keyframe")
COLUMNS = ("pairs recalled at precision 1", "keyframes recalled at precision 1", "average precision")


def simulated(count: int) -> tuple[PlaceIndex, np.ndarray, float]:
    """An index of many keyframes, their descriptors (count, COUNT, 4), and ms for each that was added."""
    rng = np.random.default_rng(0)
    known = rng.integers(0, 2**64, (count, COUNT, 4), dtype=np.uint64)
    index = PlaceIndex()
    index.add(count, known[0])  # compiles
    index.drop(count)
    started = time.process_time()
    for number in range(count):
        index.add(number, known[number])
    return index, known, 1e3 * (time.process_time() - started) / count


def seen_again(rng: np.random.Generator, keyframe: np.ndarray) -> np.ndarray:
    """Another view of a keyframe's place: some of its descriptors, bits flipped, and others."""
    flips = rng.random((SHARED, 256)) < rng.choice(FLIPPED, (SHARED, 1))
    again = keyframe[:SHARED] ^ np.packbits(flips, axis=1).view(np.uint64)
    return np.concatenate([again, rng.integers(0, 2**64, (COUNT - SHARED, 4), dtype=np.uint64)])


def time_index(count: int) -> list[str]:
    """Keyframes; ms to add one, for a query, for comparing everything; share found first; kB a keyframe."""
    index, known, add_ms = simulated(count)
    rng, seconds, right = np.random.default_rng(1), [], 0
    for place in rng.integers(count, size=QUERIES).tolist():
        view = seen_again(rng, known[place])
        started = time.process_time()
        found, _ = index.query(view, 5)
        seconds.append(time.process_time() - started)
        right += int(len(found) > 0 and found[0] == place)
    every = known.reshape(-1, 4)
    nearest, bits, back = np.empty(COUNT, np.int64), np.empty((COUNT, 2), np.int64), np.empty(len(every), np.int64)
    nearest_both_ways(view, every[:10], nearest, bits, back)
    started = time.process_time()
    nearest_both_ways(view, every, nearest, bits, back)
    whole = time.process_time() - started
    return [
        f"{count}", f"{add_ms:.2f}", f"{1e3 * float(np.median(seconds)):.2f}", f"{1e3 * whole:.0f}",
        f"{right / QUERIES:.2f}", f"{index.nbytes / count / 1e3:.0f}",
    ]  # fmt: skip


def words_of(places: Places) -> np.ndarray:
    """Words that each keyframe shares with the earlier ones, (K, K), as a run asks its index."""
    index, found = PlaceIndex(), np.zeros((len(places.views), len(places.views)))
    for number, view in enumerate(places.views):
        descriptors = binary_descriptors(OrbDetector()(view.grey).descriptor)
        numbers, words = index.query(descriptors, len(places.views))
        found[number, numbers] = words
        index.add(number, descriptors)
    return found


def scores_of(places: Places) -> tuple[np.ndarray, np.ndarray]:
    """Similarity of all pairs by words and by responses."""
    rows = np.array([with_layout(view) for view in places.views])
    return words_of(places), compare_descriptors(rows, rows, mean=rows.mean(axis=0))


def develop() -> None:
    """Print what decides WEIGHT."""
    for kind in WORLDS:
        places = rooms(kind, 100)
        words, response = scores_of(places)
        print(places.name, "words", measure(words, places), "response", measure(response, places))
        for weight in TRY:
            print(f"  words + {weight} response", measure(words + weight * response, places), flush=True)


def scored(small: bool) -> Iterator[tuple[str, Places]]:
    for kind in WORLDS:
        for seed in range(1 if small else 2):
            yield kind, rooms(kind, seed)
    yield from recordings()


def recalled(small: bool) -> dict[str, dict[str, list[tuple[float, ...]]]]:
    """Figures of each method on each kind of data."""
    found: dict[str, dict[str, list[tuple[float, ...]]]] = {}
    for name, places in scored(small):
        words, response = scores_of(places)
        for method, score in {
            "binary words": words, "responses": response, "both": words + WEIGHT * response,
        }.items():  # fmt: skip
            figures = measure(score, places)
            found.setdefault(name, {}).setdefault(method, []).append(figures)
            print(f"{places.name:24}{method:16}", *(f"{x:.3f}" for x in figures), flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--docs", type=Path, help="write the tables there")
    parser.add_argument("--development", action="store_true", help="measure on development data alone")
    parser.add_argument("--small", action="store_true", help="fewer keyframes and worlds")
    given = parser.parse_args()
    if given.development:
        develop()
        return
    times = [time_index(count) for count in ((500, 1000) if given.small else (1000, 10_000))]
    print(", ".join(INDEX))
    print(*(", ".join(row) for row in times), sep="\n", flush=True)
    print(", ".join(COLUMNS))
    found = recalled(given.small)
    if given.docs:
        rows = [
            [name, method, *(mean_and_worst([one[k] for one in figures]) for k in range(len(COLUMNS)))]
            for name, methods in found.items()
            for method, figures in methods.items()
        ]
        (given.docs / "places_numbers.inc").write_text(table(["", "by", *COLUMNS], rows))
        (given.docs / "places_index.inc").write_text(table(list(INDEX), times))


if __name__ == "__main__":
    main()
