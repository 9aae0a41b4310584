"""Measure what recordings, tiles and the scheduler cost on this machine, one process after another."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tests.sequences import write_sequence
from tspslam import Rig
from tspslam.datasets import synthetic
from tspslam.scale.cluster import local_workers

from .costs import Sample

FRAMES, SIZES = (12, 40, 120), ((320, 120), (640, 240), (1226, 370))
VERTICES = (100_000, 300_000, 1_000_000)
FOCAL = 0.58  # of the width: KITTI's
EMPTY_TASKS = 2000
MEMORY = 2_000_000_000  # bytes of a worker
KIB = 1024


def measured_recordings(folder: Path) -> Iterator[Sample]:
    """Streets at 1 m a frame, run by ``tspslam run``, one thread."""
    for width, height in SIZES:
        for frames in FRAMES:
            source = _write_street(folder / f"{width}x{frames}", width, height, frames)
            out = folder / f"{width}x{frames}-run"
            words = ["run", str(source), "--out", str(out), "--threads", "1"]
            seconds, peak = spent([sys.executable, "-m", "tspslam", *words])
            size = (float(frames), frames * width * height / 1e6)
            yield Sample(size, seconds, peak, bytes_in(source), bytes_in(out))


def measured_tiles(folder: Path) -> Iterator[Sample]:
    """Terrains in one process, their time beyond its start: `benchmarks.tiles`."""
    for vertices in VERTICES:
        words = [sys.executable, "-m", "benchmarks.tiles", str(vertices), "--folder", str(folder / str(vertices))]
        found = json.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        count = found["vertices"]
        written = sum(bytes_in(path) for path in folder.glob(f"{vertices}/*/responses"))
        reads = bytes_in(folder / str(vertices)) - written
        yield Sample(
            (count / 1e3,), 1e-6 * count * found["tiled_us_per_vertex"], 1e9 * found["peak_gb"], reads, written
        )


def _write_street(folder: Path, width: int, height: int, frames: int) -> Path:
    rig = Rig(FOCAL * width, FOCAL * width, width / 2, height / 2, 0.54, width, height)
    walk = synthetic.SyntheticSequence(synthetic.street(float(frames - 1)), rig, synthetic.Faults(noise=0.01, blur=0.5))
    return write_sequence(folder, walk)


def spent(words: list[str]) -> tuple[float, float]:
    """Seconds of the processor, and bytes of resident memory at most, of a command and what it starts."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 4):  # 4: finished, with something to say
        raise RuntimeError(f"{' '.join(words)}: {said.decode()[-400:]}")
    process.returncode = 0
    return used.ru_utime + used.ru_stime, used.ru_maxrss * KIB


def bytes_in(folder: Path) -> float:
    """Of all files in a folder."""
    return float(sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()))


def scheduler_seconds() -> float:
    """Time of Dask's scheduler, and of its client, for one message: empty tasks, two messages each."""
    with local_workers(1, 1, MEMORY) as client:
        client.gather(client.map(abs, range(100)))
        before = time.process_time()
        client.gather(client.map(abs, range(1000, 1000 + EMPTY_TASKS)))
        return (time.process_time() - before) / (2 * EMPTY_TASKS)


def start_seconds() -> float:
    """From asking for a worker to its first result, with the package imported."""
    began = time.perf_counter()
    with local_workers(1, 1, MEMORY) as client:
        client.submit(_import).result()
        return time.perf_counter() - began


def _import() -> int:
    import tspslam.run

    return len(tspslam.run.__name__)


def taken() -> dict[str, object]:
    """All that the page needs of this machine."""
    dask = {
        "scheduler_seconds": scheduler_seconds(),
        "start_seconds": statistics.median(start_seconds() for _ in "123"),
    }
    with tempfile.TemporaryDirectory() as folder:
        recordings = list(measured_recordings(Path(folder, "recordings")))
        return dask | {"recordings": recordings, "tiles": list(measured_tiles(Path(folder, "tiles")))}
