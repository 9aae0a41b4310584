"""States of odometries: that of a finished run, at the end of its path; those of several as one, in parts apart."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ..._files import bad_input
from ..._npz import Arrays
from ...errors import InputError
from ...io import RunFolder
from ...io.frames import read_frame_image
from ...run._checkpoint import read_checkpoint, write_checkpoint
from ...run.continuing import number_rows, restore_odometry
from ...run.record import FrameRecord, Row
from ...run.sequence import MADE_BY, STATE_NAME
from ...types import Image
from ...vision.slam.back_end.loop_correction import correction_state
from .joined_runs import JoinedRuns
from .runs import FinishedRun

_FRAMES = "anchors", "links", "begun", "keyframe_index"  # columns of numbers of frames
_PAIRS = "closures", "loops"  # of two such each
_PLAIN = (
    "anchored", "looped", "keyframe_pose", "keyframe_observations", "uv", "disparity", "sigma", "xyz", "descriptors",
)  # fmt: skip


def finish_state(run: FinishedRun, target: Path) -> None:
    """Write the state that a run has come to at the end of its path, adjusted, as a checkpoint.

    Parameters
    ----------
    run : FinishedRun
        The run.
    target : Path
        The checkpoint.

    Raises
    ------
    InputError
        If the run's checkpoint was changed, or cannot be what a run has left.
    """
    path = Path(run.path) / STATE_NAME
    folder = RunFolder.open(run.path)
    if folder.units[STATE_NAME].sha256 != run.state:
        raise bad_input(path, "was changed since the join began", "a run that is finished")
    folder.check_unchanged(path)
    rows, state = read_checkpoint(path, MADE_BY)
    rows = number_rows(rows, run.frames)
    odometry = restore_odometry(run.rig, run.settings, state, image_reader(run, rows))
    try:
        odometry.finish()
        bias = odometry.mapper.bias
        final = odometry.state()
        if not bias.is_used:
            final["bias"] = np.array([0.0, bias.sigma**-2.0])
    finally:
        odometry.close()
    write_checkpoint(target, MADE_BY, rows, final)


def read_step(path: Path) -> tuple[list[Row], Arrays]:
    """Read the checkpoint that a step of a join wrote.

    Parameters
    ----------
    path : Path
        Its file.

    Returns
    -------
    rows : list of FrameRecord or SkippedPair
    state : dict of str to array, such as ``xyz`` (M, 3) float64

    Raises
    ------
    InputError
        If it was changed since; the file is named.
    """
    try:
        return read_checkpoint(path, MADE_BY)
    except InputError as error:
        expected = "what a step of this join wrote; without that file the same command makes it anew"
        raise bad_input(path, str(error), expected) from error


def image_reader(run: FinishedRun, rows: Sequence[Row]) -> Callable[[int], Image]:
    """Make what reads left images of the tracked frames of a run.

    Parameters
    ----------
    run : FinishedRun
        The run.
    rows : sequence of FrameRecord or SkippedPair
        Its rows, numbered from 0 on.

    Returns
    -------
    callable
        Of the number of a tracked frame.
    """
    folder = RunFolder.open(run.path)
    places = [run.frames[row.index] for row in rows if isinstance(row, FrameRecord)]
    return lambda number: read_frame_image(folder.finished_frame(places[number]))


def joined_reader(joined: JoinedRuns, rows: Sequence[Row]) -> Callable[[int], Image]:
    """Make what reads left images of the tracked frames of several runs.

    Parameters
    ----------
    joined : JoinedRuns
        The runs.
    rows : sequence of FrameRecord or SkippedPair
        Their rows, as they are numbered among those of all.

    Returns
    -------
    callable
        Of the number of a tracked frame among those of all.
    """
    readers, starts = [], joined.first_tracked
    for run, first in zip(joined.runs, joined.first_pair, strict=True):
        frames = range(first, first + run.pairs)
        readers.append(image_reader(run, number_rows(rows[frames.start : frames.stop], frames)))

    def image_of(number: int) -> Image:
        r = bisect_right(starts, number) - 1
        return readers[r](number - starts[r])

    return image_of


def concatenate_states(joined: JoinedRuns, states: Sequence[Arrays]) -> Arrays:
    """Put the states of runs one after another: each is a further recording, in parts of the map of its own.

    Parameters
    ----------
    joined : JoinedRuns
        The runs.
    states : sequence of dict of str to array, such as ``xyz`` (M, 3) float64
        Theirs, each at the end of its path; stamps are those of the runs.

    Returns
    -------
    dict of str to array
        As an odometry has it.
    """
    numbered = [_numbered(joined, states, r) for r in range(len(states))]
    whole = {name: np.concatenate([one[name] for one in numbered]) for name in numbered[0]}
    last, none = states[-1], np.empty(0, np.int64)
    unsolved = sum(int(state["counts"][2]) for state in states)
    expected, lost, _, _, unplaced = last["counts"].tolist()
    return whole | {
        "poses": last["poses"],
        "row_offset": last["row_offset"],
        "counts": np.array([expected, lost, unsolved, 0, unplaced]),
        "next_id": np.array(sum(int(state["next_id"]) for state in states)),
        "added": np.array(sum(int(state["added"]) for state in states)),
        "bias": _weighed([state["bias"] for state in states], joined.runs[0].settings.settings.tracking.sigma_offset),
        "loop_pose": np.eye(4),
        "loop_landmark": none,
        "loop_seen": np.empty((0, 4)),
        "unsettled": none,
        "doubt": last["doubt"],
        **correction_state(None),
    }


def _numbered(joined: JoinedRuns, states: Sequence[Arrays], r: int) -> Arrays:
    """Columns of the state of run r, with its numbers among those of all."""
    state, frame, more_ids = states[r], joined.first_tracked[r], joined.first_id[r]
    parts, landmarks = (list(_before(states, name))[r] for name in ("keyframe_part", "xyz"))
    ids = {name: state[name] + more_ids for name in ("landmark_id", "merged")}
    own = {name: state[name] + frame for name in (*_FRAMES, *_PAIRS)}
    own |= ids | {name: state[name] for name in _PLAIN}
    own |= {"stamps": state["stamps"], "linked": state["linked"].copy(), "joins": state["joins"] + [frame, frame, 0]}
    own["doubted"] = state["doubted"] + [frame, 0, 0]
    own |= {"keyframe_part": state["keyframe_part"] + parts, "landmark": state["landmark"] + landmarks}
    if r:  # its first frame was located against nothing
        own["begun"] = np.concatenate([[frame], own["begun"]])
        own["links"][0] = states[r - 1]["keyframe_index"][-1] + joined.first_tracked[r - 1]
        own["linked"][0] = np.nan
    return own


def _before(states: Sequence[Arrays], name: str) -> Iterator[int]:
    """How many parts, or landmarks, are in the states before each."""
    count = 0
    for state in states:
        yield count
        count += 1 + int(state[name].max()) if name == "keyframe_part" else len(state[name])


def _weighed(biases: Sequence[Arrays | np.ndarray], sigma: float) -> np.ndarray:
    """The offset of all disparities as all runs together have it, and its information: 0 ± `sigma` is in it once."""
    value, information = np.array(biases).T
    seen = information - sigma**-2.0
    total = seen.sum() + sigma**-2.0
    return np.array([(value * information).sum() / total, total])
