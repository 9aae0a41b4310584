"""The landmarks of a sequence on disk, as the path leaves them, from which its map is made: a versioned npz."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from .._checks import is_rigid, require
from .._files import PathLike
from .._npz import Arrays
from ..errors import InputError
from ..types import Rig
from ..vision.slam.keyframes.keyframe import MapSnapshot
from ._form import (
    RIG_SCHEMA,
    Form,
    check_ascending,
    check_least,
    check_starts,
    read_arrays,
    rig_arrays,
    rig_of,
    write_arrays,
)

_NAMES = tuple(each.name for each in fields(MapSnapshot))


def write_landmarks(path: PathLike, snapshot: MapSnapshot, rig: Rig) -> None:
    """Write landmarks, keyframes and what these see of those as npz, whole or not at all; the same gives equal bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    snapshot : MapSnapshot
        Of the path when all frames were seen.
    rig : Rig
        The cameras, with the offset of the disparities that the path found.

    Raises
    ------
    InputError
        If arrays do not fit each other, or hold a value that is not finite (``disparity`` may be NaN).
    OutputError
        If the file cannot be written.
    """
    require(snapshot, MapSnapshot, "snapshot")
    require(rig, Rig, "rig")
    write_arrays(path, _FORM, rig_arrays(rig) | {name: getattr(snapshot, name) for name in _NAMES})


def read_landmarks(path: PathLike) -> tuple[MapSnapshot, Rig]:
    """Read what `write_landmarks` wrote; guarded as `read_frame`.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    snapshot : MapSnapshot
    rig : Rig

    Raises
    ------
    InputError
        If the file is no such npz, of another version, damaged, or its arrays are missing or inconsistent.
    """
    return read_arrays(path, _FORM, lambda arrays: (MapSnapshot(**{k: arrays[k] for k in _NAMES}), rig_of(arrays)))


def _check(arrays: Arrays, lengths: dict[str, tuple[int, ...]]) -> None:
    check_ascending(arrays, "landmark_id", "keyframe")
    if not is_rigid(arrays["T_world_camera"]):
        raise InputError("array T_world_camera holds no rigid motion")
    check_starts(arrays, "start", lengths["k"][0], lengths["o"][0])
    seen = arrays["observed_id"]
    if not np.isin(seen, arrays["landmark_id"]).all():
        raise InputError("array observed_id holds the number of no landmark")
    keyframe = np.repeat(np.arange(lengths["k"][0]), np.diff(arrays["start"]))
    if len(np.unique(np.column_stack([keyframe, seen]), axis=0)) < len(seen):
        raise InputError("array observed_id holds a landmark twice in a keyframe")
    check_least(arrays, "merged")


# Letters are sizes that must agree: m landmarks, k keyframes, s keyframes and one, o observations, r merged pairs.
_FORM = Form(
    "landmarks",
    1,
    {
        **RIG_SCHEMA,
        "landmark_id": ("<i8", ("m",)),
        "xyz": ("<f8", ("m", 3)),
        "keyframe": ("<i8", ("k",)),
        "T_world_camera": ("<f8", ("k", 4, 4)),
        "start": ("<i8", ("s",)),
        "observed_id": ("<i8", ("o",)),
        "uv": ("<f8", ("o", 2)),
        "disparity": ("<f8", ("o",)),
        "merged": ("<i8", ("r", 2)),
    },
    "the run is to be made anew",
    _check,
    may_be_nan=frozenset({"disparity"}),
    level=0,
)
