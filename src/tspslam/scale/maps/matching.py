"""Places that two finished runs share, on disk: candidates by their looks, then those that geometry proves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..._npz import Arrays
from ...io._form import Form, read_arrays, write_arrays
from ...run.continuing import restore_odometry
from ...vision.features.binary import Descriptors
from ...vision.slam.odometry import StereoOdometry
from ...vision.slam.places.candidates import find_candidates
from ...vision.slam.places.loop_closing import PlaceRecognition
from ...vision.slam.places.settings import LoopSettings
from ...vision.slam.places.shared_places import SharedPlaces, verify
from .runs import FinishedRun
from .states import image_reader, read_step

_ANEW = "the same command makes it anew"
_CANDIDATES = Form("candidates of a join", 2, {"candidates": ("<i8", ("c", 4))}, _ANEW, lambda arrays, lengths: None)
_SHARED = Form(
    "shared places of a join", 1,
    {
        "keyframe": ("<i8", ("s",)),
        "place": ("<i8", ("s",)),
        "T_world_camera": ("<f8", ("s", 4, 4)),
        "depth": ("<f8", ("s",)),
        "start": ("<i8", ("t",)),
        "landmark_id": ("<i8", ("l",)),
        "uv": ("<f8", ("l", 2)),
    },
    _ANEW, lambda arrays, lengths: None,
)  # fmt: skip


@contextmanager
def _opened(run: FinishedRun, state: Path) -> Iterator[StereoOdometry]:
    rows, arrays = read_step(state)
    odometry = restore_odometry(run.rig, run.settings, arrays, image_reader(run, rows))
    try:
        yield odometry
    finally:
        odometry.close()


def write_candidates(states: Sequence[Path], loops: LoopSettings, target: Path) -> None:
    """Look up the keyframes of runs among those of all others.

    Parameters
    ----------
    states : sequence of Path
        Their checkpoints at the end of their paths.
    loops : LoopSettings
        How.
    target : Path
        Where candidates go.
    """
    write_arrays(target, _CANDIDATES, {"candidates": find_candidates([_shown(state) for state in states], loops)})


def _shown(state: Path) -> list[Descriptors]:
    """Descriptors of what each keyframe of a run sees."""
    arrays = read_step(state)[1]
    return np.split(arrays["descriptors"][arrays["landmark"]], np.cumsum(arrays["keyframe_observations"])[:-1])


def read_candidates(path: Path) -> NDArray[np.int64]:
    """Read what `write_candidates` wrote.

    Parameters
    ----------
    path : Path
        Its file.

    Returns
    -------
    (C, 4) int64
        As `find_candidates` gives them.
    """
    return read_arrays(path, _CANDIDATES, lambda arrays: arrays["candidates"])


def write_shared(
    runs: tuple[FinishedRun, FinishedRun], states: tuple[Path, Path], candidates: NDArray[np.int64], target: Path
) -> None:
    """Prove candidates by geometry.

    Parameters
    ----------
    runs : tuple of 2 FinishedRun
        The runs.
    states : tuple of 2 Path
        Their checkpoints at the end of their paths.
    candidates : (C, 2) int64
        Which keyframe of the second, and which of the first.
    target : Path
        Where the shared places go.
    """
    with _opened(runs[0], states[0]) as first, _opened(runs[1], states[1]) as second:
        places = PlaceRecognition(first.map, first.tracking.pose, first.tracking.loops)
        shared = verify(places, second.map, candidates, first.tracking.pose.clear_share)
    write_arrays(target, _SHARED, vars(shared))


def read_shared(path: Path) -> SharedPlaces:
    """Read what `write_shared` wrote.

    Parameters
    ----------
    path : Path
        Its file.

    Returns
    -------
    SharedPlaces
    """
    return read_arrays(path, _SHARED, _shared_of)


def _shared_of(arrays: Arrays) -> SharedPlaces:
    return SharedPlaces(**{name: arrays[name] for name in _SHARED.arrays})
