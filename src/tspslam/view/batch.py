"""The page of a batch: a row and a picture a run, what failed on top; nothing is loaded from afar."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from PIL import Image as PillowImage

from .._atomic import write_bytes
from ._html import page_of, shown_value, text, tiles

_SIZE = (150, 120)  # px of a picture at most: a page of 400 runs stays at a few MB
_TONES = {"complete": "good", "degraded": "note", "unfinished": "none"}
_HOW = {"resumed": "resumed", "there": "finished before"}
_ERRORS = (
    ("ate_rmse_m", "ATE [m]"),
    ("rpe_translation_percent_10m", "RPE over 10 m [%]"),
    ("rpe_rotation_deg_frame", "RPE a frame [°]"),
)
_SIDE = ' style="text-align: right"'  # of the heads of numbers
_STYLE = (
    "<style>.batch td, .batch th { vertical-align: top; } .batch img { display: block; border-radius: 6px; "
    "background: #ffffff; } .batch .number { text-align: right; white-space: nowrap; } .batch p { margin: 0.2rem 0; } "
    ".batch .badge { margin-left: 0; } .batch details { margin-top: 0.2rem; } .batch table { font-size: 0.85rem; } "
    ".batch td, .batch th { padding-right: 0.6rem; } .batch thead th { white-space: normal; overflow-wrap: normal; } "
    ".batch td:first-child, .batch td:nth-child(2) { min-width: 9rem; }</style>"
)


def write_batch_page(path: str | Path, batch: Mapping[str, Any]) -> Path:
    """Write the page of a batch as one HTML file that asks nobody for anything.

    Parameters
    ----------
    path : path
        The HTML file. Pictures are found from its folder, and so are the reports that it links to.
    batch : mapping
        What ``batch.json`` holds: ``states`` and ``rows``.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> row = {"name": "drive", "source": "/data/drive", "state": "refused", "error": "holds no <images>"}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = write_batch_page(f"{folder}/batch.html", {"states": {"refused": 1}, "rows": [row]})
    ...     "holds no &lt;images&gt;" in page.read_text(encoding="utf-8")
    True
    """
    target, rows = Path(path), list(batch["rows"])
    sections = [_header(batch["states"], rows), _failures(rows), _table(target.parent, rows)]
    write_bytes(target, page_of("TSP-SLAM batch", sections).encode("utf-8", "replace"))
    return target


def _header(states: Mapping[str, int], rows: Sequence[Mapping[str, Any]]) -> str:
    whole = states.get("complete", 0) == len(rows)
    badge = f'<span class="badge {"good" if whole else "note"}">{"complete" if whole else "not all complete"}</span>'
    seconds = sum(row.get("seconds") or 0.0 for row in rows)
    numbers = [("recordings", len(rows)), *states.items(), ("frames", sum(row.get("frames", 0) for row in rows))]
    return (
        f'<header><p class="kicker">TSP-SLAM batch</p><h1>{shown_value(len(rows))} recordings{badge}</h1>'
        f"{tiles([*numbers, ('seconds of all runs', round(seconds))])}</header>{_STYLE}"
    )


def _failures(rows: Sequence[Mapping[str, Any]]) -> str:
    """Recordings without a result, and why."""
    failed = [row for row in rows if row.get("error")]
    if not failed:
        return ""
    lines = "".join(f"<li><b>{text(row['name'])}</b>: {text(row['error'])}</li>" for row in failed)
    return (
        '<section class="warnings" aria-labelledby="failures"><h2 id="failures">Without a result</h2>'
        f"<ul>{lines}</ul></section>"
    )


def _table(folder: Path, rows: Sequence[Mapping[str, Any]]) -> str:
    errors = [each for each in _ERRORS if any((row.get("evaluation") or {}).get(each[0]) is not None for row in rows)]
    heads = ["", "Run", "State", "Frames", "Keyframes", "Loops", "Time [s]", "Frames/s", *(name for _, name in errors)]
    head = "".join(f'<th scope="col"{_SIDE if k > 2 else ""}>{text(each)}</th>' for k, each in enumerate(heads))
    body = "".join(_row(folder, row, [key for key, _ in errors]) for row in rows)
    return (
        '<section class="batch" aria-labelledby="runs"><h2 id="runs">Runs</h2><div class="card wide">'
        '<div class="scroll" role="region" tabindex="0" aria-label="Table: runs"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></div></section>"
    )


def _row(folder: Path, row: Mapping[str, Any], errors: Sequence[str]) -> str:
    found, state = row.get("evaluation") or {}, str(row["state"])
    is_finished = state in ("complete", "degraded")
    frames = f"{shown_value(row.get('tracked', 0))} of {shown_value(row.get('frames', 0))}"
    seconds, pace = row.get("seconds"), row.get("frames_per_s")
    numbers = [frames, shown_value(row.get("keyframes")), shown_value(row.get("loops"))]
    numbers += [shown_value(None if value is None else round(value, 1)) for value in (seconds, pace)]
    numbers = (numbers if is_finished else ["–"] * 5) + [shown_value(_short(found.get(key))) for key in errors]
    cells = "".join(f'<td class="number">{each}</td>' for each in numbers)
    badge = f'<span class="badge {_TONES.get(state, "bad")}">{text(state)}</span>'
    return (
        f"<tr><td>{_picture(folder, row)}</td><td>{_name(row, is_finished)}{_warnings(row)}</td>"
        f"<td>{badge}{_attempts(row)}</td>{cells}</tr>"
    )


def _short(value: Any) -> Any:
    return float(f"{value:.3g}") if isinstance(value, float) else value


def _name(row: Mapping[str, Any], is_finished: bool) -> str:
    name = text(row["name"])
    link = f'<a href="{text(quote(str(row["name"])))}/report.html">{name}</a>' if is_finished else name
    return f'<p><b>{link}</b></p><p class="quiet">{text(row["source"]).replace("/", "/<wbr>")}</p>'


def _warnings(row: Mapping[str, Any]) -> str:
    warnings = row.get("warnings") or []
    if not warnings:
        return ""
    lines = "".join(f"<li>{text(each)}</li>" for each in warnings)
    count = f"{len(warnings)} warning{'' if len(warnings) == 1 else 's'}"
    return f"<details><summary>{count}</summary><ul>{lines}</ul></details>"


def _attempts(row: Mapping[str, Any]) -> str:
    attempts, how = row.get("attempts", 0), str(row.get("how", ""))
    said = [_HOW[how]] if how in _HOW else []
    said += [f"{attempts} attempts"] if attempts > 1 else []
    return f'<p class="quiet">{text(", ".join(said))}</p>' if said else ""


def _picture(folder: Path, row: Mapping[str, Any]) -> str:
    """A picture of the run, small and within the page; nothing where there is none that can be read."""
    if not row.get("picture"):
        return ""
    buffer = io.BytesIO()
    try:
        with PillowImage.open(folder / str(row["picture"])) as picture:
            small = picture.convert("RGB")
    except (OSError, ValueError, SyntaxError):
        return ""
    small.thumbnail(_SIZE)
    small.save(buffer, "JPEG", quality=80)
    data, (width, height) = base64.b64encode(buffer.getvalue()).decode("ascii"), small.size
    shown = f'src="data:image/jpeg;base64,{data}" width="{width}" height="{height}"'
    return f'<img {shown} alt="Picture of {text(row["name"])}">'
