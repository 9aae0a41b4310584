"""The map of a sequence on disk: a versioned npz; equal maps give equal bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .._checks import require, require_path
from .._files import PathLike, bad_input
from .._npz import Arrays
from ..topological_map import Levels, Observations, TopologicalMap
from ..types import Surface
from ._form import part_of, read_arrays, rig_arrays, rig_of, write_arrays
from ._frame_schema import complex_arrays, complex_of
from ._map_schema import AGAIN, FORM
from .runfolder import RunFolder

_PLAIN = (
    "xyz", "covariance", "response_view", "direction", "direction_spread", "direction_count", "landmark_id",
    "keyframes", "T_world_camera", "gain",
)  # fmt: skip


def write_map(path: PathLike, map_: TopologicalMap) -> None:
    """Write a map as npz, whole or not at all; equal maps give equal bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    map_ : TopologicalMap
        As `build_map` gives it.

    Raises
    ------
    InputError
        If the map's arrays do not fit each other, or hold a value that is not finite (``disparity`` of an observation
        may be NaN).
    OutputError
        If the file cannot be written.
    """
    require(map_, TopologicalMap, "map_")
    if Path(path).suffix.lower() in (".vtu", ".ply"):
        raise bad_input(
            path, "is a name of another format", "a name that ends with .npz; tspslam.io.maps writes VTU, PLY"
        )
    levels = [(name, level) for name in ("view_count", "view_variance", "best_view") for level in Levels._fields]
    observations = ("start", "keyframe", "uv", "disparity", "weight")
    values: dict[str, Any] = {
        **rig_arrays(map_.rig),
        "surface_faces": map_.surface.faces,
        **complex_arrays(map_.complex_, map_.signals, map_.response),
        **{f"{name}_{level}": getattr(getattr(map_, name), level) for name, level in levels},
        **{f"observations_{name}": getattr(map_.observations, name) for name in observations},
        **{name: getattr(map_, name) for name in _PLAIN},
    }
    write_arrays(path, FORM, values)


def read_map(path: PathLike) -> TopologicalMap:
    """Read a map that `write_map` wrote.

    Nothing is unpickled; every claimed size is compared with what is there before memory is taken.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    TopologicalMap

    Raises
    ------
    InputError
        If the file is no such npz, of another version, damaged, or its arrays are missing or inconsistent.

    Examples
    --------
    >>> from tspslam import InputError
    >>> try:
    ...     read_map("no such map.npz")
    ... except InputError as error:
    ...     print(str(error)[:33])
    no such map.npz: cannot be opened
    """
    return read_arrays(path, FORM, _map)


def _map(arrays: Arrays) -> TopologicalMap:
    complex_, signals, response = complex_of(arrays)
    return TopologicalMap(
        surface=Surface(arrays["surface_faces"]),
        complex_=complex_,
        signals=signals,
        view_count=Levels(**part_of(arrays, "view_count_")),
        view_variance=Levels(**part_of(arrays, "view_variance_")),
        best_view=Levels(**part_of(arrays, "best_view_")),
        response=response,
        observations=Observations(**part_of(arrays, "observations_")),
        rig=rig_of(arrays),
        **{name: arrays[name] for name in _PLAIN},
    )


def load_map(run: PathLike) -> TopologicalMap:
    """Read the map of a finished run.

    Parameters
    ----------
    run : str or path
        The run folder, or its ``map.npz``.

    Returns
    -------
    TopologicalMap

    Raises
    ------
    InputError
        If it is no run folder and no map, the run has no map, or the file was changed since the run.

    Examples
    --------
    >>> load_map("no-such-run")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-run: holds no config.yaml of a run; expected a run folder of ours
    """
    require_path(run, "run")
    if Path(run).is_file():
        return read_map(run)
    folder = RunFolder.open(run)
    if not folder.map_npz_path.exists() and folder.map_npz_path.name not in folder.units:
        raise bad_input(run, "has no map.npz", f"the run of a sequence whose map was made: {AGAIN}")
    folder.check_unchanged(folder.map_npz_path)
    return read_map(folder.map_npz_path)
