"""``tspslam export``: a finished run's map, or one of its frames, in another format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io import RunFolder, read_frame, write_frame
from ..io.maps import write_map_ply, write_map_vtu
from ..io.topological import load_map
from .guard import MAPS, check_output, is_inside

_WRITERS: dict[str, Callable[[Path, Any], None]] = {"vtu": write_map_vtu, "ply": write_map_ply, "npz": write_frame}
FORMATS = tuple(_WRITERS)


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
        Index of a keyframe; by default the map, of a run or in a format that has none frame 0.
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
    stored = folder.map_npz_path if is_map else folder.finished_frame(frame or 0)
    target = output or Path(f"{run.resolve().name}-{stored.stem}.{to}")
    if is_inside(target, run):
        raise InputError(f"{target}: lies in the run folder {run}; expected a place outside")
    check_output(target, MAPS[to], [run, stored], is_forced=is_forced)
    _WRITERS[to](target, load_map(run) if is_map else read_frame(stored))
    return target
