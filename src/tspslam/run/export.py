"""``tspslam export`` and ``tspslam map``: a finished run's map, or one of its frames, in another format."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io import RunFolder
from .config import resolve
from .given import shown_of_run, write_shown
from .guard import MAPS, check_place
from .map import join_keyframes, stored_keyframes

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
    name, shown = shown_of_run(run, frame)
    return write_shown(shown, output or Path(f"{run.resolve().name}-{name}.{to}"), to, [run], is_forced=is_forced)


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
    check_place(target, MAPS["map" if kind == "npz" else kind], [run], is_forced=is_forced)
    made = join_keyframes(stored_keyframes(folder), settings)
    sizes = {"vertices": len(made), "edges": len(made.complex_.edges), "faces": len(made.surface.faces)}
    return (
        {"written": str(write_shown(made, target, kind, [run], is_forced=is_forced))}
        | sizes
        | {"keyframes": len(made.keyframes)}
    )
