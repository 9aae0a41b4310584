"""``tspslam export`` and ``tspslam map``: a finished run's map, or one of its frames, in another format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from .._files import bad_input
from ..errors import InputError
from ..frame import Frame
from ..io import RunFolder, read_frame, write_frame
from ..io.maps import write_map_ply, write_map_vtu
from ..io.topological import load_map, write_map
from ..topological_map import TopologicalMap
from .config import resolve
from .guard import MAPS, check_output, is_inside
from .map import join_keyframes, stored_keyframes

_WRITERS: dict[str, Callable[[Path, Any], None]] = {"vtu": write_map_vtu, "ply": write_map_ply}
FORMATS = ("vtu", "ply", "npz")


def export(
    run: Path, to: str, output: Path | None = None, *, frame: int | None = None, is_forced: bool = False
) -> Path:
    """Write the map of a run, or one of its frames, in another format.

    Parameters
    ----------
    run : path
        The run folder.
    to : str
        One of `FORMATS`.
    output : path, optional
        The file; RUN-FRAME.FORMAT or RUN-map.FORMAT here by default.
    frame : int, optional
        Index of a keyframe; by default the map, of a run of one frame that frame.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the run has no such frame, or of several frames no map; if the file lies in the run, or is of another kind.
    OutputError
        If it cannot be written.
    """
    folder = RunFolder.open(run)
    made = load_map(run) if frame is None and folder.map_npz_path.exists() else None
    if made is not None and len(made.keyframes) > 1:
        return _write(run, output or Path(f"{run.resolve().name}-map.{to}"), to, made, is_forced)
    if frame is None and len(folder.stored_frames) > 1:
        raise bad_input(run, "has no map of its keyframes", f"--frame N, such as {folder.stored_frames[0]}")
    stored = folder.finished_frame(frame or 0)
    return _write(run, output or Path(f"{run.resolve().name}-{stored.stem}.{to}"), to, read_frame(stored), is_forced)


def _write(run: Path, target: Path, kind: str, shown: Frame | TopologicalMap, is_forced: bool) -> Path:
    """Write a map or a frame, not into the run, nor over a file of another kind."""
    is_map = isinstance(shown, TopologicalMap)
    _refuse_place(target, run, "map" if is_map and kind == "npz" else kind, is_forced)
    _WRITERS.get(kind, write_map if is_map else write_frame)(target, shown)
    return target


def export_map_anew(
    run: Path, output: Path | None = None, assignments: Iterable[str] = (), *, is_forced: bool = False
) -> dict[str, Any]:
    """Make the map of a run anew, and write it.

    Parameters
    ----------
    run : path
        The run folder.
    output : path, optional
        The file, of one of `FORMATS` by its suffix; RUN-map.npz here by default.
    assignments : iterable of str
        Settings that differ from the run's, such as ``"mapping.surface.longest=0.3"``.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    dict
        ``written``, and how many ``vertices``, ``edges``, ``faces`` and ``keyframes`` it has.

    Raises
    ------
    InputError
        As `export`; if a setting is not one of the map, or the run has no landmarks.
    GeometryError
        If the landmarks span no surface.
    OutputError
        If the file cannot be written.
    """
    wrong = [each for each in assignments if not each.strip().startswith("mapping.")]
    if wrong:
        raise InputError(f"--set {wrong[0]!r:.80}: is no setting of the map, expected one that begins with mapping.")
    folder, target = RunFolder.open(run), output or Path(f"{run.resolve().name}-map.npz")
    kind = target.suffix[1:].lower()
    settings = resolve(file=folder.path / "config.yaml", assignments=assignments).settings
    _refuse_place(target, run, "map" if kind == "npz" else kind, is_forced)
    made = join_keyframes(stored_keyframes(folder), settings)
    sizes = {"vertices": len(made), "edges": len(made.complex_.edges), "faces": len(made.surface.faces)}
    return {"written": str(_write(run, target, kind, made, is_forced))} | sizes | {"keyframes": len(made.keyframes)}


def _refuse_place(target: Path, run: Path, kind: str, is_forced: bool) -> None:
    """Refuse to write into the run, or over a file of another kind."""
    if is_inside(target, run):
        raise InputError(f"{target}: lies in the run folder {run}; expected a place outside")
    check_output(target, MAPS[kind], [run], is_forced=is_forced)
