"""Signals denoised, by docs/uses_protocol.rst: ``python -m benchmarks.uses.signals [--docs docs] [--quick]``.

Prints and, with ``--docs``, writes the table and the picture of the page. ``--quick``: development photographs, seed
100, n = 4 000.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import Delaunay
from skimage import data

import tspslam
from tspslam.apps import signals as ours
from tspslam.topology.texture import luminance

from . import signals_rivals as rivals
from .signals_rivals import best, psnr

SCORED = ("astronaut", "camera", "coffee", "motorcycle", "immunohistochemistry")
DEVELOPMENT = ("chelsea", "coins", "rocket", "brick")
NOISES = (0.05, 0.1, 0.2)
SIZES = (4_000, 20_000)
OAKD = tspslam.Rig(fx=451.0344, fy=451.0344, cx=299.0384, cy=255.165, baseline=0.075, width=640, height=480)
LEVELS = ("vertex", "edge", "face")
NAMES = {
    "heat": "heat on L0, oracle t",
    "tikhonov": "Tikhonov on L0, oracle t (seed 0)",
    "pygsp": "PyGSP's Tikhonov regression, oracle weight (seed 0)",
    "variation": "total variation on the graph (pyunlocbox), oracle weight (seed 0)",
    "bilateral": "bilateral mean over neighbours, oracle width (seed 0)",
    "image means": "image by non-local means, oracle strength, sampled (seed 0)",
    "image variation": "image by total variation, oracle weight, sampled (seed 0)",
    "vertices only": "our method on vertices only",
    "without uv": "ours without projections",
    "noise known": "ours, the noise known",
    "noisy": "vertices: the noisy signals",
    "edge": "edges: the noisy means",
    "edge smooth": "edges: smooth_signals, oracle t",
    "face": "faces: the noisy means",
    "face smooth": "faces: smooth_signals, oracle t",
}


def photographs(names):
    """Name and luminance of each image; recordings where they are."""
    for name in names:
        image = data.stereo_motorcycle()[0] if name == "motorcycle" else getattr(data, name)()
        yield name, np.ascontiguousarray(luminance(image))
    folder = os.environ.get("TSPSLAM_DATA")
    if folder and names is SCORED:
        for name, path in (
            ("KITTI", Path(folder) / "kitti_seq1" / "image_l" / "000025.png"),
            ("EuRoC", sorted((Path(folder) / "euroc_v101_keyframes" / "images").glob("*_0.jpg"))[50]),
        ):
            yield name, np.ascontiguousarray(luminance(tspslam.io.read_image(path)))


def random_complex(image, n, seed):
    uv = np.random.default_rng(seed).random((n, 2)) * (np.array(image.shape[::-1]) - 1)
    return uv, tspslam.build_complex(Delaunay(uv).simplices, n)


def sampled(image, uv, complex_):
    """Signals of an image of any values, which noise may have put outside [0, 1]."""
    twice = tspslam.sample_signals(np.stack([image, image], axis=-1), uv, complex_)
    return replace(twice, **{level: getattr(twice, level)[:, 0].copy() for level in LEVELS})


def compare(uv, complex_, image, noisy_image, noise, filtered) -> dict[str, float]:
    """PSNR of ours less each rival's; without images, the slow ones are left out."""
    true, noisy = sampled(image, uv, complex_), sampled(noisy_image, uv, complex_)
    got = {
        level: psnr(getattr(ours.denoise_signals(complex_, noisy, uv=uv), level), getattr(true, level))
        for level in LEVELS
    }
    graph = ours.build_graph(complex_, noisy, uv)
    values = graph.pack(noisy)[0]
    s, t = noisy.vertex, true.vertex
    smooth = rivals.smoothed_levels(complex_, noisy, true)
    vertex = {
        "heat": best(rivals.heat(complex_.L0, s), t),
        "vertices only": psnr(rivals.ours_on_vertices(graph, values, ours.estimate_variance(graph, values)), t),
        "without uv": psnr(ours.denoise_signals(complex_, noisy).vertex, t),
        "noise known": psnr(ours.denoise_signals(complex_, noisy, uv=uv, noise=noise).vertex, t),
        "noisy": psnr(s, t),
    }
    if filtered:
        vertex |= {
            "tikhonov": best(rivals.tikhonov(complex_.L0, s), t),
            "pygsp": best(rivals.regression(complex_, s), t),
            "variation": best(rivals.total_variation(complex_, s, noise), t),
            "bilateral": max(psnr(x, t) for x in rivals.bilateral(complex_, s, noise)),
            **{
                name: max(psnr(sampled(x, uv, complex_).vertex, t) for x in images) for name, images in filtered.items()
            },
        }
    gains = {name: got["vertex"] - value for name, value in vertex.items()}
    for level, smoothed in zip(("edge", "face"), smooth, strict=True):
        gains[level] = got[level] - psnr(getattr(noisy, level), getattr(true, level))
        gains[f"{level} smooth"] = got[level] - smoothed
    return {**gains, "own psnr": got["vertex"], "noise psnr": vertex["noisy"]}


def measure(names, sizes, seeds):
    """Rows: image, n, seed, noise, differences."""
    rows, begun = [], time.perf_counter()
    for name, image in photographs(names):
        for seed in seeds:
            field = np.random.default_rng(seed).normal(size=image.shape)
            for noise in NOISES:
                noisy = image + noise * field
                filtered = {}
                if seed == seeds[0]:
                    filtered["image means"] = list(rivals.images_by_means(noisy, noise))
                    filtered["image variation"] = list(rivals.images_by_variation(noisy, noise))
                for n in sizes:
                    uv, complex_ = random_complex(image, n, seed)
                    rows.append((name, n, seed, noise, compare(uv, complex_, image, noisy, noise, filtered)))
            shown = rows[-1][-1]
            print(
                f"{time.perf_counter() - begun:5.0f} s {name}, seed {seed}, last: {shown['heat']:.2f} dB over heat",
                flush=True,
            )
    return rows


def little_noise(names) -> list[str]:
    """Over the noisy signals at noise of 0.01, and the PSNR of what comes out of clean vertices, worst items."""
    gains, clean = {level: [] for level in LEVELS}, []
    for name, image in photographs(names):
        noisy = image + 0.01 * np.random.default_rng(0).normal(size=image.shape)
        for n in SIZES:
            uv, complex_ = random_complex(image, n, 0)
            s, t = sampled(noisy, uv, complex_), sampled(image, uv, complex_)
            got = ours.denoise_signals(complex_, s, uv=uv)
            for level in LEVELS:
                before, after = (psnr(getattr(each, level), getattr(t, level)) for each in (s, got))
                gains[level].append((after - before, name, n))
            clean.append((psnr(ours.denoise_signals(complex_, t, uv=uv).vertex, t.vertex), name, n))
    lines = []
    for level in LEVELS:
        mean, (gain, name, n) = np.mean([gain for gain, *_ in gains[level]]), min(gains[level])
        lines.append(
            f"{level}, noise 0.01, over the noisy ones: mean {mean:+.2f}, worst {gain:+.2f} dB ({name}, n = {n})"
        )
    lines.append("no noise, PSNR of what comes out: worst {:.2f} dB ({}, n = {})".format(*min(clean)))
    return lines


def stereo_pairs():
    """Motorcycle and, where recordings are, the scored frame of KITTI and two that nothing here was chosen on."""
    yield "Motorcycle", tspslam.datasets.motorcycle()
    if folder := os.environ.get("TSPSLAM_DATA"):
        street, road, room = (Path(folder) / name for name in ("kitti_seq1", "kitti_05", "oakd_pairs"))
        for name, left, right, calib in (
            ("KITTI 06", street / "image_l" / "000025.png", street / "image_r" / "000025.png", street / "calib.txt"),
            ("KITTI 05", road / "image_0" / "000030.png", road / "image_1" / "000030.png", road / "calib.txt"),
            ("OAK-D", room / "desk_left.png", room / "desk_right.png", OAKD),
        ):
            yield name, tspslam.read_pair(left, right, calib)


def stereo_complexes() -> list[str]:
    """The same on complexes that stereo gives: few vertices, all on corners of the image."""
    lines = []
    for name, pair in stereo_pairs():
        frame, image = tspslam.Session(pair.rig).process(pair), np.ascontiguousarray(luminance(pair.left))
        uv, complex_, ok = frame.cloud.uv, frame.complex_, frame.signals.vertex_ok
        for noise in (0.01, *NOISES):
            field = image + noise * np.random.default_rng(0).normal(size=image.shape)
            true, noisy = (sampled(each, uv, complex_) for each in (image, field))
            truth, raw = true.vertex[ok], psnr(noisy.vertex[ok], true.vertex[ok])
            gains = [
                psnr(ours.denoise_signals(complex_, noisy, uv=uv, noise=given).vertex[ok], truth) - raw
                for given in (None, noise)
            ]
            gains.append(max(psnr(x[ok], truth) for x in rivals.heat(complex_.L0, noisy.vertex)) - raw)
            told = "{:+.2f} dB, noise given {:+.2f}, heat {:+.2f}".format(*gains)
            lines.append(f"{name}'s stereo complex, {complex_.n} vertices, noise {noise}, over noisy vertices: {told}")
    return lines


def speed() -> str:
    """Time of 20 000 vertices, a fresh complex each, beside heat with a given t; the processor's own."""
    _, image = next(photographs(("motorcycle",)))
    uv, complex_ = random_complex(image, 20_000, 0)
    noisy = sampled(image + 0.1 * np.random.default_rng(0).normal(size=image.shape), uv, complex_)
    ways = (
        lambda: ours.denoise_signals(replace(complex_), noisy, uv=uv),
        lambda: tspslam.heat_filter(replace(complex_).L0, noisy.vertex, 1.0),
    )
    times = []
    for _ in range(16):  # the first is not counted: it compiles
        for way in ways:
            begun = time.thread_time()
            way()
            times.append(time.thread_time() - begun)
    mine, heat = np.median(np.reshape(times, (16, 2))[1:], axis=0)
    return f"20 000 vertices: {1e3 * mine:.0f} ms on one core; heat on their L0 alone {1e3 * heat:.0f} ms"


def cell(values) -> str:
    return f"{np.mean(values):+.2f} ({np.min(values):+.2f})"


def table(rows) -> str:
    """Mean over items, and the worst, for each noise."""
    lines = [".. list-table::", "   :header-rows: 1", ""]
    body = [["ours over, dB: mean (worst)", *[f"noise {noise}" for noise in NOISES]]]
    for key, name in NAMES.items():
        body.append(
            [name, *[cell([row[4][key] for row in rows if row[3] == noise and key in row[4]]) for noise in NOISES]]
        )
    for key, name in (("noise psnr", "PSNR of the noisy vertices, dB"), ("own psnr", "PSNR of ours, vertices, dB")):
        body.append([name, *[f"{np.mean([row[4][key] for row in rows if row[3] == noise]):.2f}" for noise in NOISES]])
    for line in body:
        lines += [f"   {'*' if k == 0 else ' '} - {text}" for k, text in enumerate(line)]
    return "\n".join(lines) + "\n"


def split_table(rows) -> list[str]:
    """Over heat by number of vertices and by image, for the log."""
    lines = []
    for title, column in (("n", 1), ("image", 0)):
        for key in dict.fromkeys(row[column] for row in rows):
            chosen = [cell([r[4]["heat"] for r in rows if r[column] == key and r[3] == noise]) for noise in NOISES]
            lines.append(f"over heat, {title} {key}: {', '.join(chosen)}")
    return lines


def draw(path: Path) -> None:
    """A piece of Motorcycle on 20 000 vertices: clean, noisy, heat with the oracle's t, ours."""
    _, image = next(photographs(("motorcycle",)))
    uv, complex_ = random_complex(image, 20_000, 0)
    true, noisy = (
        sampled(i, uv, complex_) for i in (image, image + 0.1 * np.random.default_rng(0).normal(size=image.shape))
    )
    heat = max(rivals.heat(complex_.L0, noisy.vertex), key=lambda x: psnr(x, true.vertex))
    panels = {"true": true.vertex, "noisy, 0.1": noisy.vertex, "heat, oracle t": heat,
              "denoise_signals": ours.denoise_signals(complex_, noisy, uv=uv).vertex}  # fmt: skip
    figure = Figure(figsize=(12, 3.7), layout="constrained")
    for axes, (name, values) in zip(figure.subplots(1, 4), panels.items(), strict=True):
        axes.tripcolor(*uv.T, complex_.faces, values, shading="gouraud", cmap="gray", vmin=0, vmax=1)
        title = name if name == "true" else f"{name}: {psnr(values, true.vertex):.1f} dB"
        axes.set(title=title, xlim=(230, 530), ylim=(400, 100), aspect="equal", xticks=[], yticks=[])
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    names, sizes, seeds = (DEVELOPMENT, SIZES[:1], (100,)) if given.quick else (SCORED, SIZES, (0, 1, 2))
    rows = measure(names, sizes, seeds)
    notes = [*little_noise(names), speed(), *stereo_complexes()]
    print(table(rows), *split_table(rows), *notes, sep="\n")
    if given.docs:
        listed = "\n".join(f"* {note}" for note in notes)
        (given.docs / "uses_signals.inc").write_text(f"{table(rows)}\n{listed}\n", encoding="utf-8")
        draw(given.docs / "images" / "uses_signals.png")


if __name__ == "__main__":
    main()
