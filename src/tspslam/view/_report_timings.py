"""Where the time of a run went, as one SVG that stands alone: seconds of each stage, and of each frame."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._html import text

STAGES = {
    "wait": "waiting for adjustments",
    "follow": "tracking",
    "points": "keypoints, stereo matching",
    "map": "landmarks and loops",
    "surface": "surface",
    "complex": "complex",
    "signals": "signals",
    "response": "response",
    "write": "writing keyframes",
}
"""Words for the stages of ``timings.json``, in the order in which a frame goes through them."""
WIDTH, LABEL, ROW, PLOT = 640, 250, 30, 130  # px: of the picture, for a stage's words, of a row, height of the curve
MOST_BARS = 150
_INK, _QUIET, _BLUE, _PAPER = "#1b2430", "#5a6570", "#0072b2", "#ffffff"


def timings_section(timings: str | Mapping[str, Any] | None) -> str:
    """Make the section of the times: a picture, or words on where it is; nothing where nothing is known."""
    if timings is None:
        return ""
    if isinstance(timings, str):
        shown = f'<p class="quiet">{text(timings)}</p>'
    else:
        svg = base64.b64encode(timings_svg(timings).encode("utf-8")).decode()
        shown = (
            f'<figure class="timings"><img src="data:image/svg+xml;base64,{svg}" alt="{text(words_of(timings))}">'
            "<figcaption>Stages work side by side, so that their seconds add up to more than the run took.</figcaption>"
            "</figure>"
        )
    return f'<section aria-labelledby="timings"><h2 id="timings">Where the time went</h2>{shown}</section>'


def words_of(timings: Mapping[str, Any]) -> str:
    """Say the seconds of each stage in a line."""
    said = [f"{words} {seconds:.2f} s" for words, seconds in _stages(timings)]
    return f"{_title(timings)}: {', '.join(said)}" if said else _title(timings)


def timings_svg(timings: Mapping[str, Any]) -> str:
    """Draw what ``timings.json`` holds, on white.

    Parameters
    ----------
    timings : dict
        ``frames``: seconds of each stage by the name of the frame; ``map_s``, ``total_s``. What is missing, or is no
        number, is left out.
    """
    stages, frames = _stages(timings), _frames(timings)
    top = 46 + ROW * len(stages)
    height = top + (PLOT + 80 if len(frames) > 1 else 12)
    parts = [_words(12, 28, _title(timings), 18, weight="bold"), *_bars(stages)]
    if len(frames) > 1:
        parts += _along(frames, top + 18)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        'font-family="system-ui, DejaVu Sans, sans-serif">'
        f"<title>{text(words_of(timings))}</title>"
        f'<rect width="{WIDTH}" height="{height}" fill="{_PAPER}"/>{"".join(parts)}</svg>\n'
    )


def _title(timings: Mapping[str, Any]) -> str:
    total, count = _number(timings.get("total_s")), len(_frames(timings))
    if not count:
        return "No frame was processed in the last call: all were there"
    whole = "" if total is None else f", {total:.1f} s in all"
    return f"{count} frame{'s' if count > 1 else ''} processed{whole}"


def _stages(timings: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Words and seconds of each stage."""
    sums: dict[str, float] = {}
    for row in _rows(timings):
        for name, value in row.items():
            sums[str(name)] = sums.get(str(name), 0.0) + (_number(value) or 0.0)
    order = [*STAGES, *sorted(sums.keys() - STAGES.keys())]
    found = [(STAGES.get(name, name), sums[name]) for name in order if name in sums]
    whole = _number(timings.get("map_s"))
    return found + ([] if whole is None else [("making the map", whole)])


def _frames(timings: Mapping[str, Any]) -> NDArray[np.float64]:
    """Seconds of each frame, its stages together, but what is written aside."""
    rows = [[_number(value) or 0.0 for name, value in row.items() if name != "write"] for row in _rows(timings)]
    return np.array([sum(row) for row in rows])


def _rows(timings: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    frames = timings.get("frames")
    return [row for row in frames.values() if isinstance(row, Mapping)] if isinstance(frames, Mapping) else []


def _number(value: Any) -> float | None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value < 1e9
    return float(value) if is_number else None


def _bars(stages: list[tuple[str, float]]) -> list[str]:
    """A row for each stage: words, bar, seconds."""
    most = max([seconds for _, seconds in stages], default=0.0) or 1.0
    room, parts = WIDTH - LABEL - 90, []
    for number, (words, seconds) in enumerate(stages):
        y = 46 + ROW * number
        width = max(room * seconds / most, 1)
        parts += [
            _words(LABEL - 10, y + 20, words, 17, anchor="end"),
            f'<rect x="{LABEL}" y="{y + 4}" width="{width:.1f}" height="{ROW - 9}" fill="{_BLUE}"/>',
            _words(LABEL + width + 8, y + 20, f"{seconds:.2f} s", 16, colour=_QUIET),
        ]
    return parts


def _along(frames: NDArray[np.float64], top: float) -> list[str]:
    """Seconds of each frame, one bar each; of many, the slowest of some in a row."""
    each = -(-len(frames) // MOST_BARS)
    slowest = [float(frames[k : k + each].max()) for k in range(0, len(frames), each)]
    most, step = max(slowest) or 1.0, (WIDTH - 24) / len(slowest)
    said = "Seconds of each frame" if each == 1 else f"Seconds of the slowest of each {each} frames"
    said += f": most {most:.3g} s, median {float(np.median(frames)):.3g} s"
    parts, ground = [_words(12, top + 18, said, 17)], top + 30 + PLOT
    for number, seconds in enumerate(slowest):
        height = PLOT * seconds / most
        x, y = 12 + step * number, ground - height
        parts.append(f'<rect x="{x:.1f}" y="{y:.1f}" width="{step * 0.85:.2f}" height="{height:.1f}" fill="{_BLUE}"/>')
    rule = f'<path d="M12 {ground}H{WIDTH - 12}" stroke="{_QUIET}" stroke-width="1"/>'
    ends = _words(12, ground + 22, "first", 16, colour=_QUIET)
    return [*parts, rule, ends, _words(WIDTH - 12, ground + 22, "last frame", 16, colour=_QUIET, anchor="end")]


def _words(
    x: float, y: float, words: str, size: int, *, colour: str = _INK, weight: str = "normal", anchor: str = "start"
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" font-weight="{weight}" fill="{colour}" '
        f'text-anchor="{anchor}">{text(words)}</text>'
    )
