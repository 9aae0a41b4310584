"""A finished run as a recording of rerun, written by a process of its own and looked at before it is there."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import bad_input, one_line
from ..errors import InputError, OutputError, TspSlamError
from ..io._folders import new_file
from ..io.rrd import MISSING, RecordedRun, write_rrd
from ..topological_map import TopologicalMap
from ._export_runs import RunData, load_run_data

_LONGEST = 900.0  # s: on a full disk rerun may wait for ever; 100 keyframes take some seconds
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_ERROR = re.compile(r"\bERROR\b")  # what rerun logs where a file could not be written
_REFUSED = 3  # exit code where it was the input
_CHILD = f"import sys; from {__name__} import write_recording; sys.exit(write_recording(*sys.argv[1:]))"


def export_rrd(run: Path, output: Path) -> None:
    """Write a run's map, path, cameras, images and landmarks tracked as a recording of rerun, whole or not at all.

    Rerun only logs that a disk is full: a process of its own writes, and rerun's own check reads what is there, before
    the file takes its name. Nothing is sent anywhere.

    Parameters
    ----------
    run : path
        The run folder.
    output : path
        The file, which ends with .rrd.

    Raises
    ------
    InputError
        If rerun is not installed, or the run cannot be read, or has no map.
    OutputError
        If the file cannot be written.
    """
    if importlib.util.find_spec("rerun") is None:
        raise bad_input(output, "cannot be written (rerun is not installed)", MISSING)
    with new_file(output) as made, tempfile.TemporaryDirectory() as home:
        done = _call(output, home, ["-c", _CHILD, str(run), str(made)], "written")
        if done.returncode == _REFUSED:
            raise InputError(_last_line(done))
        if done.returncode or _ERROR.search(_text(done)) or not made.is_file():
            raise _refused(output, "written", _last_line(done))
        done = _call(output, home, ["-m", "rerun", "rrd", "verify", str(made)], "read back by rerun")
        if done.returncode:
            raise _refused(output, "read back by rerun", _last_line(done))


def _call(output: Path, home: str, arguments: list[str], what: str) -> subprocess.CompletedProcess[bytes]:
    """Run Python; rerun looks for its settings, and leaves some, in a home that is thrown away."""
    places = {"HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "APPDATA": home, "LOCALAPPDATA": home}
    environment = os.environ | places | {"PYTHONPATH": os.pathsep.join(sys.path), "RERUN": "1"}
    command = [sys.executable, *arguments]
    try:
        return subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, timeout=_LONGEST, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise _refused(output, what, f"rerun did not end within {_LONGEST:g} s") from error


def _text(done: subprocess.CompletedProcess[bytes]) -> str:
    return _COLOUR.sub("", (done.stderr or done.stdout).decode("utf-8", "replace")).strip()


def _last_line(done: subprocess.CompletedProcess[bytes]) -> str:
    return one_line(_text(done).rpartition("\n")[2])[:300] or f"exit code {done.returncode}"


def _refused(output: Path, what: str, why: str) -> OutputError:
    return OutputError(one_line(f"{output}: cannot be {what} ({why}); expected a writable place with space"))


def recorded_run(data: RunData) -> RecordedRun:
    """Collect what a recording shows; faces and edges by luminance, vertices by the magnitude of the response.

    Parameters
    ----------
    data : RunData
        The run.

    Returns
    -------
    RecordedRun
    """
    rows, map_ = data.run.placed_rows, data.map_
    colours = _colours(map_)
    return RecordedRun(
        name=one_line(str(data.run.record.get("source", data.run.path.name))),
        map_=map_,
        index=np.array([row["index"] for row in rows], np.int64),
        trajectory=data.trajectory,
        landmarks_seen=np.array([row.get("landmarks_seen", np.nan) for row in rows], np.float64),
        face_rgb=colours["face"],
        edge_rgb=colours["edge"],
        vertex_rgb=colours["vertex"],
        image_of=data.image_of,
    )


def _colours(map_: TopologicalMap) -> dict[str, NDArray[np.uint8]]:
    from ..view._layers import BARE, colours_of, layers_of_map

    layers = {layer.name: layer for layer in layers_of_map(map_)}
    chosen = {"vertex": "magnitude", "edge": "edge_signal", "face": "face_signal"}
    sizes = {"vertex": len(map_), "edge": len(map_.complex_.edges), "face": len(map_.surface.faces)}
    return {
        level: colours_of(layers[name]) if name in layers else np.tile(BARE, (sizes[level], 1))
        for level, name in chosen.items()
    }


def write_recording(run: str, made: str) -> int:
    """Write a recording in this process, and say on stderr what was wrong with the run.

    Parameters
    ----------
    run : str
        The run folder.
    made : str
        The file.

    Returns
    -------
    int
        The exit code.
    """
    try:
        write_rrd(made, recorded_run(load_run_data(Path(run))))
    except TspSlamError as error:
        sys.stderr.write(f"{error}\n")
        return _REFUSED
    return 0
