"""A finished run read back: its path, its keyframes, and its frames, each when it is asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from .._checks import require_path
from .._files import PathLike, bad_input
from ..frame import Frame
from ..types import FloatArray, Trajectory
from ._record import checked_rows
from .frames import read_frame
from .runfolder import RunFolder
from .trajectory import read_trajectory


@dataclass(frozen=True, repr=False)
class StoredRun:
    """A finished run. Read it with `tspslam.load_run`; ``len(run)`` is the number of its frames.

    Attributes
    ----------
    path : Path
        The run folder.
    record : dict
        What ``run.json`` holds: status, counts, calibration, warnings, a row for each frame.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.run import config, pipeline
    >>> from tspslam import datasets, load_run
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = pipeline.run(pipeline.OnePair(datasets.motorcycle()), f"{folder}/run", config.resolve())
    ...     run = load_run(f"{folder}/run")
    ...     frame, path = run.frame(0), run.trajectory
    >>> run.keyframes, len(path), len(frame.response) == len(frame.cloud)
    ((0,), 1, True)
    """

    path: Path
    record: dict[str, Any]

    def __len__(self) -> int:
        return int(self.record["frames"])

    def __repr__(self) -> str:
        counts = f"{len(self)} frames, {len(self.keyframes)} keyframes, {len(self.stored)} stored"
        return f"StoredRun({str(self.path)!r}: {self.record['status']}, {counts})"

    @cached_property
    def trajectory(self) -> Trajectory:
        """Poses of the left camera, by stamp; the world is the first frame's camera. `InputError` if it has none."""
        self._folder.check_unchanged(self.path / "trajectory.tum")
        return read_trajectory(self.path)

    @cached_property
    def keyframes(self) -> tuple[int, ...]:
        """Indices of the frames that the map rests on; none of what ``tspslam filter`` made.

        Nor those of a recording that was not joined to the first one.
        """
        return tuple(row["index"] for row in self.placed_rows if row["is_keyframe"])

    @cached_property
    def stored(self) -> tuple[int, ...]:
        """Indices of the frames that have a file: keyframes, and frames where tracking was lost."""
        return self._folder.stored_frames

    def frame(self, index: int) -> Frame:
        """Read one stored frame: cloud in the camera's frame, surface, complex, signals, response.

        Parameters
        ----------
        index : int
            Place in its sequence, one of `stored`.

        Returns
        -------
        Frame

        Raises
        ------
        InputError
            If the frame has no file, since it is no keyframe, say; or the file was changed since the run.
        """
        return read_frame(self._folder.finished_frame(index))

    @property
    def frames(self) -> Iterator[Frame]:
        """Stored frames one after another, each read when it is its turn."""
        return (self.frame(index) for index in self.stored)

    def pose(self, index: int) -> FloatArray:
        """``T_world_camera`` of a frame, as the whole run has refined it: keyframe, or only tracked.

        Parameters
        ----------
        index : int
            Place in its sequence.

        Returns
        -------
        (4, 4) float64

        Raises
        ------
        InputError
            If the frame has no pose: it was skipped, or is none of the run's.
        """
        stamps = {row["index"]: row["stamp"] for row in self.placed_rows}
        found = np.flatnonzero(self.trajectory.stamp == stamps.get(index, np.nan))
        if not len(found):
            raise bad_input(self.path, f"has no pose of frame {index}", f"one of {len(stamps)} tracked frames")
        pose: FloatArray = self.trajectory.T_world_camera[found[0]]
        return pose

    @property
    def placed_rows(self) -> list[dict[str, Any]]:
        """Rows of ``per_frame`` in ``run.json``, without those of recordings that were not joined to the first one."""
        return [row for row in self.record.get("per_frame", []) if not row.get("is_apart")]

    @cached_property
    def _folder(self) -> RunFolder:
        return RunFolder.open(self.path)


def load_run(path: PathLike) -> StoredRun:
    """Read back what ``tspslam run`` or ``tspslam filter`` left.

    Parameters
    ----------
    path : str or path
        The run folder.

    Returns
    -------
    StoredRun
        Nothing but ``run.json`` is read before it is asked for.

    Raises
    ------
    InputError
        If it is no folder of a finished run.

    Examples
    --------
    >>> load_run("no-such-run")
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-run: holds no config.yaml of a run; expected a run folder of ours
    """
    require_path(path)
    folder = RunFolder.open(path)
    if not (folder.path / "run.json").exists():
        raise bad_input(path, "has no run.json yet", "a finished run: the same command again goes on with it")
    file, record = folder.path / "run.json", folder.read_run()
    if not _is_record(record, checked_rows(file, record)):
        raise bad_input(file, "is not what a run writes", "status, frames and per_frame")
    folder.check_unchanged(file)
    return StoredRun(folder.path, record)


def _is_record(record: dict[str, Any], rows: list[dict[str, Any]]) -> bool:
    """Whether it has what is read of it here, each of its type."""
    status, frames = record.get("status"), record.get("frames")
    is_counted = isinstance(frames, int) and frames >= 0
    return isinstance(status, str) and is_counted and all(isinstance(row.get("is_keyframe"), bool) for row in rows)
