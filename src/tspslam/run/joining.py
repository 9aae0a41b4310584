"""Several recordings in one run: where the frames of each stand, what joined them, a path for each."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from ..datasets.joined import JoinedSequence
from ..io import read_frame
from ..io.landmarks import write_landmarks
from ..io.trajectory import write_tum
from ..mapping.views import take_keyframes
from ..types import BoolArray, FloatArray, Trajectory
from ..vision.se3 import inverse, normalised
from ..vision.slam.keyframes.keyframe import MapSnapshot
from ..vision.slam.odometry import StereoOdometry
from .evaluate import describe_errors, measured
from .map import snapshot_of
from .offset_doubts import Warning_, border_doubts
from .sequence import SequenceRun

_LANDMARKS = "landmark_id", "xyz"


@dataclass(frozen=True, repr=False)
class Standing(Brief):
    """Where the tracked frames of a run stand.

    Attributes
    ----------
    recording : (T,) int64
        Which recording each is of.
    origin : (T,) int64
        Number of the tracked frame whose camera is the origin that its pose is known in: 0 for those of the first
        recording and of what was joined to it; -1 of frames before the first keyframe of their recording.
    """

    recording: NDArray[np.int64]
    origin: NDArray[np.int64]

    @property
    def is_placed(self) -> BoolArray:
        """Which frames stand in the frame of the first one, (T,)."""
        return np.asarray(self.origin == 0)

    def home(self, recording: int) -> int:
        """Find the origin of a recording's path: the first frame of all if any of it stands there, else its own.

        Parameters
        ----------
        recording : int
            Which.

        Returns
        -------
        int
            As in `origin`; -1 if it has no keyframe.
        """
        origins = self.origin[(self.recording == recording) & (self.origin >= 0)]
        return -1 if not len(origins) else 0 if (origins == 0).any() else int(np.argmax(np.bincount(origins)))


def stand(sequence: SequenceRun) -> Standing:
    """Find where the tracked frames of a run stand.

    Parameters
    ----------
    sequence : SequenceRun
        At least one frame is tracked.

    Returns
    -------
    Standing
    """
    starts = getattr(sequence.source, "starts", (0,))
    recording = np.array([bisect_right(starts, row.index) - 1 for row in sequence.tracked], np.int64)
    odometry = sequence.session.odometry
    if not isinstance(odometry, StereoOdometry) or not odometry.path.begun:
        return Standing(recording, np.zeros(len(recording), np.int64))
    origin, begun = odometry.path.origins(odometry.map), odometry.path.begun
    first = np.array([0, *begun])[np.searchsorted(begun, np.arange(len(origin)), side="right")]
    return Standing(recording, np.where(recording[first] == recording, origin, -1))


def placed_path(sequence: SequenceRun) -> Trajectory:
    """Collect the path of the frames that stand in the frame of the first one; of several of one moment, the first.

    Parameters
    ----------
    sequence : SequenceRun
        At least one frame is tracked.

    Returns
    -------
    Trajectory
    """
    path, is_placed = sequence.session.trajectory, stand(sequence).is_placed
    return _rising(path.stamp[is_placed], path.T_world_camera[is_placed])


def placed_poses(sequence: SequenceRun) -> dict[int, FloatArray]:
    """Collect the poses of the same frames, by their indices.

    Parameters
    ----------
    sequence : SequenceRun
        As `placed_path`.

    Returns
    -------
    dict of int to (4, 4) float64
    """
    told = zip(sequence.tracked, sequence.session.trajectory.T_world_camera, stand(sequence).is_placed, strict=True)
    return {row.index: T for row, T, is_placed in told if is_placed}


def _rising(stamp: FloatArray, T: FloatArray) -> Trajectory:
    first = np.diff(stamp, prepend=-np.inf) > 0
    return Trajectory(stamp[first], T[first])


def join_doubts(refused: Iterable[str], left_out: Iterable[str]) -> tuple[list[Warning_], list[Warning_]]:
    """Make warnings of what a join of finished runs has to say.

    Parameters
    ----------
    refused : iterable of str
        Of each two runs whose shared places were not believed.
    left_out : iterable of str
        Of each run that the map is without.

    Returns
    -------
    list of dict
        Of the former, each a ``code`` and a ``message``.
    list of dict
        Of the latter.
    """
    return (
        [{"code": "join_refused", "message": line} for line in refused],
        [{"code": "join_left_out", "message": line} for line in left_out],
    )


def describe_recordings(sequence: SequenceRun) -> tuple[list[dict[str, Any]], list[Warning_]]:
    """Say of each recording of a run where its frames begin, how many are tracked, and what joined it to others.

    Parameters
    ----------
    sequence : SequenceRun
        A finished one.

    Returns
    -------
    list of dict
        As ``recordings`` of ``run.json`` has them; none of a run of a single source.
    list of dict
        Warnings, each a ``code`` and a ``message``: of recordings that were not joined to the first one.
    """
    if not isinstance(sequence.source, JoinedSequence):
        return [], []
    standing = stand(sequence)
    joined = _joined_by(sequence, sequence.source, standing)
    told = [_describe(sequence, sequence.source, standing, joined.get(k), k) for k in range(len(sequence.source.names))]
    doubts = [*getattr(sequence.source, "left_out", ())]
    doubts += [warning for one in told for warning in _doubts(one, told[0]["name"])]
    odometry = sequence.session.odometry
    if isinstance(odometry, StereoOdometry):
        doubts += border_doubts(odometry.mapper.bias, standing.recording, sequence.source.names)
    return told, doubts


def _describe(
    sequence: SequenceRun, source: JoinedSequence, standing: Standing, joined_by: dict[str, Any] | None, k: int
) -> dict[str, Any]:
    """What is said of recording k."""
    rows = [row for row, of in zip(sequence.tracked, standing.recording, strict=True) if of == k]
    home = standing.home(k)
    own = _own_path(sequence, standing, k)
    local = [row.index - source.starts[k] for row in rows]
    errors, said = measured(source.recordings[k], own, local) if len(own) and local else (None, [])
    return {
        "name": source.names[k],
        "first": source.starts[k],
        "frames": len(source.recordings[k]),
        "tracked": sum(not row.is_lost for row in rows),
        "keyframes": sum(row.is_keyframe for row in rows),
        "relative_to": None if home < 0 else source.names[int(standing.recording[home])],
        "apart": int(((standing.recording == k) & (standing.origin != home)).sum()),
        "joined_by": joined_by,
        "loops_to_others": _loops_to_others(sequence, standing, k),
        "stamp_offset_s": float(source.offsets[k]),
        "trajectory": path_name(source.names[k]) if len(own) else None,
        **({"evaluation": describe_errors(errors)} if errors else {}),
        **({"truth_warnings": [each["message"] for each in said]} if said else {}),
    }


def _joined_by(sequence: SequenceRun, source: JoinedSequence, standing: Standing) -> dict[int, dict[str, Any]]:
    """What joined recordings to those before: frames by their indices, and how many landmarks both saw."""
    odometry, rows, told = sequence.session.odometry, sequence.tracked, {}
    joins = odometry.mapper.joins if isinstance(odometry, StereoOdometry) else []
    ends = [(int(standing.recording[frame]), int(standing.recording[earlier])) for frame, earlier, _ in joins]
    for k, (other, n) in grow_tree(ends, len(source.names)).items():
        frame, earlier, landmarks = joins[n]
        places = {"frame": rows[frame].index, "seen_from": rows[earlier].index}
        told[k] = {"recording": source.names[other], **places, "landmarks": landmarks}
    return told


def grow_tree(joins: Sequence[tuple[int, int]], count: int) -> dict[int, tuple[int, int]]:
    """Find what joined recordings to the lowest one that they are joined to, directly or by others: none goes round.

    Parameters
    ----------
    joins : sequence of (int, int)
        Recordings that were joined, in the order of their frames.
    count : int
        How many recordings there are.

    Returns
    -------
    dict of int to (int, int)
        By the recording: the other one, and which of the joins; not of the lowest one of those that are joined.

    Examples
    --------
    >>> grow_tree([(2, 1), (2, 0)], 4)
    {2: (0, 1), 1: (2, 0)}
    """
    known, found = set[int](), dict[int, tuple[int, int]]()
    for lowest in range(count):
        known.add(lowest)
        while leading := [n for n, (one, other) in enumerate(joins) if (one in known) != (other in known)]:
            one, other = joins[leading[0]]
            new, old = (other, one) if one in known else (one, other)
            found[new] = old, leading[0]
            known.add(new)
    return found


def _loops_to_others(sequence: SequenceRun, standing: Standing, k: int) -> int:
    odometry = sequence.session.odometry
    assert isinstance(odometry, StereoOdometry)
    ends = ({int(standing.recording[number]) for number in loop} for loop in odometry.mapper.closures)
    return sum(len(both) == 2 and k in both for both in ends)


def _doubts(one: dict[str, Any], first: str) -> Iterator[Warning_]:
    """That a recording, or some of its frames, has no place in the frame of the first."""
    name, origin = one["name"], one["relative_to"]
    if origin is None:
        yield {"code": "not_joined", "message": f"{name}: none of its {one['frames']} pairs could be tracked"}
    elif origin != first:
        start = "its own start" if origin == name else f"the start of {origin}"
        message = (
            f"{name} was not found in the map of {first}: its poses are relative to {start} ({one['trajectory']}); "
            "the map and trajectory.tum are without it"
        )
        yield {"code": "not_joined", "message": message}
    if one["apart"] and origin is not None:
        message = f"{name}: {one['apart']} of its frames stand nowhere in that path: they were seen before it was found"
        yield {"code": "apart", "message": message}


def path_name(recording: str) -> str:
    """Name the file with the path of a recording.

    Parameters
    ----------
    recording : str
        What it is called.

    Returns
    -------
    str

    Examples
    --------
    >>> path_name("monday")
    'trajectory_monday.tum'
    """
    return f"trajectory_{recording}.tum"


def write_own_paths(sequence: SequenceRun) -> list[Path]:
    """Write the path of each recording with its own stamps, in TUM's form.

    Parameters
    ----------
    sequence : SequenceRun
        A finished one.

    Returns
    -------
    list of path
        The files; none of a run of a single source, nor of a recording without a keyframe.
    """
    source = sequence.source
    if not isinstance(source, JoinedSequence):
        return []
    standing, written = stand(sequence), list[Path]()
    for k, name in enumerate(source.names):
        path = _own_path(sequence, standing, k)
        if len(path):
            written.append(sequence.folder.path / path_name(name))
            write_tum(written[-1], path.stamp, path.T_world_camera)
    return written


def _own_path(sequence: SequenceRun, standing: Standing, k: int) -> Trajectory:
    """Path of recording k: in the frame of the first one if it was joined to that, else relative to its own start."""
    home, path = standing.home(k), sequence.session.trajectory
    chosen = np.flatnonzero((standing.recording == k) & (standing.origin == home) & (home >= 0))
    T = path.T_world_camera[chosen]
    if home > 0:
        T = normalised(inverse(path.T_world_camera[home]) @ T)
    tracked = sequence.tracked
    rows = [tracked[n] for n in chosen.tolist()]
    stamps = [row.stamp if row.own_stamp is None else row.own_stamp for row in rows]
    return _rising(np.array(stamps, np.float64), T)


def note_landmarks(sequence: SequenceRun) -> Path:
    """Write what the map is made of besides the keyframes: landmarks, with frames by their indices.

    Parameters
    ----------
    sequence : SequenceRun
        A finished one.

    Returns
    -------
    path
        The file; it is not in the manifest yet. Keyframes that do not stand in the frame of the first are left out.
    """
    odometry, folder = sequence.session.odometry, sequence.folder
    if isinstance(odometry, StereoOdometry):
        indices = np.array([row.index for row in sequence.tracked], np.int64)
        snapshot, rig = odometry.map.snapshot(), odometry.map.rig
        snapshot = _without(snapshot, ~stand(sequence).is_placed[snapshot.keyframe])
        snapshot = replace(snapshot, keyframe=indices[snapshot.keyframe])
    else:
        path = zip(sequence.tracked, sequence.session.trajectory.T_world_camera, strict=True)
        poses = {row.index: T for row, T in path if row.is_keyframe and row.complex_ is not None}
        frames = {index: read_frame(folder.frame_path(index)) for index in poses}
        snapshot, rig = snapshot_of(frames, poses), sequence.session.rig
    write_landmarks(folder.landmarks_path, snapshot, rig)
    return folder.landmarks_path


def _without(snapshot: MapSnapshot, gone: BoolArray) -> MapSnapshot:
    """A snapshot without some keyframes, and the landmarks that only they see."""
    if not gone.any():
        return snapshot
    rest = take_keyframes(snapshot, ~gone)
    seen = np.isin(snapshot.landmark_id, rest.observed_id)
    return replace(rest, **{name: getattr(snapshot, name)[seen] for name in _LANDMARKS})
