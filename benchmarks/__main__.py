"""Measure everything and print it beside the committed baseline; ``--write`` commits to this run."""

from __future__ import annotations

import json
import platform
import sys
from pathlib import Path

from . import front_end, lidar, quality, spectral, topology
from .measure import process_seconds

BASELINE = Path(__file__).with_name("baseline.json")


def start_up() -> dict[str, float]:
    bare = process_seconds("-c", "pass")
    return {
        "bare_s": bare,
        "import_beyond_s": process_seconds("-c", "import tspslam") - bare,
        "help_beyond_s": process_seconds("-m", "tspslam", "--help") - bare,
    }


FIGURES = {
    "motorcycle cloud": quality.motorcycle_cloud,
    "constants and ramps": quality.filter_errors,
    "whole pair": quality.whole_pair,
    "stage, 2 000 vertices": lambda: topology.stage_figures(2_000),
    "stage, 20 000 vertices": lambda: topology.stage_figures(20_000),
    "T-MAHF none": lambda: topology.filter_figures("none"),
    "T-MAHF harmonic": lambda: topology.filter_figures("harmonic"),
    "16 times the pixels": topology.resolution_figures,
    "construction": topology.construction_figures,
    "growth": topology.growth_figures,
    "two threads": topology.thread_figures,
    "SIFT on Motorcycle": lambda: front_end.detector_figures("SIFT"),
    "BRISK on Motorcycle": lambda: front_end.detector_figures("BRISK"),
    "450 px wide": lambda: front_end.variant_figures(450),
    "1 282 px wide": lambda: front_end.variant_figures(1282),
    "depth cuts, per cent": front_end.cut_figures,
    "crust, 20 000 points": front_end.crust_figures,
    "depth buffer, 1 000 000 points": front_end.lidar_figures,
    "scans, 120 000 points": lidar.scan_figures,
    **spectral.FIGURES,
    "start-up": start_up,
}


def main() -> None:
    baseline = json.loads(BASELINE.read_text()) if BASELINE.exists() else {}
    measured = {"machine": {"processor": platform.machine(), "python": platform.python_version()}}
    for name, figure in FIGURES.items():
        measured[name] = figure()
        print(name)
        for key, value in measured[name].items():
            before = baseline.get(name, {}).get(key)
            print(f"  {key:<24} {value:>12.4g}" + (f"   baseline {before:.4g}" if before is not None else ""))
    if "--write" in sys.argv:
        BASELINE.write_text(json.dumps(measured, indent=1) + "\n")
        front_end.write_table()
        spectral.write_table()


main()
