"""``tspslam recognise``: pairs of keyframes, of one run or of two, that may show the same place."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._files import bad_input
from ..apps.recognise import compare_descriptors, describe, find_places
from ..frame import Frame
from ..io import RunFolder, read_frame
from ..topology.harmonic import tmahf_bank

ORDERS, RINGS = (1, 2), (1, 2, 3)  # as those of docs/recognise.rst
LAYOUT = (6, 3)  # cells of the image, rows and columns: a camera on a robot stays upright (docs/recognise.rst)


class Pair(NamedTuple):
    """Two keyframes that may show the same place: their indices, and how alike they are, up to 1."""

    frame: int
    other: int
    score: float


def find_pairs(run: Path, other: Path | None = None, *, apart: int = 10, most: int = 20) -> list[Pair]:
    """Compare the keyframes of a run with its earlier ones, or with those of another run.

    Parameters
    ----------
    run : path
        A run folder.
    other : path, optional
        Another one.
    apart : int
        Keyframes of one run that are nearer in time than so many keyframes are left out.
    most : int
        How many pairs there are at most.

    Returns
    -------
    list of Pair
        Best first.

    Raises
    ------
    InputError
        If a folder is no run with stored keyframes, or the runs' descriptors cannot be compared.
    """
    frames, descriptors = _described(run)
    if other is None:
        found = find_places(descriptors, apart=apart)
        pairs = zip(found.second, found.first, found.score, strict=True)
        return [Pair(frames[later], frames[earlier], float(score)) for later, earlier, score in list(pairs)[:most]]
    others, theirs = _described(other)
    alike = compare_descriptors(descriptors, theirs, mean=np.concatenate([descriptors, theirs]).mean(axis=0))
    best = np.argsort(-alike, axis=None, kind="stable")[:most]
    rows, columns = np.unravel_index(best, alike.shape)
    return [
        Pair(frames[i], others[j], float(alike[i, j])) for i, j in zip(rows, columns, strict=True) if alike[i, j] > 0
    ]


def _described(run: Path) -> tuple[tuple[int, ...], NDArray[np.float32]]:
    folder = RunFolder.open(run)
    frames = folder.stored_frames
    if not frames:
        raise bad_input(run, "has no stored keyframe", "a finished run")
    return frames, np.stack([_describe(read_frame(folder.finished_frame(index))) for index in frames])


def _describe(frame: Frame) -> NDArray[np.float32]:
    uv, signals = frame.cloud.uv, frame.signals
    bank = tmahf_bank(frame.complex_, uv, signals, ORDERS, RINGS)
    return describe(frame.complex_, signals, bank, layout=LAYOUT, uv=uv, size=(frame.rig.width, frame.rig.height))
