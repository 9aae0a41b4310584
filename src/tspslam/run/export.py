"""``tspslam export`` and ``tspslam map``: a finished run's map, or one of its frames, in another format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io import RunFolder, read_frame, write_frame
from ..io.maps import write_map_ply, write_map_vtu
from ..io.topological import load_map, write_map
from .config import resolve
from .guard import MAPS, check_output, is_inside
from .map import build_map

_WRITERS: dict[str, Callable[[Path, Any], None]] = {"vtu": write_map_vtu, "ply": write_map_ply, "npz": write_frame}
FORMATS = tuple(_WRITERS)
MAP_FORMATS = ("npz", "vtu", "ply")


def export(
    run: Path, to: str, output: Path | None = None, *, frame: int | None = None, is_forced: bool = False
) -> Path:
    """Write a frame of a run, or as VTU or PLY its map, in another format.

    Parameters
    ----------
    run : path
        The run folder.
    to : str
        One of `FORMATS`.
    output : path, optional
        The file; RUN-FRAME.FORMAT or RUN-map.FORMAT here by default.
    frame : int, optional
        Index of a keyframe; by default the map, of a run of one frame or as npz frame 0.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        If the run has no such frame, the file lies in the run, or is of another kind.
    OutputError
        If it cannot be written.
    """
    folder = RunFolder.open(run)
    is_map = frame is None and to != "npz" and folder.map_npz_path.exists()
    made = load_map(run) if is_map else None
    is_map = made is not None and len(made.keyframes) > 1
    stored = folder.map_npz_path if is_map else folder.finished_frame(frame or 0)
    target = output or Path(f"{run.resolve().name}-{stored.stem}.{to}")
    _refuse_place(target, run, to, is_forced)
    _WRITERS[to](target, made if is_map else read_frame(stored))
    return target


def export_map_anew(
    run: Path, output: Path | None = None, assignments: Iterable[str] = (), *, is_forced: bool = False
) -> Path:
    """Make the map of a run anew, and write it.

    Parameters
    ----------
    run : path
        The run folder.
    output : path, optional
        The file, of one of `MAP_FORMATS` by its suffix; RUN-map.npz here by default.
    assignments : iterable of str
        Settings that differ from the run's, such as ``"mapping.surface.longest=0.3"``.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    Path
        The file.

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
    _refuse_place(target, run, kind, is_forced)
    made = build_map(run, resolve(file=folder.path / "config.yaml", assignments=assignments).settings.mapping)
    (write_map if kind == "npz" else _WRITERS[kind])(target, made)
    return target


def _refuse_place(target: Path, run: Path, kind: str, is_forced: bool) -> None:
    """Refuse to write into the run, or over a file of another kind."""
    if is_inside(target, run):
        raise InputError(f"{target}: lies in the run folder {run}; expected a place outside")
    check_output(target, MAPS[kind], [run], is_forced=is_forced)
