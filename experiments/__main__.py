"""Run the experiments: ``python -m experiments [--data FOLDER] [--out FOLDER] [--docs FOLDER] [NAME ...]``.

A NAME alone leaves the results and the sections of the others as they are. The page is of Motorcycle and synthetic
scenes, so ``--docs`` goes neither with ``--data`` nor with ``--small``.
"""

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
    try:
        _check(chosen)
        earlier = _earlier(chosen.out / "results.json"), _earlier(chosen.docs and chosen.docs / "paper_results.json")
    except ValueError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    return run(chosen.names or NAMES, Source(chosen.data, small=chosen.small), chosen.out, chosen.docs, earlier)


def _check(chosen: argparse.Namespace) -> None:
    """ValueError with what is wrong with the arguments; makes the folders."""
    unknown = [name for name in chosen.names if name not in NAMES]
    if unknown:
        raise ValueError(f"no experiment is called {unknown[0]}, expected some of {', '.join(NAMES)}")
    if chosen.docs and (chosen.data or chosen.small):
        other = "--data" if chosen.data else "--small"
        raise ValueError(f"--docs with {other}: the page is of Motorcycle and synthetic scenes, leave one of them out")
    for option, folder in (("--out", chosen.out), ("--docs", chosen.docs)):
        try:
            if folder:
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"{option} {folder}: is no folder and none can be made ({error.strerror})") from error


def _earlier(path: Path | None) -> dict:
    """Results that stand in a file; none without it. ValueError if it holds something else."""
    if path is None or not path.exists():
        return {}
    try:
        found = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: is no JSON, move it away to begin anew") from error
    if not isinstance(found, dict):
        raise ValueError(f"{path}: holds no results, move it away to begin anew")
    return found


def _merged(earlier: dict, results: dict) -> dict:
    both = earlier | results
    return {name: both[name] for name in NAMES if name in both}


def run(names, source: Source, out: Path, docs: Path | None, earlier: tuple[dict, dict]) -> int:
    """Run each experiment, write what it gives beside what was; 4 if one was skipped for want of data, else 0."""
    results, skipped = {}, 0
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
        kept = {"numbers": dict(result.numbers), "paper": dict(result.paper)}
        results[name] = {"of": source.name, **kept, "seconds": seconds}
        print(f"{name}: {seconds} s")
    write_bytes(out / "results.json", json.dumps(_merged(earlier[0], results), indent=1, default=float).encode())
    if docs:
        done = {name: result for name, result in results.items() if "skipped" not in result}
        write_page(_merged(earlier[1], done), done, out, docs)
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
