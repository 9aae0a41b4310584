"""The documentation's page "The paper, reproduced", from what the scripts gave."""

from __future__ import annotations

import importlib
import json
import math
import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from tspslam.io import write_bytes

HEAD = """\
The paper, reproduced
=====================

.. This page is written by ``make paper``; the text stands in the scripts of ``experiments/``.

Each figure and table of *Topological Signal Processing from Stereo Visual SLAM* (Sensors 2025, 25, 6103), computed by
one small script of ``experiments/``, and answers to five questions that the paper leaves open. ``make paper`` draws and
writes all of it, in about a minute. The images are the Motorcycle pair, and synthetic scenes (:doc:`synthetic`) where
more frames are wanted; ``make paper DATA=FOLDER`` takes a KITTI, EuRoC, UTIAS or plain stereo folder instead, and
writes to ``experiments/out`` only. What the answers measure was fixed in ``experiments/PROTOCOL.md`` before the first
result; what was changed since stands there, with its reason. Numbers in the texts are of the frames shown here, unless
they name others.

The paper has no numbers for most of its figures. Where it has some, they stand in the last column.
"""

ELSEWHERE = """\
The scripts on frames of a street (KITTI) and of a room (EuRoC), which are not ours to show; the first frame of each
sequence, for Table 2 four frames evenly over it.
"""
FILTERS = ("T-MAHF none", "T-MAHF harmonic", "MAHF conformal", "MAHF robust", "MAHF graph")
TOLD = (
    ("fig07_heat_and_hops", "R² on K"),
    ("fig07_heat_and_hops", "b"),
    ("fig08_angles", "median |φ - ψ|, degrees"),
    ("fig08_angles", "last decile"),
    ("table2_time", "T-MAHF, ms a point"),
    ("table2_time", "MAHF, ms a point"),
    ("table2_time", "T-MAHF in % of MAHF"),
    ("answer_a_what_it_sees", "none: constant / real"),
    *(("answer_a_what_it_sees", f"{c}: image, all: median, degrees") for c in ("none", "mean", "harmonic", "plane")),
    *(
        ("answer_a_what_it_sees", f"{c}: image, strongest fifth: median, degrees")
        for c in ("none", "mean", "harmonic", "plane")
    ),
    *(
        ("answer_b_bad_meshes", f"{damage}, {name}: |Δr| / |r|")
        for damage in ("flip 0.2", "delete 0.2", "jitter 1")
        for name in FILTERS
    ),
    ("answer_b_bad_meshes", "refused meshes"),
    *(
        ("answer_c_hops_or_heat", f"{weight}, vertices: {what}")
        for what in (
            "phase, all, degrees",
            "phase, strongest fifth, degrees",
            "rank correlation, all",
            "rank correlation, strongest fifth",
        )
        for weight in ("indicator", "g(d)")
    ),
    *(
        ("answer_d_edges_and_faces", f"no noise, {name}: phase error, degrees")
        for name in ("vertices", "+ edges", "+ faces")
    ),
)


def write_page(results: dict, drawn: Iterable[str], out: Path, docs: Path) -> None:
    """Write ``paper.rst`` with all results, and copy the pictures that were drawn beside it."""
    pictures = docs / "images" / "paper"
    pictures.mkdir(parents=True, exist_ok=True)
    for name in drawn:
        shutil.copyfile(out / f"{name}.png", pictures / f"{name}.png")
    modules = {name: importlib.import_module(f".{name}", __package__) for name in results}
    parts = [HEAD, *(section(name, modules[name], result) for name, result in results.items())]
    parts.append(elsewhere(results, docs))
    write_bytes(docs / "paper.rst", "\n".join(parts).encode())
    write_bytes(docs / "paper_results.json", json.dumps(results, indent=1, default=float).encode())


def section(name: str, module, result: dict) -> str:
    """One experiment: its text, its picture, its numbers."""
    rows = [f"   * - {escaped(key)}\n     - {said(value)}" for key, value in result["numbers"].items()]
    if result["paper"]:
        rows = [
            f"{row}\n     - {said(result['paper'].get(key, ''))}"
            for row, key in zip(rows, result["numbers"], strict=True)
        ]
    title, text = module.TITLE, escaped(module.__doc__.strip())
    heads = ["what", "ours", "paper"][: 3 if result["paper"] else 2]
    head = "   * - " + "\n     - ".join(heads)
    return (
        f"{title}\n{'-' * len(title)}\n\n{text}\n\n"
        f".. figure:: images/paper/{name}.png\n   :width: 100%\n   :alt: {title}\n\n"
        f".. rst-class:: numbers\n\n.. list-table::\n   :header-rows: 1\n\n{head}\n" + "\n".join(rows) + "\n"
    )


def elsewhere(results: dict, docs: Path) -> str:
    """What the same scripts gave on other data: a column for each ``paper_NAME.json`` that stands in the docs."""
    others = {
        path.stem.removeprefix("paper_"): json.loads(path.read_bytes()) for path in sorted(docs.glob("paper_*.json"))
    }
    others.pop("results", None)
    if not others:
        return ""
    runs = [results, *others.values()]
    rows = []
    for name, what in TOLD:
        values = [said(run.get(name, {}).get("numbers", {}).get(what, "")) for run in runs]
        rows.append("\n     - ".join([f"   * - {escaped(what)}", *values]))
    title = "The same on other frames"
    head = "\n     - ".join(["   * - what", "Motorcycle, synthetic", *(name.replace("_", " ") for name in others)])
    return (
        f"{title}\n{'-' * len(title)}\n\n{ELSEWHERE}\n"
        f".. rst-class:: numbers\n\n.. list-table::\n   :header-rows: 1\n\n{head}\n" + "\n".join(rows) + "\n"
    )


def escaped(text: str) -> str:
    """Text whose bars are no substitutions, and whose quoted names are code."""
    return re.sub(r"(?<!:)`([^`]+)`", r"``\1``", text.replace("|", "\\|"))


def said(value: float | int | str) -> str:
    """A number with three digits; whole numbers whole."""
    if isinstance(value, str) or value is None:
        return value or "–"
    if isinstance(value, int) or float(value).is_integer():
        return f"{int(value):,}".replace(",", " ")
    return "refused" if math.isnan(value) else f"{value:.3g}"
