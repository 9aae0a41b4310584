"""The report of a run: one HTML page with its numbers, the mesh to turn, and the pictures; no request is made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._atomic import make_folder, write_bytes
from ..frame import Frame
from ..topological_map import TopologicalMap
from ._frame import check_frame
from ._html import figures, page_of, shown_value, text, tiles
from ._map_section import MAP_CAPTIONS, map_section
from ._turning import frame_to_turn

LONG_TABLE = 14  # rows; longer ones are folded
FOLDED = frozenset({"settings", "versions", "hashes", "seeds", "environment"})
UNITS = {"px": "px", "m": "m", "m2": "m²", "s": "s", "ms": "ms", "deg": "°", "rad": "rad", "percent": "%", "mb": "MB"}
NAMES = {"n": "vertices", "euler": "Euler_characteristic"}
CAPTIONS = {
    "path": (
        "Path",
        "Where the camera went, and the points that its keyframes saw, from the side that shows most of the path.",
    ),
    "keypoints": (
        "Keypoints by class of depth",
        "Where the left image was matched to the right one. Colour is the depth z of the triangulated point: blue "
        "below 8 m, green to 30 m, yellow to 60 m, red beyond (Figure 4).",
    ),
    "keypoints_depth": (
        "Keypoints by depth",
        "The same keypoints on a continuous scale, since nearly all of them fall in one class.",
    ),
    "mesh_depth": (
        "Mesh by depth",
        "The surface over the image. Each face has the mean depth of its three vertices; gaps are where depth jumps.",
    ),
    "signals": (
        "Edge and face signals",
        "Squares stand at the barycentres of edges, circles at those of faces; colour is the mean over the pixels of "
        "the edge, eq. (5), or of the face, eq. (6) (Figure 6).",
    ),
    "magnitude": (
        "Response magnitude",
        "log₁₀ of |r|, eqs (12) and (19)-(22): large where luminance changes across the neighbourhood of a vertex, "
        "small where it is flat (Figure 9, top).",
    ),
    "phase": (
        "Response phase",
        "arg r, eqs (12) and (19)-(22), on a cyclic scale: the direction of that change in the image, v pointing down. "
        "For order 1 an arrow points from dark to bright (Figure 9, bottom).",
    ),
    "view3d_signal": (
        "Mesh and face signal in space",
        "The mesh seen from the side, each face in the mean of its pixels, eq. (6).",
    ),
    "view3d_magnitude": (
        "Mesh and response magnitude in space",
        "The same view, each face in the mean log₁₀ |r| of its vertices.",
    ),
}


def write_report(
    frame: Frame,
    run: Mapping[str, Any],
    pictures: Sequence[Path],
    path: str | Path,
    *,
    map_: TopologicalMap | None = None,
) -> Path:
    """Write a report as one HTML file that loads nothing from anywhere.

    It shows the numbers of the run, the mesh of `frame` to turn and to switch between signals, and the pictures. Of a
    run of several frames the headline is the run's, and it is said which frame the mesh is of; with a map, the map is
    there to turn, and stands before what is shown of the frame. A content security policy in the page forbids every
    request. One set of versions gives the same input the same bytes.

    Parameters
    ----------
    frame : Frame
        The frame to show; of several, the selected one. Signals and responses with channels show their mean.
    run : mapping
        Numbers of the run: what ``run.json`` holds, or others. ``frames`` over 1 makes it a run of several. Plain
        values become rows of one table, a mapping a table of its own, a list of mappings a
        table with a row each (such as one row a frame); ``warnings``, a list of ``{"code", "message"}`` or strings,
        stands on top.
    pictures : sequence of Path
        What `write_pictures` and `write_map_pictures` returned, or any other images.
    path : path
        The HTML file.
    map_ : TopologicalMap, optional
        The map of a run of several frames.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the parts of the frame or of the map do not belong together, or a picture is not an image that can be read.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from tspslam import Cloud, Frame, Response, Rig, Surface, build_complex, sample_signals
    >>> uv, faces, image = np.array([[1.0, 1], [8, 2], [3, 7]]), np.array([[0, 1, 2]], np.int32), np.eye(10)
    >>> rig, complex_ = Rig(10, 10, 5, 5, width=10, height=10), build_complex(faces, 3)
    >>> cloud = Cloud(np.insert(uv / 10, 2, 5.0, axis=1), uv, np.ones(3))
    >>> signals, response = sample_signals(image, uv, complex_), Response(np.ones(3, complex), 1, np.ones(3, bool))
    >>> frame = Frame(0, 0.0, "toy", rig, cloud, Surface(faces), complex_, signals, response, image=image)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = write_report(frame, {"status": "complete", "frames": 1}, [], f"{folder}/report.html")
    ...     page.read_text(encoding="utf-8")[:15]
    '<!DOCTYPE html>'
    """
    check_frame(frame)
    of_map = [picture for picture in pictures if map_ is not None and Path(picture).stem in MAP_CAPTIONS]
    sections = [
        _header(frame, run),
        _warnings(run.get("warnings") or []),
        "" if map_ is None else map_section(map_, of_map),
        _shown(frame, run, with_scene=map_ is None),
        frame_to_turn(frame) if map_ is None else "",
        _numbers(run, folded=False),
        _pictures([picture for picture in pictures if picture not in of_map], is_small=map_ is not None),
        _numbers(run, folded=True),
    ]
    words = page_of(f"TSP-SLAM report: {_title(frame, run)}", sections)
    make_folder(Path(path).parent)
    write_bytes(path, words.encode("utf-8", "replace"))
    return Path(path)


def _is_of_several(run: Mapping[str, Any]) -> bool:
    frames = run.get("frames")
    return isinstance(frames, int) and frames > 1


def _title(frame: Frame, run: Mapping[str, Any]) -> str:
    return str(run.get("source", frame.name)) if _is_of_several(run) else frame.name


def _sizes(frame: Frame) -> list[tuple[str, Any]]:
    complex_ = frame.complex_
    return [
        ("points", complex_.n),
        ("edges", len(complex_.edges)),
        ("faces", len(complex_.faces)),
        ("Euler characteristic", complex_.n - len(complex_.edges) + len(complex_.faces)),
        ("vertices with a response", int(frame.response.defined.sum())),
    ]


def _counts(run: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """How a run of several frames went."""
    counts = {key: run[key] for key in ("frames", "tracked", "keyframes", "landmarks", "loops") if key in run}
    rows = run.get("per_frame")
    if _is_table(rows) and isinstance(rows, list):
        counts |= {"lost": sum(bool(row.get("is_lost")) for row in rows), "skipped": run["frames"] - len(rows)}
    order = ("frames", "tracked", "lost", "skipped", "keyframes", "landmarks", "loops")
    return [(key, counts[key]) for key in order if key in counts]


def _shown(frame: Frame, run: Mapping[str, Any], *, with_scene: bool) -> str:
    """Which of several frames the rest of the page shows, and its sizes."""
    if not _is_of_several(run):
        return ""
    what, frames = "The mesh in space, and the pictures" if with_scene else "The pictures below", run["frames"]
    return (
        f'<section><h2>Frame {text(frame.name)}</h2><p class="quiet">{what} but for the '
        f"path, are of this one of {shown_value(frames)} frames; the numbers above and the tables are of the run."
        f"</p>{tiles(_sizes(frame))}</section>"
    )


def _header(frame: Frame, run: Mapping[str, Any]) -> str:
    numbers = _counts(run) if _is_of_several(run) else _sizes(frame)
    status = str(run.get("status", ""))
    tone = "good" if status == "complete" else "note"
    badge = f'<span class="badge {tone}">{text(status)}</span>' if status else ""
    return (
        f'<header><p class="kicker">TSP-SLAM report</p><h1>{text(_title(frame, run))}{badge}</h1>'
        f"{tiles(numbers)}</header>"
    )


def _warnings(warnings: Any) -> str:
    items = []
    for warning in warnings if isinstance(warnings, list | tuple) else [warnings]:
        if isinstance(warning, Mapping):
            items.append(f"<li><b>{text(warning.get('code', 'warning'))}</b> {text(warning.get('message', ''))}</li>")
        else:
            items.append(f"<li>{text(warning)}</li>")
    return f'<section class="warnings"><h2>Warnings</h2><ul>{"".join(items)}</ul></section>' if items else ""


def _numbers(run: Mapping[str, Any], *, folded: bool) -> str:
    tables: list[tuple[str, list[list[Any]], list[str]]] = []
    plain = {key: value for key, value in run.items() if not _is_table(value) and key not in ("warnings", "status")}
    if plain:
        tables.append(("run", [[k, v] for k, v in plain.items()], []))
    for key, value in run.items():
        if isinstance(value, Mapping) and value:
            tables.append((key, [[k, v] for k, v in _flat(value)], []))
        elif _is_table(value) and value and key != "warnings":
            columns = list(dict.fromkeys(str(k) for row in value for k in row))
            tables.append((key, [[row.get(c) for c in columns] for row in value], columns))
    chosen = [table for table in tables if _is_folded(table[0], table[1]) == folded]
    chosen.sort(key=lambda table: bool(table[2]))
    cards = [_card(*table, folded=folded) for table in chosen]
    if not cards:
        return ""
    return f'<section><h2>{"Details" if folded else "Numbers"}</h2><div class="cards">{"".join(cards)}</div></section>'


def _is_table(value: Any) -> bool:
    rows = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(row, Mapping) for row in value)
    return isinstance(value, Mapping) or rows


def _is_folded(key: str, rows: list[list[Any]]) -> bool:
    return key in FOLDED or len(rows) > LONG_TABLE


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", value))
    return pairs


def _card(key: str, rows: list[list[Any]], columns: list[str], *, folded: bool) -> str:
    if columns:
        head = "<thead><tr>" + "".join(f'<th scope="col">{_label(c)}</th>' for c in columns) + "</tr></thead>"
        body = "".join("<tr>" + "".join(f"<td>{shown_value(v)}</td>" for v in row) + "</tr>" for row in rows)
    else:
        head = ""
        body = "".join(f'<tr><th scope="row">{_label(k)}</th><td>{shown_value(v)}</td></tr>' for k, v in rows)
    table = f'<div class="scroll"><table>{head}<tbody>{body}</tbody></table></div>'
    wide = " wide" if columns else ""
    if folded:
        return (
            f'<details class="card{wide}"><summary>{_label(key)} <small>{len(rows)}</small></summary>{table}</details>'
        )
    return f'<div class="card{wide}"><h3>{_label(key)}</h3>{table}</div>'


def _label(key: Any) -> str:
    """A key in words, with its unit: ``vertical_offset_px`` becomes "vertical offset [px]"."""
    words = NAMES.get(str(key), str(key)).split("_")
    unit = UNITS.get(words[-1].lower()) if len(words) > 1 else None
    return text(f"{' '.join(words[:-1])} [{unit}]" if unit else " ".join(words))


def _pictures(paths: Sequence[Path], *, is_small: bool) -> str:
    shown = figures(paths, CAPTIONS | MAP_CAPTIONS, is_small=is_small)
    return f'<section class="pictures"><h2>Pictures</h2>{shown}</section>' if shown else ""
