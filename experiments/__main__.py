"""Run the experiments: ``python -m experiments [--data FOLDER] [--out FOLDER] [NAME ...]``."""

from __future__ import annotations

import argparse
import csv
import importlib
import io
import json
import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np

import tspslam
from tspslam.io import write_bytes

from .common import Source
from .page import write_page

NAMES = (
    "fig02_toy_complex", "fig04_keypoints", "fig05_cloud_and_surface", "fig06_edges_and_faces",
    "fig07_heat_and_hops", "fig08_angles", "fig09_10_responses", "fig11_12_tori",
    "table2_time", "answer_a_what_it_sees", "answer_b_bad_meshes", "answer_c_hops_or_heat",
    "answer_d_edges_and_faces", "answer_e_scale",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="experiments", description="The paper's figures and tables, and its answers.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}; all by default")
    parser.add_argument("--data", type=Path, help="a KITTI, EuRoC, UTIAS or plain stereo folder; default: Motorcycle")
    parser.add_argument("--out", type=Path, default=Path("experiments/out"))
    parser.add_argument("--docs", type=Path, help="also write the documentation's page there")
    parser.add_argument("--small", action="store_true", help="little scenes, as the tests use them")
    chosen = parser.parse_args(arguments)
    unknown = [name for name in chosen.names if name not in NAMES]
    if unknown:
        parser.error(f"no experiment is called {unknown[0]}, expected some of {', '.join(NAMES)}")
    return run(chosen.names or NAMES, Source(chosen.data, small=chosen.small), chosen.out, chosen.docs)


def run(names, source: Source, out: Path, docs: Path | None) -> int:
    """Run each experiment and write what it gives; 4 if one was skipped for want of data, else 0."""
    results, skipped = {}, 0
    out.mkdir(parents=True, exist_ok=True)
    for name in names:
        start = time.perf_counter()
        try:
            result = importlib.import_module(f".{name}", __package__).run(source)
        except tspslam.TspSlamError as error:
            print(f"{name}: skipped: {error}", file=sys.stderr)
            results[name], skipped = {"skipped": str(error)}, skipped + 1
            continue
        _write(result, out / name)
        seconds = round(time.perf_counter() - start, 1)
        results[name] = {"numbers": dict(result.numbers), "paper": dict(result.paper), "seconds": seconds}
        print(f"{name}: {seconds} s")
    write_bytes(out / "results.json", json.dumps(results, indent=1, default=float).encode())
    if docs:
        write_page(results, out, docs)
    return 4 if skipped else 0


def _write(result, stem: Path) -> None:
    """The picture and the rows of one experiment."""
    picture, rows = io.BytesIO(), io.StringIO()
    result.figure.savefig(picture, format="png", dpi=100, metadata={"Software": None})
    matplotlib.pyplot.close(result.figure)
    table = csv.writer(rows, lineterminator="\n")
    table.writerow(result.table)
    table.writerows(zip(*([_plain(x) for x in column] for column in result.table.values()), strict=True))
    write_bytes(stem.with_suffix(".png"), picture.getvalue())
    write_bytes(stem.with_suffix(".csv"), rows.getvalue().encode())


def _plain(value):
    return f"{value:.6g}" if isinstance(value, float | np.floating) else value


if __name__ == "__main__":
    sys.exit(main())
