"""The documentation's page "The paper, reproduced", from what the scripts gave."""

from __future__ import annotations

import importlib
import json
import math
import shutil
from pathlib import Path

from tspslam.io import write_bytes

HEAD = """\
The paper, reproduced
=====================

.. This page is written by ``make paper``; the text stands in the scripts of ``experiments/``.

Each figure and table of *Topological Signal Processing from Stereo Visual SLAM* (Sensors 2025, 25, 6103), computed by one
small script of ``experiments/`` through the public names alone, and answers to five questions that the paper leaves open.
The images are the Motorcycle pair, and synthetic scenes (:doc:`synthetic`) where more frames are wanted; ``make paper
DATA=FOLDER`` takes a KITTI, EuRoC, UTIAS or plain stereo folder instead. What the answers measure was fixed, in
``experiments/PROTOCOL.md``, before the first result.
"""


def write_page(results: dict, out: Path, docs: Path) -> None:
    """Write ``paper.rst`` and copy the pictures beside it."""
    pictures = docs / "images" / "paper"
    pictures.mkdir(parents=True, exist_ok=True)
    parts = [HEAD]
    for name, result in results.items():
        if "skipped" in result:
            continue
        shutil.copyfile(out / f"{name}.png", pictures / f"{name}.png")
        parts.append(section(name, importlib.import_module(f".{name}", __package__), result))
    write_bytes(docs / "paper.rst", "\n".join(parts).encode())
    write_bytes(docs / "paper_results.json", json.dumps(results, indent=1, default=float).encode())


def section(name: str, module, result: dict) -> str:
    """One experiment: its text, its picture, its numbers."""
    rows = [f"   * - {key}\n     - {said(value)}" for key, value in result["numbers"].items()]
    if result["paper"]:
        rows = [
            f"{row}\n     - {said(result['paper'].get(key, ''))}"
            for row, key in zip(rows, result["numbers"], strict=True)
        ]
    title, text = module.TITLE, module.__doc__.strip().replace("`", "``")
    heads = ["what", "ours", "paper"][: 3 if result["paper"] else 2]
    head = "   * - " + "\n     - ".join(heads)
    return (
        f"{title}\n{'-' * len(title)}\n\n{text}\n\n.. figure:: images/paper/{name}.png\n   :width: 100%\n   :alt: {title}\n\n"
        f".. rst-class:: numbers\n\n.. list-table::\n   :header-rows: 1\n\n{head}\n" + "\n".join(rows) + "\n"
    )


def said(value: float | int | str) -> str:
    """A number with three digits; whole numbers whole."""
    if isinstance(value, str) or value is None:
        return value or "-"
    if isinstance(value, int) or float(value).is_integer():
        return f"{int(value):,}".replace(",", " ")
    return "refused" if math.isnan(value) else f"{value:.3g}"
