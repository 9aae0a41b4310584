"""What a keyframe costs as there are more, and what a kilometre takes: ``python -m benchmarks.long_maps [METRES]``.

First a simulated map of 5 000 keyframes, without images; then a street of so many metres (300 by default) at KITTI's
size, tracked: what the map, its images and the path hold, in bytes of their arrays.
"""

from __future__ import annotations

import contextlib
import resource
import sys
import time
from collections.abc import Iterator

import numpy as np

from tests.vision.slam.simulated_maps import STEP, Drive
from tspslam.vision.slam._state import map_state
from tspslam.vision.slam.odometry import StereoOdometry

from .slam import street

BLOCK, BLOCKS = 500, 10  # keyframes
MB = 1e6
OF_OTHERS = {"darwin": 1e6}  # what resident memory counts in, by system: bytes; elsewhere kB


def resident_mb() -> float:
    """The most memory that this process had so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / OF_OTHERS.get(sys.platform, 1e3)


def held_mb(drive: Drive) -> float:
    """Bytes of a map's arrays, and of the index of who sees what."""
    seen = sum(len(frame.landmark) for frame in drive.map.keyframes)
    return (sum(values.nbytes for values in map_state(drive.map).values()) + 8 * seen + 4 * len(drive.map.xyz)) / MB


def simulated() -> None:
    """Print the table of a simulated map."""
    print(f"{'keyframes':>9} {'km':>6} {'landmarks':>9} {'median ms':>9} {'slowest':>7} {'map, MB':>7} {'all, MB':>7}")
    seconds: list[float] = []

    @contextlib.contextmanager
    def timed() -> Iterator[None]:
        started = time.perf_counter()
        yield
        seconds.append(time.perf_counter() - started)

    drive = Drive(measure=timed, image_bytes=0)
    for _ in range(BLOCKS):
        drive.go(BLOCK)
        times, count = 1e3 * np.array(seconds[-BLOCK:]), len(drive.map.keyframes)
        print(
            f"{count:9d} {count * STEP / 1e3:6.1f} {drive.map.landmark_count:9d} {np.median(times):9.2f} "
            f"{times.max():7.1f} {held_mb(drive):7.1f} {resident_mb():7.0f}",
            flush=True,
        )


def tracked(length: float) -> None:
    """Print what a street takes."""
    sequence, before = street(length), 0.0
    odometry, seconds, state = StereoOdometry(sequence.rig), 0.0, 0.0
    for index in range(len(sequence)):
        pair = sequence[index]
        if index == 3:  # all is compiled and loaded
            before = resident_mb()
        started = time.perf_counter()
        odometry.process(pair)
        seconds += time.perf_counter() - started
    started = time.perf_counter()
    whole = odometry.state()
    state = time.perf_counter() - started
    km, world = length / 1e3, odometry.map
    images = sum(world.images.get(frame.index).nbytes for frame in world.keyframes)  # type: ignore[union-attr]
    numbers = sum(values.nbytes for values in whole.values())
    print(f"street of {length:g} m: {len(world.keyframes)} keyframes, {world.landmark_count} landmarks")
    print(f"a kilometre: {len(world.keyframes) / km:.0f} keyframes; map and path {numbers / MB / km:.1f} MB;")
    print(f"  images {images / MB / km:.1f} MB, of which {world.settings.image_bytes / MB:g} MB stay in memory")
    print(f"copied for a checkpoint in {1e3 * state:.1f} ms; {len(sequence) / seconds:.1f} frames/s")
    print(f"resident: {before:.0f} MB after three frames, {resident_mb():.0f} MB at most")
    odometry.finish()
    odometry.close()


if __name__ == "__main__":
    simulated()
    tracked(float(sys.argv[1]) if len(sys.argv) > 1 else 300.0)
