"""A terrain with image tiles, larger than the memory: the store, filtered in tiles, beside 10^5 vertices in memory.

``python -m benchmarks.tiles 1e7 --folder FOLDER [--workers 2] [--memory "1.5 GB"]``: a line of JSON. Times are of the
processor; the peak is that of the largest process. Terrain and images are made as they are written, so that 10^8 needs
no more memory than 10^5; they stay in the folder, and what is there already is not made again.
"""

import argparse
import json
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import tspslam
from tspslam.io import read_image, write_png
from tspslam.scale import ImageReference, open_store, write_store
from tspslam.scale.stores.sources import Source, Vertices

SPACING = 4  # px from vertex to vertex
SIDE = 1500  # px of an image
OVERLAP = 16  # px beside a seam, which a star reaches over
BASE = 100_000  # vertices in memory
ROWS = 1 << 18  # vertices, or faces, of a block


def terrain(side: int, images: tuple[ImageReference, ...]) -> Source:
    """A square of side² vertices, 4 px apart but for a shift of up to 1, in rows."""
    return Source(vertices_of(side), faces_of(side), images, f"terrain of {side} x {side}")


def vertices_of(side: int) -> Iterator[Vertices]:
    step = max(1, ROWS // side)
    for first in range(0, side, step):
        v, u = np.mgrid[first : min(first + step, side), 0:side].reshape(2, -1).astype(np.float64)
        shift = np.random.default_rng(first).random((2, len(u)))
        uv = np.stack([u, v], axis=1) * SPACING + shift.T
        height = 20 * np.sin(u / 90) * np.cos(v / 70)
        column, row = (np.minimum(x // (SIDE - OVERLAP), count(side) - 1).astype(np.int32) for x in uv.T)
        yield Vertices(np.column_stack([0.1 * uv, height]), uv=uv, image=row * count(side) + column)


def faces_of(side: int) -> Iterator[np.ndarray]:
    step = max(1, ROWS // (2 * side))
    for first in range(0, side - 1, step):
        v, u = np.mgrid[first : min(first + step, side - 1), 0 : side - 1].reshape(2, -1)
        a = v * side + u
        b, c, d = a + 1, a + side, a + side + 1
        yield np.stack([a, c, b, b, c, d], axis=1).reshape(-1, 3)


def count(side: int) -> int:
    """Images along a side."""
    return max(1, -(-(side * SPACING + 1 - OVERLAP) // (SIDE - OVERLAP)))


def images_of(side: int, folder: Path) -> tuple[ImageReference, ...]:
    """Tiles of one texture, which agree where they overlap."""
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for row in range(count(side)):
        for column in range(count(side)):
            origin = column * (SIDE - OVERLAP), row * (SIDE - OVERLAP)
            path = folder / f"{row:03d}-{column:03d}.png"
            if not path.exists():
                write_png(path, texture(*origin))
            found.append(ImageReference(str(path), origin=(float(origin[0]), float(origin[1]))))
    return tuple(found)


def texture(u0: int, v0: int) -> np.ndarray:
    u, v = (np.arange(SIDE) + start for start in (u0, v0))
    fine = (u[None, :] * 73 ^ v[:, None] * 151) % 61
    wave = np.sin(u / 17)[None, :] * np.cos(v / 23)[:, None]
    return (128 + 80 * wave + fine / 2).astype(np.uint8)


def in_memory() -> float:
    """Processor seconds a vertex of the whole stage on 10^5 vertices, the least of five."""
    side = int(BASE**0.5)
    uv = np.concatenate([block.uv for block in vertices_of(side)])
    faces = np.concatenate(list(faces_of(side)))
    image = texture(0, 0)
    least = np.inf
    for _ in range(6):
        begin = time.process_time()
        complex_ = tspslam.build_complex(faces, len(uv))
        tspslam.tmahf(complex_, uv, tspslam.sample_signals(image, uv, complex_))
        least = min(least, time.process_time() - begin)
    return least / len(uv)


def used() -> float:
    """Processor seconds of this process and of those that it started and that ended."""
    each = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in each)


def measure(n: int, folder: Path, workers: int, memory: str) -> dict[str, float]:
    side = round(n**0.5)
    found: dict[str, float] = {"vertices": side * side}
    path = folder / f"terrain-{side}.zarr"
    if not path.exists():
        references = images_of(side, folder / f"images-{side}")
        begin = used()
        write_store(path, terrain(side, references))
        found["write_us_per_vertex"] = 1e6 * (used() - begin) / side**2
        found["write_peak_gb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    base = in_memory()
    store = open_store(path)
    begin = used()
    response = store.filter(workers=workers, memory=memory)
    spent = used() - begin
    begin = used()
    for path in store.mesh.image_paths:
        read_image(path)
    decoding = used() - begin
    found["base_us_per_vertex"] = 1e6 * base
    found["tiled_us_per_vertex"] = 1e6 * spent / side**2
    found["ratio"] = spent / side**2 / base
    found["ratio_without_decoding"] = (spent - decoding) / side**2 / base
    found["peak_gb"] = response.summary["peak_bytes"] / 1e9
    found["tiles"] = response.summary["tiles"]
    found["defined"] = response.summary["defined"] / side**2
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("vertices", type=float)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--memory", default="1.5 GB")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    print(json.dumps(measure(int(given.vertices), given.folder, given.workers, given.memory)))
