"""How times are taken: warm, interleaved, medians; only ratios are compared between machines."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence


def seconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def cpu_seconds(function: Callable[[], object], times: int = 1) -> float:
    """CPU time of this process a call, all its threads together."""
    start = time.process_time()
    for _ in range(times):
        function()
    return (time.process_time() - start) / times


def median_seconds(function: Callable[[], object], rounds: int = 15) -> float:
    function()
    return statistics.median(seconds(function) for _ in range(rounds))


def paired(ours: Callable[[], object], reference: Callable[[], object], rounds: int = 15) -> tuple[float, float, float]:
    """Median time of each, and the median of their ratio, taken in turn."""
    ours(), reference()
    times = [(seconds(ours), seconds(reference)) for _ in range(rounds)]
    a, b = zip(*times, strict=True)
    return statistics.median(a), statistics.median(b), statistics.median(x / y for x, y in times)


def process_seconds(*words: str, rounds: int = 7) -> float:
    """Median wall time of a whole interpreter process."""
    run = lambda: subprocess.run([sys.executable, *words], check=True, capture_output=True)  # noqa: E731
    return median_seconds(run, rounds)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A list table of a page."""
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for cells in (head, *rows):
        lines += [f"   {'*' if k == 0 else ' '} - {cell}" for k, cell in enumerate(cells)]
    return "\n".join(lines) + "\n"
