"""The report of a run: one HTML page on how it went, what came out, and where to look; nothing is loaded from afar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._atomic import make_folder, write_bytes
from ..frame import Frame
from ..topological_map import TopologicalMap
from ._frame import check_frame
from ._html import contents, figures, page_of, shown_value, text, tiles
from ._map_section import MAP_CAPTIONS, map_section
from ._report_advice import missing_section, warnings_section, why_degraded
from ._report_gallery import gallery_section
from ._report_health import health_section
from ._report_parts import WholeRun
from ._report_path import path_section, true_path
from ._report_recordings import recordings_section, starts_of
from ._report_strip import strip_section
from ._report_tables import TOLD, is_table, numbers_section, settings_section
from ._report_timings import timings_section
from ._space import Station
from ._turning import frame_to_turn

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
    frame: Frame | None,
    run: Mapping[str, Any],
    pictures: Sequence[Path],
    path: str | Path,
    *,
    map_: TopologicalMap | None = None,
    whole: WholeRun | None = None,
) -> Path:
    """Write a report as one HTML file that asks nobody for anything.

    It says how the run went and what to do about its warnings, and shows the map (or the mesh of `frame`) to turn and
    to switch between signals; of a whole run also how each frame went, its path against the true one, whether the
    calibration fits, where the time went, and frames to page through; then the pictures and the numbers. A content
    security policy in the page forbids every request but for pictures that lie beside it. One set of versions gives
    the same input the same bytes.

    Parameters
    ----------
    frame : Frame or None
        The frame to show; of several, the selected one. Signals and responses with channels show their mean. None if
        there is none that can be read.
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
    whole : WholeRun, optional
        What else is known of a run: states of its frames, poses, errors, findings, settings, images, times.

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
    if frame is not None:
        check_frame(frame)
    sections = _sections(frame, run, pictures, map_, whole or WholeRun(), is_whole=whole is not None)
    words = page_of(f"TSP-SLAM report: {_title(frame, run)}", [sections[0], contents(sections[1:]), *sections[1:]])
    make_folder(Path(path).parent)
    write_bytes(path, words.encode("utf-8", "replace"))
    return Path(path)


def _sections(
    frame: Frame | None, run: Mapping[str, Any], pictures: Sequence[Path], map_: TopologicalMap | None, whole: WholeRun,
    *, is_whole: bool,
) -> list[str]:  # fmt: skip
    """All sections in order, of which some are empty."""
    states = {state.frame: state.state for state in whole.states}
    stations = [Station(index, T, states.get(index, "tracked")) for index, T in whole.poses.items()]
    told = TOLD if is_whole else frozenset({"status", "warnings"})
    return [
        _header(frame, run),
        warnings_section(run.get("warnings") or []),
        missing_section(whole.missing),
        recordings_section(run.get("recordings")),
        _mesh(frame) if map_ is None else map_section(map_, stations, true_path(whole.errors)),
        strip_section(whole.states, starts_of(run.get("recordings"))),
        path_section(run.get("evaluation"), whole.errors),
        health_section(whole.findings),
        timings_section(whole.timings),
        gallery_section(whole.shots, whole.stored),
        _pictures(frame, run, pictures, has_map=map_ is not None),
        settings_section(whole.settings),
        numbers_section(run, folded=False, told=told),
        numbers_section(run, folded=True, told=told),
    ]


def _mesh(frame: Frame | None) -> str:
    """The mesh of a frame to turn, if there is one."""
    return "" if frame is None else frame_to_turn(frame)


def _is_of_several(run: Mapping[str, Any]) -> bool:
    frames = run.get("frames")
    return isinstance(frames, int) and frames > 1


def _title(frame: Frame | None, run: Mapping[str, Any]) -> str:
    if frame is None or _is_of_several(run):
        return str(run.get("source", "run" if frame is None else frame.name))
    return frame.name


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
    if is_table(rows) and isinstance(rows, list) and _is_of_several(run):
        counts |= {"lost": sum(bool(row.get("is_lost")) for row in rows), "skipped": run["frames"] - len(rows)}
    order = ("frames", "tracked", "lost", "skipped", "keyframes", "landmarks", "loops")
    return [(key, counts[key]) for key in order if key in counts]


def _header(frame: Frame | None, run: Mapping[str, Any]) -> str:
    numbers = _counts(run) if frame is None or _is_of_several(run) else _sizes(frame)
    status = str(run.get("status", ""))
    tone = "good" if status == "complete" else "note"
    badge = f'<span class="badge {tone}">{text(status)}</span>' if status else ""
    return (
        f'<header><p class="kicker">TSP-SLAM report</p><h1>{text(_title(frame, run))}{badge}</h1>'
        f"{tiles(numbers)}{why_degraded(run)}</header>"
    )


def _pictures(frame: Frame | None, run: Mapping[str, Any], paths: Sequence[Path], *, has_map: bool) -> str:
    """The map's pictures, then those of the frame, which is named where there are several."""
    of_map = [path for path in paths if has_map and Path(path).stem in MAP_CAPTIONS]
    others = [path for path in paths if path not in of_map]
    shown = figures([*of_map, *others], CAPTIONS | MAP_CAPTIONS, is_small=has_map)
    if not shown and not (frame is not None and _is_of_several(run)):
        return ""
    return (
        f'<section class="pictures" aria-labelledby="pictures"><h2 id="pictures">Pictures</h2>'
        f"{_of_which(frame, run)}{shown}</section>"
    )


def _of_which(frame: Frame | None, run: Mapping[str, Any]) -> str:
    """Which of several frames the pictures show, and its sizes."""
    if frame is None or not _is_of_several(run):
        return ""
    return (
        f'<p class="quiet">Pictures of the path and of the map are of the whole run, the others of frame '
        f"{text(frame.name)}, one of {shown_value(run['frames'])}:</p>{tiles(_sizes(frame))}"
    )
